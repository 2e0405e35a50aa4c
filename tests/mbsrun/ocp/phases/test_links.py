"""Phases that are linked: their optimum is the optimum of the whole motion, however it is split."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from mbsrun.ocp.evaluation.backends.casadi import CasadiProgram
from mbsrun.ocp.evaluation.backends.numpy import NumpyProgram
from mbsrun.ocp.problem.phases import Condition, Link, Phase, PhasedProblem, Plants
from mbsrun.ocp.problem.problem import Cost, End, Refinement, Representation, State, Term, Unknown
from mbsrun.ocp.searching.refinement import refine_phases
from mbsrun.ocp.showing.phase_summary import summarise_phases
from mbsrun.ocp.solution.phases import Guess, PhasedSolution
from mbsrun.ocp.solution.solution import Failure, Solution
from mbsrun.ocp.solving.phases import resimulate_phases, solve_phases
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.transcription.phases import transcribe_phases
from tests.mbsrun.ocp.phases.motions import cut, free_start, split, swing_up
from tests.mbsrun.ocp.plants import cart_pole, mechanism, push
from tests.mbsrun.peer import Peer, double_integrator, explicit_functions


@pytest.fixture(scope="module")
def cart() -> Peer:
    return cart_pole()


@pytest.fixture(scope="module")
def whole(cart: Peer) -> Solution:
    outcome = solve(swing_up(), cart)
    assert isinstance(outcome, Solution)
    return outcome


def optimum(problem: PhasedProblem, *plants: Peer, guess: Guess | None = None) -> PhasedSolution:
    outcome = solve_phases(problem, Plants(plants), guess=guess)
    assert isinstance(outcome, PhasedSolution), outcome.finding
    return outcome


def test_two_halves_of_a_motion_cost_what_the_whole_does(cart: Peer, whole: Solution) -> None:
    found = optimum(split(swing_up()), cart, cart, guess=Guess(cut(whole.trajectory)))
    assert found.cost == pytest.approx(whole.cost.total, rel=1e-8)
    terms = np.sum([[value for _, value in phase.cost.terms] for phase in found.phases], axis=0)
    assert terms == pytest.approx([value for _, value in whole.cost.terms], rel=1e-6)
    assert found.phases[1].trajectory.q[0] == pytest.approx(found.phases[0].trajectory.q[-1], abs=1e-9)
    assert found.starts == (0.0, 1.0)


def test_a_link_s_cost_is_a_terminal_cost_of_the_phase_before(cart: Peer, whole: Solution) -> None:
    """The same expression of the same state, with a constant; and a price of the change between both sides."""
    problem = replace(split(swing_up()), constants=(("a", 0.4),))
    guess = Guess(cut(whole.trajectory))
    (first, second), (link,) = problem.phases, problem.links
    cost = replace(first.problem.cost, terminal=(Term("a*qd_pole**2", 3.0),))
    ended = replace(problem, phases=(replace(first, problem=replace(first.problem, cost=cost)), second))
    linked = replace(problem, links=(replace(link, cost=(Term("a*end_qd_pole**2", 3.0, "speed"),)),))
    one, other = optimum(ended, cart, cart, guess=guess), optimum(linked, cart, cart, guess=guess)
    assert other.cost == pytest.approx(one.cost, rel=1e-8)
    assert other.values[0].terms == (
        ("speed", pytest.approx(dict(one.phases[0].cost.terms)["a*qd_pole**2"], rel=1e-5)),
    )
    assert summarise_phases(other)["  speed "] == f"{other.values[0].terms[0][1]:.10g}"
    jump = Term("(start_u_cart - end_u_cart)**2", 100.0)
    smooth = optimum(replace(problem, links=(replace(link, cost=(jump,)),)), cart, cart, guess=guess)
    before, after = (phase.trajectory.u for phase in smooth.phases)
    assert abs(after[0, 0] - before[-1, 0]) < 0.1
    assert smooth.cost > whole.cost.total


def test_phases_have_grids_and_representations_of_their_own(cart: Peer, whole: Solution) -> None:
    """The same motion, more finely: the costs differ by the error of the grid."""
    explicit = cart.with_functions(explicit_functions(cart.casadi("impl")))
    problem = split(swing_up())
    first, second = problem.phases
    other = replace(second.problem, degree=4, representation=Representation.EXP1_O)
    mixed = replace(problem, phases=(first, replace(second, problem=other)))
    found = optimum(mixed, cart, explicit, guess=Guess(cut(whole.trajectory)))
    assert found.cost == pytest.approx(whole.cost.total, rel=1e-4)
    jump = Condition("start_u_cart - end_u_cart", (-0.1, 0.1))
    linked = replace(mixed, links=(replace(mixed.links[0], conditions=(jump,)),))
    smooth = optimum(linked, cart, explicit, guess=Guess(tuple(phase.trajectory for phase in found.phases)))
    assert found.cost < smooth.cost
    u = [phase.trajectory.u for phase in smooth.phases]
    assert abs(u[1][0] - u[0][-1]) <= 0.1 + 1e-7
    checked = resimulate_phases(found, Plants((cart, explicit)))
    for phase in checked.phases:
        assert phase.resimulation is not None
        assert phase.resimulation.defect == pytest.approx(0.0, abs=1e-2)


def test_backends_agree_on_a_program_of_several_plants(cart: Peer) -> None:
    """CasADi's functions and NumPy's, on blocks of two plants, maps, conditions, sensors, unknowns and constants."""
    conditions = (
        Condition("a*end_x_place*sin(start_q_pole) + end_qd_slide", (0.0, 1.0)),
        Condition("start_qd_pole**2 + end_u_slide*length - end_T*end_vx_place*end_qdd_slide", (-1.0, 1.0)),
    )
    link = Link(
        "pushed",
        "swung",
        (("cart", "a*slide*length"), ("pole", "length + a*sin(slide)")),
        conditions=conditions,
    )
    problem = PhasedProblem(
        name="both",
        phases=(
            Phase("pushed", replace(push(3), end=End(), horizon_range=(0.5, 2.0))),
            Phase("swung", replace(free_start(swing_up()), intervals=3)),
        ),
        links=(link,),
        constants=(("a", 2.0),),
        unknowns=(Unknown("length"),),
    )
    plants = Plants((double_integrator(), cart))
    own = transcribe_phases(problem, plants)
    ours, theirs = (make(own.program, *plants.every[:1], plants.every[1:]) for make in (NumpyProgram, CasadiProgram))
    rng = np.random.default_rng(3)
    x, p = rng.uniform(-1, 1, own.program.variables), own.parameters(problem)
    lam = rng.uniform(-1, 1, own.program.constraints)
    assert ours.constraint(x, p) == pytest.approx(theirs.constraint(x, p).full().ravel(), abs=1e-12)
    assert ours.jacobian(x, p).toarray() == pytest.approx(theirs.jacobian(x, p).full(), abs=1e-12)
    assert ours.hessian(x, p, 0.7, lam).toarray() == pytest.approx(theirs.hessian(x, p, 0.7, lam).full(), abs=1e-11)
    step = 1e-6
    v = rng.uniform(-1, 1, x.size)
    slope = (ours.constraint(x + step * v, p) - ours.constraint(x - step * v, p)) / (2 * step)
    assert ours.jacobian(x, p) @ v == pytest.approx(slope, abs=1e-7)


def test_a_free_phase_time_loses_nothing_against_a_scan(cart: Peer, whole: Solution) -> None:
    """With the time at which the phases change free, their cost is the least over all given times."""
    problem = split(swing_up())
    first, second = problem.phases

    def divide(change: float) -> PhasedProblem:
        parts = ((first, change), (second, 2.0 - change))
        return replace(problem, phases=tuple(replace(x, problem=replace(x.problem, horizon=T)) for x, T in parts))

    free = replace(
        divide(1.0),
        links=(Link("first", "second", conditions=(Condition("end_T + start_T", (2.0, 2.0)),)),),
    )
    free = replace(
        free, phases=tuple(replace(x, problem=replace(x.problem, horizon_range=(0.5, 1.5))) for x in free.phases)
    )
    guess = Guess(cut(whole.trajectory))
    found = optimum(free, cart, cart, guess=guess)
    best = found.durations[0]
    scanned = [
        optimum(divide(best + d), cart, cart, guess=Guess(tuple(p.trajectory for p in found.phases))).cost
        for d in (-0.02, -0.002, 0.0, 0.002, 0.02)
    ]
    assert found.cost <= min(scanned) * (1 + 1e-6)
    assert found.cost == pytest.approx(scanned[2], rel=1e-6)
    assert min(scanned) == scanned[2]


def test_a_link_to_itself_makes_a_motion_periodic(cart: Peer) -> None:
    """The cart starts at rest and advances by 0.3 m a period, whatever the pole does; a free guess of the stride."""
    stride = Unknown("stride", (0.1, 0.3), 0.2)
    own = replace(swing_up(), free_start=(1, 3), end=End(), horizon=1.0)
    link = Link("motion", "motion", map=(("cart", "cart - stride"),))
    bounded = replace(own, cost=Cost(1.0, 0.0, (), (Term("q_cart", -40.0),)))
    problem = PhasedProblem("gait", (Phase("motion", bounded),), (link,), unknowns=(stride,))
    found = optimum(problem, cart)
    trajectory = found.phases[0].trajectory
    assert found.unknown_values == pytest.approx([0.3], abs=1e-6)
    assert trajectory.q[-1] - trajectory.q[0] == pytest.approx([0.3, 0.0], abs=1e-6)
    assert trajectory.qd[-1] == pytest.approx(trajectory.qd[0], abs=1e-9)
    assert trajectory.qd[0, 0] == pytest.approx(0.0, abs=1e-9)
    within = Condition("end_q_cart - start_q_cart", (0.1, 0.3))
    free = replace(problem, links=(replace(link, map=(("cart", None),), conditions=(within,)),), unknowns=())
    assert optimum(free, cart).cost == pytest.approx(found.cost, rel=1e-8)


def test_states_that_phases_add_carry_on(cart: Peer, whole: Solution) -> None:
    """The work of the input, as a state, is its integral over both phases."""
    work = State("work", "u_cart*qd_cart", start=(0.0, 0.0))
    problem = split(swing_up())
    first, second = problem.phases
    phases = (
        replace(first, problem=replace(first.problem, states=(work,))),
        replace(second, problem=replace(second.problem, states=(replace(work, start=(-np.inf, np.inf)),))),
    )
    found = optimum(replace(problem, phases=phases), cart, cart, guess=Guess(cut(whole.trajectory)))
    end = found.phases[1].trajectory
    energy = 2 * 0.3 * 9.81 * 0.5  # the pole's mass is lifted by twice its length, and all is at rest
    assert end.states[-1, 0] == pytest.approx(energy, rel=1e-4)  # the error of the grid


def mass(m: float) -> Peer:
    """A mass that is pushed along x."""
    q, qd, qdd, u = (ca.SX.sym(name) for name in ("q", "qd", "qdd", "u"))
    return mechanism(("slide",), m * qdd - u + 0 * q * qd, (q, qd, qdd, u))


def test_a_mass_that_is_picked_up_equals_an_independent_program() -> None:
    """Two masses join, and share the momentum: (m + M) v+ = m v-. The program beside it is written with Opti.

    Both are exact for inputs that are constant over an interval; the time at which the masses meet is free.
    """
    m, M, N = 1.0, 2.0, 5
    reach = replace(push(N), horizon=0.5, horizon_range=(0.2, 0.8), cost=Cost(1.0))
    alone = replace(reach, end=End(coordinates=((0, 0.4),)))
    problem = PhasedProblem(
        name="pick up",
        phases=(Phase("alone", alone), Phase("together", free_start(reach))),
        links=(
            Link(
                "alone",
                "together",
                velocities=(("slide", "slide*m/(m + M)"),),
                conditions=(Condition("end_T + start_T", (1.0, 1.0)),),
            ),
        ),
        constants=(("m", m), ("M", M)),
    )
    found = optimum(problem, mass(m), mass(m + M))

    opti = ca.Opti()
    T, u = opti.variable(2), opti.variable(2, N)
    x, v, cost = ca.MX(0), ca.MX(0), ca.MX(0)
    for k, weight in enumerate((m, m + M)):
        h = T[k] / N
        for i in range(N):
            x, v = x + h * v + h**2 * u[k, i] / (2 * weight), v + h * u[k, i] / weight
            cost += h * u[k, i] ** 2
        if k == 0:
            opti.subject_to(x == 0.4)
            v = v * m / (m + M)
    opti.minimize(cost)
    opti.subject_to([x == 1, v == 0, ca.sum1(T) == 1, *(opti.bounded(0.2, T[k], 0.8) for k in range(2))])
    opti.set_initial(T, 0.5)
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "tol": 1e-10})
    peer = opti.solve()
    assert found.cost == pytest.approx(float(peer.value(cost)), rel=1e-8)
    assert found.durations == pytest.approx(peer.value(T), abs=1e-5)


def test_conditions_that_contradict_a_link_are_named() -> None:
    """No motion: the cart cannot jump; the message names the link."""
    problem = split(swing_up())
    link = replace(problem.links[0], conditions=(Condition("end_q_cart - start_q_cart", (0.5, 0.5)),))
    outcome = solve_phases(replace(problem, links=(link,)), Plants((cart_pole(), cart_pole())))
    assert isinstance(outcome, Failure)
    assert "link first to second: " in outcome.finding


def test_bounds_that_no_motion_through_the_phases_keeps_are_named(cart: Peer, whole: Solution) -> None:
    problem = split(swing_up())
    weak = tuple(
        replace(phase, problem=replace(phase.problem, bounds=replace(phase.problem.bounds, u=((-3.0, 3.0),))))
        for phase in problem.phases
    )
    outcome = solve_phases(replace(problem, phases=weak), Plants((cart, cart)), guess=Guess(cut(whole.trajectory)))
    assert isinstance(outcome, Failure)
    conditions, limits = outcome.finding.split("; at their limits: ")
    assert "link first to second: pole" in conditions
    assert ": the bounds of the input cart" in limits


def test_each_phase_is_refined_until_it_is_accurate(cart: Peer, whole: Solution) -> None:
    """The first phase asks for more than the second one, which is accurate from the start, and keeps its grid."""
    problem = split(swing_up())
    asked = (Refinement(1e-7), None)
    phases = tuple(
        replace(phase, problem=replace(phase.problem, refine=own))
        for phase, own in zip(problem.phases, asked, strict=True)
    )
    plants = Plants((cart, cart))
    coarse = optimum(replace(problem, phases=phases), cart, cart, guess=Guess(cut(whole.trajectory)))
    found = refine_phases(resimulate_phases(coarse, plants), plants)
    first, second = found.phases
    assert first.refinement is not None
    assert first.refinement.finding == "the re-simulation confirms the accuracy"
    assert first.resimulation is not None
    assert first.resimulation.is_accurate
    assert first.trajectory.t.size * first.problem.degree > 11 * 3
    assert second.refinement is None
    assert second.problem.intervals == 10
