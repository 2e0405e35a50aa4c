"""The decisions of motions with rigid contacts, each at a particle whose numbers are worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.kernel import KernelError, Place
from mbsrun.limits import Allowance, Limits
from mbsrun.simulation import Kind
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.integration.contacts import Mode, State
from mbsrun.simulation.integration.stepwise import LOOKS
from mbsrun.simulation.integration.tableaus import EULER, RK4, RK45, Pair
from mbsrun.simulation.integration.touching import Bound, Guard, TouchingCourse, _lift, _name_change
from mbsrun.simulation.motion import Chunk, Event, HaltError, Impacts, Settings
from tests.mbsrun.simulation.particles import Floor, Particles, drop, wait

Array = NDArray[np.float64]
OPEN, STICK, SLIP = State.OPEN, State.STICK, State.SLIP
PIECE = wait(0.0, 1.0)
INSIDE = KernelError("touching", Place(None, None, 1), 0)


def course(dynamics: Any, pair: Pair = RK4, **settings: Any) -> TouchingCourse:
    return TouchingCourse(dynamics, pair, Settings(1.0, **settings))


def mode(*states: State, way: tuple[float, float, float] = (1.0, 0.0, 0.0)) -> Mode:
    return Mode(states, np.tile(way, (len(states), 1)), np.ones(len(states)))


def events(found: TouchingCourse) -> list[tuple[Kind, float, float]]:
    return [(event.kind, event.before, event.after) for event in found.passed]


def allowance() -> Allowance:
    return Allowance(Limits())


def test_a_point_as_near_as_a_hundredth_of_a_nanometre_is_put_on_the_floor_and_hits_it() -> None:
    """Of the kinetic energy, 1 - e^2 is lost; a point farther away falls on."""
    motion = course(drop(Floor(restitution=0.5)))
    q, qd = motion.settle(0.0, PIECE, np.array([3.0, 1e-11]), np.array([2.0, -4.0]))
    assert q.tolist() == [3.0, 0.0]
    assert qd.tolist() == [2.0, 2.0]
    assert events(motion) == [(Kind.IMPACT, -4.0, 2.0)]
    assert motion.loss == pytest.approx(0.5 * 16 * 0.75)
    assert motion.fastest == 4.0
    assert motion.mode is not None
    assert motion.mode.states == (OPEN,)
    above = course(drop(Floor(restitution=0.5)))
    start = np.array([3.0, 1.01e-11])
    q, qd = above.settle(0.0, PIECE, start, np.array([2.0, -4.0]))
    assert (q.tolist(), qd.tolist(), above.passed, above.loss) == (start.tolist(), [2.0, -4.0], (), 0.0)


def test_a_point_at_rest_presses_and_rounding_of_its_velocity_goes() -> None:
    """As slow as 1e-11 of the fastest velocity so far is at rest: no impact; faster is an impact."""
    motion = course(drop(Floor()))
    motion.fastest = motion.reach = 2.0
    _, qd = motion.settle(0.0, PIECE, np.zeros(2), np.array([1.0, -1.9e-11]))
    assert qd.tolist() == [1.0, 0.0]
    assert (motion.passed, motion.loss, motion.fastest) == ((), 0.0, 2.0)
    assert motion.mode is not None
    assert motion.mode.states == (SLIP,)
    motion = course(drop(Floor()))
    motion.fastest = motion.reach = 2.0
    motion.settle(0.0, PIECE, np.zeros(2), np.array([1.0, -2.1e-11]))
    assert events(motion) == [(Kind.IMPACT, -2.1e-11, 0.0)]
    rising = course(drop(Floor()))
    assert rising.settle(0.0, PIECE, np.zeros(2), np.array([0.0, 1.0]))[1].tolist() == [0.0, 1.0]
    assert rising.mode is not None
    assert rising.mode.states == (OPEN,)


@pytest.mark.parametrize(("speed", "is_last"), [(2.7e-6, True), (2.9e-6, False)])
def test_a_rebound_below_a_tenth_of_a_picometre_is_the_last_one(speed: float, is_last: bool) -> None:
    """It rises by (e v)^2/(2 g); the rebounds after it, of 2 e v/g (1 + e + ...), end at 2 e v/(g (1 - e))."""
    motion = course(drop(Floor(restitution=0.5)))
    _, qd = motion.settle(0.0, PIECE, np.zeros(2), np.array([0.0, -speed]))
    (event,) = motion.passed
    if is_last:
        assert (event.kind, event.before, event.after, qd[1]) == (Kind.REST, -speed, 0.0, 0.0)
        assert event.time == pytest.approx(speed / 2 * 2 / 10 / 0.5, rel=1e-9, abs=0)
        assert motion.loss == pytest.approx(speed**2 / 2, rel=1e-9, abs=0)
    else:
        assert (event.kind, event.time, qd[1]) == (Kind.IMPACT, 0.0, pytest.approx(speed / 2, rel=1e-9))
        assert motion.loss == pytest.approx(speed**2 / 2 * 0.75, rel=1e-9, abs=0)


@pytest.mark.parametrize(("speed", "is_last"), [(1.9e-3, True), (2.1e-3, False)])
def test_only_a_rebound_slower_than_a_millimetre_per_second_is_the_last_one(speed: float, is_last: bool) -> None:
    """However low it rises, as it does where the pull is 1e7."""
    motion = course(drop(Floor(restitution=0.5), pull=(0.0, -1e7)))
    motion.settle(0.0, PIECE, np.zeros(2), np.array([0.0, -speed]))
    assert (motion.passed[0].kind is Kind.REST) == is_last


def test_points_at_rest_hold_while_others_rebound() -> None:
    """Two coupled points: while one rests, the other falls by f2/M22, not by the free (M^-1 f)_2."""
    M = ((1.0, 0.5), (0.5, 1.0))
    floors = Floor((1.0, 0.0), name="a"), Floor((0.0, 1.0), restitution=0.5, name="b")
    motion = course(drop(*floors, pull=(-10.0, -10.0), M=M))
    motion.settle(0.0, PIECE, np.zeros(2), np.array([0.0, -1e-6]))
    last = next(event for event in motion.passed if event.joint == "b")
    assert last.kind is Kind.REST
    assert last.time == pytest.approx(2 * 0.5e-6 / 10 / 0.5, rel=1e-6, abs=0)


def test_two_points_without_rebound_come_to_rest_beside_one_that_rebounds() -> None:
    floors = Floor((1.0, 0.0), name="a"), Floor((0.0, 1.0), restitution=0.5, name="b")
    motion = course(drop(*floors, pull=(-10.0, -10.0)))
    _, qd = motion.settle(0.0, PIECE, np.zeros(2), np.array([-1e-6, -1e-6]))
    kinds = {event.joint: event.kind for event in motion.passed}
    assert kinds == {"a": Kind.IMPACT, "b": Kind.REST}
    assert qd.tolist() == [0.0, 0.0]


def test_after_a_hundred_impacts_at_one_time_nothing_rebounds_and_a_thousand_are_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bounces: list[bool] = []

    def hit(*given: Any, bounces: bool, seen: list[bool] = bounces) -> tuple[Array, list[Event]]:
        seen.append(bounces)
        return given[4], []

    monkeypatch.setattr(TouchingCourse, "hit", hit)
    with pytest.raises(HaltError, match="1000 impacts at one time"):
        course(drop()).settle(0.0, PIECE, np.zeros(2), np.array([0.0, -1.0]))
    assert bounces == [True] * 100 + [False] * 900


def test_without_bounces_an_impact_has_no_rebound() -> None:
    motion = course(drop(Floor(restitution=1.0)))
    q, qd, M = np.zeros(2), np.array([0.0, -1.0]), np.eye(2)
    touch, near, speed = motion.contacts.touch(q[None], qd[None]), np.array([0]), np.array([-1.0])
    for bounces, end in ((True, 1.0), (False, 0.0)):
        after, found = motion.hit(0.0, PIECE, q, qd, M, touch, near, speed, bounces=bounces)
        assert after[1] == end
        assert [(event.kind, event.after) for event in found] == [(Kind.IMPACT, end)]


def test_a_point_that_an_impact_elsewhere_presses_is_part_of_it_and_one_that_it_frees_is_not() -> None:
    """The neighbour rests; by a coupling of +0.5 the impulse takes it down, by one of -0.5 up."""
    for coupling, named in ((0.5, ["a", "b"]), (-0.5, ["b"])):
        floors = Floor((1.0, 0.0), name="a"), Floor((0.0, 1.0), restitution=0.0, name="b")
        motion = course(drop(*floors, pull=(-10.0, -10.0), M=((1.0, coupling), (coupling, 1.0))))
        motion.settle(0.0, PIECE, np.zeros(2), np.array([0.0, -1.0]))
        assert [event.joint for event in motion.passed if event.kind is Kind.IMPACT] == named


def test_a_curved_side_pulls_a_point_down_besides() -> None:
    """By 5 m/s^2 beside 10: the last rebound ends earlier."""
    motion = course(drop(Floor(restitution=0.5)))
    touch = motion.contacts.touch
    setattr(motion.contacts, "touch", lambda *given: replace(touch(*given), pull=np.array([[-5.0]])))  # noqa: B010
    motion.settle(0.0, PIECE, np.zeros(2), np.array([0.0, -1e-6]))
    assert motion.passed[0].time == pytest.approx(1e-6 / 15 / 0.5, rel=1e-9, abs=0)


def test_changes_of_modes_are_told_once_there_was_one() -> None:
    """A point that came to rest by an impact is listed once; one that leaves is."""
    motion = course(drop(Floor(restitution=0.5)))
    motion.mode = mode(OPEN)
    motion.settle(0.0, PIECE, np.zeros(2), np.array([0.0, -1e-6]))
    assert [event.kind for event in motion.passed] == [Kind.REST]
    motion.passed = ()
    lifted = course(drop(Floor(), pull=(0.0, 10.0)))
    lifted.mode = mode(SLIP)
    lifted.released, lifted.turned, lifted.torn = {0}, {0}, {0}
    lifted.settle(0.5, PIECE, np.zeros(2), np.zeros(2))
    assert [(event.kind, event.time) for event in lifted.passed] == [(Kind.LEAVE, 0.5)]
    assert (lifted.released, lifted.turned, lifted.torn) == (set(), set(), set())


def test_a_way_that_turns_round_is_told() -> None:
    """By more than 120 degrees; the names of changes follow from the states."""
    motion = course(drop(Floor(coefficient=0.5)))
    touch = motion.contacts.touch(np.zeros((1, 2)), np.zeros((1, 2)))
    motion.mode = mode(SLIP)
    for angle, count in ((119, 0), (121, 1), (180, 1)):
        way = (float(np.cos(np.radians(angle))), float(np.sin(np.radians(angle))), 0.0)
        found = list(motion.compare(2.0, touch, mode(SLIP, way=way)))
        assert [event.kind for event in found] == [Kind.REVERSE] * count
    motion.mode = mode(STICK)
    assert list(motion.compare(2.0, touch, mode(STICK, way=(-1.0, 0.0, 0.0)))) == []
    names = {
        (OPEN, OPEN): None,
        (SLIP, SLIP): None,
        (SLIP, OPEN): Kind.LEAVE,
        (STICK, OPEN): Kind.LEAVE,
        (OPEN, STICK): Kind.REST,
        (OPEN, SLIP): Kind.REST,
        (SLIP, STICK): Kind.STICK,
        (STICK, SLIP): Kind.SLIP,
    }
    assert {pair: _name_change(*pair) for pair in names} == names


def test_points_are_placed_by_three_steps_of_newtons_method() -> None:
    """For a distance z^2 each step halves z; none is taken where nothing touches, or once a change is rounding."""
    motion = course(drop(Floor(row=(1.0,)), pull=(0.0,), M=((1.0,),)))
    calls: list[float] = []

    def bowl(q: Array) -> tuple[Array, Array, Array]:
        calls.append(float(q[0, 0]))
        slide, normal = np.zeros((1, 1, 3, 1)), np.zeros((1, 1, 3))
        slide[0, 0, 2, 0], normal[0, 0, 2] = 2 * q[0, 0], 1
        return q**2, normal, slide

    setattr(motion.contacts, "locate", bowl)  # noqa: B010
    assert motion.place(np.array([0.8]), [0]) == pytest.approx([0.1])
    assert calls == pytest.approx([0.8, 0.4, 0.2])
    assert motion.place(np.array([0.8]), []).tolist() == [0.8]
    dynamics = drop(Floor())
    flat = course(dynamics)
    for height, count in ((0.0, 1), (0.9e-15, 1), (1.1e-15, 2), (1e-12, 2)):
        dynamics.kernels.calls.clear()
        assert flat.place(np.array([1.0, height]), [0]).tolist() == [1.0, 0.0]
        assert dynamics.kernels.calls.count("touching") == count


def test_two_points_on_one_floor_are_placed_together() -> None:
    """The rows are dependent; the change is the least one."""
    motion = course(drop(Floor(), Floor(), Floor(row=(1.0, 0.0))))
    assert motion.place(np.array([0.5, 1e-3]), [0, 1]) == pytest.approx([0.5, 0.0], abs=1e-15)


def test_rounding_is_taken_out_across_too_where_a_point_sticks() -> None:
    """Without friction it is taken out along the normal alone; by the change that is least in the mass matrix."""
    for coefficient, across in ((0.0, 0.9e-11), (0.5, 0.0)):
        motion = course(drop(Floor(along=(1.0, 0.0), coefficient=coefficient)))
        motion.fastest = motion.reach = 1.0
        qd = np.array([0.9e-11, 0.8e-11])
        touch = motion.contacts.touch(np.zeros((1, 2)), qd[None])
        found = motion.still(touch, np.eye(2), qd, np.array([0]))
        assert found == pytest.approx([across, 0.0], abs=1e-26)
    motion.fastest = motion.reach = 0.5  # both velocities are no rounding then
    assert motion.still(touch, np.eye(2), qd, np.array([0])).tolist() == qd.tolist()
    assert motion.still(touch, np.eye(2), qd, np.array([], dtype=np.intp)).tolist() == qd.tolist()


def test_a_change_is_the_least_one_in_the_mass_matrix() -> None:
    """J change = right, and M change is a combination of the rows J; of dependent rows, one counts."""
    M, J = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.2], [0.0, 0.2, 3.0]]), np.array([[1.0, 2.0, 0.0], [2.0, 4.0, 0.0]])
    change = _lift(J, M, np.array([3.0, 6.0]))
    assert J @ change == pytest.approx([3.0, 6.0], rel=1e-12)
    force = M @ change
    assert force == pytest.approx(force[0] * J[0], rel=1e-12)


def test_slip_counts_as_none_up_to_a_share_of_the_fastest_velocity() -> None:
    """1e-11 of it, and 1e-9 where the point has just turned round."""
    motion = course(drop(Floor(along=(1.0, 0.0), coefficient=1.0), Floor(along=(1.0, 0.0), coefficient=1.0)))
    motion.fastest, motion.reach, motion.turned = 2.0, 2.0, {1}
    for point, most in ((0, 2e-11), (1, 2e-9)):
        assert motion.is_still(point, np.array([most, 0.0, 0.0]))
        assert not motion.is_still(point, np.array([1.01 * most, 0.0, 0.0]))
    touch = motion.contacts.touch(np.zeros((1, 2)), np.array([[1e-10, 0.0]]))
    assert motion.find_slipping(touch, [0, 1]) == [0]
    assert motion.find_slipping(touch, [1]) == []


def test_latches_hold_up_to_their_pull_and_are_torn_beyond() -> None:
    """A pull of 4.9 where 5 is held; of 5.1 the point leaves, and is known as torn."""
    for pull, states, torn in ((4.9, (SLIP,), set()), (5.1, (OPEN,), {0})):
        motion = course(drop(Floor(hold=5.0), pull=(0.0, pull)))
        assert motion.find_held([0]) == {0}
        assert motion.decide(0.0, PIECE, np.zeros(2), np.zeros(2), [0]).states == states
        assert motion.torn == torn
        assert motion.find_held([0]) == {0} - torn
    assert course(drop(Floor())).find_held([0]) == set()


def test_a_mode_is_locked_where_its_points_leave_no_motion() -> None:
    """Two walls hold a particle in the plane, one does not; without contact it moves."""
    walls = Floor((1.0, 0.0)), Floor((0.0, 1.0))
    for near, is_locked in (([0, 1], True), ([0], False), ([], False)):
        motion = course(drop(*walls, pull=(-1.0, -1.0)))
        assert motion.decide(0.0, PIECE, np.zeros(2), np.zeros(2), near).is_locked == is_locked
    locked = Mode((SLIP, SLIP), np.zeros((2, 3)), np.ones(2), is_locked=True)
    x = np.array([[1.0, 2.0, 3.0, 4.0]])
    assert motion.step(PIECE, locked, np.zeros(1), x, np.ones(1))[0].tolist() == x.tolist()


def test_points_that_stick_keep_three_velocities_at_rest_and_others_one() -> None:
    motion = course(drop(Floor(along=(1.0, 0.0), coefficient=1.0), Floor(along=(1.0, 0.0))))
    _, normal, slide = motion.contacts.locate(np.zeros((1, 2)))
    assert motion.list_rows(normal, slide, mode(STICK, OPEN)).shape == (1, 3, 2)
    assert motion.list_rows(normal, slide, mode(SLIP, OPEN)).tolist() == [[[0.0, 1.0]]]
    assert motion.list_rows(normal, slide, mode(OPEN, STICK)).tolist() == [[[0.0, 1.0]]]


def test_a_step_without_contact_is_the_methods_own() -> None:
    """z'' = -z by RK4: the end of a step is the exponential series up to h^4, of each state by its own length."""
    dynamics = Particles(drop().kernels, np.eye(2), lambda q, _: -q)
    h = np.array([0.1, 0.2])
    x = np.array([[1.0, 2.0, 0.5, -1.0], [0.3, 1.0, 0.0, 2.0]])
    ends, stages = course(dynamics).step(PIECE, mode(OPEN), np.zeros(2), x, h)
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
    for k in range(2):
        series = sum(np.linalg.matrix_power(h[k] * A, n) / f for n, f in enumerate((1, 1, 2, 6, 24)))
        assert ends[k] == pytest.approx(series @ x[k], rel=1e-14)
        assert stages[0, k] == pytest.approx(A @ x[k])


def test_stages_are_at_their_own_times() -> None:
    """A force that is the time alone, by an input: v = t^2/2 is exact."""
    seen: list[float] = []
    piece = wait(0.0, 1.0)

    class Told(Particles):
        def residual(self, _q: Array, _qd: Array, qdd: Array, v: Array) -> Array:
            return qdd - v

    def law(t: Array, _q: Array, _qd: Array) -> Array:
        seen.extend(t)
        return np.stack((np.zeros_like(t), t), axis=1)

    piece = type(piece)(0.0, 1.0, piece.values, False, law)
    motion = course(Told(drop().kernels, np.eye(2), lambda q, _: q))
    end = motion.step(piece, mode(OPEN), np.array([0.5]), np.zeros((1, 4)), np.array([0.1]))[0][0]
    assert end == pytest.approx([0, 0.5 * 0.1**2 / 2 + 0.1**3 / 6, 0, 0.5 * 0.1 + 0.1**2 / 2])
    assert seen == pytest.approx([0.5, 0.55, 0.55, 0.6])


def test_ends_of_steps_are_put_back_on_the_floor() -> None:
    """Place and velocity of a closed point; an open one is left."""
    motion = course(drop(Floor()))
    x = np.array([[1.0, 1e-6, 2.0, 3e-6], [1.0, -2e-6, 2.0, 4e-6]])
    assert motion.finish(mode(OPEN), x).tolist() == x.tolist()
    assert motion.finish(mode(SLIP), x) == pytest.approx(np.array([[1.0, 0, 2, 0]] * 2), abs=1e-20)


def test_rates_are_velocities_and_accelerations_with_the_forces_of_contact() -> None:
    dynamics = drop(Floor())
    motion = course(dynamics)
    x = np.array([[0.0, 0.0, 3.0, 0.0]])
    rates, _, loads = motion.rate(PIECE, mode(SLIP), np.zeros(1), x)
    assert rates.tolist() == [[3.0, 0.0, 0.0, 0.0]]
    assert loads.normal.tolist() == [[10.0]]
    assert motion.move(PIECE, mode(SLIP), np.zeros(1), x).tolist() == rates.tolist()
    dynamics.kernels.calls.clear()
    assert motion.move(PIECE, mode(OPEN), np.zeros(1), x).tolist() == [[3.0, 0.0, 0.0, -10.0]]
    assert dynamics.kernels.calls == []


def test_steps_grow_and_shrink_with_their_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """By 0.9 error^(-1/order), between 0.2 and 10; by 4 down where there is no error to speak of; accepted up to 1."""
    motion = course(drop(), RK45)
    x = np.array([0.0, 1.0, 0.0, 0.0])
    order = RK45.order
    for error, factor in ((0.0, 10.0), (1e-30, 10.0), (1.0, 0.9), (0.5, 0.9 * 0.5 ** (-1 / order))):
        monkeypatch.setattr(TouchingCourse, "estimate", lambda *_, error=error: error)
        h, _ = motion.advance(PIECE, mode(OPEN), 0.0, x, 0.01, fixed=False)
        assert h == 0.01
        assert motion.length == pytest.approx(0.01 * factor, rel=1e-14)
        assert motion.dynamics.effort.rejected is None
    for error, factor in ((1e9, 0.2), (np.nan, 0.25), (np.inf, 0.25), (2.0, 0.9 * 2.0 ** (-1 / order))):
        told = iter([error, 1.0])
        monkeypatch.setattr(TouchingCourse, "estimate", lambda *_, told=told: next(told))
        motion.dynamics.effort.rejected = None
        h, ends = motion.advance(PIECE, mode(OPEN), 0.0, x, 0.01, fixed=False)
        assert h == pytest.approx(0.01 * factor, rel=1e-14)
        assert ends == pytest.approx(np.array([[0, 1 - 5 * t * t, 0, -10 * t] for t in h * LOOKS]))
        assert motion.dynamics.effort.rejected == 1
    monkeypatch.setattr(TouchingCourse, "estimate", lambda *_: np.nan)
    assert motion.advance(PIECE, mode(OPEN), 0.0, x, 0.01, fixed=True)[0] == 0.01


@pytest.mark.parametrize("time", [0.0, 100.0])
def test_a_step_too_short_for_the_time_ends_the_motion(time: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """1e-14 s, or 1e-14 of the time."""
    tried: list[float] = []

    def refuse(_self: TouchingCourse, h: float, *_: Any) -> float:
        tried.append(h)
        return float(np.nan)

    monkeypatch.setattr(TouchingCourse, "estimate", refuse)
    with pytest.raises(HaltError, match="too short to advance the time"):
        course(drop(), RK45).advance(wait(0, 200), mode(OPEN), time, np.array([0.0, 1, 0, 0]), 1e-3, fixed=False)
    least = 1e-14 * max(1.0, time)
    assert least <= tried[-1] < 4 * least


def test_the_error_of_a_step_is_relative_to_its_tolerances() -> None:
    """The mean square over the state; of two estimates, Hairer's combination e1^2/sqrt(e1^2 + e2^2/100)."""
    x, y = np.array([1.0, 2.0]), np.array([-3.0, 1.0])
    scale = 1e-3 + 1e-2 * np.array([3.0, 2.0])
    stages = np.array([[1.0, 2.0], [3.0, -1.0]])
    motion = course(drop(Floor(row=(1.0,)), pull=(0.0,), M=((1.0,),)), atol=1e-3, rtol=1e-2)
    given = (x, y, stages, PIECE, mode(OPEN), 0.0)
    one, two = np.array([0.5, -0.25]), np.array([1.0, 1.0])
    squares = [float((((row @ stages) / scale) ** 2).sum()) for row in (one, two)]
    motion.E = one[None]
    assert motion.estimate(0.1, *given) == pytest.approx(0.1 * np.sqrt(squares[0] / 2), rel=1e-13)
    motion.E = np.stack((one, two))
    expected = 0.1 * squares[0] / np.sqrt((squares[0] + 0.01 * squares[1]) * 2)
    assert motion.estimate(0.1, *given) == pytest.approx(expected, rel=1e-13)
    motion.E = np.zeros((2, 2))
    assert motion.estimate(0.1, *given) == 0.0
    motion.E = np.array([[0.0, 0.0, 1.0]])  # of the rates at the end: (y's velocity, no acceleration)
    assert motion.estimate(0.1, *given) == pytest.approx(0.1 * np.sqrt((1.0 / scale[0]) ** 2 / 2), rel=1e-13)


