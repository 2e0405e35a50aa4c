"""Inner variables that are solved for: by hand, with their derivatives, and the steps that Newton's method takes."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.evaluation.elimination import (
    Application,
    Elimination,
    Groups,
    Inner,
    _fill,
    _find,
    _flatten,
    _localise,
    _mark,
    _measure,
    _multiply,
    _reaches,
    _read_block,
    _read_part,
    _spread,
)
from mbsrun.ocp.ground.functions import Pattern
from mbsrun.ocp.ground.program import Block, Combination

Array = NDArray[np.float64]
FUNCTION = cast(Any, "F")


class Smooth:
    """F(a, b) = (a0 b, a1 + b^2), at several places."""

    sizes = (2, 1)
    jacobian_patterns = (
        Pattern((2, 2), np.array([0, 1]), np.array([0, 1])),
        Pattern((2, 1), np.array([0, 1]), np.array([0, 0])),
    )
    hessian_patterns = (
        Pattern((2, 2), np.zeros(0, int), np.zeros(0, int)),
        Pattern((2, 1), np.array([0]), np.array([0])),
        Pattern((1, 2), np.array([0]), np.array([0])),
        Pattern((1, 1), np.array([0]), np.array([0])),
    )

    def __init__(self, places: int) -> None:
        self.places = places

    def value(self, arguments: Sequence[Array]) -> Array:
        a, b = arguments
        assert len(a) == self.places
        return np.stack((a[:, 0] * b[:, 0], a[:, 1] + b[:, 0] ** 2), axis=1)

    def jacobian(self, arguments: Sequence[Array]) -> list[Array]:
        a, b = arguments
        return [np.hstack((b, np.ones_like(b))), np.hstack((a[:, :1], 2 * b))]

    def hessian(self, _: Sequence[Array], weights: Array) -> list[Array]:
        first, second = weights[:, :1], weights[:, 1:]
        return [np.zeros((len(weights), 0)), first, first, 2 * second]


def bind(function: object, places: int) -> Any:
    assert function == FUNCTION
    return Smooth(places)


W = np.array([[0.3, -0.2], [0.5, 0.4], [-0.1, 0.7]])  # knowns of three groups
SCALE = np.array([[0.5], [1.0], [-0.25]])


def solve_by_hand() -> Elimination:
    """z0 + 2 w1 + s z1 w0 = 0 and z1 - w0 + s (w1 + w0^2) = 0: F of (z1, w1) and w0, a scale s of each group."""
    C = np.array([[[0, 1.0, 0, 0], [0, 0, 0, 1], [0, 0, 1, 0]]])
    A = np.array([[1.0, 0, 0, 2], [0, 1, -1, 0]])
    part = Application(bind, FUNCTION, C, np.array([[0, 1]]), SCALE, 3)
    return Elimination(A, [part], Groups(np.zeros((3, 2), int), np.zeros((3, 2), int)))


def by_hand(w: Array) -> tuple[Array, Array]:
    s, w0, w1 = SCALE[:, 0], w[:, 0], w[:, 1]
    z1 = w0 - s * (w1 + w0**2)
    return -2 * w1 - s * z1 * w0, z1


def test_unknowns_and_their_derivatives_are_those_by_hand() -> None:
    """Slopes and curvature by central differences of the closed form: a polynomial of degree 3."""
    found = solve_by_hand()
    assert found.solve(W) == pytest.approx(np.stack(by_hand(W), axis=1), abs=1e-15)
    h, unit = 1e-3, np.eye(2)
    slopes = np.stack(
        [np.stack([(a - b) / (2 * h) for a, b in zip(by_hand(W + h * e), by_hand(W - h * e), strict=True)], 1)
         for e in unit], axis=2,
    )  # fmt: skip
    assert found.differentiate(W) == pytest.approx(slopes, abs=1e-6)
    gradient = np.array([[1.0, 2.0], [-1.0, 0.5], [3.0, 0.0]])
    for i in range(2):
        for j in range(2):
            moved = [by_hand(W + h * (a * unit[i] + b * unit[j])) for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
            second = [(x[0] - x[1] - x[2] + x[3]) / (4 * h * h) for x in zip(*moved, strict=True)]
            expected = gradient[:, 0] * second[0] + gradient[:, 1] * second[1]
            assert found.curve(W, gradient)[:, i, j] == pytest.approx(expected, abs=1e-5)


def test_a_solution_is_kept_for_the_same_knowns(monkeypatch: pytest.MonkeyPatch) -> None:
    found, calls = solve_by_hand(), list[int]()
    iterate = found._iterate
    monkeypatch.setattr(found, "_iterate", lambda v: calls.append(1) is None and iterate(v))  # type: ignore[func-returns-value]
    found.solve(W)[:] = 7.0
    found.differentiate(W)[:] = 7.0
    assert found.solve(W) == pytest.approx(np.stack(by_hand(W), axis=1))
    assert np.abs(found.differentiate(W)).max() < 7
    assert len(calls) == 1
    found.solve(-W)
    found.solve(W)
    assert len(calls) == 3


def test_patterns_mark_what_knowns_reach() -> None:
    """w0 by F alone, and w1; the third is read by nothing. Of second derivatives, w0 w0 and z1(w) w0."""
    C = np.zeros((1, 3, 5))
    C[0, 0, 1] = C[0, 1, 3] = C[0, 2, 2] = 1
    A = np.array([[1.0, 0, 0, 2, 0], [0, 1, 0, 0, 0]])
    part = Application(bind, FUNCTION, C, np.array([[0, 1]]), SCALE, 3)
    found = Elimination(A, [part], Groups(np.zeros((3, 2), int), np.zeros((3, 3), int)))
    assert found.slope_pattern.tolist() == [[True, True, False]] * 2
    assert found.curvature_pattern.tolist() == [[True, True, False], [True, False, False], [False] * 3]
    assert part.slope_pattern.tolist() == [[True, False, True], [False, True, True]]
    assert part.curvature_pattern.tolist() == [[False, False, True], [False, False, False], [True, False, True]]
    alone = Elimination(A[:, :4], [], Groups(np.zeros((3, 2), int), np.zeros((3, 2), int)))
    assert alone.slope_pattern.tolist() == [[False, True]] * 2


class Steps(Elimination):
    """One group of one unknown whose residuals are given, in order, and whose slopes are 1."""

    def __init__(self, given: Sequence[float], nested: Sequence[bool] = ()) -> None:
        super().__init__(np.array([[1.0]]), [], Groups(np.zeros((1, 1), int), np.zeros((1, 0), int)))
        self.given, self.ends = list(given), list(nested)
        self.residuals = self.made = 0

    def _solve_nested(self, _: Array) -> bool:
        return self.ends.pop(0) if self.ends else True

    def _residual(self, *_: object) -> Array:
        self.residuals += 1
        return np.array([[self.given[min(self.residuals, len(self.given)) - 1]]])

    def _slopes(self, *_: object, **__: object) -> Array:
        self.made += 1
        return np.ones((1, 1, 1))


@pytest.mark.parametrize(
    ("given", "has_ended", "residuals", "slopes"),
    [
        ([0.99e-8], True, 1, 1),
        ([1.02e-8, 0.0], True, 2, 1),  # nothing is left
        ([1e-4, 3.1e-9], True, 2, 1),  # 1e-13 remain at this rate
        ([1e-4, 3.2e-9, 0.0], True, 3, 1),
        ([1e-4, 0.049e-4, 0.0], True, 3, 1),  # steps shrink quickly, with the same slopes
        ([1e-4, 0.051e-4, 0.0], True, 3, 2),  # they do not
        ([1e-4, 0.04e-4, 0.04 * 0.04e-4, 0.0], True, 4, 1),
        ([1e-4, 0.04e-4, 0.06 * 0.04e-4, 0.0], True, 4, 2),
        ([1e-4, 0.9e-8, 0.0], True, 3, 1),
        ([1e-4, 0.1e-4, 0.6e-6, 0.9e-8, 0.0], True, 5, 3),
        ([1.0], False, 30, 30),
        ([np.nan], False, 1, 1),
    ],
)
def test_slopes_are_kept_while_steps_shrink_quickly(
    given: Sequence[float], has_ended: bool, residuals: int, slopes: int
) -> None:
    """By a twentieth; the end is a step of 1e-8, or a known rate that leaves 1e-13; 30 steps at most."""
    steps = Steps(given)
    assert steps._iterate(np.zeros((1, 1))) is has_ended
    assert (steps.residuals, steps.made) == (residuals, slopes)


def test_steps_are_taken_off() -> None:
    """With new slopes, and with kept ones."""
    v = np.zeros((1, 1))
    assert Steps([1e-2, 1e-4, 0.0])._iterate(v)
    assert v[0, 0] == pytest.approx(-0.0101, rel=1e-12)


@pytest.mark.parametrize(
    ("nested", "residuals"),
    [([False], 0), ([True, False], 1), ([True, True, False], 2), ([True, True, True, False], 3)],
)
def test_no_solution_of_nested_equations_ends_all(nested: list[bool], residuals: int) -> None:
    steps = Steps([1e-2, 1e-4, 1e-5], nested)  # new slopes, kept ones, and new ones
    assert not steps._iterate(np.zeros((1, 1)))
    assert steps.residuals == residuals


def nest(w: Sequence[float] = (0.5, 0.2)) -> tuple[Elimination, Array]:
    """z0 + 2 z1 + w1 = 0 and z1 + z1 z1 (by F) - w0 = 0, which is nested; return it and its solution."""
    A = np.array([[1.0, 2, 0, 1], [0, 1, -1, 0]])
    C = np.array([[[0, 1.0, 0, 0], [0, 0, 0, 0], [0, 1, 0, 0]]])
    part = Application(lambda _, n: Square(n), FUNCTION, C, np.array([[1]]), np.ones((1, 1)), 1)
    z1 = (-1 + np.sqrt(max(0.0, 1 + 4 * w[0]))) / 2
    found = Elimination(A, [part], Groups(np.zeros((1, 2), int), np.zeros((1, 2), int)), nested=1)
    return found, np.array([[-2 * z1 - w[1], z1]])


class Square(Smooth):
    """F(a, b) = a0 b."""

    jacobian_patterns = (
        Pattern((1, 2), np.array([0]), np.array([0])),
        Pattern((1, 1), np.array([0]), np.array([0])),
    )

    def value(self, arguments: Sequence[Array]) -> Array:
        return super().value(arguments)[:, :1]

    def jacobian(self, arguments: Sequence[Array]) -> list[Array]:
        return [part[:, :1] for part in super().jacobian(arguments)]


def test_nested_equations_hold_after_every_step() -> None:
    found, z = nest()
    w = np.array([[0.5, 0.2]])
    v = np.concatenate((np.zeros((1, 2)), w), axis=1)
    assert found._solve_nested(v)
    assert v[0, 1] == pytest.approx(z[0, 1], abs=1e-15)
    assert v[0, 0] == 0
    assert found.solve(w) == pytest.approx(z, abs=1e-15)
    assert np.isnan(nest((-1.0, 0.2))[0].solve(np.array([[-1.0, 0.2]]))).all()


@pytest.mark.parametrize(
    ("given", "has_ended", "residuals"),
    [
        ([0.99e-8], True, 1),
        ([1.02e-8, 0.0], True, 2),
        ([1e-3, 1e-9], True, 2),
        ([1.0], False, 30),
        ([np.nan], False, 1),
        ([1.0, np.inf], False, 2),
    ],
)
def test_nested_steps_end_small_or_after_thirty(given: list[float], has_ended: bool, residuals: int) -> None:
    steps = Steps(given)
    steps._nested = np.array([0])
    with np.errstate(invalid="ignore"):
        assert Elimination._solve_nested(steps, np.zeros((1, 1))) is has_ended
    assert steps.residuals == residuals


def test_triangular_equations_are_substituted_in_order() -> None:
    """z0 - w0 + F, and z1 - z0 z0: each order reads what was found before; what is not finite is no solution."""
    A = np.array([[1.0, 0, -1], [0, 1, 0]])
    C = np.array([[[1.0, 0, 0], [0, 0, 0], [1, 0, 0]]])
    part = Application(lambda _, n: Square(n), FUNCTION, C, np.array([[1]]), -np.ones((2, 1)), 2)
    orders = [np.array([0]), np.array([1])]
    found = Elimination(A, [part], Groups(np.zeros((2, 2), int), np.zeros((2, 1), int)), orders)
    assert [len(parts) for _, parts in found.orders] == [0, 1]
    assert found.solve(np.array([[3.0], [-0.5]])) == pytest.approx(np.array([[3.0, 9.0], [-0.5, 0.25]]))
    assert np.isnan(found.solve(np.array([[np.inf], [1.0]]))).all()


def test_a_step_is_measured_by_what_it_leads_to() -> None:
    assert _measure(np.array([[3.0, -6.0]]), np.array([[-1.0, 2.0]])) == 6 / (1 + 8)
    assert _measure(np.array([[0.5]]), np.array([[0.5]])) == 0.5


def test_blocks_lie_in_a_flattened_matrix() -> None:
    pattern = Pattern((2, 2), np.array([0, 1]), np.array([1, 0]))
    assert _flatten(pattern, 0, 0, 5).tolist() == [1, 5]
    assert _flatten(pattern, 2, 1, 5).tolist() == [12, 16]
    places = [np.array([1, 4]), np.array([0])]
    assert _spread([np.array([[1.0, 2], [3, 4]]), np.array([[5.0], [6]])], places, (2, 3)).tolist() == [
        [[5, 1, 0], [0, 2, 0]],
        [[6, 3, 0], [0, 4, 0]],
    ]
    assert _mark(places, (2, 3)).tolist() == [[True, True, False], [False, True, False]]
    assert _find(np.array([[4, 9], [1, 4], [7, 0]]), np.array([1, 7])).tolist() == [1, 2]
    full = _fill(2, 3)
    assert (full.row.tolist(), full.col.tolist(), full.shape) == ([0, 0, 0, 1, 1, 1], [0, 1, 2] * 2, (2, 3))
    assert (_fill(2, 0).row.size, _fill(2, 1).col.tolist()) == (0, [0, 0])


def test_products_reach_what_both_share() -> None:
    """However many entries meet in one place."""
    first, second = np.ones((1, 300), bool), np.ones((300, 1), bool)
    assert _reaches(first, second).tolist() == [[True]]
    assert _reaches(np.array([[True, False]]), np.array([[False], [True]])).tolist() == [[False]]


def test_a_factor_multiplies_a_function_and_its_derivatives() -> None:
    """t F: by the arguments t F', by t the value; second derivatives t F'', F' and 0."""
    product = _multiply(bind)(FUNCTION, 2)
    a, b, t = np.array([[2.0, 3.0], [1.0, -1.0]]), np.array([[5.0], [0.5]]), np.array([[10.0], [-2.0]])
    assert product.sizes == (2, 1, 1)
    assert product.value([a, b, t]).tolist() == [[100, 280], [-1, 1.5]]
    by = product.jacobian([a, b, t])
    assert [x.tolist() for x in by] == [[[50, 10], [-1, -2]], [[20, 100], [-2, -2]], [[10, 28], [0.5, -0.75]]]
    assert [p.shape for p in product.jacobian_patterns] == [(2, 2), (2, 1), (2, 1)]
    weights = np.array([[1.0, 2.0], [3.0, 4.0]])
    found, patterns = product.hessian([a, b, t], weights), product.hessian_patterns
    assert [p.shape for p in patterns] == [(2, 2), (2, 1), (2, 1), (1, 2), (1, 1), (1, 1), (1, 2), (1, 1), (1, 0)]
    dense = []
    for values, pattern in zip(found[:8], patterns[:8], strict=True):
        whole = np.zeros((2, *pattern.shape))
        whole[:, pattern.row, pattern.col] = values
        dense.append(whole)
    rows = [np.concatenate(dense[:3], axis=2), np.concatenate(dense[3:6], axis=2)]
    assert rows[0].tolist() == [[[0, 0, 10, 5], [0, 0, 0, 2]], [[0, 0, -6, 1.5], [0, 0, 0, 4]]]
    assert rows[1].tolist() == [[[10, 0, 40, 2 + 20]], [[-6, 0, -16, 3 + 4]]]
    assert [x.tolist() for x in dense[6:8]] == [
        rows[0][:, :, 3:].transpose(0, 2, 1).tolist(),
        rows[1][:, :, 3:].tolist(),
    ]
    assert found[8].shape == (2, 0)


def test_groups_have_their_matrices_in_common() -> None:
    """Variables of a program by their places in a group; entries of one place that are named twice are added."""
    column = np.array([2, 0, 1, -1, 2, 0, 1])
    places = np.array([[0, 1], [2, 3]])  # two groups of two places
    own = np.array([[0, 1, 4, 5], [2, 2, 6, 6]])
    assert _read_part(own, places, column, 3).tolist() == [[[0, 0, 1], [0, 1, 0]], [[1, 0, 0], [0, 1, 0]]]
    matrices = np.array([[[1.0, 2.0, 4.0]], [[3.0, -1.0, 0.0]]])
    variables = np.array([[0, 1, 0], [1, 2, 2], [4, 5, 4], [5, 6, 6]])
    combined = Combination(matrices, np.array([0, 1, 0, 1]), variables)
    assert _read_part(combined, places, column, 3).tolist() == [[[2, 0, 5]], [[3, -1, 0]]]
    A = sparse.csr_array(
        np.array([[0, 5.0, 0, 0, 0, 0, 0], [7, 0, 1, 0, 0, 0, 0], [0, 0, 0, 0, 0, 5, 0], [0, 0, 0, 0, 7, 0, 1]])
    )
    assert _localise(A, (2, 2, 3), column).tolist() == [[5, 0, 0], [0, 1, 7]]


def test_blocks_are_read_by_their_stages() -> None:
    """Places in the order of stages, rows by their place in a stage, and a factor as one more argument."""
    column = np.array([0, 1, 0, 1, 2])
    block = Block(
        FUNCTION,
        (np.array([[2, 0], [3, 1]]), np.array([[4, 4]])),
        np.array([[2, 0], [3, 1]]),
        np.array([6, 5]),
        scale=np.array([10.0, 20.0]),
    )
    found = _read_block(block, column, (2, 3), 2, bind)
    assert found.rows.tolist() == [[0, 1]]
    assert found.scale.tolist() == [[20], [10]]
    assert found.C.tolist() == [[[1, 0, 0], [0, 1, 0], [0, 0, 1]]]
    v = np.array([[1.0, 2, 3], [4, 5, 6]])
    assert found.value(v).tolist() == [[[60, 220]], [[240, 410]]]
    timed = _read_block(
        Block(FUNCTION, block.columns, block.rows, block.stages, scale=block.scale, factor=4), column, (2, 3), 2, bind
    )
    assert timed.C[0, 3].tolist() == [0, 0, 1]
    assert timed.value(v).tolist() == [[[180, 660]], [[1440, 2460]]]


def test_all_parts_of_inner_variables_stand_one_after_another() -> None:
    """Two groups of two unknowns, then one of one; knowns by their places among the variables that stay."""
    two, one = Groups(np.array([[1, 2], [5, 6]]), np.array([[0, 9], [3, 9]])), Groups(np.array([[8]]), np.array([[3]]))

    def part(groups: Groups, mask: Array) -> Any:
        s, k = groups.unknowns.shape[1], groups.knowns.shape[1]
        return SimpleNamespace(
            groups=groups,
            slope_pattern=np.broadcast_to(mask, (s, k)) > 0,
            curvature_pattern=np.ones((k, k)) > 0,
            solve=lambda w: np.tile(w.sum(axis=1)[:, None], (1, s)),
            differentiate=lambda w: np.tile(w[:, None, :], (1, s, 1)),
            curve=lambda w, by: by.sum(axis=1)[:, None, None] * w[:, :, None] * w[:, None, :],
        )

    inner = Inner((part(two, np.array([1, 0])), part(one, np.array([1]))), np.array([0, 3, 9]))
    x = np.array([10.0, 20.0, 1.0])
    assert inner.unknowns.tolist() == [1, 2, 5, 6, 8]
    assert inner.solve(x).tolist() == [11, 11, 21, 21, 20]
    assert inner.slopes.row.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4]
    assert inner.slopes.col.tolist() == [0, 2, 0, 2, 1, 2, 1, 2, 1]
    assert inner.slopes.mask.tolist() == [True, False] * 4 + [True]
    assert inner.differentiate(x).tolist() == [10, 1, 10, 1, 20, 1, 20, 1, 20]
    assert inner.curvature.row.tolist() == [0, 0, 2, 2, 1, 1, 2, 2, 1]
    assert inner.curvature.col.tolist() == [0, 2, 0, 2, 1, 2, 1, 2, 1]
    gradient = np.array([1.0, 2, 3, 4, 5])
    assert inner.curve(x, gradient).tolist() == [300, 30, 30, 3, 2800, 140, 140, 7, 2000]
