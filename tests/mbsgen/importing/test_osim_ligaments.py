"""Ligaments, forces between points and formulas of OpenSim: against its numbers in tests/reference; faults.

`python -m tests.mbsgen.importing.test_osim_ligaments` writes the numbers anew, by the Python of MBSGEN_OPENSIM.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from mbsgen.expressions import write
from mbsgen.importing import Choices, import_model, write_imported
from mbsgen.model.reader import read_model
from mbsgen.osim_comparison import compare_with_opensim
from tests.mbsgen.importing.osim_files import Link, check_fault, save, write_answers, write_model
from tests.mbsgen.importing.osim_muscle_files import fixed, line, numbers

REFERENCE = Path(__file__).parents[2] / "reference" / "opensim_ligaments.json"
ROUNDING = 1e-10  # relative: digits that cancel in the cubes of a ligament's spline
SEEN = 1e-3  # relative: of these forces in inverse dynamics
LINKS = (Link("tibia", "UniversalJoint", "ground", ("a", "b")), Link("foot", "PinJoint", "tibia", ("ankle",)))
POLYGON = (
    '<PiecewiseLinearFunction name="force_length_curve"><x>0.9 1 1.2 2</x><y>0 0 0.3 3</y></PiecewiseLinearFunction>'
)


def _points(version: int, *, by_name: bool = False) -> str:
    """Write two points; some forces name bodies in all versions."""
    if version < 40000 or by_name:
        ends = "<body1>tibia</body1><body2>foot</body2>"
    else:
        ends = "<socket_body1>/bodyset/tibia</socket_body1><socket_body2>/bodyset/foot</socket_body2>"
    return f"{ends}<point1>0.1 0 0</point1><point2>0 0.1 0.3</point2>"


def write_passive(version: int = 40000) -> str:
    """Ligaments that are slack, in their toe and beyond it at usual poses; springs and formulas between points."""
    ends = fixed("p", "ground", "0.2 0.1 0", version), fixed("q", "tibia", "0.1 0 0", version)
    path = ends[0] + ends[1] + fixed("r", "foot", "0.1 -0.2 0.1", version)
    short = ends[0] + fixed("r", "foot", "0.1 -0.2 0.1", version)
    points, named = _points(version), _points(version, by_name=True)
    formula = "<coordinate>ankle</coordinate><expression>-2*q^3 + sin(q*qdot) - 0.3*qdot</expression>"
    rows = [line("Ligament", f"rest{x}", path, numbers(resting_length=x, pcsa_force=100)) for x in (0.9, 1.05, 1.15)]
    rows += [line("Ligament", "polygon", short, numbers(resting_length=0.9, pcsa_force=80) + POLYGON)]
    for slack in (1, 1.05, 1.137, 1.2):  # m, where the line has 1.07 to 1.15
        given = numbers(slack_length=slack, linear_stiffness=900, damping_coefficient=3, transition_strain=0.1)
        rows.append(line("Blankevoort1991Ligament", f"slack{slack}", short, given))
    rows += [
        f'<PointToPointSpring name="spring">{points}{numbers(stiffness=150, rest_length=0.4)}</PointToPointSpring>',
        f'<ExpressionBasedPointToPointForce name="pull">{named}'
        "<expression>3*d^2 - ddot</expression></ExpressionBasedPointToPointForce>",
        f'<ExpressionBasedCoordinateForce name="formula">{formula}</ExpressionBasedCoordinateForce>',
        line("PathActuator", "rope-1", short, numbers(optimal_force=50)),
    ]
    return write_model(LINKS, version=version, forces="".join(rows))


CASES = {"new": write_passive(), "old": write_passive(30000)}


@pytest.mark.parametrize("name", CASES)
def test_passive_forces_are_opensims(name: str, tmp_path: Path) -> None:
    """Inverse dynamics, lengths, rates and arms at random states; without these forces, inverse dynamics differ."""
    answer = json.loads(REFERENCE.read_text("utf-8"))[name]
    found = compare_with_opensim(save(tmp_path, CASES[name]), Choices(), lambda *_: answer)
    assert len(found.lines) == 11
    assert not found.absent
    assert max(found.misses.values()) < ROUNDING, found.misses
    bare = re.sub(r"<ForceSet.*</ForceSet>", "", CASES[name])
    assert compare_with_opensim(save(tmp_path, bare), Choices(), lambda *_: answer).misses["tau"] > SEEN


def test_they_are_written_and_read_again(tmp_path: Path) -> None:
    found = import_model(save(tmp_path, CASES["new"]))
    (tmp_path / "model.yaml").write_text(write_imported(found), "utf-8")
    assert read_model(tmp_path / "model.yaml") == found.model


def test_a_rope_pulls_by_a_signal_and_leaves_joints_without_inputs(tmp_path: Path) -> None:
    model = import_model(save(tmp_path, CASES["new"])).model
    rope = next(x for x in model.forces if x.name == "rope-1")
    assert (write(rope.force), model.signals) == ("50*rope_1", ("rope_1",))
    assert not any(joint.actuated for body in model.bodies for joint in body.joints)


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("sin(q*qdot)", "select(q,1,2)", "since select() is not read: its force is left out"),
        ("sin(q*qdot)", "speed", "since speed is none of q, qdot: its force is left out"),
        ("3*d^2 - ddot", "3*(d", "its force is left out"),
        ("<y>0 0 0.3 3</y>", "<y>0 0.1 0.3 3</y>", "its curve is not 0 at its resting length"),
    ],
)
def test_what_is_not_read_is_left_out_with_a_warning(old: str, new: str, wanted: str, tmp_path: Path) -> None:
    text = CASES["new"]
    assert old in text
    found = import_model(save(tmp_path, text.replace(old, new)))
    assert [x for x in found.notices if x.alters and wanted in x.text], [x.text for x in found.notices]
    known = len(found.model.forces) + sum("q" in write(j.law.force) for b in found.model.bodies for j in b.joints)
    assert known == 11


FAULTS = {
    "rest": ("<resting_length>1.05<", "<resting_length>0<", "resting_length is 0; give more than 0"),
    "slack": ("<slack_length>1<", "<slack_length>-1<", "slack_length is -1; give more than 0"),
    "toe": ("<transition_strain>0.1<", "<transition_strain>0<", "transition_strain is 0; give more than 0"),
    "damping": ("<damping_coefficient>3<", "<damping_coefficient>-3<", "damping_coefficient is -3; give 0 or more"),
    "body": ("<socket_body2>/bodyset/foot<", "<socket_body2>/bodyset/fot<", 'no frame "/bodyset/fot"; did you mean'),
    "coordinate": ("<coordinate>ankle<", "<coordinate>ancle<", 'no coordinate "ancle"; did you mean "ankle"?'),
    "number": ("<rest_length>0.4<", "<rest_length>short<", 'rest_length is "short"'),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_force_is_one_clear_error(fault: str, tmp_path: Path) -> None:
    """With file and line."""
    check_fault(CASES["new"], *FAULTS[fault], tmp_path)


if __name__ == "__main__":
    write_answers(CASES, REFERENCE)
