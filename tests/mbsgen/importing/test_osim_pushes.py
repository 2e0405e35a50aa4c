"""Bushings, actuators of bodies and prescribed forces of OpenSim: against its numbers in tests/reference; faults.

`python -m tests.mbsgen.importing.test_osim_pushes` writes the numbers anew, by the Python of MBSGEN_OPENSIM.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from mbsgen.importing import Choices, import_model, write_imported
from mbsgen.model.reader import read_model
from mbsgen.osim_comparison import compare_with_opensim
from tests.mbsgen.importing.osim_files import check_fault, save, write_answers
from tests.mbsgen.importing.osim_push_files import CASES

REFERENCE = Path(__file__).parents[2] / "reference" / "opensim_pushes.json"
ROUNDING = 1e-12  # relative
GLOBAL = "<point_is_global>true</point_is_global><force_is_global>"
SEEN = 1e-3  # relative: of these forces in inverse dynamics


@pytest.mark.parametrize("name", CASES)
def test_pushes_are_opensims(name: str, tmp_path: Path) -> None:
    """Inverse dynamics at random states and controls; without these forces they differ."""
    answer = json.loads(REFERENCE.read_text("utf-8"))[name]
    found = compare_with_opensim(save(tmp_path, CASES[name]), Choices(), lambda *_: answer)
    assert max(found.misses.values()) < ROUNDING, found.misses
    bare = re.sub(r"<ForceSet.*</ForceSet>", "", CASES[name], flags=re.DOTALL)
    assert compare_with_opensim(save(tmp_path, bare), Choices(), lambda *_: answer).misses["tau"] > SEEN


@pytest.mark.parametrize("name", ["curves", "torques", "points", "prescribed"])
def test_pushes_are_written_and_read_again(name: str, tmp_path: Path) -> None:
    found = import_model(save(tmp_path, CASES[name]))
    (tmp_path / "model.yaml").write_text(write_imported(found), "utf-8")
    assert read_model(tmp_path / "model.yaml") == found.model


def test_actuators_have_signals_and_leave_joints_without_inputs(tmp_path: Path) -> None:
    model = import_model(save(tmp_path, CASES["points"])).model
    body = tuple(f"body_{kind}{axis}" for kind in "mf" for axis in "xyz")
    assert {"own", "mixed", "ground", "pair", *body} < {*model.signals}
    assert not any(joint.actuated for x in model.bodies for joint in x.joints)


@pytest.mark.parametrize(
    ("name", "old", "new", "wanted"),
    [
        ("formulas", "theta_z-theta_x", "select(theta_z)", "select() is not read: its force is left out"),
        (
            "curves",
            "SimmSpline",
            "PiecewiseConstantFunction",
            "its function PiecewiseConstantFunction is not read: its force is left out",
        ),
        ("points", f"{GLOBAL}true", f"{GLOBAL}false", "its place is in the ground's, and its force in the body's"),
        ("prescribed", "<forceIsGlobal>false", "<forceIsGlobal>true", "its place is in the body's frame, and"),
        ("points", "<pointA>", "<points_are_global>true</points_are_global><pointA>", "points are in the ground's"),
        ("bushing", "_stiffness>", "_stuff>", "it has no stiffness and no damping: left out"),
        ("torques", "<bodyA>hand</bodyA><bodyB>ball", "<bodyA>ball</bodyA><bodyB>ball", "both of its bodies are one"),
    ],
)
def test_what_is_not_read_is_named(name: str, old: str, new: str, wanted: str, tmp_path: Path) -> None:
    text = CASES[name].replace("_damping>", "_drag>") if name == "bushing" else CASES[name]
    assert old in text
    found = import_model(save(tmp_path, text.replace(old, new)))
    assert [x for x in found.notices if wanted in x.text], [x.text for x in found.notices]


FAULTS: dict[str, tuple[str, str, str, str]] = {
    "frame": ("bushing", "<socket_frame1>end1", "<socket_frame1>end3", 'there is no frame "end3"; did you mean'),
    "body": ("old", "<body_1>ball", "<body_1>bal", 'there is no body "bal"; did you mean "ball"?'),
    "torque": ("torques", "<bodyB>ball", "<bodyB>head", 'there is no body "head"; did you mean "hand"?'),
    "axis": ("torques", "<axis>1 2 0.5", "<axis>0 0 0", "axis has no direction; give three numbers, not all 0"),
    "direction": ("points", "<direction>1 2 3", "<direction>0 0 0", "direction has no direction; give three numbers"),
    "three": ("prescribed", "<Constant><value>2</value></Constant>", "", "forceFunctions has 2 functions; give three"),
    "stiffness": ("bushing", "11 12 13", "11 12", "rotational_stiffness"),
    "size": ("torques", "<optimal_force>20", "<optimal_force>big", "optimal_force"),
    "socket": ("points", "<socket_body>/bodyset/hand", "<socket_body>/bodyset/hnd", "there is no frame"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_have_a_line_a_finding_and_a_remedy(fault: str, tmp_path: Path) -> None:
    name, old, new, wanted = FAULTS[fault]
    check_fault(CASES[name], old, new, wanted, tmp_path)


if __name__ == "__main__":
    write_answers(CASES, REFERENCE)
