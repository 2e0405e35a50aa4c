"""A parameter at run time is the author's number, by the author's path: as if the file were edited there."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from mbsgen.derivatives.dynamics import Dynamics
from mbsgen.formulations import impl
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import ALL, NONE
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.construction import body, fixed, frame, make_model, revolute
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Kind, Tree
from mbsgen.model.writer import write_model
from mbsgen.pipeline import Options, build_parametric, make
from mbsgen.tape.interpreter import DIGITS, evaluate
from tests.number_paths import set_number
from tests.random_scenes import random_model
from tests.shipped import TREES

Array = NDArray[np.float64]
CLOSE = 1e-12  # relative: rounding of some hundred operations, of numbers that are rounded once more


def draw_state(tree: Tree, seed: int) -> dict[str, list[float]]:
    rng = np.random.default_rng(seed)
    n, m = len(tree.joints), sum(joint.actuated for joint in tree.joints)
    w = 3 * sum(v is None for x in tree.wrenches for v in (x.force, x.moment))
    sizes = {"q": len(tree.coordinates), "qd": n, "qdd": n, "u": m, "w": w}
    return {name: list(rng.uniform(-1, 1, size)) for name, size in sizes.items()}


def run(tree: Tree, function: str, at: dict[str, list[float]]) -> dict[str, Array]:
    """Evaluate a function as the textbook writes it: numbers are what is compared, not ways to save operations."""
    tape = FUNCTIONS[function].build(tree, NONE)
    return {name: np.array(x) for name, x in evaluate(tape, {i.name: at[i.name] for i in tape.inputs}).items()}


def fix_parameters(model: Model) -> Model:
    """Make run-time parameters constants: what the file says is what counts."""
    fixed = {Kind.RUNTIME: Kind.CONSTANT}
    return replace(model, parameters=tuple(replace(p, kind=fixed.get(p.kind, p.kind)) for p in model.parameters))


def assert_parameters_are_numbers_of_the_file(text: str, folder: Path, seed: int, *, zeros: bool) -> None:
    """Change every parameter at random, and the file at every path: equations and sensors stay the same.

    Numbers within an expression for a force keep their values: they have no path in the file.
    """
    file, rng = folder / "model.yaml", np.random.default_rng(seed)
    file.write_text(text, encoding="utf-8")
    freed = build_parametric(read_model(file), zeros=zeros)
    data = yaml.safe_load(text) | {"allow_unphysical": True}
    values = []
    for parameter in (p for p in freed.parameters if p.kind is Kind.RUNTIME):
        drawn = float(parameter.value * rng.uniform(0.7, 1.4)) if parameter.value else float(rng.uniform(0.1, 0.3))
        is_within = re.search(r"\.force\.[0-9]+$", parameter.name)
        values.append(parameter.value if is_within else drawn)
        if not is_within:
            set_number(data, parameter.name, drawn)
    assert values
    file.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    tree = build_tree(fix_parameters(read_model(file)))
    design = [p.value for p in freed.parameters if p.kind is Kind.DIFFERENTIATED]
    at = draw_state(tree, seed) | {"p": values, "theta": design}
    for function in ("impl", *(["sensors"] if tree.sensors else [])):
        for name, expected in run(tree, function, at).items():
            found = run(freed, function, at)[name]
            atol = CLOSE * np.abs(expected).max()
            np.testing.assert_allclose(found, expected, rtol=0, atol=atol, err_msg=f"{function}.{name}")


@pytest.mark.parametrize("zeros", [False, True], ids=["", "zeros"])
@pytest.mark.parametrize("file", TREES, ids=lambda file: file.stem)
def test_parameters_are_the_numbers_of_the_models_that_ship(file: Path, zeros: bool, tmp_path: Path) -> None:
    assert_parameters_are_numbers_of_the_file(file.read_text(encoding="utf-8"), tmp_path, 1, zeros=zeros)


@pytest.mark.parametrize("seed", range(12))
def test_parameters_are_the_numbers_of_any_model(seed: int, tmp_path: Path) -> None:
    model = random_model(seed, 3 + seed % 4)
    assert_parameters_are_numbers_of_the_file(write_model(model), tmp_path, seed, zeros=seed % 2 == 1)


TURNED = """\
name: turned
gravity: [0, 0, -9.81]
parameters:
  l: 0.5
  half: l/2          # follows l
  slope: 3           # an axis depends on it: it stays
