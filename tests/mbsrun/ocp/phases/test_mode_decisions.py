"""Modes of stops, dry friction and rigid contacts by hand: what each adds, where phases begin and end, what strikes."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from mbsgen.manifest import BearingLoad, Friction, OpenContact, OpenJoint, Stops
from mbsrun.ocp.problem import modes as module
from mbsrun.ocp.problem.modes import (
    add_modes,
    arrive,
    begin,
    complete,
    find_faults,
    find_wrong_hits,
    find_wrong_start,
    is_closed,
    list_modes,
    make_contact,
    strike,
)
from mbsrun.ocp.problem.phases import Blow, Impact
from mbsrun.ocp.problem.problem import Bounds, Constraint, Contact, End, Problem, WrenchComponent
from mbsrun.quantities import SIGNAL, Quantity
from tests.mbsrun.ocp.plants import FREE_RANGE, push

INF = math.inf


def joint(name: str = "a", stops: tuple[Any, Any, Any] | None = None, **friction: Any) -> OpenJoint:
    known = {"torque": 2.0, "static": 2.0, "stribeck": None}
    return OpenJoint(
        name=name,
        signal=f"stop_{name}",
        stops=None if stops is None else Stops(lower=stops[0], upper=stops[1], restitution=stops[2]),
        friction=Friction(**(known | friction)) if friction else None,
    )


def contact(name: str = "toe", axis: int = 2, coefficient: float = 0.5, **given: Any) -> OpenContact:
    known = {"height": 0.0, "restitution": 0.0}
    return OpenContact(name=name, point=f"{name}_point", axis=axis, coefficient=coefficient, **(known | given))


STOPPED = joint(stops=(-1.0, 2.0, 0.0))
BOUNCING = joint(stops=(-1.0, 2.0, 0.5))
RUBBED = joint(torque=2.0, static=3.0, stribeck=0.25)
BOTH = joint(stops=(None, 2.0, 0.0), torque=2.0, static=3.0)
CLUTCH = joint(torque=1.0, static=1.5, one_way=-1)
FOOT = contact(coefficient=0.0)
TOE = contact()


def manifest_of(*laws: Any, **given: Any) -> Any:
    """A model of sliding joints x and a, which laws are about."""
    joints = tuple(law for law in laws if isinstance(law, OpenJoint))
    contacts = tuple(law for law in laws if isinstance(law, OpenContact))
    known = {
        "coordinates": [SimpleNamespace(name=name) for name in ("x", "a")], "positions": ("x", "a"), "rigid": (),
        "meetings": (), "open_joints": joints, "open_contacts": contacts, "model": "m",
    }  # fmt: skip
    return SimpleNamespace(**(known | given))


@pytest.fixture(autouse=True)
def names(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names of coordinates and velocities, and of the components of the wrench at a toe."""
    found = {f"{kind}_{name}": Quantity(kind, i) for kind in ("q", "qd") for i, name in enumerate(("x", "a"))}
    monkeypatch.setattr(module, "list_quantities", lambda _: found)
    monkeypatch.setattr(module, "find_component", lambda _, name, k: 5 + k if name == "toe_point" else None)
    monkeypatch.setattr(module, "name_components", lambda _: [f"w{k}" for k in range(9)])


def state(**given: Any) -> Problem:
    wide = FREE_RANGE
    known: dict[str, Any] = {
        "start_q": (0.0, 0.0), "start_qd": (0.0, 0.0), "end": End(),
        "bounds": Bounds((wide, (-9.0, 9.0)), (wide, (-5.0, 5.0)), (wide,)),
    }  # fmt: skip
    return replace(push(2), **(known | given))


def show(findings: Any) -> list[tuple[str, str]]:
    return [(".".join(map(str, x.place)), x.finding) for x in findings]


# --- what there is --------------------------------------------------------------------------------------------------


