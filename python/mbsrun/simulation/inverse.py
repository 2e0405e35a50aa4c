"""Inverse dynamics along a given motion: some joints' q(t), and so all others' -> the forces that it takes.

    Phi(q, qd, qdd) = S u + D tau + J^T lam

Phi is the residual without inputs, S and D choose the actuated and the driven joints. With a basis Z of the motions
that loops admit, J Z = 0, the forces solve Z^T (S u + D tau) = Z^T Phi: the ones of least norm, where there are more of
them than freedoms; what they cannot balance is returned, where there are fewer. The rest gives the multipliers lam.

Loops are closed near the pose that the poses before lead to. So a mechanism stays on its branch where branches meet, as
a parallelogram does where its links are in line.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from mbsgen.errors import MbsError
from mbsgen.manifest import TIME, Manifest
from mbsrun.closure import FARTHEST, RANK, Closure, OpenError
from mbsrun.kernel import ArgumentError, Kernels
from mbsrun.quantities import Added, label_forces, label_motion, label_multipliers, list_quantities
from mbsrun.quaternions import neutral, normalise
from mbsrun.results import Numbers
from mbsrun.simulation.closing import complete_velocities
from mbsrun.simulation.course import Course, stand
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.formulation import Formulation

Array = NDArray[np.float64]
PREDICTING = 3  # poses that the next one is extrapolated from
LEAST, ROUNDED = 3, 1e-9  # rows that show a jump; a jump that counts [rad, m]
OFF = 0.5  # the largest distance of a closed pose from its prediction, relative to the step
ABREAST = 1000  # times that are computed at once
JUMP = 0.25  # of a step, relative to its time and the speed: what the mean of both velocities leaves

Report = Callable[[int, int], None]  # takes the number of finished times, and of all


class FreeError(MbsError):
    """A motion that the given joints do not determine."""

    remedy = "give the motion of more joints"


@dataclass(frozen=True, eq=False)
class Forces:
    """A motion at K times, with the forces that it takes."""

    t: Array  # (K,)
    q: Array  # (K, nq)
    qd: Array  # (K, n)
    qdd: Array  # (K, n)
    u: Array  # (K, m): of actuated joints
    tau: Array  # (K, d): of driven joints
    multipliers: Array  # (K, e)
    rest: Array  # (K, n): generalised forces that u, tau and multipliers cannot provide
    spare: int  # entries of u and tau beyond the freedoms: they have the least norm
    w: Array  # (K, nw): components of open wrenches, and other numbers that forces read

    def find_jump(self, manifest: Manifest) -> tuple[float, str] | None:
        """Return the first time, and the joint, at which places jump away from their velocities; None: nowhere."""
        for i, joint in enumerate(manifest.coordinates):
            if joint.name not in manifest.positions or len(self.t) < LEAST:
                continue
            q, qd, h = self.q[:, manifest.positions.index(joint.name)], self.qd[:, i], np.diff(self.t)
            left = np.abs(np.diff(q) - h * (qd[:-1] + qd[1:]) / 2)
            fast = h * np.maximum(np.abs(qd[:-1]), np.abs(qd[1:]))
            jumps = np.flatnonzero(left > np.maximum(JUMP * fast, ROUNDED))
            if jumps.size:
                return float(self.t[jumps[0] + 1]), joint.name
        return None

    @property
    def unbalanced(self) -> Array:
        """Return the largest generalised force that is missing, (K,)."""
        return np.asarray(np.abs(self.rest).max(axis=1))


def invert(kernels: Kernels, joints: Sequence[int], course: Course, times: Array) -> Forces:
    """Compute the forces for the motion `course` of some joints, by their entries of qd, at increasing times.

    The first pose is reached from the manifest's. Raises OpenError where loops cannot be closed, and FreeError where
    the joints do not determine the others; both with the time and the joints.
    """
    manifest = kernels.manifest
    check_kernels(kernels)
    places = [manifest.positions.index(manifest.coordinates[i].name) for i in joints]
    pose = np.array(manifest.pose) if manifest.pose else neutral(manifest)
    states: list[tuple[Array, Array, Array]] = []
    for k, (y, yd, ydd) in enumerate(zip(*course.states(times), strict=True)):
        ahead = _predict(times[: k + 1], [q for q, _, _ in states[-PREDICTING:]], kernels)
        try:
            states.append(_follow(kernels, joints, places, pose, ahead, y, yd, ydd))
        except OpenError as error:
            finding = f"{error.finding} at {_describe(manifest, joints, times[k], y)}"
            raise OpenError(error.loop, finding, error.remedy) from None
        except FreeError as error:
            if not states:
                raise
            finding = f"at {_describe(manifest, joints, times[k], y)}, ways to go on meet, as at a change point"
            raise FreeError(f"{finding}; take an --output-step whose rows pass it by, or {error.remedy}") from None
        pose = states[-1][0]
    q, qd, qdd = (np.array(x) for x in zip(*states, strict=True))
    if unknown := [name for name in manifest.signals if name != TIME]:
        raise ArgumentError(f"forces of {manifest.model} read {', '.join(unknown)}, which the motion does not give")
    w = np.zeros((len(times), manifest.open_entries))
    if manifest.reads_time:
        w[:, -1] = times
    return balance(kernels, times, q, qd, qdd, w)


def _predict(times: Array, poses: Sequence[Array], kernels: Kernels) -> Array | None:
    """Return the pose at the last of some times, extrapolated from the poses before; None where there are too few."""
    if len(poses) < 2:
        return None
    before, t = times[-1 - len(poses) : -1], times[-1]
    weights = [np.prod([(t - other) / (own - other) for other in before if other != own]) for own in before]
    return normalise(np.tensordot(weights, np.array(poses), axes=1), kernels.manifest)


def _describe(manifest: Manifest, joints: Sequence[int], time: float, y: Array) -> str:
    """Describe a time with the places of the given joints."""
    given = [f"{manifest.coordinates[i].name} = {value:.6g}" for i, value in zip(joints, y.tolist(), strict=True)]
    return ", ".join([f"t = {time:.6g} s", *given])


def check_kernels(kernels: Kernels) -> None:
    """Raise ArgumentError for kernels that were generated without those needed here."""
    manifest = kernels.manifest
    missing = {"impl", *(("loops", "loop_rates", "loop_jacobian") if manifest.loops else ())}
    missing -= {kernel.name for kernel in manifest.kernels}
    if missing:
        raise ArgumentError(f"{manifest.model} was generated without {', '.join(sorted(missing))}")


def balance(
    kernels: Kernels,
    times: Array,
    q: Array,
    qd: Array,
    qdd: Array,
    w: Array,
    report: Report | None = None,
    *,
    taken: Array | None = None,
) -> Forces:
    """Compute the forces for a motion of all joints, (K, ...), that keeps the loops closed, under open wrenches w.

    Generalised forces `taken` (K, n) are part of the model, and are taken out of it.
    """
    manifest = kernels.manifest
    dynamics = Dynamics(kernels, Formulation.IMPL, stand(np.zeros(len(manifest.driven))))
    others = np.zeros_like(qd) if taken is None else taken
    parts = []
    for first in range(0, len(q), ABREAST):
        some = slice(first, first + ABREAST)
        parts.append(_balance_some(dynamics, q[some], qd[some], qdd[some], w[some], others[some]))
        if report is not None:
            report(min(first + ABREAST, len(q)), len(q))
    u, tau, lam, rest, spare = (np.concatenate(x) for x in zip(*parts, strict=True))
    return Forces(times, q, qd, qdd, u, tau, lam, rest, int(spare.max()), w)


def _follow(
    kernels: Kernels,
    joints: Sequence[int],
    places: Sequence[int],
    pose: Array,
    ahead: Array | None,
    y: Array,
    yd: Array,
    ydd: Array,
) -> tuple[Array, Array, Array]:
    """Return q, qd and qdd of all joints, from the pose before, or near the one that is expected."""
    manifest = kernels.manifest
    n = len(manifest.coordinates)
    free = [i for i in range(n) if i not in joints]
    qd, qdd = np.zeros(n), np.zeros(n)
    qd[list(joints)], qdd[list(joints)] = yd, ydd
    J = np.zeros((0, n))
    if manifest.loops:
        closure = Closure(kernels)
        near = None if ahead is None else _close_near(closure, ahead, pose, places, y)
        pose = closure.move(pose, places, y) if near is None else near
        qd = complete_velocities(closure, pose, qd, joints)
        qdd = closure.complete_accelerations(pose, qd, joints, ydd)
        J = closure.jacobian(pose)
    else:
        pose = pose.copy()
        pose[list(places)] = y
    left = len(free) - np.linalg.matrix_rank(J[:, free], rtol=RANK) if free else 0
    if left:
        names = ", ".join(manifest.coordinates[i].name for i in joints)
        count = "1 freedom is" if left == 1 else f"{left} freedoms are"
        raise FreeError(f"{count} left when {names or 'nothing'} moves; {FreeError.remedy}")
    return pose, qd, qdd


def _close_near(closure: Closure, ahead: Array, before: Array, places: Sequence[int], y: Array) -> Array | None:
    """Return the closed pose near an expected one; None where there is none."""
    expected = ahead.copy()
    expected[list(places)] = y
    step = float(np.abs(expected - before).max())
    found = closure.close(expected, places, FARTHEST * (1 + np.abs(expected).max()))
    return found if closure.is_closed(found) and np.abs(found - expected).max() <= OFF * step else None


def _balance_some(
    dynamics: Dynamics, q: Array, qd: Array, qdd: Array, w: Array, taken: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Return u, tau, lam, the generalised forces that are missing, and how many forces are spare, of some times."""
    manifest, forces, (K, n) = dynamics.kernels.manifest, dynamics.forces_count, qd.shape
    v, lam = np.hstack((np.zeros((K, forces)), w)), np.zeros((K, len(manifest.owners)))
    Phi = dynamics.residual(q, qd, qdd, v, lam) + taken
    seen = slice(None if manifest.loops else 1)  # a force acts on its own coordinate: in a tree, alike at all times
    state = q[seen], qd[seen], qdd[seen], v[seen], lam[seen]
    S = -dynamics.input_slopes(*state)[:, :, :forces] if forces else np.zeros((len(state[0]), n, 0))
    D = np.broadcast_to(np.eye(n)[:, list(manifest.driven)], (len(S), n, len(manifest.driven)))
    sides = np.concatenate((S, D), axis=2)
    if manifest.loops:
        jacobians = Closure(dynamics.kernels).jacobian(q)
        rows = [_balance_closed(dynamics.kernels, *x) for x in zip(q, Phi, sides, jacobians, strict=True)]
        found, multipliers, unbalanced, spare = (np.array(x) for x in zip(*rows, strict=True))
    else:
        solved, _, rank, _ = np.linalg.lstsq(sides[0], Phi.T, rcond=RANK)
        found, multipliers, unbalanced = solved.T, np.zeros((K, 0)), Phi - solved.T @ sides[0].T
        spare = np.full(K, sides.shape[2] - int(rank))
    return found[:, :forces], found[:, forces:], multipliers, unbalanced, spare


