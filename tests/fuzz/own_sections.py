"""The sections of a drawn problem along a motion: the terms of its cost, and numbers with their limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Manifest
from tests.fuzz.formulas import Formula
from tests.fuzz.own_mechanism import Known
from tests.fuzz.own_motion import Motion, find_weights
from tests.fuzz.own_problem import Problem, name_slack
from tests.fuzz.own_recordings import list_squares
from tests.fuzz.problem_names import spell

Array = NDArray[np.float64]
Range = tuple[float, float]
Targets = dict[str, float | None]

NEAR = 1e-9  # a point as near to an interval's end is there
UNKNOWN = ("free", "link")  # histories that are no numbers


@dataclass(frozen=True)
class Demand:
    """Numbers that stay within limits."""

    title: str
    values: Array
    limits: Range
    is_optional: bool = False  # a program may ask it, or not: it follows from others, or is for nothing


class Sections:
    """Reads the sections along a motion."""

    def __init__(self, problem: Problem, motion: Motion, manifest: Manifest) -> None:
        self.problem, self.motion, self.manifest = problem, motion, manifest
        self.data, self.own = problem.data, problem.own
        self.points, self.first, self.last = (
            problem.at_points(motion),
            problem.at_end(motion, 0),
            problem.at_end(motion, 1),
        )
        N = motion.intervals
        self.inner = problem.at_mesh(motion, list(range(1, N + 1)))
        self.h = motion.T * problem.fractions
        self.weights = (self.h[:, None] * find_weights(problem.nodes)).ravel()

    # -- the cost -------------------------------------------------------------------------------------------------

    def list_costs(self) -> dict[str, float]:
        """Return the terms of the cost, weights included."""
        cost, problem, found = self.data["cost"], self.problem, {}
        plain = [x for x in self.own.inputs if x not in problem.lifted and x not in problem.forces]
        others = any(cost.get(key) for key in ("running", "terminal", "largest", "input_rates", "track"))
        price = problem.number(cost.get("inputs", 0 if others else 1))
        for title, names in (("inputs", plain), ("continuous inputs", problem.lifted)):
            found[title] = price * sum(self.integrate(self.points[f"u_{spell(x)}"] ** 2) for x in names)
        price = problem.number(cost.get("input_rates", 0))
        found["input rates"] = price * sum(self.sum_rates(problem.u[x]) for x in plain)
        for x in problem.lifted:
            found[f"rates of {x}"] = price * self.integrate(self.points[f"rate_u_{spell(x)}"] ** 2)
        for i, part in enumerate(cost.get("running", ())):
            found[f"running {i}"] = self.weigh(part) * self.integrate(part["expression"].evaluate(self.points))
        for part in cost.get("track", ()):
            for name, tree in list_squares(part).items():
                weight = self.weigh(part) * part.get("weights", {}).get(name, 1)
                found[f"track {name}"] = weight * self.integrate(Formula(tree).evaluate(self.points))
        for i, part in enumerate(cost.get("terminal", ())):
            found[f"terminal {i}"] = self.weigh(part) * float(part["expression"].evaluate(self.last)[0])
        for i, part in enumerate(cost.get("largest", ())):
            found[f"largest {i}"] = self.weigh(part) * problem.unknowns[part["name"]]
        for name, part in self.data.get("controls", {}).items():
            weight = problem.number(part.get("rate", {}).get("weight", 0))
            lifted = name in problem.lifted_controls
            rate = self.integrate(self.points[f"rate_{name}"] ** 2) if lifted else 0.0
            found[f"rate of {name}"] = weight * (rate if lifted else self.sum_rates(problem.controls[name]))
        for i, part in enumerate(self.data["constraints"]):
            if "soft" in part:
                found |= self.price_slack(i, part)
        return found

    def weigh(self, part: dict[str, Any]) -> float:
        return self.problem.number(part.get("weight", 1))

    def integrate(self, values: Array) -> float:
        return float((self.weights * np.broadcast_to(values, self.weights.shape)).sum())

    def sum_rates(self, values: Array) -> float:
        """Sum squared differences of constant inputs (N, d) over the distances of midpoints."""
        distance = (self.h[1:] + self.h[:-1]) / 2
        return float((np.diff(values[:, 0]) ** 2 / distance).sum())

    def price_slack(self, i: int, part: dict[str, Any]) -> dict[str, float]:
        soft, name = part["soft"], name_slack(i, part["soft"])
        prices = soft if isinstance(soft, dict) else {"linear": soft}
        found = {}
        for key, power in (("linear", 1), ("quadratic", 2)):
            price = self.problem.number(prices.get(key, 0))
            if part.get("at", "path") == "path":
                found[f"{name} {key}"] = price * self.integrate(self.points[name] ** power)
            else:
                found[f"{name} {key}"] = price * self.problem.unknowns[name] ** power
        return found

    # -- limits ---------------------------------------------------------------------------------------------------

    def list_demands(self) -> list[Demand]:
        """Return everything that has limits; unlimited numbers are left out."""
        every = [
            *self.ask_start(),
            *self.ask_end(),
            *self.ask_states(),
            *self.ask_inputs(),
            *self.ask_added(),
            *self.ask_constraints(),
        ]
        return [x for x in every if np.isfinite(x.limits).any() and x.values.size]

    def read(self, limits: Any) -> Range:
        """Read a range of the file."""
        low, high = limits
        lower = -np.inf if low is None else self.problem.number(low)
        return lower, np.inf if high is None else self.problem.number(high)

    def ask_start(self) -> Iterator[Demand]:
        given, motion, own = self.data["start"], self.motion, self.own
        numbers = self.problem.mechanism.find_quaternions()
        pose: Targets = dict.fromkeys(own.positions, 0.0)
        pose |= {own.positions[i + 3]: 1.0 for i in numbers}
        if own.is_closed:
            pose = dict(zip(own.positions, own.pose, strict=True))
        pose |= {x: None if value is None else self.problem.number(value) for x, value in given["pose"].items()}
        for i in numbers:
            names = own.positions[i : i + 4]
            values = [pose[x] for x in names]
            if None in values:
                length = (motion.q[0, i : i + 4] ** 2).sum()
                yield Demand("length", np.array([length]), (1.0, 1.0))
                continue
            size = float(np.linalg.norm(np.array(values, dtype=float)))
            pose |= {x: value / size for x, value in zip(names, values, strict=True) if value is not None}
        speeds: Targets = dict.fromkeys(own.velocities, 0.0)
        speeds |= {
            x: None if value is None else self.problem.number(value) for x, value in given.get("velocity", {}).items()
        }
        pose, speeds = self.complete(pose, speeds)
        free = {*own.free, *own.turning}
        for names, values, wanted in ((own.positions, motion.q[0], pose), (own.velocities, motion.qd[0], speeds)):
            for name, value in zip(names, values, strict=True):
                if (target := wanted.get(name)) is not None:
                    follows = name not in free
                    yield Demand(f"start {name}", np.array([value]), (target, target), is_optional=follows)

    def complete(self, pose: Targets, speeds: Targets) -> tuple[Targets, Targets]:
        """Complete a start by the loops; driven joints have none."""
        own = self.own
        if own.is_closed:
            usual = dict(zip(own.positions, own.pose, strict=True))
            q = np.array([usual[x] if x not in own.settled or pose[x] is None else pose[x] for x in own.positions])
            qd = np.array([speeds[x] or 0.0 if x in own.free else 0.0 for x in own.velocities])
            mechanism = self.problem.mechanism
            places, driven = mechanism.places, list(own.driven)
            q[places], qd[driven] = (x[0] for x in mechanism.drive(np.zeros(1))[:2])
            q, qd = (x[0] for x in mechanism.close(q[None], qd[None]))
            pose = {x: q[i] if pose.get(x, 0) is not None else None for i, x in enumerate(own.positions)}
            speeds = {x: qd[i] if speeds.get(x, 0) is not None else None for i, x in enumerate(own.velocities)}
        moved = {own.velocities[i] for i in own.driven}
        return ({x: y for x, y in part.items() if x not in moved} for part in (pose, speeds))  # type: ignore[return-value]

    def is_free(self, name: str, *, velocity: bool) -> bool:
        """Return whether the start leaves a coordinate or a velocity free."""
        part = self.data["start"].get("velocity", {}) if velocity else self.data["start"]["pose"]
        return name in part and part[name] is None

    @property
    def has_free_start(self) -> bool:
        """Return whether anything of the mechanism is free at the start."""
        return any(self.is_free(x, velocity=False) for x in self.own.positions) or any(
            self.is_free(x, velocity=True) for x in self.own.velocities
        )

    def ask_end(self) -> Iterator[Demand]:
        end, number = self.data.get("end", {}), self.problem.number
        for name, where in end.get("sensors", {}).items():
            wanted = {axis: number(x) for axis, x in where.items()}
            if "radius" in wanted:
                r, a = wanted["radius"], wanted["azimuth"]
                wanted = {"x": r * np.cos(a), "y": r * np.sin(a), "z": wanted["height"]}
            for axis, x in wanted.items():
                yield Demand(f"end {axis} {name}", self.last[f"{axis}_{spell(name)}"], (x, x))
        for name, where in end.get("sensor_velocities", {}).items():
            for axis in "xyz":
                x = number(where.get(axis, 0))
                yield Demand(f"end v{axis} {name}", self.last[f"v{axis}_{spell(name)}"], (x, x))
        for key, prefix in (("pose", "q"), ("velocity", "qd"), ("acceleration", "qdd")):
            for name, x in self.list_ends(key).items():
                title = f"end {name}" if key == "pose" else f"end {key} {name}"
                yield Demand(title, self.last[f"{prefix}_{spell(name)}"], (x, x))

    def list_ends(self, key: str) -> dict[str, float]:
        """Return the given values of the end's pose, velocity or acceleration; attitudes have another condition."""
        given = self.data.get("end", {}).get(key, {})
        given = dict.fromkeys(self.own.free, 0.0) if given == "zero" else given
        return {
            name: self.problem.number(x) for name, x in given.items() if key != "pose" or name not in self.own.turning
        }

    def ends_within(self, name: str, key: str, limits: Range) -> bool:
        """Return whether the end gives a coordinate or a velocity, within its limits: they ask nothing more of it."""
        value = self.list_ends(key).get(name)
        return value is not None and limits[0] <= value <= limits[1]

    def find_attitudes(self) -> list[float]:
        """Return the squared distance of each attitude at the end from the one that is asked for."""
        pose, found = self.data.get("end", {}).get("pose", {}), []
        for first in self.problem.mechanism.find_quaternions():
            names = self.own.positions[first : first + 4]
            if names[0] in pose:
                wanted = np.array([self.problem.number(pose[x]) for x in names])
                q = self.motion.q[-1, first : first + 4]
                found.append(float(q @ q - (q @ wanted) ** 2 / (wanted @ wanted)))
        return found

    def bound(
        self, title: str, points: Array, mesh: Array, limits: Range, *, start: bool, end: bool = False
    ) -> Iterator[Demand]:
        """Bound a state at points and mesh points; at the start and at the end only where it is not given."""
        last = end and self.problem.nodes[-1] > 1 - NEAR  # the last point is the end
        yield Demand(title, points[:-1], limits)
        yield Demand(title, points[-1:], limits, is_optional=last)
        yield Demand(title, mesh[1:-1], limits)
        yield Demand(title, mesh[:1], limits, is_optional=start)
        yield Demand(title, mesh[-1:], limits, is_optional=end)

    def ask_states(self) -> Iterator[Demand]:
        bounds, motion, own = self.data.get("bounds", {}), self.motion, self.own
        coordinates = {c.name: c for c in self.manifest.coordinates}
        given = bounds.get("coordinates", {})
        for i, name in enumerate(own.positions):
            c = coordinates.get(name)
            usual = (-np.inf, np.inf) if c is None else self.read((c.lower, c.upper))
            limits = self.read(given[name]) if name in given else usual
            points, mesh = motion.point_q[:, :, i].ravel(), motion.q[:, i]
            if name in self.known:
                continue
            start, end = not self.is_free(name, velocity=False), self.ends_within(name, "pose", limits)
            yield from self.bound(f"bound {name}", points, mesh, limits, start=start, end=end)
        given = bounds.get("velocities", {})
        for i, name in enumerate(own.velocities):
            speed = coordinates[name].max_speed
            usual = (-np.inf, np.inf) if speed is None else (-speed, speed)
            limits = self.read(given if isinstance(given, list) else given[name]) if self.names(given, name) else usual
            points, mesh = motion.point_qd[:, :, i].ravel(), motion.qd[:, i]
            if name in self.known:
                continue
            start, end = not self.is_free(name, velocity=True), self.ends_within(name, "velocity", limits)
            yield from self.bound(f"bound of the velocity {name}", points, mesh, limits, start=start, end=end)

    @staticmethod
    def names(given: Any, name: str) -> bool:
        return isinstance(given, list) or name in given

    @property
    def known(self) -> list[str]:
        """List the driven joints whose motion nothing that is chosen changes: their bounds are checked before."""
        chosen = {*self.data.get("unknowns", {})} | ({"t", "T"} if self.problem.is_free else set())
        return [x for x, drive in self.data.get("driven", {}).items() if not drive.names & chosen]

    def ask_inputs(self) -> Iterator[Demand]:
        bounds, problem = self.data.get("bounds", {}), self.problem
        given, rates = bounds.get("inputs", {}), bounds.get("input_rates", {})
        forces = {c.name: c.max_force for c in self.manifest.coordinates}
        for name in self.own.inputs:
            force = forces[name]
            usual = (-np.inf, np.inf) if force is None else (-force, force)
            limits = self.read(given if isinstance(given, list) else given[name]) if self.names(given, name) else usual
            limited = self.read(rates if isinstance(rates, list) else rates[name]) if self.names(rates, name) else None
            points = self.points[f"u_{spell(name)}"]
            state = f"input_{spell(name)}" if name in problem.lifted else None
            delay = problem.inputs.get("delay", {}).get(name)
            history = problem.inputs.get("history", {}).get(name, 0)
            early = 0.0 if delay is None or history in UNKNOWN else delay
            yield from self.bound_input(f"input {name}", points, state, limits, limited, early)
            if delay is not None:
                yield from self.delay(f"delay of {name}", points, state, f"rate_u_{spell(name)}", delay, history)
        for name, part in self.data.get("controls", {}).items():
            limits = self.read(part.get("range", (None, None)))
            limited = self.read(part["rate"].get("range", (None, None))) if "rate" in part else None
            state = name if name in problem.lifted_controls else None
            history = part.get("history", 0)
            early = part.get("delay", 0.0) if history not in UNKNOWN else 0.0
            yield from self.bound_input(f"control {name}", self.points[name], state, limits, limited, early)
            if "delay" in part:
                yield from self.delay(
                    f"delay of {name}", self.points[name], state, f"rate_{name}", part["delay"], history
                )

    def bound_input(
        self, title: str, points: Array, state: str | None, limits: Range, rates: Range | None, known: float
    ) -> Iterator[Demand]:
        """Bound an input and its rate; `state` is its name where it is one. Until `known` it has a known value."""
        if state is None:
            yield Demand(title, points[~self.find_early(known)], limits)
            if rates is not None:
                values = points.reshape(self.motion.intervals, -1)[:, 0]
                yield Demand(f"rate of {title}", np.diff(values) / ((self.h[1:] + self.h[:-1]) / 2), rates)
            return
        fixed = known > 0
        mesh = self.motion.states[state]
        yield from self.bound(title, points, mesh, limits, start=fixed)
        if rates is not None:
            rate = f"rate_u_{state.removeprefix('input_')}" if state.startswith("input_") else f"rate_{state}"
            yield Demand(f"rate of {title}", self.points[rate], rates, is_optional=fixed)

    def find_early(self, delay: float) -> NDArray[np.bool_]:
        """Mark the points of intervals that begin before a time."""
        early = self.motion.t[:-1] < delay - NEAR * self.motion.T
        return np.repeat(early, len(self.problem.nodes))

    def delay(
        self, title: str, points: Array, state: str | None, rate: str, delay: float, history: Any
    ) -> Iterator[Demand]:
        """Ask a delayed input to be its history at first."""
        if history in UNKNOWN:
            return
        before = self.problem.number(history)
        early = self.find_early(delay)
        if state is None:
            yield Demand(title, points[early], (before, before))
            return
        yield Demand(title, self.motion.states[state][:1], (before, before))
        yield Demand(title, self.points[rate][early], (0.0, 0.0))

    def ask_added(self) -> Iterator[Demand]:
        motion, problem, data = self.motion, self.problem, self.data
        for name, part in data.get("states", {}).items():
            start, end = (self.condition(part.get(key)) for key in ("start", "end"))
            mesh, points = motion.states[name], motion.point_states[name].ravel()
            yield Demand(f"start {name}", mesh[:1], start)
            yield Demand(f"end {name}", mesh[-1:], end)
            limits = self.read(part.get("range", (None, None)))
            given = [x[0] == x[1] for x in (start, end)]
            yield from self.bound(f"range of {name}", points, mesh, limits, start=given[0], end=given[1])
        for i, part in enumerate(data.get("integrals", ())):
            yield Demand(f"integral {i}", motion.states[f"@integral {i}"][-1:], self.read(part["range"]))
        for name, part in problem.list_components().items():
            if isinstance(part, dict):
                yield Demand(name, self.points[name], self.read(part.get("range", (None, None))))
        for name, limits in data.get("bounds", {}).get("tau", {}).items():
            yield Demand(f"tau {name}", self.points[f"tau_{spell(name)}"], self.read(limits))
        for name, part in data.get("unknowns", {}).items():
            yield Demand(name, np.array([problem.unknowns[name]]), self.read(part.get("range", (None, None))))
        if problem.is_free:
            yield Demand("horizon", np.array([motion.T]), self.read(data["horizon"]["range"]))

    def condition(self, given: Any) -> Range:
        if isinstance(given, list):
            return self.read(given)
        return self.read((given, given))

    def ask_constraints(self) -> Iterator[Demand]:
        for i, part in enumerate(self.data["constraints"]):
            at, limits = part.get("at", "path"), self.read(part["range"])
            formula = part["expression"]
            if "soft" not in part:
                yield from self.ask(f"constraint {i}", formula, at, limits, jumps=False)
                continue
            name = name_slack(i, part["soft"])
            where = self.points[name] if at == "path" else np.array([self.problem.unknowns[name]])
            yield Demand(name, where, (0.0, np.inf))
            sides = (("-", (-np.inf, limits[1])), ("+", (limits[0], np.inf)))
            for sign, side in sides:
                yield from self.ask(f"soft {i}", Formula((sign, formula.tree, name)), at, side, jumps=at == "path")
        for i, part in enumerate(self.data["cost"].get("largest", ())):
            tree, name = part["expression"].tree, part["name"]
            yield from self.ask(f"largest {i}", Formula(("-", tree, name)), "path", (-np.inf, 0.0), jumps=False)
            if part.get("absolute"):
                yield from self.ask(f"largest {i}", Formula(("+", tree, name)), "path", (0.0, np.inf), jumps=False)

    def ask(self, title: str, formula: Formula, at: str, limits: Range, *, jumps: bool) -> Iterator[Demand]:
        """Ask an expression to stay within limits: along the path at points, and at mesh points unless it jumps."""

        def compute(known: Known, count: int) -> Array:
            return np.broadcast_to(formula.evaluate(known), count)

        if at != "path":
            yield Demand(title, compute(self.first if at == "start" else self.last, 1), limits)
            return
        yield Demand(title, compute(self.points, len(self.weights)), limits)
        if jumps or formula.names & set(self.list_jumping()):
            return
        yield Demand(title, compute(self.inner, self.motion.intervals), limits)
        first = self.problem.at_mesh(self.motion, [0])
        yield Demand(title, compute(first, 1), limits, is_optional=not self.has_free_start)

    def list_jumping(self) -> list[str]:
        """List the names of quantities that jump where an interval ends."""
        own = self.own
        names = [f"u_{spell(x)}" for x in own.inputs] + [f"qdd_{spell(x)}" for x in own.velocities]
        names += [f"tau_{spell(own.velocities[i])}" for i in own.driven]
        return [*names, *self.problem.list_components(), *self.problem.controls]
