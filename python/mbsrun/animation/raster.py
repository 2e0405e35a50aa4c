"""Pictures of a film without a browser: triangles -> pixels, by a depth buffer in NumPy.

A triangle covers the pixels whose barycentric coordinates are not negative; 1/depth is linear over it (Foley, van Dam,
Feiner, Hughes, Computer Graphics, section 15.4). The nearest triangle of each pixel is shaded afterwards, by the light
of `renderer.js`. Pictures are drawn at twice their size and averaged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from mbsrun.animation.film import Actor, Arrow, Course, Film, Force, Layer, Plane, Track
from mbsrun.animation.shapes import Shape, join, make_bead, make_cone, make_shape, make_stick, point_along

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]  # (height, width, 3)

SAMPLES = 2  # per pixel, in each direction
SLOPE = np.tan(np.pi / 12)  # of half the angle of view
PAPER, FAINT, INK = (np.array(c) / 255 for c in ((244, 246, 249), (185, 195, 207), (29, 39, 51)))
SENSOR, MARKER, BASE = "#d55e00", "#e69f00", "#5d6b7a"
ARROWS = {Force.FORCE: "#d55e00", Force.MOMENT: "#cc79a7"}
CONTACT_ALPHA, SHADOW = 0.45, 0.16


@dataclass(frozen=True, eq=False)
class Camera:
    """An eye that looks at a centre, in perspective."""

    eye: Array
    right: Array
    above: Array
    back: Array  # towards the eye
    scale: float  # pixels at distance 1
    width: int
    height: int

    def project(self, points: Array) -> tuple[Array, Array]:
        """Return the pixels (..., 2) of points (..., 3), and their distances along the view."""
        d = points - self.eye
        depth = -(d @ self.back)
        safe = np.maximum(depth, 1e-9)
        x = self.width / 2 + self.scale * (d @ self.right) / safe
        y = self.height / 2 - self.scale * (d @ self.above) / safe
        return np.stack((x, y), axis=-1), depth


@dataclass(frozen=True, eq=False)
class Paint:
    """Triangles with one colour each; unlit ones are shown as they are."""

    shape: Shape
    colors: Array  # (T, 3)
    lit: bool = True


def draw_film(film: Film, width: int, height: int, chosen: Sequence[int] | None = None) -> Iterator[Picture]:
    """Draw the pictures of a film, one for each of its times, or for chosen ones by their numbers."""
    stage = _Stage(film, width * SAMPLES, height * SAMPLES)
    for k in range(len(film.times)) if chosen is None else chosen:
        image = Image.fromarray(stage.draw(k)).resize((width, height), Image.Resampling.BOX)
        _write_texts(image, film, k)
        yield np.asarray(image)


def look(film: Film, width: int, height: int) -> Camera:
    """Choose the camera that sees everything that moves, as the page's first view does."""
    up = np.array(film.up)
    first = np.array([1.0, 0.0, 0.0]) if abs(up[2]) > 0.5 else np.array([0.0, 0.0, 1.0])
    east = first - up * (first @ up)
    east /= np.linalg.norm(east)
    north = np.cross(up, east)
    ca, sa = np.cos(film.view.azimuth), np.sin(film.view.azimuth)
    ce, se = np.cos(film.view.elevation), np.sin(film.view.elevation)
    flat = ca * east + sa * north
    right, above, back = ca * north - sa * east, ce * up - se * flat, ce * flat + se * up
    middle = (np.array(film.low) + np.array(film.high)) / 2
    d = np.concatenate([np.array(film.hull) + shift for shift in find_shifts(film)]) - middle
    need = np.maximum(np.abs(d @ right) / (0.94 * width / height), np.abs(d @ above) / 0.86) / SLOPE
    distance = max(float((need + d @ back).max()), 0.1 * film.size)
    return Camera(middle + distance * back, right, above, back, height / 2 / SLOPE, width, height)


