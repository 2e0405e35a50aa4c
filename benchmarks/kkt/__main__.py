"""Measure: `python -m benchmarks.kkt`; a table to the terminal, figures and a page to build/bench-kkt."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path

from benchmarks.compilation import describe_machine
from benchmarks.kkt.problems import PROBLEMS
from benchmarks.kkt.solving import LIMIT, LONG, Case, measure
from benchmarks.kkt.transcription import SCHEMES, Problem, Scheme, admits
from mbsrun.measuring.store import Store
from mbsrun.ocp.ground.linear import compile_own

QUICK = ("van der Pol", "brachistochrone", "gas oil")
PRECISE = "Radau 3"  # the scheme by which optima are compared with published ones
GOAL = 2.0


@dataclass(frozen=True)
class Figures:
    """The cases of a run, and the machine."""

    about: str
    load: float  # processes that want to run, in the mean of a minute
    cases: tuple[Case, ...] = ()


def mean(ratios: Sequence[float]) -> float:
    """Return the geometric mean."""
    return math.exp(sum(map(math.log, ratios)) / len(ratios)) if ratios else math.nan


def list_pairs(names: Sequence[str]) -> Iterator[tuple[Problem, Scheme]]:
    """List the problems of some names, or all, with the schemes that admit them."""
    for problem in PROBLEMS:
        if not names or problem.name in names:
            yield from ((problem, scheme) for scheme in SCHEMES if admits(problem, scheme))


def write_line(case: Case) -> str:
    """Write a case as a row of a table."""
    own, peer = case.own, case.peer
    same = "" if case.is_same else ", another optimum"
    status = "" if own.is_solved else f", {own.status}"
    their = f"{peer.iterations}" if peer.is_solved else f"{peer.iterations}, {peer.status}"
    lost = " **lost**" if case.is_lost else ""
    cells = (
        own.scheme,
        f"{own.variables} · {own.constraints}",
        f"{own.iterations}{status} · {their}{same}{lost}",
        f"{1e3 * own.seconds_algebra:.1f} · {1e3 * peer.seconds_algebra:.1f}",
        f"{case.algebra:.2f} ({case.algebra_median:.2f})",
        f"{1e3 * own.seconds:.1f} · {1e3 * peer.seconds:.1f}",
        f"{case.whole:.2f}",
        f"{own.cost:.8g}",
    )
    return f"| {' | '.join(cells)} |"


def summarise(cases: Sequence[Case]) -> list[str]:
    """Write what all cases amount to."""
    comparable = [case for case in cases if case.is_comparable]
    problems = list(dict.fromkeys(case.own.problem for case in cases))
    by_problem = {
        name: mean([case.algebra for case in comparable if case.own.problem == name])
        for name in problems
        if any(case.own.problem == name for case in comparable)
    }
    lost = [f"{case.own.problem}, {case.own.scheme}" for case in cases if case.is_lost]
    below = [case for case in comparable if case.algebra < GOAL]
    slowest = min(comparable, key=lambda case: case.algebra, default=None)
    lines = [
        f"- {len(problems)} problems, {len(cases)} programs. Lost: {', '.join(lost) or 'none'}.",
        f"- {len(comparable)} programs have the same optimum by both in about as many iterations. There the ratio of",
        f"  the time of linear algebra is {mean([case.algebra for case in comparable]):.2f} in the geometric mean,",
        f"  and the ratio of whole solves {mean([case.whole for case in comparable]):.2f}.",
        f"- {len(comparable) - len(below)} of these programs reach {GOAL:g} in linear algebra, and",
        f"  {sum(ratio >= GOAL for ratio in by_problem.values())} of {len(by_problem)} problems in the mean of theirs.",
    ]
    if slowest is not None:
        lines += [f"- The least: {slowest.own.problem}, {slowest.own.scheme}, {slowest.algebra:.2f}."]
    only = [case for case in cases if case.own.is_solved and not any(row.is_solved for row in case.rows[1:])]
    if only:
        lines += [f"- Solved with `mbs` alone: {', '.join(f'{c.own.problem}, {c.own.scheme}' for c in only)}."]
    return lines


def list_optima(cases: Sequence[Case], problems: Sequence[Problem]) -> list[str]:
    """Write the optima of the most precise scheme beside the published ones."""
    lines = ["| problem | source | published | found | difference |", "|---|---|---:|---:|---:|"]
    for problem in problems:
        found = [c.own for c in cases if c.own.problem == problem.name and c.own.scheme == PRECISE]
        if not found:
            continue
        cost = f"{found[0].cost:.8g}" if found[0].is_solved else found[0].status
        if problem.optimum is None:
            lines.append(f"| {problem.name} | {problem.source} | – | {cost} | |")
            continue
        gap = (found[0].cost - problem.optimum) / abs(problem.optimum)
        mark = "" if abs(gap) <= problem.digits else ", more than expected"
        lines.append(f"| {problem.name} | {problem.source} | {problem.optimum:.8g} | {cost} | {gap:.1e}{mark} |")
    return lines


def write_page(figures: Figures) -> str:
    """Write the page: what was compared, the summary, a table for each problem, and the optima."""
    cases = figures.cases
    by_name = {problem.name: problem for problem in PROBLEMS}
    names = list(dict.fromkeys(case.own.problem for case in cases))
    lines = [
        "# The linear solver beside MUMPS",
        "",
        f"`python -m benchmarks.kkt`: {figures.about}; {figures.load:.1f} processes wanted to run.",
        "",
        "[Problems](../kkt/problems.py) of optimal control and estimation from the literature are transcribed in",
        "plain CasADi, and solved by IPOPT with the project's linear solver, `mbs`, and with MUMPS, from the same",
        "start and with the same options (tol = 1e-8). MUMPS runs twice: by AMD without scaling, as the project sets",
        "it, and with IPOPT's defaults. The quicker one that converges counts. Ratios are MUMPS over `mbs`: above 1,",
        "`mbs` is quicker.",
        "",
        "Times are of the processor, in ms, of the shortest round; one core. Linear algebra is what IPOPT counts for",
        "factorisations, solutions and the conversion of matrices; its clock has steps of 1 ms. Whole solves include",
        "functions in CasADi's virtual machine, and IPOPT itself. Ratios of medians are in brackets. The slower",
        f"setting of MUMPS runs in the first round alone, as do programs of more than {LONG:g} s. MUMPS is stopped",
        f"after {LIMIT:g} s by the clock.",
        "",
        *summarise(cases),
    ]
    for name in names:
        lines += ["", f"## {name}", ""]
        lines += ["| scheme | variables · equations | iterations | algebra | ratio | whole | ratio | optimum |"]
        lines += ["|---|---:|---:|---:|---:|---:|---:|---:|"]
        lines += [write_line(case) for case in cases if case.own.problem == name]
    lines += ["", "## Optima", "", f"By {PRECISE}; meshes are not refined.", ""]
    lines += list_optima(cases, [by_name[name] for name in names])
    return "\n".join(lines) + "\n"


def write_figures(figures: Figures, folder: Path) -> None:
    """Write the figures, and the page that shows them."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "kkt.json").write_text(json.dumps(asdict(figures), indent=1) + "\n", "utf-8")
    (folder / "kkt.md").write_text(write_page(figures), "utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write; 1 where a program is lost."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kkt", description=__doc__)
    parser.add_argument("--quick", action="store_true", help=f"one round of {', '.join(QUICK)}")
    names = [problem.name for problem in PROBLEMS]
    parser.add_argument("--problem", action="append", choices=names, default=[], help="by default all")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--again", action="store_true", help="measure programs of earlier runs again")
    parser.add_argument("-o", "--output", type=Path, default=Path("build/bench-kkt"))
    given = parser.parse_args(arguments)
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})  # MUMPS' BLAS takes as many threads as there are cores
    output: Path = given.output.absolute()
    rounds = 1 if given.quick else given.rounds
    about = f"{describe_machine()}, CasADi {version('casadi')}; {rounds} rounds"
    store = Store(output / "kkt.jsonl", Case, is_renewed=given.again)
    figures = Figures(about, os.getloadavg()[0])
    for problem, scheme in list_pairs(QUICK if given.quick else given.problem):
        facts = (about, compile_own().name, problem.name, problem.intervals, scheme.name)
        (case,) = store.find_or_measure(facts, partial(_measure_one, problem, scheme, rounds))
        print(f"{problem.name:18} {write_line(case)}", flush=True)
        figures = Figures(figures.about, figures.load, (*figures.cases, case))
        write_figures(figures, output)
    print(*summarise(figures.cases), sep="\n")
    return 1 if any(case.is_lost for case in figures.cases) else 0


def _measure_one(problem: Problem, scheme: Scheme, rounds: int) -> list[Case]:
    return [measure(problem, scheme, rounds)]


if __name__ == "__main__":
    sys.exit(main())
