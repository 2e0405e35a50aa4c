"""Verification: whatever is wrong in what is generated, nothing is written."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from decimal import Decimal
from functools import cache
from pathlib import Path

import pytest

from mbsgen import pipeline
from mbsgen.families import Functions, write_families, write_functions
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.construction import (
    ball,
    body,
    frame,
    free,
    inertia,
    make_model,
    prismatic,
    revolute,
    runtime,
    wrench,
)
from mbsgen.model.model import Joint, Model
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Kind, Tree
from mbsgen.request import Options, Request
from mbsgen.roles import Role
from mbsgen.tape.interpreter import evaluate, fifty_digits
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Op, Output, Sparsity, Tape
from mbsgen.targets.contract import Family
from mbsgen.verification.functions import Comparison, Truth, write_equations
from mbsgen.verification.states import draw_states
from mbsgen.verification.verify import TOLERANCE, VerificationError, verify
from tests.mbsgen.formulations.closed_mechanisms import make

TENSOR = inertia(0.1, 0.1, 0.1)
ONE_PLAN, OPTIONS = (kind(reductions=Reductions(trials=1)) for kind in (Request, Options))


def kite() -> Model:
    """Hold a ball and a hinge on a free body, with a parameter, a frame, a rotor, a damper and two wrenches."""
    return make_model(
        "kite",
        [
            body("trunk", free(), mass="m", com=(0.1, 0, 0.2), inertia=inertia(0.4, 0.5, 0.6, 0.03)),
            body("tail", ball(position=(0.4, 0, 0)), parent="trunk", mass=0.5, inertia=inertia(0.1, 0.2, 0.2)),
            body("rudder", revolute("z", position=(0, 0.2, 0.1), damping=0.3, armature=0.2), parent="tail", mass=0.7),
        ],
        gravity=(0.5, 0, -9.81),
        parameters={"m": runtime(2.0)},
        frames=[frame("eye", "rudder", position=(0.1, 0.2, 0), orientation=[("x", 0.4)])],
        wrenches=[
            wrench("wind", "trunk", position=(0.1, 0, 0), frame="base", force="input", moment=(0.1, 0.2, 0.3)),
            wrench("jet", "tail", position=(0, 0.1, 0), frame="body", force=(1, 2, 3), moment="input"),
        ],
    )


@cache
def written() -> tuple[Tree, tuple[Family, ...]]:
    tree = build_tree(kite())
    return tree, write_families(tree, ONE_PLAN)


def kernels() -> list[str]:
    return [tape.name for family in written()[1] for tape in family.tapes if tape.name != "setup"]


def double_last(tape: Tape) -> Tape:
    """Double the last nonzero of the last result."""
    literals = range(tape.first_literal, tape.first_operation)
    operations, outputs = list(tape.operations), list(tape.outputs)
    output = outputs[-1]
    place = max(k for k, value in enumerate(output.values) if value not in literals)
    operations.append((Op.ADD, output.values[place], output.values[place]))
    values = list(output.values)
    values[place] = tape.first_operation + len(operations) - 1
    outputs[-1] = replace(output, values=tuple(values))
    return replace(tape, operations=tuple(operations), outputs=tuple(outputs))


def with_fault(families: tuple[Family, ...], kernel: str) -> tuple[Family, ...]:
    def change(tape: Tape | None) -> Tape | None:
        return double_last(tape) if tape is not None and tape.name == kernel else tape

    found = []
    for f in families:
        value = change(f.value)
        assert value is not None
        found.append(replace(f, value=value, jac=change(f.jac), adj1=change(f.adj1), jac_adj1=change(f.jac_adj1)))
    return tuple(found)


def test_what_is_right_passes_and_nothing_is_left_out() -> None:
    tree, families = written()
    found = verify(tree, families, still=False)
    assert set(found.deviations) == set(kernels())
    assert found.unchecked == ()
    assert found.states == 2


def find_refusal(tree: Tree, families: tuple[Family, ...]) -> str:
    """Return the message of a refusal; empty where there is none."""
    try:
        verify(tree, families, still=False)
    except VerificationError as error:
        return str(error)
    return ""


def test_a_single_wrong_number_is_refused() -> None:
    """In each kernel, the last entry of the last result, doubled: of c, of a derivative, of a hoisted value.

    The last result of `condition` is a bound that depends on the plan: nothing else computes it. The kernels are no
    cases of the test, since every process of a run would write them for its list of tests.
    """
    tree, families = written()
    missed = {}
    for kernel in ("setup", *(x for x in kernels() if x != "condition")):
        found = find_refusal(tree, with_fault(families, kernel))
        place = "" if kernel == "setup" else rf"kite: (lin_)?{kernel}: "
        if not (re.search(place, found) and "nothing is written" in found):
            missed[kernel] = found
    assert missed == {}


CLOSED_FORMS = ("impl", "semi_res", "exp1", "exp2", "impl_red", "semi_red", "exp1_red")
OF_LOOPS = ("loops", "loop_rates", "loop_accelerations", "loop_jacobian", "loop_forces")


@cache
def closed() -> dict[str, Family]:
    """Write the functions of a closed mechanism in space."""
    request = replace(ONE_PLAN, functions=(*CLOSED_FORMS, *OF_LOOPS), derivatives=0)
    return {family.value.name: family for family in write_families(make("spatial"), request)}


@pytest.mark.parametrize("kernel", [*CLOSED_FORMS, *OF_LOOPS])
def test_a_single_wrong_number_of_a_closed_mechanism_is_refused(kernel: str) -> None:
    """The last entry of the last result, doubled: of lam in accelerations, of gamma beside J."""
    own = (closed()[kernel],)
    assert set(verify(make("spatial"), own, still=False).deviations) == {kernel}
    with pytest.raises(VerificationError, match=f"spatial: {kernel}: "):
        verify(make("spatial"), with_fault(own, kernel), still=False)


def test_second_differences_are_as_precise_for_large_velocities() -> None:
    """Accelerations of gaps grow by the square of velocities, which are large where a loop is almost singular."""
    tree, speed = make("four_bar"), Decimal("1e5")
    with fifty_digits():
        truth = Truth(tree, write_equations(tree), next(draw_states(tree, still=False)))
        still = [Decimal(0)] * len(truth.all_qd)
        slow = truth.closures.accelerate(truth.all_qd, still)
        fast = truth.closures.accelerate([speed * x for x in truth.all_qd], still)
        assert Comparison("gamma", [x / speed**2 for x in fast], slow).deviation < Decimal("1e-28")


def test_nothing_is_written_where_a_function_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def write_wrong(*arguments: object, **options: object) -> Functions:
        found = write_functions(*arguments, **options)  # type: ignore[arg-type]
        return replace(found, families=with_fault(found.families, "semi"))

    monkeypatch.setattr(pipeline, "write_functions", write_wrong)
    with pytest.raises(VerificationError, match="kite: semi: c differs by"):
        pipeline.generate(kite(), tmp_path / "out", replace(OPTIONS, functions=("semi",), derivatives=0))
    assert not (tmp_path / "out").exists()


def test_parameters_that_no_function_depends_on_are_no_obstacle() -> None:
    """Of a mass at run time, the poses know nothing: there is no setup."""
    product = pipeline.make(kite(), replace(OPTIONS, functions=("frames",), derivatives=0))
    assert [kernel.name for kernel in product.manifest.kernels] == ["frames"]
    assert set(product.report.verification.deviations) == {"frames"}


def test_a_derivative_that_differences_cannot_see_is_no_fault(tmp_path: Path) -> None:
    """Half a metre above a hard ground the slope of its force is some 1e-2000 of the weight."""
    text = "name: drop\ngravity: [0, 0, -9.81]\nbodies:\n"
    text += "  - {name: b, joint: {type: prismatic, axis: z, actuated: false}, mass: 0.2}\n"
    text += "contacts:\n  - {name: ground, body: b, radius: 0.03, stiffness: 1e5, exponent: 1}\n"
    (tmp_path / "drop.yaml").write_text(text)
    product = pipeline.make(read_model(tmp_path / "drop.yaml"), replace(OPTIONS, functions=("exp2",), derivatives=1))
    assert max(product.report.verification.deviations.values()) <= TOLERANCE


def test_the_slope_of_a_far_contact_is_no_fault(tmp_path: Path) -> None:
    """Free bodies without weight, 40 widths apart: their residuals depend on q by some 1e-25 N alone."""
    text = "name: far\ngravity: [0, 0, 0]\nbodies:\n"
    text += "  - {name: a, joint: {type: free}, mass: 2, inertia: [0.01, 0.01, 0.01]}\n"
    text += "  - {name: b, joint: {type: free}, mass: 3, inertia: [0.02, 0.02, 0.03]}\n"
    text += "contacts:\n  - {name: hit, body: a, radius: 0.1, plane: {body: b, position: [0, 0, -0.4]}, "
    text += "stiffness: 1e4, width: 1e-2, friction: {coefficient: 0.5, speed: 0.1}}\n"
    (tmp_path / "far.yaml").write_text(text)
    product = pipeline.make(read_model(tmp_path / "far.yaml"), replace(OPTIONS, functions=("impl",), derivatives=2))
    assert max(product.report.verification.deviations.values()) <= TOLERANCE


@pytest.mark.parametrize("turned", [(), [("x", 0.3)]], ids=["straight", "turned"])
@pytest.mark.parametrize("joint", [revolute, prismatic])
def test_what_cancels_is_no_fault(joint: Callable[..., Joint], turned: Sequence[tuple[str, float]]) -> None:
    """Momenta, velocities and powers are 0 in truth, and rounding in digits, where all lies on an axis of any slope."""
    axis = (1, -2, 0.5)
    on_axis, back = (0.3, -0.6, 0.15), (-0.3, 0.6, -0.15)
    model = make_model(
        "still",
        [
            body("first", joint(axis, orientation=turned, actuated=False), mass=1, com=on_axis, inertia=TENSOR),
            body("second", joint(axis, position=on_axis), parent="first", mass=1, com=back, inertia=TENSOR),
        ],
        gravity=(0, 0, 0),
        frames=[frame("here", "first", position=on_axis), frame("origin", "second", position=back)],
        wrenches=[wrench("push", "second", position=back, frame="base", force=("0.1*q_first", 0.2, 0.3))],
    )
    pipeline.make(model, replace(OPTIONS, functions=("energy", "power", "motion", "jacobian", "semi", "sensors")))


def test_what_cancels_on_a_tilted_axis_is_no_fault() -> None:
    """A balanced wheel has no momentum, its hub no velocity, and a follower that turns back no angular velocity.

    A comparison in 50 digits finds rounding in place of these zeros.
    """
    tilted = {"position": (-0.047, 0, 0), "orientation": [("y", -1.1)]}
    back = revolute("z", name="back", position=(0, 0, 0.24), follows=("wheel", -1, 0))
    model = make_model(
        "wheel",
        [
            body("wheel", revolute("z", **tilted), mass=2, com=(0, 0, 0.24), inertia=(2, 2, 3)),
            body("level", back, parent="wheel", mass=1, inertia=(1, 1, 1)),
        ],
        gravity=(0, 0, -9.81),
        frames=[frame("hub", "level")],
    )
    tree = build_tree(model)
    verify(tree, write_families(tree, ONE_PLAN), still=False)


def test_the_report_says_what_was_compared() -> None:
    product = pipeline.make(kite(), replace(OPTIONS, functions=("energy", "sensors"), derivatives=1))
    checked = product.report.verification
    assert set(checked.deviations) == {"energy", "sensors", "jac_sensors", "adj1_sensors", "lin_sensors"}
    assert max(checked.deviations.values()) < float(TOLERANCE)
    assert "at 2 random states" in product.files["report.md"]
    assert '"unchecked": []' in product.files["report.json"]


@pytest.mark.parametrize("name", ["exp1", "exp2"])
def test_guards_have_the_scales_of_constants_where_masses_are_parameters(name: str) -> None:
    """The scale of a pivot is then a result of `setup`: the same numbers, and none of them 0."""
    tree = written()[0]
    fixed = replace(tree, parameters=tuple(replace(p, kind=Kind.CONSTANT) for p in tree.parameters))
    found = [scales_of(x, name) for x in (tree, fixed)]
    assert found[0] == pytest.approx(found[1], rel=1e-14)
    assert min(found[0].values()) > 0


def scales_of(tree: Tree, name: str) -> dict[int, float]:
    """Evaluate what the guards of a function compare with, by joint."""
    tapes = {f.value.name: f.value for f in write_families(tree, replace(ONE_PLAN, functions=(name,), derivatives=0))}
    tape, given = tapes[name], {"p": [p.value for p in tree.parameters]}
    h = evaluate(tapes["setup"], given)["h"] if "setup" in tapes else []
    scales = tuple(guard.scale for guard in tape.guards)
    shown = replace(tape, outputs=(Output(Port("scale", Role.RESULT), Sparsity.dense(len(scales)), scales),))
    values = evaluate(shown, {i.name: h if i.name == "h" else [0.3] * i.sparsity.nnz for i in tape.inputs})["scale"]
    return {guard.joint: float(x) for guard, x in zip(tape.guards, values, strict=True)}
