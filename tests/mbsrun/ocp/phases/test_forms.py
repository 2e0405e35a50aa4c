"""Phases in every form and representation: a swing-up that drops a load on the way, in two phases of free durations.

Shooting by the collocation of the scheme, in one step, has the optimum of the standard form to rounding. Shooting by
Runge and Kutta's method is compared with a program in CasADi's Opti, with equations of motion by hand.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun.external import load_on_demand
from mbsrun.ocp.solution.phases import Guess, PhasedSolution
from mbsrun.ocp.solving.phases import resimulate_phases, solve_phases
from mbsrun.ocp.statement.phases import read_phased_problem

MODEL = """
name: crane
gravity: [0, 0, -9.81]
parameters:
  load: {value: 0.3, kind: runtime}
  rope: {value: 0.5, kind: differentiated}
bodies:
  - {name: cart, joint: {name: cart, type: prismatic, axis: x}, mass: 1}
  - name: mass
    parent: cart
    joint: {name: angle, type: revolute, axis: y, actuated: false}
    mass: load
    com: [0, 0, -rope]
    inertia: [0, 0, 0]
frames: [{name: mass, body: mass, position: [0, 0, -rope]}]
"""
TEXT = """
model: crane.yaml
scheme: radau
degree: 3
intervals: 10
horizon: {guess: 1, range: [0.3, 2]}
cost: {inputs: 1, terminal: [{expression: T, weight: 3}]}
bounds: {inputs: [-30, 30], velocities: {cart: [-4, 4]}}
form: standard
solver: {method: mbs, tolerance: 1e-9}
phases:
  - name: loaded
    start: {pose: {}}
    end: {pose: {cart: 0.6}}
  - name: empty
    intervals: 8
    parameters: {load: 0.2}
    end: {pose: {cart: 1, angle: pi}, velocity: zero}
links:
  - from: loaded
    to: empty
    conditions: [{expression: end_q_angle + 0.1*start_qd_angle, range: [-1, 4]}]
"""
MODELS = Path(__file__).parents[4] / "models"
Solve = Callable[..., PhasedSolution]


@pytest.fixture
def solve(requires: Callable[[str], str], tmp_path: Path) -> Solve:
    requires("cc")
    (tmp_path / "crane.yaml").write_text(MODEL)

    def do(*changes: tuple[str, str], near: PhasedSolution | None = None) -> PhasedSolution:
        text = TEXT
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "crane.ocp.yaml").write_text(text)
        problem, plants = read_phased_problem(tmp_path / "crane.ocp.yaml", load_on_demand)
        found = solve_phases(problem, plants, guess=None if near is None else start_near(near))
        assert isinstance(found, PhasedSolution), found
        assert max(link.violation for link in found.values) < 2e-8
        return resimulate_phases(found, plants)

    return do


def start_near(found: PhasedSolution) -> Guess:
    """Return a guess near a solution: there are several minima."""
    known = zip((unknown.name for unknown in found.unknowns), found.unknown_values, strict=True)
    return Guess(tuple(phase.trajectory for phase in found.phases), tuple(known))


def expect_equal(found: PhasedSolution, expected: PhasedSolution) -> None:
    """The same cost, durations and motions."""
    assert found.cost == pytest.approx(expected.cost, rel=1e-8)
    assert found.durations == pytest.approx(expected.durations, rel=1e-5)
    assert found.unknown_values == pytest.approx(expected.unknown_values, rel=1e-5)
    for own, other in zip(found.phases, expected.phases, strict=True):
        assert own.trajectory.q == pytest.approx(other.trajectory.q, abs=1e-5)
        assert own.trajectory.point_q == pytest.approx(other.trajectory.point_q, abs=1e-5)


@pytest.mark.parametrize("family", ["radau", "legendre"])
def test_all_forms_and_representations_have_one_optimum(solve: Solve, family: str) -> None:
    """Both methods; forms that differ from phase to phase; every representation that a form takes."""
    family_change = ("scheme: radau", f"scheme: {family}")
    expected = solve(family_change)
    for form, representations in (
        ("standard", ["EXP1-O", "EXP1-A"]),
        ("integral", ["IMPL", "SEMI", "EXP2-A", "EXP2-O"]),
        ("shooting", ["IMPL", "SEMI", "EXP1-O", "EXP2-O"]),
    ):
        for name in representations:
            representation = ("form: standard", f"form: {form}\nrepresentation: {name}")
            expect_equal(solve(family_change, representation, near=expected), expected)
    shooting = ("form: standard", "form: shooting")
    found = solve(family_change, shooting, ("method: mbs", "method: ipopt"), near=expected)
    expect_equal(found, expected)
    expect_equal(solve(family_change, ("name: empty", "name: empty\n    form: shooting"), near=expected), expected)
    assert found.size.variables < expected.size.variables / 3


def test_shooting_takes_shared_unknowns_and_inputs_at_a_start(solve: Solve) -> None:
    """The length of the rope is chosen with the motion; a condition reads inputs, which leaves the stages."""
    changes = (
        ("solver:", "unknowns: {rope: {guess: 0.5, range: [0.3, 0.8]}}\nsolver:"),
        ("weight: 3}", "weight: 3}, {expression: (rope - 0.5)**2, weight: 1000}"),
        ("range: [-1, 4]}]", "range: [-1, 4]}, {expression: end_u_cart - start_u_cart, range: [0, 0]}]"),
        ("method: mbs", "method: ipopt"),
    )
    expected = solve(*changes)
    assert 0.3 < expected.unknown_values[0] < 0.8
    expect_equal(solve(*changes, ("form: standard", "form: shooting"), near=expected), expected)
    expect_equal(solve(*changes, ("form: standard", "form: shooting\nrepresentation: EXP1-O"), near=expected), expected)


CLOSED = """
model: five_bar.yaml
horizon: {guess: 0.5, range: [0.2, 1]}
intervals: 8
scheme: radau
degree: 3
loops: reduced
form: standard
cost: {inputs: 1, terminal: [{expression: T, weight: 2}]}
solver: {tolerance: 1e-9}
phases:
  - {name: first, start: {pose: {left: -2.4621, right: -1.1397}}}
  - {name: second, end: {pose: {left: -2.0, right: -0.8}, velocity: zero}}
