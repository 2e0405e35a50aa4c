"""The list of MJCF is complete by MuJoCo's own schema, and each attribute is treated as the list says.

A sample is a file with the attribute and one without it. An attribute that is read makes another model; one that is
warned of makes a warning, a refused one an error, and an idle one none of these.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from mbsgen.errors import InputError
from mbsgen.importing import import_model
from mbsgen.importing.mjcf.schema import TABLE, Entry, Use
from mbsgen.model.model import Model

OLDER = {  # what MuJoCo 4.0 has no more, or has outside of its schema
    "compiler": {"exactmeshinertia", "convexhull"},
    "option": {"apirate", "collision", "mpr_iterations", "mpr_tolerance"},
    "flag": {"passive", "sensornoise"},
}
BODY = '<inertial pos="0.1 0 0" mass="1" diaginertia="1 1.2 1.1"/>'
CORNERS = "0 0 0 1 0 0 0 1 0 0 0 2"
FACES = "0 2 1 0 1 3 0 3 2 1 2 3"
MACHINE = (
    '<mujoco><default><default class="other"><joint damping="7"/><geom density="5"/><motor gear="3"/>'
    '<mesh scale="2 2 2"/><equality active="false"/></default></default>{head}<worldbody>{world}</worldbody>{tail}'
    "</mujoco>"
)
ARM = f'<body name="a"><joint name="j" axis="0 1 0"/>{BODY}<site name="s" pos="1 0 0"/>{{}}</body>'
TWO = (
    ARM.format("")
    + f'<body name="b" pos="1 0 0"><joint name="k"/><joint name="l" axis="1 0 0"/><joint name="m" axis="0 1 0"/>{BODY}'
    '<site name="t" pos="0.5 0 0" quat="0.9 0.1 0 0"/></body>'
)


def fill(head: str = "", world: str = "", tail: str = "") -> str:
    return MACHINE.format(head=head, world=world, tail=tail)


MESHED = ARM.format('<body name="n"><joint/><geom type="mesh" mesh="m"/></body>')
TEMPLATES = {  # of entries, with a place for attributes
    "mujoco": "<mujoco {}><worldbody>" + ARM.format("") + "</worldbody></mujoco>",
    "compiler": fill(
        "<compiler {}/><asset><mesh name='m' file='finer/m.obj'/></asset>",
        '<body euler="10 20 30"><joint stiffness="1" springref="0.2" range="-1 1"/><joint axis="1 0 0"/>'
        '<inertial pos="1 0 0" mass="2" diaginertia="1 1 1"/><geom size="0.1"/><geom size="0.2" group="3"/></body>'
        '<body name="n"><joint/><geom size="0.1" group="2"/><geom type="mesh" mesh="m"/></body>',
    ),
    "option": fill("<option {}/>", ARM.format(""), '<actuator><motor joint="j" group="1"/></actuator>'),
    "flag": fill(
        "<option><flag {}/></option>",
        ARM.format('<geom size="0.1"/>').replace('"j"', '"j" stiffness="1" damping="1" frictionloss="1" range="-1 1"'),
        '<actuator><motor joint="j" ctrlrange="-1 1"/></actuator>'
        '<equality><connect body1="a" anchor="0 0 0"/></equality>',
    ),
    "default": fill("<default><default class='x' {}><joint armature='1'/></default></default>", ARM.format("")),
    "default_equality": fill("<default><equality {}/></default>", TWO, '<equality><weld body1="b"/></equality>'),
    "mesh": fill(f'<asset><mesh name="m" vertex="{CORNERS}" face="{FACES}" {{}}/></asset>', MESHED),
    "body": fill("", ARM.format(f"<body {{}}><joint/>{BODY}</body>")),
    "worldbody": fill("", ARM.format("")).replace("<worldbody>", "<worldbody {}>"),
    "frame": fill("", ARM.format(f"<frame {{}}><body><joint/>{BODY}</body></frame>")),
    "inertial": fill("", '<body><joint/><joint axis="1 0 0"/><inertial {}/></body>'),
    "joint": fill("", f"<body><joint {{}}/>{BODY}</body>"),
    "freejoint": fill("", f"<body><freejoint {{}}/>{BODY}</body>"),
    "geom": fill("", '<body><joint/><joint axis="1 0 0"/><geom {}/></body>'),
    "site": fill(
        "", ARM.format("<site {}/>") + TWO.partition("</body>")[2], '<equality><weld site1="t" site2="p"/></equality>'
    ),
    "connect": fill("", TWO, "<equality><connect {}/></equality>"),
    "weld": fill("", TWO, "<equality><weld {}/></equality>"),
    "coupling": fill("", TWO, "<equality><joint {}/></equality>"),
    "motor": fill("", TWO, "<actuator><motor {}/></actuator>"),
    "general": fill("", TWO, "<actuator><general {}/></actuator>"),
}
POSE = {
    "pos": "0.1 0.2 0.3",
    "quat": "0.9 0.1 0.2 0.3",
    "axisangle": "0 1 1 20",
    "xyaxes": "0 1 0 1 0 1",
    "zaxis": "1 0 1",
    "euler": "10 20 30",
}
ACTUATOR = 'joint="j"'
DRIVE = {
    "armature": "1",
    "class": ("other", 'armature="1"'),
    "ctrlrange": "-1 1",
    "ctrllimited": ("false", 'ctrlrange="-1 1"'),
    "damping": "1 2",
    "forcerange": "-1 1",
    "forcelimited": ("false", 'forcerange="-1 1"'),
    "gear": ("2", 'armature="1"'),
    "joint": ("k", ""),
    "jointinparent": ("k", ""),
    "delay": "0.1",
    "cranklength": ("1", "", 'joint="j"'),
    **dict.fromkeys(("cranksite", "refsite", "site", "slidersite", "tendon", "body"), ("s", "", 'joint="j"')),
}
# Values by entry and attribute: a value; or a value and attributes that it needs, or replaces
VALUES: dict[str, dict[str, str | tuple[str, ...]]] = {
    "mujoco": {"model": "x"},
    "compiler": {
        "angle": "radian", "autolimits": "false", "eulerseq": "zyx", "inertiafromgeom": "true",
        "assetdir": "finer", "meshdir": "finer", "strippath": "true",
        "inertiagrouprange": ("0 2", 'inertiafromgeom="true"'), "settotalmass": "5", "exactmeshinertia": "true",
        "balanceinertia": "true", "boundinertia": "1", "boundmass": "1", "coordinate": "global",
    },
    "option": {
        "gravity": "1 2 3", "actuatorgroupdisable": "1", "density": "1", "viscosity": "1", "wind": "1 0 0",
    },
    "flag": dict.fromkeys(
        ("clampctrl", "constraint", "contact", "damper", "equality", "frictionloss", "gravity", "limit", "spring",
         "passive", "actuation"), "disable",
    ),
    "default": {"class": ("", "")},
    "default_equality": {"active": "false"},
    "mesh": {
        "class": "other", "content_type": ("model/obj", 'file="m.stl"', f'vertex="{CORNERS}" face="{FACES}"'),
        "face": ("", "", ""), "file": ("m.obj", "", f'vertex="{CORNERS}" face="{FACES}"'), "inertia": "shell",
        "name": ("", "", ""), "refpos": "1 2 3", "refquat": "0.9 0.1 0 0", "scale": "1 2 3",
        "vertex": ("", "", ""), "builtin": "sphere", "maxhullvert": ("4", 'inertia="convex"'),
    },
    "body": {**POSE, "name": "n", "childclass": "other", "gravcomp": "1", "mocap": "true", "sleep": ("", "")},
    "frame": {**POSE, "childclass": "other", "scale": "2", "massscale": "2", "scaling": "geometry"},
    "inertial": {
        **{key: (value, 'pos="0.1 0 0" mass="1" diaginertia="1 2 3"') for key, value in POSE.items()},
        "pos": ("1 2 3", 'mass="1" diaginertia="1 2 2"', 'mass="1" diaginertia="1 2 2" pos="0.1 0 0"'),
        "mass": ("2", 'diaginertia="1 2 2" pos="0.1 0 0"', 'diaginertia="1 2 2" pos="0.1 0 0" mass="1"'),
        "diaginertia": ("1 2 2", 'mass="1" pos="1 0 0"', 'mass="1" pos="1 0 0" diaginertia="1 1 1"'),
        "fullinertia": ("1 2 2 0.1 0.1 0", 'mass="1" pos="1 0 0"', 'mass="1" pos="1 0 0" diaginertia="1 1 1"'),
    },
    "joint": {
        "actuatorfrcrange": "-1 1", "actuatorfrclimited": ("false", 'actuatorfrcrange="-1 1"'), "armature": "1",
        "axis": "1 0 0", "class": "other", "damping": "1", "frictionloss": "1", "range": "-1 1",
        "limited": ("false", 'range="-1 1"'), "name": "n", "pos": "1 2 3", "ref": "10", "stiffness": "1",
        "springref": ("10", 'stiffness="1"'), "type": "slide", "springdamper": "1 1",
        "springyield": ("1", 'stiffness="1"'),
    },
    "freejoint": {"name": ("", "")},
    "geom": {
        **{key: (value, 'type="box" size="1 2 3"') for key, value in POSE.items()},
        "conaffinity": ("0", 'size="1" contype="0"'), "contype": ("0", 'size="1" conaffinity="0"'),
        "class": ("other", 'size="1"'), "density": ("5", 'size="1"'), "mass": ("5", 'size="1"'),
        "size": ("2", "", 'size="1"'), "type": ("box", 'size="1 2 3"'),
        "fromto": ("0 0 0 1 2 3", 'type="box" size="1"', 'size="1"'), "rgba": ("1 0 0 1", 'size="1"'),
        "group": ("7", 'size="1"'), "mesh": ("", ""), "shellinertia": ("true", 'size="1"'),
    },
    "site": {
        **{key: (value, 'name="p"') for key, value in POSE.items()}, "name": ("", ""), "class": ("", ""),
        "fromto": ("0 0 0 1 2 3", 'name="p" type="box"'),
    },
    "connect": {
        "active": ("false", 'body1="b" anchor="0.1 0 0"'), "anchor": ("1 0 0", 'body1="b"', 'body1="b" anchor="2 0 0"'),
        "body1": ("b", 'anchor="0 0 0"', 'body1="a" anchor="0 0 0"'),
        "body2": ("a", 'body1="b" anchor="0 0 0"'), "class": ("other", 'body1="b" anchor="0.1 0 0"'),
        "name": ("n", 'body1="b" anchor="0.1 0 0"'),
        "site1": ("t", 'site2="s"', 'site1="s" site2="t"'), "site2": ("s", 'site1="t"', 'site1="s" site2="t"'),
    },
    "weld": {
        "active": ("false", 'body1="b"'), "anchor": ("1 0 0", 'body1="b"'), "body1": ("b", "", 'body1="a"'),
        "body2": ("a", 'body1="b"'), "class": ("other", 'body1="b"'), "name": ("n", 'body1="b"'),
        "relpose": ("1 0 0 1 0 0 0", 'body1="b"'), "torquescale": ("0", 'body1="b"'),
        "site1": ("t", 'site2="s"', 'site1="s" site2="t"'), "site2": ("s", 'site1="t"', 'site1="s" site2="t"'),
    },
    "coupling": {
        "active": ("false", 'joint1="j"'), "class": ("other", 'joint1="j"'), "joint1": ("j", "", 'joint1="k"'),
        "joint2": ("k", 'joint1="j"'), "name": ("n", 'joint1="j"'), "polycoef": ("1 2", 'joint1="j" joint2="k"'),
    },
    "motor": {**DRIVE, "group": ("1", ""), "name": ("", "")},
    "general": {
        **DRIVE, "group": ("1", ""), "name": ("", ""), "gainprm": "2", "gaintype": "affine", "biasprm": "1 2",
        "biastype": "affine", "dynprm": "1", "dyntype": "filter", "actdim": "1",
    },
}  # fmt: skip
ELSEWHERE = {  # treated as listed by other tests
    ("default", "class"), ("mesh", "face"), ("mesh", "vertex"), ("mesh", "name"), ("body", "sleep"),
    ("freejoint", "name"), ("geom", "mesh"), ("site", "name"), ("site", "class"), ("motor", "name"),
    ("general", "name"), ("motor", "group"), ("general", "group"), ("mesh", "content_type"), ("geom", "fitscale"),
    ("compiler", "fitaabb"),
}  # fmt: skip
WORDS = {  # of idle attributes whose values are no numbers
    "conflict": "merge", "passthrough": "textures", "align": "true", "simple": "false", "fuse": "false",
    "interp": "linear", "user": "1 2", "rgba": "1 0 0 1", "material": "x", "texturedir": "x", "type": "box",
}  # fmt: skip


def find_word(name: str, attribute: str) -> str:
    """Return a value of an idle attribute."""
    return "disable" if name == "flag" else WORDS.get(attribute, "1")


def list_schema() -> dict[str, set[str]]:
    """List the elements of MuJoCo's schema by their paths, with their attributes."""
    mujoco = pytest.importorskip("mujoco")
    found: dict[str, set[str]] = {}
    path: list[str] = []
    for line in mujoco.mj_printSchema(False, True).splitlines():
        start = re.match(r"( *)(\(world\)body|[a-z_]+) \(.\)(.*)", line)
        if start is not None:
            path = [*path[: len(start[1]) // 3], start[2].replace("(world)", "")]
            found["/".join(path)] = set()
        found["/".join(path)] |= set((start[3] if start else line).split())
    return found


def find(path: str) -> Entry | None:
    """Find the entry of a path; None where the list leaves an element with all its content to one treatment."""
    entry = TABLE["mujoco"]
    for tag in path.split("/")[1:]:
        if not entry.children and not entry.attributes:
            return None
        entry = TABLE["body"] if tag == "body" else TABLE[entry.children[tag]]  # `worldbody` is listed with `body`
    return entry if entry.attributes else None


def test_the_list_has_what_the_schema_has() -> None:
    """Each element, and each attribute of an element without one treatment as a whole; else only older ones."""
    seen: dict[str, set[str]] = {}
    for path, attributes in list_schema().items():
        entry = find(path)
        if entry is not None:
            assert attributes <= entry.attributes.keys(), (path, attributes - entry.attributes.keys())
            name = next(name for name, each in TABLE.items() if each is entry)
            seen.setdefault(name, set()).update(attributes)
    for name, attributes in seen.items():
        assert TABLE[name].attributes.keys() - attributes <= OLDER.get(name, set()), name


def list_samples() -> Iterator[tuple[str, str, Use]]:
    for name in TEMPLATES:
        if name != "worldbody":
            yield from ((name, attribute, use) for attribute, use in TABLE[name].attributes.items())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a folder with meshes of one name and three sizes."""
    folder = tmp_path_factory.mktemp("schema")
    (folder / "finer" / "finer").mkdir(parents=True)
    open_one = "f 1 3 2\nf 1 2 4\nf 1 4 3\n"
    for where, size in ((folder, 1), (folder / "finer", 2), (folder / "finer" / "finer", 3)):
        corners = f"v 0 0 0\nv {size} 0 0\nv 0 1 0\nv 0 0 3\nv 0.1 0.1 0.1\n"
        (where / "m.obj").write_text(corners + open_one + "f 2 3 5\nf 3 4 5\nf 4 2 5\n")
    return folder


def attempt(path: Path) -> tuple[Model | None, set[str]]:
    """Import a file: the model, None where it is refused, and the warnings."""
    try:
        imported = import_model(path)
    except InputError:
        return None, set()
    return imported.model, {notice.text for notice in imported.notices if notice.alters}


@pytest.mark.parametrize(("name", "attribute", "use"), [*list_samples()])
def test_each_attribute_is_treated_as_listed(name: str, attribute: str, use: Use, folder: Path) -> None:
    if (name, attribute) in ELSEWHERE:
        return
    usual = {
        "geom": 'size="1"', "inertial": 'mass="1" pos="0.1 0 0" diaginertia="1 2 2"', "site": 'name="p"',
        "connect": 'body1="b" anchor="0.1 0 0"', "weld": 'body1="b"', "coupling": 'joint1="j"',
        "motor": ACTUATOR, "general": ACTUATOR,
    }.get(name, "")  # fmt: skip
    given = VALUES.get(name, {}).get(attribute, find_word(name, attribute) if use is Use.IDLE else None)
    assert given is not None, f"{name}/{attribute} has no sample"
    value, needed, without = (given, usual, usual) if isinstance(given, str) else (*given, *given[1:], "")[:3]
    if name in ("motor", "general") and not isinstance(given, str) and len(given) == 2:
        needed, without = f"{needed} {ACTUATOR}" * ("joint" not in attribute), f"{without} {ACTUATOR}"
    template, path = TEMPLATES[name], folder / "machine.xml"
    base = template.replace("vertex=", "{}vertex=", 0)
    if name == "mesh" and without.startswith("vertex"):
        base = template.replace(f'vertex="{CORNERS}" face="{FACES}" ', "")
    path.write_text(template.format(without) if base is template else base.format(without))
    model, warnings = attempt(path)
    assert model is not None or (name == "compiler" and attribute == "inertiagrouprange"), "the sample without it"
    path.write_text(base.format(f'{needed} {attribute}="{value}"'))
    other, more = attempt(path)
    match use:
        case Use.READ:
            assert (other, more) != (model, warnings)
        case Use.WARNED:
            assert more - warnings
        case Use.REFUSED:
            assert other is None
        case Use.IDLE:
            assert (other, more) == (model, warnings)


@pytest.mark.parametrize(
    "tag", [tag for tag, name in TABLE["actuator"].children.items() if TABLE[name].use != Use.READ]
)
def test_actuators_with_gains_are_warned_of(tag: str, tmp_path: Path) -> None:
    path = tmp_path / "machine.xml"
    path.write_text(fill("", TWO, f'<actuator><{tag} joint="j"/></actuator>'))
    assert any("gains and dynamics are left out" in text for text in attempt(path)[1])


@pytest.mark.parametrize(
    ("section", "tag"),
    [(section, tag) for section in ("deformable", "tendon", "equality", "extension", "contact")
     for tag, name in TABLE[section].children.items() if TABLE[name].use is Use.WARNED],
)  # fmt: skip
def test_elements_that_are_warned_of(section: str, tag: str, tmp_path: Path) -> None:
    path = tmp_path / "machine.xml"
    path.write_text(fill("", TWO, f"<{section}><{tag}/></{section}>"))
    assert attempt(path)[1]


@pytest.mark.parametrize("tag", [tag for tag, name in TABLE["body"].children.items() if TABLE[name].use is Use.REFUSED])
def test_elements_that_are_refused(tag: str, tmp_path: Path) -> None:
    path = tmp_path / "machine.xml"
    path.write_text(fill("", ARM.format(f"<{tag}/>")))
    assert attempt(path)[0] is None


@pytest.mark.parametrize(
    ("text", "warning"),
    [
        (
            '<worldbody><body><joint stifness="3"/>{}</body></worldbody>',
            "stifness is no attribute of it: it is left out",
        ),
        ("<worldbody/><actuators/><worldbody><body><joint/>{}</body></worldbody>", "(did you mean actuator?)"),
        ("<option><flags/></option><worldbody><body><joint/>{}</body></worldbody>", "no such element here"),
        ('<default><joint dampin="1"/></default><worldbody><body><joint/>{}</body></worldbody>', "dampin is no"),
        ('<compiler angel="radian"/><worldbody><body><joint/>{}</body></worldbody>', "(did you mean angle?)"),
    ],
)
def test_what_the_schema_does_not_have_is_warned_of(text: str, warning: str, tmp_path: Path) -> None:
    path = tmp_path / "machine.xml"
    path.write_text(f"<mujoco>{text.format(BODY)}</mujoco>")
    assert any(warning in told for told in attempt(path)[1])
