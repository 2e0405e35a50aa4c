"""Derivatives of the formulations, each in the way with the fewest flops: by tape, by recursion, by implication.

`impl` and `semi_res` are two forms of one function, so the cheapest derivatives of one serve both. So are `exp1` and
`exp2`, except for their guards; in larger trees, only one way is written, and only once. The flops of each way that is
written are counted for the report.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, TypeVar

from mbsgen.derivatives import implicit, kernels, recursion
from mbsgen.derivatives.implicit import Constraints
from mbsgen.derivatives.kernels import Derivatives, differentiable
from mbsgen.derivatives.looped import LoopedAccelerations, LoopedResidual
from mbsgen.derivatives.vanishing import drop_vanishing, find_patterns, narrow
from mbsgen.formulations import catalogue, coupling, ports
from mbsgen.formulations.multipliers import list_owners
from mbsgen.formulations.planning import finish, take_factors, write_sums, write_sums_again
from mbsgen.formulations.reductions import Reductions
from mbsgen.formulations.tables import can_loop
from mbsgen.model.tree import Kind, Tree
from mbsgen.procedure.fusion import drop_dead as drop_dead_stages
from mbsgen.procedure.procedure import Computation, Procedure, straight
from mbsgen.procedure.procedure import count as count_stages
from mbsgen.request import MEASURED, CodeSize
from mbsgen.roles import Order, Role
from mbsgen.tape import reverse
from mbsgen.tape.counts import count_paper
from mbsgen.tape.passes import keep_results
from mbsgen.tape.ports import Function
from mbsgen.tape.types import Sparsity, Tape

C = TypeVar("C", bound=Computation, covariant=True)
Ways = Mapping[str, Callable[[], Tape]]  # by name: `tape`, `recursion` or `implicit`


class Dynamics:
    """The derivatives of a tree's formulations.

    With `staged`, Jacobians that are large enough for a loop are written in stages alone, and not straight as well.
    With `counted`, all ways are written for their counts, also ways that always lose at this size.
    """

    def __init__(
        self,
        tree: Tree,
        reductions: Reductions,
        *,
        staged: bool = False,
        size: CodeSize = MEASURED,
        counted: bool = False,
    ) -> None:
        is_compared = len(tree.bodies) <= size.compared or _is_strange(tree)
        staged, counted = staged and not is_compared, counted or len(tree.bodies) <= size.few
        self._choice = _Choice(reductions, is_compared=is_compared, staged=staged, size=size, counted=counted)
        self._tree, self._reductions = tree, reductions
        self._is_looped = staged and can_loop(tree, size.looped)

    def differentiate(self, tape: Tape, before: Sequence[Derivatives] = ()) -> Derivatives:
        """Differentiate a form of the equations of motion by all its inputs but parameters.

        `before` holds the derivatives of other forms: what they share is not written again.
        """
        if any(o.port in implicit.UNKNOWNS for o in tape.outputs):
            if self._is_looped:
                return LoopedAccelerations(tape, self._tree, self._reductions, lambda: self._of_accelerations(tape, ()))
            return self._of_accelerations(tape, before)
        if self._is_looped:
            return LoopedResidual(tape, self._tree, self._reductions, lambda: self._of_residual(tape))
        return self._of_residual(tape)

    def _of_residual(self, tape: Tape) -> Derivatives:
        return self._residual if tape.function == self._residual.tape.function else _Renamed(tape, self._residual)

    def _of_accelerations(self, tape: Tape, before: Sequence[Derivatives]) -> Derivatives:
        first = next((found for found in before if isinstance(found, _OfAccelerations)), None)
        return _OfAccelerations(tape, self._residual, self._choice_of_accelerations, first, self._restrain(tape))

    @cached_property
    def _residual(self) -> _OfResidual:
        return _OfResidual(self._tree, self._reductions, self._choice)

    @property
    def _choice_of_accelerations(self) -> _Choice:
        """Return the choice for the accelerations; with loops, the tape's own derivatives soon take far too long."""
        if not self._tree.is_constrained:
            return self._choice
        return replace(self._choice, is_compared=len(self._tree.bodies) <= self._choice.size.compared)

    def _restrain(self, tape: Tape) -> Constraints | None:
        """Return the equations that a form of the accelerations keeps besides the residual's."""
        tree = self._tree
        if not tree.is_constrained:
            return None
        unrestrained = coupling.write_unrestrained(tape.function.base, tree, self._reductions)
        guards = coupling.write_guards(tree)
        return Constraints(self._closure, len(tree.driven), list_owners(tree), guards, unrestrained)

    @cached_property
    def _closure(self) -> Derivatives | None:
        """Return the derivatives of the accelerations at which loops open."""
        if not (self._tree.loops or self._tree.constraints):
            return None
        tape = straight(catalogue.FUNCTIONS["loop_accelerations"].build(self._tree, self._reductions))
        return kernels.differentiate(tape, differentiable(tape))