def test_bounds_of_a_mode_are_distances_pressures_slips_and_reserves() -> None:
    rough, smooth = Floor(along=(1.0, 0.0), coefficient=0.5, hold=3.0), Floor()
    motion = course(drop(rough, smooth))
    listed = {
        (OPEN, OPEN): [Guard(0, Bound.GAP), Guard(1, Bound.GAP)],
        (STICK, SLIP): [Guard(0, Bound.PRESS), Guard(0, Bound.HOLD), Guard(1, Bound.PRESS)],
        (SLIP, OPEN): [Guard(0, Bound.PRESS), Guard(0, Bound.SLIP), Guard(1, Bound.GAP)],
    }
    for states, guards in listed.items():
        assert motion.list_guards(mode(*states)) == guards


def test_bounds_have_their_values_by_hand() -> None:
    """Forces have a slack of 1e-13 of the largest normal force; a latch adds what it holds."""
    big = 1e13
    rough = Floor(along=(1.0, 0.0), coefficient=0.5, hold=3.0)
    other = Floor((0.0, 0.0, 1.0), name="other")
    motion = course(
        drop(Floor((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), coefficient=0.5, hold=3.0), other, pull=(4.0, -10.0, -big))
    )
    x = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    guards = [Guard(0, Bound.PRESS), Guard(0, Bound.HOLD), Guard(1, Bound.PRESS)]
    found = motion.measure(PIECE, mode(STICK, SLIP), guards, np.zeros(1), x)
    assert found == pytest.approx(np.array([[10 + 3 + 1.0, 5 + 1.0 - 4, big + 1.0]]), rel=1e-9)
    motion = course(drop(rough))
    x = np.array([[0.0, 0.25, 3.0, 0.5]])
    found = motion.measure(
        PIECE, mode(SLIP, way=(-1.0, 0.0, 0.0)), [Guard(0, Bound.GAP), Guard(0, Bound.SLIP)], np.zeros(1), x
    )
    assert found == pytest.approx(np.array([[0.25, -3.0]]))


