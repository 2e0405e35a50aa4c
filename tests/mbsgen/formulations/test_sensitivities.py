"""Sensitivities and curvatures: whatever a plan says, they are the derivatives of the textbook's residual."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mbsgen.derivatives import kernels
from mbsgen.formulations import textbook
from mbsgen.formulations.chain import write_chain
from mbsgen.formulations.parsimony.curvatures import curvatures
from mbsgen.formulations.parsimony.mass_matrix import Entries
from mbsgen.formulations.parsimony.plan import Choice, Mass, Meeting, NoSuchPlanError, Plan
from mbsgen.formulations.parsimony.search import flip_each, meet
from mbsgen.formulations.parsimony.segments import align
from mbsgen.formulations.parsimony.sensitivities import sensitivities
from mbsgen.formulations.parsimony.writing import begin
from mbsgen.formulations.planning import PlanTrials, dynamics_alone, find_plans
from mbsgen.formulations.reductions import ALL
from mbsgen.formulations.states import declare_state
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.construction import body, inertia, make_model, prismatic, revolute
from mbsgen.model.tree import Tree
from mbsgen.tape import forward, reverse
from mbsgen.tape.builder import Builder
from mbsgen.tape.interpreter import DIGITS, evaluate
from mbsgen.tape.types import Tape

TOLERANCE = 1e-30  # of the largest entry, in 50 digits: a plan divides by masses, lengths and inertias near 1
STATE = ("q", "qd", "qdd")
STEPS = 12  # of a walk over plans


@cache
def bend(seed: int) -> Tree:
    """Make a tree of revolute and prismatic joints, many about parallel axes; links lie along an axis or are askew."""
    rng = np.random.default_rng(seed)
    bodies = []
    for i in range(5):
        along = rng.permutation([float(rng.uniform(0.3, 1)), 0.0, 0.0])
        place = tuple(float(x) for x in (along if rng.random() < 0.7 else rng.uniform(-1, 1, 3)))
        axis = str(rng.choice(["y", "y", "-y", "y", "x", "z"]))
        kind = prismatic if rng.random() < 0.15 else revolute
        com = tuple(float(x) for x in rng.uniform(-0.5, 0.5, 3) * rng.permutation([1.0, 0.0, float(rng.integers(2))]))
        moments = inertia(*(float(x) for x in rng.uniform(0.2, 0.3, 3)))
        parent = f"b{rng.integers(max(0, i - 2), i)}" if i else "base"
        bodies.append(body(f"b{i}", kind(axis, position=place), parent=parent, mass=1.0 + i, com=com, inertia=moments))
    return dynamics_alone(build_tree(make_model("bent", bodies, gravity=(0.5, -0.3, -9.81))), driven=False)


def walk(plan: Plan, rng: np.random.Generator) -> Plan:
    """Change the choices of one body, and the meetings of all."""
    n = len(plan.choices)
    mass, spin_from = [Mass.PASSED, Mass.BALANCING, Mass.POINT, Mass.KEPT][rng.integers(4)], int(rng.integers(2))
    own_frame, scaled, by_spin, by_rates = (bool(x) for x in rng.integers(2, size=4))
    choice = Choice(own_frame, mass, scaled, spin_from, by_spin=by_spin, by_rates=by_rates)
    plan = plan.put(int(rng.integers(1, n + 1)), choice)
    meetings = (list(Meeting)[k] for k in rng.integers(3, size=n))
    kept = zip(plan.choices, meetings, *(map(bool, rng.integers(2, size=n)) for _ in range(2)), strict=True)
    choices = (replace(c, meeting=m, by_moments=moments, by_columns=columns) for c, m, moments, columns in kept)
    return replace(plan, choices=tuple(choices))


def write_textbook(tree: Tree) -> Tape:
    builder = Builder()
    state = declare_state(tree, builder, forces=False)
    chain = write_chain(tree, builder, state)
    builder.output_dense("Phi", [[x] for x in textbook.residual(chain, state.qd, chain.accelerate(state.qdd))])
    return builder.build("textbook")


@cache
def state_of(tree: Tree, seed: int) -> dict[str, list[object]]:
    rng, n = np.random.default_rng(seed), len(tree.bodies)
    return {name: [DIGITS.literal(float(x)) for x in rng.uniform(-2, 2, n)] for name in (*STATE, "adj_Phi")}


@cache
def differentiate(tree: Tree, seed: int) -> dict[str, dict[tuple[int, int], object]]:
    """Differentiate the textbook's residual by its operations, once and twice, in 50 digits."""
    tape, at = write_textbook(tree), state_of(tree, seed)
    adjoint = reverse.adjoint(tape, STATE)
    found: dict[str, dict[tuple[int, int], object]] = {}
    for derivative in (forward.jacobian(tape, STATE), kernels.adjoint_jacobian(tape, adjoint, STATE)):
        results = evaluate(derivative, {i.name: at[i.name] for i in derivative.inputs}, DIGITS)
        for o in derivative.outputs:
            found[o.name] = dict(zip(o.sparsity.entries, results[o.name], strict=True))
    rest = {
        "q": at["q"],
        "qd": [DIGITS.literal(0.0)] * len(tree.bodies),
        "qdd": [DIGITS.literal(0.0)] * len(tree.bodies),
    }
    found["weight"] = {(i, 0): value for i, value in enumerate(evaluate(tape, rest, DIGITS)["Phi"])}
    return found


