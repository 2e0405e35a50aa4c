"""Searches from many starts by hand: rounds, time, motions that are found again, interrupts, and what is repeated."""

from __future__ import annotations

import math
import signal
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsrun.ocp.ground.status import UNREACHABLE
from mbsrun.ocp.problem.problem import SolverOptions
from mbsrun.ocp.searching import executor, multistart, search
from mbsrun.ocp.searching import phases as of_phases
from mbsrun.ocp.searching.executor import DIGITS, SOLVERS, Worker
from mbsrun.ocp.searching.multistart import (
    GUESS,
    KINDS,
    ROUNDS,
    Wish,
    end_at_interrupt,
    gather,
    list_starts,
    plan_hops,
    solve_from_many,
)
from mbsrun.ocp.searching.search import LOST, Job, LostMotionError, Outcome, OutOfTimeError, Search, find_progress
from mbsrun.ocp.searching.trials import Found, Hop, Interpolation, Trial, Varied
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.record import Attempt, Task
from mbsrun.ocp.solution.solution import Failure, Run, Start, Starts

TASK, OTHER = Task((0, 0), (1.0, 0.0), "IMPL"), Task((1, 0), (1.0, 0.0), "IMPL")
STUDY: Any = SimpleNamespace(name="study")


def make_trial(name: str, start: Any = None, number: int = 0, task: Task = TASK) -> Trial:
    return Trial(task, "robust", "noise", name, start or Interpolation("zero"), number)


def make_attempt(trial: Trial, cost: float | None = 1.0, status: str = "good") -> Attempt:
    return Attempt(trial.task, trial.protocol, trial.part, trial.guess, trial.round, status, 3, 0.5, 0.25, cost)


class Notes:
    """A record in memory, which notes what is asked."""

    def __init__(self, *attempts: Attempt, motion: Any = None, best: Attempt | None = None) -> None:
        self.made, self.motion, self.best_of, self.asked = list(attempts), motion, best, list[Any]()
        self.put: list[Any] = []

    def attempts(self) -> Iterable[Attempt]:
        return list(self.made)

    def find(self, key: Any) -> bool:
        return any(attempt.key == key for attempt in self.made)

    def add(self, attempt: Attempt, motion: Any, environment: str = "") -> bool:
        self.made.append(attempt)
        self.asked.append((attempt.guess, motion, environment))
        return attempt.cost == 0.0

    def best(self, protocol: str, number: int | None = None) -> Any:
        return (protocol, number)

    best_turned = best

    def best_motion(self, *asked: Any, **more: Any) -> Any:
        self.asked.append((*asked, *more.values()))
        return self.motion

    def best_attempt(self, *asked: Any) -> Attempt | None:
        self.asked.append(asked)
        return self.best_of

    def put_motion(self, attempt: Attempt, motion: Any) -> None:
        self.put.append((attempt, motion))


class Maker:
    """An executor whose attempts have the costs of their guesses' names."""

    def __init__(self, **costs: float | None) -> None:
        self.costs, self.jobs = costs, list[Job]()

    def carry_out(self, orders: Iterable[Job]) -> Iterator[Outcome]:
        for job in orders:
            self.jobs.append(job)
            cost = self.costs.get(job.trial.guess, 1.0)
            yield Outcome(make_attempt(job.trial, cost), f"motion of {job.trial.guess}", "here")  # type: ignore[arg-type]


def begin(maker: Any, record: Any, **given: Any) -> Search:
    return Search(STUDY, maker, record, **given)


# --- rounds ---------------------------------------------------------------------------------------------------------


