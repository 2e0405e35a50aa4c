"""Models scaled to a subject: against OpenSim's ScaleTool, similar models, and a table of segments."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from jsonschema import Draft202012Validator

from mbsgen.documents import read_document
from mbsgen.errors import InputError
from mbsgen.expressions import FLOATS, Expression, evaluate
from mbsgen.importing.markup import Element, read_markup
from mbsgen.importing.rotations import turn
from mbsgen.model.model import Hull, Placement, Plane, Triple
from mbsgen.model.reader import read_model
from mbsgen.subjects.osim import Masses, list_bodies, scale_osim
from mbsgen.subjects.plain import scale_model
from mbsgen.subjects.reading import read_subject
from mbsgen.subjects.scaling import ModelSource, OsimSource, scale_subject
from mbsgen.subjects.schema import write_schema
from mbsgen.subjects.segments import TABLES
from mbsrun.cli import cli
from mbsrun.subjects import Fitted, fit_subject
from tests import opensim
from tests.mbsgen.importing.osim_muscle_files import shape
from tests.mbsrun.subject_files import (
    FACTORS,
    MARKERS,
    MEASUREMENTS,
    SETUP,
    write_factors,
    write_leg,
    write_trc,
)

ROOT = Path(__file__).parents[2]
PEER = Path(__file__).with_name("scale_peer.py")
EXAMPLE = ROOT / "models" / "subjects" / "leg.subject.yaml"
ROUNDED = 1e-8  # relative: the digits asked of lengths, masses and inertias
WEIGHTS = (10, 2, 3, 1, 5, 5, 1, 4, 4, 2, 2, 2)  # of markers
KEPT = "RigidTendonMuscle"  # OpenSim does not scale its lengths, here they follow its line


def write_trial(folder: Path, *, version: int = 40000) -> None:
    """Write the leg, and markers of another one, whose factors are known, 1 cm beside their places."""
    (folder / "leg.osim").write_text(write_leg(version=version, fixed=("heel",)), encoding="utf-8")
    root = scale_osim(read_markup(folder / "leg.osim"), FACTORS, Masses())
    places = OsimSource(root).measure().places
    rng = np.random.default_rng(0)
    trial = {name: places[name] + rng.normal(0, 0.01, 3) + rng.normal(0, 0.001, (8, 3)) for name in MARKERS}
    write_trc(folder / "static.trc", trial)


def write_tasks() -> str:
    tasks = "".join(
        f'<IKMarkerTask name="{name}"><apply>true</apply><weight>{w}</weight></IKMarkerTask>'
        for name, w in zip(MARKERS, WEIGHTS, strict=True)
    )
    knee = "<weight>0.01</weight><value_type>manual_value</value_type><value>0.3</value>"
    return f'{tasks}<IKCoordinateTask name="knee"><apply>true</apply>{knee}</IKCoordinateTask>'


def list_numbers(element: Element, path: str = "") -> Iterator[tuple[str, list[float]]]:
    """Yield the numbers of a file; products of a function with 1 are the function."""
    if element.tag == "MultiplierFunction":
        (holder,), scale = element.all("function"), element.first("scale")
        assert scale is not None
        yield f"{path}/scale", [float(scale.text)]
        element = holder.children[0]
    elif path.endswith(("translation1", "translation2", "translation3", "_location")) and "Function" in element.tag:
        yield f"{path}/scale", [1.0]
    name = element.attributes.get("name", "")
    own = f"{path}/{element.tag}[{name}]" if name and name != "function" else f"{path}/{element.tag}"
    try:
        numbers = [float(x) for x in element.text.split()]
    except ValueError:
        numbers = []
    if numbers:
        yield own, numbers
    for child in element.children:
        yield from list_numbers(child, own)


def compare(ours: Path, theirs: Path, *, without: str = "") -> float:
    """Return the largest difference of numbers with the same path in two files, over 1 plus their size."""
    found, expected = (dict(list_numbers(read_markup(path))) for path in (ours, theirs))
    scales = {name for name in found.keys() | expected.keys() if name.endswith("/scale")}
    assert found.keys() - scales == expected.keys() - scales
    worst = 0.0
    for name, numbers in expected.items():
        if name in scales or KEPT in name or (without and without in name):
            continue
        a, b = np.array(found[name]), np.array(numbers)
        worst = max(worst, float((np.abs(a - b) / (np.abs(b).max() or 1.0)).max()))
    for name in scales:
        worst = max(worst, abs(found.get(name, [1.0])[0] - expected.get(name, [1.0])[0]))
    return worst


@pytest.mark.parametrize("version", [40000, 30000])
@pytest.mark.parametrize(("mass", "keep"), [(70.0, "true"), (-1.0, "false"), (70.0, "false"), (-1.0, "true")])
def test_scaled_models_equal_those_of_opensim(tmp_path: Path, mass: float, keep: str, version: int) -> None:
    """All numbers of the file: lengths, muscles, masses, inertias.

    OpenSim reads frames and inertias of version 3 with six digits, so factors have few digits there.
    """
    write_trial(tmp_path, version=version)
    is_rounded = version < 40000
    order = "manualScale" if is_rounded else "measurements manualScale"
    given = FACTORS if is_rounded else {"foot": FACTORS["foot"]}
    setup = SETUP.format(
        mass=mass, order=order, measurements=MEASUREMENTS, factors=write_factors(given), keep=keep,
        places="false", tasks="",
    )  # fmt: skip
    (tmp_path / "setup.xml").write_text(setup, encoding="utf-8")
    fitted = fit_subject(tmp_path / "setup.xml")
    (tmp_path / "ours.osim").write_text(fitted.scaled.text, encoding="utf-8")
    ask(tmp_path, {"ours": "ours_printed", "stretched": "theirs"})
    assert compare(tmp_path / "ours_printed.osim", tmp_path / "theirs.osim", without="inertia") < ROUNDED
    assert compare(tmp_path / "ours_printed.osim", tmp_path / "theirs.osim") < (1e-5 if is_rounded else ROUNDED)


def test_wrapping_surfaces_are_stretched_as_in_opensim(tmp_path: Path) -> None:
    """Ellipsoids, tori, cylinders and spheres that are turned on a body with three different factors."""
    shapes = shape("WrapEllipsoid", "egg", "0.01 -0.2 0.02", "0.3 0.2 0.1", dimensions="0.03 0.04 0.05")
    shapes += shape("WrapTorus", "ring", "0.02 -0.1 0.03", "1.5 0.1 0.2", inner_radius="0.02", outer_radius="0.06")
    shapes += shape("WrapCylinder", "roll", "0 -0.3 0.01", "0.4 0 0.2", radius="0.03", length="0.1")
    shapes += shape("WrapSphere", "ball", "0.03 -0.3 0.01", "0.4 0.5 0.2", radius="0.04")
    write_trial(tmp_path)
    path, body = tmp_path / "leg.osim", '<Body name="femur">'
    text = path.read_text("utf-8")
    assert text.count(body) == 1
    path.write_text(
        text.replace(body, f"{body}<WrapObjectSet><objects>{shapes}</objects></WrapObjectSet>"), encoding="utf-8"
    )
    setup = SETUP.format(
        mass=-1.0, order="manualScale", measurements="", factors=write_factors(), keep="true", places="false", tasks="",
    )  # fmt: skip
    (tmp_path / "setup.xml").write_text(setup, encoding="utf-8")
    (tmp_path / "ours.osim").write_text(fit_subject(tmp_path / "setup.xml").scaled.text, encoding="utf-8")
    ask(tmp_path, {"ours": "ours_printed", "stretched": "theirs"})
    assert compare(tmp_path / "ours_printed.osim", tmp_path / "theirs.osim") < ROUNDED
    sizes = dict(list_numbers(read_markup(tmp_path / "theirs.osim")))
    radius = next(x for name, x in sizes.items() if name.endswith("WrapSphere[ball]/radius"))
    assert radius == pytest.approx([0.04 * (1.2 + 1.05 + 0.95) / 3], rel=1e-12)


WRAPS = """
name: wraps
gravity: [0, 0, 0]
bodies: [{name: thigh, joint: {type: free}, mass: 1, inertia: [0.1, 0.1, 0.1]}]
forces:
  - name: line
    type: spring
    from: {body: base, position: [0.3, 0, 0]}
    to: {body: thigh, position: [-0.3, 0, 0]}
    stiffness: 1
    rest: 0.1
    wraps:
      - {type: WRAP, body: thigh, position: [0.1, 0.2, 0.3], orientation: {rpy: [pi/2, 0, 0]}}