def find_shifts(film: Film) -> list[Array]:
    """Return by how much each actor is moved aside."""
    count = len(film.actors)
    if not film.is_apart or count < 2:
        return [np.zeros(3)] * count
    up, azimuth = np.array(film.up), film.view.azimuth
    first = np.array([1.0, 0.0, 0.0]) if abs(up[2]) > 0.5 else np.array([0.0, 0.0, 1.0])
    east = first - up * (first @ up)
    east /= np.linalg.norm(east)
    way = np.cos(azimuth) * np.cross(up, east) - np.sin(azimuth) * east
    width = abs(float(way @ np.subtract(film.high, film.low))) + 0.18 * film.size
    return [(i - (count - 1) / 2) * width * way for i in range(count)]


class _Stage:
    """A film with its camera, and everything that is the same in all pictures."""

    def __init__(self, film: Film, width: int, height: int) -> None:
        self._film = film
        self._camera = look(film, width, height)
        self._shifts = find_shifts(film)
        self._shapes = [[make_shape(solid, film.meshes) for solid in actor.solids] for actor in film.actors]
        back = self._camera.back
        light = 0.9 * np.array(film.up) - 0.35 * self._camera.right + 0.45 * back
        self._light = light / np.linalg.norm(light)
        self._floor = next((plane for plane in film.planes if plane.grid), None)
        self._paper = self._draw_ground()

    def draw(self, k: int) -> Picture:
        """Draw picture k."""
        solid, glassy, front = self._collect(k)
        picture = self._paper.copy()
        self._cast_shadows(picture, join([x.shape for x in solid if x.lit]))
        depth = np.full(picture.shape[:2], np.inf)
        self._paint(picture, depth, solid, 1.0)
        self._paint(picture, depth, glassy, CONTACT_ALPHA)
        self._paint(picture, np.full(picture.shape[:2], np.inf), front, 1.0)
        return np.asarray(np.rint(np.clip(picture, 0, 1) * 255), dtype=np.uint8)

    # --- triangles ---------------------------------------------------------------------------------------------------

    def _collect(self, k: int) -> tuple[list[Paint], list[Paint], list[Paint]]:
        """List what is solid, what is seen through, and what stands in front."""
        film, solid = self._film, list[Paint]()
        glassy, front = list[Paint](), list[Paint]()
        for i, (actor, track) in enumerate(zip(film.actors, film.tracks, strict=True)):
            if track.shown is not None and not track.shown[0] <= film.times[k] + 1e-9 < track.shown[1]:
                continue
            poses = _Poses(track, k, self._shifts[i])
            for each, shape in zip(actor.solids, self._shapes[i], strict=True):
                turn = poses.turn(each.frame) @ np.array(each.axes).reshape(3, 3).T
                placed = shape.placed(turn, poses.point(each.frame, each.at), np.ones(3))
                (glassy if each.layer is Layer.CONTACTS else solid).append(_color(placed, each.color))
            if not film.has_visuals:
                solid += self._draw_edges(actor, poses)
            solid += self._draw_lines(actor, poses)
            solid += self._draw_traces(actor, track, k, self._shifts[i])
            for arrow in track.arrows:
                front += self._draw_arrow(arrow, poses, k)
        for marker in film.markers:
            radius, at = 2.1 * film.thickness, np.array(marker.position)
            for way in (np.array(film.up), -np.array(film.up)):
                cone = make_cone().placed(point_along(way), at, radius * np.array([1, 1, 1.4]))
                solid.append(_color(cone, MARKER))
        return solid, glassy, front

    def _draw_edges(self, actor: Actor, poses: _Poses) -> Iterator[Paint]:
        thickness = self._film.thickness
        for i, frame in enumerate(actor.frames):
            at = poses.origin(i)
            if i not in actor.floating:
                radius = (0.45 if frame.slides else 1.0) * thickness
                yield _color(make_stick(poses.origin(frame.parent), at, radius), actor.color)
                yield _color(make_bead(at, thickness), actor.color)
            if frame.sensor:
                yield _color(make_bead(at, 1.35 * thickness), SENSOR)

    def _draw_lines(self, actor: Actor, poses: _Poses) -> Iterator[Paint]:
        thickness = self._film.thickness
        for line in actor.lines:
            a, b = (poses.point(end.frame, end.at) for end in line.ends)
            if line.kind is Course.ROD:
                yield _color(make_stick(a, b, 0.8 * thickness), actor.color)
            else:
                path = _coil(a, b, 2.2 * thickness) if line.kind is Course.SPRING else np.stack((a, b))
                yield self._draw_path(path, 2.0, SENSOR if line.kind is Course.GAP else "#1d2733")

    def _draw_traces(self, actor: Actor, track: Track, k: int, shift: Array) -> Iterator[Paint]:
        color = actor.color if len(self._film.actors) > 1 and not self._film.is_sequence else SENSOR
        for i, frame in enumerate(actor.frames):
            if frame.sensor and len(track.p) > 1:
                path = track.p[:, i] + shift
                yield self._draw_path(path, 1.0, _pale(color))
                yield self._draw_path(path[: k + 1], 1.8, color)

    def _draw_path(self, path: Array, pixels: float, color: str) -> Paint:
        """Draw a path as strips that face the camera."""
        a, b = path[:-1], path[1:]
        moved = np.linalg.norm(b - a, axis=1) > 1e-9
        a, b = a[moved], b[moved]
        across = np.cross(b - a, a - self._camera.eye)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
        _, depth = self._camera.project(a)
        across *= (0.5 * pixels * SAMPLES * depth / self._camera.scale)[:, None]
        quads = np.stack((a - across, a + across, b + across, b - across), axis=1)
        corners = np.concatenate((quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]))
        return _color(Shape(corners, np.zeros_like(corners)), color, lit=False)

    def _draw_arrow(self, arrow: Arrow, poses: _Poses, k: int) -> Iterator[Paint]:
        """Draw a force as a straight arrow, a moment as one that turns about it."""
        film, color = self._film, ARROWS[arrow.kind]
        vector = arrow.scale * arrow.values[k]
        vector = vector if arrow.in_base else poses.turn(arrow.foot.frame) @ vector
        length = float(np.linalg.norm(vector))
        if length <= 0.004 * film.size:
            return
        foot, way, r = poses.point(arrow.foot.frame, arrow.foot.at), vector / length, 0.62 * film.thickness
        if arrow.kind is Force.FORCE:
            head = min(3.2 * film.thickness, 0.5 * length)
            neck = foot + (length - head) * way
            yield _color(make_stick(foot, neck, r), color)
            yield _color(make_cone().placed(point_along(way), neck, head * np.array([0.6, 0.6, 1])), color)
            return
        R = min(max(0.3 * length, 3.2 * film.thickness), 0.09 * film.size)
        angle, axes = min(5.4, length / R), point_along(way)
        angles = np.linspace(0, angle, max(3, int(np.ceil(5 * angle))) + 1)
        circle = foot + R * (np.cos(angles)[:, None] * axes[:, 0] + np.sin(angles)[:, None] * axes[:, 1])
        yield _color(join([make_stick(a, b, r) for a, b in pairwise(circle)]), color)
        head = min(3.2 * film.thickness, 0.5 * R * angle)
        ahead = -np.sin(angle) * axes[:, 0] + np.cos(angle) * axes[:, 1]
        yield _color(make_cone().placed(point_along(ahead), circle[-1], head * np.array([0.6, 0.6, 1])), color)

    # --- pixels ------------------------------------------------------------------------------------------------------

    def _paint(self, picture: Array, depth: Array, paints: list[Paint], alpha: float) -> None:
        """Shade the pixels that triangles cover and nothing nearer hides."""
        if not paints:
            return
        shape = join([x.shape for x in paints])
        colors = np.concatenate([x.colors for x in paints])
        lit = np.concatenate([np.full(len(x.colors), x.lit) for x in paints])
        places, far = self._camera.project(shape.corners)
        found = rasterise(places, far, depth)
        if found is None:
            return
        row, column, triangle, weights = found
        point = np.einsum("nk,nkc->nc", weights, shape.corners[triangle])
        normal = np.einsum("nk,nkc->nc", weights, shape.normals[triangle])
        shown = np.where(lit[triangle, None], self._shade(point, normal, colors[triangle]), colors[triangle])
        picture[row, column] = (1 - alpha) * picture[row, column] + alpha * shown

    def _shade(self, point: Array, normal: Array, color: Array) -> Array:
        """Return the colours of points, by the same light as in the page."""
        n = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        v = self._camera.eye - point
        v /= np.linalg.norm(v, axis=1, keepdims=True)
        n = np.where(((n * v).sum(1) < 0)[:, None], -n, n)
        diffuse = np.maximum(n @ self._light, 0.0)
        sky = 0.5 + 0.5 * (n @ np.array(self._film.up))
        rim = (1 - np.clip((n * v).sum(1), 0, 1)) ** 3
        half = v + self._light
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        gloss = np.clip((n * half).sum(1), 0, 1) ** 48
        t = np.clip(0.6 + 0.4 * sky, 0, 1)
        lit = color * ((0.34 + 0.26 * sky + 0.52 * diffuse) * t * t * (3 - 2 * t))[:, None]
        return np.asarray(np.clip(lit + (0.16 * gloss + 0.1 * rim)[:, None], 0, 1) ** 0.95)

    def _cast_shadows(self, picture: Array, shape: Shape) -> None:
        """Darken the ground where triangles lie between it and the light."""
        floor = self._floor
        if floor is None or not len(shape.corners):
            return
        n = np.array(floor.normal)
        heights = (shape.corners - np.array(floor.at)) @ n
        above = heights.max(axis=1) > 0
        if (self._camera.eye - np.array(floor.at)) @ n <= 0 or not above.any():
            return
        fallen = shape.corners[above] - (heights[above] / (n @ self._light))[..., None] * self._light
        places, far = self._camera.project(fallen)
        found = rasterise(places, far, np.full(picture.shape[:2], np.inf))
        if found is not None:
            row, column, _, _ = found
            picture[row, column] *= 1 - SHADOW

    def _draw_ground(self) -> Array:
        """Draw the paper, with the grids of planes that fade with the distance."""
        camera = self._camera
        paper = np.broadcast_to(PAPER, (camera.height, camera.width, 3)).copy()
        x = (np.arange(camera.width) + 0.5 - camera.width / 2) / camera.scale
        y = (camera.height / 2 - np.arange(camera.height) - 0.5) / camera.scale
        rays = x[None, :, None] * camera.right + y[:, None, None] * camera.above - camera.back
        for plane in self._film.planes:
            self._draw_grid(paper, rays, plane)
        return paper

    def _draw_grid(self, paper: Array, rays: Array, plane: Plane) -> None:
        film, camera = self._film, self._camera
        n, at = np.array(plane.normal), np.array(plane.at)
        slope = rays @ n
        t = np.where(np.abs(slope) > 1e-9, ((at - camera.eye) @ n) / np.where(slope == 0, 1, slope), -1.0)
        points = camera.eye + t[..., None] * rays
        middle = (np.array(film.low) + np.array(film.high)) / 2
        spread = 1 + 0.5 * len(film.actors) if film.is_apart else 1.0
        reach = (1.4 if plane.grid else 0.8) * spread * film.size
        fade = 1 - np.clip((np.linalg.norm(points - middle, axis=2) / reach - 0.35) / 0.65, 0, 1)
        step = 10.0 ** np.round(np.log10(film.size / 6))
        axes = point_along(n)
        shown = np.zeros(paper.shape[:2])
        for axis in (axes[:, 0], axes[:, 1]):
            place = ((points - at) @ axis) / step
            off = np.abs(place - np.round(place)) * step
            width = np.maximum(np.hypot(*np.gradient((points - at) @ axis)), 1e-12) * 0.6 * SAMPLES
            shown = np.maximum(shown, np.clip(1.5 - off / width, 0, 1))
        share = (np.where(t > 0, fade, 0.0) * shown * 0.9)[..., None]
        paper += share * (FAINT - paper)


