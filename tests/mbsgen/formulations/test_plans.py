"""Plans: whatever a plan says of how bodies are written, the equations are the textbook's."""

from __future__ import annotations

from dataclasses import replace
from math import sin
from typing import Any

import numpy as np
import pytest

from mbsgen.formulations import exp1, exp2, impl, semi, textbook
from mbsgen.formulations.chain import write_chain
from mbsgen.formulations.parsimony.articulated import accelerations, articulate
from mbsgen.formulations.parsimony.mass_matrix import joint_matrix, mass_matrix
from mbsgen.formulations.parsimony.plan import Choice, Mass, Meeting, NoSuchPlanError, Plan
from mbsgen.formulations.parsimony.residual import residual
from mbsgen.formulations.parsimony.segments import align
from mbsgen.formulations.parsimony.sensitivities import sensitivities
from mbsgen.formulations.parsimony.writing import begin
from mbsgen.formulations.planning import PlanTrials
from mbsgen.formulations.reductions import ALL
from mbsgen.formulations.states import declare_state
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.construction import ball, body, free, inertia, make_model, prismatic, revolute
from mbsgen.model.model import Model
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder
from mbsgen.tape.interpreter import DIGITS, evaluate
from mbsgen.tape.types import Tape

TOLERANCE = 1e-30  # of the largest entry, in 50 digits: a plan divides by masses, lengths and inertias near 1
STEPS = 24  # of a walk over plans


def ball_at_tip() -> Model:
    """A rod in a vertical plane, with a ball joint at its lower end that carries a bob."""
    return make_model(
        "ball_at_tip",
        [
            body("rod", revolute("y"), mass=0.5, com=(0, 0, -0.5)),
            body("bob", ball(position=(0, 0, -1)), parent="rod", mass=1, inertia=inertia(0.1, 0.1, 0.1)),
        ],
        gravity=(0, 0, -9.81),
    )


def test_what_a_ball_joint_carries_weighs_on_the_rod_that_holds_it() -> None:
    """At rest, the rod's joint bears g (m_rod l / 2 + m_bob l) sin q.

    It feels the inertia m_rod (l / 2)^2 + m_bob l^2 while the bob turns freely, plus the bob's inertia where it does
    not.
    """
    tree, g, angle = build_tree(ball_at_tip()), 9.81, 0.3
    at = {"q": [angle, 0.0, 0.0, 0.0, 1.0], "qd": [0.0] * 4, "qdd": [0.0] * 4}
    at["u"] = [0.0] * sum(b.joint.actuated for b in tree.bodies)
    moment, felt = g * (0.5 * 0.5 + 1.0) * sin(angle), 0.5 * 0.5**2 + 1.0

    def run(tape: Tape) -> dict[str, list[Any]]:
        return evaluate(tape, {i.name: at[i.name] for i in tape.inputs})

    for build in (impl.build, semi.build_residual):
        assert run(build(tree))["Phi"] == pytest.approx([moment, 0, 0, 0], abs=1e-14)
    terms = run(semi.build(tree))
    assert terms["c"] == pytest.approx([moment, 0, 0, 0], abs=1e-14)
    assert terms["M"][0] == pytest.approx(felt + 0.1, rel=1e-14)
    for build in (exp1.build, exp2.build):
        assert run(build(tree))["qdd"][0] == pytest.approx(-moment / felt, rel=1e-14)


def random_chain(seed: int) -> Tree:
    """Make a tree whose links lie along one axis or are askew, with all joints, and bodies that may be pendulums."""
    rng = np.random.default_rng(seed)
    bodies = []
    for i in range(4):
        along = rng.permutation([float(rng.uniform(0.3, 1)), 0.0, 0.0])
        place = tuple(float(x) for x in (along if rng.random() < 0.8 else rng.uniform(-1, 1, 3)))
        axis = str(rng.choice(["x", "y", "z", "-y"]))
        rotor = float(rng.choice([0.0, 0.2]))
        kinds = [revolute(axis, position=place, armature=rotor)] * 4 + [ball(position=place)] * 2
        kinds += [prismatic(axis, position=place, armature=rotor)] + ([] if i else [free(position=place)])
        com = tuple(float(x) for x in rng.uniform(-0.5, 0.5, 3) * rng.permutation([1.0, 0.0, float(rng.integers(2))]))
        parent = f"b{rng.integers(max(0, i - 2), i)}" if i else "base"
        moments = inertia(*(float(x) for x in rng.uniform(0.2, 0.3, 3)))
        bodies.append(
            body(f"b{i}", kinds[rng.integers(len(kinds))], parent=parent, mass=1.0 + i, com=com, inertia=moments)
        )
    return build_tree(make_model("chain", bodies, gravity=(0.5, -0.3, -9.81)))


