"""Measure: `python -m benchmarks.classics`; a table to the terminal, figures and a page to build/bench-classics."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from benchmarks.classics.peers import SETTINGS, Peer, place_start
from benchmarks.classics.problems import CLASSICS, Classic
from benchmarks.compilation import describe_machine
from benchmarks.ocp.peer import Effort
from mbsrun import load
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.no_mechanism import NO_MECHANISM
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.status import ACCEPTABLE, SOLVED
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import make_guess
from mbsrun.ocp.guessing.state_guess import complete
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import Solver
from mbsrun.ocp.statement.statement import read_problem

FILES = Path(__file__).parents[2] / "models" / "classics"
QUICK = ("brachistochrone", "van_der_pol", "car", "cart_pole")
SAME = 1e-6  # relative difference of costs within which two optima are one
LONG = 2.0  # s; what takes longer is solved once
OURS, THEIRS = "mbsrun", "CasADi"
WAYS: Mapping[str, tuple[str, Mapping[str, str]]] = {
    "IPOPT": ("ipopt", {}),
    "IPOPT, adaptive": ("ipopt", {"mu_strategy": "adaptive"}),
    "mbs": ("mbs", {}),
}


@dataclass(frozen=True)
class Row:
    """A problem, solved by one way: the quickest of several rounds."""

    way: str
    status: str
    found: float  # the printed figure; not a number where nothing was found
    iterations: int
    seconds: float  # of the processor
    variables: int
    constraints: int

    @property
    def is_solved(self) -> bool:
        """Return whether the solver converged."""
        return self.status in (SOLVED, ACCEPTABLE) and math.isfinite(self.found)


@dataclass(frozen=True)
class Case:
    """A problem with all rows: ours, the file as it stands first, then the peer's."""

    name: str
    grid: str
    ours: tuple[Row, ...]
    peers: tuple[Row, ...]

    @property
    def classic(self) -> Classic:
        """Return the published problem."""
        return next(classic for classic in CLASSICS if classic.name == self.name)

    @property
    def best(self) -> Row:
        """Return our quickest row with the optimum of the file as it stands."""
        return _find_quickest(self.ours, self.ours[0].found)

    @property
    def peer(self) -> Row:
        """Return the peer's quickest row with the same optimum; with another one, where it never finds that."""
        return _find_quickest(self.peers, self.ours[0].found)

    @property
    def ratio(self) -> float:
        """Return the peer's time over ours."""
        return self.peer.seconds / self.best.seconds


@dataclass(frozen=True)
class Figures:
    """The cases of a run, and the machine."""

    about: str
    load: float  # processes that want to run, in the mean of a minute
    cases: tuple[Case, ...] = ()


def _is_same(a: float, b: float) -> bool:
    return abs(a - b) <= SAME * abs(b)


def _find_quickest(rows: Sequence[Row], found: float) -> Row:
    """Return the quickest row with an optimum; without one, of all that are solved, or of all."""
    same = [row for row in rows if row.is_solved and _is_same(row.found, found)]
    return min(same or [row for row in rows if row.is_solved] or rows, key=lambda row: row.seconds)


class Ours:
    """A file, solved by `mbsrun`; each way has its program, from one guess."""

    def __init__(self, classic: Classic) -> None:
        """Read the file, and guess."""
        self.classic = classic
        self.problem, self.plant = read_classic(classic.name)
        scheme = schemes.build(self.problem.family, self.problem.degree)
        guess = make_guess(self.problem, self.plant, scheme)
        assert isinstance(guess, Trajectory), "the targets are within reach"
        self.guess = complete(guess, self.problem, self.plant)
        self._solvers: dict[str, tuple[Solver, Problem]] = {}

    def solve(self, way: str) -> Row:
        """Solve in one of WAYS."""
        if way not in self._solvers:
            method, options = WAYS[way]
            chosen = self.problem.with_solver(method)
            merged = {**dict(chosen.solver.options), **options}
            chosen = replace(chosen, solver=replace(chosen.solver, options=tuple(merged.items())))
            self._solvers[way] = Solver(chosen, self.plant), chosen
            once = replace(chosen, solver=replace(chosen.solver, max_iterations=1))
            self._solvers[way][0].solve(once, self.guess)  # makes the functions
        solver, problem = self._solvers[way]
        done = solver.solve(problem, self.guess)
        cost = done.cost.total if isinstance(done, Solution) else math.nan
        sizes = solver.program.casadi.variables, solver.program.casadi.constraints
        run = done.run
        return Row(way, run.status, self.classic.factor * cost, run.iterations, run.cpu_seconds, *sizes)


