"""Studies of OpenSim Moco, imported and solved: Moco's optima in tests/reference/moco, omissions, faults.

`python -m tests.mbsrun.ocp.test_moco_studies` writes the studies and their costs anew, by the Python of MBSGEN_OPENSIM.
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

import mbsrun
from mbsgen.cli import cli
from mbsgen.errors import InputError
from mbsgen.importing import Choices, import_model
from mbsgen.importing.findings import Findings
from mbsgen.importing.omoco.problem import write_problem
from mbsgen.importing.omoco.study import Study, match_pattern, read_study
from tests import opensim

REFERENCE = Path(__file__).parents[2] / "reference" / "moco"
COSTS = json.loads((REFERENCE / "costs.json").read_text("utf-8"))
SAME = 1e-6  # relative: Moco's tolerance is 1e-7


def read(name: str, folder: Path, *changes: tuple[str, str]) -> tuple[str, Findings]:
    """Return the problem file of a changed study, and the findings; the folder gets its tables and its model."""
    study, findings = _read_both(name, folder, *changes)
    return write_problem(study, f"{name}.yaml", findings), findings


def _read_both(name: str, folder: Path, *changes: tuple[str, str]) -> tuple[Study, Findings]:
    text = (REFERENCE / f"{name}.omoco").read_text("utf-8")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    for table in ("states.sto", "tip.trc"):
        shutil.copy(REFERENCE / table, folder)
    path = folder / f"{name}.omoco"
    path.write_text(text, "utf-8")
    findings = Findings(str(path))
    return read_study(path, Choices(), findings), findings


BALL = """<BallJoint name="b"><socket_parent_frame>/bodyset/b0</socket_parent_frame><socket_child_frame>/bodyset/c
</socket_child_frame><coordinates><Coordinate name="x" /><Coordinate name="y" /><Coordinate name="z" /></coordinates>
</BallJoint>"""
BODY = '<Body name="c"><mass>1</mass><mass_center>0 0 0</mass_center><inertia>1 1 1 0 0 0</inertia></Body>'


def add_ball(*infos: tuple[str, str, str]) -> list[tuple[str, str]]:
    """Make the changes that put a ball at the end of a pendulum, with bounds and values at the start of its speeds."""
    shown = "".join(
        f'<MocoVariableInfo name="/jointset/b/{name}"><bounds>{bounds}</bounds><initial_bounds>{start}</initial_bounds>'
        "</MocoVariableInfo>"
        for name, bounds, start in infos
    )
    return [("<PinJoint", BALL + "<PinJoint"), ("<Body ", BODY + "<Body "), ("<state_infos>", f"<state_infos>{shown}")]


def list_warnings(findings: Findings, text: str) -> list[int]:
    """Return the lines of the warnings that hold a text."""
    return [x.line for x in findings.notices if text in x.text and x.alters]


def test_each_muscle_keeps_its_bounds_along_the_path(tmp_path: Path) -> None:
    """One range holds all; narrower ones are constraints, and an activation without bounds has its excitation's."""
    text, findings = read("lift", tmp_path)
    assert "muscles: {excitation: [0.0, 1.0], rise: 0.015, fall: 0.06, effort: 0}" in text
    for name, low, high in (("front", 0.02, 0.06), ("middle", 0.05, 0.9), ("middle_excitation", 0.05, 0.9)):
        assert f"  - {{expression: {name}, range: [{low}, {high}]}}\n" in text
    assert "{expression: back" not in text
    assert not [x for x in findings.notices if x.alters]


def test_each_muscle_has_its_own_activation_dynamics(tmp_path: Path) -> None:
    """The smooth law or the sharp one, with numbers of the file or of OpenSim's classes, or none."""
    for name, own in (("sharp", '"upper": {rise: 0.01, fall: 0.04, sharp: true}'), ("direct", '"back": {}')):
        text, findings = read(name, tmp_path)
        assert f"rise: 0.03, fall: 0.05, effort: 0, own: {{{own}}}}}\n" in text
        assert not [x for x in findings.notices if "time constants" in x.text]
    constant = "<activation_time_constant>0.029999999999999999<"
    text, findings = read("direct", tmp_path, (constant, constant.replace("0.029999999999999999", "0.02")))
    assert '"middle": {rise: 0.03, fall: 0.05}' in text
    assert len([x for x in findings.notices if "in one process of OpenSim 4.6 all have the ones" in x.text]) == 1
    with pytest.raises(InputError, match=r"time constants of -1 and 0\.05 s; give more than 0"):
        read("direct", tmp_path, (constant, constant.replace("0.029999999999999999", "-1")))


