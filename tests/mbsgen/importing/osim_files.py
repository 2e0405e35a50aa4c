"""Files of OpenSim for tests, in the forms of versions 3 and 4, with numbers of our own."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from mbsgen.errors import InputError
from mbsgen.importing import Choices, import_model
from mbsgen.osim_comparison import ask_opensim, compare_with_opensim

KNOTS = "-2.1 -1.2 -0.5 -0.35 -0.17 0.16 2.1"
VALUES = "-0.42 -0.41 -0.4 -0.398 -0.3966 -0.3953 -0.396"
SPLINE = f"<SimmSpline><x>{KNOTS}</x><y>{VALUES}</y></SimmSpline>"
LINE = "<LinearFunction><coefficients>1 0</coefficients></LinearFunction>"
SINE = "<Sine><amplitude>0.5</amplitude><omega>1.3</omega><phase>-0.2</phase><offset>0.1</offset></Sine>"
ARC = "<PolynomialFunction><coefficients>0.05 0.1 -0.2</coefficients></PolynomialFunction>"
THIRD = f"<MultiplierFunction><function>{ARC}</function><scale>0.3</scale></MultiplierFunction>"
PLANE = "<LinearFunction><coefficients>0.1 0.7 0.2</coefficients></LinearFunction>"
INERTIA = (0.02, 0.03, 0.025, 0.001, -0.002, 0.003)


def coordinate(name: str, inner: str = "<default_value>0</default_value>") -> str:
    return f'<Coordinate name="{name}">{inner}</Coordinate>'


def axis(
    name: str, direction: str, coordinates: str = "", function: str = "<Constant><value>0</value></Constant>"
) -> str:
    return (
        f'<TransformAxis name="{name}"><coordinates>{coordinates}</coordinates><axis>{direction}</axis>'
        f"<function>{function}</function></TransformAxis>"
    )


def transform(*axes: str) -> str:
    """Make a transform; axes that are not given are at 0."""
    usual = {
        "rotation1": "1 0 0",
        "rotation2": "0 1 0",
        "rotation3": "0 0 1",
        "translation1": "1 0 0",
        "translation2": "0 1 0",
        "translation3": "0 0 1",
    }
    given = {name: text for text in axes for name in usual if f'name="{name}"' in text}
    text = "\n".join(given.get(name) or axis(name, direction) for name, direction in usual.items())
    return f"<SpatialTransform>{text}</SpatialTransform>"


@dataclass(frozen=True)
class Link:
    """A body, and the joint that carries it on another one."""

    name: str
    kind: str = "PinJoint"
    parent: str = "ground"
    coordinates: tuple[str, ...] = ()
    more: str = ""  # in the joint
    outer: tuple[str, str] = ("0.1 -0.3 0.05", "0.2 -0.4 0.3")  # of the joint in the parent
    inner: tuple[str, str] = ("0.02 0.1 -0.03", "-0.1 0.3 0.2")  # of the joint in the child
    reverse: bool = False
    mass: str = "<mass>1.5</mass><mass_center>0.01 -0.2 0.03</mass_center>"
    settings: str = "<default_value>0</default_value>"


def write_body(link: Link, *, version: int) -> str:
    names = ("xx", "yy", "zz", "xy", "xz", "yz")
    if version >= 40000:
        inertia = f"<inertia>{' '.join(map(str, INERTIA))}</inertia>"
        return f'<Body name="{link.name}">{link.mass}{inertia}</Body>'
    inertia = "".join(f"<inertia_{k}>{x}</inertia_{k}>" for k, x in zip(names, INERTIA, strict=True))
    coordinates = "".join(coordinate(name, link.settings) for name in link.coordinates)
    joint = (
        f'<{link.kind} name="to_{link.name}"><parent_body>{link.parent}</parent_body>'
        f"<location_in_parent>{link.outer[0]}</location_in_parent>"
        f"<orientation_in_parent>{link.outer[1]}</orientation_in_parent>"
        f"<location>{link.inner[0]}</location><orientation>{link.inner[1]}</orientation>"
        f"<CoordinateSet><objects>{coordinates}</objects></CoordinateSet>"
        f"<reverse>{str(link.reverse).lower()}</reverse>{link.more}</{link.kind}>"
    )
    return f'<Body name="{link.name}">{link.mass}{inertia}<Joint>{joint}</Joint></Body>'


def write_joint(link: Link) -> str:
    coordinates = "".join(coordinate(name, link.settings) for name in link.coordinates)
    parent = "/ground" if link.parent == "ground" else f"/bodyset/{link.parent}"
    first = _offset("outer", parent, *link.outer)
    second = _offset("inner", f"/bodyset/{link.name}", *link.inner)
    ends = ("inner", "outer") if link.reverse else ("outer", "inner")
    return (
        f'<{link.kind} name="to_{link.name}"><socket_parent_frame>{ends[0]}</socket_parent_frame>'
        f"<socket_child_frame>{ends[1]}</socket_child_frame><coordinates>{coordinates}</coordinates>"
        f"<frames>{first}{second}</frames>{link.more}</{link.kind}>"
    )


def _offset(name: str, parent: str, translation: str, orientation: str) -> str:
    return (
        f'<PhysicalOffsetFrame name="{name}"><socket_parent>{parent}</socket_parent>'
        f"<translation>{translation}</translation><orientation>{orientation}</orientation></PhysicalOffsetFrame>"
    )


def write_model(
    links: Sequence[Link],
    *,
    version: int = 40000,
    forces: str = "",
    constraints: str = "",
    markers: str = "",
    more: str = "",
    joints: str = "",
) -> str:
    """Write a file; `joints` are further ones of version 4."""
    bodies = "\n".join(write_body(link, version=version) for link in links)
    if version >= 40000:
        rows = "\n".join(map(write_joint, links))
        tree = f'<BodySet name="bodyset"><objects>{bodies}</objects></BodySet>\n'
        tree += f'<JointSet name="jointset"><objects>{rows}\n{joints}</objects></JointSet>'
    else:
        ground = '<Body name="ground"><mass>0</mass></Body>'
        tree = f"<BodySet><objects>{ground}\n{bodies}</objects></BodySet>"
    sets = (("ConstraintSet", constraints), ("ForceSet", forces), ("MarkerSet", markers))
    rest = "\n".join(f'<{tag} name="{tag.lower()}"><objects>{inner}</objects></{tag}>' for tag, inner in sets if inner)
    head = f'<?xml version="1.0" encoding="UTF-8" ?>\n<OpenSimDocument Version="{version}">\n'
    return f'{head}<Model name="leg"><gravity>0.3 -9.8 0.2</gravity>\n{tree}\n{rest}{more}</Model></OpenSimDocument>\n'


def coupler(name: str, dependent: str, independent: str, function: str, scale: float = 1.0, more: str = "") -> str:
    return (
        f'<CoordinateCouplerConstraint name="{name}">{more}<coupled_coordinates_function>{function}'
        f"</coupled_coordinates_function><independent_coordinate_names>{independent}</independent_coordinate_names>"
        f"<dependent_coordinate_name>{dependent}</dependent_coordinate_name>"
        f"<scale_factor>{scale}</scale_factor></CoordinateCouplerConstraint>"
    )


def limit(name: str, coordinate: str) -> str:
    return (
        f'<CoordinateLimitForce name="{name}"><coordinate>{coordinate}</coordinate>'
        "<upper_stiffness>2</upper_stiffness><upper_limit>10</upper_limit><lower_stiffness>3</lower_stiffness>"
        "<lower_limit>-5</lower_limit><damping>0.05</damping><transition>20</transition></CoordinateLimitForce>"
    )


def spring(name: str, coordinate: str) -> str:
    return (
        f'<SpringGeneralizedForce name="{name}"><coordinate>{coordinate}</coordinate><stiffness>12</stiffness>'
        "<rest_length>0.3</rest_length><viscosity>0.7</viscosity></SpringGeneralizedForce>"
    )


def save(folder: Path, text: str, name: str = "leg.osim") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


HIP = Link("femur", "CustomJoint", "pelvis", ("flexion", "adduction"), transform(
    axis("rotation1", "0 0 1", "flexion", LINE),
    axis("rotation2", "1 0 0.5", "adduction", LINE.replace("1 0<", "-1 0.2<")),
    axis("rotation3", "0 1 0", "", "<Constant><value>0.3</value></Constant>"),
    axis("translation2", "0 2 1", "", "<Constant><value>0.1</value></Constant>"),
))  # fmt: skip
KNEE = Link("tibia", "CustomJoint", "femur", ("knee",), transform(
    axis("rotation1", "0 0 1", "knee", LINE),
    axis("rotation2", "1 0 0"),
    axis("rotation3", "0 1 0", "knee", ARC),
    axis("translation1", "1 0 0", "knee", THIRD),
    axis("translation2", "0 1 0", "knee", SPLINE),
    axis("translation3", "0 0 1", "knee", LINE.replace("1 0<", "0.05 0.01<")),
))  # fmt: skip
PELVIS = Link("pelvis", "PlanarJoint", "ground", ("tilt", "px", "py"))
LEG = (PELVIS, HIP, KNEE, Link("foot", "UniversalJoint", "tibia", ("ankle", "subtalar")))
ARM = (
    Link("trunk", "SliderJoint", "ground", ("lift",)),
    Link("upper", "GimbalJoint", "trunk", ("a", "b", "c")),
    Link("hand", "BallJoint", "upper", ("d", "e", "f")),
    Link("nail", "WeldJoint", "hand"),
    Link("ring", "PinJoint", "nail", ("turn",)),
)
BALL = (Link("ball", "FreeJoint", "ground", ("rx", "ry", "rz", "tx", "ty", "tz")),)
SPIRAL = Link("nut", "CustomJoint", "ground", ("twist", "slide"), transform(
    axis("rotation2", "0 0.6 0.8", "twist", LINE.replace("1 0<", "2 0.1<")),
    axis("translation1", "1 0 1", "twist slide", PLANE),
    axis("translation3", "0 1 1", "slide", LINE.replace("1 0<", "-0.5 0<")),
))  # fmt: skip
CARRIERS = {"one": "ground", "two": "one", "three": "two", "four": "three"}
CHAIN = tuple(Link(name, "PinJoint", carrier, (f"q_{name}",)) for name, carrier in CARRIERS.items())
PATELLA = Link("patella", "CustomJoint", "femur", ("beta",), transform(
    axis("rotation3", "1 0 0"),
    axis("rotation1", "0 0 1", "beta", SINE),
    axis("translation1", "1 0 0", "beta", SPLINE),
))  # fmt: skip
POLYGON = "<PiecewiseLinearFunction><x>-1 0.1 1</x><y>-0.4 0.1 1.3</y></PiecewiseLinearFunction>"
MARKERS = (
    '<Marker name="heel"><socket_parent_frame>/bodyset/foot</socket_parent_frame><location>0.1 0.2 0.3</location>'
    '</Marker><Marker name="top"><socket_parent_frame>/jointset/to_foot/inner</socket_parent_frame>'
    "<location>-0.1 0.2 0</location></Marker>"
)
CASES: dict[str, str] = {
    "leg": write_model(
        LEG, forces=limit("stop", "knee") + spring("spring", "knee") + limit("end", "px"), markers=MARKERS
    ),
    "leg_3": write_model(LEG, version=30000, forces=limit("stop", "knee") + spring("spring", "ankle")),
    "arm": write_model(ARM),
    "ball": write_model(BALL),
    "nut": write_model((SPIRAL,), forces=limit("stop", "twist") + spring("spring", "twist")),
    "turned": write_model([replace(link, reverse=True) for link in LEG], version=30000),
    "coupled": write_model(
        (*CHAIN, Link("femur", "PinJoint", "four", ("hip",)), KNEE, PATELLA),
        constraints=coupler("first", "q_two", "q_one", LINE.replace("1 0<", "-2 0.1<"), 0.5)
        + coupler("second", "q_three", "q_one", POLYGON, 2.0)
        + coupler("third", "q_four", "q_one hip", PLANE)
        + coupler("fourth", "beta", "knee", LINE.replace("1 0<", "-1 0.1<")),
    ),
}  # fmt: skip
COORDINATES: dict[str, tuple[str, ...]] = {
    "leg": ("tilt", "px", "py", "flexion", "adduction", "knee", "ankle", "subtalar"),
    "arm": ("lift", "a", "b", "c", "d", "e", "f", "turn"),
    "ball": ("rx", "ry", "rz", "tx", "ty", "tz"),
    "nut": ("twist", "slide"),
    "coupled": ("q_one", "q_two", "q_three", "q_four", "hip", "knee", "beta"),
}
COORDINATES["leg_3"] = COORDINATES["turned"] = COORDINATES["leg"]


def check_fault(text: str, old: str, new: str, wanted: str, folder: Path) -> None:
    """Check that a change of a file is refused in these words, with the file and a line."""
    assert old in text
    with pytest.raises(InputError) as caught:
        import_model(save(folder, text.replace(old, new)))
    assert wanted in str(caught.value)
    assert "leg.osim:" in str(caught.value)


def write_answers(cases: Mapping[str, str], reference: Path) -> None:
    """Write OpenSim's numbers for models to a file."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, text in cases.items():

            def keep(*given: Any, name: str = name) -> Any:
                found[name] = ask_opensim(*given)
                return found[name]

            compare_with_opensim(save(Path(folder), text), Choices(), keep)
    reference.write_text(json.dumps(found) + "\n", "utf-8")
