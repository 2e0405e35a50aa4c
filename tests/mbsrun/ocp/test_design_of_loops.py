"""Unknown parameters of mechanisms with closed loops: lengths, masses and springs chosen with the motion.

The four-bar is compared with a program that is written from scratch: one coordinate, the angle phi of the crank. The
circles about the ends of crank and ground meet at the joint of coupler and rocker, so every point is a function of phi
and of the lengths. With T = m(phi) phid^2 / 2 and the potential V(phi), Lagrange's equation is

    m phidd + m' phid^2 / 2 + V' = u,

and its collocation has the same points as the one of the reduced form: both optima are the same to the tolerance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import MappingProxyType

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from mbsgen.errors import InputError
from mbsrun.closure import CLOSED, Closure
from mbsrun.external import OnDemand, load_on_demand
from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import make_guess
from mbsrun.ocp.guessing.state_guess import complete
from mbsrun.ocp.optima.sensitivity import find_sensitivities
from mbsrun.ocp.problem.design import equip
from mbsrun.ocp.problem.problem import Form, Loops, Problem, Representation
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import Solution, read_solution, write_solution
from mbsrun.ocp.solving.assembly import find_other_assembly
from mbsrun.ocp.solving.phases import solve_phases
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import Solver, solve
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.phases import read_phased_problem
from mbsrun.ocp.statement.statement import read_problem

GROUND, CRANK, COUPLER, G = 0.30, 0.10, 0.28, 9.81
BAR = f"""\
name: bar
gravity: [0, 0, -{G}]
parameters:
  crank: {{value: {CRANK}, kind: differentiated}}
  rocker: {{value: 0.24, kind: differentiated}}
  mass: {{value: 0.36, kind: differentiated}}
  k: {{value: 0.5, kind: differentiated}}
bodies:
  - name: crank
    joint: {{name: motor, type: revolute, axis: -y}}
    mass: 0.15
    com: [crank/2, 0, 0]
    inertia: [0, 1e-4, 1e-4]
  - name: coupler
    parent: crank
    joint: {{name: pin, type: revolute, axis: -y, position: [crank, 0, 0], actuated: false}}
    mass: 0.42
    com: [{COUPLER}/2, 0, 0]
    inertia: [0, 3e-3, 3e-3]
  - name: rocker
    joint: {{name: swing, type: revolute, axis: -y, position: [{GROUND}, 0, 0], actuated: false,
             stiffness: k, rest: 1.6}}
    mass: mass
    com: [rocker/2, 0, 0]
    inertia: [0, mass*rocker**2/12, mass*rocker**2/12]
loops:
  - {{name: closure, type: hinge, axis: y, from: {{body: coupler, position: [{COUPLER}, 0, 0]}},
     to: {{body: rocker, position: [rocker, 0, 0]}}}}
independent: [motor]
assembly: {{motor: 60 deg, pin: -29 deg, swing: 91 deg}}
frames:
  - {{name: tracer, body: coupler, position: [{COUPLER}/2, 0, 0.08]}}
"""
PRICES = """\
    - {expression: (rocker - 0.25)**2, weight: 10}
    - {expression: (mass - 0.3)**2, weight: 0.05}
    - {expression: k**2, weight: 0.001}
"""
UNKNOWNS = """\
unknowns:
  rocker: {guess: 0.24, range: [0.22, 0.3]}
  mass: {guess: 0.36, range: [0.1, 1]}
  k: {guess: 0.5, range: [0, 20]}
