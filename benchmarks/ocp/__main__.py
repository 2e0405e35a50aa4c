"""Measure: `python -m benchmarks.ocp`; tables to the terminal, figures to build/bench-ocp."""

from __future__ import annotations

import argparse
import os
import random
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path

import casadi as ca
from rich.console import Console

from benchmarks.compilation import describe_machine
from benchmarks.newton_euler import write_functions
from benchmarks.ocp.peer import Effort, Peer, Shelf, list_settings, processor_seconds, write_dynamics
from benchmarks.ocp.rows import OURS, Figures, Loads, Row, read_figures, replace_rows, show, write_figures
from benchmarks.symbolic import eliminate, read_tape
from mbsgen.manifest import FILE_NAME
from mbsgen.manifest import read as read_manifest
from mbsgen.pipeline import read_tree
from mbsrun import Mechanism, load
from mbsrun.models import Extent, find_folder
from mbsrun.ocp import schemes
from mbsrun.ocp.guess import make_guess
from mbsrun.ocp.linear import LINEAR_SOLVERS, OWN
from mbsrun.ocp.methods import LINEAR_SOLVER
from mbsrun.ocp.problem import Form, Problem, Representation, find_conflicts
from mbsrun.ocp.solution import Solution
from mbsrun.ocp.solve import Solver
from mbsrun.ocp.statement import read_problem
from mbsrun.ocp.trajectory import Trajectory

MODELS = Path(__file__).parents[2] / "models"
MODEL = MODELS / "arm_pendulum.yaml"
INTERVALS, DEGREE = 100, 4  # the paper's
PEERS = "peers"  # the folder, within that of the figures, of what was compiled for CasADi
BARRIERS: tuple[Mapping[str, str], ...] = ({}, {"mu_strategy": "adaptive"})  # options of IPOPT


@dataclass(frozen=True)
class Way:
    """A program, ready to be solved."""

    name: str
    seconds_building: float
    variables: int
    constraints: int
    solve: Callable[[], Effort]


def make_ours(name: str, problem: Problem, plant: Mechanism, guess: Trajectory) -> Way:
    """Transcribe with generated kernels."""
    begin = processor_seconds()
    solver = Solver(problem, plant)
    program = solver.transcription.program
    solver.solve(replace(problem, solver=replace(problem.solver, max_iterations=0)), guess)  # makes the functions

    def solve() -> Effort:
        outcome = solver.solve(problem, guess)
        run, cost = outcome.run, outcome.cost.total if isinstance(outcome, Solution) else float("nan")
        return Effort(run.status, run.iterations, cost, run.cpu_seconds, run.cpu_seconds_evaluating)

    return Way(name, processor_seconds() - begin, program.variables, program.constraints, solve)


def list_variants(problem: Problem) -> Iterator[tuple[str, Problem]]:
    """List what is ours, by name: all forms that go with a representation, linear solvers and barriers."""
    for form in Form:
        chosen = replace(problem, form=form)
        if find_conflicts(chosen):
            continue
        for options in ({**algebra, **barrier} for algebra in list_algebras() for barrier in BARRIERS):
            name = ", ".join([OURS, *([f"{form.value} form"] * (form is not Form.STANDARD)), *options.values()])
            yield name, replace(chosen, solver=replace(problem.solver, options=tuple(options.items())))


def list_algebras() -> list[Mapping[str, str]]:
    """List options that choose a linear solver: none, then the others that there are."""
    return [{}, *({LINEAR_SOLVER: name} for name in LINEAR_SOLVERS if name != OWN)]


def make_ways(problem: Problem, plant: Mechanism, shelf: Shelf | None) -> Iterator[Way]:
    """Make all ways for the representation of a problem, from the same guess; with a shelf, the compiled ones too."""
    guess = make_guess(problem, plant, schemes.build(problem.family, problem.degree))
    assert isinstance(guess, Trajectory), "the target is within reach"
    for name, chosen in list_variants(problem):
        yield make_ours(name, chosen, plant, guess)
    for name, peer in chain(make_peers(problem, None), make_peers(problem, shelf) if shelf else ()):
        yield Way(name, peer.seconds_building, peer.variables, peer.constraints, partial(peer.solve, guess))


def make_peers(problem: Problem, shelf: Shelf | None) -> Iterator[tuple[str, Peer]]:
    """Make CasADi's own, by name: interpreted, or compiled with a shelf."""
    q = ca.SX.sym("q", len(problem.start_q))
    place = ca.Function("place", [q], [write_place(q)])
    settings = list_settings(problem)
    afternoon = write_dynamics(write_functions(read_tree(MODEL)))
    if shelf is None:
        for name in settings:
            yield f"CasADi, interpreted, {name}", Peer(problem, afternoon, place, settings[name])
    else:
        yield "CasADi, compiled, tuned", Peer(problem, afternoon, place, settings["tuned"], shelf)
        ours = read_ours(problem.representation)
        yield "our equations in CasADi, compiled, tuned", Peer(problem, ours, place, settings["tuned"], shelf)


