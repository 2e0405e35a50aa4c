"""The made stride of a body with 80 muscles: its files, and the laws that its loads must obey."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.moco.body import FREEDOMS, SEGMENTS, read_muscles
from benchmarks.moco.stride import prepare, read_stride
from mbsgen.model.reader import read_model

GRAVITY = 9.81


def test_the_body_has_31_freedoms_and_80_muscles(tmp_path: Path) -> None:
    problem = prepare(tmp_path, 7)
    assert "intervals: 7\n" in problem.read_text("utf-8")
    model = read_model(tmp_path / "body.yaml")
    assert len(FREEDOMS) == sum(len(body.joints) for body in model.bodies) == 31
    assert len(read_muscles()) == len(model.forces) == 80


def test_loads_of_a_period_carry_the_body_and_neither_push_nor_brake_it() -> None:
    stride = read_stride()
    t, mass = stride["time"], sum(x.mass for x in SEGMENTS)
    force = {axis: np.trapezoid(stride[f"f{axis}_r"] + stride[f"f{axis}_l"], t) / t[-1] for axis in "xyz"}
    assert force["y"] == pytest.approx(mass * GRAVITY, rel=2e-3)
    assert force["x"] == pytest.approx(0, abs=2)
    assert force["z"] == pytest.approx(0, abs=2)


def test_speeds_are_rates_of_coordinates() -> None:
    stride = read_stride()
    t = stride["time"]
    for name in FREEDOMS:
        way = np.trapezoid(stride[f"speed_{name}"], t)
        assert way == pytest.approx(stride[name][-1] - stride[name][0], abs=2e-3)


def test_the_left_leg_does_half_a_period_later_what_the_right_one_does() -> None:
    stride = read_stride()
    half = (len(stride["time"]) - 1) // 2
    for name in ("hip_flexion", "knee_angle", "ankle_angle"):
        left, right = stride[f"{name}_l"], stride[f"{name}_r"]
        assert left[:half] == pytest.approx(right[half : 2 * half], abs=0.06)