@pytest.mark.parametrize(("begin", "end"), [(0.2, 0.3), (0.4, 0.6), (0.7, 0.8), (0.9, 1.4), (0.3, 0.45), (0.6, 0.74)])
def test_a_point_that_enters_within_a_step_is_seen_where_it_is_looked_at(begin: float, end: float) -> None:
    """The distance (t - begin)(t - end) is found at its first 0, at four looks in a step or between them."""
    motion = course(drop(Floor(row=(1.0,)), pull=(2.0,), M=((1.0,),)))
    x, guards = np.array([begin * end, -(begin + end)]), [Guard(0, Bound.GAP)]
    ends = motion.step(PIECE, mode(OPEN), np.zeros(4), np.tile(x, (4, 1)), LOOKS)[0]
    found = motion.look(PIECE, mode(OPEN), guards, 0.0, x, 1.0, ends)
    assert found is not None
    length, state = found
    assert length == pytest.approx(begin, rel=1e-12)
    assert state == pytest.approx([0.0, begin - end], abs=1e-12)
    assert (motion.released, motion.torn, motion.turned) == ({0}, set(), set())
    assert motion.look(PIECE, mode(OPEN), [], 0.0, x, 1.0, ends) is None


def test_a_point_that_turns_back_between_two_looks_is_no_event() -> None:
    """The distance (t - 0.4)^2 + d stays above 0 by d; below 0 by no more than rounding, it has not fallen."""
    motion, guards = course(drop(Floor(row=(1.0,)), pull=(2.0,), M=((1.0,),))), [Guard(0, Bound.GAP)]
    for d, is_event in ((1e-3, False), (1e-9, False), (-1e-13, False), (-1e-9, True)):
        x = np.array([0.16 + d, -0.8])
        ends = motion.step(PIECE, mode(OPEN), np.zeros(4), np.tile(x, (4, 1)), LOOKS)[0]
        found = motion.look(PIECE, mode(OPEN), guards, 0.0, x, 1.0, ends)
        assert (found is not None) == is_event
        if found is not None:
            assert found[0] == pytest.approx(0.4 - np.sqrt(-d), abs=1e-11)


