"""Tyres: the Magic Formula as it is printed, the brush in closed form, files and their faults."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy import arctan, cos, sin, tan
from numpy.typing import NDArray

from mbsgen.assembly import assemble
from mbsgen.errors import InputError
from mbsgen.expressions import Number
from mbsgen.formulations import impl
from mbsgen.formulations.reductions import ALL
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.releasing import with_runtime_numbers
from mbsgen.model.changes.scene import Scene, stage
from mbsgen.model.construction import body, brush, contact, joint, magic, make_model
from mbsgen.model.file.tir import read_tyre
from mbsgen.model.model import Model
from mbsgen.model.reader import ModelWarning, read_model
from mbsgen.model.tyres import MAGIC, NEEDED, Tyre
from mbsgen.model.writer import write_model
from mbsgen.procedure.procedure import straight
from mbsgen.tape.interpreter import evaluate
from tests.mbsgen.model.printed import RADIUS, ROAD, print_formulas

Array = NDArray[np.float64]

STIFFNESS = 2.1e5

RIG = """
name: rig
gravity: [0, 0, 0]
bodies:
  - {name: hub, joint: {type: floating, order: zxy}, mass: 10, inertia: [1, 1, 1]}
contacts:
  - {name: road, body: hub, wheel: {axis: y}, tyre: {file: road.tir}}
"""


def make_rig(tyre: Tyre) -> Model:
    """Make a wheel on a floating hub, without gravity: the residual of a straight motion is the ground's force."""
    hub = body("hub", joint("floating", order="zxy"), mass=10, inertia=(1, 1, 1))
    law = contact("road", "hub", stiffness=STIFFNESS, exponent=1, wheel=(RADIUS, "y"), tyre=tyre)
    return make_model("rig", [hub], gravity=(0, 0, 0), contacts=[law])


def measure(model: Model, depth: float, camber: float, velocity: tuple[float, float], spin: float) -> Array:
    """Return Fx, Fy, Fz at the ground and the moment about the hub's centre along x, the axle and z."""
    tree = assemble(build_tree(model))
    height = RADIUS * cos(camber) - depth
    q, qd = [0, 0, height, 0, camber, 0], [*velocity, 0, 0, 0, spin]
    values = {"q": q, "qd": qd, "qdd": [0.0] * 6, "u": [], "w": []}
    tape = straight(impl.build(tree, ALL))
    given = {port.name: values[port.name] for port in tape.inputs}
    return -np.array(evaluate(tape, given)["Phi"], float).ravel()[[0, 1, 2, 4, 5, 3]]


def lay_out(force: Array, moment: Array, depth: float, camber: float) -> Array:
    """Return the same of a force and a moment at the point on the ground below the wheel."""
    arm = np.array([0.0, RADIUS * sin(camber), depth - RADIUS * cos(camber)])
    about = np.cross(arm, force) + moment
    return np.array([*force, about[0], about[1] * cos(camber) + about[2] * sin(camber), about[2]])