"""
TURN = f"""\
model: bar.yaml
horizon: 0.5
intervals: 12
scheme: radau
degree: 3
{UNKNOWNS}cost:
  inputs: 1
  terminal:
{PRICES}start: {{pose: {{motor: 60 deg}}}}
end: {{pose: {{motor: 150 deg}}, velocity: zero}}
"""
Array = NDArray[np.float64]
GUESS: Mapping[str, float] = MappingProxyType({"rocker": 0.24, "mass": 0.36, "k": 0.5})


@pytest.fixture
def folder(tmp_path: Path, requires: Callable[[str], str]) -> Path:
    requires("cc")
    (tmp_path / "bar.yaml").write_text(BAR, "utf-8")
    return tmp_path


def read(folder: Path, text: str = TURN) -> tuple[Problem, OnDemand]:
    path = folder / "turn.ocp.yaml"
    path.write_text(text, "utf-8")
    problem, plant = read_problem(path, load_on_demand)
    assert isinstance(plant, OnDemand)
    return problem, plant


def solved(problem: Problem, plant: OnDemand) -> Solution:
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution), outcome
    return outcome


# --- the same from scratch ---


def write_motion() -> ca.Function:
    """Write the torque of the crank and the angle of the rocker, by phi, phid, phidd and the unknown numbers."""
    phi, phid, phidd, rocker, mass, k = (ca.SX.sym(x) for x in ("phi", "phid", "phidd", "rocker", "mass", "k"))
    knee = CRANK * ca.vertcat(ca.cos(phi), ca.sin(phi))
    way = ca.vertcat(GROUND, 0) - knee
    far = ca.norm_2(way)
    along = (COUPLER**2 - rocker**2 + far**2) / (2 * far)
    across = ca.sqrt(COUPLER**2 - along**2)
    tip = knee + along * way / far + across * ca.vertcat(-way[1], way[0]) / far
    swing = ca.atan2(tip[1], tip[0] - GROUND)
    slope = ca.atan2(tip[1] - knee[1], tip[0] - knee[0])
    parts = (
        (0.15, 1e-4, knee / 2, phi),
        (0.42, 3e-3, (knee + tip) / 2, slope),
        (mass, mass * rocker**2 / 12, (tip + ca.vertcat(GROUND, 0)) / 2, swing),
    )
    inertia = sum(m * ca.sumsqr(ca.jacobian(at, phi)) + I * ca.jacobian(turn, phi) ** 2 for m, I, at, turn in parts)
    V = sum(m * G * at[1] for m, _, at, _ in parts) + k * (swing - 1.6) ** 2 / 2
    u = inertia * phidd + ca.jacobian(inertia, phi) * phid**2 / 2 + ca.jacobian(V, phi)
    return ca.Function("motion", [phi, phid, phidd, ca.vertcat(rocker, mass, k)], [u, swing])


def price(numbers: ca.MX) -> ca.MX:
    rocker, mass, k = ca.vertsplit(numbers)
    return 10 * (rocker - 0.25) ** 2 + 0.05 * (mass - 0.3) ** 2 + 0.001 * k**2


@cache
def solve_from_scratch() -> tuple[float, Array, Array]:
    """Return the least cost, the numbers (rocker, mass, k) and the angles of the crank at mesh points."""
    N, T, scheme = 12, 0.5, schemes.build(Family.RADAU, 3)
    opti, h, motion = ca.Opti(), T / N, write_motion()
    states, u, numbers = opti.variable(2, N + 1), opti.variable(N), opti.variable(3)
    points = [opti.variable(2, 3) for _ in range(N)]
    for i in range(N):
        nodes = ca.horzcat(states[:, i], points[i])
        rates = nodes @ scheme.D.T / h
        for j in range(3):
            opti.subject_to(rates[0, j] == points[i][1, j])
            opti.subject_to(motion(points[i][0, j], points[i][1, j], rates[1, j], numbers)[0] == u[i])
        opti.subject_to(states[:, i + 1] == points[i][:, 2])
        for point in ca.horzsplit(nodes):
            opti.set_initial(point, [1.05 + 1.57 * (i + 0.5) / N, 3.0])
    opti.subject_to(states[:, 0] == [np.pi / 3, 0])
    opti.subject_to(states[:, N] == [5 * np.pi / 6, 0])
    opti.subject_to(opti.bounded([0.22, 0.1, 0], numbers, [0.3, 1, 20]))
    opti.set_initial(numbers, list(GUESS.values()))
    opti.minimize(h * ca.sumsqr(u) + price(numbers))
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "tol": 1e-11})
    found = opti.solve()
    return found.value(opti.f), np.array(found.value(numbers)), np.array(found.value(states[0, :]))


FORMS = [
    *((Loops.MULTIPLIERS, representation, Form.STANDARD, "mbs") for representation in Representation),
    (Loops.MULTIPLIERS, Representation.IMPL, Form.STANDARD, "ipopt"),
    (Loops.REDUCED, Representation.IMPL, Form.STANDARD, "mbs"),
    (Loops.REDUCED, Representation.IMPL, Form.STANDARD, "ipopt"),
    (Loops.REDUCED, Representation.IMPL, Form.INTEGRAL, "mbs"),
    (Loops.REDUCED, Representation.IMPL, Form.SHOOTING, "ipopt"),
    (Loops.REDUCED, Representation.EXP1_O, Form.STANDARD, "mbs"),
    (Loops.REDUCED, Representation.EXP1_O, Form.SHOOTING, "mbs"),
    (Loops.REDUCED, Representation.EXP1_A, Form.STANDARD, "mbs"),
]


@pytest.mark.parametrize(("loops", "representation", "form", "method"), FORMS)
def test_length_mass_and_spring_are_the_ones_of_a_program_from_scratch(
    folder: Path, loops: Loops, representation: Representation, form: Form, method: str
) -> None:
    """The reduced form has its very equations; with multipliers, the error of the discretisation differs, some h^5."""
    cost, numbers, phi = solve_from_scratch()
    problem, plant = read(folder)
    problem = replace(problem.with_solver(method), loops=loops, representation=representation, form=form)
    problem = replace(problem, solver=replace(problem.solver, tolerance=1e-10))
    found = solved(problem, plant)
    same = 1e-7 if loops is Loops.REDUCED else 1e-5
    assert found.cost.total == pytest.approx(cost, rel=same)
    assert found.trajectory.unknowns == pytest.approx(numbers, rel=10 * same)
    assert found.trajectory.q[:, 0] == pytest.approx(phi, abs=100 * same)
    assert found.violation.closure is not None
    assert found.violation.closure <= CLOSED


def test_the_motion_found_stays_closed(folder: Path, tmp_path: Path) -> None:
    """Starts and re-simulations have the lengths found, also when they are read from a file."""
    problem, plant = read(folder)
    found = resimulate(solved(replace(problem, intervals=30, loops=Loops.MULTIPLIERS), plant), plant)
    write_solution(found, tmp_path / "solution.json")
    for solution in (found, read_solution(tmp_path / "solution.json")):
        assert solution.resimulation is not None
        assert solution.resimulation.closure is not None
        assert solution.resimulation.closure <= CLOSED
    known = equip(plant, problem, found.trajectory.unknowns)
    assert Closure(known).measure(found.trajectory.q) <= CLOSED
    assert Closure(plant).measure(found.trajectory.q) > 1e-3  # with the length that was guessed
    swing = float(write_motion()(*found.trajectory.q[0, :1], 0, 0, found.trajectory.unknowns)[1])
    assert found.trajectory.q[0] == pytest.approx([np.pi / 3, found.trajectory.q[0, 1], swing], abs=1e-9)
    again = solve(replace(problem, intervals=30, loops=Loops.REDUCED), plant, guess=found.trajectory)
    assert isinstance(again, Solution)
    assert again.cost.total == pytest.approx(found.cost.total, rel=1e-6)


@pytest.mark.parametrize("loops", Loops)
def test_no_neighbour_is_better(folder: Path, loops: Loops) -> None:
    """The least cost of a motion, with given numbers, is stationary at the numbers found, and higher beside them."""
    problem, plant = read(folder)
    problem = replace(problem, loops=loops, solver=replace(problem.solver, tolerance=1e-11))
    found = solved(problem, plant)
    best = dict(zip(GUESS, found.trajectory.unknowns.tolist(), strict=True))

    def cost(**changes: float) -> float:
        given = best | changes
        text = TURN.replace(UNKNOWNS, f"parameters: {given}\n").replace("  terminal:\n" + PRICES, "")
        fixed, with_numbers = read(folder, text)
        fixed = replace(fixed, loops=loops, solver=problem.solver)
        return solved(fixed, with_numbers).cost.total + float(price(ca.DM(list(given.values()))))

    assert cost() == pytest.approx(found.cost.total, rel=1e-9)
    for name, value in best.items():
        step = 1e-3 * value
        above, below = cost(**{name: value + step}), cost(**{name: value - step})
        assert min(above, below) > found.cost.total
        assert abs(above - below) / (2e-3) <= 1e-5 * found.cost.total + 2 * (above + below - 2 * found.cost.total)


@pytest.mark.parametrize(
    ("loops", "representation"),
    [
        (Loops.MULTIPLIERS, Representation.IMPL),
        (Loops.MULTIPLIERS, Representation.SEMI),
        (Loops.MULTIPLIERS, Representation.EXP1_O),
        (Loops.MULTIPLIERS, Representation.EXP2_A),
        (Loops.REDUCED, Representation.IMPL),
        (Loops.REDUCED, Representation.EXP1_O),
    ],
)
def test_derivatives_are_exact(folder: Path, loops: Loops, representation: Representation) -> None:
    """The error of a linear prediction is a quarter where the step is half: of rows, and of gradients."""
    text = TURN.replace("end: {pose: {motor: 150 deg},", "end: {sensors: {tracer: {z: 0.15}},")
    problem, plant = read(folder, text)
    problem = replace(problem, intervals=2, degree=2, loops=loops, representation=representation)
    rest = make_guess(
        replace(problem, guess=replace(problem.guess, motion="rest")), plant, schemes.build(Family.RADAU, 2)
    )
    assert isinstance(rest, Trajectory)
    solver = Solver(problem, plant)
    program, p = solver.program, solver.transcription.parameters(problem)
    functions, other = program.casadi, Prepared(solver.transcription.program, solver.plant).numpy
    x = solver.transcription.pack(complete(rest, problem, plant))
    rng = np.random.default_rng(1)
    x += 0.02 * rng.normal(size=x.size)
    way, lam = rng.normal(size=x.size) / 10, rng.normal(size=functions.constraints)

    def g(h: float) -> Array:
        return np.asarray(functions.constraint(x + h * way, p).full().ravel())

    def slope(h: float) -> Array:
        J = functions.jacobian(x + h * way, p).full()
        return np.asarray(functions.gradient(x + h * way, p)[1].full().ravel() + J.T @ lam)

    J, H = functions.jacobian(x, p).full(), np.array(ca.DM(functions.hessian(x, p, 1.0, lam)).full())
    H = np.triu(H) + np.triu(H, 1).T
    for value, rate in ((g, J @ way), (slope, H @ way)):
        left = [float(np.abs(value(h) - value(0.0) - h * rate).max()) for h in (1e-2, 5e-3, 2.5e-3)]
        assert left[0] / left[1] == pytest.approx(4, rel=0.1)
        assert left[1] / left[2] == pytest.approx(4, rel=0.1)
    columns = solver.transcription.layout.unknowns
    assert (np.abs(J[:, columns]).max(axis=0) > 1e-3).all()
    assert other.jacobian(x, p).toarray() == pytest.approx(J, abs=1e-9 * np.abs(J).max())


# --- starts, ends, assemblies ---


def test_masses_and_springs_leave_the_start_as_it_is(folder: Path) -> None:
    rocker = "  rocker: {guess: 0.24, range: [0.22, 0.3]}\n"
    held, _ = read(folder, TURN.replace(rocker, "").replace("(rocker - 0.25)**2", "k"))
    freed, plant = read(folder)
    assert Closure(plant).parameters == ("crank", "rocker")
    assert held.free_start == ()
    assert freed.free_start == held.following == (1, 2, 4, 5)
    assert freed.start_q == held.start_q


SURPLUS = "follows from the others by the loops, which change with rocker"


@pytest.mark.parametrize(
    ("old", "new", "path", "finding", "remedy"),
    [
        ("{motor: 60 deg}", "{motor: 60 deg, swing: SWING}", "start.pose.swing", f"swing {SURPLUS}", "leave it out"),
        (
            "{pose: {motor: 60 deg}}",
            "{pose: {motor: 60 deg}, velocity: {motor: 1, swing: RATE}}",
            "start.velocity.swing",
            f"swing {SURPLUS}",
            "leave it out",
        ),
        (
            "{motor: 150 deg}",
            "{motor: 150 deg, swing: END}",
            "end.pose.swing",
            f"swing {SURPLUS}",
            "leave it out, or write it as a constraint at: end",
        ),
    ],
)
def test_a_value_that_lengths_change_is_refused(
    folder: Path, old: str, new: str, path: str, finding: str, remedy: str
) -> None:
    """Also where it agrees with the lengths that are guessed."""
    problem, plant = read(folder)
    closure, q = Closure(plant), np.array(problem.start_q)
    end = closure.move(q, (0,), np.array([5 * np.pi / 6]))
    rate = closure.complete_velocities(q, (0,), np.ones(1))[2]
    text = new.replace("SWING", f"{q[2]:.17g}").replace("RATE", f"{rate:.17g}").replace("END", f"{end[2]:.17g}")
    with pytest.raises(InputError) as caught:
        read(folder, TURN.replace(old, text))
    assert (path, finding, remedy) in [(f.path, f.finding, f.remedy) for f in caught.value.faults]


def test_a_coordinate_at_the_end_that_follows_is_met_as_a_constraint(folder: Path) -> None:
    """Two angles at the end determine the length, by the law of cosines."""
    text = TURN.replace("start:", "constraints:\n  - {expression: q_swing, range: [2.225, 2.225], at: end}\nstart:")
    found = solved(*read(folder, text))
    rocker = found.trajectory.unknowns[0]
    swing = float(write_motion()(5 * np.pi / 6, 0, 0, [rocker, 0.3, 1])[1])
    assert swing == pytest.approx(2.225, abs=1e-8)


def test_a_start_made_in_python_leaves_free_what_lengths_change(folder: Path) -> None:
    problem, plant = read(folder)
    with pytest.raises(
        ProblemError, match="start_q: all entries are given, and rocker changes the ones that loops give"
    ):
        solve(replace(problem, free_start=()), plant)


def test_another_assembly_is_no_solution(folder: Path) -> None:
    """The same crank and lengths, with the rocker below the base; and a length for which no loop closes on the way."""
    problem, plant = read(folder)
    found = solved(problem, plant)
    assert not find_other_assembly(found, plant)
    q = found.trajectory.q.copy()
    q[0] = Closure(equip(plant, problem, found.trajectory.unknowns)).close(np.array([np.pi / 3, -2.5, -1.7]), (0,))
    other = replace(found, trajectory=replace(found.trajectory, q=q))
    assert find_other_assembly(other, plant).startswith("with the guesses of rocker it starts ")
    far = replace(problem, unknowns=(replace(problem.unknowns[0], guess=0.8), *problem.unknowns[1:]))
    assert "no way of closed poses was found from the values of rocker" in find_other_assembly(
        replace(found, problem=far), plant
    )


@pytest.mark.parametrize("start", ["{motor: 60 deg}", "{swing: 95 deg}"])
def test_sensitivities_by_lengths_hold_the_given_start(folder: Path, start: str) -> None:
    """The derivative of the least cost, and the costs of solves at values beside it."""
    text = TURN.replace(UNKNOWNS, "PARAMETERS\nsolver: {tolerance: 1.0e-12}\n").replace("  terminal:\n" + PRICES, "")
    text = text.replace("{motor: 60 deg}", start)
    problem, plant = read(folder, text.replace("PARAMETERS\n", ""))
    found = dict(find_sensitivities(solved(problem, plant), plant).sensitivities)
    assert list(found) == ["crank", "rocker", "mass", "k"]
    for name in ("crank", "rocker", "k"):
        value = plant.parameters[name]
        above, below = (
            solved(*read(folder, text.replace("PARAMETERS", f"parameters: {{{name}: {value + h:.17g}}}"))).cost.total
            for h in (1e-4 * value, -1e-4 * value)
        )
        assert found[name] == pytest.approx((above - below) / (2e-4 * value), rel=1e-5)


# --- other problems ---


def test_phases_share_the_lengths(folder: Path) -> None:
    """A motion in two phases of one mechanism is the motion in one."""
    first, last = TURN.replace(UNKNOWNS, "").replace("0.5\n", "0.25\n", 1).replace("12", "6", 1), "end: {pose"
    start, end = first.index("start:"), first.index(last)
    second = first[: first.index("  terminal")] + first[end:]
    text = "phases:\n"
    for name, part in (("first", first[:start] + first[start:end]), ("second", second)):
        text += f"  - name: {name}\n" + "".join(f"    {line}\n" for line in part.splitlines())
    path = folder / "phases.ocp.yaml"
    path.write_text(f"{text}{UNKNOWNS}links: [{{from: first, to: second}}]\n", "utf-8")
    problem, plants = read_phased_problem(path, load_on_demand)
    found, whole = solve_phases(problem, plants), solved(*read(folder))
    assert isinstance(found, PhasedSolution), found
    assert found.cost == pytest.approx(whole.cost.total, rel=1e-7)
    assert found.unknown_values == pytest.approx(whole.trajectory.unknowns, rel=1e-4)  # the cost is flat there


def test_the_numbers_of_a_driven_linkage(folder: Path) -> None:
    """The motion of the crank is given; the integral of its squared torque is least at the numbers found."""
    bar = BAR.replace("name: motor, type: revolute, axis: -y", "name: motor, type: revolute, axis: -y, actuated: false")
    (folder / "bar.yaml").write_text(bar.replace("independent:", "driven:"), "utf-8")
    text = TURN.replace("inputs: 1", "running: [{expression: tau_motor**2}]").replace("{motor: 60 deg}", "{}")
    text = text[: text.index("end:")] + "driven: {motor: pi/3 + 1.5*(t/T)**3*(10 - 15*t/T + 6*(t/T)**2)}\n"
    found = solved(*read(folder, text))
    nodes, weights = np.polynomial.legendre.leggauss(40)
    s, motion = (1 + nodes) / 2, write_motion()
    phi = np.pi / 3 + 1.5 * s**3 * (10 - 15 * s + 6 * s**2)
    phid = 1.5 * 30 * s**2 * (1 - s) ** 2 / 0.5
    phidd = 1.5 * 60 * s * (1 - s) * (1 - 2 * s) / 0.25

    def cost(numbers: Array) -> float:
        torque = motion.map(40)(phi[None], phid[None], phidd[None], np.tile(numbers[:, None], 40))[0].full().ravel()
        return float(weights @ torque**2 / 4 + price(ca.DM(numbers)))

    best = minimize(cost, list(GUESS.values()), method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-14})
    assert found.cost.total == pytest.approx(best.fun, rel=1e-6)
    assert found.trajectory.unknowns == pytest.approx(best.x, rel=1e-4)


BALL = """\
name: crank
gravity: [0, 0, -9.81]
parameters:
  arm: {value: 0.1, kind: differentiated}
  load: {value: 0.8, kind: differentiated}