@dataclass(frozen=True, eq=False)
class _Poses:
    """The frames of an actor in one picture; -1 is the base."""

    track: Track
    k: int
    shift: Array

    def origin(self, frame: int) -> Array:
        return self.shift if frame < 0 else self.track.p[self.k, frame] + self.shift

    def turn(self, frame: int) -> Array:
        return np.eye(3) if frame < 0 else self.track.R[self.k, frame]

    def point(self, frame: int, at: tuple[float, float, float]) -> Array:
        return np.asarray(self.origin(frame) + self.turn(frame) @ np.array(at))


def rasterise(
    places: Array, far: Array, depth: Array
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], Array] | None:
    """Find the pixels in which triangles are nearer than `depth`, and lower it there.

    `places` (T, 3, 2) are pixels, `far` (T, 3) distances. Returns row, column, triangle and barycentric coordinates in
    space (n, 3) of each pixel; None where nothing is seen.
    """
    height, width = depth.shape
    triangle, row, column = _list_pixels(places, far, width, height)
    if not len(triangle):
        return None
    planes = _find_planes(places, far)
    inverse = planes[triangle, 0] * column + planes[triangle, 1] * row + planes[triangle, 2]
    distance, pixel, flat = 1 / np.maximum(inverse, 1e-30), row * width + column, depth.reshape(-1)
    np.minimum.at(flat, pixel, distance)
    seen = np.flatnonzero(distance <= flat[pixel])
    slots = np.full(flat.size, -1)
    slots[pixel[seen]] = seen
    seen = slots[slots >= 0]
    if not len(seen):
        return None
    triangle, row, column = triangle[seen], row[seen], column[seen]
    return row, column, triangle, _find_weights(places[triangle], far[triangle], column, row)


