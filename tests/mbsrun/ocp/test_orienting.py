"""Directions and conditions of axes: against rotation matrices of scipy, and by hand."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mbsrun.ocp.problem.problem import Aims
from mbsrun.ocp.statement import orienting
from mbsrun.ocp.statement.orienting import Condition, list_conditions, point, turn_by, turn_to

Array = NDArray[np.float64]


def stack(aims: Aims | None) -> Array:
    """Return the axes as columns, in order."""
    assert aims is not None
    assert [k for k, _ in aims] == [0, 1, 2]
    return np.array([axis for _, axis in aims]).T


def test_turns_have_the_columns_of_their_matrix() -> None:
    """Turns about x, then y, then z of the base; a quaternion (x, y, z, w) of any length; none of length 0."""
    angles = (0.3, -0.8, 1.9)
    assert stack(turn_by(*angles)) == pytest.approx(Rotation.from_euler("xyz", angles).as_matrix(), abs=1e-15)
    quaternion = np.array([0.2, -1.3, 0.7, 2.1])
    matrix = Rotation.from_quat(quaternion).as_matrix()
    assert stack(turn_to(*quaternion.tolist())) == pytest.approx(matrix, abs=1e-15)
    assert turn_to(0.0, 0.0, 0.0, 0.0) is None
    assert turn_to(0.0, 0.0, 0.0, 3.0) is not None


def test_two_axes_give_the_third_of_a_right_handed_frame() -> None:
    a, b = np.array([2.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.5])
    for i, j, third in ((0, 1, (0, -1, 0)), (1, 2, (0, -1, 0)), (0, 2, (0, 1, 0)), (2, 1, (0, 1, 0))):
        frame = stack(point({i: a, j: b}))
        assert frame[:, i].tolist() == [1, 0, 0]
        assert frame[:, j].tolist() == [0, 0, 1]
        assert frame[:, 3 - i - j] == pytest.approx(third)
        assert np.linalg.det(frame) == pytest.approx(1.0)
    assert point({1: [0.0, 3.0, 4.0]}) == ((1, (0.0, 0.6, 0.8)),)


def test_directions_that_make_no_frame_have_none() -> None:
    """No length, three of them, or an angle that is not right, by more than 1e-9."""
    assert point({0: [0.0, 0.0, 0.0]}) is None
    assert point({0: [1.0, 0.0, 0.0], 1: [0.0, 0.0, 0.0]}) is None
    assert point({k: np.eye(3)[k] for k in range(3)}) is None
    assert point({0: [1.0, 0.0, 0.0], 1: [1.1e-9, 1.0, 0.0]}) is None
    assert point({0: [1.0, 0.0, 0.0], 1: [0.9e-9, 1.0, 0.0]}) is not None


def plant(moved: list[int] | None, attitude: Array, *, columns: bool = True) -> Any:
    """Stand in for a mechanism with two sensors, the second of an attitude of which some entries move."""

    class Plant:
        manifest = SimpleNamespace(configuration=(), positions=(), coordinates=())

        def __call__(self, _name: str, **_: Array) -> dict[str, Array]:
            return {"attitude": np.hstack((np.full((3, 3), 9.0), attitude))}

        def describe(self, _name: str) -> Any:
            own = SimpleNamespace(name="jac_attitude_q", rows=18, row=moved)
            return SimpleNamespace(outputs=[own] if columns else [])

    return Plant()


@pytest.fixture(autouse=True)
def rest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(orienting, "neutral", lambda _: np.zeros(1))


def weigh(text: str, axes: Array) -> float:
    """Evaluate a sum of components x of axis x, written xx_tip, at axes given as columns."""
    known = {f"{a}{b}_tip": float(axes["xyz".index(b), "xyz".index(a)]) for a in "xyz" for b in "xyz"}
    total = 0.0
    for term in text.replace("- ", "+ -").split(" + "):
        number, name = term.split("*")
        total += float(number) * known[name]
    return total


@pytest.mark.parametrize("angle", [0.0, 0.4, -2.0, math.pi])
def test_conditions_of_a_whole_orientation_are_the_sine_along_the_axis_and_the_cosine(angle: float) -> None:
    """Of a turn by an angle about n: sin(a) n = 0, and 1 + 2 cos(a) >= 1."""
    target = Rotation.from_euler("xyz", (0.3, -0.8, 1.9))
    n = np.array([2.0, -1.0, 2.0]) / 3
    axes = (Rotation.from_rotvec(angle * n) * target).as_matrix()
    aims = tuple((k, tuple(target.as_matrix()[:, k].tolist())) for k in range(3))
    found = list(list_conditions(aims, 1, "tip", plant(None, np.zeros((3, 3)))))  # type: ignore[arg-type]
    assert [isinstance(x, Condition) for x in found] == [True] * 4
    values = [weigh(x.expression, axes) for x in found if isinstance(x, Condition)]
    assert values == pytest.approx([*(math.sin(angle) * n), 1 + 2 * math.cos(angle)], abs=1e-14)
    assert [x.range for x in found if isinstance(x, Condition)] == [(0.0, 0.0)] * 3 + [(1.0, math.inf)]


def test_conditions_of_one_axis_are_two_directions_across_and_its_own() -> None:
    t = np.array([2.0, -1.0, 2.0]) / 3
    found = list(list_conditions(((1, (2 / 3, -1 / 3, 2 / 3)),), 1, "tip", plant(None, np.zeros((3, 3)))))
    assert [x.range for x in found if isinstance(x, Condition)] == [(0.0, 0.0), (0.0, 0.0), (0.0, math.inf)]
    rows = np.zeros((3, 3))
    for i, x in enumerate(found):
        assert isinstance(x, Condition)
        rows[i] = [weigh(x.expression, np.outer(e, [0, 1, 0])) for e in np.eye(3)]
        assert "x_" not in x.expression.replace("yx_", "")
    assert rows[2] == pytest.approx(t)
    assert rows @ rows.T == pytest.approx(np.eye(3), abs=1e-15)


def test_components_that_nothing_moves_are_numbers() -> None:
    """A joint about z: axis z stays, which is right or wrong by its angle; an error is left out to 1e-9."""
    moved = [9 + 3 * k + j for k in (0, 1) for j in (0, 1)]
    for lean, errors in ((0.0, []), (0.9e-9, []), (0.5, [0.25, 0.25, 0.5])):
        held = np.eye(3)
        held[:, 2] = (lean, 0.0, 1.0)
        found = list(list_conditions(((2, (0.0, 0.0, 1.0)),), 1, "tip", plant(moved, held)))
        assert [abs(x) for x in found if not isinstance(x, Condition)] == pytest.approx(errors[2:] if lean else [])
    whole = tuple((k, tuple(np.eye(3)[k].tolist())) for k in range(3))
    found = list(list_conditions(whole, 1, "tip", plant(moved, np.eye(3))))  # type: ignore[arg-type]
    assert found == [
        Condition("0.5*xy_tip - 0.5*yx_tip", (0.0, 0.0)),
        Condition("1.0*xx_tip + 1.0*yy_tip", (0.0, math.inf)),
    ]
    fixed = list(list_conditions(whole, 1, "tip", plant([], np.diag([1.0, -1.0, -1.0]))))  # type: ignore[arg-type]
    assert fixed == [pytest.approx(2.0)]  # half a turn: 1 + 2 cos = -1
    still = list(list_conditions(whole, 1, "tip", plant(None, np.eye(3), columns=False)))  # type: ignore[arg-type]
    assert still == []
