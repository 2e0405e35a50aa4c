"""Moments: the inertia of a tree's bodies in the fewest numbers, the base inertial parameters.

A body's inertia is its mass m, first moment S and tensor J about its own origin, its joint. A joint does not feel all
of it. For a revolute joint along e, mass on the axis and a line of mass along it could as well be fixed to the parent;
for a prismatic joint, J could. These parts are moved to the parent, body by body from the leaves. The rest are the base
inertial parameters (Khalil, Bennis, 1991; Gautier, Khalil, 1990), each of which changes the motion. Nothing is moved to
the base.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from sympy import Expr, Integer

from mbsgen.model.symbols import round_number, to_double, total
from mbsgen.model.tree import ONE, ZERO, Body, Matrix, Motion, RigidPart, Tree, Vector

NONE: Vector = (ZERO, ZERO, ZERO)
HALF = ONE / 2


@dataclass(frozen=True)
class Moments:
    """Mass [kg], first moment [kg m] and tensor [kg m2] about the origin of a body, in its frame."""

    m: Expr = ZERO
    S: Vector = NONE
    J: Matrix = (NONE, NONE, NONE)

    def __add__(self, other: Moments) -> Moments:
        S = _vector([_add(a, b) for a, b in zip(self.S, other.S, strict=True)])
        J = _matrix([[_add(a, b) for a, b in zip(x, y, strict=True)] for x, y in zip(self.J, other.J, strict=True)])
        return Moments(_add(self.m, other.m), S, J)

    def __sub__(self, other: Moments) -> Moments:
        S, J = _vector([-x for x in other.S]), _matrix([[-x for x in row] for row in other.J])
        return self + Moments(-other.m, S, J)

    @property
    def is_known(self) -> bool:
        """Return whether all entries are numbers."""
        return all(x.is_number for x in (self.m, *self.S, *(x for row in self.J for x in row)))

    def place(self, d: Vector, R: Matrix) -> Moments:
        """Refer them to a frame in which this frame has the origin d and the axes R (columns), by Steiner's theorem."""
        S = _vector([_add(*(_times(R[i][k], self.S[k]) for k in range(3))) for i in range(3)])
        pairs = [(k, l) for k in range(3) for l in range(3)]
        twice = (2 * _times(a, b) for a, b in zip(d, S, strict=True))
        dot = _add(_times(self.m, _add(*(_times(x, x) for x in d))), *twice)
        upper = {
            (i, j): _add(
                *(_times(_times(R[i][k], R[j][l]), self.J[k][l]) for k, l in pairs),
                dot if i == j else ZERO,
                -_times(self.m, _times(d[i], d[j])),
                -_times(d[i], S[j]),
                -_times(S[i], d[j]),
            )
            for i in range(3)
            for j in range(i, 3)
        }
        first = _vector([_add(_times(self.m, a), b) for a, b in zip(d, S, strict=True)])
        return Moments(self.m, first, symmetric(upper))

    def write(self, name: str) -> tuple[RigidPart, ...]:
        """Write them as rigid parts; a first moment becomes a pair of opposite masses."""
        parts = (RigidPart(name, self.m, NONE, self.J),)
        if all(x == 0 for x in self.S):
            return parts
        arm, back = _vector([x * HALF for x in self.S]), _vector([-x * HALF for x in self.S])
        empty = (NONE, NONE, NONE)
        return (*parts, RigidPart(f"{name}, ahead", ONE, arm, empty), RigidPart(f"{name}, behind", -ONE, back, empty))


def gather_moments(tree: Tree, constants: Mapping[Expr, Expr]) -> tuple[list[tuple[RigidPart, ...]], list[Moments]]:
    """Return, for each body, its parts that depend on parameters, unchanged, and the moments of the rest, where they
    are felt.
    """
    kept: list[tuple[RigidPart, ...]] = []
    moments: list[Moments] = []
    for body in tree.bodies:
        own = [(part, _read(part, constants)) for part in (_as_part(body), *body.parts)]
        kept.append(tuple(part for part, found in own if not found.is_known))
        moments.append(sum((found for _, found in own if found.is_known), Moments()))
    inside = {i for x in tree.quaternions for i in x.bodies}
    for i in range(len(tree.bodies), 0, -1):
        body = tree.bodies[i - 1]
        position = _vector([x.xreplace(dict(constants)) for x in body.position])
        turn = _matrix([[x.xreplace(dict(constants)) for x in row] for row in body.orientation])
        numbers = (*position, *(x for row in turn for x in row))
        if body.parent and i not in inside and all(x.is_number for x in numbers):
            unfelt = _find_unfelt(body, moments[i - 1])
            moments[i - 1] = moments[i - 1] - unfelt
            still = NONE if body.joint.motion is Motion.PRISMATIC else position
            moments[body.parent - 1] = moments[body.parent - 1] + unfelt.place(still, turn)
    return kept, moments


def replace_inertia(body: Body, kept: tuple[RigidPart, ...], moments: Moments) -> Body:
    """Replace a body's masses by the given parts and moments."""
    own, *parts = (*moments.write(body.name), *kept)
    return replace(body, mass=own.mass, com=own.com, inertia=own.inertia, parts=tuple(parts))


def _find_unfelt(body: Body, own: Moments) -> Moments:
    """Return the moments that could as well be fixed to a body's parent."""
    if body.joint.motion is Motion.PRISMATIC:
        return Moments(J=own.J)
    e = body.joint.axis
    a, b = (k for k in range(3) if k != e)
    line = min(own.J[a][a], own.J[b][b], key=to_double)
    S = _vector([own.S[k] if k == e else ZERO for k in range(3)])
    J = symmetric({(i, j): line if i == j != e else ZERO for i in range(3) for j in range(i, 3)})
    return Moments(own.m, S, J)


def _as_part(body: Body) -> RigidPart:
    return RigidPart(body.name, body.mass, body.com, body.inertia)


def _read(part: RigidPart, constants: Mapping[Expr, Expr]) -> Moments:
    def value(number: Expr) -> Expr:
        return number.xreplace(dict(constants))

    tensor = _matrix([[value(x) for x in row] for row in part.inertia])
    central = Moments(value(part.mass), NONE, tensor)
    com = _vector([value(x) for x in part.com])
    if not (central.is_known and all(x.is_number for x in com)):
        return central if not central.is_known else Moments(part.mass, part.com, part.inertia)
    return central.place(com, symmetric({(i, j): Integer(i == j) for i in range(3) for j in range(i, 3)}))


def _add(*terms: Expr) -> Expr:
    found = total(terms)
    return round_number(found) if found.is_number else found


def _times(a: Expr, b: Expr) -> Expr:
    return ZERO if a == 0 or b == 0 else a * b


def _vector(components: list[Expr]) -> Vector:
    x, y, z = components
    return x, y, z


def _matrix(rows: list[list[Expr]]) -> Matrix:
    a, b, c = rows
    return _vector(a), _vector(b), _vector(c)


def symmetric(upper: Mapping[tuple[int, int], Expr]) -> Matrix:
    """Return the symmetric matrix of an upper triangle."""
    return _matrix([[upper[min(i, j), max(i, j)] for j in range(3)] for i in range(3)])
