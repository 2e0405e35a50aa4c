"""Placements composed, and moved tensors, in expressions: terms with a 0 and factors of 1 vanish."""

from __future__ import annotations

from mbsgen.expressions import Call, Expression, Negation, Number, Operation
from mbsgen.model.model import ORIGIN, ZERO, Inertia, Placement, Rotation, Triple


def compose(first: Placement, second: Placement) -> Placement:
    """Place in one frame what `second` places in the frame that `first` places there."""
    moved = second.position
    for rotation in reversed(first.orientation):
        moved = _rotate(rotation, moved)
    x, y, z = (add(a, b) for a, b in zip(first.position, moved, strict=True))
    return Placement((x, y, z), first.orientation + second.orientation)


def move_inertia(inertia: Inertia, point: Triple, com: Triple, mass: Expression) -> Inertia:
    """Take a tensor about a point to the centre of mass: I - m (d.d 1 - d dT), d = com - point (Steiner)."""
    x, y, z = (subtract(a, b) for a, b in zip(com, point, strict=True))
    xx, yy, zz = (multiply(a, a) for a in (x, y, z))

    def less(entry: Expression, square: Expression) -> Expression:
        return subtract(entry, multiply(mass, square))

    return Inertia(
        less(inertia.xx, add(yy, zz)),
        less(inertia.yy, add(xx, zz)),
        less(inertia.zz, add(xx, yy)),
        *(
            add(entry, multiply(mass, multiply(a, b)))
            for entry, a, b in ((inertia.xy, x, y), (inertia.xz, x, z), (inertia.yz, y, z))
        ),
    )


def _rotate(rotation: Rotation, v: Triple) -> Triple:
    if v == ORIGIN:
        return v
    j, k = (rotation.axis + 1) % 3, (rotation.axis + 2) % 3
    c, s = Call("cos", (rotation.angle,)), Call("sin", (rotation.angle,))
    turned = list(v)
    turned[j] = add(multiply(c, v[j]), multiply(Negation(s), v[k]))
    turned[k] = add(multiply(s, v[j]), multiply(c, v[k]))
    x, y, z = turned
    return x, y, z


def add(a: Expression, b: Expression) -> Expression:
    """Write a + b."""
    if a == ZERO or b == ZERO:
        return b if a == ZERO else a
    return Operation("+", a, b)


def subtract(a: Expression, b: Expression) -> Expression:
    """Write a - b."""
    if b == ZERO or a == b:
        return a if b == ZERO else ZERO
    return Negation(b) if a == ZERO else Operation("-", a, b)


def multiply(a: Expression, b: Expression) -> Expression:
    """Write a * b."""
    if a == ZERO or b == ZERO:
        return ZERO
    if Number(1.0) in (a, b):
        return b if a == Number(1.0) else a
    return Operation("*", a, b)


def divide(a: Expression, b: Expression) -> Expression:
    """Write a / b."""
    return a if b == Number(1.0) else Operation("/", a, b)
