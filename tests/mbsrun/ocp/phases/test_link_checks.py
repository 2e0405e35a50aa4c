"""Faults of phases and links, one by one: names, maps, velocities, impacts and contacts of small mechanisms."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsgen.documents import Finding
from mbsrun.ocp.problem.phases import Blow, Condition, Impact, Link, Phase, PhasedProblem, Plants
from mbsrun.ocp.problem.problem import Cost, Loops, Problem, SolverOptions, Term, Unknown
from mbsrun.ocp.statement import phase_checks
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.phase_checks import _check_contact, _check_whole, _Link, check_phases, find_faults
from tests.mbsrun.ocp.plants import cart_pole, push
from tests.mbsrun.peer import double_integrator

SLIDE, CART = double_integrator(), cart_pole()
SAME: tuple[Any, Any] = (SLIDE, SLIDE)
EASY = replace(push(2), end=replace(push(2).end, coordinates=()))


def make(*links: Link, parts: tuple[Problem, ...] = (EASY, EASY), **given: Any) -> PhasedProblem:
    """Phases a, b, ... with links."""
    return PhasedProblem("whole", tuple(Phase("abc"[k], part) for k, part in enumerate(parts)), links, **given)


def find(problem: PhasedProblem, plants: Any = SAME) -> list[tuple[str, str, str]]:
    return list(map(show, find_faults(problem, Plants(tuple(plants)))))


def show(finding: Finding) -> tuple[str, str, str]:
    return ".".join(map(str, finding.place)), finding.finding, finding.remedy


def link(**given: Any) -> Link:
    return Link("a", "b", **given)


# --- the whole ------------------------------------------------------------------------------------------------------


def test_phases_have_names_and_one_has_a_cost() -> None:
    none: Any = PhasedProblem("whole", ())
    assert list(map(show, _check_whole(none))) == [("phases", "there are none", "give at least one phase")]
    free = replace(EASY, cost=Cost(0.0, 0.0))
    assert list(_check_whole(make(parts=(EASY, free)))) == []
    (found,) = _check_whole(make(parts=(free, free)))
    assert show(found)[:2] == ("phases", "every weight of every phase's cost is 0")
    for name, is_good in (("a1_B", True), ("1a", False), ("", False), ("a b", False), ("é", False), ("a.b", False)):
        found_names = list(_check_whole(PhasedProblem("whole", (Phase("a", EASY), Phase(name, EASY)))))
        assert [show(x)[0] for x in found_names] == ([] if is_good else ["phases.1.name"])
    twice = list(_check_whole(PhasedProblem("whole", tuple(Phase(name, EASY) for name in "abcbb"))))
    assert [show(x)[:2] for x in twice] == [
        ("phases.3.name", "a second phase b"),
        ("phases.4.name", "a second phase b"),
    ]


def test_methods_of_c_take_no_expressions_of_casadi_and_threads_are_theirs_alone() -> None:
    for method, threads, places in (
        ("mbs", 2, []),
        ("ipopt", 2, ["solver.threads"]),
        ("ipopt", 1, []),
    ):
        found = _check_whole(make(solver=SolverOptions(method=method, threads=threads)))
        assert [show(x)[0] for x in found] == places


@pytest.mark.parametrize(
    ("links", "found"),
    [
        ((Link("a", "b"),), []),
        ((Link("a", "x"),), [("links.0.to", 'there is no phase "x"')]),
        ((Link("", "b"),), [("links.0.from", "missing")]),
        ((Link("a", "b"), Link("b", "a"), Link("a", "b")), [("links.2.to", "a second link leads to the start of b")]),
        ((Link("x", "y"),), [("links.0.from", 'there is no phase "x"'), ("links.0.to", 'there is no phase "y"')]),
    ],
)
def test_links_tie_phases_that_are_there_and_each_start_once(
    links: tuple[Link, ...], found: list[tuple[str, str]]
) -> None:
    assert [x[:2] for x in find(make(*links))] == found


def test_faults_of_phases_come_before_faults_of_links() -> None:
    """And name their phase; a problem of one phase without a name has no links."""
    bad = replace(EASY, intervals=0)
    plants = Plants((SLIDE, SLIDE))
    with pytest.raises(ProblemError) as error:
        check_phases(make(Link("a", "x"), parts=(EASY, bad)), plants)
    assert [place for place, *_ in error.value.findings] == ["phase b: intervals"]
    with pytest.raises(ProblemError) as error:
        check_phases(make(Link("a", "x")), plants)
    assert [place for place, *_ in error.value.findings] == ["links[0].to"]
    check_phases(PhasedProblem("whole", (Phase("", EASY),)), Plants((SLIDE,)))


# --- maps -----------------------------------------------------------------------------------------------------------


def check_map(given: dict[str, str | None], before: Any, after: Any, **more: Any) -> list[tuple[str, str, str]]:
    own = _Link(make(link(), constants=(("k", 1.0),), unknowns=(Unknown("n", (0.0, 9.0), 1.0),)), Plants(SAME), 0)
    found = own.check_map(("map",), tuple(given.items()), before.manifest, after.manifest, **more)
    return list(map(show, found))


def test_a_map_gives_each_coordinate_that_only_the_phase_after_has() -> None:
    """By an expression, or null; coordinates of equal names follow."""
    assert check_map({}, CART, CART) == []
    assert check_map({"slide": "cart + k*n"}, CART, SLIDE) == []
    assert check_map({"slide": None}, CART, SLIDE, velocities=(("slide", None),)) == []
    (missing,) = check_map({}, CART, SLIDE)
    assert missing[:2] == ("map", "cart-pole has no coordinate slide, which double integrator has")
    (unknown, _) = check_map({"slode": "1"}, CART, SLIDE)
    assert unknown == ("map.slode", "double integrator has no such coordinate to map", 'did you mean "slide"?')
    (unknown, _) = check_map({"qqq": None}, CART, SLIDE)
    assert unknown[2] == "there are slide"
    (text,) = check_map({"slide": "carr"}, CART, SLIDE)
    assert text == ("map.slide", 'unknown name "carr"', 'did you mean "cart"?')
    (text,) = check_map({"slide": "1 +"}, CART, SLIDE)
    assert text[0] == "map.slide"
    (kink,) = check_map({"slide": "max(cart, 0)"}, CART, SLIDE)
    assert kink[0] == "map.slide"


def test_a_map_gives_states_that_the_problem_adds() -> None:
    states = {"states_before": ("heat",), "states_after": ("cold",)}
    assert check_map({"cold": "heat + 1"}, CART, CART, **states) == []
    assert check_map({"cold": None}, CART, CART, **states) == []
    (text,) = check_map({"cold": "cold + 1"}, CART, CART, **states)
    assert text[:2] == ("map.cold", 'unknown name "cold"')


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ({"states_before": ("cart",)}, "cart"),
        ({"states_after": ("pole",)}, "pole"),
        ({"states_before": ("k",)}, "k"),
        ({"states_before": ("n", "pole")}, "n, pole"),
    ],
)
def test_a_name_has_one_meaning_in_a_map(given: dict[str, Any], name: str) -> None:
    (found,) = check_map({}, CART, CART, **given)
    assert found[1] == f"{name} has two meanings, among coordinates, states, constants and unknowns"


def test_velocities_that_nothing_gives_are_missing() -> None:
    """Where the coordinate has one, or is mapped, the velocity follows; else it is given."""
    turned = cart_pole()
    own: Any = SimpleNamespace(
        manifest=SimpleNamespace(
            model="turned", positions=("cart", "pole"), quaternions=(),
            coordinates=(*CART.manifest.coordinates[:1], SimpleNamespace(name="spin")),
        )
    )  # fmt: skip
    (found,) = check_map({}, turned, own)
    assert found[:2] == ("velocities", "cart-pole has no velocity of spin")
    assert check_map({}, turned, own, velocities=(("spin", "1"),)) == []


def test_velocities_of_a_link_are_of_joints_and_read_velocities() -> None:
    own = _Link(make(link(), constants=(("k", 1.0),)), Plants(SAME), 0)

    def check(**given: str | None) -> list[tuple[str, str, str]]:
        return list(map(show, own.check_velocities(tuple(given.items()), CART.manifest, SLIDE.manifest)))

    assert check(slide="cart*k") == []
    assert check(slide=None) == []
    assert check(slode="1") == [
        ("links.0.velocities.slode", "double integrator has no such velocity", 'did you mean "slide"?')
    ]
    assert check(qqq=None)[0][2] == "there are slide"
    assert check(slide="slide")[0][:2] == ("links.0.velocities.slide", 'unknown name "slide"')


def test_a_coordinate_is_given_once_at_a_link() -> None:
    """By the end before, by the start after, or by the link: unless the start is free, or the map has another value."""
    end = replace(EASY, end=replace(EASY.end, coordinates=((0, 1.0),)))
    for before, after, chosen, count in (
        (end, EASY, (), 1),
        (end, replace(EASY, free_start=(0,)), (), 0),
        (EASY, EASY, (), 0),
        (end, EASY, (("slide", "0"),), 0),
    ):
        found = find(make(link(map=chosen), parts=(before, after)))
        assert len(found) == count
        if count:
            told = "slide has a value at the end of a and at the start of b"
            assert found[0] == ("links.0", told, "leave one out: the link gives the other")


def test_costs_and_conditions_read_both_sides() -> None:
    good = link(cost=(Term("end_q_slide + start_q_slide + k", 2.0),), conditions=(Condition("k", (0.0, 0.0)),))
    assert find(make(good, constants=(("k", 1.0),))) == []
    bad = link(
        cost=(Term("end_q_slode", 2.0), Term("k", float("inf"))),
        conditions=(Condition("q_slide", (1.0, 0.5)), Condition("start_qd_slide", (1.0, 1.0))),
    )
    found = find(make(bad, constants=(("k", 1.0),)))
    assert [(place, finding) for place, finding, _ in found] == [
        ("links.0.cost.0.expression", 'unknown name "end_q_slode"'),
        ("links.0.cost.1.weight", "found inf"),
        ("links.0.conditions.0.expression", 'unknown name "q_slide"'),
        ("links.0.conditions.0.range", "1 is above 0.5"),
    ]


# --- impacts --------------------------------------------------------------------------------------------------------


def check_impact(impact: Impact, own: Problem = EASY, **given: Any) -> list[tuple[str, str, str]]:
    link_of = _Link(make(link(impact=impact)), Plants(SAME), 0)
    plant = given.get("plant", SLIDE)
    return list(map(show, link_of.check_impact(impact, plant, given.get("before", SLIDE.manifest), own)))


def test_an_impact_has_contacts_or_stops_and_a_restitution_up_to_1(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(phase_checks, "_check_contact", lambda *_: iter(()))
    blow = Blow(0, "slide", "stop", is_lower=True)
    contact: Any = SimpleNamespace(sensor="place")
    assert check_impact(Impact((), 0.0, (), (blow,))) == []
    assert check_impact(Impact((contact,))) == []
    assert check_impact(Impact(()))[0][:2] == ("links.0.impact.contacts", "there are none")
    for restitution, is_good in ((0.0, True), (1.0, True), (-0.1, False), (1.1, False), (float("nan"), False)):
        places = [x[0] for x in check_impact(Impact((contact,), restitution))]
        assert places == ([] if is_good else ["links.0.impact.restitution"])
    (loops,) = check_impact(Impact((contact,)), replace(EASY, loops=Loops.REDUCED))
    assert loops[:2] == ("links.0.impact", "phase a has loops: reduced, and an impact changes all velocities")


def test_another_model_of_an_impact_is_mapped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(phase_checks, "_check_contact", lambda *_: iter(()))
    contact: Any = SimpleNamespace(sensor="place")
    (missing,) = check_impact(Impact((contact,)), before=CART.manifest)
    assert missing[:2] == ("links.0.impact.map", "cart-pole has no coordinate slide, which double integrator has")
    assert check_impact(Impact((contact,), map=(("slide", "cart"),)), before=CART.manifest) == []
    (wrong,) = check_impact(Impact((contact,), map=(("other", "1"),)))
    assert wrong[0] == "links.0.impact.map.other"


def test_a_contact_that_rebounds_is_not_held_after() -> None:
    def touch(sensor: str, axes: tuple[int, ...] = (0, 2)) -> Any:
        return SimpleNamespace(sensor=sensor, normal=2, axes=axes)

    for restitution, contact, held, count in (
        (0.5, touch("foot"), touch("foot"), 1),
        (0.0, touch("foot"), touch("foot"), 0),
        (0.5, touch("foot"), touch("hand"), 0),
        (0.5, touch("foot", (0,)), touch("foot"), 0),
    ):
        after: Any = SimpleNamespace(contacts=(held,))
        own = _Link(make(link()), Plants(SAME), 0)
        found = list(map(show, own.check_rebound(Impact((contact,), restitution), after)))
        assert len(found) == count
        if found:
            assert found[0][:2] == ("links.0.impact.restitution", "foot rebounds, and phase b holds it")


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({}, []),
        ({"sensor": "plate"}, [("contact", 'double integrator has no sensor "plate"', 'did you mean "place"?')]),
        ({"sensor": "xyz"}, [("contact", 'double integrator has no sensor "xyz"', "there are place")]),
        ({"friction": 0.0}, []),
        ({"friction": -0.1}, [("contact.friction", "found -0.1", "give a number that is not negative")]),
        ({"axes": (0, 1)}, [("contact.axes", "place cannot move along y", "give axes: x")]),
        ({"axes": (1, 2)}, [("contact.axes", "place cannot move along y, z", "give axes: x")]),
    ],
)
def test_contacts_are_of_sensors_that_move(
    monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any], found: list[tuple[str, str, str]]
) -> None:
    """A wrench acts at the sensor, to 1e-9."""
    monkeypatch.setattr(phase_checks, "find_wrench", lambda *_: 3)
    contact: Any = SimpleNamespace(**({"sensor": "place", "friction": None, "axes": (0,), "wrench": "push"} | changes))
    for apart, is_there in ((0.9e-9, True), (1.1e-9, False)):
        monkeypatch.setattr(phase_checks, "_measure_distance", lambda *_, apart=apart: apart)
        told = list(map(show, _check_contact(("contact",), contact, SLIDE, ["place"])))
        assert told[: len(found)] == found
        is_judged = changes.get("sensor") is None and not is_there
        assert [x[1] for x in told[len(found) :]] == (
            ["the wrench push does not act at the sensor place"] if is_judged else []
        )


def test_a_contact_needs_an_open_force_in_axes_of_the_base(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(phase_checks, "find_wrench", lambda *_: None)
    monkeypatch.setattr(phase_checks, "find_axes", lambda *_: (0,))
    contact: Any = SimpleNamespace(sensor="place", friction=None, axes=(0,), wrench="push")
    known = [SimpleNamespace(name=f"w{k}", force=k != 1, in_base=k != 2) for k in range(4)]
    for wrenches, remedy in ((known, "there are w0, w3"), (known[1:3], "give the model wrenches: ")):
        plant: Any = SimpleNamespace(manifest=SimpleNamespace(model="m", wrenches=wrenches))
        (found,) = map(show, _check_contact(("contact",), contact, plant, ["place"]))
        assert found[1] == 'm leaves no force "push" open, in axes of the base'
        assert found[2].startswith(remedy)


def test_a_reduced_form_before_asks_for_one_after() -> None:
    own = _Link(make(link()), Plants(SAME), 0)
    (found,) = own.check_speeds(EASY)
    assert show(found)[:2] == ("links.0", "phase a has loops: reduced, phase b has all velocities")
    assert list(own.check_speeds(replace(EASY, loops=Loops.REDUCED))) == []


def test_a_wrench_is_where_its_force_does_the_work_of_the_sensor() -> None:
    """The largest entry of J_c' + dPhi/dw, of the wrench's own columns and the sensor's own rows."""
    J = np.arange(12.0).reshape(6, 2)
    by_force = np.full((2, 9), 77.0)
    by_force[:, 3:6] = -J[3:6].T
    by_force[1, 4] += 0.25

    class Kernels:
        manifest = SimpleNamespace(coordinates=("a", "b"), positions=("a", "b"), quaternions=())

        def describe(self, _: str) -> Any:
            return SimpleNamespace(inputs=[SimpleNamespace(name=name, rows=2) for name in ("q", "qd", "w", "p")])

        def __call__(self, name: str, **state: Any) -> dict[str, Any]:
            assert set(state) == ({"q", "qd", "w"} if name == "jac_impl" else {"q", "qd"})
            assert state["q"].any()
            return {"jac_Phi_w": by_force} if name == "jac_impl" else {"jac_v_qd": J}

    plant: Any = Kernels()
    assert phase_checks._measure_distance(plant, 1, 3) == 0.25
