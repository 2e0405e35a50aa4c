"""Approximations: what is left out is felt by no more than the tolerance, at any state, and saves flops."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mbsgen import manifest
from mbsgen.approximation import choice
from mbsgen.approximation.choice import Approximation, approximate
from mbsgen.approximation.cuts import release
from mbsgen.approximation.effects import LEAST_INERTIA
from mbsgen.approximation.states import Array, draw
from mbsgen.errors import InputError
from mbsgen.formulations import impl, ports, semi
from mbsgen.formulations.reductions import Reductions
from mbsgen.formulations.results import energy
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.changes.scene import EVERYTHING, Scene
from mbsgen.model.construction import body, make_model, revolute
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Kind, Tree
from mbsgen.pipeline import make
from mbsgen.request import OptionError, Options, merge
from mbsgen.tape.counts import count
from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Tape
from tests.random_scenes import random_model

MODELS = Path(__file__).parents[3] / "models"
ONE_PLAN = Reductions(trials=1)
STATES, SEED = 200, 4711  # other states than the choice and its check use


def results(tape: Tape, tree: Tree, states: dict[str, Array]) -> dict[str, Array]:
    """Evaluate a tape: (states, nonzeros) of each result."""
    given = {name: list(columns.T) for name, columns in states.items()}
    given[ports.PARAMETERS.name], given[ports.DESIGN.name] = (
        [p.value for p in tree.parameters if p.kind is kind] for kind in (Kind.RUNTIME, Kind.DIFFERENTIATED)
    )
    given["u"] = [np.zeros(STATES)] * sum(b.joint.actuated for b in tree.bodies)
    found = evaluate(tape, {i.name: given[i.name] for i in tape.inputs})
    return {o.name: np.array([np.broadcast_to(x, STATES) for x in found[o.name]]).T for o in tape.outputs}


def masses(tree: Tree, states: dict[str, Array]) -> Array:
    """Evaluate M: (states, n, n)."""
    tape = semi.build(tree, ONE_PLAN)
    values, n = results(tape, tree, states)["M"], len(tree.bodies)
    full = np.zeros((STATES, n, n))
    for k, (r, c) in enumerate(tape.output("M").sparsity.entries):
        full[:, r, c] = values[:, k]
    return full


def worst_torque(whole: Tree, reduced: Tree) -> float:
    """Find the largest error of a joint's force, by the largest force that this joint has."""
    states = draw(whole, STATES, SEED)
    expected, found = (results(impl.build(tree, ONE_PLAN), tree, states)["Phi"] for tree in (whole, reduced))
    return float((np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)).max())


