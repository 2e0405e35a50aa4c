"""Inverse kinematics: against scipy on forward kinematics by hand, linear algebra, known motions, and optimality."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import null_space
from scipy.optimize import least_squares

from mbsrun import load
from mbsrun.external import Mechanism
from mbsrun.recordings import AXES, Recording, read_recording
from mbsrun.recordings.fitting import FITTED, Fitter, Targets, find_undetermined, second_differences, solve_step
from tests.recordings_made import FILES, FOLDER, MARKERS, place_markers, swing

Array = NDArray[np.float64]
MODELS = FOLDER.parent

FREE = """\
name: marked
gravity: [0, 0, 0]
bodies:
  - {name: hull, joint: {type: free}, mass: 2, inertia: [1, 2, 2.5]}
  - name: boom
    parent: hull
    joint: {name: hinge, type: revolute, axis: y, position: [0.2, 0, 0]}
    mass: 1
    inertia: [1, 1, 1]
frames:
  - {name: a, body: hull, position: [0.1, 0, 0.05]}
  - {name: b, body: hull, position: [-0.1, 0.2, 0]}
  - {name: c, body: hull, position: [0, -0.1, 0.1]}
  - {name: tip, body: boom, position: [0.4, 0, 0.1]}
"""

SLIDE = """\
name: slide
gravity: [0, 0, 0]
bodies: [{name: a, joint: {name: s, type: prismatic, axis: x, limits: [-5, 5]}, mass: 1}]
frames: [{name: m, body: a}]
"""


@pytest.fixture(scope="module")
def arm() -> Mechanism:
    return load(FOLDER / "arm.yaml", extent=FITTED)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return read_recording(FOLDER / "swing.trc")


def aim(recording: Recording, weights: tuple[float, ...] = (1, 1, 1), count: int | None = None) -> Targets:
    """Aim at the markers of the arm."""
    places = np.array([[recording.column(f"{axis}[{name}]") for axis in AXES] for name in MARKERS])
    markers = places.transpose(2, 0, 1)[:count]
    none = np.zeros((len(markers), 0))
    return Targets(recording.times[:count], (0, 1, 2), markers, np.array(weights), (), none, np.zeros(0))


def test_the_recordings_that_ship_are_made_by_their_script() -> None:
    for name, make in FILES.items():
        assert (FOLDER / name).read_text("utf-8") == make()


def test_each_frame_is_the_least_squares_solution(arm: Mechanism, recording: Recording) -> None:
    """scipy finds the same poses, with weights, limits and gaps, by finite differences of kinematics by hand."""
    targets = aim(recording, (1, 0.5, 2))
    fit = Fitter(arm, targets).fit()
    assert fit.converged.all()
    for k in range(0, 121, 5):
        seen = np.isfinite(targets.markers[k]).all(axis=1)
        root = np.sqrt(targets.marker_weights[seen])[:, None]

        def residual(q: Array, k: int = k, seen: Array = seen, root: Array = root) -> Array:
            return np.asarray((root * (place_markers(q[:1], q[1:])[0] - targets.markers[k])[seen]).ravel())

        start = np.array(swing(recording.times[k : k + 1])).ravel()
        found = least_squares(residual, start, bounds=([-1, 0], [2.5, 2.6]), xtol=1e-14, ftol=1e-14, gtol=1e-14)
        assert fit.q[k][~fit.is_undetermined[k]] == pytest.approx(found.x[~fit.is_undetermined[k]], abs=1e-6)
    hidden = ~np.isfinite(targets.markers[:, 2, 0])
    np.testing.assert_array_equal(fit.is_undetermined, np.stack((0 * hidden, hidden), axis=1))
    np.testing.assert_array_equal(np.isnan(fit.errors[:, 2]), hidden)
    assert np.abs(fit.q - np.array(swing(recording.times)).T)[~hidden].max() < 0.05


def test_limits_hold(arm: Mechanism, recording: Recording) -> None:
    """A hand above the reach of the elbow's limit: the limit is active, and the rest is the best with it."""
    targets = aim(recording, count=3)
    shoulder = np.full(3, 0.4)
    markers = place_markers(shoulder, np.full(3, -0.3))
    fit = Fitter(arm, Targets(targets.times, (0, 1, 2), markers, np.ones(3), (), np.zeros((3, 0)), np.zeros(0))).fit()
    assert fit.converged.all()
    assert fit.at_limits.tolist() == [[False, True]] * 3

    def residual(q: Array) -> Array:
        return np.asarray((place_markers(q, 0 * q)[0] - markers[0]).ravel())

    found = least_squares(residual, np.array([0.4]), xtol=1e-14, gtol=1e-14)
    assert fit.q[0] == pytest.approx([found.x[0], 0], abs=1e-7)


