"""The laws of contact at single states: modes, forces and conditions of particles on floors, by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.simulation.integration import contacts as module
from mbsrun.simulation.integration.contacts import (
    Contacts,
    Loads,
    Mode,
    ParadoxError,
    Search,
    State,
    Touch,
    find_way,
    span,
)
from tests.mbsrun.simulation.particles import Floor, drop

Array = NDArray[np.float64]
OPEN, STICK, SLIP = State.OPEN, State.STICK, State.SLIP
ROUGH = Floor(along=(1.0, 0.0), coefficient=0.5)


def search(dynamics: Any, qd: list[float], near: list[int], **given: Any) -> tuple[Mode, Loads]:
    """Search at the origin for the mode that goes on."""
    contacts = Contacts(dynamics)
    state = np.zeros((1, dynamics.size)), np.array([qd])
    touch = contacts.touch(*state)
    slipping = given.pop("slipping", [k for k in near if np.linalg.norm(touch.slip[0, k]) > 0])
    inertia = given.pop("inertia", contacts.find_free(*state, np.zeros((1, 0))))
    return Search(contacts, touch, inertia, near, slipping, **given).find()


def test_points_have_velocities_along_and_across_their_normals() -> None:
    contacts = Contacts(drop(Floor(along=(2.0, 0.0), offset=3.0)))
    touch = contacts.touch(np.array([[5.0, 1.0]]), np.array([[0.5, -4.0]]))
    assert touch.gap.tolist() == [[4.0]]
    assert touch.velocity.tolist() == [[[1.0, 0.0, -4.0]]]
    assert touch.speed.tolist() == [[-4.0]]
    assert touch.slip.tolist() == [[[1.0, 0.0, 0.0]]]
    M, free = contacts.find_free(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 0)))
    assert (M.tolist(), free.tolist()) == ([[[1.0, 0.0], [0.0, 1.0]]], [[0.0, -10.0]])


@pytest.mark.parametrize(("push", "states"), [(4.9, STICK), (5.1, SLIP), (-4.9, STICK), (-5.1, SLIP)])
def test_a_block_sticks_up_to_the_limit_of_friction(push: float, states: State) -> None:
    """10 N press it down, mu = 0.5: up to 5 N are held; beyond, it slips, and the rest accelerates it."""
    mode, loads = search(drop(ROUGH, pull=(push, -10.0)), [0.0, 0.0], [0])
    assert mode.states == (states,)
    assert loads.normal == pytest.approx(np.array([[10.0]]))
    held = -push if states == STICK else -5.0 * np.sign(push)
    assert loads.friction[0, 0] == pytest.approx([held, 0.0, 0.0], abs=1e-12)
    assert loads.qdd[0] == pytest.approx([push + held, 0.0], abs=1e-12)
    assert mode.shares == pytest.approx([10.0])


@pytest.mark.parametrize(("speed", "friction"), [(2.0, -5.0), (-2.0, 5.0)])
def test_friction_of_a_slipping_point_is_against_its_way(speed: float, friction: float) -> None:
    mode, loads = search(drop(ROUGH, pull=(0.5, -10.0)), [speed, 0.0], [0])
    assert mode.states == (SLIP,)
    assert mode.ways.tolist() == [[np.sign(speed), 0.0, 0.0]]
    assert loads.qdd[0] == pytest.approx([0.5 + friction, 0.0])


def test_points_that_are_pulled_open() -> None:
    """Without friction, and with; one that is far is open whatever pulls."""
    for floor in (Floor(), ROUGH):
        for pull, state in ((0.1, OPEN), (-0.1, STICK if floor.coefficient else SLIP)):
            mode, loads = search(drop(floor, pull=(0.0, pull)), [0.0, 0.0], [0])
            assert mode.states == (state,)
            assert loads.qdd[0, 1] == pytest.approx(max(pull, 0.0), abs=1e-14)
    mode, loads = search(drop(Floor()), [0.0, 0.0], [])
    assert (mode.states, mode.closed, loads.qdd.tolist()) == ((OPEN,), [], [[0.0, -10.0]])


def test_an_impact_leaves_the_velocities_that_are_its_goal() -> None:
    """-1 becomes 0.5: an impulse of 1.5; along a rough floor it takes at most half of this."""
    goal = np.array([[0.5]])
    for across, after in ((2.0, 2.0 - 0.75), (0.5, 0.0), (-2.0, -1.25)):
        inertia = np.eye(2)[None], np.array([[across, -1.0]])
        mode, loads = search(drop(ROUGH), [across, -1.0], [0], inertia=inertia, goal=goal)
        assert loads.qdd[0] == pytest.approx([after, 0.5], abs=1e-12)
        assert loads.normal == pytest.approx(np.array([[1.5]]))
        assert mode.states == (STICK if after == 0 else SLIP,)


def test_latched_points_stay_closed() -> None:
    mode, loads = search(drop(Floor(hold=5.0), pull=(0.0, 3.0)), [0.0, 0.0], [0], held={0})
    assert mode.states == (SLIP,)
    assert loads.normal == pytest.approx(np.array([[-3.0]]))


def test_given_impulses_are_the_least_ones() -> None:
    """A point gets 2 where 1 would stop it, and leaves with 1; one that needs 3 gets 3, and stays."""
    for speed, end in ((-1.0, 1.0), (-3.0, 0.0), (-2.0, 0.0)):
        inertia = np.eye(2)[None], np.array([[0.0, speed]])
        mode, loads = search(
            drop(Floor()), [0.0, speed], [0], inertia=inertia, goal=np.zeros((1, 1)), given=np.array([2.0])
        )
        assert loads.qdd[0, 1] == pytest.approx(end, abs=1e-12)
        assert loads.normal[0, 0] == pytest.approx(max(2.0, -speed))
        assert mode.leaving == ((0,) if end else ())
    rough = drop(ROUGH)
    inertia = np.eye(2)[None], np.array([[0.4, -1.0]])
    _, loads = search(rough, [0.4, -1.0], [0], inertia=inertia, goal=np.zeros((1, 1)), given=np.array([2.0]))
    assert loads.qdd[0] == pytest.approx([0.0, 1.0], abs=1e-12)
    inertia = np.eye(2)[None], np.array([[4.0, -1.0]])
    _, loads = search(rough, [4.0, -1.0], [0], inertia=inertia, goal=np.zeros((1, 1)), given=np.array([2.0]))
    assert loads.qdd[0] == pytest.approx([3.0, 1.0], abs=1e-12)


def test_modes_are_tried_from_closed_to_open() -> None:
    floors = Floor(), ROUGH, ROUGH, Floor(hold=1.0)
    contacts = Contacts(drop(*floors))
    touch = contacts.touch(np.zeros((1, 2)), np.zeros((1, 2)))
    inertia = np.eye(2)[None], np.zeros((1, 2))

    def listed(near: list[int], slipping: list[int], **given: Any) -> list[Any]:
        return list(Search(contacts, touch, inertia, near, slipping, **given)._list())

    assert listed([0], []) == [((SLIP, OPEN, OPEN, OPEN), ()), ((OPEN,) * 4, ())]
    assert [x[0][1] for x in listed([1], [])] == [STICK, SLIP, OPEN]
    assert [x[0][1] for x in listed([1], [1])] == [SLIP, OPEN]
    assert [x[0][1] for x in listed([1], [1], goal=np.zeros((1, 4)))] == [STICK, SLIP, OPEN]
    assert [x[0][3] for x in listed([3], [], held={3})] == [SLIP]
    assert len(listed([0, 1, 2, 3], [])) == 2 * 3 * 3 * 2
    given = np.ones(4)
    assert listed([0], [], given=given) == [((SLIP, OPEN, OPEN, OPEN), ()), ((SLIP, OPEN, OPEN, OPEN), (0,))]
    assert listed([1], [], given=given) == [
        ((OPEN, STICK, OPEN, OPEN), ()),
        ((OPEN, SLIP, OPEN, OPEN), ()),
        ((OPEN, STICK, OPEN, OPEN), (1,)),
        ((OPEN, SLIP, OPEN, OPEN), (1,)),
    ]
    assert listed([3], [], given=given, held={3}) == [((OPEN, OPEN, OPEN, SLIP), ())]


def test_two_solutions_are_a_paradox_and_so_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Solutions count as one where accelerations agree to 1e-6."""
    contacts = Contacts(drop(ROUGH))
    touch = contacts.touch(np.zeros((1, 2)), np.array([[1.0, 0.0]]))
    one = Mode((SLIP,), np.zeros((1, 3)), np.ones(1))
    for apart, message in ((1.0, "2 motions obey"), (3e-5, "2 motions obey"), (1e-5, "")):
        told = iter([np.array([[0.0, 10.0]]), np.array([[0.0, 10.0 + apart]])])

        def tell(_self: Search, *_: Any, told: Any = told) -> Any:
            qdd = next(told, None)
            return None if qdd is None else (one, Loads(qdd, np.ones((1, 1)), np.zeros((1, 1, 3)), np.zeros(1)))

        monkeypatch.setattr(Search, "_try", tell)
        found = Search(contacts, touch, (np.eye(2)[None], np.zeros((1, 2))), [0], [0])
        if message:
            with pytest.raises(ParadoxError, match=f"{message} the laws of contact and friction at floor"):
                found.find()
        else:
            assert found.find()[0] is one
    monkeypatch.setattr(Search, "_try", lambda *_: None)
    with pytest.raises(ParadoxError, match="no motion obeys"):
        Search(contacts, touch, (np.eye(2)[None], np.zeros((1, 2))), [0], [0]).find()


