"""A leg with markers and muscles in OpenSim's form, recorded markers of a subject, and settings of a scaling."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.mbsgen.importing.osim_files import HIP, KNEE, LINE, PELVIS, SPLINE, Link, write_model
from tests.mbsgen.importing.osim_muscle_files import write_forces

Array = NDArray[np.float64]

FACTORS: Mapping[str, tuple[float, float, float]] = {
    "pelvis": (1.1, 0.9, 1.2), "femur": (1.2, 1.05, 0.95), "tibia": (0.9, 1.15, 1.02), "foot": (1.1, 1.1, 1.1),
}  # fmt: skip
MARKERS: Mapping[str, tuple[str, tuple[float, float, float]]] = {
    "asis": ("pelvis", (0.1, 0.05, 0.12)), "psis": ("pelvis", (-0.12, 0.06, 0.05)),
    "sacrum": ("pelvis", (-0.1, -0.04, -0.1)), "thigh": ("femur", (0.09, -0.15, 0.06)),
    "knee_out": ("femur", (0.01, -0.38, 0.07)), "knee_in": ("femur", (0.01, -0.39, -0.06)),
    "shank": ("tibia", (0.06, -0.2, 0.04)), "ankle_out": ("tibia", (-0.01, -0.4, 0.06)),
    "ankle_in": ("tibia", (0.0, -0.41, -0.04)), "heel": ("foot", (-0.06, -0.04, 0.0)),
    "toe": ("foot", (0.16, -0.04, 0.02)), "side": ("foot", (0.1, -0.03, 0.06)),
}  # fmt: skip


def write_markers(*, version: int = 40000, fixed: tuple[str, ...] = ()) -> str:
    """Write the markers of the leg."""
    return "".join(
        f'<Marker name="{name}">'
        + (f"<body>{body}</body>" if version < 40000 else f"<socket_parent_frame>/bodyset/{body}</socket_parent_frame>")
        + f"<location>{' '.join(map(str, at))}</location><fixed>{str(name in fixed).lower()}</fixed></Marker>"
        for name, (body, at) in MARKERS.items()
    )


def write_leg(*, version: int = 40000, fixed: tuple[str, ...] = ()) -> str:
    """Write a leg whose translations are along the axes of their frames, in a pose that is not 0."""
    settings = "<default_value>0.2</default_value><range>-1.5 1.5</range>"
    hip = Link("femur", HIP.kind, HIP.parent, HIP.coordinates, HIP.more.replace("0 2 1", "0 1 0"), settings=settings)
    knee = Link("tibia", KNEE.kind, KNEE.parent, KNEE.coordinates, KNEE.more, settings=settings)
    pelvis = Link(
        "pelvis", PELVIS.kind, PELVIS.parent, PELVIS.coordinates, settings="<default_value>0.1</default_value>"
    )
    foot = Link("foot", "UniversalJoint", "tibia", ("ankle", "subtalar"), settings=settings)
    markers = write_markers(version=version, fixed=fixed)
    return write_model(
        (pelvis, hip, knee, foot), version=version, markers=markers, forces=write_forces(version)
    )  # fmt: skip


def write_trc(path: Path, places: Mapping[str, Array], rate: float = 100.0) -> None:
    """Write a TRC file of markers, (K, 3) [m] each."""
    K = len(next(iter(places.values())))
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate:g}\t{rate:g}\t{K}\t{len(places)}\tmm\t{rate:g}\t1\t{K}",
        "Frame#\tTime\t" + "".join(f"{name}\t\t\t" for name in places),
        "\t\t" + "".join(f"X{k}\tY{k}\tZ{k}\t" for k in range(1, len(places) + 1)),
        "",
    ]
    rows = [
        "\t".join([str(k + 1), f"{k / rate:.6f}", *(f"{1000 * x:.9f}" for at in places.values() for x in at[k])])
        for k in range(K)
    ]
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")


SETUP = """<?xml version="1.0" encoding="UTF-8" ?>
<OpenSimDocument Version="40600"><ScaleTool name="leg"><mass>{mass}</mass>
<GenericModelMaker><model_file>leg.osim</model_file></GenericModelMaker>
<ModelScaler><apply>true</apply><scaling_order> {order}</scaling_order>
<MeasurementSet><objects>{measurements}</objects></MeasurementSet><ScaleSet><objects>{factors}</objects></ScaleSet>
<marker_file>static.trc</marker_file><time_range>0 0.05</time_range>
<preserve_mass_distribution>{keep}</preserve_mass_distribution>
<output_model_file>stretched.osim</output_model_file></ModelScaler>
<MarkerPlacer><apply>{places}</apply><IKTaskSet><objects>{tasks}</objects></IKTaskSet>
<marker_file>static.trc</marker_file><time_range>0 0.05</time_range>
<output_motion_file>pose.mot</output_motion_file><output_model_file>placed.osim</output_model_file><max_marker_movement>-1</max_marker_movement></MarkerPlacer>
</ScaleTool></OpenSimDocument>
"""


def write_measurement(name: str, pairs: tuple[str, ...], bodies: Mapping[str, str]) -> str:
    """Write a measurement of a ScaleTool; bodies with their axes."""
    inner = "".join(f"<MarkerPair><markers>{pair}</markers></MarkerPair>" for pair in pairs)
    scales = "".join(f'<BodyScale name="{body}"><axes>{axes}</axes></BodyScale>' for body, axes in bodies.items())
    return (
        f'<Measurement name="{name}"><apply>true</apply><MarkerPairSet><objects>{inner}</objects></MarkerPairSet>'
        f"<BodyScaleSet><objects>{scales}</objects></BodyScaleSet></Measurement>"
    )


def write_factors(factors: Mapping[str, tuple[float, float, float]] = FACTORS) -> str:
    """Write the factors of a ScaleTool."""
    return "".join(
        f"<Scale><scales>{' '.join(map(str, x))}</scales><segment>{name}</segment><apply>true</apply></Scale>"
        for name, x in factors.items()
    )


MEASUREMENTS = (
    write_measurement("pelvis", ("asis psis", "asis sacrum"), {"pelvis": "X Y Z"})
    + write_measurement("thigh", ("asis knee_out", "thigh knee_in"), {"femur": "Y"})
    + write_measurement("wide", ("knee_out knee_in",), {"femur": "X Z", "tibia": "X Z"})
    + write_measurement("shank", ("knee_out ankle_out", "knee_in ankle_in"), {"tibia": "Y"})
)
__all__ = ["FACTORS", "LINE", "MARKERS", "MEASUREMENTS", "SETUP", "SPLINE", "write_factors", "write_leg", "write_trc"]
