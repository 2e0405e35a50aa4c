"""Equations in intermediate values are the whole equations, part by part."""

from __future__ import annotations

import random

import numpy as np
import pytest

from mbsgen.equations import build_symbolic, derive, derive_stepwise
from mbsgen.pipeline import read
from tests.shipped import FOLDER

PARTS = ("M", "c", "g", "applied", "h", "J", "position")
MODELS = {  # model: what it has
    "satellite": "a quaternion",
    "compressor": "a loop, a driven joint and a force law",
    "slider_crank": "a loop, and an open wrench",
    "leg": "a joint that follows another one",
    "recorded/arm": "run-time parameters",
    "design/lifting_arm": "a spring",
    "contact/block": "contacts",
}


@pytest.mark.parametrize("name", MODELS)
def test_each_part_is_the_whole_equations(name: str) -> None:
    tree = build_symbolic(read(FOLDER / f"{name}.yaml"))
    found, whole, draw = derive_stepwise(tree), derive(tree), random.Random(3)
    naming = found.naming
    given = {"q": naming.q, "qd": naming.qd, "u": naming.u}
    values = {key: [draw.uniform(-0.7, 0.7) for _ in symbols] for key, symbols in given.items()}
    for key in ("w", "lam", "tau"):
        symbols = {x.name for part in PARTS for x in getattr(whole, part).free_symbols}
        size = max((k for k in range(1, 10) if f"{key}{k}" in symbols), default=0)
        values[key] = [draw.uniform(-1, 1) for _ in range(size)]
    for part in PARTS:
        mine, other = (motion.evaluate(getattr(motion, part), **values) for motion in (found, whole))
        np.testing.assert_allclose(mine, other, rtol=1e-11, atol=1e-11, err_msg=part)
