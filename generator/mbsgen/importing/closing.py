"""The closing of a draft: loops between bodies, equations of coordinates, and joints that follow others.

Joints have their names in the file here; a draft replaces them by their names in the model when it is complete.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mbsgen.expressions import FLOATS, Expression, Name, Negation, Number, Operation, Power, evaluate, substitute
from mbsgen.importing.markup import Element
from mbsgen.importing.poses import Array, Pose
from mbsgen.model.tree import Cut

Rule = tuple[str, float, float]  # of a follower: the joint that it follows, ratio, offset
X = "x"  # in the expression of a curve: the coordinate


@dataclass(frozen=True, eq=False)
class Spot:
    """A frame on a body of a draft, or on the base."""

    body: str
    pose: Pose  # in the body's frame


@dataclass(frozen=True, eq=False)
class Closure:
    """A loop between frames on two bodies."""

    name: str
    cut: Cut
    first: Spot
    second: Spot
    source: Element
    axis: Array | None = None  # in both frames; None: z
    axis2: Array | None = None  # of a universal joint, in the second frame; None: x
    pitch: float = 0.0  # of a helical joint [m/rad]


@dataclass(frozen=True)
class Term:
    """coefficient (q - start)^power, of the coordinate q of a joint."""

    joint: str
    coefficient: float
    start: float = 0.0
    power: int = 1

    def at(self, q: float) -> float:
        """Return its value at a coordinate."""
        return self.coefficient * (q - self.start) ** self.power

    def write(self, name: str) -> Expression:
        """Write its size, without the sign of the coefficient, for a joint of this name."""
        factor: Expression = Name(name)
        if self.start:
            factor = Operation("-" if self.start > 0 else "+", factor, Number(abs(self.start)))
        if self.power != 1:
            factor = Power(factor, self.power)
        return factor if abs(self.coefficient) == 1 else Operation("*", Number(abs(self.coefficient)), factor)


@dataclass(frozen=True)
class Curve:
    """Any function of the coordinate of a joint, with the coefficient 1 or -1."""

    joint: str
    coefficient: float
    expression: Expression  # over X

    def at(self, q: float) -> float:
        """Return its value at a coordinate."""
        return self.coefficient * evaluate(self.expression, {X: q}, FLOATS)

    def write(self, name: str) -> Expression:
        """Write the function, without the sign of the coefficient, for a joint of this name."""
        return substitute(self.expression, {X: Name(name)})


@dataclass(frozen=True)
class Equation:
    """A sum of terms, and of a constant, that vanishes."""

    name: str
    terms: tuple[Term | Curve, ...]
    constant: float
    source: Element

    def hold(self, held: Mapping[str, float]) -> Equation:
        """Return the equation with the coordinates of held joints in the constant, and without terms that are 0."""
        constant = self.constant + sum(term.at(held[term.joint]) for term in self.terms if term.joint in held)
        terms = tuple(term for term in self.terms if term.joint not in held and term.coefficient)
        return Equation(self.name, terms, constant, self.source)

    def write(self, called: Mapping[str, str]) -> Expression:
        """Write the sum over the joints' names in the model; it has a term."""
        first, *rest = self.terms
        total = first.write(called[first.joint])
        total = total if first.coefficient > 0 else Negation(total)
        for term in rest:
            total = Operation("+" if term.coefficient > 0 else "-", total, term.write(called[term.joint]))
        if self.constant:
            total = Operation("+" if self.constant > 0 else "-", total, Number(abs(self.constant)))
        return total


@dataclass
class Closing:
    """The loops, equations and followers of a draft."""

    closures: list[Closure] = field(default_factory=list)
    equations: list[Equation] = field(default_factory=list)
    rules: dict[str, Rule] = field(default_factory=dict)  # by follower
    dependent: set[str] = field(default_factory=set)  # joints whose coordinates others determine, by the file

    def couple(self, follower: str, rule: Rule) -> bool:
        """Couple a joint to another one; return False where it follows one already, or leads the other."""
        leader, ratio, _ = rule
        chain = [leader]
        while chain[-1] in self.rules and len(chain) <= len(self.rules):
            chain.append(self.rules[chain[-1]][0])
        if ratio == 0 or follower in chain or follower in self.rules:
            return False
        self.rules[follower] = rule
        return True
