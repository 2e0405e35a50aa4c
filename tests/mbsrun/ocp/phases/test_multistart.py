"""A search from many starts among phases: the split swing-up has several minima, and start 0 is its guess."""

from __future__ import annotations

from dataclasses import replace

from mbsrun.ocp.problem.phases import Phase, PhasedProblem, Plants
from mbsrun.ocp.searching.multistart import Wish
from mbsrun.ocp.searching.phases import solve_phases_from_many
from mbsrun.ocp.showing.phase_summary import summarise_phases
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import Failure, Starts
from tests.mbsrun.ocp.phases.motions import split, swing_up
from tests.mbsrun.ocp.plants import cart_pole


def _ignore(_starts: Starts) -> None:
    pass


def _find(count: int, seed: int = 2) -> tuple[Starts, PhasedSolution | Failure | None]:
    cart = cart_pole()
    return solve_phases_from_many(
        split(replace(swing_up(), intervals=10, horizon=5.0)), Plants((cart, cart)), Wish(count, seed), id
    )


def test_the_best_of_all_starts_is_the_solution() -> None:
    """Start k depends on the seed and k alone, and the solution has the lowest cost of all."""
    (few, _), (more, best) = _find(2), _find(3)
    assert [start.kind for start in more.results] == ["guess", "noise", "waves"]
    assert [start.cost for start in few.results] == [start.cost for start in more.results[:2]]
    assert isinstance(best, PhasedSolution)
    from_guess, _, from_waves = (start.cost for start in more.results)
    assert best.cost == from_waves
    assert from_guess is not None
    assert best.cost < 0.99 * from_guess, "the guess leads to the best minimum; nothing is searched"
    assert "in 3 starts; lower ones may exist" in summarise_phases(best)["starts"]


def test_a_search_ends_with_its_time_and_with_a_failure() -> None:
    cart = cart_pole()
    problem = split(swing_up())
    starts, outcome = solve_phases_from_many(problem, Plants((cart, cart)), Wish(3, seconds=-1.0), _ignore)
    assert outcome is None
    assert not starts.results
    tight = replace(problem.phases[0].problem.solver, max_iterations=1)
    short = PhasedProblem("short", tuple(Phase(x.name, x.problem) for x in problem.phases), problem.links, solver=tight)
    starts, outcome = solve_phases_from_many(short, Plants((cart, cart)), Wish(2), _ignore)
    assert isinstance(outcome, Failure)
    assert [start.cost for start in starts.results] == [None, None]
