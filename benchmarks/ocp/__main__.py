"""Measure: `python -m benchmarks.ocp`; tables to the terminal, figures to build/bench-ocp."""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import casadi as ca
from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.afternoon import write_functions
from benchmarks.ocp.peer import Effort, Peer, list_settings, write_dynamics
from mbsgen.pipeline import read_tree
from mbsrun import Mechanism, load
from mbsrun.ocp import schemes
from mbsrun.ocp.guess import make_guess
from mbsrun.ocp.problem import Form, Problem, Representation
from mbsrun.ocp.solution import Solution
from mbsrun.ocp.solve import Solver
from mbsrun.ocp.statement import read_problem
from mbsrun.ocp.trajectory import Trajectory

MODELS = Path(__file__).parents[2] / "models"
SAME = 1e-6  # relative difference of costs within which two optima are one
OURS = "mbsgen"


@dataclass(frozen=True)
class Row:
    """What one way of solving took in one representation: its best round."""

    representation: str
    way: str
    seconds_building: float  # program and compilation
    variables: int
    constraints: int
    status: str
    iterations: int
    cost: float
    cpu_seconds: float
    cpu_seconds_evaluating: float

    @property
    def evaluating(self) -> float:
        """Give milliseconds per iteration for functions and derivatives."""
        return 1e3 * self.cpu_seconds_evaluating / max(self.iterations, 1)

    @property
    def solving(self) -> float:
        """Give milliseconds per iteration for linear algebra, and IPOPT's own."""
        return 1e3 * (self.cpu_seconds - self.cpu_seconds_evaluating) / max(self.iterations, 1)


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
    begin = time.perf_counter()
    solver = Solver(problem, plant)
    program = solver.transcription.program
    solver.solve(replace(problem, solver=replace(problem.solver, max_iterations=0)), guess)  # makes the functions

    def solve() -> Effort:
        outcome = solver.solve(problem, guess)
        run, cost = outcome.run, outcome.cost.total if isinstance(outcome, Solution) else float("nan")
        return Effort(run.status, run.iterations, cost, run.cpu_seconds, run.cpu_seconds_evaluating)

    return Way(name, time.perf_counter() - begin, program.variables, program.constraints, solve)


def make_ways(problem: Problem, plant: Mechanism, is_interpreted: bool) -> Iterator[Way]:
    """Make all ways for the representation of a problem, from the same guess."""
    guess = make_guess(problem, plant, schemes.build(problem.family, problem.degree))
    assert isinstance(guess, Trajectory), "the target is within reach"
    yield make_ours(OURS, problem, plant, guess)
    adaptive = (("mu_strategy", "adaptive"),)
    yield make_ours(
        f"{OURS}, adaptive", replace(problem, solver=replace(problem.solver, options=adaptive)), plant, guess
    )
    if not problem.representation.is_ode:
        yield make_ours(f"{OURS}, integral form", replace(problem, form=Form.INTEGRAL), plant, guess)
    dynamics = write_dynamics(write_functions(read_tree(MODELS / "arm_pendulum.yaml")))
    q = ca.SX.sym("q", len(problem.start_q))
    place = ca.Function("place", [q], [write_place(q)])
    settings = list_settings(problem)
    peers = [(False, name) for name in settings] + [(True, "tuned")] * (not is_interpreted)
    for is_compiled, name in peers:
        peer = Peer(problem, dynamics, place, settings[name], is_compiled)
        way = f"CasADi, {'compiled' if is_compiled else 'interpreted'}, {name}"
        yield Way(way, peer.seconds_building, peer.variables, peer.constraints, partial(peer.solve, guess))


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


def show(rows: Sequence[Row], seconds_generating: float | None) -> Table:
    """Lay the rows out, each figure with how many times ours it is."""
    made = "" if seconds_generating is None else f"; loading the model took {seconds_generating:.1f} s"
    title = f"one solve{made}; ours is {OURS!r}"
    table = Table(title=title, box=box.SIMPLE)
    for column in ("representation", "way"):
        table.add_column(column)
    for column in ("build [s]", "iterations", "evaluation [ms]", "algebra [ms]", "solve, CPU [s]", "optimum"):
        table.add_column(column, justify="right")
    for row in rows:
        ours = next(r for r in rows if (r.representation, r.way) == (row.representation, OURS))
        is_same = abs(row.cost - ours.cost) <= SAME * abs(ours.cost)
        table.add_row(
            row.representation,
            row.way,
            f"{row.seconds_building:.1f}",
            str(row.iterations),
            f"{row.evaluating:.2f} ({row.evaluating / ours.evaluating:.1f})",
            f"{row.solving:.1f} ({row.solving / ours.solving:.1f})",
            f"{row.cpu_seconds:.2f} ({row.cpu_seconds / ours.cpu_seconds:.1f})",
            f"{row.cost:.8g}" if is_same else f"{row.cost:.8g}, another",
        )
    return table


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
    parser.add_argument("-o", "--output", type=Path, default=Path("build/bench-ocp"))
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as cache:
        if not given.quick:
            os.environ["XDG_CACHE_HOME"] = cache  # nothing is found made
        begin = time.perf_counter()
        problem, plant = read_problem(MODELS / "arm_reach.ocp.yaml", load)
        seconds_generating = time.perf_counter() - begin
        if given.quick:
            problem = replace(problem, intervals=10, degree=3)
        rows: list[Row] = []
        for name in given.representation or (["IMPL", "EXP1-O"] if given.quick else names):
            chosen = replace(problem, representation=Representation(name))
            rows += measure(
                list(make_ways(chosen, plant, given.quick or given.interpreted)),
                name,
                1 if given.quick else given.rounds,
            )
    Console(width=None if sys.stdout.isatty() else 160).print(show(rows, None if given.quick else seconds_generating))
    given.output.mkdir(parents=True, exist_ok=True)
    figures = {"seconds_generating": seconds_generating, "rows": [asdict(row) for row in rows]}
    (given.output / "ocp.json").write_text(json.dumps(figures, indent=1) + "\n", "utf-8")
    return 0 if all(row.status == "Solve_Succeeded" for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