def _list_pixels(
    places: Array, far: Array, width: int, height: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """List the pixels whose centres lie in triangles, row by row: triangle, row, column."""
    y = places[..., 1] - 0.5
    low = np.clip(np.ceil(y.min(axis=1)), 0, height).astype(np.int64)
    high = np.clip(np.floor(y.max(axis=1)), -1, height - 1).astype(np.int64)
    kept = np.flatnonzero((high >= low) & (far > 1e-6).all(axis=1) & (np.abs(_find_areas(places)) > 1e-9))
    triangle, row = _expand(kept, low[kept], high[kept] - low[kept] + 1)
    left, right = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    for k in range(3):  # each side that a row crosses bounds its span
        a, b = places[triangle, k] - 0.5, places[triangle, (k + 1) % 3] - 0.5
        rise = b[:, 1] - a[:, 1]
        share = (row - a[:, 1]) / np.where(rise == 0, 1.0, rise)
        crossed = (rise != 0) & (share >= -1e-12) & (share <= 1 + 1e-12)
        x = a[:, 0] + share * (b[:, 0] - a[:, 0])
        left = np.where(crossed, np.minimum(left, x), left)
        right = np.where(crossed, np.maximum(right, x), right)
    first = np.ceil(np.clip(left, 0, width)).astype(np.int64)
    last = np.floor(np.clip(right, -1, width - 1)).astype(np.int64)
    spans = np.flatnonzero(last >= first)
    index, column = _expand(spans, first[spans], (last - first + 1)[spans])
    return triangle[index], row[index], column


def _expand(items: NDArray[np.int64], starts: NDArray[np.int64], counts: NDArray[np.int64]) -> tuple[Any, Any]:
    """Repeat each item, and count up from its start beside it."""
    ends = np.cumsum(counts)
    steps = np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - counts, counts)
    return np.repeat(items, counts), np.repeat(starts, counts) + steps