def _balance_closed(kernels: Kernels, q: Array, Phi: Array, sides: Array, J: Array) -> tuple[Array, Array, Array, int]:
    """Return u and tau, lam, what is missing, and how many forces are spare, at one time."""
    Z = null_space(J, rcond=RANK)
    solved, _, rank, _ = np.linalg.lstsq(Z.T @ sides, Z.T @ Phi, rcond=RANK)
    found = np.asarray(solved, dtype=float)
    rest = Phi - sides @ found
    unbalanced = Z @ (Z.T @ rest)
    return found, Closure(kernels).balance(q, rest - unbalanced), unbalanced, sides.shape[1] - int(rank)


def measure(forces: Forces, kernels: Kernels) -> Numbers:
    """Return the numbers of a motion with its forces by name."""
    parts = {"t": forces.t[:, None], "q": forces.q, "qd": forces.qd, "qdd": forces.qdd, "u": forces.u}
    parts |= {"tau": forces.tau, "lam": forces.multipliers, "w": forces.w}
    return Numbers(kernels, list_quantities(kernels.manifest, Added()), parts)


def tabulate(forces: Forces, kernels: Kernels) -> tuple[list[str], Array]:
    """Return the names of columns with units, and the numbers, a row for each time."""
    manifest = kernels.manifest
    header = ["t [s]", *label_motion(manifest, rates=2)]
    header += label_forces(manifest, "u", manifest.actuated) + label_forces(manifest, "tau", manifest.driven)
    header += [*label_multipliers(manifest), "unbalanced"]
    columns = [forces.t[:, None], forces.q, forces.qd, forces.qdd, forces.u, forces.tau, forces.multipliers]
    return header, np.concatenate((*columns, forces.unbalanced[:, None]), axis=1)
