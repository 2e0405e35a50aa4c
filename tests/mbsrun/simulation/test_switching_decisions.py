"""Joints with stops and friction by hand: forces at rest, modes that follow, impacts with their losses, and shares."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.simulation import sharing
from mbsrun.simulation.integration.complementarity import WITHIN, ComplementarityError
from mbsrun.simulation.integration.holding import Inertia
from mbsrun.simulation.integration.joints import Joints
from mbsrun.simulation.integration.switching import _Course
from mbsrun.simulation.motion import Event, Kind, Mode
from mbsrun.simulation.sharing import share

Array = NDArray[np.float64]
FREE, FORWARD, BACKWARD, STICKS, LOWER, UPPER = (
    int(x) for x in (Mode.FREE, Mode.FORWARD, Mode.BACKWARD, Mode.STICKS, Mode.LOWER, Mode.UPPER)
)


def weigh(M: Any) -> Inertia:
    """The inertia of masses without loops."""
    mass = np.array(M, dtype=float)
    inverse = np.linalg.inv(np.linalg.cholesky(mass))
    n = len(mass)
    return Inertia(mass, np.zeros((0, n)), np.arange(n), inverse, inverse, np.zeros((n, 0)))


def make(
    M: Any, push: Any, *, torque: Any = None, static: Any = None, e: Any = None, stops: Any = None, varies: bool = False
) -> tuple[Any, Inertia]:
    """Make a course of joints a, b, ... that forces push; friction where `static` is above 0, stops at places."""
    inertia, f = weigh(M), np.array(push, dtype=float)
    n = len(f)
    zero, none = np.zeros(n), np.zeros(n, dtype=int)
    names: Any = SimpleNamespace(coordinates=[SimpleNamespace(name="abc"[k]) for k in range(n)])
    level = zero if static is None else np.array(static, dtype=float)
    low, high = (zero - np.inf, zero + np.inf) if stops is None else (np.array(x, dtype=float) for x in stops)
    course: Any = _Course.__new__(_Course)
    course.joints = Joints(
        names, tuple(range(n)), low, high, zero if e is None else np.array(e, dtype=float), level > 0,
        level if torque is None else np.array(torque, dtype=float), level, zero, none, none > 0,
    )  # fmt: skip

    def accelerate(_: Any, __: Any, ___: Any, ____: Any, own: Inertia, modes: Any, forces: Array) -> Array:
        return np.linalg.solve(own.M, f + forces - np.where(np.abs(modes) == 1, modes, 0) * course.joints.torque)

    course.forces = SimpleNamespace(accelerate=accelerate, find_work=lambda *_: 0.25)
    course.held, course.released = np.zeros(n), {}
    course.dynamics = SimpleNamespace(course=SimpleNamespace(is_constant=not varies))
    return course, inertia


def decide(course: Any, inertia: Inertia, qd: Any, sides: Any) -> tuple[list[int], list[float]]:
    modes, forces = course.decide(0.0, None, np.array(qd, dtype=float), None, inertia, np.array(sides))
    return modes.tolist(), forces.tolist()


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize(
    ("push", "mode", "near"),
    [
        (0.0, STICKS, False), (0.4, STICKS, False), (-0.4, STICKS, False), (0.5, STICKS, True), (-0.5, STICKS, True),
        (0.6, FORWARD, None), (-0.6, BACKWARD, None),
    ],
)  # fmt: skip
def test_a_joint_sticks_up_to_its_static_friction(size: float, push: float, mode: int, near: bool | None) -> None:
    """It is held by the opposite force; at the most, it is near to sliding, to the side to which it is pushed."""
    course, inertia = make([[2.0]], [size * push], torque=[0.3 * size], static=[0.5 * size])
    modes, forces = decide(course, inertia, [0.0], [0])
    assert modes == [mode]
    assert forces == pytest.approx([-size * push if mode == STICKS else 0.0])
    assert course.locking.tolist() == ([0] if mode == STICKS else [])
    if near is not None:
        free, none = np.array([size * push / 2.0]), np.zeros(1, dtype=int)
        rest = course.balance(inertia, np.array([0]), np.array([[0.5]]), free, none, {})
        assert rest.lam == pytest.approx([-size * push])
        assert (rest.place.tolist(), rest.near.tolist(), rest.is_alone) == ([WITHIN], [near], True)
        room = 0.5 * size - abs(size * push)
        assert rest.slack == pytest.approx([room / (room + abs(size * push))], abs=1e-9)


def test_a_joint_that_was_let_go_slides_where_it_is_near_to_it() -> None:
    """The way of its release; else it has its sliding friction there already."""
    course, inertia = make([[2.0]], [0.5], torque=[0.5], static=[0.5])
    course.released = {0: 1}
    assert decide(course, inertia, [0.0], [0])[0] == [FORWARD]
    course, inertia = make([[2.0]], [0.4], torque=[0.5], static=[0.5])
    course.released = {0: 1}
    assert decide(course, inertia, [0.0], [0])[0] == [STICKS]
    course, inertia = make([[2.0]], [0.4], torque=[0.3], static=[0.5])
    course.released = {0: 1}
    assert decide(course, inertia, [0.0], [0])[0] == [FORWARD]


@pytest.mark.parametrize(
    ("side", "push", "static", "mode", "force"),
    [
        (1, -3.0, 0.0, LOWER, 3.0),
        (1, 3.0, 0.0, FREE, 0.0),
        (-1, 3.0, 0.0, UPPER, -3.0),
        (-1, -3.0, 0.0, FREE, 0.0),
        (1, 0.4, 0.5, LOWER, -0.4),
        (1, 0.6, 0.5, FORWARD, 0.0),
        (-1, -0.6, 0.5, BACKWARD, 0.0),
        (-1, 9.0, 0.5, UPPER, -9.0),
    ],
)
def test_a_stop_presses_away_from_it_alone(side: int, push: float, static: float, mode: int, force: float) -> None:
    course, inertia = make([[2.0]], [push], static=[static])
    assert decide(course, inertia, [0.0], [side]) == ([mode], [pytest.approx(force)])


def test_joints_that_move_keep_their_way_and_joints_without_friction_are_free() -> None:
    course, inertia = make(np.eye(3), [0.0, 0.0, 0.0], static=[1.0, 1.0, 0.0])
    assert decide(course, inertia, [0.5, -0.5, 0.5], [0, 0, 0]) == ([FORWARD, BACKWARD, FREE], [0.0, 0.0, 0.0])
    assert decide(course, inertia, [0.0, -0.5, 0.0], [0, 0, 1]) == ([STICKS, BACKWARD, LOWER], [0.0, 0.0, 0.0])
    assert course.locking.tolist() == [0, 2]


def test_joints_at_rest_share_their_loads_by_the_inertia_between_them() -> None:
    """Joint a slides under 5 with friction 1; the force that holds b is the inertia's, M_ba qdd_a."""
    course, inertia = make([[2.0, 1.0], [1.0, 2.0]], [5.0, 0.0], static=[1.0, 9.0])
    modes, forces = decide(course, inertia, [0.0, 0.0], [0, 0])
    assert modes == [FORWARD, STICKS]
    assert forces == pytest.approx([0.0, (5.0 - 1.0) / 2.0])