def _is_strange(tree: Tree) -> bool:
    """Return whether a tree has differentiated parameters or quaternions, which the recursions do not handle."""
    return bool(tree.quaternions) or any(parameter.kind is Kind.DIFFERENTIATED for parameter in tree.parameters)


@dataclass(frozen=True)
class Written(Generic[C]):
    """A derivative, and the flops of each way in which it was written; `whole` may have more results."""

    function: C
    ways: Mapping[str, int]
    whole: C


@dataclass(frozen=True)
class _Choice:
    """Writes derivatives in all ways, and keeps the one with the fewest flops."""

    reductions: Reductions
    is_compared: bool
    staged: bool
    size: CodeSize
    counted: bool  # the tape's own derivatives, however long
    twice: bool = False  # write sums once more

    def finish(self, tape: Tape) -> Tape:
        """Lower a finished tape's cost, by the reductions that are on."""
        return finish(tape, self.reductions)

    def among(self, tape: Tape, order: Order, ways: Ways, others: Ways) -> Written[Tape]:
        """Choose among `ways` and, where the tree and the tape are not too large for that, `others`."""
        may_win = len(tape.operations) <= self.size.tried or order is Order.ADJOINT or self.counted or not ways
        tried = {**ways, **others} if self.is_compared and may_win else ways
        written = {way: take_factors(write(), self.reductions) for way, write in tried.items()}
        if order is not Order.ADJOINT:  # the results of an adjoint stay dense
            written = {way: drop_vanishing(tape) for way, tape in written.items()}
        select = _leave_values_out if order is Order.JACOBIAN else _leave
        flops = {way: count_paper(select(tape)) for way, tape in written.items()}
        best = min(flops, key=flops.__getitem__)
        whole = write_sums(written[best], self.reductions)
        whole = write_sums_again(whole, self.reductions) if self.twice else whole
        found = select(whole)
        return Written(found, flops | {best: count_paper(found)}, whole)


def _leave(tape: Tape) -> Tape:
    return tape


def _without_choice(way: str, tape: Tape) -> Written[Tape]:
    """Count a derivative that is a part of another one, or renamed."""
    return Written(tape, {way: count_paper(tape)}, tape)


class _Chosen(Derivatives, ABC):
    """Derivatives that are written in several ways, of which one is kept."""

    @cached_property
    @abstractmethod
    def written_jac(self) -> Written[Tape] | Written[Computation]:
        """Write the Jacobian."""

    @cached_property
    @abstractmethod
    def written_lin(self) -> Written[Tape] | Written[Computation]:
        """Write the linearisation."""

    @cached_property
    @abstractmethod
    def written_adj1(self) -> Written[Tape]:
        """Write the adjoint."""

    @cached_property
    @abstractmethod
    def written_jac_adj1(self) -> Written[Tape]:
        """Write the Jacobian of the adjoint."""

    @cached_property
    def jac(self) -> Computation:
        return self.written_jac.function

    @cached_property
    def lin(self) -> Computation:
        return self.written_lin.function

    @cached_property
    def adj1(self) -> Tape:
        return self.written_adj1.function

    @cached_property
    def jac_adj1(self) -> Tape:
        return self.written_jac_adj1.function

    def count_ways(self, orders: Iterable[Order]) -> Mapping[str, Mapping[str, int]]:
        found = [self._find(order) for order in orders]
        return {written.function.name: written.ways for written in found}

    def _find(self, order: Order) -> Written[Tape] | Written[Computation]:
        match order:
            case Order.JACOBIAN:
                return self.written_jac
            case Order.LINEARISATION:
                return self.written_lin
            case Order.ADJOINT:
                return self.written_adj1
            case _:
                return self.written_jac_adj1


