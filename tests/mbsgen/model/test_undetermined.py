"""A check refuses what generation could not write, and nothing else: one judgement for both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsgen.expressions import Number
from mbsgen.formulations import exp1, exp2, semi
from mbsgen.formulations.reductions import NONE
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.checks.checks import find_faults
from mbsgen.model.checks.undetermined import check_undetermined_joints
from mbsgen.model.construction import ball, body, cardan, fixed, make_model, planar, prismatic, revolute
from mbsgen.model.model import BASE, Body, Fixed, Joint, Model
from mbsgen.model.tree import Tree
from mbsgen.pipeline import Options, make
from mbsgen.tape.interpreter import evaluate

GRAVITY = (Number(0.0), Number(0.0), Number(-9.81))
SINGULAR = 1e-12  # of the largest eigenvalue of M, its diagonal scaled to 1: rounding, with room
WEIGHTS = {"revolute": 0.4, "prismatic": 0.25, "rotor": 0.05, "cardan": 0.1, "planar": 0.05, "fixed": 0.1, "ball": 0.05}


def draw_joint(rng: np.random.Generator) -> Joint | Fixed | tuple[Joint, ...]:
    turns = [] if rng.random() < 0.6 else [(str(rng.choice([*"xyz"])), "pi/2")]
    place = [float(x) for x in rng.choice([0.0, 0.0, 0.5], 3)]
    axis = str(rng.choice([*"xyz"]))
    match rng.choice([*WEIGHTS], p=[*WEIGHTS.values()]):
        case "revolute":
            return revolute(axis, position=place, orientation=turns)
        case "prismatic":
            return prismatic(axis, position=place, orientation=turns)
        case "rotor":
            return revolute(axis, position=place, orientation=turns, armature=0.3)
        case "cardan":
            return cardan("xy", position=place, orientation=turns)
        case "planar":
            return planar("xz", position=place, orientation=turns)
        case "ball":
            return ball(position=place, orientation=turns)
    return fixed(position=place, orientation=turns)


def draw_model(seed: int) -> Model:
    """Draw a model that often has joints too many: few axes, few places, and many bodies without mass."""
    rng = np.random.default_rng(seed)
    bodies: list[Body] = []
    for i in range(int(rng.integers(1, 6))):
        parent = str(rng.choice([BASE, *(b.name for b in bodies[-2:])])) if rng.random() < 0.3 or not i else f"b{i - 1}"
        mass, com, inertia = 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if rng.random() < 0.55:
            mass, com = 1.5, tuple(float(x) for x in rng.choice([0.0, 0.0, 0.3], 3))
            inertia = (0.0, 0.0, 0.0) if rng.random() < 0.5 else (0.1, 0.1, 0.1)
        bodies.append(body(f"b{i}", draw_joint(rng), parent=parent, mass=mass, com=com, inertia=inertia))
    return Model(
        "drawn",
        make_model("g", [body("b", revolute("x"), mass=1, com=(0, 1, 0))], gravity=(0, 0, -9)).gravity,
        tuple(bodies),
    )


def is_regular(tree: Tree, seed: int) -> bool:
    """Return whether M is regular at a random state."""
    tape, rng = semi.build(tree, NONE), np.random.default_rng(seed)
    values = evaluate(tape, {i.name: list(rng.uniform(-2, 2, i.sparsity.nnz)) for i in tape.inputs})["M"]
    n = len(tree.bodies)
    M = np.zeros((n, n))
    for place, value in zip(tape.output("M").sparsity.entries, values, strict=True):
        M[place] = value
    size = np.sqrt(np.diag(M))
    return bool(np.all(size > 0) and np.linalg.eigvalsh(M / np.outer(size, size))[0] > SINGULAR)


def test_what_a_check_lets_pass_has_a_regular_matrix_and_is_written() -> None:
    """And what it refuses is singular at any state. Both verdicts come up many times."""
    verdicts = []
    for seed in range(80):
        model = draw_model(seed)
        others = [f for f in find_faults(model) if "nothing" not in f.finding]
        if others or not any(b.joints for b in model.bodies):
            continue
        tree = build_tree(model)
        is_accepted = not [*check_undetermined_joints(model)]
        assert is_accepted == is_regular(tree, seed), seed
        if is_accepted:  # no TapeError
            exp1.build(tree, NONE)
            exp2.build(tree, NONE)
        verdicts.append(is_accepted)
    assert min(verdicts.count(True), verdicts.count(False)) > 15


@pytest.mark.parametrize("lightness", [1e-3, 1e-9, 1e-12])
def test_a_light_body_between_joints_is_enough(lightness: float) -> None:
    """The pivot is the light body's inertia, beside the heavy one's: doubles alone would not distinguish it from 0."""
    light = body("light", revolute("z"), mass=lightness, inertia=(lightness, lightness, lightness))
    heavy = body("heavy", revolute("z"), parent="light", mass=1e6, com=(1, 0, 0), inertia=(1, 1, 1))
    make_model("pair", [light, heavy], gravity=(0, 0, -9))


def test_a_scene_may_not_lock_what_keeps_joints_apart(tmp_path: Path) -> None:
    bodies = [
        body("a", revolute("z")),
        body("b", revolute("y"), parent="a"),
        body("c", revolute("z"), parent="b", mass=1, com=(1, 0, 0), inertia=(1, 1, 1)),
    ]
    model = make_model("wrist", bodies, gravity=(0, 0, -9))
    scene = tmp_path / "scene.yaml"
    scene.write_text("locked: {b: 0}\n", encoding="utf-8")
    with pytest.raises(InputError, match='joint "a" moves nothing that "c" cannot undo'):
        make(model, Options(scene=scene))
    scene.write_text("locked: {b: 0.5}\nfunctions: [impl]\nderivatives: 0\n", encoding="utf-8")
    make(model, Options(scene=scene))
