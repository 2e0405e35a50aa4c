"""Effects: the errors of a tree's functions, and the flops they save, while some numbers of the tree are 0.

The error of an entry is its largest difference from the whole tree's at the compared states, divided by its own largest
value there. The entries of a vector, such as a position, share that value; M_ij is divided by the largest sqrt(M_ii
M_jj). The error of a function is the error of its worst entry. Accelerations are compared for the forces that give the
whole tree the drawn accelerations, as far as its joints are driven.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.approximation.cuts import Released
from mbsgen.approximation.states import Array, States
from mbsgen.formulations import ports
from mbsgen.formulations.catalogue import FUNCTIONS, REFERENCE, list_giving
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.tree import Kind
from mbsgen.procedure.procedure import straight
from mbsgen.roles import Role
from mbsgen.tape.interpreter import FLOATS, evaluate
from mbsgen.tape.passes import keep_results, set_zero
from mbsgen.tape.types import Output, Tape
from mbsgen.tape.zeros import Sets, count_without

LEAST_INERTIA = 0.5  # fraction of the kinetic energy of any motion that must remain
ROUNDING = 1e-13  # relative to a result's largest entry: smaller differences are ignored
VALUES, MARKS = 2**24, 2**27  # numbers, and truth values, that are held at a time

Results = dict[str, Array]  # (sets, states, rows, columns)


@dataclass(frozen=True)
class Wanted:
    """The functions to compare, and for some of them the results to compare."""

    functions: tuple[str, ...]
    results: Mapping[str, Sequence[str]]
    motion: bool  # else velocities are 0, and no input


class ReleasedFunctions:
    """A released tree's functions, evaluated with any of its numbers 0."""

    def __init__(self, released: Released, wanted: Wanted) -> None:
        self.released, self.wanted = released, wanted
        self.tapes = {name: self._write(name) for name in wanted.functions}

    def _write(self, name: str) -> Tape:
        tape = straight(FUNCTIONS[name].build(self.released.tree, Reductions(trials=1)))
        if name in self.wanted.results:
            tape = keep_results(tape, self.wanted.results[name])
        return tape if self.wanted.motion else set_zero(tape, Role.VELOCITY)

    @property
    def judged(self) -> tuple[str, ...]:
        """Return the functions whose errors count; of two forms of one function, one."""
        counted = [name for name, tape in self.tapes.items() if is_judged(tape)]
        others = {name: FUNCTIONS[name].same_as for name in counted}
        return tuple(dict.fromkeys(others[name] if others[name] in counted else name for name in counted))

    def count(self, sets: Sets) -> NDArray[np.int64]:
        """Estimate the flops of all functions without each set of numbers: (k,)."""
        entries = np.hstack([np.zeros((len(sets), len(self._given)), bool), sets])
        total = np.zeros(len(sets), np.int64)
        for tape in self.tapes.values():
            step = max(1, MARKS // (len(tape.operations) + 1))
            for k in range(0, len(sets), step):
                total[k : k + step] += count_without(tape, ports.PARAMETERS.name, entries[k : k + step])
        return total

    @property
    def _given(self) -> list[float]:
        """List the values of the model's own parameters at run time."""
        return [p.value for p in self.released.whole.parameters if p.kind is Kind.RUNTIME]

    def evaluate(self, tape: Tape, states: States, sets: Sets) -> Results:
        """Evaluate a tape at all states, without each set of numbers."""
        step = max(1, VALUES // (len(tape.operations) * len(sets) + 1))
        parts = [
            self._evaluate(tape, {name: columns[k : k + step] for name, columns in states.items()}, sets)
            for k in range(0, len(states["q"]), step)
        ]
        return {o.name: np.concatenate([part[o.name] for part in parts], axis=1) for o in tape.outputs}

    def _evaluate(self, tape: Tape, states: States, sets: Sets) -> Results:
        values = np.array(list(self.released.numbers.values()))
        design = [p.value for p in self.released.tree.parameters if p.kind is Kind.DIFFERENTIATED]
        given = {name: list(columns.T[:, None, :]) for name, columns in states.items()}
        numbers = [np.where(zero, 0.0, value)[:, None] for zero, value in zip(sets.T, values, strict=True)]
        given |= {ports.DESIGN.name: design, ports.PARAMETERS.name: [*self._given, *numbers]}
        with np.errstate(all="ignore"):  # an undefined result is NaN; `judge` counts it as an infinite error
            found = evaluate(tape, {i.name: given[i.name] for i in tape.inputs}, FLOATS)
        shape = len(sets), len(states["q"])
        return {o.name: _fill(o, found[o.name], shape) for o in tape.outputs}


def _fill(output: Output, values: Sequence[Any], shape: tuple[int, int]) -> Array:
    full = np.zeros((*shape, output.sparsity.rows, output.sparsity.cols))
    for (r, c), value in zip(output.sparsity.entries, values, strict=True):
        full[:, :, r, c] = value
    return full


def is_judged(tape: Tape) -> bool:
    """Return whether the error of a function counts: an estimate of digits is no result of mechanics."""
    return bool(tape.outputs) and not tape.giving(Role.CONDITION)


class Comparison:
    """Functions at some states: what the whole tree has there, and how far from it others are.

    M is looked at in the first `poses` of them.
    """

    def __init__(self, functions: ReleasedFunctions, states: States, poses: int) -> None:
        self._functions = functions
        none = self._none
        released = functions.released
        residual = straight(FUNCTIONS[REFERENCE].build(released.tree, Reductions(trials=1)))
        still = dict(states) | {
            "u": np.zeros((len(states["q"]), sum(joint.actuated for joint in released.tree.joints)))
        }
        torques = functions.evaluate(residual, still, none)["Phi"][0, :, :, 0]
        driven = [k for k, joint in enumerate(released.tree.joints) if joint.actuated]
        self._still, self._driven = still, still | {"u": torques[:, driven]}
        self._whole = {name: self._evaluate(name, none) for name in functions.judged}
        self._poses = {name: values[:poses] for name, values in still.items()}
        self._inertia = straight(FUNCTIONS[list_giving(Role.MASS_MATRIX)[0]].build(released.tree, Reductions(trials=1)))

    @property
    def _none(self) -> Sets:
        return np.zeros((1, len(self._functions.released.numbers)), bool)

    @property
    def compared(self) -> frozenset[str]:
        """Return the functions that `evaluate` has states for: all whose errors count."""
        return frozenset(name for name, tape in self._functions.tapes.items() if is_judged(tape))

    def evaluate(self, name: str, tape: Tape) -> Results:
        """Evaluate a tape without released numbers at the states of a function."""
        return self._evaluate(name, self._none, tape)

    def _evaluate(self, name: str, sets: Sets, tape: Tape | None = None) -> Results:
        states = self._driven if self._functions.tapes[name].giving(Role.ACCELERATION) else self._still
        return self._functions.evaluate(tape or self._functions.tapes[name], states, sets)

    def judge(self, sets: Sets) -> Array:
        """Return the largest error of all functions without each set of numbers; infinite where M is not kept: (k,)."""
        size = max((len(self._functions.tapes[name].operations) for name in self._whole), default=1)
        step = max(1, VALUES // (size * len(self._still["q"]) + 1))
        parts = [sets[k : k + step] for k in range(0, len(sets), step)]
        return np.concatenate([self._judge(part) for part in parts]) if parts else np.zeros(0)

    def _judge(self, sets: Sets) -> Array:
        worst = np.where(self.keeps_inertia(sets), 0.0, np.inf)
        for name in self._whole:
            worst = np.maximum(worst, self._differ(name, self._evaluate(name, sets)))
        return worst

    def measure(self, tapes: Mapping[str, Tape]) -> dict[str, float]:
        """Return the error of each function as it is generated, from tapes without released numbers."""
        known = {name: self._find_alike(name) for name, tape in tapes.items() if is_judged(tape)}
        return {
            name: float(self._differ(whole, self._evaluate(whole, self._none, tapes[name]))[0])
            for name, whole in known.items()
        }

    def _find_alike(self, name: str) -> str:
        return name if name in self._whole else FUNCTIONS[name].same_as

    def _differ(self, name: str, found: Results) -> Array:
        worst = np.zeros(len(next(iter(found.values()))))
        for result, values in found.items():
            whole = self._whole[name][result]
            largest = np.abs(whole[0]).max(axis=0)
            off = np.abs(values - whole).max(axis=1, initial=0.0)
            off[off <= ROUNDING * largest.max(initial=0.0)] = 0.0
            with np.errstate(all="ignore"):
                ratio = np.where(off == 0.0, 0.0, off / _share(result, largest))
            worst = np.maximum(worst, np.where(np.isnan(ratio), np.inf, ratio).max(axis=(1, 2), initial=0.0))
        return worst

    def keeps_inertia(self, sets: Sets) -> NDArray[np.bool_]:
        """Return whether M without each set of numbers keeps enough of the whole M, in every direction: (k,)."""
        reduced = self._functions.evaluate(self._inertia, self._poses, sets)["M"]
        left = reduced - LEAST_INERTIA * self._whole_inertia
        kept: NDArray[np.bool_] = np.array([bool(np.isfinite(x).all()) for x in left])
        kept[kept] = (np.linalg.eigvalsh(left[kept] / self._sizes) > 0).all(axis=(1, 2))
        return kept

    @cached_property
    def _whole_inertia(self) -> Array:
        return self._functions.evaluate(self._inertia, self._poses, self._none)["M"]

    @cached_property
    def _sizes(self) -> Array:
        diagonal = np.sqrt(np.diagonal(self._whole_inertia, axis1=2, axis2=3))
        sizes: Array = diagonal[..., :, None] * diagonal[..., None, :]
        return sizes


def _share(result: str, largest: Array) -> Array:
    """Return the value that errors of each entry of a result are divided by, from the largest value of each entry."""
    match result:
        case "M":
            diagonal = np.sqrt(np.diag(largest))
            return np.outer(diagonal, diagonal)
        case "position" | "v" | "omega" | "p":  # a vector is a column
            return np.broadcast_to(largest.max(axis=0, keepdims=True), largest.shape)
        case "momentum" | "angular_momentum" | "com" | "R":
            return np.full(largest.shape, largest.max(initial=0.0))
        case "J":  # three rows
            blocks = largest.reshape(-1, 3, largest.shape[1]).max(axis=(1, 2))
            return np.repeat(blocks, 3)[:, None] * np.ones(largest.shape)
    return largest