def test_muscles_that_are_left_out_are_named(tmp_path: Path) -> None:
    """Their bounds, weights and pairs have warnings with lines, and are no faults."""
    point = '<PathPoint name="front_0">'
    wrap = (
        '<PathWrapSet><objects><PathWrap name="w"><wrap_object>w</wrap_object></PathWrap></objects></PathWrapSet>'
        "<PathPointSet>"
    )
    shape = '<WrapObjectSet><objects><WrapSphereObst name="w" /></objects></WrapObjectSet>'
    text = (REFERENCE / "lift.omoco").read_text("utf-8")
    start = text.index(point)
    held = text.rindex("<PathPointSet>", 0, start)
    changed = text[:held] + wrap + text[held + len("<PathPointSet>") :]
    changed = changed.replace('<Ground name="ground">', f'<Ground name="ground">{shape}')
    (tmp_path / "lift.omoco").write_text(changed, "utf-8")
    findings = Findings("lift.omoco")
    problem = write_problem(read_study(tmp_path / "lift.omoco", Choices(), findings), "lift.yaml", findings)
    assert "front" not in problem
    assert len(list_warnings(findings, "its muscle is not in the model: these bounds are left out")) == 2


def test_bounds_of_muscles_wider_than_the_problems_are_named(tmp_path: Path) -> None:
    name = '<MocoVariableInfo name="/forceset/front">'
    wide = (name, f"{name}<bounds>0 inf</bounds>")
    lines = list_warnings(read("lift", tmp_path, wide)[1], "the excitation stays between 0 and 1 in the problem")
    assert lines == [_find_line("lift", name)]


def test_bounds_of_an_elastic_tendon_are_constraints(tmp_path: Path) -> None:
    soft = [("<ignore_tendon_compliance>true", "<ignore_tendon_compliance>false")]
    info = '<MocoVariableInfo name="/forceset/front/activation">'
    for bounds, wanted, warned in (("0.1 1.5", "[0.1, 1.5]", 0), ("0.1 7", "[0.1, null]", 1)):
        own = info.replace("activation", "normalized_tendon_force") + f"<bounds>{bounds}</bounds></MocoVariableInfo>"
        text, findings = read("lift", tmp_path, *soft, (info, own + info))
        assert f"  - {{expression: front_tendon, range: {wanted}}}\n" in text
        assert len(list_warnings(findings, "the state of its tendon stays between 0 and 5")) == warned


def test_damping_of_explicit_tendons_is_named(tmp_path: Path) -> None:
    """OpenSim 4.6: the rate of normalised tendon force is the same with any damping; `lift` has explicit dynamics."""
    soft = ("<ignore_tendon_compliance>true", "<ignore_tendon_compliance>false")
    assert len(list_warnings(read("lift", tmp_path, soft)[1], "have no fibre damping in OpenSim")) == 1
    assert not list_warnings(read("elastic", tmp_path)[1], "have no fibre damping in OpenSim")


def test_an_initial_equilibrium_of_tendons_holds_anyway(tmp_path: Path) -> None:
    for mode, wanted in (("", "begin in equilibrium without it"), ("<mode>cost</mode>", "as a cost is not read")):
        tag = "MocoInitialForceEquilibriumDGFGoal"
        goal = f'<goals><{tag} name="still">{mode}</{tag}>'
        assert [x for x in read("elastic", tmp_path, ("<goals>", goal))[1].notices if wanted in x.text]