def test_a_recorded_coordinate_decides_what_markers_leave_open(arm: Mechanism, recording: Recording) -> None:
    targets = aim(recording)
    values = swing(recording.times)[1][:, None]
    whole = Targets(targets.times, (0,), targets.markers[:, :1], np.ones(1), (1,), values, np.ones(1))
    fit = Fitter(arm, whole).fit()
    assert not fit.is_undetermined.any()
    np.testing.assert_allclose(fit.q[:, 1], values[:, 0], atol=1e-9)
    np.testing.assert_allclose(fit.deviations, 0, atol=1e-9)


def test_a_free_body_is_found_from_any_pose(tmp_path: Path) -> None:
    """Exact markers give the motion back; attitudes keep their sign, and a boom without its marker is open."""
    path = tmp_path / "marked.yaml"
    path.write_text(FREE, "utf-8")
    kernels = load(path, extent=FITTED)
    names = kernels.manifest.positions
    K = 40
    t = np.linspace(0, 1, K)
    q = np.zeros((K, len(names)))
    angle = 3.5 * t + 2
    axis = np.array([2, -1, 2]) / 3
    first = kernels.manifest.quaternions[0]
    q[:, first : first + 4] = np.concatenate((np.sin(angle / 2)[:, None] * axis, np.cos(angle / 2)[:, None]), axis=1)
    for name, values in (("hull.x", 2 + t), ("hull.y", np.sin(t)), ("hull.z", -(t**2)), ("hinge", 0.4 * np.cos(3 * t))):
        q[:, names.index(name)] = values
    markers = kernels("sensors", q=q)["position"].transpose(0, 2, 1)
    markers[10:14, 3] = np.nan
    fit = Fitter(kernels, Targets(t, (0, 1, 2, 3), markers, np.ones(4), (), np.zeros((K, 0)), np.zeros(0))).fit()
    assert fit.converged.all()
    sign = np.sign((fit.q[0, first : first + 4] * q[0, first : first + 4]).sum())
    fit.q[:, first : first + 4] *= sign
    known = np.ones((K, len(names)), dtype=bool)
    known[10:14, names.index("hinge")] = False
    np.testing.assert_array_equal(fit.is_undetermined, ~known)
    np.testing.assert_allclose(fit.q[known], q[known], atol=1e-8)


def test_quaternions_keep_their_sign_from_frame_to_frame(tmp_path: Path, rng: np.random.Generator) -> None:
    """Two signs are one attitude: each frame has the one that is nearer to the frame before, and the first one stays.

    A recording's spline, and its derivatives, would otherwise pass through no attitude at all.
    """
    path = tmp_path / "marked.yaml"
    path.write_text(FREE, "utf-8")
    kernels = load(path, extent=FITTED)
    K, n, first = 60, len(kernels.manifest.positions), kernels.manifest.quaternions[0]
    angle = np.linspace(0, 9, K)
    smooth = rng.standard_normal((K, n))
    smooth[:, first : first + 4] = np.c_[np.sin(angle / 2), 0 * angle, 0.1 * np.sin(angle / 2), np.cos(angle / 2)]
    signs = np.where(rng.random(K) < 0.5, -1.0, 1.0)
    mixed = smooth.copy()
    mixed[:, first : first + 4] *= signs[:, None]
    none = np.zeros((K, 0))
    fitter = Fitter(kernels, Targets(np.arange(float(K)), (), np.zeros((K, 0, 3)), np.zeros(0), (), none, np.zeros(0)))
    found = fitter.settle_signs(mixed.copy())
    smooth[:, first : first + 4] *= signs[0]
    np.testing.assert_array_equal(found, smooth)


