"""Neighbours of optima of quadratic programs: against the optimum of every active set, one after the other."""

from __future__ import annotations

import itertools
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.optima import neighbours
from mbsrun.ocp.optima.neighbours import LATER, _complement, _meet, move_one_sided, predict
from mbsrun.ocp.optima.point import Active, Limits, assemble
from mbsrun.ocp.optima.status import CHANGING, DEPENDENT, FLAT, SMOOTH, SPLIT
from mbsrun.ocp.optima.symmetric import Factors

Array = NDArray[np.float64]


class Quadratic:
    """Minimise x' H x/2 + f' x within limits of x and of J x + rows; all but H and J move with a number t."""

    def __init__(self, H: Array, J: Array, still: dict[str, Array], moves: dict[str, Array]) -> None:
        self.H, self.J, self.still = H, J, still
        zero = {"f": np.zeros(len(H)), "rows": np.zeros(len(J))}
        zero |= {name: np.zeros_like(still[name]) for name in ("lower", "upper", "least", "most")}
        self.moves = zero | moves

    def at(self, t: float) -> dict[str, Array]:
        """Return all numbers at t; rows are 0 at first."""
        start = {"rows": np.zeros(len(self.J)), **self.still}
        return {name: start[name] + t * self.moves[name] for name in self.moves}

    def solve(self, t: float) -> tuple[Array, Array, Array]:
        """Return the optimum, the multipliers of rows, and the gradient of the Lagrangian: the set that fits."""
        n, m = len(self.H), len(self.J)
        now = self.at(t)
        best: tuple[float, Any] = (np.inf, None)
        for sides in itertools.product((-1, 0, 1), repeat=n + m):
            A = np.vstack((np.eye(n), self.J))[[s != 0 for s in sides]]
            lows, highs = np.concatenate((now["lower"], now["least"])), np.concatenate((now["upper"], now["most"]))
            limits = np.where(np.array(sides) == 1, highs, lows) - np.concatenate((np.zeros(n), now["rows"]))
            b = limits[[s != 0 for s in sides]]
            if not np.isfinite(b).all() or len(A) > n or np.linalg.matrix_rank(A) < len(A):
                continue
            K = np.block([[self.H, A.T], [A, np.zeros((len(A), len(A)))]])
            x, mu = np.split(np.linalg.solve(K, np.concatenate((-now["f"], b))), [n])
            every = np.zeros(n + m)
            every[[s != 0 for s in sides]] = mu
            values = np.concatenate((x, self.J @ x + now["rows"]))
            wrong = max(
                (lows - values).max(), (values - highs).max(), *(-s * y for s, y in zip(sides, every, strict=True))
            )
            if wrong < best[0]:
                best = wrong, (x, every[n:], -every[:n])
        assert best[0] < 1e-12
        return best[1]  # type: ignore[no-any-return]

    def move(self, *, weak: float = 1e-9, status: str = SMOOTH, examined: str = SMOOTH) -> Any:
        """Stand in for the movement of the optimum at t = 0."""
        x, lam, zeta = self.solve(0.0)
        now = self.at(0.0)
        sides = []
        for values, forces, low, high in (
            (x, zeta, now["lower"], now["upper"]),
            (self.J @ x, -lam, now["least"], now["most"]),
        ):
            near = np.where(np.abs(values - low) < weak, -1, np.where(np.abs(values - high) < weak, 1, 0))
            strong = np.abs(forces) > weak
            sides.append((np.where(strong, near, 0).astype(np.int8), np.where(strong, 0, near).astype(np.int8)))
        active, weak_ones = Active(sides[0][0], sides[1][0]), Active(sides[0][1], sides[1][1])
        H, J = sparse.csc_array(self.H), sparse.csc_array(self.J)
        limits = Limits(now["lower"], now["upper"], now["least"], now["most"], np.arange(len(x)))
        none = Active(np.zeros(len(x), np.int8), np.zeros(len(lam), np.int8))
        optimum = SimpleNamespace(
            x=x, values=self.J @ x, multipliers=lam, zeta=zeta, hessian=H, jacobian=J, limits=limits,
            active=active, weak=weak_ones, implied=none, status=status, factors=Factors(assemble(H, J.tocsr(), active)),
        )  # fmt: skip

        def combine(rates: Array) -> Any:
            return SimpleNamespace(**{name: rates[0] * value for name, value in self.moves.items()})

        return SimpleNamespace(
            optimum=optimum, combine=combine, push=lambda change: (change.f, change.rows), examine=lambda _: examined
        )