def test_modes_are_of_friction_and_of_stops_that_are_there() -> None:
    for law, modes in (
        (STOPPED, ("free", "lower", "upper")),
        (joint(stops=(-1.0, None, 0.0)), ("free", "lower")),
        (RUBBED, ("forward", "backward", "stick")),
        (BOTH, ("forward", "backward", "stick", "upper")),
        (CLUTCH, ("backward", "stick")),
        (joint(torque=1.0, one_way=1), ("forward", "stick")),
        (TOE, ("open", "stick", "forward", "backward")),
        (FOOT, ("open", "slide")),
    ):
        assert list_modes(law) == modes
    found = complete(
        {"toe": "stick"}, manifest_of(STOPPED, RUBBED.model_copy(update={"name": "x"}), TOE, contact("heel"))
    )
    assert found == {"a": "free", "x": "forward", "toe": "stick", "heel": "open"}
    closed = {mode for mode in ("free", "forward", "backward", "stick", "lower", "upper") if is_closed(BOTH, mode)}
    assert closed == {"stick", "lower", "upper"}
    assert {mode for mode in ("open", "stick", "slide", "forward", "backward") if is_closed(TOE, mode)} == {
        "stick", "slide", "forward", "backward",
    }  # fmt: skip


AXES = {"toe": (0, 2), "foot": (2,), "ball": (0, 1, 2), "pole": (2,)}


@pytest.mark.parametrize(
    ("laws", "modes", "found"),
    [
        ((STOPPED,), {"a": "lower"}, []),
        ((STOPPED,), {}, []),
        ((STOPPED,), {"x": "free"}, [("x", 'joint "x" has neither rigid stops nor dry friction, so it has no modes')]),
        ((STOPPED,), {"b": "free"}, [("b", 'the model has no joint or contact "b" with modes')]),
        ((STOPPED,), {"a": "stick"}, [("a", "joint a has no dry friction, so it has no mode stick")]),
        ((BOTH,), {"a": "lower"}, [("a", "joint a has no rigid stop at its lower limit")]),
        ((RUBBED,), {"a": "free"}, [("a", "joint a has dry friction, so it is never free")]),
        ((RUBBED,), {"a": "fast"}, [("a", 'joint a has no mode "fast"')]),
        ((CLUTCH,), {"a": "forward"}, [("a", "joint a is a clutch, which moves one way, so it has no mode forward")]),
        ((RUBBED,), {}, [("", "a has dry friction, and no mode")]),
        ((TOE,), {"toe": "slide"}, [("toe", "contact toe has friction, which slide is without")]),
        ((FOOT,), {"toe": "stick"}, [("toe", "contact toe has no friction to stick by")]),
        ((FOOT,), {"toe": "forward"}, [("toe", "contact toe has no friction, so its slip has no way")]),
        ((FOOT,), {"toe": "shut"}, [("toe", 'contact toe has no mode "shut"')]),
        ((TOE,), {"toe": "forward"}, []),
        (
            (contact("ball"),),
            {"ball": "forward"},
            [("ball", "ball can slide along x and y, and forward is along one axis")],
        ),
        ((contact("ball"),), {"ball": "stick"}, []),
        (
            (contact("pole"),),
            {"pole": "backward"},
            [("pole", "pole can slide along no axis, and backward is along one axis")],
        ),
        ((STOPPED, contact("a")), {"a": "open"}, [("a", "a joint and a contact have this name")]),
    ],
)
def test_modes_that_are_not_there_are_refused(laws: Any, modes: dict[str, str], found: list[tuple[str, str]]) -> None:
    assert show(find_faults(modes, manifest_of(*laws), AXES | {"a": (0, 2)})) == found


def test_parts_without_modes_are_refused_with_the_model() -> None:
    load = BearingLoad(coefficient=0.1, static=0.1, arm=1.0, length=None)
    (found,) = show(find_faults({}, manifest_of(joint(torque=1.0, load=load)), AXES))
    assert found == ("", "friction by the load of joint a has no modes")
    points = [SimpleNamespace(name="p", is_stop=is_stop) for is_stop in (True, False)]
    assert show(find_faults({}, manifest_of(rigid=points), AXES)) == [
        ("", "rigid stop p has no modes here"),
        ("", "rigid contact p has no modes here"),
    ]


# --- what a mode adds -----------------------------------------------------------------------------------------------


def add(law: Any, mode: str, axes: tuple[int, ...] = (0, 2)) -> Problem:
    problem = state(modes=((law.name, mode),))
    return add_modes(problem, manifest_of(law), {law.name: axes})