def _find_areas(places: Array) -> Array:
    e, f = places[:, 1] - places[:, 0], places[:, 2] - places[:, 0]
    return np.asarray(e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0])


def _find_planes(places: Array, far: Array) -> Array:
    """Return 1/distance of each triangle as a function of column and row: its two slopes, and its value at 0, 0."""
    e, f = places[:, 1] - places[:, 0], places[:, 2] - places[:, 0]
    area = _find_areas(places)
    area = np.where(np.abs(area) > 1e-9, area, 1.0)
    inverse = 1 / np.maximum(far, 1e-6)
    g, h = inverse[:, 1] - inverse[:, 0], inverse[:, 2] - inverse[:, 0]
    x = (g * f[:, 1] - h * e[:, 1]) / area
    y = (h * e[:, 0] - g * f[:, 0]) / area
    start = inverse[:, 0] + x * (0.5 - places[:, 0, 0]) + y * (0.5 - places[:, 0, 1])
    return np.stack((x, y, start), axis=1)


def _find_weights(places: Array, far: Array, column: NDArray[np.int64], row: NDArray[np.int64]) -> Array:
    """Return barycentric coordinates in space of pixels in their triangles."""
    e, f = places[:, 1] - places[:, 0], places[:, 2] - places[:, 0]
    area, u, v = _find_areas(places), column + 0.5 - places[:, 0, 0], row + 0.5 - places[:, 0, 1]
    b, c = (u * f[:, 1] - v * f[:, 0]) / area, (e[:, 0] * v - e[:, 1] * u) / area
    near = np.clip(np.stack((1 - b - c, b, c), axis=1), 0, 1) / far
    return np.asarray(near / near.sum(axis=1, keepdims=True))


