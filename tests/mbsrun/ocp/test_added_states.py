"""States and controls beside a mechanism's, and integrals with a range: closed forms, and a program of CasADi's."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import mbsrun
from mbsgen.errors import InputError
from mbsrun import load
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.no_mechanism import NO_MECHANISM
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import (
    Constraint,
    Control,
    Cost,
    Force,
    Form,
    Integral,
    Problem,
    Representation,
    State,
    Term,
    Unknown,
)
from mbsrun.ocp.searching.multistart import Wish, solve_from_many
from mbsrun.ocp.solution.solution import Failure, Solution, read_solution, write_solution
from mbsrun.ocp.solution.table import write_table
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.statement import read_problem
from tests.mbsrun.ocp.plants import mechanism, push
from tests.mbsrun.peer import Peer

MODELS = Path(__file__).parents[3] / "models"
MUSCLE = """
model: pendulum.yaml
horizon: 0.8
intervals: 10
scheme: radau
degree: 3
states:
  act: {rate: (exc - act)/0.05, start: 0.1, end: [null, 0.9], range: [0, 1]}
controls:
  exc: {range: [0, 1], guess: 0.2}
cost:
  inputs: 0.1
  running:
    - {expression: act**2 + 0.01*exc**2}
    - {expression: (u_q1 - 8*act)**2, weight: 10}
start: {pose: [0]}
end: {pose: {q1: 0.5}, velocity: zero}
"""


@cache
def mass() -> Peer:
    q, qd, qdd, u = (ca.SX.sym(name) for name in ("q", "qd", "qdd", "u"))
    return mechanism(("x",), qdd - u + 0 * q + 0 * qd, (q, qd, qdd, u))


def hurry(N: int, family: Family, representation: Representation) -> Problem:
    """Push 1 kg over 1 m from rest to rest in the least time, with an integral of u^2 of at most 14."""
    problem = replace(push(N, family, 3), representation=representation, horizon_range=(0.5, 2.0))
    return replace(
        problem,
        cost=Cost(0.0, 0.0, terminal=(Term("T", 1.0),)),
        integrals=(Integral("u_x**2", (-np.inf, 14.0)),),
        free_start=(),
    )


def found(problem: Problem, plant: Peer) -> Solution:
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution), outcome
    return outcome


@pytest.mark.parametrize(
    ("family", "representation"),
    [(Family.RADAU, Representation.IMPL), (Family.LEGENDRE, Representation.EXP1_O)],
)
def test_least_time_under_a_budget(family: Family, representation: Representation) -> None:
    """A push over 1 m in T needs at least 12 / T^3, and 12 / (1 - 1 / N^2) / T^3 with N steps of the input."""
    N = 10
    solution = found(hurry(N, family, representation), mass())
    assert solution.cost.total == pytest.approx((12 / (1 - N**-2) / 14) ** (1 / 3), rel=1e-7)
    assert solution.trajectory.states[-1] == pytest.approx([14.0], rel=1e-6)
    check = resimulate(solution, mass()).resimulation
    assert check is not None
    assert check.defect is not None
    assert check.defect < 1e-9
    assert check.open_loop_error is not None
    assert check.open_loop_error < 1e-9


def test_states_follow_their_equation() -> None:
    """e' = a, a' = -25 e of a problem without bounds on them: e = sin(5 t) / 5 beside any motion of the mechanism."""
    oscillation = (State("e", "a", start=(0.0, 0.0)), State("a", "-25*e", start=(1.0, 1.0)))
    trajectory = found(replace(push(20, degree=4), states=oscillation), mass()).trajectory
    expected = np.stack((np.sin(5 * trajectory.t) / 5, np.cos(5 * trajectory.t)), axis=1)
    assert trajectory.states == pytest.approx(expected, abs=1e-8)
    expected = np.stack((np.sin(5 * trajectory.point_t) / 5, np.cos(5 * trajectory.point_t)), axis=2)
    assert trajectory.point_states == pytest.approx(expected, abs=1e-6)  # of lower order within intervals


def test_a_muscle_on_a_pendulum_has_the_optimum_of_another_program(tmp_path: Path) -> None:
    """The same collocation, written by hand for CasADi's Opti: equal costs, states and controls."""
    (tmp_path / "pendulum.yaml").write_text((MODELS / "pendulum.yaml").read_text())
    (tmp_path / "muscle.ocp.yaml").write_text(MUSCLE)
    problem, plant = read_problem(tmp_path / "muscle.ocp.yaml", load)
    solution = solve(problem, plant)
    assert isinstance(solution, Solution), solution
    N, scheme, h = problem.intervals, schemes.build(problem.family, problem.degree), problem.horizon / problem.intervals
    opti = ca.Opti()
    x = opti.variable(3, N + 1)  # q, qd, act
    z, controls = [opti.variable(3, scheme.degree) for _ in range(N)], opti.variable(2, N)  # u, exc
    opti.subject_to(x[:, 0] == ca.DM([0, 0, 0.1]))
    opti.subject_to(x[:2, N] == ca.DM([0.5, 0]))
    opti.subject_to(x[2, N] <= 0.9)
    opti.subject_to(opti.bounded(0, controls[1, :], 1))
    cost = 0
    for k in range(N):
        nodes, (u, exc) = ca.horzcat(x[:, k], z[k]), ca.vertsplit(controls[:, k])
        for j in range(scheme.degree):
            q, qd, act = ca.vertsplit(z[k][:, j])
            qdd = (u - 0.05 * qd - 2 * 9.81 / 2 * ca.sin(q)) / (2 / 4 + 2 / 12)
            rate = ca.vertcat(qd, qdd, (exc - act) / 0.05)
            opti.subject_to(nodes @ ca.DM(scheme.D[j]) == h * rate)
            opti.subject_to(opti.bounded(0, act, 1))
            running = act**2 + 0.01 * exc**2 + 10 * (u - 8 * act) ** 2
            cost += h * scheme.weights[j] * running
        cost += 0.1 * h * u**2
        opti.subject_to(x[:, k + 1] == z[k][:, -1])
    opti.minimize(cost)
    opti.solver("ipopt", {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-10})
    peer = opti.solve()
    assert solution.cost.total == pytest.approx(float(peer.value(cost)), rel=1e-7)
    assert solution.trajectory.states[:, 0] == pytest.approx(peer.value(x)[2], abs=1e-5)
    assert solution.trajectory.controls[:, 0] == pytest.approx(peer.value(controls)[1], abs=1e-4)
    by_stages = solve(problem.with_solver("mbs"), plant)
    assert isinstance(by_stages, Solution), by_stages
    assert by_stages.cost.total == pytest.approx(solution.cost.total, rel=1e-7)


