"""The rules by which a search chooses, corrects and ends with an active set: each at its boundary, by hand."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.ground.program import Block, Matrix, Program
from mbsrun.ocp.methods import Instance
from mbsrun.ocp.optima import point
from mbsrun.ocp.optima.interior import Centre
from mbsrun.ocp.optima.point import (
    Active,
    Limits,
    _choose,
    _judge,
    _keep_one,
    _list_equal,
    _Search,
    _separate,
    _touch,
    _vanish,
    assemble,
    complete,
)
from mbsrun.ocp.optima.status import CHANGING, DEPENDENT, FLAT, NOT_CONVERGED, SMOOTH
from mbsrun.ocp.optima.thinning import Thinned

Array = NDArray[np.float64]
INF = np.inf
NONE = sparse.csc_array((2, 2))


def sides(*given: int) -> NDArray[np.int8]:
    return np.array(given, dtype=np.int8)


def active(variables: Sequence[int], rows: Sequence[int] = ()) -> Active:
    return Active(sides(*variables), sides(*rows))


def listed(found: Active) -> tuple[list[int], list[int]]:
    return found.variables.tolist(), found.rows.tolist()


def search(
    c: Sequence[float],
    A: Sequence[Sequence[float]] = ((0.0, 0.0),),
    bounds: Sequence[tuple[float, float]] = ((-INF, INF),) * 2,
    ranges: Sequence[tuple[float, float]] = ((-INF, INF),),
    x: Sequence[float] = (0.0, 0.0),
    scale: float = 1.0,
) -> _Search:
    """Return a search with the cost c'x + x'x/2 and rows A x, of two variables."""
    J = sparse.csc_array(np.array(A, dtype=float).reshape(-1, 2))
    functions = SimpleNamespace(
        gradient=lambda x, _: np.array(c) + x,
        constraint=lambda x, _: J @ x,
        jacobian=lambda *_: Matrix(J),
        hessian=lambda _x, _p, factor, _lam: Matrix(sparse.csc_array(factor * np.eye(2))),
    )
    (lower, upper), (least, most) = np.array(bounds, dtype=float).T, np.array(ranges, dtype=float).reshape(-1, 2).T
    start = Instance(np.array(x, dtype=float), np.zeros(0), lower, upper, least, most)
    return _Search(cast(Any, functions), Program(J, (NONE, NONE), ()), start, scale)


@pytest.mark.parametrize(
    ("value", "force", "side"),
    [
        (1e-5, 0.0, 0),  # a distance, and no force
        (0.9e-5, 0.0, None),
        (0.0, 1e-5, -1),  # a force, and no distance
        (0.0, 0.9e-5, None),
        (0.9e-5, 0.9e-5, None),
        (1.0, 0.9, 0),  # the larger one counts, since the optimum is looked at again
        (0.9, 1.0, -1),
        (1.0, 1.0, 0),
        (1.0, -2.0, 0),  # the force of the other side
    ],
)
def test_a_limit_acts_where_its_force_exceeds_its_distance(value: float, force: float, side: int) -> None:
    """Where both are small, there is a doubt. Distances are over sizes, and sides are mirrored."""
    one, size = np.ones(1), 2.0
    expected = None if side is None else [side]
    found = _separate(size * value * one, 0 * one, INF * one, force * one, size * one)
    assert (found if found is None else found.tolist()) == expected
    found = _separate(-size * value * one, -INF * one, 0 * one, -force * one, size * one)
    assert (found if found is None else found.tolist()) == (expected and [-expected[0]])


def test_distances_are_from_limits() -> None:
    """2 of a size 4 from a limit of 6, and none of it from 8."""
    one = np.ones(1)
    found = _separate(8 * one, 6 * one, 9 * one, 0 * one, 4 * one)
    assert found is not None
    assert found.tolist() == [0]
    found = _separate(8 * one, 6 * one, 8 * one, -one, 4 * one)
    assert found is not None
    assert found.tolist() == [1]


def test_equal_limits_act_whatever_the_force() -> None:
    """Also where a value is off."""
    one = np.ones(1)
    found = _separate(0.5 * one, one, one, one, one)
    assert found is not None
    assert found.tolist() == [2]


def test_values_touch_the_nearest_limit_within_reach() -> None:
    """The lower one of two that are as near."""
    values = np.array([0.25, 0.26, 3.75, 3.74, 0.5, 0.5, 0.6, 2.0])
    lower, upper = np.zeros(8), np.array([4.0, 4, 4, 4, 1, 1, 1, 0])
    reach = np.array([0.25, 0.25, 0.25, 0.25, 0.5, 0.4, 0.7, 0.1])
    lower[7] = 0.0
    assert _touch(values, lower, upper, reach).tolist() == [-1, 0, 1, 0, -1, 0, 1, 2]


def test_the_larger_one_of_distance_and_force_decides_and_none_is_weak() -> None:
    """Distances over sizes, forces over the gradient's; both below 1e-8 are weak; equal ones do not act."""
    size, most = np.full(7, 4.0), 2.0
    below = np.array([4.0, 0.0, 4.0, 0.0, 3.6e-8, 4e-8, INF]), np.array([0.0, 2.0, 0.5, 5e-9, 0.0, 0.0, 0.0])
    above = np.full(7, INF), np.zeros(7)
    found, weak = _choose(below, above, size, most)
    assert found.tolist() == [0, -1, 0, -1, 0, 0, 0]
    assert weak.tolist() == [0, 0, 0, 0, -1, 0, 0]
    found, weak = _choose(above, below, size, most)
    assert (found.tolist(), weak.tolist()) == ([0, 1, 0, 1, 0, 0, 0], [0, 0, 0, 0, 1, 0, 0])
    found, weak = _choose((np.array([0.0]), np.array([0.9e-8])), (np.array([INF]), np.zeros(1)), np.ones(1), 1.0)
    assert (found.tolist(), weak.tolist()) == ([0], [-1])


