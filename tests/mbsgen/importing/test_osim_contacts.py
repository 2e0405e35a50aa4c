"""Contacts of OpenSim's models: against OpenSim's numbers, which ship in tests/reference; and what is refused.

`python -m tests.mbsgen.importing.test_osim_contacts` writes the numbers anew, by the Python of MBSGEN_OPENSIM.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from mbsgen.importing import Choices, import_model, write_imported
from mbsgen.model.reader import read_model
from mbsgen.osim_comparison import compare_with_opensim
from tests.mbsgen.importing.osim_contact_files import CASES
from tests.mbsgen.importing.osim_files import check_fault, save, write_answers

REFERENCE = Path(__file__).parents[2] / "reference" / "opensim_contacts.json"
ROUNDING = 1e-12  # relative
SEEN = 1e-3  # relative: of forces of contact in inverse dynamics
COUNTS = {"shares": 2, "releasing": 2}


@pytest.mark.parametrize("name", CASES)
def test_contact_forces_are_opensims(name: str, tmp_path: Path) -> None:
    """Inverse dynamics at random states; without the contacts they differ, so the spheres press."""
    answer = json.loads(REFERENCE.read_text("utf-8"))[name]
    found = compare_with_opensim(save(tmp_path, CASES[name]), Choices(), lambda *_: answer)
    assert max(found.misses.values()) < ROUNDING, found.misses
    assert len(import_model(tmp_path / "leg.osim").model.contacts) == COUNTS.get(name, 1)
    bare = re.sub(r"<ForceSet.*</ForceSet>", "", CASES[name])
    assert compare_with_opensim(save(tmp_path, bare), Choices(), lambda *_: answer).misses["tau"] > SEEN


@pytest.mark.parametrize("name", ["smooth", "spheres"])
def test_contacts_are_written_and_read_again(name: str, tmp_path: Path) -> None:
    found = import_model(save(tmp_path, CASES[name]))
    (tmp_path / "model.yaml").write_text(write_imported(found), "utf-8")
    assert read_model(tmp_path / "model.yaml") == found.model


def test_pairs_that_do_not_move_and_other_geometry_are_named(tmp_path: Path) -> None:
    text = CASES["smooth"].replace('<ContactSphere name="heel"><socket_frame>/bodyset/foot<',
                                   '<ContactSphere name="heel"><socket_frame>/ground<')  # fmt: skip
    found = import_model(save(tmp_path, text))
    assert not found.model.contacts
    assert any('"one" is between bodies that do not move' in x.text for x in found.notices)
    mesh = re.sub(r'ContactSphere( name="toe".*?</)ContactSphere', r"ContactMesh\1ContactMesh", CASES["shares"])
    found = import_model(save(tmp_path, mesh))
    assert len(found.model.contacts) == 1
    assert [x.text for x in found.notices if "a ContactMesh, which is not read" in x.text and x.alters]


FAULTS: dict[str, tuple[str, str, str]] = {
    "name": ("/heel</socket_sphere>", "/hel</socket_sphere>", 'no contact geometry "hel"; did you mean "heel"?'),
    "swapped": ("/floor</socket_half", "/toe</socket_half", "it needs a sphere and a half space; let socket_sphere"),
    "radius": ("<radius>0.8<", "<radius>0<", "radius is 0; give more than 0"),
    "stiffness": ("<stiffness>3000.0<", "<stiffness>-3<", "stiffness is -3; give more than 0"),
    "friction": ("<static_friction>0.9<", "<static_friction>-1<", "static_friction is -1; give 0 or more"),
    "frame": ("/bodyset/foot</socket_frame><location>0.1 ", "/bodyset/fot</socket_frame><location>0.1 ",
              'there is no frame "/bodyset/fot"'),
    "number": ("<dissipation>0.3<", "<dissipation>much<", 'dissipation is "much"'),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_contact_is_one_clear_error(fault: str, tmp_path: Path) -> None:
    """With file and line."""
    check_fault(CASES["smooth"], *FAULTS[fault], tmp_path)


if __name__ == "__main__":
    write_answers(CASES, REFERENCE)
