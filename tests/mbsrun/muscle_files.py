"""Muscles of Millard and Thelen in a file of OpenSim, random states of them, and OpenSim's numbers there."""

from __future__ import annotations

import json
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tests.mbsgen.importing.osim_files import Link, save
from tests.mbsgen.importing.osim_files import write_model as write_osim
from tests.mbsgen.importing.osim_muscle_files import fixed, line, numbers
from tests.opensim import ask

STRENGTH, FIBRE, TENDON, ANGLE = 900.0, 0.1, 0.2, 0.3

OWN_CURVES = (
    "<ActiveForceLengthCurve><min_norm_active_fiber_length>0.4</min_norm_active_fiber_length>"
    "<transition_norm_fiber_length>0.7</transition_norm_fiber_length><max_norm_active_fiber_length>1.7"
    "</max_norm_active_fiber_length><shallow_ascending_slope>0.7</shallow_ascending_slope></ActiveForceLengthCurve>"
    "<ForceVelocityCurve><concentric_slope_near_vmax>0.3</concentric_slope_near_vmax><isometric_slope>4"
    "</isometric_slope><eccentric_slope_near_vmax>0.2</eccentric_slope_near_vmax>"
    "<max_eccentric_velocity_force_multiplier>1.6</max_eccentric_velocity_force_multiplier><concentric_curviness>0.4"
    "</concentric_curviness><eccentric_curviness>0.8</eccentric_curviness></ForceVelocityCurve>"
    "<FiberForceLengthCurve><strain_at_zero_force>-0.1</strain_at_zero_force><strain_at_one_norm_force>0.5"
    "</strain_at_one_norm_force><stiffness_at_low_force>0.3</stiffness_at_low_force><stiffness_at_one_norm_force>4"
    "</stiffness_at_one_norm_force><curviness>0.6</curviness></FiberForceLengthCurve>"
    "<TendonForceLengthCurve><strain_at_one_norm_force>0.06</strain_at_one_norm_force><stiffness_at_one_norm_force>30"
    "</stiffness_at_one_norm_force><norm_force_at_toe_end>0.4</norm_force_at_toe_end><curviness>0.7</curviness>"
    "</TendonForceLengthCurve>"
)
OWN_SHAPES = numbers(
    KshapeActive=0.5, KshapePassive=4, Af=0.3, Flen=1.6, fv_linear_extrap_threshold=0.9, FmaxTendonStrain=0.05
)
MUSCLES: dict[str, tuple[str, bool, str, float]] = {  # kind, rigid, more of it, strain of the tendon
    "rigid": ("Millard2012EquilibriumMuscle", True, "", 0.0),
    "rigid_own": ("Millard2012EquilibriumMuscle", True, numbers(fiber_damping=0) + OWN_CURVES, 0.0),
    "damped": ("Millard2012EquilibriumMuscle", False, "", 0.049),
    "undamped": ("Millard2012EquilibriumMuscle", False, numbers(fiber_damping=0), 0.049),
    "own": ("Millard2012EquilibriumMuscle", False, OWN_CURVES, 0.06),
    "own_undamped": ("Millard2012EquilibriumMuscle", False, numbers(fiber_damping=0) + OWN_CURVES, 0.06),
    "thelen": ("Thelen2003Muscle", False, "", 0.04),
    "thelen_own": ("Thelen2003Muscle", False, OWN_SHAPES, 0.05),
}
FLAGS = {"Millard2012EquilibriumMuscle": ("ignore_tendon_compliance",), "Thelen2003Muscle": ()}
ELASTIC = tuple(name for name, (_, is_rigid, *_) in MUSCLES.items() if not is_rigid)


def write_file() -> str:
    """Write a slider that all muscles pull along its axis."""
    ends = fixed("a", "ground", "0 0 0") + fixed("b", "cart", "0 0 0")
    common = numbers(
        max_isometric_force=STRENGTH, optimal_fiber_length=FIBRE, tendon_slack_length=TENDON,
        pennation_angle_at_optimal=ANGLE,
    )  # fmt: skip
    rows = (
        line(kind, name, ends, common + more + numbers(**dict.fromkeys(FLAGS[kind], is_rigid)))
        for name, (kind, is_rigid, more, _) in MUSCLES.items()
    )
    here = ("0 0 0", "0 0 0")
    return write_osim((Link("cart", "SliderJoint", "ground", ("x",), outer=here, inner=here),), forces="".join(rows))


def draw(count: int) -> list[dict[str, Any]]:
    """Draw states: fibres of half to 1.7 of their best length, and tendons from slack to quite stretched."""
    rng, found, height = np.random.default_rng(5), [], FIBRE * math.sin(ANGLE)
    for _ in range(count):
        q = TENDON + rng.uniform(0.6, 1.6) * FIBRE
        strains = {name: rng.uniform(-0.2, 1.2) * MUSCLES[name][3] for name in ELASTIC}
        fibres = {name: math.hypot(q - TENDON * (1 + strain), height) for name, strain in strains.items()}
        activations = {name: rng.uniform(0.02, 1) for name in MUSCLES}
        found.append({"q": q, "qd": rng.uniform(-0.9, 0.9), "fibres": fibres, "activations": activations})
    return found


def ask_opensim(states: list[dict[str, Any]]) -> list[dict[str, dict[str, float]]]:
    """Return what `curve_peer` prints."""
    with tempfile.TemporaryDirectory() as folder:
        path = save(Path(folder), write_file())
        text = json.dumps({"file": str(path), "states": states})
        found: list[dict[str, dict[str, float]]] = json.loads(ask(Path(__file__).with_name("curve_peer.py"), text))
    return found
