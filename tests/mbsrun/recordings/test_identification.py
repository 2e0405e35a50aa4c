"""A pendulum's inertia and friction from a recorded swing, against nonlinear least squares on its ODE."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mbsrun.external import load_on_demand
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.recordings import read_recording
from tests.recordings_made import ANGLE_NOISE, FOLDER, FRICTION, INERTIA, NOISE, place_markers, swing, swing_pendulum

Array = NDArray[np.float64]


def test_inertia_and_friction_of_a_recorded_swing() -> None:
    """The estimate is the least-squares solution of the ODE, and as near to the truth as its covariance lets expect.

    The splines' noise between samples differs a little from the noise at samples, hence half a standard deviation
    between both estimates. From another guess the same optimum is found.
    """
    problem, plant = read_problem(FOLDER / "pendulum_inertia.ocp.yaml", load_on_demand)
    found = solve(problem, plant)
    assert isinstance(found, Solution)
    assert [x.name for x in problem.unknowns] == ["inertia", "friction"]
    estimate = found.trajectory.unknowns
    recording = read_recording(FOLDER / "pendulum.csv")
    angles, sigma = recording.column("angle"), np.radians(ANGLE_NOISE)

    def residual(x: Array) -> Array:
        return np.asarray((swing_pendulum(recording.times, x[0], x[1], (x[2], x[3])) - angles) / sigma)

    start = np.array([0.02, 0.01, angles[0], 0.0])
    best = least_squares(residual, start, x_scale=[0.01, 0.01, 1, 1], xtol=1e-12)
    jacobian = np.asarray(best.jac)
    deviations = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))[:2]

    assert (np.abs(estimate - best.x[:2]) < 0.5 * deviations).all()
    assert (np.abs(estimate - (INERTIA, FRICTION)) < 3 * deviations).all()
    assert (deviations < 0.02 * estimate).all()
    assert found.cost.total / 4 == pytest.approx(sigma**2, rel=0.15)
    far = replace(problem, unknowns=tuple(replace(x, guess=5 * x.guess) for x in problem.unknowns))
    again = solve(far, plant)
    assert isinstance(again, Solution)
    assert again.trajectory.unknowns == pytest.approx(estimate, rel=1e-5)


def test_recorded_markers_are_followed() -> None:
    """The motion is nearer to the true one than the noise of the markers."""
    problem, plant = read_problem(FOLDER / "arm_follow.ocp.yaml", load_on_demand)
    found = solve(problem, plant)
    assert isinstance(found, Solution)
    trajectory = found.trajectory
    places, true = place_markers(*trajectory.q.T), place_markers(*swing(trajectory.t))
    assert np.sqrt(np.mean(np.sum((places - true) ** 2, axis=2))) < NOISE
    assert [name for name, _ in found.cost.terms[2:]] == [f"track swing: {x}" for x in ("biceps", "elbow", "hand")]
