"""Placements composed, and moved tensors, in expressions: terms with a 0 and factors of 1 vanish."""

from __future__ import annotations

from mbsgen.expressions import FLOATS, Call, Expression, Negation, Number, Operation, evaluate, names
from mbsgen.model.model import ORIGIN, ZERO, Body, Inertia, Placement, Rotation, Triple

CANCELLED = 1e-15  # part of a number: the rounding of it, of four products and of a sum


def compose(first: Placement, second: Placement) -> Placement:
    """Place in one frame what `second` places in the frame that `first` places there."""
    moved = second.position
    for rotation in reversed(first.orientation):
        moved = _rotate(rotation, moved)
    x, y, z = (add(a, b) for a, b in zip(first.position, moved, strict=True))
    return Placement((x, y, z), first.orientation + second.orientation)


def centre_inertia(body: Body) -> Inertia:
    """Take the tensor of a body to its centre of mass: I - m (d.d 1 - d dT), d = com - about (Steiner)."""
    inertia, mass = body.inertia, body.mass
    if inertia.about is None:
        return inertia
    x, y, z = (subtract(a, b) for a, b in zip(body.com, inertia.about, strict=True))
    xx, yy, zz = (multiply(a, a) for a in (x, y, z))

    def less(entry: Expression, square: Expression) -> Expression:
        return _settle(subtract(entry, multiply(mass, square)), entry)

    return Inertia(
        less(inertia.xx, add(yy, zz)),
        less(inertia.yy, add(xx, zz)),
        less(inertia.zz, add(xx, yy)),
        *(
            _settle(add(entry, multiply(mass, multiply(a, b))), entry)
            for entry, a, b in ((inertia.xy, x, y), (inertia.xz, x, z), (inertia.yz, y, z))
        ),
    )


def _settle(difference: Expression, entry: Expression) -> Expression:
    """Make the rest of an entry 0 where it is rounding alone: of a point mass, or a thin rod."""
    if names(difference):
        return difference
    left, whole = (float(evaluate(x, {}, FLOATS)) for x in (difference, entry))
    return ZERO if abs(left) <= CANCELLED * abs(whole) else difference


def _rotate(rotation: Rotation, v: Triple) -> Triple:
    if v == ORIGIN:
        return v
    j, k = (rotation.axis + 1) % 3, (rotation.axis + 2) % 3
    angle = _inner(rotation.angle)
    c, s = Call("cos", (angle,)), Call("sin", (angle,))
    turned = list(v)
    turned[j] = add(multiply(c, v[j]), multiply(Negation(s), v[k]))
    turned[k] = add(multiply(s, v[j]), multiply(c, v[k]))
    x, y, z = turned
    return x, y, z


def add(a: Expression, b: Expression) -> Expression:
    """Write a + b."""
    if a == ZERO or b == ZERO:
        return b if a == ZERO else a
    return Operation("+", _inner(a), _inner(b))


def subtract(a: Expression, b: Expression) -> Expression:
    """Write a - b."""
    if b == ZERO or a == b:
        return a if b == ZERO else ZERO
    return Negation(_inner(b)) if a == ZERO else Operation("-", _inner(a), _inner(b))


def multiply(a: Expression, b: Expression) -> Expression:
    """Write a * b."""
    if a == ZERO or b == ZERO:
        return ZERO
    if Number(1.0) in (a, b):
        return b if a == Number(1.0) else a
    return Operation("*", _inner(a), _inner(b))


def divide(a: Expression, b: Expression) -> Expression:
    """Write a / b."""
    return a if b == Number(1.0) else Operation("/", _inner(a), _inner(b))


def _inner(x: Expression) -> Expression:
    """Write a part of an expression as a reader finds it there: a sign is no part of a number."""
    return Negation(Number(-x.value)) if isinstance(x, Number) and x.value < 0 else x
