"""The movement of an optimum with a number: what keeps it from having derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.optima.movement import (
    Movement,
    Numbers,
    _reach,
    _stack,
    find_openings,
    measure_step,
    take_differences,
)
from mbsrun.ocp.optima.point import Active
from mbsrun.ocp.optima.status import CHANGING, DEPENDENT, FLAT, SMOOTH, SPLIT, STUCK

Array = NDArray[np.float64]
NONE = np.zeros(0)


@pytest.mark.parametrize(
    ("value", "least", "most", "status"),
    [
        (0.5, 0.5, 0.5, SMOOTH),  # it stays met
        (-0.5, -0.5, -0.5, SMOOTH),
        (0.5, -0.5, -0.5, STUCK),
        (0.0, 0.5, 0.5, STUCK),
        (0.5, 0.0, 0.0, STUCK),
        (0.0, 0.0, 0.5, STUCK),  # the equality becomes a range
    ],
)
def test_an_equality_that_no_variable_moves_must_stay_met(value: float, least: float, most: float, status: str) -> None:
    """Its value changes by `value` of the number, its limits by `least` and `most`."""
    change = Numbers(np.ones(1), np.zeros(1), np.zeros(1), np.array([least]), np.array([most]))
    limits = SimpleNamespace(least=np.array([1.0]), most=np.array([1.0]))
    active = Active(np.zeros(1, dtype=np.int8), np.zeros(1, dtype=np.int8))
    movement = SimpleNamespace(
        changes=[change],
        _given=[change],
        optimum=SimpleNamespace(active=active, limits=limits),
        push=lambda _: (NONE, np.array([value])),
        _examine_set=lambda *_: SMOOTH,
    )
    assert Movement.examine(movement, 0) == status  # type: ignore[arg-type]


def test_limits_of_an_equality_that_part_have_no_derivative() -> None:
    """Of a variable with both limits active; a number that changes nothing is smooth."""
    active = Active(np.array([2], dtype=np.int8), np.zeros(0, dtype=np.int8))
    limits = SimpleNamespace(least=NONE, most=NONE)
    for lower, upper, status in ((0.0, 1.0, SPLIT), (1.0, 1.0, SMOOTH), (0.0, 0.0, SMOOTH)):
        change = Numbers(np.zeros(1), np.array([lower]), np.array([upper]), NONE, NONE)
        movement = SimpleNamespace(
            changes=[change],
            _given=[change],
            optimum=SimpleNamespace(active=active, limits=limits),
            push=lambda _: (NONE, NONE),
            _examine_set=lambda *_: SMOOTH,
        )
        assert Movement.examine(movement, 0) == status  # type: ignore[arg-type]


def sides(*given: int) -> NDArray[np.int8]:
    return np.array(given, dtype=np.int8)


def numbers(
    lower: Sequence[float] = (),
    upper: Sequence[float] = (),
    least: Sequence[float] = (),
    most: Sequence[float] = (),
    parameters: Sequence[float] = (),
) -> Numbers:
    return Numbers(*(np.array(part, dtype=float) for part in (parameters, lower, upper, least, most)))


def test_differences_are_of_order_four() -> None:
    """Exact for polynomials of degree 4, at any step; limits that are infinite anywhere stay."""
    (found,) = take_differences(lambda t: [np.array([3 + 2 * t + 5 * t**2 - 7 * t**3 + 11 * t**4])], 0.1)
    assert found.tolist() == [pytest.approx(2.0, abs=1e-12)]
    (one,) = take_differences(lambda t: [np.array([3 * t, np.inf, np.inf if t > 0.15 else t])], 0.1)
    assert one.tolist() == [pytest.approx(3.0), 0.0, 0.0]


def test_a_number_reaches_as_far_as_its_first_gap() -> None:
    """Either way; gaps that do not move, or are infinite, do not count."""
    assert _reach(np.array([3.0, 1.0, 0.5, np.inf]), np.array([-6.0, 4.0, 0.0, 1.0])) == 0.25
    assert _reach(np.array([1.0]), np.array([0.0])) == np.inf
    assert _reach(NONE, NONE) == np.inf


def test_steps_of_differences_are_a_thousandth_of_the_change() -> None:
    """Over the size of a variable, 1 at least."""
    assert measure_step(np.array([2.0, -8.0]), np.array([0.1, -16.0])) == 1e-3 / 2
    assert measure_step(np.array([0.5, -8.0]), np.array([0.1, -4.0])) == 1e-3 / 2
    assert measure_step(np.zeros(2), np.ones(2)) == 1e-3
    assert measure_step(NONE, NONE) == 1e-3


def test_columns_are_stacked() -> None:
    assert _stack([np.array([1.0, 2]), np.array([3.0, 4])], 2).tolist() == [[1, 3], [2, 4]]
    assert _stack([], 3).shape == (3, 0)


def opened(variables: Sequence[int], rows: Sequence[int], jacobian: Array) -> Any:
    implied, none = (
        Active(sides(*variables), sides(*rows)),
        Active(sides(*[0] * len(variables)), sides(*[0] * len(rows))),
    )
    return SimpleNamespace(implied=implied, weak=none, jacobian=sparse.csc_array(jacobian))


def open_implied(optimum: Any, change: Numbers, rows: Array, dx: Array) -> Array:
    return find_openings(optimum, optimum.implied, change, rows, dx)


def test_implied_limits_open_by_their_own_motion_less_what_moves_them() -> None:
    """Outwards is positive: an upper limit rises, a lower one falls; over the largest change of all."""
    optimum = opened([1, -1, 0], [-1, 0, 1], np.array([[1.0, 0, 2], [9, 9, 9], [0, 3, 0]]))
    change = numbers([1, 2, 3], [4, 5, 6], [7, 8, 9], [10, 11, 12])
    dx, rows = np.array([0.5, -1.0, 2.0]), np.array([0.25, 70.0, -0.5])
    expected = [4 - 0.5, -(2 + 1.0), -(7 - (0.5 + 4 + 0.25)), 12 - (-3 - 0.5)]
    assert open_implied(optimum, change, rows, dx) == pytest.approx(np.array(expected) / 70)
    none = numbers([0] * 3, [0] * 3, [0] * 3, [0] * 3)
    assert open_implied(optimum, none, np.zeros(3), np.zeros(3)).tolist() == [0] * 4
    # lower rows at their least, upper ones at their most
    assert open_implied(
        opened([0] * 3, [1, 0, -1], np.zeros((3, 3))), change, np.zeros(3), np.zeros(3)
    ) == pytest.approx([10 / 12, -9 / 12])
    assert open_implied(
        opened([-1, 0, 1], [0] * 3, np.zeros((3, 3))), change, np.zeros(3), np.zeros(3)
    ) == pytest.approx([-1 / 12, 6 / 12])


def examine(
    change: Numbers | None, variables: Sequence[int], rows: Sequence[int], ranges: Sequence[tuple[float, float]] = ()
) -> str:
    least, most = np.array(ranges, dtype=float).reshape(-1, 2).T
    movement = SimpleNamespace(
        changes=[change],
        _given=[change],
        optimum=SimpleNamespace(
            active=Active(sides(*variables), sides(*rows)), limits=SimpleNamespace(least=least, most=most)
        ),
        push=lambda _: (NONE, np.zeros(len(rows))),
        _examine_set=lambda k, same: f"{k} {same:g}",
    )
    return Movement.examine(cast(Any, movement), 0)


def test_what_ought_to_be_equal_may_differ_by_a_billionth() -> None:
    """Of the largest change, in any part of the numbers."""
    assert examine(None, [], []) == SPLIT
    for apart, found in ((0.9e-9, "0 4e-09"), (1.1e-9, SPLIT)):
        off = 4 * apart
        assert examine(numbers([1.0], [1.0 + off], parameters=[-4.0]), [2], []) == found
        assert examine(numbers(least=[1.0], most=[1.0 + off], lower=[4.0], upper=[0.0]), [0], [2], [(0, 0)]) == found
        stuck = STUCK if found == SPLIT else found
        assert examine(numbers(least=[off], most=[off], upper=[4.0], lower=[0.0]), [0], [0], [(0, 0)]) == stuck
        assert examine(numbers(least=[0.0], most=[off], upper=[4.0], lower=[0.0]), [0], [0], [(0, 0)]) == stuck
    assert examine(numbers(least=[1.0], most=[2.0]), [], [0], [(0, 1)]) == "0 2e-09"
    assert examine(numbers(least=[1.0], most=[1.0]), [], [2], [(0, 0)]) == "0 1e-09"
    assert examine(numbers([0.0], [0.0]), [2], []) == SMOOTH


@pytest.mark.parametrize(
    ("parts", "opens", "spans", "bends", "status"),
    [
        (True, False, (), False, CHANGING),
        (False, True, (), False, CHANGING),
        (False, False, (2.0,), False, SMOOTH),
        (False, False, (2.1,), False, CHANGING),
        (False, False, (1.9,), True, DEPENDENT),
        (False, False, (), True, DEPENDENT),
        (False, False, (), False, SMOOTH),
    ],
)
def test_a_set_must_stay_for_the_span_of_a_number(
    parts: bool, opens: bool, spans: tuple[float, ...], bends: bool, status: str
) -> None:
    movement = SimpleNamespace(
        _given=[None],
        spans=spans,
        _parts_copies=lambda *_: parts,
        _opens_some=lambda _: opens,
        measure_reach=lambda _: 2.0,
        _bends=lambda _: bends,
    )
    assert Movement._examine_set(cast(Any, movement), 0, 1e-9) == status


@pytest.mark.parametrize(("opening", "opens"), [(0.9e-8, False), (-1.1e-8, True), (1.1e-8, True)])
def test_a_limit_opens_by_more_than_rounding(opening: float, opens: bool) -> None:
    """One that others imply, or one without a force."""
    change = numbers([0.0], [0.0], [opening], [1.0])
    implied = opened([0], [-1], np.zeros((1, 1)))
    for optimum in (implied, SimpleNamespace(**{**vars(implied), "implied": implied.weak, "weak": implied.implied})):
        movement = SimpleNamespace(
            optimum=optimum, _given=[change], _pushed=[(NONE, np.zeros(1))], move=lambda _: np.zeros(1)
        )
        assert Movement._opens_some(cast(Any, movement), 0) is opens


@pytest.mark.parametrize(("side", "name"), [(-1, "lower"), (1, "upper")])
def test_copies_of_a_variable_keep_equal_bounds(side: int, name: str) -> None:
    """Bounds of variables that a row makes equal, one of which is active: where they are equal, they move alike."""
    start = {"lower": np.array([1.0, 1.0, 2.0, 1.0]), "upper": np.array([1.0, 1.0, 2.0, 1.0])}
    for moved, parts in (
        ([3.0, 3.0, 3.0, 3.0], False),
        ([3.0, 3.0 + 0.9e-9, 3.0, 3.0], False),
        ([3.0, 3.0 - 1.1e-9, 3.0, 3.0], True),
        ([3.0, 3.0, 9.0, 3.0], False),  # of other bounds
        ([3.0, 3.0, 3.0, 9.0], False),  # of another variable
    ):
        other = {"lower": [0.0] * 4, "upper": [0.0] * 4, name: moved}
        optimum = SimpleNamespace(
            active=Active(sides(0, side, 0, 0), sides()),
            limits=SimpleNamespace(ties=np.array([1, 1, 1, 0])),
            instance=SimpleNamespace(**start),
        )
        movement = cast(Any, SimpleNamespace(optimum=optimum))
        assert Movement._parts_copies(movement, numbers(**other), 1e-9) is parts
    idle = SimpleNamespace(
        active=Active(sides(0, -side, 0, 2), sides()), limits=optimum.limits, instance=optimum.instance
    )
    other[name] = [3.0, 7.0, 3.0, 3.0]
    assert Movement._parts_copies(cast(Any, SimpleNamespace(optimum=idle)), numbers(**other), 1e-9) is False


def test_a_reach_is_the_first_change_of_the_set() -> None:
    """Distances of open limits over the rates at which they close, and forces of held ones over theirs.

    x0 is free, x1 at its upper limit, x2 at both; row 0 is free, row 1 at its least.
    """
    J = np.array([[1.0, 0, 0], [0, 0, 2.0]])
    optimum = SimpleNamespace(
        active=Active(sides(0, 1, 2), sides(0, -1)),
        weak=Active(sides(0, 0, 0), sides(0, 0)),
        implied=Active(sides(0, 0, 0), sides(0, 0)),
        x=np.array([1.0, 5.0, 0.0]),
        values=np.array([3.0, 0.0]),
        zeta=np.array([0.0, -6.0, 1e-9]),
        multipliers=np.array([0.0, -8.0]),
        jacobian=sparse.csc_array(J),
        hessian=sparse.csc_array(np.diag([1.0, 0.5, 1.0])),
        limits=SimpleNamespace(
            lower=np.array([-3.0, -1e-9, 0]), upper=np.array([np.inf, 5, 0]), least=np.array([-9.0, 0]),
            most=np.array([9.0, 1e-9]),
        ),
    )  # fmt: skip
    active = optimum.active

    def reach(dx: Array, dlam: float, force: Array, rows: Array, change: Numbers, **given: Any) -> float:
        optimum.__dict__.update(given)
        movement = SimpleNamespace(
            optimum=optimum,
            _given=[change],
            move=lambda _: dx,
            _solved=np.array([[dx[0]], [dlam]]),
            _pushed=[(force, rows)],
        )
        return Movement.measure_reach(cast(Any, movement), 0)

    assert (active.free.tolist(), active.chosen.tolist()) == ([0], [1])
    still, none, zero = numbers([0] * 3, [0] * 3, [0] * 2, [0] * 2), np.zeros(3), np.zeros(2)
    # x0 falls by 2, to -3 from 1; row 0 falls by 2, to -9 from 3
    assert reach(np.array([-2.0, 0, 0]), 0.0, none, zero, still) == 2.0
    # its limit comes nearer by 3
    change = numbers([3.0, 0, 0], [0] * 3, [0] * 2, [0] * 2)
    assert reach(np.array([-2.0, 0, 0]), 0.0, none, zero, change) == pytest.approx(4 / 5)
    # the row moves by itself: 6 to its most
    assert reach(none, 0.0, none, np.array([3.0, 0]), still) == 2.0
    change = numbers([0] * 3, [0] * 3, [0] * 2, [-9.0, 0])
    assert reach(none, 0.0, none, np.array([3.0, 0]), change) == 0.5
    # the force of x1: 6, by 2 of the number, 1 of its motion; of x2, an equality, none counts
    assert reach(np.array([0.0, 2.0, 0]), 0.0, np.array([0, 2.0, 9.0]), zero, still) == pytest.approx(2.0)
    # the multiplier of row 1
    assert reach(none, 32.0, none, zero, still) == 0.25
    weak = Active(sides(1, 0, 0), sides(0, 0))
    assert reach(np.array([-2.0, 0, 0]), 0.0, none, zero, still, weak=weak) == 3.0  # row 0 alone
    weak, implied = Active(sides(1, 0, 0), sides(0, 0)), Active(sides(0, 0, 0), sides(-1, 0))
    assert reach(np.array([-2.0, 0, 0]), 0.0, none, zero, still, weak=weak, implied=implied) == np.inf


def test_rates_combine_changes() -> None:
    """Numbers that stand still are left out; nothing moves where all do."""
    a, b = numbers([1.0], [2.0], [3.0], [4.0], [5.0]), numbers([10.0], [20.0], [30.0], [40.0], [50.0])
    instance = SimpleNamespace(
        parameters=np.ones(1), lower=np.ones(1), upper=np.ones(1), g_lower=np.ones(1), g_upper=np.ones(1)
    )
    movement = Movement(cast(Any, None), cast(Any, SimpleNamespace(instance=instance)), (a, None, b))
    found = movement.combine(np.array([2.0, 7.0, -1.0]))
    assert [part.tolist() for part in found.parts] == [[-40], [-8], [-16], [-24], [-32]]
    assert [part.tolist() for part in movement.combine(np.zeros(3)).parts] == [[0]] * 5


def test_a_cost_has_derivatives_where_multipliers_are_unique() -> None:
    """w' terms - multipliers' limits + zeta' bounds + the slope by constants, with the scale of the cost taken off."""
    optimum = SimpleNamespace(
        status=CHANGING, x=None, scale=0.5, instance=SimpleNamespace(parameters=np.array([1.0, 2.0, 0.3])),
        multipliers=np.array([7.0, 3.0]), zeta=np.array([0.0, -4.0]), active=Active(sides(0, -1), sides(0, 2)),
    )  # fmt: skip
    change = numbers(parameters=[2.0, 0.5, 6.0])
    movement = SimpleNamespace(
        optimum=optimum,
        status=CHANGING,
        changes=[change] * 3,
        prepared=SimpleNamespace(numpy=SimpleNamespace(terms=lambda *_: np.array([10.0, 100.0]))),
        _given=[change] * 3,
        _weights=2,
        _limits=np.array([[0.25, 0.25, 0.25]]),
        _held=np.array([[8.0, 8.0, 8.0]]),
        _by_constants=SimpleNamespace(slope=np.array([0.125])),
        _statuses=[SMOOTH, CHANGING, DEPENDENT],
    )
    found = Movement.find_costs(cast(Any, movement))
    total = (0.5 * (20 + 50) - 3 * 0.25 - 4 * 8 + 0.125 * 6) / 0.5
    assert found[:2] == pytest.approx([total, total])
    assert np.isnan(found[2])
    movement.status = FLAT
    assert np.isnan(Movement.find_costs(cast(Any, movement))).all()


