"""OpenSim's models: against OpenSim's numbers, which ship in tests/reference; loops, functions, and what is refused.

`python -m tests.mbsgen.importing.test_osim` writes the numbers anew, where
`python -m tests.peers build/peers` installed OpenSim.
"""

from __future__ import annotations

import json
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpmath import mpf
from scipy.interpolate import make_interp_spline

from mbsgen.assembly import assemble
from mbsgen.errors import InputError
from mbsgen.expressions import FLOATS, Number, evaluate
from mbsgen.importing import Choices, Imported, import_model, write_imported
from mbsgen.importing.osim.functions import write_natural, write_polygon, write_spline
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.model import Fixed, Joint
from mbsgen.model.reader import read_model
from tests import peers
from tests.mbsgen.importing.osim_files import (
    ARC,
    CASES,
    CHAIN,
    COORDINATES,
    KNEE,
    LEG,
    LINE,
    Link,
    axis,
    coordinate,
    coupler,
    limit,
    save,
    spring,
    transform,
    write_model,
)
from tests.mbsgen.importing.osim_motion import Case, Motion, ask_opensim, draw, find_misses, list_states

REFERENCE = Path(__file__).parents[2] / "reference" / "opensim_joints.json"
SIZES = {"nut": {"twist": 2.0, "slide": 0.5}}
BALLS = {"arm": (("d", "e", "f"),), "ball": (("rx", "ry", "rz"),)}
EPS = float(np.finfo(float).eps)


class WithBeta(Motion):
    """A model in which the coordinate beta is replaced by 0.1 - knee."""

    def find(self, name: str, z: Any) -> mpf:
        return mpf("0.1") - self.find("knee", z) if name == "beta" else super().find(name, z)


def read(folder: Path, text: str, **choices: Any) -> Imported:
    return import_model(save(folder, text), Choices(**choices))


def prepare(folder: Path, name: str) -> tuple[Motion, Case, Any]:
    """Return a case, its motion, and states."""
    file = save(folder, CASES[name], f"{name}.osim")
    found = import_model(file)
    seen = ("heel", "top", "foot") if name == "leg" else ("tibia", "patella") if name == "coupled" else ()
    motion = WithBeta(import_model(file, Choices(sensors=seen)) if seen else found, {})
    case = Case(file, COORDINATES[name], BALLS.get(name, ()), SIZES.get(name, {}))
    return motion, case, draw(motion, case, seed=1)


@pytest.mark.parametrize("name", CASES)
def test_equations_and_places_are_opensims(name: str, tmp_path: Path) -> None:
    """Mass matrix, inverse dynamics with springs and limits, and places of markers and bodies, at random states.

    The factor 1e4 covers the digits of a knee's spline that cancel in sums of cubes.
    """
    motion, case, drawn = prepare(tmp_path, name)
    misses = find_misses(motion, case, drawn, json.loads(REFERENCE.read_text("utf-8"))[name])
    assert max(misses.values()) < 1e4 * EPS, misses


@pytest.mark.parametrize("name", CASES)
def test_the_reference_is_what_opensim_computes(name: str, tmp_path: Path) -> None:
    if not (peers.FOLDER / "opensim").exists():
        pytest.skip("python -m tests.peers build/peers installs OpenSim")
    motion, case, drawn = prepare(tmp_path, name)
    assert max(find_misses(motion, case, drawn, ask_opensim(case.file, list_states(case, drawn))).values()) < 1e4 * EPS


@pytest.mark.parametrize("name", CASES)
def test_models_are_written_and_read_again(name: str, tmp_path: Path) -> None:
    found = read(tmp_path, CASES[name])
    (tmp_path / "model.yaml").write_text(write_imported(found), "utf-8")
    assert read_model(tmp_path / "model.yaml") == found.model


# --- functions -------------------------------------------------------------------------------------------------------


def test_a_spline_is_the_one_with_the_third_derivatives_of_four_points_and_straight_ends() -> None:
    """Against SciPy's cubic spline with these third derivatives, within; its tangents, beyond."""
    rng = np.random.default_rng(0)
    for n in (4, 5, 9):
        x, y = np.cumsum(rng.uniform(0.2, 0.6, n)) - 1, rng.uniform(-1, 1, n)
        thirds = [6 * np.polyfit(x[points], y[points], 3)[0] for points in (slice(0, 4), slice(-4, None))]
        spline = make_interp_spline(x, y, 3, bc_type=([(3, thirds[0])], [(3, thirds[1])]))
        found = write_spline(x, y)
        scale = np.abs(spline(np.linspace(x[0], x[-1], 99))).max()
        for at in np.linspace(x[0] - 1, x[-1] + 1, 40):
            near = np.clip(at, x[0], x[-1])
            wanted = spline(near) + spline(near, 1) * (at - near)
            assert evaluate(found, {"x": at}, FLOATS) == pytest.approx(wanted, abs=1e-9 * scale)


