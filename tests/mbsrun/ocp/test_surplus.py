"""Conditions that follow from others, by the space of motions that contacts leave: rank, choice and contradiction."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsrun.ocp.problem.problem import End, Unknown
from mbsrun.ocp.statement import surplus
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.surplus import _check_velocities, _choose, _compare, _solve, free_targets
from tests.mbsrun.ocp.plants import push

PROBLEM: Any = SimpleNamespace(name="task")


@pytest.mark.parametrize("freedoms", [1, 2, 3])
def test_as_many_conditions_are_kept_as_there_are_freedoms(freedoms: int, rng: np.random.Generator) -> None:
    """In the order in which they are given; the rows that are kept have full rank."""
    free = np.linalg.qr(rng.standard_normal((6, freedoms)))[0]
    given = [4, 1, 5, 0]
    kept = _choose(free, given)
    assert len(kept) == freedoms
    assert kept == [i for i in given if i in kept]
    assert np.linalg.matrix_rank(free[kept]) == freedoms


def test_conditions_on_motions_that_depend_on_each_other_are_kept_once() -> None:
    """Rows 0 and 1 are one motion; row 2 does not move; a part of a hundred millionth is rounding."""
    free = np.array([[1.0, 0.0], [2.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    assert _choose(free, [0, 1]) == [1]  # the larger one
    assert _choose(free, [0, 2]) == [0]
    assert _choose(free, [2]) == []
    assert _choose(free, [3, 0]) == [3, 0]
    nearly = free.copy()
    nearly[1, 1] = 0.4e-8
    assert _choose(nearly, [0, 1]) == [1]
    nearly[1, 1] = 4e-8
    assert _choose(nearly, [0, 1]) == [0, 1]
    assert _choose(free, [0, 1], {0}) == [0]  # the one that is liked
    assert _choose(free, [0, 1, 3], {0}) == [1, 3]  # which are too few
    assert _choose(free, [0, 1, 2], {0, 2}) == [1]  # or no motion
    assert _choose(free, []) == []
    assert _choose(np.zeros((4, 0)), [0, 1]) == []


def test_velocities_that_contradict_contacts_are_refused() -> None:
    """Velocity 1 is twice velocity 0, and velocity 2 is 0."""
    free = np.array([[1.0], [2.0], [0.0]]) / np.sqrt(5)
    _check_velocities(PROBLEM, free, {0: 1.5, 1: 3.0, 2: 0.0}, [1])
    _check_velocities(PROBLEM, free, {0: 1.5, 1: 3.0 + 1.8e-6}, [1])
    with pytest.raises(ProblemError, match=r"end.velocities: the contacts imply values that differ .* by 0\.5 1/s"):
        _check_velocities(PROBLEM, free, {0: 2.0, 1: 3.0}, [1])


def test_values_differ_by_more_than_rounding() -> None:
    found = np.array([1.0, 2.0, 3.0])
    _compare(PROBLEM, "end.coordinates", {0: 1.0 - 0.9e-6, 2: 3.0 + 0.9e-6}, found, "m")
    for given in ({0: 1.0, 2: 3.25}, {2: 2.75, 0: 1.0}):
        with pytest.raises(ProblemError, match=r"task: end.coordinates: .* by 0\.25 m; give values"):
            _compare(PROBLEM, "end.coordinates", given, found, "m")
    with pytest.raises(ProblemError):
        _compare(PROBLEM, "end.coordinates", {1: 2.0 + 1.1e-6}, found, "m")


def test_steps_to_a_pose_go_half_a_radian_at_most() -> None:
    """For an arc tangent, whole steps go astray; of more unknowns than equations, the change is least."""
    seen: list[float] = []

    def measure(q: Any) -> Any:
        seen.append(float(q[0]))
        return np.arctan(3.0 * (q - 1.0))

    found = _solve(measure, lambda q: np.atleast_2d(3.0 / (1 + 9.0 * (q - 1.0) ** 2)), np.array([4.0]))
    assert found == pytest.approx([1.0], abs=1e-12)
    assert np.abs(np.diff(seen)).max() == pytest.approx(0.5)
    plane = _solve(lambda q: np.array([q @ [1.0, 2.0] - 5.0]), lambda _: np.array([[1.0, 2.0]]), np.zeros(2))
    assert plane == pytest.approx([1.0, 2.0], abs=1e-12)


# --- targets that follow from driven joints -------------------------------------------------------------------------


def free(*targets: tuple[float | None, ...], driven: tuple[int, ...] = (0,), **given: Any) -> Any:
    """Free targets of the sensor at (q0, q1, q0 + q1), near (2, 3); joint 0 is driven."""
    slopes = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])

    def call(name: str, q: Any) -> dict[str, Any]:
        assert q.tolist() == [2.0, 3.0]
        return {"position": (slopes @ q)[:, None]} if name == "sensors" else {"jac_position_q": slopes}

    class Kernels:
        manifest = SimpleNamespace(
            driven=driven, coordinates=("a", "b"), quaternions=given.pop("quaternions", ()), loops=(),
            frames=[SimpleNamespace(name="body", sensor=False), SimpleNamespace(name="tip", sensor=True)],
        )  # fmt: skip

        def __call__(self, name: str, q: Any) -> dict[str, Any]:
            return call(name, q)

    end = End(sensors=tuple(("tip", target) for target in targets))  # type: ignore[misc]
    problem = replace(push(2), end=end, **given)
    plant: Any = Kernels()
    found = free_targets(problem, plant, np.array([2.0, 3.0]))
    return [target for _, target in found.end.sensors]


def test_targets_that_a_driven_joint_meets_are_freed(monkeypatch: pytest.MonkeyPatch) -> None:
    """One freedom is left, so one of the targets that it moves is kept: the one that moves most, or the first."""
    monkeypatch.setattr(surplus, "find_closure", lambda _: None)
    assert free((2.0, 3.0, 5.0)) == [(None, 3.0, None)]
    assert free((2.0, None, 5.0)) == [(None, None, 5.0)]
    assert free((2.0, None, None), (None, 3.0, None)) == [(None, None, None), (None, 3.0, None)]


def test_no_target_is_freed_where_it_is_met_by_chance_or_not_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without driven joints, with a motion that is open, as few as freedoms, away from the pose, or without rank."""
    monkeypatch.setattr(surplus, "find_closure", lambda _: None)
    every = (2.0, 3.0, 5.0)
    for target, given in (
        (every, {"driven": ()}),
        (every, {"horizon_range": (0.5, 2.0)}),
        (every, {"unknowns": (Unknown("n"),)}),
        (every, {"quaternions": (0,)}),
        ((None, 3.0, None), {}),
        ((2.0, 3.1, 5.0), {}),
        ((2.0, None, None), {"driven": (0, 1)}),
    ):
        assert free(target, **given) == [target if given.get("driven") != (0, 1) else (None, None, None)]


def test_loops_take_freedoms_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """With joint 1 fixed by a loop, nothing is left to choose."""
    monkeypatch.setattr(surplus, "find_closure", lambda _: SimpleNamespace(jacobian=lambda _: np.array([[0.0, 1.0]])))
    assert free((2.0, 3.0, None)) == [(None, None, None)]
