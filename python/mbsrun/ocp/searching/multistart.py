"""Solve one problem from many starts, in this process or in many; a record keeps every attempt.

Start 0 is the guess of the problem; the others are random, of all kinds of `starts` in turn. Start k depends on the
seed and k alone, so a longer list of starts begins with the shorter one. Starts are independent of each other: the
number of starts that found the lowest cost shows the chance of one more start to find it.
"""

from __future__ import annotations

import math
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import FrameType

from mbsrun.environment import describe_environment
from mbsrun.models import find_folder
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.guessing.starts import TURNS, Kind, Variation, list_turning
from mbsrun.ocp.methods import choose
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.searching.attempts import is_higher
from mbsrun.ocp.searching.cluster import open_workers
from mbsrun.ocp.searching.executor import LocalExecutor, Worker
from mbsrun.ocp.searching.search import Executor, Job, OutOfTimeError, Search
from mbsrun.ocp.searching.study import ONE, Study, describe, identify
from mbsrun.ocp.searching.trials import MULTISTART, Found, Hop, Interpolation, Trial, Varied, list_hops
from mbsrun.ocp.solution.record import Attempt, Best, Record, Task, open_record
from mbsrun.ocp.solution.solution import Failure, Solution, Start, Starts
from mbsrun.ocp.solving.judging import OTHER, tell_both, wants_other
from mbsrun.ocp.solving.solve import choose_method

Watch = Callable[[Starts], None]
GUESS = "guess"
KINDS: tuple[Kind, ...] = ("noise", "waves", "turns", "noise", "bumps", "waves", "branches")  # of the starts 1, 2, ...
ROUNDS = 100  # of hops, at most


def state_study(problem: Problem, plant: Plant) -> Study:
    """Return the study of one problem, for a search."""
    return Study(
        problem,
        None,
        ONE,
        ((problem.cost.inputs, problem.cost.input_rates),),
        (problem.representation,),
        tuple(plant.manifest.actuated),
        list_turning(problem, plant.manifest),
        method=choose(choose_method(problem, plant)),
    )


