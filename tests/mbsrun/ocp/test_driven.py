"""Driven joints in optimal control: against hand-written programs in CasADi, inverse dynamics, and closed forms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import casadi as ca
import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun.external import OnDemand, load_on_demand
from mbsrun.kernel import Kernels
from mbsrun.ocp.evaluation.backends import condensation
from mbsrun.ocp.ground.integrators import SECOND_ORDER
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.state_guess import complete
from mbsrun.ocp.problem.driving import Guide
from mbsrun.ocp.problem.problem import Drive, Form, Loops, Problem, Representation
from mbsrun.ocp.showing.pictures import make_trajectories
from mbsrun.ocp.showing.summary import summarise
from mbsrun.ocp.solution.solution import Solution, read_solution, write_solution
from mbsrun.ocp.solution.table import write_table
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.phases import read_phased_problem
from mbsrun.ocp.statement.statement import read_problem, state_problem
from mbsrun.ocp.statement.surplus import free_targets
from mbsrun.ocp.transcription.transcription import transcribe
from mbsrun.simulation.inverse import Forces, balance

MODELS = Path(__file__).parents[3] / "models"
M, m, l, I, d, G = 1.3, 0.4, 0.5, 0.02, 0.1, 9.81
CART = f"""\
name: pushed
gravity: [0, 0, -{G}]
bodies:
  - name: cart
    joint: {{type: prismatic, axis: x, actuated: false, limits: [-1, 1], max_speed: 3}}
    mass: {M}
  - name: pole
    parent: cart
    joint: {{type: revolute, axis: y, damping: {d}}}
    mass: {m}
    com: [0, 0, -{l}]
    inertia: [{I}, {I}, 0.001]
driven: [cart]
frames:
  - {{name: tip, body: pole, position: [0, 0, -1]}}