def test_bounds_of_angular_velocities_are_named(tmp_path: Path) -> None:
    """A ball's speeds are angular velocities in OpenSim; both are zero together."""
    zero = [(f"{k}/speed", "0", "0") for k in "xyz"]
    rates = "are angular velocities in the study, but rates of turns"
    assert not list_warnings(read("repeat", tmp_path, *add_ball(*zero))[1], rates)
    findings = read("repeat", tmp_path, *add_ball(*zero[:2], ("z/speed", "-3 4", "0")))[1]
    assert len(list_warnings(findings, rates)) == 3  # each component of one reads all three of the other
    # the usual bounds of speeds
    assert list_warnings(read("repeat", tmp_path, *add_ball())[1], rates) == [_find_line("repeat", "<MocoPhase")]


def test_goals_over_angular_velocities_are_named(tmp_path: Path) -> None:
    squares = '<MocoSumSquaredStateGoal name="s"><pattern>.*/[xq].*speed</pattern></MocoSumSquaredStateGoal>'
    zero = [(f"{k}/speed", "0", "0") for k in "xyz"]
    findings = read("repeat", tmp_path, *add_ball(*zero), ("<goals>", f"<goals>{squares}"))[1]
    assert len(list_warnings(findings, "are angular velocities in the study")) == 1


def test_a_study_and_its_model_have_names(tmp_path: Path) -> None:
    """A model without a name is called so, with a notice; a problem file without a name would hide its model."""
    found = _read_both("swing", tmp_path, ('<Model name="pendulum"', '<Model name=""'))[0]
    assert found.imported.model.name == "model"
    assert [x.line > 0 for x in found.imported.notices if 'it has no name: called "model"' in x.text] == [True]
    done = CliRunner().invoke(cli, ["import", str(REFERENCE / "swing.omoco"), "-o", str(tmp_path / ".ocp.yaml")])
    assert done.exit_code == 2
    assert "a study makes two files: give -o swing.ocp.yaml" in done.output


def test_faults_have_the_order_of_their_lines(tmp_path: Path) -> None:
    """A second coordinate of a name comes before the actuator that misses the other one."""
    with pytest.raises(InputError) as caught:
        read("swing", tmp_path, ('<Coordinate name="q1"', '<Coordinate name="q0"'))
    assert ["a second coordinate" in x.finding for x in caught.value.faults] == [True, False]
    assert [x.line for x in caught.value.faults] == sorted(x.line for x in caught.value.faults)


def _find_line(name: str, text: str) -> int:
    """Return the line of a text in a study."""
    lines = (REFERENCE / f"{name}.omoco").read_text("utf-8").splitlines()
    return next(k for k, line in enumerate(lines, 1) if text in line)


@pytest.mark.parametrize("name", COSTS)
def test_optima_are_mocos(name: str, tmp_path: Path) -> None:
    """The same transcription on the same mesh: final time, effort, markers, squares, places, periods."""
    for table in ("states.sto", "tip.trc"):
        shutil.copy(REFERENCE / table, tmp_path)
    out = tmp_path / f"{name}.ocp.yaml"
    done = CliRunner().invoke(cli, ["import", str(REFERENCE / f"{name}.omoco"), "-o", str(out)])
    assert done.exit_code == 0, done.output
    solution = mbsrun.read_problem(out).solve()
    assert solution.status == "Solve_Succeeded"
    assert solution.cost == pytest.approx(COSTS[name], rel=SAME)


def test_states_are_tracked_from_the_start_of_the_motion(tmp_path: Path) -> None:
    """The table begins before the motion, whose angles it has at its own times."""
    text, findings = read("track", tmp_path)
    assert not [x for x in findings.notices if x.alters]
    path = '"/jointset/j0/q0/value"'
    assert f"  states_1: {{file: states.sto, start: 0.0, columns: {{column_1: {path}}}}}" in text
    assert '{expression: "(q_q0 - ref_states_1_column_1)**2", weight: 30.0}' in text