def test_of_several_points_the_first_event_ends_a_step_and_those_at_the_same_time_are_of_it() -> None:
    floors = tuple(Floor((1.0,), offset=x, name=str(x)) for x in (1.0, 0.5, 0.5, 2.0))
    motion = course(drop(*floors, pull=(0.0,), M=((1.0,),)))
    guards = [Guard(k, Bound.GAP) for k in range(4)]
    ends = np.array([[-4 * t, -4.0] for t in LOOKS])
    found = motion.look(PIECE, mode(OPEN, OPEN, OPEN, OPEN), guards, 0.0, np.array([0.0, -4.0]), 1.0, ends)
    assert found is not None
    assert found[0] == pytest.approx(0.125, rel=1e-12)
    assert motion.released == {1, 2}


def test_a_bound_that_is_0_at_the_start_is_left_before_it_is_looked_for() -> None:
    """z = t - t^2/0.6 leaves 0 and comes back at 0.6; z = -t never leaves: the event is at once."""
    motion = course(drop(Floor(row=(1.0,)), pull=(-2 / 0.6,), M=((1.0,),)))
    guard = Guard(0, Bound.GAP)
    found = motion.locate(PIECE, mode(OPEN), guard, 0.0, np.array([0.0, 1.0]), 0.0, 1.0)
    assert found == pytest.approx(0.6, rel=1e-14)
    found = motion.locate(PIECE, mode(OPEN), guard, 0.0, np.array([0.0, -1.0]), 0.0, 1.0)
    assert found == 2.0**-40
    inner = motion.locate(PIECE, mode(OPEN), guard, 0.0, np.array([0.3, 1.0]), 0.25, 1.0)
    assert inner == pytest.approx(0.3 + np.sqrt(0.09 + 0.18), rel=1e-14)


