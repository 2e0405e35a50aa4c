"""Controllers in C: optima against IPOPT's, data that change, the loop in C against the loop in Python, builds, misuse.

The model's and the problem's names are hostile on purpose: nothing of them may reach C, a shell or a path.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import mbsrun
from mbsgen.errors import InputError
from mbsrun import bare
from mbsrun.cli import cli, main
from mbsrun.controllers import making
from mbsrun.controllers.emulation import emulate
from mbsrun.controllers.folder import read
from mbsrun.controllers.loading import Controller, ControllerError, read_statuses
from mbsrun.controllers.making import Made, UnsolvedError, choose_name, hash_problem, make
from mbsrun.controllers.report import SINGLE
from mbsrun.controllers.writing import BARRIER, choose_barrier
from mbsrun.external import Mechanism, OnDemand, load, load_on_demand
from mbsrun.library import compile_library, find_compiler
from mbsrun.models import Extent
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import make_guess
from mbsrun.ocp.problem.problem import Bounds, Control, Delay, Problem, Symbolic
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import Solver
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.optimal.control import OptimalControl

Requires = Callable[[str], str]

MODEL = """\
name: 'cart * "$(touch x)'
gravity: [0, 0, -9.81]
parameters:
  mp: {value: 0.3, kind: runtime}
  mc: {value: 1.0, kind: differentiated}
bodies:
  - name: cart
    joint: {name: 'c* "', type: prismatic, axis: x, limits: [-2, 2]}
    mass: mc
  - name: pole
    parent: cart
    joint: {name: pole, type: revolute, axis: -y, actuated: false, damping: 0.01}
    mass: mp
    com: [0, 0, -0.5]
"""
PROBLEM = """\
model: cart.yaml
horizon: 1
intervals: 8
scheme: radau
degree: 2
representation: EXP1-O
constants: {rest: 0.1}
cost:
  inputs: 0.5
  running:
    - {expression: (q_pole - rest*sin(t))**2, weight: 2}
  terminal:
    - {expression: qd_pole**2, weight: 0.5}
start:
  pose: {pole: 0.4}
bounds:
  inputs: [-8, 8]
constraints:
  - {expression: q_pole + 0.1*sin(qd_pole), range: [-1, 0.6]}
end:
  pose: {pole: 0}
