"""A line around an ellipsoid or in a torus: two points in the base frame -> its length and its slopes by both points.

The slopes are the exact derivatives of the length, with roots by the implicit function theorem. OpenSim pulls along the
straight parts of such a line instead; their work is not the change of the length that it computes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from sympy import Expr

from mbsgen.model.steps import Define, Steps
from mbsgen.model.symbols import total
from mbsgen.model.tree import ZERO, Vector
from mbsgen.model.triples import dot
from mbsgen.model.wrapping import Turn
from mbsgen.model.wrapping_ellipsoid import Ellipsoid, measure_around
from mbsgen.model.wrapping_torus import Torus, measure_through

Shape = Ellipsoid | Torus


def make_shaped_turn(shape: Shape, axes: Sequence[Vector], a: Vector, b: Vector, define: Define) -> Turn:
    """Describe the line from a to b, which are seen from the centre of the surface with these axes."""
    steps = Steps(define)
    p, q = (
        _vector(define(f"{name}.{k}", dot(axis, x)) for k, axis in zip("xyz", axes, strict=True))
        for name, x in (("local a", a), ("local b", b))
    )
    if isinstance(shape, Ellipsoid):
        must, length = measure_around(shape, p, q, steps)
        may: Expr = ZERO
    else:
        may, length = measure_through(shape, p, q, steps)
        must = ZERO
    whole = steps("around", length)
    slopes = steps.differentiate(whole, [*p, *q])
    local = [define(f"slope {k}", x) for k, x in enumerate(slopes, 1)]
    first, second = (
        _vector(total(s * axis[k] for s, axis in zip(own, axes, strict=True)) for k in range(3))
        for own in (local[:3], local[3:])
    )
    return Turn(must, may, whole, (first, second))


def _vector(components: Iterable[Expr]) -> Vector:
    x, y, z = components
    return x, y, z