def test_rounds_go_on_until_nothing_is_left_to_try(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each round sees the attempts of earlier ones; what is in the record is not made again."""
    rounds = [[make_trial("a"), make_trial("b")], [make_trial("c", number=1)], []]
    seen: list[Any] = []

    def plan(_: Any, protocol: str, number: int, best: Any, before: Any, turned: Any) -> list[Trial]:
        seen.append((protocol, number, best, sorted(key[-1] for key in before), turned))
        return rounds[number]

    monkeypatch.setattr(search, "plan_round", plan)
    record, maker, shown, plans = Notes(make_attempt(make_trial("b"))), Maker(c=0.0), list[Any](), list[Any]()
    begin(maker, record, watch=lambda attempt, is_best: shown.append((attempt.guess, is_best))).run(
        "robust", lambda *counts: plans.append(counts)
    )
    assert [job.trial.guess for job in maker.jobs] == ["a", "c"]
    assert [x[1:] for x in seen] == [
        (0, ("robust", 0), [], ("robust", 0)),
        (1, ("robust", 1), ["a", "b"], ("robust", 1)),
        (2, ("robust", 2), ["a", "b", "c"], ("robust", 2)),
    ]
    assert plans == [(2, 1), (1, 0)]
    assert shown == [("a", False), ("c", True)]
    assert record.asked == [("a", "motion of a", "here"), ("c", "motion of c", "here")]


def test_no_attempt_begins_after_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 4.0, 5.0, 5.1])
    monkeypatch.setattr(search, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    maker = Maker()
    with pytest.raises(OutOfTimeError):
        begin(maker, Notes(), seconds=5.0).try_all([make_trial(name) for name in "abc"])
    assert [job.trial.guess for job in maker.jobs] == ["a", "b"]


def test_progress_is_of_the_first_round_with_something_left(monkeypatch: pytest.MonkeyPatch) -> None:
    rounds = [[make_trial("a"), make_trial("b")], [make_trial("c", number=1)], []]
    monkeypatch.setattr(search, "plan_round", lambda *given: rounds[given[2]])

    def count(*names: str) -> tuple[int, int, int, bool]:
        notes: Any = Notes(*(make_attempt(make_trial(x, number=int(x == "c"))) for x in names))
        found = find_progress(STUDY, notes)
        return found.round, found.trials, found.done, found.is_through

    assert count() == (0, 2, 0, False)
    assert count("b") == (0, 2, 1, False)
    assert count("a", "b") == (1, 1, 0, False)
    assert count("a", "b", "c") == (1, 1, 1, True)
    rounds[0] = []
    assert count() == (0, 0, 0, True)


# --- motions --------------------------------------------------------------------------------------------------------


def test_trials_start_from_motions_of_the_rounds_before() -> None:
    for start, asked in (
        (Found(OTHER), (OTHER, "robust", 3, "")),
        (Hop(OTHER, "knee", (1,)), (OTHER, "robust", 3, "knee")),
    ):
        record: Any = Notes(motion="kept")
        job = begin(Maker(), record)._prepare(make_trial("x", start, 3))
        assert (job.motion, job.study, record.asked) == ("kept", STUDY, [asked])
    record = Notes(motion="kept")
    assert begin(Maker(), record)._prepare(make_trial("x")).motion is None
    assert record.asked == []


@pytest.mark.parametrize(("cost", "is_same"), [(2.0, True), (2.0 * (1 + 0.9e-6), True), (2.1, False), (None, False)])
def test_a_motion_that_was_not_restored_is_found_again(
    monkeypatch: pytest.MonkeyPatch, cost: float | None, *, is_same: bool
) -> None:
    """By its attempt, to the cost that was recorded; where it ends elsewhere, it is sought once."""
    monkeypatch.setattr(search, "SAME", 1e-6)
    monkeypatch.setattr(search, "restate", lambda _, attempt: make_trial(attempt.guess))
    lost = make_attempt(make_trial("old"), 2.0)
    record: Any = Notes(best=lost)
    maker = Maker(old=cost)
    own = begin(maker, record)
    if is_same:
        assert own.find_motion(TASK, "robust", 2, "t") == "motion of old"
        assert record.put == [(lost, "motion of old")]
        return
    for _ in range(2):
        with pytest.raises(LostMotionError, match=r"target 0,0 in IMPL: noise old ends in .* and ended in 2\.0"):
            own.find_motion(TASK, "robust", 2, "t")
    assert len(maker.jobs) == 1
    assert record.put == []


def test_a_motion_without_an_attempt_that_solved_is_none() -> None:
    for best in (None, make_attempt(make_trial("old"), None)):
        record: Any = Notes(best=best)
        assert begin(Maker(), record).find_motion(TASK, "robust") is None


def test_a_trial_whose_motion_is_lost_counts_as_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    def prepare(_: Any, trial: Trial) -> Job:
        if trial.guess == "a":
            raise LostMotionError("lost")
        return Job(STUDY, trial, None)

    monkeypatch.setattr(Search, "_prepare", prepare)
    record: Any = Notes()
    begin(Maker(), record).try_all([make_trial("a"), make_trial("b")])
    assert [(x.guess, x.status, x.cost) for x in record.made] == [("a", LOST, None), ("b", "good", 1.0)]


# --- starts of one problem ------------------------------------------------------------------------------------------


def make_study(*turning: int, quaternions: bool = False, start: tuple[float, ...] = (0.0,)) -> Any:
    guess = SimpleNamespace(inputs="dynamic")
    problem = SimpleNamespace(guess=guess, start_q=start, has_quaternions=quaternions, solver=SolverOptions())
    return SimpleNamespace(
        problem=problem, costs=((2.0, 3.0),), representations=(SimpleNamespace(value="IMPL"),), turning=turning,
        state=lambda task: ("stated", task),
    )  # fmt: skip


def test_starts_are_the_guess_and_kinds_in_turn() -> None:
    """Turns where joints turn, each joint in each way; noise alone without a start, no waves with quaternions."""
    found = list_starts(make_study(4, 6), 7, 30)
    assert found[0].start == Interpolation("dynamic")
    assert (found[0].part, found[0].guess, found[0].task) == (GUESS, "0", Task((0, 0), (2.0, 3.0), "IMPL"))
    kinds = [trial.part for trial in found[1:]]
    assert kinds == [KINDS[k % len(KINDS)] for k in range(29)]
    turns = [trial.start.variation.turn for trial in found if trial.part == "turns"]  # type: ignore[union-attr]
    assert turns == [
        (4, multistart.TURNS[0]),
        (6, multistart.TURNS[0]),
        (4, multistart.TURNS[1]),
        (6, multistart.TURNS[1]),
    ]
    assert all(isinstance(trial.start, Varied) for trial in found[1:])
    assert [trial.start.variation.seed for trial in found[1:3]] == [(7, 1), (7, 2)]  # type: ignore[union-attr]
    assert found[2].guess == "7 2"
    assert list_starts(make_study(4, 6), 7, 12) == found[:12]
    assert len(list_starts(make_study(), 7, 0)) == 0
    assert {x.part for x in list_starts(make_study(), 7, 30)} == {GUESS, *KINDS} - {"turns"}
    assert {x.part for x in list_starts(make_study(quaternions=True), 7, 30)} == {GUESS, "noise", "branches"}
    assert {x.part for x in list_starts(make_study(4, start=()), 7, 30)} == {GUESS, "noise"}


def test_hops_start_from_the_best_start_so_far() -> None:
    starts = Starts(5, 3, (Start(0, GUESS, "good", 1, 0.0, 3.0, "a"), Start(1, "noise", "good", 1, 0.0, 2.0, "b")))
    found = plan_hops(make_study(), starts, 2, 3)
    assert [(x.start, x.round) for x in found] == [(Hop(found[0].task, "b", (5, 2, k)), 2) for k in range(3)]
    assert plan_hops(make_study(quaternions=True), starts, 2, 3) == []
    assert plan_hops(make_study(start=()), starts, 2, 3) == []
    assert plan_hops(make_study(), Starts(5, 3, ()), 2, 3) == []
    assert plan_hops(make_study(), Starts(5, 3, (Start(0, GUESS, "bad", 1, 0.0, None, ""),)), 2, 3) == []


def test_finished_trials_have_their_numbers() -> None:
    trials = [make_trial(name) for name in "abc"]
    hops = [make_trial("h")]
    found = gather(
        trials, [make_attempt(trials[2], 4.0), make_attempt(hops[0], 5.0), make_attempt(make_trial("x"))], 9, hops
    )
    assert (found.seed, found.asked) == (9, 3)
    assert [(x.number, x.kind, x.cost) for x in found.results] == [(2, "noise", 4.0)]
    assert [(x.number, x.cost) for x in found.hops] == [(0, 5.0)]


@pytest.fixture
def handler() -> Iterator[Any]:
    """Set Python's handler of interrupts, which programs in the background do not have."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield signal.default_int_handler
    signal.signal(signal.SIGINT, before)


def test_the_first_interrupt_ends_a_search_and_the_second_one_everything(handler: Any) -> None:
    """The handler from before is there again afterwards; other threads have no part in it."""
    stopped = list[int]()
    with pytest.raises(KeyboardInterrupt):  # noqa: SIM117, PT012
        with end_at_interrupt(lambda: stopped.append(1)):
            assert signal.getsignal(signal.SIGINT) is not handler
            signal.raise_signal(signal.SIGINT)
            assert stopped == [1]
            assert signal.getsignal(signal.SIGINT) is handler
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is handler
    with end_at_interrupt(lambda: None):
        pass
    assert signal.getsignal(signal.SIGINT) is handler
    inside: list[Any] = []

    def run() -> None:
        with end_at_interrupt(lambda: None):
            inside.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert inside == [handler]


def run_all(monkeypatch: pytest.MonkeyPatch, costs: dict[str, float | None], wish: Wish, stop_at: str = "") -> Any:
    """Solve from many starts with attempts of given costs; `stop_at` is the attempt after which an interrupt comes."""
    record: Any = Notes()
    shown: list[Any] = []

    class Made(Maker):
        def carry_out(self, orders: Iterable[Job]) -> Iterator[Outcome]:
            for outcome in super().carry_out(orders):
                yield outcome
                if outcome.attempt.guess == stop_at:
                    signal.raise_signal(signal.SIGINT)

    @contextmanager
    def opened(*_: Any) -> Iterator[Any]:
        yield record

    @contextmanager
    def maker(*_: Any) -> Iterator[Any]:
        yield made

    made = Made(**costs)
    monkeypatch.setattr(multistart, "state_study", lambda *_: make_study())
    monkeypatch.setattr(multistart, "open_record", opened)
    monkeypatch.setattr(multistart, "identify", lambda *_: "")
    monkeypatch.setattr(multistart, "describe", lambda *_: "")
    monkeypatch.setattr(multistart, "_open_executor", maker)
    monkeypatch.setattr(
        multistart, "_repeat", lambda _, tried, starts, *__: (len(tried[1]), starts.best and starts.best.cost)
    )
    plant: Any = SimpleNamespace(manifest=None)
    starts, repeated = solve_from_many(None, plant, None, wish, None, shown.append)  # type: ignore[arg-type]
    return [job.trial.guess for job in made.jobs], starts, repeated, shown


def test_all_starts_are_made_and_watched(monkeypatch: pytest.MonkeyPatch) -> None:
    made, starts, repeated, shown = run_all(monkeypatch, {"0": 5.0, "3 1": 4.0, "3 2": None}, Wish(3, 3))
    assert made == ["0", "3 1", "3 2"]
    assert (len(starts.results), starts.best.cost, repeated) == (3, 4.0, (0, 4.0))
    assert [len(x.results) for x in shown] == [0, 1, 2, 3]


def test_hops_go_on_while_they_find_something_lower(monkeypatch: pytest.MonkeyPatch) -> None:
    """From a lower cost others start; a round that finds nothing lower is the last one."""
    costs = {"0": 5.0, "- 5 3 0": 4.0, "- 5 3 1": 6.0, "- 4 3 0": 4.5, "- 4 3 1": 5.5}
    made, starts, repeated, _ = run_all(monkeypatch, costs, Wish(1, 3, hops=2))
    assert made == ["0", "- 5 3 0", "- 5 3 1", "- 4 3 0", "- 4 3 1"]
    assert (repeated, len(starts.hops)) == ((4, 4.0), 4)
    made, *_ = run_all(monkeypatch, {"0": None}, Wish(1, 3, hops=2))
    assert made == ["0"]


def test_an_interrupt_keeps_the_starts_that_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    made, starts, repeated, _ = run_all(monkeypatch, {"0": 5.0, "3 1": 4.0}, Wish(5, 3), stop_at="3 1")
    assert made == ["0", "3 1"]
    assert (len(starts.results), repeated) == (2, (0, 4.0))
    assert ROUNDS >= 2
    assert math.isinf(Wish(1).seconds)


@dataclass(frozen=True)
class Solved:
    """A solution of a cost."""

    run: Any
    cost: Any
    problem: Any = None
    starts: Any = None


def repeat(monkeypatch: pytest.MonkeyPatch, starts: Starts, *found: Any) -> tuple[Any, list[Job]]:
    """Repeat the best of two starts or two hops, where solves end so, one after the other."""
    jobs: list[Job] = []
    ends = list(found)

    class Making:
        def __init__(self, _: Any) -> None:
            pass

        def solve(self, job: Job) -> Any:
            jobs.append(job)
            return ends.pop(0)

    monkeypatch.setattr(multistart, "Worker", Making)
    trials, hops = [make_trial("a"), make_trial("b")], [make_trial("h", Hop(TASK, "t", (1,)), 4)]
    record: Any = Notes(motion="kept")
    study = make_study()
    return multistart._repeat(study, (trials, hops), starts, None, record), jobs  # type: ignore[arg-type]


def one_of(*costs: float | None, kind: str = "noise") -> tuple[Start, ...]:
    return tuple(Start(k, kind, "good", 1, 0.0, cost, "t") for k, cost in enumerate(costs))


def end_at(cost: float) -> Solved:
    return Solved(Run("good", 1, 0.0, 0.0), SimpleNamespace(total=cost))


def test_the_best_start_is_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hop from the motion that it began with; the solution has the study's problem and all starts."""
    monkeypatch.setattr(multistart, "wants_other", lambda *_: False)
    starts = Starts(0, 2, one_of(3.0, 2.0))
    found, jobs = repeat(monkeypatch, starts, end_at(2.0))
    assert [(job.trial.guess, job.motion) for job in jobs] == [("b", None)]
    assert (found.cost.total, found.starts, found.problem) == (2.0, starts, ("stated", TASK))
    starts = Starts(0, 2, one_of(3.0), one_of(1.0, kind="hops"))
    _, jobs = repeat(monkeypatch, starts, end_at(1.0))
    assert [(job.trial.guess, job.motion) for job in jobs] == [("h", "kept")]
    assert multistart._repeat(None, ([], []), Starts(0, 2, ()), None, None) is None  # type: ignore[arg-type]


def test_a_start_that_ends_elsewhere_is_repeated_from_its_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multistart, "wants_other", lambda *_: False)
    failure = Failure(None, Run("bad", 1, 0.0, 0.0), "no way", "go")  # type: ignore[arg-type]
    for first in (end_at(5.0), failure):
        found, jobs = repeat(monkeypatch, Starts(0, 2, one_of(3.0, 2.0)), first, end_at(2.0))
        assert [(job.trial.start, job.motion) for job in jobs][1] == (Found(TASK, is_held=True), "kept")
        assert found.cost.total == 2.0
    _, jobs = repeat(monkeypatch, Starts(0, 2, one_of(3.0, 2.0)), end_at(1.5))
    assert len(jobs) == 1


