"""Modes of phases: stops, dry friction and rigid contacts of the model, against closed forms and the simulation."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from mbsgen.errors import InputError
from mbsrun.external import load_on_demand
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solving.phases import Ready, prepare_phases, resimulate_phases, solve_phases
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.phases import read_phased_problem

G = 9.81
MODELS = Path(__file__).parents[4] / "models" / "modes"
SOLVED = 1e-6  # of numbers that the solver finds to its tolerance of 1e-8


def solve(file: Path) -> tuple[PhasedSolution, Plants]:
    """Solve a problem file, and simulate its phases again."""
    problem, plants = read_phased_problem(file, load_on_demand)
    found = solve_phases(problem, plants)
    assert isinstance(found, PhasedSolution), found
    return resimulate_phases(found, plants), plants


def write(folder: Path, model: str, problem: str) -> Path:
    """Write a model and a problem of it."""
    (folder / "model.yaml").write_text(model, encoding="utf-8")
    file = folder / "problem.ocp.yaml"
    file.write_text("model: model.yaml\n" + problem, encoding="utf-8")
    return file


def check_followed(solution: PhasedSolution, accuracy: float = 1e-9) -> None:
    """Check that the simulation from event to event follows the phases."""
    (followed,) = solution.followed
    assert followed.finding == ""
    assert followed.error is not None
    assert followed.error < accuracy


def test_a_crate_is_pushed_in_least_time() -> None:
    """With a = (F - T)/m and b = (F + T)/m, v^2 (1/a + 1/b)/2 = 1 m, and the time is v (1/a + 1/b)."""
    solution, _ = solve(MODELS / "crate_push.ocp.yaml")
    a, b = (10 - 2) / 1, (10 + 2) / 1
    v = math.sqrt(2 / (1 / a + 1 / b))
    assert solution.durations[:2] == pytest.approx((v / a, v / b), abs=SOLVED)
    rest = solution.find("rest").trajectory
    assert abs(rest.q[-1, 0] - rest.q[0, 0]) < 1e-12
    check_followed(solution)


def test_a_ball_bounces_by_its_restitution() -> None:
    """Each impulse is (1 + e) m times the speed of arrival; without inputs, energy gives the speeds."""
    solution, plants = solve(MODELS / "ball_bounce.ocp.yaml")
    check_followed(solution)
    for k, values in enumerate(solution.values):
        before, after = (solution.phases[i].trajectory for i in (k, k + 1))
        ((joint, impulse),) = values.stops
        assert joint == "ball"
        assert impulse == pytest.approx(-1.8 * before.qd[-1, 0], abs=1e-9)
        assert after.qd[0, 0] == pytest.approx(-0.8 * before.qd[-1, 0], abs=1e-9)
    assert [x.trajectory.q[-1, 0] for x in solution.phases] == pytest.approx([0, 0, 0.6], abs=1e-9)
    # a solution that another restitution had given is found to differ: the inputs of the fall, reversed
    fall = solution.phases[0]
    wrong = replace(fall, trajectory=replace(fall.trajectory, u=-fall.trajectory.u))
    changed = resimulate_phases(replace(solution, phases=(wrong, *solution.phases[1:])), plants)
    assert changed.followed[0].finding


SLEDGE = """
name: sledge
gravity: [0, 0, -9.81]
bodies:
  - name: box
    joint:
      - {name: x, type: prismatic, axis: x, max_force: 30}
      - {name: z, type: prismatic, axis: z, max_force: 30}
    mass: 2
contacts:
  - {name: sole, body: box, restitution: 0, friction: {coefficient: 0.4}}
"""
LANDING = """
intervals: 2
degree: 2
horizon: {guess: 0.4, range: [0.01, 2]}
cost: {inputs: 1}
modes: {sole: open}
phases:
  - name: fall
    start: {pose: {x: 0, z: 1}, velocity: {x: 3, z: 0}}
    guess: {end: {z: 0.1, x: 0.3}}
  - name: slide
    modes: {sole: forward}
    guess: {end: {z: 0, x: 0.6}}
  - name: stay
    modes: {sole: stick}
    horizon: 0.2
