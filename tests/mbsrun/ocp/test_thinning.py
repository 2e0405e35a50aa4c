"""Limits that other conditions imply, by hand: which one goes first, what multipliers remain, and drawn active sets."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.optima.thinning import _find_first, _find_null, _purify, thin

Array = NDArray[np.float64]


def sign(*sides: int) -> NDArray[np.int8]:
    return np.array(sides, dtype=np.int8)


def test_the_first_multiplier_without_a_value_is_found() -> None:
    """Rates of 1e-7 at most move none; one below 0 by rounding is there at once."""
    y = np.array([4.0, 3.0, 1.0, 0.5])
    assert _find_first(y, np.array([-1.0, -0.5, 1.0, 0.0])) == (4.0, 0)
    assert _find_first(y, np.array([-1.0, -1.0, -0.1, 0.0])) == (3.0, 1)
    assert _find_first(y, np.array([1.0, 0.0, 0.5, -0.9e-7])) == (np.inf, -1)
    assert _find_first(y, np.array([1.0, 0.0, 0.5, -1.1e-7]))[1] == 3
    assert _find_first(np.array([1.0, -1e-9]), np.array([-1.0, -1.0])) == (0.0, 1)


@pytest.mark.parametrize("scale", [1.0, -1.0, 1e3, 1e-3])
def test_the_way_ends_at_the_nearer_of_both_sides(scale: float) -> None:
    """y + t (1, -1, 0.5): the second one is 0 at t = 1, the first one at t = -3; an equation goes along."""
    way = scale * np.array([[1.0], [-1.0], [0.5]])
    found = _purify(np.array([3.0, 1.0, 2.0]), way, sign(1, 1, 0))
    assert found is not None
    assert (found[0].tolist(), found[1].tolist()) == (pytest.approx([4.0, 0.0, 2.5]), [1])
    found = _purify(np.array([-3.0, 9.0, 2.0]), way, sign(-1, 1, 0))
    assert found is not None
    assert (found[0].tolist(), found[1].tolist()) == (pytest.approx([0.0, 6.0, 3.5]), [0])


def test_directions_of_equations_alone_cannot_be_thinned() -> None:
    """To 1e-7 of the largest entry."""
    y = np.array([3.0, 1.0, 2.0])
    assert _purify(y, np.array([[0.9e-7], [1.0], [-1.0]]), sign(1, 0, 0)) is None
    assert _purify(y, np.array([[1.1e-7], [1.0], [-1.0]]), sign(1, 0, 0)) is not None
    assert _purify(y, np.array([[0.0], [1.0], [-1.0]]), sign(0, 0, 0)) is None
    kept = _purify(y, np.zeros((3, 0)), sign(1, 1, 0))
    assert kept is not None
    assert (kept[0].tolist(), kept[1].size) == ([3.0, 1.0, 2.0], 0)


@pytest.mark.parametrize("seed", range(8))
def test_each_direction_takes_one_limit(seed: int) -> None:
    """Sums along all rows stay, signs are right, and no direction is left that moves a limit."""
    rng = np.random.default_rng(seed)
    m, k = 9, 1 + seed % 4
    way = rng.normal(size=(m, k))
    sides = np.where(rng.random(m) < 0.6, rng.choice([-1, 1], m), 0).astype(np.int8)
    sides[:5] = 1
    y = np.where(sides == 0, rng.normal(size=m), sides * rng.uniform(0.1, 2, m))
    found = _purify(y, way, sides)
    assert found is not None
    after, gone = found
    assert len(set(gone.tolist())) == k
    assert (sides[gone] != 0).all()
    assert not after[gone].any()
    assert (sides * after >= -1e-12).all()
    across = np.linalg.qr(way, mode="complete")[0][:, k:]
    assert across.T @ (after - y) == pytest.approx(np.zeros(m - k), abs=1e-10)


def test_directions_without_a_gradient_are_a_basis() -> None:
    """Of rows of any size: J'n = 0, as many as rows depend on others; rows without entries count too."""
    rng = np.random.default_rng(3)
    base = rng.normal(size=(4, 7))
    J = np.vstack((base, 1e5 * (base[0] + base[1]), np.zeros(7), base[2]))
    J[1] *= 1e-4
    found = _find_null(sparse.csr_array(J))
    assert found is not None
    assert found.shape == (7, 3)
    scaled = J / np.where(J.any(axis=1), np.abs(J).max(axis=1), 1.0)[:, None]
    sizes = np.where(J.any(axis=1), np.abs(J).max(axis=1), 1.0)
    weighted = sizes[:, None] * found
    assert scaled.T @ weighted == pytest.approx(np.zeros((7, 3)), abs=1e-7)
    assert np.linalg.matrix_rank(weighted, tol=1e-6) == 3
    none = _find_null(sparse.csr_array(base))
    assert none is not None
    assert none.shape == (4, 0)