@pytest.mark.parametrize(
    ("law", "mode", "text", "limits"),
    [
        (RUBBED, "forward", "-(2.0 + 1.0*exp(-(qd_a/0.25)**2))", (0.0, 5.0)),
        (RUBBED, "backward", "(2.0 + 1.0*exp(-(qd_a/0.25)**2))", (-5.0, 0.0)),
        (joint(torque=2.0, stribeck=0.25), "forward", "-2.0", (0.0, 5.0)),
        (BOTH, "backward", "2.0", (-5.0, 0.0)),
        (STOPPED, "free", "0", (-5.0, 5.0)),
    ],
)
def test_a_joint_that_slides_has_the_force_of_its_friction_and_one_way(
    law: OpenJoint, mode: str, text: str, limits: tuple[float, float]
) -> None:
    found = add(law, mode)
    assert found.wrenches == (WrenchComponent("stop_a", SIGNAL, text),)
    assert found.bounds.qd == (FREE_RANGE, limits)
    assert found.bounds.q[1] == (-9.0, 9.0)
    assert found.constraints == ()


@pytest.mark.parametrize(
    ("law", "mode", "force"),
    [
        (RUBBED, "stick", (-3.0, 3.0)),
        (CLUTCH, "stick", (-INF, 1.5)),
        (joint(torque=1.0, static=1.5, one_way=1), "stick", (-1.5, INF)),
        (STOPPED, "lower", (0.0, INF)),
        (STOPPED, "upper", (-INF, 0.0)),
        (BOTH, "upper", (-INF, 3.0)),
    ],
)
def test_a_joint_at_rest_is_held_by_what_friction_and_stops_can_bear(
    law: OpenJoint, mode: str, force: tuple[float, float]
) -> None:
    """Its velocity is 0; at a stop, its place has no bound beside the stop."""
    found = add(law, mode)
    (held,) = found.wrenches
    assert (held.expression, held.bounds) == (None, pytest.approx(force))
    assert found.constraints == (Constraint("qd_a", (0.0, 0.0), name="a at rest"),)
    assert found.bounds.qd[1] == (-5.0, 5.0)
    assert found.bounds.q[1] == ((-9.0, 9.0) if mode == "stick" else (-INF, INF))
    assert found.bounds.q[0] == FREE_RANGE


def test_an_open_contact_has_a_gap_and_no_force() -> None:
    for height, text in ((0.0, "z_toe_point"), (0.25, "z_toe_point - 0.25")):
        found = add(contact(height=height), "open")
        assert found.wrenches == tuple(WrenchComponent("toe_point", k, "0") for k in range(3))
        assert found.constraints == (Constraint(text, (0.0, INF), name="the gap of toe"),)
        assert found.contacts == ()


def test_a_closed_contact_is_held_along_its_normal_and_where_it_sticks() -> None:
    """One that slides has its friction against the slip, and slips one way."""
    found = add(TOE, "stick")
    assert found.contacts == (Contact("toe_point", "toe_point", (0, 2), 2, 0.5),)
    assert (found.wrenches, found.constraints) == ((), ())
    found = add(FOOT, "slide")
    assert found.contacts == (Contact("toe_point", "toe_point", (2,), 2, None),)
    for mode, factor, slip in (("forward", -0.5, (0.0, INF)), ("backward", 0.5, (-INF, 0.0))):
        found = add(TOE, mode)
        assert found.contacts == (Contact("toe_point", "toe_point", (2,), 2, None, (0, factor)),)
        assert found.wrenches == (WrenchComponent("toe_point", 0, f"{factor!r}*w7"),)
        assert found.constraints == (Constraint("vx_toe_point", slip, name="the slip of toe"),)
    side = make_contact(contact(axis=0), "forward", (0, 1))
    assert (side.axes, side.normal, side.drag) == ((0,), 0, (1, -0.5))


# --- starts ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("law", "mode", "changes", "found"),
    [
        (RUBBED, "forward", {"start_qd": (0.0, 0.0)}, []),
        (RUBBED, "forward", {"start_qd": (0.0, -0.5)}, [("velocity.a", "a starts at -0.5, and moves forward here")]),
        (RUBBED, "backward", {"start_qd": (0.0, 0.5)}, [("velocity.a", "a starts at 0.5, and moves backward here")]),
        (RUBBED, "forward", {"start_qd": (0.0, 0.5)}, []),
        (RUBBED, "forward", {"start_qd": (0.0, -0.5), "free_start": (3,)}, []),
        (RUBBED, "stick", {"start_qd": (0.0, -0.5)}, []),
        (STOPPED, "upper", {"start_q": (0.0, 2.0 + 0.9e-9)}, []),
        (
            STOPPED,
            "upper",
            {"start_q": (0.0, 2.0 - 1.1e-9)},
            [("pose.a", "a starts at 2, and is at its stop at 2 in this phase")],
        ),
        (
            STOPPED,
            "lower",
            {"start_q": (0.0, 0.5)},
            [("pose.a", "a starts at 0.5, and is at its stop at -1 in this phase")],
        ),
        (STOPPED, "lower", {"start_q": (0.0, 0.5), "free_start": (1,)}, []),
        (STOPPED, "free", {"start_q": (0.0, 0.5)}, []),
    ],
)
def test_a_given_start_is_at_the_stop_and_moves_the_way_of_its_mode(
    law: OpenJoint, mode: str, changes: dict[str, Any], found: list[tuple[str, str]]
) -> None:
    problem = state(modes=(("a", mode),), **changes)
    assert show(find_wrong_start(problem, manifest_of(law))) == found


