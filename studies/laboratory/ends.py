"""Random problems of optimal control whose ends lie on their limits, as files: a number -> a model and a problem.

Users write such problems the most: a rail ends where the motion ends, an arm moves to its stop, nothing may move
backwards, and all comes to rest. At such an end the active rows are dependent, so their multipliers are not unique.
Other kinds have rows twice, fixed variables, equations that follow from others, or a feasible set without an interior.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbsrun.ocp.problem.problem import Form, Representation
from studies.laboratory.mechanisms import write

Rng = np.random.Generator
Problem = dict[str, Any]  # as its file says it

MASSES = (1.0, 2.0, 0.5)
NAMES = ("a", "b", "c")
ROD = {"mass": 1, "com": [0.25, 0, 0], "inertia": [0.002, 0.02, 0.02]}


def _slide(name: str, mass: float, **other: object) -> dict[str, object]:
    return {"name": name, "joint": {"type": "prismatic", "axis": "x"}, "mass": mass, **other}


def _turn(name: str, parent: str) -> dict[str, object]:
    place = {"position": [0.5, 0, 0]} if parent else {}
    above = {"parent": parent} if parent else {}
    return {"name": name, **above, "joint": {"type": "revolute", "axis": "z", **place}, **ROD}


def _name(name: str, bodies: list[dict[str, object]], **other: object) -> str:
    return json.dumps({"name": name, "gravity": [0, 0, 0], "bodies": bodies, **other}, indent=1)


RAILS = tuple(_name(f"rail{n}", [_slide(*pair) for pair in zip(NAMES[:n], MASSES, strict=False)]) for n in range(1, 4))
STACK = _name("stack", [_slide("a", 1.0), _slide("b", 2.0, parent="a")])  # the second one rides on the first
ARMS = tuple(
    _name(
        f"arm{n}",
        [_turn(name, parent) for name, parent in zip(NAMES[:n], ("", *NAMES), strict=False)],
        gravity=[0, -9.81, 0],
    )
    for n in (2, 3)
)
CRANE = _name(
    "crane",
    [
        _slide("trolley", 1.0),
        {
            "name": "load",
            "parent": "trolley",
            "joint": {"type": "revolute", "axis": "-y", "actuated": False},
            "mass": 2,
            "com": [0, 0, -1],
        },
    ],
    gravity=[0, 0, -9.81],
    frames=[{"name": "load", "body": "load", "position": [0, 0, -1]}],
)


@dataclass(frozen=True)
class Draw:
    """A random problem: its kind, and the text of both files."""

    number: int
    kind: str
    model: str
    problem: Problem  # without its model

    def write(self, folder: Path) -> Path:
        """Write both files; return the path of the problem's."""
        model = write(folder, self.model)
        path = folder / f"end_{self.number:03d}.ocp.yaml"
        path.write_text(json.dumps({"model": model.name, **self.problem}, indent=1) + "\n", encoding="utf-8")
        return path


def draw(number: int) -> Draw:
    """Draw a problem; kinds take turns."""
    rng = np.random.default_rng([40, number])
    kinds = tuple(KINDS)
    kind = kinds[number % len(kinds)]
    model, problem = KINDS[kind](rng)
    return Draw(number, kind, model, {**problem, **_draw_form(rng, problem)})


# --- the grid and the form ------------------------------------------------------------------------------------------


def _draw_form(rng: Rng, problem: Problem) -> Problem:
    """Draw how a motion becomes variables: forms, representations, points."""
    found: Problem = {
        "intervals": int(rng.integers(8, 25)),
        "scheme": str(rng.choice(["radau", "legendre"])),
        "degree": int(rng.integers(2, 5)),
    }
    forms = [Form.STANDARD] if "controls" in problem else [Form.STANDARD, Form.INTEGRAL, Form.SHOOTING]
    form = forms[int(rng.integers(len(forms)))]
    if form is Form.SHOOTING:
        ways = [way for way in Representation if way.is_ode or not way.is_explicit]
    else:
        ways = list(Representation)
    way = ways[int(rng.integers(len(ways)))]
    if form is Form.SHOOTING and way.is_explicit and rng.random() < 0.5:
        found |= {"integrator": "rk4", "steps": 2}
    return {**found, "form": form.value, "representation": way.value}


