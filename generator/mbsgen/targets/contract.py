"""The faces of a function and its derivatives in CasADi's contract for external functions.

CasADi finds `jac_f`, `adj1_f` and `jac_adj1_f` by name beside `f`, and passes by position:

    jac_f        inputs of f, out_<o>                       outputs jac_<o>_<i>, all pairs, o slowest
    adj1_f       inputs of f, out_<o>, adj_<o>              outputs adj_<i>
    jac_adj1_f   inputs of adj1_f, out_adj_<i>              outputs jac_adj_<i>_<x>, x over the inputs of adj1_f

So a face has more arguments than its tape: unused results (`out_*`) and structurally zero blocks have an empty pattern.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from mbsgen.procedure.procedure import Computation, Procedure, as_procedure, count
from mbsgen.procedure.wires import Wire
from mbsgen.roles import FAMILY, Order, Role, name_adjoint, name_derivative, name_kernel, name_unneeded
from mbsgen.tape.counts import Counts
from mbsgen.tape.ports import Port, adjoint_port, derivative_port, seed_port
from mbsgen.tape.types import Input, Output, Sparsity, Tape


@dataclass(frozen=True)
class Family:
    """A function and its generated derivatives."""

    value: Computation
    jac: Computation | None = None
    adj1: Computation | None = None
    jac_adj1: Computation | None = None
    title: str = ""  # what it computes; for readers
    staged: Mapping[str, Procedure] = field(default_factory=dict)  # by name, tapes in stages, where that is quicker
    integer: Literal["casadi_int", "int"] = "casadi_int"  # the type of counts and places in CasADi's contract

    @property
    def functions(self) -> tuple[Computation, ...]:
        """List the function and its derivatives."""
        return tuple(f for f in (self.value, self.jac, self.adj1, self.jac_adj1) if f is not None)

    @property
    def tapes(self) -> tuple[Tape, ...]:
        """List the functions that are straight-line programs."""
        return tuple(f for f in self.functions if isinstance(f, Tape))

    @property
    def is_precise(self) -> bool:
        """Return whether its numbers have two parts: other languages have number types for that."""
        return any(i.port.role is Role.REMAINDER for i in self.value.inputs)

    def __post_init__(self) -> None:
        own, derivatives = self.value.function, (self.jac, self.adj1, self.jac_adj1)
        for tape, order in zip(derivatives, FAMILY[1:], strict=True):
            assert tape is None or tape.function == own.to(order), f"{tape and tape.name} is no {order.value} of {own}"

    def describe(self, tape: Computation) -> str:
        """Describe the function or a derivative of it; for readers."""
        name = tape.name
        jacobians = f"Jacobians of {{}}, {name_derivative('<result>', '<input>')}"
        adjoint, weight = name_adjoint("<input>"), name_adjoint("<result>")
        match tape.function.order:
            case Order.JACOBIAN:
                text = jacobians.format(self.value.name)
            case Order.ADJOINT:
                text = f"{adjoint}, the sum over results of (d result / d input)^T {weight}"
            case Order.ADJOINT_JACOBIAN:
                text = jacobians.format(tape.function.to(Order.ADJOINT).name)
            case _:
                text = self.title
        return f"{name}: {text}" if text else name


@dataclass(frozen=True)
class Slot:
    """One argument of a face."""

    port: Port
    sparsity: Sparsity
    differentiable: bool

    @property
    def name(self) -> str:
        """Name the argument."""
        return self.port.name


@dataclass(frozen=True)
class Face:
    """A kernel with its arguments as CasADi counts them."""

    family: Family
    kernel: str  # "jac_impl"
    symbol: str  # "jac_arm_impl"
    function: str  # "arm_compute_jac_impl": the typed C function
    tape: Computation
    inputs: tuple[Slot, ...]
    outputs: tuple[Slot, ...]

    @property
    def procedure(self) -> Procedure:
        """Return the stages in which the kernel is to be written."""
        return self.family.staged.get(self.tape.name) or as_procedure(self.tape)

    @property
    def counts(self) -> Counts:
        """Return the counts of the operations."""
        return count(self.procedure)


def arguments(tape: Computation) -> list[Input | Output | Wire]:
    """List a function's inputs, then its results."""
    return [*tape.inputs, *tape.outputs]