def test_files_hold_states_and_controls(tmp_path: Path) -> None:
    """They come back from solution.json, digit by digit, and have columns in the table."""
    problem = replace(push(4), states=(State("e", "c", start=(0.0, 0.0)),), controls=(Control("c", (-1.0, 1.0)),))
    solution = found(problem, mass())
    write_solution(solution, tmp_path / "solution.json")
    again = read_solution(tmp_path / "solution.json").trajectory
    assert np.array_equal(again.point_states, solution.trajectory.point_states)
    assert np.array_equal(again.controls, solution.trajectory.controls)
    write_table(solution, mass(), tmp_path / "solution.csv")
    header, first, *_ = (tmp_path / "solution.csv").read_text().splitlines()
    assert header.endswith("state[e],control[c]")
    assert first.endswith(f"{solution.trajectory.states[0, 0]},{solution.trajectory.controls[0, 0]}")


@pytest.mark.parametrize(
    ("state", "start", "end"),
    [
        (State("e", "1 + 0*t", start=(2.0, 2.0)), 2.0, 3.0),  # integrated
        (State("e", "1/(t - 0.5)**2", start=(2.0, 2.0)), 2.0, 2.0),  # a pole on the way: held
        (State("e", "0*t", start=(2.0, 2.0), end=(5.0, 5.0)), 2.0, 5.0),  # straight
        (State("e", "0*t", start=(2.0, 2.0), guess=(1.0, 4.0)), 1.0, 4.0),
        (State("e", "0*t", guess=0.5), 0.5, 0.5),
        (State("e", "9 + 0*t", start=(2.0, 2.0), bounds=(0.0, 4.0)), 2.0, 4.0),
    ],
)
def test_guesses_of_states(state: State, start: float, end: float) -> None:
    from mbsrun.ocp.guessing.guess import rest
    from mbsrun.ocp.guessing.state_guess import complete

    problem = replace(push(10), states=(state,))
    guess = complete(rest(problem, schemes.build(problem.family, problem.degree)), problem, mass())
    assert guess.states[[0, -1], 0] == pytest.approx([start, end], abs=1e-3)