"""
HOSTILE = 'a "b" $(touch y); é'


@dataclass(frozen=True)
class Case:
    """A controller, and what it was made of."""

    problem: Problem
    plant: OnDemand | Mechanism
    model: Path
    guess: Trajectory
    made: Made
    folder: Path


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory, requires: Requires) -> Iterator[Case]:
    """Make the controller; compiled without optimisation, since tests take longer to compile than to run."""
    requires("cc")
    place = tmp_path_factory.mktemp("controller")
    (place / "cart.yaml").write_text(MODEL, encoding="utf-8")
    (place / f"{HOSTILE}.ocp.yaml").write_text(PROBLEM, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CFLAGS", "-O0 -Wall -Wextra -Wpedantic -Werror")
        problem, plant = read_problem(place / f"{HOSTILE}.ocp.yaml", load_on_demand)
        guess = make_guess(problem, plant, schemes.build(problem.family, problem.degree))
        assert isinstance(guess, Trajectory)
        made = make(problem, plant, place / "cart.yaml")
        folder = place / "written"
        folder.mkdir()
        for name, text in made.files.items():
            (folder / name).write_text(text, encoding="utf-8")
        yield Case(problem, plant, place / "cart.yaml", guess, made, folder)


@pytest.fixture
def controller(case: Case) -> Controller:
    """Load it afresh."""
    return mbsrun.controller(case.folder)


def solve_by_ipopt(problem: Problem, plant: OnDemand | Mechanism, guess: Trajectory) -> Solution:
    outcome = Solver(problem, plant).solve(problem, guess)
    assert isinstance(outcome, Solution)
    return outcome


# --- optima --------------------------------------------------------------------------------------------------------


def test_the_optimum_is_ipopts(case: Case, controller: Controller) -> None:
    """Cost to 1e-6, plan to 1e-4: both solve to 1e-8 of the scaled conditions."""
    expected = solve_by_ipopt(case.problem, case.plant, case.guess)
    result = controller.solve()
    assert result.is_solved
    assert result.cost == pytest.approx(expected.cost.total, rel=1e-6)
    assert case.made.manifest.cost == pytest.approx(expected.cost.total, rel=1e-6)
    plan, motion = controller.plan(), expected.trajectory
    assert plan.times == pytest.approx(motion.t)
    assert plan.states == pytest.approx(np.concatenate((motion.q, motion.qd), axis=1), abs=1e-4)
    assert plan.inputs == pytest.approx(motion.u, abs=1e-4)


def test_data_change_as_the_problem_does(case: Case, controller: Controller) -> None:
    """All at once: start, target, bounds, a range, weights, a constant, both masses. IPOPT finds the same optimum."""
    cost, end, bounds = case.problem.cost, case.problem.end, case.problem.bounds
    changed = replace(
        case.problem,
        start_q=(0.2, 0.5),
        start_qd=(0.1, -0.3),
        end=replace(end, coordinates=((1, 0.05),)),
        bounds=Bounds(((-0.4, 2.0), bounds.q[1]), ((-1.5, 1.5), bounds.qd[1]), ((-6.0, 5.0),)),
        constraints=(replace(case.problem.constraints[0], range=(-1.0, 0.55)),),
        cost=replace(
            cost,
            inputs=0.7,
            running=(replace(cost.running[0], weight=3.0),),
            terminal=(replace(cost.terminal[0], weight=0.2),),
        ),
        constants=(("rest", 0.3),),
    )
    plant = load(case.model, {"mp": 0.5, "mc": 1.4}, Extent(("impl", "frames", "exp1"), 2))
    expected = solve_by_ipopt(changed, plant, case.guess)
    values = {
        "start_q": (0.2, 0.5),
        "start_qd": (0.1, -0.3),
        "end_q": (0.05,),
        "q_lower": (-0.4, -np.inf),
        "qd_lower": (-1.5, -np.inf),
        "qd_upper": (1.5, np.inf),
        "u_lower": (-6.0,),
        "u_upper": (5.0,),
        "constraints_upper": (0.55,),
        "weights": (0.7, 3.0, 0.2),
        "constants": (0.3,),
        "parameters": (0.5,),
        "theta": (1.4,),
    }
    for name, numbers in values.items():
        controller.data[name][:] = numbers
    result = controller.solve()
    assert result.cost == pytest.approx(expected.cost.total, rel=1e-6)
    assert abs(result.cost - case.made.manifest.cost) > 0.01
    controller.reset()
    assert controller.solve().cost == pytest.approx(case.made.manifest.cost, rel=1e-6)


def test_a_bound_is_not_the_bound_of_another(case: Case) -> None:
    """Each number of the data is read somewhere, and no vector reads a number of another kind."""
    manifest = case.made.manifest
    assert [field.name for field in manifest.data] == [
        *("start_q", "start_qd", "end_q", "q_lower", "q_upper", "qd_lower", "qd_upper", "u_lower", "u_upper"),
        *("constraints_lower", "constraints_upper", "weights", "constants", "parameters", "theta", "numbers"),
    ]
    notes = {entry.note for field in manifest.data for entry in field.entries}
    assert {"(q_pole - rest*sin(t))**2", "qd_pole**2", "q_pole + 0.1*sin(qd_pole)"} <= notes


# --- in real time --------------------------------------------------------------------------------------------------

LOOP = """\
#include "{0}.h"
#include <stdio.h>
#include <stdlib.h>
int main(void)
{{
    {0}_real state[{0}_STATES] = {{0.01, 0.41, 0.02, -0.1}}, inputs[{0}_INPUTS];
    void *memory = malloc({0}_bytes());
    {0} *c = {0}_create(memory, {0}_bytes());
    int k;
    if ({0}_solve(c, NULL) != MBS_STAGES_SOLVED)
        return 1;
    for (k = 0; k < 8; ++k) {{
        {0}_get_data(c).weights[{0}_weights_inputs] = 0.5 + 0.01 * k;
        if ({0}_prepare(c, k > 0) != MBS_STAGES_PREPARED || {0}_feedback(c, state, inputs) != MBS_STAGES_STEPPED)
            return 2;
        printf("%a %a %a\\n", inputs[0], state[0], {0}_get_step(c)->stationarity);
        if ({0}_predict(c, state, inputs, {0}_get_period(c), 4, state))
            return 3;
    }}
    free(memory);
    return 0;
}}
"""


def test_the_loop_in_c_and_the_loop_in_python_agree_to_the_last_bit(
    case: Case, controller: Controller, tmp_path: Path
) -> None:
    """Eight periods with changing data: inputs, states and residuals."""
    name, compiler = case.made.manifest.prefix, find_compiler(os.environ)
    (tmp_path / "loop.c").write_text(LOOP.format(name), encoding="utf-8")
    library, program = controller.library, tmp_path / "loop"
    command = [*compiler.command, *compiler.flags, f"-I{case.folder}", str(tmp_path / "loop.c"), str(library)]
    subprocess.run([*command, f"-Wl,-rpath,{library.parent}", "-o", str(program)], check=True)
    told = subprocess.run([str(program)], capture_output=True, text=True, check=True).stdout
    state, rows = np.array([0.01, 0.41, 0.02, -0.1]), []
    assert controller.solve().status == "solved"
    for k in range(8):
        controller.data["weights"][0] = 0.5 + 0.01 * k
        assert controller.prepare(shift=k > 0).status == "prepared"
        inputs, step = controller.feedback(state)
        assert step.status == "stepped"
        rows.append([float(inputs[0]), float(state[0]), step.stationarity])
        state = controller.predict(state, inputs, controller.period, 4)
    assert [[float.fromhex(x) for x in line.split()] for line in told.splitlines()] == rows


def test_feedback_converges_to_the_solution_of_the_measured_state(controller: Controller) -> None:
    """Steps at one state without a shift are Newton's method for the barrier problem, near the optimum itself."""
    controller.solve()
    state = [0.05, 0.45, 0.0, 0.1]
    for _ in range(8):
        assert controller.prepare().status == "prepared"
        inputs, step = controller.feedback(state)
    assert step.violation < 1e-9
    assert np.array_equal(controller.data["start_q"], state[:2])
    assert controller.solve(warm=True).is_solved
    assert controller.plan().inputs[0] == pytest.approx(inputs, abs=1e-2)  # the barrier's own distance