def hang(seed: int) -> Tree:
    """Make a tree whose last two joints meet in a point at right angles, with a pendulum in a plane beyond."""
    rng = np.random.default_rng(seed)
    first, last, along = (int(x) for x in rng.permutation(3))
    place = np.where((np.arange(3) == first) | (rng.random() < 0.5), rng.uniform(0.3, 1, 3), 0.0)
    moments = [inertia(*(float(x) for x in rng.uniform(0.2, 0.3, 3))) for _ in range(3)]
    kind = (revolute, prismatic)[int(rng.integers(2))]
    rotor, ring = float(rng.choice([0.0, 0.2])), revolute("xyz"[first], position=tuple(map(float, place)))
    mass = float(rng.choice([0.0, 0.5]))
    com = tuple(float(x) for x in 0.4 * (np.arange(3) == along))
    bodies = [
        body("b0", revolute("z"), mass=1, com=(0.2, 0.1, 0), inertia=moments[0]),
        body("b1", kind("y", position=(0.5, 0, 0), armature=rotor), parent="b0", mass=1, com=com, inertia=moments[1]),
        body("ring", ring, parent="b1", mass=mass, inertia=moments[2] if mass else inertia(0, 0, 0)),
        body("bob", revolute("xyz"[last], armature=rotor), parent="ring", mass=2, com=com, inertia=moments[0]),
    ]
    return build_tree(make_model("hang", bodies, gravity=(0.5, -0.3, -9.81)))


@pytest.mark.parametrize("seed", range(8))
def test_a_point_mass_in_series_with_a_rotor_moves_as_the_textbook_says(seed: int) -> None:
    tree, rng = hang(seed), np.random.default_rng(seed)
    for _ in range(6):
        plan = replace(change(Plan((Choice(),) * 4), rng), in_series=True, together=int(rng.integers(3)))
        for i in (1, 2):
            plan = plan.put(i, replace(plan[i], mass=Mass.PASSED, scaled=False))
        plan = plan.put(3, Choice()).put(4, Choice(own_frame=False, mass=Mass.POINT, spin_from=spin_of(tree)))
        assert_textbook(write_by(tree, plan), state_of(tree, seed))
        trials = PlanTrials(tree, ALL)
        assert articulate(trials.begin(plan), together=(1, 2)[: plan.together])[3].series


@pytest.mark.parametrize("seed", range(8))
def test_motions_that_turn_meet_a_body_before_its_joint_is_free(seed: int) -> None:
    """Whatever the joints before it: parallel or askew, prismatic, with rotors or without."""
    tree, rng = random_chain(seed), np.random.default_rng(seed)
    n = len(tree.bodies)
    for together in range(1, min(n, 5)):
        plan = change(Plan((Choice(),) * n), rng)
        for i in range(1, n + 1):
            kept = replace(random_choice(rng), mass=Mass.PASSED, scaled=False)
            plan = plan.put(i, replace(kept, meeting=Meeting.BEYOND if rng.random() < 0.8 else Meeting.SPLIT))
        plan = replace(plan, together=together, by_motions=bool(rng.integers(2)), turns_apart=True)
        assert_textbook(write_by(tree, plan), state_of(tree, seed))


def spin_of(tree: Tree) -> int:
    """Return the axis across a pendulum, from the one after its joint's, of the moment that becomes spin."""
    axis, com = tree.bodies[3].joint.axis, [x != 0 for x in tree.bodies[3].com]
    return int(com[(axis + 1) % 3])


def random_choice(rng: np.random.Generator) -> Choice:
    mass = [Mass.PASSED, Mass.BALANCING, Mass.POINT, Mass.KEPT][rng.integers(4)]
    meeting = list(Meeting)[rng.integers(len(Meeting))]
    own_frame, scaled, by_spin, by_rates, passes_spin = (bool(x) for x in rng.integers(2, size=5))
    return Choice(own_frame, mass, scaled, int(rng.integers(2)), meeting, by_spin, by_rates, passes_spin)


def change(plan: Plan, rng: np.random.Generator) -> Plan:
    """Change one body's choice, the joints that are eliminated together, and the choices of the whole plan."""
    n = len(plan.choices)
    changed = plan.put(int(rng.integers(1, n + 1)), random_choice(rng))
    flags = (
        "by_angles",
        "by_motions",
        "first_resists",
        "shift_first",
        "in_series",
        "at_rest",
        "turns_apart",
        "by_squares",
        "by_levers",
    )
    chosen = {name: bool(x) for name, x in zip(flags, rng.integers(2, size=len(flags)), strict=True)}
    return replace(changed, together=int(rng.integers(n + 1)), **chosen)