"""


@pytest.mark.parametrize(
    ("shape", "sizes"),
    [
        ("ellipsoid, radii: [0.1, 0.2, 0.3]", (0.1 * 1.2, 0.2 * 0.8, 0.3 * 1.1)),
        ("torus, radius: 0.2, tube: 0.05", (0.2 * 1.0, 0.05 * 1.0)),
        ("cylinder, radius: 0.2", (0.2 * 1.0,)),
        ("sphere, radius: 0.2", (0.2 * 3.1 / 3,)),
    ],
)
def test_wraps_of_a_model_file_are_stretched(shape: str, sizes: tuple[float, ...], tmp_path: Path) -> None:
    """A quarter turn about x: y of the surface is z of its body, whose factors are 1.2, 1.1 and 0.8."""
    path = tmp_path / "wraps.yaml"
    path.write_text(WRAPS.replace("WRAP", shape), encoding="utf-8")
    scaled = scale_model(read_model(path), {"thigh": (1.2, 1.1, 0.8)}, Masses())
    (wrap,) = next(x for x in scaled.forces if x.name == "line").wraps
    assert [evaluate(x, {}, FLOATS) for x in wrap.size] == pytest.approx(sizes, rel=1e-12)
    assert [evaluate(x, {}, FLOATS) for x in wrap.placement.position] == pytest.approx([0.12, 0.22, 0.24], rel=1e-12)


def ask(folder: Path, printed: dict[str, str]) -> None:
    """Scale by `setup.xml` of a folder in OpenSim, and print models of it."""
    files = {str(folder / f"{a}.osim"): str(folder / f"{b}.osim") for a, b in printed.items()}
    text = json.dumps({"setup": str(folder / "setup.xml"), "printed": files})
    assert json.loads(opensim.ask(PEER, text, folder)) == 0


def test_placed_markers_are_opensims_within_its_tolerance(tmp_path: Path) -> None:
    """Places of markers on bodies, and the sum of weighted squares is not larger than at OpenSim's pose."""
    write_trial(tmp_path)
    setup = SETUP.format(
        mass=70, order="measurements", measurements=MEASUREMENTS, factors="", keep="true",
        places="true", tasks=write_tasks(),
    )  # fmt: skip
    (tmp_path / "setup.xml").write_text(setup, encoding="utf-8")
    fitted = fit_subject(tmp_path / "setup.xml")
    assert fitted.converged
    (tmp_path / "ours.osim").write_text(fitted.scaled.text, encoding="utf-8")
    ask(tmp_path, {"ours": "ours_printed", "placed": "theirs"})
    found, expected = (dict(list_numbers(read_markup(tmp_path / f"{x}.osim"))) for x in ("ours_printed", "theirs"))
    places = [name for name in expected if "/Marker[" in name and name.endswith("location")]
    assert len(places) == len(MARKERS)
    for name in places:
        np.testing.assert_allclose(found[name], expected[name], atol=2e-4)  # m; OpenSim's search ends early
    heel = next(x for x in places if "heel" in x)
    np.testing.assert_allclose(found[heel], expected[heel], rtol=ROUNDED)  # it is fixed on its body
    assert [x.left > 0 for x in fitted.markers] == [x.name == "heel" for x in fitted.markers]


