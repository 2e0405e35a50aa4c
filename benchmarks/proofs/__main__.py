"""Check proofs of optima: `python -m benchmarks.proofs`; with --make, find the points, and write them and a page."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import numpy as np

from benchmarks.pages import tabulate
from benchmarks.proofs.cases import list_cases
from benchmarks.proofs.intervals import UnknownOperationError
from benchmarks.proofs.programs import find_point, find_start, state
from benchmarks.proofs.proof import Nonlinear, Point, Proof, System, approach, enclose_cost, level, prove, settle

ROOT = Path(__file__).parents[2]
PROBLEMS = list_cases()
POINTS = ROOT / "benchmarks" / "results" / "proofs"
RECORD = POINTS.parent / "proofs.json"  # the rows of the page
_TEXT = """\
The discrete problems of models/classics, as `mbsrun solve` writes them, have strict local minima: a zero of their
conditions of optimality lies in a ball around a stored point, its held bounds have multipliers of one sign, and the
Hessian is positive where rows and held bounds permit a step. [proof.py](../proofs/proof.py) states the theorem.
`python -m benchmarks.proofs NAME` proves one again from the point in [proofs/](proofs): in seconds, for the arm in
about a minute of processor time.

`arm` is the task of the [study](../../docs/study/README.md): at the centre of the cylinder, or at the corner with an
azimuth of 90° and a height of -0.1 m (lower) or 0.1 m (upper). It is the minimum that `mbsrun solve` finds from its
guess; without smoothing, the study lists lower ones. `plain` is the cost with k2 = 0, `smooth` with
k2 = 1e5. The last interval is at rest, so its limits hold where limits of the end do, and are dropped
([rest.py](../proofs/rest.py)). The limits of the rocket's mass are dropped too: it only falls, from a given start to a
given end ([monotone.py](../proofs/monotone.py)).

The car switches from full acceleration to full braking at a node of its grid, so all of its controls are at bounds: one
bound more than its equations leave free. Then multipliers are not unique, and the theorem does not apply.

- unknowns: variables that no bound holds, and multipliers of rows
- radius: of the ball, in each unknown z by max(1, |z|)
- multiplier: the least of a held bound; costs are divided by their largest weight
- curvature: a lower bound of the eigenvalues of H + w A'A, whose diagonal is scaled to nearly 1; where rounding
  hides them, as at the arm's bounds, of d'Hd for all d of length 1 that the rows permit
- mbs above: by how much the cost of `mbs` at its default tolerance is above the enclosed optimum, relative; negative
  where `mbs` ends at another minimum, or beyond its constraints by their tolerance
"""


@dataclass(frozen=True)
class Row:
    """A problem, what was proved of it, and the cost of `mbs` against the optimum's."""

    name: str
    unknowns: int
    proof: Proof
    cost: float
    above: float


@click.command()
@click.argument("names", nargs=-1, type=click.Choice(list(PROBLEMS)))
@click.option("--make", is_flag=True, help="Solve, and write points and a page, instead of checking stored points.")
def main(names: Sequence[str], make: bool) -> None:
    """Check that discrete optima are strict local minima, for NAMES or for all that have a point."""
    rows = []
    for name in names or PROBLEMS:
        path = POINTS / f"{name}.npz"
        if not make and not path.exists():
            continue
        before = time.perf_counter()
        try:
            row = make_row(name, path) if make else check_row(name, path)
        except (ArithmeticError, UnknownOperationError) as error:
            row = Row(name, 0, Proof(np.inf, np.inf, 0.0, 0.0, 0.0, str(error)), np.nan, np.nan)
        rows.append(row)
        told = row.proof.reason or f"proved, radius {row.proof.radius:.0e}"
        click.echo(f"{name}: {told}; {time.perf_counter() - before:.1f} s")
    if make:
        kept = record(rows, RECORD)
        (POINTS.parent / "proofs.md").write_text(write_page(kept), encoding="utf-8")
    if not make and any(row.proof.reason for row in rows):
        raise click.ClickException("not every stored point is proved")


