"""Dry friction by the load of joints, in trees at given states: forces, accelerations, and their conditions.

A joint's reaction (F, T) about its own origin, with axis a and P = 1 - a a^T, loads its bearings across its axis by

    one bearing:  F_1 = P F,    two at a distance L:  F_1,2 = P F/2 +- a x T/L,    N = sum |F_k|.

A joint that slides has the force -sign(qd) (T(qd) + mu(qd) r N), with the radius r of a pin, or r = 1. At rest it holds
up to T_s + mu_s r N. Reactions are affine in accelerations, and these in the forces of friction. So the loads of the
sliding joints solve

    N_i = sum_k |c_k + D_k N|,    k: bearings of joint i.

S_ij is the sum of |D_kj| over these bearings. Where the spectral radius of S is below 1, the right side contracts
in a weighted norm, and there is one solution. Of one joint with S >= 1 there is none, or there are two: the right side
less N is convex, not negative at N = 0, and does not fall far out. Of several joints nothing is known then. This is
Painleve's paradox of bearings, and ends a motion.

At rest each joint sticks, or starts to slide in one of two ways. All combinations are tried, to see whether there are
several motions.

Painleve, "Sur les lois du frottement de glissement", Comptes rendus 121 (1895); Le Suan An, "The Painleve paradoxes and
the law of motion of mechanical systems with Coulomb friction", J. Appl. Math. Mech. 54 (1990).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import MbsError
from mbsgen.manifest import BearingLoad
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.integration.explicit import Loads
from mbsrun.simulation.integration.joints import Joints
from mbsrun.simulation.motion import Mode

Array = NDArray[np.float64]

NEAR = 1e-9  # of the size of a condition's terms: what is as near to 0 may be either
SAME = 1e-6  # of the accelerations: motions that differ by less are one
FIXED = 4 * np.finfo(float).eps  # of the loads: a smaller change ends Newton's method
MOST = 200  # of its steps
DOUBLED = 40  # times that the size of a load is doubled to enclose it
TRIED = 729  # combinations of joints at rest: six joints


class LoadError(MbsError):
    """Friction by loads that allows no motion, or several, or it is not known."""


@dataclass(frozen=True, eq=False)
class State:
    """K states of a tree: M qdd = f + forces of friction, and the forces r + B qdd of R bearings."""

    M: Array  # (K, n, n)
    f: Array  # (K, n)
    r: Array  # (K, R, 3)
    B: Array  # (K, R, 3, n)

    def pick(self, k: int) -> State:
        """Return one state."""
        return State(*(x[k : k + 1] for x in (self.M, self.f, self.r, self.B)))


@dataclass(frozen=True, eq=False)
class Pattern:
    """The modes of joints, and the numbers that follow from these alone."""

    ways: NDArray[np.int_]  # (n,): in which joints slide, else 0
    held: NDArray[np.intp]  # joints that stick,
    free: NDArray[np.intp]  # and all others
    sliding: NDArray[np.intp]  # (d,): joints whose friction depends on their load
    rows: NDArray[np.intp]  # their bearings
    sums: Array  # (d, rows): 1 for the bearings of each


@dataclass(frozen=True, eq=False)
class Rub:
    """Friction in K states: the accelerations, the forces of dry joints, and the loads N of joints, (K, n) each."""

    qdd: Array
    lam: Array
    loads: Array


@dataclass(frozen=True, eq=False)
class Rest:
    """One state in which joints are at rest, with the torques and coefficients (n,) that count there."""

    state: State
    still: NDArray[np.intp]  # these joints
    torque: Array
    grip: Array


@dataclass(frozen=True, eq=False)
class Bearings:
    """The joints with dry friction of a tree."""

    dynamics: Dynamics  # in a formulation with a mass matrix
    joints: Joints
    coefficient: Array  # (n,): times the arm [m, or 1]; 0 of joints without a load
    static: Array  # (n,): the same at rest
    owner: NDArray[np.intp]  # (R,): the joint of each bearing
    frame: NDArray[np.intp]  # (R,): its joint's frame
    by_force: Array  # (R, 3, 3): the load of a bearing by the joint's force in that frame,
    by_moment: Array  # (R, 3, 3): and by its moment [1/m]

    @classmethod
    def of(cls, dynamics: Dynamics) -> Bearings:
        """Read them from a manifest."""
        manifest = dynamics.kernels.manifest
        assert manifest.appearance is not None, "a manifest with loads has axles"
        frames = {x.coordinate: (k, x.axis) for k, x in enumerate(manifest.appearance.axles)}
        loads = [None if c.friction is None else c.friction.load for c in manifest.coordinates]
        rows = [(i, *frames[i], *row) for i, x in enumerate(loads) if x is not None for row in _list_bearings(x)]
        owner, frame, axes, parts, levers = zip(*rows, strict=True)
        a, across = np.array(axes), [np.eye(3) - np.outer(axis, axis) for axis in axes]
        return cls(
            dynamics,
            Joints.of(manifest),
            np.array([0.0 if x is None else x.coefficient * x.arm for x in loads]),
            np.array([0.0 if x is None else x.static * x.arm for x in loads]),
            np.array(owner, dtype=np.intp),
            np.array(frame, dtype=np.intp),
            np.array(parts)[:, None, None] * across,
            np.array(levers)[:, None, None] * np.cross(a[:, None], np.eye(3)).transpose(0, 2, 1),
        )

    def lay(self) -> Loads:
        """Return the numbers as C functions take them."""
        fall = np.where(self.joints.stribeck > 0, self.static - self.coefficient, 0.0)
        return Loads(
            self.owner.tolist(),
            self.frame.tolist(),
            self.by_force,
            self.by_moment,
            self.coefficient,
            fall,
            self.static,
        )

    @property
    def starting(self) -> Array:
        """The coefficients of joints that start to slide: the static ones where they fall over a Stribeck speed."""
        return np.asarray(np.where(self.joints.stribeck > 0, self.static, self.coefficient))

    def rub(self, qd: Array) -> Array:
        """Return the coefficients of sliding joints at velocities (..., n)."""
        stribeck = self.joints.stribeck
        slowness = np.divide(1.0, stribeck, out=np.zeros_like(stribeck), where=stribeck > 0)
        fall = np.where(stribeck > 0, self.static - self.coefficient, 0.0)
        return np.asarray(self.coefficient + fall * np.exp(-((qd * slowness) ** 2)))

    def read(self, modes: NDArray[np.int_]) -> Pattern:
        """Read the modes of joints (n,)."""
        ways, sticks = np.where(np.abs(modes) == 1, modes, 0), modes == Mode.STICKS
        sliding = np.flatnonzero((ways != 0) & (self.static > 0))
        rows = np.flatnonzero(np.isin(self.owner, sliding))
        sums = (self.owner[rows] == sliding[:, None]).astype(np.float64)
        return Pattern(ways, np.flatnonzero(sticks), np.flatnonzero(~sticks), sliding, rows, sums)

    def place(self, q: Array, qd: Array, v: Array) -> State:
        """Describe states (K, nq), (K, n) with inputs (K, m)."""
        dynamics, (K, n) = self.dynamics, qd.shape
        M, f = dynamics.mass_matrix(q, qd, v), -dynamics.residual(q, qd, np.zeros_like(qd), v)
        many, units = [np.repeat(x, n + 1, axis=0) for x in (q, qd, v)], np.tile(np.eye(n + 1, n, k=-1), (K, 1))
        found = dynamics.call("reactions", many[0], many[1], many[2], units)
        turns = dynamics.kernels("frames", q=q)["R"].reshape(K, 3, -1, 3).transpose(0, 2, 3, 1)[:, self.frame]
        force, moment = (
            found[name].reshape(K, n + 1, 3, -1).transpose(0, 3, 2, 1)[:, self.frame] for name in ("force", "moment")
        )
        loads = self.by_force @ (turns @ force) + self.by_moment @ (turns @ moment)
        return State(M, f, loads[..., 0], loads[..., 1:] - loads[..., :1])

    def slide(self, state: State, qd: Array, pattern: Pattern) -> Rub:
        """Return the friction in given modes, at velocities (K, n). Raises LoadError."""
        found = self.solve(state, pattern, self.joints.rub(qd), self.rub(qd))
        if len(found) == 1:
            return found[0]
        raise self._deny(len(found))

    def solve(self, state: State, pattern: Pattern, torque: Array, grip: Array) -> list[Rub]:
        """Return all solutions in given modes, with torques and coefficients (K, n) of sliding joints.

        Of states in which several solutions may be, or none, only the first one counts. Raises LoadError.
        """
        (K, n), ways, free, sliding = state.f.shape, pattern.ways, pattern.free, pattern.sliding
        W = np.zeros((K, n, n))
        factor = np.linalg.inv(self.dynamics.factorise(state.M, free))
        W[:, free[:, None], free] = factor.transpose(0, 2, 1) @ factor
        forces, factors = -ways * torque, (ways * grip)[:, sliding]
        start, columns = _apply(W, state.f + forces), -W[:, :, sliding] * factors[:, None]
        c = (state.r + _apply(state.B, start[:, None]))[:, pattern.rows]
        D = (state.B @ columns[:, None])[:, pattern.rows]
        loads = np.zeros((1, K, sliding.size))
        if sliding.size:
            S = pattern.sums @ np.sqrt((D * D).sum(axis=2))
            sizes = _find_radius(S)
            if not (sizes < 1).all():
                k = int(np.flatnonzero(~(sizes < 1))[0])
                if K > 1:
                    return self.solve(state.pick(k), pattern, torque[k : k + 1], grip[k : k + 1])
                if sliding.size > 1:
                    finding = f"whether a motion obeys the friction by the load of joints {self._name(sliding)}"
                    raise LoadError(f"{finding} is not known: their loads depend on it too much")
                with self._naming(sliding):
                    loads = np.array(_find_roots(c[0], D[0, :, :, 0])).reshape(-1, 1, 1)
            else:
                with self._naming(sliding):
                    loads = _contract(pattern.sums, S, c, D)[None]
        return [
            self._complete(state, pattern.held, start + _apply(columns, N), forces, (sliding, factors * N))
            for N in loads
        ]

    def _complete(
        self, state: State, held: NDArray[np.intp], qdd: Array, forces: Array, rubbed: tuple[NDArray[np.intp], Array]
    ) -> Rub:
        """Return accelerations with all forces of friction, and the loads."""
        lam, loads = forces.copy(), np.zeros_like(qdd)
        lam[:, rubbed[0]] -= rubbed[1]
        lam[:, held] = (_apply(state.M, qdd) - state.f)[:, held]
        bearings = state.r + _apply(state.B, qdd[:, None])
        np.add.at(loads.T, self.owner, np.sqrt((bearings * bearings).sum(axis=2)).T)
        return Rub(qdd, lam, loads)

    def _deny(self, count: int) -> LoadError:
        names = self._name(np.flatnonzero(self.static > 0))
        told = "no motion obeys" if not count else f"{count} motions obey"
        return LoadError(f"{told} the friction by the load of joints {names}: Painleve's paradox")

    def doubt(self, sliding: NDArray[np.intp]) -> LoadError:
        """Return the error of joints that slide, and whose loads are not known to rounding."""
        return LoadError(
            f"whether a motion obeys the friction by the load of joints {self._name(sliding)} is not known to rounding"
        )

    @contextmanager
    def _naming(self, sliding: NDArray[np.intp]) -> Iterator[None]:
        """Name the joints where their loads are not found."""
        try:
            yield
        except LoadError:
            raise self.doubt(sliding) from None

    def settle(self, state: State, qd: Array, released: Mapping[int, int]) -> tuple[NDArray[np.int_], Rub]:
        """Return the mode of each joint in one state; `released` ones start to slide. Raises LoadError."""
        joints = self.joints
        modes = np.where(joints.is_dry & (qd != 0), np.sign(qd), Mode.FREE).astype(np.int_)
        still = np.flatnonzero((qd == 0) & joints.is_dry)
        torque, grip = joints.rub(qd), self.rub(qd)
        torque[still], grip[still] = joints.static[still], self.static[still]
        starts = list(released)
        while True:
            torque[starts], grip[starts] = joints.starting[starts], self.starting[starts]
            found = self._search(Rest(state, still, torque, grip), modes, released)
            if not found and released:
                return self.settle(state, qd, {})
            if len(found) != 1:
                raise self._deny(len(found))
            falls = (torque > joints.starting) | (grip > self.starting)
            starts = [i for i in still.tolist() if abs(found[0][0][i]) == 1 and falls[i]]
            if not starts:
                return found[0]

    def _search(
        self, rest: Rest, modes: NDArray[np.int_], released: Mapping[int, int]
    ) -> list[tuple[NDArray[np.int_], Rub]]:
        """Try all combinations of sticking and sliding of joints at rest; list the ones that differ in the motion."""
        state, still = rest.state, rest.still
        every = (int(Mode.STICKS), int(Mode.FORWARD), int(Mode.BACKWARD))
        options = [(released[i],) if i in released else every for i in still.tolist()]
        if np.prod([len(x) for x in options]) > TRIED:
            raise LoadError(f"more than six joints with friction are at rest at once: {self._name(still)}")
        factor = np.linalg.inv(self.dynamics.factorise(state.M, np.arange(len(modes))))[0]
        inertia, found = np.abs(factor.T @ factor), list[tuple[NDArray[np.int_], Rub]]()
        for chosen in itertools.product(*options):
            tried = modes.copy()
            tried[still] = chosen
            for rub in self._try(rest, tried, inertia):
                noise = SAME * np.abs(rub.qdd).max() + NEAR * (inertia @ np.abs(state.f[0])).max()
                if all(np.abs(rub.qdd - other.qdd).max() > noise for _, other in found):
                    found.append((tried, rub))
        return found

    def _try(self, rest: Rest, modes: NDArray[np.int_], inertia: Array) -> list[Rub]:
        """Return the solutions in modes whose conditions hold; inertia: the sizes of the entries of M^-1."""
        state, still, torque, grip = rest.state, rest.still, rest.torque, rest.grip
        pattern = self.read(modes)
        ways, held, starts = pattern.ways, pattern.held, still[modes[still] != Mode.STICKS]
        good = []
        for rub in self.solve(state, pattern, torque[None], grip[None]):
            (qdd,), (lam,), (loads,) = rub.qdd, rub.lam, rub.loads
            most = torque[held] + grip[held] * loads[held]
            holds = np.abs(lam[held]) <= most + NEAR * (most + np.abs(lam[held]))
            moves = ways[starts] * qdd[starts] >= -NEAR * (inertia @ (np.abs(state.f[0]) + np.abs(lam)))[starts]
            if holds.all() and moves.all():
                good.append(rub)
        return good

    def _name(self, chosen: NDArray[np.intp]) -> str:
        return ", ".join(self.joints.manifest.coordinates[i].name for i in chosen)


def _list_bearings(load: BearingLoad) -> list[tuple[float, float]]:
    """List the bearings of a joint: the parts of the force, and the levers of the moment [1/m]."""
    return [(1.0, 0.0)] if load.length is None else [(0.5, 1 / load.length), (0.5, -1 / load.length)]


def _apply(A: Array, x: Array) -> Array:
    """Return products of matrices (..., m, n) with vectors (..., n)."""
    return np.asarray((A @ x[..., None])[..., 0])


def _find_radius(S: Array) -> Array:
    """Return the spectral radii (K,) of matrices (K, d, d); NaN where they have no number."""
    if S.shape[1] == 1:
        return np.asarray(S[:, 0, 0])
    known = np.asarray(np.isfinite(S).all(axis=(1, 2)))
    return np.where(known, np.abs(np.linalg.eigvals(np.where(known[:, None, None], S, 0.0))).max(axis=1), np.nan)


def _contract(sums: Array, S: Array, c: Array, D: Array) -> Array:
    """Solve N = sums |c + D N|, (K, d), by Newton's method; a step that is no better is one of the iteration.

    Bearings: c (K, R, 3), D (K, R, 3, d); sums (d, R), of radii of S (K, d, d) below 1. Raises LoadError.
    """
    one = np.eye(len(sums))
    weight = np.linalg.solve(one - S, np.ones((len(c), len(sums), 1)))[..., 0]  # S weight < weight
    lengths = np.sqrt((c * c).sum(axis=2)) @ sums.T

    def look(N: Array) -> tuple[Array, Array]:
        forces = c + _apply(D, N[:, None])
        sizes = np.sqrt((forces * forces).sum(axis=2))
        units = forces / np.maximum(sizes, np.finfo(float).tiny)[..., None]
        return sizes @ sums.T - N, sums @ (units[:, :, None] @ D)[:, :, 0]

    N: Array = lengths
    rest, slopes = look(N)
    for _ in range(MOST):
        trial = N + np.linalg.solve(one - slopes, rest[..., None])[..., 0]
        found = look(trial)
        is_worse = ((np.abs(found[0]) / weight).max(axis=1) > (np.abs(rest) / weight).max(axis=1))[:, None]
        if is_worse.any():
            trial = np.where(is_worse, N + rest, trial)
            found = look(trial)
        change, N, (rest, slopes) = np.abs(trial - N), trial, found
        if (change <= FIXED * weight * (lengths + _apply(S, np.abs(N)))).all():
            return N
    raise LoadError("the loads of joints, on which friction depends, are not found to rounding")


def _find_roots(c: Array, D: Array) -> list[float]:
    """Return all N >= 0 with N = sum |c + D N|, for bearings (R, 3): two, one, or none. Raises LoadError."""
    from scipy.optimize import brentq  # here, and late: it takes long to load

    def rest(N: float) -> float:
        return float(np.linalg.norm(c + D * N, axis=1).sum() - N)

    def slope(N: float) -> float:
        forces = c + D * N
        sizes = np.maximum(np.linalg.norm(forces, axis=1), np.finfo(float).tiny)
        return float(((forces * D).sum(axis=1) / sizes).sum() - 1)

    if not c.any():
        return [0.0]
    if slope(0.0) >= 0:
        return []
    last = float(np.linalg.norm(c, axis=1).sum())
    for _ in range(DOUBLED):
        if slope(last) > 0 and rest(last) > 0:
            break
        last *= 2
    else:
        raise LoadError("whether a motion obeys the friction by the load of a joint is not known to rounding")
    bottom = brentq(slope, 0.0, last, xtol=FIXED * last, rtol=FIXED)
    if rest(bottom) > 0:
        return []
    return [float(brentq(rest, *ends, xtol=FIXED * last, rtol=FIXED)) for ends in ((0.0, bottom), (bottom, last))]