@pytest.mark.parametrize(("limits", "guess"), [((0.5, 2), 0.5), ((-3, -1), -1.0), ((None, 4), 0.0), ((-1, None), 0.0)])
def test_controls_without_a_guess_are_as_near_to_0_as_they_may(
    limits: tuple[float | None, float | None], guess: float
) -> None:
    stated = mbsrun.problem(
        None,
        name="slide",
        horizon=1,
        intervals=2,
        states={"x": {"rate": "a", "start": 0}},
        controls={"a": {"range": limits}},
        cost={"running": [{"expression": "a**2", "weight": 1}]},
    )
    assert [control.guess for control in stated.value.controls] == [guess]


def test_noise_of_states_grows_with_their_range() -> None:
    """A quarter of the range counts as 1 rad, and as 1 without a range: the same draws, times 10000 and 1."""
    from mbsrun.ocp.guessing.guess import rest
    from mbsrun.ocp.guessing.starts import add_noise
    from mbsrun.ocp.guessing.state_guess import complete

    moved = []
    for state in (State("e", "0*t", guess=200.0, bounds=(-1e4, 3e4)), State("e", "0*t", guess=200.0)):
        problem = replace(push(50), states=(state,))
        guess = complete(rest(problem, schemes.build(problem.family, problem.degree)), problem, mass())
        noisy = add_noise(guess, problem, mass().manifest, np.random.default_rng(3))
        moved.append(np.concatenate((noisy.states.ravel(), noisy.point_states.ravel())) - 200.0)
    assert np.abs(moved[1]).max() > 0.01
    inside = np.abs(moved[0]) < 1e4  # not at a bound
    assert inside.mean() > 0.5
    np.testing.assert_allclose(moved[0][inside], 1e4 * moved[1][inside], rtol=1e-9)


BAD = """
model: pendulum.yaml
horizon: 1
intervals: 4
scheme: radau
degree: 2
constants: {k: 1}
states:
  act: {rate: "(exc - actt)", start: 5, range: [0, 1], guess: 2}
  sin: {rate: "1", start: 0}
  k: {rate: "1", start: 0}
  q_q1: {rate: "1", start: 0}
  free: {rate: "1"}
  back: {rate: "1", start: [3, 2]}
controls:
  exc: {range: [1, 0]}
  act: {}
integrals: [{expression: bct**2, range: [0, 1]}]
cost: {inputs: 1}
start: {pose: [0]}
"""


def test_every_fault_of_states_is_reported(tmp_path: Path) -> None:
    """Faults come with file, line, place and a remedy, all at once."""
    (tmp_path / "pendulum.yaml").write_text((MODELS / "pendulum.yaml").read_text())
    (tmp_path / "bad.ocp.yaml").write_text(BAD)
    with pytest.raises(InputError) as error:
        read_problem(tmp_path / "bad.ocp.yaml", load)
    faults = {fault.path: (fault.line, fault.finding, fault.remedy) for fault in error.value.faults}
    assert faults["states.act.rate"] == (9, 'unknown name "actt"', 'did you mean "act"?')
    assert faults["states.act.start"][1] == "5 is out of [0, 1]"
    assert faults["states.act.guess"][1] == "2 is out of [0, 1]"
    assert faults["states.back.start"][1] == "3 is above 2"
    assert faults["controls.exc.range"][1] == "1 is above 0"
    assert faults["integrals[0].expression"][1] == 'unknown name "bct"'
    for name in ("states.sin", "states.k", "states.q_q1", "controls.act"):
        assert faults[name][2] == "give a name that nothing else has"
    assert "states.free.start" in faults