def record(rows: Sequence[Row], path: Path) -> list[Row]:
    """Replace rows of a file by new ones of their names, and return all rows, in the order of the problems."""
    kept = {row.name: row for row in read_record(path)} | {row.name: row for row in rows}
    ordered = [kept[name] for name in PROBLEMS if name in kept]
    path.write_text(json.dumps([asdict(row) for row in ordered], indent=1) + "\n", encoding="utf-8")
    return ordered


def read_record(path: Path) -> list[Row]:
    """Read the rows of a file; none where there is no file."""
    found = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    return [Row(**{**row, "proof": Proof(**row["proof"])}) for row in found]


def make_row(name: str, path: Path) -> Row:
    """Find a point, prove it, and store it if that succeeds."""
    problem, plant = PROBLEMS[name].read()
    start, program = find_start(problem, plant), state(problem, plant)
    system = System(program)
    point = level(program, settle(system, approach(system, start) or find_point(program, start)))
    row = _judge(name, system, point)
    if not row.proof.reason:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, x=point.x, lam=point.lam, held=point.held, rows=point.rows)
    found = float(program.objective(start))
    return Row(name, row.unknowns, row.proof, row.cost, (found - row.cost) / max(abs(row.cost), 1e-300))


def check_row(name: str, path: Path) -> Row:
    """Prove a stored point. Raises ArithmeticError where it belongs to another program."""
    program = state(*PROBLEMS[name].read())
    with np.load(path) as stored:
        point = Point(*(stored[key] for key in ("x", "lam", "held", "rows")))
    _fit(program, point)
    return _judge(name, System(program), point)


def _fit(program: Nonlinear, point: Point) -> None:
    """Demand that held numbers lie exactly at their bounds, and that other rows have no multiplier."""
    sizes = (len(program.lower), len(program.g_lower))
    if (len(point.x), len(point.lam)) != sizes:
        raise ArithmeticError("the stored point is of another program: make it anew")
    bounds = np.where(point.held < 0, program.lower, np.where(point.held > 0, program.upper, point.x))
    if not np.array_equal(bounds, point.x) or point.lam[point.rows == 0].any():
        raise ArithmeticError("the stored active set does not fit its point")
    if not np.array_equal(level(program, point).x, point.x):
        raise ArithmeticError("the last interval is not at rest")
    if (point.rows[program.g_lower == program.g_upper] == 0).any():
        raise ArithmeticError("an equation is not held")


def _judge(name: str, system: System, point: Point) -> Row:
    proof = prove(system, point)
    low, high = enclose_cost(system, point, proof.radius if np.isfinite(proof.radius) else 0.0)
    return Row(name, len(point.unknowns), proof, (low + high) / 2, np.nan)


def write_page(rows: Sequence[Row]) -> str:
    """Write the page."""
    proved = [row for row in rows if not row.proof.reason]
    lines = ["# Proved optima", "", f"{len(proved)} of {len(rows)} problems are proved.", "", *_TEXT.splitlines(), ""]
    titles = ["problem", "unknowns", "radius", "multiplier", "curvature", "optimum", "mbs above"]
    lines += tabulate(titles, map(_write_row, proved))
    lines += ["", "## Not proved", "", *_list_reasons(rows)]
    return "\n".join(lines) + "\n"


def _write_row(row: Row) -> list[str]:
    multiplier = "no bounds" if np.isinf(row.proof.least_multiplier) else f"{row.proof.least_multiplier:.1e}"
    figures = (
        f"{row.proof.radius:.0e}",
        multiplier,
        f"{row.proof.curvature:.0e}",
        _write(row.cost, ".12g"),
        _write(row.above, ".0e"),
    )
    return [row.name.replace("_", " "), str(row.unknowns), *figures]


def _write(number: float, form: str) -> str:
    return "–" if np.isnan(number) else format(number, form)


def _list_reasons(rows: Sequence[Row]) -> Iterator[str]:
    for row in rows:
        if row.proof.reason:
            yield f"- {row.name.replace('_', ' ')}: {row.proof.reason}"


if __name__ == "__main__":
    main()
