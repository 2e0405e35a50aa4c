"""The derivative tapes of a function: `jac_`, `adj1_` and `jac_adj1_`, in the way with the fewest flops."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property

from mbsgen.derivatives.vanishing import drop_vanishing
from mbsgen.procedure.procedure import Computation, Procedure, straight
from mbsgen.roles import Order, Role
from mbsgen.tape import forward, reverse
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.counts import count_paper
from mbsgen.tape.passes import merge
from mbsgen.tape.ports import derivative_port
from mbsgen.tape.replay import declare_inputs, replay, replay_guards
from mbsgen.tape.types import Output, Tape


class Derivatives:
    """The derivatives of one tape f by chosen inputs; each is written on first use."""

    def __init__(self, tape: Tape, wrt: Sequence[str]) -> None:
        self.tape, self.wrt = tape, tuple(wrt)

    @cached_property
    def jac(self) -> Computation:
        """`jac_f`: blocks jac_<out>_<in>."""
        return jacobian(self.tape, self.wrt)

    @cached_property
    def lin(self) -> Computation:
        """`lin_f`: the outputs of f and of jac_f."""
        return linearise(self.tape, straight(self.jac))

    @property
    def bias(self) -> Tape:
        """The tape to take f from where accelerations are 0, beside `jac_f`."""
        return self.tape

    @cached_property
    def staged(self) -> Mapping[str, Procedure]:
        """Return, by name, the derivatives that are also written in stages, as shorter code."""
        return {}

    @cached_property
    def adj1(self) -> Computation:
        """`adj1_f`: adj_<in> = sum over outputs of (d out / d in)T adj_<out>."""
        return reverse.adjoint(self.tape, self.wrt)

    @cached_property
    def jac_adj1(self) -> Tape:
        """`jac_adj1_f`: blocks jac_adj_<in>_<in> and jac_adj_<in>_adj_<out>."""
        return adjoint_jacobian(self.tape, straight(self.adj1), self.wrt)

    def count_ways(self, orders: Iterable[Order]) -> Mapping[str, Mapping[str, int]]:  # noqa: ARG002  # of a subclass
        """Return, by kernel, the flops of derivatives by each way of writing them; empty where there is one way."""
        return {}


def differentiable(tape: Tape) -> list[str]:
    """Return the inputs by which a tape is differentiated: all except parameters."""
    return [i.name for i in tape.inputs if i.port.role.is_differentiated]


def differentiate(tape: Tape, wrt: Sequence[str]) -> Derivatives:
    """Differentiate `tape` by the inputs `wrt`, operation by operation."""
    return Derivatives(tape, wrt)


def linearise(tape: Tape, jac: Tape) -> Tape:
    """Write `lin_<name>`: a function and its Jacobians at one state; shared operations are computed once."""
    return merge((tape, jac), tape.function.to(Order.LINEARISATION))


def jacobian(tape: Tape, wrt: Sequence[str]) -> Tape:
    """Write `jac_<name>`, forward or in reverse, whichever takes fewer flops."""
    found = min(
        (forward.jacobian(tape, wrt), reverse.jacobian(tape, wrt)),
        key=count_paper,
    )
    return drop_vanishing(found)


def adjoint_jacobian(tape: Tape, adj1: Tape, wrt: Sequence[str]) -> Tape:
    """Write `jac_adj1_<name>` from the adjoint, forward; of its symmetric second derivatives, one triangle."""
    builder = Builder()
    values = replay(adj1, builder, declare_inputs(adj1, builder))
    replay_guards(adj1, builder, values)
    seeds = [i for i in adj1.inputs if i.port.role is Role.SEED]
    adjoints = {o.port.by.name: o for o in adj1.outputs if o.port.by}
    gradients = forward.propagate(adj1, builder, values, (*wrt, *(seed.name for seed in seeds)))
    order = {name: k for k, name in enumerate(wrt)}
    hessian = _Hessian(adj1, adjoints, builder, wrt, gradients)
    for row in wrt:
        for col in wrt:
            hessian.write(row, col, upper=order[row] < order[col])
        for seed in seeds:
            forward.write_block(builder, adj1, adjoints[row], seed, gradients)
    return drop_vanishing(builder.build(tape.function.to(Order.ADJOINT_JACOBIAN)))


class _Hessian:
    """Blocks of the symmetric second derivative, each entry taken from the lower triangle."""

    def __init__(
        self,
        adj1: Tape,
        adjoints: Mapping[str, Output],
        builder: Builder,
        wrt: Sequence[str],
        gradients: Sequence[forward.Gradient],
    ) -> None:
        self._builder, self._adjoints = builder, {name: o.port for name, o in adjoints.items()}
        self._inputs = {name: adj1.input(name).port for name in wrt}
        self._sizes = {name: adj1.input(name).sparsity.nnz for name in wrt}
        first, offsets = 0, {}
        for i in adj1.inputs:
            offsets[i.name] = first
            first += i.sparsity.nnz
        self._rows = {
            name: [
                {
                    (other, column - offsets[other]): derivative
                    for other in wrt
                    for column, derivative in gradients[value].items()
                    if offsets[other] <= column < offsets[other] + self._sizes[other]
                }
                for value in adjoints[name].values
            ]
            for name in wrt
        }

    def write(self, row: str, col: str, *, upper: bool) -> None:
        """Declare the derivative of the adjoint by `row`, by the input `col`."""
        entries = {}
        for r in range(self._sizes[row]):
            for c in range(self._sizes[col]):
                mirrored = upper or (row == col and c > r)
                found = self._entry(col, c, row, r) if mirrored else self._entry(row, r, col, c)
                if found is not None:
                    entries[r, c] = found
        port = derivative_port(self._adjoints[row], self._inputs[col])
        self._builder.output_nonzeros(port, self._sizes[row], self._sizes[col], entries)

    def _entry(self, row: str, r: int, col: str, c: int) -> Scalar | None:
        """Return an entry of the lower triangle, unless its mirror image shows that it is zero."""
        own, mirror = self._rows[row][r].get((col, c)), self._rows[col][c].get((row, r))
        return own if mirror is not None else None
