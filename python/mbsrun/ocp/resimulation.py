"""Integrate the true motion under the inputs of a solution, and tell how far the collocation is from it.

    M(q) qdd = -Phi(q, qd, 0, u),    M = dPhi/dqdd

and the rates of q, which are qd but for quaternions,

by DOP853 at tolerances near rounding: from the start of every interval to its end (the defect, which judges the
discretisation), and from the start of the horizon to its end (where an unstable plant has multiplied the defects).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

from mbsgen.errors import MbsError
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.solution import Resimulation, Solution
from mbsrun.quaternions import find_rates

Array = NDArray[np.float64]

TOLERANCE = 1e-13  # relative and absolute


def resimulate(solution: Solution, plant: Plant) -> Solution:
    """Return the solution with its re-simulation."""
    trajectory = solution.trajectory
    step = float(trajectory.t[1] - trajectory.t[0])
    states = np.concatenate((trajectory.q, trajectory.qd), axis=1)
    ends = integrate(plant, states[:-1], trajectory.u, step)
    defects = None if ends is None else np.abs(ends - states[1:]).max(axis=1)
    last: Array | None = states[:1]
    for u in trajectory.u:
        last = None if last is None else integrate(plant, last, u[None], step)
    return replace(
        solution,
        resimulation=Resimulation(
            defect=None if defects is None else float(defects.max()),
            defect_interval=None if defects is None else int(defects.argmax()),
            open_loop_error=None if last is None else float(np.abs(last[0] - states[-1]).max()),
            is_accurate=defects is not None and bool(defects.max() <= solution.problem.accuracy),
        ),
    )


def integrate(plant: Plant, states: Array, u: Array, duration: float) -> Array | None:
    """Integrate several motions at once: states (B, nq + n) under constant inputs (B, m) for `duration` s.

    Gives the states at the end, or None where the integrator or a kernel gives up.
    """

    def rate(_: float, flat: Array) -> Array:
        q, qd = np.split(flat.reshape(states.shape), [places], axis=1)
        return np.concatenate((find_rates(plant, q, qd), accelerations(plant, q, qd, u)), axis=1).ravel()

    places = len(plant.manifest.positions)

    try:
        solver = DOP853(rate, 0.0, states.ravel(), duration, rtol=TOLERANCE, atol=TOLERANCE)
        if not np.isfinite(solver.h_abs):  # it would look for a first step without end
            return None
        with np.errstate(all="ignore"):  # a motion that runs away ends in a status
            while solver.status == "running":
                solver.step()
    except (MbsError, np.linalg.LinAlgError):  # a kernel that fails, a mass matrix that is singular
        return None
    return np.asarray(solver.y.reshape(states.shape)) if solver.status == "finished" else None


def accelerations(plant: Plant, q: Array, qd: Array, u: Array) -> Array:
    """Solve the equations of motion for qdd in several states: q (B, nq), qd (B, n), u (B, m)."""
    zero = np.zeros_like(qd)
    M = plant("jac_impl", q=q, qd=qd, qdd=zero, u=u)["jac_Phi_qdd"]
    c = plant("impl", q=q, qd=qd, qdd=zero, u=u)["Phi"]
    return np.asarray(np.linalg.solve(M, -c[..., None])[..., 0])
