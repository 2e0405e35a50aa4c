"""Bad loops, constraints and joints beside them: each is refused with its place, the finding and a remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbsgen.errors import InputError
from mbsgen.model.construction import body, constraint, end, loop, make_model, revolute, rod
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from tests.mbsgen.model.files import LINKAGE, find_faults


def test_the_good_linkage_is_good(tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    file.write_text(LINKAGE, encoding="utf-8")
    assert [loop.name for loop in read_model(file).loops] == ["knee", "strut"]


# Replacements in LINKAGE; line, path and a piece of the finding of the one fault that follows.
STRUT = "  - {name: strut, type: rod, from: {body: rocker, position: [0, 0, 0.2]}, to: {body: slider}, length: 0.4}\n"
CAM = "q4 - a*sin(q1)"
MANY = "".join(STRUT.replace("strut", f"s{i}").replace("0.4}", f"{i + 1}}}") for i in range(1000))
BAD: dict[str, tuple[str, str, int, str, str]] = {
    # shape
    "no type": ("    type: hinge\n", "", 27, "loops[0].type", "missing"),
    "an unknown type": ("type: hinge", "type: hing", 28, "loops[0].type", 'found "hing"'),
    "a type that is no word": ("type: hinge", "type: 5", 28, "loops[0].type", "found 5"),
    "a screw without a pitch": ("type: hinge", "type: helical", 27, "loops[0].pitch", "without a pitch"),
    "a pitch that vanishes": ("type: hinge", "type: helical\n    pitch: 0*a", 29, "loops[0].pitch", "a pitch of 0"),
    "a pitch of a hinge": ("type: hinge", "type: hinge\n    pitch: 0.1", 29, "loops[0].pitch", "a pitch of a loop"),
    "a floating loop": ("type: hinge", "type: floating", 28, "loops[0].type", 'no loop is closed by "floating"'),
    "a free loop": ("type: hinge", "type: free", 28, "loops[0].type", 'no loop is closed by "free"'),
    "a Cardan loop": ("type: hinge", "type: cardan", 28, "loops[0].type", 'no loop is closed by "cardan"'),
    "an unknown key": ("    axis: y\n", "    axes: y\n", 31, "loops[0].axes", "unknown key"),
    "a loop with a coordinate": (
        "    axis: y\n",
        "    axis: y\n    limits: [0, 1]\n",
        32,
        "loops[0].limits",
        "unknown",
    ),
    "one end": ("    from: {body: coupler, position: [0.4, 0, 0]}\n", "", 27, "loops[0].from", "missing"),
    "an end that is a name": ("to: {body: slider}", "to: slider", 32, "loops[1].to", 'found "slider"'),
    "an end without a body": ("from: {body: coupler, ", "from: {", 29, "loops[0].from.body", "missing"),
    "an unknown key of an end": ("{body: slider}", "{body: slider, axis: x}", 32, "loops[1].to.axis", "unknown key"),
    "no equation": (f", equation: {CAM}", "", 34, "constraints[0].equation", "missing"),
    "two sides": (CAM, "q4 = q1", 34, "constraints[0].equation", "has no meaning"),
    "driven by a word": ("driven: [q1]", "driven: q1", 35, "driven", 'found "q1"'),
    "a rough coordinate of a word": ("q2: 0.1", "q2: low", 37, "assembly.q2", 'unknown name "low"'),
    # names
    "two loops of a name": ("name: strut", "name: knee", 32, "loops[1].name", 'name "knee" is taken'),
    "a loop named as a constraint": ("name: cam", "name: Knee", 34, "constraints[0].name", 'hard to tell from "knee"'),
    "an empty name": ("name: strut", "name: ''", 32, "loops[1].name", "an empty name"),
    "a path for a name": ("name: strut", "name: ../../etc/passwd", 32, "loops[1].name", "looks like a path"),
    "a hidden character": ("name: cam", 'name: "c\\u202Eam"', 34, "constraints[0].name", "control character U+202E"),
    "a long name": ("name: cam", f"name: {'c' * 65}", 34, "constraints[0].name", "a name of 65 characters"),
    # bodies
    "a missing body": ("body: coupler", "body: copler", 29, "loops[0].from.body", 'there is no body "copler"'),
    "a body between joints": ("{body: slider}", "{body: ball.rx}", 32, "loops[1].to.body", "there is no body"),
    "a body and itself": ("to: {body: slider}", "to: {body: rocker}", 32, "loops[1].to.body", '"rocker" and itself'),
    "the base and itself": (
        STRUT,
        "  - {name: strut, type: ball, from: {body: base, position: [1, 0, 0]}, to: {body: base}}\n",
        32,
        "loops[1].to.body",
        '"base" and itself',
    ),
    "bodies that are fixed together": (
        "from: {body: rocker, position: [0, 0, 0.2]}, to",
        "from: {body: bolt}, to",
        32,
        "loops[1].to.body",
        '"bolt" and "slider" are fixed to each other',
    ),
    "a body that is fixed to the base": (
        STRUT,
        "  - {name: strut, type: ball, from: {body: post}, to: {body: base}}\n",
        32,
        "loops[1].to.body",
        '"post" and "base" are fixed to each other',
    ),
    # geometry
    "a rod without a length": (", length: 0.4", "", 32, "loops[1].length", "a rod without a length"),
    "a rod of no length": ("length: 0.4", "length: a - 0.2", 32, "loops[1].length", "a length of 0"),
    "a rod of a negative length": ("length: 0.4", "length: -0.4", 32, "loops[1].length", "a length of -0.4"),
    "a rod of a tiny length": ("length: 0.4", "length: 1e-200", 32, "loops[1].length", "a length of 1e-200"),
    "a length of a hinge": (
        "    axis: y\n",
        "    axis: y\n    length: 1\n",
        32,
        "loops[0].length",
        "a length of a loop",
    ),
    "an axis of a rod": ("length: 0.4", "length: 0.4, axis: y", 32, "loops[1].axis", "an axis of a loop of type rod"),
    "a second axis of a hinge": ("    axis: y\n", "    axis: y\n    axis2: z\n", 32, "loops[0].axis2", "a second axis"),
    "no direction": ("    axis: y\n", "    axis: [0, 0, 0]\n", 31, "loops[0].axis", "[0, 0, 0] has no direction"),
    "no direction by parameters": ("    axis: y\n", "    axis: [0, a - 0.2, 0]\n", 31, "loops[0].axis", "no direction"),
    "an axis at run time": ("    axis: y\n", "    axis: [0, m, 0]\n", 31, "loops[0].axis", "may change at run time"),
    "parallel axes": ("type: hinge", "type: universal\n    axis2: -y", 29, "loops[0].axis2", "parallel"),
    "a second axis without direction": (
        "type: hinge",
        "type: universal\n    axis2: [0, 0, 0]",
        29,
        "loops[0].axis2",
        "no direction",
    ),
    "a place by an unknown name": (
        "[0.4, 0, 0]}\n    to",
        "[b, 0, 0]}\n    to",
        29,
        "loops[0].from.position[0]",
        '"b"',
    ),
    "a turn without a value": ("angle: 0.3", "angle: 1/0", 30, "loops[0].to.orientation[0].angle", "has no value"),
    "a loop that is given twice": (STRUT, STRUT + STRUT.replace("strut", "twin"), 33, "loops[2]", "as loops[1]"),
    "too many loops": (STRUT, MANY, 26, "loops", "1002 loops and constraints"),
    # constraints
    "an equation of an unknown joint": (CAM, "q5 - q1", 34, "constraints[0].equation", 'nor a parameter "q5"'),
    "an equation without a joint": (CAM, "a - 0.3", 34, "constraints[0].equation", "no joint, and -0.1 remains"),
    "an equation that is a number": (CAM, "5", 34, "constraints[0].equation", "no joint, and 5 remains"),
    "an equation that holds without a joint": (CAM, "0", 34, "constraints[0].equation", "depends on no joint"),
    "an equation of run-time parameters": (CAM, "m - a", 34, "constraints[0].equation", "depends on no joint"),
    "an equation whose joints cancel": (CAM, "q4 + a - q4", 34, "constraints[0].equation", "cancel, and 0.2 remains"),
    "an equation without a value": (CAM, "q4 + log(a - 0.2)", 34, "constraints[0].equation", "has no value"),
    "an equation that divides by 0": (CAM, "1/(q4 - q4)", 34, "constraints[0].equation", "has no value"),
    "an equation of a great power": (CAM, "q4**17", 34, "constraints[0].equation", 'exponent "17"'),
    "an equation of code": (CAM, "__import__('os').abort()", 34, "constraints[0].equation", "has no meaning"),
    "an equation of roots of roots": (CAM, "sqrt(2*sqrt(q4 + 2))", 34, "constraints[0].equation", "neither whole nor"),
    "an equation of velocities": (CAM, "qd - q1", 34, "constraints[0].equation", 'nor a parameter "qd"'),
    "an equation that is given twice": (
        "constraints:\n",
        f"constraints:\n  - {{name: c, equation: {CAM}}}\n",
        35,
        "constraints[1].equation",
        "the same",
    ),
    "a name of a joint and a parameter": (
        "  a: 0.2",
        "  a: 0.2\n  q4: 1",
        35,
        "constraints[0].equation",
        '"q4" is the name',
    ),
    # joints
    "a driven joint that is unknown": ("driven: [q1]", "driven: [crank]", 35, "driven[0]", 'there is no joint "crank"'),
    "a driven joint with an input": (
        "driven: [q1]",
        "driven: [q4]",
        35,
        "driven[0]",
        '"q4" is driven, and has an input',
    ),
    "a driven joint, twice": ("driven: [q1]", "driven: [q1, q1]", 35, "driven[1]", '"q1" is named twice'),
    "a driven quaternion": ("driven: [q1]", "driven: [ball.rx]", 35, "driven[0]", "part of a joint with a quaternion"),
    "a driven body": ("driven: [q1]", "driven: [ball]", 35, "driven[0]", 'there is no joint "ball"'),
    "an independent joint that is unknown": ("independent: [q1]", "independent: [q]", 36, "independent[0]", '"q"'),
    "an independent joint, twice": ("independent: [q1]", "independent: [q1, q1]", 36, "independent[1]", "named twice"),
    "a rough coordinate of an unknown joint": ("q2: 0.1", "knee: 0.1", 37, "assembly.knee", 'there is no joint "knee"'),
    "a rough coordinate without a value": ("q2: 0.1", "q2: 1e200", 37, "assembly.q2", "1e+200"),
}


@pytest.mark.parametrize(("old", "new", "line", "path", "finding"), BAD.values(), ids=BAD.keys())
def test_a_fault_is_told_with_its_place(old: str, new: str, line: int, path: str, finding: str, tmp_path: Path) -> None:
    assert LINKAGE.count(old) >= 1
    told = find_faults(LINKAGE.replace(old, new, 1), tmp_path)
    assert [(fault.file, fault.line, fault.path) for fault in told] == [(str(tmp_path / "model.yaml"), line, path)]
    assert finding in told[0].finding
    assert told[0].remedy


FOLLOWER = LINKAGE.replace(
    "{name: q3, type: revolute, axis: y, position: [0.4, 0, 0], actuated: false}",
    "{name: q3, type: revolute, axis: y, position: [0.4, 0, 0], follows: {joint: q2}}",
)


@pytest.mark.parametrize(
    ("old", "new", "path"),
    [
        ("driven: [q1]", "driven: [q3]", "driven[0]"),
        ("independent: [q1]", "independent: [q3]", "independent[0]"),
        ("q2: 0.1", "q3: 0.1", "assembly.q3"),
    ],
)
def test_a_joint_that_follows_has_no_coordinate(old: str, new: str, path: str, tmp_path: Path) -> None:
    (fault,) = find_faults(FOLLOWER.replace(old, new), tmp_path)
    assert (fault.path, fault.finding) == (path, 'joint "q3" has no coordinate: it follows "q2"')
    assert fault.remedy == 'name "q2"'


def test_parts_of_a_quaternion_are_suggested_where_they_are_taken(tmp_path: Path) -> None:
    (fault,) = find_faults(LINKAGE.replace("driven: [q1]", "driven: [ball]"), tmp_path)
    assert fault.remedy == "a quaternion turns this body, and its parts cannot be named: name another joint"
    (fault,) = find_faults(LINKAGE.replace("q2: 0.1", "ball: 0.1"), tmp_path)
    assert fault.remedy == "the joints of this body are ball.rx, ball.ry, ball.rz: name one of them"


def test_joints_beside_no_loop_have_nothing_to_determine(tmp_path: Path) -> None:
    start = LINKAGE.index("loops:")
    text = LINKAGE[:start] + "independent: [q1]\nassembly: {q2: 0.1}\n"
    assert [fault.path for fault in find_faults(text, tmp_path)] == ["independent", "assembly"]


def test_all_faults_of_loops_come_at_once(tmp_path: Path) -> None:
    """Faults of shape, of names, of bodies, of numbers and of joints; not what follows from one."""
    text = (
        LINKAGE.replace("name: strut", "name: knee")
        .replace("body: coupler", "body: copler")
        .replace("axis: y\n  - {name: knee", "axis: [0, m, 0]\n  - {name: knee")
        .replace("length: 0.4", "lenght: 0.4")
        .replace(CAM, "q4 - b*sin(q9)")
        .replace("driven: [q1]", "driven: [q4, q2, q2]")
        .replace("q2: 0.1", "q2: '2 +'")
    )
    assert [(fault.line, fault.path) for fault in find_faults(text, tmp_path)] == [
        (29, "loops[0].from.body"),
        (31, "loops[0].axis"),
        (32, "loops[1].lenght"),
        (32, "loops[1].length"),
        (32, "loops[1].name"),
        (34, "constraints[0].equation"),
        (34, "constraints[0].equation"),
        (35, "driven[0]"),
        (35, "driven[2]"),
        (37, "assembly.q2"),
    ]


def test_a_loop_does_not_replace_mass(tmp_path: Path) -> None:
    """A massless body that loops hold is refused: M of the joints must be positive definite."""
    text = LINKAGE.replace("    mass: 1\n    com: [0, 0, 0.1]\n", "")
    (fault,) = find_faults(text, tmp_path)
    assert (fault.path, fault.finding.split(":")[0]) == ("bodies[2].joint", 'joint "q3" moves nothing')
    assert "loops do not replace it" in fault.remedy


def make(**parts: object) -> Model:
    arm = body("arm", revolute("y", actuated=False), mass=1, com=(0, 0, 1))
    return make_model("m", [arm], gravity=(0, 0, 0), **parts)  # type: ignore[arg-type]


def test_models_made_in_python_are_checked_too() -> None:
    with pytest.raises(ValueError, match="give universal, with axis and axis2"):
        loop("joint", "cardan", end("arm"), end("base"))
    with pytest.raises(InputError, match=r"loops\[0\].pitch: a helical joint without a pitch"):
        make(loops=[loop("screw", "helical", end("arm"), end("base"))])
    with pytest.raises(InputError, match=r"loops\[0\].to.body: a loop between \"arm\" and itself"):
        make(loops=[rod("r", end("arm"), end("arm"), 1)])
    with pytest.raises(InputError, match=r"loops\[0\].length: a rod without a length"):
        make(loops=[rod("r", end("arm"), end("base"), 0)])
    with pytest.raises(InputError, match="an empty name"):
        make(constraints=[constraint("", "arm - 2")])


# Equations in place of the cam's; path and finding of the one fault that follows.
CONTRADICTIONS: dict[str, tuple[list[str], str, str]] = {
    "two places of a joint": (["q4 - 0.1", "q4 - 0.3"], "constraints[1].equation", "0.2 is left"),
    "two offsets": (["q2 + 2*q3 - a", "q2/2 + q3"], "constraints[1].equation", "is left"),
    "a circle of ratios": (["q2 - q3", "q3 - q4 - 1", "q4 - q2"], "constraints[2].equation", "1 is left"),
    "only driven joints": (["q1 - a"], "constraints[0].equation", "all joints in this equation are"),
    "a joint that follows a driven one": (
        ["a*sin(q5)"],
        "constraints[0].equation",
        "all joints in this equation are driven",
    ),
}


@pytest.mark.parametrize(("equations", "path", "finding"), CONTRADICTIONS.values(), ids=CONTRADICTIONS.keys())
def test_contradictions_are_found(equations: list[str], path: str, finding: str, tmp_path: Path) -> None:
    listed = "".join(f"  - {{name: c{i}, equation: {text}}}\n" for i, text in enumerate(equations))
    follower = "{name: q5, type: revolute, axis: x, follows: {joint: q1}}"
    text = LINKAGE.replace(f"  - {{name: cam, equation: {CAM}}}\n", listed)
    text = text.replace("{type: fixed, position: [1, 0, 0]}", follower).replace("mass: 1}", "mass: 1, com: [0, 1, 0]}")
    told = find_faults(text, tmp_path)
    assert [fault.path for fault in told] == [path]
    assert finding in told[0].finding


def test_constraints_that_let_nothing_move_are_found(tmp_path: Path) -> None:
    text = LINKAGE[: LINKAGE.index("loops:")].replace(
        "  - {name: ball, parent: slider, joint: {type: ball}, mass: 1, inertia: [1, 1, 1]}\n", ""
    )
    equations = ("q1 - q2", "q1 + q2 - q3", "q4 - 1", "q1 - 0.5")
    text += "constraints:\n" + "".join(f"  - {{name: c{i}, equation: {x}}}\n" for i, x in enumerate(equations))
    assert [(x.path, x.finding) for x in find_faults(text, tmp_path)] == [
        ("constraints", "no joint is left that moves")
    ]


def test_limits_of_a_joint_that_a_constraint_makes_a_follower_bind_its_leader(tmp_path: Path) -> None:
    text = LINKAGE.replace(CAM, "q3 - q2 - 2").replace("position: [0, 0, a]", "position: [0, 0, a], limits: [-1, 1]")
    text = text.replace("position: [0.4, 0, 0], act", "position: [0.4, 0, 0], limits: [-0.5, 0.5], act")
    (fault,) = find_faults(text, tmp_path)
    assert fault.finding == "the limits of its followers leave the joint no range"


def test_parts_that_are_alike_by_their_faults_are_no_twins(tmp_path: Path) -> None:
    """Equations that cannot be read are replaced by one example while the rest is examined."""
    text = LINKAGE.replace(CAM, "q4 +").replace("driven", "  - {name: c, equation: '2 -'}\ndriven")
    assert [x.path for x in find_faults(text, tmp_path)] == ["constraints[0].equation", "constraints[1].equation"]
