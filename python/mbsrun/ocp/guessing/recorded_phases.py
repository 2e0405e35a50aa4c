"""Guesses of phases from files: a solution in phases, a table for each phase, or parts of one recording.

A folder stands for its tables NAME.csv, such as `mbsrun solve` writes. A recording that several phases take must be
divided among them, by the `guess.times` of each. Phases without a file are guessed as their problem says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from mbsgen.errors import Fault, InputError
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.recorded import find_guess
from mbsrun.ocp.problem.phases import PhasedProblem, Plants, equip_phases
from mbsrun.ocp.solution.phases import Guess, PartialGuess, read_phased_guess
from mbsrun.ocp.statement.sections import is_solution

Name = Callable[[int | None, Sequence[Fault]], list[Fault]]  # the phase, its faults -> the faults with their lines


def keep_names(phase: int | None, faults: Sequence[Fault]) -> list[Fault]:  # noqa: ARG001  # of a Name: phase
    """Name no lines: a problem that is not from a file has none."""
    return list(faults)


def find_phased_guess(
    problem: PhasedProblem, plants: Plants, folder: Path, other: Path | None = None, name: Name = keep_names
) -> Guess | PartialGuess:
    """Read the guess of a problem's phases: of the file or folder `other`, or of files in `folder` that phases name.

    Raises InputError with the faults of all files; `name` names the lines that give the files of phases.
    """
    if other is None:
        files = {k: folder / own for k, own in enumerate(_list_own(problem)) if own is not None}
        return _read(problem, plants, files, name)
    phases = range(len(problem.phases))
    if other.is_dir():
        tables = {k: other / f"{problem.phases[k].name}.csv" for k in phases}
        return _read(problem, plants, tables, keep_names)
    undivided = [] if is_solution(other) or len(phases) == 1 else _list_undivided(problem)
    if undivided:
        finding = f"a recording for all phases, and no guess.times divide it for {', '.join(undivided)}"
        remedy = "give each phase its guess.times [from, to] and the recording as guess.solution; or a folder of tables"
        raise InputError([Fault(str(other), 0, "", finding, remedy)])
    return _read(problem, plants, dict.fromkeys(phases, other), keep_names)


def _list_own(problem: PhasedProblem) -> Iterator[str | None]:
    return (phase.problem.guess.solution for phase in problem.phases)


def _list_undivided(problem: PhasedProblem) -> list[str]:
    return [phase.name for phase in problem.phases if phase.problem.guess.times == (None, None)]


def _read(problem: PhasedProblem, plants: Plants, files: Mapping[int, Path], name: Name) -> Guess | PartialGuess:
    """Read the files of some phases."""
    found: dict[int, Trajectory] = {}
    unknowns: tuple[tuple[str, float], ...] = ()
    faults: list[Fault] = []
    solved = {k: path for k, path in files.items() if is_solution(path)}
    for path in dict.fromkeys(solved.values()):
        own = [k for k in solved if solved[k] == path]
        names = tuple(problem.phases[k].name for k in own)
        try:
            guess = read_phased_guess(path, names, tuple(plants.phases[k].manifest for k in own))
        except InputError as error:
            faults += name(None, error.faults)
            continue
        unknowns = guess.unknowns
        found |= dict(zip(own, guess.trajectories, strict=True))
    equipped = equip_phases(problem, plants).phases
    for k, path in files.items():
        if k in solved:
            continue
        try:
            found[k] = find_guess(path, problem.phases[k].problem, equipped[k])
        except InputError as error:
            faults += name(k, error.faults)
    if faults:
        raise InputError(faults)
    if len(found) == len(problem.phases):
        return Guess(tuple(found[k] for k in range(len(found))), unknowns)
    return PartialGuess(tuple((problem.phases[k].name, motion) for k, motion in sorted(found.items())), unknowns)