def test_rows_vanish_that_only_fixed_variables_move() -> None:
    J = sparse.csr_array(np.array([[1.0, 5.0], [0.0, 5.0], [-2.0, 0.0], [0.0, 0.0]]))
    two = np.zeros(2)
    limits = Limits(two, np.array([1.0, 0.0]), np.zeros(4), np.zeros(4), np.zeros(2, dtype=np.int64))
    assert _vanish(J, limits).tolist() == [False, True, False, True]


def test_equal_variables_keep_their_tightest_bound_once() -> None:
    """The first one of them, where they are as tight."""
    ties = np.array([0, 1, 0, 2, 1, 0])
    lower, upper = np.array([1.0, 5, 3, 7, 5, 2]), np.array([1.0, 5, 3, 7, 6, 0.5])
    _keep_one(ties, lower, -1.0)
    assert lower.tolist() == [-INF, 5, 3, 7, -INF, -INF]
    _keep_one(ties, upper, 1.0)
    assert upper.tolist() == [INF, 5, INF, 7, INF, 0.5]


def test_variables_are_equal_by_linear_rows_of_both_alone() -> None:
    """x0 = x1 by the first row; others have a limit, a third entry, other factors, a function, or a fixed variable."""
    A = np.array(
        [
            [2.0, -2, 0, 0],
            [0.0, 1, -1, 0],  # within a range
            [0.0, 1, -1, 0],  # of another number
            [1.0, -1, 1, 0],
            [0.0, 1, -2, 0],
            [0.0, 1, 1, 0],
            [0.0, 1, -1, 0],  # a function besides
            [0.0, 0, 1, -1],  # of a fixed one
        ]
    )
    lower, upper = np.zeros(8), np.zeros(8)
    upper[1], lower[2], upper[2] = 1.0, 1.0, 1.0
    block = Block(cast(Any, None), (), np.array([[6]]), np.zeros(1, dtype=np.int64))
    none = sparse.csc_array((4, 4))
    program = Program(sparse.csc_array(A), (none, none), (block,))
    start = Instance(np.zeros(4), np.zeros(0), np.zeros(4), np.ones(4), lower, upper)
    assert _list_equal(program, start).tolist() == [[0, 1], [2, 3]]
    fixed = cast(Any, SimpleNamespace(
        A=program.A, blocks=program.blocks, variables=4, constraints=8,
        kept=np.array([0, 1, 2]), kept_rows=np.arange(8),
    ))  # fmt: skip
    assert _list_equal(fixed, start).tolist() == [[0, 1]]
    start = Instance(np.zeros(4), np.zeros(0), np.zeros(4), np.ones(4), lower - 1.0, upper)
    assert _list_equal(program, start).tolist() == []


