"""Solve a problem of phases from many starts: its guess, and random motions about the guess of every phase.

Start 0 is the guess of the problem. In start k, bumps, waves or noise move the guess of every phase, as in `starts`;
start k depends on the seed and k alone.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.starts import Kind, disturb
from mbsrun.ocp.problem.phases import PhasedProblem, Plants
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.searching.multistart import GUESS, Watch, Wish, end_at_interrupt
from mbsrun.ocp.solution.phases import Guess, PhasedSolution
from mbsrun.ocp.solution.solution import Failure, Start, Starts
from mbsrun.ocp.solving.judging import wants_other
from mbsrun.ocp.solving.phases import prepare_phases

KINDS: tuple[Kind, ...] = ("noise", "waves", "bumps")  # of the starts 1, 2, ...


@dataclass(frozen=True)
class _Draw:
    """The kind of a start, and the seed of its random numbers."""

    kind: Kind
    seed: tuple[int, int]

    def move(self, guess: Guess, problem: PhasedProblem, plants: Plants) -> Guess:
        """Move the guess of every phase."""
        motions = [
            self._move_phase(motion, phase.problem, k, plants)
            for k, (motion, phase) in enumerate(zip(guess.trajectories, problem.phases, strict=True))
        ]
        return replace(guess, trajectories=tuple(motions))

    def _move_phase(self, motion: Trajectory, own: Problem, k: int, plants: Plants) -> Trajectory:
        plant, rng = plants.phases[k], np.random.default_rng((*self.seed, k))
        kind: Kind = "noise" if own.has_quaternions or not plant.manifest.coordinates else self.kind
        return disturb(motion, kind, own, plant, plant.manifest.actuated, rng)


def solve_phases_from_many(
    problem: PhasedProblem, plants: Plants, wish: Wish, watch: Watch
) -> tuple[Starts, PhasedSolution | Failure | None]:
    """Solve from many starts, and return the best solution, or else the first failure; None where no start ended.

    It passes the outcomes to `watch` after every start. At the end of the time, or at an interrupt, the finished
    starts count. Raises ProblemError with every fault of the problem.
    """
    results: list[Start] = []
    best: PhasedSolution | Failure | None = None
    ready = prepare_phases(problem, plants)
    if isinstance(ready, Failure):
        return Starts(wish.seed, wish.starts, (_sum_up(0, GUESS, ready),)), ready
    asked, guess = ready.problem, ready.guess
    alone = replace(ready, problem=replace(asked, solver=replace(asked.solver, fallback=False)))
    ended, end = [False], time.monotonic() + wish.seconds
    with end_at_interrupt(lambda: ended.__setitem__(0, True)):
        for k in range(wish.starts):
            if ended[0] or time.monotonic() > end:
                break
            draw = _Draw(KINDS[(k - 1) % len(KINDS)], (wish.seed, k))
            moved = draw.move(guess, asked, ready.solver.plants) if k else guess
            found = replace(alone, guess=moved).solve()
            results.append(_sum_up(k, draw.kind if k else GUESS, found))
            if best is None or _is_lower(found, best):
                best = found
            watch(Starts(wish.seed, wish.starts, tuple(results)))
    starts = Starts(wish.seed, wish.starts, tuple(results))
    if isinstance(best, Failure) and wants_other(asked.solver, best.run):
        best = ready.solve()
    if isinstance(best, PhasedSolution):
        best = replace(best.with_solver(asked.solver), search=starts)
    return starts, best


def _is_lower(found: PhasedSolution | Failure, best: PhasedSolution | Failure) -> bool:
    if isinstance(found, Failure):
        return False
    return isinstance(best, Failure) or found.cost < best.cost


def _sum_up(number: int, kind: str, found: PhasedSolution | Failure) -> Start:
    run, cost = found.run, found.cost if isinstance(found, PhasedSolution) else None
    return Start(number, kind, run.status, run.iterations, run.cpu_seconds, cost, "")
