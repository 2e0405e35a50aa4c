"""The movement of an optimum with a number: what keeps it from having derivatives."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mbsrun.ocp.optima.movement import Movement, Numbers
from mbsrun.ocp.optima.point import Active
from mbsrun.ocp.optima.status import SMOOTH, SPLIT, STUCK

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