@pytest.mark.parametrize(("count", "tried"), [(729, 730), (5, 6)])
def test_so_many_modes_are_tried_and_no_more(count: int, tried: int, monkeypatch: pytest.MonkeyPatch) -> None:
    contacts = Contacts(drop(*[ROUGH] * 8))
    touch = contacts.touch(np.zeros((1, 2)), np.array([[1.0, 0.0]]))
    seen: list[Any] = []
    if count != 729:
        monkeypatch.setattr(module, "MOST", count)
    monkeypatch.setattr(Search, "_try", lambda _self, states, _: seen.append(states))
    with pytest.raises(ParadoxError):
        Search(contacts, touch, (np.eye(2)[None], np.zeros((1, 2))), list(range(8)), []).find()
    assert len(seen) == tried


def test_the_first_mode_is_enough_where_nothing_slips() -> None:
    """Without friction, and where all stick, no second mode is looked for."""
    for floor, slipping, goes_on in ((Floor(), [], False), (ROUGH, [], False), (ROUGH, [0], True)):
        contacts = Contacts(drop(floor))
        touch = contacts.touch(np.zeros((1, 2)), np.array([[float(bool(slipping)), 0.0]]))
        seen: list[Any] = []
        found = Search(contacts, touch, (np.eye(2)[None], np.array([[0.0, -10.0]])), [0], slipping)
        attempt = found._try

        def count(states: Any, leaving: Any, attempt: Any = attempt, seen: list[Any] = seen) -> Any:
            seen.append(states)
            return attempt(states, leaving)

        found._try = count  # type: ignore[method-assign]
        found.find()
        assert (len(seen) > 1) == goes_on


