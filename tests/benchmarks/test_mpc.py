"""The benchmark of predictive control: its runners solve one task, and find the same optimum."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from benchmarks.mpc.__main__ import agree, measure, shift
from benchmarks.mpc.casadi_peers import SETTINGS, CasadiPeer
from benchmarks.mpc.own import OwnRunner
from benchmarks.mpc.problem import JOINTS, Iterate, Task, rest
from mbsrun.external import OnDemand


def make_torque() -> ca.Function:
    """Make a robot whose inertia depends on the pose, in place of the kernel."""
    q, qd, a, u = (ca.SX.sym(name, JOINTS) for name in ("q", "qd", "a", "u"))
    return ca.Function("impl", [q, qd, a, u], [(2 + ca.sin(q)) * a + 10 * ca.cos(q) + 0.1 * qd**2 - u])


def test_runners_find_one_optimum_between_the_bounds() -> None:
    """Dynamics hold, torques stay within their bounds and reach them, and a shifted solution is a good guess."""
    task, torque = Task(intervals=8, step=0.05), make_torque()
    task = replace(task, torque=np.full(JOINTS, 18.0))
    rows = [measure(task, CasadiPeer(task, name, torque), 1) for name in SETTINGS]
    assert agree(rows)
    for row in rows:
        x, a = row.cold.iterate.x, row.cold.iterate.a
        assert x[1:] == pytest.approx(x[:-1] @ task.A.T + a @ task.B.T, abs=1e-9)
        torques = torque(x[:-1, :JOINTS].T, x[:-1, JOINTS:].T, a.T, 0).full()
        assert 18.0 - 1e-5 < np.abs(torques).max() < 18.0 + 1e-5


def test_an_iterate_is_shifted_along_the_dynamics() -> None:
    task = Task(intervals=3)
    guess = rest(task)
    a = np.arange(3 * JOINTS, dtype=float).reshape(3, JOINTS)
    x = [guess.x[0]]
    for k in range(3):
        x.append(task.A @ x[-1] + task.B @ a[k])
    moved = shift(task, Iterate(np.array(x), a))
    assert (moved.x[:-1] == np.array(x)[1:]).all()
    assert moved.x[-1] == pytest.approx(task.A @ moved.x[-2] + task.B @ moved.a[-1])


def test_rest_costs_the_way_to_the_target() -> None:
    task = Task(intervals=2, step=0.5, weights=(2.0, 1.0, 1.0), end_weights=(4.0, 1.0))
    gap = float(((task.start - task.target) ** 2).sum())
    guess = rest(task)
    assert task.cost(guess.x, guess.a) == pytest.approx((0.5 * 2 * 2 + 4.0) / 2 * gap)


def write_slides(folder: Path) -> Path:
    """Write a chain of seven slides, whose code is short."""
    lines = ["name: slides", "gravity: [0, 0, -9.81]", "bodies:"]
    for i in range(JOINTS):
        parent = f"parent: b{i - 1}, " if i else ""
        joint = f"{{name: s{i}, type: prismatic, axis: {'xyz'[i % 3]}, stiffness: 3, damping: 0.5, force: -2*q**3}}"
        lines.append(f"  - {{name: b{i}, {parent}joint: {joint}, mass: 0.5}}")
    (folder / "slides.yaml").write_text("\n".join(lines), encoding="utf-8")
    return folder / "slides.yaml"


def test_the_projects_solver_finds_the_optimum_and_controls_in_real_time(tmp_path: Path) -> None:
    model, task = write_slides(tmp_path), Task(intervals=8, step=0.05)
    task = replace(task, torque=np.full(JOINTS, 30.0))
    own = OwnRunner(task, model)
    rows = [measure(task, runner, 1) for runner in (own, CasadiPeer(task, "ipopt", OnDemand(model).casadi("impl")))]
    assert agree(rows)
    found = own.control(100)
    assert len(found.feedback) == 100
    assert found.gap < 1e-2
