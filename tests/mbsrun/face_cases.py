"""Models and states for tests of the faces of libraries of arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mbsrun import Mechanism, load
from mbsrun.models import Extent

MODELS = Path(__file__).parents[2] / "models"
# A tree, a tree with differentiated and run-time parameters, a quaternion, and a closed loop.
CASES = {"cart_pole": "exp1", "design/lifting_arm": "exp1", "satellite": "impl", "four_bar": "exp1"}


def load_case(model: str) -> tuple[Mechanism, str]:
    """Load a function of a case, and return its name, too."""
    name = CASES[model]
    return load(MODELS / f"{model}.yaml", extent=Extent((name,))), name


def draw(kernels: Mechanism, name: str, seed: int, *batch: int) -> dict[str, np.ndarray]:
    """Draw a state away from poses at which joints or loops are singular."""
    rng = np.random.default_rng(seed)
    inputs = [a for a in kernels.describe(name).inputs if a.nnz and a.name != "h"]
    return {a.name: 0.6 + 0.2 * rng.standard_normal((*batch, a.rows)) for a in inputs}
