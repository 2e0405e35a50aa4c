"""A problem without phases, solved: Problem and plant -> Solution or Failure.

It is a problem of one phase, which has no name: see `ocp.solving.phases`.
"""

from __future__ import annotations

from dataclasses import replace

from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.phases import PhasedProblem, Plants, list_one
from mbsrun.ocp.problem.problem import Problem, SolverOptions
from mbsrun.ocp.solution.phases import Guess, PhasedSolution
from mbsrun.ocp.solution.solution import Failure, Solution
from mbsrun.ocp.solving.phases import Make, PhasedSolver, solve_phases
from mbsrun.ocp.solving.phases import choose_method as choose_of_phases
from mbsrun.ocp.solving.runs import Watch
from mbsrun.ocp.transcription.transcription import Transcription


class Solver:
    """A transcribed problem, to be solved for any start, targets, bounds and weights."""

    def __init__(self, problem: Problem, plant: Plant, *, is_judged: bool = True) -> None:
        """Transcribe a problem. Raises ProblemError with every fault of it.

        Where answers are not judged, the word of the method counts, as of one sample of a loop.
        """
        self.whole = PhasedSolver(list_one(problem), Plants((plant,)), is_judged=is_judged)

    @property
    def plant(self) -> Plant:
        """Return the kernels with the problem's parameters."""
        return self.whole.plants.phases[0]

    @property
    def transcription(self) -> Transcription:
        """Return how problems become numbers of the program, and its variables motions."""
        return self.whole.transcription.phases[0]

    @property
    def program(self) -> Prepared:
        """Return the program, ready for methods."""
        return self.whole.program

    def solve(
        self, problem: Problem, guess: Trajectory, watch: Watch | None = None, usual: Trajectory | None = None
    ) -> Solution | Failure:
        """Solve a problem of the same structure from a guess on its grid, as `PhasedSolver.solve` does."""
        own = None if usual is None else Guess((usual,))
        return read_one(self.whole.solve(list_one(problem), Guess((guess,)), watch, own))


def solve(
    problem: Problem,
    plant: Plant,
    watch: Watch | None = None,
    guess: Trajectory | None = None,
    make: Make = PhasedSolver,
) -> Solution | Failure:
    """Solve a problem from a guess, by default the one that it describes; a guess may be on any grid.

    `make` may return an earlier solver of the same structure. Where no pose meets the targets, it fails at once. Raises
    ProblemError with every fault of the problem.
    """
    own = None if guess is None else Guess((guess,))
    return read_one(solve_phases(list_one(problem), Plants((plant,)), watch, own, make))


def choose_method(problem: Problem, plant: Plant) -> SolverOptions:
    """Return the solver's options with their method, as for a problem of phases."""
    return choose_of_phases(list_one(problem), Plants((plant,)))


def read_one(found: PhasedSolution | Failure) -> Solution | Failure:
    """Return what was found of a problem without phases."""
    if isinstance(found, PhasedSolution):
        return found.single
    assert isinstance(found.problem, PhasedProblem), "it is of the whole"
    return replace(found, problem=found.problem.phases[0].problem)
