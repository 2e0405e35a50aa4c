"""Forces of springs, cables, contacts and given wrenches along a motion, for arrows: poses and velocities -> newtons.

The laws are the kernels' laws, with the run-time parameters of the kernels. With d = b - a from the first end to the
second, its length |d|, and s(x, w) = w log(1 + exp(x/w)), a smooth max(x, 0),

    spring:   T = stiffness (length - rest) + damping rate + force
    cable:    T = stiffness s(length - rest, width) phi(dissipation rate) + force
    contact:  gap = n.(p - P) of a plane, |c - P| - r - R of two spheres, n = (c - P)/|c - P|;
              of a box, as `mbsgen.model.elements` writes it
              N = stiffness s(-gap, width)^exponent phi(-dissipation rate)
              F = N n - coefficient N v_t / sqrt(v_t.v_t + speed^2)

with phi(x) = s(1 + x, 1/10)/s(1, 1/10) (Hunt, Crossley, J. Appl. Mech. 42, 1975). A positive tension T pulls the ends
together; F acts on the body that touches. `force` and the components of wrenches are expressions over numbers of the
state. Velocities of points are central differences along the coordinates' rates.
"""

from __future__ import annotations

import operator
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.expressions import Algebra, evaluate, parse
from mbsgen.manifest import Appearance, Element, Given, Grip, Point, Reading, Tension, Touch
from mbsrun.animation.film import Force
from mbsrun.appearance import complete_appearance, name_parameters
from mbsrun.ocp.ground.plant import Plant
from mbsrun.skeleton import Skeleton, place

Array = NDArray[np.float64]

STEP = 1e-6  # s, of the differences
SIGNS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


