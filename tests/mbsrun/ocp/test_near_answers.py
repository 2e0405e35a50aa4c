"""Many solves from solutions nearby, by hand: which are taken together, in what parts, and which are judged alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.ocp.ground.status import SOLVED
from mbsrun.ocp.problem.problem import SolverOptions
from mbsrun.ocp.solving import nearby, phases
from mbsrun.ocp.solving.nearby import NearAnswer, _finish_alone, _read_part, _solve_alone, _stack, solve_all_near
from mbsrun.ocp.solving.phases import PhasedSolver

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Own:
    """A solution nearby."""

    near: Any = None
    x: Any = None
    near_of: Any = None


@dataclass(frozen=True)
class Begin:
    """The numbers of a start."""

    lower: Array
    scales: Array | None = None
    cost_scale: float = 1.0
    parameters: Array = field(default_factory=lambda: np.zeros(1))
    upper: Array = field(default_factory=lambda: np.ones(2))
    g_lower: Array = field(default_factory=lambda: np.zeros(3))
    g_upper: Array = field(default_factory=lambda: np.ones(3))


def make_start(problem: Any, own: Any = None, most: int = 5) -> Any:
    return SimpleNamespace(problem=problem, own=own or Own(), most_iterations=most, instance=None, state=None)


# --- groups ---------------------------------------------------------------------------------------------------------


def test_problems_of_one_method_are_solved_together_and_others_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Answers come in the order of the starts."""
    stacks = {"a": object(), "b": object()}
    together: list[Any] = []

    def solve_stack(_: Any, method: Any, starts: Any) -> list[Any]:
        together.append((method, [x.problem for x in starts]))
        return [f"{x.problem} together" for x in starts]

    monkeypatch.setattr(nearby, "_solve_stack", solve_stack)
    monkeypatch.setattr(nearby, "_solve_alone", lambda _, start: f"{start.problem} alone")
    monkeypatch.setattr(nearby, "can_stack", lambda _: True)
    asked: list[Any] = []

    def make_stacks(problem: str, threads: int) -> Any:
        asked.append(threads)
        return stacks.get(problem[0])

    solver: Any = SimpleNamespace(make_stacks=make_stacks)
    starts = [make_start(name) for name in ("a1", "c1", "b1", "a2", "b2")]
    assert solve_all_near(solver, starts, 3) == [
        "a1 together", "c1 alone", "b1 together", "a2 together", "b2 together",
    ]  # fmt: skip
    assert together == [(stacks["a"], ["a1", "a2"]), (stacks["b"], ["b1", "b2"])]
    assert asked == [3] * 5
    monkeypatch.setattr(nearby, "can_stack", lambda _: False)
    assert solve_all_near(solver, starts[:1]) == ["a1 alone"]
    assert solve_all_near(solver, []) == []


def test_one_solve_has_its_solution_as_a_neighbour_where_it_is_noted() -> None:
    for found, notes, expected in (
        (None, [], None),
        ("solved", [], NearAnswer("solved", None)),  # type: ignore[arg-type]
        ("solved", ["first", "last"], NearAnswer("solved", "last")),  # type: ignore[arg-type]
    ):

        def solve_near(problem: Any, own: Any, most: int, note: Any, notes: Any = notes, found: Any = found) -> Any:
            assert (problem, own, most) == ("p", "o", 7)
            for own_note in notes:
                note(own_note)
            return found

        solver: Any = SimpleNamespace(solve_near=solve_near)
        answer = _solve_alone(solver, make_start("p", "o", 7))
        assert (answer and vars(answer)) == (expected and vars(expected))