@pytest.mark.parametrize("seed", [1, 4])
def test_any_tree_keeps_its_tolerance_where_nobody_looked(seed: int) -> None:
    """Joints of all kinds, quaternions, laws, rotors, wrenches, a mass at run time; forces and M at fresh states."""
    tree, tolerance = build_tree(random_model(seed, 4)), 0.05
    found = approximate(tree, tolerance, merge(Options(functions=("impl", "semi"), reductions=ONE_PLAN), EVERYTHING))
    assert found.taken, "these trees have something to leave out"
    assert max(found.errors.values()) <= tolerance
    assert worst_torque(tree, found.tree) <= tolerance
    states = draw(tree, STATES, SEED)
    whole, reduced = masses(tree, states), masses(found.tree, states)
    assert np.array_equal(reduced, reduced.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(reduced - LEAST_INERTIA * whole).min() > 0
    sizes = np.sqrt(np.diagonal(whole, axis1=1, axis2=2).max(axis=0))
    assert (np.abs(reduced - whole).max(axis=0) <= tolerance * np.outer(sizes, sizes)).all()
    flops = [sum(count(f.build(x, ONE_PLAN)).paper for f in (impl, semi)) for x in (tree, found.tree)]
    assert flops[1] < flops[0]


@pytest.mark.parametrize("seed", [1, 4])
def test_with_nothing_left_out_a_released_tree_is_the_whole(seed: int) -> None:
    """Inertia stands where it is felt: forces, energies and momenta stay, to rounding."""
    tree = build_tree(random_model(seed, 5))
    states = draw(tree, STATES, SEED)
    gathered = release(tree).reduce(())
    for write in (lambda x: impl.build(x, ONE_PLAN), energy.build):
        expected, found = (results(write(x), x, states) for x in (tree, gathered))
        for name, values in expected.items():
            assert np.abs(found[name] - values).max() <= 1e-12 * np.abs(values).max(), name


def cranes(damping: float = 1e-4) -> Model:
    """Two arms in a row that are nearly planar, and a hook whose inertia is all but nothing to the arms."""
    return make_model(
        "cranes",
        [
            body("boom", revolute("y"), mass=40, com=(1, 2e-4, 0), inertia=(3, 20, 20)),
            body(
                "jib", revolute("y", position=(2, 0, 0)), parent="boom", mass=15, com=(0.7, 1e-4, 0), inertia=(1, 4, 4)
            ),
            body(
                "hook",
                revolute("x", position=(1.4, 0, 0), friction=(4.0, 0.1), damping=damping),
                parent="jib",
                mass=3,
                inertia=(2e-4, 0.05, 0.05),
            ),
        ],
        gravity=(0, 0, -9.81),
    )


def test_what_is_generated_must_keep_the_tolerance_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cuts that keep it by the estimate alone are not made: here the tapes err by twice of it."""
    tree, options = build_tree(cranes()), Options(functions=("impl",), reductions=ONE_PLAN)
    assert approximate(tree, 0.01, merge(options, EVERYTHING)).taken
    monkeypatch.setattr(choice.Comparison, "measure", lambda _, tapes: dict.fromkeys(tapes, 0.02))
    assert not approximate(tree, 0.01, merge(options, EVERYTHING)).taken


def test_what_a_joint_alone_stands_on_stays() -> None:
    """All that M has for the hook is below the tolerance of its force, which is friction; M is kept all the same."""
    tree = build_tree(cranes())
    found = approximate(tree, 0.1, merge(Options(functions=("impl",)), EVERYTHING))
    taken = {x.cut.name for x in found.taken}
    assert "hook.damping" in taken
    assert "hook.inertia.xx" not in taken
    alone = draw(tree, STATES, SEED)
    assert (masses(found.tree, alone)[:, 2, 2] >= LEAST_INERTIA * masses(tree, alone)[:, 2, 2]).all()


def test_a_choice_that_other_states_do_not_bear_out_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A choice at rest would leave dampers out; where everything moves, their effect is found."""
    tree, options = build_tree(cranes(damping=3.0)), Options(functions=("impl",), reductions=ONE_PLAN)

    def draw_still(tree: Tree, count: int, seed: int, *, motion: bool) -> dict[str, Array]:
        return draw(tree, count, seed, motion=motion and seed != choice.SEEDS[0])

    monkeypatch.setattr(choice, "draw", draw_still)
    misled = approximate(tree, 0.01, merge(options, EVERYTHING))
    assert not misled.taken
    assert misled.tree is tree


def test_nothing_is_left_out_that_saves_nothing() -> None:
    """Sensors feel no mass, so that no mass goes, however light; a lever that they do not feel does."""
    tree = build_tree(read_model(MODELS / "leg.yaml"))
    found = approximate(tree, 0.5, merge(Options(functions=("sensors",)), EVERYTHING))
    assert all(".position." in x.cut.name for x in found.taken)


@pytest.mark.parametrize("motion", [True, False])
def test_the_scene_decides_what_is_felt(motion: bool) -> None:
    """Without motion, what only velocities feel is not there to be left out."""
    tree = build_tree(cranes())
    scene = Scene(functions=("impl",), motion=motion)
    found = approximate(tree, 0.05, merge(Options(), scene))
    assert ("hook.damping" in {x.cut.name for x in found.taken}) is motion


@pytest.fixture(scope="module")
def files() -> dict[str, str]:
    return dict(make(cranes(), Options(functions=("impl",), derivatives=0, tolerance=0.01)).files)


def test_what_is_left_out_is_told(files: dict[str, str], tmp_path: Path) -> None:
    """By report, header and manifest."""
    told = json.loads(files["report.json"])["approximation"]
    assert told["tolerance"] == 0.01
    assert max(told["errors"].values()) <= 0.01
    assert told["left_out"]["hook.damping"]["value"] == "-0.0001*qd"
    assert told["left_out"]["hook.damping"]["flops"] > 0
    for name in told["left_out"]:
        assert name in files["report.md"]
    assert "approximate the model" in files["cranes.h"]
    (tmp_path / "manifest.json").write_text(files["manifest.json"])
    assert manifest.read(tmp_path / "manifest.json").tolerance == 0.01


def test_errors_of_jacobians_are_told() -> None:
    """Against central differences of both trees' forces at the same states."""
    tree = build_tree(read_model(MODELS / "six_axis.yaml"))
    options = Options(functions=("impl", "energy"), derivatives=1, reductions=ONE_PLAN)
    found = approximate(tree, 0.01, merge(options, EVERYTHING))
    assert found.slopes.keys() == {"impl"}
    states = draw(tree, choice.SLOPES, choice.SEEDS[1])
    worst = 0.0
    for name in ("q", "qd", "qdd"):
        expected, reduced = (differences(x, states, name) for x in (tree, found.tree))
        rows = np.abs(expected).max(axis=(0, 2))[:, None]
        off = np.abs(reduced - expected).max(axis=0)
        worst = max(worst, float((off / np.where(rows > 1e-6, rows, np.inf)).max()))
    assert found.slopes["impl"] == pytest.approx(worst, rel=1e-4)
    assert worst > 0.01, "the tolerance limits values alone"


def differences(tree: Tree, states: dict[str, Array], name: str, step: float = 1e-5) -> Array:
    """Differentiate the joints' forces by q, qd or qdd: (states, forces, columns)."""
    tape, columns = impl.build(tree, ONE_PLAN), []
    for k in range(states[name].shape[1]):
        sides = []
        for way in (step, -step):
            moved = states[name].copy()
            moved[:, k] += way
            given = {key: list(x.T) for key, x in (states | {name: moved}).items()}
            given["u"] = [np.zeros(len(moved))] * sum(b.joint.actuated for b in tree.bodies)
            found = evaluate(tape, {i.name: given[i.name] for i in tape.inputs})["Phi"]
            sides.append(np.array([np.broadcast_to(x, len(moved)) for x in found]).T)
        columns.append((sides[0] - sides[1]) / (2 * step))
    return np.stack(columns, axis=2)


def test_without_jacobians_none_are_compared(files: dict[str, str]) -> None:
    assert json.loads(files["report.json"])["approximation"]["errors_of_jacobians"] == {}
    assert "Errors of Jacobians" not in files["report.md"]


def test_without_a_tolerance_nothing_changes() -> None:
    options = Options(functions=("impl",), derivatives=0, reductions=ONE_PLAN)
    plain = make(cranes(), options).files
    zero = make(cranes(), Options(**{**vars(options), "tolerance": 0.0})).files
    assert zero == plain
    assert "tolerance" not in plain["manifest.json"]
    assert "approximate" not in plain["cranes.h"]


def test_the_option_comes_before_the_scene() -> None:
    options = Options(functions=("impl",), derivatives=0, reductions=ONE_PLAN, scene=Scene(tolerance=0.01))
    assert "approximation" in json.loads(make(cranes(), options).files["report.json"])
    without = make(cranes(), Options(**{**vars(options), "tolerance": 0.0}))
    assert "approximation" not in json.loads(without.files["report.json"])


@pytest.mark.parametrize("tolerance", [-1e-3, 0.6, float("nan"), float("inf")])
def test_what_is_no_tolerance_is_refused(tolerance: float) -> None:
    with pytest.raises(OptionError, match="tolerance"):
        make(cranes(), Options(tolerance=tolerance))


def test_numbers_that_may_change_are_not_left_out() -> None:
    with pytest.raises(OptionError, match="run-time"):
        make(cranes(), Options(tolerance=0.01, runtime=True))


@pytest.mark.parametrize("text", ["tolerance: 2", "tolerance: -1", "tolerance: much", "tolerance: .nan"])
def test_a_scene_with_no_tolerance_is_refused_by_its_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(f"functions: [impl]\n{text}\n")
    with pytest.raises(InputError, match=r"scene\.yaml:2: tolerance"):
        make(cranes(), Options(scene=path))


def test_a_scene_file_may_ask_for_it(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text("functions: [impl]\nderivatives: 0\ntolerance: 1e-2\n")
    assert make(cranes(), Options(scene=path)).manifest.tolerance == 0.01


def test_the_same_tree_gives_the_same_approximation() -> None:
    tree, options = build_tree(cranes()), Options(functions=("impl",), reductions=ONE_PLAN)
    first, second = (approximate(tree, 0.05, merge(options, EVERYTHING)) for _ in range(2))
    assert isinstance(first, Approximation)
    assert first == second
