"""Other forms for the data of a model file: orientations, tensors about a point, rows of tables, derived parameters.

What a form replaces need not be the same: the independent program reads all forms by itself.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

from tests.fuzz.kinematics import FLOATS, turn_by, value_of

SHARE = 0.3  # of the parts that can have another form
ANGLES = ("pi/2", "-pi", 0.4, -1.1, "a", "a/2", 0, 0)
LENGTHS = (0.2, -0.35, "l", "l/3", 0, 0)
DERIVED = {"half": "l/2 + 0.05", "load": "m*(1 + a)"}  # parameters of parameters


def vary(model: dict[str, Any], source: random.Random) -> None:
    """Write parts of a model in other forms."""
    if source.random() < SHARE:
        model["parameters"] |= DERIVED
        _derive(model, source)
    for body in model["bodies"]:
        _vary_tensor(body, source)
        joint = body["joint"]
        if isinstance(joint, dict) and joint["type"] in ("revolute", "prismatic") and source.random() < SHARE:
            body["joint"] = _write_row(joint, source)
    for place in _list_places(model):
        if place.get("orientation") and source.random() < SHARE:
            place["orientation"] = _orient(source)


def _derive(model: dict[str, Any], source: random.Random) -> None:
    """Read derived parameters where others are read."""
    for body in model["bodies"]:
        if isinstance(body["mass"], str) and source.random() < SHARE:
            body["mass"] = "load"
    for place in [*model["bodies"], *_list_places(model)]:
        key = "com" if "com" in place else "position"
        place[key] = [source.choice(["half", "-half/2"]) if isinstance(x, str) else x for x in place[key]]


def _list_places(model: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for body in model["bodies"]:
        yield from body["joint"] if isinstance(body["joint"], list) else [body["joint"]]
    yield from model["frames"]
    yield from model.get("contacts", ())


def _vary_tensor(body: dict[str, Any], source: random.Random) -> None:
    """Move the tensor of a body to a point near its centre of mass."""
    if source.random() >= SHARE or body["inertia"] == [0, 0, 0]:
        return
    given, about = body["inertia"], [round(source.uniform(-0.1, 0.1), 3) for _ in "xyz"]
    tensor = dict(given) if isinstance(given, dict) else dict(zip(("xx", "yy", "zz"), given, strict=True))
    d = [f"({com} - {point})" for com, point in zip(body["com"], about, strict=True)]
    for r in range(3):
        for c in range(r, 3):
            squares = [f"{d[k]}**2" for k in range(3) if k != r]
            moved = " + ".join(squares) if r == c else f"-{d[r]}*{d[c]}"
            key = "xyz"[r] + "xyz"[c]
            tensor[key] = _shorten(f"{tensor.get(key, 0)} + ({body['mass']})*({moved})")
    body["inertia"] = tensor | {"about": about}


def _shorten(expression: str) -> Any:
    """Write an expression without names as a number."""
    try:
        return value_of(expression, {}, FLOATS)
    except KeyError:
        return expression


def _write_row(joint: dict[str, Any], source: random.Random) -> dict[str, Any]:
    """Write a joint as a row of a table; it keeps its place and its settings."""
    row = {key: x for key, x in joint.items() if key != "axis"}
    row |= {"type": "dh", "convention": source.choice(["standard", "modified"]), "motion": joint["type"]}
    return row | {
        "a": source.choice(LENGTHS),
        "alpha": source.choice(ANGLES),
        "d": source.choice(LENGTHS),
        "theta": source.choice(ANGLES),
    }


def _orient(source: random.Random) -> dict[str, Any]:
    """Draw an orientation in another form."""
    q = source.choice([[0, 0, 0.6, 0.8], [1, 0, 0, 1], [round(source.uniform(-1, 1), 3) + 1.5 for _ in "xyzw"]])
    rpy = [source.choice(ANGLES) for _ in "xyz"]
    return source.choice([{"rpy": rpy}, {"quaternion": q}, {"matrix": turn_by(FLOATS, *q).tolist()}])
