"""A model made in Python is the one that a file describes, and is judged by the same rules."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsgen.model.construction import (
    body,
    cardan,
    fixed,
    floating,
    frame,
    inertia,
    make_model,
    number,
    prismatic,
    revolute,
    runtime,
    vector,
    wrench,
)
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Kind

MODELS = Path(__file__).parents[3] / "models"
DOWN = (0, 0, -9.81)


def make_pendulum() -> Model:
    thin = ("m*l**2/12", "m*l**2/12", 0)
    rod = body("rod", revolute("y", name="q1", damping="d"), mass="m", com=(0, 0, "-l/2"), inertia=thin)
    return make_model(
        "pendulum",
        [rod],
        gravity=(0, 0, "-g"),
        parameters={"g": 9.81, "l": 1, "m": 2, "d": 0.05},
        frames=[frame("tip", "rod", position=(0, 0, "-l"))],
    )


def make_quadruped() -> Model:
    """Four legs by two loops, mirrored by signs."""
    trunk = inertia(0.016, 0.046, 0.053, xz=1.2e-3)
    bodies = [body("trunk", floating("zyx"), mass=4.2, com=(0.004, 0, 0.003), inertia=trunk)]
    feet = []
    for end, x in (("front", "front"), ("rear", "-front")):
        for where, s in (("left", ""), ("right", "-")):
            leg, y = f"{end} {where}", -1 if s else 1
            hip = revolute("x", position=(x, f"{s}side", 0), limits=(-0.8, 0.8))
            thigh = revolute("y", position=(0, f"{s}hip", 0), limits=(-2.5, 2.5))
            shank, foot = revolute("y", position=(0, 0, "-thigh"), limits=(-2.6, 0)), fixed((0, 0, "-shank"))
            hips, thighs = inertia(3.8e-4, 5.6e-4, 4.4e-4, xy=y * 6e-5), inertia(1.98e-3, 2.1e-3, 5.9e-4, yz=y * 2.1e-4)
            thin = inertia(2.5e-4, 2.5e-4, 6e-6)
            bodies += [
                body(f"{leg} hip", hip, parent="trunk", mass=0.54, com=(0, y * 0.036, 0), inertia=hips),
                body(f"{leg} thigh", thigh, parent=f"{leg} hip", mass=0.63, com=(0, y * 0.016, -0.02), inertia=thighs),
                body(f"{leg} shank", shank, parent=f"{leg} thigh", mass=0.07, com=(0, 0, -0.09), inertia=thin),
                body(f"{leg} foot", foot, parent=f"{leg} shank", mass=0.06, inertia=(1e-5, 1e-5, 1e-5)),
            ]
            feet.append(frame(leg, f"{leg} foot"))
    lengths = {"front": 0.19, "side": 0.05, "hip": 0.06, "thigh": 0.21, "shank": 0.19}
    return make_model("quadruped", bodies, gravity=DOWN, parameters=lengths, frames=feet)


@pytest.mark.parametrize("make", [make_pendulum, make_quadruped], ids=["pendulum", "quadruped"])
def test_a_model_in_python_is_that_of_its_file(make: Callable[[], Model]) -> None:
    model = make()
    assert model == read_model(MODELS / f"{model.name}.yaml")


def test_parts_have_the_defaults_of_a_file(tmp_path: Path) -> None:
    text = """
name: m
gravity: [0, 0, -9.81]
parameters: {k: {value: 2, kind: runtime}}
bodies:
  - {name: a, joint: {type: prismatic, axis: -x}, mass: k}
  - {name: b, parent: a, joint: {type: cardan}, mass: 1, com: [1, 2, 3]}
  - {name: c, parent: a, joint: {type: fixed}}
frames: [{name: f, body: c}]
wrenches: [{name: w, body: b, force: input}]
"""
    file = tmp_path / "model.yaml"
    file.write_text(text, encoding="utf-8")
    bodies = [
        body("a", prismatic("-x"), mass="k"),
        body("b", cardan(), parent="a", mass=1, com=(1, 2, 3)),
        body("c", fixed(), parent="a"),
    ]
    pulls, sensors = [wrench("w", "b", force="input")], [frame("f", "c")]
    made = make_model("m", bodies, gravity=DOWN, parameters={"k": runtime(2)}, frames=sensors, wrenches=pulls)
    assert made == read_model(file)
    assert made.parameters[0].kind is Kind.RUNTIME


def test_numbers_of_any_kind_are_taken() -> None:
    assert number(2) == number(2.0) == number("2") == number(np.float64(2)) == number(np.int64(2)) == number(number(2))
    assert math.copysign(1, number(-0.0).value) == 1
    assert vector(np.array([1.0, 2.0, 3.0])) == vector([1, 2, "3"])


WRONG: dict[str, tuple[Callable[[], object], str]] = {
    "no number": (lambda: number(None), "None"),
    "a truth": (lambda: number(True), "True"),
    "not a number": (lambda: number(math.nan), "nan"),
    "no expression": (lambda: number("l1 +"), "not an expression"),
    "code": (lambda: number("__import__('os')"), "no meaning"),
    "a vector of two": (lambda: body("b", revolute("x"), com=(1, 2)), r"\(1, 2\)"),
    "a vector of a word": (lambda: body("b", revolute("x"), com="xyz"), "'xyz'"),
    "an axis": (lambda: revolute("w"), '"w"'),
    "an axis of two": (lambda: prismatic((1, 2)), r"\(1, 2\)"),
    "an order": (lambda: floating("xyx"), '"xyx"'),
    "an order of another joint": (lambda: cardan("xyz"), '"xyz"'),
    "a turn": (lambda: fixed(orientation=[("-z", 1)]), "'-z'"),
    "a frame": (lambda: wrench("w", "b", frame="world"), "'world'"),  # type: ignore[arg-type]
    "an input": (lambda: wrench("w", "b", force="inputs"), "'inputs'"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize(("make", "finding"), WRONG.values(), ids=WRONG.keys())
def test_what_is_no_part_is_refused_at_once(make: Callable[[], object], finding: str) -> None:
    with pytest.raises(ValueError, match=finding):
        make()


def test_an_unknown_setting_is_refused() -> None:
    with pytest.raises(TypeError, match="dampnig"):
        revolute("x", dampnig=1)  # type: ignore[call-arg]


def test_a_whole_is_judged_as_a_file_is() -> None:
    """All faults together, with the paths that they would have in a file."""
    bodies = [
        body("a", revolute((0, 0, 0)), mass=-1),
        body("b", (revolute("x", damping=-1), prismatic("y", limits=("k", 0))), parent="c"),
        body("d", (revolute("x"),), mass=1),
    ]
    with pytest.raises(InputError) as caught:
        make_model("m", bodies, gravity=DOWN, wrenches=[wrench("w", "a")])
    assert [(fault.file, fault.line, fault.path) for fault in caught.value.faults] == [
        ('model "m"', 0, "bodies[0].joint.axis"),
        ('model "m"', 0, "bodies[0].mass"),
        ('model "m"', 0, "bodies[1].joint[0].damping"),
        ('model "m"', 0, "bodies[1].joint[1].limits[0]"),
        ('model "m"', 0, "bodies[1].parent"),
        ('model "m"', 0, "bodies[2].joint"),
        ('model "m"', 0, "wrenches[0]"),
    ]
