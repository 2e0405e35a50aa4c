"""The end of a search by hand: the cause that a failure names, answers that are none, starts that cannot be."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.ocp.ground.status import (
    BAD_BOUNDS,
    ELSEWHERE,
    INFEASIBLE,
    INVALID,
    JUMPED,
    OPEN,
    SOLVED,
    NoNumbersError,
)
from mbsrun.ocp.problem.problem import Loops, SolverOptions
from mbsrun.ocp.solution.solution import Failure, Run
from mbsrun.ocp.solving import phases
from mbsrun.ocp.solving.phases import PhasedSolver, _list_unstaged, _measure_part
from mbsrun.ocp.solving.singularities import Cause

Array = NDArray[np.float64]
SPENT = Run(SOLVED, 5, 1.0, 1.0)
ENDED = np.array([1.0, 2.0])


def make_phase(title: str, **given: Any) -> Any:
    return SimpleNamespace(title=title, name=title.rstrip(": "), problem=SimpleNamespace(name=title, **given))


def make_task(count: int = 2, **given: Any) -> Any:
    parts = tuple(make_phase(f"p{k}: ", loops=Loops.REDUCED) for k in range(count))
    return SimpleNamespace(phases=parts, solver=SolverOptions(), weight=1.0, links=(), **given)


def make_plants(count: int = 2, has_model: bool = True) -> Any:
    plants = [SimpleNamespace(manifest=SimpleNamespace(coordinates=("a",) if has_model else ())) for _ in range(count)]
    return SimpleNamespace(phases=plants, every=plants)


def end(status: str = SOLVED, x: Array = ENDED, **given: Any) -> Any:
    return SimpleNamespace(run=Run(status, given.pop("iterations", 5), 1.0, 1.0), x=x, **given)


# --- failures -------------------------------------------------------------------------------------------------------


def explain(monkeypatch: pytest.MonkeyPatch, status: str, **found: Any) -> Failure:
    """Return the failure where a cause, clashes or a singular form are found."""
    words = [f"ended {status}", "try again"]
    monkeypatch.setattr(phases, "explain", lambda name, *_, **__: [f"ended {name}", words[1]])
    solver = SimpleNamespace(
        plants=make_plants(),
        _find_cause=lambda *_: found.get("cause"),
        _describe=lambda *_: found.get("clash", ""),
        _find_singular=lambda *_: found.get("lost", ""),
    )
    return PhasedSolver._explain(cast(Any, solver), make_task(), end(status), cast(Any, None))


def test_a_failure_names_the_expression_that_caused_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Alone where the search met no number; after the method's words where it went on in vain."""
    cause = Cause("log(x) is not finite", "keep x above 0", "path[0]")
    assert explain(monkeypatch, INVALID, cause=cause).finding == "log(x) is not finite"
    failure = explain(monkeypatch, "slow", cause=cause, clash="rows clash", lost="it is singular")
    assert failure.finding == "ended slow; log(x) is not finite"
    assert (failure.remedy, failure.place, failure.run.status) == ("keep x above 0", "path[0]", "slow")


def test_a_failure_names_what_clashes_and_the_form_that_lost_its_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    assert explain(monkeypatch, "slow").finding == "ended slow"
    assert explain(monkeypatch, "slow").remedy == "try again"
    assert explain(monkeypatch, "slow", clash="a and b").finding == "ended slow: a and b"
    failure = explain(monkeypatch, "slow", clash="a and b", lost="it is singular")
    assert failure.finding == "ended slow: a and b; it is singular"
    assert failure.remedy == "take loops: multipliers, or try again"


@pytest.mark.parametrize("has_model", [True, False])
def test_the_words_for_a_failure_depend_on_whether_there_is_a_mechanism(
    monkeypatch: pytest.MonkeyPatch, has_model: bool
) -> None:
    seen: list[Any] = []
    monkeypatch.setattr(phases, "explain", lambda *given, **more: (seen.append((given, more)), ("a", "b"))[1])
    solver = SimpleNamespace(
        plants=make_plants(has_model=has_model), _find_cause=lambda *_: None, _describe=lambda *_: "",
        _find_singular=lambda *_: "",
    )  # fmt: skip
    PhasedSolver._explain(cast(Any, solver), make_task(), end("slow", iterations=7), cast(Any, None))
    assert seen == [(("slow", 7), {"has_model": has_model})]