def test_a_subject_of_the_same_shape_is_found_exactly(tmp_path: Path) -> None:
    """Markers of the leg stretched evenly: factors are known, and in its pose no marker is beside its place."""
    path = tmp_path / "leg.osim"
    path.write_text((EXAMPLE.parent / "leg.osim").read_text(encoding="utf-8"), encoding="utf-8")
    even = dict.fromkeys(list_bodies(read_markup(path)), (1.1, 1.1, 1.1))
    grown = OsimSource(scale_osim(read_markup(path), even, Masses()))
    write_trc(tmp_path / "static.trc", {name: np.array([x, x]) for name, x in grown.measure().places.items()})
    settings = EXAMPLE.read_text(encoding="utf-8").replace("times: [0, 0.2]\n", "")
    (tmp_path / "subject.yaml").write_text(settings, encoding="utf-8")
    fitted = fit_subject(tmp_path / "subject.yaml")
    for name, factors in fitted.scaled.factors.items():
        np.testing.assert_allclose(factors, even[name], rtol=1e-9)  # digits of the recording
    assert max(x.error for x in fitted.markers) < 1e-6
    assert sum(x.after for x in fitted.scaled.weights) == pytest.approx(27, rel=1e-12)
    np.testing.assert_allclose([*fitted.scaled.lines.values()], 1.1, rtol=1e-9)  # all lengths grow alike