def _coil(a: Array, b: Array, radius: float) -> Array:
    """Return a helix between two points, with straight ends."""
    length = float(np.linalg.norm(b - a))
    if length < 1e-12:
        return np.stack((a, b))
    axes = point_along((b - a) / length)
    t = np.linspace(0, 1, 127)
    r, w = radius * np.minimum(1, np.minimum(8 * t, 8 * (1 - t))), 2 * np.pi * 9 * t
    middle = a + (0.12 + 0.76 * t)[:, None] * (b - a)
    helix = middle + (r * np.cos(w))[:, None] * axes[:, 0] + (r * np.sin(w))[:, None] * axes[:, 1]
    return np.concatenate((a[None], helix, b[None]))


def _color(shape: Shape, color: str, *, lit: bool = True) -> Paint:
    return Paint(shape, np.broadcast_to(read_color(color), (len(shape.corners), 3)), lit)


def read_color(color: str) -> Array:
    """Return red, green and blue of a colour "#rrggbb", from 0 to 1."""
    return np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255


def _pale(color: str) -> str:
    mixed = np.rint(255 * (0.35 * read_color(color) + 0.65 * PAPER)).astype(int)
    return "#" + "".join(f"{x:02x}" for x in mixed)


def _write_texts(image: Image.Image, film: Film, k: int) -> None:
    """Write the title, the time, and the names of several actors."""
    pen = ImageDraw.Draw(image)
    large, small = (_font(max(10, round(image.height * share))) for share in (0.036, 0.028))
    margin = round(0.02 * image.height) + 4
    ink = tuple(int(255 * x) for x in INK)
    pen.text((margin, margin), film.title[:80], fill=ink, font=large)
    parts = [name for name, start in film.parts if start <= film.times[k] + 1e-9]
    label = f"{parts[-1]}   " if parts else ""
    pen.text((image.width - margin, margin), f"{label}{film.times[k]:.2f} s", fill=ink, font=small, anchor="ra")
    if len(film.actors) > 1 and not film.is_sequence:
        for i, actor in enumerate(film.actors):
            y = round(1.9 * margin + image.height * (0.036 + 0.04 * i))
            r = round(0.011 * image.height)
            pen.ellipse((margin, y, margin + 2 * r, y + 2 * r), fill=actor.color)
            pen.text((margin + 3 * r, y + r), actor.name[:60], fill=ink, font=small, anchor="lm")


def _font(size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), size)