def test_a_way_is_smooth_where_a_point_comes_to_rest() -> None:
    """The direction of the slip, on the side of the way in which it began; the way itself where there is no slip."""
    way = np.array([[1.0, 0.0, 0.0]])
    mode = Mode((SLIP,), way, np.ones(1))

    def find(slip: list[float], along: float = 0.0) -> list[float]:
        velocity = np.array([[[*slip, along]]])
        normal = np.array([[[0.0, 0.0, 1.0]]])
        zero = np.zeros((1, 1))
        touch = Touch(zero, normal, np.zeros((1, 1, 3, 2)), velocity, zero, 0 * velocity, zero)
        return [float(x) for x in find_way(touch, mode, 0)[0]]

    assert find([3.0, 4.0]) == pytest.approx([0.6, 0.8, 0.0])
    assert find([-3.0, 4.0]) == pytest.approx([0.6, -0.8, 0.0])
    assert find([0.0, 2.0]) == pytest.approx([0.0, 1.0, 0.0])
    assert find([0.0, 0.9e-12]) == [1.0, 0.0, 0.0]
    assert find([0.0, 1.1e-12]) == pytest.approx([0.0, 1.0, 0.0])
    assert find([0.0, 5e-12], along=9.0) == [1.0, 0.0, 0.0]
    assert find([0.0, 2e-11], along=9.0) == pytest.approx([0.0, 1.0, 0.0])


def test_two_directions_lie_across_each_normal() -> None:
    for n in (np.array([[0.0, 0.0, 1.0]]), np.array([[0.6, 0.0, 0.8]]), np.array([[1.0, 2.0, -2.0]]) / 3):
        basis = np.array([n[0], *(x[0] for x in span(n))])
        assert basis @ basis.T == pytest.approx(np.eye(3), abs=1e-14)


