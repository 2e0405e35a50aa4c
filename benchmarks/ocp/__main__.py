"""Measure: `python -m benchmarks.ocp`; tables to the terminal, figures to build/bench-ocp."""

from __future__ import annotations

import argparse
import os
import random
import statistics
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import casadi as ca
import numpy as np
from rich.console import Console

from benchmarks.compilation import describe_machine, find_cache
from benchmarks.ocp.peer import TUNED, Effort, Peer, Points, Shelf, list_settings, processor_seconds, write_dynamics
from benchmarks.ocp.rows import LONG, OURS, POINTS, STAGES, Figures, Measured, Row, show, write_figures
from benchmarks.study import DisagreementError
from benchmarks.symbolic import read_tape
from mbsgen.manifest import FILE_NAME, Kernel
from mbsgen.manifest import read as read_manifest
from mbsgen.pipeline import read_tree
from mbsrun import Mechanism, load
from mbsrun.measuring.store import Store
from mbsrun.models import Extent, find_folder, fingerprint_generator
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.linear import LINEAR_SOLVERS, OWN
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import make_guess
from mbsrun.ocp.methods.ipopt import LINEAR_SOLVER
from mbsrun.ocp.problem.problem import Form, Problem, Representation, find_conflicts
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import Solver
from mbsrun.ocp.statement.statement import read_problem

MODELS = Path(__file__).parents[2] / "models"
MODEL = MODELS / "arm_pendulum.yaml"
INTERVALS, DEGREE = 100, 4  # the paper's
PEERS = "ocp"  # the folder of CasADi's compiled C, in the cache of benchmarks
MUMPS = "mumps"
BARRIERS: tuple[Mapping[str, str], ...] = ({}, {"mu_strategy": "adaptive"})  # options of IPOPT


@dataclass(frozen=True)
class Way:
    """A program, ready to be solved."""

    name: str
    seconds_building: float
    variables: int
    constraints: int
    solve: Callable[[], Effort]


def make_ours(name: str, problem: Problem, plant: Plant, guess: Trajectory) -> Way:
    """Transcribe with kernels."""
    begin = processor_seconds()
    solver = Solver(problem, plant)
    program = solver.transcription.program
    solver.solve(replace(problem, solver=replace(problem.solver, max_iterations=1)), guess)  # makes the functions

    def solve() -> Effort:
        outcome = solver.solve(problem, guess)
        run, cost = outcome.run, outcome.cost.total if isinstance(outcome, Solution) else float("nan")
        return Effort(run.status, run.iterations, cost, run.cpu_seconds, run.cpu_seconds_evaluating)

    return Way(name, processor_seconds() - begin, program.variables, program.constraints, solve)


def list_variants(problem: Problem) -> Iterator[tuple[str, Problem]]:
    """List our ways, by name: all forms that go with a representation; IPOPT with linear solvers and barriers, and the
    method by stages.
    """
    for form in Form:
        chosen = replace(problem, form=form)
        if find_conflicts(chosen):
            continue
        words = [OURS, *([f"{form.value} form"] * (form is not Form.STANDARD))]
        for options in ({**algebra, **barrier} for algebra in list_algebras() for barrier in BARRIERS):
            name = ", ".join([*words, *options.values()])
            yield name, replace(chosen, solver=replace(problem.solver, method="ipopt", options=tuple(options.items())))
        yield ", ".join([*words, STAGES]), replace(chosen, solver=replace(problem.solver, method="mbs", options=()))


def list_algebras() -> list[Mapping[str, str]]:
    """List options that choose a linear solver: none, then all others."""
    return [{}, *({LINEAR_SOLVER: name} for name in LINEAR_SOLVERS if name != OWN)]