def go(motion: TouchingCourse, piece: Any, x: list[float]) -> list[Chunk]:
    motion.mode = mode(OPEN) if motion.mode is None else motion.mode
    return list(motion.run(piece, np.array(x[:2]), np.array(x[2:]), allowance()))


def test_fixed_steps_are_equal_and_come_in_chunks_of_64() -> None:
    """200 steps of Euler's method: 64, 64, 64 and 8 that end exactly at the piece's end."""
    motion = course(drop(), EULER, step=0.005)
    chunks = go(motion, wait(2.0, 3.0), [0.0, 100.0, 0.0, 0.0])
    assert [len(chunk.t) - 1 for chunk in chunks] == [64, 64, 64, 8]
    assert chunks[-1].t[-1] == 3.0
    assert np.concatenate([np.diff(chunk.t) for chunk in chunks]) == pytest.approx(0.005, rel=1e-9)
    assert chunks[-1].qd[-1][1] == pytest.approx(-10.0)
    assert motion.dynamics.effort.steps == 200
    assert motion.length == 0.0


def test_the_first_step_is_a_millisecond_or_what_is_left() -> None:
    for end, first in ((1.0, 1e-3), (4e-4, 4e-4)):
        motion = course(drop(), RK45)
        assert go(motion, wait(0.0, end), [0.0, 100.0, 0.0, 0.0])[0].t[1] == first
    motion = course(drop(), RK45)
    motion.length = 0.1
    chunks = go(motion, wait(0.0, 0.25), [0.0, 100.0, 0.0, 0.0])
    assert chunks[0].t.tolist()[:2] == [0.0, 0.1]
    assert chunks[0].t[-1] == 0.25


