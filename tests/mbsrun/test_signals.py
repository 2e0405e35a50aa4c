"""Forces that read the time and signals: closed forms of forced motions, and of their optima."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
from scipy.optimize import minimize_scalar

from mbsgen.errors import InputError
from mbsrun import Mechanism, load
from mbsrun.controllers.making import make
from mbsrun.kernel import ArgumentError
from mbsrun.linearisation.equations import check_kernels
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.simulation.simulate import simulate
from mbsrun.simulation.statement import read_statement

SLED = """
name: sled
gravity: [0, 0, 0]
bodies:
  - {name: sled, joint: {name: x, type: prismatic, axis: x, actuated: false, force: t}, mass: 2}
frames: [{name: nose, body: sled}]
wrenches: [{name: wind, body: sled, force: [2*wind*t, 0, 0]}]
forces: [{name: rope, from: {body: sled}, to: {body: base, position: [9, 0, 0]}, force: pull}]
signals: [pull, wind]
"""
# (2 x'' = t + 2 wind t + pull; w = (pull, wind, t))


@cache
def sled(folder: Path) -> Mechanism:
    file = folder / "sled.yaml"
    file.write_text(SLED)
    return load(file)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("signals")


def test_kernels_read_signals_and_then_the_time(folder: Path) -> None:
    """2 x'' = t + 2 wind t + pull, and its derivatives."""
    kernels = sled(folder)
    assert kernels.manifest.inputs == ("pull", "wind", "t")
    state = {"q": [0.3], "qd": [0.2], "qdd": [1.5], "u": [], "w": [0.7, 0.4, 5.0]}
    assert kernels("impl", **state)["Phi"] == pytest.approx(2 * 1.5 - 5 - 2 * 0.4 * 5 - 0.7, rel=1e-14)
    slopes = kernels("jac_impl", **state)["jac_Phi_w"]
    assert slopes.ravel() == pytest.approx([-1, -2 * 5, -1 - 2 * 0.4], rel=1e-14)


@pytest.mark.parametrize("method", ["dop853", "rk4", "gauss", "variational"])
def test_a_forced_motion_follows_its_closed_form(method: str, folder: Path) -> None:
    """With wind = 0.5 and pull = 6 t^2, 2 x'' = 2 t + 6 t^2: x = t^3/6 + t^4/4; held inputs do not hold the time."""
    kernels = sled(folder)
    options = {"duration": 1, "method": method, "output_step": 0.5} | ({} if method == "dop853" else {"step": 1e-3})
    given = read_statement(None, {**options, "signals": {"pull": "6*t**2", "wind": 0.5}}, kernels.manifest)
    motion = simulate(kernels, given.drive, given.start.q, given.start.qd, given.settings)
    assert motion.q[:, 0] == pytest.approx([0, 0.5**3 / 6 + 0.5**4 / 4, 1 / 6 + 1 / 4], abs=1e-6)
    assert motion.energy is not None
    assert motion.energy.is_kept
    held = read_statement(None, {**options, "signals": {"pull": 2}, "input_period": 0.5}, kernels.manifest)
    motion = simulate(kernels, held.drive, held.start.q, held.start.qd, held.settings)
    assert motion.q[-1, 0] == pytest.approx(1 / 12 + 1 / 2, abs=1e-6)


PROBLEM = """
model: sled.yaml
horizon: {guess: 1, range: [0.2, 4]}
intervals: 6
scheme: radau
degree: 4
inputs: polynomial
controls: {pull: {range: [-1000, 1000]}}
signals: {wind: 0}
cost: {running: [{expression: pull**2}], terminal: [{expression: T}]}
start: {pose: {}}
end: {pose: {x: 1}, velocity: zero}
"""


@pytest.mark.parametrize("method", ["ipopt", "mbs"])
def test_the_best_pull_has_its_closed_form(method: str, folder: Path) -> None:
    """Least integral of (2 x'' - t)^2 plus T, from 0 to 1, at rest: the pull is linear in t, for each T."""
    kernels = sled(folder)
    file = folder / "pull.ocp.yaml"
    file.write_text(PROBLEM + f"solver: {{method: {method}}}\n")
    problem, _ = read_problem(file, lambda _: kernels)
    outcome = solve(problem, kernels)
    assert isinstance(outcome, Solution)
    found = resimulate(outcome, kernels)
    assert found.resimulation is not None
    assert found.resimulation.is_accurate

    def price(T: float) -> float:
        a, c = 12 / T**2, -24 / T**3 - 1  # pull = a + c t
        return a * a * T + a * c * T**2 + c * c * T**3 / 3 + T

    best = minimize_scalar(price, bounds=(0.2, 4), method="bounded", options={"xatol": 1e-10})
    assert found.cost.total == pytest.approx(best.fun, rel=1e-7)
    assert found.trajectory.t[-1] == pytest.approx(best.x, rel=1e-4)


BAD = {
    "no value": ("signals: {wind: 0}\n", "", "signal_wind has no value"),
    "an unknown signal": ("wind: 0}", "wind: 0, gust: 1}", '"gust"'),
    "the time": ("wind: 0}", "wind: 0, t: 1}", '"t"'),
    "another form": ("inputs: polynomial", "form: integral", "the integral form takes no"),
}


@pytest.mark.parametrize(("old", "new", "finding"), BAD.values(), ids=BAD.keys())
def test_a_bad_problem_is_refused(old: str, new: str, finding: str, folder: Path) -> None:
    file = folder / "bad.ocp.yaml"
    file.write_text(PROBLEM.replace(old, new))
    with pytest.raises(InputError) as caught:
        read_problem(file, lambda _: sled(folder))
    assert finding in str(caught.value)


def test_uses_that_do_not_know_the_time_refuse_it(folder: Path) -> None:
    kernels = sled(folder)
    with pytest.raises(ArgumentError, match="depend on the time t"):
        check_kernels(kernels)
    file = folder / "control.ocp.yaml"
    file.write_text(PROBLEM.replace("inputs: polynomial\n", "").replace("{guess: 1, range: [0.2, 4]}", "1"))
    problem, _ = read_problem(file, lambda _: kernels)
    with pytest.raises(ProblemError, match="forces of the model read pull, wind, t"):
        make(problem, kernels, folder / "sled.yaml")
