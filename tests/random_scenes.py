"""Random models as their author writes them, and random scenes of them: the ground of the property tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbsgen.expressions import Expression, Number, parse
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.model.changes.scene import Scene
from mbsgen.model.construction import (
    Setting,
    ball,
    body,
    cardan,
    fixed,
    frame,
    inertia,
    make_model,
    planar,
    prismatic,
    revolute,
    runtime,
    spherical,
    wrench,
)
from mbsgen.model.expansion import list_steps
from mbsgen.model.model import BASE, Body, Fixed, Joint, Model
from mbsgen.model.topology import find_carriers
from tests.random_trees import random_inertia

Array = NDArray[np.float64]
AXES: Sequence[str | tuple[float, float, float]] = ("x", "y", "z", "-y", (0.6, 0.0, 0.8), (1.0, -2.0, 0.5))
ANGLES = ("pi/2", "-pi/2", 0.4, "k")


def random_model(seed: int, size: int) -> Model:
    """Make a model of `size` bodies: all joints, sequences, fixed bodies, laws, rotors, sensors, wrenches."""
    rng = np.random.default_rng(seed)
    bodies: list[Body] = []
    for i in range(size):
        xx, yy, zz, xy, xz, yz = _tensor(rng)
        parent = BASE if not i else str(rng.choice([BASE, *(b.name for b in bodies)] if i > 2 else [bodies[-1].name]))
        joint = _draw_carrier(rng) if i else revolute("z", name="first")
        mass = "m" if i == 1 else float(rng.uniform(0.5, 3))
        bodies.append(
            body(f"b{i}", joint, parent=parent, mass=mass, com=_point(rng), inertia=inertia(xx, yy, zz, xy, xz, yz))
        )
    anywhere = [b.name for b in bodies]
    frames = [frame(f"f{k}", str(rng.choice(anywhere)), position=_point(rng), orientation=_turns(rng)) for k in "ab"]
    plain = make_model("random", bodies, gravity=_point(rng, 9.0), parameters={"k": 0.3, "m": runtime(1.5)})
    moving = [name for name, carrier in find_carriers(plain).items() if carrier != BASE]
    wrenches = [
        wrench(
            f"w{k}",
            str(rng.choice(moving)),
            position=_point(rng),
            frame="base" if k else "body",
            force="input" if k < 2 else _point(rng, 5.0),
            moment=(0.1, "k", 0.0) if k else "input",
        )
        for k in range(3)
    ]
    return make_model(
        "random",
        bodies,
        gravity=_point(rng, 9.0),
        parameters={"k": 0.3, "m": runtime(1.5)},
        frames=frames,
        wrenches=wrenches,
    )


OF_ELEMENTS = (
    "distances",
    "lengths",
    "stretches",
    "tensions",
    "contact_forces",
    "touching",
    "meetings",
)  # of few models


def random_scene(model: Model, seed: int) -> Scene:
    """Draw a scene: some joints locked, some sensors and wrenches, perhaps no gravity or no motion, few functions."""
    rng = np.random.default_rng(seed + 10_000)
    steps = [step for i, part in enumerate(model.bodies) for step in list_steps(i, part)]
    joints = [step.name for step in steps if not step.joint.floats]
    count = int(rng.integers(0, len(joints)))
    places: tuple[Expression, ...] = (Number(0.0), Number(0.7), parse("-pi/2"), parse("k/2"))
    locked = tuple((str(name), places[rng.integers(4)]) for name in rng.choice(joints, count, replace=False))
    dynamics = ("impl", "semi", "semi_res", "exp1", "exp2")
    others = [name for name in FUNCTIONS if name not in (*dynamics, "condition", "rates", *OF_ELEMENTS)]
    return Scene(
        functions=(str(rng.choice(dynamics)), str(rng.choice(dynamics)), str(rng.choice(others))),
        locked=locked,
        sensors=None if rng.random() < 0.5 else ("fa",),
        wrenches=None if rng.random() < 0.5 else ("w1",),
        gravity=bool(rng.random() < 0.7),
        motion=bool(rng.random() < 0.7),
        results=() if rng.random() < 0.5 else (("energy", ("kinetic", "com")), ("semi", ("M",))),
    )


def _draw_carrier(rng: np.random.Generator) -> Joint | Fixed | tuple[Joint, ...]:
    place = {"position": _point(rng), "orientation": _turns(rng)}
    match rng.integers(9):
        case 4:
            return ball(**place)
        case 0:
            return fixed(**place)
        case 1:
            return cardan("zx", **place)
        case 2:
            return (_draw_joint(rng), *spherical("zyx", **place)[:1], _draw_joint(rng))
        case 3:
            return planar("xz", **place)
    return _draw_joint(rng)


def _draw_joint(rng: np.random.Generator) -> Joint:
    setting: Setting = {
        "position": _point(rng),
        "orientation": _turns(rng),
        "actuated": bool(rng.random() < 0.7),
        "damping": float(rng.choice([0.0, 0.4])),
    }
    if rng.random() < 0.4:
        setting["armature"] = "m/10" if rng.random() < 0.3 else float(rng.uniform(0.01, 2))
    if rng.random() < 0.3:
        setting["stiffness"], setting["rest"], setting["friction"] = 3.0, "k", (0.2, 0.5)
    make = revolute if rng.random() < 0.7 else prismatic
    return make(AXES[rng.integers(len(AXES))], **setting)


def _point(rng: np.random.Generator, size: float = 0.5) -> tuple[float, float, float]:
    """Draw a vector; half of them lie along an axis."""
    x, y, z = rng.uniform(-size, size, 3) * (rng.permutation([1.0, 0.0, 0.0]) if rng.random() < 0.5 else 1.0)
    return float(x), float(y), float(z)


def _turns(rng: np.random.Generator) -> list[tuple[str, float | str]]:
    return [("xyz"[rng.integers(3)], ANGLES[rng.integers(len(ANGLES))]) for _ in range(rng.integers(3))]


def _tensor(rng: np.random.Generator) -> list[float]:
    tensor = random_inertia(rng)
    if rng.random() < 0.5:
        tensor = np.diag(np.diag(tensor))
    return [float(tensor[r, c]) for r, c in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
