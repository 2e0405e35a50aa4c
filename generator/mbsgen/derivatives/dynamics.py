"""Derivatives of the formulations, each in the way that takes the fewest flops: by tape, by recursion, by implication.

`impl` and `semi_res` are one function, written twice, and so are `exp1` and `exp2`: what is cheapest for one is taken
for the other. How many flops each way takes is kept for the report.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property

from mbsgen.derivatives import implicit, kernels, recursion, reverse
from mbsgen.derivatives.kernels import Derivatives, differentiable
from mbsgen.derivatives.vanishing import drop_vanishing
from mbsgen.formulations import impl
from mbsgen.formulations.planning import finish
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.tree import Kind, Tree
from mbsgen.tape.columns import Columns
from mbsgen.tape.counts import count
from mbsgen.tape.types import Tape

ACCELERATIONS = ("exp1", "exp2")
# Operations from which on columns are looped over. A Panda's Jacobian of EXP1 (4700 operations) takes 0.47 us straight
# and 0.62 with a loop, a quadruped's (20,000) 3.4 and 3.2, a humanoid's (110,000) 24 and 20.
STRAIGHT = 16_000
COMPARED = 12  # bodies: in larger trees, only the way that always won is written

Ways = Mapping[str, Callable[[], Tape]]  # by name: `tape`, `recursion` or `implicit`


class Dynamics:
    """The derivatives of a tree's formulations."""

    def __init__(self, tree: Tree, reductions: Reductions) -> None:
        self._choice = _Choice(reductions, is_compared=len(tree.bodies) <= COMPARED or _is_strange(tree))
        self._residual = _OfResidual(tree, reductions, self._choice)

    def differentiate(self, tape: Tape) -> Derivatives:
        """Differentiate a formulation by all its inputs but parameters."""
        if tape.name in ACCELERATIONS:
            return _OfAccelerations(tape, self._residual, self._choice)
        return self._residual if tape.name == "impl" else _Renamed(tape, self._residual)

    @property
    def flops(self) -> Mapping[str, Mapping[str, int]]:
        """Tell what each derivative that was asked for takes by each way, by the paper's convention."""
        return self._choice.flops


def _is_strange(tree: Tree) -> bool:
    """Tell whether a tree has differentiated parameters or quaternions, of which the recursions know nothing."""
    return bool(tree.quaternions) or any(parameter.kind is Kind.DIFFERENTIATED for parameter in tree.parameters)


class _Choice:
    """Writes derivatives in all ways, and keeps the one with the fewest flops."""

    def __init__(self, reductions: Reductions, *, is_compared: bool) -> None:
        self._reductions, self._is_compared = reductions, is_compared
        self.flops: dict[str, dict[str, int]] = {}

    def finish(self, tape: Tape) -> Tape:
        """Lower a finished tape's cost by what is wanted for that."""
        return finish(tape, self._reductions)

    def among(self, name: str, ways: Ways, others: Ways) -> Tape:
        """Choose among `ways` and, in trees that are not too large for that, `others`."""
        tried = {**ways, **others} if self._is_compared else ways
        written = {way: self.finish(write()) for way, write in tried.items()}
        if not name.startswith("adj1_"):  # the results of an adjoint stay dense
            written = {way: drop_vanishing(tape) for way, tape in written.items()}
        self.flops[name] = {way: count(tape).paper for way, tape in written.items()}
        return min(written.values(), key=lambda tape: count(tape).paper)


class _OfResidual(Derivatives):
    def __init__(self, tree: Tree, reductions: Reductions, choice: _Choice) -> None:
        tape = impl.build(tree, reductions)
        super().__init__(tape, differentiable(tape))
        self._tree, self._reductions, self._choice = tree, reductions, choice

    def _by_recursion(self, write: Callable[[Tree, Reductions], Tape]) -> Ways:
        return {} if _is_strange(self._tree) else {"recursion": lambda: write(self._tree, self._reductions)}

    @cached_property
    def jac(self) -> Tape:
        return self._choice.among(
            "jac_impl",
            self._by_recursion(recursion.jacobian),
            {"tape": lambda: kernels.jacobian(self.tape, self.wrt)},
        )

    @cached_property
    def lin(self) -> Tape:
        return self._choice.among(
            "lin_impl",
            self._by_recursion(recursion.linearisation),
            {"tape": lambda: kernels.linearise(self.tape, self.jac)},
        )

    @cached_property
    def adj1(self) -> Tape:
        return self._choice.among("adj1_impl", {"tape": lambda: reverse.adjoint(self.tape, self.wrt, "adj1_impl")}, {})

    @cached_property
    def jac_adj1(self) -> Tape:
        return self._choice.among(
            "jac_adj1_impl",
            self._by_recursion(recursion.adjoint_jacobian),
            {"tape": lambda: kernels.adjoint_jacobian(self.tape, self.adj1, self.wrt)},
        )


class _Renamed(Derivatives):
    """The derivatives of the residual, for another form of it."""

    def __init__(self, tape: Tape, residual: Derivatives) -> None:
        super().__init__(tape, residual.wrt)
        self._residual = residual

    def _rename(self, found: Tape) -> Tape:
        return replace(found, name=found.name.replace(self._residual.tape.name, self.tape.name))

    @cached_property
    def jac(self) -> Tape:
        return self._rename(self._residual.jac)

    @cached_property
    def lin(self) -> Tape:
        return self._rename(self._residual.lin)

    @cached_property
    def adj1(self) -> Tape:
        return self._rename(self._residual.adj1)

    @cached_property
    def jac_adj1(self) -> Tape:
        return self._rename(self._residual.jac_adj1)


class _OfAccelerations(Derivatives):
    def __init__(self, tape: Tape, residual: Derivatives, choice: _Choice) -> None:
        super().__init__(tape, differentiable(tape))
        self._residual, self._choice = residual, choice

    @cached_property
    def jac(self) -> Tape:
        return self._choice.among(
            f"jac_{self.tape.name}",
            {"implicit": lambda: implicit.jacobian(self.tape, self._residual, self.wrt)},
            {"tape": lambda: kernels.jacobian(self.tape, self.wrt)},
        )

    @cached_property
    def lin(self) -> Tape:
        return self._choice.among(
            f"lin_{self.tape.name}",
            {"implicit": lambda: implicit.linearisation(self.tape, self._residual, self.wrt)},
            {"tape": lambda: kernels.linearise(self.tape, self.jac)},
        )

    @cached_property
    def loops(self) -> Mapping[str, Columns]:
        """Write those that are large once more, with a loop."""
        return {
            written.name: self._loop(with_value=written is self.lin)
            for written in (self.jac, self.lin)
            if len(written.operations) > STRAIGHT
        }

    def _loop(self, *, with_value: bool) -> Columns:
        found = implicit.columns(self.tape, self._residual, self.wrt, with_value=with_value)
        return replace(found, tape=self._choice.finish(found.tape))

    @cached_property
    def adj1(self) -> Tape:
        name = f"adj1_{self.tape.name}"
        return self._choice.among(
            name,
            {"implicit": lambda: implicit.adjoint(self.tape, self._residual, self.wrt)},
            {"tape": lambda: reverse.adjoint(self.tape, self.wrt, name)},
        )

    @cached_property
    def jac_adj1(self) -> Tape:
        by_tape = Derivatives(self.tape, self.wrt)
        return self._choice.among(
            f"jac_adj1_{self.tape.name}",
            {"implicit": lambda: implicit.adjoint_jacobian(self.tape, self._residual, self.wrt)},
            {"tape": lambda: by_tape.jac_adj1},
        )