def read_ours(representation: Representation) -> dict[str, ca.Function]:
    """Give the equations that the kernels hold, without their derivatives, as the peer takes its own."""
    name = representation.kernel
    folder = find_folder(MODEL, Extent((name,), 0, python=True))
    function = eliminate(read_tape(folder, read_manifest(folder / FILE_NAME), (name,))[name], f"ours_{name}")
    return dict.fromkeys(("impl", "semi", "exp"), function)


def write_place(q: ca.SX) -> ca.SX:
    """Give the hand's position: 0.3 m of upper arm, 0.3 m of forearm and 0.1 m of hand in a vertical plane."""
    angles = [q[1], q[1] + q[2], q[1] + q[2] + q[3]]
    reach = sum(length * ca.cos(angle) for length, angle in zip((0.3, 0.3, 0.1), angles, strict=True))
    depth = sum(length * ca.sin(angle) for length, angle in zip((0.3, 0.3, 0.1), angles, strict=True))
    return ca.vertcat(reach * ca.cos(q[0]), reach * ca.sin(q[0]), -depth)


def measure(ways: Sequence[Way], representation: str, rounds: int) -> list[Row]:
    """Solve every way once a round, in random order; keep each one's quickest."""
    best: dict[str, Effort] = {}
    for turn in range(rounds):
        for way in random.Random(turn).sample(ways, len(ways)):
            effort = way.solve()
            held = best.get(way.name)
            if held is None or effort.cpu_seconds < held.cpu_seconds:
                best[way.name] = effort
    return [
        Row(representation, w.name, w.seconds_building, w.variables, w.constraints, **asdict(best[w.name]))
        for w in ways
    ]


def compile_peers(problems: Sequence[Problem], output: Path) -> None:
    """Compile what CasADi writes of some problems, where a run finds it."""
    for problem in problems:
        for name, peer in make_peers(problem, Shelf(output / PEERS)):
            print(f"{problem.representation.value}, {name}: {peer.seconds_building:.1f} s", flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write; 1 where a solve did not succeed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ocp", description=__doc__)
    parser.add_argument(
        "--quick",
        action="store_true",
        help="a coarse mesh, IMPL and EXP1-O, one round, no peer compiled, kernels from the cache",
    )
    parser.add_argument("--interpreted", action="store_true", help="leave out what CasADi compiles, which takes long")
    parser.add_argument("--compile", action="store_true", help="compile what CasADi writes, for a later run, and leave")
    parser.add_argument("--rounds", type=int, default=3)
    names = [r.value for r in Representation]
    parser.add_argument("--representation", action="append", choices=names, help="by default all")
    parser.add_argument("--again", action="store_true", help="measure again what an earlier run kept")
    parser.add_argument("-o", "--output", type=Path, default=Path("build/bench-ocp"))
    given = parser.parse_args(arguments)
    about = f"{describe_machine()}; the quickest of {given.rounds} rounds; N = {INTERVALS}, degree {DEGREE}"
    output: Path = given.output.absolute()
    shelf = None if given.quick or given.interpreted else Shelf(output / PEERS)
    chosen_names = given.representation or (["IMPL", "EXP1-O"] if given.quick else names)
    kept = None if given.quick or given.again else read_figures(output / "ocp.json", about)
    with tempfile.TemporaryDirectory() as scratch:
        if not (given.quick or given.compile):
            os.environ["XDG_CACHE_HOME"] = scratch  # nothing is found made
        begin = processor_seconds()
        problem, plant = read_problem(MODELS / "arm_reach.ocp.yaml", load)
        seconds = None if given.quick else processor_seconds() - begin
        if given.quick:
            problem = replace(problem, intervals=10, degree=3)
        else:
            problem = replace(problem, intervals=INTERVALS, degree=DEGREE)
        if given.compile:
            compile_peers([replace(problem, representation=Representation(name)) for name in chosen_names], output)
            return 0
        figures = kept or Figures(about, len(os.sched_getaffinity(0)), seconds)
        for name in chosen_names:
            if name in figures.representations:
                continue
            before = os.getloadavg()[0]
            ways = make_ways(replace(problem, representation=Representation(name)), plant, shelf)
            rows = measure(list(ways), name, 1 if given.quick else given.rounds)
            figures = replace_rows(figures, rows, Loads(name, before, os.getloadavg()[0]))
            write_figures(figures, output)
    Console(width=None if sys.stdout.isatty() else 160).print(show(figures))
    return 0 if all(row.status == "Solve_Succeeded" for row in figures.rows) else 1


if __name__ == "__main__":
    sys.exit(main())