@pytest.mark.parametrize(
    ("is_singular", "condition", "negative", "weak", "status"),
    [
        (False, 1e15, 1, 0, SMOOTH),
        (False, 1.1e15, 1, 0, DEPENDENT),
        (True, 1.0, 1, 0, DEPENDENT),
        (False, 1.0, 2, 0, FLAT),
        (False, 1.0, 1, 1, CHANGING),
        (False, 1.0, 1, 2, CHANGING),
    ],
)
def test_a_point_is_judged_by_its_system(
    is_singular: bool, condition: float, negative: int, weak: int, status: str
) -> None:
    """By its condition, by as many negative eigenvalues as rows, and by weak limits of variables or of rows."""
    factors = SimpleNamespace(is_singular=is_singular, measure_condition=lambda: condition, negative=negative)
    open_ = active([int(weak == 1), 0], [0, int(weak == 2)])
    assert _judge(cast(Any, factors), active([0, 1], [0, 2]), open_) == status


def test_systems_have_free_variables_and_chosen_rows() -> None:
    """K = [[H, J'], [J, 0]], of which the lower triangle is listed."""
    whole = np.array([[2.0, 3, 4], [3, 5, 6], [4, 6, 7]])
    hessian = complete(Matrix(sparse.csc_array(np.triu(whole))))
    assert hessian.toarray().tolist() == whole.tolist()
    J = sparse.csr_array(np.array([[1.0, 2, 3], [4, 5, 6]]))
    K = assemble(hessian, J, active([0, 1, 0], [0, -1])).toarray()
    assert K.tolist() == [[2, 0, 0], [4, 7, 0], [4, 6, 0]]


def test_sets_are_joined_and_parted() -> None:
    """The first of two sets has the word where both have a limit."""
    first, second = active([0, 1, -1, 0], [2, 0]), active([-1, -1, 0, 0], [1, 1])
    assert listed(first.together(second)) == ([-1, 1, -1, 0], [2, 1])
    assert listed(first.without(second)) == ([0, 0, -1, 0], [0, 0])
    assert (first.free.tolist(), first.held.tolist(), first.chosen.tolist()) == ([0, 3], [1, 2], [0])
    assert first.is_same(active([0, 1, -1, 0], [2, 0]))
    assert not first.is_same(active([0, 1, -1, 0], [2, 1]))
    assert not first.is_same(active([0, 1, 1, 0], [2, 0]))


def test_active_limits_give_values() -> None:
    """Upper ones where the side is 1, lower ones elsewhere."""
    limits = Limits(
        np.array([1.0, 2, 3, 4]), np.array([5.0, 6, 7, 4]), np.array([-1.0, -2, 8]), np.array([9.0, 10, 8]),
        np.zeros(4, dtype=np.int64),
    )  # fmt: skip
    values, rows = limits.place(active([1, 0, -1, 2], [-1, 1, 2]))
    assert (values.tolist(), rows.tolist()) == ([5, 3, 4], [-1, 10, 8])
    assert [x.tolist() for x in limits.equal] == [[False, False, False, True], [False, False, True]]


def test_limits_are_released_by_forces_of_the_wrong_sign() -> None:
    """By more than 1e-8 of the gradient; a row's multiplier has the other sign than a variable's; equalities stay."""
    for factor, is_free in ((0.99, False), (1.01, True)):
        force = factor * 4e-8
        task = search([-4.0, 2.0], [[0.0, 0.0]] * 4, ranges=[(0, 1)] * 4)
        at = task._evaluate(np.array([-force + 4.0, force - 2.0]))
        at = point._Values(at.x, at.g, np.array([-4.0, 0.0]), sparse.csr_array(np.array([[1.0, 0.0]] * 4)))
        lam = np.array([4.0 - force, 0.0, 0.0, 0.0])
        assert listed(task._release(at, lam, active([-1, 0], [0] * 4)))[0] == [0 if is_free else -1, 0]
        assert listed(task._release(at, lam, active([1, 2], [0] * 4)))[0] == [1, 2]
        lam = np.array([4.0 + force, 0.0, 0.0, 0.0])
        assert listed(task._release(at, lam, active([1, 0], [0] * 4)))[0] == [0 if is_free else 1, 0]
        assert listed(task._release(at, lam, active([-1, 0], [0] * 4)))[0] == [-1, 0]
        lam = np.array([force, -force, -force, force])
        found = listed(task._release(at, lam, active([0, 0], [-1, 1, -1, 1])))[1]
        assert found == ([0, 0, -1, 1] if is_free else [-1, 1, -1, 1])