def faces(family: Family, prefix: str) -> tuple[Face, ...]:
    """List the faces of a function and its derivatives, the function's own first."""
    value = family.value
    own = tuple(Slot(i.port, i.sparsity, _is_differentiable(family, i)) for i in value.inputs)
    out = tuple(_unneeded(o) for o in value.outputs)
    adj = tuple(Slot(seed_port(o.port), o.sparsity, True) for o in value.outputs)
    found = [_face(family, prefix, value, own, tuple(Slot(o.port, o.sparsity, True) for o in value.outputs))]
    if family.jac:
        found.append(_face(family, prefix, family.jac, own + out, _blocks(family.jac, value.outputs, own)))
    if family.adj1:
        gradient = tuple(_slot(family.adj1, adjoint_port(s.port), s.sparsity) for s in own)
        found.append(_face(family, prefix, family.adj1, own + out + adj, gradient))
        if family.jac_adj1:
            inputs = own + out + adj
            unneeded = tuple(map(_unneeded, gradient))
            blocks = _blocks(family.jac_adj1, gradient, inputs)
            found.append(_face(family, prefix, family.jac_adj1, inputs + unneeded, blocks))
    return tuple(found)


def _face(family: Family, prefix: str, tape: Computation, inputs: tuple[Slot, ...], outputs: tuple[Slot, ...]) -> Face:
    held = {slot.name for slot in (*inputs, *outputs) if slot.sparsity.nnz}
    missing = [x.name for x in arguments(tape) if x.sparsity.nnz and x.name not in held]
    assert not missing, f"{tape.name}: CasADi's contract has no place for {missing}"
    symbol, function = name_symbol(prefix, family, tape), name_function(prefix, tape.name)
    return Face(family, tape.name, symbol, function, tape, inputs, outputs)


def name_function(prefix: str, kernel: str) -> str:
    """Name the typed C function of a kernel."""
    return f"{prefix}_compute_{kernel}"


def name_symbol(prefix: str, family: Family, tape: Computation) -> str:
    """Name the function in CasADi's contract: CasADi puts the order before its name, as in `jac_arm_f`."""
    own = f"{prefix}_{family.value.name}"
    return own if tape is family.value else name_kernel(own, tape.function.order)


def _is_differentiable(family: Family, source: Input | Wire) -> bool:
    """Return whether the derivatives include the input; a function without derivatives claims all, so that CasADi
    fails.
    """
    if family.adj1:
        return any(o.port.by == source.port for o in family.adj1.outputs)
    if family.jac:
        return any(o.port.by == source.port for o in family.jac.outputs)
    return True


def _blocks(tape: Computation, rows: Sequence[Output | Wire | Slot], cols: tuple[Slot, ...]) -> tuple[Slot, ...]:
    return tuple(
        _slot(tape, derivative_port(o.port, i.port), Sparsity.of(_numel(o.sparsity), _numel(i.sparsity), ()))
        for o in rows
        for i in cols
    )


def _slot(tape: Computation, port: Port, shape: Sparsity) -> Slot:
    """Make the slot of a result: with the tape's pattern, or empty where the tape has no such result."""
    for output in tape.outputs:
        if output.port == port:
            is_same = (output.sparsity.rows, output.sparsity.cols) == (shape.rows, shape.cols)
            assert is_same, f"{port.name} has another shape"
            return Slot(port, output.sparsity, True)
    return _empty(port, shape)


def _unneeded(result: Output | Wire | Slot) -> Slot:
    """Make the slot of a result among the inputs of a derivative, which does not use it."""
    return _empty(replace(result.port, name=name_unneeded(result.port.name)), result.sparsity)


def _empty(port: Port, shape: Sparsity) -> Slot:
    return Slot(port, Sparsity.of(shape.rows, shape.cols, ()), False)


def _numel(sparsity: Sparsity) -> int:
    return sparsity.rows * sparsity.cols