def test_straight_lines_go_on_beyond_their_points() -> None:
    found = write_polygon(np.array([-1.0, 0.0, 2.0]), np.array([1.0, 0.0, 4.0]))
    assert [evaluate(found, {"x": at}, FLOATS) for at in (-2.0, -0.5, 1.0, 3.0)] == [2, 0.5, 2, 6]


def test_two_turns_by_curves_of_one_coordinate_balance_their_power(tmp_path: Path) -> None:
    """The power of the forces is the rate of the kinetic energy, without gravity; OpenSim's forces are not."""
    turns = (
        axis("rotation1", "1 0 0", "q", LINE),
        *(axis(f"rotation{k}", f"0 {k - 2} {3 - k}", "q", ARC) for k in (2, 3)),
    )
    text = write_model([Link("one", "CustomJoint", coordinates=("q",), more=transform(*turns))])
    motion = Motion(read(tmp_path, text, gravity=(0.0, 0.0, 0.0)), {})
    assert motion.tapes

    def move(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        at, none = np.array([0.4 + 0.9 * t]), np.zeros(1)
        return motion.follow(at, np.array([0.9]), none, lambda z: [motion.find(name, z) for name in motion.order])

    def find_energy(t: float) -> float:
        q, qd, _ = move(t)
        return float(qd @ motion.compute("semi", q=q, qd=qd)["M"] @ qd / 2)

    q, qd, qdd = move(0.0)
    power = float(qd @ motion.compute("impl", q=q, qd=qd, qdd=qdd)["Phi"][:, 0])
    assert abs(power) > 1e-3
    assert (find_energy(1e-4) - find_energy(-1e-4)) / 2e-4 == pytest.approx(power, rel=1e-6)


def test_the_name_of_a_file_is_no_part_of_the_models(tmp_path: Path) -> None:
    assert read(tmp_path, write_model(LEG).replace('name="leg"', 'name="leg.osim"')).model.name == "leg"


# --- structure -------------------------------------------------------------------------------------------------------


def list_joints(found: Imported) -> dict[str, Joint]:
    rows = {x.name: x.joint for x in found.model.bodies if not isinstance(x.joint, Fixed)}
    joints = [(name, [row] if isinstance(row, Joint) else row) for name, row in rows.items()]
    return {joint.name or name: joint for name, row in joints for joint in row}


def show(found: Imported, *, alters: bool) -> str:
    return "\n".join(str(notice) for notice in found.notices if notice.alters == alters)


def test_both_versions_make_one_model(tmp_path: Path) -> None:
    assert read(tmp_path, write_model(LEG)).model == read(tmp_path, write_model(LEG, version=30000)).model


def test_a_locked_coordinate_is_held_and_the_command_line_has_the_last_word(tmp_path: Path) -> None:
    locked = Link(
        "tibia",
        KNEE.kind,
        "ground",
        KNEE.coordinates,
        KNEE.more,
        settings="<default_value>0.4</default_value><locked>true</locked>",
    )
    text = write_model([locked, CHAIN[0]])
    assert [*list_joints(read(tmp_path, text))] == ["q_one"]
    at = {value: read(tmp_path, text, locked=(("knee", value),)).model for value in (0.4, 0.5)}
    assert at[0.4] == read(tmp_path, text).model != at[0.5]
    assert "held at 0.4" in show(read(tmp_path, text), alters=False)


def test_coordinates_that_are_replaced_are_held_by_others(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match='"beta" is held, and is no joint here; hold the coordinates that it depends on'
    ):
        read(tmp_path, CASES["coupled"], locked=(("beta", 0.3),))


def test_coordinate_actuators_give_inputs_and_bound_them(tmp_path: Path) -> None:
    """Without any, all joints have inputs, except in a base that slides in several directions."""
    passive = {name for name, joint in list_joints(read(tmp_path, write_model(LEG))).items() if not joint.actuated}
    assert passive == {
        "tilt",
        "px",
        "py",
        "to_tibia_rotation3",
        "to_tibia_translation1",
        "to_tibia_translation2",
        "to_tibia_translation3",
    }
    text = "<coordinate>knee</coordinate><optimal_force>50</optimal_force>"
    bounds = "<min_control>-1</min_control><max_control>2</max_control>"
    forces = f'<CoordinateActuator name="motor">{text}{bounds}</CoordinateActuator>'
    found = list_joints(read(tmp_path, write_model(LEG, forces=forces)))
    assert [name for name, joint in found.items() if joint.actuated] == ["knee"]
    assert found["knee"].max_force == Number(100.0)
    off = forces.replace("<coordinate>", "<appliesForce>false</appliesForce><coordinate>")
    assert list_joints(read(tmp_path, write_model(LEG, forces=off)))["ankle"].actuated


def test_ranges_are_bounds(tmp_path: Path) -> None:
    link = Link("one", coordinates=("q_one",), settings="<range>-1.5 99999.9</range><clamped>true</clamped>")
    joint = list_joints(read(tmp_path, write_model([link])))["q_one"]
    assert (joint.lower, joint.upper) == (Number(-1.5), None)


def test_what_is_left_out_is_named_with_its_line(tmp_path: Path) -> None:
    """Muscles, contacts, unknown forces, controllers, prescribed motions: a warning each."""
    names = (
        "Schutte1993Muscle_Deprecated",
        "Millard2012AccelerationMuscle",
        "HuntCrossleyForce",
        "SpatialForce",
        "ClutchedPathSpring",
        "MyForce",
    )
    forces = "\n".join(f'<{name} name="x{k}"><points>1</points></{name}>' for k, name in enumerate(names))
    controller = '<PrescribedController name="c"><x>1</x></PrescribedController>'
    controllers = f"<ControllerSet><objects>{controller}</objects></ControllerSet>"
    link = Link("one", coordinates=("q_one",), settings="<prescribed>true</prescribed>")
    constraint = '<PointOnLineConstraint name="p"><x>1</x></PointOnLineConstraint>'
    text = write_model([link], forces=forces, constraints=constraint, more=controllers)
    warnings = show(read(tmp_path, text), alters=True)
    first = text.splitlines().index(next(line for line in text.splitlines() if "Schutte" in line)) + 1
    for k, name in enumerate(names):
        assert (
            f"leg.osim:{first + k}: OpenSimDocument/Model[leg]/ForceSet[forceset]/objects/{name}[x{k}]: warning"
            in warnings
        )
    for word in (
        "PrescribedController[c]",
        "prescribed function",
        "PointOnLineConstraint[p]",
        "<MyForce> is not known here",
    ):
        assert word in warnings


def test_constraints_and_joints_close_loops(tmp_path: Path) -> None:
    """A four-bar linkage of pins about z, closed by a joint or by a constraint of version 3 or 4."""
    flat, still = ("0 -1 0", "0 0 0"), ("0 0 0", "0 0 0")
    bars = [
        Link("a", coordinates=("qa",), outer=still, inner=still),
        Link("b", parent="a", coordinates=("qb",), outer=flat, inner=still),
        Link("c", coordinates=("qc",), outer=("1.5 0.2 0", "0 0 0"), inner=still),
    ]
    where = "<location_body_1>1 -1 0</location_body_1><location_body_2>0 -1 0</location_body_2>"
    named = (
        "<body_1>b</body_1><body_2>c</body_2>",
        "<socket_body_1>/bodyset/b</socket_body_1><socket_body_2>/bodyset/c</socket_body_2>",
    )
    models = []
    for version, ends in zip((30000, 40000), named, strict=True):
        constraint = f'<PointConstraint name="close">{ends}{where}</PointConstraint>'
        models.append(read(tmp_path, write_model(bars, version=version, constraints=constraint)).model)
    assert models[0] == models[1]
    assert [loop.cut.value for loop in models[0].loops] == ["ball"]
    offset = "<socket_parent>/bodyset/c</socket_parent><translation>0 -1 0</translation>"
    pin = (
        '<PinJoint name="close"><socket_parent_frame>start</socket_parent_frame>'
        '<socket_child_frame>end</socket_child_frame><coordinates><Coordinate name="qd"/></coordinates><frames>'
        f'<PhysicalOffsetFrame name="start">{offset.replace("/c", "/b").replace("0 -1", "1 -1")}</PhysicalOffsetFrame>'
        f'<PhysicalOffsetFrame name="end">{offset}</PhysicalOffsetFrame></frames></PinJoint>'
    )
    found = read(tmp_path, write_model(bars, joints=pin))
    assert "closes a loop" in show(found, alters=False)
    assert [loop.cut.value for loop in found.model.loops] == ["hinge"]
    assert len(assemble(build_tree(found.model)).bodies) == 3


def test_a_body_that_no_joint_connects_is_free_and_quaternions_are_possible(tmp_path: Path) -> None:
    text = write_model(CHAIN[:1]).replace(
        '<Body name="one">', '<Body name="loose"><mass>1</mass><inertia>1 1 1 0 0 0</inertia></Body><Body name="one">'
    )
    found = read(tmp_path, text, quaternions=True)
    assert "moves freely, as in OpenSim" in show(found, alters=False)
    assert [len(x.joint) for x in found.model.bodies if isinstance(x.joint, tuple)] == [6]
    (ball,) = read(tmp_path, CASES["ball"], quaternions=True).model.bodies
    assert isinstance(ball.joint, tuple)
    assert all(joint.floats for joint in ball.joint[-3:])


FAULTS: dict[str, tuple[str, str, str]] = {  # what is changed, into what, and the finding
    "no version": (' Version="40000"', "", "an <OpenSimDocument> without a version; open it in OpenSim 4"),
    "old version": ('"40000"', '"10900"', 'its version is "10900"; open it in OpenSim 4, and save it'),
    "a beta's version": ('"40000"', '"30515"', 'its version is "30515"; open it'),
    "no model": ("Model", "ModelDraft", "it holds <ModelDraft>, and no <Model>; give the file of a"),
    "mass": ("<mass>1.5", "<mass>heavy", 'mass is "heavy"; give numbers such as 0.3'),
    "inertia": ("0.02 0.03 0.025 ", "0.02 0.03 ", "inertia has 5 numbers: "),
    "second body": ('<Body name="tibia"', '<Body name="femur"', 'a second body "femur": line '),
    "no frame": (
        "<socket_parent>/bodyset/femur<",
        "<socket_parent>/bodyset/femor<",
        'there is no frame "/bodyset/femor"; did you mean',
    ),
    "no socket": ("<socket_parent_frame>outer<", "<socket_parent_frame><", "it names no frame; give the path of one"),
    "cyclic": (
        "<socket_parent>/bodyset/femur<",
        "<socket_parent>/jointset/to_tibia/inner<",
        "its frames are at offsets to each other, in a circle; begin",
    ),
    "kind": ("UniversalJoint", "EllipsoidJoint", 'a joint of the kind "EllipsoidJoint", which is not read; give'),
    "coordinates": (coordinate("subtalar"), "", "a UniversalJoint of 1 coordinates; give 2"),
    "second coordinate": ('name="subtalar"', 'name="ankle"', 'a second coordinate "ankle": line '),
    "foreign": (
        "<coordinates>adduction<",
        "<coordinates>hip<",
        '"hip" is no coordinate of this joint; name flexion, adduction',
    ),
    "axis": ("<axis>1 0 0.5<", "<axis>0 0 0<", "the axis is 0 0 0; give a direction"),
    "axis name": ('name="rotation2"', 'name="turn"', 'an axis called "turn"; call the axes rotation1'),
    "coefficients": ("-1 0.2<", "-1<", "1 coefficients; give 2: a slope for each coordinate, and the"),
    "function": (
        "PolynomialFunction",
        "PiecewiseConstantFunction",
        'a function of the kind "PiecewiseConstantFunction", which is not read; give',
    ),
    "repeated knots": ("-1.2 -0.5", "-1.2 -1.2", "x[2] = -1.2 repeats the one before it; give values of x that"),
    "falling knots": ("-1.2 -0.5", "-1.2 -1.3", "x[2] = -1.3 comes after -1.2; give values"),
    "knots and values": ("-2.1 -1.2", "-2.1", "6 values of x, and 7 of y; give as many of each"),
    "no number": ("-2.1 -1.2", "left -1.2", 'x has "left"; give numbers such as'),
    "gravity": ("<gravity>0.3 -9.8 0.2", "<gravity>0.3 -9.8", "gravity has 2 numbers: "),
    "force": ("<coordinate>ankle<", "<coordinate>ankel<", 'there is no coordinate "ankel"; did you mean "ankle"?'),
    "transition": ("<transition>20", "<transition>0", "the transition is not above 0; give the width"),
    "limits": ("<upper_limit>10", "<upper_limit>-10", "the upper limit is below the lower one; swap the limits"),
    "coupling": (
        "<dependent_coordinate_name>subtalar<",
        "<dependent_coordinate_name>nothing<",
        'there is no coordinate "nothing"; ',
    ),
    "itself": (
        "<dependent_coordinate_name>subtalar<",
        "<dependent_coordinate_name>ankle<",
        '"ankle" depends on itself; name another coordinate',
    ),
    "no function": (
        f"<coupled_coordinates_function>{LINE}",
        "<coupled_coordinates_function>",
        "a coupling of no function or no coordinates; give both, or",
    ),
    "marker": (
        "<socket_parent_frame>/bodyset/foot<",
        "<socket_parent_frame>/bodyset/hand<",
        'there is no frame "/bodyset/hand"; ',
    ),
    "range": ("<default_value>0</default_value>", "<range>2 1</range>", "a range from 2 to 1; swap them"),
    "range of one": (
        "<default_value>0</default_value>",
        "<range>2</range>",
        "a range of 1 numbers; give the lower and the upper bound",
    ),
    "no leader": (
        ">flexion</coordinates>",
        "></coordinates>",
        "no axis turns or slides in proportion to it alone; give an",
    ),
    "one body": (
        "<socket_parent>/bodyset/femur<",
        "<socket_parent>/bodyset/tibia<",
        'both of its frames are on "tibia"; name two bodies',
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_have_a_place_a_finding_and_a_remedy(fault: str, tmp_path: Path) -> None:
    old, new, wanted = FAULTS[fault]
    text = write_model(
        LEG,
        forces=limit("stop", "knee") + spring("spring", "ankle"),
        constraints=coupler("pair", "subtalar", "ankle", LINE),
        markers='<Marker name="heel"><socket_parent_frame>/bodyset/foot</socket_parent_frame></Marker>',
    )
    assert old in text
    changed = text.replace(old, new)
    if fault == "cyclic":
        changed = changed.replace("<socket_parent>/bodyset/tibia<", "<socket_parent>/jointset/to_tibia/outer<")
    with pytest.raises(InputError) as caught:
        read(tmp_path, changed)
    assert wanted in str(caught.value)
    assert "leg.osim:" in str(caught.value)


def test_all_faults_are_reported_together(tmp_path: Path) -> None:
    text = (
        write_model(LEG)
        .replace("<mass>1.5", "<mass>heavy")
        .replace("-1.2 -0.5", "-1.2 -1.2")
        .replace("UniversalJoint", "Hinge")
    )
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    for finding in ("mass is", "x[2] = -1.2 repeats", 'kind "Hinge"'):
        assert finding in str(caught.value)


def write_reference() -> None:
    """Write OpenSim's numbers for all cases."""
    with tempfile.TemporaryDirectory() as folder:
        found = {}
        for name in CASES:
            _, case, drawn = prepare(Path(folder), name)
            found[name] = ask_opensim(case.file, list_states(case, drawn))
    REFERENCE.write_text(json.dumps(found) + "\n", "utf-8")


def test_a_gcv_spline_is_the_natural_spline_through_its_points(tmp_path: Path) -> None:
    """OpenSim 4.6's values, also beyond the ends, where the degree is the half order less 1."""
    x, y = np.array([-1, -0.6, -0.1, 0.3, 0.8, 1.2, 1.5]), np.array([0.1, 0.4, -0.2, 0.3, 0.25, 0.5, 0.1])
    places = (-1.3, -0.8, 0.55, 1.4, 1.7)
    wanted = {
        2: (-0.32768430864100606, 0.3513421543205034, 0.3074935406329096, 0.28000245601098034, -0.2716721926913715),
        3: (-1.3379066527934738, 0.46873090581620785, 0.3217608954688668, 0.33575615176662577, -0.691704600760586),
    }
    for order, values in wanted.items():
        curve = write_natural(x, y, order)
        found = [evaluate(curve, {"x": place}, FLOATS) for place in places]
        np.testing.assert_allclose(found, values, rtol=1e-12)
    simm = "<SimmSpline>"
    numbers = "<half_order>2</half_order><error_variance>0</error_variance>"
    text = write_model(LEG)
    assert simm in text
    text = text.replace(simm, f"<GCVSpline>{numbers}").replace("</SimmSpline>", "</GCVSpline>")
    import_model(save(tmp_path, text))
    for old, new, finding in (
        ("<half_order>2", "<half_order>7", "half_order is 7; give 1, 2, 3 or 4"),
        ("<error_variance>0", "<error_variance>0.1", "error_variance is 0.1; give 0: a curve through the points"),
        ("<half_order>2", "<half_order>4", "points; give 8 at least"),
    ):
        with pytest.raises(InputError, match=re.escape(finding)):
            import_model(save(tmp_path, text.replace(old, new)))


if __name__ == "__main__":
    write_reference()
