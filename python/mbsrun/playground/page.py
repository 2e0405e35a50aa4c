"""The page: `templates/html/playground.html` with its scripts, the compiled mechanism, and its picture as data.

Names come from untrusted files: no character of them can end the block that they stand in, the scripts only ever show
them as text, and the page's policy admits these scripts, WebAssembly and nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbsrun.animation.page import fill_page
from mbsrun.external import Mechanism
from mbsrun.playground.machine import describe_machine
from mbsrun.playground.scene import describe_picture

SCRIPTS = ("renderer.js", "kernels.js", "playground.js")


def write_playground(path: Path, kernels: Mechanism, controllers: Sequence[Mapping[str, Any]] = ()) -> None:
    """Write the page of a mechanism, with controllers of `machine`. The same mechanism gives the same bytes.

    Raises PlaygroundError for missing functions, CompileError where ziglang is not installed.
    """
    path.write_text(render_playground(kernels, controllers), encoding="utf-8")


def render_playground(kernels: Mechanism, controllers: Sequence[Mapping[str, Any]] = ()) -> str:
    """Return the text of the page; see `write_playground`."""
    machine = describe_machine(kernels)
    lower, upper = (np.array([x[side] for x in machine["positions"]]) for side in ("lower", "upper"))
    picture = describe_picture(kernels, np.array(machine["start"]), lower, upper)
    return fill_page("playground.html", SCRIPTS, {"machine": machine, "controllers": list(controllers), **picture})
