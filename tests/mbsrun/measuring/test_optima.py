"""Charts of optimal control: what optima err by, against a push whose optimum is known on every control grid."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from mbsrun import cli, load
from mbsrun.measuring.captions import OUTLINES, write_captions
from mbsrun.measuring.charts import draw_optima
from mbsrun.measuring.optima import OptimumScope, measure_optima
from mbsrun.measuring.points import SolvePoint, write_points
from mbsrun.measuring.sections import read_folders
from mbsrun.measuring.solves import Case
from mbsrun.measuring.store import Store
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Representation
from studies.laboratory.mechanisms import SLIDE, UNSTABLE
from studies.laboratory.optimisation import state_catch, state_push
from tests.picture_kinds import find_kind

PUSH = """
model: slide.yaml
horizon: 1
intervals: 8
scheme: radau
degree: 2
cost: {inputs: 1}
start: {pose: {}}
end: {pose: {slide: 1}, velocity: zero}
"""


def quiet(*_: object) -> None:
    """Ignore progress."""


@pytest.fixture
def slide(tmp_path: Path) -> Path:
    path = tmp_path / "slide.yaml"
    path.write_text(SLIDE, encoding="utf-8")
    return path


def test_errors_are_those_of_the_closed_form(slide: Path, tmp_path: Path) -> None:
    """J*(N) = 12 / (1 - 1/N^2) J, and 12 J in the limit: degree 2 has the first exactly, and one interval has none.

    Degree 1, implicit Euler, has the same cost with another motion, as the defect shows. From N = 5 and 10 the limit is
    extrapolated to 4e-4: the error is of the order N^-4.
    """
    case = Case(state_push(8), load(slide))
    scope = OptimumScope((1, 5, 10), (1, 2), (Family.RADAU,), (Representation.IMPL,), 1, ())
    store = Store(tmp_path / "out" / "optimisation.jsonl", SolvePoint)
    points, grids = measure_optima(case, scope, store, quiet)
    for grid in grids[1:]:
        exact = 12 / (1 - 1 / grid.intervals**2)
        assert grid.cost == pytest.approx(exact, rel=1e-8)
        assert grid.accuracy is not None
        assert grid.accuracy < 1e-8
        assert grid.error == pytest.approx(exact / 12 - 1, abs=5e-4)
    assert grids[0].cost is None
    assert grids[0].finding
    by_grid = {(p.degree, p.intervals): p for p in points}
    assert all("more constraints than" in by_grid[degree, 1].finding for degree in (1, 2))
    for intervals in (5, 10):
        coarse, fine = by_grid[1, intervals], by_grid[2, intervals]
        assert fine.error is not None
        assert fine.error < 1e-8
        assert fine.defect is not None
        assert coarse.defect is not None
        assert fine.defect < 1e-7 < 1e-3 < coarse.defect
    write_points(points, tmp_path / "out", "optimisation")
    paths = draw_optima(points, grids, tmp_path / "out")
    assert {"optimisation.png", "optimisation.svg", "control_grid.png"} <= {path.name for path in paths}
    write_captions("optimisation", "a reach", tmp_path / "out")
    (section,) = read_folders([tmp_path / "out"])
    assert [item.title for item in section.items] == [x.title for x in OUTLINES["optimisation"].items[:3]]
    again, _ = measure_optima(case, scope, store, lambda *_: None)
    assert again == points


def test_tolerances_are_tried_with_the_highest_degree(tmp_path: Path) -> None:
    """A motion x'' = 4 sin x + u: a loose tolerance takes fewer iterations, and costs digits of the cost."""
    path = tmp_path / "unstable.yaml"
    path.write_text(UNSTABLE.format(rate=2), encoding="utf-8")
    case = Case(state_catch(10, 3), load(path))
    scope = OptimumScope((10,), (2, 5), (Family.RADAU, Family.LEGENDRE), (Representation.IMPL,), 1, (10.0, 1e-8))
    points, grids = measure_optima(case, scope, Store(tmp_path / "out" / "points.jsonl", SolvePoint), quiet)
    tried = [(p.family, p.degree, p.tolerance) for p in points]
    own = [(family, degree, 1e-8) for family in ("radau", "legendre") for degree in (2, 5)]
    assert tried == [*own, ("radau", 5, 10.0)]
    tight, loose = points[1], points[-1]
    assert loose.iterations < tight.iterations
    assert loose.error is not None
    assert tight.error is not None
    assert loose.error > 10 * tight.error
    assert all(drawn.stat().st_size > 5_000 for drawn in draw_optima(points, grids, tmp_path / "out"))


def test_the_command_writes_chart_and_tables(slide: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (slide.parent / "push.ocp.yaml").write_text(PUSH, encoding="utf-8")
    monkeypatch.chdir(slide.parent)
    arguments = [
        "--quick",
        "--intervals",
        "4",
        "--degree",
        "2",
        "--representation",
        "EXP2-O",
        "--tolerance",
        "1e-3",
        "-o",
        "chart",
        "--format",
        "svg",
    ]
    monkeypatch.setattr(sys, "argv", ["mbsrun", "chart", "optimisation", "push.ocp.yaml", *arguments])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code in (0, None)
    solved, loose = json.loads(Path("chart/optimisation.json").read_text(encoding="utf-8"))
    assert (solved["intervals"], solved["representation"], solved["total_error"]) == (4, "EXP2-O", None)
    assert (solved["tolerance"], loose["tolerance"]) == (1e-8, 1e-3)
    assert find_kind(Path("chart/control_grid.svg")) == "svg"
    (section,) = read_folders([Path("chart")])  # its captions name the files
    assert section.name == "optimisation"