def test_numbers_of_solves_stand_side_by_side() -> None:
    """Scales of 1 where a start has none."""
    given: Any = [Begin(np.array([1.0, 2.0])), Begin(np.array([3.0, 4.0]), np.array([5.0, 6.0]))]
    starts = [make_start(None, Own(near="n0"), 3), make_start(None, Own(near="n1"), 4)]
    found = _stack(given, starts, np.array([7.0, 8.0]))
    assert found.lower.tolist() == [[1, 2], [3, 4]]
    assert found.scales.tolist() == [[1, 1], [5, 6]]
    assert (found.upper.shape, found.g_lower.tolist(), found.g_upper.tolist()) == ((2, 2), [[0] * 3] * 2, [[1] * 3] * 2)
    assert (found.near, found.most_iterations.tolist(), found.scaling.tolist()) == (("n0", "n1"), [3, 4], [7, 8])


# --- a stack --------------------------------------------------------------------------------------------------------


def solve(
    monkeypatch: pytest.MonkeyPatch,
    numbered: list[Any],
    statuses: list[str],
    x: Any,
    late: dict[int, Any],
    room: int = 9,
) -> tuple[list[Any], list[list[int]]]:
    """Solve starts of which some have numbers; `late` are the answers that are judged at once, by case."""
    parts: list[list[int]] = []

    def read(*given: Any) -> Iterator[Any]:
        part = given[4]
        parts.append(part)
        yield from (late.get(i) for i in part)

    monkeypatch.setattr(nearby, "_read_part", read)
    monkeypatch.setattr(nearby, "_stack", lambda *_: "stack")
    monkeypatch.setattr(nearby, "ROOM", room)
    monkeypatch.setattr(nearby, "_finish_alone", lambda _, given, __, i, own, scaling: (given[0], i, own.x, scaling))
    answer = SimpleNamespace(statuses=statuses, x=np.array(x), near=[f"near {i}" for i in range(len(statuses))])
    solver: Any = SimpleNamespace(
        number_near=lambda problem, *_: numbered[problem],
        scale=lambda problem, scale: 10 * scale + problem,
        program=SimpleNamespace(numpy=SimpleNamespace(count_nonzeros=lambda: (3, 0))),
    )
    starts = [make_start(k, Own(x=f"x{k}")) for k in range(len(numbered))]
    method: Any = lambda stack: answer if stack == "stack" else None  # noqa: E731
    return nearby._solve_stack(solver, method, starts), parts