def test_more_directions_than_are_projected_at_once_are_found() -> None:
    J = np.repeat(np.eye(3), 12, axis=0)
    found = _find_null(sparse.csr_array(J))
    assert found is not None
    assert found.shape == (36, 33)
    assert J.T @ found == pytest.approx(np.zeros((3, 33)), abs=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_a_thinned_set_is_independent_and_has_the_same_gradient(seed: int) -> None:
    """Equations stay, multipliers have their signs, and limits that go have none."""
    rng = np.random.default_rng(seed)
    n, m = 6, 7
    J = np.round(rng.normal(size=(m, n)), 1)
    J[4], J[5], J[6] = J[0] + J[1], 2 * J[2], J[3] - J[0]
    rows = sign(2, 1, -1, 2, 1, -1, 0)
    variables = sign(0, -1, 1, 0, 0, 2)
    lam = np.array([0.5, 1.0, -2.0, -0.7, 3.0, -0.4, 0.0])
    gradient = -J.T @ lam  # of the cost, so that free variables are stationary
    gradient[[1, 2, 5]] += [0.8, -0.6, 5.0]
    zeta = gradient + J.T @ lam
    found = thin(sparse.csr_array(J), variables, rows, lam, zeta)
    assert found is not None
    after = gradient + J.T @ found.lam
    assert after[found.variables == 0] == pytest.approx(np.zeros((found.variables == 0).sum()), abs=1e-7)
    assert (found.rows * found.lam >= -1e-9)[np.abs(found.rows) == 1].all()
    assert (-found.variables * after >= -1e-9)[np.abs(found.variables) == 1].all()
    assert (found.rows[[0, 3]] == 2).all()
    assert found.variables[5] == 2
    assert not found.lam[found.rows == 0].any()
    active = np.vstack((J[found.rows != 0], np.eye(n)[found.variables != 0]))
    assert np.linalg.matrix_rank(active) == len(active)
    assert found.rows[6] == 0
    whole = np.vstack((J[rows != 0], np.eye(n)[variables != 0]))
    assert len(active) == np.linalg.matrix_rank(whole)
    free = J[:, variables == 0].T
    assert free @ found.directions.T == pytest.approx(np.zeros((3, len(found.directions))), abs=1e-7)
    assert not found.directions[:, 6].any()


def test_one_of_two_equal_limits_goes_and_its_multiplier_is_the_others() -> None:
    J = sparse.csr_array(np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    for lam, rows, kept in (
        ([2.0, 3.0, 0.0], sign(1, 1, 0), 1),
        ([3.0, 2.0, 0.0], sign(1, 1, 0), 0),
        ([-2.0, -3.0, 0.0], sign(-1, -1, 0), 1),
        ([-2.0, 3.0, 0.0], sign(2, 1, 0), 0),
    ):
        found = thin(J, sign(0, 0), rows, np.array(lam), np.zeros(2))
        assert found is not None
        assert found.rows.tolist() == [rows[k] if k == kept else 0 for k in range(3)]
        assert found.lam == pytest.approx([sum(lam) if k == kept else 0.0 for k in range(3)], abs=1e-9)
    assert thin(J, sign(0, 0), sign(2, 2, 0), np.array([1.0, 2.0, 0.0]), np.zeros(2)) is None


def test_a_held_variable_that_an_equation_implies_goes() -> None:
    """The limit's multiplier becomes the equation's: zeta + t = 0 and lam + t."""
    J = sparse.csr_array(np.array([[1.0, 0.0]]))
    for side, zeta in ((-1, 0.75), (1, -0.75)):
        found = thin(J, sign(side, 0), sign(2), np.array([5.0]), np.array([zeta, 0.0]))
        assert found is not None
        assert (found.variables.tolist(), found.rows.tolist()) == ([0, 0], [2])
        assert found.lam == pytest.approx([5.0 - zeta])
    assert thin(J, sign(2, 0), sign(2), np.array([5.0]), np.array([1.0, 0.0])) is None
