"""Scenes: what is left out is gone, and what is left agrees with the whole model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from mbsgen.assembly import assemble
from mbsgen.errors import InputError
from mbsgen.evidence import gather
from mbsgen.expressions import Number, parse
from mbsgen.families import write_families
from mbsgen.formulations import impl
from mbsgen.formulations.catalogue import list_results, select_functions
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.scene import EVERYTHING, Scene, read_scene, stage
from mbsgen.model.construction import body, frame, make_model, prismatic, revolute
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Kind
from mbsgen.pipeline import make
from mbsgen.request import OptionError, Options, Request, merge
from mbsgen.roles import ON_REQUEST
from mbsgen.tape.counts import count

MODELS = Path(__file__).parents[2] / "models"
FEW = Reductions(trials=1)


def linkage() -> Model:
    """A slider, a joint about an odd axis, a branch, and joints in sequence; a parameter that says where to lock."""
    inertia = (0.02, 0.03, 0.04)
    odd = revolute((0.6, 0.0, 0.8), position=(0.1, 0.2, 0.0), orientation=[("x", 0.4), ("z", -0.7)])
    return make_model(
        "linkage",
        [
            body("cart", joint=prismatic((0.0, 1.0, 1.0)), mass=2.0, com=(0.1, 0, 0), inertia=inertia),
            body("arm", parent="cart", joint=odd, mass=1.0, com=(0.3, 0.1, 0), inertia=inertia),
            body(
                "wrist",
                parent="arm",
                joint=[
                    revolute("x", name="a", position=(0.5, 0, 0)),
                    revolute("-y", name="b"),
                    revolute("z", name="c"),
                ],
                mass=0.5,
                com=(0, 0.1, 0.2),
                inertia=inertia,
            ),
            body("flap", parent="cart", joint=revolute("y", position=(0, 0, 0.3)), mass=0.3, com=(0.2, 0, 0)),
        ],
        gravity=(0, 0.5, -9.81),
        parameters={"angle": 0.4},
        frames=[frame("tip", body="wrist", position=(0.1, 0, 0)), frame("edge", body="flap", position=(0.4, 0, 0))],
    )


LOCKS = [
    {"cart": Number(0.3)},
    {"arm": parse("angle")},
    {"a": parse("-angle/2"), "flap": Number(1.1)},
    {"c": Number(0.7)},
    {"b": Number(-0.2)},
    {"arm": Number(0.2), "a": Number(0.1), "b": Number(0.3), "c": Number(-0.5)},
]


@pytest.mark.parametrize("locked", LOCKS, ids=lambda locked: "+".join(locked))
def test_what_is_left_agrees_with_the_whole(locked: dict[str, object]):
    """Residuals, mass matrix, accelerations, sensors, energies and poses, to rounding, with joints locked."""
    scene = Scene(locked=tuple(locked.items()))
    evidence = gather(linkage(), merge(Options(reductions=FEW), scene))
    assert set(evidence.deviations) == set(select_functions(build_tree(linkage()))) - {
        *ON_REQUEST,
        "condition",
        "rates",
    }
    assert max(evidence.deviations.values()) < 1e-13
    before, after = evidence.flops["the whole model"], evidence.flops["joints locked"]
    assert sum(after.values()) < sum(before.values())


def test_without_motion_only_statics_is_left():
    model = read_model(MODELS / "double_pendulum.yaml")
    scene = Scene(functions=("impl", "semi"), motion=False)
    families = {f.value.name: f for f in write_families(build_tree(stage(model, scene)), merge(Options(), scene))}
    value, jac = families["impl"].value, families["impl"].jac
    assert jac is not None
    assert "qd" not in [i.name for i in (*value.inputs, *jac.inputs)]
    assert [o.name for o in jac.outputs] == ["jac_Phi_q", "jac_Phi_qdd", "jac_Phi_u"]
    assert count(value).paper < count(impl.build(build_tree(model))).paper
    assert max(gather(model, merge(Options(), scene)).deviations.values()) < 1e-15


def test_a_function_that_iterates_gives_the_chosen_results_alone() -> None:
    """As straight functions do: of a projection, the coordinates without the velocities."""
    model = read_model(MODELS / "four_bar.yaml")
    scene = Scene(functions=("project",), results=(("project", ("closed",)),))
    tree = assemble(build_tree(stage(model, scene)))
    (family,) = write_families(tree, merge(Options(derivatives=0), scene))
    assert [o.name for o in family.value.outputs] == ["closed"]


def test_without_motion_loops_are_closed_and_states_projected() -> None:
    """An iteration keeps its inputs, velocities too; straight functions lose theirs."""
    model = read_model(MODELS / "four_bar.yaml")
    scene = Scene(functions=("close_rates", "project"), motion=False)
    tree = assemble(build_tree(stage(model, scene)))
    families = {f.value.name: f.value for f in write_families(tree, merge(Options(derivatives=0), scene))}
    assert {name: [i.name for i in value.inputs] for name, value in families.items()} == {
        "close_rates": ["q"],
        "project": ["q", "qd"],
    }


@pytest.mark.parametrize("name", ["exp1", "exp2"])
def test_accelerations_of_another_mechanism_are_no_evidence(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a scene's tape is of heavier bodies, with equal gravity, the comparison shows it."""
    model = linkage()
    scene = Scene(functions=(name,), locked=(("cart", Number(0.3)),))
    options = Options(reductions=FEW)
    assert gather(model, merge(options, scene)).deviations[name] < 1e-9
    heavier = replace(model, bodies=(model.bodies[0], replace(model.bodies[1], mass=Number(2.0)), *model.bodies[2:]))
    wrong = {f.value.name: f.value for f in write_families(build_tree(stage(heavier, scene)), merge(options, scene))}
    monkeypatch.setattr("mbsgen.evidence._tapes", lambda *_: wrong)
    assert gather(model, merge(options, scene)).deviations[name] > 1e-3