def read_classic(name: str) -> tuple[Problem, Plant]:
    """Read the file of a problem, with or without a mechanism."""
    return read_problem(FILES / f"{name}.ocp.yaml", _load, NO_MECHANISM)


def _load(model: Path) -> Plant:
    return load(model)


class Theirs:
    """The same problem in plain CasADi, on the same grid and from the same guess."""

    def __init__(self, ours: Ours) -> None:
        """Transcribe it."""
        problem, guess, self.classic = ours.problem, ours.guess, ours.classic
        is_constant = problem.inputs == "constant"
        tolerance = problem.solver.tolerance
        self.peer = Peer(
            self.classic.peer,
            problem.family.value,
            problem.degree,
            problem.intervals,
            is_constant=is_constant,
            tolerance=tolerance,
        )
        inputs = np.concatenate((guess.u, guess.controls), axis=1)[:, None]
        self.start = place_start(
            np.concatenate((guess.q, guess.qd, guess.states), axis=1),
            np.concatenate((guess.point_q, guess.point_qd, guess.point_states), axis=2),
            inputs if is_constant else np.repeat(inputs, problem.degree, axis=1),
            None if problem.horizon_range is None else problem.horizon,
        )

    def solve(self, way: str) -> Row:
        """Solve in one of SETTINGS."""
        done: Effort = self.peer.solve(way, self.start)
        found = self.classic.peer_factor * done.cost
        return Row(way, done.status, found, done.iterations, done.cpu_seconds, *self.peer.sizes)


def measure(classic: Classic, rounds: int) -> Case:
    """Solve a problem in all ways, once a round in turn."""
    ours = Ours(classic)
    sides: tuple[tuple[str, Callable[[str], Row], Sequence[str]], ...] = (
        (OURS, ours.solve, tuple(WAYS)),
        (THEIRS, Theirs(ours).solve, tuple(SETTINGS)),
    )
    rows: dict[tuple[str, str], Row] = {}
    for _ in range(rounds):
        for side, solve, ways in sides:
            for way in ways:
                known = rows.get((side, way))
                if known is None:
                    rows[side, way] = solve(way)
                elif known.is_solved and known.seconds < LONG:
                    rows[side, way] = min(known, solve(way), key=lambda row: row.seconds)
    problem = ours.problem
    grid = f"{problem.intervals} x {problem.degree}" + ("" if problem.inputs == "constant" else ", polynomials")
    found = {side: tuple(row for (of, _), row in rows.items() if of == side) for side in (OURS, THEIRS)}
    return Case(classic.name, grid, found[OURS], found[THEIRS])


def write_line(case: Case) -> str:
    """Write a case as a row of the table."""
    classic, first, best, peer = case.classic, case.ours[0], case.best, case.peer
    digits = f"{classic.count_digits(first.found)} of {classic.digits}" if first.is_solved else first.status
    other = "" if _is_same(peer.found, first.found) else f", {peer.found:.9g}"
    failed = "" if peer.is_solved else f", {peer.status}"
    cells = (
        f"[{classic.title}](../../models/classics/{classic.name}.ocp.yaml)",
        classic.source,
        classic.printed,
        f"{first.found:.9g}",
        digits,
        case.grid,
        f"{first.iterations}",
        f"{1e3 * first.seconds:.0f}",
        f"{best.way}: {best.iterations}, {1e3 * best.seconds:.0f}",
        f"{peer.way}: {peer.iterations}, {1e3 * peer.seconds:.0f}{other}{failed}",
        f"{case.ratio:.1f}",
    )
    return f"| {' | '.join(cells)} |"


HEAD = (
    "| problem | source | printed | found | digits | grid | iterations | ms | our best | CasADi's best | ratio |",
    "|---|---|---:|---:|---:|---|---:|---:|---|---|---:|",
)


def mean(ratios: Sequence[float]) -> float:
    """Return the geometric mean."""
    return math.exp(sum(map(math.log, ratios)) / len(ratios)) if ratios else math.nan