MODEL = """
name: leg
gravity: [0, -9.81, 0]
parameters: {size: 0.4}
bodies:
  - {name: thigh, joint: {type: revolute, axis: z}, mass: 8, com: [0, -0.17, 0], inertia: [0.13, 0.03, 0.14]}
  - name: shank
    parent: thigh
    joint: {type: revolute, axis: z, position: [0, -size, 0]}
    mass: 3
    com: [0, -0.18, 0]
    inertia: [0.05, 0.005, 0.05]
frames:
  - {name: knee, body: thigh, position: [0, -0.4, 0.05]}
  - {name: hip, body: thigh, position: [0, 0, 0.08]}
  - {name: heel, body: shank, position: [-0.03, -0.4, 0], orientation: {rpy: [0, 30 deg, 0]}}
forces:
  - name: vastus
    type: muscle
    from: {body: thigh, position: [0.03, -0.1, 0]}
    to: {body: shank, position: [0.04, -0.05, 0]}
    muscle: {strength: 1000, fibre: 0.1, tendon: 0.2, activation: vastus}
signals: [vastus]
"""


def write_model(folder: Path, settings: str) -> Path:
    (folder / "leg.yaml").write_text(MODEL, encoding="utf-8")
    (folder / "subject.yaml").write_text("model: leg.yaml\n" + settings, encoding="utf-8")
    return folder / "subject.yaml"


def test_a_model_file_is_stretched_as_a_file_of_opensim(tmp_path: Path) -> None:
    """Places scale with their body, joints with the parent; even factors scale inertias by the square."""
    path = write_model(tmp_path, "factors: {thigh: [1.2, 1.2, 1.2], shank: [1, 1.1, 1]}\n")
    fitted = fit_subject(path)
    (tmp_path / "scaled.yaml").write_text(fitted.scaled.text, encoding="utf-8")
    source = fitted.scaled.source
    assert isinstance(source, ModelSource)
    places = source.measure().places
    np.testing.assert_allclose(places["knee"], [0, -0.48, 0.06], atol=1e-15)
    np.testing.assert_allclose(places["shank"], [0, -0.48, 0], atol=1e-15)
    np.testing.assert_allclose(places["heel"], [-0.03, -0.48 - 0.44, 0], atol=1e-15)
    before = np.hypot(0.01, 0.35)
    after = np.hypot(0.04 - 0.036, 0.48 + 0.055 - 0.12)
    assert fitted.scaled.lines["vastus"] == pytest.approx(after / before, rel=1e-12)
    same = scale_subject(read_subject(write_model(tmp_path, "")), {})
    assert same.text == ModelSource(read_model(tmp_path / "leg.yaml")).write()


SOLIDS = """
name: solids
gravity: [0, 0, 0]
bodies:
  - {name: stone, joint: {type: free}, mass: 1, inertia: [0.1, 0.1, 0.1]}
  - {name: rock, joint: {type: free}, mass: 1, inertia: [0.1, 0.1, 0.1]}
contacts:
  - name: pair
    body: stone
    position: [0.1, 0.2, 0.3]
    orientation: {rpy: [0.4, -0.3, 0.8]}
    points: [[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3], [-0.1, -0.1, -0.1]]
    hull: {body: rock, position: [0, 0.1, 0], points: [[0.2, 0, 0], [0, 0.1, 0], [0, 0, 0.4], [-0.2, -0.1, -0.1]]}
    restitution: 0
  - name: slope
    body: stone
    radius: 0.1
    plane: {body: rock, position: [0, 0, 0.1], normal: [0.3, -0.2, 1]}
    stiffness: 1
  - {name: tyre, body: stone, wheel: {radius: 0.3, axis: z, length: 0.2}, stiffness: 1}
  - {name: box, body: stone, size: [0.1, 0.2, 0.3], orientation: {rpy: [0, 0, pi/2]}, stiffness: 1}
"""