# --- impacts --------------------------------------------------------------------------------------------------------


def strike(course: Any, inertia: Inertia, qd: Any, sides: Any, last: Any = None) -> Any:
    return course.strike(1.5, np.array(qd, dtype=float), inertia, np.array(sides), course.joints.restitution, last)


@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("mass", [2.0, 2e-30, 2e30])
def test_a_joint_rebounds_with_a_part_of_its_speed(e: float, side: int, mass: float) -> None:
    """And 1 - e^2 of its energy is lost, at any size of its mass."""
    course, inertia = make([[mass]], [0.0], e=[e])
    found = strike(course, inertia, [-3.0 * side], [side])
    assert found.qd.tolist() == pytest.approx([3.0 * e * side])
    assert found.loss == pytest.approx((1 - e * e) * 9.0 * mass / 2, rel=1e-12, abs=0)
    assert found.events == (Event(1.5, "a", Kind.IMPACT, -3.0 * side, found.qd[0]),)
    assert (found.jump.joints, found.jump.restitution, found.driven) == ((0,), (e,), 0.25)
    assert (found.jump.before.tolist(), found.jump.after.tolist()) == ([-3.0 * side], found.qd.tolist())


def test_joints_that_rest_at_stops_take_part_in_an_impact() -> None:
    """M (w+ - w-) = P: joint b rests at its stop, which pushes only if the hit at a would press it through."""
    for coupling, pushed in ((1.0, True), (-1.0, False)):
        M = np.array([[2.0, coupling], [coupling, 2.0]])
        course, inertia = make(M, [0.0, 0.0], e=[0.0, 0.0])
        found = strike(course, inertia, [-3.0, 0.0], [1, 1])
        jump = found.qd - [-3.0, 0.0]
        impulses = M @ jump
        assert found.qd[0] == pytest.approx(0.0)
        if pushed:
            assert found.qd[1] == pytest.approx(0.0)
            assert impulses == pytest.approx([6.0, 3.0])
            assert [event.joint for event in found.events] == ["a", "b"]
            assert found.jump.joints == (0, 1)
        else:
            assert impulses == pytest.approx([4.5, 0.0])
            assert found.qd[1] > 0
            assert [event.joint for event in found.events] == ["a"]
        energies = [v @ M @ v / 2 for v in (np.array([-3.0, 0.0]), found.qd)]
        assert found.loss == pytest.approx(energies[0] - energies[1])


