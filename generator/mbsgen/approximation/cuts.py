"""Cuts: parts of a tree that may be left out, as numbers that become 0.

A tree is released: its inertia is gathered where it is felt (`moments`), and each number that may be left out becomes a
run-time parameter. So one tape computes the effect of any cut. Numbers that depend on run-time parameters are not
released.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from sympy import Add, Expr, Symbol, sstr, tanh

from mbsgen.approximation.moments import Moments, gather_moments, replace_inertia, symmetric
from mbsgen.model.symbols import exact, to_double
from mbsgen.model.tree import COORDINATE, RATE, ZERO, Body, Joint, Kind, Parameter, RigidPart, Tree, Vector

AXES = "xyz"
Take = Callable[[str, Expr], Expr]  # (name, number) -> the number in its place


@dataclass(frozen=True)
class Cut:
    """A part that may be left out: a number that becomes 0."""

    name: str  # such as `hand.inertia.xy` or `wrist.damping`: a parameter of the released tree
    value: str  # its value in the model, for readers


@dataclass(frozen=True)
class Released:
    """A tree in which every number that may be left out is a parameter at run time."""

    whole: Tree
    tree: Tree
    numbers: Mapping[str, float]  # by the parameters' names, in their order
    cuts: tuple[Cut, ...]  # a cut for each

    def reduce(self, cuts: Collection[str]) -> Tree:
        """Return the whole tree with some numbers removed."""

        def take_terms(terms: Mapping[str, Expr]) -> Expr:
            return Add(*(term for name, term in terms.items() if name not in cuts))

        return _rewrite(self.whole, lambda name, number: ZERO if name in cuts else number, take_terms)


def release(tree: Tree) -> Released:
    """Make a parameter of each removable number: of inertias, joint positions, rotors and terms of joint forces."""
    numbers: dict[str, float] = {}
    cuts: list[Cut] = []

    def take(name: str, number: Expr) -> Expr:
        if number.free_symbols or number == 0:
            return number
        numbers[name] = to_double(number)
        cuts.append(Cut(name, f"{numbers[name]:.6g}"))
        return Symbol(name)

    def take_terms(terms: Mapping[str, Expr]) -> Expr:
        kept: list[Expr] = []
        for name, term in terms.items():
            if term.free_symbols <= {COORDINATE, RATE}:
                numbers[name] = 1.0
                cuts.append(Cut(name, sstr(term.evalf(6), full_prec=False)))
                kept.append(Symbol(name) * term)
            else:
                kept.append(term)
        return Add(*kept)

    released = _rewrite(tree, take, take_terms)
    own = tuple(Parameter(name, Symbol(name), value, Kind.RUNTIME) for name, value in numbers.items())
    return Released(
        tree, replace(released, parameters=(*tree.parameters, *own)), MappingProxyType(numbers), tuple(cuts)
    )


def _rewrite(tree: Tree, take: Take, take_terms: Callable[[Mapping[str, Expr]], Expr]) -> Tree:
    """Replace the numbers of a tree, with its inertia gathered."""
    constants: dict[Expr, Expr] = {p.symbol: exact(p.value) for p in tree.parameters if p.kind is Kind.CONSTANT}

    def take_vector(name: str, vector: Vector) -> Vector:
        x, y, z = (take(f"{name}.{axis}", number) for axis, number in zip(AXES, vector, strict=True))
        return x, y, z

    def take_moments(name: str, found: Moments) -> Moments:
        mass, S = take(f"{name}.mass", found.m), take_vector(f"{name}.moment", found.S)
        places = [(i, j) for i in range(3) for j in range(i, 3)]
        upper = {(i, j): take(f"{name}.inertia.{AXES[i]}{AXES[j]}", found.J[i][j]) for i, j in places}
        return Moments(mass, S, symmetric(upper))

    def take_joint(joint: Joint) -> Joint:
        armature = take(f"{joint.name}.armature", joint.armature.xreplace(constants))
        law = take_terms(_name_terms(joint.name, joint.law.xreplace(constants)))
        return replace(joint, armature=armature, law=law)

    def take_body(body: Body, kept: tuple[RigidPart, ...], moments: Moments) -> Body:
        x, y, z = (number.xreplace(constants) for number in body.position)
        placed = replace(body, position=take_vector(f"{body.name}.position", (x, y, z)), joint=take_joint(body.joint))
        return replace_inertia(placed, kept, take_moments(body.name, moments))

    return replace(tree, bodies=tuple(map(take_body, tree.bodies, *gather_moments(tree, constants))))


def _name_terms(joint: str, law: Expr) -> dict[str, Expr]:
    """Name the terms of a joint's force law: springs, dampers and friction, where a term is one of these."""
    terms: dict[str, Expr] = {}
    for term in Add.make_args(law):
        if term != 0:
            kind = f"{joint}.{_classify(term)}"
            k = sum(name.startswith(kind) for name in terms)
            terms[f"{kind}.{k + 1}" if k else kind] = term
    return terms


def _classify(term: Expr) -> str:
    if (term / RATE).is_number:
        return "damping"
    if (term / COORDINATE).is_number:
        return "stiffness"
    return "friction" if term.has(tanh) else "force"
