"""Derivatives of stages, in 50 digits: against central differences, first and second; adjoints against Jacobians."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from mbsgen.errors import TapeError
from mbsgen.procedure.differentiation import adjoint, jacobian
from mbsgen.procedure.newton import Newton
from mbsgen.procedure.procedure import Procedure, count, evaluate
from mbsgen.procedure.solve import Block, Factor, Solve
from mbsgen.procedure.straight import Straight
from mbsgen.procedure.wires import Wire
from mbsgen.tape import forward, reverse
from mbsgen.tape.counts import count as count_tape
from mbsgen.tape.interpreter import DIGITS
from mbsgen.tape.ports import Function
from mbsgen.tape.types import Sparsity
from tests.mbsgen.procedure.examples import EXAMPLES, POINT, TREE, Q, convert, solve, straight

Values = dict[str, list[Any]]
STEP = DIGITS.literal("1e-15")
ROUNDING = 1e-26  # a central difference is off by STEP squared, 1e-30, times third derivatives


def differences(procedure: Procedure, point: Values, x: str, k: int) -> Values:
    """Differentiate all results by one entry, nonzero by nonzero."""
    ends = []
    for step in (STEP, -STEP):
        moved = {name: [*values] for name, values in point.items()}
        moved[x][k] += step
        ends.append(evaluate(procedure, moved, DIGITS))
    return {name: [(a - b) / (2 * STEP) for a, b in zip(ends[0][name], ends[1][name], strict=True)] for name in ends[0]}


def compare(procedure: Procedure, derived: Procedure, point: Values, wrt: Sequence[str]) -> None:
    """Hold the Jacobian `derived` against differences of `procedure`; entries that are left out are zero."""
    found = evaluate(derived, point, DIGITS)
    blocks = {wire.name: dict(zip(wire.sparsity.entries, found[wire.name], strict=True)) for wire in derived.outputs}
    for x in wrt:
        for k, place in enumerate(procedure.input(x).places):
            slopes = differences(procedure, point, x, k)
            for output in procedure.outputs:
                block = blocks.get(f"jac_{output.name}_{x}", {})
                for row, slope in zip(output.places, slopes[output.name], strict=True):
                    assert abs(block.get((row, place), 0) - slope) < ROUNDING


@pytest.mark.parametrize("name", EXAMPLES)
def test_jacobians_are_differences(name: str) -> None:
    """Of every result by every input; also of a Jacobian."""
    example = EXAMPLES[name]
    point = convert(example.point, DIGITS)
    first = jacobian(example.procedure, example.wrt)
    compare(example.procedure, first, point, example.wrt)
    compare(first, jacobian(first, example.wrt[:1]), point, example.wrt[:1])


@pytest.mark.parametrize("name", EXAMPLES)
def test_adjoints_are_weighted_jacobians(name: str) -> None:
    """adj_x = J^T lambda; and its Jacobian, the second derivatives, against differences."""
    example = EXAMPLES[name]
    procedure, wrt = example.procedure, example.wrt
    seeds = {f"adj_{o.name}": [DIGITS.literal(0.3 + 0.4 * k) for k in range(o.sparsity.nnz)] for o in procedure.outputs}
    point = convert(example.point, DIGITS) | seeds
    back = adjoint(procedure, wrt)
    found, J = evaluate(back, point, DIGITS), jacobian(procedure, wrt)
    blocks = evaluate(J, point, DIGITS)
    for x in wrt:
        total = dict.fromkeys(procedure.input(x).places, DIGITS.literal(0))
        for o in procedure.outputs:
            weights = dict(zip(o.places, seeds[f"adj_{o.name}"], strict=True))
            for block in (wire for wire in J.outputs if wire.name == f"jac_{o.name}_{x}"):
                for (r, c), value in zip(block.sparsity.entries, blocks[block.name], strict=True):
                    total[c] += weights[r] * value
        assert max(abs(a - b) for a, b in zip(found[f"adj_{x}"], total.values(), strict=True)) < 1e-40
    compare(back, jacobian(back, [*wrt, *seeds]), point, [*wrt, *seeds])


def test_a_straight_procedure_has_the_derivatives_of_its_tape() -> None:
    """As many operations of each kind."""
    procedure = straight()
    (stage,) = procedure.stages
    assert isinstance(stage, Straight)
    derived, back = jacobian(procedure, ["x"]), adjoint(procedure, ["x"])
    assert count(derived).operations == count_tape(forward.jacobian(stage.tape, ["x"])).operations
    assert count(back).operations == count_tape(reverse.adjoint(stage.tape, ["x"])).operations


@pytest.mark.parametrize("name", [name for name in EXAMPLES if name != "newton"])
def test_no_factorisation_is_differentiated(name: str) -> None:
    """First and second derivatives solve by the factors of the function itself, which are computed once."""
    procedure, wrt = EXAMPLES[name].procedure, EXAMPLES[name].wrt
    back = adjoint(procedure, wrt)
    factors = sum(isinstance(stage, Factor) for stage in procedure.stages)
    for derived in (jacobian(procedure, wrt), back, jacobian(back, wrt)):
        assert sum(isinstance(stage, Factor) for stage in derived.stages) == factors


def test_no_iteration_is_differentiated() -> None:
    """Derivatives begin with the iteration of the function itself; its start has none."""
    procedure = EXAMPLES["newton"].procedure
    for derived in (jacobian(procedure, ["q", "start"]), adjoint(procedure, ["q", "start"])):
        assert [stage for stage in derived.stages if isinstance(stage, Newton)] == list(procedure.stages)
    assert [wire.name for wire in jacobian(procedure, ["q", "start"]).outputs] == ["jac_angles_q"]


def test_what_no_result_depends_on_is_left_out() -> None:
    """The Jacobian of one result by one input has no stage for the others."""
    before = solve(TREE)
    procedure = Procedure(Function("narrow"), before.inputs, before.stages, before.outputs[:1])
    assert len(jacobian(procedure, ["x"]).outputs) == 1
    still = Procedure(Function("still"), (*before.inputs, Q), before.stages, before.outputs)
    assert not jacobian(still, ["q"]).stages
    assert evaluate(adjoint(still, ["q"]), {**POINT, "q": [0.0], "adj_y": [1, 1], "adj_X0": [1] * 4}) == {
        "adj_q": [0.0]
    }


def test_a_solve_by_factors_of_no_known_matrix_is_not_differentiated() -> None:
    """Factors that come as inputs, or from a tape, belong to no matrix that could be differentiated."""
    factors, right = TREE.factors("M"), Wire("right", Sparsity.dense(1, 4))
    stage = Solve("S", TREE, factors, right, (Block(Wire("y", Sparsity.dense(4)), 0),))
    procedure = Procedure(Function("p"), (*factors, right), (stage,), stage.gives)
    with pytest.raises(TapeError, match="S cannot be differentiated: no stage factorises M_lower"):
        jacobian(procedure, ["right"])
