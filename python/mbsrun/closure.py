"""Closed loops outside the kernels: poses, velocities and accelerations that keep them closed.

    h(q) = 0,    J qd = 0,    J qdd + gamma = 0,    q' = E(q) qd

with h from the kernel `loops`, and J and gamma = Jd qd from `loop_jacobian`. Some entries g are given, the others f are
free. Newton's method finds a pose near another one; velocities and accelerations x, with gamma or 0 for b, are linear:

    dq_f = -((J E^+)_f)^+ h,    x_f = -J_f^+ (J_g x_g + b)

The pseudo-inverses take the change of least norm, and none along directions in which J has lost its rank. So poses are
found where the kernels `close`, `close_rates`, `close_accelerations` and `project` fail. E is 1 without quaternions;
closed poses have quaternions of length 1.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import MbsError
from mbsgen.manifest import Manifest
from mbsgen.roles import Role
from mbsrun.kernel import Kernels
from mbsrun.ocp.ground.plant import Plant
from mbsrun.quaternions import list_entries, list_quaternions, normalise

Array = NDArray[np.float64]

GAP = "gap"  # the name of h among the kernels' results
CLOSED = 1e-10  # the largest gap of closed loops [m, 1]
ITERATIONS = 50  # of Newton's method
LONGEST = 0.5  # step of Newton's method [rad, m]
SETTLED = 1e-14  # a step below which Newton's method ends, relative to 1 + |q|
FARTHEST = 0.5  # how far Newton's method goes along a continuation, relative to 1 + |q|
SHORTEST = 1e-3  # step of a continuation, relative to the whole way
STRIDE = 1.0  # the longest step of a continuation [rad, m]
SPREAD = 0.2  # step of continuations side by side [rad, m]
PARTS = 10  # steps of a continuation over parameters
RANK = 1e-8  # of singular values, relative to the first: a double root is found to the root of the rounding
INDEPENDENT = 1e-6  # the least part of a unit vector that other conditions leave undetermined
REGULAR = 1e-3  # the least singular value of the block of dependent coordinates, relative to the largest of J


class OpenError(MbsError):
    """A loop that cannot be closed from the given entries."""

    def __init__(self, loop: str, finding: str, remedy: str) -> None:
        self.loop, self.finding, self.remedy = loop, finding, remedy
        super().__init__(f"loop {loop}: {finding}; {remedy}")


@dataclass(frozen=True)
class Gap:
    """The loop that is open by the most, or that opens the fastest."""

    name: str
    size: float  # [m, 1], per second for rates

    def __str__(self) -> str:
        return f"the loop {self.name} stays open by {self.size:.3g}"


class Closure:
    """The loops of a mechanism; arrays are of shape (..., n) unless they say otherwise.

    `held` and `given` are entries of q for poses, and entries of qd for velocities and accelerations. A mechanism
    without loops has m = 0 equations, and everything keeps it closed.
    """

    def __init__(self, plant: Plant | Kernels) -> None:
        """Take the kernels of a mechanism."""
        self.plant, self.manifest = plant, plant.manifest
        self.independent, self.dependent = list(self.manifest.independent), list(self.manifest.dependent)
        self.places, self.size = len(self.manifest.positions), len(self.manifest.coordinates)
        self.count = len(self.manifest.owners)  # m
        self.places_independent = list_entries(self.manifest, self.independent)

    # --- the equations ---

    def gaps(self, q: Array) -> Array:
        """Return h, (..., m)."""
        return self._evaluate("loops", GAP, (self.count,), q=q)

    def rates(self, q: Array, qd: Array) -> Array:
        """Return J qd, (..., m)."""
        return self._evaluate("loop_rates", "hd", (self.count,), q=q, qd=qd)

    def jacobian(self, q: Array) -> Array:
        """Return J, (..., m, n)."""
        rest = np.zeros((*q.shape[:-1], self.size))
        return self._evaluate("loop_jacobian", "J", (self.count, self.size), q=q, qd=rest)

    def measure_strength(self, q: Array) -> float:
        """Return the least singular value of J at a pose, (nq,), relative to the largest.

        Places and directions of a loop have different units: the longest row of each has the length 1.
        """
        if not self.count:
            return 1.0
        J = self.jacobian(q[None])[0]
        rows = np.linalg.norm(J, axis=1)
        groups = [(x.name, name.startswith("turn")) for x in self.manifest.loops for name in x.equations]
        longest = {group: max(rows[[other == group for other in groups]]) or 1.0 for group in groups}
        values = np.linalg.svd(J / np.array([[longest[group]] for group in groups]), compute_uv=False)
        return float(values[-1] / values[0])

    def bias(self, q: Array, qd: Array) -> Array:
        """Return gamma, (..., m)."""
        return self._evaluate("loop_jacobian", "gamma", (self.count,), q=q, qd=qd)

    def _evaluate(self, name: str, result: str, shape: tuple[int, ...], **state: Array) -> Array:
        """Return a kernel's result for states of any leading shape."""
        leading = state["q"].shape[:-1]
        if not self.count:
            return np.zeros((*leading, *shape))
        states = (-1,) if math.prod(leading) != 1 else ()  # one state has a shorter way into C
        flat: dict[str, Any] = {key: x.reshape(*states, x.shape[-1]) for key, x in state.items()}
        return self.plant(name, **flat)[result].reshape(*leading, *shape)

    def slopes(self, q: Array) -> Array:
        """Return J E^+, the derivatives of h by q for changes that E admits, (B, m, nq)."""
        J = self.jacobian(q)
        if not self.manifest.configuration:
            return J
        units = np.tile(np.eye(self.size), (len(q), 1))  # E is linear in velocities: its columns are rates of unit ones
        columns = self.plant("rates", q=np.repeat(q, self.size, axis=0), qd=units)["rate"]
        E = columns.reshape(len(q), self.size, self.places).swapaxes(1, 2)
        return np.asarray(J @ np.linalg.pinv(E))

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """The differentiated parameters that h reads, such as lengths; masses and springs are none of them."""
        if not (self.count and self.manifest.design):
            return ()
        kernel = self.plant.describe("jac_loops")
        theta = kernel.taking(Role.DESIGN)
        slopes = next((a for a in kernel.outputs if theta is not None and a.by == theta.name), None)
        if slopes is None:
            return ()
        ends = range(0, slopes.nnz + 1, slopes.rows) if slopes.colind is None else slopes.colind
        is_read = np.diff(ends) > 0
        return tuple(p.name for p, read in zip(self.manifest.design, is_read, strict=True) if read)

    # --- how far loops are open ---

    def measure(self, q: Array) -> float:
        """Return the largest gap of some poses."""
        return float(np.abs(self.gaps(q)).max(initial=0.0))

    def measure_rates(self, q: Array, qd: Array) -> float:
        """Return the largest rate at which loops open in some states."""
        return float(np.abs(self.rates(q, qd)).max(initial=0.0))

    def is_closed(self, q: Array) -> bool:
        """Return whether the loops of some poses are closed."""
        return self.measure(q) <= CLOSED

    def find_gap(self, q: Array) -> Gap:
        """Find the loop that is open by the most in one pose (nq,)."""
        return self.find_worst(self.gaps(q))

    def find_worst(self, gaps: Array) -> Gap:
        """Find the loop of the largest one of some gaps, or rates, (m,)."""
        k = int(np.abs(gaps).argmax())
        return Gap(self.manifest.loops[self.manifest.owners[k]].name, float(abs(gaps[k])))

    # --- poses ---

    def close(self, q: Array, held: Collection[int] = (), farthest: float = np.inf) -> Array:
        """Close the loops near poses (..., nq), with some coordinates held; return the last iterates.

        A pose that goes farther than `farthest` from its start is given up.
        """
        q = np.array(q, dtype=np.float64, order="C")
        poses, free = q.reshape(-1, self.places), self._list_free(self.places, held)
        start, active = poses.copy(), np.arange(len(poses) if free.size and self.count else 0)
        for _ in range(ITERATIONS):
            gaps, slopes = self.gaps(poses[active]), self.slopes(poses[active])[..., free]
            finite = np.isfinite(gaps).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2))
            active, gaps, slopes = active[finite], gaps[finite], slopes[finite]
            if not active.size:
                break
            step = -_solve(slopes, gaps)
            length = np.abs(step).max(axis=1)
            poses[active[:, None], free] += step * np.minimum(1.0, LONGEST / np.maximum(length, SETTLED))[:, None]
            way = np.abs(poses[active] - start[active]).max(axis=1)
            goes_on = (length > SETTLED * (1 + np.abs(poses[active]).max(axis=1))) & (way <= farthest)
            active = active[goes_on]
            if not active.size:
                break
        return normalise(q, self.manifest)

    def move(self, pose: Array, given: Sequence[int], values: Array) -> Array:
        """Return a closed pose (nq,) with given entries at some values, reached from the pose `pose`.

        The given entries move there step by step, and the others follow in the same assembly. Raises OpenError where
        the loops cannot be closed on the way.
        """
        q, start, way, length = pose.copy(), pose[list(given)], 0.0, 1.0
        longest = STRIDE / max(STRIDE, float(np.abs(values - start).max(initial=0.0)))
        while way < 1:
            length = min(length, longest, 1 - way)
            trial = q.copy()
            trial[list(given)] = start + (way + length) * (values - start)
            found = self.close(trial, given, FARTHEST * (1 + np.abs(trial).max()))
            if self.is_closed(found):
                q, way, length = found, way + length, 2 * length
                continue
            length /= 2
            if length < SHORTEST:
                raise self.tell_open(found)
        return q

    def spread(self, pose: Array, given: Sequence[int], values: Array) -> Array:
        """Return closed poses (K, nq), each with given entries on the way from a pose (nq,) to values (K, g).

        They go step by step, and as far as the loops close by the same branch, away from singular poses.
        """
        q, far = np.tile(pose, (len(values), 1)), np.abs(values - pose[list(given)]).max(initial=0.0)
        count = max(1, math.ceil(far / SPREAD))
        sign, active = self._find_branch(pose[None])[0], np.arange(len(values))
        for k in range(1, count + 1):
            trial = q[active]
            trial[:, list(given)] = pose[list(given)] + k / count * (values[active] - pose[list(given)])
            found = self.close(trial, given)
            is_good = np.abs(self.gaps(found)).max(axis=1, initial=0.0) <= CLOSED
            is_good &= np.abs(found - q[active]).max(axis=1) <= LONGEST
            is_good &= self._find_branch(found) == sign
            active, found = active[is_good], found[is_good]
            if not active.size:
                break
            q[active] = found
        return q

    def tell_open(self, q: Array) -> OpenError:
        """Return the error of a pose (nq,) whose loops stay open."""
        gap = self.find_gap(q)
        return OpenError(gap.name, f"it stays open by {gap.size:.3g}", "give other coordinates, or fewer of them")

    def follow(self, path: Array, start: Array, held: Sequence[int]) -> Array | None:
        """Close a path (K, n) point by point, from a closed pose on.

        Held coordinates keep their values of the path, and the others go on from the point before; where none is held,
        each pose goes to the nearest closed one. Return None where loops do not close, or coordinates jump.
        """
        others, closed, last = self._list_free(self.places, held), np.empty_like(path), start
        for k, pose in enumerate(path):
            near = pose.copy()
            if held:
                near[others] = last[others]
            found = self.close(near, held)
            if not self.is_closed(found) or np.abs((found - last)[others]).max(initial=0.0) > LONGEST:
                return None
            closed[k] = last = found
        return closed

    @staticmethod
    def _list_free(size: int, held: Collection[int]) -> NDArray[np.int64]:
        return np.array([i for i in range(size) if i not in held], dtype=np.int64)

    # --- velocities and accelerations ---

    def complete_velocities(self, q: Array, given: Sequence[int], values: Array) -> Array:
        """Return velocities with given entries at some values (..., g); the others follow, with the least norm."""
        return self._complete(q, given, values, np.zeros((*q.shape[:-1], self.count)))

    def complete_accelerations(self, q: Array, qd: Array, given: Sequence[int], values: Array) -> Array:
        """Return accelerations with given entries at some values (..., g); the others follow, with the least norm."""
        return self._complete(q, given, values, self.bias(q, qd))

    def _complete(self, q: Array, given: Sequence[int], values: Array, bias: Array) -> Array:
        x = np.zeros((*q.shape[:-1], self.size))
        x[..., list(given)] = values
        return self._correct(q, x, bias, given)

    def _correct(self, q: Array, x: Array, bias: Array, held: Collection[int] = ()) -> Array:
        """Solve J x + bias = 0 for the nearest x with some entries held."""
        J, free, x = self.jacobian(q), self._list_free(self.size, held), x.copy()
        for _ in range(2 if free.size else 0):  # the second time for rounding
            x[..., free] -= _solve(J[..., free], (J @ x[..., None])[..., 0] + bias)
        return x

    def project(self, q: Array, qd: Array, held: Sequence[int] = ()) -> tuple[Array, Array]:
        """Return the nearest states that keep the loops closed, for states that nearly do; joints of `held` stay."""
        closed = self.close(q, list_entries(self.manifest, held))
        return closed, self.project_velocities(closed, qd, held)

    def project_velocities(self, q: Array, qd: Array, held: Collection[int] = ()) -> Array:
        """Return the nearest velocities that keep the loops closed, with some entries held."""
        return self._correct(q, qd, np.zeros((*q.shape[:-1], self.count)), held)

    def project_accelerations(self, q: Array, qd: Array, qdd: Array, held: Collection[int] = ()) -> Array:
        """Return the nearest accelerations that keep the loops closed, with some entries held."""
        return self._correct(q, qdd, self.bias(q, qd), held)

    def balance(self, q: Array, forces: Array) -> Array:
        """Return the multipliers (..., m) of joint forces that loops have to bear: J^T lam = forces."""
        return _solve(self.jacobian(q).swapaxes(-1, -2), forces)

    # --- independent coordinates ---

    def is_regular(self, q: Array) -> bool:
        """Return whether the independent coordinates determine the others along a path (K, n), by one branch."""
        branches = self._find_branch(q)
        return bool(branches[0] and (branches == branches[0]).all())

    def jumps(self, q: Array) -> bool:
        """Return whether a path (K, n) has poses on both sides of those where the dependent block is singular."""
        branches = self._find_branch(q)
        return bool((branches > 0).any() and (branches < 0).any())

    def _find_branch(self, q: Array) -> Array:
        """Return the sign of the determinant of J's dependent columns for poses (K, n); 0 near singular poses."""
        J = self.jacobian(q)
        J = np.where(np.isfinite(J).all(axis=(1, 2), keepdims=True), J, 0.0)
        block = J[:, :, self.dependent]
        least, most = (np.linalg.svd(x, compute_uv=False) for x in (block, J))
        is_regular = (least[:, -1] > 0) & (least[:, -1] >= REGULAR * most[:, 0])
        return np.where(is_regular, np.sign(np.linalg.det(block)), 0.0)

    def choose(self, q: Array, candidates: Sequence[int]) -> list[int]:
        """Choose the first entries of qd that can have any value in a pose (nq,), whatever the chosen before have."""
        return [i for (i,) in _choose(self.jacobian(q), [([i], 1) for i in candidates])]

    def list_held(self, q: Array, given: Sequence[int]) -> list[int]:
        """List the entries of qd that stay where some are given, in a pose (nq,): these, and independent ones left."""
        return sorted({*given, *self.choose(q, [*given, *self.independent])})

    def list_held_places(self, q: Array, given: Sequence[int]) -> list[int]:
        """List the entries of q that stay likewise."""
        return sorted({*given, *self.choose_places(q, [*given, *self.places_independent])})

    def choose_places(self, q: Array, candidates: Sequence[int]) -> list[int]:
        """Choose the first entries of q likewise; the four of a quaternion are chosen whole, or none of them is."""
        turns = {x.first: x.entries for x in list_quaternions(self.manifest)}
        own = {i for entries in turns.values() for i in entries}
        groups = [(turns[i], 3) if i in turns else ([i], 1) for i in candidates if i in turns or i not in own]
        lengths = np.zeros((len(turns), self.places))
        for row, entries in zip(lengths, turns.values(), strict=True):
            row[entries] = q[entries]
        return [i for chosen in _choose(np.concatenate((self.slopes(q[None])[0], lengths)), groups) for i in chosen]