def test_a_slider_of_loose_components_is_read(tmp_path: Path) -> None:
    """The joint and the actuator stand in <components> of the model, and not in sets."""
    text = (REFERENCE / "sliding_mass.omoco").read_text("utf-8")
    model = re.search(r"<Model .*</Model>", text, re.DOTALL)
    assert model is not None
    (tmp_path / "slider.osim").write_text(f'<OpenSimDocument Version="40600">{model[0]}</OpenSimDocument>', "utf-8")
    found = import_model(tmp_path / "slider.osim")
    joints = [(joint.name, joint.actuated) for body in found.model.bodies for joint in body.joints]
    assert joints == [("position", True)]
    assert not [x for x in found.notices if x.alters]


def test_grids_are_mocos(tmp_path: Path) -> None:
    hermite = "<transcription_scheme>hermite-simpson<"
    for scheme, wanted in (
        ("trapezoidal", "scheme: lobatto\ndegree: 2\ninputs: linear"),
        ("legendre-gauss-4", "scheme: legendre\ndegree: 4\ninputs: linear"),
        ("legendre-gauss-radau-2", "scheme: radau\ndegree: 2\ninputs: linear"),
    ):
        assert wanted in read("swing", tmp_path, (hermite, hermite.replace("hermite-simpson", scheme)))[0]
    mesh = ("<num_mesh_intervals>20</num_mesh_intervals>", "<mesh>0 0.25 1</mesh>")
    assert "intervals: [0.25, 0.75]" in read("swing", tmp_path, mesh)[0]


LEFT_OUT = {
    "goal": ("swing", "MocoFinalTimeGoal", "MocoJointReactionGoal", "this goal has no counterpart that is written"),
    "exponent": ("repeat", "<exponent>4", "<exponent>3", "an exponent of 3 is not read, only even ones"),
    "mode": ("swing", "<weight>0.29999999999999999", "<mode>endpoint_constraint</mode><weight>1", "as a constraint"),
    "setting": ("swing", "<weight>0.29999999999999999", "<other>3</other><weight>1", "this setting of a goal is not"),
    "displacement": (
        "repeat",
        "<divide_by_duration>",
        "<divide_by_displacement>true</divide_by_displacement><divide_by_duration>",
        "this setting of a goal is not read",
    ),
    "table": ("track", "states.sto", "other.sto", 'there is no "other.sto" in the folder of the study: left out'),
    "paths": ("swing", "<goals>", "<path_constraints><A><b>1</b></A></path_constraints><goals>", "not part of the"),
    "operator": ("swing", "<model>", "<operators><ModOpAddReserves /></operators><model>", "is not made: change"),
    "solver": ("swing", "<optim_conv", "<minimize_lagrange_multipliers>true</minimize_lagrange_multipliers><optim_conv",
               "it is not part of the problem"),
}  # fmt: skip


@pytest.mark.parametrize("case", LEFT_OUT)
def test_what_has_no_counterpart_is_named_with_its_line(case: str, tmp_path: Path) -> None:
    name, old, new, wanted = LEFT_OUT[case]
    found = [x for x in read(name, tmp_path, *_change(old, new))[1].notices if wanted in x.text]
    assert found
    assert found[0].alters
    assert found[0].line > 0


def _change(old: str, new: str) -> list[tuple[str, str]]:
    """Change a tag where it begins and where it ends."""
    return [(old, new), (f"</{old}>", f"</{new}>")] if re.fullmatch(r"\w+Goal", old) else [(old, new)]