FAR = np.array([np.inf])


def box(f: list[float], moves: dict[str, Array], *, lower: float = 0.0, upper: float = np.inf) -> Quadratic:
    """Minimise |x|^2/2 + f' x within a box; a row without limits."""
    n = len(f)
    still = {"f": np.array(f), "lower": np.full(n, lower), "upper": np.full(n, upper), "least": -FAR, "most": FAR}
    return Quadratic(np.eye(n), np.ones((1, n)), still, moves)


def test_an_optimum_meets_a_bound_and_another_leaves_its_own() -> None:
    """The projection of -f: 1 - 2 t until 1/2, then 0; 0 until 1/3, then 3 t - 1."""
    found = predict(box([-1.0, 1.0], {"f": np.array([2.0, -3.0])}).move(), [1.0])
    assert (found.status, found.changes) == (SMOOTH, 2)
    assert found.dx == pytest.approx([-1.0, 2.0], abs=1e-13)
    half = predict(box([-1.0, 1.0], {"f": np.array([2.0, -3.0])}).move(), [0.25])
    assert (half.status, half.changes) == (SMOOTH, 0)
    assert half.dx == pytest.approx([-0.5, 0.0], abs=1e-14)


def test_bounds_take_variables_along() -> None:
    """One at its lower bound, one at its upper one, which move; a third is met by a bound that comes."""
    problem = box(
        [1.0, -5.0, -0.5], {"lower": np.array([0.25, 0.0, 0.75]), "upper": np.array([0.0, -0.5, 0.0])}, upper=2.0
    )
    found = predict(problem.move(), [1.0])
    assert found.dx == pytest.approx([0.25, -0.5, 0.25], abs=1e-14)
    assert found.changes == 1


@pytest.mark.parametrize("seed", range(12))
def test_predictions_of_quadratic_programs_are_exact(seed: int) -> None:
    """Three variables and two rows, with all limits on the move: the optimum of the moved program."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 3))
    still = {"f": 2 * rng.normal(size=3), "lower": -rng.uniform(0.2, 1, 3), "upper": rng.uniform(0.2, 1, 3)}
    still |= {"least": -rng.uniform(0.2, 1, 2), "most": rng.uniform(0.2, 1, 2)}
    moves = {"f": 3 * rng.normal(size=3), "rows": 0.1 * rng.normal(size=2)}
    moves |= {name: 0.1 * rng.normal(size=len(still[name])) for name in ("lower", "upper", "least", "most")}
    problem = Quadratic(A @ A.T + np.eye(3), rng.normal(size=(2, 3)), still, moves)
    found = predict(problem.move(), [1.0])
    assert found.status == SMOOTH
    assert found.dx == pytest.approx(problem.solve(1.0)[0] - problem.solve(0.0)[0], abs=1e-10)
    first = move_one_sided(problem.move(), [1.0])
    step = 1e-6
    assert first.dx == pytest.approx((problem.solve(step)[0] - problem.solve(0.0)[0]) / step, abs=1e-5)


@pytest.mark.parametrize("seed", range(8))
def test_weak_limits_become_active_or_not_as_the_direction_decides(seed: int) -> None:
    """The unconstrained optimum lies on a bound and on a row: the derivative is the one-sided one."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 3))
    H, J = A @ A.T + np.eye(3), rng.normal(size=(1, 3))
    x = rng.uniform(-0.5, 0.5, 3)
    side = rng.choice([-1, 1], 2)
    lower, upper = np.full(3, -1.0), np.full(3, 1.0)
    (lower if side[0] < 0 else upper)[0] = x[0]
    row = J @ x
    limits = {"least": row if side[1] < 0 else -5 * FAR, "most": row if side[1] > 0 else 5 * FAR}
    still = {"f": -H @ x, "lower": lower, "upper": upper, **limits}
    moves = {"f": rng.normal(size=3), "rows": 0.3 * rng.normal(size=1)}
    moves |= {"lower": 0.2 * rng.normal(size=3), "upper": 0.2 * rng.normal(size=3)}
    moves |= {"least": 0.2 * rng.normal(size=1), "most": 0.2 * rng.normal(size=1)}
    problem = Quadratic(H, J, still, moves)
    step = 1e-6
    expected = (problem.solve(step)[0] - problem.solve(0.0)[0]) / step
    movement = problem.move()
    assert (movement.optimum.weak.variables[0], movement.optimum.weak.rows[0]) == tuple(side)
    found = move_one_sided(movement, [1.0])
    assert found.status == SMOOTH
    assert found.dx == pytest.approx(expected, abs=1e-5)
    assert predict(movement, [step]).dx == pytest.approx(step * expected, abs=1e-10)


