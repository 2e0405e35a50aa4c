"""Every element and attribute of URDF and SDF that may change a motion is read, warned of, or refused."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from mbsgen.errors import InputError
from mbsgen.importing import Imported, import_model
from mbsgen.importing.sdf.vocabulary import choose_vocabulary
from mbsgen.importing.urdf.vocabulary import VOCABULARY
from mbsgen.importing.vocabulary import TEXT, Part, Treatment, Vocabulary
from tests.mbsgen.importing import schemas

DRAKE = "xmlns:drake"


@dataclass(frozen=True)
class Format:
    """A format with its schema, and a file that has every part that is read."""

    suffix: str
    root: str
    vocabulary: Vocabulary
    schema: dict[str, str]
    text: str
    unseen: frozenset[str]  # parts that are read, and not in the file, with the reason beside them

    def parse(self) -> ET.Element:
        return ET.fromstring(self.text.replace("drake:", "drake__"))

    def write(self, tree: ET.Element, folder: Path) -> Path:
        path = folder / f"machine.{self.suffix}"
        path.write_text(ET.tostring(tree, encoding="unicode").replace("drake__", "drake:"), encoding="utf-8")
        return path


FORMATS = {
    "sdf": Format(
        "sdf",
        "sdf",
        choose_vocabulary((1, 6)),
        schemas.SDF,
        schemas.SDF_FILE,
        frozenset({"pose @frame", "sdf model", "world joint", "world frame"}),  # a fault; tests of frames have the rest
    ),
    "urdf": Format(
        "urdf",
        "robot",
        VOCABULARY,
        schemas.URDF,
        schemas.URDF_FILE,
        frozenset(
            {
                "inertial @name",  # means nothing
                "robot loop", "loop @name", "loop @type", "loop predecessor", "loop successor", "loop axis",
                "loop_end @link", "loop_end origin", "robot loop_joint", "robot drake:ball_constraint",
                "robot transmission", "joint actuator",  # tests of loops and transmissions read these
                "robot gazebo", "robot mujoco", "mujoco compiler",  # nothing in them is read
            }
        ),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FORMATS)
def test_the_vocabulary_has_all_that_the_schemas_list(name: str) -> None:
    known = FORMATS[name].vocabulary.places
    for place, parts in FORMATS[name].schema.items():
        assert not set(parts.split()) - known[place].keys(), place


def walk(kind: Format, tree: ET.Element) -> Iterator[tuple[ET.Element, str]]:
    """Yield the elements that the reader looks into, with their places."""
    waiting = [(tree, kind.root)]
    while waiting:
        element, place = waiting.pop()
        yield element, place
        for child in element:
            part = kind.vocabulary.places[place].get(child.tag.replace("drake__", "drake:"))
            if part is not None and part.treatment is Treatment.READ and part.place is not None:
                waiting.append((child, part.place))


def attempt(kind: Format, tree: ET.Element, folder: Path) -> Imported | str:
    try:
        return import_model(kind.write(tree, folder))
    except InputError as error:
        return str(error)


def warnings(found: Imported | str) -> list[str]:
    """Return the texts of the warnings, except of the one on ranges, which every file has."""
    notices = () if isinstance(found, str) else found.notices
    return [notice.text for notice in notices if notice.alters and not notice.text.startswith("the ranges of")]


def alter(value: str) -> str:
    """Change numbers to others, flags to the contrary, and any other word to one that means nothing."""
    flags = {"true": "false", "false": "true"}
    if value.strip() in flags:
        return flags[value.strip()]
    try:
        return " ".join(repr(0.9 * float(word) + 0.05) for word in value.split())
    except ValueError:
        return f"{value.strip()}x"


LABELS = ("world @name", "frame @name", "joint @name", "coupling @name")  # which nothing else may mention


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_read_decides_the_model(name: str, tmp_path: Path) -> None:
    """Another value in its place gives another model, or is refused; and nothing in the file is warned of."""
    kind = FORMATS[name]
    base = attempt(kind, kind.parse(), tmp_path)
    assert isinstance(base, Imported), base
    assert warnings(base) == []
    seen = set()
    for k, (first, place) in enumerate([*walk(kind, kind.parse())]):
        parts = kind.vocabulary.places[place]
        seen |= {f"{place} {key}" for key in (child.tag.replace("drake__", "drake:") for child in first)}
        keys = [f"@{key}" for key in first.attrib] + [TEXT] * bool(parts.get(TEXT))
        for key in keys:
            seen.add(f"{place} {key}")
            if parts[key].treatment is not Treatment.READ:
                continue
            tree = kind.parse()
            element, _ = [*walk(kind, tree)][k]
            if key == TEXT:
                element.text = alter(element.text or "")
            else:
                element.set(key[1:], alter(element.get(key[1:], "")))
            found = attempt(kind, tree, tmp_path)
            is_other = isinstance(found, str) or found.model != base.model
            assert is_other or f"{place} {key}" in LABELS, f"{place} {key} {first.tag}"
    wanted = {
        f"{place} {key}"
        for place, parts in kind.vocabulary.places.items()
        for key, part in parts.items()
        if part.treatment is Treatment.READ
    }
    assert wanted - seen - kind.unseen == set()


def list_cases(name: str, *treatments: Treatment) -> list[tuple[str, str]]:
    return [
        (place, key)
        for place, parts in FORMATS[name].vocabulary.places.items()
        for key, part in parts.items()
        if part.treatment in treatments
    ]


def add(kind: Format, place: str, key: str, value: str) -> ET.Element:
    """Add a part to the first element at a place."""
    tree = kind.parse()
    if kind.root == "robot":
        for parent, tag in (("robot", "gazebo"), ("robot", "mujoco"), ("mujoco", "compiler")):
            next(element for element, inside in walk(kind, tree) if inside == parent).append(ET.Element(tag))
        for text in ('<loop name="l" type="fixed"><predecessor link="a"/><successor link="a"/></loop>',):
            if place.startswith("loop"):
                tree.append(ET.fromstring(text))
    tag = key.removeprefix("@").replace("drake:", "drake__")
    at = next(element for element, inside in walk(kind, tree) if inside == place)
    if key.startswith("@"):
        at.set(tag, value)
    else:
        child = ET.SubElement(at, tag, {"name": "part"} if key in ("plugin", "gripper") else {})
        child.text = value
    return tree


@pytest.mark.parametrize("name", FORMATS)
def test_what_changes_a_motion_and_is_not_read_is_a_warning(name: str, tmp_path: Path) -> None:
    """Each part of the list that is warned of; with a value that means nothing there is no warning.

    Where the list names these values, 0 has a meaning: such as of a link's gravity.
    """
    kind = FORMATS[name]
    for place, key in list_cases(name, Treatment.WARNED):
        part: Part = kind.vocabulary.places[place][key]
        found = attempt(kind, add(kind, place, key, "0.7"), tmp_path)
        assert part.text in warnings(found), f"{place} {key}: {found}"
        if key not in ("plugin", "gripper"):
            told = warnings(attempt(kind, add(kind, place, key, "0 0.0"), tmp_path))
            assert (part.text in told) == (part.harmless is not None), f"{place} {key}"
        for harmless in part.harmless or ():
            assert warnings(attempt(kind, add(kind, place, key, harmless), tmp_path)) == [], f"{place} {key}"


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_refused_is_an_error(name: str, tmp_path: Path) -> None:
    kind = FORMATS[name]
    for place, key in list_cases(name, Treatment.REFUSED):
        found = attempt(kind, add(kind, place, key, "0.7"), tmp_path)
        assert isinstance(found, str), f"{place} {key}"
        assert kind.vocabulary.places[place][key].text in found


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_idle_changes_nothing(name: str, tmp_path: Path) -> None:
    kind = FORMATS[name]
    base = attempt(kind, kind.parse(), tmp_path)
    assert isinstance(base, Imported)
    for place, key in list_cases(name, Treatment.IDLE):
        found = attempt(kind, add(kind, place, key, "0.7"), tmp_path)
        assert isinstance(found, Imported), f"{place} {key}: {found}"
        assert warnings(found) == []
        assert found.model == base.model


@pytest.mark.parametrize("name", FORMATS)
def test_what_no_list_knows_is_a_warning(name: str, tmp_path: Path) -> None:
    """In each place: an element, an attribute, a text, and a second element where only the first is read."""
    kind = FORMATS[name]
    loops = {"loop", "loop_end"}  # of which the file has none
    for place, parts in kind.vocabulary.places.items():
        if place in loops:
            continue
        for key, text in (("qqqqqqqqqqqq", "<qqqqqqqqqqqq>"), ("@qqqqqqqqqqqq", 'qqqqqqqqqqqq "1"')):
            found = attempt(kind, add(kind, place, key, "1"), tmp_path)
            assert f"{text} is not known here, and is left out" in warnings(found), place
        for key, part in parts.items():
            if part.treatment is Treatment.READ and not part.repeats and not key.startswith(("@", "#")):
                found = attempt(kind, add_twin(kind, place, key), tmp_path)
                told = any(one.startswith(f"a second <{key}>, which is left out") for one in warnings(found))
                assert told or key in REFUSED_TWICE, f"{place} {key}: {found}"


REFUSED_TWICE = ("world",)


def add_twin(kind: Format, place: str, key: str) -> ET.Element:
    """Return the file with two elements of a tag at a place, of which the second means nothing."""
    tag = key.replace("drake:", "drake__")
    tree = add(kind, place, "@" + "xmlns", "u")
    at = next((e for e, inside in walk(kind, tree) if inside == place and e.find(tag) is not None), None)
    if at is None:
        at = next(element for element, inside in walk(kind, tree) if inside == place)
        ET.SubElement(at, tag)
    at.append(ET.Element(tag))
    return tree


@pytest.mark.parametrize("value", ["0", "false", "False"])
@pytest.mark.parametrize(
    ("name", "place", "key"),
    [
        ("sdf", "link", "gravity"),
        ("sdf", "link", "@gravity"),
        ("urdf", "link", "gravity"),
        ("urdf", "gazebo", "gravity"),
    ],
)
def test_a_link_without_gravity_is_a_warning(name: str, place: str, key: str, value: str, tmp_path: Path) -> None:
    kind = FORMATS[name]
    assert kind.vocabulary.places[place][key].text in warnings(attempt(kind, add(kind, place, key, value), tmp_path))
    assert warnings(attempt(kind, add(kind, place, key, "true"), tmp_path)) == []


def test_a_misspelt_name_has_a_hint(tmp_path: Path) -> None:
    kind = FORMATS["urdf"]
    found = attempt(kind, add(kind, "dynamics", "@dampign", "3"), tmp_path)
    assert warnings(found) == ['dampign "3" is not known here, and is left out (did you mean damping?)']