def test_another_method_is_asked_where_no_start_has_an_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the first start."""
    failure = Failure(None, Run("bad", 1, 0.0, 0.0), "no way", "go")  # type: ignore[arg-type]
    monkeypatch.setattr(multistart, "wants_other", lambda *_: True)
    monkeypatch.setattr(multistart, "replace", lambda x, **new: _change(x, new))
    monkeypatch.setattr(multistart, "tell_both", lambda first, second: replace(second, run=first.run))
    study = make_study()
    study.problem.with_solver = lambda method: f"by {method}"
    monkeypatch.setattr(__import__(__name__, fromlist=["x"]), "make_study", lambda: study)
    found, jobs = repeat(monkeypatch, Starts(0, 2, one_of(None, None)), failure, end_at(7.0))
    assert [job.trial.guess for job in jobs] == ["a", "a"]
    assert (jobs[1].study.problem, jobs[1].study.method) == ("by ipopt", "ipopt")
    assert (found.cost.total, found.run.status) == (7.0, "bad")


def _change(x: Any, new: dict[str, Any]) -> Any:
    return SimpleNamespace(**(vars(x) | new)) if isinstance(x, SimpleNamespace) else replace(x, **new)


# --- one attempt ----------------------------------------------------------------------------------------------------


def make_worker(monkeypatch: pytest.MonkeyPatch, **found: Any) -> tuple[Any, list[Any]]:
    """Make a worker whose solvers note what they solve; `found` are their ends, by problem."""
    solved: list[Any] = []

    class Solving:
        def __init__(self, problem: Any, _: Any) -> None:
            self.made = problem.name

        def solve(self, problem: Any, guess: Any) -> Any:
            solved.append((self.made, problem.name, guess))
            return found[problem.name]

    monkeypatch.setattr(executor, "Solver", Solving)
    monkeypatch.setattr(executor, "structure", lambda problem: problem.shape)
    plant: Any = SimpleNamespace(manifest=SimpleNamespace(model="m", model_hash="0123456789abcdef"))
    return Worker(plant, {"version": "9"}), solved


def make_problem(name: str, shape: str = "s") -> Any:
    solver = SimpleNamespace(method="mbs", options=(("a", 1),))
    return SimpleNamespace(name=name, shape=shape, solver=solver, family="f", degree=2)


@dataclass(frozen=True)
class Ran:
    """A run."""

    status: str = "good"
    iterations: int = 4
    cpu_seconds: float = 2.0
    cpu_seconds_evaluating: float = 1.0


@dataclass(frozen=True)
class End:
    """The end of a solve."""

    run: Ran
    trajectory: Any = "motion"
    is_only_acceptable: bool = False
    cost: Any = field(default_factory=lambda: SimpleNamespace(total=3.0))
    size: Any = field(
        default_factory=lambda: SimpleNamespace(variables=1, constraints=2, jacobian_nonzeros=3, hessian_nonzeros=4)
    )
    resimulation: Any = None


def test_solvers_are_kept_by_structure_and_the_oldest_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    worker, _ = make_worker(monkeypatch)
    shapes = [f"s{k}" for k in range(SOLVERS)]
    first = [worker._find_solver(make_problem("x", shape)) for shape in shapes]
    assert [worker._find_solver(make_problem("y", shape)) for shape in shapes] == first
    assert worker._find_solver(make_problem("y", "s0")) is first[0]
    worker._find_solver(make_problem("z", "new"))
    assert worker._find_solver(make_problem("y", "s0")) is first[0]
    assert worker._find_solver(make_problem("y", "s1")) is not first[1]
    assert len(worker._solvers) == SOLVERS


def test_a_start_without_a_pose_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    worker, solved = make_worker(monkeypatch)
    monkeypatch.setattr(executor, "state", lambda _: make_problem("whole"))
    worker.make_guess = lambda *_: None
    failure = worker.solve(Job(STUDY, make_trial("a"), None))
    assert (failure.run, solved) == (Run(UNREACHABLE, 0, 0.0, 0.0), [])
    assert worker.carry_out(Job(STUDY, make_trial("a"), None)).attempt.status == UNREACHABLE


def test_rough_starts_are_solved_on_a_coarse_mesh_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its processor time counts; its failure is named as such."""
    whole, coarse = make_problem("whole", "w"), make_problem("coarse", "c")
    monkeypatch.setattr(executor, "state", lambda _: whole)
    monkeypatch.setattr(executor, "coarsen", lambda *_: coarse)
    monkeypatch.setattr(executor, "adapt", lambda motion, problem, _: f"{motion} on {problem.name}")
    monkeypatch.setattr(executor.schemes, "build", lambda *_: None)
    trial = make_trial("a", Varied(SimpleNamespace()))  # type: ignore[arg-type]
    worker, solved = make_worker(monkeypatch, coarse=End(Ran(cpu_seconds=5.0), "first"), whole=End(Ran()))
    worker.make_guess = lambda *_: "guess"
    found = worker.solve(Job(STUDY, trial, None))
    assert solved == [("coarse", "coarse", "guess"), ("whole", "whole", "first on whole")]
    assert found.run.cpu_seconds == 7.0
    lost = Failure(coarse, Run("bad", 1, 0.0, 0.0), "no way", "go")
    worker, solved = make_worker(monkeypatch, coarse=lost)
    worker.make_guess = lambda *_: "guess"
    failure = worker.solve(Job(STUDY, trial, None))
    assert (failure.run.status, failure.problem, len(solved)) == ("Coarse_bad", whole, 1)
    worker, solved = make_worker(monkeypatch, whole=End(Ran()))
    worker.make_guess = lambda *_: "guess"
    assert worker.solve(Job(STUDY, make_trial("a"), None)).run.cpu_seconds == 2.0
    assert solved == [("whole", "whole", "guess")]