@pytest.mark.parametrize(("size", "bends"), [(0.9e-6, False), (1.1e-6, True)])
def test_a_derivative_bends_by_a_millionth(size: float, bends: bool) -> None:
    """By a direction of multipliers as large as the largest one; multipliers that turn no variable do not count."""
    seen: list[Array] = []

    def curve(direction: Array, dx: Array, constants: Array) -> Array:
        seen.append(direction)
        assert constants.tolist() == [5.0]
        return np.array([dx[0], 3.0])

    optimum = SimpleNamespace(
        active=Active(sides(0, 1), sides(2, 1)),
        directions=np.array([[0.5, -2.0]]),
        multipliers=np.array([4.0, -6.0]),
        factors=SimpleNamespace(solve=lambda b: np.array([-size * b[0], 9.0, 9.0])),
    )
    movement = SimpleNamespace(
        optimum=optimum,
        _weights=1,
        _given=[numbers(parameters=[1.0, 5.0])],
        move=lambda _: np.array([-2.0, 0.5]),
        _curve_rows=curve,
    )
    assert Movement._bends(cast(Any, movement), 0) is bends
    assert np.abs(seen[0]).tolist() == [pytest.approx(1.5), pytest.approx(6.0)]
    optimum.directions = np.zeros((0, 2))
    assert Movement._bends(cast(Any, movement), 0) is False
