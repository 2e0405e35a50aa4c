"""The equations of loops in numbers: h, its Jacobians by q and by qd, and cosines between axes, at the model's values.

Tapes are interpreted in double precision. A pose at which an expression has no value has residuals of NaN.

Lengths are counted in units of the mechanism: h, and the entries of Jacobians, are of order 1 at any size. Coordinates
are in m and rad; `steps` holds the unit of each. A unit is a power of two, and 1 m for sizes from a millimetre to
30 m, so that their numbers are the model's.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from sympy import Expr

from mbsgen.formulations import closure, ports
from mbsgen.formulations.catalogue import project
from mbsgen.formulations.reductions import ALL
from mbsgen.model.symbols import exact, to_double
from mbsgen.model.tree import Cut, Kind, Motion, Tree
from mbsgen.tape import forward
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Tape

Array = NDArray[np.float64]

ORDINARY = (1e-3, 30.0)  # m: sizes of mechanisms whose unit is 1 m


class Mechanism:
    """The loops of a tree, with all equations that they have."""

    def __init__(self, tree: Tree, parameters: Sequence[float] | None = None) -> None:
        """Take a tree, and values of its parameters except constants, in its order; None: the model's values."""
        whole = replace(tree, closure=None)
        self.tree = tree
        self.equations = closure.list_equations(tree)
        self._h = _build(closure.build, whole)
        self._slopes = forward.jacobian(self._h, [ports.COORDINATES.name])
        self._jacobian = _build(closure.build_jacobian, whole)
        self._senses = _build(closure.build_senses, whole)
        own = [p for p in tree.parameters if p.kind is not Kind.CONSTANT]
        values = [p.value for p in own] if parameters is None else parameters
        self._given: dict[str, list[float]] = {
            port.name: [x for p, x in zip(own, values, strict=True) if p.kind is kind]
            for port, kind in ((ports.PARAMETERS, Kind.RUNTIME), (ports.DESIGN, Kind.DIFFERENTIATED))
        }
        self.n = len(tree.joints)
        self.sizes = measure_sizes(tree)
        units = [_choose_unit(size) for size in self.sizes]
        self.size = max(self.sizes, default=_measure_rough(tree))
        self.unit = _choose_unit(self.size)
        slides = [joint.name for joint in tree.joints if joint.motion is Motion.PRISMATIC]
        slides += [x.coordinates[k] for x in tree.quaternions if x.is_free for k in range(3)]
        self.steps = np.array([self.unit if name in slides else 1.0 for name in tree.coordinates])
        self._speeds = np.array([self.unit if joint.motion is Motion.PRISMATIC else 1.0 for joint in tree.joints])
        self._rows = np.ones(len(self.equations))
        self._rows = np.array([self._choose_row(i, k, units) for i, (k, _) in enumerate(self.equations)])
        self.senses_of = closure.list_senses(tree)  # of each cosine, the number of its loop

    @property
    def operations(self) -> int:
        """Count the operations of h and dh/dq."""
        return len(self._h.operations) + len(self._slopes.operations)

    def _choose_row(self, row: int, number: int, units: Sequence[float]) -> float:
        """Return one over the unit of an equation; a constraint of small or large lengths has its slopes' size."""
        if number < len(units):
            return 1.0 if is_turn(self.equations[row][1]) else 1.0 / units[number]
        size = 1.0 if self.unit == 1.0 else float(np.linalg.norm(self.slopes(place_roughly(self.tree))[row]))
        return 1.0 / _choose_unit(size) if 0.0 < size < math.inf else 1.0

    def gauge(self, J: Array) -> Array:
        """Return a Jacobian relative to the sizes of loops, and the rows of constraints to their own."""
        shifts = np.array([joint.motion is Motion.PRISMATIC for joint in self.tree.joints])
        found = self._weigh()[:, None] * J
        found[:, shifts] *= max(self.sizes, default=self.unit) / self.unit
        own = [i for i, (k, _) in enumerate(self.equations) if k >= len(self.sizes)]
        found[own] /= np.maximum(np.linalg.norm(found[own], axis=1, keepdims=True), 1e-300)
        return found

    def distances(self, q: Array) -> Array:
        """Return how far each equation is from holding: in rad, or relative to the size of its loop."""
        found = np.abs(self._weigh() * self.h(q))
        own = [i for i, (k, _) in enumerate(self.equations) if k >= len(self.sizes)]
        if own:
            found[own] /= np.maximum(np.linalg.norm(self.slopes(q)[own], axis=1), 1e-300)
        return found

    def choose_pulls(self, q: Array, kept: Sequence[int]) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return units of the kept equations' multipliers, for projections by the mass matrix and by plain distance."""
        gaps, weight = 1.0 / self._rows, _find_least_mass(self.tree)
        J = gaps[:, None] * self.J(q) / self._speeds
        own = list(kept)
        sizes = np.array([self.sizes[k] if k < len(self.sizes) else self.unit for k, _ in self.equations])
        pulls = weight * sizes**2 / (gaps if self.unit != 1.0 else np.where(self._weigh() == 1.0, 1.0, sizes))
        plain = (
            gaps / np.maximum(((J * self._speeds) ** 2).sum(axis=1), 1e-300) if self.unit != 1.0 else np.ones(len(gaps))
        )
        return tuple(map(_choose_unit, pulls[own])), tuple(map(_choose_unit, plain[own]))

    def _weigh(self) -> Array:
        """Return for each equation of a length its unit over the size of its loop, or over the pitch of a screw."""
        loops, values = self.tree.loops, {p.symbol: exact(p.value) for p in self.tree.parameters}
        found = np.ones(len(self.equations))
        for i, (k, name) in enumerate(self.equations):
            if k < len(loops) and not is_turn(name):
                pitch = abs(to_double(loops[k].value.xreplace(values))) if name == closure.SCREW else 0.0
                found[i] = 1.0 / self._rows[i] / (pitch or self.sizes[k])
        return found

    def h(self, q: Array) -> Array:
        """Return what is left open, shape (all equations,)."""
        found: Array = self._rows * np.array(self._evaluate(self._h, q)[ports.CLOSURE.name], float)
        return found

    def slopes(self, q: Array) -> Array:
        """Return dh/dq, shape (all equations, entries of q)."""
        if not self.equations:
            return np.zeros((0, len(self.steps)))
        found: Array = self._rows[:, None] * self._spread(self._slopes, q) * self.steps
        return found

    def J(self, q: Array) -> Array:
        """Return J, shape (all equations, n)."""
        if not self.equations:  # driven joints alone
            return np.zeros((0, self.n))
        found: Array = self._rows[:, None] * self._spread(self._jacobian, q) * self._speeds
        return found

    def senses(self, q: Array) -> Array:
        """Return cosines that are positive where axes point the same way, see `closure.build_senses`."""
        return np.array(self._evaluate(self._senses, q)["senses"], float)

    def _spread(self, tape: Tape, q: Array) -> Array:
        found, output = self._evaluate(tape, q), tape.outputs[0]
        full = np.zeros((output.sparsity.rows, output.sparsity.cols))
        for (r, c), value in zip(output.sparsity.entries, found[output.name], strict=True):
            full[r, c] = value
        return full

    def _evaluate(self, tape: Tape, q: Array) -> dict[str, list[float]]:
        given = {**self._given, ports.COORDINATES.name: [float(x) for x in q]}
        arguments = {i.name: given.get(i.name, [0.0] * i.sparsity.nnz) for i in tape.inputs}
        try:
            with np.errstate(all="ignore"):
                return evaluate(tape, arguments)
        except (ValueError, OverflowError, ZeroDivisionError):
            return {o.name: [float("nan")] * len(o.values) for o in tape.outputs}