links:
  - {from: fall, to: slide}
  - {from: slide, to: stay}
"""


def test_a_box_lands_slides_and_sticks(tmp_path: Path) -> None:
    """Nothing pushes it: it lands with v = sqrt(2 g h), loses mu v along, and slides for (3 - mu v)/(mu g)."""
    solution, _ = solve(write(tmp_path, SLEDGE, LANDING))
    v, mu = math.sqrt(2 * G), 0.4
    assert solution.durations[:2] == pytest.approx((v / G, (3 - mu * v) / (mu * G)), abs=SOLVED)
    (impulse,) = solution.values[0].impulses
    assert impulse.components[2] == pytest.approx(2 * v, abs=SOLVED)
    assert solution.find("slide").trajectory.qd[0, 0] == pytest.approx(3 - mu * v, abs=SOLVED)
    check_followed(solution)


DOCK = """
name: dock
gravity: [0, 0, 0]
bodies:
  - {name: a, joint: {type: prismatic, axis: x, max_force: 20}, mass: 1}
  - {name: b, parent: a, joint: {type: prismatic, axis: x, limits: [0, 2], stops: {restitution: 0}}, mass: 3}
"""
DOCKING = """
intervals: 2
degree: 2
horizon: {guess: 0.5, range: [0.01, 1]}
cost: {inputs: 1}
modes: {}
phases:
  - name: fly
    start: {pose: {a: 0, b: 1}, velocity: {a: 0, b: 2}}
    horizon: 0.5
  - name: stay
    modes: {b: upper}
    horizon: 0.5
links:
  - {from: fly, to: stay}
"""


def test_an_end_that_planes_imply_is_stated_once(tmp_path: Path) -> None:
    """The trunk is as high as the leg is long: one of both is left out, and another length is refused."""
    text = (MODELS / "hopper_jump.ocp.yaml").read_text(encoding="utf-8").replace("hopper.yaml", f"{MODELS}/hopper.yaml")
    ends = []
    for length in (0.4, 0.41):
        file = tmp_path / f"{length}.ocp.yaml"
        file.write_text(text.replace("leg: 0.4}, velocity: zero", f"leg: {length}}}"), encoding="utf-8")
        ends.append(read_phased_problem(file, load_on_demand))
    ready = prepare_phases(*ends[0])
    assert isinstance(ready, Ready)
    assert [len(own.phases[2].problem.end.coordinates) for own in (ends[0][0], ready.problem)] == [2, 1]
    with pytest.raises(ProblemError, match=r"landing: end.coordinates: .* differ from the given ones by 0\.01 "):
        prepare_phases(*ends[1])


def test_two_bodies_become_one_at_a_stop(tmp_path: Path) -> None:
    """Without inputs, momentum stays: 3 kg with 2 m/s take 1 kg along, 1.5 m/s for both."""
    solution, _ = solve(write(tmp_path, DOCK, DOCKING))
    assert solution.cost == pytest.approx(0, abs=SOLVED)
    assert solution.find("stay").trajectory.qd[-1] == pytest.approx((1.5, 0), abs=SOLVED)
    assert solution.values[0].stops == (("b", pytest.approx(-1.5, abs=SOLVED)),)
    check_followed(solution)


STUCK = """
name: stuck
gravity: [0, 0, -9.81]
bodies:
  - {name: block, joint: {type: prismatic, axis: x, friction: {torque: 2, static: 6}}, mass: 1}
"""
SLIDING = """
intervals: 2
degree: 2
horizon: 1
cost: {inputs: 1}
modes: {block: forward}
phases:
  - name: slide
    start: {pose: {block: 0}, velocity: {block: 0}}
    end: {pose: {block: 0.5}}
