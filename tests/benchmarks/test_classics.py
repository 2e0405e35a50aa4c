"""Published problems: their files have the published optima, and the optima of plain CasADi."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from scipy.optimize import brentq

from benchmarks.classics.__main__ import (
    FILES,
    WAYS,
    Case,
    Figures,
    Ours,
    Row,
    Theirs,
    read_classic,
    summarise,
    write_figures,
)
from benchmarks.classics.problems import CLASSICS, Classic

BY_NAME = {classic.name: classic for classic in CLASSICS}
FAST = (
    "brachistochrone",
    "goddard_rocket",
    "particle_steering",
    "catalyst_mixing",
    "container_crane",
    "bryson_denham",
    "minimum_energy",
    "zermelo",
    "moon_lander",
    "orbit_raising",
    "car",
)


@pytest.mark.parametrize("name", FAST)
def test_file_has_the_published_optimum(name: str) -> None:
    """To all digits that the source prints, from the guess of the file, with no mechanism."""
    ours = Ours(BY_NAME[name])
    row = ours.solve("IPOPT")
    assert row.is_solved
    assert ours.classic.count_digits(row.found) == ours.classic.digits


@pytest.mark.parametrize(("name", "way"), [("van_der_pol", "IPOPT"), ("car", "mbs")])
def test_peer_solves_the_same_program(name: str, way: str) -> None:
    """Independent statements, on one grid, from one guess: the optima are one, with fixed or free horizon."""
    ours = Ours(BY_NAME[name])
    found, peer = ours.solve(way), Theirs(ours).solve("MUMPS")
    assert found.is_solved
    assert peer.is_solved
    assert found.found == pytest.approx(peer.found, rel=1e-7)


def test_values_on_bounds_do_not_stop_the_method_by_stages() -> None:
    """The crane begins and ends with states that are given, and at bounds: these leave no interior."""
    row = Ours(BY_NAME["container_crane"]).solve("mbs")
    assert row.is_solved
    assert row.iterations < 50


def test_every_problem_has_a_file() -> None:
    assert {f"{name}.ocp.yaml" for name in BY_NAME} == {path.name for path in FILES.glob("*.ocp.yaml")}
    for classic in CLASSICS:
        problem, plant = read_classic(classic.name)
        states = len(problem.start_q) + len(problem.start_qd) + len(problem.states)
        assert states == len(classic.peer.x)
        assert len(plant.manifest.actuated) + len(problem.controls) == len(classic.peer.u)


def test_cycloid_gives_the_least_time_of_the_bead() -> None:
    """x = r (a - sin a), y = r (1 - cos a) through (10, 3), and T = a sqrt(r / g)."""
    angle = brentq(lambda a: (a - math.sin(a)) / (1 - math.cos(a)) - 10 / 3, 1.0, 6.0, xtol=1e-15)
    radius = 3 / (1 - math.cos(angle))
    assert f"{angle * math.sqrt(radius / 9.81):.8f}" == BY_NAME["brachistochrone"].printed


def test_lander_falls_and_brakes() -> None:
    """It falls from 10 m at 2 m/s down, then brakes by 1.5: the fuel is 3 times the time of braking."""
    speed = math.sqrt((2**2 / 1.5 + 2 * 10) / (1 / 1.5 + 1 / 1.5))  # v^2 / (2 g) - 2^2 / (2 g) + v^2 / (2 a) = 10
    assert f"{3 * speed / 1.5:.5f}" == BY_NAME["moon_lander"].printed


@pytest.mark.parametrize(
    ("printed", "found", "digits"),
    [
        ("1.01283", 1.012836, 6),
        ("1.01283", 1.01285, 5),
        ("-0.0480556", -0.04805568, 6),
        ("-0.0480556", 0.0480556, 0),
        ("30.0000", 30.00005, 6),
        ("30.0000", math.nan, 0),
        ("2030.85609", 2033.2, 3),
    ],
)
def test_digits_are_counted_to_one_unit(printed: str, found: float, digits: int) -> None:
    assert replace(BY_NAME["car"], printed=printed).count_digits(found) == digits


def make_row(way: str, found: float, seconds: float, status: str = "Solve_Succeeded") -> Row:
    return Row(way, status, found, 7, seconds, 10, 5)


def test_page_shows_what_is_equal_and_what_is_lost(tmp_path: Path) -> None:
    """Another optimum of a quicker way does not count; nor does a peer that ends elsewhere."""
    classic: Classic = BY_NAME["car"]
    ours = (make_row("IPOPT", 30.0, 0.2), make_row("IPOPT, adaptive", 31.0, 0.1), make_row("mbs", 30.0, 0.15))
    peers = (make_row("MUMPS", 30.0, 0.6), make_row("MUMPS, tuned", 29.0, 0.1))
    case = Case(classic.name, "60 x 3", ours, peers)
    assert case.best.way == "mbs"
    assert case.ratio == pytest.approx(4.0)
    lost = Case("zermelo", "60 x 3", (make_row("IPOPT", math.nan, 0.2, "Failed"), *ours[1:]), peers)
    write_figures(Figures("here", 1.0, (case, lost)), tmp_path)
    page = (tmp_path / "classics.md").read_text("utf-8")
    assert "| 6 of 6 |" in page
    assert "not solved from the file as it stands: Zermelo's ship." in page
    assert "mbs: 7, 150" in page
    assert len(WAYS) == len(ours)
    assert summarise([case])[1].startswith("- 1 optima agree")