def name_equations(tree: Tree, rows: Iterable[int]) -> tuple[str, ...]:
    """Name equations by their numbers, from 0: the loop or constraint, and the equation."""
    owners = [*(loop.name for loop in tree.loops), *(constraint.name for constraint in tree.constraints)]
    every = closure.list_equations(tree)
    return tuple(f"{owners[every[i][0]]}.{every[i][1]}" for i in rows)


def is_turn(equation: str) -> bool:
    """Return whether an equation, by its name, compares directions, not places."""
    return equation.startswith("turn") or equation == "angle"


def place_roughly(tree: Tree) -> Array:
    """Return the author's rough pose."""
    given = {tree.bodies[number - 1].joint.name: value for number, value in tree.rough}
    for quaternion in tree.quaternions:
        turns = [given.get(tree.bodies[i - 1].joint.name, 0.0) for i in quaternion.bodies[-3:]]
        given |= dict(zip(quaternion.coordinates[-4:], _make_quaternion(np.array(turns)), strict=True))
    return np.array([given.get(name, rest) for name, rest in zip(tree.coordinates, tree.neutral, strict=True)])


def _make_quaternion(turn: Array) -> Array:
    """Return the quaternion, its scalar last, of a turn: its angle times its axis, along x, y, z."""
    angle = float(np.linalg.norm(turn))
    axis = turn / angle if angle else turn
    return np.array([*(math.sin(angle / 2) * axis), math.cos(angle / 2)])


