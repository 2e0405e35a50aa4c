"""Motions -> a film: poses at the times of its pictures, actors, arrows, bounds, ground and view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import TIME, Manifest, Point
from mbsgen.style import PALETTE
from mbsrun.animation.actors import BY_BODY, list_meshes, look_alike, make_actor
from mbsrun.animation.film import Actor, Arrow, Film, Force, Marker, Plane, Track, Triple, View
from mbsrun.animation.forces import Load, find_loads
from mbsrun.animation.visuals import Visual, show_drawings
from mbsrun.appearance import complete_manifest
from mbsrun.ocp.ground.plant import Plant
from mbsrun.skeleton import Skeleton, place

Array = NDArray[np.float64]

RATE = 25.0  # pictures a second; a page interpolates
MAX_PICTURES = 1500
FAR = 1e12  # m; points farther away are shown there
FLAT = 0.06  # a mechanism whose depth is a smaller part of its size is seen from the front
ARROW = 0.3  # of the longest arrow, relative to the size of the mechanism
USUAL = 0.8  # quantile of a force of a contact, a spring or a cable that is as long; impacts are above it
CUT = 1.5  # lengths of arrows are cut there, relative to ARROW
UP = (0.0, 0.0, 1.0)
_STEPS = (-2, -1, 0, 1, 2)
_CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a motion: times (K,), coordinates (K, n), and their rates; inputs and open wrenches, where known.

    Inputs and wrenches are at the same times, and hold until the next one.
    """

    kernels: Plant
    t: Array
    q: Array
    rates: Array | None = None
    name: str = ""
    u: Array | None = None  # (K, inputs)
    w: Array | None = None  # (K, entries of w)

    def __post_init__(self) -> None:
        t, q, n = self.t, self.q, len(self.kernels.manifest.positions)
        if t.ndim != 1 or not t.size or q.shape != (t.size, n) or (np.diff(t) <= 0).any():
            raise ValueError(f"times of shape {t.shape} must increase, and q of shape {q.shape} have {n} columns")
        if self.rates is not None and self.rates.shape != q.shape:
            raise ValueError(f"qd has shape {self.rates.shape}, q {q.shape}")
        for name, values in (("u", self.u), ("w", self.w)):
            if values is not None and (values.ndim != 2 or len(values) != t.size):
                raise ValueError(f"{name} has shape {values.shape}; give a row for each of {t.size} times")


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion of one mechanism, in parts that follow each other; their frames have the same names."""

    parts: tuple[Part, ...]
    name: str = ""

    @property
    def start(self) -> float:
        """Return the time at which it begins."""
        return float(self.parts[0].t[0])

    @property
    def end(self) -> float:
        """Return the time at which it ends."""
        return float(self.parts[-1].t[-1])

    @property
    def manifest(self) -> Manifest:
        """Return the manifest of its first part, which has the frames of all, with numbers of its parameters."""
        return complete_manifest(self.parts[0].kernels)


@dataclass(frozen=True)
class Wanted:
    """The content of a film beside its motions."""

    title: str | None = None  # None: the model's name
    markers: tuple[Marker, ...] = field(default=())
    is_apart: bool = False  # several motions side by side
    visuals: tuple[Visual, ...] = ()  # shapes and meshes of bodies, in place of the model's and of solids from inertia
    rate: float = RATE  # pictures a second
    is_sequence: bool = False  # motions follow each other, and each is shown in its time alone


def make_film(motions: Sequence[Motion], wanted: Wanted | None = None) -> Film:
    """Make the film of some motions, which are shown at the same time, or one after the other."""
    wanted = wanted or Wanted()
    drawings = [_list_visuals(motion.manifest, wanted) for motion in (motions if wanted.is_sequence else motions[:1])]
    drawings = drawings if wanted.is_sequence else drawings * len(motions)
    start, end = min(x.start for x in motions), max(x.end for x in motions)
    times = choose_times(start, end, wanted.rate)
    skeletons = [_place(motion, times) for motion in motions]
    is_one = len(motions) == 1 or wanted.is_sequence
    looks = [BY_BODY] * len(motions) if is_one else [look_alike(PALETTE[i % len(PALETTE)]) for i in range(len(motions))]
    actors = tuple(
        make_actor(motion.name or motion.manifest.model, motion.manifest, skeleton, look, visuals)
        for motion, skeleton, look, visuals in zip(motions, skeletons, looks, drawings, strict=True)
    )
    arrows = [_list_arrows(motion, times) for motion in motions]
    loads = [_list_loads(motion, times) for motion in motions]
    for every, own in zip(arrows, loads, strict=True):
        every += [Arrow(x.kind, x.foot, True, x.values) for x in own if x.kind is Force.MOMENT and x.values.any()]
    loads = [[x for x in own if x.kind is Force.FORCE] for own in loads]
    lengths = [np.linalg.norm(x.values, axis=1) for every in loads for x in every]
    usual = max((float(np.quantile(x[x > 0], USUAL)) for x in lengths if (x > 0).any()), default=0.0)
    scales = _choose_scales([x for every in arrows for x in every], max(actor.size for actor in actors), usual)
    cut = CUT * ARROW * max(actor.size for actor in actors) / scales[Force.FORCE]
    for every, own in zip(arrows, loads, strict=True):
        every += [Arrow(Force.FORCE, x.foot, True, _shorten(x.values, cut)) for x in own if x.values.any()]
    tracks = tuple(
        _track(skeleton, tuple(_rescale(x, scales[x.kind]) for x in own), shown)
        for skeleton, own, shown in zip(skeletons, arrows, _list_shown(motions, wanted), strict=True)
    )
    points = _list_points(actors, tracks, wanted.markers)
    low, high = _bound(points)
    up = _find_up(motions[0].manifest)
    return Film(
        title=motions[0].manifest.model if wanted.title is None else wanted.title,
        times=times,
        actors=actors,
        tracks=tracks,
        up=up,
        low=low,
        high=high,
        hull=_find_hull(points),
        thickness=0.009 * max(actor.size for actor in actors),
        view=_choose_view(low, high, up),
        planes=tuple(_list_planes(motions, low, high, up)),
        markers=wanted.markers,
        meshes=list_meshes(wanted.visuals),
        parts=tuple(
            (part.name, float(part.t[0]))
            for motion in (motions if wanted.is_sequence else motions[:1])
            for part in motion.parts
            if part.name
        ),
        is_apart=wanted.is_apart,
    )


def _list_visuals(manifest: Manifest, wanted: Wanted) -> tuple[Visual, ...]:
    """List the wanted shapes, and the model's own of other bodies."""
    shown = {x.body for x in wanted.visuals}
    return (*wanted.visuals, *(x for x in show_drawings(manifest) if x.body not in shown))