"""


def test_a_motion_that_friction_would_hold_is_told(tmp_path: Path) -> None:
    """The inputs exceed the friction of sliding, and not the one at rest: the simulation sticks."""
    solution, _ = solve(write(tmp_path, STUCK, SLIDING))
    (followed,) = solution.followed
    assert followed.finding == "block has mode stick at 0.5 s of phase slide, which states forward"
    assert followed.error is None


@pytest.mark.parametrize(("mode", "speed", "remedy"), [("forward", -0.1, "least"), ("backward", 0.1, "most")])
def test_a_start_against_its_mode_is_refused(mode: str, speed: float, remedy: str, tmp_path: Path) -> None:
    text = SLIDING.replace("forward", mode)
    for given, refused in ((speed, True), (-speed, False)):
        file = write(tmp_path, STUCK, text.replace("velocity: {block: 0}", f"velocity: {{block: {given}}}"))
        if refused:
            finding = f"start.velocity.block: block starts at {speed:g}, and moves {mode} here; start at {remedy} at 0"
            with pytest.raises(InputError, match=finding):
                read_phased_problem(file, load_on_demand)
        else:
            read_phased_problem(file, load_on_demand)


FAULTS = {
    "unknown": (
        "{sole: forward}",
        "{sol: forward}",
        "phases[1].modes.sol: the model has no joint or contact",
    ),
    "side": (
        "{sole: forward}",
        "{sole: lower}",
        "phases[1].modes.sole: contact sole has no mode",
    ),
    "frictionless": ("{sole: forward}", "{x: stick}", "phases[1].modes.x: joint"),
    "map": ("to: slide}", "to: slide, map: {x: x}}", "links[0]: a link with a map joins no modes; leave map and"),
    "impact": (
        "to: slide}",
        "to: slide, impact: {contacts: [sole]}}",
        "links[0]: modes have their impacts by",
    ),
    "hit": ("to: slide}", "to: slide, hits: {sole: stick}}", "links[0].hits.sole: sole is held by the phase after its"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_wrong_modes_are_refused(fault: str, tmp_path: Path) -> None:
    """Each has one fault, with its place and a remedy."""
    old, new, text = FAULTS[fault]
    with pytest.raises(InputError) as caught:
        read_phased_problem(write(tmp_path, SLEDGE, LANDING.replace(old, new)), load_on_demand)
    (found,) = caught.value.faults
    assert text in f"{found.path}: {found.finding}; {found.remedy}"
    assert found.line > 0
    assert found.remedy


def test_dry_friction_needs_a_mode_and_stops_do_not_stick(tmp_path: Path) -> None:
    for modes, text in (("{}", "block has dry friction, and no mode"), ("{block: free}", "so it is never free")):
        file = write(tmp_path, STUCK, SLIDING.replace("{block: forward}", modes))
        with pytest.raises(InputError) as caught:
            read_phased_problem(file, load_on_demand)
        (found,) = caught.value.faults
        assert text in found.finding
    file = write(tmp_path, STUCK.replace("static: 6", "load: {coefficient: 0.1}"), SLIDING)
    with pytest.raises(InputError, match="friction by the load of joint block has no modes; give a torque in place"):
        read_phased_problem(file, load_on_demand)
    file = write(tmp_path, DOCK, DOCKING.replace("{b: upper}", "{b: stick}"))
    with pytest.raises(InputError, match="joint b has no dry friction, so it has no mode stick"):
        read_phased_problem(file, load_on_demand)


def test_the_signal_of_a_mode_is_not_given_and_other_signals_are(tmp_path: Path) -> None:
    """The mode gives the force that holds a joint; a signal that the model reads elsewhere stays the problem's."""
    model = STUCK + "  - {name: cart, joint: {type: prismatic, axis: y, force: 2*pull}, mass: 1}\nsignals: [pull]\n"
    problem, _ = read_phased_problem(write(tmp_path, model, SLIDING + "signals: {pull: 0.5}\n"), load_on_demand)
    given = {part.wrench: part.expression for part in problem.phases[0].problem.wrenches}
    assert given == {"pull": "0.5", "hold_block": "-2.0"}
    with pytest.raises(InputError) as caught:
        read_phased_problem(write(tmp_path, STUCK, SLIDING + "signals: {hold_block: 1}\n"), load_on_demand)
    (found,) = caught.value.faults
    assert (found.path, found.finding) == ("signals.hold_block", "the mode of block gives it")