def test_shapes_of_contacts_are_stretched_with_their_bodies(tmp_path: Path) -> None:
    """Points of a hull go where its body's points go, a plane through three of them stays so, and boxes turn."""
    (tmp_path / "solids.yaml").write_text(SOLIDS, encoding="utf-8")
    model = read_model(tmp_path / "solids.yaml")
    own, other = (1.5, 0.8, 1.2), (0.7, 2.0, 1.1)
    scaled = scale_model(model, {"stone": own, "rock": other}, Masses())

    def number(x: Expression) -> float:
        return evaluate(x, {}, FLOATS)

    def place(points: tuple[Triple, ...], placement: Placement) -> np.ndarray:
        R = np.eye(3)
        for rotation in placement.orientation:
            R = R @ turn(np.eye(3)[rotation.axis], number(rotation.angle))
        centre = np.array([number(x) for x in placement.position])
        return np.array([[number(x) for x in point] for point in points]) @ R.T + centre

    (before, slope, wheel, _), (after, slope_after, wheel_after, box_after) = model.contacts, scaled.contacts
    stretched = place(before.points, before.placement) * own
    assert place(after.points, after.placement) == pytest.approx(stretched, rel=1e-14)
    assert isinstance(before.other, Hull)
    assert isinstance(after.other, Hull)
    stretched = place(before.other.points, before.other.placement) * other
    assert place(after.other.points, after.other.placement) == pytest.approx(stretched, rel=1e-14)

    assert isinstance(slope.other, Plane)
    assert isinstance(slope_after.other, Plane)
    normal, turned = (np.array([number(x) for x in side.normal]) for side in (slope.other, slope_after.other))
    (origin,) = place((slope.other.position,), Placement()) * other
    assert place((slope_after.other.position,), Placement())[0] == pytest.approx(origin)
    across = np.linalg.svd(normal[None])[2][1:]  # directions within the plane
    assert turned @ (across * other).T == pytest.approx([0, 0], abs=1e-14)

    assert wheel.wheel is not None
    assert wheel_after.wheel is not None
    assert number(wheel_after.wheel.radius) == pytest.approx(0.3 * (1.5 + 0.8) / 2)
    assert number(wheel_after.wheel.length) == pytest.approx(0.2 * 1.2)
    assert box_after.size is not None
    assert [number(x) for x in box_after.size] == pytest.approx([0.1 * 0.8, 0.2 * 1.5, 0.3 * 1.2])
    assert scale_model(model, {}, Masses()).contacts == model.contacts


def test_segments_of_the_table_have_its_lengths_masses_and_inertias(tmp_path: Path) -> None:
    """P. de Leva's figures, for a man of the sample's stature and 100 kg: lengths in m and masses in per cent."""
    path = write_model(
        tmp_path,
        "mass: 100\nheight: 1.741\nsex: male\n"
        "segments: {thigh: {segment: thigh, end: shank}, shank: {segment: shank}}\n",
    )
    fitted = fit_subject(path)
    thigh, places = TABLES["male"]["thigh"], fitted.scaled.source.measure().places
    np.testing.assert_allclose([thigh.length, thigh.mass, thigh.centre], [0.4222, 0.1416, 0.4095], rtol=1e-15)
    np.testing.assert_allclose(places["shank"], [0, -0.4222, 0], atol=1e-15)
    (tmp_path / "scaled.yaml").write_text(fitted.scaled.text, encoding="utf-8")
    body = read_model(tmp_path / "scaled.yaml").bodies[0]
    mass, centre, *moments = (
        evaluate(x, {}, FLOATS) for x in (body.mass, body.com[1], body.inertia.xx, body.inertia.yy, body.inertia.zz)
    )
    np.testing.assert_allclose([mass, centre], [14.16, -0.4095 * 0.4222], rtol=1e-12)
    np.testing.assert_allclose(np.sqrt(np.array(moments) / 14.16) / 0.4222, [0.329, 0.149, 0.329], rtol=1e-12)


