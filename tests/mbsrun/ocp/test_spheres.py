"""A sled that pushes another one by compliant spheres, against a program of CasADi's Opti with the documented law."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from mbsrun import load
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem

SLEDS = """
name: sleds
gravity: [0, 0, 0]
bodies:
  - {name: a, joint: {type: prismatic, axis: x}, mass: 1}
  - {name: b, joint: {type: prismatic, axis: x, actuated: false}, mass: 2}
contacts:
  - {name: bump, body: a, radius: 0.1, sphere: {body: b, radius: 0.2, position: [0, 0, 0.05]}, stiffness: 2e3,
     exponent: 1, width: 5e-3, dissipation: 0.1}
"""
PUSH = """
model: sleds.yaml
horizon: 1
intervals: 40
scheme: radau
degree: 3
start: {pose: {a: 0, b: 0.4}}
end: {pose: {a: 0.4, b: 0.7}, velocity: {a: 0}}
cost: {inputs: 1}
"""
INTERVALS, DEGREE = 40, 3


def soften(x: ca.MX, width: float) -> ca.MX:
    most = ca.fmax(x / width, 0)
    return width * (most + ca.log(ca.exp(-most) + ca.exp(x / width - most)))


def accelerate(state: ca.MX, u: ca.MX) -> ca.MX:
    """Return the time derivatives of a, b and their velocities; the centres are 0.05 apart along z."""
    d = state[0] - state[1]
    length = ca.sqrt(d**2 + 0.05**2)
    rate = d * (state[2] - state[3]) / length
    N = 2e3 * soften(0.3 - length, 5e-3) * soften(1 - 0.1 * rate, 0.1) / soften(ca.MX(1), 0.1)
    return ca.vertcat(state[2], state[3], u + N * d / length, -N * d / length / 2)


def solve_with_opti() -> float:
    """Collocate the states at Radau points, and return the least integral of u**2."""
    opti = ca.Opti()
    h, points = 1 / INTERVALS, [0.0, *ca.collocation_points(DEGREE, "radau")]
    slopes = [
        np.polyder(np.poly1d(np.poly([p for p in points if p != own])) / np.prod([own - p for p in points if p != own]))
        for own in points
    ]
    state, cost = opti.variable(4), 0
    opti.subject_to(state == ca.DM([0, 0.4, 0, 0]))
    opti.set_initial(state, [0, 0.4, 0, 0])
    for k in range(INTERVALS):
        u = opti.variable()
        inner = [state, *(opti.variable(4) for _ in range(DEGREE))]
        for j in range(1, DEGREE + 1):
            share = (k + points[j]) / INTERVALS
            opti.set_initial(inner[j], [0.4 * share, 0.4 + 0.3 * share, 0.4, 0.3])
            rate = sum(float(slopes[i](points[j])) * inner[i] for i in range(DEGREE + 1))
            opti.subject_to(rate == h * accelerate(inner[j], u))
        state, cost = inner[-1], cost + h * u**2
    opti.subject_to(state[:3] == ca.DM([0.4, 0.7, 0]))
    opti.minimize(cost)
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "tol": 1e-10})
    return float(opti.solve().value(cost))


@pytest.mark.parametrize("method", ["ipopt", "mbs"])
def test_a_push_is_the_optimum_of_an_independent_program(method: str, tmp_path: Path) -> None:
    """The same cost on the same grid; the momentum of both at the end is the integral of the input."""
    (tmp_path / "sleds.yaml").write_text(SLEDS)
    (tmp_path / "push.ocp.yaml").write_text(PUSH + f"solver: {{method: {method}}}\n")
    found = solve(*read_problem(tmp_path / "push.ocp.yaml", load))
    assert isinstance(found, Solution), found
    assert found.cost.inputs == pytest.approx(solve_with_opti(), rel=1e-6)
    motion = found.trajectory
    assert motion.u.sum() / INTERVALS == pytest.approx(motion.qd[-1] @ [1, 2], rel=1e-8)