def test_faults_of_problems_made_in_python() -> None:
    """The same, for values; other forms than the standard one refuse states."""
    states = (State("x", "q_x"), State("x", "y + 1"), State("e", "1", bounds=(0.0, 1.0), start=(2.0, 2.0)))
    with pytest.raises(ProblemError) as error:
        solve(replace(push(4), states=states, controls=(Control("c d"),)), mass())
    places = {place for place, _, _ in error.value.findings}
    assert places == {"states[1].name", "states[1].rate", "states[2].start", "controls[0].name"}
    with pytest.raises(ProblemError, match="the shooting form takes no states"):
        solve(replace(push(4), states=(State("e", "q_x"),), form=Form.SHOOTING), mass())


FALL = """
constants: {g: 9.81}
horizon: {guess: 1, range: [0.1, 10]}
intervals: 40
scheme: radau
degree: 3
states:
  x: {rate: v*sin(theta), start: 0, end: pi}
  y: {rate: v*cos(theta), start: 0, end: 2}
  v: {rate: g*cos(theta), start: 0, guess: [0, 6]}
controls:
  theta: {range: [0, pi], guess: 1}
cost: {terminal: [{expression: T}]}
"""


def test_the_brachistochrone_needs_no_mechanism(tmp_path: Path) -> None:
    """A cycloid of radius 1 takes pi / sqrt(g) to its lowest point; steps of the slope lose a part of order 1 / N^2."""
    (tmp_path / "fall.ocp.yaml").write_text(FALL)
    problem, plant = read_problem(tmp_path / "fall.ocp.yaml", load, NO_MECHANISM)
    solution = solve(problem, plant)
    assert isinstance(solution, Solution), solution
    least = np.pi / np.sqrt(9.81)
    assert least < solution.cost.total < least * (1 + 0.5 / 40**2)
    check = resimulate(solution, plant).resimulation
    assert check is not None
    assert check.is_accurate
    by_stages = solve(problem.with_solver("mbs"), plant)
    assert isinstance(by_stages, Solution), by_stages
    assert by_stages.cost.total == pytest.approx(solution.cost.total, rel=1e-9)


def test_a_file_without_a_mechanism_names_what_it_needs(tmp_path: Path) -> None:
    """A command that needs a model refuses the file; a mechanism needs a start; without both there is no control."""
    path = tmp_path / "fall.ocp.yaml"
    path.write_text(FALL)
    with pytest.raises(InputError, match="model: no model; name a model file"):
        read_problem(path, load)
    path.write_text(FALL.replace("states:", f"model: {MODELS / 'pendulum.yaml'}\nstates:"))
    with pytest.raises(InputError, match="start: missing; give pose"):
        read_problem(path, load)
    path.write_text("horizon: 1\nintervals: 1\nscheme: radau\ndegree: 1\ncost: {inputs: 1}\nstart: {pose: {q: 1}}\n")
    with pytest.raises(InputError) as error:
        read_problem(path, load, NO_MECHANISM)
    assert {fault.path for fault in error.value.faults} == {"controls", "start.pose.q"}


def test_many_starts_without_a_mechanism(tmp_path: Path) -> None:
    """Random states and controls lead to the same optimum."""
    (tmp_path / "fall.ocp.yaml").write_text(FALL.replace("40", "8"))
    problem, plant = read_problem(tmp_path / "fall.ocp.yaml", load, NO_MECHANISM)
    starts, outcome = solve_from_many(problem, plant, None, Wish(3), tmp_path / "starts.sqlite", lambda _: None)
    assert isinstance(outcome, Solution)
    assert [start.kind for start in starts.results] == ["guess", "noise", "noise"]
    assert starts.times == 3


def jerky() -> Problem:
    """Push 1 kg over 1 m from rest to rest in the least time, by a force whose rate is at most 32 N/s."""
    problem = replace(push(8, degree=3), horizon_range=(0.5, 2.0), cost=Cost(terminal=(Term("T", 1.0),)))
    return replace(
        problem,
        states=(State("force", "change", start=(0.0, 0.0), end=(0.0, 0.0)),),
        controls=(Control("change", (-32.0, 32.0)),),
        forces=(Force(0, "force"),),
    )


