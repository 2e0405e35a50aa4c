"""Equations of motion of a model file by virtual power: all bodies in absolute coordinates, in the base frame.

This is an independent program: it reads the YAML's data, and shares no line with the generator. Each body's motion is
summed joint by joint, and its inertial force and moment (m (a - g); I alpha + om x I om) are applied to every joint
before it:

    Phi_j = sum of m (a - g) . dv/dqd_j + (I alpha + om x I om) . dom/dqd_j, less the wrenches' power at unit speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.fuzz.forces import Forces
from tests.fuzz.kinematics import FLOATS, Array, Data, Kinematics, Motion, Numbers, Values

__all__ = ["Absolute", "Array", "Data", "Found"]


@dataclass(frozen=True)
class Found:
    """The joint forces, by name; and energies."""

    Phi: dict[str, Any]
    size: Any  # of the largest sum of magnitudes that an entry of Phi is
    Q: dict[str, Any]  # without u
    kinetic: Any
    potential: Any
    power: Any  # of the wrenches
    frames: dict[str, Motion]


class Absolute(Kinematics):
    """A model with numbers for its parameters. Coordinates, velocities and accelerations are given by name."""

    def __init__(self, model: Data, names: Values, numbers: Numbers = FLOATS, *, gravity: bool = True) -> None:
        super().__init__(model, names, numbers)
        self.gravity = self.vector(model["gravity"] if gravity else [0, 0, 0])

    def run(self, q: Values, qd: Values, qdd: Values, w: Values) -> Found:
        """Evaluate at a state of all joints. `w` holds `NAME.force` and `NAME.moment` of wrenches that are inputs."""
        bodies = self.move(q, qd, qdd).bodies
        zero = self.numbers.make(0.0)
        Phi, sizes, Q = (dict.fromkeys(qd, zero) for _ in range(3))
        kinetic = potential = power = zero

        def hook(motion: Motion, F: Array, N: Array) -> None:
            for column in motion.columns:
                parts = [x @ y for x, y in zip((F, N), column.at(motion.p), strict=True)]
                Phi[column.name] += sum(parts)
                sizes[column.name] += sum(map(abs, parts))

        for body in self.model["bodies"]:
            mass = self.number(body.get("mass", 0.0))
            motion = bodies[body["name"]].carry(self.vector(body.get("com", [0, 0, 0])))
            inertia = motion.R @ self.inertia(body) @ motion.R.T
            hook(
                motion,
                mass * (motion.a - self.gravity),
                inertia @ motion.alpha + np.cross(motion.om, inertia @ motion.om),
            )
            kinetic += (mass * motion.v @ motion.v + motion.om @ inertia @ motion.om) / 2
            potential -= mass * self.gravity @ motion.p
        forces = Forces(self, bodies, q, qd, w)
        for x in forces.list_applied(w):
            hook(x.motion, -x.force, -x.moment)
            power += x.force @ x.motion.v + x.moment @ x.motion.om
        for name, joint in self.elementary():
            rotor = self.number(joint.get("armature", 0.0))
            Phi[name] += rotor * qdd[name]
            sizes[name] += abs(rotor * qdd[name])
            kinetic += rotor * qd[name] ** 2 / 2
            Q[name] = self.law(joint, q[name], qd[name], forces.names)
        frames = {f["name"]: self.place(bodies[f["body"]], f) for f in self.model.get("frames", ())}
        return Found(Phi, max(sizes.values()), Q, kinetic, potential, power, frames)