_FUNCTIONS: Mapping[str, Any] = {
    name: getattr(np, name) for name in ("sin", "cos", "tan", "sqrt", "exp", "log", "tanh")
}
_INVERSE: Mapping[str, Any] = {"asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2}
ARRAYS: Algebra[Array] = Algebra(
    number=np.float64,  # type: ignore[arg-type]  # it is broadcast
    constants={"pi": np.float64(np.pi)},  # type: ignore[dict-item]
    negate=operator.neg,
    operations={"+": operator.add, "-": operator.sub, "*": operator.mul, "/": np.divide},
    power=lambda base, exponent: base ** float(exponent),
    functions={**_FUNCTIONS, **_INVERSE, "abs": np.abs, "max": np.maximum},
)


@dataclass(frozen=True, eq=False)
class Load:
    """A force or a moment over time at a point that is fixed in a frame; components in the base frame."""

    foot: Point
    values: Array  # (K, 3) [N or N m]
    kind: Force = Force.FORCE


def find_loads(plant: Plant, q: Array, dq: Array, signals: Mapping[str, Array] = MappingProxyType({})) -> list[Load]:
    """Compute the forces of springs, cables, contacts and given wrenches at coordinates q (K, n) with derivatives dq.

    `signals` holds the signals that forces read, and the time, (K,) each; a missing one is 0. The list of forces
    depends on the model alone.
    """
    appearance = complete_appearance(plant)
    if appearance is None or not has_loads(appearance):
        return []
    course = _Course(*(place(plant, q + step * dq) for step in (0.0, STEP, -STEP)))
    given = {name: np.zeros(len(q)) for name in plant.manifest.signals} | dict(signals)
    state = given | {x.name: _read(course, x, q, dq) for x in appearance.readings}
    known: dict[str, Array] = {**state, **{name: np.full(len(q), x) for name, x in name_parameters(plant).items()}}
    with np.errstate(all="ignore"):
        found = [load for element in appearance.elements for load in _pull(course, element, known)]
        found += [load for touch in appearance.contacts for load in _press(course, touch)]
        return found + [load for wrench in appearance.given for load in _apply(course, wrench, known)]


def has_loads(appearance: Appearance) -> bool:
    """Return whether a model has springs, cables, contacts or given wrenches whose laws are known."""
    laws = [*(x.law for x in appearance.elements), *(x.law for x in appearance.contacts)]
    return bool(appearance.given) or any(law is not None for law in laws)


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


def _read(course: _Course, reading: Reading, q: Array, dq: Array) -> Array:
    """Return a number of the state, (K,)."""
    if reading.point is None:
        return np.asarray((dq if reading.rate else q)[:, reading.entry])
    places = course.find(reading.point)
    found = course.move(reading.point.frame, places) if reading.rate else places
    return np.asarray(found[:, reading.entry])


def _compute(text: str, known: Mapping[str, Array], count: int) -> Array:
    """Compute an expression at all states; the empty one is 0."""
    return np.broadcast_to(evaluate(parse(text), known, ARRAYS) if text else 0.0, (count,))


def _apply(course: _Course, wrench: Given, known: Mapping[str, Array]) -> Iterator[Load]:
    """Yield the force and the moment of a wrench."""
    count = len(course.now.p)
    for kind, texts in ((Force.FORCE, wrench.force), (Force.MOMENT, wrench.moment)):
        if any(texts):
            values = np.stack([_compute(text, known, count) for text in texts], axis=1)
            if not wrench.in_base:
                axes = _axes(course.now, wrench.at.frame) @ np.array(wrench.axes).reshape(3, 3).T
                values = np.einsum("kij,kj->ki", axes, values)
            yield Load(wrench.at, values, kind)


def _pull(course: _Course, element: Element, known: Mapping[str, Array]) -> Iterator[Load]:
    """Yield the forces on the ends of a spring or a cable that can move."""
    if element.law is None:
        return
    a, b = (course.find(end) for end in (element.first, element.second))
    d = b - a
    length = np.linalg.norm(d, axis=1)
    way = d / np.maximum(length, 1e-12)[:, None]
    relative = course.move(element.second.frame, b) - course.move(element.first.frame, a)
    rate = np.einsum("ki,ki->k", way, relative)
    T = find_tension(element.law, length, rate, cable=element.cable)
    T = T + _compute(element.force, {**known, "length": length, "rate": rate}, len(length))
    F = T[:, None] * way
    for end, force in ((element.first, F), (element.second, -F)):
        if end.frame >= 0:
            yield Load(end, force)


def find_tension(law: Tension, length: Array, rate: Array, *, cable: bool) -> Array:
    """Return the tension of a spring or a cable [N]."""
    if cable:
        return law.stiffness * soften(length - law.rest, law.width) * _dissipate(law.dissipation * rate)
    return law.stiffness * (length - law.rest) + law.damping * rate


def _press(course: _Course, touch: Touch) -> Iterator[Load]:
    """Yield the forces of a contact on the body that touches: at a sphere's centre, or at corners."""
    if touch.law is None:
        return
    C = np.array(touch.axes).reshape(3, 3)  # one a row
    corners = np.zeros((1, 3)) if touch.points is None else np.array(touch.points)
    corners = corners if touch.size is None else SIGNS * np.array(touch.size)
    for corner in corners @ C:
        x, y, z = (np.array(touch.centre.at) + corner).tolist()
        foot = Point(frame=touch.centre.frame, at=(x, y, z))
        frame, n, gap, p = _meet(course, touch, touch.law, course.find(foot))
        v = course.move(foot.frame, p) - course.move(frame, p)
        yield Load(foot, find_contact_force(touch.law, n, gap, v))


def _meet(course: _Course, touch: Touch, law: Grip, c: Array) -> tuple[int, Array, Array, Array]:
    """Return the frame of the side that is touched at points c (K, 3), normals, gaps, and points of contact."""
    if touch.sphere is not None:
        P, r, R = course.find(touch.sphere.centre), touch.radius, touch.sphere.radius
        length = np.linalg.norm(c - P, axis=1)
        n = (c - P) / np.maximum(length, 1e-12)[:, None]
        return touch.sphere.centre.frame, n, length - r - R, (R * c + r * P) / (r + R)
    if touch.box is not None:
        frame, own = touch.box.centre.frame, np.array(touch.box.axes).reshape(3, 3)  # one a row
        turned = own @ np.swapaxes(_axes(course.now, frame), 1, 2) if frame >= 0 else own
        axes = np.broadcast_to(turned, (len(c), 3, 3))
        x = np.einsum("kai,ki->ka", axes, c - course.find(touch.box.centre))
        gap, slope = measure_box(x, np.array(touch.box.size), law.width)
        n = np.einsum("kai,ka->ki", axes, slope)
        return frame, n, gap - touch.radius, c - touch.radius * n
    if touch.capsule is not None:
        rod = touch.capsule
        frame, own = rod.centre.frame, np.array(rod.axis)
        axis = _axes(course.now, frame) @ own if frame >= 0 else np.broadcast_to(own, c.shape)
        gap, n = measure_capsule(c - course.find(rod.centre), axis, rod.length, law.width)
        return frame, n, gap - touch.radius - rod.radius, c - touch.radius * n
    assert touch.plane is not None, "a contact has another side"
    frame, normal = touch.plane.frame, np.array(touch.normal)
    n = np.broadcast_to(normal, (len(course.now.p), 3)) if frame < 0 else _axes(course.now, frame) @ normal
    p = c - touch.radius * n
    return frame, n, np.einsum("ki,ki->k", n, p - course.find(touch.plane)), p


def measure_box(x: Array, size: Array, width: float) -> tuple[Array, Array]:
    """Return the smooth distances from a box (K,), and their gradients (K, 3), at points in its axes (K, 3)."""
    q = soften(2 * x, width) - x - size / 2
    y = soften(q, width)
    outside = np.sqrt(np.sum(y**2, axis=1) + (1e-3 * width) ** 2)
    m = width * np.logaddexp.reduce(q / width, axis=1)
    slope = y * _step(q / width) / outside[:, None] + (_step(-m / width)[:, None] * np.exp((q - m[:, None]) / width))
    return outside - soften(-m, width), (2 * _step(2 * x / width) - 1) * slope


def measure_capsule(d: Array, axis: Array, length: float, width: float) -> tuple[Array, Array]:
    """Return the smooth distances (K,) from segments of directions (K, 3), and their gradients, at points d (K, 3)."""
    along = np.einsum("ki,ki->k", axis, d)
    q = soften(2 * along, width) - along - length / 2
    beyond = soften(q, width)
    across = d - along[:, None] * axis
    gap = np.sqrt(np.sum(across**2, axis=1) + beyond**2)
    slope = (2 * _step(2 * along / width) - 1) * _step(q / width) * beyond
    return gap, (across + slope[:, None] * axis) / np.maximum(gap, 1e-12)[:, None]


def _step(x: Array) -> Array:
    return np.asarray((1 + np.tanh(x / 2)) / 2)


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