bodies:
  - {name: crank, joint: {name: crank, type: revolute, axis: x}, mass: 1, com: [0, 0, 0.05],
     inertia: [0.02, 0.03, 0.04]}
  - {name: rod, parent: crank, joint: {type: ball, position: [0, 0, arm], actuated: false}, mass: 0.6, com: [0.3, 0, 0],
     inertia: [0.001, 0.02, 0.0205]}
  - {name: slider, joint: {name: slider, type: prismatic, axis: x, position: [0, 0.1, 0], actuated: false}, mass: load}
loops:
  - {name: wrist, type: universal, axis: y, axis2: z, from: {body: slider}, to: {body: rod, position: [0.6, 0, 0]}}
independent: [crank]
assembly: {slider: 0.57}
"""
BALL_TURN = """\
model: bar.yaml
horizon: 0.5
intervals: 8
scheme: radau
degree: 3
unknowns: {arm: {guess: 0.1, range: [0.05, 0.2]}, load: {guess: 0.8, range: [0.3, 1]}}
cost: {inputs: 1, terminal: [{expression: (arm - 0.12)**2 + (load - 0.5)**2, weight: 30}]}
start: {pose: {crank: 0}}
end: {pose: {crank: 2}, velocity: zero}
"""


def test_the_loop_of_a_joint_with_a_quaternion(folder: Path) -> None:
    """The least cost of a motion is stationary at the numbers found."""
    (folder / "bar.yaml").write_text(BALL, "utf-8")
    found = solved(*read(folder, BALL_TURN))
    best = found.trajectory.unknowns
    unknowns, cost = BALL_TURN.splitlines(keepends=True)[5:7]

    def solve_at(arm: float) -> float:
        fixed = BALL_TURN.replace(unknowns, f"parameters: {{arm: {arm:.17g}, load: {best[1]:.17g}}}\n")
        own = solved(*read(folder, fixed.replace(cost, "cost: {inputs: 1}\n"))).cost.total
        return own + 30 * float((arm - 0.12) ** 2 + (best[1] - 0.5) ** 2)

    assert solve_at(best[0]) == pytest.approx(found.cost.total, rel=1e-7)
    above, below = solve_at(1.003 * best[0]), solve_at(0.997 * best[0])
    assert min(above, below) > found.cost.total
    assert abs(above - below) <= 0.05 * (above + below - 2 * found.cost.total)