def _list_shown(motions: Sequence[Motion], wanted: Wanted) -> list[tuple[float, float] | None]:
    """List the times of motions in a sequence: until the next one starts; the last one stays after its end."""
    if not wanted.is_sequence or len(motions) == 1:
        return [None] * len(motions)
    ends = [*(motion.start for motion in motions[1:]), motions[-1].end + 1.0]
    return [(motion.start, end) for motion, end in zip(motions, ends, strict=True)]


def choose_times(start: float, end: float, rate: float = RATE) -> Array:
    """Choose the times of the pictures: `rate` of them a second, both ends, at most MAX_PICTURES."""
    count = min(int(np.ceil((end - start) * rate)) + 1, MAX_PICTURES)
    return np.linspace(start, end, count)


# --- poses -----------------------------------------------------------------------------------------------------------


def _find_parts(motion: Motion, times: Array) -> Array:
    """Return the index of the part that is shown at each time."""
    ends = [float(part.t[-1]) for part in motion.parts]
    return np.minimum(np.searchsorted(ends, times), len(ends) - 1)


def _place(motion: Motion, times: Array) -> Skeleton:
    """Place the frames of a motion; it stands before its start and after its end."""
    held = np.clip(times, motion.start, motion.end)
    which = _find_parts(motion, held)
    found = [place(x.kernels, _interpolate(x, held[which == i])) for i, x in enumerate(motion.parts) if i in which]
    p, R = (np.concatenate([getattr(each, name) for each in found]) for name in ("p", "R"))
    return Skeleton(found[0].frames, np.clip(p, -FAR, FAR), R, found[0].links)


def _interpolate(part: Part, times: Array) -> Array:
    if len(part.t) == 1:
        return np.repeat(part.q, len(times), axis=0)
    s, (a, b, c, d) = _fit(part, times)
    return np.asarray(d + c * s + b * (s * s) + a * (s * s * s))


def _differentiate(part: Part, times: Array) -> Array:
    """Return the time derivatives of the coordinates."""
    if len(part.t) == 1:
        return np.zeros((len(times), part.q.shape[1])) if part.rates is None else part.rates[[0] * len(times)]
    s, (a, b, c, _) = _fit(part, times)
    return np.asarray(c + 2 * b * s + 3 * a * (s * s))