"""
TASK: Mapping[str, Any] = {
    "horizon": 1.5,
    "intervals": 12,
    "scheme": "radau",
    "degree": 3,
    "driven": {"cart": "0.3*sin(3*t)**2 + 0.1*t"},
    "cost": {"inputs": 1, "running": [{"expression": "tau_cart**2", "weight": 0.01}]},
    "start": {"pose": {"pole": 0}},
    "end": {"pose": {"pole": 1.2}, "velocity": "zero"},
}
FREE: Mapping[str, Any] = {
    **TASK,
    "horizon": {"guess": 1.5, "range": [0.5, 4]},
    "driven": {"cart": "0.4*sin(pi*t/T)**2 + 0.1*t"},
    "cost": {**TASK["cost"], "terminal": [{"expression": "T**2", "weight": 0.2}]},
}
EVERY = list(Representation)


def load_text(text: str, folder: Path) -> OnDemand:
    """Load a model from its text."""
    file = folder / "model.yaml"
    file.write_text(text, "utf-8")
    found = load_on_demand(file)
    assert isinstance(found, OnDemand)
    return found


@pytest.fixture(scope="module")
def cart(requires: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> OnDemand:
    requires("cc")
    return load_text(CART, tmp_path_factory.mktemp("pushed"))


@pytest.fixture(scope="module")
def five_bar(requires: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> OnDemand:
    """The five-bar, whose right motor is driven."""
    requires("cc")
    text = (MODELS / "five_bar.yaml").read_text("utf-8")
    for old, new in (
        ("name: right, type: revolute", "name: right, actuated: false, type: revolute"),
        ("limits: [-1.5, 0.5], max_speed: 20, max_force: 12,", "limits: [-1.5, 0.5], max_speed: 20,"),
        ("independent: [left, right]\n", "independent: [left, right]\ndriven: [right]\n"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    file = tmp_path_factory.mktemp("five_bar") / "five_bar.yaml"
    file.write_text(text, "utf-8")
    found = load_on_demand(file)
    assert isinstance(found, OnDemand)
    return found


def state(plant: OnDemand, task: Mapping[str, Any], representation: Representation = Representation.IMPL) -> Problem:
    return state_problem({**task, "representation": representation.value}, "task", plant, Path())


def find(plant: OnDemand, problem: Problem, method: str = "ipopt") -> Solution:
    problem = replace(problem.with_solver(method), solver=replace(problem.with_solver(method).solver, tolerance=1e-10))
    found = solve(problem, plant)
    assert isinstance(found, Solution), found
    return found


def invert(plant: OnDemand, motion: Trajectory) -> Forces:
    """Compute the forces for the states at the points of a motion."""
    N = motion.point_t.size
    q, qd, qdd = (x.reshape(N, -1) for x in (motion.point_q, motion.point_qd, motion.point_qdd))
    return balance(cast("Kernels", plant), motion.point_t.ravel(), q, qd, qdd, np.zeros((N, 0)))


class Hand:
    """The pole on the cart as a program in CasADi: the cart's motion is put into the equations of motion."""

    def __init__(self, task: Mapping[str, Any], move: Callable[[ca.MX, ca.MX], ca.MX]) -> None:
        self.opti = opti = ca.Opti()
        N, degree = task["intervals"], task["degree"]
        is_free = isinstance(task["horizon"], dict)
        T = opti.variable() if is_free else ca.MX(task["horizon"])
        C, D, B = ca.collocation_coeff(ca.collocation_points(degree, "radau"))
        points = ca.collocation_points(degree, "radau")
        t, horizon = ca.MX.sym("t"), ca.MX.sym("T")
        x = move(t, horizon)
        xdd = ca.Function("xdd", [t, horizon], [ca.jacobian(ca.jacobian(x, t), t)])
        q, qd, z = opti.variable(1, N * degree), opti.variable(1, N * degree), opti.variable(1, N * degree)
        u, forces = opti.variable(1, N), []
        before, cost = (ca.MX(0), ca.MX(0)), ca.MX(0)
        for k in range(N):
            own = slice(k * degree, (k + 1) * degree)
            h = T / N
            nodes = [ca.horzcat(start, part[own]) for start, part in zip(before, (q, qd), strict=True)]
            opti.subject_to(nodes[0] @ C == h * qd[own])
            opti.subject_to(nodes[1] @ C == h * z[own])
            for j in range(degree):
                i = k * degree + j
                a = xdd((k + points[j]) * h, T)
                s, c = ca.sin(q[i]), ca.cos(q[i])
                opti.subject_to((I + m * l**2) * z[i] - m * l * c * a + m * G * l * s + d * qd[i] == u[k])
                forces.append((M + m) * a - m * l * (c * z[i] - s * qd[i] ** 2))
                cost += h * B[j] * 0.01 * forces[-1] ** 2
            cost += h * u[k] ** 2
            before = (nodes[0] @ D, nodes[1] @ D)
        opti.subject_to(before[0] == 1.2)
        opti.subject_to(before[1] == 0)
        if is_free:
            cost += 0.2 * T**2
            opti.subject_to(opti.bounded(0.5, T, 4))
            opti.set_initial(T, 1.5)
        opti.minimize(cost)
        opti.set_initial(q, np.linspace(0, 1.2, N * degree))
        opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "tol": 1e-11})
        solved = opti.solve()
        self.cost, self.u, self.T = solved.value(cost), np.array(solved.value(u)), float(solved.value(T))
        self.q = np.array(solved.value(q)).reshape(N, degree)
        self.tau = np.array(solved.value(ca.vertcat(*forces))).reshape(N, degree)


@cache
def by_hand() -> Hand:
    return Hand(TASK, lambda t, _: 0.3 * ca.sin(3 * t) ** 2 + 0.1 * t)