def make_ways(problem: Problem, plant: Mechanism, shelf: Shelf | None) -> Iterator[Way]:
    """Make all ways for the representation of a problem, from the same guess; with a shelf, the compiled ones too."""
    guess = make_guess(problem, plant, schemes.build(problem.family, problem.degree))
    assert isinstance(guess, Trajectory), "the target is within reach"
    for name, chosen in list_variants(problem):
        yield make_ours(name, chosen, plant, guess)
    for name, peer in make_peers(problem, None):
        yield Way(name, peer.seconds_building, peer.variables, peer.constraints, partial(peer.solve, guess))
    if shelf is None:
        return
    for name, peer in make_peers(problem, shelf):
        yield Way(name, peer.seconds_building, peer.variables, peer.constraints, partial(peer.solve, guess))
    mumps = replace(problem, solver=replace(problem.solver, options=((LINEAR_SOLVER, MUMPS),)))
    for name, points in list_points(problem, plant, shelf):
        check_dynamics(name, points, plant, problem.representation.kernel)
        way = make_ours(name, mumps, points, guess)
        yield replace(way, seconds_building=way.seconds_building + points.seconds_compiling)


def make_peers(problem: Problem, shelf: Shelf | None) -> Iterator[tuple[str, Peer]]:
    """Make the ways of plain CasADi, by name: interpreted, or compiled with a shelf."""
    q = ca.SX.sym("q", len(problem.start_q))
    place = ca.Function("place", [q], [write_place(q)])
    settings = list_settings(problem)
    short = write_dynamics(read_tree(MODEL))
    if shelf is None:
        for name in settings:
            yield f"CasADi, interpreted, {name}", Peer(problem, short, place, settings[name])
    else:
        for name in TUNED:
            yield f"CasADi, compiled, {name}", Peer(problem, short, place, settings[name], shelf)


def list_points(problem: Problem, plant: Plant, shelf: Shelf) -> Iterator[tuple[str, Points]]:
    """List the kernels that CasADi writes and differentiates at a point: short recursions, and our equations."""
    kernel, short = problem.representation.kernel, write_dynamics(read_tree(MODEL))
    function = short[{"impl": "impl", "semi_res": "semi"}.get(kernel, "exp")]
    names = [argument.name for argument in read_kernel(plant, kernel).inputs]
    outputs = [argument.name for argument in read_kernel(plant, kernel).outputs]
    named = ca.Function(kernel, function.sx_in(), function.call(function.sx_in()), names, outputs)
    yield f"{POINTS}, mumps", Points(plant, {kernel: named}, shelf)
    folder = find_folder(MODEL, Extent((kernel,), 0, targets=("python",)))
    ours = read_tape(folder, read_manifest(folder / FILE_NAME), (kernel,))
    yield "our equations in CasADi, by points, compiled, mumps", Points(plant, ours, shelf)


def read_kernel(plant: Plant, name: str) -> Kernel:
    """Return the description of a kernel."""
    return plant.manifest.kernel(name)


def check_dynamics(way: str, points: Points, plant: Plant, kernel: str) -> None:
    """Compare a peer's dynamics with ours at a few states, to 1e-9. Raises DisagreementError."""
    rng = np.random.default_rng(5)
    for _ in range(3):
        given = {a.name: rng.uniform(-1, 1, (a.rows, a.cols)) for a in read_kernel(plant, kernel).inputs}
        found, expected = (np.array(p.casadi(kernel)(*given.values())) for p in (points, plant))
        error = float(np.abs(found - expected).max() / max(1.0, float(np.abs(expected).max())))
        if not error <= 1e-9:
            raise DisagreementError(f"{kernel} of {way}: off by {error:.1e}")


def write_place(q: ca.SX) -> ca.SX:
    """Return the position of the hand: 0.3 m of upper arm, 0.3 m of forearm and 0.1 m of hand in a vertical plane."""
    angles = [q[1], q[1] + q[2], q[1] + q[2] + q[3]]
    reach = sum(length * ca.cos(angle) for length, angle in zip((0.3, 0.3, 0.1), angles, strict=True))
    depth = sum(length * ca.sin(angle) for length, angle in zip((0.3, 0.3, 0.1), angles, strict=True))
    return ca.vertcat(reach * ca.cos(q[0]), reach * ca.sin(q[0]), -depth)


def measure(ways: Sequence[Way], representation: str, rounds: int) -> list[Row]:
    """Solve every way once a round, in random order; what takes longer than LONG is solved in the first one alone."""
    efforts: dict[str, list[Effort]] = {way.name: [] for way in ways}
    for turn in range(rounds):
        for way in random.Random(turn).sample(ways, len(ways)):
            done = efforts[way.name]
            if not done or done[0].cpu_seconds <= LONG:
                done.append(way.solve())
    return [make_row(representation, way, efforts[way.name]) for way in ways]