def test_load_is_shared_in_proportion_to_pressures() -> None:
    """Two feet that stick, of which one bears three times as much: it holds three times the friction."""
    feet = tuple(Floor((0.0, 1.0, side), (1.0, 0.0, 0.0), coefficient=0.5, name=str(side)) for side in (-1.0, 1.0))
    mode, loads = search(drop(*feet, pull=(4.0, -10.0, 5.0)), [0.0, 0.0, 0.0], [0, 1])
    assert mode.states == (STICK, STICK)
    assert loads.normal[0] == pytest.approx([7.5, 2.5])
    contacts = Contacts(drop(*feet, pull=(4.0, -10.0, 5.0)))
    state = np.zeros((1, 3)), np.zeros((1, 3))
    shared = contacts.load(
        contacts.touch(*state),
        np.eye(3)[None],
        np.array([[4.0, -10.0, 5.0]]),
        replace(mode, shares=np.array([3.0, 1.0])),
    )
    assert shared.friction[0, :, 0] == pytest.approx([-3.0, -1.0])
    assert shared.miss[0] < 1e-14


def test_a_slipping_direction_that_starts_is_the_one_of_the_motion() -> None:
    """Pushed along (3, 4) on a floor with two directions: friction opposes that."""
    floor = Floor((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), coefficient=0.5)
    dynamics = drop(floor, pull=(6.0, 8.0, -10.0))
    kernels = dynamics.kernels

    def call(name: str, q: Array) -> dict[str, Array]:
        found: dict[str, Array] = kernels(name, q=q)
        if name == "touching":
            found["slide"][:, 0, 1, 1] = 1.0  # the second direction
        return found

    contacts = Contacts(dynamics)
    contacts._place = lambda q: (  # type: ignore[method-assign]
        call("touching", q)["clearance"],
        np.array([[[0.0, 0.0, 1.0]]]),
        call("touching", q)["slide"],
    )
    touch = contacts.touch(np.zeros((1, 3)), np.zeros((1, 3)))
    mode, loads = Search(contacts, touch, (np.eye(3)[None], np.array([[6.0, 8.0, -10.0]])), [0], []).find()
    assert mode.states == (SLIP,)
    assert mode.ways[0] == pytest.approx([0.6, 0.8, 0.0])
    assert loads.friction[0, 0] == pytest.approx([-3.0, -4.0, 0.0])
    assert loads.qdd[0] == pytest.approx([3.0, 4.0, 0.0])


def holds(mode: Mode, loads: Loads, **given: Any) -> bool:
    """Judge a mode of one rough point that touches."""
    contacts = Contacts(drop(ROUGH))
    touch = contacts.touch(np.zeros((1, 2)), np.zeros((1, 2)))
    turning = given.pop("turning", [])
    return Search(contacts, touch, (np.eye(2)[None], np.zeros((1, 2))), [0], [], **given)._holds(mode, loads, turning)


def bear(normal: float, friction: float = 0.0, qdd: tuple[float, float] = (0.0, 0.0), miss: float = 0.0) -> Loads:
    force = np.array([[[friction, 0.0, 0.0]]])
    return Loads(np.array([qdd]), np.array([[normal]]), force, np.array([miss]))


def test_conditions_of_a_mode_hold_up_to_a_billionth() -> None:
    stick, slip, opened = (Mode((x,), np.array([[1.0, 0, 0]]), np.ones(1)) for x in (STICK, SLIP, OPEN))
    assert holds(stick, bear(10.0, 5.0))
    assert holds(stick, bear(10.0, -5.0 * (1 + 0.9e-9)))
    assert not holds(stick, bear(10.0, -5.0 * (1 + 1.3e-9)))
    assert not holds(stick, bear(10.0, 5.0), released=[0])
    assert holds(stick, bear(10.0, 5.0 * (1 - 1.3e-9)), released=[0])
    assert not holds(stick, bear(10.0, 0.0, miss=1.1e-8))
    assert holds(stick, bear(10.0, 0.0, miss=0.9e-8))
    assert not holds(slip, bear(10.0, qdd=(np.inf, 0.0)))
    assert not holds(slip, bear(-1.0))
    assert holds(slip, bear(-1.0), held=[0])
    assert holds(slip, bear(1.0), given=np.array([1.0]))
    assert not holds(slip, bear(1.0), given=np.array([1.1]))
    assert holds(opened, bear(0.0, qdd=(0.0, 1.0)))
    assert not holds(opened, bear(0.0, qdd=(0.0, -1.0)))
    assert not holds(opened, bear(0.0, qdd=(1.0, -3e-9)))
    assert holds(opened, bear(0.0, qdd=(1.0, -1e-9)))
    assert not holds(opened, bear(0.0, qdd=(0.0, 0.4)), goal=np.array([[0.5]]))
    assert holds(opened, bear(0.0, qdd=(0.0, 0.6)), goal=np.array([[0.5]]))
    leaving = replace(slip, leaving=(0,))
    assert not holds(leaving, bear(1.0, qdd=(0.0, -1.0)))
    assert holds(leaving, bear(1.0, qdd=(0.0, 1.0)))
    assert holds(slip, bear(1.0, qdd=(-1.0, 0.0)))
    assert not holds(slip, bear(1.0, qdd=(-1.0, 0.0)), turning=[0])
    assert holds(slip, bear(1.0, qdd=(1.0, 0.0)), turning=[0])
    for sign, holds_it in ((0.95, True), (1.05, False)):  # of 1e-9 of the sizes of terms, 2 by 100 here
        assert holds(opened, bear(0.0, qdd=(100.0, -sign * 2e-7))) is holds_it
        assert holds(opened, bear(0.0, qdd=(100.0, 0.5 - sign * 2e-7)), goal=np.array([[0.5]])) is holds_it
        assert holds(leaving, bear(1.0, qdd=(100.0, -sign * 2e-7))) is holds_it
        assert holds(slip, bear(1.0, qdd=(-sign * 2e-7, 100.0)), turning=[0]) is holds_it