def test_the_feedback_matrix_is_the_slope_of_the_feedback(controller: Controller) -> None:
    """A step is linear in the measured state, so differences are its slope; before and after the feedback itself."""
    controller.solve()
    with pytest.raises(ControllerError, match="there is no feedback matrix; call prepare first"):
        controller.gain()
    state = controller.plan().states[0].copy()
    controller.prepare()
    gain = controller.gain()
    assert gain.shape == (1, 4)
    controller.feedback(state)
    assert controller.gain() == pytest.approx(gain, rel=1e-12)
    for j in range(4):
        found = []
        for h in (1e-4, -1e-4):
            controller.data["start_q"][:], controller.data["start_qd"][:] = state[:2], state[2:]
            controller.solve()
            controller.prepare()
            moved = state.copy()
            moved[j] += h
            found.append(controller.feedback(moved)[0])
        assert gain[:, j] == pytest.approx((found[0] - found[1]) / 2e-4, rel=1e-5, abs=1e-6 * np.abs(gain).max())


def test_the_feedback_matrix_is_the_derivative_of_the_optimum(case: Case, controller: Controller) -> None:
    """With a small barrier parameter: by the derivatives of the solution that another method finds."""
    problem = mbsrun.read_problem(case.model.parent / f"{HOSTILE}.ocp.yaml")
    assert isinstance(problem, OptimalControl)
    coordinates = [part.name for part in case.plant.manifest.coordinates]
    names = [f"start.{key}.{name}" for key in ("pose", "velocity") for name in coordinates]
    derivatives = problem.derivatives(problem.solve(check=False), names)
    controller.options.mu_target = 1e-10
    controller.solve()
    controller.prepare()
    expected = [derivatives.by(name).trajectory.u[0, 0] for name in names]
    assert controller.gain()[0] == pytest.approx(expected, rel=1e-4, abs=1e-6)


def test_the_barrier_parameter_is_a_share_of_the_scaled_optimum(case: Case) -> None:
    """The solver minimises the cost times a scale; a cost 2000 times as large gives the same number."""
    manifest, problem, cost = case.made.manifest, case.problem, case.problem.cost
    assert manifest.barrier == pytest.approx(BARRIER * manifest.scale * abs(manifest.cost), rel=1e-5)
    header = (case.folder / f"{manifest.prefix}.h").read_text("utf-8")
    for name, value in (("SCALE", manifest.scale), ("BARRIER", manifest.barrier)):
        (found,) = re.findall(rf"^#define {manifest.prefix}_{name} (\S+)$", header, re.MULTILINE)
        assert float(found) == value
    terms = {
        name: tuple(replace(x, weight=2000 * x.weight) for x in getattr(cost, name)) for name in ("running", "terminal")
    }
    larger = replace(problem, cost=replace(cost, inputs=2000 * cost.inputs, **terms))
    assert choose_barrier(larger, 2000 * manifest.cost) == pytest.approx(manifest.barrier, rel=1e-5)


def test_steps_take_the_exported_barrier_parameter(controller: Controller) -> None:
    """Unless the options have another one; it decides how near to a bound the inputs come."""
    state = [0.05, 0.45, 0.0, 0.1]

    def find_inputs(barrier: float) -> float:
        controller.reset()
        controller.solve()
        controller.options.mu_target = barrier
        for _ in range(6):
            controller.prepare()
            inputs, _ = controller.feedback(state)
        return float(inputs[0])

    usual, same, other = map(find_inputs, (0.0, controller.manifest.barrier, 30 * controller.manifest.barrier))
    assert usual == same
    assert abs(usual - other) > 1e-6


