"""Many points that are judged at once: the numbers of the judge of single points, for drawn programs and points."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.solving.optimality import judge, linearise
from mbsrun.ocp.solving.stacked import Limits, StackedJudge

Array = NDArray[np.float64]
ROWS = (  # of the Jacobian, by the variables that they read: two bound the same variable, one bounds another
    (0, 1, 2), (1,), (2, 3), (1,), (3,), (0, 4), (2, 4),
)  # fmt: skip
COUNT = 6


def draw(seed: int, *, is_scaled: bool) -> dict[str, Any]:
    """Draw points of a program of 5 variables and 7 rows whose cost has the gradient -J'y, to 1e-9."""
    rng = np.random.default_rng(seed)
    pattern = np.zeros((len(ROWS), 5))
    for row, read in enumerate(ROWS):
        pattern[row, list(read)] = 1
    matrix = sparse.csc_array(pattern)
    data = rng.uniform(0.5, 3, (COUNT, matrix.nnz)) * rng.choice([-1, 1], (COUNT, matrix.nnz))
    x = rng.normal(size=(COUNT, 5)) * rng.choice([0.3, 5.0], (COUNT, 5))
    J = np.zeros((COUNT, len(ROWS), 5))
    column = np.repeat(np.arange(5), np.diff(matrix.indptr))
    J[:, matrix.indices, column] = data
    g = (J @ x[..., None])[..., 0]
    scales = rng.choice([1.0, 20.0, 0.1], (COUNT, 5)) if is_scaled else np.ones((COUNT, 5))
    lower, upper = x - rng.uniform(0, 2, x.shape), x + rng.uniform(0, 2, x.shape)
    lower[rng.random(x.shape) < 0.2], upper[rng.random(x.shape) < 0.2] = -np.inf, np.inf
    lower[:, 4] = upper[:, 4] = x[:, 4] + np.where(rng.random(COUNT) < 0.5, 0.0, 1e-9)
    g_lower, g_upper = g - rng.uniform(0, 3, g.shape), g + rng.uniform(0, 3, g.shape)
    g_lower[:, 2] = g_upper[:, 2] = g[:, 2]
    g_lower[:, 5], g_upper[:, 6] = -np.inf, np.inf
    y = np.zeros(g.shape)
    y[:, 2] = rng.normal(size=COUNT)
    g_upper[:, 0], y[:, 0] = g[:, 0], rng.uniform(0, 1, COUNT)
    g_lower[:, 5], y[:, 5] = g[:, 5], -rng.uniform(0, 1, COUNT)
    noise = 1e-9 * rng.normal(size=x.shape)
    gradient = -np.einsum("kij,ki->kj", J, y) + noise
    beyond = 1e-9 * (rng.random(x.shape) < 0.3)
    return {
        "matrix": matrix, "x": x + beyond, "g": g, "data": data, "J": J, "gradient": gradient, "y": y,
        "lower": lower, "upper": upper, "g_lower": g_lower, "g_upper": g_upper, "scales": scales,
    }  # fmt: skip


def judge_all(drawn: dict[str, Any], tolerance: float, weights: Array) -> list[Any]:
    values: Any = SimpleNamespace(gradient=drawn["gradient"], rows=drawn["g"], slopes=drawn["data"])
    limits = Limits(*(drawn[name] for name in ("lower", "upper", "g_lower", "g_upper", "scales")))
    return StackedJudge(drawn["matrix"]).judge(drawn["x"], values, limits, drawn["y"], tolerance, weights)


def judge_one(drawn: dict[str, Any], k: int, tolerance: float, weight: float) -> Any:
    own = {name: x[k] for name, x in drawn.items() if name != "matrix"}
    J = sparse.csc_array((own["data"], drawn["matrix"].indices, drawn["matrix"].indptr), shape=drawn["matrix"].shape)
    point = linearise(
        own["x"], own["g"], own["gradient"], J, (own["lower"], own["upper"]), (own["g_lower"], own["g_upper"]),
        own["scales"],
    )  # fmt: skip
    return judge(point, tolerance, weight, own["y"])


@pytest.mark.parametrize("is_scaled", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_drawn_points_have_the_numbers_of_the_judge_of_single_points(seed: int, *, is_scaled: bool) -> None:
    """Where the bounds decide: the same decrease, allowance, reach and violation; else nothing is said."""
    drawn, weights = draw(seed, is_scaled=is_scaled), np.random.default_rng(seed).uniform(0.5, 2, COUNT)
    for tolerance in (1e-8, 1e-3):
        every = judge_all(drawn, tolerance, weights)
        assert any(found is not None for found in every)
        for k, found in enumerate(every):
            own = judge_one(drawn, k, tolerance, float(weights[k]))
            if found is not None:
                for name in ("decrease", "allowed", "reach", "violation", "allowed_violation"):
                    assert getattr(found, name) == pytest.approx(getattr(own, name), rel=1e-10, abs=1e-16), name
                assert (found.is_sure, found.is_optimal) == (own.is_sure, own.is_optimal)


def test_points_that_the_bounds_do_not_decide_are_left() -> None:
    """A cost that falls, numbers that are none, and a row of one variable that has lost its slope."""
    for change in ("gradient", "nan", "slope", ""):
        drawn = draw(1, is_scaled=False)
        if change == "gradient":
            drawn["gradient"][2] += 1.0
        elif change == "nan":
            drawn["y"][2, 0] = np.nan
        elif change == "slope":
            drawn["data"][2, drawn["matrix"].indices == 1] = 0.0
        found = judge_all(drawn, 1e-8, np.ones(COUNT))
        plain = judge_all(draw(1, is_scaled=False), 1e-8, np.ones(COUNT))
        assert [x is None for x in found] == [x is None or (k == 2 and bool(change)) for k, x in enumerate(plain)]
        assert plain[2] is not None


def test_a_gradient_that_vanishes_is_judged_by_the_tolerance() -> None:
    """Below the tolerance times the weight, the size of each variable adds as much."""
    drawn = draw(2, is_scaled=False)
    drawn["y"][:] = 0.0
    for size in (0.5, 1.5):
        drawn["gradient"][:] = size * 1e-8
        weights = np.full(COUNT, 2.0)
        for k, found in enumerate(judge_all(drawn, 1e-8, weights)):
            own = judge_one(drawn, k, 1e-8, 2.0)
            assert found is None or found.allowed == pytest.approx(own.allowed, rel=1e-12)
