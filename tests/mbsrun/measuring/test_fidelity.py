"""Charts of fidelity: what is left out is found in the error, and what was supposed holds to rounding."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsrun.measuring.captions import OUTLINES, write_captions
from mbsrun.measuring.charts import draw_fidelity
from mbsrun.measuring.fidelity import (
    TOLERANCES,
    WHOLE,
    FidelityPoint,
    FidelityScope,
    KernelComparison,
    list_reductions,
    measure_fidelity,
    take_whole,
)
from mbsrun.measuring.points import write_points
from mbsrun.measuring.sections import read_folders

LITTLE = FidelityScope(2, 8, ("impl", "sensors"))
ROUNDING = 1e-14


def quiet(*_: object) -> None:
    """Ignore progress."""


def measure(model: Path, folder: Path, *scenes: Path) -> dict[str, FidelityPoint]:
    whole = take_whole(model, LITTLE)
    reductions = list_reductions(model, whole.manifest, scenes)
    return {p.reduction: p for p in measure_fidelity(whole, reductions, folder, LITTLE, quiet) if p.kernel == "impl"}


def test_each_thing_left_out_costs_what_it_did(cart: Path, tmp_path: Path) -> None:
    """Locked joints, fixed parameters and rest are exact as supposed; the spring and the damper are k x + d xd."""
    points = measure(cart, tmp_path / "out")
    for name in ("x locked", "turn locked", "no velocities", "constant parameters"):
        error, elsewhere, flops = points[name].error, points[name].error_anywhere, points[name].flops
        assert error is not None
        assert error < ROUNDING, name
        assert elsewhere is not None
        assert (elsewhere > 1e-3) == (name != "constant parameters")
        assert flops is not None
        assert flops < points[WHOLE].flops_whole
    whole = take_whole(cart, LITTLE)
    states = {name: x[:8] for name, x in KernelComparison(whole, "impl", [], LITTLE).states.items()}
    inputs: dict[str, Any] = {name: states[name] for name in ("q", "qd", "qdd", "u", "w", "theta")}
    Phi = whole.kernels("impl", **inputs)["Phi"]
    forces = 7 * states["q"][:, 0] + 0.4 * states["qd"][:, 0]
    assert points["no forces of joints"].error == pytest.approx(np.abs(forces).max() / np.abs(Phi).max(), rel=1e-9)
    for tolerance in TOLERANCES:
        error = points[f"tolerance {tolerance:g}"].error
        assert error is not None
        assert error <= tolerance
    light = points["rod without mass"]
    assert "turn" in light.finding
    assert (light.flops, light.error, light.ns) == (None, None, None)
    assert all(p.ns is not None and p.ns_whole == points[WHOLE].ns for p in points.values() if not p.finding)
    write_points([*points.values()], tmp_path / "out", "fidelity")
    path, *_ = draw_fidelity([*points.values()], tmp_path / "out")
    assert path.stat().st_size > 10_000
    write_captions("fidelity", "cart", tmp_path / "out")
    (section,) = read_folders([tmp_path / "out"])
    assert [item.title for item in section.items] == [caption.title for caption in OUTLINES["fidelity"].items]


def test_scenes_are_taken_by_their_parts(cart: Path, tmp_path: Path) -> None:
    """Each part that changes a kernel, and then all; what only chooses functions is none."""
    scene = tmp_path / "still.scene.yaml"
    scene.write_text("functions: [impl]\nlocked: {turn: pi/6}\ngravity: false\n", encoding="utf-8")
    points = measure(cart, tmp_path / "out", scene)
    assert list(points) == [WHOLE, "still.scene: locked", "still.scene: gravity", "still.scene"]
    locked = points["still.scene: locked"]
    assert locked.error is not None
    assert locked.error < ROUNDING
    assert measure(cart, tmp_path / "out", scene) == points, "kept, and not measured again"