def test_a_joint_that_comes_to_rest_after_endless_rebounds_rests_at_their_last_time() -> None:
    course, inertia = make([[2.0]], [0.0], e=[0.0])
    found = strike(course, inertia, [-3.0], [1], {0: 1.75})
    assert [(x.time, x.kind) for x in found.events] == [(1.75, Kind.REST)]


def test_a_joint_that_loops_press_through_its_stop_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    course, inertia = make(np.eye(2), [0.0, 0.0])
    monkeypatch.setattr(Inertia, "are_independent", lambda *_: False)

    def fail(*_: Any) -> None:
        raise ComplementarityError

    monkeypatch.setattr("mbsrun.simulation.integration.switching.solve_redundant", fail)
    one = np.ones(2)
    with pytest.raises(ComplementarityError, match=r"press a joint through its stop, of joints a, b$"):
        course.weigh(inertia, np.array([0, 1]), np.eye(2), -one, 0 * one, one, one)


# --- joints that hold each other ------------------------------------------------------------------------------------


def test_of_joints_that_a_loop_locks_the_ones_with_most_slack_hold() -> None:
    """Two joints of one freedom: one holds both."""
    half = np.array([[0.5, 0.5], [0.5, 0.5]])
    inertia = Inertia(np.eye(2), np.array([[1.0, -1.0]]), np.arange(2), np.eye(2), half, np.zeros((2, 1)))
    both = np.array([0, 1])
    assert not inertia.are_independent(both)
    assert inertia.choose(both, np.array([0.25, 0.75])).tolist() == [1]
    assert inertia.choose(both, np.array([0.75, 0.25])).tolist() == [0]
    assert inertia.choose(np.array([1]), np.array([0.5])).tolist() == [1]
    assert inertia.respond(both) == pytest.approx(half)
    assert inertia.measure(both).tolist() == [1.0, 1.0]
    assert inertia.move(np.array([1.0, 3.0])) == pytest.approx([2.0, 2.0])
    free = weigh([[4.0, 0.0], [0.0, 9.0]])
    assert free.are_independent(both)
    assert free.respond(np.array([1])) == pytest.approx(np.array([[0.0], [1 / 9]]))
    assert free.measure(both) == pytest.approx([1 / 4, 1 / 9])


# --- muscles that share a load --------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_passive", [True, False])
def test_muscles_share_what_their_passive_fibres_leave(monkeypatch: pytest.MonkeyPatch, *, is_passive: bool) -> None:
    """Minimise a^2 + (r/R)^2 with r = b + B a: a = -B b/(B^2 + R^2). A residual has the passive pull in it."""
    slope, passive, active, residual, reserve = 0.2, 5.0, 10.0, -4.0, 3.0
    pull = SimpleNamespace(
        slopes=np.full((2, 1, 1), slope), passive=np.full((2, 1), passive), active=np.full((2, 1), active)
    )
    monkeypatch.setattr(sharing, "list_muscles", lambda _: SimpleNamespace(elastic=()))
    monkeypatch.setattr(sharing, "measure_pull", lambda *_: pull)
    monkeypatch.setattr(
        sharing,
        "Dynamics",
        lambda *_: SimpleNamespace(forces_count=0, residual=lambda *_: np.full((2, 1), residual)),
    )
    manifest = SimpleNamespace(driven=(), equations=(), loops=(), coordinates=[SimpleNamespace(name="knee")])
    zero = np.zeros((2, 1))
    motion: Any = SimpleNamespace(t=np.array([0.0, 1.0]), q=zero, qd=zero, qdd=zero, w=np.zeros((2, 0)))
    kernels: Any = SimpleNamespace(manifest=manifest)
    found = share(kernels, motion, reserve=reserve, bounds=(0.0, 1.0), is_passive=is_passive)
    b, B = residual - (0.0 if is_passive else slope * passive), slope * active
    a = -B * b / (B * B + reserve * reserve)
    assert found.activations == pytest.approx(np.full((2, 1), a))
    assert found.reserves == pytest.approx(np.full((2, 1), b + B * a))
    assert found.tensions == pytest.approx(np.full((2, 1), a * active + (passive if is_passive else 0.0)))
    assert (found.coordinates, found.unsolved, found.t.tolist()) == (("knee",), 0, [0.0, 1.0])
    bound = share(kernels, motion, reserve=reserve, bounds=(0.0, 0.25), is_passive=is_passive)
    assert bound.activations == pytest.approx(np.full((2, 1), min(a, 0.25)))
