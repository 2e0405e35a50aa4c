"""Solids that touch each other: both sides of a contact -> corners, and the radius that rounds their edges.

A point or a sphere has one corner, a capsule two, a box eight. The solid is all within the radius of their convex hull.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

from mbsgen.algebra.dense import dot
from mbsgen.expressions import Expression
from mbsgen.model.model import ZERO, Block, Capsule, Contact, Hull, Sphere, Triple

Corner = tuple[float, float, float]
Measure = Callable[[Expression], float]  # a number, which must be constant
FLAT = 1e-9  # of the size of a hull: a thinner one has no inside


def list_expressions(contact: Contact) -> tuple[Expression, ...]:
    """List the numbers of both shapes, all of which must be constant."""
    own = (contact.radius, *(contact.size or ()), *(x for point in contact.points for x in point))
    match contact.other:
        case Block(size=size):
            return (*own, *size)
        case Capsule(length=length, radius=radius):
            return (*own, length, radius)
        case Hull(points=points, radius=radius):
            return (*own, radius, *(x for point in points for x in point))
        case Sphere(radius=radius):
            return (*own, radius)
    return own


def find_solids(contact: Contact, measure: Measure) -> tuple[tuple[tuple[Corner, ...], float], ...]:
    """Return the corners of both sides, each in its frame [m], with their radii."""
    if contact.size is not None:
        first = _list_box_corners(contact.size, measure)
    else:
        first = _list_points(contact.points, measure) or ((0.0, 0.0, 0.0),)
    match contact.other:
        case Block(size=size):
            other, radius = _list_box_corners(size, measure), ZERO
        case Capsule(length=length, radius=radius):
            half = measure(length) / 2
            other = ((0.0, 0.0, -half), (0.0, 0.0, half))
        case Hull(points=points, radius=radius):
            other = _list_points(points, measure)
        case Sphere(radius=radius):
            other = ((0.0, 0.0, 0.0),)
        case _:
            raise AssertionError("a plane is no solid")
    return (first, measure(contact.radius)), (other, measure(radius))


def _list_box_corners(size: Triple, measure: Measure) -> tuple[Corner, ...]:
    x, y, z = (measure(edge) / 2 for edge in size)
    return tuple((a * x, b * y, c * z) for a, b, c in product((-1, 1), repeat=3))


def _list_points(points: Sequence[Triple], measure: Measure) -> tuple[Corner, ...]:
    return tuple((measure(x), measure(y), measure(z)) for x, y, z in points)


def has_inside(corners: Sequence[Corner]) -> bool:
    """Return whether corners are one point, two points, or points that do not all lie in a plane."""
    if len(corners) < 3:
        return True
    ways = [[a - b for a, b in zip(point, corners[0], strict=True)] for point in corners]
    size = max(dot(way, way) for way in ways)
    for _ in range(3):
        longest = max(ways, key=lambda way: dot(way, way))
        square = dot(longest, longest)
        if square <= FLAT**2 * size:
            return False
        shares = [dot(way, longest) / square for way in ways]
        ways = [
            [x - share * y for x, y in zip(way, longest, strict=True)] for way, share in zip(ways, shares, strict=True)
        ]
    return True
