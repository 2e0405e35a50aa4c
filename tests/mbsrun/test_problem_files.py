"""The shipped problem files: each is solved with generated kernels, and its optimum agrees with known values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from mbsgen.manifest import Manifest
from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.problem import Problem, Representation
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem

MODELS = Path(__file__).parents[2] / "models"


@pytest.fixture
def read(requires: Callable[[str], str]) -> Callable[[str], tuple[Problem, Plant]]:
    requires("cc")
    return lambda name: read_problem(MODELS / f"{name}.ocp.yaml", load_on_demand)


def optimum(problem: Problem, plant: Plant) -> Solution:
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution)
    return outcome


def test_swing_up(read: Callable[[str], tuple[Problem, Plant]]) -> None:
    """The published optimum, 58.88 to 1e-3 (Dymos, its test of Kelly's problem): the grid of inputs alone is between.

    Its error falls with 1/N^2, and is extrapolated from N = 40 and 80; 58.8077 is what Radau of degree 5 found on 80
    intervals with inputs that are polynomials.
    """
    problem, plant = read("cart_pole_swing_up")
    coarse, fine = (optimum(replace(problem, intervals=N), plant).cost.total for N in (40, 80))
    assert (4 * fine - coarse) / 3 == pytest.approx(58.8076674583, rel=1e-5)
    assert (4 * fine - coarse) / 3 == pytest.approx(58.8839489745, rel=2e-3)


NAMES = ["cart_pole_balance", "planar_arm_reach", "planar_arm_fastest", "cart_pole_swing_up", "leg_step"]


@pytest.mark.parametrize("name", NAMES)
def test_all_representations_have_one_optimum(read: Callable[[str], tuple[Problem, Plant]], name: str) -> None:
    """The equations are the same, however they are written."""
    problem, plant = read(name)
    costs = [optimum(replace(problem, representation=r), plant).cost.total for r in Representation]
    assert costs == pytest.approx([costs[0]] * len(costs), rel=1e-5)


@pytest.mark.parametrize("name", ["six_axis_reach", "leg_step"])
def test_another_method_integrates_the_same_motion(read: Callable[[str], tuple[Problem, Plant]], name: str) -> None:
    """Re-simulated under the inputs alone, a solution ends where it says, to the accuracy that its file asks for."""
    problem, plant = read(name)
    solution = resimulate(optimum(problem, plant), plant)
    assert solution.resimulation is not None
    assert solution.resimulation.is_accurate


def test_a_post_is_passed_by(read: Callable[[str], tuple[Problem, Plant]]) -> None:
    """The hand touches the circle about the post and never enters it."""
    problem, plant = read("planar_arm_reach")
    constants = dict(problem.constants)
    trajectory = optimum(problem, plant).trajectory
    hand = plant("sensors", q=trajectory.point_q.reshape(-1, 2))["position"][:, :2, 0]
    distance = np.hypot(*(hand - [constants["x_post"], constants["y_post"]]).T)
    assert distance.min() == pytest.approx(constants["clearance"], abs=1e-6)


def test_the_fastest_reach_is_at_its_limits(read: Callable[[str], tuple[Problem, Plant]]) -> None:
    """Minimum time of a two-link arm: at almost all times some motor gives all it can."""
    problem, plant = read("planar_arm_fastest")
    solution = resimulate(optimum(problem, plant), plant)
    trajectory = solution.trajectory
    assert solution.resimulation is not None
    assert solution.resimulation.is_accurate
    limits = np.array(problem.bounds.u)[:, 1]
    saturated = (np.abs(trajectory.u) > limits - 1e-3).any(axis=1)
    assert saturated.mean() > 0.9
    assert trajectory.t[-1] < problem.horizon


def test_the_page_on_problem_files_opens_with_one(requires: Callable[[str], str], tmp_path: Path) -> None:
    """Its first example is whole, and is solved."""
    requires("cc")
    page = (MODELS.parent / "docs" / "problem.md").read_text("utf-8")
    (tmp_path / "page.ocp.yaml").write_text(page.split("```yaml\n")[1].split("```")[0], "utf-8")
    problem, plant = read_problem(tmp_path / "page.ocp.yaml", lambda path: load_on_demand(MODELS / path.name))
    assert optimum(problem, plant).cost.total == pytest.approx(58.8, rel=0.01)


@dataclass(frozen=True)
class Elsewhere:
    """The kernels of a plant, without the face that C functions need."""

    plant: Plant

    @property
    def manifest(self) -> Manifest:
        return self.plant.manifest

    @property
    def parameters(self) -> Mapping[str, float]:
        return self.plant.parameters

    def __call__(self, name: str, **inputs: Any) -> dict[str, Any]:
        return self.plant(name, **inputs)


@pytest.mark.parametrize("name", ["cart_pole_balance", "five_bar_reach", "satellite_turn", "planar_arm_fastest"])
def test_two_integrators_see_the_same_defects(read: Callable[[str], tuple[Problem, Plant]], name: str) -> None:
    """Steps in C, by intervals, and SciPy's, of all at once: a tree, a loop, quaternions, a free horizon.

    Both keep 1e-13 a step, of numbers up to 10, in some ten steps an interval. Over the horizon an unstable plant
    multiplies errors as it does the defect.
    """
    problem, plant = read(name)
    solution = optimum(problem, plant)
    one = resimulate(solution, plant).resimulation
    other = resimulate(solution, cast("Plant", Elsewhere(plant))).resimulation
    assert one is not None
    assert other is not None
    assert one.defects == pytest.approx(other.defects, abs=1e-11)
    assert one.defect is not None
    assert one.open_loop_error == pytest.approx(other.open_loop_error, rel=1e-4, abs=1e-11)
    assert one.margins is not None
    assert other.margins is not None
    pairs = zip(one.margins.each, other.margins.each, strict=True)
    assert all(a.value == pytest.approx(b.value, abs=1e-9) for a, b in pairs)
    assert (one.closure is None) is (other.closure is None)


def test_a_motion_that_c_cannot_follow_has_no_accuracy(read: Callable[[str], tuple[Problem, Plant]]) -> None:
    """Inputs that are no numbers, or overflow: neither integrator ends, and no number is given."""
    problem, plant = read("cart_pole_balance")
    solution = optimum(problem, plant)
    for value in (np.nan, 1e200):
        u, points = (np.full_like(x, value) for x in (solution.trajectory.u, solution.trajectory.point_u))
        broken = replace(solution, trajectory=replace(solution.trajectory, u=u, point_u=points))
        check = resimulate(broken, plant).resimulation
        assert check is not None
        assert check.defect is None
        assert check.open_loop_error is None
        assert not check.is_accurate
