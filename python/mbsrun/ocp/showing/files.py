"""The files of a solution in phases: PhasedSolution and plants -> a folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.showing.phase_pictures import make_phased_mechanism, make_phased_trajectories, write_animations
from mbsrun.ocp.showing.pictures import animate, draw_mechanism, plot_mesh, plot_starts, plot_trajectories, save
from mbsrun.ocp.solution.phases import PhasedSolution, write_phased_solution
from mbsrun.ocp.solution.solution import (
    ANIMATION,
    DISTRIBUTION,
    MECHANISM,
    MESH,
    SOLUTION,
    STARTS,
    TABLE,
    TRAJECTORIES,
    Solution,
    write_solution,
)
from mbsrun.ocp.solution.table import measure, write_table


def write_files(solution: PhasedSolution, plants: Plants, folder: Path, columns: Sequence[str] = ()) -> tuple[str, ...]:
    """Write all files, and return their names; times of tables and pictures are since the start of the first phase.

    `columns` are further columns of tables, by names or patterns; a phase has the ones that it knows.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if solution.problem.is_single:
        return _write_single(solution.single, plants.phases[0], folder, columns)
    write_phased_solution(solution, folder / SOLUTION)
    tables, phases = [f"{name}.csv" for name in solution.names], shift_phases(solution)
    for table, phase, plant in zip(tables, phases, plants.phases, strict=True):
        write_table(phase, plant, folder / table, measure(phase, plant).select_known(columns))
    save(make_phased_trajectories(solution, phases, plants), folder / TRAJECTORIES)
    pictures: tuple[str, ...] = (TRAJECTORIES,)
    if all(plant.manifest.coordinates for plant in plants.phases):
        save(make_phased_mechanism(solution, phases, plants), folder / MECHANISM)
        pictures += (MECHANISM, *write_animations(solution, phases, plants, folder))
    for name, phase in zip(solution.names, solution.phases, strict=True):
        if phase.refinement is not None:
            plot_mesh(phase.refinement, folder / f"{name}.mesh.png")
            pictures += (f"{name}.mesh.png",)
    if solution.search is not None:
        plot_starts(solution.search, folder / DISTRIBUTION)
        pictures += (DISTRIBUTION,)
    return (SOLUTION, *tables, *pictures)


def _write_single(solution: Solution, plant: Plant, folder: Path, columns: Sequence[str]) -> tuple[str, ...]:
    """Write the files of a problem without phases."""
    write_solution(solution, folder / SOLUTION)
    write_table(solution, plant, folder / TABLE, columns)
    plot_trajectories(solution, plant.manifest, folder / TRAJECTORIES)
    written = [SOLUTION, TABLE, TRAJECTORIES]
    if plant.manifest.coordinates:
        draw_mechanism(solution, plant, folder / MECHANISM)
        animate(solution, plant, folder / ANIMATION)
        written += [MECHANISM, ANIMATION]
    if solution.refinement is not None:
        plot_mesh(solution.refinement, folder / MESH)
        written.append(MESH)
    if solution.starts is not None:
        plot_starts(solution.starts, folder / DISTRIBUTION)
        written += [DISTRIBUTION, STARTS]
    return tuple(written)


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