def test_solved_and_finite_points_are_read_in_parts_and_the_undecided_ones_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A problem without numbers has no answer, and moves the cases after it."""
    numbered = [(0, Begin(np.zeros(2), None, 1.0)), None, *((k, Begin(np.zeros(2), None, 2.0)) for k in (2, 3, 4, 5))]
    late = {0: SimpleNamespace(x="new 0"), 4: SimpleNamespace(x="new 5")}
    statuses = [SOLVED, SOLVED, "bad", SOLVED, SOLVED]
    x = [[0.0], [1.0], [2.0], [np.nan], [4.0]]
    found, parts = solve(monkeypatch, numbered, statuses, x, late, room=6)
    assert parts == [[0, 1], [4]]
    assert [None if a is None else type(a).__name__ for a in found] == [
        "NearAnswer", None, "tuple", None, None, "NearAnswer"
    ]  # fmt: skip
    assert found[2] == (2, 1, "x2", 22.0)
    assert (found[5].found, found[5].neighbour) == (late[4], Own(x="new 5", near="near 4"))
    assert solve(monkeypatch, numbered, statuses, x, late, room=1)[1] == [[0], [1], [4]]
    assert solve(monkeypatch, [None, None], [], [], {})[0] == [None, None]


@dataclass(frozen=True)
class Judged:
    """A judgement."""

    is_feasible: bool = True
    decrease: float = 0.1
    reach: float = 0.2


@dataclass(frozen=True)
class Ran:
    """A run."""

    decrease: float = 0.0
    reach: float = 0.0


def read(
    monkeypatch: pytest.MonkeyPatch, judgements: list[Any], terms: Any, *, bent: bool = True, sharpens: float = -1.0
) -> tuple[list[Any], list[Any]]:
    """Read cases 2 and 0 of three; costs are the products of terms and parameters."""
    asked: list[Any] = []

    class Program:
        has_curved_rows = bent

    class Stacked:
        pattern = None

        def __init__(self, _: Any, count: int) -> None:
            asked.append(count)

        def evaluate(self, x: Array, p: Array) -> Any:
            asked.append((x.tolist(), p.tolist()))
            return SimpleNamespace(terms=np.array(terms))

    def judge(_: Array, __: Any, limits: Any, multipliers: Array, tolerance: float, weights: Array) -> list[Any]:
        asked.append((limits.lower.tolist(), limits.scales.tolist(), multipliers.tolist(), tolerance, weights.tolist()))
        return judgements

    monkeypatch.setattr(nearby, "StackedProgram", Stacked)
    monkeypatch.setattr(nearby, "NumpyProgram", Program)
    monkeypatch.setattr(nearby, "_FUNCTIONS", SimpleNamespace(find=lambda *_: {}))
    monkeypatch.setattr(nearby, "_JUDGES", SimpleNamespace(find=lambda *_: SimpleNamespace(judge=judge)))
    monkeypatch.setattr(nearby, "_make_run", lambda *_: Ran())
    solver: Any = SimpleNamespace(
        program=SimpleNamespace(numpy=Program()), needs_sharpening=lambda _, __, cost, ___: cost == sharpens
    )
    problems = [SimpleNamespace(weight=w, solver=SolverOptions(tolerance=1e-6)) for w in (2.0, 3.0, 4.0)]
    given: Any = [(problem, Begin(np.zeros(1), None, 0.5)) for problem in problems]
    rows = np.array([[0.0], [1.0], [2.0]])
    stack: Any = SimpleNamespace(
        parameters=np.array([[1.0, 5.0], [2.0, 5.0], [3.0, 5.0]]), lower=rows, upper=rows, g_lower=rows, g_upper=rows,
        scales=10 * rows,
    )  # fmt: skip
    answer: Any = SimpleNamespace(x=np.array([[7.0], [8.0], [9.0]]), multipliers=100 * rows)
    return list(_read_part(solver, given, stack, answer, [2, 0])), asked


def test_cases_of_a_part_are_judged_by_their_own_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cost is the product of terms and the first parameters; weights are over the scale of the cost."""
    found, asked = read(monkeypatch, [Judged(), Judged(decrease=0.3)], [[2.0], [4.0]])
    assert asked == [
        2,
        ([[9.0], [7.0]], [[3.0, 5.0], [1.0, 5.0]]),
        ([[2.0], [0.0]], [[20.0], [0.0]], [[200.0], [0.0]], 1e-6, [8.0, 4.0]),
    ]
    assert [(x.cost, x.x.tolist(), x.run) for x in found] == [(6.0, [9.0], Ran(0.1, 0.2)), (4.0, [7.0], Ran(0.3, 0.2))]


@pytest.mark.parametrize(
    ("given", "kept"),
    [
        ({"judgements": [None, Judged()]}, [False, True]),
        ({"judgements": [Judged(is_feasible=False), Judged()]}, [False, True]),
        ({"judgements": [Judged(), Judged()], "terms": [[np.nan], [1.0]]}, [False, True]),
        ({"judgements": [Judged(), Judged()], "bent": False}, [False, False]),
        ({"judgements": [Judged(), Judged()], "sharpens": 1.0}, [True, False]),
    ],
)
def test_cases_that_are_not_decided_are_left(
    monkeypatch: pytest.MonkeyPatch, given: dict[str, Any], kept: list[bool]
) -> None:
    """Without a judgement, violated, without a cost, of a problem that may be convex, or to be sharpened."""
    found, _ = read(monkeypatch, given.pop("judgements"), given.pop("terms", [[1.0], [1.0]]), **given)
    assert [x is not None for x in found] == kept