def _choose(rows: Array, groups: Sequence[tuple[list[int], int]]) -> Iterator[list[int]]:
    """Choose the first groups of entries that conditions leave free by a number of directions, and hold these then."""
    basis = np.linalg.svd(rows, full_matrices=False)[2]
    for entries, freedoms in groups:
        left = np.eye(rows.shape[1])[entries]
        for _ in range(2):  # twice is enough: the second time removes the rounding of the first
            left = left - (left @ basis.T) @ basis
        lengths, directions = np.linalg.svd(left, full_matrices=False)[1:]
        if lengths[freedoms - 1] > INDEPENDENT:
            basis = np.concatenate((basis, directions[:freedoms]))
            yield entries


def _solve(A: Array, b: Array) -> Array:
    """Return the x of least norm that solves A x = b in the least squares, for a batch of both."""
    return np.asarray((np.linalg.pinv(A, rcond=RANK) @ b[..., None])[..., 0])


def carry_pose(plant: Plant, pose: Array, values: Mapping[str, float], held: Sequence[int]) -> Array | None:
    """Return the closed pose (nq,) that another one becomes as parameters of the plant go to other values.

    They go there step by step; held coordinates stay, and the others follow in the same assembly. Return None where
    loops open on the way, or coordinates jump.
    """
    q, before = pose, {name: plant.parameters[name] for name in values}
    for part in np.linspace(0, 1, PARTS + 1)[1:].tolist():
        between = {name: (1 - part) * before[name] + part * value for name, value in values.items()}
        closure = Closure(plant.with_parameters(**between))
        found = closure.close(q, held)
        if not closure.is_closed(found) or np.abs(found - q).max(initial=0.0) > LONGEST:
            return None
        q = found
    return q


def find_closure(plant: Plant) -> Closure | None:
    """Return the loops of a mechanism; None where it has none."""
    return Closure(plant) if has_loops(plant.manifest) else None


def has_loops(manifest: Manifest) -> bool:
    """Return whether a mechanism has closed loops or constraints."""
    return bool(manifest.dependent)