def find_cause(monkeypatch: pytest.MonkeyPatch, status: str, ends: list[Any], **found: Any) -> tuple[Any, list[Any]]:
    """Find the cause where phases and links have some, by name of the motion; return it, and what was asked."""
    asked: list[Any] = []

    def of_phase(problem: Any, _: Any, __: Any, guess: Any, last: Any) -> Cause | None:
        asked.append((problem.name, guess, last))
        return found.get("phases", {}).get(problem.name)

    def of_links(_: Any, __: Any, motions: Any, title: str) -> Cause | None:
        asked.append((tuple(motions), title))
        return found.get("links", {}).get(title)

    monkeypatch.setattr(phases, "find_cause", of_phase)
    monkeypatch.setattr(phases, "find_in_links", of_links)
    solver = SimpleNamespace(plants=make_plants(), _read_ends=lambda _: ends)
    guess = SimpleNamespace(trajectories=("g0", "g1"))
    run = Run(status, 3, 1.0, 1.0)
    return PhasedSolver._find_cause(cast(Any, solver), make_task(), run, cast(Any, guess), ENDED), asked


def test_causes_are_sought_in_phases_then_in_links_where_there_is_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the guess, and where the search ended; a phase is named."""
    cause = Cause("it is nan", "mend it", "cost[1]")
    found, asked = find_cause(monkeypatch, "slow", ["e0", "e1"], phases={"p1: ": cause})
    assert (found.finding, found.place, found.remedy) == ("p1: it is nan", "p1: cost[1]", "mend it")
    assert asked == [("p0: ", "g0", "e0"), ("p1: ", "g1", "e1")]
    found, asked = find_cause(monkeypatch, "slow", ["e0", "e1"], links={"the guess": cause})
    assert found is None
    assert len(asked) == 2
    ended = "the motion where the search ended"
    found, asked = find_cause(monkeypatch, INVALID, ["e0", "e1"], links={ended: cause})
    assert found is cause
    assert asked[2:] == [(("g0", "g1"), "the guess"), (("e0", "e1"), ended)]
    found, asked = find_cause(monkeypatch, INVALID, [None, None], links={ended: cause})
    assert found is None
    assert asked[2:] == [(("g0", "g1"), "the guess")]
    assert find_cause(monkeypatch, INVALID, ["e0", "e1"], links={"the guess": cause})[0] is cause


def test_ends_are_read_where_their_numbers_are_motions() -> None:
    def fail(_: Any) -> None:
        raise ValueError("no motion")

    for x, complete, found in (
        (ENDED, lambda x: 2 * x, ["read", [2.0, 4.0]]),
        (np.array([1.0, np.nan]), lambda x: x, [None, None]),
        (ENDED, fail, [None, None]),
    ):
        solver = SimpleNamespace(
            plants=make_plants(),
            program=SimpleNamespace(numpy=SimpleNamespace(complete=complete)),
            transcription=SimpleNamespace(unpack=lambda x: ["read", x.tolist()]),
        )
        assert PhasedSolver._read_ends(cast(Any, solver), x) == found


def describe(monkeypatch: pytest.MonkeyPatch, outcome: Any, *, fails: bool = False) -> tuple[str, list[Any]]:
    seen: list[Any] = []
    monkeypatch.setattr(phases, "describe", lambda clash, names: (seen.append((clash, names)), "of rows")[1])
    monkeypatch.setattr(phases, "describe_point", lambda found, names: (seen.append((found, names)), "of a point")[1])
    monkeypatch.setattr(phases, "see_solver", lambda names, _: f"{names} as seen")

    def evaluate(*_: Any) -> Array:
        if fails:
            raise NoNumbersError("none")
        return np.array([9.0])

    own = SimpleNamespace(variable_bounds=lambda _: "variables", constraint_bounds=lambda _: "rows", program=None)
    solver = SimpleNamespace(transcription=own, _name_parts=lambda _: "names", _evaluate=evaluate)
    return PhasedSolver._describe(cast(Any, solver), make_task(), outcome), seen


def test_clashes_are_described_at_the_point_of_an_infeasible_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else, before any step, and without numbers, by rows that were found to cross."""
    start = SimpleNamespace(parameters=None)
    for status in INFEASIBLE:
        text, seen = describe(monkeypatch, end(status, clash="c", start=start))
        assert text == "of a point"
        found, names = seen[0]
        assert names == "names as seen"
        assert [x if isinstance(x, str) else x.tolist() for x in vars(found).values()] == [
            [1.0, 2.0], "variables", [9.0], "rows",
        ]  # fmt: skip
    first = INFEASIBLE[0]
    for outcome, fails in (
        (end("slow", clash="c", start=start), False),
        (end(first, clash="c", start=start, iterations=0), False),
        (end(first, np.array([1.0, np.inf]), clash="c", start=start), False),
        (end(first, clash="c", start=start), True),
    ):
        assert describe(monkeypatch, outcome, fails=fails) == ("of rows", [("c", "names")])


