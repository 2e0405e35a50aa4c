"""Ranges of joints: dead centres by the law of cosines, limits, whole turns."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import mbsrun
from mbsrun.cli import cli
from mbsrun.closure import Closure
from mbsrun.commands.range import MOVED
from mbsrun.external import Mechanism
from mbsrun.quaternions import neutral
from mbsrun.simulation.strokes import Stroke, _Way, find_stroke, find_strokes

MODELS = Path(__file__).parents[3] / "models"


def load(name: str) -> tuple[Mechanism, np.ndarray]:
    mechanism = mbsrun.load(MODELS / f"{name}.yaml", extent=MOVED)
    manifest = mechanism.manifest
    return mechanism, np.array(manifest.pose) if manifest.pose else neutral(manifest)


def lead(name: str, joint: str) -> Stroke:
    mechanism, pose = load(name)
    stroke = find_stroke(mechanism, pose, joint)
    assert stroke is not None
    assert Closure(mechanism).measure(stroke.q) < 1e-9
    return stroke


def test_a_rocker_swings_between_its_dead_centres() -> None:
    """Crank 0.1 m and coupler 0.28 m lie in line there: triangles of 0.3 m, 0.24 m and their sum or difference."""
    stroke = lead("four_bar", "swing")
    inner, outer = (math.pi - math.acos((0.3**2 + 0.24**2 - length**2) / (2 * 0.3 * 0.24)) for length in (0.38, 0.18))
    assert [stroke.lower.value, stroke.upper.value] == pytest.approx([inner, outer], abs=1e-8)
    assert {stroke.lower.cause, stroke.upper.cause} == {"loop closure is at a dead centre"}
    assert (np.diff(stroke.q[:, 2]) > 0).all()
    crank = lead("four_bar", "motor")
    assert crank.upper.value - crank.lower.value == pytest.approx(4 * math.pi)  # a whole turn either way
    assert crank.upper.cause == "a whole turn"
    swing = crank.q[:, 2]
    assert [swing.min(), swing.max()] == pytest.approx([inner, outer], abs=1e-4)


def test_a_piston_moves_by_two_cranks() -> None:
    stroke = lead("slider_crank", "piston")
    assert [stroke.lower.value, stroke.upper.value] == pytest.approx([0.14 - 0.045, 0.14 + 0.045], abs=1e-8)


def test_limits_end_a_way_and_other_freedoms_stay() -> None:
    """Of a five-bar with motors between -3.6 and -1.6, and between -1.5 and 0.5 rad."""
    mechanism, pose = load("five_bar")
    left, elbow, right, _ = find_strokes(mechanism, pose)
    assert [left.lower.value, left.upper.value] == pytest.approx([-3.6, -1.6], abs=1e-9)
    assert left.lower.cause == left.upper.cause == "limit of left"
    assert left.held == ("right",)
    assert np.ptp(left.q[:, 2]) == 0
    assert elbow.held == ("left",)
    assert [right.lower.value, right.upper.value] == pytest.approx([-1.5, 0.5], abs=1e-9)


def test_joints_without_loops_have_their_limits_or_turn_round() -> None:
    shoulder, elbow = find_strokes(*load("planar_arm"))
    assert [shoulder.lower.cause, elbow.upper.cause] == ["a whole turn", "limit of elbow"]
    assert [elbow.lower.value, elbow.upper.value] == pytest.approx([-2.5, 2.5], abs=1e-9)


def test_the_command_prints_ends_and_writes_the_way(tmp_path: Path) -> None:
    model, out = str(MODELS / "four_bar.yaml"), tmp_path / "swing.csv"
    found = CliRunner().invoke(cli, ["range", model, "--joint", "swing", "--pose", "motor=2", "-o", str(out)])
    assert found.exit_code == 0, found.output
    assert "from    1.593020" in found.output
    assert "dead centre" in found.output
    with out.open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["q[motor] [rad]", "q[pin] [rad]", "q[swing] [rad]", *(f"{x}[tracer] [m]" for x in "xyz")]
    assert len(rows) > 40
    every = CliRunner().invoke(cli, ["range", model])
    assert every.exit_code == 0
    assert "a whole turn" in every.output
    wrong = CliRunner().invoke(cli, ["range", model, "--joint", "swong"])
    assert wrong.exit_code == 2
    assert "give some of motor, pin, swing" in wrong.output


def test_the_limit_that_a_step_goes_farthest_beyond_is_named() -> None:
    """A joint that begins beyond its limit may come back; one on its limit may stay there."""
    way = _Way.__new__(_Way)
    way.names = ("a", "b", "c")
    way.lower, way.upper = np.array([-1.0, -np.inf, 0.0]), np.array([1.0, 2.0, np.inf])
    for last, found, name in (
        ((0.0, 0.0, 0.0), (1.0, 2.0, 0.0), ""),
        ((0.0, 0.0, 0.0), (1.5, 2.0, 0.0), "a"),
        ((0.0, 0.0, 0.0), (1.5, 2.75, 0.0), "b"),
        ((0.0, 0.0, 0.0), (-1.5, 2.25, -0.75), "c"),
        ((5.0, 0.0, 0.0), (4.0, 2.5, 0.0), "b"),
        ((5.0, 0.0, 0.0), (4.0, 2.0, 0.0), ""),
        ((5.0, 2.0, -3.0), (5.25, 2.125, -3.5), "c"),
        ((-5.0, 0.0, 0.0), (-5.25, 0.0, 0.0), "a"),
        ((-5.0, 0.0, 0.0), (-4.0, 0.0, 0.0), ""),
    ):
        told = way._find_limit(np.array(last), np.array(found))
        assert told == (f"limit of {name}" if name else "")
