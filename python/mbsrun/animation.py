"""A motion that plays in a browser: times and coordinates -> one HTML file that needs no network and no other file.

The page is `templates/html/animation.html` with the script beside it; the motion goes into it as JSON, the poses in
base64: 20 bytes a frame and picture. Names come from untrusted files: no character of them can end the block that they
stand in, the script only ever shows them as text, and the page's policy admits that script and nothing else.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicHermiteSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from mbsgen import resources
from mbsrun.ocp.plant import Plant
from mbsrun.skeleton import Skeleton, place

Array = NDArray[np.float64]

RATE = 25.0  # pictures a second; the page interpolates
MAX_PICTURES = 1500
FAR = 1e12  # m; points farther away are shown there
_ESCAPES = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}


@dataclass(frozen=True)
class Marker:
    """A point to show, such as a target; in the base frame, m."""

    name: str
    position: tuple[float, float, float]


def write_animation(
    path: str | Path,
    kernels: Plant,
    times: ArrayLike,
    q: ArrayLike,
    *,
    qd: ArrayLike | None = None,
    title: str | None = None,
    markers: Sequence[Marker] = (),
) -> None:
    """Write the page that plays the motion q (K, n) at `times` (K,), which increase.

    Between them q is taken to be linear, or cubic where its rates qd (K, n) are given. The title is the model's name
    unless another is given. The same motion gives the same bytes. Raises ValueError for arrays that do not fit.
    """
    Path(path).write_text(render_animation(kernels, times, q, qd=qd, title=title, markers=markers), encoding="utf-8")


def render_animation(
    kernels: Plant,
    times: ArrayLike,
    q: ArrayLike,
    *,
    qd: ArrayLike | None = None,
    title: str | None = None,
    markers: Sequence[Marker] = (),
) -> str:
    """Return the text of the page; see `write_animation`."""
    rates = None if qd is None else np.asarray(qd, dtype=np.float64)
    part = Part(kernels, np.asarray(times, dtype=np.float64), np.asarray(q, dtype=np.float64), rates)
    return render_parts([part], kernels.manifest.model if title is None else title, markers)


@dataclass(frozen=True)
class Part:
    """A part of a motion: times (K,), coordinates (K, n), and their rates."""

    kernels: Plant
    t: Array
    q: Array
    rates: Array | None = None

    def __post_init__(self) -> None:
        t, q, n = self.t, self.q, len(self.kernels.manifest.positions)
        if t.ndim != 1 or not t.size or q.shape != (t.size, n) or (np.diff(t) <= 0).any():
            raise ValueError(f"times of shape {t.shape} must increase, and q of shape {q.shape} have {n} columns")
        if self.rates is not None and self.rates.shape != q.shape:
            raise ValueError(f"qd has shape {self.rates.shape}, q {q.shape}")


def render_parts(parts: Sequence[Part], title: str, markers: Sequence[Marker] = ()) -> str:
    """Return the text of a page that plays parts of a motion one after the other; their frames have the same names."""
    start, ends = float(parts[0].t[0]), [float(part.t[-1]) for part in parts]
    grid = choose_times(start, ends[-1])
    which = np.minimum(np.searchsorted(ends, grid), len(parts) - 1)
    skeletons = [
        place(part.kernels, _interpolate(part.t, part.q, part.rates, grid[which == i])) for i, part in enumerate(parts)
    ]
    skeleton = skeletons[0]
    p, R = (np.concatenate([getattr(each, name) for each in skeletons]) for name in ("p", "R"))
    motion = {
        "title": title,
        "start": start,
        "end": ends[-1],
        "times": len(grid),
        "frames": _describe_frames(skeleton),
        "links": [{"ends": [x.first, x.second], "rod": x.is_rod} for x in skeleton.links],
        "markers": [{"name": m.name, "at": [float(x) for x in m.position]} for m in markers],
        "places": _encode(np.clip(p.swapaxes(1, 2), -FAR, FAR), "<f4"),
        "turns": _encode(_quaternions(R), "<i2"),
    }
    return _fill_page(json.dumps(motion, ensure_ascii=False, allow_nan=False).translate(_ESCAPES))


def choose_times(start: float, end: float) -> Array:
    """Choose the times of the pictures: RATE of them a second, both ends, at most MAX_PICTURES."""
    count = min(int(np.ceil((end - start) * RATE)) + 1, MAX_PICTURES)
    return np.linspace(start, end, count)


def _interpolate(t: Array, q: Array, qd: Array | None, grid: Array) -> Array:
    if len(t) == 1:
        return q
    spline = make_interp_spline(t, q, k=1) if qd is None else CubicHermiteSpline(t, q, qd)
    return np.asarray(spline(grid))


def _describe_frames(skeleton: Skeleton) -> list[dict[str, object]]:
    return [
        {"name": frame.name, "parent": frame.parent, "sensor": frame.sensor, "slide": frame.slides}
        for frame in skeleton.frames
    ]


def _quaternions(R: Array) -> Array:
    """Turn rotations (K, 3, 3 F) into quaternions x, y, z, w (K, F, 4), scaled to the range of 16 bits."""
    matrices = R.reshape(len(R), 3, -1, 3).transpose(0, 2, 1, 3)
    quaternions = Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_quat(canonical=True)
    return np.asarray(np.rint(quaternions * 32767).reshape(len(R), -1, 4))


def _encode(values: Array, number: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values).astype(number).tobytes()).decode("ascii")


def _fill_page(motion: str) -> str:
    folder = resources.folder("templates") / "html"
    script = (folder / "animation.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    page = (folder / "animation.html").read_text(encoding="utf-8")
    page = page.replace("@SCRIPT_HASH@", f"sha256-{digest}").replace("@SCRIPT@", script)
    return page.replace("@MOTION@", motion)  # last: its text may contain the other marks
