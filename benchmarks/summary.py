"""Figures of all benchmarks -> `benchmarks/results`, and one table of ratios there; `python -m benchmarks.summary`."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from benchmarks.ocp.rows import OURS, POINTS, STAGES, Row
from benchmarks.table import Quickest

RESULTS = Path(__file__).parent / "results"
FILES = ("benchmarks.json", "benchmarks.md", "benchmarks.png", "growth.json", "growth.md", "ocp.json", "ocp.md")
LOOPS = ("loops.json", "loops.md")
KKT = ("kkt.json", "kkt.md")
CLASSICS = ("classics.json", "classics.md")
COLUMNS = ("residual", "accelerations", "Jacobian of the residual", "Jacobian of the accelerations")
MODELS = {"arm_pendulum": "the paper's arm, 6 joints", "ur5": "UR5, 6 joints", "panda": "Panda, 7 joints"}
ROBOTS = {"anymal": "ANYmal, 18 joints"}
TITLES = (("IMPL",), ("EXP1", "EXP2"), ("Jacobian of IMPL",), ("Jacobian of EXP1", "Jacobian of EXP2"))
KERNELS = (("impl",), ("exp1", "exp2"), ("jac_impl",), ("jac_exp2",))
REPRESENTATION = "IMPL"


def write_summary(kernels: Mapping[str, Any], growth: Mapping[str, Any], ocp: Mapping[str, Any]) -> str:
    """Return the table of all three benchmarks, from the content of their JSON files."""
    rows = [*_list_rows(kernels, growth), *_list_solves(ocp)]
    lines = [
        "The time of the quickest peer over the time of the generated code, by the shortest rounds. For the first",
        "number of a cell, everybody uses this project's quick sine and cosine; for the one in brackets, peers use",
        "the C library's.",
        "",
        f"| | {' | '.join(COLUMNS)} |",
        "|---|" + "---:|" * len(COLUMNS),
        *(f"| {name} | {' | '.join(cells)} |" for name, cells in rows),
        "",
        "Peers are short recursions and Pinocchio's algorithms, both as C that CasADi writes, and Pinocchio in C++;",
        "for the arms' Jacobians also our own equations, differentiated by CasADi. Accelerations are by either side's",
        "quicker algorithm. All numbers of the models are folded, for everybody.",
        "",
        "Optimal control: N = 100, degree 4, the residual at each point. The first number compares with our own",
        "program, in which C that CasADi writes takes the place of our kernels; the one in brackets with a program",
        "that CasADi differentiates as a whole and compiles. Ours has its own linear solver, the peers MUMPS.",
        "",
        f"Measured on {kernels['machine']}; optimal control on {ocp['about'].partition(';')[0]}.",
        "All figures: [kernels](benchmarks.md), [size](growth.md), [optimal control](ocp.md).",
    ]
    return "\n".join(lines) + "\n"


def _list_rows(kernels: Mapping[str, Any], growth: Mapping[str, Any]) -> Iterator[tuple[str, list[str]]]:
    for model, name in MODELS.items():
        if model in kernels["models"]:
            rows = kernels["models"][model]
            yield name, [_compare([rows[title]["quickest"] for title in titles if title in rows]) for titles in TITLES]
    for robot, name in ROBOTS.items():
        found = {row["kernel"]: row["quickest"] for row in growth["rows"] if row["mechanism"] == robot}
        if found:
            yield name, [_compare([found[kernel] for kernel in names]) for names in KERNELS]


def _compare(found: Sequence[Mapping[str, Mapping[str, Any]]]) -> str:
    """Write the ratios of the quickest peer to the quickest of ours."""

    def ratio(basis: str) -> str:
        entries = [Quickest(**quickest[basis]) for quickest in found if basis in quickest]
        if not entries:
            return "–"
        return f"{min(entry.ns for entry in entries) / min(entry.ns_ours for entry in entries):#.3g}"

    return f"{ratio('same header')} ({ratio('as they come')})"


def _list_solves(ocp: Mapping[str, Any]) -> Iterator[tuple[str, list[str]]]:
    rows = [row for content in ocp["rows"] if (row := Row(**content)).representation == REPRESENTATION]
    ours = next((row for row in rows if row.way == OURS), None)
    points = [row for row in rows if row.way.startswith(POINTS)]
    whole = [row for row in rows if row.way.startswith("CasADi, compiled")]
    if ours and points and whole:
        evaluating = (f"{min(row.evaluating for row in some) / ours.evaluating:#.3g}" for some in (points, whole))
        stages = [row for row in rows if row.way == f"{OURS}, {STAGES}"]
        by_stages = "by stages {} ({})".format(*_compare_solves(stages[0], points, whole)) if stages else "–"
        cells = [
            "evaluation {} ({})".format(*evaluating),
            "by IPOPT {} ({})".format(*_compare_solves(ours, points, whole)),
        ]
        yield "optimal control of the arm", [*cells, by_stages, "–"]


def _compare_solves(ours: Row, *peers: Sequence[Row]) -> tuple[str, ...]:
    """Write the ratios of the quickest solve of each group of peers to ours."""
    return tuple(f"{min(row.cpu_seconds for row in some) / ours.cpu_seconds:#.3g}" for some in peers)


@click.command()
@click.option("--kernels", default=Path("build/bench"), type=click.Path(file_okay=False, path_type=Path))
@click.option("--ocp", default=Path("build/bench-ocp"), type=click.Path(file_okay=False, path_type=Path))
@click.option("--loops", default=Path("build/bench-loops"), type=click.Path(file_okay=False, path_type=Path))
@click.option("--kkt", default=Path("build/bench-kkt"), type=click.Path(file_okay=False, path_type=Path))
@click.option("--classics", default=Path("build/bench-classics"), type=click.Path(file_okay=False, path_type=Path))
@click.option("-o", "--out", default=RESULTS, type=click.Path(file_okay=False, path_type=Path))
def main(kernels: Path, ocp: Path, loops: Path, kkt: Path, classics: Path, out: Path) -> None:
    """Copy the results of the benchmarks from their folders, and write their summary."""
    places = {file: (ocp if file.startswith("ocp") else kernels) / file for file in FILES}
    missing = [str(path) for path in places.values() if not path.exists()]
    if missing:
        raise click.ClickException(f"{', '.join(missing)}: not there; measure first: make bench bench-growth bench-ocp")
    out.mkdir(parents=True, exist_ok=True)
    groups = ((loops, LOOPS), (kkt, KKT), (classics, CLASSICS))
    separate = [folder / file for folder, files in groups for file in files]
    places |= {path.name: path for path in separate if path.exists()}
    for file, path in places.items():
        shutil.copyfile(path, out / file)
    contents = [json.loads(places[f"{name}.json"].read_text("utf-8")) for name in ("benchmarks", "growth", "ocp")]
    (out / "summary.md").write_text(write_summary(*contents), encoding="utf-8")
    click.echo(f"{out / 'summary.md'} has the table.")


if __name__ == "__main__":
    main()
