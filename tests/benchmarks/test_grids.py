"""The comparisons of orders of collocation and of grids: what they measure, on small problems."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks.ocp import horizons, orders, refinement
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.trajectory import Trajectory


@pytest.fixture(autouse=True)
def compiler(requires: Callable[[str], str]) -> None:
    requires("cc")


def test_coordinates_are_read_off_the_polynomials() -> None:
    """q = t^(d + 1) is the integral of a velocity of degree d, and no polynomial of degree d."""
    scheme = schemes.build(Family.RADAU, 2)
    t = np.array([0.0, 0.5, 1.5])
    point_t = t[:-1, None] + np.diff(t)[:, None] * scheme.points
    powers = [(x[..., None] ** 3, 3 * x[..., None] ** 2, 6 * x[..., None]) for x in (t, point_t)]
    motion = Trajectory(t, powers[0][0], powers[0][1], np.zeros((2, 1)), point_t, *powers[1])
    places = t[:-1, None] + np.diff(t)[:, None] * orders.PLACES
    exact = orders.read_coordinates(motion, scheme, is_second=True)[..., 0]
    assert exact == pytest.approx(places**3, abs=1e-14)
    assert np.abs(orders.read_coordinates(motion, scheme, is_second=False)[..., 0] - places**3).max() > 1e-3


def test_second_order_errs_less_within_intervals(tmp_path: Path) -> None:
    """The page has a row for each scheme, and the ratios of the rows."""
    out = tmp_path / "page.md"
    orders.main(["--problems", "planar_arm_reach", "--degrees", "3", "--parts", "10", "--out", str(out)])
    rows = [line.split(" | ") for line in out.read_text("utf-8").splitlines() if line.startswith("| planar_arm")]
    assert [row[2] for row in rows] == ["radau", "legendre"]
    for row in rows:
        first, second = map(float, row[6].split(", "))
        assert second < first / 5


def test_refined_and_equal_grids_are_as_accurate(tmp_path: Path) -> None:
    out = tmp_path / "page.md"
    refinement.main(["--problems", "planar_arm_reach", "--accuracies", "1e-5", "--out", str(out)])
    rows = [line.split(" | ") for line in out.read_text("utf-8").splitlines() if line.startswith("| planar_arm")]
    assert [row[2] for row in rows] == ["refined", "equal"]
    assert all(float(row[6]) <= 1e-5 for row in rows)


def test_both_methods_find_one_optimum_on_each_grid(tmp_path: Path) -> None:
    """Coarser grids have several optima."""
    out = tmp_path / "page.md"
    horizons.main(["--intervals", "30", "40", "--out", str(out)])
    rows = [line.split(" | ") for line in out.read_text("utf-8").splitlines() if " | Solve_Succeeded" in line]
    assert [row[:2] for row in rows] == [[f"| {n}", method] for n in (30, 40) for method in horizons.METHODS]
    for own, ipopt in (rows[:2], rows[2:]):
        assert float(own[-1].rstrip(" |")) == pytest.approx(float(ipopt[-1].rstrip(" |")), rel=1e-6)