def test_numbers_that_move_nothing_differentiable_have_no_derivative() -> None:
    """A status that is bad for one number counts where its rate is not 0; a change of sets is what this is for."""
    problem = box([-1.0], {"f": np.array([2.0])})
    for status, examined, rates, told in (
        (SMOOTH, SPLIT, [1.0], SPLIT),
        (SMOOTH, SPLIT, [0.0], SMOOTH),
        (CHANGING, CHANGING, [1.0], SMOOTH),
        (FLAT, SMOOTH, [1.0], FLAT),
    ):
        for function in (move_one_sided, predict):
            found = function(problem.move(status=status, examined=examined), rates)
            assert found.status == told
            assert np.isnan(found.dx).all() == (told != SMOOTH)


def test_weak_limits_that_depend_on_each_other_have_a_status() -> None:
    """Two equal rows on which the optimum lies."""
    still = {
        "f": np.zeros(2),
        "lower": np.full(2, -9.0),
        "upper": np.full(2, 9.0),
        "least": np.zeros(2),
        "most": np.full(2, 9.0),
    }
    problem = Quadratic(np.eye(2), np.ones((2, 2)), still, {"f": np.array([1.0, 1.0])})
    assert move_one_sided(problem.move(), [1.0]).status == DEPENDENT


def test_a_way_with_too_many_changes_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = box([-1.0, 1.0], {"f": np.array([2.0, -3.0])})
    monkeypatch.setattr(neighbours, "MOST", 2)
    found = predict(problem.move(), [1.0])
    assert (found.status, found.changes) == (CHANGING, 1)
    monkeypatch.setattr(neighbours, "MOST", 3)
    assert predict(problem.move(), [1.0]).status == SMOOTH


def test_the_first_distance_that_is_gone_is_named() -> None:
    """Distance over speed, of the closing ones; one that is gone already takes no time to speak of."""
    distances, inf = np.array([1.0, 3.0, 0.5, 9.0]), np.inf
    assert _meet(distances, np.array([1.0, 6.0, 0.0, -1.0])) == (0.5, 1)
    assert _meet(distances, np.array([0.0, -1.0, 0.0, -1.0])) is None
    assert _meet(np.array([inf, 2.0]), np.array([1.0, 1.0])) == (2.0, 1)
    assert _meet(np.array([inf]), np.array([1.0])) is None
    assert _meet(np.array([0.0, 1.0]), np.array([1.0, 1.0])) == (LATER, 0)


def test_complements_share_no_entry() -> None:
    """y = r + M mu, both nonnegative, y' mu = 0; a matrix that is not definite has no answer."""
    M, r = np.array([[200.0, 1.0], [1.0, 0.5]]), np.array([-2.0, 3.0])
    mu = _complement(M, r)
    assert mu is not None
    assert mu == pytest.approx([0.01, 0.0])
    mu = _complement(M, np.array([-100.0, -1.0]))
    assert mu is not None
    assert r.size == mu.size
    assert M @ mu == pytest.approx([100.0, 1.0])
    assert _complement(np.ones((2, 2)), r) is None
    assert _complement(np.array([[1.0, 2.0], [2.0, 1.0]]), r) is None
    nearly = np.array([[1.0, 1 - 1e-12], [1 - 1e-12, 1.0]])
    found = _complement(nearly, -np.ones(2))
    assert found is not None
    assert nearly @ found == pytest.approx([1.0, 1.0])


def test_factors_that_live_as_long_as_the_interpreter_end_in_silence() -> None:
    """Modules are gone before the last objects are; the library is called before that."""
    lines = (
        "import numpy, scipy.sparse, mbsrun.ocp.optima.symmetric as symmetric",
        "numpy.kept = symmetric.Factors(scipy.sparse.csc_array(numpy.eye(2))), symmetric",
    )
    ended = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, check=True)
    assert (ended.stdout, ended.stderr) == ("", "")