def test_an_optimum_is_that_of_a_program_written_by_hand(cart: OnDemand) -> None:
    found, hand = find(cart, state(cart, TASK)), by_hand()
    assert found.cost.total == pytest.approx(hand.cost, rel=1e-9)
    assert found.trajectory.u[:, 0] == pytest.approx(hand.u, abs=1e-6)
    assert found.trajectory.point_q[:, :, 1] == pytest.approx(hand.q, abs=1e-7)
    assert found.driving is not None
    assert found.driving[:, :, 0] == pytest.approx(hand.tau, abs=1e-6)


@pytest.mark.parametrize("method", ["ipopt", "mbs"])
def test_a_free_horizon_is_found_as_by_a_program_written_by_hand(cart: OnDemand, method: str) -> None:
    """The cart's motion depends on T, so the derivatives of its velocities and accelerations by T matter."""
    found = find(cart, state(cart, FREE), method)
    hand = Hand(FREE, lambda t, T: 0.4 * ca.sin(ca.pi * t / T) ** 2 + 0.1 * t)
    assert found.trajectory.t[-1] == pytest.approx(hand.T, rel=1e-7)
    assert found.cost.total == pytest.approx(hand.cost, rel=1e-9)


@pytest.mark.parametrize("representation", EVERY)
def test_all_representations_have_one_optimum(cart: OnDemand, representation: Representation) -> None:
    assert find(cart, state(cart, TASK, representation)).cost.total == pytest.approx(by_hand().cost, rel=1e-8)


@pytest.mark.parametrize("representation", [Representation.SEMI, Representation.EXP1_O, Representation.EXP2_A])
def test_stages_find_the_same_optimum(cart: OnDemand, representation: Representation) -> None:
    found = find(cart, state(cart, TASK, representation), "mbs")
    assert found.cost.total == pytest.approx(by_hand().cost, rel=1e-8)


