"""Forces of OpenSim that act on coordinates: springs, limits and actuators.

A CoordinateLimitForce of a coordinate q pushes back beyond a limit with a stiffness that grows over the transition, by
Simbody's step of degree 5, and damps while it pushes:

    -K_up s(u) (q - upper) + K_low s(w) (lower - q) - damping (s(u) + s(w)) qd,
    u = (q - upper)/transition, w = (lower - q)/transition, s(u) = u^3 (10 - 15 u + 6 u^2) from 0 to 1.

Its numbers are in degrees where OpenSim counts the coordinate as an angle: a turn by a LinearFunction of slope 1 or -1.

An ExpressionBasedCoordinateForce is a formula of q and qdot.

Source: OpenSim's documentation of these classes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from mbsgen.documents import abbreviate, nearest
from mbsgen.expressions import Expression, Name, Number, Operation, parse, substitute
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.osim.functions import read_formula, write_number, write_shift
from mbsgen.model.model import FREE, ZERO, Law

ACTUATORS = ("CoordinateActuator", "ActivationCoordinateActuator")
SPRING, LIMIT, FORMULA = "SpringGeneralizedForce", "CoordinateLimitForce", "ExpressionBasedCoordinateForce"
READ = (*ACTUATORS, SPRING, LIMIT, FORMULA)
_TRUE, _FALSE = ("true", "1"), ("false", "0")


def is_on(element: Element) -> bool:
    """Return whether a force, a constraint or a surface of a file acts."""
    switches = (("appliesForce", _FALSE), ("isEnforced", _FALSE), ("isDisabled", _TRUE), ("active", _FALSE))
    return not any((part := element.first(tag)) is not None and part.text.lower() in off for tag, off in switches)


@dataclass
class Forces:
    """Forces on coordinates, by the coordinate."""

    findings: Findings
    springs: dict[str, list[Element]] = field(default_factory=dict)
    limits: dict[str, list[Element]] = field(default_factory=dict)
    formulas: dict[str, list[tuple[Element, Expression]]] = field(default_factory=dict)
    efforts: dict[str, float] = field(default_factory=dict)  # the largest force of the actuators [N m or N]

    def read(self, element: Element, coordinates: Mapping[str, Element]) -> None:
        """Read a force of READ; the file has these coordinates."""
        if not is_on(element):
            self.findings.tell(element, "it is switched off in the file: left out")
            return
        name = _read_text(element, "coordinate")
        if name not in coordinates:
            meant = nearest(name, list(coordinates))
            remedy = f"did you mean {abbreviate(meant)}?" if meant else "name a coordinate of the file"
            self.findings.fault(element, f"there is no coordinate {abbreviate(name)}", remedy)
        elif element.tag == SPRING:
            self.springs.setdefault(name, []).append(element)
        elif element.tag == LIMIT:
            self.limits.setdefault(name, []).append(element)
        elif element.tag == FORMULA:
            force = read_formula(element, {"q": "q", "qdot": "qd"}, self.findings)
            if force is not None:
                self.formulas.setdefault(name, []).append((element, force))
        else:
            optimal = abs(self._number(element, "optimal_force", 1.0))
            bounds = [self._bound(element, tag) for tag in ("min_control", "max_control")]
            effort = math.inf if None in bounds else optimal * max(abs(x) for x in bounds if x is not None)
            self.efforts[name] = self.efforts.get(name, 0.0) + effort

    def list_passive(self, coordinate: str) -> list[Element]:
        """List the forces on a coordinate that are no actuators."""
        formulas = [element for element, _ in self.formulas.get(coordinate, [])]
        return [*self.springs.get(coordinate, []), *self.limits.get(coordinate, []), *formulas]

    def find_effort(self, coordinate: str) -> float | None:
        """Return the largest force on a coordinate; None without a bound."""
        effort = self.efforts.get(coordinate, math.inf)
        return effort if math.isfinite(effort) and effort > 0 else None

    def make_law(self, coordinate: str, size: float, *, in_degrees: bool) -> Law:
        """Make the law of a joint whose coordinate is `size` times the coordinate of the file."""
        total: Expression | None = None
        stiffness = moment = damping = 0.0
        for spring in self.springs.get(coordinate, []):
            k = self._number(spring, "stiffness", 0.0)
            stiffness, moment = stiffness + k, moment + k * self._number(spring, "rest_length", 0.0)
            damping += self._number(spring, "viscosity", 0.0)
        for limit in self.limits.get(coordinate, []):
            force = self._write_limit(limit, in_degrees=in_degrees)
            if force is not None:
                total = force if total is None else Operation("+", total, force)
        for _, force in self.formulas.get(coordinate, []):
            total = force if total is None else Operation("+", total, force)
        if total is not None and size != 1:
            scaled = {name: Operation("/", Name(name), Number(size)) for name in ("q", "qd")}
            total = Operation("/", substitute(total, scaled), Number(size))
        rest = moment / stiffness * size if stiffness else 0.0
        return replace(
            FREE,
            stiffness=Number(stiffness / size**2),
            rest=Number(rest),
            damping=Number(damping / size**2),
            force=ZERO if total is None else total,
        )

    def _write_limit(self, element: Element, *, in_degrees: bool) -> Expression | None:
        degree = math.pi / 180 if in_degrees else 1.0
        upper, lower, transition = (
            self._number(element, tag, 0.0) * degree for tag in ("upper_limit", "lower_limit", "transition")
        )
        high, low, damping = (
            self._number(element, tag, 0.0) / degree for tag in ("upper_stiffness", "lower_stiffness", "damping")
        )
        if transition <= 0:
            remedy = "give the width over which the stiffness grows, in degrees where the coordinate turns"
            self.findings.fault(element, "the transition is not above 0", remedy)
            return None
        if upper < lower:
            self.findings.fault(element, "the upper limit is below the lower one", "swap the limits")
            return None
        above, below = f"({write_shift('q', upper)})", f"({write_number(lower)} - q)"
        u, w = (f"min(max({x}/{write_number(transition)}, 0), 1)" for x in (above, below))
        steps = [f"{x}**3*(10 - 15*{x} + 6*{x}**2)" for x in (u, w)]
        parts = [
            f"-{write_number(high)}*{steps[0]}*{above}" if high else "",
            f"{write_number(low)}*{steps[1]}*{below}" if low else "",
            f"-{write_number(damping)}*({steps[0] if high else 0} + {steps[1] if low else 0})*qd" if damping else "",
        ]
        return parse(" + ".join(f"({part})" for part in parts if part) or "0")

    def _number(self, element: Element, tag: str, default: float) -> float:
        child = element.first(tag)
        return default if child is None else self.findings.number(child, tag, default, {tag: child.text})

    def _bound(self, element: Element, tag: str) -> float | None:
        child = element.first(tag)
        return None if child is None else self.findings.bound(child, tag, {tag: child.text})


def _read_text(element: Element, tag: str) -> str:
    child = element.first(tag)
    return "" if child is None else child.text