@pytest.mark.parametrize(
    ("depth", "kappa", "alpha", "camber"),
    [(0.02, 0.0, 0.0, 0.0), (0.015, 0.05, -0.04, 0.03), (0.03, -0.12, 0.1, -0.06), (0.004, 0.9, 0.4, 0.1)],
)
def test_the_magic_formula_is_the_printed_one(
    tmp_path: Path, depth: float, kappa: float, alpha: float, camber: float
) -> None:
    """At combined slip and camber, from light to twice the nominal load; mirrored, it is its own mirror image."""
    (tmp_path / "road.tir").write_text(ROAD.read_text())
    (tmp_path / "rig.yaml").write_text(RIG)
    model = read_model(tmp_path / "rig.yaml")
    c = {key: 0.0 if value is None else value for key, value in MAGIC.items()} | dict(read_tyre(ROAD).magic)
    V, Fz = 20.0, STIFFNESS * depth
    at = c["FNOMIN"] / STIFFNESS
    rolling = RADIUS - at * (c["DREFF"] * arctan(c["BREFF"] * depth / at) + c["FREFF"] * depth / at)
    Fx, Fy, Mx, My, Mz = print_formulas(c, Fz, kappa, alpha, camber, V)
    expected = lay_out(np.array([Fx, Fy, Fz]), np.array([Mx, My, Mz]), depth, camber)
    spin = V * (1 + kappa) / rolling
    found = measure(model, depth, camber, (V, V * tan(alpha)), spin)
    assert found == pytest.approx(expected, rel=1e-11, abs=1e-9 * Fz)
    (law,) = model.contacts
    assert law.tyre is not None
    turned = replace(model, contacts=(replace(law, tyre=replace(law.tyre, mirrored=True)),))
    found = measure(turned, depth, -camber, (V, -V * tan(alpha)), spin)
    assert found * [1, -1, 1, -1, 1, -1] == pytest.approx(expected, rel=1e-11, abs=1e-9 * Fz)


@pytest.mark.parametrize(("slip", "angle"), [(1e-9, 0.3), (0.02, -1.2), (0.06, 2.5), (0.4, 0.7)])
def test_a_brush_is_its_integral_over_the_bristles(slip: float, angle: float) -> None:
    """Bristles adhere up to where friction under a parabolic pressure breaks them away; then all of them slide."""
    C, mu, a, depth, V = 8e4, 0.9, 0.06, 0.02, 30.0
    Fz, sx, sy = STIFFNESS * depth, slip * np.cos(angle), slip * np.sin(angle)
    # a bristle at x from the leading edge is bent by slip x; the stiffness per length is C/(2 a^2)
    x, weights = np.polynomial.legendre.leggauss(40)
    edge = max(2 * a * (1 - C * slip / (3 * mu * Fz)), 0.0)  # C/(2 a^2) slip x = mu 3 Fz/(4 a) (1 - (x/a - 1)^2)
    parts = [(0.0, edge, lambda x: C / (2 * a**2) * slip * x)]
    parts += [(edge, 2 * a, lambda x: mu * 3 * Fz / (4 * a) * (1 - (x / a - 1) ** 2))]
    force = moment = 0.0
    for begin, end, pull in parts:
        places = begin + (x + 1) / 2 * (end - begin)
        force += float(weights @ pull(places)) * (end - begin) / 2
        moment += float(weights @ (pull(places) * (a - places))) * (end - begin) / 2
    spin = V / RADIUS
    found = measure(make_rig(brush(C, C, mu, a)), depth, 0.0, (V * (1 - sx), V * sy), spin)
    direction = np.array([sx, -sy]) / slip
    F, M = np.array([*force * direction, Fz]), np.array([0, 0, moment * direction[1]])
    expected = lay_out(F, M, depth, 0.0)
    assert found == pytest.approx(expected, rel=1e-11, abs=3e-8)
    if slip == 0.4:
        assert force == pytest.approx(mu * Fz)


def test_a_wheel_in_the_air_has_no_force(tmp_path: Path) -> None:
    """No load divides anything; of a brush a third of 1e-9 N is left."""
    (tmp_path / "road.tir").write_text(ROAD.read_text())
    (tmp_path / "rig.yaml").write_text(RIG)
    for model in (read_model(tmp_path / "rig.yaml"), make_rig(brush(8e4, 6e4, 0.9))):
        assert np.abs(measure(model, -0.5, 0.1, (20.0, 1.0), 50.0)).max() < 1e-9
        assert np.isfinite(measure(model, 0.01, 0.0, (0.0, 0.0), 0.0)).all()