def test_a_free_start_is_put_at_stops_at_rest_and_on_planes() -> None:
    manifest = manifest_of(BOTH, TOE)
    for mode, free, own in (
        ("upper", (1, 3), [("q_a", 2.0), ("qd_a", 0.0)]),
        ("upper", (1,), [("q_a", 2.0)]),
        ("upper", (3,), [("qd_a", 0.0)]),
        ("stick", (1, 3), [("qd_a", 0.0)]),
        ("forward", (1, 3), []),
    ):
        problem = state(modes=(("a", mode), ("toe", "open")), free_start=free)
        assert begin(problem, manifest).constraints == tuple(Constraint(x, (v, v), "start") for x, v in own)
    problem = state(modes=(("a", "forward"), ("toe", "stick")), free_start=(0,))
    assert begin(problem, manifest).constraints == (
        Constraint("z_toe_point", (0.0, 0.0), "start", name="the gap of toe"),
    )
    given = state(modes=(("a", "upper"), ("toe", "stick")))
    assert begin(given, manifest).constraints == ()


# --- ends and impacts -----------------------------------------------------------------------------------------------


def reach(law: Any, before: str, after: str, hit: str = "", *, jumps: bool = False) -> tuple[Any, Any, Any]:
    problem = state(modes=((law.name, before),), end=End(coordinates=((0, 7.0),), velocities=((0, 8.0),)))
    found = arrive(problem, {law.name: after}, {law.name: hit} if hit else {}, manifest_of(law), jumps=jumps)
    return found.end.coordinates[1:], found.end.velocities[1:], found.constraints


@pytest.mark.parametrize(
    ("law", "before", "after", "hit", "jumps", "place", "speed"),
    [
        (STOPPED, "free", "upper", "", False, 2.0, None),
        (STOPPED, "free", "lower", "", True, -1.0, None),
        (STOPPED, "upper", "upper", "", False, None, None),
        (STOPPED, "upper", "free", "", False, None, None),
        (BOUNCING, "free", "free", "upper", True, 2.0, None),
        (BOUNCING, "free", "lower", "", True, -1.0, 0.0),
        (BOUNCING, "free", "lower", "", False, -1.0, None),
        (BOTH, "forward", "stick", "", True, None, 0.0),
        (BOTH, "forward", "stick", "", False, None, None),
        (BOTH, "stick", "stick", "", True, None, None),
        (BOTH, "stick", "forward", "", True, None, None),
        (STOPPED, "lower", "upper", "", False, 2.0, None),
    ],
)
def test_a_phase_ends_where_the_next_one_begins(
    law: Any, before: str, after: str, hit: str, jumps: bool, place: float | None, speed: float | None
) -> None:
    """At the stop that is reached or hit; at rest where a joint begins to stick, and velocities jump elsewhere."""
    places, speeds, gaps = reach(law, before, after, hit, jumps=jumps)
    assert places == (() if place is None else ((1, place),))
    assert speeds == (() if speed is None else ((1, speed),))
    assert gaps == ()


def test_a_phase_ends_on_the_plane_that_is_touched_next() -> None:
    gap = (Constraint("z_toe_point", (0.0, 0.0), "end", name="the gap of toe"),)
    for before, after, hit, expected in (
        ("open", "stick", "", gap),
        ("open", "open", "stick", gap),
        ("stick", "forward", "", ()),
        ("stick", "open", "", ()),
        ("open", "open", "", ()),
    ):
        assert reach(TOE, before, after, hit)[2] == expected