def summarise(cases: Sequence[Case]) -> list[str]:
    """Write what all cases amount to."""
    whole = [c for c in cases if c.ours[0].is_solved and c.classic.count_digits(c.ours[0].found) == c.classic.digits]
    lost = [c.classic.title for c in cases if not c.ours[0].is_solved]
    compared = [c for c in cases if c.best.is_solved and c.peer.is_solved and _is_same(c.peer.found, c.ours[0].found)]
    ratios = [case.ratio for case in compared]
    lines = [
        f"- {len(cases)} problems; not solved from the file as it stands: {', '.join(lost) or 'none'}.",
        f"- {len(whole)} optima agree with all printed digits, to within one unit of the last.",
        f"- Time of plain CasADi over ours, each at its best: {mean(ratios):.1f} in the geometric mean of the",
        f"  {len(ratios)} problems that end in one optimum; the least is {min(ratios, default=math.nan):.1f}.",
    ]
    by_stages = {c.classic.title: row for c in cases for row in c.ours if row.way == "mbs"}
    own = [title for title, row in by_stages.items() if not row.is_solved]
    others = [
        f"{c.classic.title} ({by_stages[c.classic.title].found:.6g})"
        for c in cases
        if by_stages[c.classic.title].is_solved and not _is_same(by_stages[c.classic.title].found, c.ours[0].found)
    ]
    lines.append(f"- The method `mbs` does not solve: {', '.join(own) or 'none'}. It ends in another optimum in:")
    lines.append(f"  {', '.join(others) or 'none'}.")
    return lines


def list_remarks(cases: Sequence[Case]) -> list[str]:
    """List the remarks on problems whose digits need one."""
    return [f"- {case.classic.title}: {case.classic.remark}" for case in cases if case.classic.remark]


def write_page(figures: Figures) -> str:
    """Write the page."""
    lines = [
        "# Published problems of optimal control",
        "",
        f"`python -m benchmarks.classics`: {figures.about}; {figures.load:.1f} processes wanted to run.",
        "",
        "Each problem is [a file](../../models/classics), solved as `mbsrun solve` does it, from the guess that the",
        "file describes; nothing is tuned. The found optimum, iterations and ms are of the file as it stands, by IPOPT",
        "with the project's linear solver. `digits` counts the printed digits to within one unit of the last. The grid",
        "is N x d, by Radau points; inputs are constant over an interval, or polynomials.",
        "",
        "The peer states each problem [on its own](../classics/problems.py) in plain CasADi: the same collocation,",
        "grid, guess and tolerance, with `expand`, solved by IPOPT with MUMPS in three settings. Not equal: the peer",
        "fixes the start by bounds of variables, where ours is written as rows, and eliminated; its functions run in",
        "CasADi's virtual machine. Times are of the processor, in ms, of the quickest round, on one core, without the",
        "making of programs. `ratio` is CasADi's best over our best.",
        "",
        *summarise(figures.cases),
        "",
        *HEAD,
        *(write_line(case) for case in figures.cases),
        "",
        *list_remarks(figures.cases),
    ]
    return "\n".join(lines) + "\n"


def write_figures(figures: Figures, folder: Path) -> None:
    """Write the figures, and the page that shows them."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "classics.json").write_text(json.dumps(asdict(figures), indent=1) + "\n", "utf-8")
    (folder / "classics.md").write_text(write_page(figures), "utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write; 1 where a file is not solved as it stands."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.classics", description=__doc__)
    parser.add_argument("--quick", action="store_true", help=f"one round of {', '.join(QUICK)}")
    names = [classic.name for classic in CLASSICS]
    parser.add_argument("--problem", action="append", choices=names, default=[], help="by default all")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("-o", "--output", type=Path, default=Path("build/bench-classics"))
    given = parser.parse_args(arguments)
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})  # MUMPS' BLAS takes as many threads as there are cores
    output: Path = given.output.absolute()
    rounds = 1 if given.quick else given.rounds
    chosen = QUICK if given.quick else given.problem or names
    about = f"{describe_machine()}, CasADi {version('casadi')}; {rounds} rounds"
    figures = Figures(about, os.getloadavg()[0])
    for classic in CLASSICS:
        if classic.name in chosen:
            figures = replace(figures, cases=(*figures.cases, measure(classic, rounds)))
            print(write_line(figures.cases[-1]), flush=True)
            write_figures(figures, output)
    print(*summarise(figures.cases), sep="\n")
    return 0 if all(case.ours[0].is_solved for case in figures.cases) else 1


if __name__ == "__main__":
    sys.exit(main())
