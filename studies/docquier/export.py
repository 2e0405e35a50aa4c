"""Write all attempts of a record as one table, CSV or Parquet: a row for each attempt, with its environment."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Literal

from mbsgen.errors import MbsError
from mbsrun.ocp.searching.study import Study
from mbsrun.ocp.solution.record import Attempt

ATTEMPTS = "attempts"  # the table's name
Form = Literal["csv", "parquet"]
Row = dict[str, object]
DIGITS = 16  # of the name of a study


class ExportError(MbsError):
    """A package for the requested form is missing."""


_PLAIN = tuple(field.name for field in fields(Attempt) if field.name != "task")
_PLACE = ("problem", "place_i", "place_j", "azimuth", "height")
_PROBLEM = ("inputs", "input_rates", "representation", "scheme", "degree", "intervals", "tolerance", "max_iterations")


def list_columns() -> tuple[str, ...]:
    """List the columns of an attempt itself; the environment's columns follow."""
    return ("study", *_PLACE, *_PROBLEM, *_PLAIN)


def list_rows(study: Study, identity: str, attempts: Iterable[tuple[Attempt, str]]) -> list[Row]:
    """Return attempts as rows with a name for each number; `identity` is the name of the study in a record."""
    rows: list[Row] = []
    for attempt, environment in attempts:
        task, problem = attempt.task, study.problem
        i, j = task.place
        row: Row = {"study": identity[:DIGITS], "problem": problem.name, "place_i": i, "place_j": j}
        row["azimuth"] = study.targets.azimuths[i] if study.sensor is not None else None
        row["height"] = study.targets.heights[j] if study.sensor is not None else None
        row |= {"inputs": task.weights[0], "input_rates": task.weights[1], "representation": task.representation}
        row |= {"scheme": problem.family.value, "degree": problem.degree, "intervals": problem.intervals}
        row |= {"tolerance": problem.solver.tolerance, "max_iterations": problem.solver.max_iterations}
        row |= {name: getattr(attempt, name) for name in _PLAIN}
        row |= json.loads(environment) if environment else {}
        rows.append(row)
    return rows


def export(rows: Sequence[Row], path: Path, form: Form) -> Path:
    """Write rows to `path` with the suffix of the form; return the path. Raises ExportError."""
    path = path.with_suffix(f".{form}")
    columns = list(dict.fromkeys(name for row in rows for name in row))
    if form == "csv":
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, columns)
            writer.writeheader()
            writer.writerows(rows)
        return path
    try:
        from pyarrow import Table, parquet
    except ImportError:
        remedy = "run pip install '.[study]' in the folder of the project; or give --export csv"
        raise ExportError(f"Parquet needs pyarrow: {remedy}") from None
    parquet.write_table(Table.from_pylist([{name: row.get(name) for name in columns} for row in rows]), path)
    return path
