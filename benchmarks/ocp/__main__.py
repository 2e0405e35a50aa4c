"""Measure: `python -m benchmarks.ocp`; tables to the terminal, figures to build/bench-ocp."""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import casadi as ca
from rich.console import Console

from benchmarks.afternoon import write_functions
from benchmarks.compilation import describe_machine
from benchmarks.ocp.peer import Effort, Peer, list_settings, processor_seconds, write_dynamics
from benchmarks.ocp.rows import OURS, Figures, Loads, Row, read_figures, replace_rows, show, write_figures
from benchmarks.symbolic import eliminate, read_tape
from mbsgen.manifest import FILE_NAME
from mbsgen.manifest import read as read_manifest
from mbsgen.pipeline import read_tree
from mbsrun import Mechanism, load
from mbsrun.models import Extent, find_folder
from mbsrun.ocp import schemes
from mbsrun.ocp.guess import make_guess
from mbsrun.ocp.problem import Form, Problem, Representation, find_conflicts
from mbsrun.ocp.solution import Solution
from mbsrun.ocp.solve import Solver
from mbsrun.ocp.statement import read_problem
from mbsrun.ocp.trajectory import Trajectory

MODELS = Path(__file__).parents[2] / "models"
MODEL = MODELS / "arm_pendulum.yaml"
INTERVALS, DEGREE = 100, 4  # the paper's


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


def make_ways(problem: Problem, plant: Mechanism, is_interpreted: bool) -> Iterator[Way]:
    """Make all ways for the representation of a problem, from the same guess."""
    guess = make_guess(problem, plant, schemes.build(problem.family, problem.degree))
    assert isinstance(guess, Trajectory), "the target is within reach"
    adaptive = replace(problem.solver, options=(("mu_strategy", "adaptive"),))
    for form in Form:
        chosen = replace(problem, form=form)
        if find_conflicts(chosen):
            continue
        name = OURS if form is Form.STANDARD else f"{OURS}, {form.value} form"
        yield make_ours(name, chosen, plant, guess)
        yield make_ours(f"{name}, adaptive", replace(chosen, solver=adaptive), plant, guess)
    q = ca.SX.sym("q", len(problem.start_q))
    place = ca.Function("place", [q], [write_place(q)])
    settings = list_settings(problem)
    afternoon = write_dynamics(write_functions(read_tree(MODEL)))
    peers = [("CasADi, interpreted, defaults", afternoon, "defaults", False)]
    peers.append(("CasADi, interpreted, tuned", afternoon, "tuned", False))
    if not is_interpreted:
        peers.append(("CasADi, compiled, tuned", afternoon, "tuned", True))
        peers.append(("our equations in CasADi, compiled, tuned", read_ours(problem.representation), "tuned", True))
    for name, dynamics, options, is_compiled in peers:
        peer = Peer(problem, dynamics, place, settings[options], is_compiled)
        yield Way(name, peer.seconds_building, peer.variables, peer.constraints, partial(peer.solve, guess))


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


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write; 1 where a solve did not succeed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ocp", description=__doc__)
    parser.add_argument(
        "--quick",
        action="store_true",
        help="a coarse mesh, IMPL and EXP1-O, one round, no peer compiled, kernels from the cache",
    )
    parser.add_argument("--interpreted", action="store_true", help="leave out what CasADi compiles, which takes long")
    parser.add_argument("--rounds", type=int, default=3)
    names = [r.value for r in Representation]
    parser.add_argument("--representation", action="append", choices=names, help="by default all")
    parser.add_argument("--again", action="store_true", help="measure again what an earlier run kept")
    parser.add_argument("-o", "--output", type=Path, default=Path("build/bench-ocp"))
    given = parser.parse_args(arguments)
    about = f"{describe_machine()}; the quickest of {given.rounds} rounds; N = {INTERVALS}, degree {DEGREE}"
    output: Path = given.output.absolute()
    kept = None if given.quick or given.again else read_figures(output / "ocp.json", about)
    with tempfile.TemporaryDirectory() as scratch, contextlib.chdir(scratch):  # where CasADi leaves what it compiles
        if not given.quick:
            os.environ["XDG_CACHE_HOME"] = scratch  # nothing is found made
        begin = processor_seconds()
        problem, plant = read_problem(MODELS / "arm_reach.ocp.yaml", load)
        seconds = None if given.quick else processor_seconds() - begin
        if given.quick:
            problem = replace(problem, intervals=10, degree=3)
        else:
            problem = replace(problem, intervals=INTERVALS, degree=DEGREE)
        figures = kept or Figures(about, len(os.sched_getaffinity(0)), seconds)
        for name in given.representation or (["IMPL", "EXP1-O"] if given.quick else names):
            if name in figures.representations:
                continue
            before = os.getloadavg()[0]
            chosen = replace(problem, representation=Representation(name))
            ways = make_ways(chosen, plant, given.quick or given.interpreted)
            rows = measure(list(ways), name, 1 if given.quick else given.rounds)
            del ways  # and with it what CasADi compiled, while its folder is there
            figures = replace_rows(figures, rows, Loads(name, before, os.getloadavg()[0]))
            write_figures(figures, output)
    Console(width=None if sys.stdout.isatty() else 160).print(show(figures))
    return 0 if all(row.status == "Solve_Succeeded" for row in figures.rows) else 1


if __name__ == "__main__":
    sys.exit(main())