bodies:
  - name: arm
    joint: {type: revolute, axis: [1, slope, 2], position: [half, 0, 0], limits: [-l, l]}
    mass: 2
    com: [0, 0, -0.4]
    inertia: [0.1, 0.1, 0.02]
  - name: load
    parent: arm
    joint: {type: fixed, position: [0, 0, -0.9], orientation: [{axis: x, angle: 0.3}]}
    mass: 3
  - name: arm 2
    parent: load
    joint: {type: revolute, axis: y, orientation: [{axis: z, angle: pi/2}]}
    mass: 1
    com: [l, 0, 0]
frames:
  - {name: arm, body: arm, position: [0, 0, half]}
"""


FORMS = """\
name: forms
gravity: [0, 0, -9.81]
parameters: {m: {value: 2, kind: runtime}}
bodies:
  - name: base plate
    joint: {type: revolute, axis: y, orientation: {rpy: [0.2, 0, -0.3]}}
    mass: m
    com: [0, 0.2, -0.5]
    inertia: {xx: 0.9, yy: 0.9, zz: 0.3, xy: 0.01, about: [0.1, 0, -0.2]}
  - name: upper
    parent: base plate
    joint:
      {name: elbow, type: dh, convention: standard, a: 0.2, alpha: 0.7, d: 0.3, theta: 0.5, position: [0, 0, -1]}
    mass: 1
    com: [0, 0, -1]
  - name: lower
    parent: upper
    joint: {type: dh, convention: modified, motion: prismatic, a: 0.3, alpha: pi/2, d: 0.1, theta: m/8}
    mass: 1
    com: [0, 0.1, -1]
  - name: wrist
    parent: lower
    joint: # the same as a cardan joint, by other names
      - {name: pitch, type: revolute, axis: y, position: [0, 0, 0.4]}
      - {type: revolute, axis: x, position: [0, 0, 0]}
    mass: 1
    com: [0.1, 0, -0.3]
frames:
  - {name: tip, body: lower, orientation: {rpy: [0.1, 0.2, pi/2]}}
"""


@pytest.mark.parametrize("zeros", [False, True], ids=["", "zeros"])
def test_parameters_are_the_numbers_of_other_forms(zeros: bool, tmp_path: Path) -> None:
    """Tensors about a point move with the centre of mass; rows of tables and roll, pitch and yaw keep their words."""
    assert_parameters_are_numbers_of_the_file(FORMS, tmp_path, 3, zeros=zeros)
    names = {p.name for p in build_parametric(read_model(tmp_path / "model.yaml"), zeros=zeros).parameters}
    assert names >= {
        "base plate.orientation.roll",
        "base plate.orientation.yaw",
        "base plate.inertia.about.x",
        "base plate.inertia.zz",
        "elbow.position.z",
        "pitch.position.z",
        "elbow.a",
        "elbow.alpha",
        "elbow.d",
        "elbow.theta",
        "lower.a",
        "lower.d",
        "frames.tip.orientation.pitch",
    }
    assert not names & {"upper.position.x", "upper.orientation.1", "lower.theta", "base plate.orientation.1"}


def test_names_are_those_of_the_file(tmp_path: Path) -> None:
    """Of a turned axis, of bodies fixed together, of numbers that depend on a parameter, of limits."""
    file = tmp_path / "model.yaml"
    file.write_text(TURNED, encoding="utf-8")
    freed = build_parametric(read_model(file))
    assert {p.name: p.value for p in freed.parameters if p.kind is Kind.RUNTIME} == {
        "l": 0.5,
        "gravity.z": -9.81,
        "arm.mass": 2,
        "arm.com.z": -0.4,
        **{f"arm.inertia.{axis}": value for axis, value in (("xx", 0.1), ("yy", 0.1), ("zz", 0.02))},
        "load.position.z": -0.9,
        "load.orientation.1": 0.3,
        "load.mass": 3,
        "arm 2.mass": 1,
    }
    assert (freed.bodies[0].joint.lower, freed.bodies[0].joint.upper) == (-0.5, 0.5)
    for zeros in (False, True):
        assert_parameters_are_numbers_of_the_file(TURNED, tmp_path, 3, zeros=zeros)


def test_zeros_become_parameters_where_they_are_asked_for(tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    file.write_text(TURNED, encoding="utf-8")
    names = {p.name for p in build_parametric(read_model(file), zeros=True).parameters}
    assert {
        "arm.com.x",
        "arm 2.orientation.1",
        "gravity.x",
        "arm 2.inertia.xy",
        "arm.damping",
        "load.position.x",
    } <= names


def test_a_screw_has_the_parameters_of_its_turn_alone(tmp_path: Path) -> None:
    """The slide that goes with the turn is not in the file, so it has no stiffness, damping or rotor there."""
    text = (
        "name: screw\ngravity: [0, 0, -9.81]\nbodies:\n"
        "  - {name: nut, joint: {type: helical, axis: z, pitch: 0.01, damping: 0.2}, mass: 1, inertia: [1, 1, 1]}\n"
    )
    assert_parameters_are_numbers_of_the_file(text, tmp_path, 0, zeros=True)


def test_names_that_are_alike_stay_apart() -> None:
    """A joint that is called like a body which is fixed."""
    bodies = [
        body("a", revolute("z", name="b", position=(1, 0, 0)), mass=1, com=(1, 0, 0)),
        body("b", fixed((2, 0, 0))),
    ]
    bodies.append(body("c", revolute("y"), parent="b", mass=1, com=(1, 0, 0)))
    model = make_model("alike", bodies, gravity=(0, 0, -9), frames=[frame("b", "c", position=(3, 0, 0))])
    names = [p.name for p in build_parametric(model).parameters]
    assert {"b.position.x", "b.position.x.2", "frames.b.position.x"} <= set(names)
    assert len(set(names)) == len(names)


# --- functions of parameters -----------------------------------------------------------------------------------------

FUNCTIONAL = """\
name: functional
gravity: ["0.1*sin(a)", 0, "-9 - sqrt(b)"]
parameters:
  a: {a}
  b: {b}
  follows: a*b + cos(a)
