"""The files of a solution in phases: PhasedSolution and plants -> a folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mbsrun.ocp.phases.problem import Plants
from mbsrun.ocp.phases.solution import PhasedSolution, write_phased_solution
from mbsrun.ocp.solution import Solution
from mbsrun.ocp.table import write_table

SOLUTION = "solution.json"


def write_files(solution: PhasedSolution, plants: Plants, folder: Path) -> tuple[str, ...]:
    """Write all files, and return their names; times of tables and pictures are since the start of the first phase."""
    folder.mkdir(parents=True, exist_ok=True)
    write_phased_solution(solution, folder / SOLUTION)
    tables = [f"{name}.csv" for name in solution.names]
    for table, phase, plant in zip(tables, shift_phases(solution), plants.phases, strict=True):
        write_table(phase, plant, folder / table)
    return (SOLUTION, *tables)


def shift_phases(solution: PhasedSolution) -> list[Solution]:
    """Return the phases with times since the start of the first one."""
    return [
        replace(
            phase,
            trajectory=replace(
                phase.trajectory, t=phase.trajectory.t + start, point_t=phase.trajectory.point_t + start
            ),
        )
        for phase, start in zip(solution.phases, solution.starts, strict=True)
    ]
