"""One problem from many starts: which, in what order, and what came of them.

Start 0 is the problem's own guess; the others are random, of all kinds of `starts` in turn. Start k follows from the
seed and k alone: with more starts, the first ones stay the same. They share nothing, so how often the lowest cost was
found says how likely it is that one more start finds it, and warns where it was found once.
"""

from __future__ import annotations

from collections.abc import Sequence

from mbsgen.manifest import Manifest
from mbsrun.ocp.problem import Problem
from mbsrun.ocp.record import Attempt, Best, Task
from mbsrun.ocp.search import MULTISTART, ONE, Interpolation, Study, Trial, Varied, list_hops
from mbsrun.ocp.solution import Start, Starts
from mbsrun.ocp.starts import TURNS, Kind, Variation, describe_turns, list_turning

GUESS = "guess"
KINDS: tuple[Kind, ...] = ("noise", "waves", "turns", "noise", "bumps", "waves", "branches")  # of the starts 1, 2, ...


def state_study(problem: Problem, manifest: Manifest) -> Study:
    """State the study of one problem, as searches take it."""
    weights = (problem.cost.inputs, problem.cost.input_rates)
    turning = list_turning(problem, manifest)
    return Study(problem, None, ONE, (weights,), (problem.representation,), tuple(manifest.actuated), turning)


def list_starts(study: Study, seed: int, count: int) -> list[Trial]:
    """List the trials of `count` starts."""
    task = Task((0, 0), study.costs[0], study.representations[0].value)
    trials = [Trial(task, MULTISTART, GUESS, "0", Interpolation(study.problem.guess.inputs))]
    kinds = [kind for kind in KINDS if kind != "turns" or study.turning]
    kinds = [kind for kind in kinds if kind not in ("bumps", "waves") or not study.problem.has_quaternions]
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
    """List the hops of a round, from 1, from the best that was found before; none where a motion takes no waves."""
    if starts.best is None or starts.best.cost is None or study.problem.has_quaternions:
        return []
    task = Task((0, 0), study.costs[0], study.representations[0].value)
    best = Best(starts.best.cost, number - 1, starts.best.turns)
    return list(list_hops(task, best, number, (starts.seed,), MULTISTART, count))


def gather(trials: Sequence[Trial], attempts: Sequence[Attempt], seed: int, hops: Sequence[Trial] = ()) -> Starts:
    """Collect what came of the trials that were made."""
    made = {attempt.key: attempt for attempt in attempts}

    def collect(chosen: Sequence[Trial]) -> tuple[Start, ...]:
        pairs = [(k, made[trial.key]) for k, trial in enumerate(chosen) if trial.key in made]
        return tuple(Start(k, a.part, a.status, a.iterations, a.cpu_seconds, a.cost, a.turns) for k, a in pairs)

    return Starts(seed, len(trials), collect(trials), collect(hops))


def describe_starts(starts: Starts) -> str:
    """Say in words what was found, and no more."""
    made, best = len(starts.results), starts.best
    if best is None:
        return f"no solution in {made} starts"
    times = "once" if starts.times == 1 else f"{starts.times} times"
    turns = f" ({describe_turns(best.turns)})" if best.turns else ""
    hops = f", by {len(starts.hops)} hops from the best of them" if starts.hops and not starts.times else ""
    return f"the lowest cost{turns} was found {times} in {made} starts{hops}; lower ones may exist"