bodies:
  - name: rod
    joint: {{type: revolute, axis: [1, 2, 2], orientation: [{{axis: x, angle: "a + atan2(b, 2)"}}], damping: "exp(-a)"}}
    mass: sqrt(b)
    com: ["sin(a)", 0.1, "-tan(a)/b"]
    inertia: [0.1, "0.1*b", "0.1*sqrt(b)"]
  - name: hook
    parent: rod
    joint:
      type: prismatic
      axis: y
      position: ["follows**2", "log(b)", 0]
      orientation: [{{axis: y, angle: "asin(a/2)"}}, {{axis: z, angle: follows}}]
      stiffness: "abs(b)"
      rest: acos(a)
      armature: a**2
      friction: {{torque: a*b, speed: "tanh(b)"}}
      force: "sin(a*q)*follows"
    mass: a + b
    com: [0, "1/b", 0]
  - name: plate
    parent: hook
    joint: {{type: fixed, orientation: [{{axis: x, angle: "a*b"}}]}}
    mass: a
    com: [0, "cos(b)", 1]
  - name: tip
    parent: plate
    joint: {{type: ball, position: ["atan(b)", 0, a]}}
    mass: "1 + a**3"
    inertia: [0.1, 0.1, 0.1]
frames:
  - {{name: end, body: tip, position: ["sqrt(a)", 0, 0], orientation: [{{axis: z, angle: a/b}}]}}
wrenches:
  - {{name: push, body: hook, position: [a, 0, 0], force: ["cos(a)", 0, input_], moment: [0, "b*a", 0]}}