class _OfResidual(_Chosen):
    def __init__(self, tree: Tree, reductions: Reductions, choice: _Choice) -> None:
        tape = straight(catalogue.FUNCTIONS[catalogue.REFERENCE].build(tree, reductions))
        super().__init__(tape, differentiable(tape))
        self._tree, self._reductions = tree, reductions
        self._choice = replace(choice, twice=True)  # all other derivatives hold these

    def _by_recursion(self, write: Callable[[Tree, Reductions], Tape]) -> Ways:
        if _is_strange(self._tree):
            return {}
        if self._tree.couplings:
            return {"recursion": lambda: coupling.couple(write(self._tree.uncoupled, self._reductions), self._tree)}
        return {"recursion": lambda: write(self._tree, self._reductions)}

    @cached_property
    def written_jac(self) -> Written[Tape]:
        if not self._choice.is_compared:  # then all that it takes is in `lin`
            return _without_choice("recursion", _leave_values_out(straight(self.lin)))
        return self._choice.among(
            self.tape,
            Order.JACOBIAN,
            self._by_recursion(recursion.expansion),
            {"tape": lambda: kernels.jacobian(self.tape, self.wrt)},
        )

    @property
    def bias(self) -> Tape:
        """The tape of the Jacobian, where it holds the residual, too: they share most of their operations."""
        written = self.written_jac.whole
        return written if any(o.port == ports.RESIDUAL for o in written.outputs) else self.tape

    @cached_property
    def written_lin(self) -> Written[Tape]:
        return self._choice.among(
            self.tape,
            Order.LINEARISATION,
            self._by_recursion(recursion.linearisation),
            {"tape": lambda: kernels.linearise(self.tape, straight(self.jac))},
        )

    @cached_property
    def written_adj1(self) -> Written[Tape]:
        return self._choice.among(self.tape, Order.ADJOINT, {"tape": lambda: reverse.adjoint(self.tape, self.wrt)}, {})

    @cached_property
    def written_jac_adj1(self) -> Written[Tape]:
        return self._choice.among(
            self.tape,
            Order.ADJOINT_JACOBIAN,
            self._by_recursion(recursion.adjoint_jacobian),
            {"tape": lambda: kernels.adjoint_jacobian(self.tape, self.adj1, self.wrt)},
        )


class _Renamed(Derivatives):
    """The derivatives of the residual, for another form of it."""

    def __init__(self, tape: Tape, residual: Derivatives) -> None:
        super().__init__(tape, residual.wrt)
        self._residual = residual

    def _rename(self, found: Tape) -> Tape:
        return replace(found, function=self.tape.function.to(found.function.order))

    @cached_property
    def jac(self) -> Tape:
        return self._rename(straight(self._residual.jac))

    @cached_property
    def lin(self) -> Tape:
        return self._rename(straight(self._residual.lin))

    @cached_property
    def adj1(self) -> Tape:
        return self._rename(straight(self._residual.adj1))

    @cached_property
    def jac_adj1(self) -> Tape:
        return self._rename(self._residual.jac_adj1)

    def count_ways(self, orders: Iterable[Order]) -> Mapping[str, Mapping[str, int]]:
        return self._residual.count_ways(orders)