def test_limits_are_taken_in_where_they_are_passed() -> None:
    """By more than 1e-10 of a size, unless they are weak, or active already."""
    task = search([0.0, 0.0], [[0.0, 0.0]] * 2, [(-4.0, 4.0)] * 2, [(-8.0, 8.0)] * 2, x=[4.0, 0.0])
    none = active([0, 0], [0, 0])
    for factor, side in ((0.9, 0), (1.1, 1)):
        x, g = 4.0 + factor * 4e-10, 8.0 + factor * 8e-10
        near = 4.0 + factor * 1e-10
        for sign in (1, -1):
            at = point._Values(
                sign * np.array([x, near]), sign * np.array([g, 0.0]), np.zeros(2), task._evaluate(np.zeros(2)).J
            )
            assert listed(task._correct(at, np.zeros(2), none, none)) == ([sign * side] * 2, [sign * side, 0])
            weak = active([0, 1], [1, 0])
            assert listed(task._correct(at, np.zeros(2), none, weak)) == ([sign * side, 0], [0, 0])
            weak = active([-sign, 0], [-sign, 0])
            assert listed(task._correct(at, np.zeros(2), weak, none)) == ([-sign, sign * side], [-sign, 0])
    at = point._Values(np.array([4.0, -4.0]), np.array([8.0, -8.0]), np.zeros(2), task._evaluate(np.zeros(2)).J)
    assert listed(task._correct(at, np.zeros(2), none, none)) == listed(none)
    for sign in (1, -1):
        task = search([0.0, 0.0], [[0.0, 0.0]] * 2, [(-0.5, 0.5)] * 2, [(-0.5, 0.5)] * 2)
        edge = sign * np.array([0.5 + 1e-10, 0.0])
        at = point._Values(edge, edge, np.zeros(2), at.J)
        assert listed(task._correct(at, np.zeros(2), none, none)) == listed(none)


def test_limits_that_are_left_out_hold_to_1e_8() -> None:
    """Of sizes, 1 at least; of rows over their limits."""
    task = search([0.0, 0.0], [[1.0, 0.0], [0.0, 1.0]], [(4.0, 9.0), (0.5, 9.0)], [(-9, 8.0), (0.25, 9)], x=[4.0, 0.0])
    at = task._evaluate(np.zeros(2))
    for off, holds in ((0.99e-8, True), (1.01e-8, False)):
        here = point._Values(np.array([4.0 + 4 * off, 0.5 - off]), np.array([8.0 + 8 * off, 0.25 - off]), at.c, at.J)
        for implied in (
            active([-1, 0], [0, 0]),
            active([0, -1], [0, 0]),
            active([0, 0], [1, 0]),
            active([0, 0], [0, -1]),
        ):
            assert task._holds(here, implied) == holds
        assert task._holds(here, active([0, 0], [0, 0]))


def test_touched_limits_are_parted_by_their_forces() -> None:
    """More than 1e-8 of the gradient is a force; equalities have one always, rows that nothing moves never."""
    x = [4.0, 0.0]
    for factor, side in ((0.99, 0), (1.01, 1)):
        force = factor * 4e-8
        task = search([-8.0, 0.0], [[0, 0], [0, 0], [0, 0.0]], [(-9, 4), (0, 0)], [(0, 5), (0, 0), (-1, 1)], x)
        at = task._evaluate(np.array(x))
        at = point._Values(at.x, at.g, at.c, sparse.csr_array(np.array([[0.0, 0], [0, 2], [1, 0]])))
        strong, weak = task._part(at, np.array([force, 0.0, 4.0 - force]))
        assert listed(strong) == ([side, 2], [-side, 0, 0])
        assert listed(weak) == ([1 - side, 0], [side - 1, 0, 0])
    task = search([0.0, 0.0], [[1.0, 0], [0, 1.0]], [(-9, 9)] * 2, [(0, 0), (-2, 2)], [0.0, 2.0])
    assert listed(task._part(task._evaluate(np.array([0.0, 2.0])), np.zeros(2))[0]) == ([0, 0], [2, 0])
    assert listed(task._part(task._evaluate(np.array([0.0, 2.0])), np.zeros(2))[1]) == ([0, 0], [0, 1])