""".replace("input_", "b")


def read_functional(a: object, b: object, folder: Path) -> Tree:
    file = folder / "model.yaml"
    file.write_text(FUNCTIONAL.format(a=a, b=b), encoding="utf-8")
    return build_tree(read_model(file))


@pytest.mark.parametrize("kind", ["runtime", "differentiated"])
def test_functions_of_parameters_stand_anywhere(kind: str, tmp_path: Path) -> None:
    """All functions of the language in all places, at values other than in the file."""
    freed = read_functional(f"{{value: 0.9, kind: {kind}}}", f"{{value: 1.5, kind: {kind}}}", tmp_path)
    known = read_functional(0.4, 1.7, tmp_path)
    at = draw_state(known, 1) | {"p" if kind == "runtime" else "theta": [0.4, 1.7]}
    for function in ("impl", "exp2", "sensors"):
        for name, expected in run(known, function, at).items():
            atol = 100 * CLOSE * np.abs(expected).max()  # M is badly conditioned where the ball's parts are light
            np.testing.assert_allclose(run(freed, function, at)[name], expected, rtol=0, atol=atol, err_msg=function)


def test_functions_of_parameters_have_derivatives(tmp_path: Path) -> None:
    """By differences in 50 digits, which are right to 25: 1e-12 is room for the rounding of doubles."""
    tree = read_functional("{value: 0.4, kind: differentiated}", "{value: 1.7, kind: differentiated}", tmp_path)
    tape = impl.build(tree)
    jac = Dynamics(tree, ALL).differentiate(tape).jac
    at = draw_state(tree, 2) | {"theta": [0.4, 1.7]}
    pattern = jac.output("jac_Phi_theta").sparsity
    found = np.zeros((pattern.rows, pattern.cols))
    for place, value in zip(
        pattern.entries, evaluate(jac, {i.name: at[i.name] for i in jac.inputs})["jac_Phi_theta"], strict=True
    ):
        found[place] = value
    step = DIGITS.literal(10) ** -25
    for column in range(2):
        sides = []
        for sign in (1, -1):
            given = {i.name: [DIGITS.literal(x) for x in at[i.name]] for i in tape.inputs}
            given["theta"][column] += sign * step
            sides.append(evaluate(tape, given, DIGITS)["Phi"])
        expected = np.array([float((plus - minus) / (2 * step)) for plus, minus in zip(*sides, strict=True)])
        np.testing.assert_allclose(found[:, column], expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_generation_takes_functions_of_parameters(tmp_path: Path) -> None:
    """The whole way, with a scene that locks a joint where a parameter says."""
    read_functional("{value: 0.4, kind: runtime}", "{value: 1.7, kind: runtime}", tmp_path)
    scene = tmp_path / "scene.yaml"
    scene.write_text('locked: {hook: "sin(a)/2"}\nfunctions: [impl]\nderivatives: 0\n', encoding="utf-8")
    made = make(tmp_path / "model.yaml", Options(scene=scene))
    assert [p.name for p in made.manifest.parameters] == ["a", "b"]
    assert made.report.evidence is not None
    assert max(made.report.evidence.deviations.values()) < CLOSE


def test_names_of_parameters_may_differ_by_capitals_alone(tmp_path: Path) -> None:
    """m and M are two parameters: in the equations, in the manifest, and in what `setup` takes."""
    file = tmp_path / "model.yaml"
    file.write_text(
        "name: two\ngravity: [0, 0, -9.81]\nparameters: {m: {value: 1, kind: runtime}, M: {value: 5, kind: runtime}}\n"
        "bodies:\n  - {name: a, joint: {type: prismatic, axis: z}, mass: M}\n"
        "  - {name: b, parent: a, joint: {type: prismatic, axis: x}, mass: m}\n",
        encoding="utf-8",
    )
    made = make(file, Options(functions=("semi",), derivatives=0, targets=("python", "matlab")))
    assert [p.name for p in made.manifest.parameters] == ["m", "M"]
    tree = build_tree(read_model(file))
    assert run(tree, "semi", draw_state(tree, 0) | {"p": [2.0, 7.0]})["M"].tolist() == [9.0, 0.0, 0.0, 2.0]


def test_a_quarter_turn_in_degrees_has_its_zeros(tmp_path: Path) -> None:
    turned = TURNED.replace("angle: pi/2", "angle: 90 deg")
    trees = []
    for k, text in enumerate((TURNED, turned)):
        (tmp_path / f"{k}.yaml").write_text(text, encoding="utf-8")
        trees.append(build_tree(read_model(tmp_path / f"{k}.yaml")))
    assert trees[0] == trees[1]


def test_a_report_counts_the_same_whether_zeros_are_parameters(tmp_path: Path) -> None:
    """Table 4 counts numbers at run time that are not 0."""
    file = tmp_path / "model.yaml"
    file.write_text(TURNED, encoding="utf-8")
    options = Options(runtime=True, functions=("impl",), derivatives=0)
    plain, zeros = (make(file, replace(options, zeros=choice)) for choice in (False, True))
    assert zeros.report.formulations == plain.report.formulations
    assert len(zeros.manifest.parameters) > len(plain.manifest.parameters)
