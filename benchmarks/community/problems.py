"""The community's motions: of the mechanisms in `benchmarks.loops`, of trees, and of a slider-crank.

`tests/reference/motions.json` holds starts and ends, each computed by two methods: `python -m tests.motion_references`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.loops import problems as loops
from benchmarks.loops.mechanism import release
from benchmarks.loops.problems import REFERENCES, Problem
from mbsgen.pipeline import read_tree

MODELS = Path(__file__).parents[1] / "models" / "motions"
TITLES = {
    "pendulum": "A01: pendulum, 10 s",
    "four_bars": "A02: two four-bars, 10 s",
    "andrews": "A03: Andrews' mechanism, 0.05 s",
    "bricard": "A04: Bricard's mechanism, 10 s",
    "flyball": "A05: flyball governor, stiff, 10 s",
    "slider_crank": "Slider-crank, 0.1 s",
    "heavy_top": "Heavy top, 1 s",
    "free_top": "Free top, 20 s",
    "chain2": "2 rods, 3 s",
    "chain8": "8 rods, 1.5 s",
}


def read_certificates() -> Mapping[str, Any]:
    """Return start, end, methods and agreement of each motion, by name."""
    content: Mapping[str, Any] = json.loads((REFERENCES / "motions.json").read_text("utf-8"))
    return content


def make_problem(name: str) -> Problem:
    """Return a motion whose coordinates are the same for all programs."""
    certificate, path = read_certificates()[name], MODELS / f"{name}.yaml"
    start, end = (np.array([float(x) for x in certificate[key]]) for key in ("start", "end"))
    q, qd = np.split(start, 2)
    tree = release(read_tree(path))
    is_redundant = bool(tree.loops)  # hinges in a plane, where a program has 3-D joints alone
    span = float(certificate["span"])
    return Problem(name, TITLES[name], span, tree, q, qd, end, is_redundant=is_redundant, file=path)


PROBLEMS: Mapping[str, Callable[[], Problem]] = {
    name: loops.PROBLEMS.get(name) or partial(make_problem, name) for name in TITLES
}