def test_a_bounded_rate_of_an_input() -> None:
    """The least time is (32 s / rate)^(1/3), with steps of the rate at a quarter and at three quarters of it."""
    solution = found(jerky(), mass())
    assert solution.cost.total == pytest.approx(1.0, rel=1e-7)
    assert solution.trajectory.controls[:, 0] == pytest.approx([32, 32, -32, -32, -32, -32, 32, 32], abs=1e-4)
    assert solution.trajectory.point_u.ravel() == pytest.approx(solution.trajectory.point_states.ravel(), abs=1e-9)
    check = resimulate(solution, mass()).resimulation
    assert check is not None
    assert check.is_accurate


def test_the_least_peak_of_an_input() -> None:
    """A push over 1 m in 1 s needs at least 4 N: first ahead, then back."""
    limits = (Constraint("u_x - peak", (-np.inf, 0.0)), Constraint("u_x + peak", (0.0, np.inf)))
    problem = replace(push(8), cost=Cost(terminal=(Term("peak", 1.0),)), constraints=limits)
    solution = found(replace(problem, unknowns=(Unknown("peak", (0.0, 100.0), 10.0),)), mass())
    assert solution.cost.total == pytest.approx(4.0, rel=1e-7)
    assert solution.trajectory.u[:, 0] == pytest.approx([4, 4, 4, 4, -4, -4, -4, -4], abs=1e-5)


@pytest.mark.parametrize(("family", "degree"), [(Family.LOBATTO, 3), (Family.RADAU, 2), (Family.LEGENDRE, 3)])
def test_a_constraint_of_states_holds_where_a_state_is_free_at_the_start(family: Family, degree: int) -> None:
    """s' = 1 and s >= 0.3 along the path: the least integral of s over 1 s is 0.3 + 1/2."""
    problem = replace(push(4, family, degree), cost=Cost(0.0, 0.0, running=(Term("s", 1.0),)))
    states, limits = (State("s", "1"),), (Constraint("s", (0.3, np.inf)), Constraint("q_x", (-1.0, np.inf)))
    solution = found(replace(problem, states=states, constraints=limits), mass())
    assert solution.cost.total == pytest.approx(0.8, rel=1e-7)
    assert solution.trajectory.states[0] == pytest.approx([0.3], abs=1e-7)


@pytest.mark.parametrize("family", [Family.LOBATTO, Family.RADAU])
def test_a_constraint_of_states_and_unknown_numbers_holds_at_the_start(family: Family) -> None:
    """The highest floor below a push from 0 to 1 m is 0, its start."""
    problem = replace(push(4, family, 3), cost=Cost(1e-3, 0.0, terminal=(Term("floor", -1.0),)))
    limits = (Constraint("q_x - floor", (0.0, np.inf)),)
    solution = found(replace(problem, unknowns=(Unknown("floor", (-1.0, 1.0), 0.5),), constraints=limits), mass())
    assert solution.trajectory.unknowns == pytest.approx([0.0], abs=1e-6)


def test_a_given_start_is_judged_beside_free_states() -> None:
    """A constraint on the mechanism is violated at a start that is given, whatever another state does."""
    problem = replace(push(4), states=(State("s", "1"),), constraints=(Constraint("q_x", (0.1, np.inf)),))
    outcome = solve(problem, mass())
    assert isinstance(outcome, Failure)
    assert "the given start violates a constraint of the path" in outcome.finding


def test_a_soft_constraint_is_exact_where_its_weight_is_large() -> None:
    """With a large weight the slack vanishes, and the cost is the hard constraint's; with a small one it gives."""
    hard = replace(push(8), constraints=(Constraint("qd_x", (-np.inf, 1.2)),))
    soft = replace(
        hard, controls=(Control("slack", (0.0, np.inf)),), constraints=(Constraint("qd_x - slack", (-np.inf, 1.2)),)
    )
    firm, weak = (
        found(replace(soft, cost=Cost(1.0, running=(Term("slack", weight),))), mass()) for weight in (100.0, 1.0)
    )
    assert firm.cost.total == pytest.approx(found(hard, mass()).cost.total, rel=1e-5)
    assert np.abs(firm.trajectory.controls).max() < 1e-5
    assert weak.trajectory.controls.max() > 0.05
    assert weak.cost.total < firm.cost.total