def _fit(part: Part, times: Array) -> tuple[Array, tuple[Array, ...]]:
    """Return the times since the beginning of their steps, (K, 1), and the coefficients there, from the cube on.

    The coordinates are Hermite's cubic polynomials through values and rates, or lines through values.
    """
    k = np.searchsorted(part.t, times, side="right").clip(1, len(part.t) - 1) - 1
    length, begin = (part.t[k + 1] - part.t[k])[:, None], part.q[k]
    slope, s = (part.q[k + 1] - begin) / length, (times - part.t[k])[:, None]
    if part.rates is None:
        return s, (np.zeros_like(slope), np.zeros_like(slope), slope, begin)
    first, bend = part.rates[k], (part.rates[k] + part.rates[k + 1] - 2 * slope) / length
    return s, (bend / length, (slope - first) / length - bend, first, begin)


def _track(skeleton: Skeleton, arrows: tuple[Arrow, ...], shown: tuple[float, float] | None) -> Track:
    K = len(skeleton.p)
    R = skeleton.R.reshape(K, 3, -1, 3).transpose(0, 2, 1, 3)
    return Track(np.ascontiguousarray(skeleton.p.swapaxes(1, 2)), np.ascontiguousarray(R), arrows, shown)


# --- arrows ----------------------------------------------------------------------------------------------------------


def _list_arrows(motion: Motion, times: Array) -> list[Arrow]:
    """List the forces of actuators at their joints, and the open wrenches, over time."""
    manifest = motion.manifest
    appearance = manifest.appearance
    if appearance is None:
        return []
    u, w = (_sample(motion, times, name) for name in ("u", "w"))
    found = []
    frames = {axle.coordinate: i for i, axle in enumerate(appearance.axles) if axle.coordinate is not None}
    for k, i in enumerate(manifest.actuated):
        if u is not None and k < u.shape[1] and u[:, k].any():
            frame = frames[i]
            kind = Force.MOMENT if manifest.coordinates[i].motion == "revolute" else Force.FORCE
            values = u[:, k : k + 1] * np.array(appearance.axles[frame].axis)
            found.append(Arrow(kind, Point(frame=frame, at=(0.0, 0.0, 0.0)), False, values))
    entry = 0
    for wrench, foot in zip(manifest.wrenches, appearance.wrenches, strict=False):
        for kind, is_open in ((Force.FORCE, wrench.force), (Force.MOMENT, wrench.moment)):
            if is_open:
                if w is not None and w[:, entry : entry + 3].any():
                    axes = np.array(foot.axes or np.eye(3)).reshape(3, 3)  # one a row
                    found.append(Arrow(kind, foot, wrench.in_base, w[:, entry : entry + 3] @ axes))
                entry += 3
    return found


def _list_loads(motion: Motion, times: Array) -> list[Load]:
    """List the forces of springs, cables, contacts and given wrenches; 0 before the motion and after it."""
    names = motion.manifest.signals
    w = _sample(motion, times, "w")
    which, within = _find_parts(motion, times), (times >= motion.start) & (times <= motion.end)
    found: list[Load] = []
    for i, part in enumerate(motion.parts):
        rows = within & (which == i)
        if rows.any():
            q, dq = _interpolate(part, times[rows]), _differentiate(part, times[rows])
            t = times[rows] - (part.t[0] if len(motion.parts) > 1 else 0.0)  # of a phase, from its start
            given = {} if w is None or not names else dict(zip(names, w[rows, -len(names) :].T, strict=True))
            loads = find_loads(part.kernels, q, dq, given | {TIME: t})
            found = found or [replace(x, values=np.zeros((len(times), 3))) for x in loads]
            for load, own in zip(found, loads, strict=False):
                load.values[rows] = np.where(np.isfinite(own.values), own.values, 0.0)
    return found


def _sample(motion: Motion, times: Array, name: str) -> Array | None:
    """Return inputs or wrenches at the pictures; 0 where a part has none, and after the motion's end."""
    known = [values for part in motion.parts if (values := getattr(part, name)) is not None and values.shape[1]]
    if not known:
        return None
    found = np.zeros((len(times), known[0].shape[1]))
    which = _find_parts(motion, times)
    for i, part in enumerate(motion.parts):
        values = getattr(part, name)
        if values is not None and values.shape[1] == found.shape[1]:
            rows = np.clip(np.searchsorted(part.t, times, side="right") - 1, 0, len(part.t) - 1)
            found[which == i] = values[rows[which == i]]
    found[(times < motion.start) | (times > motion.end) | ~np.isfinite(found).all(axis=1)] = 0.0
    return found


def _choose_scales(arrows: Sequence[Arrow], size: float, usual: float) -> dict[Force, float]:
    """Choose a scale for forces and one for moments, so that the longest arrows have a length that is seen.

    `usual` is a force of contacts, springs and cables that has this length too, if it is larger [N].
    """
    scales = {}
    for kind in Force:
        largest = max((float(np.abs(x.values).max()) for x in arrows if x.kind is kind), default=0.0)
        largest = max(largest, usual) if kind is Force.FORCE else largest
        scales[kind] = ARROW * size / largest if largest > 0 else 1.0
    return scales