def test_the_table_has_all_of_the_body() -> None:
    """Masses of head, trunk, arms and legs are the whole to the digits of the table, and so are parts of the trunk."""
    for table in TABLES.values():
        paired = ("upper_arm", "forearm", "hand", "thigh", "shank", "foot")
        whole = table["head"].mass + table["trunk"].mass + 2 * sum(table[x].mass for x in paired)
        assert whole == pytest.approx(1, abs=1.1e-4)
        parts = [table[f"{x}_trunk"] for x in ("upper", "middle", "lower")]
        assert sum(x.mass for x in parts) == pytest.approx(table["trunk"].mass, abs=1.1e-4)
        assert sum(x.length for x in parts) == pytest.approx(table["trunk"].length, abs=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("femur: xyz", "femor: xyz", ':9: measurements.thigh.bodies.femor: the model has no body "femor"; did'),
        ("[hip, knee]", "[hip, kne]", ":9: measurements.thigh.pairs[0]: "),
        ("mass: 27", "mass: -27", ":5: mass: found -27; give a number above 0, up to 1000, in kg and m"),
        ("mass: 27", "mas: 27", ":5: mas: unknown key; did you mean `mass`?"),
        ("static.trc", "statc.trc", ":3: recording: there is no file"),
        ("times: [0, 0.2]", "times: [3, 4]", ":4: times: no sample lies in it; the recording is from 0 to 0.2 s"),
        ("leg.osim", "arm.osim", ":2: model: there is no file"),
        ("pelvis_list:", "pelvis_lst:", ":14: markers.coordinates.pelvis_lst: the model has no coordinate"),
        ("mass: 27", "segments: {femur: {segment: thigh}}", ":5: segments: the table of segments needs `mass`"),
    ],
)  # fmt: skip
def test_faults_of_settings_are_named(tmp_path: Path, old: str, new: str, expected: str) -> None:
    for name in ("leg.osim", "static.trc"):
        (tmp_path / name).write_text((EXAMPLE.parent / name).read_text(encoding="utf-8"), encoding="utf-8")
    path = tmp_path / "subject.yaml"
    path.write_text(EXAMPLE.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as error:
        fit_subject(path)
    assert f"{path}{expected}" in str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("<model_file>leg.osim</model_file>", "", "GenericModelMaker: it names no model; give <model_file>"),
        ("> manualScale<", "> manual<", 'scaling_order: found "manual"; give measurements or manualScale'),
        ("<segment>femur", "<segment>thigh", 'factors.thigh: the model has no body "thigh"'),
        ("<scales>1.1 0.9 1.2", "<scales>1.1 0 1.2", "found 1.1 0 1.2; give factors above 0"),
        ("ScaleTool", "Tool", "it holds <OpenSimDocument>, and no <ScaleTool>"),
    ],
)
def test_faults_of_a_setup_are_named(tmp_path: Path, old: str, new: str, expected: str) -> None:
    write_trial(tmp_path)
    text = SETUP.format(
        mass=1, order="manualScale", measurements="", factors=write_factors(), keep="true", places="false", tasks=""
    )
    assert old in text
    (tmp_path / "setup.xml").write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as error:
        fit_subject(tmp_path / "setup.xml")
    assert expected in str(error.value)
    assert str(error.value).startswith(f"{tmp_path / 'setup.xml'}:")


def test_the_schema_is_up_to_date_and_the_page_names_every_key() -> None:
    """If the change of the schema is meant: `make schema`."""
    schema = json.loads(write_schema())
    assert (ROOT / "models" / "subject.schema.json").read_text(encoding="utf-8") == write_schema()
    Draft202012Validator.check_schema(schema)
    assert [*Draft202012Validator(schema).iter_errors(read_document(EXAMPLE).data)] == []
    page = (ROOT / "docs" / "scaling.md").read_text(encoding="utf-8")
    keys = {*schema["properties"], *(key for part in schema["$defs"].values() for key in part["properties"])}
    assert [key for key in sorted(keys) if key not in page] == []


def test_the_command_writes_a_model_tables_and_a_picture(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run = CliRunner().invoke(cli, ["scale", str(EXAMPLE), "-o", str(out)])
    assert run.exit_code == 0, run.output
    names = {"scaled.osim", "factors.csv", "distances.csv", "markers.csv", "pose.mot", "scaling.json", "scaling.png"}
    assert {path.name for path in out.iterdir()} == names
    told = json.loads((out / "scaling.json").read_text(encoding="utf-8"))
    assert told["masses"].keys() == told["factors"].keys() == {"pelvis", "femur", "tibia", "foot"}
    assert isinstance(fit_subject(EXAMPLE), Fitted)