def test_touching_is_within_1e_8_of_a_size() -> None:
    """Of a variable's, and of a row's value, 1 at least."""
    task = search([0.0, 0.0], [[1.0, 0], [0, 1.0]], [(-4, 4), (-0.5, 0.5)], [(-4, 4), (-0.5, 0.5)], [4.0, 0.0])
    for off, side in ((0.99e-8, 1), (1.01e-8, 0)):
        for sign in (1, -1):
            x = sign * np.array([4.0 - 4 * off, 0.5 - off])
            assert listed(task._touch(task._evaluate(x))) == ([sign * side] * 2,) * 2


def test_an_answer_is_read_by_distances_and_scaled_forces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forces times sizes over the largest gradient; a row's has the other sign; rows that nothing moves are open."""
    calls: list[Any] = []

    def separate(*given: Array) -> NDArray[np.int8]:
        calls.append([x.tolist() for x in given])
        return sides(1, 2)

    monkeypatch.setattr(point, "_separate", separate)
    task = search([2.0, -8.0], [[1.0, 0], [0, 4.0]], [(-9, 9), (0, 0)], [(1, 2), (3, 3)], [8.0, 0.5], 0.5)
    found = task._read(np.array([2.0, 1.0]), np.array([3.0, -1.0]))
    assert found is not None
    assert listed(found) == ([1, 2], [1, 0])
    c = [0.5 * (2 + 2), 0.5 * (-8 + 1)]
    zeta, most = [c[0] + 3, c[1] - 4], 3.5
    assert calls[0] == [[2, 1], [-9, 0], [9, 0], [zeta[0] * 8 / most, zeta[1] / most], [8, 1]]
    assert calls[1] == [[2, 4], [1, 3], [2, 3], [-3.0 * 2 / most, 1.0 * 4 / most], [2, 4]]
    task = search([-2.0, -1.0], [[1.0, 0], [0, 1.0]], [(-9, 9)] * 2, [(1, 2), (3, 3)])
    found = task._read(np.array([2.0, 1.0]), np.array([3.0, -1.0]))
    assert found is not None
    assert listed(found) == ([1, 2], [1, 2])
    assert calls[2][3] == [3, -1]  # the gradient is 0: over 1
    doubts: Iterator[Any] = iter([sides(0, 0), None])
    monkeypatch.setattr(point, "_separate", lambda *_: next(doubts))
    assert task._read(np.array([2.0, 1.0]), np.array([3.0, -1.0])) is None


def test_a_guess_has_the_sets_of_its_centre(monkeypatch: pytest.MonkeyPatch) -> None:
    """Distances over sizes and forces over the largest gradient; equal limits act, unless nothing moves the row."""
    big, none = np.full(2, INF), np.zeros(2)
    x = np.array([2.0, 1.0])
    rows = np.array([0.5, 3.0, 3.0]), np.array([1.0, 0.0, 0.0])
    infinite = np.full(3, INF), np.zeros(3)
    centre = Centre(
        x, np.array([7.0, 0, 0]), (np.array([1.0, 1.0]), np.array([0.26, 0.0])), (big, none), rows, infinite
    )
    monkeypatch.setattr(point, "Task", lambda *_: SimpleNamespace(approach=lambda *_: centre))
    task = search([0.0, -1.0], [[1.0, 0], [0, 1], [1.0, 0]], [(0, 9), (1, 1)], [(0, 1), (1, 1), (2, 2)], [4.0, 0.0])
    found = task._guess(x, np.zeros(3))
    assert not isinstance(found, str)
    # variable 0: 0.26 * 4 / 2 = 0.52 > 1 / 4; row 0: 1.0 * 2 / 2 = 1 > 0.5 / 2
    assert (found[0] is x, found[1].tolist()) == (True, [7, 0, 0])
    assert listed(found[2]) == ([-1, 2], [-1, 0, 2])
    assert listed(found[3]) == ([0, 0], [0, 0, 0])
    monkeypatch.setattr(point, "Task", lambda *_: SimpleNamespace(approach=lambda *_: "no end"))
    assert task._guess(x, np.zeros(3)) == "no end"