links: [{from: first, to: second}]
"""
TURNED = """
model: satellite.yaml
horizon: {guess: 5, range: [2, 10]}
intervals: 8
scheme: radau
degree: 3
form: standard
cost: {inputs: 1, terminal: [{expression: T, weight: 0.01}]}
solver: {tolerance: 1e-9}
phases:
  - {name: first, start: {pose: {hinge: 0.4}}}
  - name: second
    end: {pose: {hull.qx: 0.5, hull.qy: 0.5, hull.qz: 0, hull.qw: 1/sqrt(2), hinge: 0.4}, velocity: zero}
links: [{from: first, to: second}]
"""


@pytest.mark.parametrize("text", [CLOSED, TURNED], ids=["loops", "quaternions"])
def test_shooting_has_the_optimum_of_the_standard_form(
    requires: Callable[[str], str], tmp_path: Path, text: str
) -> None:
    """With closed loops, and with quaternions."""
    requires("cc")
    found = []
    for name in ("five_bar.yaml", "satellite.yaml"):
        (tmp_path / name).write_text((MODELS / name).read_text("utf-8"), "utf-8")
    for form in ("standard", "shooting", "shooting\nrepresentation: EXP1-O"):
        (tmp_path / "task.ocp.yaml").write_text(text.replace("form: standard", f"form: {form}"), "utf-8")
        outcome = solve_phases(*read_phased_problem(tmp_path / "task.ocp.yaml", load_on_demand))
        assert isinstance(outcome, PhasedSolution), outcome
        found.append(outcome)
    for own in found[1:]:
        expect_equal(own, found[0])


def test_accelerations_in_links_of_shooting_are_refused(solve: Solve) -> None:
    """They are no variables there; the standard form takes them."""
    condition = ("range: [-1, 4]}]", "range: [-1, 4]}, {expression: end_qdd_cart, range: [-60, 60]}]")
    with pytest.raises(InputError, match=r"links\[0\].conditions\[1\].expression: unknown name .*end_qdd_cart"):
        solve(condition, ("form: standard", "form: shooting"))


def test_shooting_by_runge_kutta_is_a_program_in_opti(solve: Solve) -> None:
    found = solve(
        ("form: standard", "form: shooting\nintegrator: rk4\nsteps: 2\nrepresentation: EXP1-O"),
        ("degree: 3", "degree: 1"),
    )
    opti = ca.Opti()
    end, middle, total, times = ca.MX(), ca.MX(), 0, []
    for N, load in ((10, 0.3), (8, 0.2)):
        T, x, u = opti.variable(), opti.variable(4, N + 1), opti.variable(1, N)
        opti.subject_to(opti.bounded(0.3, T, 2))
        opti.subject_to(opti.bounded(-30, u, 30))
        opti.subject_to(opti.bounded(-4, x[2, :], 4))
        motion = found.phases[len(times)].trajectory
        opti.set_initial(T, motion.t[-1])
        opti.set_initial(u, motion.u.T)
        opti.set_initial(x, np.concatenate((motion.q, motion.qd), axis=1).T * 1.01)
        opti.subject_to(x[:, 0] == (end if times else 0))
        h = T / N
        for k in range(N):
            opti.subject_to(x[:, k + 1] == step(x[:, k], u[k], h, load))
        if times:
            opti.subject_to(opti.bounded(-1, end[1] + 0.1 * x[3, 0], 4))
            opti.subject_to(x[:, N] == ca.vertcat(1, ca.pi, 0, 0))
        else:
            opti.subject_to(x[0, N] == 0.6)
        middle = middle if times else x[:, N]
        end = x[:, N]
        times.append(T)
        total += h * ca.sumsqr(u) + 3 * T
    opti.minimize(total)
    opti.solver("ipopt", {"print_time": False, "ipopt.print_level": 0, "ipopt.tol": 1e-10})
    solution = opti.solve()
    assert found.cost == pytest.approx(solution.value(total), rel=1e-8)
    assert found.durations == pytest.approx([solution.value(T) for T in times], rel=1e-6)
    assert found.phases[1].trajectory.qd[0] == pytest.approx(solution.value(middle)[2:], rel=1e-5)


def step(x: ca.MX, u: ca.MX, h: ca.MX, load: float) -> ca.MX:
    """Two steps of Runge and Kutta's method; equations of a cart of 1 kg with a point mass at a rope of 0.5 m."""

    def rate(x: ca.MX) -> ca.MX:
        s, c, l, g = ca.sin(x[1]), ca.cos(x[1]), 0.5, 9.81
        # (1 + load) xdd - load l (add c - ad^2 s) = u,  l add = xdd c - g s
        xdd = (u - load * l * x[3] ** 2 * s - load * g * s * c) / (1 + load * s**2)
        return ca.vertcat(x[2], x[3], xdd, (xdd * c - g * s) / l)

    for _ in range(2):
        k1 = rate(x)
        k2 = rate(x + h / 4 * k1)
        k3 = rate(x + h / 4 * k2)
        k4 = rate(x + h / 2 * k3)
        x = x + h / 12 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x
