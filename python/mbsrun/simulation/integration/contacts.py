"""Rigid contacts of points with dry friction, at given states: forces, accelerations, impacts, and their conditions.

A point k at a distance g from the other side, with normal n and relative velocity S qd, carries a force R = N n + T:

    g > 0, N = 0    or    g = 0, N >= 0;    |T| <= mu N, and T = -mu N v/|v| while it slips with the velocity v

A mode says of each point whether it is open, sticks or slips. Then the accelerations follow from linear equations, with
rows J, the directions G of their forces, and beta = Jd qd,

    M qdd = f + G lam,    J qdd + beta = 0,    J M^-1 G lam = -(J M^-1 f + beta).

Where points can share their load in many ways, they share it in proportion to their normal forces. With friction, the
conditions of no mode may hold, or of several: Painleve's paradox, which is said. Impacts obey the same conditions, of
impulses and of velocities after them, with w+ = -e w- along the normal (Newton). Or they consist of compression, an
impact with e = 0, and expansion: there the impulses along the normals are e times as large as before, or more where a
point would enter the other side (Poisson). Friction obeys Coulomb in both.

Pfeiffer, Glocker, "Multibody dynamics with unilateral contacts" (1996), chapters 5 to 8; Genot, Brogliato, "New results
on Painleve paradoxes", European Journal of Mechanics A 18 (1999).
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import MbsError
from mbsrun.simulation.dynamics import Dynamics

Array = NDArray[np.float64]

RANK = 1e-10  # of the singular values of J M^-1 G: smaller ones are 0
NEAR = 1e-9  # of the size of a condition's terms: what is as near to 0 may be either
TURNS = 60  # of the direction in which a point starts to slip
FIXED = 1e-13  # a change of the direction that ends them
MOST = 729  # modes that are tried, to see whether there are several


class State(IntEnum):
    """The state of a point of contact."""

    OPEN = 0
    STICK = 1
    SLIP = 2


class ParadoxError(MbsError):
    """Contacts that allow no motion, or several."""


@dataclass(frozen=True, eq=False)
class Mode:
    """The states of P points, and the directions in which slipping ones began to slip."""

    states: tuple[State, ...]
    ways: Array  # (P, 3)
    shares: Array  # (P,): forces in proportion to which points share their load
    is_locked: bool = False  # no joint can move
    leaving: tuple[int, ...] = ()  # points that have their given impulses alone, and may leave

    @property
    def closed(self) -> list[int]:
        """List the points that touch."""
        return [k for k, state in enumerate(self.states) if state != State.OPEN]


@dataclass(frozen=True, eq=False)
class Touch:
    """Points of contact in K states."""

    gap: Array  # (K, P)
    normal: Array  # (K, P, 3)
    slide: Array  # (K, P, 3, n)
    velocity: Array  # (K, P, 3)
    pull: Array  # (K, P): the change of the normal velocity without accelerations,
    drift: Array  # (K, P, 3): and of the velocity
    reach: Array  # (K, P): the sum of the sizes of a velocity's terms, of which it has its rounding

    @property
    def speed(self) -> Array:
        """Return the velocities away from the other sides, (K, P)."""
        return np.asarray((self.normal * self.velocity).sum(axis=2))

    @property
    def slip(self) -> Array:
        """Return the velocities along the other sides, (K, P, 3)."""
        return np.asarray(self.velocity - self.speed[..., None] * self.normal)


@dataclass(frozen=True, eq=False)
class Loads:
    """Accelerations and forces in K states; of impacts, velocities and impulses."""

    qdd: Array  # (K, n)
    normal: Array  # (K, P)
    friction: Array  # (K, P, 3)
    miss: Array  # (K,): the largest relative error of the equations


class Contacts:
    """The rigid contacts of a model."""

    def __init__(self, dynamics: Dynamics) -> None:
        """Take the equations of motion, in a formulation with a mass matrix."""
        self.dynamics, points = dynamics, dynamics.kernels.manifest.rigid
        self.names = [point.name for point in points]
        self.stops = [point.stop if point.is_stop else "" for point in points]
        self.restitution = np.array([point.restitution for point in points])
        self.coefficient = np.array([point.coefficient for point in points])
        self.hold = np.array([point.hold for point in points])  # the pulls that latches bear
        self.couples = np.array([point.is_coupling for point in points], dtype=np.bool_)
        self.places = np.zeros(len(points))  # where couplings hold their numbers

    def touch(self, q: Array, qd: Array) -> Touch:
        """Describe the points in states (K, nq), (K, n)."""
        gap, normal, slide = self.locate(q)
        velocity = np.einsum("kpin,kn->kpi", slide, qd)
        rates, slopes = self.dynamics.rates(q, qd), self.dynamics.kernels("jac_touching", q=q)
        K, points, _, n = slide.shape
        by_q = slopes["jac_slide_q"].reshape(K, n, points, 3, q.shape[1])  # column by column
        turn = np.einsum("kpiq,kq->kpi", slopes["jac_direction_q"].reshape(K, points, 3, q.shape[1]), rates)
        drift = np.einsum("knpi,kn->kpi", (by_q @ rates[:, None, None, :, None])[..., 0], qd)
        pull = (turn * velocity).sum(axis=2) + (normal * drift).sum(axis=2)
        reach = np.einsum("kpin,kn->kpi", np.abs(slide), np.abs(qd)).max(axis=2)
        return Touch(gap, normal, slide, velocity, pull, drift, reach)

    def locate(self, q: Array) -> tuple[Array, Array, Array]:
        """Return gaps (K, P), normals (K, P, 3) and Jacobians (K, P, 3, n) at poses."""
        distance, normal, slide = self._place(q)
        return distance - self.places, normal, slide

    def measure(self, q: Array) -> Array:
        """Return the distances at one pose, of couplings the numbers themselves, (P,)."""
        return np.asarray(self._place(q[None])[0][0])

    def _place(self, q: Array) -> tuple[Array, Array, Array]:
        """Return distances, normals and Jacobians."""
        found = self.dynamics.kernels("touching", q=q)
        points, n = len(self.names), self.dynamics.size
        normal = found["direction"].transpose(0, 2, 1)
        return found["clearance"].reshape(-1, points), normal, found["slide"].reshape(-1, points, 3, n)

    def find_free(self, q: Array, qd: Array, v: Array) -> tuple[Array, Array]:
        """Return the mass matrix (K, n, n), and accelerations without contacts (K, n)."""
        M = self.dynamics.mass_matrix(q, qd, v)
        return M, -self.dynamics.solve(M, self.dynamics.residual(q, qd, np.zeros_like(qd), v))

    def load(
        self,
        touch: Touch,
        M: Array,
        free: Array,
        mode: Mode,
        goal: Array | None = None,
        given: Array | None = None,
    ) -> Loads:
        """Return accelerations and forces in a mode; with `goal` (K, P), velocities of an impact along the normals.

        `free` (K, n) are the accelerations without contacts, or the velocities before the impact; `given` (P,) are the
        impulses along the normals of points that leave.
        """
        closed, is_impact = mode.closed, goal is not None
        K, points = touch.gap.shape
        normal, friction = np.zeros((K, points)), np.zeros((K, points, 3))
        if not closed:
            return Loads(free, normal, friction, np.zeros(K))
        rows, ends, weights = list[Array](), list[Array](), list[float]()
        units = list[tuple[int, Array]]()  # of each row, the point, and the force on it of 1 (K, 3)
        for k in closed:
            n, S, share = touch.normal[:, k], touch.slide[:, k], float(np.sqrt(mode.shares[k]))
            is_stuck = mode.states[k] == State.STICK
            unit = n if is_stuck else n - self.coefficient[k] * find_way(touch, mode, k)
            if given is not None and k in mode.leaving:
                free = free + given[k] * np.linalg.solve(M, np.einsum("ki,kin->kn", unit, S)[..., None])[..., 0]
                normal[:, k] += given[k]
                friction[:, k] += given[k] * (unit - n)
            else:
                units.append((k, unit))
                rows.append(np.einsum("ki,kin->kn", n, S))
                ends.append(touch.pull[:, k] if goal is None else -goal[:, k])
                weights.append(1.0)
            if is_stuck and self.coefficient[k] > 0:
                for t in span(n):
                    units.append((k, t))
                    rows.append(np.einsum("ki,kin->kn", t, S))
                    ends.append(np.zeros(K) if is_impact else (t * touch.drift[:, k]).sum(axis=1))
                    weights.append(share)
        if not rows:
            return Loads(free, normal, friction, np.zeros(K))
        columns = [np.einsum("ki,kin->kn", unit, touch.slide[:, k]) for k, unit in units]
        J, G, b, D = np.stack(rows, 1), np.stack(columns, 2), np.stack(ends, 1), np.array(weights)
        response = np.linalg.solve(M, G)
        system = J @ response
        right = -(np.einsum("kan,kn->ka", J, free) + b)
        lam = D * np.einsum("kab,kb->ka", np.linalg.pinv(system * D, rcond=RANK), right)
        terms = np.abs(right).max(axis=1) + (np.abs(system) @ np.abs(lam)[..., None])[..., 0].max(axis=1)
        miss = np.abs((system @ lam[..., None])[..., 0] - right).max(axis=1) / np.maximum(terms, 1e-300)
        for row, (k, unit) in enumerate(units):
            force = lam[:, row, None] * unit
            along = (force * touch.normal[:, k]).sum(axis=1)
            normal[:, k] += along
            friction[:, k] += force - along[:, None] * touch.normal[:, k]
        return Loads(free + np.einsum("kna,ka->kn", response, lam), normal, friction, miss)


def find_way(touch: Touch, mode: Mode, k: int) -> Array:
    """Return the directions in which a point slips, (K, 3): smooth where it comes to rest on a straight way."""
    slip, way = touch.slip[:, k], mode.ways[k]
    size = np.linalg.norm(slip, axis=1, keepdims=True)
    sign = np.where((slip @ way)[:, None] < 0, -1.0, 1.0)
    is_known = size > 1e-12 * (1 + np.abs(touch.velocity[:, k]).max(axis=1, keepdims=True))
    return np.asarray(np.where(is_known, sign * slip / np.maximum(size, 1e-300), way))


def span(n: Array) -> tuple[Array, Array]:
    """Return two directions across normals (K, 3)."""
    axis = np.eye(3)[np.abs(n).argmin(axis=1)]
    first = np.cross(n, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(n, first)


class Search:
    """The search for modes whose conditions hold, at one state: of forces and accelerations, or of an impact."""

    def __init__(
        self,
        contacts: Contacts,
        touch: Touch,
        inertia: tuple[Array, Array],
        near: Sequence[int],
        slipping: Sequence[int],
        released: Collection[int] = (),
        goal: Array | None = None,
        held: Collection[int] = (),
        given: Array | None = None,
    ) -> None:
        """Take a state (K = 1), with M and the accelerations or velocities without contacts.

        `near` points touch, `slipping` ones among them slip, and `released` ones are no longer held as they were;
        `goal` as in `Contacts.load`. Latches keep `held` points closed, whatever pulls. With
        `given` (P,), impulses along the normals are as large at least; points that have no more may leave.
        """
        self.contacts, self.touch, (self.M, self.free) = contacts, touch, inertia
        self.near, self.slipping, self.released, self.goal = near, slipping, released, goal
        self.held, self.given = held, given

    def find(self) -> tuple[Mode, Loads]:
        """Return a mode and its loads. Raises ParadoxError."""
        near, slipping, found = self.near, self.slipping, list[tuple[Mode, Loads]]()
        names = ", ".join(self.contacts.names[k] for k in near)
        is_simple = not any(self.contacts.coefficient[k] > 0 for k in near)
        for count, (states, leaving) in enumerate(self._list()):
            if count > MOST:
                break
            mode = self._try(states, leaving)
            if mode is None or any(self._is_same(mode[1], other) for _, other in found):
                continue
            found.append(mode)
            if is_simple or (State.SLIP not in mode[0].states and not slipping):
                break
        if not found:
            raise ParadoxError(f"no motion obeys the laws of contact and friction at {names}: Painleve's paradox")
        if len(found) > 1:
            finding = f"{len(found)} motions obey the laws of contact and friction at {names}"
            finding += ": Painleve's paradox, or points that share their load in several ways"
            raise ParadoxError(finding)
        return found[0]

    def _list(self) -> Iterator[tuple[tuple[State, ...], tuple[int, ...]]]:
        """List the states of points, from all closed to all open, with the points that leave."""
        if self.given is not None:
            yield from self._list_leaving()
            return
        options = [
            (State.OPEN,)
            if k not in self.near
            else (State.SLIP,)
            if k in self.held
            else (State.SLIP, State.OPEN)
            if (k in self.slipping and self.goal is None) or self.contacts.coefficient[k] == 0
            else (State.STICK, State.SLIP, State.OPEN)
            for k in range(len(self.contacts.names))
        ]
        yield from ((states, ()) for states in itertools.product(*options))

    def _list_leaving(self) -> Iterator[tuple[tuple[State, ...], tuple[int, ...]]]:
        """List modes in which points near have their given impulses alone, or more."""
        options = []
        for k in range(len(self.contacts.names)):
            states = (State.SLIP,) if self.contacts.coefficient[k] == 0 else (State.STICK, State.SLIP)
            leaves = (False,) if k in self.held else (False, True)
            options.append([(x, y) for y in leaves for x in states] if k in self.near else [(State.OPEN, False)])
        for chosen in itertools.product(*options):
            yield tuple(x for x, _ in chosen), tuple(k for k, (_, leaves) in enumerate(chosen) if leaves)

    def _is_same(self, one: Loads, other: Loads) -> bool:
        size = np.abs(one.qdd).max() + np.abs(other.qdd).max() + np.abs(self.free).max()
        return bool(np.abs(one.qdd - other.qdd).max() <= 1e-6 * size)

    def _try(self, states: tuple[State, ...], leaving: tuple[int, ...]) -> tuple[Mode, Loads] | None:
        """Return a mode, if its conditions hold."""
        count = len(states)
        ways, shares = np.zeros((count, 3)), np.ones(count)
        fixed = [k for k in range(count) if k in self.slipping and self.goal is None]
        for k in self.slipping:
            ways[k] = self.touch.slip[0, k] / np.linalg.norm(self.touch.slip[0, k])
        mode = Mode(states, ways, shares, leaving=leaving)
        slips = [k for k, x in enumerate(states) if x == State.SLIP and self.contacts.coefficient[k] > 0]
        turning = [k for k in slips if k not in fixed]
        loads = self._load(mode)
        if turning:
            mode, loads = self._turn(mode, turning)
        if self._holds(mode, loads, turning):
            return replace(mode, shares=np.maximum(loads.normal[0], 0) + 1e-300), loads
        if np.isfinite(loads.normal).all() and (loads.normal[0] > 0).any():
            mode = replace(mode, shares=np.maximum(loads.normal[0], 1e-9 * loads.normal[0].max()))
            loads = self._load(mode)
            if self._holds(mode, loads, turning):
                return mode, loads
        return None

    def _load(self, mode: Mode) -> Loads:
        return self.contacts.load(self._fix(mode), self.M, self.free, mode, self.goal, self.given)

    def _fix(self, mode: Mode) -> Touch:
        """Return the points with the velocities that give slipping ones their way."""
        velocity = self.touch.velocity.copy()
        for k, state in enumerate(mode.states):
            if state == State.SLIP:
                n = self.touch.normal[0, k]
                velocity[0, k] = (velocity[0, k] @ n) * n + mode.ways[k]
        return replace(self.touch, velocity=velocity)

    def _turn(self, mode: Mode, turning: Sequence[int]) -> tuple[Mode, Loads]:
        """Find the directions in which points start to slip, or slip after an impact: of their motion then."""
        stick = replace(mode, states=tuple(State.STICK if k in turning else x for k, x in enumerate(mode.states)))
        loads, ways = self._load(stick), mode.ways.copy()
        for k in turning:
            size = float(np.linalg.norm(loads.friction[0, k]))
            ways[k] = -loads.friction[0, k] / size if size > 0 else span(self.touch.normal[:, k])[0][0]
        for _ in range(TURNS):
            mode = replace(mode, ways=ways.copy())
            loads = self._load(mode)
            motion, change = self._move(loads)[1], 0.0
            for k in turning:
                size = float(np.linalg.norm(motion[k]))
                if size > NEAR * (1e-300 + np.abs(loads.qdd).max()) and motion[k] @ ways[k] > 0:
                    change = max(change, float(np.abs(motion[k] / size - ways[k]).max()))
                    ways[k] = motion[k] / size
            if change < FIXED:
                break
        return mode, loads

    def _move(self, loads: Loads) -> tuple[Array, Array]:
        """Return what points do along the normal (P,), and across it (P, 3): accelerations, or velocities."""
        S, n = self.touch.slide[0], self.touch.normal[0]
        motion = np.einsum("pin,n->pi", S, loads.qdd[0])
        along = (n * motion).sum(axis=1)
        if self.goal is not None:
            return along, motion - along[:, None] * n
        motion = motion + self.touch.drift[0]
        across = motion - (n * motion).sum(axis=1)[:, None] * n
        return along + self.touch.pull[0], across

    def _find_rounding(self, k: int) -> float:
        """Return a normal force [N] of a point that may be rounding of 0, by the largest acceleration."""
        row = self.touch.normal[0, k] @ self.touch.slide[0, k]
        terms = float(np.abs(row).sum() * np.abs(self.free[0]).max() + np.abs(self.touch.pull[0, k]))
        return NEAR * terms / max(float(row @ np.linalg.solve(self.M[0], row)), 1e-300)

    def _holds(self, mode: Mode, loads: Loads, turning: Sequence[int]) -> bool:
        """Return whether the conditions of all points that touch hold."""
        if not (np.isfinite(loads.qdd).all() and loads.miss[0] <= 1e-8):
            return False
        along, across = self._move(loads)
        reach = np.abs(self.touch.slide[0]).sum(axis=(1, 2)) * np.abs(loads.qdd).max() + np.abs(self.touch.pull[0])
        press = np.abs(loads.normal[0]).max() + 1e-300
        for k, state in enumerate(mode.states):
            N, T, mu = loads.normal[0, k], float(np.linalg.norm(loads.friction[0, k])), self.contacts.coefficient[k]
            least = NEAR * press
            if state == State.OPEN:
                if k in self.near and along[k] < (0 if self.goal is None else self.goal[0, k]) - NEAR * reach[k]:
                    return False
                continue
            room = -1 if k in self.released else 1
            most = mu * N * (1 + room * NEAR) + 1e-3 * least
            breaks = state == State.STICK and most < T
            turns_back = k in turning and across[k] @ mode.ways[k] < -NEAR * reach[k]
            lowest = 0.0 if self.given is None else self.given[k]
            lowest += self._find_rounding(k) if k in self.released else -least
            pulls = lowest > N and k not in self.held
            enters = k in mode.leaving and along[k] < -NEAR * reach[k]
            if pulls or enters or breaks or turns_back:
                return False
        return True
