"""Forces of springs, cables and compliant contacts along a motion, for arrows: poses and velocities -> newtons.

The laws are the kernels' laws, with the numbers of the model's file. With d = b - a from the first end to the second,
its length |d|, and s(x, w) = w log(1 + exp(x/w)), a smooth max(x, 0),

    spring:   T = stiffness (length - rest) + damping rate
    cable:    T = stiffness s(length - rest, width) phi(dissipation rate)
    contact:  gap = n.(p - P) of a plane, |c - P| - r - R of two spheres, n = (c - P)/|c - P|
              N = stiffness s(-gap, width)^exponent phi(-dissipation rate)
              F = N n - coefficient N v_t / sqrt(v_t.v_t + speed^2)

with phi(x) = s(1 + x, 1/10)/s(1, 1/10) (Hunt, Crossley, J. Appl. Mech. 42, 1975). A positive tension T pulls the ends
together; F acts on the body that touches. Velocities of points are central differences along the coordinates' rates.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Appearance, Element, Grip, Point, Tension, Touch
from mbsrun.ocp.plant import Plant
from mbsrun.skeleton import Skeleton, place

Array = NDArray[np.float64]

STEP = 1e-6  # s, of the differences
SIGNS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


@dataclass(frozen=True, eq=False)
class Load:
    """A force over time at a point that is fixed in a frame; components in the base frame."""

    foot: Point
    values: Array  # (K, 3) [N]


def find_loads(plant: Plant, q: Array, dq: Array) -> list[Load]:
    """Compute the forces of all springs, cables and contacts at coordinates q (K, n) with time derivatives dq.

    Their list depends on the model alone.
    """
    appearance = plant.manifest.appearance
    if appearance is None or not has_loads(appearance):
        return []
    course = _Course(*(place(plant, q + step * dq) for step in (0.0, STEP, -STEP)))
    found = [load for element in appearance.elements for load in _pull(course, element)]
    return found + [load for touch in appearance.contacts for load in _press(course, touch)]


def has_loads(appearance: Appearance) -> bool:
    """Return whether a model has springs, cables or contacts whose laws are known."""
    laws = [*(x.law for x in appearance.elements), *(x.law for x in appearance.contacts)]
    return any(law is not None for law in laws)


@dataclass(frozen=True, eq=False)
class _Course:
    """Frames at some states, and a little later and earlier."""

    now: Skeleton
    after: Skeleton
    before: Skeleton

    def find(self, point: Point) -> Array:
        """Return the places of a point, (K, 3)."""
        return _find(self.now, point.frame, np.array(point.at))

    def move(self, frame: int, places: Array) -> Array:
        """Return the velocities of the points of a frame that are now at some places, (K, 3)."""
        if frame < 0:
            return np.zeros_like(places)
        p, R = self.now.p[:, :, frame], _axes(self.now, frame)
        own = np.einsum("kji,kj->ki", R, places - p)
        return (_find(self.after, frame, own) - _find(self.before, frame, own)) / (2 * STEP)


def _axes(skeleton: Skeleton, frame: int) -> Array:
    return skeleton.R[:, :, 3 * frame : 3 * frame + 3]


def _find(skeleton: Skeleton, frame: int, at: Array) -> Array:
    """Return the places of a point of a frame, the same at all states or one for each."""
    count = len(skeleton.p)
    own = np.broadcast_to(at, (count, 3))
    return (
        own if frame < 0 else np.asarray(skeleton.p[:, :, frame] + np.einsum("kij,kj->ki", _axes(skeleton, frame), own))
    )


def _pull(course: _Course, element: Element) -> Iterator[Load]:
    """Yield the forces on the ends of a spring or a cable that can move."""
    if element.law is None:
        return
    a, b = (course.find(end) for end in (element.first, element.second))
    d = b - a
    length = np.linalg.norm(d, axis=1)
    way = d / np.maximum(length, 1e-12)[:, None]
    relative = course.move(element.second.frame, b) - course.move(element.first.frame, a)
    F = find_tension(element.law, length, np.einsum("ki,ki->k", way, relative), cable=element.cable)[:, None] * way
    for end, force in ((element.first, F), (element.second, -F)):
        if end.frame >= 0:
            yield Load(end, force)


def find_tension(law: Tension, length: Array, rate: Array, *, cable: bool) -> Array:
    """Return the tension of a spring or a cable [N]."""
    if cable:
        return law.stiffness * soften(length - law.rest, law.width) * _dissipate(law.dissipation * rate)
    return law.stiffness * (length - law.rest) + law.damping * rate


def _press(course: _Course, touch: Touch) -> Iterator[Load]:
    """Yield the forces of a contact on the body that touches: at a sphere's centre, or at the corners of a box."""
    if touch.law is None:
        return
    C = np.array(touch.axes).reshape(3, 3)  # one a row
    corners = np.zeros((1, 3)) if touch.size is None else SIGNS * np.array(touch.size)
    for corner in corners @ C:
        x, y, z = (np.array(touch.centre.at) + corner).tolist()
        foot = Point(frame=touch.centre.frame, at=(x, y, z))
        frame, n, gap, p = _meet(course, touch, course.find(foot))
        v = course.move(foot.frame, p) - course.move(frame, p)
        yield Load(foot, find_contact_force(touch.law, n, gap, v))


def _meet(course: _Course, touch: Touch, c: Array) -> tuple[int, Array, Array, Array]:
    """Return the frame of the side that is touched at points c (K, 3), normals, gaps, and points of contact."""
    if touch.sphere is not None:
        P, r, R = course.find(touch.sphere.centre), touch.radius, touch.sphere.radius
        length = np.linalg.norm(c - P, axis=1)
        n = (c - P) / np.maximum(length, 1e-12)[:, None]
        return touch.sphere.centre.frame, n, length - r - R, (R * c + r * P) / (r + R)
    assert touch.plane is not None, "a contact has another side"
    frame, normal = touch.plane.frame, np.array(touch.normal)
    n = np.broadcast_to(normal, (len(course.now.p), 3)) if frame < 0 else _axes(course.now, frame) @ normal
    p = c - touch.radius * n
    return frame, n, np.einsum("ki,ki->k", n, p - course.find(touch.plane)), p


def find_contact_force(law: Grip, n: Array, gap: Array, v: Array) -> Array:
    """Return the force of a contact (K, 3), given normals, gaps, and relative velocities [N]."""
    rate, depth = np.einsum("ki,ki->k", n, v), soften(-gap, law.width)
    power = depth ** int(law.exponent)
    if law.exponent % 1:
        power = power * np.sqrt(depth + 1e-6 * law.width)
    N = law.stiffness * power * _dissipate(-law.dissipation * rate)
    slip = v - rate[:, None] * n
    drag = law.coefficient * N / np.sqrt(np.einsum("ki,ki->k", slip, slip) + law.speed**2)
    return np.asarray(N[:, None] * n - drag[:, None] * slip)


def soften(x: Array, width: float) -> Array:
    """Return a smooth max(x, 0)."""
    return width * np.logaddexp(0.0, x / width)


def _dissipate(x: Array) -> Array:
    return soften(1 + x, 0.1) / float(soften(np.array(1.0), 0.1))
