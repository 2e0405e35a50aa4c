"""Mirror images of motions, in the plane through the base's x and z axes: targets at opposite azimuths.

A mechanism is its own mirror image where some joints, moved the other way, move everything in it as a mirror shows.
Which joints is found by numbers: signs of the coordinates, and of their forces, under which neither the equations of
motion nor the sensor's place change. The image of an optimum is an optimum of the opposite target then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from mbsgen.errors import MbsError
from mbsgen.manifest import Manifest
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.problem import Problem

MOST = 10  # coordinates: all their signs are tried
SEED = 1  # of the state that they are tried in
ALIKE = 1e-9  # relative, of forces and places
MIRROR = np.array([1.0, -1.0, 1.0])


def find_mirror(problem: Problem, plant: Plant, sensor: str) -> tuple[int, ...]:
    """Find the sign of every coordinate, 1 or -1, in a mirror image; () where there is none, or none is looked for.

    None is looked for in mechanisms with quaternions, loops, driven joints or open wrenches, and in problems with
    further states, controls or unknowns.
    """
    manifest = plant.manifest
    n, sensors = len(manifest.coordinates), [frame.name for frame in manifest.frames if frame.sensor]
    beside = (problem.every_state, problem.controls, problem.unknowns, problem.wrenches, manifest.driven)
    if n > MOST or problem.has_quaternions or manifest.dependent or any(beside) or manifest.wrenches:
        return ()
    state = np.random.default_rng(SEED).uniform(-1.0, 1.0, (3, n))
    force = np.random.default_rng(SEED + 1).uniform(-1.0, 1.0, len(manifest.actuated))
    signs = np.array([*product((1, -1), repeat=n)])
    q, qd, qdd = (np.ascontiguousarray(signs * part) for part in state)
    try:
        Phi = plant("impl", q=q, qd=qd, qdd=qdd, u=signs[:, list(manifest.actuated)] * force)["Phi"]
        place = plant("sensors", q=q)["position"][:, :, sensors.index(sensor)]
    except MbsError:  # a kernel that fails in the state that is tried
        return ()
    alike = np.abs(signs * Phi - Phi[0]).max(axis=1) <= ALIKE * np.abs(Phi[0]).max()
    alike &= np.abs(place - MIRROR * place[0]).max(axis=1) <= ALIKE * np.abs(place[0]).max()
    return tuple(map(int, signs[alike.argmax()])) if alike.any() else ()


def reflect(motion: Trajectory, signs: Sequence[int], manifest: Manifest) -> Trajectory:
    """Return the mirror image of a motion, by the signs of `find_mirror`."""
    sign = np.array(signs)
    force = sign[list(manifest.actuated)]
    return replace(
        motion,
        q=sign * motion.q,
        qd=sign * motion.qd,
        u=force * motion.u,
        point_q=sign * motion.point_q,
        point_qd=sign * motion.point_qd,
        point_qdd=sign * motion.point_qdd,
        point_u=force * motion.point_u if motion.point_u.shape[-1] else motion.point_u,
    )