def _shorten(values: Array, most: float) -> Array:
    """Shorten vectors that are longer than a limit, such as forces of impacts."""
    lengths = np.linalg.norm(values, axis=1, keepdims=True)
    return np.asarray(values * np.minimum(1.0, most / np.maximum(lengths, 1e-300)))


def _rescale(arrow: Arrow, scale: float) -> Arrow:
    return Arrow(arrow.kind, arrow.foot, arrow.in_base, arrow.values, scale)


# --- bounds, ground, view --------------------------------------------------------------------------------------------


def _list_points(actors: Sequence[Actor], tracks: Sequence[Track], markers: Sequence[Marker]) -> Array:
    """List the places of frames, ends of lines, corners of solids, and markers, at all times: (points, 3)."""
    points = [np.array([m.position for m in markers]).reshape(-1, 3)]
    for actor, track in zip(actors, tracks, strict=True):
        shown = [i for i in range(len(actor.frames)) if i not in actor.floating]
        points.append(track.p[:, shown].reshape(-1, 3))
        if not actor.floating:
            points.append(np.zeros((1, 3)))
        for end in (end for line in actor.lines for end in line.ends):
            at = np.array([end.at])
            points.append(at if end.frame < 0 else track.p[:, end.frame] + track.R[:, end.frame] @ at[0])
        for solid in actor.solids:
            axes = np.array(solid.axes).reshape(3, 3)  # one a row
            corners = np.array(solid.at) + _CORNERS * np.array(solid.size) @ axes
            if solid.frame >= 0:
                corners = track.p[:, None, solid.frame] + corners @ track.R[:, solid.frame].swapaxes(1, 2)
            points.append(corners.reshape(-1, 3))
    return np.concatenate(points)


def _bound(points: Array) -> tuple[Triple, Triple]:
    """Return the corners of the box around all points, which is not flat."""
    low, high = points.min(0), points.max(0)
    least = 0.05 * float((high - low).max() or 1.0)
    low, high = np.minimum(low, (low + high - least) / 2), np.maximum(high, (low + high + least) / 2)
    return _triple(low), _triple(high)


def _find_hull(points: Array) -> tuple[Triple, ...]:
    """Return the points that lie farthest out, in 98 directions."""
    ways = np.array([(x, y, z) for x in _STEPS for y in _STEPS for z in _STEPS if 2 in map(abs, (x, y, z))])
    return tuple(_triple(points[i]) for i in np.unique((points @ ways.T).argmax(0)))


def _find_up(manifest: Manifest) -> Triple:
    """Return the direction against gravity; z without it."""
    if manifest.appearance is None:
        return UP
    g = np.array(manifest.appearance.gravity)
    length = float(np.linalg.norm(g))
    return _triple(-g / length + 0.0) if length > 0 else UP


def _list_planes(motions: Sequence[Motion], low: Triple, high: Triple, up: Triple) -> list[Plane]:
    """List the planes of contacts on the base, each once; without a level one, a ground below everything."""
    found: dict[tuple[float, ...], Plane] = {}
    for motion in motions:
        for x in motion.manifest.appearance.contacts if motion.manifest.appearance else ():
            if x.plane is not None and x.normal is not None and x.plane.frame < 0:
                level = float(np.dot(x.normal, x.plane.at))
                found.setdefault((*x.normal, level), Plane(x.plane.at, x.normal))
    planes = list(found.values())
    for i, plane in enumerate(planes):
        if np.dot(plane.normal, up) > 1 - 1e-9:
            planes[i] = Plane(plane.at, plane.normal, grid=True)
            return planes
    corners = np.stack((low, high))
    lowest = float(np.where(np.array(up) > 0, corners[0], corners[1]) @ np.array(up))
    return [*planes, Plane(_triple(lowest * np.array(up)), up, grid=True)]


def _choose_view(low: Triple, high: Triple, up: Triple) -> View:
    """Look at a flat mechanism nearly from the front, and at any other one from a corner."""
    vertical = np.array(up)
    if vertical.max() < 1 - 1e-9:
        return View()
    first = np.array([1.0, 0.0, 0.0]) if abs(vertical[2]) > 0.5 else np.array([0.0, 0.0, 1.0])
    east = first - vertical * (first @ vertical)
    north = np.cross(vertical, east)
    spans = [float(abs(way @ np.subtract(high, low))) for way in (east, north)]
    largest = float(np.subtract(high, low).max())
    if min(spans) > 3 * FLAT * largest:
        return View()
    azimuth = -np.pi / 2 if spans[1] <= spans[0] else 0.0
    return View(azimuth + 0.3, 0.16)


def _triple(v: Array) -> Triple:
    x, y, z = (float(c) for c in v)
    return x, y, z
