"""A model's text -> everything that a page in a browser shows of it: the work of a worker that runs Python.

The answer is JSON: the mechanism with its WebAssembly, shapes for its picture, costs, equations; or the faults, as the
command line prints them. Nothing here needs NumPy or a compiler, so models with loops and constraints are refused.
"""

from __future__ import annotations

import json
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mbsgen.equations import FORMATS, Page, build_symbolic, derive, show_lines, show_motion, write_lines
from mbsgen.equations.sums import SizeError
from mbsgen.errors import InputError, MbsError
from mbsgen.machine import FUNCTIONS, OPTIONAL, describe_mechanism, select_kernels
from mbsgen.manifest import Manifest
from mbsgen.model.model import Model
from mbsgen.model.reader import read_model
from mbsgen.picture import describe_picture, list_meshes
from mbsgen.pipeline import make
from mbsgen.request import Options
from mbsgen.roles import Order

FILE = "model.yaml"
FORMULATIONS = ("impl", "semi", "exp1", "exp2")
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
    remarks += found.pop("remarks")
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
        "picture": describe_picture(manifest),
        "costs": [*_list_costs(manifest)],
        "remarks": [f"the mesh of {body} is not drawn: this page reads no files" for body in list_meshes(manifest)],
        "report": product.files["report.md"],
        "equations": FORMATS["html"](_write_equations(model)),
    }


def _list_costs(manifest: Manifest) -> Iterator[dict[str, Any]]:
    """Yield the flops and the equations of the four formulations, as they are generated."""
    for name in FORMULATIONS:
        kernel = manifest.find(name, Order.VALUE)
        assert kernel is not None, f"{name} was requested"
        yield {"name": name, "flops": kernel.flops.paper, "equations": kernel.equations}


def _write_equations(model: Model) -> Page:
    tree = build_symbolic(model)
    try:
        return show_motion(derive(tree, TERMS))
    except SizeError:
        return show_lines(write_lines(tree))
