"""A model's text -> everything that a page in a browser shows of it: the work of a worker that runs Python.

The answer is JSON: the mechanism with its WebAssembly, shapes for its picture, flops, equations; or the faults, as the
command line prints them. Nothing here needs NumPy or a compiler, so models with loops and constraints are refused.
"""

from __future__ import annotations

import json
import math
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mbsgen.algebra.dense import find_eigen
from mbsgen.equations import FORMATS, Page, build_symbolic, derive, show_lines, show_motion, write_lines
from mbsgen.equations.sums import SizeError
from mbsgen.errors import InputError, MbsError
from mbsgen.machine import FUNCTIONS, OPTIONAL, describe_mechanism, select_kernels
from mbsgen.manifest import Manifest, Mass
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.pipeline import make
from mbsgen.request import Options
from mbsgen.style import PALETTE, mix

FILE = "model.yaml"
TERMS = 400  # of equations, beyond which they are written line by line
LOOPS = (
    f"{FILE}: this page shows trees alone, and the model has loops, constraints or driven joints; install the tool, "
    "and use `mbsrun playground`"
)


def answer(text: str) -> str:
    """Return what a page shows of the text of a model file, or its `faults`, as JSON."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(record=True) as heard:
        path = Path(folder) / FILE
        path.write_text(text, encoding="utf-8")
        try:
            found = _describe(path)
        except MbsError as error:
            return json.dumps({"faults": _shorten(error, folder)})
    remarks = [str(each.message).replace(f"{folder}/", "") for each in heard]
    return json.dumps({**found, "remarks": remarks}, allow_nan=False)


def _shorten(error: MbsError, folder: str) -> list[str]:
    """List the faults without the folder, which no user knows."""
    faults = error.faults if isinstance(error, InputError) else (error,)
    return [str(fault).replace(f"{folder}/", "") for fault in faults]


def _describe(path: Path) -> dict[str, Any]:
    try:
        model = read_model(path)
    except ImportError:  # its checks need NumPy
        raise MbsError(LOOPS) from None
    if model.loops or model.constraints or model.driven:
        raise MbsError(LOOPS)
    product = make(path, Options(functions=FUNCTIONS, optional=OPTIONAL, derivatives=0, targets=("wasm",)))
    manifest = product.manifest
    (module,) = product.packages.values()
    start = [0.0] * len(manifest.positions)
    for first in manifest.quaternions:
        start[first + 3] = 1.0
    values = {p.name: p.value for p in (*manifest.parameters, *manifest.design)}
    return {
        "machine": describe_mechanism(manifest, list(select_kernels(manifest)), module, start, values),
        "picture": _describe_picture(manifest),
        "report": product.files["report.md"],
        "equations": FORMATS["html"](_write_equations(model)),
    }


def _write_equations(model: Model) -> Page:
    tree = build_symbolic(model)
    try:
        return show_motion(derive(tree, TERMS))
    except SizeError:
        return show_lines(write_lines(tree))


# --- picture ---------------------------------------------------------------------------------------------------------


def _describe_picture(manifest: Manifest) -> dict[str, Any]:
    """Return the frames, the shapes in them, the vertical, and the ends that no frame marks; the page finds sizes."""
    appearance = manifest.appearance
    assert appearance is not None, "a generated manifest has an appearance"
    g = appearance.gravity
    length = math.hypot(*g)
    return {
        "frames": [
            {"name": x.name, "parent": x.parent, "sensor": x.sensor, "slide": x.slides} for x in manifest.frames
        ],
        "up": [-x / length + 0.0 for x in g] if length else [0.0, 0.0, 1.0],
        "ends": [{"frame": i, "at": x.com} for i, x in enumerate(manifest.frames) if x.com is not None],
        "solids": [*_list_solids(manifest)],
    }


def _list_solids(manifest: Manifest) -> Iterator[dict[str, Any]]:
    """List the ellipsoid of each mass; no mesh is read."""
    assert manifest.appearance is not None
    masses = manifest.appearance.masses
    colors: dict[int, str] = {}
    for mass in masses:
        color = colors.setdefault(mass.frame, mix(PALETTE[len(colors) % len(PALETTE)], "#ffffff", 0.18))
        yield {"layer": "solids", "frame": mass.frame, "kind": "ellipsoid", "color": color, **_fit_ellipsoid(mass)}


def _fit_ellipsoid(mass: Mass) -> dict[str, Any]:
    """Fit the homogeneous ellipsoid: of axes a, b, c it has moments such as m (b^2 + c^2) / 20."""
    xx, yy, zz, xy, xz, yz = mass.inertia
    moments, axes = find_eigen(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
    half = sum(moments) / 2
    size = [2 * math.sqrt(max(5 * (half - moment) / mass.mass, 0.0)) for moment in moments]
    return {"size": size, "at": mass.com, "axes": [x for axis in axes for x in axis]}
