"""Animations: motions -> a film -> a page that plays it, or a file of pictures.

render_animation(kernels, times, q)          a page of one motion
render_parts(parts, title)                   parts that follow each other, such as phases
write_page(make_film(motions, wanted))       several motions at the same time
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsrun.animation.film import Film, Marker
from mbsrun.animation.motions import MAX_PICTURES, RATE, Motion, Part, Wanted, choose_times, make_film
from mbsrun.animation.page import write_page
from mbsrun.ocp.ground.plant import Plant

__all__ = [
    "MAX_PICTURES",
    "RATE",
    "Film",
    "Marker",
    "Motion",
    "Part",
    "Wanted",
    "choose_times",
    "make_film",
    "render_animation",
    "render_parts",
    "write_animation",
    "write_page",
]


def write_animation(
    path: str | Path,
    kernels: Plant,
    times: ArrayLike,
    q: ArrayLike,
    *,
    qd: ArrayLike | None = None,
    inputs: ArrayLike | None = None,
    title: str | None = None,
    markers: Sequence[Marker] = (),
) -> None:
    """Write the page that plays the motion q (K, n) at `times` (K,), which increase.

    Between them q is taken to be linear, or cubic where its rates qd (K, n) are given. Inputs, and after them entries
    of open wrenches, (K, m), are drawn as arrows. The title is the model's name unless another is given. The same
    motion gives the same bytes. Raises ValueError for arrays that do not fit.
    """
    text = render_animation(kernels, times, q, qd=qd, inputs=inputs, title=title, markers=markers)
    Path(path).write_text(text, encoding="utf-8")


def render_animation(
    kernels: Plant,
    times: ArrayLike,
    q: ArrayLike,
    *,
    qd: ArrayLike | None = None,
    inputs: ArrayLike | None = None,
    title: str | None = None,
    markers: Sequence[Marker] = (),
) -> str:
    """Return the text of the page; see `write_animation`."""
    rates, given = (None if x is None else _array(x) for x in (qd, inputs))
    m = len(kernels.manifest.actuated)
    u, w = (None, None) if given is None else (given[:, :m], given[:, m:])
    part = Part(kernels, _array(times), _array(q), rates, u=u, w=w)
    return render_parts([part], kernels.manifest.model if title is None else title, markers)


def render_parts(parts: Sequence[Part], title: str, markers: Sequence[Marker] = ()) -> str:
    """Return the text of a page that plays parts of a motion one after the other; their mechanisms may differ."""
    frames = [tuple(frame.name for frame in part.kernels.manifest.frames) for part in parts]
    begins = [k for k in range(len(parts)) if k == 0 or frames[k] != frames[k - 1]]
    motions = [Motion(tuple(parts[a:b])) for a, b in zip(begins, [*begins[1:], len(parts)], strict=True)]
    return write_page(make_film(motions, Wanted(title, tuple(markers), is_sequence=True)))


def _array(values: ArrayLike) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)