def test_attempts_have_the_numbers_of_solutions_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of answers that are sure; a checked one has its defect."""
    problem = make_problem("whole")
    monkeypatch.setattr(executor, "state", lambda _: problem)
    monkeypatch.setattr(executor, "count_turns", lambda *_: "knee")
    checked = replace(End(Ran()), resimulation=SimpleNamespace(defect=1e-9))
    monkeypatch.setattr(executor, "resimulate", lambda *_: checked)
    worker, _ = make_worker(monkeypatch)
    for found, is_checked, cost, defect in (
        (End(Ran()), False, 3.0, None),
        (End(Ran()), True, 3.0, 1e-9),
        (replace(End(Ran()), is_only_acceptable=True), False, None, None),
        (Failure(problem, Run("bad", 4, 2.0, 0.0), "no way", "go"), False, None, None),
    ):
        worker.solve = lambda _, found=found: found
        outcome = worker.carry_out(Job(STUDY, replace(make_trial("a"), is_checked=is_checked), None))
        attempt = outcome.attempt
        assert (attempt.cost, attempt.defect, attempt.iterations) == (cost, defect, 4)
        assert (outcome.motion, attempt.turns) == (("motion", "knee") if cost else (None, ""))
        assert (attempt.variables, attempt.hessian_nonzeros) == ((1, 4) if cost else (None, None))
        told = '"version": "9", "model": "m", "generated": "0123456789ab", "solver": "mbs", "a": 1'
        assert outcome.environment == "{" + told + "}"
    assert DIGITS == 12


def test_trials_start_from_found_motions_their_images_hops_and_variations(monkeypatch: pytest.MonkeyPatch) -> None:
    worker, _ = make_worker(monkeypatch)
    monkeypatch.setattr(executor.schemes, "build", lambda *given: given)
    monkeypatch.setattr(executor, "adapt", lambda motion, problem, scheme: (motion, problem.name, scheme))
    monkeypatch.setattr(executor, "reflect", lambda motion, signs, _: f"{motion} by {signs}")
    monkeypatch.setattr(executor, "hop", lambda motion, problem, _, seed: (motion[0], problem.name, seed))
    monkeypatch.setattr(executor, "vary", lambda _, problem, __, scheme, bumped: (problem.name, scheme, bumped))
    monkeypatch.setattr(executor, "balance", lambda motion, problem, _, inputs: (motion, problem.name, inputs))
    study: Any = SimpleNamespace(mirror="signs", bumped="bumps")
    problem, coarse = make_problem("whole"), SimpleNamespace(name="coarse", family="g", degree=3)

    def guess(start: Any, motion: Any = "m") -> Any:
        return worker.make_guess(Job(study, make_trial("a", start), motion), problem)

    assert guess(Found(TASK)) == ("m", "whole", ("f", 2))
    assert guess(Found(TASK, is_mirrored=True)) == ("m by signs", "whole", ("f", 2))
    assert guess(Hop(TASK, "", (4, 5))) == ("m", "whole", (4, 5))
    for found, expected in ((coarse, ("coarse", ("g", 3), "bumps")), (None, ("whole", ("f", 2), "bumps"))):
        monkeypatch.setattr(executor, "coarsen", lambda *_, found=found: found)
        assert guess(Varied(SimpleNamespace())) == expected  # type: ignore[arg-type]
    worker._move = lambda problem: f"moved {problem.name}"
    assert guess(Interpolation("zero")) == ("moved whole", "whole", "zero")
    worker._move = lambda _: None
    assert guess(Interpolation("zero")) is None


def test_poses_of_targets_are_found_once_and_motions_are_finite(monkeypatch: pytest.MonkeyPatch) -> None:
    worker, _ = make_worker(monkeypatch)
    found: list[Any] = []
    pose = SimpleNamespace(q=1.0, is_reached=True)

    def find(problem: Any, _: Any) -> Any:
        found.append(problem.start_q)
        return pose

    monkeypatch.setattr(executor, "find_pose", find)
    monkeypatch.setattr(executor.schemes, "build", lambda *_: "scheme")
    monkeypatch.setattr(executor, "rest", lambda *_: "rest")
    motion = SimpleNamespace(point_q=np.ones(2))
    monkeypatch.setattr(executor, "interpolate", lambda *_: motion)
    guess, end = (
        SimpleNamespace(motion="interpolation", upright=()),
        SimpleNamespace(sensors=1, coordinates=2, orientations=3),
    )

    def state(start: float, how: str = "interpolation") -> Any:
        own = SimpleNamespace(motion=how, upright=guess.upright)
        return SimpleNamespace(family="f", degree=2, guess=own, end=end, start_q=start, bounds=SimpleNamespace(q=5))

    assert worker._move(state(1.0, "rest")) == "rest"
    assert worker._move(state(1.0)) is motion
    assert worker._move(state(1.0)) is motion
    worker._move(state(2.0))
    assert found == [1.0, 2.0]
    motion.point_q[1] = np.nan
    assert worker._move(state(1.0)) is None
    motion.point_q[1] = 1.0
    pose.is_reached = False
    assert worker._move(state(1.0)) is None


# --- phases ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ready:
    """A problem that is ready: it ends in the next of some outcomes."""

    problem: Any
    guess: Any
    solver: Any
    ends: Any

    def solve(self) -> Any:
        self.ends.asked.append((self.guess, self.problem.solver.fallback))
        return self.ends.left.pop(0)


@dataclass(frozen=True)
class Asked:
    """A problem of which the solver counts."""

    solver: SolverOptions


class Lowest(PhasedSolution):
    """A solution of a cost."""

    def __new__(cls, cost: float) -> Any:
        found: Any = object.__new__(cls)
        object.__setattr__(found, "run", Run("good", 1, 0.0, 0.5))
        object.__setattr__(found, "_cost", cost)
        return found

    def __init__(self, cost: float) -> None:
        pass

    cost = property(lambda self: self._cost)  # type: ignore[assignment]

    def with_solver(self, _: Any) -> Any:
        return self


def solve_many(monkeypatch: pytest.MonkeyPatch, wish: Wish, *found: Any, other: bool = False) -> Any:
    ends = SimpleNamespace(left=list(found), asked=[])
    ready = Ready(Asked(SolverOptions()), "guess", SimpleNamespace(plants=None), ends)
    monkeypatch.setattr(of_phases, "prepare_phases", lambda *_: ready)
    monkeypatch.setattr(of_phases._Draw, "move", lambda own, *_: (own.kind, own.seed))
    monkeypatch.setattr(of_phases, "wants_other", lambda *_: other)
    monkeypatch.setattr(of_phases, "replace", lambda x, **new: x if isinstance(x, Lowest) else replace(x, **new))
    shown: list[Any] = []
    starts, best = of_phases.solve_phases_from_many(None, None, wish, shown.append)  # type: ignore[arg-type]
    return starts, best, ends.asked, shown


LOST_RUN = Failure(None, Run("bad", 2, 0.0, 0.0), "no way", "go")  # type: ignore[arg-type]


def test_phases_start_from_their_guess_then_from_kinds_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without another method; the lowest cost is the best, and the first of equal ones."""
    ends = [LOST_RUN, Lowest(3.0), Lowest(2.0), Lowest(2.0), LOST_RUN]
    starts, best, asked, shown = solve_many(monkeypatch, Wish(5, 8), *ends)
    assert best is ends[2]
    assert asked == [
        ("guess", False), (("noise", (8, 1)), False), (("waves", (8, 2)), False), (("bumps", (8, 3)), False),
        (("noise", (8, 4)), False),
    ]  # fmt: skip
    assert [(x.number, x.kind, x.cost) for x in starts.results] == [
        (0, GUESS, None), (1, "noise", 3.0), (2, "waves", 2.0), (3, "bumps", 2.0), (4, "noise", None)
    ]  # fmt: skip
    assert [len(x.results) for x in shown] == [1, 2, 3, 4, 5]
    assert (starts.seed, starts.asked) == (8, 5)


def test_failures_of_all_starts_are_the_first_one_or_another_methods_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    second = replace(LOST_RUN, finding="another")
    _, best, asked, _ = solve_many(monkeypatch, Wish(2), LOST_RUN, second)
    assert best is LOST_RUN
    answer = Lowest(7.0)
    _, best, asked, _ = solve_many(monkeypatch, Wish(2), LOST_RUN, second, answer, other=True)
    assert best is answer
    assert asked[-1] == ("guess", None)


def test_phases_start_no_more_after_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 5.0, 5.1])
    monkeypatch.setattr(of_phases, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    starts, *_ = solve_many(monkeypatch, Wish(9, seconds=5.0), Lowest(1.0))
    assert len(starts.results) == 1


def test_a_problem_that_cannot_start_is_one_failed_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(of_phases, "prepare_phases", lambda *_: LOST_RUN)
    starts, best = of_phases.solve_phases_from_many(None, None, Wish(4, 2), lambda _: None)  # type: ignore[arg-type]
    assert best is LOST_RUN
    assert [(x.number, x.kind, x.status, x.cost) for x in starts.results] == [(0, GUESS, "bad", None)]
    assert (starts.seed, starts.asked) == (2, 4)
