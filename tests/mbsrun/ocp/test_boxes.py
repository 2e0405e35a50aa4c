"""A ball that is pushed along a shelf and up beside it, against a program of CasADi's Opti with the documented law."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from mbsrun import load
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem

SHELF = """
name: shelf
gravity: [0, 0, -9.81]
bodies:
  - {name: cart, joint: {name: x, type: prismatic, axis: x}, mass: 0}
  - {name: ball, parent: cart, joint: {name: z, type: prismatic, axis: z, actuated: false}, mass: 1}
contacts:
  - {name: edge, body: ball, radius: 0.1, box: {position: [0, 0, -0.1], size: [0.6, 1, 0.2]}, stiffness: 2e3,
     exponent: 1, width: 1e-2, dissipation: 0.1}
"""
FALL = """
model: shelf.yaml
horizon: 0.8
intervals: 40
scheme: radau
degree: 3
start: {pose: {x: 0, z: 0.1}}
end: {pose: {x: 0.45, z: -0.2}}
cost: {inputs: 1}
guess: {motion: line}
"""
INTERVALS, DEGREE, HORIZON = 40, 3, 0.8


def soften(x: ca.MX, width: float) -> ca.MX:
    most = ca.fmax(x / width, 0)
    return width * (most + ca.log(ca.exp(-most) + ca.exp(x / width - most)))


def accelerate(state: ca.MX, u: ca.MX) -> ca.MX:
    """Return the time derivatives of x, z and their velocities; CasADi differentiates the gap."""
    at, w = ca.MX.sym("at", 2), 1e-2
    x = ca.vertcat(at[0], 0, at[1] + 0.1)
    q = ca.vertcat(*(soften(2 * x[i], w) - x[i] - half for i, half in enumerate((0.3, 0.5, 0.1))))
    y = ca.vertcat(*(soften(q[i], w) for i in range(3)))
    m = q[2] + soften(q[1] + soften(q[0] - q[1], w) - q[2], w)
    g = ca.sqrt(ca.sumsqr(y) + (1e-3 * w) ** 2) - soften(-m, w) - 0.1
    measure = ca.Function("measure", [at], [g, ca.gradient(g, at)])
    gap, n = measure(state[:2])
    rate = ca.dot(n, state[2:])
    N = 2e3 * soften(-gap, w) * soften(1 - 0.1 * rate, 0.1) / soften(ca.MX(1), 0.1)
    return ca.vertcat(state[2:], ca.vertcat(u, -9.81) + N * n)


def solve_with_opti(guess: np.ndarray) -> float:
    """Collocate the states at Radau points, and return the least integral of u**2."""
    opti = ca.Opti()
    h, points = HORIZON / INTERVALS, [0.0, *ca.collocation_points(DEGREE, "radau")]
    slopes = [
        np.polyder(np.poly1d(np.poly([p for p in points if p != own])) / np.prod([own - p for p in points if p != own]))
        for own in points
    ]
    state, cost = opti.variable(4), 0
    opti.subject_to(state == ca.DM([0, 0.1, 0, 0]))
    for k in range(INTERVALS):
        u = opti.variable()
        inner = [state, *(opti.variable(4) for _ in range(DEGREE))]
        for j in range(1, DEGREE + 1):
            opti.set_initial(inner[j], guess[k])
            rate = sum(float(slopes[i](points[j])) * inner[i] for i in range(DEGREE + 1))
            opti.subject_to(rate == h * accelerate(inner[j], u))
        state, cost = inner[-1], cost + h * u**2
    opti.subject_to(state[:2] == ca.DM([0.45, -0.2]))
    opti.minimize(cost)
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "tol": 1e-10})
    return float(opti.solve().value(cost))


@pytest.mark.parametrize("method", ["ipopt", "mbs"])
def test_a_fall_over_an_edge_is_the_optimum_of_an_independent_program(method: str, tmp_path: Path) -> None:
    """The same cost on the same grid: the ball leaves the shelf over its edge. `mbs` begins at IPOPT's motion."""
    (tmp_path / "shelf.yaml").write_text(SHELF)
    (tmp_path / "fall.ocp.yaml").write_text(FALL + "solver: {method: ipopt}\n")
    found = solve(*read_problem(tmp_path / "fall.ocp.yaml", load))
    assert isinstance(found, Solution), found
    if method == "mbs":
        (tmp_path / "fall.ocp.yaml").write_text(FALL + "solver: {method: mbs}\n")
        found = solve(*read_problem(tmp_path / "fall.ocp.yaml", load), guess=found.trajectory)
        assert isinstance(found, Solution), found
    motion = found.trajectory
    guess = np.hstack((motion.q, motion.qd))[1:]
    assert found.cost.inputs == pytest.approx(solve_with_opti(guess), rel=1e-6)