def test_closed_loops_stay_closed(rng: np.random.Generator) -> None:
    """At the optimum, the cost has no slope along motions that the loops permit."""
    kernels = load(MODELS / "five_bar.yaml", extent=FITTED)
    fitter = Fitter(
        kernels, Targets(np.arange(2.0), (), np.zeros((2, 0, 3)), np.zeros(0), (), np.zeros((2, 0)), np.zeros(0))
    )
    assert fitter.closure is not None
    pose = fitter.closure.close(np.array(kernels.manifest.pose))
    sensors = tuple(range(kernels("sensors", q=pose)["position"].shape[1]))
    place = kernels("sensors", q=pose)["position"].T
    markers = place + 0.02 * rng.standard_normal((5, *place.shape))
    none = np.zeros((5, 0))
    fit = Fitter(kernels, Targets(np.arange(5.0), sensors, markers, np.ones(len(sensors)), (), none, np.zeros(0))).fit()
    assert fit.converged.all()
    assert fitter.closure.measure(fit.q) < 1e-10
    for k, q in enumerate(fit.q):
        residual = (kernels("sensors", q=q)["position"].T - markers[k]).ravel()
        slope = residual @ kernels("jac_sensors", q=q)["jac_position_q"]
        assert np.abs(slope @ null_space(fitter.closure.jacobian(q))).max() < 1e-9


@pytest.mark.parametrize("smooth", [1e-3, 1e-5])
def test_smooth_motions_of_a_linear_mechanism_solve_linear_equations(tmp_path: Path, smooth: float) -> None:
    """For a slide the sum is quadratic: (W + S D^T D) q = W x, through a gap as well, at uneven times."""
    path = tmp_path / "slide.yaml"
    path.write_text(
        SLIDE,
        "utf-8",
    )
    kernels = load(path, extent=FITTED)
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.02, 0.1, 30))
    x = np.sin(2 * t) + 0.05 * rng.standard_normal(30)
    markers = np.zeros((30, 1, 3))
    markers[:, 0, 0] = x
    markers[12:17] = np.nan
    fit = Fitter(kernels, Targets(t, (0,), markers, np.array([2.0]), (), np.zeros((30, 0)), np.zeros(0))).fit(smooth)
    D = second_differences(t).toarray()
    known = np.isfinite(markers[:, 0, 0])
    W = 2.0 * np.diag(known.astype(float))
    expected = np.linalg.solve(W + smooth * D.T @ D, W @ np.where(known, x, 0))
    assert fit.converged.all()
    np.testing.assert_allclose(fit.q[:, 0], expected, atol=1e-8)


def test_smooth_poses_err_less(arm: Mechanism, recording: Recording) -> None:
    """All frames together: noise is smoothed, and the hidden hand is found."""
    expected = np.array(swing(recording.times)).T
    plain, smooth = (Fitter(arm, aim(recording)).fit(s) for s in (0.0, 1e-9))
    errors = [np.abs(fit.q - expected).max() for fit in (plain, smooth)]
    assert smooth.converged.all()
    assert errors[1] < 0.6 * errors[0]


def test_second_differences_are_exact_for_parabolas() -> None:
    t = np.array([0, 0.1, 0.4, 0.5, 1.1])
    np.testing.assert_allclose(second_differences(t) @ (3 * t**2 - t + 1), 6)


