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
from mbsgen.model.tree import Tree
from mbsgen.tape.counts import count
from mbsgen.tape.types import Tape

RESIDUALS, ACCELERATIONS = ("impl", "semi_res"), ("exp1", "exp2")
COMPARED = 12  # bodies: in larger trees, only the way that always won is written

Ways = Mapping[str, Mapping[str, int]]  # of each derivative: flops, by the paper's convention, by the way


class Dynamics:
    """The derivatives of a tree's formulations; written when they are asked for."""

    def __init__(self, tree: Tree, reductions: Reductions) -> None:
        self._tree, self._reductions = tree, reductions
        self._is_compared = len(tree.bodies) <= COMPARED
        self.flops: dict[str, dict[str, int]] = {}

    def differentiate(self, tape: Tape) -> Derivatives:
        """Write the derivatives of a formulation, by all its inputs but parameters."""
        return self._differentiate_accelerations(tape) if tape.name in ACCELERATIONS else self._of_residual(tape)

    # -- residuals ----------------------------------------------------------------------------------------------

    @cached_property
    def _residual(self) -> tuple[Tape, Derivatives]:
        tape = impl.build(self._tree, self._reductions)
        wrt = differentiable(tape)
        jac = self._choose(
            "jac_impl",
            {"recursion": lambda: recursion.jacobian(self._tree, self._reductions)}
            | ({"tape": lambda: kernels.jacobian(tape, wrt)} if self._is_compared else {}),
        )
        lin = self._choose(
            "lin_impl",
            {
                "recursion": lambda: recursion.linearisation(self._tree, self._reductions),
                "tape": lambda: kernels.linearise(tape, jac),
            },
        )
        adj1 = self._choose("adj1_impl", {"tape": lambda: reverse.adjoint(tape, wrt, "adj1_impl")})
        jac_adj1 = self._choose(
            "jac_adj1_impl",
            {"recursion": lambda: recursion.adjoint_jacobian(self._tree, self._reductions)}
            | ({"tape": lambda: kernels.adjoint_jacobian(tape, adj1, wrt)} if self._is_compared else {}),
        )
        return tape, Derivatives(jac, lin, adj1, jac_adj1)

    def _of_residual(self, tape: Tape) -> Derivatives:
        _, found = self._residual

        def named(of_impl: Tape) -> Tape:
            return replace(of_impl, name=of_impl.name.replace("impl", tape.name))

        return Derivatives(*map(named, (found.jac, found.lin, found.adj1, found.jac_adj1)))

    # -- accelerations ------------------------------------------------------------------------------------------

    def _differentiate_accelerations(self, tape: Tape) -> Derivatives:
        value, found = self._residual
        residual = implicit.Residual(value, found.jac, found.adj1, found.jac_adj1)
        wrt, name = differentiable(tape), tape.name
        adj1_by_tape = reverse.adjoint(tape, wrt, f"adj1_{name}")

        def both(implied: Callable[[], Tape], by_tape: Callable[[], Tape]) -> dict[str, Callable[[], Tape]]:
            return {"implicit": implied} | ({"tape": by_tape} if self._is_compared else {})

        jac = self._choose(
            f"jac_{name}", both(lambda: implicit.jacobian(tape, residual, wrt), lambda: kernels.jacobian(tape, wrt))
        )
        lin = self._choose(
            f"lin_{name}",
            {
                "implicit": lambda: implicit.linearisation(tape, residual, wrt),
                "tape": lambda: kernels.linearise(tape, jac),
            },
        )
        return Derivatives(
            jac,
            lin,
            self._choose(f"adj1_{name}", both(lambda: implicit.adjoint(tape, residual, wrt), lambda: adj1_by_tape)),
            self._choose(
                f"jac_adj1_{name}",
                both(
                    lambda: implicit.adjoint_jacobian(tape, residual, wrt),
                    lambda: kernels.adjoint_jacobian(tape, adj1_by_tape, wrt),
                ),
            ),
        )

    def _choose(self, name: str, ways: Mapping[str, Callable[[], Tape]]) -> Tape:
        """Write a derivative in all ways, and keep the one with the fewest flops."""
        written = {way: finish(write(), self._reductions) for way, write in ways.items()}
        if not name.startswith("adj1_"):  # the results of an adjoint stay dense
            written = {way: drop_vanishing(tape) for way, tape in written.items()}
        self.flops[name] = {way: count(tape).paper for way, tape in written.items()}
        return min(written.values(), key=lambda tape: count(tape).paper)