def test_without_gravity_nothing_falls():
    model = read_model(MODELS / "double_pendulum.yaml")
    tree = build_tree(stage(model, Scene(gravity=False)))
    assert all(component == 0 for component in tree.gravity)
    assert max(gather(model, merge(Options(), Scene(gravity=False))).deviations.values()) < 1e-14


def test_sensors_and_results_that_nobody_reads_cost_nothing():
    scene = Scene(functions=("sensors", "energy"), sensors=("edge",), results=(("energy", ("kinetic",)),))
    flops = gather(linkage(), merge(Options(reductions=FEW), scene)).flops
    assert flops["sensors and wrenches left out"]["sensors"] < flops["the whole model"]["sensors"]
    assert flops["results left out"]["energy"] < flops["the whole model"]["energy"]


def test_functions_wanted_together_share_what_they_can():
    model = read_model(MODELS / "double_pendulum.yaml")
    scene = Scene(functions=(), together=(("step", ("impl", "sensors")),))
    (step,) = write_families(build_tree(model), merge(Options(), scene))
    apart = {f.value.name: f.value for f in write_families(build_tree(model), Request(functions=("impl", "sensors")))}
    assert [o.name for o in step.value.outputs] == ["Phi", "position"]
    assert count(step.value).paper < count(apart["impl"]).paper + count(apart["sensors"]).paper
    assert step.jac is not None
    assert {"jac_Phi_q", "jac_position_q"} <= {o.name for o in step.jac.outputs}


@pytest.mark.parametrize(
    "parts", [("impl", "energy"), ("exp1", "power"), ("semi_res", "power"), ("sensors", "frames", "condition")]
)
def test_functions_together_have_the_derivatives_of_all(parts: tuple[str, ...]):
    """The energy has no derivatives alone; a block that is missing in a joined function would be a derivative of 0."""
    scene = Scene(functions=(), together=(("step", parts),), derivatives=1)
    product = make(MODELS / "double_pendulum.yaml", Options(scene=scene, count=False))  # compares with differences
    value, jac = (product.manifest.kernel(name) for name in ("step", "jac_step"))
    assert {o.of for o in jac.outputs} == {o.name for o in value.outputs}


