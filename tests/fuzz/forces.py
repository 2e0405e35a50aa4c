"""Applied forces of a model file: wrenches, force elements and contacts, in the base frame.

This is an independent program: it reads the YAML's data, and shares no line with the generator. A force is applied at a
point that moves with its body; the equations are the documented ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from mbsgen.model.tree import Tree
from tests.fuzz.kinematics import Array, Data, Kinematics, Motion, Values, value_of


@dataclass(frozen=True)
class Applied:
    """A force and a moment at a point of a body."""

    body: str
    motion: Motion  # of the point
    force: Array
    moment: Array


class Forces:
    """The forces of a model whose bodies move."""

    def __init__(
        self, kinematics: Kinematics, bodies: Mapping[str, Motion], q: Values, qd: Values, given: Values
    ) -> None:
        self.own, self.bodies, self.model = kinematics, bodies, kinematics.model
        self.functions = kinematics.numbers.functions
        numbers = {name: kinematics.numbers.make(x) for name, x in given.items() if isinstance(x, float)}
        self.names = {**kinematics.names, **given, **numbers}
        for kind, column in (("q", q), ("qd", qd)):
            self.names |= {f"{kind}_{spell(name)}": x for name, x in column.items()}
        for frame in self.model.get("frames", ()):
            motion = kinematics.place(bodies[frame["body"]], frame)
            for axis, p, v in zip("xyz", motion.p, motion.v, strict=True):
                self.names |= {f"{axis}_{spell(frame['name'])}": p, f"v{axis}_{spell(frame['name'])}": v}

    def list_applied(self, w: Values) -> Iterator[Applied]:
        """List all forces; `w` holds `NAME.force` and `NAME.moment` of wrenches that are inputs, signals, and `t`."""
        for wrench in self.model.get("wrenches", ()):
            yield self._wrench(wrench, w)
        for element in self.model.get("forces", ()):
            yield from self._element(element)
        for contact in self.model.get("contacts", ()):
            for point in self._list_points(contact):
                yield from self._contact(contact, point)

    def value(self, number: Any, **more: Any) -> Any:
        """Evaluate an expression over parameters, the state, and further names."""
        return value_of(number, {**self.names, **more}, self.own.numbers)

    def _wrench(self, wrench: Data, w: Values) -> Applied:
        motion = self.bodies[wrench["body"]].carry(self.own.vector(wrench.get("position", [0, 0, 0])))
        given = []
        for key in ("force", "moment"):
            written = wrench.get(key, [0, 0, 0])
            open_one = isinstance(written, str)
            values = w[f"{wrench['name']}.{key}"] if open_one else [self.value(x) for x in written]
            vector = np.array([self.own.numbers.make(x) for x in values], dtype=self.own.numbers.kind)
            given.append(motion.R @ vector if wrench.get("frame", "base") == "body" else vector)
        return Applied(wrench["body"], motion, *given)

    def _element(self, element: Data) -> Iterator[Applied]:
        ends = [self.own.place(self.bodies[element[key]["body"]], element[key]) for key in ("from", "to")]
        d, v = ends[1].p - ends[0].p, ends[1].v - ends[0].v
        stiffness, rest, damping, dissipation = (
            self.value(element.get(key, 0)) for key in ("stiffness", "rest", "damping", "dissipation")
        )
        none = 0 * ends[0].p
        if element.keys().isdisjoint(("rest", "damping", "force")) and element.get("type") != "cable":
            force = stiffness * d
        else:
            length = self.own.numbers.length(d)
            rate = (d @ v) / length
            if element.get("type") == "cable":
                stretch = self._soften(length - rest, self.value(element.get("width", 1e-4)))
                tension = stiffness * stretch * self._limit(dissipation * rate)
            else:
                tension = stiffness * (length - rest) + damping * rate
            tension += self.value(element.get("force", 0), length=length, rate=rate)
            force = tension * d / length
        yield Applied(element["from"]["body"], ends[0], force, none)
        yield Applied(element["to"]["body"], ends[1], -force, none)

    def _list_points(self, contact: Data) -> list[Motion]:
        centre = self.own.place(self.bodies[contact["body"]], contact)
        if "points" in contact:
            return [centre.carry(self.own.vector(point)) for point in contact["points"]]
        if "length" in (wheel := contact.get("wheel", {})):
            half = self.own.direction(wheel.get("axis", "y")) * self.value(wheel["length"]) / 2
            return [centre.carry(-half), centre.carry(half)]
        if "size" not in contact:
            return [centre]
        half = self.own.vector(contact["size"]) / 2
        return [centre.carry(half * np.array(signs)) for signs in product((-1, 1), repeat=3)]

    def _contact(self, contact: Data, centre: Motion) -> Iterator[Applied]:
        given = next((contact[key] for key in ("sphere", "box", "capsule", "plane") if key in contact), {})
        carrier = given.get("body", "base")
        body = self.bodies[carrier]
        foot = body.carry(self.own.vector(given.get("position", [0, 0, 0])))
        radius, width = self.value(contact.get("radius", 0)), self.value(contact.get("width", 1e-4))
        if "sphere" in contact:
            length, other = self.own.numbers.length(centre.p - foot.p), self.value(given["radius"])
            n, gap = (centre.p - foot.p) / length, length - radius - other
            touch = foot.p + length * other / (radius + other) * n
        elif "box" in contact:
            foot = self.own.place(body, given)
            gap, slope = self._measure_box(foot.R.T @ (centre.p - foot.p), self.own.vector(given["size"]), width)
            n = foot.R @ slope
            touch, gap = centre.p - radius * n, gap - radius
        elif "capsule" in contact:
            foot = self.own.place(body, given)
            gap, slope = self._measure_capsule(foot.R.T @ (centre.p - foot.p), self.value(given["length"]), width)
            n = foot.R @ slope
            touch, gap = centre.p - radius * n, gap - radius - self.value(given["radius"])
        else:
            n = body.R @ self.own.direction(given.get("normal", "z"))
            touch = centre.p - radius * n
            if "wheel" in contact:
                axis = centre.R @ self.own.direction(contact["wheel"].get("axis", "y"))
                lowest = n - (n @ axis) * axis
                touch = touch - self.value(contact["wheel"]["radius"]) * lowest / self.own.numbers.length(lowest)
            gap = n @ (touch - foot.p)
        v = centre.v + np.cross(centre.om, touch - centre.p) - foot.v - np.cross(foot.om, touch - foot.p)
        rate = n @ v
        depth = self._soften(-gap, width)
        exponent = self.value(contact.get("exponent", 1.5))
        power = depth ** int(exponent)
        if exponent % 1:
            power = power * self.functions["sqrt"](depth + self.own.numbers.make(1e-6) * width)
        damped = self._limit(-self.value(contact.get("dissipation", 0)) * rate)
        normal = self.value(contact["stiffness"]) * power * damped
        force = normal * n
        if "friction" in contact:
            coefficient, speed = (self.value(contact["friction"][key]) for key in ("coefficient", "speed"))
            slip = v - rate * n
            force = force - coefficient * normal * slip / self.functions["sqrt"](slip @ slip + speed**2)
        yield Applied(contact["body"], centre, force, np.cross(touch - centre.p, force))
        yield Applied(carrier, foot, -force, -np.cross(touch - foot.p, force))

    def _measure_box(self, x: Array, size: Array, width: Any) -> tuple[Any, Array]:
        """Return the smooth distance of a point from a box, in its axes, and the gradient."""
        exp, log, sqrt = (self.functions[name] for name in ("exp", "log", "sqrt"))
        numbers = self.own.numbers
        rises, falls = (np.array([exp(s * c / width) for c in x], dtype=numbers.kind) for s in (1, -1))
        q = np.array([width * log(c) for c in rises + falls], dtype=numbers.kind) - size / 2
        E = np.array([exp(c / width) for c in q], dtype=numbers.kind)
        y = np.array([width * log(1 + e) for e in E], dtype=numbers.kind)
        length = sqrt(y @ y + (numbers.make(1e-3) * width) ** 2)
        slope = y * E / (1 + E) / length + E / E.sum() / (1 + E.sum())
        return length - width * log(1 + 1 / E.sum()), slope * (rises - falls) / (rises + falls)

    def _measure_capsule(self, x: Array, length: Any, width: Any) -> tuple[Any, Array]:
        """Return the smooth distance of a point from the segment of a capsule, in its axes, and the gradient."""
        exp, log, sqrt = (self.functions[name] for name in ("exp", "log", "sqrt"))
        rises, falls = exp(x[2] / width), exp(-x[2] / width)
        E = (rises + falls) * exp(-length / 2 / width)  # exp of the way beyond the end, over the width
        y = width * log(1 + E)
        g = sqrt(x[0] ** 2 + x[1] ** 2 + y**2)
        slope = y * E / (1 + E) * (rises - falls) / (rises + falls)
        return g, np.array([x[0], x[1], slope], dtype=self.own.numbers.kind) / g

    def _soften(self, x: Any, width: Any) -> Any:
        """Return w log(1 + exp(x/w)), without overflow."""
        return self.functions["softplus"](x, width)

    def _limit(self, x: Any) -> Any:
        one, part = self.own.numbers.make(1.0), self.own.numbers.make(1.0) / 10
        return self._soften(1 + x, part) / self._soften(one, part)


def draw_inputs(model: Data, source: np.random.Generator) -> dict[str, Any]:
    """Draw the parts of `w`: of wrenches that are inputs, in a fixed order; then signals, and the time."""
    found: dict[str, Any] = {
        f"{x['name']}.{key}": source.uniform(-3, 3, 3)
        for x in model["wrenches"] for key in ("force", "moment") if x[key] == "input"
    }  # fmt: skip
    return found | {name: float(source.uniform(-2, 2)) for name in (*model.get("signals", ()), "t")}


def order_inputs(tree: Tree, w: Values) -> list[float]:
    """List the entries of `w` as the functions of a tree take them."""
    parts = [
        w[f"{wrench.name}.{key}"]
        for wrench in tree.wrenches
        for key, given in (("force", wrench.force), ("moment", wrench.moment))
        if given is None
    ]
    return [*(float(x) for part in parts for x in part), *(w[name] for name in tree.signals)]


def spell(name: str) -> str:
    """Write a name as a part of a name in expressions."""
    return name.replace(".", "_")