# --- kinds ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Motion:
    """A motion of masses from rest to rest."""

    model: str
    starts: tuple[float, ...]
    ends: tuple[float, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Name the coordinates."""
        return NAMES[: len(self.starts)]

    def state(self, rng: Rng) -> Problem:
        """State it with a cost: of force, of force and velocity, or time."""
        ways = dict(zip(self.names, self.ends, strict=True))
        start = {"pose": dict(zip(self.names, self.starts, strict=True))}
        found: Problem = {"start": start, "end": {"pose": ways, "velocity": "zero"}}
        horizon = _round(rng.uniform(1, 3))
        kind = rng.random()
        if kind < 0.15:
            found["horizon"] = {"guess": horizon, "range": [0.2, 10]}
            found["cost"] = {"inputs": 0, "terminal": [{"expression": "T"}]}
            found["bounds"] = {"inputs": [-5, 5]}
            return found
        found["horizon"] = horizon
        found["cost"] = {"inputs": 1}
        if kind < 0.4:
            found["cost"]["running"] = [{"expression": f"qd_{name}**2"} for name in self.names]
        elif kind < 0.5:
            found["cost"]["input_rates"] = 0.1
        return found

    def box(self, rng: Rng) -> dict[str, list[float]]:
        """Return limits of some coordinates: a rail that ends where the motion ends, or begins where it begins."""
        found: dict[str, list[float]] = {}
        for name, start, end in zip(self.names, self.starts, self.ends, strict=True):
            low, high = min(start, end), max(start, end)
            wide = _round(rng.uniform(0.1, 2))
            if rng.random() < 0.3:
                continue
            beyond = wide if rng.random() < 0.6 else 0.0
            first = [low - beyond, high] if end > start else [low, high + beyond]
            found[name] = [_round(x) for x in first]
        if not found:
            found[self.names[-1]] = [min(self.starts[-1], self.ends[-1]), max(self.starts[-1], self.ends[-1])]
        return found


def _draw_motion(rng: Rng, least: int = 1) -> _Motion:
    models = [*RAILS[least - 1 :], STACK]
    model = models[int(rng.integers(len(models)))]
    count = len(json.loads(model)["bodies"])
    starts = [0.0 if rng.random() < 0.6 else _round(rng.uniform(-0.5, 0.5)) for _ in range(count)]
    ends = [_round(start + rng.choice([-1, 1, 1]) * rng.uniform(0.3, 2.5)) for start in starts]
    return _Motion(model, tuple(starts), tuple(ends))


def _bound(problem: Problem, key: str, ranges: Mapping[str, object]) -> Problem:
    bounds = problem.get("bounds", {})
    return {**problem, "bounds": {**bounds, key: {**bounds.get(key, {}), **ranges}}}


def _constrain(problem: Problem, *rows: Mapping[str, object]) -> Problem:
    return {**problem, "constraints": [*problem.get("constraints", []), *rows]}


def _draw_coordinates(rng: Rng) -> tuple[str, Problem]:
    """Rails that end where the motion ends."""
    motion = _draw_motion(rng)
    return motion.model, _bound(motion.state(rng), "coordinates", motion.box(rng))


def _draw_velocities(rng: Rng) -> tuple[str, Problem]:
    """Nothing moves backwards; at rest at both ends, velocities are at their bound."""
    motion = _draw_motion(rng)
    ways = zip(motion.names, motion.starts, motion.ends, strict=True)
    ranges = {name: [0, None] if end > start else [None, 0] for name, start, end in ways if rng.random() < 0.8}
    return motion.model, _bound(motion.state(rng), "velocities", ranges or {"a": _away(motion)})


def _away(motion: _Motion) -> list[int | None]:
    return [0, None] if motion.ends[0] > motion.starts[0] else [None, 0]


def _draw_sum(rng: Rng) -> tuple[str, Problem]:
    """A row of several coordinates, or of velocities, ends at its limit."""
    motion = _draw_motion(rng, 2)
    ways = np.sign(np.subtract(motion.ends, motion.starts))
    weights = [int(rng.integers(1, 4)) * int(way) for way in ways]
    value = float(np.dot(weights, motion.ends))
    rows: list[Mapping[str, object]] = []
    if rng.random() < 0.7:
        text = " + ".join(f"({w})*q_{name}" for w, name in zip(weights, motion.names, strict=True))
        rows.append({"expression": text, "range": [None, round(value, 9)]})
    if not rows or rng.random() < 0.4:
        text = " + ".join(f"({w})*qd_{name}" for w, name in zip(weights, motion.names, strict=True))
        rows.append({"expression": text, "range": [0, None]})
    return motion.model, _constrain(motion.state(rng), *rows)


def _draw_stop(rng: Rng) -> tuple[str, Problem]:
    """An arm moves to the stop of a joint, or of some."""
    model = ARMS[int(rng.integers(len(ARMS)))]
    count = len(json.loads(model)["bodies"])
    starts = [_round(x) for x in rng.uniform(-1, 1, count)]
    ends = [_round(start + rng.choice([-1, 1]) * rng.uniform(0.3, 1.5)) for start in starts]
    motion = _Motion(model, tuple(starts), tuple(ends))
    stops: dict[str, list[float]] = {}
    for name, start, end in zip(motion.names, starts, ends, strict=True):
        if not stops or rng.random() < 0.4:
            wide = _round(rng.uniform(0.5, 2))
            stops[name] = [_round(start - wide), end] if end > start else [end, _round(start + wide)]
    problem: Problem = {
        "horizon": _round(rng.uniform(0.8, 2)),
        "cost": {"inputs": 1},
        "start": {"pose": dict(zip(motion.names, starts, strict=True))},
        "end": {"pose": dict(zip(motion.names, ends, strict=True)), "velocity": "zero"},
    }
    return model, _bound(problem, "coordinates", stops)


def _draw_crane(rng: Rng) -> tuple[str, Problem]:
    """A hanging load is moved to rest at a wall, in least time or at least force."""
    way = _round(rng.uniform(0.5, 4))
    problem: Problem = {
        "start": {"pose": {}},
        "end": {"pose": {"trolley": way, "load": 0}, "velocity": "zero"},
        "bounds": {"inputs": {"trolley": [-10, 10]}},
    }
    if rng.random() < 0.7:
        problem |= {"horizon": {"guess": 3, "range": [0.5, 10]}, "cost": {"terminal": [{"expression": "T"}]}}
    else:
        problem |= {"horizon": 3, "cost": {"inputs": 1}}
    if rng.random() < 0.4:
        problem = _bound(problem, "coordinates", {"trolley": [0 if rng.random() < 0.5 else -1, way]})
    if "coordinates" not in problem["bounds"] or rng.random() < 0.5:
        problem = _constrain(problem, {"expression": "x_load", "range": [None, way]})
    return CRANE, problem


def _draw_friction(rng: Rng) -> tuple[str, Problem]:
    """Work without a sign, by split forces or velocities: both parts are at their bound at rest."""
    motion = _draw_motion(rng)
    problem = motion.state(rng)
    name = motion.names[0]
    problem["controls"] = {"ahead": {"range": [0, None], "guess": 0.5}, "back": {"range": [0, None]}}
    split = f"u_{name}"
    if rng.random() < 0.7:  # dry friction: a velocity differs from point to point
        split, problem["inputs"] = f"qd_{name}", "polynomial"
        problem["cost"].pop("input_rates", None)
    price = _round(rng.uniform(0.1, 2))
    running = [*problem["cost"].get("running", []), {"expression": "ahead + back", "weight": price}]
    problem["cost"] = {**problem["cost"], "running": running}
    problem = _constrain(problem, {"expression": f"{split} - ahead + back", "range": [0, 0]})
    if rng.random() < 0.5:
        problem = _bound(problem, "coordinates", motion.box(rng))
    return motion.model, problem


def _draw_duplicated(rng: Rng) -> tuple[str, Problem]:
    """A limit is said twice or three times: as a bound, as a row, as a multiple of a row."""
    motion = _draw_motion(rng)
    problem, box = motion.state(rng), motion.box(rng)
    if rng.random() < 0.5:
        problem = _bound(problem, "coordinates", box)
    for name, (low, high) in box.items():
        problem = _constrain(problem, {"expression": f"q_{name}", "range": [low, high]})
        if rng.random() < 0.6:
            problem = _constrain(
                problem, {"expression": f"2*q_{name}", "range": [round(2 * low, 9), round(2 * high, 9)]}
            )
    return motion.model, problem


def _draw_fixed(rng: Rng) -> tuple[str, Problem]:
    """One mass is fixed by its bounds, by its force, or by both; others move to the ends of their rails."""
    motion = _draw_motion(rng, 2)
    names, k = motion.names, int(rng.integers(len(motion.names)))
    ends = tuple(motion.starts[i] if i == k else end for i, end in enumerate(motion.ends))
    motion = _Motion(motion.model if motion.model != STACK else RAILS[1], motion.starts, ends)
    problem = motion.state(rng)
    box = {name: limits for name, limits in motion.box(rng).items() if name != names[k]}
    problem = _bound(problem, "coordinates", box) if box else problem
    if rng.random() < 0.7:
        problem = _bound(problem, "coordinates", {names[k]: [motion.starts[k], motion.starts[k]]})
    if rng.random() < 0.4:
        problem = _bound(problem, "velocities", {names[k]: [0, 0]})
    if rng.random() < 0.4:
        free = {name: [-5, 5] for name in names}
        bounds = problem.get("bounds", {})
        problem = {**problem, "bounds": {**bounds, "inputs": {**free, names[k]: [0, 0]}}}
    return motion.model, problem


def _draw_implied(rng: Rng) -> tuple[str, Problem]:
    """Equations at the end, or along the path, that follow from others."""
    motion = _draw_motion(rng, 2)
    problem = motion.state(rng)
    text = " + ".join(f"q_{name}" for name in motion.names)
    problem = _constrain(problem, {"expression": text, "range": [round(sum(motion.ends), 9)] * 2, "at": "end"})
    if rng.random() < 0.5:
        problem = _constrain(problem, {"expression": "qd_a - 2*qd_b", "range": [0, 0], "at": "end"})
    if rng.random() < 0.5:
        problem = _bound(problem, "coordinates", motion.box(rng))
    return motion.model, problem


def _draw_empty(rng: Rng) -> tuple[str, Problem]:
    """Two inequalities that leave an equation: no point has room on either side."""
    motion = _draw_motion(rng, 2)
    starts, ends = list(motion.starts), list(motion.ends)
    if rng.random() < 0.5:  # the first two move together
        starts[1], ends[1] = starts[0], ends[0]
        model = motion.model if motion.model != STACK else RAILS[1]
        motion, text = _Motion(model, tuple(starts), tuple(ends)), "q_a - q_b"
        value = 0.0
    else:
        ends[0] = starts[0]
        motion, text, value = _Motion(motion.model, tuple(starts), tuple(ends)), "q_a", starts[0]
    rows = ({"expression": text, "range": [value, None]}, {"expression": text, "range": [None, value]})
    problem = _constrain(motion.state(rng), *rows)
    if rng.random() < 0.4:
        box = {name: limits for name, limits in motion.box(rng).items() if name not in ("a", "b")}
        problem = _bound(problem, "coordinates", box) if box else problem
    return motion.model, problem


def _round(x: float) -> float:
    """Return a number as users write it."""
    return round(float(x), 2)


KINDS: Mapping[str, Callable[[Rng], tuple[str, Problem]]] = {
    "coordinates": _draw_coordinates,
    "velocities": _draw_velocities,
    "sum": _draw_sum,
    "stop": _draw_stop,
    "crane": _draw_crane,
    "friction": _draw_friction,
    "duplicated": _draw_duplicated,
    "fixed": _draw_fixed,
    "implied": _draw_implied,
    "empty": _draw_empty,
}