@pytest.mark.parametrize(
    ("parts", "finding"),
    [
        (("exp1", "impl"), "exp1 gives qdd, which impl reads; leave one of the two out"),
        (("exp1", "exp2"), "exp1 gives qdd, which exp2 gives too; leave one of the two out"),
    ],
)
def test_functions_that_cannot_go_together_are_named(parts: tuple[str, ...], finding: str):
    """One call has one value of each name."""
    with pytest.raises(OptionError, match=finding):
        write_families(
            build_tree(read_model(MODELS / "double_pendulum.yaml")),
            merge(Options(), Scene(functions=(), together=(("step", parts),))),
        )


def test_poses_go_together_with_parameters():
    """Origins of frames are called p, as run-time parameters are, which setup takes."""
    scene = Scene(functions=(), together=(("step", ("frames", "impl")),), derivatives=1)
    product = make(MODELS / "double_pendulum.yaml", Options(scene=scene, count=False, runtime=True))
    assert [o.name for o in product.manifest.kernel("step").outputs] == ["p", "R", "Phi"]


def test_planar_motion_has_planar_equations():
    """With all of its inertia given, a planar double pendulum takes what one of thin rods takes."""

    def chain(*inertia: float) -> Model:
        parts = [
            body("upper", joint=revolute("y"), mass=1.5, com=(0, 0, -0.5), inertia=inertia),
            body(
                "lower",
                parent="upper",
                joint=revolute("y", position=(0, 0, -1)),
                mass=0.8,
                com=(0, 0, -0.3),
                inertia=inertia,
            ),
        ]
        return make_model("chain", parts, gravity=(0, 0, -9.81))

    thin, thick = (count(impl.build(build_tree(chain(*x)), ALL)).paper for x in ((0.1, 0.1, 0), (0.1, 0.2, 0.15)))
    assert thick == thin


def test_kinds_of_parameters_are_the_scenes():
    scene = Scene(parameters=(("angle", Kind.RUNTIME),))
    assert [p.kind for p in stage(linkage(), scene).parameters] == [Kind.RUNTIME]


def test_a_scene_without_wishes_changes_nothing():
    model = linkage()
    assert stage(model, EVERYTHING) == model


def test_every_fault_of_a_scene_is_told_at_once(tmp_path: Path):
    path = tmp_path / "scene.yaml"
    path.write_text(
        "functions: [imple]\nlocked: {arm: 0, wrst: 1}\nsensors: [top]\nparameters: {angel: runtime}\n"
        "results: {energy: [heat]}\ntogether: {impl: [impl, semi_res]}\nmotoin: false\n"
    )
    with pytest.raises(InputError) as caught:
        read_scene(path, linkage(), list_results())
    text = str(caught.value)
    for found in ("imple", "wrst", "top", "angel", "heat", "cannot be the name", "a result Phi", "motoin"):
        assert found in text
    assert "did you mean `impl`?" in text


@pytest.mark.parametrize(
    ("text", "finding"),
    [
        ("locked: {cart: 0, arm: 0, a: 0, b: 0, c: 0, flap: 0}", "no joint is left that moves"),
        ("locked: {arm: strange}", "depends on"),
        ("derivatives: 3", "derivatives"),
        ("together: {step: [impl]}", "give two functions or more"),
        ("together: {jac_impl: [exp2, energy]}", "cannot be the name of a function"),
        ("together: {adj1_step: [exp2, energy]}", "cannot be the name of a function"),
        ("results: {semi_res: []}", "no result is named"),
    ],
)
def test_what_cannot_be_is_refused(text: str, finding: str, tmp_path: Path):
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=finding):
        read_scene(path, linkage(), list_results())


def test_a_scene_file_is_followed(tmp_path: Path):
    path = tmp_path / "scene.yaml"
    path.write_text("functions: [exp2]\nderivatives: 1\nlocked: {q2: pi/6}\n")
    product = make(MODELS / "double_pendulum.yaml", Options(scene=path))
    assert [kernel.name for kernel in product.manifest.kernels] == ["exp2", "jac_exp2", "adj1_exp2", "lin_exp2"]
    assert [c.name for c in product.manifest.coordinates] == ["q1"]
    assert product.report.evidence is not None
    assert "differs from the whole" in product.files["report.md"]
