"""The page of derivatives: a problem measured, and the lines of problems with and without derivatives."""

from __future__ import annotations

import math

from benchmarks.derivatives import MODELS, Row, measure, write_page
from mbsrun.ocp.optima.status import DEPENDENT, SMOOTH


def test_a_problem_is_measured_and_listed() -> None:
    row = measure("moco/effort", MODELS / "moco" / "effort.ocp.yaml")
    assert row.status == SMOOTH
    assert len(row.errors) == 3
    assert max(error for _, error in row.errors) < 1e-8
    other = Row("other", DEPENDENT, 10, 2, 0, (), (1.0, 1.0, math.nan))
    page = write_page([row, other])
    assert "Of 2 problems, 1 have derivatives. Of 3 numbers, 3 agree to" in page
    assert "| other | Dependent_Constraints | 10 | 2 | 0 | – | 1e+03 | 1e+03 | – |" in page