def test_a_step_that_ends_at_an_event_ends_the_run_and_one_at_once_has_one_state() -> None:
    """A fall from 0.05 m hits after 0.1 s; where the point is below the floor at once, the chunk has one state."""
    motion = course(drop(), RK45)
    (chunk,) = go(motion, wait(0.0, 1.0), [0.0, 0.05, 1.0, 0.0])
    assert chunk.t[-1] == pytest.approx(0.1, rel=1e-12)
    assert chunk.q[-1] == pytest.approx([0.1, 0.0], abs=1e-14)
    assert motion.released == {0}
    (sunk,) = go(course(drop(), RK45), wait(10.0, 11.0), [0.0, -1e-20, 0.0, -1e-6])
    assert len(sunk.t) == 1


@pytest.mark.parametrize("time", [0.0, 100.0])
def test_steps_into_each_other_are_quartered_until_the_time_stands(
    time: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kernels fail for points far inside each other: a step of fixed length ends there, others are retried."""
    look, tried = TouchingCourse.look, list[float]()

    def fail(self: TouchingCourse, *given: Any) -> Any:
        tried.append(given[5])
        if given[5] > 1e-5:
            raise INSIDE
        return look(self, *given)

    monkeypatch.setattr(TouchingCourse, "look", fail)
    motion = course(drop(), RK45)
    go(motion, wait(time, time + 3e-6), [0.0, 100.0, 0.0, 0.0])
    tried.clear()
    motion.length = 1e-3
    go(motion, wait(time, time + 1e-3), [0.0, 100.0, 0.0, 0.0])[0]
    assert tried[:5] == pytest.approx([1e-3 / 4**k for k in range(5)], rel=1e-9)

    def never(_self: TouchingCourse, *given: Any) -> Any:
        tried.append(given[5])
        raise INSIDE

    monkeypatch.setattr(TouchingCourse, "look", never)
    with pytest.raises(KernelError):
        go(course(drop(), RK45), wait(time, time + 1.0), [0.0, 100.0, 0.0, 0.0])
    least = 1e-14 * max(1.0, time)
    assert least <= tried[-1] < 4 * least
    tried.clear()
    with pytest.raises(KernelError):
        go(course(drop(), EULER, step=0.1), wait(time, time + 1.0), [0.0, 100.0, 0.0, 0.0])
    assert len(tried) == 1


def test_a_chunk_has_its_events_and_the_forces_and_losses_within_it() -> None:
    """A rough block slides at 3 m/s under 10 N, mu = 0.5: 5 N of friction take 15 W; events are listed once."""
    floor = Floor(along=(1.0, 0.0), coefficient=0.5)
    motion = course(drop(floor), RK4)
    told = Event(0.0, "floor", Kind.REST, 0.0, 0.0)
    motion.passed, motion.loss = (told,), 7.0
    state = np.array([0.0, 0.0, 3.0, 0.0])
    alone = motion.gather(PIECE, mode(SLIP), [0.0], [state])
    assert alone.segment is not None
    assert (motion.passed, motion.loss) == ((told,), 7.0)
    chunk = motion.gather(PIECE, mode(SLIP), [0.0, 0.2], [state, np.array([0.5, 0.0, 2.0, 0.0])])
    assert chunk.segment is not None
    assert chunk.segment.push is not None
    assert not motion.passed
    assert motion.loss == 0.0
    qdd, force, power = chunk.segment.push(np.zeros(1), state[None, :2], state[None, 2:])
    assert qdd == pytest.approx(np.array([[-5.0, 0.0]]))
    assert force == pytest.approx(np.array([[-5.0, 0.0, 10.0]]))
    assert power == pytest.approx([15.0])
    assert chunk.dense is not None
    q, qd = chunk.dense(np.array([0.1]), np.array([0]))
    assert q == pytest.approx(np.array([[0.3 - 0.025, 0.0]]))
    assert qd == pytest.approx(np.array([[2.5, 0.0]]))


def test_poissons_expansion_has_its_share_of_the_compressions_impulse() -> None:
    """Compression by m v, expansion by e m v: together (1 + e) m v, and the rebound is e v."""
    for impacts in Impacts:
        motion = course(drop(Floor(restitution=0.25), M=((2.0, 0.0), (0.0, 2.0))), impacts=impacts)
        q, qd = np.zeros(2), np.array([0.0, -4.0])
        touch = motion.contacts.touch(q[None], qd[None])
        after, loads, phases = motion.strike(q, qd, 2 * np.eye(2), touch, [0], np.array([0.25]), np.array([-4.0]))
        assert after == pytest.approx([0.0, 1.0])
        assert loads.normal == pytest.approx(np.array([[2 * 4 * 1.25]]))
        assert len(phases) == (1 if impacts is Impacts.NEWTON else 2)


def test_a_motion_in_a_formulation_without_mass_matrix_takes_one_with() -> None:
    for given, taken in (
        (Formulation.EXP2, Formulation.SEMI),
        (Formulation.IMPL, Formulation.IMPL),
    ):
        dynamics = Particles(drop().kernels, np.eye(2), lambda q, _: q, formulation=given)
        motion = course(dynamics)
        assert motion.dynamics.formulation is taken