def measure_representation(problem: Problem, plant: Mechanism, shelf: Shelf | None, rounds: int) -> list[Measured]:
    """Make and solve all ways for the representation of a problem, and note the load of the machine."""
    before = os.getloadavg()[0]
    rows = measure(list(make_ways(problem, plant, shelf)), problem.representation.value, rounds)
    return [Measured(tuple(rows), before, os.getloadavg()[0])]


def make_row(representation: str, way: Way, efforts: Sequence[Effort]) -> Row:
    """Describe a way by its quickest solve, and the medians of all."""
    best = min(efforts, key=lambda effort: effort.cpu_seconds)
    return Row(
        representation,
        way.name,
        way.seconds_building,
        way.variables,
        way.constraints,
        **asdict(best),
        rounds=len(efforts),
        cpu_seconds_median=statistics.median(effort.cpu_seconds for effort in efforts),
        cpu_seconds_evaluating_median=statistics.median(effort.cpu_seconds_evaluating for effort in efforts),
    )


def compile_peers(problems: Sequence[Problem], plant: Mechanism, shelf: Shelf) -> None:
    """Compile the C of CasADi for some problems, where a run finds it."""
    for problem in problems:
        for name, peer in make_peers(problem, shelf):
            print(f"{problem.representation.value}, {name}: {peer.seconds_building:.1f} s", flush=True)
        for name, points in list_points(problem, plant, shelf):
            points.casadi(problem.representation.kernel)
            print(f"{problem.representation.value}, {name}: {points.seconds_compiling:.1f} s", flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write; 1 where a solve did not succeed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ocp", description=__doc__)
    parser.add_argument(
        "--quick",
        action="store_true",
        help="a coarse mesh, IMPL and EXP1-O, one round, no peer compiled, kernels from the cache",
    )
    parser.add_argument("--interpreted", action="store_true", help="leave out what CasADi compiles, which takes long")
    parser.add_argument("--prepare", action="store_true", help="compile what CasADi writes, and measure nothing")
    parser.add_argument("--rounds", type=int, default=3)
    names = [r.value for r in Representation]
    parser.add_argument("--representation", action="append", choices=names, help="by default all")
    parser.add_argument("--again", action="store_true", help="measure representations of earlier runs again")
    parser.add_argument("-o", "--output", type=Path, default=Path("build/bench-ocp"))
    given = parser.parse_args(arguments)
    about = f"{describe_machine()}; {given.rounds} rounds; N = {INTERVALS}, degree {DEGREE}"
    output: Path = given.output.absolute()
    shelf = None if given.quick or given.interpreted else Shelf(find_cache() / PEERS)
    chosen_names = given.representation or (["IMPL", "EXP1-O"] if given.quick else names)
    with tempfile.TemporaryDirectory() as scratch:
        if not (given.quick or given.prepare):
            os.environ["XDG_CACHE_HOME"] = scratch  # an empty cache
        begin = processor_seconds()
        problem, plant = read_problem(MODELS / "arm_reach.ocp.yaml", load)
        seconds = None if given.quick else processor_seconds() - begin
        if given.quick:
            problem = replace(problem, intervals=10, degree=3)
        else:
            problem = replace(problem, intervals=INTERVALS, degree=DEGREE)
        if given.prepare:
            problems = [replace(problem, representation=Representation(name)) for name in chosen_names]
            compile_peers(problems, plant, Shelf(find_cache() / PEERS))
            return 0
        figures = Figures(about, len(os.sched_getaffinity(0)), seconds)
        store = Store(output / "ocp.jsonl", Measured, is_renewed=given.again)
        for name in chosen_names:
            chosen = replace(problem, representation=Representation(name))
            facts = (about, given.quick, shelf is None, fingerprint_generator().hex(), chosen)
            rounds = 1 if given.quick else given.rounds
            found = store.find_or_measure(facts, partial(measure_representation, chosen, plant, shelf, rounds))
            figures = replace(figures, measured=(*figures.measured, *found))
            write_figures(figures, output)
    Console(width=None if sys.stdout.isatty() else 160).print(show(figures))
    return 0 if all(row.status == "Solve_Succeeded" for row in figures.rows) else 1


if __name__ == "__main__":
    sys.exit(main())
