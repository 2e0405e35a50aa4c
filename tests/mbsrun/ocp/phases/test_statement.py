"""Problem files with phases: defaults, and every fault with its line, path, finding and remedy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import casadi as ca
import pytest

from mbsgen.errors import InputError
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.phases import PhasedProblem
from mbsrun.ocp.statement.phases import has_phases, read_phased_problem
from mbsrun.ocp.statement.statement import read_problem
from tests.mbsrun.ocp.plants import cart_pole, mechanism
from tests.mbsrun.peer import Peer, double_integrator

GOOD = """\
model: cart.yaml
constants: {a: 2, way: a/4}
horizon: 1
intervals: 10
scheme: radau
degree: 3
cost: {inputs: 1}
unknowns: {stride: {range: [0, 1], guess: 0.5}}
phases:
  - name: first
    start: {pose: {cart: way}}
  - name: second
    intervals: 4
    cost: {input_rates: 0.5}
    start: {velocity: {pole: 0.1}}
    end: {pose: {pole: pi}}
links:
  - from: first
    to: second
    map: {cart: cart + stride}
    conditions:
      - {expression: end_q_pole + a*start_qd_pole, range: [0, null]}
"""


def models(path: Path) -> Plant:
    known: dict[str, Callable[[], Peer]] = {"cart.yaml": cart_pole, "slide.yaml": double_integrator}
    if path.name == "push.yaml":
        return pushed()
    return known[path.name]()


def pushed() -> Peer:
    """A mechanism of the name slide, whose sensor cannot be held: it leaves no force open."""
    q, qd, qdd, u = (ca.SX.sym(name) for name in ("q", "qd", "qdd", "u"))
    return mechanism(("slide",), qdd - u + 0 * q * qd, (q, qd, qdd, u))


@pytest.fixture
def read(tmp_path: Path) -> Callable[[str], PhasedProblem]:
    def do(text: str) -> PhasedProblem:
        (tmp_path / "file.ocp.yaml").write_text(text)
        return read_phased_problem(tmp_path / "file.ocp.yaml", models)[0]

    return do


def test_phases_take_the_defaults_of_the_file(read: Callable[[str], PhasedProblem]) -> None:
    """A mapping of a phase replaces the keys that it names; a linked start is free where nothing is given."""
    problem = read(GOOD)
    first, second = (phase.problem for phase in problem.phases)
    assert [first.intervals, second.intervals] == [10, 4]
    assert [first.cost.weights, second.cost.weights] == [(1.0, 0.0), (1.0, 0.5)]
    assert first.start_q == (0.5, 0.0)
    assert [first.free_start, second.free_start] == [(), (0, 1, 2)]
    assert second.start_qd == (0.0, 0.1)
    assert problem.constants == (("a", 2.0), ("way", 0.5))
    assert [unknown.name for unknown in problem.unknowns] == ["stride"]
    (link,) = problem.links
    assert (link.source, link.target, link.map) == ("first", "second", (("cart", "cart + stride"),))
    assert link.conditions[0].range == (0.0, float("inf"))


def test_slacks_and_largest_values_are_of_one_phase_unless_they_have_a_name(
    read: Callable[[str], PhasedProblem],
) -> None:
    own = "cost: {inputs: 1, largest: [{expression: u_cart}, {expression: q_cart, name: far}]}\n"
    own += "constraints: [{expression: q_cart, range: [0, 1], at: end, soft: 3}]"
    problem = read(GOOD.replace("cost: {inputs: 1}", own))
    assert [unknown.name for unknown in problem.every_unknown] == [
        "stride", *(f"first_{x}" for x in ("slack_0", "largest_0")), "far", "second_slack_0", "second_largest_0"
    ]  # fmt: skip


def test_a_file_with_links_alone_has_one_phase(read: Callable[[str], PhasedProblem], tmp_path: Path) -> None:
    own = GOOD.split("phases:")[0] + "start: {pose: {pole: null}}\nlinks: [{}]\n"
    problem = read(own)
    assert has_phases(tmp_path / "file.ocp.yaml")
    assert [phase.name for phase in problem.phases] == ["motion"]
    assert (problem.links[0].source, problem.links[0].target) == ("motion", "motion")
    (tmp_path / "plain.ocp.yaml").write_text(own.replace("links: [{}]\n", ""))
    assert not has_phases(tmp_path / "plain.ocp.yaml")


FAULTS: dict[str, tuple[str, str, str]] = {  # the text that is replaced, the new one, and the fault
    "no phases": ("phases:", "phases: []\nothers:", "phases: found an empty list; give at least one phase"),
    "phases that are no list": (
        "phases:\n  - name: first",
        "phases:\n  name: first\n  u:\n  - name: f",
        "phases: found",
    ),
    "no name": ("  - name: second\n    int", "  - int", "phases[1].name: missing; give it"),
    "a name twice": ("name: second", "name: first", "phases[1].name: a second phase first; give it another name"),
    "no word": ("name: second", "name: the second", 'phases[1].name: found "the second"; give a word'),
    "unknown key": (
        "    intervals: 4",
        "    interval: 4",
        "phases[1].interval: unknown key; did you mean `intervals`?",
    ),
    "unknown key of the file": ("intervals: 10", "interval: 10", "interval: unknown key; did you mean `intervals`?"),
    "missing key": ("horizon: 1\n", "", "phases[0].horizon: missing; give it"),
    "solver of a phase": (
        "    intervals: 4",
        "    solver: {}",
        "phases[1].solver: solver belongs to the whole problem",
    ),
    "solution of a phase": (
        "    intervals: 4",
        "    guess: {solution: a.json}",
        "phases[1].guess.solution: the solution is of the whole problem; move it out of the phase: one file holds all "
        "phases; or give the phase a recording",
    ),
    "number of a phase": ("{cart: way}", "{cart: wy}", "phases[0].start.pose.cart: unknown name"),
    "number of the file": ("horizon: 1", "horizon: -1", "horizon: found -1; give a positive number"),
    "coordinate": ("{pole: pi}", "{pol: pi}", 'phases[1].end.pose.pol: the model has no coordinate "pol"; did you'),
    "start that no link gives": ("    start: {pose: {cart: way}}\n", "", "phases[0].start: missing; give pose"),
    "method": (
        "degree: 3",
        "degree: 3\nsolver: {method: mb}",
        'solver.method: found "mb"',
    ),
    "unknown phase": ("from: first", "from: frst", 'links[0].from: there is no phase "frst"; did you mean "first"?'),
    "no phase": ("  - from: first\n    to", "  - to", "links[0].from: missing; there are first, second"),
    "two links": (
        "links:\n",
        "links:\n  - {from: second, to: second}\n",
        "links[1].to: a second link leads to the start of second; leave one out",
    ),
    "key of a link": ("    to: second", "    to: second\n    mp: {}", "links[0].mp: unknown key; did you mean `map`?"),
    "coordinate of a map": (
        "map: {cart:",
        "map: {crt:",
        "links[0].map.crt: cart-pole has no such coordinate to map; did",
    ),
    "name of a map": (
        "cart + stride",
        "cart + strde",
        'links[0].map.cart: unknown name "strde"; did you mean "stride"?',
    ),
    "syntax of a map": ("cart + stride", "cart + (", "links[0].map.cart: "),
    "two meanings": ("a: 2", "cart: 2, a: 2", "links[0].map: cart has two meanings"),
    "velocity": (
        "map: {",
        "velocities: {crt: 1}\n    map: {",
        "links[0].velocities.crt: cart-pole has no such velocity",
    ),
    "name of a velocity": (
        "map: {",
        "velocities: {cart: q_cart}\n    map: {",
        'links[0].velocities.cart: unknown name "q_cart"',
    ),
    "name of a condition": (
        "end_q_pole +",
        "q_pole +",
        'links[0].conditions[0].expression: unknown name "q_pole"; did you mean "end_q_pole"?',
    ),
    "range": ("[0, null]", "[2, 1]", "links[0].conditions[0].range: 2 is above 1; give [lower, upper]"),
    "no range": (", range: [0, null]", "", "links[0].conditions[0].range: missing"),
    "sensor": (
        "    map: {",
        "    impact: {contacts: [foot]}\n    map: {",
        "links[0].impact.contacts[0]: cart-pole has no sensor",
    ),
    "no contacts": ("    map: {", "    impact: {contacts: []}\n    map: {", "links[0].impact.contacts: there are none"),
    "restitution": (
        "    map: {",
        "    impact: {contacts: [foot], restitution: 1.5}\n    map: {",
        "links[0].impact.restitution: found 1.5; give a number from 0 to 1",
    ),
    "axes": (
        "    map: {",
        "    impact: {contacts: [{sensor: foot, axes: xx}]}\n    map: {",
        'links[0].impact.contacts[0].axes: found "xx"; give some of x, y, z',
    ),
    "unknown of a phase": (
        "    intervals: 4",
        "    unknowns: {}",
        "phases[1].unknowns: unknowns belongs to the whole problem",
    ),
    "unknown guess": ("guess: 0.5", "guess: 5", "unknowns.stride.guess: 5 is out of [0, 1]; guess within the range"),
    "name of a cost": (
        "    map: {",
        "    cost: [{expression: q_pole}]\n    map: {",
        'links[0].cost[0].expression: unknown name "q_pole"; did you mean "end_q_pole"?',
    ),
    "syntax of a cost": ("    map: {", "    cost: [{expression: 2*}]\n    map: {", "links[0].cost[0].expression: "),
    "weight of a cost": (
        "    map: {",
        "    cost: [{expression: end_T, weight: b}]\n    map: {",
        "links[0].cost[0].weight: unknown name",
    ),
    "a cost that is no list": ("    map: {", "    cost: {inputs: 1}\n    map: {", "links[0].cost: found"),
    "impulse without an impact": (
        "    map: {",
        "    cost: [{expression: jz_place}]\n    map: {",
        'links[0].cost[0].expression: unknown name "jz_place"',
    ),
    "delay without a history": (
        "    intervals: 4",
        "    intervals: 4\n    inputs: {delay: 0.25}",
        "phases[1].inputs.delay: the phase before gave the inputs that act first, and the file does not say which; "
        "give history: link, for commands of the phase before; a number; or free",
    ),
    "price of a slack": (
        "    intervals: 4",
        "    constraints: [{expression: q_cart, range: [0, 1], soft: -1}]\n    intervals: 4",
        "phases[1].constraints[0].soft: found -1; give a number that is not negative",
    ),
    "name that phases share with an unknown": (
        "    cost: {input_rates: 0.5}",
        "    cost: {largest: [{expression: q_cart, name: stride}]}",
        'phases[1].cost.largest[0].name: no name for a largest value: "stride"',
    ),
    "model of an impact": (
        "    map: {",
        "    impact: {contacts: [place], model: push.C}\n    map: {",
        'links[0].impact.model: found "push.C"; give a model file (.yaml)',
    ),
}


@pytest.mark.parametrize(("old", "new", "fault"), FAULTS.values(), ids=FAULTS.keys())
def test_a_fault_is_named_with_its_place(old: str, new: str, fault: str, read: Callable[[str], PhasedProblem]) -> None:
    assert GOOD.count(old) >= 1
    with pytest.raises(InputError) as refusal:
        read(GOOD.replace(old, new, 1))
    texts = [str(found) for found in refusal.value.faults]
    assert any(fault in text for text in texts)


def faults_of(read: Callable[[str], PhasedProblem], *changes: tuple[str, str]) -> list[str]:
    text = GOOD
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    with pytest.raises(InputError) as refusal:
        read(text)
    return [str(found).partition(": ")[2] for found in refusal.value.faults]


def test_phases_cost_something_together(read: Callable[[str], PhasedProblem]) -> None:
    texts = faults_of(read, ("cost: {inputs: 1}", "cost: {inputs: 0}"), ("    cost: {input_rates: 0.5}\n", ""))
    assert texts == ["phases: every weight of every phase's cost is 0; give one of them a cost"]


def test_a_value_that_is_given_on_both_sides_is_refused(read: Callable[[str], PhasedProblem]) -> None:
    first = ("    start: {pose: {cart: way}}\n", "    start: {pose: {cart: way}}\n    end: {pose: {pole: 1}}\n")
    texts = faults_of(read, first, ("{velocity: {pole: 0.1}}", "{pose: {pole: 1}}"))
    assert texts == [
        "links[0]: pole has a value at the end of first and at the start of second; leave one out: the link gives the "
        "other"
    ]


def test_a_mechanism_with_other_coordinates_needs_a_map(read: Callable[[str], PhasedProblem]) -> None:
    """The map gives what the phase before has not; expressions read that phase's names."""
    texts = faults_of(
        read,
        (
            "  - name: first\n    start: {pose: {cart: way}}\n",
            "  - name: first\n    model: slide.yaml\n    start: {pose: {}}\n",
        ),
    )
    assert texts == [
        "links[0].map: double integrator has no coordinate pole, which cart-pole has; give each an expression, or null "
        "where it is free",
        'links[0].map.cart: unknown name "cart"; known here are slide, a, way, stride',
        'links[0].conditions[0].expression: unknown name "end_q_pole"; did you mean "end_z_place"?',
    ]


def test_a_contact_is_at_a_force_that_the_model_leaves_open(read: Callable[[str], PhasedProblem]) -> None:
    slide = ("model: cart.yaml", "model: slide.yaml"), ("{pose: {cart: way}}", "{pose: {}}")
    rest = ("    start: {velocity: {pole: 0.1}}\n    end: {pose: {pole: pi}}\n", "")
    link = GOOD[GOOD.index("    map:") :]
    hit = "    impact: {contacts: [place, {sensor: place, axes: xz}]}\n"
    texts = faults_of(read, *slide, rest, (link, hit))
    closed = (
        'double integrator leaves no force "place" open, in axes of the base; '
        "give the model wrenches: [{name: NAME, body: ..., position: ..., frame: base, force: input}]"
    )
    assert texts == [
        f"links[0].impact.contacts[0]: {closed}",
        f"links[0].impact.contacts[1]: {closed}",
        "links[0].impact.contacts[1].axes: place cannot move along z; give axes: x",
    ]


def test_commands_for_one_phase_refuse_several_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "file.ocp.yaml").write_text(GOOD)
    with pytest.raises(InputError, match="a problem with phases; only `mbsrun solve`"):
        read_problem(tmp_path / "file.ocp.yaml", models)