def test_a_rescue_recovers_from_a_plan_that_has_diverged(controller: Controller) -> None:
    """The same optimum as from the guess; from a plan that has not diverged, it takes fewer iterations."""
    state = np.array([0.05, 0.45, 0.0, 0.1])
    controller.solve()
    near, warm = controller.rescue(state)
    controller.prepare()
    controller.feedback(state)
    controller.variables[:] = 1e30  # as steps leave it that go wrong
    assert controller.prepare().status == "diverged"
    inputs, step = controller.feedback(state)
    assert step.status == "not prepared"
    inputs, cold = controller.rescue(state)
    assert (warm.is_solved, cold.is_solved) == (True, True)
    assert warm.iterations < cold.iterations
    assert cold.cost == pytest.approx(warm.cost, rel=1e-6)
    assert inputs == pytest.approx(near, abs=1e-4)
    assert np.array_equal(controller.data["start_qd"], state[2:])
    assert controller.prepare().status == "prepared"
    assert controller.feedback(state)[1].status == "stepped"


def test_a_rescue_takes_the_guess_where_the_plan_leads_nowhere(controller: Controller) -> None:
    """A plan without numbers, of which no step knows yet."""
    state = [0.0, 0.4, 0.0, 0.0]
    controller.solve()
    controller.variables[:] = np.nan
    assert controller.rescue(state)[1].is_solved
    assert np.isfinite(controller.plan().inputs).all()
    kept = controller.plan().inputs[0]
    inputs, result = controller.rescue([np.nan, 0.4, 0.0, 0.0])
    assert result.status == "bad problem"
    assert np.array_equal(inputs, kept)
    controller.variables[:] = np.nan
    assert controller.rescue(state, iterations=1)[1].status == "iteration limit"


def test_the_model_moves_as_the_simulation_has_it(case: Case, controller: Controller) -> None:
    """RK4 with the controller's masses against a fine step of the same kernel's accelerations."""
    controller.data["parameters"][:] = 0.5
    plant = load(case.model, {"mp": 0.5}, Extent(("impl", "frames", "exp1"), 2))
    state, dt = np.array([0.1, 0.4, 0.2, -0.3]), 1e-3
    after = controller.predict(state, [2.0], dt, 1)
    qdd = plant("exp1", q=state[:2], qd=state[2:], u=[2.0])["qdd"]
    assert (after - state) / dt == pytest.approx(np.concatenate((state[2:], qdd)), abs=30 * dt)
    halved = controller.predict(controller.predict(state, [2.0], 0.1, 10), [2.0], 0.1, 10)
    assert controller.predict(state, [2.0], 0.2, 20) == pytest.approx(halved, abs=1e-12)


# --- misuse and failures -------------------------------------------------------------------------------------------


def test_a_state_that_is_no_number_gives_the_plans_inputs(controller: Controller) -> None:
    controller.solve()
    planned = controller.plan().inputs[0]
    controller.prepare()
    inputs, step = controller.feedback([np.nan, 0.4, 0, 0])
    assert (step.status, "a measurement is not finite" in step.message) == ("bad problem", True)
    assert np.array_equal(inputs, planned)
    assert np.isfinite(controller.data["start_q"]).all()


def test_feedback_needs_a_preparation(controller: Controller) -> None:
    inputs, step = controller.feedback(np.zeros(4))
    assert step.status == "not prepared"
    assert np.isfinite(inputs).all()


def test_limits_hold(controller: Controller) -> None:
    result = controller.solve(iterations=2)
    assert (result.status, result.iterations) == ("iteration limit", 2)
    controller.reset()
    assert controller.solve(seconds=1e-9).status == "time limit"


def test_data_without_meaning_have_a_status(controller: Controller) -> None:
    controller.data["u_lower"][:] = 9.0  # above the upper one
    assert controller.solve().status == "bad problem"
    controller.reset()
    controller.data["constants"][:] = np.nan
    assert controller.solve().status == "callback failed"
    assert controller.prepare().status in ("callback failed", "bad problem")
    controller.reset()
    assert controller.solve().is_solved


def test_controllers_in_threads_share_nothing(case: Case) -> None:
    """Four at once give the bits of one alone."""
    alone = mbsrun.controller(case.folder)
    expected = alone.solve()
    several = [mbsrun.controller(case.folder) for _ in range(4)]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda c: c.solve(), several))
    assert found == [expected] * 4
    assert all(np.array_equal(c.plan().states, alone.plan().states) for c in several)