def test_points_move_with_accelerations_turning_sides_and_drifts() -> None:
    """Along the normal S qdd + pull; across it S qdd + drift without its normal part; in impacts neither counts."""
    contacts = Contacts(drop(ROUGH))
    touch = replace(
        contacts.touch(np.zeros((1, 2)), np.zeros((1, 2))),
        pull=np.array([[2.0]]),
        drift=np.array([[[0.5, -1.0, 7.0]]]),
    )
    inertia = np.eye(2)[None], np.zeros((1, 2))
    along, across = Search(contacts, touch, inertia, [0], [])._move(bear(0.0, qdd=(3.0, 4.0)))
    assert (along.tolist(), across.tolist()) == ([6.0], [[3.5, -1.0, 0.0]])
    along, across = Search(contacts, touch, inertia, [0], [], goal=np.zeros((1, 1)))._move(bear(0.0, qdd=(3.0, 4.0)))
    assert (along.tolist(), across.tolist()) == ([4.0], [[3.0, 0.0, 0.0]])
    mode = Mode((STICK,), np.zeros((1, 3)), np.ones(1))
    loads = contacts.load(touch, np.eye(2)[None], np.array([[1.0, -10.0]]), mode)
    assert loads.qdd[0] == pytest.approx([-0.5, -2.0])  # so that neither velocity changes
    assert loads.normal[0] == pytest.approx([8.0])
    pulled = Search(contacts, touch, inertia, [0], [])._holds(
        Mode((OPEN,), np.zeros((1, 3)), np.ones(1)), bear(0.0, qdd=(0.0, -1.9)), []
    )
    assert pulled


class Curved:
    """Kernels of a point whose slide is q, and whose side turns with q, in several states."""

    def __init__(self, kernels: Any) -> None:
        self.kernels, self.manifest = kernels, kernels.manifest

    def __call__(self, name: str, q: Array) -> dict[str, Array]:
        found: dict[str, Array] = self.kernels(name, q=q)
        if name == "jac_touching":
            for k in range(len(q)):
                found["jac_slide_q"][k, 1, 0, 2, 0] = 2.0 + k  # of the normal velocity by qd_1, by q_0
                found["jac_slide_q"][k, 0, 0, 0, 1] = 5.0
                found["jac_direction_q"][k, 0, 0, 1] = 3.0
        return found


def test_sides_that_turn_and_points_that_curve_change_velocities() -> None:
    """Drift: the sum of dS_ij/dq_k qd_j qd_k; pull: the turn of the normal by the velocity, and the normal's drift."""
    dynamics = drop(ROUGH)
    contacts = Contacts(replace(dynamics, kernels=Curved(dynamics.kernels)))
    qd = np.array([[2.0, 3.0], [1.0, -1.0]])
    touch = contacts.touch(np.array([[0.0, 1.0], [0.0, 4.0]]), qd)
    assert touch.gap.tolist() == [[1.0], [4.0]]
    assert touch.velocity.tolist() == [[[2.0, 0.0, 3.0]], [[1.0, 0.0, -1.0]]]
    assert touch.drift.tolist() == [[[5 * 2 * 3.0, 0.0, 2 * 3 * 2.0]], [[-5.0, 0.0, -3.0]]]
    assert touch.pull.tolist() == [[3 * 3 * 2.0 + 12.0], [-3.0 - 3.0]]