def hit_between(law: Any, before: str, after: str, hit: str = "") -> Impact | None:
    laws = law if isinstance(law, tuple) else (law,)
    name = laws[0].name
    fixed = {own.name: own.name and "open" for own in laws[1:]}
    return strike(
        {name: before, **fixed}, {name: after, **fixed}, {name: hit} if hit else {}, manifest_of(*laws), {"toe": (0, 2)}
    )


def test_joints_that_come_to_a_stop_without_rebound_strike_it() -> None:
    blow = Blow(1, "a", "stop_a", is_lower=True, restitution=0.0)
    assert hit_between(STOPPED, "free", "lower") == Impact((), 0.0, blows=(blow,))
    assert hit_between(STOPPED, "free", "upper") == Impact((), 0.0, blows=(replace(blow, is_lower=False),))
    assert hit_between(STOPPED, "free", "free") is None
    assert hit_between(STOPPED, "lower", "lower") is None
    assert hit_between(BOUNCING, "free", "lower") is None
    assert hit_between(BOTH, "forward", "stick") is None
    rebound = Blow(1, "a", "stop_a", is_lower=False, restitution=0.5)
    assert hit_between(BOUNCING, "free", "free", "upper") == Impact((), 0.0, blows=(rebound,))


def test_contacts_that_close_strike_and_closed_ones_are_held_meanwhile() -> None:
    """With the restitution of the ones that rebound; a joint that stays at its stop is held too."""
    stick = make_contact(TOE, "stick", (0, 2))
    assert hit_between(TOE, "open", "stick") == Impact((stick,), 0.0)
    assert hit_between(TOE, "stick", "open") is None
    bouncy = contact(restitution=0.25)
    assert hit_between(bouncy, "open", "stick") is None
    assert hit_between(bouncy, "open", "open", "stick") == Impact((make_contact(bouncy, "stick", (0, 2)),), 0.25)
    manifest = manifest_of(STOPPED, TOE)
    found = strike({"a": "lower", "toe": "open"}, {"a": "lower", "toe": "stick"}, {}, manifest, {"toe": (0, 2)})
    assert found == Impact((stick,), 0.0, blows=(Blow(1, "a", "stop_a", is_lower=True),))
    moved = strike({"a": "lower", "toe": "open"}, {"a": "free", "toe": "stick"}, {}, manifest, {"toe": (0, 2)})
    assert moved == Impact((stick,), 0.0)
    both = strike({"a": "free", "toe": "stick"}, {"a": "upper", "toe": "forward"}, {}, manifest, {"toe": (0, 2)})
    assert both is not None
    assert both.contacts == (make_contact(TOE, "forward", (0, 2)),)


@pytest.mark.parametrize(
    ("law", "before", "after", "hit", "found"),
    [
        (BOUNCING, "free", "free", "upper", None),
        (BOUNCING, "free", "free", "free", 'a has no impact "free"'),
        (RUBBED, "forward", "forward", "stick", 'a has no impact "stick"'),
        (BOUNCING, "free", "upper", "upper", "a is held by the phase after its impact"),
        (BOUNCING, "upper", "free", "upper", "a is held by the phase before its impact"),
        (TOE, "open", "open", "stick", None),
        (TOE, "open", "open", "open", 'toe has no impact "open"'),
        (TOE, "stick", "open", "stick", "toe is held by the phase before its impact"),
    ],
)
def test_hits_are_of_free_parts_and_their_sides(law: Any, before: str, after: str, hit: str, found: str | None) -> None:
    told = find_wrong_hits({law.name: before}, {law.name: after}, {law.name: hit}, manifest_of(law))
    assert show(told) == ([(law.name, found)] if found else [])


def test_hits_at_once_have_one_restitution() -> None:
    one, other = contact("toe", restitution=0.25), contact("heel", restitution=0.5)
    modes = {"toe": "open", "heel": "open"}
    for second, count in ((other, 1), (contact("heel", restitution=0.25), 0)):
        found = show(find_wrong_hits(modes, modes, {"toe": "stick", "heel": "stick"}, manifest_of(one, second)))
        assert len(found) == count
    assert show(find_wrong_hits(modes, modes, {"toe": "stick"}, manifest_of(one, other))) == []
    assert show(find_wrong_hits({}, {}, {"b": "stick"}, manifest_of(one))) == [
        ("b", 'the model has no joint or contact "b" with modes')
    ]
