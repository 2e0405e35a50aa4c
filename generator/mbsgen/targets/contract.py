"""The faces of a function and its derivatives in CasADi's contract for external functions.

CasADi looks `jac_f`, `adj1_f` and `jac_adj1_f` up by name beside `f`, and passes by position:

    jac_f        inputs of f, out_<o>                       outputs jac_<o>_<i>, all pairs, o slowest
    adj1_f       inputs of f, out_<o>, adj_<o>              outputs adj_<i>
    jac_adj1_f   inputs of adj1_f, out_adj_<i>              outputs jac_adj_<i>_<x>, x over the inputs of adj1_f

So a face has more arguments than its tape: results that are not needed (`out_*`) and blocks that are structurally zero
are there with an empty pattern.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mbsgen.tape.columns import Columns
from mbsgen.tape.counts import Counts, count
from mbsgen.tape.types import Input, Output, Sparsity, Tape


@dataclass(frozen=True)
class Family:
    """A function, and those of its derivatives that are generated. Their names are made from the function's."""

    value: Tape
    jac: Tape | None = None
    adj1: Tape | None = None
    jac_adj1: Tape | None = None
    title: str = ""  # what it computes; for readers
    meanings: Mapping[str, str] = field(
        default_factory=dict
    )  # `argument` or `function.argument` -> what it is, its unit
    loops: Mapping[str, Columns] = field(default_factory=dict)  # tape -> the same with a loop, where that is quicker
    integer: str = "casadi_int"  # the type of counts and places in CasADi's contract

    @property
    def tapes(self) -> tuple[Tape, ...]:
        """List the function and those of its derivatives that there are."""
        return tuple(t for t in (self.value, self.jac, self.adj1, self.jac_adj1) if t is not None)

    def describe(self, kernel: str) -> str:
        """Tell what the function or a derivative of it computes; for readers."""
        name = self.value.name
        return {
            name: f"{name}: {self.title}" if self.title else name,
            f"jac_{name}": f"jac_{name}: Jacobians of {name}, jac_<result>_<input>",
            f"adj1_{name}": f"adj1_{name}: adj_<input>, the sum over results of (d result / d input)^T adj_<result>",
            f"jac_adj1_{name}": f"jac_adj1_{name}: Jacobians of adj1_{name}, jac_<result>_<input>",
        }[kernel]

    def meaning(self, argument: str) -> str:
        """Tell what an argument of the function is, with its unit; empty where nobody said."""
        return self.meanings.get(f"{self.value.name}.{argument}", self.meanings.get(argument, ""))


@dataclass(frozen=True)
class Slot:
    """One argument of a face."""

    name: str
    sparsity: Sparsity
    differentiable: bool


@dataclass(frozen=True)
class Face:
    """A tape with its arguments as CasADi counts them."""

    family: Family
    kernel: str  # "jac_impl"
    symbol: str  # "jac_arm_impl"
    function: str  # "arm_compute_jac_impl": the typed C function
    tape: Tape
    inputs: tuple[Slot, ...]
    outputs: tuple[Slot, ...]

    @property
    def loop(self) -> Columns | None:
        """Give the same function with a loop, if it is to be written so."""
        return self.family.loops.get(self.tape.name)

    @property
    def counts(self) -> Counts:
        """Count what is computed."""
        if self.loop is None:
            return count(self.tape)
        return self.loop.counts(sum(o.sparsity.nnz for o in self.tape.outputs if o.name in self.loop.blocks))


def arguments(tape: Tape) -> list[Input | Output]:
    """List a tape's inputs, then its outputs."""
    return [*tape.inputs, *tape.outputs]


def faces(family: Family, prefix: str) -> tuple[Face, ...]:
    """List the faces of a function and its derivatives, the function's own first."""
    value = family.value
    own = tuple(Slot(i.name, i.sparsity, _is_differentiable(family, i)) for i in value.inputs)
    out = tuple(_empty(f"out_{o.name}", o.sparsity) for o in value.outputs)
    adj = tuple(Slot(f"adj_{o.name}", o.sparsity, True) for o in value.outputs)
    found = [_face(family, prefix, "", value, own, tuple(Slot(o.name, o.sparsity, True) for o in value.outputs))]
    if family.jac:
        found.append(_face(family, prefix, "jac_", family.jac, own + out, _blocks(family.jac, value.outputs, own)))
    if family.adj1:
        gradient = tuple(_slot(family.adj1, f"adj_{s.name}", s.sparsity) for s in own)
        found.append(_face(family, prefix, "adj1_", family.adj1, own + out + adj, gradient))
        if family.jac_adj1:
            inputs = own + out + adj
            seeds = tuple(_empty(f"out_{s.name}", s.sparsity) for s in gradient)
            blocks = _blocks(family.jac_adj1, gradient, inputs)
            found.append(_face(family, prefix, "jac_adj1_", family.jac_adj1, inputs + seeds, blocks))
    return tuple(found)


def _face(
    family: Family, prefix: str, order: str, tape: Tape, inputs: tuple[Slot, ...], outputs: tuple[Slot, ...]
) -> Face:
    name = family.value.name
    held = {slot.name for slot in (*inputs, *outputs) if slot.sparsity.nnz}
    missing = [x.name for x in arguments(tape) if x.sparsity.nnz and x.name not in held]
    assert not missing, f"{order}{name}: CasADi's contract has no place for {missing}"
    symbol, function = f"{order}{prefix}_{name}", f"{prefix}_compute_{order}{name}"
    return Face(family, f"{order}{name}", symbol, function, tape, inputs, outputs)


def _is_differentiable(family: Family, source: Input) -> bool:
    """Tell whether the derivatives know the input; without any, CasADi is to ask for one and fail aloud."""
    if family.adj1:
        return any(o.name == f"adj_{source.name}" for o in family.adj1.outputs)
    if family.jac:
        wanted = {f"jac_{o.name}_{source.name}" for o in family.value.outputs}
        return any(o.name in wanted for o in family.jac.outputs)
    return True


def _blocks(tape: Tape, rows: tuple[Output, ...] | tuple[Slot, ...], cols: tuple[Slot, ...]) -> tuple[Slot, ...]:
    return tuple(
        _slot(tape, f"jac_{o.name}_{i.name}", Sparsity.of(_numel(o.sparsity), _numel(i.sparsity), ()))
        for o in rows
        for i in cols
    )


def _slot(tape: Tape, name: str, shape: Sparsity) -> Slot:
    """Make the slot of a result: with the tape's pattern, or empty where the tape has no such result."""
    for output in tape.outputs:
        if output.name == name:
            assert (output.sparsity.rows, output.sparsity.cols) == (shape.rows, shape.cols), f"{name} has another shape"
            return Slot(name, output.sparsity, True)
    return _empty(name, shape)


def _empty(name: str, shape: Sparsity) -> Slot:
    return Slot(name, Sparsity.of(shape.rows, shape.cols, ()), False)


def _numel(sparsity: Sparsity) -> int:
    return sparsity.rows * sparsity.cols