def test_parts_are_named_by_their_phase_at_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """Variables and rows of a phase follow the ones of the phases before; rows between phases have texts."""
    own_names = SimpleNamespace(variables={0: "q", 1: "u"}, rows={0: "gap", 2: "path"}, inner={2})
    monkeypatch.setattr(phases, "name_parts", lambda *_: own_names)
    offsets = [SimpleNamespace(variables=v, rows=r) for v, r in ((0, 0), (10, 20), (30, 40))]
    own = SimpleNamespace(phases=(1, 2), offsets=offsets, texts=[(np.array([41, 42]), "a link")])
    solver = SimpleNamespace(transcription=own, plants=make_plants())
    names = PhasedSolver._name_parts(cast(Any, solver), make_task())
    assert names.variables == {0: "p0: q", 1: "p0: u", 10: "p1: q", 11: "p1: u"}
    rows = {0: "p0: gap", 2: "p0: path", 20: "p1: gap", 22: "p1: path", 41: "a link", 42: "a link"}
    assert (names.rows, names.inner) == (rows, frozenset({2, 22}))


@pytest.mark.parametrize(
    ("x", "loops", "lost", "found"),
    [
        (ENDED, Loops.REDUCED, {"b": "it is singular"}, "p1: it is singular"),
        (ENDED, Loops.REDUCED, {"a": "first", "b": "second"}, "p0: first"),
        (ENDED, Loops.REDUCED, {}, ""),
        (ENDED, Loops.MULTIPLIERS, {"b": "it is singular"}, ""),
        (np.array([np.nan]), Loops.REDUCED, {"b": "it is singular"}, ""),
        (ENDED, Loops.REDUCED, None, ""),
    ],
)
def test_a_reduced_form_that_loses_its_loops_is_named_by_its_phase(
    monkeypatch: pytest.MonkeyPatch, x: Array, loops: Loops, lost: dict[str, str] | None, found: str
) -> None:
    monkeypatch.setattr(phases, "find_singular", lambda part, _: (lost or {}).get(part, ""))

    def read(*_: Any) -> Any:
        if lost is None:
            raise NoNumbersError("none")
        return SimpleNamespace(phases=("a", "b"))

    task = make_task()
    for phase in task.phases:
        phase.problem.loops = loops
    solver = SimpleNamespace(plants=make_plants(), _read=read)
    assert PhasedSolver._find_singular(cast(Any, solver), task, end("slow").run, x) == found
    if loops is Loops.MULTIPLIERS:
        task.phases[1].problem.loops = Loops.REDUCED
        assert PhasedSolver._find_singular(cast(Any, solver), task, end("slow").run, x) == "p1: it is singular"


# --- answers --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ended:
    """An outcome."""

    run: Run
    x: Array
    start: Any


def answer(monkeypatch: pytest.MonkeyPatch, **given: Any) -> Any:
    """Judge the end of a search: with gaps of loops, a cause of the judge, and findings of branches by phase."""
    monkeypatch.setattr(phases, "explain", lambda status, *_: (f"ended {status}", "try again"))
    monkeypatch.setattr(
        phases, "examine", lambda *_: (Run(given.get("judged", SOLVED), 5, 1.0, 1.0), given.get("cause", ""))
    )
    monkeypatch.setattr(phases, "find_jump", lambda part, _: given.get("jumps", {}).get(part.name, ""))
    monkeypatch.setattr(phases, "find_other_assembly", lambda part, _: given.get("others", {}).get(part.name, ""))
    gaps = given.get("gaps", (None, None))
    parts = [
        SimpleNamespace(name=name, violation=SimpleNamespace(closure=x)) for name, x in zip("ab", gaps, strict=True)
    ]
    solution = SimpleNamespace(phases=parts)

    def read(_: Any, run: Run, *__: Any) -> Any:
        if given.get("lack"):
            raise NoNumbersError(given["lack"])
        solution.run = run
        return solution

    solver = SimpleNamespace(
        plants=make_plants(), program=None, _balance_impacts=lambda _, outcome: (outcome.run, outcome.x),
        _evaluate=lambda *_: np.zeros(1), _is_judged=given.get("is_judged", True), _read=read,
    )  # fmt: skip
    task = make_task()
    task.solver = SolverOptions(tolerance=given.get("tolerance", SolverOptions.tolerance))
    outcome: Any = Ended(Run(SOLVED, 5, 1.0, 1.0), ENDED, SimpleNamespace(parameters=None))
    return PhasedSolver._answer(cast(Any, solver), task, outcome)