def test_a_batch_is_solves_one_by_one(case: Case, controller: Controller) -> None:
    """To the last bit, in any number of threads; the controller stays as it is."""
    controller.data["weights"][:] = 0.7, 3.0, 0.2
    controller.solve()
    before, plan = controller.variables.copy(), controller.plan()
    starts = np.array([[0.1 * k, 0.3 - 0.1 * k, 0.0, 0.1] for k in range(5)])
    uppers = np.array([[5.0 + k] for k in range(5)])
    found = controller.solve_batch(starts, data={"u_upper": uppers})
    again = controller.solve_batch(starts, data={"u_upper": uppers}, threads=3)
    assert np.array_equal(controller.variables, before)
    assert np.array_equal(controller.plan().states, plan.states)
    assert controller.data["start_q"].tolist() == [0, 0.4]
    assert found.is_solved.all()
    for name in ("cost", "iterations", "inputs", "plan_states", "plan_inputs"):
        assert np.array_equal(getattr(found, name), getattr(again, name))
    other = mbsrun.controller(case.folder)
    for k, start in enumerate(starts):
        other.reset()
        other.data["weights"][:] = 0.7, 3.0, 0.2
        other.data["u_upper"][:] = uppers[k]
        other.data["start_q"][:], other.data["start_qd"][:] = start[:2], start[2:]
        other.variables[:] = before
        result = other.solve()
        assert (found.statuses[k], found.iterations[k]) == (result.status, result.iterations)
        assert found.cost[k] == result.cost
        assert np.array_equal(found.plan_states[k], other.plan().states)
        assert np.array_equal(found.plan_inputs[k], other.plan().inputs)
        assert np.array_equal(found.inputs[k], other.plan().inputs[0])


def test_a_problem_of_a_batch_may_fail(controller: Controller) -> None:
    good = [0.1, 0.3, 0, 0]
    found = controller.solve_batch([good, [np.nan, 0, 0, 0], good], iterations=200)
    assert found.statuses[1] == "bad problem"
    assert found.is_solved.tolist() == [True, False, True]
    assert found.cost[0] == found.cost[2]
    few = controller.solve_batch([good], iterations=1)
    assert few.statuses == ("iteration limit",)


def test_data_outlive_their_controller(case: Case) -> None:
    data = mbsrun.controller(case.folder).data["start_q"]
    assert data == pytest.approx([0, 0.4])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda c: c.feedback([1, 2]), r"state has shape \(2,\); give 4 numbers"),
        (lambda c: c.feedback("up"), "is no vector of numbers"),
        (lambda c: c.predict(np.zeros(4), [1.0], -1.0), "give a time"),
        (lambda c: c.predict(np.zeros(4), [np.inf], 1.0), "no acceleration on the way"),
        (lambda c: c.solve(iterations=0), "iterations = 0 is no limit"),
        (lambda c: c.solve_batch(), "give states, or rows of data"),
        (lambda c: c.solve_batch(np.zeros(4)), r"states has shape \(4,\); give rows of 4 numbers"),
        (lambda c: c.solve_batch(np.zeros((2, 3))), r"states has shape \(2, 3\); give rows of 4 numbers"),
        (lambda c: c.solve_batch("up"), "states: no array of numbers; give rows of 4"),
        (lambda c: c.solve_batch(data={"mass": [[1]]}), "data: there is no 'mass'; there are start_q"),
        (lambda c: c.solve_batch(np.zeros((2, 4)), data={"weights": np.ones((1, 3))}), "weights 1, states 2"),
        (lambda c: c.solve_batch(np.zeros((2, 4)), threads=0), "threads = 0: give at least one"),
    ],
)
def test_misuse_is_told(controller: Controller, call: Callable[[Controller], object], message: str) -> None:
    with pytest.raises(ControllerError, match=message):
        call(controller)


def test_a_folder_without_a_controller_is_told(tmp_path: Path, case: Case) -> None:
    with pytest.raises(InputError, match="there is no such file; write the folder"):
        mbsrun.controller(tmp_path)
    text = (case.folder / "manifest.json").read_text(encoding="utf-8")
    (tmp_path / "manifest.json").write_text(text.replace('"intervals": 8', '"intervals": 0'), encoding="utf-8")
    with pytest.raises(InputError, match="intervals: Input should be greater than or equal to 1"):
        mbsrun.controller(tmp_path)