@pytest.mark.parametrize("seed", range(12))
def test_every_plan_that_fits_writes_the_equations_of_the_textbook(seed: int) -> None:
    """The residual, M and the accelerations, in 50 digits, on a random walk over plans; others are refused."""
    tree, rng = random_chain(seed), np.random.default_rng(seed)
    n, tried = len(tree.bodies), 0
    plan = Plan((Choice(),) * n)
    for _ in range(STEPS):
        changed = change(plan, rng)
        try:
            tape = write_by(tree, changed)
        except NoSuchPlanError:
            continue
        plan, tried = changed, tried + 1
        assert_textbook(tape, state_of(tree, seed))
    assert tried > STEPS / 6


@pytest.mark.parametrize("seed", range(6))
def test_trials_that_remember_write_the_same_operations(seed: int) -> None:
    """On a random walk over plans, a builder that remembers parts of former plans refers to the very same values."""
    tree, rng = random_chain(seed), np.random.default_rng(seed)
    remembering, forgetting = PlanTrials(tree, ALL), PlanTrials(tree, ALL)
    forgetting.chain.builder.memory = None
    plan, tried = Plan((Choice(),) * len(tree.bodies)), 0
    for _ in range(STEPS):
        changed = change(plan, rng)
        try:
            expected = write_trial(forgetting, changed)
        except NoSuchPlanError:
            with pytest.raises(NoSuchPlanError):
                write_trial(remembering, changed)
            continue
        plan, tried = changed, tried + 1
        assert write_trial(remembering, changed) == expected
    assert tried > STEPS / 6
    assert remembering.chain.builder.memory


def write_trial(trials: PlanTrials, plan: Plan) -> list[int]:
    """Write all recursions by a plan; list the references to their results."""
    state, writing = trials.state, trials.begin(plan)
    found = sensitivities(writing, state.qd, state.qdd)
    results = [
        *residual(writing, state.qd, state.qdd),
        *joint_matrix(writing).values(),
        *mass_matrix(writing, absolute=True).values(),
        *accelerations(writing, state.qd, state.qdd).qdd,
        *(value for entries in (found.Phi, found.q, found.qd, found.qdd) for value in entries.values()),
    ]
    return [value.ref for value in results]


def write_by(tree: Tree, plan: Plan) -> Tape:
    """Write what the textbook expects and what a plan makes of it. Raises NoSuchPlanError."""
    builder = Builder()
    state = declare_state(tree, builder, forces=False)
    chain = write_chain(tree, builder, state)
    expected = textbook.residual(chain, state.qd, chain.accelerate(state.qdd))
    writing = begin(chain, align(chain), plan, ALL)
    columns = {
        "expected": expected,
        "rest": textbook.residual(chain, state.qd, chain.drift),
        "found": residual(writing, state.qd, chain.accelerate(state.qdd)),
        "qdd": accelerations(writing, state.qd, expected).qdd,
        "relative": accelerations(writing, state.qd, expected, absolute=False).qdd,
    }
    for name, column in columns.items():
        builder.output_dense(name, [[x] for x in column])
    M = joint_matrix(writing)
    builder.output_nonzeros("M", *[len(tree.bodies)] * 2, {(i - 1, j - 1): v for (i, j), v in M.items()})
    return builder.build("plan")


def state_of(tree: Tree, seed: int) -> dict[str, list[Any]]:
    rng, n = np.random.default_rng(seed), len(tree.bodies)
    sizes = {"q": len(tree.coordinates), "qd": n, "qdd": n}
    return {name: [DIGITS.literal(float(x)) for x in rng.uniform(-2, 2, size)] for name, size in sizes.items()}


def assert_textbook(tape: Tape, at: dict[str, list[Any]]) -> None:
    results = evaluate(tape, at, DIGITS)
    moved = list(results["rest"])
    for (i, j), value in zip(tape.output("M").sparsity.entries, results["M"], strict=True):
        moved[i] += value * at["qdd"][j]
        if i != j:
            moved[j] += value * at["qdd"][i]
    scale = max(1, *map(abs, results["expected"]))
    for found, expected in (
        (results["found"], results["expected"]),
        (moved, results["expected"]),
        (results["qdd"], at["qdd"]),
        (results["relative"], at["qdd"]),
    ):
        assert max(abs(a - b) for a, b in zip(found, expected, strict=True)) <= TOLERANCE * scale