@pytest.mark.parametrize("representation", [Representation.IMPL, Representation.EXP1_O])
@pytest.mark.parametrize("scheme", ["radau", "legendre"])
def test_derivatives_by_horizon_and_unknowns_are_exact(
    cart: OnDemand, representation: Representation, scheme: str
) -> None:
    task = {
        **FREE,
        "intervals": 2,
        "scheme": scheme,
        "unknowns": {"a": {"guess": 0.4, "range": [0, 1]}},
        "driven": {"cart": "a*sin(pi*t/T)**2 + softplus(t - 1, 0.3)/T"},
        "constraints": [{"expression": "tau_cart*qdd_cart + qd_cart", "range": [-900, 900], "at": "end"}],
        "end": {"velocity": "zero", "acceleration": "zero"},
        "bounds": {"tau": {"cart": [-900, 900]}},
    }
    problem = state(cart, task, representation)
    transcription = transcribe(problem, cart)
    program, p = condensation.build(transcription.program, cart), transcription.parameters(problem)
    rng = np.random.default_rng(0)
    x, weights = rng.uniform(0.5, 1, program.variables), rng.uniform(-1, 1, program.constraints)

    def slopes(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        J = program.jacobian(x, p)
        return program.constraint(x, p).full().ravel(), (J.T @ weights).full().ravel()

    J, H = program.jacobian(x, p).full(), program.hessian(x, p, 0.0, weights).full()
    H = np.triu(H) + np.triu(H, 1).T
    chosen = [transcription.layout.horizon, *transcription.layout.unknowns.tolist()]
    assert len(chosen) == 2
    for i in chosen:
        step = 1e-5 * np.eye(x.size)[i]
        ahead, behind = slopes(x + step), slopes(x - step)
        g, second = ((a - b) / 2e-5 for a, b in zip(ahead, behind, strict=True))
        assert J[:, i] == pytest.approx(g, abs=1e-6 * np.abs(J).max())
        assert H[i] == pytest.approx(second, abs=1e-6 * np.abs(H).max())


def test_second_order_collocation_takes_driven_joints(cart: OnDemand) -> None:
    """On a fine grid both have one optimum."""
    fine = state(cart, {**TASK, "intervals": 30, "degree": 4})
    costs = [find(cart, replace(fine, integrator=name)).cost.total for name in ("collocation", SECOND_ORDER)]
    assert costs[0] == pytest.approx(costs[1], rel=1e-7)


@pytest.mark.parametrize("scheme", ["radau", "legendre"])
def test_forces_are_those_of_inverse_dynamics_at_given_states(cart: OnDemand, scheme: str) -> None:
    problem = state(cart, {**TASK, "scheme": scheme}, Representation.EXP1_A)
    found = find(cart, problem)
    motion, guide = found.trajectory, Guide.of(problem, cart.manifest)
    given = guide.read(motion.point_t, 1.5)
    for part, values in zip((motion.point_q, motion.point_qd, motion.point_qdd), given, strict=True):
        assert part[:, :, 0] == pytest.approx(values[:, :, 0], abs=1e-12)
    t = motion.t
    assert motion.q[:, 0] == pytest.approx(0.3 * np.sin(3 * t) ** 2 + 0.1 * t, abs=1e-12)
    assert motion.qd[:, 0] == pytest.approx(0.9 * np.sin(6 * t) + 0.1, abs=1e-12)
    forces = invert(cart, motion)
    assert found.driving is not None
    assert found.driving.reshape(-1, 1) == pytest.approx(forces.tau, abs=1e-7)
    assert np.repeat(motion.u, 3, axis=0) == pytest.approx(forces.u, abs=1e-7)


def test_a_resimulation_moves_driven_joints_too(cart: OnDemand) -> None:
    """The error falls as the collocation's order says, and the states that a problem adds read the force."""
    task = {
        **TASK,
        "degree": 4,
        "states": {"work": {"rate": "tau_cart*qd_cart", "start": 0}},
        "cost": {"inputs": 1},
    }
    coarse, fine = (find(cart, state(cart, {**task, "intervals": N})) for N in (10, 20))
    errors = [resimulate(found, cart).resimulation for found in (coarse, fine)]
    first, second = (x.open_loop_error for x in errors if x is not None and x.open_loop_error is not None)
    assert second < 1e-6
    assert first / second > 30
    # the work of cart and input is the gain of energy and the loss in the damper
    motion = fine.trajectory
    q, qd = motion.q[-1, 1], motion.qd[-1]
    v = np.array([qd[0] - l * np.cos(q) * qd[1], l * np.sin(q) * qd[1]])
    gain = M * qd[0] ** 2 / 2 + m * (v @ v) / 2 + I * qd[1] ** 2 / 2 + m * G * l * (1 - np.cos(q))
    gain -= (M + m) * 0.1**2 / 2  # the start's
    inner = motion.point_qd[:, :, 1] * (motion.u - d * motion.point_qd[:, :, 1])
    weights = ca.collocation_coeff(ca.collocation_points(4, "radau"))[2].full().ravel()
    given = float((inner @ weights).sum() * 1.5 / 20)
    assert motion.states[-1, 0] + given == pytest.approx(gain, abs=1e-6)


def test_the_shortest_time_keeps_the_bound_of_a_driven_velocity(cart: OnDemand) -> None:
    """x = s^3 (10 - 15 s + 6 s^2)/2 with s = t/T has the greatest velocity 15/16/T, in the middle."""
    task = {
        **FREE,
        "driven": {"cart": "(t/T)**3*(10 - 15*t/T + 6*(t/T)**2)/2"},
        "bounds": {"velocities": {"cart": [None, 0.8]}},
        "cost": {"terminal": [{"expression": "T", "weight": 1}], "inputs": 1e-6},
    }
    assert find(cart, state(cart, task)).trajectory.t[-1] == pytest.approx(15 / 16 / 0.8, rel=1e-6)


@pytest.mark.parametrize("method", ["ipopt", "mbs"])
def test_bounds_hold_the_force(cart: OnDemand, method: str) -> None:
    free = find(cart, state(cart, FREE), method)
    held = find(cart, state(cart, {**FREE, "bounds": {"tau": {"cart": [None, 4]}}}), method)
    assert free.driving is not None
    assert held.driving is not None
    assert free.driving.max() > 5
    assert held.driving.max() == pytest.approx(4, abs=1e-6)
    assert held.cost.total > free.cost.total


def test_an_unknown_chooses_the_motion(cart: OnDemand) -> None:
    """The least integral of the squared acceleration of a sin(2 t) + 0.2 t^2 has a closed form: it is linear in a."""
    task = {
        **TASK,
        "unknowns": {"a": {"guess": 0.2, "range": [-1, 1]}},
        "driven": {"cart": "a*sin(2*t) + 0.2*t**2"},
        "cost": {"inputs": 1e-6, "running": [{"expression": "qdd_cart**2", "weight": 1}]},
        "degree": 4,
    }
    found = find(cart, state(cart, task))
    t = np.linspace(0, 1.5, 20_001)
    h = t[1] - t[0]
    weights = np.full(t.size, h)
    weights[[0, -1]] /= 2
    columns = -4 * np.sin(2 * t)
    a = -(weights * columns * 0.4).sum() / (weights * columns**2).sum()
    assert found.trajectory.unknowns[0] == pytest.approx(a, abs=1e-5)
    assert found.trajectory.q[:, 0] == pytest.approx(
        found.trajectory.unknowns[0] * np.sin(2 * found.trajectory.t) + 0.2 * found.trajectory.t**2, abs=1e-9
    )


def test_files_hold_the_force(cart: OnDemand, tmp_path: Path) -> None:
    found = find(cart, state(cart, TASK))
    write_solution(found, tmp_path / "solution.json")
    again = read_solution(tmp_path / "solution.json")
    assert again.driven == ("cart",)
    assert again.problem.driven == (Drive(0, "0.3*sin(3*t)**2 + 0.1*t"),)
    assert found.driving is not None
    assert again.driving is not None
    assert np.array_equal(found.driving, again.driving)
    write_table(found, cart, tmp_path / "solution.csv")
    header, *rows = (line.split(",") for line in (tmp_path / "solution.csv").read_text("utf-8").splitlines())
    column = [float(row[header.index("tau[cart] [N]")]) for row in rows]
    assert column[1:3] == found.driving[0, :2, 0].tolist()  # the third is the next interval's start
    # the earlier solution is a guess on another grid
    finer = state(cart, {**TASK, "intervals": 18})
    assert isinstance(solve(finer, cart, guess=again.trajectory), Solution)


def test_the_force_is_drawn_beside_the_inputs_and_summarised(cart: OnDemand) -> None:
    found = find(cart, state(cart, TASK))
    assert found.driving is not None
    panels = make_trajectories(found, cart.manifest).axes
    labels = [panel.get_ylabel() for panel in panels]
    assert labels[:4] == ["$q$ [m]", "$q$ [rad]", r"$\dot{q}$ [m/s]", r"$\dot{q}$ [rad/s]"]
    assert labels[4:] == ["$u$ [N m]", r"$\tau$ [N]"]
    assert np.asarray(panels[5].lines[0].get_ydata()) == pytest.approx(found.driving.ravel())
    assert [panel.lines[0].get_label() for panel in panels[:2]] == ["cart (driven)", "pole"]
    least, most = (float(x) for x in summarise(found)["tau[cart]"].split(" to "))
    assert (least, most) == pytest.approx((found.driving.min(), found.driving.max()), rel=1e-5)


# --- all joints ---


SPINNER = """\
name: spinner
gravity: [0, 0, 0]
bodies:
  - {name: wheel, joint: {type: revolute, axis: z, actuated: false}, mass: 1, inertia: [1, 1, 0.25]}
  - {name: arm, parent: wheel, joint: {type: revolute, axis: y, actuated: false}, mass: 1, inertia: [0.5, 0.5, 0.5]}
driven: [wheel, arm]
"""
SPIN: Mapping[str, Any] = {
    "horizon": {"guess": 1, "range": [0.1, 5]},
    "intervals": 4,
    "scheme": "radau",
    "degree": 2,
    "driven": {"wheel": "2*(t/T)**2", "arm": "0"},
    "cost": {"terminal": [{"expression": "T", "weight": 1}]},
    "start": {"pose": {}},
    "bounds": {"tau": {"wheel": [-12, 12]}},
}


@pytest.fixture(scope="module")
def spinner(requires: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> OnDemand:
    requires("cc")
    return load_text(SPINNER, tmp_path_factory.mktemp("spinner"))


@pytest.mark.parametrize("method", ["ipopt", "mbs"])
@pytest.mark.parametrize("representation", EVERY)
def test_a_mechanism_of_driven_joints_alone_is_timed(
    spinner: OnDemand, representation: Representation, method: str
) -> None:
    """The wheel has the constant acceleration 4/T^2, and the moment 12 = (0.25 + 0.5) 4/T^2 at its bound."""
    found = resimulate(find(spinner, state(spinner, SPIN, representation), method), spinner)
    assert found.trajectory.t[-1] == pytest.approx(0.5, rel=1e-7)
    assert found.trajectory.point_qdd[:, :, 0] == pytest.approx(4 / 0.5**2, rel=1e-6)
    assert found.resimulation is not None
    assert found.resimulation.open_loop_error == pytest.approx(0, abs=1e-9)


def test_a_mechanism_of_driven_joints_alone_has_unknowns(spinner: OnDemand) -> None:
    """The wheel turns as far as its moment permits: 12 = 0.75 * 2 a."""
    task = {
        **SPIN,
        "horizon": 1,
        "unknowns": {"a": {"guess": 1, "range": [0, 50]}},
        "driven": {"wheel": "a*t**2", "arm": "0"},
        "cost": {"terminal": [{"expression": "-a", "weight": 1}]},
    }
    assert find(spinner, state(spinner, task)).trajectory.unknowns[0] == pytest.approx(8, rel=1e-7)


def test_nothing_to_choose_is_refused(spinner: OnDemand) -> None:
    with pytest.raises(ProblemError, match="there is nothing to control"):
        state(spinner, {**SPIN, "horizon": 1})


TURN: Mapping[str, Any] = {
    **SPIN,
    "horizon": {"guess": 0.1, "range": [0.02, 3]},
    "intervals": 10,
    "degree": 3,
    "driven": {"crank": "40 deg + (t/T)**2/2"},
    "bounds": {"tau": {"crank": [-20, 20]}},
}


@pytest.mark.parametrize("loops", Loops)
def test_a_driven_mechanism_with_a_loop_is_timed(requires: Callable[[str], str], loops: Loops) -> None:
    """Both forms find the shortest turn of the compressor's crank, by one torque: the one of inverse dynamics."""
    requires("cc")
    compressor = load_on_demand(MODELS / "compressor.yaml")
    assert isinstance(compressor, OnDemand)
    task = {**TURN, "loops": loops.value}
    found = find(compressor, state(compressor, task), "mbs")
    assert found.driving is not None
    assert found.driving.max() == pytest.approx(20, abs=1e-6)
    forces = invert(compressor, found.trajectory).tau
    assert found.driving.reshape(-1, 1) == pytest.approx(forces, abs=1e-5 if loops is Loops.REDUCED else 1e-2)
    assert found.violation.closure is not None
    assert found.violation.closure < 1e-10


def test_a_moment_out_of_reach_names_the_given_motions(requires: Callable[[str], str]) -> None:
    """Twice as far, the gas takes more than the bound of the moment, however slowly the crank turns."""
    requires("cc")
    compressor = load_on_demand(MODELS / "compressor.yaml")
    assert isinstance(compressor, OnDemand)
    found = solve(state(compressor, {**TURN, "driven": {"crank": "40 deg + (t/T)**2"}}), compressor)
    assert not isinstance(found, Solution)
    assert "the given motions in interval" in found.finding
    assert "forces by expressions" not in found.finding
    assert "the force of the driven joint crank" in found.finding


# --- loops ---


SWING: Mapping[str, Any] = {
    "horizon": 0.3,
    "intervals": 20,
    "scheme": "radau",
    "degree": 3,
    "driven": {"right": "-1.1397 + 0.6*sin(5*t)**2"},
    "cost": {"inputs": 1, "running": [{"expression": "tau_right**2", "weight": 0.1}]},
    "start": {"pose": {"left": -2.4621}},
    "end": {"pose": {"left": -2.3}, "velocity": "zero"},
}
FORMS = [
    *((Loops.MULTIPLIERS, representation) for representation in EVERY),
    *((Loops.REDUCED, r) for r in (Representation.IMPL, Representation.EXP1_O, Representation.EXP1_A)),
]


@pytest.mark.parametrize(("loops", "representation"), FORMS)
def test_loops_with_driven_joints_have_one_optimum(
    five_bar: OnDemand, loops: Loops, representation: Representation
) -> None:
    """Both forms of loops differ by the error of the discretisation."""
    found = resimulate(find(five_bar, replace(state(five_bar, SWING, representation), loops=loops)), five_bar)
    assert found.cost.total == pytest.approx(0.1107402580, rel=1e-7)
    assert found.violation.closure is not None
    assert found.violation.closure < 1e-10
    check = found.resimulation
    assert check is not None
    assert check.closure is not None
    assert check.closure < 1e-10
    assert check.defect is not None
    assert check.defect < 1e-8
    motion = found.trajectory
    assert motion.q[:, 2] == pytest.approx(-1.1397 + 0.6 * np.sin(5 * motion.t) ** 2, abs=1e-12)


def test_forces_of_loops_and_driven_joints_are_those_of_inverse_dynamics(five_bar: OnDemand) -> None:
    problem = replace(state(five_bar, SWING), loops=Loops.REDUCED)
    found = find(five_bar, problem, "mbs")
    motion, N = found.trajectory, found.trajectory.point_t.size
    forces = invert(five_bar, motion)
    assert found.driving is not None
    assert found.driving.reshape(N, 1) == pytest.approx(forces.tau, abs=1e-6)
    assert np.repeat(motion.u, 3, axis=0) == pytest.approx(forces.u, abs=1e-6)
    assert found.cost.total == pytest.approx(0.1107402580, rel=1e-7)


def test_a_loop_that_would_start_anywhere_is_refused(five_bar: OnDemand) -> None:
    task = {**SWING, "horizon": {"guess": 0.3, "range": [0.2, 0.5]}}
    assert state(five_bar, {**task, "driven": {"right": "-1.1397 + 0.6*sin(t/T)**2"}}).driven
    with pytest.raises(ProblemError, match="the loops would start in a pose or at a velocity that the solver chooses"):
        state(five_bar, {**task, "driven": {"right": "-1.1397 + 0.6*sin(t/T)"}})


# --- what is refused ---


def test_a_problem_made_by_a_program_is_checked(cart: OnDemand) -> None:
    good = state(cart, TASK)
    for bad, finding in (
        (replace(good, driven=()), "the model drives cart, and the problem gives no motion of it"),
        (replace(good, driven=(*good.driven, Drive(1, "t"))), "the model does not drive it"),
        (replace(good, driven=(*good.driven, *good.driven)), "the joint has a motion already"),
        (replace(good, driven=(Drive(0, "q_pole"),)), 'unknown name "q_pole"'),
        (replace(good, driven=(Drive(0, "abs(t)"),)), "has a kink"),
        (replace(good, form=Form.SHOOTING), "the shooting form takes no driven joints"),
        (replace(good, bounds=replace(good.bounds, tau=((0.0, 1.0),) * 2)), "found 2 entries"),
    ):
        with pytest.raises(ProblemError, match=finding):
            solve(bad, cart)


def test_bounds_that_cross_are_a_failure(cart: OnDemand) -> None:
    good = state(cart, TASK)
    found = solve(replace(good, bounds=replace(good.bounds, tau=((1.0, -1.0),))), cart)
    assert not isinstance(found, Solution)
    assert found.finding == "the bounds of force of driven joint cart are [1, -1]"


def test_the_guess_follows_the_motion(cart: OnDemand) -> None:
    problem = state(cart, TASK)
    t, point_t = problem.grid.times(1.5, np.array([0.2, 1.0]))
    zeros = np.zeros((12, 2, 2))
    guess = Trajectory(t, np.zeros((13, 2)), np.zeros((13, 2)), np.zeros((12, 1)), point_t, zeros, zeros, zeros)
    found = complete(guess, problem, cart)
    assert found.point_qdd[:, :, 0] == pytest.approx(5.4 * np.cos(6 * point_t), abs=1e-12)
    assert not found.point_qdd[:, :, 1].any()


def test_targets_that_follow_from_the_given_motion_are_no_conditions(cart: OnDemand) -> None:
    """The pole alone moves at the end: of the place of its tip, one coordinate decides."""
    expected = find(cart, state(cart, TASK, Representation.IMPL))
    tip = cart("sensors", q=expected.trajectory.q[-1])["position"].ravel()
    task = {**TASK, "end": {"sensors": {"tip": dict(zip("xyz", map(float, tip), strict=True))}, "velocity": "zero"}}
    problem = state(cart, task, Representation.IMPL)
    freed = free_targets(problem, cart, expected.trajectory.q[-1])
    ((_, target),) = freed.end.sensors
    assert [x is not None for x in target].count(True) == 1
    away = expected.trajectory.q[-1] + [0, 0.1]
    assert free_targets(problem, cart, away) == problem  # values that need not agree stay conditions
    assert free_targets(state(cart, {**FREE, "end": task["end"]}), cart, expected.trajectory.q[-1]).end == problem.end
    for representation in (Representation.SEMI, Representation.EXP2_A):
        found = find(cart, state(cart, task, representation))
        assert found.cost.total == pytest.approx(expected.cost.total, rel=1e-7)
        assert found.problem.end == problem.end
        assert found.trajectory.q[-1] == pytest.approx(expected.trajectory.q[-1], abs=1e-7)


def test_the_example_is_solved(requires: Callable[[str], str]) -> None:
    """The table's torque reaches its bounds, and its turn is a quarter."""
    requires("cc")
    problem, plant = read_problem(MODELS / "driven" / "turntable_pass.ocp.yaml", load_on_demand)
    found = solve(problem, plant)
    assert isinstance(found, Solution), found
    assert found.driving is not None
    assert np.abs(found.driving).max() == pytest.approx(6, abs=1e-5)
    assert found.trajectory.q[-1, 0] == pytest.approx(np.pi / 2, abs=1e-12)
    assert found.trajectory.t[-1] < 0.9


def test_phases_refuse_driven_joints(cart: OnDemand, tmp_path: Path) -> None:
    file = tmp_path / "p.ocp.yaml"
    file.write_text(
        "model: pushed.yaml\nscheme: radau\ndegree: 3\nintervals: 3\ncost: {inputs: 1}\n"
        "phases:\n  - {name: a, horizon: 1, start: {pose: {}}}\n  - {name: b, horizon: 1}\nlinks: [{from: a, to: b}]\n"
    )
    with pytest.raises(InputError, match="the model drives cart, and a problem of phases takes no driven joints"):
        read_phased_problem(file, lambda _: cart)