REFUSED: Mapping[str, tuple[Callable[[Problem], Problem], str]] = {
    "mesh": (
        lambda problem: replace(problem, intervals=2, mesh=(0.25, 0.75)),
        "intervals: a controller moves its plan ahead by equal intervals",
    ),
    "inputs": (lambda problem: replace(problem, inputs="polynomial"), "inputs: a controller holds its inputs"),
    "states": (
        lambda problem: replace(problem, controls=(Control("brake", rates=(-1.0, 1.0)),)),
        "controls.rate: a controller remembers the inputs that it gave to joints alone",
    ),
    "delays": (
        lambda problem: replace(problem, delays=(Delay("input", 0, 0.125, None),)),
        "inputs.history: a controller remembers the inputs that it gave, and these are free",
    ),
    "rates": (
        lambda problem: replace(
            problem, bounds=replace(problem.bounds, rates=((-1.0, 1.0),)), horizon_range=(0.5, 2.0)
        ),
        "bounds.input_rates: a controller remembers the inputs that it gave a period before",
    ),
    "functions": (
        lambda problem: replace(problem, functions=(Symbolic("drag", (), "drag"),)),
        "functions: a controller is C, and the problem has expressions of CasADi",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_problem_that_a_controller_cannot_solve_is_refused(case: Case, name: str) -> None:
    change, message = REFUSED[name]
    with pytest.raises(ProblemError, match=message):
        make(change(case.problem), case.plant, case.model)


@pytest.mark.parametrize(("section", "key"), [("phases: [{name: a}]", "phases"), ("links: [{from: a}]", "links")])
def test_a_problem_of_phases_is_refused_with_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], section: str, key: str
) -> None:
    (tmp_path / "parts.ocp.yaml").write_text(f"model: cart.yaml\n{section}\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["mbsrun", "controller", "parts.ocp.yaml", "-o", "none"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert f"parts.ocp.yaml:2: {key}: a problem with {key}; only `mbsrun solve`" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_a_problem_that_is_not_solved_gives_no_controller(case: Case) -> None:
    """Bounds that leave no way."""
    bounds = replace(case.problem.bounds, u=((-0.01, 0.01),))
    with pytest.raises(UnsolvedError, match=r"the controller does not solve its own problem in .* no motion near"):
        make(replace(case.problem, bounds=bounds), case.plant, case.model)


def test_the_command_writes_a_folder_and_replaces_only_its_own(
    case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit codes: 0 where it is written, 1 where the problem is not solved, 2 for a folder of somebody else."""
    monkeypatch.setattr(making, "measure_single", lambda *_: 0)
    monkeypatch.setattr(making, "measure_stacks", lambda *_: {})
    shutil.copy(case.model, tmp_path)
    file, out = tmp_path / f"{HOSTILE}.ocp.yaml", tmp_path / "out"

    def call(text: str) -> tuple[object, str]:
        file.write_text(text, encoding="utf-8")
        monkeypatch.setattr(sys, "argv", ["mbsrun", "controller", str(file), "-o", str(out)])
        with pytest.raises(SystemExit) as end:
            main()
        return end.value.code, "".join(capsys.readouterr())

    code, told = call(PROBLEM)
    assert (code, "its problem in" in told) == (0, True)
    assert mbsrun.controller(out).solve().is_solved
    code, told = call(PROBLEM.replace("[-8, 8]", "[-0.01, 0.01]"))
    assert (code, "does not solve its own problem" in told) == (1, True)
    assert (out / f"{case.made.manifest.prefix}.h").exists()
    (out / "notes.txt").write_text("mine", encoding="utf-8")
    code, told = call(PROBLEM)
    assert (code, "it holds notes.txt, which mbsgen did not write" in told) == (2, True)
    assert "unknown: it needs call graphs" in (out / "report.md").read_text(encoding="utf-8")


# --- the folder ----------------------------------------------------------------------------------------------------


def test_the_same_problem_gives_the_same_bytes(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    """Measurements apart, which the compiler makes."""
    known = read(case.folder).memory
    prefix, rows = case.made.manifest.prefix, case.made.files["report.md"].splitlines()
    stacks = {
        row.split("`")[1].removeprefix(f"{prefix}_"): int(row.split("|")[2]) for row in rows if row.startswith("| `")
    }
    monkeypatch.setattr(making, "measure_single", lambda *_: known.single)
    monkeypatch.setattr(making, "measure_stacks", lambda *_: stacks)
    assert make(case.problem, case.plant, case.model).files == case.made.files


def test_names_of_files_and_symbols_are_mangled(case: Case) -> None:
    name = case.made.manifest.prefix
    assert all(part.isalnum() and part.isascii() for part in name.split("_"))
    assert set(os.listdir(case.folder)) == set(case.made.files) == set(case.made.manifest.files)
    assert not any(
        HOSTILE in text or "touch" in text for file, text in case.made.files.items() if file != "manifest.json"
    )
    assert choose_name("cart", "cart") == "cart_controller"


def test_nothing_is_allocated_and_only_libm_is_called(controller: Controller, requires: Requires) -> None:
    told = subprocess.run([requires("nm"), "-Du", str(controller.library)], capture_output=True, text=True, check=True)
    symbols = {line.split()[-1].partition("@")[0] for line in told.stdout.splitlines()}
    weak = {"__cxa_finalize", "__gmon_start__", "_ITM_deregisterTMCloneTable", "_ITM_registerTMCloneTable"}
    assert symbols - weak <= {"memcpy", "memmove", "memset", "sin", "cos", "sqrt", "fabs", "pow", "exp", "log", "log10"}


def test_statuses_are_words_of_the_header(case: Case) -> None:
    words = read_statuses(case.folder)
    assert (words[:3], words[4], words[-1]) == (("solved", "acceptable", "infeasible"), "time limit", "diverged")


def test_cmake_builds_checks_and_installs_it(case: Case, tmp_path: Path, requires: Requires) -> None:
    """The check and the example run; another project finds the installed library, as pkg-config does."""
    name, cmake = case.made.manifest.prefix, requires("cmake")
    build(cmake, case.folder, tmp_path / "build", "-DCMAKE_BUILD_TYPE=Debug")
    run("ctest", "--test-dir", tmp_path / "build")
    told = run(tmp_path / "build" / f"{name}_main")
    assert "period 40" in told
    run(cmake, "--install", tmp_path / "build", "--prefix", tmp_path / "first")
    place = (tmp_path / "first").rename(tmp_path / "moved")
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.14)\nproject(user C)\n"
        f"find_package({name} REQUIRED)\nadd_executable(user user.c)\n"
        f"target_link_libraries(user PRIVATE {name}::{name})\n",
        encoding="utf-8",
    )
    (tmp_path / "user.c").write_text(f"#include <{name}.h>\nint main(void) {{ return !{name}_bytes(); }}\n")
    build(cmake, tmp_path, tmp_path / "user", f"-DCMAKE_PREFIX_PATH={place}")
    run(tmp_path / "user" / "user")
    query = ("env", f"PKG_CONFIG_PATH={place / 'lib' / 'pkgconfig'}", requires("pkg-config"), name)
    flags = run(*query, "--cflags", "--libs").split()
    run(requires("gcc"), "-std=c99", tmp_path / "user.c", *flags, "-o", tmp_path / "again")
    run(tmp_path / "again")


@pytest.mark.parametrize("sanitizer", ["thread", "address,undefined"])
def test_threads_change_no_digit(case: Case, tmp_path: Path, requires: Requires, sanitizer: str) -> None:
    """A solve, and eight periods in real time, by 1 and by 3 workers in memory of exactly the bytes asked for."""
    manifest, found = case.made.manifest, []
    text = LOOP.format(manifest.prefix)
    ending = f"    {manifest.prefix}_end(c);\n    free(memory);"
    assert text.count("    free(memory);") == 1
    (tmp_path / "loop.c").write_text(text.replace("    free(memory);", ending), encoding="utf-8")
    sources = [tmp_path / "loop.c", *(case.folder / source for source in manifest.sources)]
    for more in ([], ["-DMBS_STAGES_WORKERS=3", "-pthread"]):
        flags = ["-std=c99", "-O0", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-fsanitize={sanitizer}"]
        run(requires("gcc"), *flags, f"-I{case.folder}", *more, *sources, "-lm", "-o", tmp_path / "loop")
        found.append(run(tmp_path / "loop"))
    assert found[0] == found[1]
    assert len(found[0].splitlines()) == 8


def test_cmake_builds_threads(case: Case, tmp_path: Path, requires: Requires) -> None:
    """The check and the example end, too; the example prints what it does without threads."""
    name, cmake = case.made.manifest.prefix, requires("cmake")
    said = []
    for workers in (1, 2):
        place = tmp_path / str(workers)
        build(cmake, case.folder, place, "-DCMAKE_BUILD_TYPE=Debug", f"-DMBS_STAGES_WORKERS={workers}")
        run("ctest", "--test-dir", place)
        said.append([line for line in run(place / f"{name}_main").splitlines() if "bytes" not in line])
    assert said[0] == said[1]


def test_a_problem_with_threads_has_the_same_controller(case: Case) -> None:
    problem = replace(case.problem, solver=replace(case.problem.solver, threads=2))
    assert hash_problem(problem) == case.made.manifest.problem_hash


def test_a_limit_of_time_holds_with_threads(case: Case, tmp_path: Path, requires: Requires) -> None:
    """The clock is read in the caller's thread."""
    name = case.made.manifest.prefix
    (tmp_path / "late.c").write_text(LATE.format(name), encoding="utf-8")
    sources = [case.folder / source for source in case.made.manifest.sources]
    flags = ["-std=c99", "-O0", "-DMBS_STAGES_WORKERS=2", "-pthread", f"-I{case.folder}"]
    run(requires("gcc"), *flags, tmp_path / "late.c", *sources, "-lm", "-o", tmp_path / "late")
    assert run(tmp_path / "late") == "4 iterations, time limit\n"


LATE = """
#include "{0}.h"
#include <stdio.h>
#include <stdlib.h>
static double tick(void *context)
{{
    return ++*(double *)context;
}}
int main(void)
{{
    void *memory = malloc({0}_bytes());
    {0} *c = {0}_create(memory, {0}_bytes());
    {0}_limits limits = {{0}};
    double time = 0;
    int status;
    limits.seconds = 5;
    limits.clock = tick;
    limits.context = &time;
    status = {0}_solve(c, &limits);
    printf("%d iterations, %s\\n", {0}_get_result(c)->iterations, status == MBS_STAGES_TIME_LIMIT ? "time limit" : "?");
    {0}_end(c);
    free(memory);
    return 0;
}}
"""


def test_single_precision_agrees_with_the_check(case: Case, tmp_path: Path) -> None:
    """The library that was compiled to count its bytes."""
    manifest, compiler = case.made.manifest, find_compiler(os.environ)
    single = replace(compiler, flags=(*compiler.flags, *SINGLE))
    library = compile_library(case.folder, manifest.prefix, manifest.sources, single)
    command = [*single.command, *single.flags, str(case.folder / f"{manifest.prefix}_check.c"), str(library)]
    run(*command, f"-Wl,-rpath,{library.parent}", "-o", tmp_path / "check")
    assert run(tmp_path / "check").strip().endswith("agrees")


def test_single_precision_under_sanitizers(case: Case, tmp_path: Path, requires: Requires) -> None:
    """A solve and eight periods, in memory of exactly the bytes that the controller asks for."""
    manifest, program = case.made.manifest, tmp_path / "loop"
    (tmp_path / "loop.c").write_text(LOOP.format(manifest.prefix), encoding="utf-8")
    flags = ["-std=c99", "-O0", *SINGLE, "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    sources = [case.folder / source for source in manifest.sources]
    run(requires("gcc"), *flags, f"-I{case.folder}", tmp_path / "loop.c", *sources, "-lm", "-o", program)
    assert len(run(program).splitlines()) == 8


def test_it_runs_on_a_bare_machine(
    case: Case, controller: Controller, requires: Requires, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Solved in single precision on a Cortex-M7, and stepped, with the inputs of the loop in double precision.

    The software of the compiler computes in double precision for the clock alone. The stack is below the host's.
    """
    for tool in bare.PACKAGES:
        requires(tool)
    manifest = case.made.manifest
    found = emulate(case.folder, manifest, manifest.memory.single)
    assert (found.status, set(found.steps), len(found.steps)) == ("solved", {"stepped"}, 10)
    assert found.cost == pytest.approx(manifest.cost, rel=1e-3)
    assert controller.solve().is_solved
    state, inputs = controller.plan().states[0], []
    for k in range(10):
        controller.prepare(shift=k > 0)
        inputs.append(controller.feedback(state)[0])
        state = controller.predict(state, inputs[-1], controller.period)
    assert np.array(found.inputs) == pytest.approx(np.array(inputs), abs=0.02)
    assert 0 < found.feedback.usual <= found.feedback.most < found.prepare.usual <= found.prepare.most < found.solve
    clock = {"__aeabi_dsub", "__aeabi_dcmpge", "__aeabi_dcmpgt"}
    assert set(found.needs) - clock <= {"memcpy", "memmove", "memset", "sinf", "cosf", "powf", "logf", "log10f"}
    assert found.workspace <= manifest.memory.single
    rows = [row for row in case.made.files["report.md"].splitlines() if row.startswith("| `")]
    assert found.stack <= max(int(row.split("|")[2]) for row in rows)
    monkeypatch.setattr(making, "measure_single", lambda *_: manifest.memory.single)
    monkeypatch.setattr(making, "measure_stacks", lambda *_: {})
    monkeypatch.setattr(making, "emulate", lambda *_: found)
    report = make(case.problem, case.plant, case.model, emulated=True).files["report.md"]
    assert f"| instructions of the solve | {found.solve} |" in report


def test_missing_tools_of_the_emulation_are_named_before_any_work(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    file = case.model.parent / f"{HOSTILE}.ocp.yaml"
    run = CliRunner().invoke(cli, ["controller", str(file), "--emulate", "-o", str(case.model.parent / "none")])
    assert isinstance(run.exception, bare.BareError)
    assert "arm-none-eabi-gcc is not on the PATH; install gcc-arm-none-eabi" in str(run.exception)
    assert not (case.model.parent / "none").exists()


def build(cmake: str, source: Path, target: Path, *options: str) -> None:
    run(cmake, "-S", source, "-B", target, *options)
    run(cmake, "--build", target)


def run(*command: str | Path) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