FAULTS = {
    "variable": ("swing", "/jointset/j0/q0/value", "/jointset/j0/q/value", 'no variable "/jointset/j0/q/value"; did'),
    "weight": ("swing", 'MocoWeight name="/forceset/tau1', 'MocoWeight name="/forceset/tau3', "did you mean"),
    "pattern": ("swing", "/jointset/.*/speed", "(a*)*b", 'the pattern "(a*)*b" is not read; name each variable'),
    "bounds": ("swing", "<bounds>-10 10<", "<bounds>10 -10<", "bounds from 10 to -10; swap them"),
    "three": ("swing", "<bounds>-10 10<", "<bounds>1 2 3<", "3 bounds; give one value, or a lower and an upper"),
    "words": ("swing", "<bounds>-10 10<", "<bounds>a b<", "bounds is"),
    "scheme": ("swing", "hermite-simpson", "euler", 'the scheme "euler" is not read; give trapezoidal, hermite'),
    "intervals": ("swing", "mesh_intervals>20", "mesh_intervals>2.5", "2.5 intervals; give a whole number"),
    "mesh": ("swing", "<num_mesh_intervals>20</num_mesh_intervals>", "<mesh>0 1 0.5</mesh>", "does not increase"),
    "initial": ("swing", "<bounds>0</bounds>", "<bounds>0 1</bounds>", "the initial time is free; give one value"),
    "final": ("swing", "<bounds>1.5</bounds>", "<bounds>-1</bounds>", "the motion lasts from -1 to -1 s"),
    "marker": ("reach", "/markerset/tip", "/markerset/top", 'there is no marker "top"; did you mean "tip"?'),
    "pair": ("repeat", "<initial_variable>/jointset/j0/q0/value", "<initial_variable>/q0", "there is no variable"),
    "force": ("swing", "<optimal_force>1<", "<optimal_force>0<", "its optimal_force is 0; give a force"),
    "second": ("swing", "<coordinate>q1", "<coordinate>q0", "a second actuator of q0"),
    "model": ("swing", "<mass>1</mass>", "<mass>-1</mass>", "mass"),
    "kind": ("swing", "<MocoStudy ", "<MocoStdy ", "and no <MocoStudy>; give a study's file"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_have_a_line_a_finding_and_a_remedy(fault: str, tmp_path: Path) -> None:
    name, old, new, wanted = FAULTS[fault]
    changes = [(old, new)] if fault != "kind" else [(old, new), ("</MocoStudy>", "</MocoStdy>")]
    with pytest.raises(InputError) as caught:
        read(name, tmp_path, *changes)
    assert wanted.replace('"', "") in str(caught.value).replace('"', ""), str(caught.value)
    assert re.search(r"\.omoco:\d+: ", str(caught.value))


def test_a_model_is_named_beside_the_study_alone(tmp_path: Path) -> None:
    text = (REFERENCE / "repeat.omoco").read_text("utf-8")
    model = re.search(r"<model>\s*(<Model .*</Model>)\s*</model>", text, re.DOTALL)
    assert model is not None
    (tmp_path / "leg.osim").write_text(f'<OpenSimDocument Version="40600">{model[1]}</OpenSimDocument>', "utf-8")
    whole = read("repeat", tmp_path)[0]
    assert read("repeat", tmp_path, (model[0], "<filepath>leg.osim</filepath>"))[0] == whole
    for name, wanted in (("../leg.osim", "outside its folder"), ("leg2.osim", "there is no such file")):
        with pytest.raises(InputError, match=wanted):
            read("repeat", tmp_path, (model[0], f"<filepath>{name}</filepath>"))


def test_a_study_is_no_model_and_makes_two_files(tmp_path: Path) -> None:
    path = shutil.copy(REFERENCE / "swing.omoco", tmp_path)
    for arguments in (["import", str(path)], ["import", str(path), "-o", str(tmp_path / "model.yaml")]):
        done = CliRunner().invoke(cli, arguments)
        assert done.exit_code == 2
        assert "a study makes two files: give -o swing.ocp.yaml" in done.output
    with pytest.raises(InputError, match="and no model; make a problem and its model: mbsgen import"):
        import_model(Path(path))


def test_patterns_match_whole_names_and_end_soon() -> None:
    paths = ["/a/value", "/a/speed", "/b/speed"]
    assert match_pattern(".*speed", paths) == paths[1:]
    assert match_pattern("/[ab]/(value|speed)", paths) == paths
    assert match_pattern("(a+)+", paths) is match_pattern("(" * 3, paths) is match_pattern(".*.*.*.*.*x", paths) is None


if __name__ == "__main__":
    script = Path(__file__).with_name("moco_studies.py")
    found = json.loads(opensim.ask(script, folder=REFERENCE))
    (REFERENCE / "costs.json").write_text(json.dumps(found) + "\n", "utf-8")
