"""Verify families before they are written: values against the textbook and geometry, derivatives against differences.

Everything is computed in 50 digits. There, equal results differ by rounding far below the tolerance, and the tolerance
is far below any fault. A function that is wrong anywhere is wrong at almost every state, so two states are enough.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from itertools import islice

from mbsgen.errors import MbsError
from mbsgen.formulations import ports
from mbsgen.model.tree import Tree
from mbsgen.procedure.procedure import Computation, evaluate
from mbsgen.roles import Order, Role
from mbsgen.tape.interpreter import DECIMALS, fifty_digits
from mbsgen.tape.ports import Port
from mbsgen.tape.rounding import UNIT
from mbsgen.targets.contract import Family
from mbsgen.verification.derivatives import compare_derivatives, compare_linearised
from mbsgen.verification.functions import Comparison, Results, Truth, grow_energy, list_expectations, write_equations
from mbsgen.verification.states import (
    Numbers,
    State,
    draw_start,
    draw_states,
    draw_states_nearby,
    has_own_states,
)

STATES = 2  # with parameters at their values, and near them
ROUNDOFF = Decimal(2) ** -53  # of doubles; mbs_check.c has the same
TRIED = 8  # states, where force laws have no value at some
TOLERANCE = Decimal("1e-20")  # rounding is 1e-45, differences err by 1e-30; faults change leading digits


class VerificationError(MbsError):
    """A function that does not compute the equations of its mechanism: a fault of this program."""


@dataclass(frozen=True)
class Verification:
    """The comparisons that were made, and their largest deviations."""

    states: int
    deviations: Mapping[str, float]  # by kernel: the largest, relative
    unchecked: tuple[str, ...]  # kernels that were not compared
    references: Mapping[str, tuple[float, ...]]  # results of functions at the first state of the check program


def verify(tree: Tree, families: Sequence[Family], *, still: bool) -> Verification:
    """Compare all functions of a tree. Raises VerificationError for the first that differs.

    still: velocities are zero, and no input.
    """
    with fifty_digits():
        return _Verifier(tree, families, still=still).run()


class _Verifier:
    def __init__(self, tree: Tree, families: Sequence[Family], *, still: bool) -> None:
        self.tree, self.families, self.still = tree, families, still
        self.by_name = {family.value.name: family for family in families}
        self.deviations: dict[str, float] = {}
        self.references: dict[str, tuple[float, ...]] = {}

    def run(self) -> Verification:
        equations = write_equations(self.tree)
        drawn = [draw_states(self.tree, still=self.still)]
        if self.tree.constraints:
            drawn.append(draw_states_nearby(self.tree, still=self.still))
        tried = (Truth(self.tree, equations, x) for states in drawn for x in islice(states, TRIED))
        truths = list(islice((truth for truth in tried if truth.is_finite), STATES))
        for truth in truths:
            self._compare_values(truth)
        for truth in truths[:1]:
            self._compare_derivatives(truth.state)
        kernels = [f.name for family in self.families for f in family.functions if not f.giving(Role.SETUP)]
        unchecked = tuple(name for name in kernels if name not in self.deviations)
        return Verification(len(truths), self.deviations, unchecked, self.references)

    def _compare_values(self, truth: Truth) -> None:
        for name, family in self.by_name.items():
            value, found = family.value, False
            expectations = list_expectations(value) if value.function.order is Order.VALUE else ()
            if not expectations or (_closes(value) and truth.state.number):  # other lengths may keep loops open
                continue
            results = evaluate(value, self._arguments(value, truth.state), DECIMALS)
            for expect in expectations:
                for comparison in expect(truth, value, results):
                    self._judge(name, comparison, truth.state)
                    found = True
            if {ports.KINETIC, ports.POTENTIAL} <= {o.port for o in value.outputs} and not self.still:
                self._judge(name, self._grow_energy(value, truth), truth.state)
            if (
                found
                and truth.state.number == 0
                and truth.state.coordinates is None
                and not (_closes(value) or _has_remainders(value))
            ):  # the check program starts at drawn numbers
                self._refer(value, results)

    def _refer(self, function: Computation, results: Results) -> None:
        if has_own_states(self.tree):
            return
        self.references[function.name] = tuple(float(x) for o in function.outputs for x in results[o.name])

    def _grow_energy(self, value: Computation, truth: Truth) -> Comparison:
        given = self._arguments(value, truth.state)
        return grow_energy(truth, lambda moved: evaluate(value, given | moved, DECIMALS))

    def _compare_derivatives(self, state: State) -> None:
        def arguments(tape: Computation) -> dict[str, Numbers]:
            return self._arguments(tape, state)

        for name, family in self.by_name.items():
            for kernel, comparison in compare_derivatives(family, arguments, state.sizes):
                self._judge(kernel, comparison, state)
            if state.number == 0 and state.coordinates is None and (self.tree.loops or self.tree.constraints):
                for derivative in family.functions[1:]:
                    if not _closes(derivative):  # the check program starts at drawn numbers
                        results = evaluate(derivative, arguments(derivative), DECIMALS)
                        self._refer(derivative, results)
            plain = self.by_name.get(family.value.function.base)
            if family.value.function.order is Order.LINEARISATION and plain is not None:
                for comparison in compare_linearised(family, plain, arguments, state.sizes):
                    self._judge(name, comparison, state)

    def _arguments(self, tape: Computation, state: State) -> dict[str, Numbers]:
        if _closes(tape):
            state = replace(state, coordinates=draw_start(self.tree))
        return {i.name: self._argument(i.port, i.sparsity.nnz, state) for i in tape.inputs}

    def _argument(self, port: Port, count: int, state: State) -> Numbers:
        if port.role is Role.REMAINDER:
            return [Decimal(0)] * count
        if port.role is Role.SETUP:
            return self._setup(state)
        if port == UNIT:
            return [ROUNDOFF]
        return state.take(ports.PARAMETERS.name if port.role is Role.PARAMETER else port.name, count)

    def _setup(self, state: State) -> Numbers:
        setup = next((family.value for family in self.families if family.value.giving(Role.SETUP)), None)
        if setup is None:  # no function depends on the parameters
            return []
        return evaluate(setup, self._arguments(setup, state), DECIMALS)[ports.SETUP.name]

    def _judge(self, kernel: str, comparison: Comparison, state: State) -> None:
        deviation = comparison.deviation
        if not deviation <= TOLERANCE:
            raise VerificationError(
                f"{self.tree.name}: {kernel}: {comparison.of} differs by {deviation:.1e} of its size from the "
                f"mechanism's equations (state {state.number}); nothing is written. This is a fault of mbsgen: please "
                "report it with the model"
            )
        self.deviations[kernel] = max(self.deviations.get(kernel, 0.0), float(deviation))


def _has_remainders(function: Computation) -> bool:
    """Return whether numbers have a second part, which the check program would draw as large as the first."""
    return any(i.port.role is Role.REMAINDER for i in function.inputs)


def _closes(function: Computation) -> bool:
    """Return whether a function closes loops, or is a derivative of one that does: it needs a start near a pose."""
    return any(ports.CLOSED in (x.port, x.port.of) for x in (*function.inputs, *function.outputs))