def measure_sizes(tree: Tree) -> list[float]:
    """Return the size of each loop: the longest of its lengths [m]; 1 without any."""
    values = {p.symbol: exact(p.value) for p in tree.parameters}

    def measure(vector: Iterable[Expr]) -> float:
        return math.hypot(*(to_double(x.xreplace(values)) for x in vector))

    found = []
    for loop in tree.loops:
        ends = (loop.first, loop.second)
        paths = [_climb(tree, end.body) for end in ends]
        own = [[i for i in path if i not in other] for path, other in (paths, paths[::-1])]
        vectors = [end.position for end, path in zip(ends, own, strict=True) if path]
        vectors += [tree.bodies[i - 1].position for path in own for i in path[:-1]]
        roots = [tree.bodies[p[-1] - 1].position if p else end.position for p, end in zip(own, ends, strict=True)]
        between = [b - a for a, b in zip(*roots, strict=True)]  # they may be far from their carrier's origin
        lengths = [loop.value] if loop.cut in (Cut.ROD, Cut.HELICAL) else []
        found.append(max(map(measure, [*vectors, between, lengths])) or 1.0)
    return found


def _climb(tree: Tree, body: int) -> list[int]:
    return [body, *_climb(tree, tree.bodies[body - 1].parent)] if body else []


def _measure_rough(tree: Tree) -> float:
    """Return the longest of the author's rough shifts [m], by which coordinates without loops are measured; else 1."""
    shifts = [abs(x) for i, x in tree.rough if tree.bodies[i - 1].joint.motion is Motion.PRISMATIC]
    return max(shifts, default=0.0) or 1.0


def _find_least_mass(tree: Tree) -> float:
    """Return the least mass of a body that loops move, or of all bodies; 1 kg without any."""
    values = {p.symbol: exact(p.value) for p in tree.parameters}
    ends = [end.body for loop in tree.loops for end in (loop.first, loop.second)]
    moved = {i for end in ends for i in _climb(tree, end)} or range(1, len(tree.bodies) + 1)
    masses = [to_double(tree.bodies[i - 1].mass.xreplace(values)) for i in sorted(moved)]
    return min((x for x in masses if x > 0), default=1.0)


def _choose_unit(size: float) -> float:
    """Return the power of two next to a size; 1 for ordinary ones."""
    return 1.0 if ORDINARY[0] <= size <= ORDINARY[1] else 2.0 ** round(math.log2(size))


def _build(write: closure.Write, tree: Tree) -> Tape:
    return project(lambda own, _: write(own))(tree, ALL)
