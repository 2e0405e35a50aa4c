"""The problems whose optima are proved: published ones, and reaches of the paper's arm with both of its costs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path

from benchmarks.proofs.programs import read
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.problem import Problem, cylindrical

MODELS = Path(__file__).parents[2] / "models"
RADIUS = 0.63  # m, of the cylinder of the paper's targets
PLACES = {"centre": (0.0, 0.0), "lower_corner": (pi / 2, -0.1), "upper_corner": (pi / 2, 0.1)}  # azimuth, height
COSTS = {"plain": (1.0, 0.0), "smooth": (1.0, 1e5)}  # k1, k2


@dataclass(frozen=True)
class Case:
    """A problem file; for the arm, also the weights k1 and k2, and the azimuth [rad] and height [m] of the target."""

    path: Path
    weights: tuple[float, float] | None = None
    place: tuple[float, float] | None = None

    def read(self) -> tuple[Problem, Plant]:
        """Read the problem and its mechanism."""
        problem, plant = read(self.path)
        if self.weights is not None:
            problem = replace(problem, cost=replace(problem.cost, inputs=self.weights[0], input_rates=self.weights[1]))
        if self.place is not None:
            sensors = (("hand", cylindrical(RADIUS, *self.place)),)
            problem = replace(problem, end=replace(problem.end, sensors=sensors))
        return problem, plant


def list_cases() -> Mapping[str, Case]:
    """List all cases by name."""
    paths = sorted((MODELS / "classics").glob("*.ocp.yaml"))
    cases = {path.name.removesuffix(".ocp.yaml"): Case(path) for path in paths}
    arm = MODELS / "arm_reach.ocp.yaml"
    return cases | {
        f"arm_{place}_{cost}": Case(arm, weights, target)
        for place, target in PLACES.items()
        for cost, weights in COSTS.items()
    }