def test_a_step_within_bounds_is_optimal(rng: np.random.Generator) -> None:
    """Random quadratic programs: the conditions of Karush, Kuhn and Tucker hold."""
    for _ in range(50):
        n, m = 6, 2
        root = rng.standard_normal((n, n))
        A, g, H = root @ root.T + 0.1 * np.eye(n), 5 * rng.standard_normal(n), rng.standard_normal((m, n))
        lower, upper = -rng.uniform(0, 1, n), rng.uniform(0, 1, n)
        h = -H @ (0.5 * (lower + upper) * rng.random(n))
        d, multipliers = solve_step(A, g, H, h, lower, upper)
        assert np.abs(H @ d + h).max() < 1e-9
        slope = A @ d + g + H.T @ multipliers
        inside = (d > lower + 1e-9) & (d < upper - 1e-9)
        assert np.abs(slope[inside]).max(initial=0) < 1e-8
        assert (slope[d <= lower + 1e-9] > -1e-8).all()
        assert (slope[d >= upper - 1e-9] < 1e-8).all()


def test_undetermined_directions() -> None:
    J, H = np.array([[1.0, -1.0, 0.0]]), np.zeros((0, 3))
    assert find_undetermined(J, H).tolist() == [True, True, True]
    assert find_undetermined(J, np.array([[1.0, 0, 0]])).tolist() == [False, False, True]
    assert find_undetermined(np.zeros((0, 2)), np.zeros((0, 2))).tolist() == [True, True]


def test_frames_need_few_steps(arm: Mechanism, recording: Recording) -> None:
    """Gauss-Newton's steps are damped only where they do not lower the sum: some five from the frame before."""
    targets = aim(recording, count=12)
    fitter = Fitter(arm, targets)
    q, is_done = fitter.start(0)
    assert is_done
    fitter.iterations = 0
    for k in range(1, 12):
        q, is_done = fitter.solve(k, q)
        assert is_done
    assert fitter.iterations <= 6 * 11
    fitter.iterations = 0
    poses = np.array([q] * 12)
    assert fitter.solve_all(poses, 1e-6)[1]
    assert fitter.iterations <= 8 * 12


def test_damping_does_not_grow_where_steps_are_good(arm: Mechanism, recording: Recording) -> None:
    """Markers far from where sensors can be need many undamped steps, of a frame and of all together."""
    targets = aim(recording, count=3)
    fitter = Fitter(arm, replace(targets, markers=0.5 * targets.markers))
    q, is_done = fitter.solve(0, np.array([0.5, 0.5]))
    assert is_done
    assert fitter.iterations > 15
    sums = fitter.evaluate(0, q)
    assert np.abs(sums.J.T @ sums.r).max() < 1e-8
    fitter.iterations = 0
    every, is_done = fitter.solve_all(np.full((3, 2), 0.5), 1e-14)
    assert is_done
    assert fitter.iterations > 3 * 15
    assert every[0] == pytest.approx(q, abs=1e-5)


def test_steps_of_sparse_programs_are_those_of_full_ones(rng: np.random.Generator) -> None:
    """With limits that act, limits on one side, and entries that cannot move."""
    for _ in range(20):
        n = 5
        root = rng.standard_normal((n, n))
        A, g, H = root @ root.T + 0.1 * np.eye(n), 5 * rng.standard_normal(n), rng.standard_normal((1, n))
        lower, upper = -rng.uniform(0.1, 1, n), rng.uniform(0.1, 1, n)
        upper[0], lower[1], lower[2], upper[2] = np.inf, -np.inf, 0.0, 0.0
        h = -H @ np.array([0.05, -0.05, 0.0, 0.05, 0.0])
        full = solve_step(A, g, H, h, lower, upper)
        thin = solve_step(sparse.csc_array(A), g, sparse.csc_array(H), h, lower, upper)
        for a, b in zip(full, thin, strict=True):
            assert a == pytest.approx(b, rel=1e-8, abs=1e-9)
        d, multipliers = full
        slope = A @ d + g + H.T @ multipliers
        assert d[2] == 0
        assert np.abs(H @ d + h).max() < 1e-9
        for k in (0, 1, 3, 4):
            at_low, at_high = d[k] < lower[k] + 1e-9, d[k] > upper[k] - 1e-9
            assert slope[k] > -1e-7 if at_low else slope[k] < 1e-7 if at_high else abs(slope[k]) < 1e-7