def test_a_guess_of_a_cost_without_slope_has_forces_over_1(monkeypatch: pytest.MonkeyPatch) -> None:
    big, none = np.full(2, INF), np.zeros(2)
    row = (np.array([INF]), np.zeros(1))
    centre = Centre(none, np.zeros(1), (np.array([0.5, 0.5]), np.array([0.6, 0.4])), (big, none), row, row)
    monkeypatch.setattr(point, "Task", lambda *_: SimpleNamespace(approach=lambda *_: centre))
    found = search([0.0, 0.0])._guess(none, np.zeros(1))
    assert not isinstance(found, str)
    assert listed(found[2]) == ([-1, 0], [0])


def improve(monkeypatch: pytest.MonkeyPatch, steps: Sequence[float], changes: int = 0, size: float = 1.0) -> Any:
    """Return how many steps were made of the given ones, and the status; the first `changes` change the set."""
    task = search([1.0, 1.0], x=[0.0, size])
    made: list[float] = []

    def step(at: Any, *_: object) -> tuple[Array, Array]:
        made.append(steps[len(made)])
        return at.x + np.array([0.0, made[-1] * size]), np.zeros(1)

    def correct(_at: object, _lam: object, given: Active, _weak: object) -> Active:
        return active([1 - given.variables[0], 0], [0]) if len(made) <= changes else given

    monkeypatch.setattr(task, "_step", step)
    monkeypatch.setattr(task, "_correct", correct)
    monkeypatch.setattr(task, "_end", lambda _at, _lam, _active, _weak, status, *_: (len(made), status))
    return task._improve(
        np.array([0.0, 0.0 if size == 1 else size]), np.zeros(1), active([0, 0], [0]), active([0, 0], [0])
    )


def test_newtons_method_ends_with_small_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """1e-10; or at most 1e-7, and no longer a tenth of the one before; with the set as it is; after 15 at most."""
    assert improve(monkeypatch, [1e-10, 0.0]) == (1, SMOOTH)
    assert improve(monkeypatch, [1.1e-10, 0.0]) == (2, SMOOTH)
    assert improve(monkeypatch, [1e-10, 0.0], changes=1) == (2, SMOOTH)
    # a power of 2 is exact after a sum
    assert improve(monkeypatch, [2.0**-24, 2.0**-25, 0.0]) == (2, SMOOTH)
    assert improve(monkeypatch, [2.0**-24, 0.09 * 2.0**-24, 0.0]) == (3, SMOOTH)
    assert improve(monkeypatch, [2.0**-24, 0.11 * 2.0**-24, 0.0]) == (2, SMOOTH)
    assert improve(monkeypatch, [0.99e-7, 0.99e-7, 0.0]) == (2, SMOOTH)
    assert improve(monkeypatch, [1.01e-7, 1.01e-7, 0.0]) == (3, SMOOTH)
    assert improve(monkeypatch, [0.5, 0.5e-9, 0.0]) == (3, SMOOTH)
    assert improve(monkeypatch, [1e-3] * 20) == (15, NOT_CONVERGED)


def test_newtons_method_ends_far_away(monkeypatch: pytest.MonkeyPatch) -> None:
    """At more than ten sizes from the solution, or at no number."""
    assert improve(monkeypatch, [5.0, 5.0, 0.0], size=2.0) == (3, SMOOTH)
    assert improve(monkeypatch, [5.0, 5.1, 0.0], size=2.0) == (2, NOT_CONVERGED)
    assert improve(monkeypatch, [np.nan, 0.0]) == (1, NOT_CONVERGED)


def test_an_end_is_judged_near_the_solution_alone() -> None:
    """Within a tenth of a size; limits that were left out hold; only held variables have forces."""
    for off, status in ((0.099, SMOOTH), (0.101, NOT_CONVERGED)):
        task = search([1.0, 2.0], bounds=[(0, 9)] * 2, x=[4.0, 0.5])
        at = task._evaluate(np.array([4.0 - 4 * off, 0.5]))
        found = task._end(at, np.zeros(1), active([0, -1], [0]), active([0, 0], [0]), SMOOTH)
        assert found.status == status
        assert found.moved == pytest.approx(off)
        assert found.zeta.tolist() == [0, 2.5]
        assert found.directions.shape == (0, 1)
    at = task._evaluate(np.array([4.0, 0.5]))
    none = active([0, 0], [0])
    assert task._end(at, np.zeros(1), none, none, SMOOTH).status == SMOOTH
    assert task._end(at, np.zeros(1), none, none, SMOOTH, active([0, -1], [0])).status == DEPENDENT
    assert task._end(at, np.zeros(1), none, none, FLAT).status == FLAT


