"""The benchmark of predictive control: its runners solve one task, and find the same optimum."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from benchmarks.mpc import acados_peer, own, sensitivities
from benchmarks.mpc.__main__ import shift
from benchmarks.mpc.casadi_peers import REFERENCE, CasadiPeer, list_settings
from benchmarks.mpc.contest import ACCURATE, Start, choose, compete
from benchmarks.mpc.own import OwnRunner
from benchmarks.mpc.page import Horizon, RealTime, write_page
from benchmarks.mpc.problem import JOINTS, Answer, Array, Iterate, Task, rest
from mbsrun.external import OnDemand


def make_torque() -> ca.Function:
    """Make a robot whose inertia depends on the pose, in place of the kernel."""
    q, qd, a, u = (ca.SX.sym(name, JOINTS) for name in ("q", "qd", "a", "u"))
    return ca.Function("impl", [q, qd, a, u], [(2 + ca.sin(q)) * a + 10 * ca.cos(q) + 0.1 * qd**2 - u])


def begin(task: Task, torque: ca.Function) -> Start:
    """Start at rest, with the exact solution."""
    state = np.concatenate([task.start, np.zeros(JOINTS)])
    return Start(state, rest(task), solve(CasadiPeer(task, REFERENCE, torque), state, rest(task)))


def solve(peer: CasadiPeer, state: Array, guess: Iterate, *, shifts: bool = False) -> Iterate:
    peer.prepare(state, guess, shifts=shifts)
    return peer.solve().iterate


def test_runners_find_one_optimum_between_the_bounds() -> None:
    """Dynamics hold, torques stay within their bounds and reach them; multipliers that are kept save iterations."""
    torque = make_torque()
    task = replace(Task(intervals=8, step=0.05), torque=np.full(JOINTS, 18.0))
    start = begin(task, torque)
    rows = []
    for name in ("fatrop", "ipopt"):
        best = choose(task, [CasadiPeer(task, next(list_settings(name)), torque)], start)
        rows += compete(task, {name: best}, start, 2)
    for row in rows:
        x, a = row.answer.iterate.x, row.answer.iterate.a
        assert row.error <= ACCURATE
        assert x[1:] == pytest.approx(x[:-1] @ task.A.T + a @ task.B.T, abs=1e-9)
        torques = torque(x[:-1, :JOINTS].T, x[:-1, JOINTS:].T, a.T, 0).full()
        assert 18.0 - 1e-4 < np.abs(torques).max() < 18.0 + 1e-5
    kept = CasadiPeer(task, next(x for x in list_settings("ipopt") if x.multipliers == "kept"), torque)
    cold = solve(kept, start.state, start.guess)
    ahead = shift(task, cold)
    kept.prepare(ahead.x[0], ahead, shifts=True)
    again = kept.solve()
    zero = CasadiPeer(task, replace(kept.settings, multipliers="zero"), torque)
    zero.prepare(ahead.x[0], ahead, shifts=True)
    assert again.iterations < zero.solve().iterations
    assert task.measure_error(again.iterate, solve(zero, ahead.x[0], ahead)) <= ACCURATE


def test_the_quickest_accurate_options_are_chosen() -> None:
    """Of three solvers, one is quick and wrong, one right and slow."""

    @dataclass
    class Known:
        settings: str
        seconds: float
        iterate: Iterate
        name: str = "known"

        def prepare(self, start: Array, guess: Iterate, *, shifts: bool) -> None:
            pass

        def solve(self) -> Answer:
            return Answer("done", True, 3, self.iterate, self.seconds)

    task = Task(intervals=2)
    exact = rest(task)
    off = Iterate(exact.x, exact.a + 2e-4 * 2 * task.acceleration)
    start = Start(exact.x[0], exact, exact)
    runners = [Known("wrong", 1.0, off), Known("slow", 3.0, exact), Known("best", 2.0, exact)]
    found = choose(task, runners, start)
    assert (found.runner, found.tried, found.accurate, found.best) == (runners[2], 3, 2, 2.0)
    assert np.isnan(found.first)
    with pytest.raises(RuntimeError, match="no options find the optimum"):
        choose(task, runners[:1], start)
    rows = compete(task, {"best": found, "slow": choose(task, runners[1:2], start)}, start, 4)
    assert (rows[1].ratios == 1.5).all()
    text = write_page([Horizon(task, tuple(rows), tuple(rows), ())], 4)
    assert "| 2 | slow | 3, 3000.00 | 1.5 | 3, 3000.00 | 1.5 | 1000.00 | 0e+00 |" in text
    assert "| 2 | best | cold | 3 | 2 | – | 2000.00 | best |" in text


def test_grids_begin_with_defaults_and_have_no_option_twice() -> None:
    for every in (list(acados_peer.list_settings(20)), list(own.list_settings()), list(list_settings("ipopt"))):
        assert len({str(x) for x in every}) == len(every)
    assert next(acados_peer.list_settings(20)) == acados_peer.Settings()
    assert next(own.list_settings()) == own.Settings()


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
    torque = OnDemand(model).casadi("impl")
    start, runner = begin(task, torque), OwnRunner(task, model)
    (cold,) = compete(task, {"mbs": choose(task, [runner], start)}, start, 2)
    ahead = shift(task, cold.answer.iterate)
    exact = solve(CasadiPeer(task, REFERENCE, torque), ahead.x[0], ahead)
    shifted = Start(ahead.x[0], ahead, exact, shifts=True)
    (warm,) = compete(task, {"mbs": choose(task, [runner], shifted)}, shifted, 2)
    assert warm.answer.iterations < cold.answer.iterations
    found = runner.control(100)
    assert len(found.feedback) == 100
    assert found.gap(task) < 1e-2
    page = write_page([Horizon(task, (cold,), (warm,), (RealTime("mbs", "some", 1, (found,)),))], 2)
    assert "| 8 | mbs | 100 |" in page


def test_derivatives_of_first_inputs_are_differences_of_solutions(tmp_path: Path) -> None:
    """By sweeps of each state, and of one function by its adjoint; inner variables are torques at their bounds."""
    model, task = write_slides(tmp_path), replace(Task(intervals=8, step=0.05), torque=np.full(JOINTS, 30.0))
    torque = OnDemand(model).casadi("impl")
    start, exact = begin(task, torque), CasadiPeer(task, REFERENCE, torque)
    runner = OwnRunner(task, model)
    answer = sensitivities.solve_from(task, runner, start.state)
    assert answer.is_solved
    slopes = runner.differentiate()
    truth = sensitivities.differentiate(task, exact, start.state)
    assert sensitivities.compare(slopes.matrix, truth) < 1e-3  # by the barrier
    assert slopes.gradient == pytest.approx(slopes.matrix.sum(axis=0), abs=1e-8 * np.abs(slopes.matrix).max())
    times = np.array([1e-3, 2e-3])
    row = sensitivities.Found("mbs", "some", 3, 2, 1e-6, times, times, times / 2, 1e-5, 2e-5)
    page = sensitivities.write_page([row, replace(row, name="other", slopes=3 * times)], task, 2)
    assert "| other | 2 of 2 | 1.0e-06 | 1 | 1.00 | 3e+03 | 3.00 | 1.0e-05 | 500 | 1.00 | 2.0e-05 |" in page
    assert len({str(x) for x in sensitivities.list_acados(20)}) == 16
