"""Muscles of OpenSim's models: against OpenSim's numbers, which ship in tests/reference; and what is refused.

`python -m tests.mbsgen.importing.test_osim_muscles` writes the numbers anew, by the Python of MBSGEN_OPENSIM.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from mbsgen.cli import cli
from mbsgen.errors import InputError
from mbsgen.expressions import Name, Number, write
from mbsgen.importing import Choices, import_model, write_imported
from mbsgen.model.reader import read_model
from mbsgen.osim_comparison import AROUND, PULLS, SHAPED, compare_with_opensim
from tests import peers
from tests.mbsgen.importing.osim_files import save, write_answers
from tests.mbsgen.importing.osim_muscle_files import CASES, around

PATHS = ("lengths", "rates", "arms")
METHODS = ("hybrid", "midpoint", "axial")
LINES = {
    "shaped": (*(f"{x}_{k}" for x in ("egg", "behind") for k in METHODS), "ring", "half", "three"),
    "wrapped": ("front", "behind", "near", "ball", "cap", "three", "range", "two"),
}
REFERENCE = Path(__file__).parents[2] / "reference" / "opensim_paths.json"
ROUNDING = 1e-11  # relative: digits that cancel in the cubes of a knee's spline


SUMS = 1e-5  # relative: OpenSim adds chords of a millimetre of an ellipse
CHANGES = 1e-3  # relative: differences of such sums


@pytest.mark.parametrize("name", [x for x in CASES if x != "shaped"])
def test_lengths_and_arms_are_opensims(name: str, tmp_path: Path) -> None:
    """Masses, forces, places, lengths, rates and arms at random states.

    Points are fixed, conditional and moving; lines wrap around spheres, and around cylinders across their plane.
    """
    answer = json.loads(REFERENCE.read_text("utf-8"))[name]
    found = compare_with_opensim(save(tmp_path, CASES[name]), Choices(), lambda *_: answer)
    assert found.lines == LINES.get(name, ("long", "two-joints", "short.1", "rigid", "strap"))
    assert not found.absent
    assert set(found.misses) - {x + AROUND for x in PATHS} == {"M", "tau", "places", *PATHS}
    assert max(found.misses.values()) < ROUNDING, found.misses


def test_lengths_around_ellipsoids_and_tori_are_opensims(tmp_path: Path) -> None:
    """By all methods, with sides and without; arms are the slopes of OpenSim's lengths, unlike OpenSim's own ones."""
    answer = json.loads(REFERENCE.read_text("utf-8"))["shaped"]
    found = compare_with_opensim(save(tmp_path, CASES["shaped"]), Choices(), lambda *_: answer)
    assert found.agrees
    assert found.lines == LINES["shaped"]
    assert found.misses[f"lengths{SHAPED}"] < SUMS
    assert found.misses[f"arms{SHAPED}"] < CHANGES
    assert found.misses[PULLS] > CHANGES
    assert max(found.misses[key] for key in ("M", "tau", "places")) < ROUNDING


def test_the_reference_is_what_opensim_computes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if "MBSGEN_OPENSIM" not in os.environ:
        if not (peers.FOLDER / "opensim").exists():
            pytest.skip("python -m tests.peers build/peers installs OpenSim")
        monkeypatch.setenv("PYTHONPATH", str(peers.FOLDER))
    path = save(tmp_path, CASES["leg"])
    done = CliRunner().invoke(cli, ["compare", str(path), "--with", "opensim"])
    assert done.exit_code == 0, done.output
    assert "5 muscles and springs along paths" in done.output


def test_muscles_have_the_numbers_that_moco_gives_them(tmp_path: Path) -> None:
    """As its ModOpReplaceMusclesWithDeGrooteFregly2016 (OpenSim 4.6) replaces Millard's and Thelen's muscles."""
    model = import_model(save(tmp_path, CASES["leg"])).model
    muscles = {x.name: x.muscle for x in model.forces}
    two, short, rigid = (muscles[name] for name in ("two-joints", "short.1", "rigid"))
    assert two is not None
    assert short is not None
    assert rigid is not None
    assert (two.damping, two.passive, two.tendon_strain) == (Number(0.05), Number(0.65), Number(0.04))
    assert (short.damping, short.passive, short.tendon_strain) == (Number(0), Number(0.5), Number(0.033))
    assert (two.activation, two.tendon_state) == (Name("two_joints"), Name("two_joints_tendon"))
    assert rigid.tendon_state is None
    strap = next(x for x in model.forces if x.name == "strap")
    assert write(strap.force) == "250*max(length - 0.3, 0)*(1 + 0.1*rate)"
    assert model.signals == ("long", "two_joints", "two_joints_tendon", "short_1", "short_1_tendon", "rigid")
    assert not any(joint.actuated for body in model.bodies for joint in body.joints)


def test_muscles_are_written_and_read_again(tmp_path: Path) -> None:
    found = import_model(save(tmp_path, CASES["leg"]))
    (tmp_path / "model.yaml").write_text(write_imported(found), "utf-8")
    assert read_model(tmp_path / "model.yaml") == found.model


def test_a_path_around_what_is_not_read_is_left_out_with_a_warning(tmp_path: Path) -> None:
    """A surface of another kind, a cylinder along whose axis the line stays, two surfaces between the same points."""
    ball = around("ball")
    text = CASES["wrapped"].replace("<quadrant>-x<", "<quadrant>z<").replace(around("any", "2 3"), ball + ball)
    text = text.replace('<WrapSphere name="cap"', '<WrapSphereObst name="cap"')
    text = text.replace("</WrapSphere></objects>", "</WrapSphereObst></objects>")
    found = import_model(save(tmp_path, text))
    assert [x.name for x in found.model.forces] == ["front", "near", "ball", "three"]
    warned = [x.text for x in found.notices if x.alters and "its path wraps around" in x.text]
    for part, count in (("a WrapSphereObst", 2), ("a side along its axis", 1), ("between the same points", 1)):
        assert sum(part in x for x in warned) == count, warned


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("<range>2 3<", "<range>3 3<", "a range from point 3 to 3 of 3; give the numbers of two of its points"),
        ("<wrap_object>ball<", "<wrap_object>bal<", 'there is no surface "bal"; did you mean "ball"?'),
        ("<quadrant>-x<", "<quadrant>w<", 'a quadrant "w"; give all, x, -x'),
        ("<radius>0.1<", "<radius>-0.1<", "a radius or a length of 0 or less; give more than 0"),
    ],
)
def test_a_faulty_surface_is_one_clear_error(old: str, new: str, wanted: str, tmp_path: Path) -> None:
    text = CASES["wrapped"]
    assert old in text
    with pytest.raises(InputError, match=re.escape(wanted)):
        import_model(save(tmp_path, text.replace(old, new)))


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("<dimensions>0.1 0.07 0.12<", "<dimensions>0.1 0.07<", "dimensions has 2 numbers"),
        (
            "<dimensions>0.1 0.07 0.12<",
            "<dimensions>0.1 0 0.12<",
            "a radius or a length of 0 or less; give more than 0",
        ),
        ("<outer_radius>0.06<", "<outer_radius>0.01<", "an outer_radius of 0.01; give more than 0.02"),
        ("<method>midpoint<", "<method>middle<", 'a method "middle"; give hybrid, midpoint, axial'),
    ],
)
def test_a_faulty_shape_is_one_clear_error(old: str, new: str, wanted: str, tmp_path: Path) -> None:
    text = CASES["shaped"]
    assert old in text
    with pytest.raises(InputError, match=re.escape(wanted)):
        import_model(save(tmp_path, text.replace(old, new)))


FAULTS: dict[str, tuple[str, str, str]] = {
    "point": ("MovingPathPoint", "MovingPathPiont", 'of the kind "MovingPathPiont"; give one of PathPoint'),
    "frame": ("/bodyset/femur</socket", "/bodyset/femor</socket", 'there is no frame "/bodyset/femor"; did you mean'),
    "coordinate": ("tibia/knee</socket_c", "tibia/kne</socket_c", 'there is no coordinate "kne"; did you mean "knee"?'),
    "range": ("-0.3 0.4</range>", "0.4 -0.3</range>", "a range from 0.4 to -0.3; swap them"),
    "bounds": ("-0.3 0.4</range>", "-0.3</range>", 'range has 1 numbers: "-0.3"; give 2'),
    "function": ("x_location>", "u_location>", "no x_location; give it a function"),
    "strength": (
        "<max_isometric_force>900<",
        "<max_isometric_force>-900<",
        "force is -900; give more than 0",
    ),
    "number": ("<tendon_slack_length>0.15<", "<tendon_slack_length>long<", 'tendon_slack_length is "long"'),
    "path": ("GeometryPath>", "Path>", "no GeometryPath; give the points of its path"),
    "degrees": (
        "<pennation_angle_at_optimal>0.2<",
        "<pennation_angle_at_optimal>12<",
        "is 12 rad; give less than a quarter turn, in rad",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_muscle_is_one_clear_error(fault: str, tmp_path: Path) -> None:
    """With file and line."""
    old, new, wanted = FAULTS[fault]
    text = CASES["leg"]
    assert old in text
    with pytest.raises(InputError) as caught:
        import_model(save(tmp_path, text.replace(old, new)))
    assert wanted in str(caught.value)
    assert "leg.osim:" in str(caught.value)


def test_paths_without_two_ends_are_refused(tmp_path: Path) -> None:
    text = CASES["leg"]
    for old, wanted in (('"long"><GeometryPath><PathPointSet><objects>', "a path of 0 points; give at least two"),):
        start = text.index(old) + len(old)
        changed = text[:start] + text[text.index("</objects>", start) :]
        with pytest.raises(InputError, match=wanted):
            import_model(save(tmp_path, changed))


def test_a_missing_opensim_is_one_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MBSGEN_OPENSIM", str(tmp_path / "python"))
    with pytest.raises(InputError, match="let MBSGEN_OPENSIM name a Python in which"):
        compare_with_opensim(save(tmp_path, CASES["leg"]), Choices())


if __name__ == "__main__":
    write_answers(CASES, REFERENCE)