def write_by(tree: Tree, plan: Plan) -> Tape:
    """Write first and second derivatives by a plan. Raises NoSuchPlanError."""
    builder = Builder()
    state = declare_state(tree, builder, forces=False)
    chain, n = write_chain(tree, builder, state), len(tree.bodies)
    seeds = builder.vector("adj_Phi", n)
    writing = begin(chain, align(chain), plan, ALL)
    first = sensitivities(writing, state.qd, state.qdd)
    _, second = curvatures(writing, state.qd, state.qdd, seeds)
    blocks: dict[str, Entries] = {
        "jac_Phi_q": first.q,
        "jac_Phi_qd": first.qd,
        "jac_Phi_qdd": first.qdd,
        "weight": {(i, 1): value for i, value in first.weight.items()},
        "jac_adj_q_q": second.q_q | {(j, i): value for (i, j), value in second.q_q.items()},
        "jac_adj_q_qd": second.q_qd,
        "jac_adj_qd_qd": second.qd_qd | {(j, i): value for (i, j), value in second.qd_qd.items()},
        "jac_adj_q_qdd": second.q_qdd,
    }
    for name, entries in blocks.items():
        builder.output_nonzeros(
            name, n, n if name != "weight" else 1, {(i - 1, j - 1): value for (i, j), value in entries.items()}
        )
    return builder.build("plan")


@pytest.mark.parametrize("seed", range(8))
def test_every_plan_that_fits_writes_the_derivatives_of_the_textbooks_residual(seed: int) -> None:
    """First and second ones, in 50 digits, on a random walk over plans: wherever loads meet the joints before them."""
    tree, rng = bend(seed), np.random.default_rng(seed)
    expected, at = differentiate(tree, seed), state_of(tree, seed)
    plan, tried = Plan((Choice(),) * len(tree.bodies)), 0
    for _ in range(STEPS):
        changed = walk(plan, rng)
        try:
            tape = write_by(tree, changed)
        except NoSuchPlanError:
            continue
        plan, tried = changed, tried + 1
        results = evaluate(tape, {i.name: at[i.name] for i in tape.inputs}, DIGITS)
        for o in tape.outputs:
            wanted, found = expected[o.name], dict(zip(o.sparsity.entries, results[o.name], strict=True))
            scale = max(1, *map(abs, wanted.values()))
            for place in wanted.keys() | found.keys():
                assert abs(found.get(place, 0) - wanted.get(place, 0)) <= TOLERANCE * scale, (o.name, place)
    assert tried > STEPS / 6


@pytest.mark.parametrize("seed", range(8))
def test_loads_that_meet_the_joints_before_save_operations(seed: int) -> None:
    """On trees with groups of parallel axes, the plan takes no more operations than loads that pass to the base."""
    tree = bend(seed)
    with PlanTrials(tree, ALL) as trials:

        def cost(plan: Plan) -> int:
            found = sensitivities(trials.begin(plan), trials.state.qd, trials.state.qdd)
            return trials.cost([*found.q.values(), *found.qd.values(), *found.qdd.values()])

        plan = find_plans(tree, ALL).sensitivities
        assert cost(plan) <= cost(plan.carried_down)
        assert cost(meet(trials.segments, cost, plan)) <= cost(plan)
        assert cost(flip_each(trials.segments, cost, plan, "by_moments")) <= cost(plan)
        apart = tuple(replace(choice, by_columns=False) for choice in plan.choices)
        assert cost(plan) <= cost(replace(plan, choices=apart))