def test_an_answer_that_is_finished_alone_has_its_own_run_and_multipliers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nearby, "_make_run", lambda *given: ("run", given[3]))
    near = SimpleNamespace(scale=lambda factor: f"near by {factor}")
    answer: Any = SimpleNamespace(near=[None, near], x=["x0", "x1"], multipliers=["m0", "m1"])

    def finish(problem: Any, outcome: Any, own: Any, note: Any) -> Any:
        assert (problem, own) == ("problem", "own")
        assert (outcome.run, outcome.x, outcome.multipliers, outcome.start) == (("run", 1), "x1", "m1", "start")
        assert outcome.near == "near by 2.5"
        note("noted")
        return "found"

    solver: Any = SimpleNamespace(finish_near=finish)
    found = _finish_alone(solver, ("problem", "start"), answer, 1, "own", 2.5)  # type: ignore[arg-type]
    assert found is not None
    assert (found.found, found.neighbour) == ("found", "noted")
    solver.finish_near = lambda *_: None
    assert _finish_alone(solver, ("problem", "start"), answer, 1, "own", 2.5) is None  # type: ignore[arg-type]


def test_runs_have_the_numbers_of_their_case(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nearby.methods, "choose", lambda options: f"by {options}")
    answer: Any = SimpleNamespace(
        statuses=["a", "b"], iterations=[1, 2], seconds=[0.1, 0.2], evaluating=[0.3, 0.4], cpu_seconds=[0.5, 0.6]
    )
    solver: Any = SimpleNamespace(choose_method=lambda problem: f"options of {problem}")
    run = nearby._make_run(solver, "p", answer, 1)  # type: ignore[arg-type]
    assert (run.status, run.iterations, run.seconds, run.cpu_seconds) == ("b", 2, 0.2, 0.6)
    assert (run.seconds_evaluating, run.method) == (0.4, "by options of p")


# --- the solver's part ----------------------------------------------------------------------------------------------


def test_stacks_are_made_once_for_methods_that_solve_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one thread a solve, and without a limit of time."""
    made: list[Any] = []

    def make_many(order: Any, threads: int) -> Any:
        made.append((order.tolerance, order.settings, threads))
        return f"stack {len(made)}"

    chosen: list[SolverOptions] = [SolverOptions(method="mbs")]
    monkeypatch.setattr(phases.methods, "choose", lambda options: options.method)
    monkeypatch.setattr(
        phases, "METHODS", {"mbs": SimpleNamespace(make_many=make_many), "ipopt": SimpleNamespace(make_many=None)}
    )
    monkeypatch.setattr(
        phases, "Assignment", lambda _, tolerance, *given: SimpleNamespace(tolerance=tolerance, settings=given[2])
    )
    solver: Any = SimpleNamespace(choose_method=lambda _: chosen[0], _stacks={}, program=None)

    def make(threads: int = 1) -> Any:
        return PhasedSolver.make_stacks(solver, None, threads)  # type: ignore[arg-type]

    assert (make(), make(), make(2), make()) == ("stack 1", "stack 1", "stack 2", "stack 1")
    chosen[0] = replace(chosen[0], objective_scaling=3.0)
    assert make() == "stack 1"
    for options in (
        SolverOptions(method="ipopt"),
        SolverOptions(method="mbs", threads=2),
        SolverOptions(method="mbs", options=(("max_wall_time", 1.0),)),
    ):
        chosen[0] = options
        assert make() is None
    chosen[0] = SolverOptions(method="mbs", options=(("a", 1),))
    assert make() == "stack 3"
    assert made[-1] == (SolverOptions.tolerance, {"a": 1}, 1)


def test_functions_of_two_numbers_of_points_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """The oldest ones go where a third number comes."""

    class Prepared:
        pass

    monkeypatch.setattr(nearby, "StackedProgram", lambda *given: [given])
    program: Any = Prepared()
    first, second = nearby._bind_functions(program, 18), nearby._bind_functions(program, 3)
    assert first == [(program, 18)]
    assert nearby._bind_functions(program, 18) is first
    assert nearby._bind_functions(program, 5) == [(program, 5)]
    assert nearby._bind_functions(program, 3) is second
    assert nearby._bind_functions(program, 18) is not first
