"""Tables of stages: C computes from them what NumPy computes of the program that they were made of."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import sparse

from mbsgen.expressions import parse
from mbsrun.external import load_on_demand
from mbsrun.ocp.evaluation.stages import scripts
from mbsrun.ocp.evaluation.stages.binding import Evaluator, Tables
from mbsrun.ocp.evaluation.stages.building import build
from mbsrun.ocp.ground.functions import Formula, Input
from mbsrun.ocp.ground.program import Block, Program, Stages
from mbsrun.ocp.problem.problem import Form, Loops, Problem, Representation
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.ocp.transcription.transcription import transcribe
from tests.mbsrun.ocp.conftest import MODELS
from tests.mbsrun.ocp.stages.stage_functions import compare
from tests.mbsrun.peer import Peer, double_integrator


@pytest.fixture
def plant() -> Peer:
    return double_integrator()


EPSILON = np.finfo(np.float64).eps

# Each has parts that the others lack: closed loops in either form, input rates, a free horizon and expressions with
# kernels' results, quaternions, and forms without states at the points.
CASES = {
    "closed loops, reduced": ("five_bar_reach", {"loops": Loops.REDUCED}),
    "closed loops, multipliers": ("five_bar_reach", {"loops": Loops.MULTIPLIERS}),
    "expressions of positions": ("planar_arm_reach", {}),
    "free horizon, input rates": ("planar_arm_fastest", {"input_rates": 1.3}),
    "explicit": ("cart_pole_swing_up", {}),
    "quaternions": ("satellite_turn", {}),
    "integral": ("cart_pole_swing_up", {"form": Form.INTEGRAL, "representation": Representation.IMPL}),
    "shooting": (
        "cart_pole_swing_up",
        {"form": Form.SHOOTING, "representation": Representation.IMPL, "input_rates": 0.1},
    ),
    "an elastic tendon": ("moco/hanging", {}),
    "integral over Legendre points": ("cart_pole_balance", {"form": Form.INTEGRAL}),
}


def vary(problem: Problem, changes: dict[str, object]) -> Problem:
    """Change a problem; it has few intervals."""
    changes = {**changes}
    rates = changes.pop("input_rates", problem.cost.input_rates)
    return replace(problem, intervals=3, cost=replace(problem.cost, input_rates=rates), **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(("name", "changes"), CASES.values(), ids=CASES.keys())
def test_functions_of_stages_are_those_of_the_program(name: str, changes: dict[str, object]) -> None:
    """Values, Jacobian and Hessian at a random point, after lifted variables are eliminated."""
    problem, plant = read_problem(MODELS / f"{name}.ocp.yaml", load_on_demand)
    problem = vary(problem, changes)
    transcription = transcribe(problem, plant)
    program, rng = transcription.program, np.random.default_rng(0)
    least, most = transcription.constraint_bounds(problem)
    rows = np.ones(program.constraints, dtype=bool)
    rows[program.kept_rows] = np.isfinite(least) | np.isfinite(most)
    p = transcription.parameters(problem)
    data = build(program, plant, p[: len(program.H)] != 0, rows)
    x = rng.uniform(0.3, 1.0, program.variables)
    found = compare(Evaluator(Tables(data, plant), p), program, plant, x, p, rng)
    # sums of some hundred terms, products with the derivatives of lifted variables
    assert max(found.values, found.slopes, found.curvatures) < 1000 * EPSILON


def test_the_rate_of_an_elastic_tendon_is_an_inner_variable() -> None:
    """An equilibrium determines it at each point, so excitations alone are inputs, and no row of a stage is left."""
    problem, plant = read_problem(MODELS / "moco" / "hanging.ocp.yaml", load_on_demand)
    program = transcribe(replace(problem, intervals=3), plant).program
    assert program.stages is not None
    excitations = program.stages.inputs
    assert excitations.shape == (3, problem.degree)
    assert not np.intersect1d(excitations, program.stages.inner).size
    first, middle, _, last = (build(program, plant).kinds[kind] for kind in build(program, plant).kind_of_stage)
    assert (middle.nv - middle.inner, middle.ne - middle.inner, middle.ng) == (problem.degree, 0, 0)
    assert (first.nv - first.inner, last.nv) == (problem.degree, 0)


def test_a_function_may_read_one_variable_twice(plant: Peer) -> None:
    """x u + T x u, where both inputs of a product are the state, and T is a factor and an input."""
    T, inputs, nothing = 5, (Input("a", 1), Input("b", 1), Input("T", 1)), sparse.csc_array((6, 6))
    names = {part.kind: (part.kind, 0) for part in inputs}
    product = Formula((parse("a*b*T + a**2"), parse("a/b")), names, inputs)
    states, at, both = np.array([[0], [2], [4]]), np.arange(2), np.array([[0, 2]])
    columns = (both, both, np.full((1, 2), T))
    cost = Block(product, columns, np.zeros((2, 2), dtype=np.int64), at, factor=T)
    block = Block(product, columns, np.array([[0, 1], [2, 3]]), at, factor=T)
    A = sparse.coo_array(([1.0, -1, -1, 1, -1, -1], ([4, 4, 4, 5, 5, 5], [2, 0, 1, 4, 2, 3])), shape=(6, 6)).tocsc()
    stages = Stages(
        states=states,
        inputs=np.array([[1], [3]]),
        inner=np.zeros((2, 0, 0), dtype=np.int64),
        equations=np.zeros((2, 0, 0), dtype=np.int64),
        continuity=np.array([[4], [5]]),
        common=np.array([T]),
        rows=np.array([0, 1, 0, 1, 0, 1]),
    )
    program = Program(A, (nothing,), (block,), (cost,), stages=stages)
    rng, p = np.random.default_rng(0), np.array([0.7])
    x = rng.uniform(0.3, 1.0, 6)
    found = compare(Evaluator(Tables(build(program, plant), plant), p), program, plant, x, p, rng)
    assert max(found.values, found.slopes, found.curvatures) < 100 * EPSILON


def test_entries_that_lie_apart_are_copied_into_a_row() -> None:
    """A function reads its parameters one after the other: where they lie so, nothing is copied."""
    frame: Any = SimpleNamespace(parameters=9, given=0, numbers=0)
    stage: Any = SimpleNamespace(nx=0, nv=0)
    writer = scripts._Writer(stage, frame)
    assert writer.gather(np.array([3, 4, 5])) == 3
    assert (writer.start, writer.terms[scripts.ARGUMENTS]) == ([], [])
    for entries in ([3, 5], [5, 4], [2, 3, 5]):
        at = writer.gather(np.array(entries))
        to, source, factor, _ = writer.terms[scripts.ARGUMENTS][-1]
        assert (to.tolist(), source.tolist()) == ([*range(at, at + len(entries))], entries)
        assert (factor == 1).all()