def list_starts(study: Study, seed: int, count: int) -> list[Trial]:
    """List the trials of `count` starts."""
    task = Task((0, 0), study.costs[0], study.representations[0].value)
    trials = [Trial(task, MULTISTART, GUESS, "0", Interpolation(study.problem.guess.inputs))]
    kinds = [kind for kind in KINDS if kind != "turns" or study.turning]
    kinds = [kind for kind in kinds if kind not in ("bumps", "waves") or not study.problem.has_quaternions]
    if not study.problem.start_q:
        kinds = ["noise"]
    for k in range(1, count):
        kind = kinds[(k - 1) % len(kinds)]
        turn = None
        if kind == "turns":
            joints, own = len(study.turning), (k - 1) // len(kinds)
            turn = (study.turning[own % joints], TURNS[own // joints % len(TURNS)])
        variation = Variation(kind, (seed, k), turn)
        trials.append(Trial(task, MULTISTART, kind, f"{seed} {k}", Varied(variation)))
    return trials[:count]


def plan_hops(study: Study, starts: Starts, number: int, count: int) -> list[Trial]:
    """List the hops of a round from the best start of the rounds before; rounds count from 1."""
    has_waves = study.problem.start_q and not study.problem.has_quaternions
    if starts.best is None or starts.best.cost is None or not has_waves:
        return []
    task = Task((0, 0), study.costs[0], study.representations[0].value)
    best = Best(starts.best.cost, number - 1, starts.best.turns)
    return list(list_hops(task, best, number, (starts.seed,), MULTISTART, count))


def gather(trials: Sequence[Trial], attempts: Sequence[Attempt], seed: int, hops: Sequence[Trial] = ()) -> Starts:
    """Collect the results of the finished trials."""
    made = {attempt.key: attempt for attempt in attempts}

    def collect(chosen: Sequence[Trial]) -> tuple[Start, ...]:
        pairs = [(k, made[trial.key]) for k, trial in enumerate(chosen) if trial.key in made]
        return tuple(Start(k, a.part, a.status, a.iterations, a.cpu_seconds, a.cost, a.turns) for k, a in pairs)

    return Starts(seed, len(trials), collect(trials), collect(hops))


# --- the search -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Wish:
    """The number of starts, and the limits of the search."""

    starts: int
    seed: int = 0
    seconds: float = math.inf  # no start begins later
    workers: int = 0  # processes; 0: this one
    hops: int = 0  # in each round, from the best solution so far


def solve_from_many(
    problem: Problem, plant: Plant, model: Path | None, wish: Wish, path: Path, watch: Watch
) -> tuple[Starts, Solution | Failure | None]:
    """Solve a problem from many starts, and solve it again from the best start; return None where none was made.

    The search skips attempts in the record at `path`. It passes the results so far to `watch` after every start. At the
    end of the time, or at an interrupt, the finished starts count. Without a model file, one process makes all starts.
    """
    study = state_study(problem, plant)
    trials, hops = list_starts(study, wish.seed, wish.starts), list[Trial]()
    with open_record(path, identify(study, plant.manifest), describe(study, plant.manifest)) as record:

        def look() -> Starts:
            return gather(trials, list(record.attempts()), wish.seed, hops)

        def show(_attempt: Attempt, _is_best: bool) -> None:
            watch(look())

        watch(look())
        with suppress(OutOfTimeError, KeyboardInterrupt), _open_executor(plant, model, wish.workers) as executor:
            search = Search(study, executor, record, show, wish.seconds)
            with end_at_interrupt(partial(setattr, search, "end", -math.inf)):
                search.try_all(trials)
                for number in range(1, ROUNDS if wish.hops else 1):
                    before = look()
                    own = plan_hops(study, before, number, wish.hops)
                    hops += own
                    search.try_all(own)
                    best, lowest = look().best, before.best
                    if best is None or lowest is None or best == lowest:
                        break
        starts = look()
        return starts, _repeat(study, (trials, hops), starts, plant, record)


@contextmanager
def _open_executor(plant: Plant, model: Path | None, workers: int) -> Iterator[Executor]:
    if workers == 0 or model is None:
        yield LocalExecutor(plant, describe_environment())
        return
    with open_workers(workers, None) as executor_for:
        yield executor_for(find_folder(model))


@contextmanager
def end_at_interrupt(stop: Callable[[], None]) -> Iterator[None]:
    """Call `stop` at the first interrupt, and raise KeyboardInterrupt at the second.

    The current start then ends: an interrupted solver returns a status that would count as the result of its start.
    """

    def end(_number: int, _frame: FrameType | None) -> None:
        stop()
        signal.signal(signal.SIGINT, before)

    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread():  # signals are the main thread's
        yield
        return
    signal.signal(signal.SIGINT, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _repeat(
    study: Study, tried: tuple[list[Trial], list[Trial]], starts: Starts, plant: Plant, record: Record
) -> Solution | Failure | None:
    """Solve from the best start again, and from its motion if that ends elsewhere; without a best, from the first."""
    if not starts.results:
        return None
    best, worker = starts.best or starts.results[0], Worker(plant)
    trial = tried[best.kind == "hops"][best.number]
    motion = None
    if isinstance(trial.start, Hop):
        motion = record.best_motion(trial.task, trial.protocol, trial.round, trial.start.turns)
    found = worker.solve(Job(study, trial, motion))
    if best.cost is not None and (isinstance(found, Failure) or is_higher(found.cost.total, best.cost)):
        motion = record.best_motion(trial.task, trial.protocol, turns=best.turns)
        found = worker.solve(Job(study, replace(trial, start=Found(trial.task, is_held=True)), motion))
    if isinstance(found, Failure) and wants_other(study.problem.solver, found.run):
        asked = replace(study, problem=study.problem.with_solver(OTHER), method=OTHER)
        found = tell_both(found, worker.solve(Job(asked, trial, motion)))
    found = replace(found, problem=study.state(trial.task))
    return found if isinstance(found, Failure) else replace(found, starts=starts)