def test_limits_of_others_are_left_out_with_their_forces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thinned by the gradient of the Lagrangian; limits without a force (1e-8 of the gradient) stay weak."""
    task = search([-4.0, 2.0], [[1.0, 0], [0, 1.0], [1.0, 1.0]], ranges=[(-9, 9)] * 3)
    seen: list[Any] = []

    def thin(J: Any, variables: Any, rows: Any, lam: Any, zeta: Any) -> Thinned:
        seen.append((J.toarray().tolist(), variables.tolist(), rows.tolist(), lam.tolist(), zeta.tolist()))
        new = np.array([4.0 - 3.9e-8, -2.0 + 4.1e-8, 0.0])
        return Thinned(sides(-1, 1), sides(1, -1, 0), new, np.ones((1, 3)))

    monkeypatch.setattr(point, "thin", thin)
    again = SimpleNamespace(status=DEPENDENT, factors=SimpleNamespace(is_singular=True))

    def record(*given: object) -> Any:
        seen.append(given)
        return again

    monkeypatch.setattr(task, "_improve", record)
    found = task._end(
        task._evaluate(np.zeros(2)), np.zeros(3), active([0, 0], [0] * 3), active([0, 0], [0] * 3), CHANGING
    )
    lam = np.array([1.0, 1.0, 0.5])
    weak = active([-1, 1], [1, -1, 1])
    assert task._leave_out(found, np.zeros(2), lam, active([0, 0], [0] * 3), weak).status == FLAT
    J = [[1.0, 0], [0, 1.0], [1.0, 1.0]]
    assert seen[0] == (J, [-1, 1], [1, -1, 1], lam.tolist(), [-4 + 1.5, 2 + 1.5])
    _, _, kept, open_, implied = seen[1]
    assert listed(open_) == ([-1, 0], [0, 0, 0])
    assert listed(kept) == ([0, 1], [1, -1, 0])
    assert listed(implied) == ([0, 0], [0, 0, 1])
    again.factors.is_singular = False
    assert task._leave_out(found, np.zeros(2), lam, active([0, 0], [0] * 3), weak) is found
    monkeypatch.setattr(point, "thin", lambda *_: None)
    assert task._leave_out(found, np.zeros(2), lam, active([0, 0], [0] * 3), weak) is found


def test_rows_without_a_force_stay_weak_where_others_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """At most 1e-8 of the largest gradient."""
    task = search([-4.0, 2.0], [[0.0, 0], [0, 0], [0, 0]], ranges=[(-9, 9)] * 3)
    seen: list[Any] = []
    new = np.array([3.9e-8, -4.1e-8, 0.0])
    monkeypatch.setattr(point, "thin", lambda *_: Thinned(sides(0, 0), sides(1, -1, 1), new, np.ones((1, 3))))
    again = task._end(task._evaluate(np.zeros(2)), new, active([0, 0], [0] * 3), active([0, 0], [0] * 3), FLAT)
    again = replace(again, status=CHANGING)

    def record(*given: object) -> Any:
        seen.append(given)
        return again

    monkeypatch.setattr(task, "_improve", record)
    weak = active([0, 0], [1, -1, 1])
    found = task._leave_out(again, np.zeros(2), np.zeros(3), active([0, 0], [0] * 3), weak)
    assert listed(seen[0][3]) == ([0, 0], [1, 0, 1])
    assert found.directions.tolist() == [[1, 1, 1]]


def test_a_step_meets_its_limits_and_leaves_no_slope() -> None:
    """Of x'x/2 + c'x: held variables come to bounds, chosen rows to their limits; other rows have no multiplier."""
    task = search([1.0, 2.0], [[1.0, 1.0], [1.0, -1.0]], [(-3, 0.5), (-9, 9)], [(-9, 4), (-9, 9)], [1.0, 1.0])
    at, given = task._evaluate(np.array([1.0, 1.0])), active([1, 0], [1, 0])
    x, lam = task._step(at, np.array([5.0, 6.0]), given, task._factorise(at, np.zeros(2), given))
    assert x == pytest.approx([0.5, 3.5])
    assert lam == pytest.approx([-5.5, 0.0])
