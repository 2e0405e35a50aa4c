"""A film that plays in a browser: one HTML file that needs no network and no other file.

The page is `templates/html/animation.html` with the scripts beside it: `renderer.js` draws, `animation.js` plays. The
film goes into it as JSON, poses in base64: 20 bytes a frame and picture. Names come from untrusted files: no character
of them can end the block that they stand in, the scripts only ever show them as text, and the page's policy admits
those scripts and nothing else.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen import resources
from mbsrun.animation.film import Actor, Arrow, Film, Mesh, Solid, Track
from mbsrun.quaternions import find_quaternions

Array = NDArray[np.float64]

SCRIPTS = ("renderer.js", "animation.js")
_ESCAPES = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}


def write_page(film: Film) -> str:
    """Return the text of the page that plays a film. The same film gives the same bytes."""
    content = {
        "title": film.title,
        "start": float(film.times[0]),
        "end": float(film.times[-1]),
        "times": len(film.times),
        "parts": [{"name": name, "start": start} for name, start in film.parts],
        "sequence": film.is_sequence,
        "options": {"apart": film.is_apart, "skeleton": not film.has_visuals},
        "scene": describe_scene(film),
        "courses": [_describe_track(track) for track in film.tracks],
    }
    return fill_page("animation.html", SCRIPTS, content)


def describe_scene(film: Film) -> dict[str, Any]:
    """Return the scene that `renderer.js` draws; numbers of meshes are in base64."""
    return {
        "up": film.up,
        "bounds": {"low": film.low, "high": film.high, "points": film.hull},
        "view": {"azimuth": film.view.azimuth, "elevation": film.view.elevation},
        "thickness": film.thickness,
        "planes": [{"at": x.at, "normal": x.normal, "grid": x.grid} for x in film.planes],
        "markers": [{"name": m.name, "at": [float(x) for x in m.position]} for m in film.markers],
        "meshes": [_describe_mesh(mesh) for mesh in film.meshes],
        "mechanisms": [_describe_actor(actor) for actor in film.actors],
    }


def _describe_mesh(mesh: Mesh) -> dict[str, str]:
    return {"vertices": _encode(mesh.vertices, "<f4"), "faces": _encode(mesh.faces, "<u4")}


def _describe_actor(actor: Actor) -> dict[str, Any]:
    return {
        "name": actor.name,
        "color": actor.color,
        "frames": [
            {"name": x.name, "parent": x.parent, "sensor": x.sensor, "slide": x.slides}
            | ({"edge": False} if i in actor.floating else {})
            for i, x in enumerate(actor.frames)
        ],
        "solids": [_describe_solid(solid) for solid in actor.solids],
        "lines": [{"kind": x.kind, "ends": [{"frame": e.frame, "at": e.at} for e in x.ends]} for x in actor.lines],
    }


def _describe_solid(solid: Solid) -> dict[str, Any]:
    described = {"layer": solid.layer, "frame": solid.frame, "kind": solid.kind, "size": solid.size}
    described |= {"at": solid.at, "axes": solid.axes, "color": solid.color}
    return described if solid.mesh is None else {**described, "mesh": solid.mesh}


def _describe_track(track: Track) -> dict[str, Any]:
    return {
        "places": _encode(track.p, "<f4"),
        "turns": _encode(_find_quaternions(track.R), "<i2"),
        "arrows": [_describe_arrow(arrow) for arrow in track.arrows],
        "shown": track.shown,
    }


def _describe_arrow(arrow: Arrow) -> dict[str, Any]:
    return {
        "kind": arrow.kind,
        "frame": arrow.foot.frame,
        "at": arrow.foot.at,
        "base": arrow.in_base,
        "scale": arrow.scale,
        "values": _encode(arrow.values, "<f4"),
    }


def _find_quaternions(R: Array) -> Array:
    """Turn rotations (K, F, 3, 3) into quaternions x, y, z, w (K, F, 4), scaled to the range of 16 bits."""
    return np.asarray(np.rint(find_quaternions(R) * 32767))


def _encode(values: NDArray[Any], number: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values).astype(number).tobytes()).decode("ascii")


def fill_page(template: str, scripts: Sequence[str], content: Mapping[str, Any]) -> str:
    """Return a page with its scripts and its content, as JSON; its policy admits these scripts and nothing else."""
    folder = resources.folder("templates") / "html"
    script = "".join((folder / name).read_text(encoding="utf-8") for name in scripts)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    page = (folder / template).read_text(encoding="utf-8")
    page = page.replace("@SCRIPT_HASH@", f"sha256-{digest}").replace("@SCRIPT@", script)
    data = json.dumps(content, ensure_ascii=False, allow_nan=False).translate(_ESCAPES)
    return page.replace("@CONTENT@", data)  # last: its text may contain the other marks