def test_an_answer_that_is_judged_well_is_a_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    assert answer(monkeypatch).run.status == SOLVED
    assert answer(monkeypatch, is_judged=False, judged="bad", cause="it falls").run.status == SOLVED


def test_an_answer_without_numbers_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    failure = answer(monkeypatch, lack="a kernel fails")
    assert (failure.run.status, failure.finding) == (INVALID, f"ended {INVALID}, at the end: a kernel fails")


def test_loops_that_stay_open_come_before_other_constraints(monkeypatch: pytest.MonkeyPatch) -> None:
    """Above 1e-8, or the tolerance; the phase is named."""
    for tolerance, gap, is_open in (
        (1e-9, 0.9e-8, False),
        (1e-9, 1.1e-8, True),
        (1e-6, 0.9e-6, False),
        (1e-6, 1.1e-6, True),
    ):
        found = answer(monkeypatch, gaps=(None, gap), tolerance=tolerance)
        assert isinstance(found, Failure) == is_open
    failure = answer(
        monkeypatch, gaps=(1e-9, 0.5), cause="it falls", judged="bad", jumps={"a": "it jumps"}, tolerance=1e-9
    )
    assert (failure.run.status, failure.finding) == (OPEN, f"p1: ended {OPEN}, by 5.0e-01 of 1.0e-08")


def test_the_judges_cause_comes_before_branches(monkeypatch: pytest.MonkeyPatch) -> None:
    failure = answer(monkeypatch, cause="it falls", judged="bad", jumps={"a": "it jumps"})
    assert (failure.run.status, failure.finding) == ("bad", "ended bad, it falls")


@pytest.mark.parametrize(
    ("given", "status", "finding"),
    [
        ({"jumps": {"b": "it jumps"}}, JUMPED, "p1: ended {}; it jumps"),
        ({"others": {"a": "it is elsewhere"}}, ELSEWHERE, "p0: ended {}; it is elsewhere"),
        ({"jumps": {"a": "it jumps"}, "others": {"a": "it is elsewhere"}}, JUMPED, "p0: ended {}; it jumps"),
        ({"jumps": {"b": "it jumps"}, "others": {"a": "it is elsewhere"}}, ELSEWHERE, "p0: ended {}; it is elsewhere"),
    ],
)
def test_motions_that_change_their_branch_are_no_answers(
    monkeypatch: pytest.MonkeyPatch, given: dict[str, Any], status: str, finding: str
) -> None:
    failure = answer(monkeypatch, **given)
    assert (failure.run.status, failure.finding) == (status, finding.format(status))


# --- starts ---------------------------------------------------------------------------------------------------------


def test_bounds_that_cross_are_a_failure_of_their_phase(monkeypatch: pytest.MonkeyPatch) -> None:
    solver: Any = SimpleNamespace(plants=make_plants())
    monkeypatch.setattr(phases, "find_crossed_bounds", lambda problem, _: "q: 2 > 1" if problem.name == "p1: " else "")
    failure = PhasedSolver._find_crossed(solver, make_task())
    assert failure is not None
    assert (failure.finding, failure.run) == ("p1: q: 2 > 1", Run(BAD_BOUNDS, 0, 0.0, 0.0))
    one: Any = SimpleNamespace(plants=make_plants(1))
    assert PhasedSolver._find_crossed(one, make_task(1)) is None


