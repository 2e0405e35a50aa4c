"""Bad model files: each is refused with the place, the finding and a remedy, and nothing beside."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbsgen.documents.places import MAX_FAULTS
from mbsgen.documents.reading import MAX_BYTES
from mbsgen.model.reader import read_model
from tests.mbsgen.model.files import GOOD, WALKER, find_faults

HOOK = GOOD[GOOD.index("  - name: hook") : GOOD.index("frames:")]


def test_the_good_model_is_good(tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    file.write_text(GOOD, encoding="utf-8")
    assert [body.name for body in read_model(file).bodies] == ["cart", "boom", "hook"]


# Replacements in GOOD; line, path and a piece of the finding of the one fault that follows.
BAD: dict[str, tuple[str, str, int, str, str]] = {
    # shape
    "unknown key": ("gravity:", "gravety:", 2, "gravety", "unknown key"),
    "unknown key of a joint": ("actuated: false", "actuatd: false", 18, "bodies[1].joint.actuatd", "unknown key"),
    "unknown key of an inertia": ("xy: 0.05", "yx: 0.05", 21, "bodies[1].inertia.yx", "unknown key"),
    "repeated key": ("    mass: 10", "    mass: 10\n    mass: 11", 11, "bodies[0].mass", "key repeated"),
    "no type": ("type: prismatic, ", "", 9, "bodies[0].joint.type", "missing"),
    "no axis": ("axis: -y, ", "", 24, "bodies[2].joint.axis", "missing"),
    "no joint": (
        "    joint: {name: q1, type: prismatic, axis: x, limits: [-1, 1]}\n",
        "",
        8,
        "bodies[0].joint",
        "missing",
    ),
    "unknown type": ("type: prismatic", "type: sliding", 9, "bodies[0].joint.type", '"sliding"'),
    "unknown kind": ("kind: runtime", "kind: variable", 6, "parameters.m.kind", '"variable"'),
    "unknown axis": ("axis: -y", "axis: w", 24, "bodies[2].joint.axis", '"w"'),
    "an axis of two": ("axis: -y", "axis: [0, 1]", 24, "bodies[2].joint.axis", "[0, 1]"),
    "an axis of a rotation": ("{axis: z, angle", "{axis: -z, angle", 17, "bodies[1].joint.orientation[0].axis", '"-z"'),
    "a short vector": ("com: [l/2, 0, 0]", "com: [l/2, 0]", 20, "bodies[1].com", "list of 2"),
    "a long vector": ("com: [l/2, 0, 0]", "com: [l/2, 0, 0, 0]", 20, "bodies[1].com", "list of 4"),
    "a half inertia": ("yy: 1, ", "", 21, "bodies[1].inertia.yy", "missing"),
    "one limit": ("limits: [-1, 1]", "limits: [1]", 9, "bodies[0].joint.limits", "list of 1"),
    "an infinite limit": ("limits: [-1, 1]", "limits: [-1, .inf]", 9, "bodies[0].joint.limits[1]", "found inf"),
    "a name that is a number": ("name: crane", "name: 5", 1, "name", "found 5"),
    "a truth for a number": ("mass: 10", "mass: true", 10, "bodies[0].mass", "found true"),
    "a list for a number": ("mass: 10", "mass: [10]", 10, "bodies[0].mass", "found [10]"),
    "a word for a truth": ("actuated: false", "actuated: no", 18, "bodies[1].joint.actuated", 'found "no"'),
    # numbers and expressions
    "a mass of nan": ("mass: 10", "mass: .nan", 10, "bodies[0].mass", "found nan"),
    "an infinite mass": ("mass: 10", "mass: .inf", 10, "bodies[0].mass", "found inf"),
    "a mass beyond doubles": ("mass: 10", "mass: 1e999", 10, "bodies[0].mass", "beyond the largest double"),
    "a huge mass": ("mass: 10", "mass: 1e200", 10, "bodies[0].mass", "a value of 1e+200"),
    "a tiny mass": ("mass: 10", "mass: 1e-200", 10, "bodies[0].mass", "a mass of 1e-200"),
    "a negative mass": ("mass: 10", "mass: -10", 10, "bodies[0].mass", "a mass of -10"),
    "a mass negative by a parameter": ("mass: 10", "mass: l - 3", 10, "bodies[0].mass", "a mass of -1"),
    "an overflowing product": ("mass: 10", "mass: 1e100*1e100*l", 10, "bodies[0].mass", "2e+200"),
    "a division by 0": ("mass: 10", "mass: 1/(l - 2)", 10, "bodies[0].mass", "has no value"),
    "a root of -1": ("mass: 10", "mass: sqrt(-1)", 10, "bodies[0].mass", "has no value"),
    "an unknown name": ("[0, 0, l/2]", "[0, 0, L/2]", 16, "bodies[1].joint.position[2]", 'unknown name "L"'),
    "an unknown function": (
        "angle: pi/2",
        "angle: sec(1)",
        17,
        "bodies[1].joint.orientation[0].angle",
        "unknown function",
    ),
    "code": ("mass: 10", "mass: __import__('os').abort()", 10, "bodies[0].mass", "has no meaning"),
    "code that is called": ("mass: 10", "mass: exit(0)", 10, "bodies[0].mass", 'unknown function "exit"'),
    "code in a comprehension": ("mass: 10", "mass: '[x for x in ()]'", 10, "bodies[0].mass", "has no meaning"),
    "a great power": ("mass: 10", "mass: 9**9**9", 10, "bodies[0].mass", "exponent"),
    "a tower of powers": ("mass: 10", "mass: (((0.1**16)**16)**16)**16", 10, "bodies[0].mass", "degree"),
    "a tower of exponentials": ("mass: 10", "mass: exp(exp(exp(9)))", 10, "bodies[0].mass", "has no value"),
    "a long expression": ("mass: 10", f"mass: {'1+' * 6000}1", 10, "bodies[0].mass", "12001 characters"),
    "many terms": ("mass: 10", f"mass: {'1+' * 2000}1", 10, "bodies[0].mass", "4001 terms"),
    "a deep expression": ("mass: 10", f"mass: {'sin(' * 45}1{')' * 45}", 10, "bodies[0].mass", "nested deeper"),
    "no form at run time": ("mass: m", "mass: sqrt(2*sqrt(m))", 19, "bodies[1].mass", "neither whole nor"),
    # parameters
    "a later parameter": ("  g: 9.81", "  g: 5*l", 4, "parameters.g", "used before it is given"),
    "a parameter of itself": ("  g: 9.81", "  g: 2*g", 4, "parameters.g", "used before it is given"),
    "a frozen run-time value": (
        "runtime}",
        "runtime}\n  k: {value: 2*m, kind: runtime}",
        7,
        "parameters.k",
        "the value of an input depends on",
    ),
    "an endless chain of parameters": (
        "runtime}",
        "runtime}\n  k0: m + m\n" + "".join(f"  k{i}: k{i - 1} + k{i - 1}\n" for i in range(1, 15)),
        18,
        "parameters.k11",
        "8191 terms",
    ),
    "a limit at run time": (
        "limits: [-1, 1]",
        "limits: [-1, m]",
        9,
        "bodies[0].joint.limits[1]",
        "may change at run time",
    ),
    "an axis at run time": ("0.6, 0.8]", "0.6, m]", 15, "bodies[1].joint.axis", "may change at run time"),
    "a parameter without a name": ("  g: 9.81", '  g: 9.81\n  "": 1', 5, 'parameters[""]', "cannot use the name"),
    "a parameter with a blank": ("  g: 9.81", "  g: 9.81\n  a b: 1", 5, 'parameters["a b"]', "cannot use the name"),
    "a parameter called sin": ("  g: 9.81", "  g: 9.81\n  sin: 1", 5, "parameters.sin", "their own meaning"),
    "a parameter called pi": ("  g: 9.81", "  g: 9.81\n  pi: 3", 5, "parameters.pi", "their own meaning"),
    "a parameter called lambda": ("  g: 9.81", "  g: 9.81\n  lambda: 1", 5, "parameters.lambda", "their own meaning"),
    # names
    "an empty name": ("name: crane", "name: ''", 1, "name", "an empty name"),
    "a blank name": ("name: hook", "name: '  '", 22, "bodies[2].name", "an empty name"),
    "a long name": ("name: hook", f"name: {'h' * 65}", 22, "bodies[2].name", "a name of 65 characters"),
    "a path": ("name: crane", "name: ../../etc/crane", 1, "name", "looks like a path"),
    "a path of Windows": ("name: crane", "name: C:\\crane", 1, "name", "looks like a path"),
    "a hidden file": ("name: hook", "name: .hook", 22, "bodies[2].name", "looks like a path"),
    "a home": ("name: crane", "name: ~root", 1, "name", "looks like a path"),
    "a control character": ("name: crane", 'name: "cra\\ane"', 1, "name", "control character U+0007"),
    "a line break": ("name: crane", 'name: "cra\\nne"', 1, "name", "hidden character U+000A"),
    "an invisible character": ("name: hook", 'name: "ho\\u200Bok"', 22, "bodies[2].name", "hidden character U+200B"),
    "blanks around a name": ("name: crane", "name: ' crane'", 1, "name", "blanks at its ends"),
    "two bodies of a name": ("name: hook", "name: boom", 22, "bodies[2].name", 'name "boom" is taken'),
    "bodies alike in case": ("name: hook", "name: Boom", 22, "bodies[2].name", 'hard to tell from "boom"'),
    "bodies alike in form": ("name: hook", "name: ｂoom", 22, "bodies[2].name", 'hard to tell from "boom"'),
    "two joints of a name": (
        "{type: revolute, axis: -y",
        "{name: q1, type: revolute, axis: -y",
        24,
        "bodies[2].joint.name",
        "is taken",
    ),
    "two frames of a name": (
        "frames:",
        "frames:\n  - {name: tip, body: hook}",
        30,
        "frames[1].name",
        'name "tip" is taken',
    ),
    "a body called base": ("name: hook", "name: Base", 22, "bodies[2].name", "the fixed base"),
    # the tree
    "a missing parent": ("parent: boom", "parent: bom", 23, "bodies[2].parent", 'there is no body "bom"'),
    "a missing carrier": ("body: boom", "body: boon", 29, "frames[0].body", 'there is no body "boon"'),
    "its own parent": ("parent: boom", "parent: hook", 23, "bodies[2].parent", '"hook" -> "hook"'),
    "a loop of parents": ("parent: cart", "parent: hook", 12, "bodies[1].parent", '"boom" -> "hook" -> "boom"'),
    "no bodies": (GOOD[GOOD.index("bodies:") :], "bodies: []", 7, "bodies", "0 bodies"),
    "too many bodies": (
        HOOK,
        "".join(HOOK.replace("name: hook", f"name: h{i}") for i in range(1000)),
        7,
        "bodies",
        "1002 bodies",
    ),
    # mechanics
    "no direction": ("[0, 0.6, 0.8]", "[0, 0, 0]", 15, "bodies[1].joint.axis", "[0, 0, 0] has no direction"),
    "no direction by parameters": (
        "[0, 0.6, 0.8]",
        "[0, l - 2, 0]",
        15,
        "bodies[1].joint.axis",
        "[0, l - 2, 0] has no direction",
    ),
    "limits out of order": (
        "limits: [-1, 1]",
        "limits: [1, -1]",
        9,
        "bodies[0].joint.limits",
        "lower limit 1 is above",
    ),
    "a negative moment": ("[1e-3, 1e-3, 1e-3]", "[-1e-3, 1e-3, 1e-3]", 27, "bodies[2].inertia", "principal moments"),
    "no triangle": ("[1e-3, 1e-3, 1e-3]", "[1e-3, 1e-3, 2.1e-3]", 27, "bodies[2].inertia", "principal moments"),
    "no triangle off the diagonal": ("xy: 0.05", "xy: 0.4", 21, "bodies[1].inertia", "principal moments"),
    "an inertia without a mass": ("    mass: 0.5\n", "", 26, "bodies[2].inertia", "without a mass"),
    "a leaf without a mass": (
        HOOK,
        "  - {name: hook, parent: boom, joint: {type: revolute, axis: y}}\n",
        22,
        "bodies[2].joint",
        'joint "hook" moves nothing',
    ),
    "two joints on one line": (
        HOOK,
        "  - {name: h, parent: boom, joint: {type: revolute, axis: x}}\n"
        "  - {name: k, parent: h, joint: {type: revolute, axis: -x, position: [2, 0, 0]}, mass: 1, com: [0, 1, 0]}\n",
        22,
        "bodies[2].joint",
        'joint "h" moves nothing that "k" cannot undo',
    ),
    "a slide without a mass": (
        HOOK,
        "  - {name: hook, parent: boom, joint: {name: q3, type: prismatic, axis: y}}\n",
        22,
        "bodies[2].joint",
        'joint "q3" moves nothing',
    ),
    "a point on its axis": (
        HOOK,
        "  - {name: p, joint: {type: revolute, axis: [1, 2, 2], position: [9, l, 0]}, mass: 1, com: [2, 4, 4]}\n",
        22,
        "bodies[2].joint",
        'joint "p" moves nothing',
    ),
    "a rod on its axis": (
        HOOK,
        "  - {name: p, joint: {type: revolute, axis: y}, mass: 1, com: [0, 1, 0], inertia: [1, 0, 1]}\n",
        22,
        "bodies[2].joint",
        "no inertia about its axis",
    ),
}


@pytest.mark.parametrize(("old", "new", "line", "path", "finding"), BAD.values(), ids=BAD.keys())
def test_a_fault_is_told_with_its_place(old: str, new: str, line: int, path: str, finding: str, tmp_path: Path) -> None:
    assert GOOD.count(old) >= 1
    told = find_faults(GOOD.replace(old, new, 1), tmp_path)
    told = tuple(fault for fault in told if (fault.path, fault.finding) != ("gravity", "missing"))  # of "gravety"
    assert [(fault.file, fault.line, fault.path) for fault in told] == [(str(tmp_path / "model.yaml"), line, path)]
    assert finding in told[0].finding
    assert told[0].remedy


def test_a_mistyped_word_is_guessed(tmp_path: Path) -> None:
    text = (
        GOOD.replace("parent: boom", "parent: Bom").replace("mass: 10", "mas: 10").replace("inertia: [", "inertai: [")
    )
    assert [fault.remedy for fault in find_faults(text, tmp_path)] == [
        "did you mean `mass`?",
        'did you mean "boom"?',
        "did you mean `inertia`?",
    ]


def test_all_faults_of_a_file_come_at_once(tmp_path: Path) -> None:
    """Faults of YAML, of shape, of names, of the tree, of numbers and of mechanics; not what follows from one."""
    text = (
        GOOD.replace("name: crane", "name: a/b")
        .replace("  g: 9.81", "  g: &g 9.81")
        .replace("  l: 2", "  l: 2 +")
        .replace("type: prismatic", "type: sliding")
        .replace("[-1, 1]", "[1, -1]")
        .replace("mass: 10", "mass: -10")
        .replace("parent: cart", "parent: hook")
        .replace("[0, 0.6, 0.8]", "[0, 0, 0]")
        .replace("actuated: false", "actuated: false\n      colour: red")
        .replace("xy: 0.05", "xy: 5")
        .replace("mass: 0.5", "mass: x")
        .replace("body: boom", "body: bom")
    )
    assert [(fault.line, fault.path) for fault in find_faults(text, tmp_path)] == [
        (1, "name"),
        (4, "parameters.g"),
        (5, "parameters.l"),
        (9, "bodies[0].joint.limits"),
        (9, "bodies[0].joint.type"),
        (10, "bodies[0].mass"),
        (12, "bodies[1].parent"),
        (15, "bodies[1].joint.axis"),
        (19, "bodies[1].joint.colour"),
        (22, "bodies[1].inertia"),
        (26, "bodies[2].mass"),
        (30, "frames[0].body"),
    ]


def test_a_body_called_base_is_one_fault(tmp_path: Path) -> None:
    """Bodies without a parent stand on the fixed base, not on this body."""
    joint = "joint: {type: revolute, axis: y}, mass: 1, com: [1, 0, 0]"
    text = f"name: m\ngravity: [0, 0, -9.81]\nbodies:\n  - {{name: base, {joint}}}\n  - {{name: arm, {joint}}}\n"
    assert [fault.path for fault in find_faults(text, tmp_path)] == ["bodies[0].name"]


def test_a_key_that_stands_twice_does_not_hide_that_its_value_is_missing(tmp_path: Path) -> None:
    """Joints of a number without a value are not judged."""
    text = GOOD.replace("    mass: 10", "    mass: boom\n    mass: 10")
    assert [(fault.path, "repeated" in fault.finding) for fault in find_faults(text, tmp_path)] == [
        ("bodies[0].mass", True)
    ]


def test_undetermined_joints_are_looked_for_once_all_else_is_right(tmp_path: Path) -> None:
    """Every joint of a limb without mass is named."""
    limb = "".join(
        f"  - {{name: x{i}, parent: {p}, joint: {{type: revolute, axis: y}}}}\n" for i, p in enumerate(["boom", "x0"])
    )
    text = GOOD.replace(HOOK, HOOK + limb)
    assert [fault.path for fault in find_faults(text, tmp_path)] == ["bodies[3].joint", "bodies[4].joint"]
    assert [fault.path for fault in find_faults(text.replace("mass: 10", "mass: -1"), tmp_path)] == ["bodies[0].mass"]


GOOD_ALL_THE_SAME = {
    "an inertia at the edge of the triangle": ("[1e-3, 1e-3, 1e-3]", "[1e-3, 1e-3, 2.000000001e-3]"),
    "an inertia that no body has, if wished": ("[1e-3, 1e-3, 1e-3]", "[1e-3, 1e-3, 5e-3]\nallow_unphysical: true"),
    "a run-time mass that is 0 now": ("value: 3", "value: 0"),
    "the lightest mass": ("mass: 0.5", "mass: 1e-150"),
    "the heaviest mass": ("mass: 0.5", "mass: 1e150"),
    "a keyword of C for a name": ("name: hook", "name: while"),
    "gamma for a name": ("name: crane", "name: gamma"),
    "quotes in a name": ("name: crane", "name: \"'; rm -rf *; '\""),
    "another script": ("name: hook", "name: crochet à 鈎"),
    "no limit on one side": ("limits: [-1, 1]", "limits: [null, 1]"),
    "a light body off the axis of a heavy one on it": ("mass: 0.5", "mass: 1e-15"),
}


@pytest.mark.parametrize(("old", "new"), GOOD_ALL_THE_SAME.values(), ids=GOOD_ALL_THE_SAME.keys())
def test_what_may_look_wrong_is_accepted(old: str, new: str, tmp_path: Path) -> None:
    assert GOOD.count(old) == 1
    text = GOOD.replace(old, new)
    file = tmp_path / "model.yaml"
    file.write_text(text, encoding="utf-8")
    assert len(read_model(file).bodies) == 3


ARM = WALKER[WALKER.index("  - name: arm") : WALKER.index("frames:")]

# As above, of WALKER.
BAD_PARTS: dict[str, tuple[str, str, int, str, str]] = {
    # joints that have names
    "unknown order": ("order: xyz", "order: xyx", 10, "bodies[0].joint.order", '"xyx"'),
    "an order of another joint": ("order: xyz", "order: xy", 10, "bodies[0].joint.order", '"xy"'),
    "a plane of a floating joint": ("order: xyz", "plane: xy", 10, "bodies[0].joint.plane", "unknown key"),
    "an axis of a floating joint": ("order: xyz", "axis: x", 10, "bodies[0].joint.axis", "unknown key"),
    "limits of a floating joint": ("order: xyz", "limits: [-1, 1]", 10, "bodies[0].joint.limits", "unknown key"),
    "unknown axis of a joint": ("{rz: {limits", "{rw: {limits", 11, "bodies[0].joint.axes.rw", 'no axis "rw"'),
    "an axis that a Cardan joint has not": (
        "{type: cardan, ",
        "{type: cardan, axes: {rz: {}}, ",
        28,
        "bodies[3].joint.axes.rz",
        'no axis "rz"',
    ),
    "limits of an axis out of order": ("[-1, 1]", "[1, -1]", 11, "bodies[0].joint.axes.rz.limits", "is above"),
    "limits of an axis by an unknown name": ("[-1, 1]", "[-1, w]", 11, "bodies[0].joint.axes.rz.limits[1]", '"w"'),
    "a key of an axis": ("damping: 2}", "dampnig: 2}", 11, "bodies[0].joint.axes.rz.dampnig", "unknown key"),
    "a place of an axis": ("damping: 2}", "position: 2}", 11, "bodies[0].joint.axes.rz.position", "unknown key"),
    "a place of a Cardan joint": ("[0, 0.3, 0]}", "[0, y, 0]}", 28, "bodies[3].joint.position[1]", '"y"'),
    "a type that is no word": ("type: floating", "type: [floating]", 9, "bodies[0].joint.type", '["floating"]'),
    "no type of an order": ("      type: floating\n", "", 8, "bodies[0].joint.type", "missing"),
    "a joint that is a word": (
        "joint: {type: cardan, position: [0, 0.3, 0]}",
        "joint: cardan",
        28,
        "bodies[3].joint",
        '"cardan"',
    ),
    "limits of a ball": ("{type: cardan,", "{type: ball, limits: [0, 1],", 28, "bodies[3].joint.limits", "unknown key"),
    "a free body on another": ("{type: cardan,", "{type: free,", 28, "bodies[3].joint", "a free body within the tree"),
    # sequences
    "a sequence of one": (
        "      - {type: prismatic, axis: z, friction: {torque: 1, speed: 0.01}, force: -k*q**3}\n",
        "",
        20,
        "bodies[2].joint",
        "list of 1",
    ),
    "an empty sequence": (
        "joint: {type: cardan, position: [0, 0.3, 0]}",
        "joint: []",
        28,
        "bodies[3].joint",
        "list of 0",
    ),
    "a fixed joint in a sequence": (
        "{type: revolute, axis: x, stiffness: k, rest: 0.1}",
        "{type: fixed, axis: x}",
        21,
        "bodies[2].joint[0].type",
        '"fixed"',
    ),
    "a floating joint in a sequence": (
        "{type: revolute, axis: x, stiffness: k, rest: 0.1}",
        "{type: floating, axis: x}",
        21,
        "bodies[2].joint[0].type",
        '"floating"',
    ),
    "no direction in a sequence": ("axis: z,", "axis: [0, 0, 0],", 22, "bodies[2].joint[1].axis", "no direction"),
    "a point on the axis of a sequence": (
        ARM,
        "  - {name: arm, mass: 1, parent: leg, joint: [{type: prismatic, axis: x}, {type: revolute, axis: y}]}\n",
        26,
        "bodies[3].joint[1]",
        'joint "arm.ry" moves nothing',
    ),
    "a locked axis of a joint": (
        "    com: [0, 0.3, 0]\n    inertia: [0.1, 0.01, 0.1]\n",
        "    com: [0, 0.3, 0]\n",
        28,
        "bodies[3].joint",
        'joint "arm.ry" moves nothing',
    ),
    "a name taken by a body between": ("name: arm", "name: trunk.rx", 26, "bodies[3].name", '"trunk.rx" is taken'),
    "a name taken by a joint between": (
        "{type: revolute, axis: x,",
        "{name: trunk.x, type: revolute, axis: x,",
        21,
        "bodies[2].joint[0].name",
        '"trunk.x" is taken',
    ),
    "an empty name of a joint between": (
        "{type: revolute, axis: x,",
        "{name: '', type: revolute, axis: x,",
        21,
        "bodies[2].joint[0].name",
        "an empty name",
    ),
    "a name too long for its joints": ("name: arm", f"name: {'a' * 63}", 26, "bodies[3].name", "66 characters"),
    "too many joints": (
        ARM,
        f"  - {{name: arm, mass: 1, joint: [{', '.join(['{type: prismatic, axis: x}'] * 992)}]}}\n",
        6,
        "bodies",
        "1001 bodies, those between",
    ),
    # bodies that are fixed
    "limits of a fixed body": (
        "{type: fixed, ",
        "{type: fixed, limits: [0, 1], ",
        16,
        "bodies[1].joint.limits",
        "unknown key",
    ),
    "a place that is no number": ("[-0.2, 0, 0.1]", "[-0.2, 0, up]", 16, "bodies[1].joint.position[2]", '"up"'),
    "its own fixed parent": (
        "trunk\n    joint: {type: fixed",
        "pack\n    joint: {type: fixed",
        15,
        "bodies[1].parent",
        "loop",
    ),
    "a loop with a fixed body": (
        "    parent: trunk\n    joint: {type: fixed",
        "    parent: arm\n    joint: {type: fixed",
        15,
        "bodies[1].parent",
        '"pack" -> "arm" -> "pack"',
    ),
    "a negative mass of a fixed body": ("mass: 2\n", "mass: -2\n", 17, "bodies[1].mass", "a mass of -2"),
    "nothing that moves": (
        WALKER[WALKER.index("  - name: trunk") :],
        "  - {name: a, joint: {type: fixed}, mass: 1}\n  - {name: b, parent: a, joint: {type: fixed}}\n",
        6,
        "bodies",
        "nothing moves",
    ),
    "a fixed body too light for a joint": (
        ARM,
        "  - {name: arm, parent: leg, joint: {type: revolute, axis: x}}\n"
        "  - {name: dot, parent: arm, joint: {type: fixed}, mass: 1}\n",
        26,
        "bodies[3].joint",
        'joint "arm" moves nothing',
    ),
    # joints' own forces
    "a negative armature": ("damping: 2", "armature: -2", 11, "bodies[0].joint.axes.rz.armature", "an armature of -2"),
    "a speed of nothing": ("damping: 2", "max_speed: 0", 11, "bodies[0].joint.axes.rz.max_speed", "found 0"),
    "a force at run time": ("damping: 2", "max_force: push", 11, "bodies[0].joint.axes.rz.max_force", "at run time"),
    "a negative stiffness": ("stiffness: k", "stiffness: -k", 21, "bodies[2].joint[0].stiffness", "stiffness -50"),
    "a negative damping": ("damping: 2", "damping: -2", 11, "bodies[0].joint.axes.rz.damping", "damping -2"),
    "a negative friction": ("torque: 1", "torque: -1", 22, "bodies[2].joint[1].friction.torque", "torque -1"),
    "friction at rest": ("speed: 0.01", "speed: 0", 22, "bodies[2].joint[1].friction.speed", "a speed of 0"),
    "friction that is a number": ("{torque: 1, speed: 0.01}", "1", 22, "bodies[2].joint[1].friction", "found 1"),
    "a rest position alone": ("stiffness: k, ", "", 21, "bodies[2].joint[0].rest", "without a spring"),
    "a stiffness in q": ("stiffness: k", "stiffness: k*q", 21, "bodies[2].joint[0].stiffness", 'unknown name "q"'),
    "an unknown name in a force": ("-k*q**3", "-k*x**3", 22, "bodies[2].joint[1].force", 'unknown name "x"'),
    "the acceleration in a force": ("-k*q**3", "-k*qdd", 22, "bodies[2].joint[1].force", 'unknown name "qdd"'),
    "another joint in a force": ("-k*q**3", "trunk.x", 22, "bodies[2].joint[1].force", "no meaning"),
    "code in a force": ("-k*q**3", "__import__('os').abort()", 22, "bodies[2].joint[1].force", "no meaning"),
    "a call in a force": ("-k*q**3", "eval(q)", 22, "bodies[2].joint[1].force", 'unknown function "eval"'),
    "a lambda in a force": ("-k*q**3", "'(lambda: q)()'", 22, "bodies[2].joint[1].force", "no meaning"),
    "an attribute in a force": ("-k*q**3", "q.__class__", 22, "bodies[2].joint[1].force", "no meaning"),
    "a condition in a force": (
        "-k*q**3",
        "1 if q else 0",
        22,
        "bodies[2].joint[1].force",
        "no meaning",
    ),
    "a broken power in a force": ("-k*q**3", "-k*q**0.3", 22, "bodies[2].joint[1].force", "neither whole nor"),
    "a root of a root in a force": ("-k*q**3", "sqrt(sqrt(q))", 22, "bodies[2].joint[1].force", "neither whole nor"),
    "a force that has no value": ("-k*q**3", "q/(k - 50)", 22, "bodies[2].joint[1].force", "has no value"),
    "an infinite force": ("-k*q**3", ".inf", 22, "bodies[2].joint[1].force", "found inf"),
    "a parameter called q": ("  k: 50", "  k: 50\n  q: 1", 5, "parameters.q", "the joint's own"),
    "a parameter called qd": ("  k: 50", "  k: 50\n  qd: 1", 5, "parameters.qd", "the joint's own"),
    # wrenches
    "a wrench on a missing body": ("body: leg, pos", "body: lag, pos", 35, "wrenches[0].body", 'no body "lag"'),
    "a wrench on the base": ("body: leg, pos", "body: base, pos", 35, "wrenches[0].body", "does not move"),
    "a wrench on a body fixed to the base": (
        "    parent: trunk\n    joint: {type: fixed",
        "    joint: {type: fixed",
        36,
        "wrenches[1].body",
        '"pack" is fixed to base',
    ),
    "no body of a wrench": ("body: leg, pos", "pos", 35, "wrenches[0].body", "missing"),
    "a wrench of nothing": (", force: input", "", 35, "wrenches[0]", "without force and moment"),
    "a wrench of zeros": ("[push, 0, 0]", "[k - 50, 0, 0]", 36, "wrenches[1]", "without force and moment"),
    "an unknown input": ("force: input", "force: inputs", 35, "wrenches[0].force", '"inputs"'),
    "an input among numbers": ("[push, 0, 0]", "[input, 0, 0]", 39, "wrenches[1].force[0]", 'unknown name "input"'),
    "a force of two": ("[push, 0, 0]", "[push, 0]", 39, "wrenches[1].force", "list of 2"),
    "a wrench in q": ("[push, 0, 0]", "[q, 0, 0]", 39, "wrenches[1].force[0]", 'unknown name "q"'),
    "an unknown frame": ("frame: base", "frame: world", 35, "wrenches[0].frame", '"world"'),
    "a frame that is a body": ("frame: body", "frame: pack", 38, "wrenches[1].frame", '"pack"'),
    "two wrenches of a name": ("name: wind", "name: Ground", 36, "wrenches[1].name", 'hard to tell from "ground"'),
    "a wrench that is a path": ("name: wind", "name: ../wind", 36, "wrenches[1].name", "looks like a path"),
    "a key of a wrench": ("frame: body\n", "at: body\n", 38, "wrenches[1].at", "unknown key"),
    # signals, written before the wrenches that may read them
    **{
        name: ("[push, 0, 0]", f"[push, {read}, 0]\nsignals: [{signals}]", line, path, finding)
        for name, signals, read, line, path, finding in (
            ("a signal that is not read", "gust", "0", 40, "signals[0]", 'no force reads "gust"'),
            ("a signal of the time's name", "t", "t", 40, "signals[0]", "their own meaning of t"),
            ("a signal of a joint's own name", "qd", "0", 40, "signals[0]", "their own meaning of qd"),
            ("a signal of a parameter's name", "k", "0", 40, "signals[0]", 'name "k" is taken'),
            ("a signal of a state's name", "q_trunk_z", "0", 40, "signals[0]", "a number of the state"),
            ("a signal twice", "gust, gust", "gust", 40, "signals[1]", 'name "gust" is taken'),
            ("a signal that is no word", "'a b'", "0", 40, "signals[0]", "cannot use the name"),
            ("a signal that is a function", "sin", "0", 40, "signals[0]", "their own meaning"),
            ("an unknown signal", "gust", "gust + gist", 39, "wrenches[1].force[1]", 'unknown name "gist"'),
            ("a signal that is a number", "5", "0", 40, "signals[0]", "found 5"),
        )
    },
    "code in a wrench": ("[push, 0, 0]", "['open(\"x\")', 0, 0]", 39, "wrenches[1].force[0]", "no meaning"),
}


@pytest.mark.parametrize(("old", "new", "line", "path", "finding"), BAD_PARTS.values(), ids=BAD_PARTS.keys())
def test_a_fault_of_a_joint_or_wrench_is_told_with_its_place(
    old: str, new: str, line: int, path: str, finding: str, tmp_path: Path
) -> None:
    assert WALKER.count(old) >= 1
    told = find_faults(WALKER.replace(old, new, 1), tmp_path)
    assert [(fault.line, fault.path) for fault in told] == [(line, path)]
    assert finding in told[0].finding
    assert told[0].remedy


def test_the_good_walker_is_good(tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    file.write_text(WALKER, encoding="utf-8")
    assert [len(body.joints) for body in read_model(file).bodies] == [6, 0, 2, 2]


def test_run_time_masses_may_be_0_of_bodies_that_are_fixed_together_too(tmp_path: Path) -> None:
    """No centre of mass is computed of them: it would be 0/0."""
    text = (
        WALKER.replace("{value: 2, kind", "{value: 0, kind")
        .replace("mass: 1\n", "mass: push\n")
        .replace("[push,", "[1,")
    )
    tip = "  - {name: tip, parent: arm, joint: {type: fixed, position: [0, 0.1, 0]}, mass: 2*push}\nframes:"
    file = tmp_path / "model.yaml"
    for accepted in (text, text.replace("frames:", tip)):
        file.write_text(accepted, encoding="utf-8")
        read_model(file)


def test_a_wrong_type_does_not_hide_what_is_wrong_elsewhere(tmp_path: Path) -> None:
    """Nothing follows from keys that might belong to the right type."""
    text = (
        WALKER.replace("type: floating", "type: flaoting").replace("mass: 2\n", "mass: -2\n").replace("k: 50", "k: x")
    )
    told = [(fault.path, fault.remedy) for fault in find_faults(text, tmp_path)]
    types = "give 'revolute', 'prismatic', 'fixed', 'cardan', 'universal', 'spherical', 'planar', 'floating', "
    types += "'ball', 'free', 'cylindrical', 'helical', 'dh'"
    assert told[1] == ("bodies[0].joint.type", types)
    assert [path for path, _ in told] == ["parameters.k", "bodies[0].joint.type", "bodies[1].mass"]


HOSTILE = {  # written so that reading them with care is quick, and without care is not
    "aliases of aliases": "a0: &a0 [x, x]\n"
    + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 30)),
    "nested lists": "bodies: " + "[" * 300_000,
    "nested mappings": "".join(f"{' ' * i}bodies:\n" for i in range(1000)),
    "a million values": f"bodies: [{'1,' * 400_000}]",
    "a long scalar": f"name: {'x' * 900_000}",
    "a long number": f"name: m\ngravity: [0, 0, {'9' * 900_000}]",
    "thousands of unknown keys": "name: m\n" + "".join(f"nome{i}: 1\n" for i in range(20_000)),
    "thousands of missing parents": "name: m\ngravity: [0, 0, 0]\nbodies:\n"
    + "".join(f"- {{name: b{i}, parent: c{i}, joint: {{type: revolute, axis: z}}, mass: 1}}\n" for i in range(1000)),
    "squares of squares": "name: m\ngravity: [0, 0, p4000]\nparameters:\n  p0: 1.0000000000000002\n"
    + "".join(f"  p{i}: p{i - 1}*p{i - 1}\n" for i in range(1, 4001)),
    "a long chain of nothing": "name: m\ngravity: [0, 0, 0]\nbodies:\n- {name: b0, joint: {type: revolute, axis: z}}\n"
    + "".join(f"- {{name: b{i}, parent: b{i - 1}, joint: {{type: revolute, axis: z}}}}\n" for i in range(1, 1000)),
    "a long shaft of points": "name: m\ngravity: [0, 0, 0]\nbodies:\n"
    + "".join(
        f"- {{name: b{i}, parent: {f'b{i - 1}' if i else 'base'}, joint: {{type: revolute, axis: z}}, mass: 1}}\n"
        for i in range(1000)
    ),
    "a million bytes of comments": "#\n" * 500_000,
    "too large": "#" * (MAX_BYTES + 1),
}


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE.keys())
def test_hostile_files_are_refused(text: str, tmp_path: Path) -> None:
    assert 0 < len(find_faults(text, tmp_path)) <= MAX_FAULTS + 1


def test_a_long_chain_of_followers_is_refused(tmp_path: Path) -> None:
    """Combined rules grow with the square of the chain: a thousand joints would take hours."""
    bodies = "".join(
        f"  - {{name: x{i}, joint: {{type: revolute, axis: y, follows: {{joint: {f'x{i - 1}' if i else 'q1'}}}}}, "
        "mass: 1, com: [1, 0, 0]}\n"
        for i in range(34)
    )
    told = find_faults(GOOD.replace(HOOK, HOOK + bodies), tmp_path)
    assert [(fault.path, fault.remedy) for fault in told] == [
        (f"bodies[{i}].joint.follows.joint", 'let it follow "q1"') for i in (35, 36)
    ]