def test_files_keep_tyres(tmp_path: Path) -> None:
    """A model is written with its coefficients, and reads as the same one; factors become inputs."""
    (tmp_path / "road.tir").write_text(ROAD.read_text())
    (tmp_path / "rig.yaml").write_text(RIG.replace("file: road.tir", "file: road.tir, coefficients: {LMUX: 0.7}"))
    for model in (read_model(tmp_path / "rig.yaml"), make_rig(brush(8e4, 6e4, 0.9, 0.05))):
        (tmp_path / "copy.yaml").write_text(write_model(model))
        assert read_model(tmp_path / "copy.yaml") == model
    model = with_runtime_numbers(read_model(tmp_path / "rig.yaml"))
    names = {x.name for x in model.parameters}
    assert {"contacts.road.tyre.LMUX", "contacts.road.stiffness"} <= names
    assert "contacts.road.tyre.PCX1" not in names


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ("FITTYP        = 6", "FITTYP = 61"),
            r"road\.tir:14: FITTYP: formulas of type 61; give a file of MF-Tyre 5\.2",
        ),
        (("'meter'", "'mm'"), r"road\.tir:7: LENGTH: a unit .mm.; convert the file to SI: meter"),
        (("PCX1          = 1.58", "PCX1 = wide"), r"PCX1: found .wide.; give a number"),
        (("PDX1          = 1.04", "PDX1 = nan"), r"PDX1: found no number"),
        (("PKY1 ", "PKX9 "), r"PKY1: missing"),
        (("QSY2          = 0", "PCY1 = 1"), r"PCY1: given again in line"),
        (("FNOMIN        = 4000", "FNOMIN = -1"), r"FNOMIN: found -1; give more than 0"),
        (("UNLOADED_RADIUS = 0.313", ""), r"rig\.yaml:7: contacts\[0\]\.wheel\.radius: missing"),
        (("VERTICAL_STIFFNESS = 2.1e5", ""), r"contacts\[0\]\.stiffness: missing"),
    ],
)
def test_a_fault_of_a_file_is_named(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    text = ROAD.read_text()
    assert text.count(change[0]) == 1
    (tmp_path / "road.tir").write_text(text.replace(*change))
    (tmp_path / "rig.yaml").write_text(RIG)
    with pytest.raises(InputError, match=message) as found:
        read_model(tmp_path / "rig.yaml")
    assert len(found.value.faults) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("file: road.tir", "file: none.tir"), r"none\.tir: there is no such file"),
        (("file: road.tir", "file: ../road.tir"), "leads out of the model's folder"),
        (("file: road.tir", "file: road.yaml"), r"no file that is read; give \.tir"),
        (("file: road.tir", "file: road.tir, coefficients: {PCX9: 1}"), r"no coefficient .PCX9.; did you mean PCX1"),
        (("file: road.tir", "file: road.tir, coefficients: {LMUX: 0}"), "LMUX missing, or 0"),
        (
            ("{axis: y}, tyre: {file: road.tir}", "{radius: 1}, stiffness: 1, tyre: {coefficients: {PCX1: 1}}"),
            "FNOMIN, PDX1, PKX1, PCY1, PDY1, PKY1, PKY2 missing, or 0",
        ),
        (
            ("file: road.tir", "file: road.tir, brush: {longitudinal: 1, lateral: 1, friction: 1}"),
            "file beside a brush",
        ),
        (("file: road.tir", "file: road.tir, speed: 0"), "found 0; give more than 0"),
        (
            ("file: road.tir", "file: road.tir, transient: true"),
            r"transient: no relaxation length: PTX1 and PTY1 are missing, or 0; give them under coefficients",
        ),
        (
            ("file: road.tir", "file: road.tir, coefficients: {PTX1: 1}"),
            r"PTX1: PTX1 of a tyre that is not transient; give transient: true",
        ),
        (
            ("file: road.tir", "file: road.tir, transient: true, coefficients: {PTY1: 1}"),
            r"PTY2: found 0; give more than 0",
        ),
        (
            (
                "{axis: y}, tyre: {file: road.tir}",
                "{radius: 1}, stiffness: 1, tyre: {transient: true, brush: {longitudinal: 1, lateral: 1, friction: 1}}",
            ),
            "transient beside a brush",
        ),
        (
            (
                "{axis: y}, tyre: {file: road.tir}",
                "{radius: 1}, stiffness: 1,"
                " tyre: {brush: {longitudinal: 1, lateral: 1, friction: 1, relaxation: {lateral: 0}}}",
            ),
            r"relaxation\.lateral: found 0; give more than 0",
        ),
        (("wheel: {axis: y}, ", ""), "a tyre without a wheel"),
        (("wheel:", "friction: {coefficient: 1, speed: 1}, wheel:"), "friction beside a tyre"),
        (("wheel:", "restitution: 0, wheel:"), "restitution beside a tyre"),
    ],
)
def test_a_fault_of_a_tyre_is_named(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    (tmp_path / "road.tir").write_text(ROAD.read_text())
    (tmp_path / "rig.yaml").write_text(RIG.replace(*change))
    with pytest.raises(InputError, match=message) as found:
        read_model(tmp_path / "rig.yaml")
    assert len(found.value.faults) == 1


def test_what_is_left_out_is_said(tmp_path: Path) -> None:
    """Pressures are not computed, and relaxation lengths of transient tyres alone."""
    (tmp_path / "road.tir").write_text(ROAD.read_text() + "PTX1 = 1.5\nPTY1 = 0\nPPX1 = 0.3\n")
    (tmp_path / "rig.yaml").write_text(RIG)
    with pytest.warns(ModelWarning) as found:
        read_model(tmp_path / "rig.yaml")
    pressure, relaxation = sorted(str(x.message).split("road.tir: ")[1] for x in found)
    assert pressure == "no formula of MF-Tyre 5.2 without turn slip and pressure has PPX1; these are left out"
    assert relaxation == "without transient: true in a tyre, the relaxation lengths PTX1 are left out"
    (tmp_path / "rig.yaml").write_text(RIG.replace("file: road.tir", "file: road.tir, transient: true"))
    with pytest.warns(ModelWarning) as found:
        model = read_model(tmp_path / "rig.yaml")
    assert len(found) == 1
    assert [x.name for x in model.bodies] == ["hub", "road.longitudinal"]  # PTY1 is 0


def test_slips_that_are_states_are_bodies(tmp_path: Path) -> None:
    """A file keeps the lengths, not the bodies; lengths of a brush become inputs; locked bodies have no slips."""
    lengths = {"longitudinal": 0.3, "lateral": 0.5}
    model = make_rig(brush(8e4, 6e4, 0.9, 0.05, lengths))
    assert [x.name for x in model.bodies] == ["hub", "road.longitudinal", "road.lateral"]
    (tmp_path / "copy.yaml").write_text(write_model(model))
    assert read_model(tmp_path / "copy.yaml") == model
    assert "contacts.road.tyre.relaxation.lateral" in {x.name for x in with_runtime_numbers(model).parameters}
    still = stage(model, Scene(locked=tuple((f"hub.{k}", Number(0.0)) for k in ("x", "y", "z", "rz", "rx", "ry"))))
    assert not still.contacts
    assert [x.name for x in still.bodies] == ["hub"]
    coefficients = dict.fromkeys(NEEDED, 1.0) | {"PTX1": 1.2, "PTY1": 2.0, "PTY2": 1.5, "LSGAL": 0.8}
    model = make_rig(magic(coefficients, transient=True))
    (tmp_path / "copy.yaml").write_text(write_model(model))
    assert read_model(tmp_path / "copy.yaml") == model
    assert magic({**coefficients, "PTX1": 0}, transient=True).relaxed == ("lateral",)
    assert magic(coefficients).relaxed == ()
    with pytest.raises(ValueError, match='a relaxation "across"; give longitudinal or lateral'):
        brush(8e4, 6e4, 0.9, relaxation={"across": 1})