def test_starts_outside_their_range_are_a_failure_of_their_phase(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        phases, "find_wrong_start", lambda problem, _: ("too high", "bounds.q") if problem.name == "p1: " else None
    )
    failure: Any = phases._make_ready(make_task(), make_plants(), cast(Any, None), cast(Any, None))
    assert (failure.finding, failure.place) == ("p1: too high", "p1: bounds.q")
    assert failure.run == Run(INFEASIBLE[0], 0, 0.0, 0.0)
    monkeypatch.setattr(phases, "settle_phases", lambda *given: ("settled", given[2]))
    ready: Any = phases._make_ready(make_task(1), make_plants(1), cast(Any, "guess"), cast(Any, lambda *x: x))
    assert (ready.problem, ready.guess, ready.solver[0]) == (("settled", "guess"), "guess", ("settled", "guess"))


# --- sizes and links ------------------------------------------------------------------------------------------------


def test_a_phase_counts_its_own_variables_and_rows() -> None:
    sizes = [SimpleNamespace(program=SimpleNamespace(kept=np.zeros(n), kept_rows=np.zeros(n + 1))) for n in (3, 5)]
    own: Any = SimpleNamespace(phases=sizes)
    assert [tuple(vars(_measure_part(own, k)).values()) for k in (0, 1)] == [(3, 4, 0, 0), (5, 6, 0, 0)]


def test_parts_of_links_that_no_stage_has_are_named_with_their_expressions() -> None:
    """Conditions by their rows, terms of the cost by numbers below 0, and other rows of the link as a whole."""
    said = [SimpleNamespace(expression=f"e{k}") for k in range(2)]
    priced = [SimpleNamespace(expression=f"c{k}") for k in range(2)]
    rows = [
        SimpleNamespace(
            link=SimpleNamespace(conditions=said, cost=priced),
            conditions=np.array([first, first + 1]),
            costs=np.array([cost, cost + 1]),
            extent=(first, first + 3),
        )
        for first, cost in ((10, 0), (20, 5))
    ]
    for unstaged, found in (
        ([11], [("links[0].conditions[1].expression", ": e1")]),
        ([20, -1 - 6], [("links[1].conditions[0].expression", ": e0"), ("links[1].cost[1].expression", ": c1")]),
        ([-1], [("links[0].cost[0].expression", ": c0")]),
        ([12, 22], [("links[0]", ""), ("links[1]", "")]),
        ([13, 9], []),
    ):
        own: Any = SimpleNamespace(links=rows, unstaged=np.array(unstaged))
        assert list(_list_unstaged(own)) == found


def test_a_link_has_its_own_violation_cost_and_impulses() -> None:
    contact = SimpleNamespace(sensor="foot", axes=(0, 2))
    impact = SimpleNamespace(contacts=(contact,), blows=(SimpleNamespace(joint="knee"),))
    terms = [SimpleNamespace(title="effort", weight=2.0), SimpleNamespace(title="time", weight=3.0)]
    found = SimpleNamespace(
        repeats=np.array([104]), extent=(101, 103), costs=np.array([1, 0]),
        impact=SimpleNamespace(
            impulses=[np.array([3, 5])], changes=np.array([0, 1]), multipliers=np.array([2]), blows=np.array([4])
        ),
    )  # fmt: skip
    solver: Any = SimpleNamespace(
        transcription=SimpleNamespace(links=[found], offsets=[SimpleNamespace(rows=0), SimpleNamespace(rows=100)])
    )
    g = np.array([50.0, 1.0, -2.0, 60.0, 7.0])
    lower, upper = np.zeros(5), np.array([0.0, 3.0, 0.0, 0.0, 3.0])
    x, cost = np.arange(10.0, 20.0), np.array([5.0, 11.0])
    for is_impact in (True, False):
        link = SimpleNamespace(source="a", target="b", cost=terms, impact=impact if is_impact else None)
        task: Any = SimpleNamespace(links=[link])
        values = PhasedSolver._read_link(solver, task, 0, x, cost, g, lower, upper)
        assert (values.source, values.target, values.violation) == ("a", "b", 4.0)
        assert values.terms == (("effort", 22.0), ("time", 15.0))
        assert bool(values.impulses) == is_impact
    link.impact = impact
    values = PhasedSolver._read_link(solver, task, 0, x, cost, g, lower, upper)
    (impulse,) = values.impulses
    assert (impulse.sensor, impulse.components) == ("foot", (13.0, 0.0, 15.0))
    assert (values.changes, values.multipliers) == ((10.0, 11.0), (12.0,))
    assert values.stops == (("knee", 14.0),)