class _OfAccelerations(_Chosen):
    """The derivatives of one form of the accelerations; `first` is the form that they were written for before.

    With loops or driven joints, they are written for each form, and not in stages.
    """

    def __init__(
        self,
        tape: Tape,
        residual: Derivatives,
        choice: _Choice,
        first: _OfAccelerations | None,
        constraints: Constraints | None,
    ) -> None:
        super().__init__(tape, differentiable(tape))
        self._residual, self._choice, self._constraints = residual, choice, constraints
        self._first = None if choice.is_compared or constraints else first

    def _take(self, written: Tape) -> Tape:
        """Return the first form's derivative under this form's name: both eliminate in M, with the same guards."""
        return replace(written, function=self.tape.function.to(written.function.order))

    @cached_property
    def written_jac(self) -> Written[Tape] | Written[Computation]:
        function = self.tape.function.to(Order.JACOBIAN)
        if self._is_surely_long:
            return self._count_columns(self._write_staged(function, self._patterns))
        if not self._choice.is_compared:  # then all that it takes is in `lin`
            return _without_choice("implicit", _leave_values_out(straight(self.lin)))
        return self._choice.among(
            self.tape,
            Order.JACOBIAN,
            {"implicit": lambda: implicit.jacobian(self.tape, self._residual, self.wrt, self._constraints)},
            {"tape": lambda: kernels.jacobian(self.tape, self.wrt)},
        )

    @cached_property
    def written_lin(self) -> Written[Tape] | Written[Computation]:
        function = self.tape.function.to(Order.LINEARISATION)
        if self._is_surely_long:
            return self._count_columns(self._write_staged(function, self._patterns))
        if self._first:
            return _without_choice("implicit", self._take(straight(self._first.lin)))
        return self._choice.among(
            self.tape,
            Order.LINEARISATION,
            {"implicit": lambda: implicit.linearisation(self.tape, self._residual, self.wrt, self._constraints)},
            {"tape": lambda: kernels.linearise(self.tape, straight(self.jac))},
        )

    @cached_property
    def staged(self) -> Mapping[str, Procedure]:
        """Write large derivatives once more, in stages."""
        if self._constraints:
            return {}
        limit = self._choice.size.straight
        large = [x for x in (self.jac, self.lin) if isinstance(x, Tape) and len(x.operations) > limit]
        return {x.name: self._write_staged(x.function, {o.name: o.sparsity for o in x.outputs}) for x in large}

    @cached_property
    def _columns(self) -> Procedure:
        """Write the accelerations and their Jacobian, with columns that are solved for in a loop."""
        if self._first:
            taken = self._take(self._first._columns.stages[0].tapes[0])
            function = self.tape.function.to(Order.LINEARISATION)
            own = replace(taken, function=Function(f"columns_{function.name}"))
            return self._first._columns.rewrite(lambda _: own, function)
        return implicit.columns(self.tape, self._residual, self.wrt).rewrite(self._choice.finish)

    @cached_property
    def _is_surely_long(self) -> bool:
        """Return whether the straight code, before it is written, would only be looked at for its patterns."""
        if not self._choice.staged or self._constraints:
            return False
        nothing = {name: Sparsity.of(x.rows, x.cols, ()) for name, x in self._blocks.items()}
        return count_stages(narrow(self._columns, nothing)).paper > self._choice.size.certain

    @property
    def _blocks(self) -> Mapping[str, Sparsity]:
        return {wire.name: wire.sparsity for wire in self._columns.outputs if wire.port.role is Role.DERIVATIVE}

    @cached_property
    def _patterns(self) -> Mapping[str, Sparsity]:
        return self._first._patterns if self._first else find_patterns(self._columns)

    def _write_staged(self, function: Function, patterns: Mapping[str, Sparsity]) -> Procedure:
        """Leave of the columns what a function gives."""
        found = narrow(self._columns, patterns).rewrite(
            lambda tape: replace(tape, function=Function(f"columns_{function.name}")), function
        )
        if function.order is Order.LINEARISATION:
            return found
        blocks = tuple(wire for wire in found.outputs if wire.port.role is Role.DERIVATIVE)
        return drop_dead_stages(replace(found, outputs=blocks))

    def _count_columns(self, written: Procedure) -> Written[Computation]:
        """Count the Jacobian with the accelerations."""
        return Written(written, {"implicit": count_stages(narrow(self._columns, self._patterns)).paper}, written)

    @cached_property
    def written_adj1(self) -> Written[Tape]:
        if self._first:
            return _without_choice("implicit", self._take(self._first.adj1))
        return self._choice.among(
            self.tape,
            Order.ADJOINT,
            {"implicit": lambda: implicit.adjoint(self.tape, self._residual, self.wrt, self._constraints)},
            {"tape": lambda: reverse.adjoint(self.tape, self.wrt)},
        )

    @cached_property
    def written_jac_adj1(self) -> Written[Tape]:
        if self._first:
            return _without_choice("implicit", self._take(self._first.jac_adj1))
        by_tape = Derivatives(self.tape, self.wrt)
        return self._choice.among(
            self.tape,
            Order.ADJOINT_JACOBIAN,
            {"implicit": lambda: implicit.adjoint_jacobian(self.tape, self._residual, self.wrt, self._constraints)},
            {"tape": lambda: by_tape.jac_adj1},
        )

    def count_ways(self, orders: Iterable[Order]) -> Mapping[str, Mapping[str, int]]:
        """Count these derivatives, and the residual's derivatives in them."""
        orders = tuple(orders)
        used = dict.fromkeys((Order.JACOBIAN, *(order for order in orders if order is not Order.LINEARISATION)))
        return {**self._residual.count_ways(used), **super().count_ways(orders)}


def _leave_values_out(lin: Tape) -> Tape:
    """Return the Jacobian alone of a function with its Jacobian."""
    blocks = {o.name for o in lin.outputs if o.port.role is Role.DERIVATIVE}
    return replace(keep_results(lin, blocks), function=lin.function.to(Order.JACOBIAN))
