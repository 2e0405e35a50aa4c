"""Answers and failures of problems of phases: numbers of links, and which part of which phase is wrong.

A mass of 1 kg on a rail is pushed from phase to phase; whatever an answer says of its motions follows from them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mbsrun.ocp.ground.status import BAD_BOUNDS, BAD_GUESS
from mbsrun.ocp.guessing.phases import Guess
from mbsrun.ocp.problem.phases import Condition, Link, Phase, PhasedProblem, Plants
from mbsrun.ocp.problem.problem import Bounds, End, SolverOptions, Term, Unknown
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import Failure
from mbsrun.ocp.solving.phases import PhasedSolver, prepare_phases, solve_phases
from mbsrun.ocp.statement.checks import ProblemError
from tests.mbsrun.ocp.plants import FREE_RANGE, push
from tests.mbsrun.peer import double_integrator

FREE = (FREE_RANGE,)
PLANTS = Plants((double_integrator(),) * 2)
FIRST = replace(push(3), end=End())
SECOND = replace(push(2), free_start=(0, 1))
LINK = Link(
    "ahead", "on", map=(("slide", "slide - stride"),), velocities=(("slide", "slide*0.5"),),
    conditions=(Condition("end_q_slide - 0.75", (0.0, 0.0)), Condition("end_u_slide", (-np.inf, 9.0))),
    cost=(Term("end_qd_slide**2", 0.5, name="speed"), Term("stride*k", 2.0)),
)  # fmt: skip
PROBLEM = PhasedProblem(
    "two", (Phase("ahead", FIRST), Phase("on", SECOND)), (LINK,), (("k", 3.0),), (Unknown("stride", (0.25, 0.5), 0.3),)
)


def solve(problem: PhasedProblem = PROBLEM, guess: Guess | None = None) -> Any:
    return solve_phases(problem, PLANTS, guess=guess)


@pytest.fixture(scope="module")
def solution() -> PhasedSolution:
    found = solve()
    assert isinstance(found, PhasedSolution)
    return found


def test_a_link_has_its_costs_and_its_violation(solution: PhasedSolution) -> None:
    """Terms by their names or expressions; the sum of all parts is the cost of the whole."""
    (link,) = solution.values
    first, second = (phase.trajectory for phase in solution.phases)
    (stride,) = solution.unknown_values
    assert (link.source, link.target, link.impulses) == ("ahead", "on", ())
    assert dict(link.terms) == {
        "speed": pytest.approx(0.5 * first.qd[-1, 0] ** 2), "stride*k": pytest.approx(2 * stride * 3)
    }  # fmt: skip
    assert stride == pytest.approx(0.25, abs=1e-6)
    assert first.q[-1, 0] == pytest.approx(0.75, abs=1e-8)
    assert second.q[0, 0] == pytest.approx(0.75 - stride, abs=1e-8)
    assert second.qd[0, 0] == pytest.approx(0.5 * first.qd[-1, 0], abs=1e-8)
    assert 0 <= link.violation < 1e-8
    inputs = [float((phase.u[:, 0] ** 2 * np.diff(phase.t)).sum()) for phase in (first, second)]
    assert [phase.cost.total for phase in solution.phases] == pytest.approx(inputs)
    assert solution.cost == pytest.approx(sum(inputs) + sum(x for _, x in link.terms))


def test_an_answer_names_its_parts(solution: PhasedSolution) -> None:
    assert (solution.name, solution.names, solution.constants) == ("two", ("ahead", "on"), (("k", 3.0),))
    assert [phase.problem.name for phase in solution.phases] == ["ahead", "on"]
    assert [unknown.name for unknown in solution.problem.every_unknown] == ["stride"]
    whole, parts = solution.size, [phase.size for phase in solution.phases]
    assert whole.variables == sum(part.variables for part in parts) + 1
    assert whole.constraints == sum(part.constraints for part in parts) + 2 + 2
    alone: Any = solve_phases(PhasedProblem("one", (Phase("", push(3)),)), Plants(PLANTS.phases[:1]))
    assert alone.phases[0].problem.name == "one"
    assert alone.phases[0].size == alone.size


@pytest.mark.parametrize(("k", "name"), [(0, "ahead"), (1, "on")])
def test_bounds_that_cross_are_named_with_their_phase(k: int, name: str) -> None:
    """Nothing is searched."""
    wrong = replace(PROBLEM.phases[k].problem, bounds=Bounds(((2.0, 1.0),), FREE, FREE), start_q=(0.0,))
    phases = tuple(Phase(x.name, wrong) if i == k else x for i, x in enumerate(PROBLEM.phases))
    solver, guess = PhasedSolver(PROBLEM, PLANTS), solve().guess
    found = solver.solve(replace(PROBLEM, phases=phases), guess)
    assert isinstance(found, Failure)
    assert (found.run.status, found.run.iterations, found.run.seconds) == (BAD_BOUNDS, 0, 0.0)
    assert found.run.cpu_seconds == 0.0
    assert found.finding.endswith("the bounds of coordinate slide are [2, 1]")
    assert name in found.finding


def test_a_guess_that_is_no_number_is_refused(solution: PhasedSolution) -> None:
    motion = solution.phases[1].trajectory
    wrong = replace(motion, q=np.full_like(motion.q, np.nan))
    found = solve(guess=Guess((solution.phases[0].trajectory, wrong), (("stride", 0.3),)))
    assert isinstance(found, Failure)
    assert (found.run.status, found.run.iterations, found.run.seconds, found.run.cpu_seconds) == (
        BAD_GUESS,
        0,
        0.0,
        0.0,
    )
    assert "the guess has numbers that are not finite" in found.finding


def test_another_structure_needs_another_solver(solution: PhasedSolution) -> None:
    solver = PhasedSolver(PROBLEM, PLANTS)
    for changed in (
        replace(PROBLEM, links=(replace(LINK, conditions=()),)),
        replace(PROBLEM, phases=(Phase("ahead", replace(FIRST, degree=3)), PROBLEM.phases[1])),
    ):
        with pytest.raises(ValueError, match="two differs in structure from the transcribed problem"):
            solver.solve(changed, solution.guess)


@pytest.mark.parametrize(
    ("key", "part"), [("conditions", Condition("end_qdd_slide", (-9.0, 9.0))), ("cost", Term("end_qdd_slide", 1.0))]
)
def test_parts_of_links_that_no_stage_reads_are_named_for_a_method_by_stages(key: str, part: Any) -> None:
    """Accelerations, in conditions or in costs, by their numbers and expressions."""
    link = replace(LINK, **{key: (*getattr(LINK, key), part)})
    with pytest.raises(ProblemError) as refusal:
        PhasedSolver(replace(PROBLEM, links=(link,), solver=SolverOptions(method="mbs")), PLANTS)
    found = {place: finding for place, finding, _ in refusal.value.findings}
    assert found[f"links[0].{key}[2].expression"].endswith(": end_qdd_slide")
    assert all(place.startswith(f"links[0].{key}[") for place in found)


def test_unknown_numbers_that_phases_share_are_guessed_once(solution: PhasedSolution) -> None:
    """The guess's number counts, then the first motion that has one, then the problem's guess."""
    own = tuple(
        Phase(name, replace(problem, unknowns=(Unknown("p", guess=guess),)))
        for name, problem, guess in (("ahead", FIRST, 0.5), ("on", SECOND, 0.5))
    )
    problem, plants = replace(PROBLEM, phases=own), PLANTS
    ready = prepare_phases(problem, plants, solution.guess)
    assert not isinstance(ready, Failure)
    bare = tuple(replace(phase.trajectory, unknowns=np.zeros(0)) for phase in solution.phases)
    some = (bare[0], replace(bare[1], unknowns=np.array([0.7])))
    for motions, given, expected in ((bare, (), 0.5), (some, (), 0.7), (some, (("p", 0.9),), 0.9)):
        found = ready.solver.complete(ready.problem, Guess(motions, given))
        assert [motion.unknowns.tolist() for motion in found.trajectories] == [[expected]] * 2
