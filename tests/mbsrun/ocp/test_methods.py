"""The solvers that a problem may choose: they agree, take the options that are listed, and no others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun.external import OnDemand
from mbsrun.ocp import methods
from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.evaluation.stages.interface import load
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.status import SOLVED
from mbsrun.ocp.guessing.guess import interpolate
from mbsrun.ocp.methods import METHODS, Amount, Answer, Assignment, Instance
from mbsrun.ocp.methods.nlpsol import count_iterations
from mbsrun.ocp.problem.problem import Problem, SolverOptions, cylindrical
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.runs import Progress, call
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.ocp.transcription.transcription import transcribe
from tests.mbsrun.ocp.conftest import MODELS
from tests.mbsrun.ocp.plants import push
from tests.mbsrun.peer import Peer, double_integrator

MASS = """
name: mass
gravity: [0, 0, 0]
bodies:
  - {name: slide, joint: {type: prismatic, axis: x}, mass: 1}
"""


@pytest.fixture(scope="module")
def mass(tmp_path_factory: pytest.TempPathFactory) -> OnDemand:
    """The double integrator with kernels in C."""
    path = tmp_path_factory.mktemp("models") / "mass.yaml"
    path.write_text(MASS, encoding="utf-8")
    return OnDemand(path)


def choose(method: str, mass: OnDemand) -> Plant:
    """Choose a plant that a method can use: the project's own one calls C alone."""
    return mass if method == "mbs" else double_integrator()


@pytest.mark.parametrize("method", METHODS)
def test_every_solver_finds_the_optimum(method: str, mass: OnDemand) -> None:
    """12 / (1 - 1/N^2), as above; the watch receives the true cost, with any scale of the solver."""
    seen: list[Progress] = []
    options = SolverOptions(method=method, objective_scaling=0.01)
    outcome = solve(replace(push(8), solver=options), choose(method, mass), seen.append)
    assert isinstance(outcome, Solution)
    assert outcome.cost.total == pytest.approx(12 / (1 - 1 / 64), rel=1e-6)
    assert all(p.cost == pytest.approx(outcome.cost.total, rel=1e-3) for p in seen[-1:])


CHOSEN = {
    "kernels in C": (True, (), "mbs"),
    "kernels in Python": (False, (), "ipopt"),
    "an option that IPOPT alone has": (True, (("mu_strategy", "adaptive"),), "ipopt"),
    "an option of the project's own": (True, (("mu_init", 0.01),), "mbs"),
}


@pytest.mark.parametrize(("in_c", "options", "method"), CHOSEN.values(), ids=CHOSEN.keys())
def test_a_method_is_chosen_where_none_is_given(
    in_c: bool, options: tuple[tuple[str, float | str], ...], method: str, mass: OnDemand
) -> None:
    """The run names it; the problem stays as it was asked."""
    problem = replace(push(8), solver=SolverOptions(options=options))
    outcome = solve(problem, mass if in_c else double_integrator())
    assert isinstance(outcome, Solution)
    assert outcome.run.method == method
    assert outcome.problem == problem
    assert outcome.cost.total == pytest.approx(12 / (1 - 1 / 64), rel=1e-6)


def test_expressions_of_casadi_need_ipopt() -> None:
    assert methods.choose(SolverOptions(), calls_casadi=True) == "ipopt"
    assert methods.choose(SolverOptions(method="mbs"), calls_casadi=True) == "mbs"  # which is then refused
    assert dict(methods.warm(SolverOptions(options=(("bound_push", 0.1),))).options) == {
        "mu_init": 1e-5,
        "bound_push": 0.1,
    }


def test_each_field_of_the_options_in_c_can_be_given() -> None:
    """All but the fields of keys of a problem, of starts that a solve sets, and of steps in real time.

    Lanes are no field: they are how functions are called.
    """
    fields = {name for name, _ in load()[0].typeof("mbs_stages_options").fields}
    others = {"tol", "max_iter", "warm_start_init_point", "follow", "most_violation"}
    assert fields - set(METHODS["mbs"].options) == others
    assert set(METHODS["mbs"].options) - {"lanes"} <= fields


def test_what_later_solves_share_is_no_time_of_a_search() -> None:
    """Such as the tables of stages. An answer that names no time in functions took none there."""
    answer = Answer(np.zeros(1), SOLVED, 3, preparing=1000.0, cpu_preparing=500.0)
    run = call(lambda _: answer, Instance(np.zeros(1), *[np.zeros(0)] * 5)).run
    assert -1000.0 <= run.seconds < -900.0
    assert -500.0 <= run.cpu_seconds < -400.0
    assert (run.seconds_evaluating, run.cpu_seconds_evaluating) == (0.0, 0.0)


def test_solvers_agree_on_an_arm(arm: Peer, reach: Problem) -> None:
    """IPOPT and the SQP method, each with the program's own derivatives."""
    near = replace(reach.with_target("hand", cylindrical(0.65, 0.1, 0.0)), intervals=6, degree=3)
    costs = []
    for method in ("ipopt", "sqpmethod"):
        outcome = solve(replace(near, solver=SolverOptions(method=method)), arm)
        assert isinstance(outcome, Solution)
        costs.append(outcome.cost.total)
    assert costs[1] == pytest.approx(costs[0], rel=1e-6)


@pytest.mark.parametrize(("method", "name"), [(m, name) for m, method in METHODS.items() for name in method.options])
def test_every_option_is_one_of_the_solver(method: str, name: str, mass: OnDemand) -> None:
    """CasADi and IPOPT refuse what they do not know, and values that they do not take."""
    option = METHODS[method].options[name]
    least = option.least if isinstance(option, Amount) else 0.0
    value = option.words[-1] if not isinstance(option, Amount) else int(max(least, 1)) if option.whole else least + 0.25
    assert option.admits(value)
    plant = choose(method, mass)
    transcription = transcribe(push(4), plant)
    order = Assignment(Prepared(transcription.program, plant), 1e-8, 100, 1.0, {name: value}, 1)
    guess = interpolate(push(4), transcription.scheme, np.array([1.0]))
    lower, upper = transcription.variable_bounds(push(4))
    g_lower, g_upper = transcription.constraint_bounds(push(4))
    solver = METHODS[method].make(order)
    p = transcription.parameters(push(4))
    answer = solver(Instance(transcription.pack(guess), p, lower, upper, g_lower, g_upper))
    assert "Invalid_Option" not in answer.status


@pytest.mark.parametrize("name", ["output_file", "option_file_name", "hsllib", "print_level", "tol"])
def test_options_that_touch_files_or_libraries_are_none(name: str) -> None:
    assert all(name not in method.options for method in METHODS.values())


SOLVER_OPTIONS = {
    "a word": ("mu_strategy: adaptive", (("mu_strategy", "adaptive"),)),
    "a number": ("mu_init: 0.01", (("mu_init", 0.01),)),
    "a number that YAML takes for text": ("mu_init: 1e-3", (("mu_init", 1e-3),)),
    "a whole number": ("mumps_pivot_order: 5", (("mumps_pivot_order", 5),)),
    "what YAML takes for a switch": ("recalc_y: yes", (("recalc_y", "yes"),)),
}


@pytest.mark.parametrize(("text", "expected"), SOLVER_OPTIONS.values(), ids=SOLVER_OPTIONS.keys())
def test_options_of_the_solver(arm: Peer, tmp_path: Path, text: str, expected: tuple[tuple[str, float | str]]) -> None:
    file = tmp_path / "task.ocp.yaml"
    file.write_text((MODELS / "arm_reach.ocp.yaml").read_text("utf-8") + f"solver: {{options: {{{text}}}}}\n", "utf-8")
    assert read_problem(file, lambda _: arm)[0].solver.options == expected


WRONG_OPTIONS = {
    "unknown": ("options: {mu_strateg: adaptive}", 'did you mean "mu_strategy"?'),
    "a file to write": ("options: {output_file: /tmp/x}", "mbs takes no option"),
    "a library to load": ("options: {hsllib: evil.so, mu_strategy: adaptive}", "ipopt takes no option"),
    "another solver's": ("method: sqpmethod, options: {mu_init: 1}", "sqpmethod takes no option"),
    "a word that is none": ("options: {mu_strategy: 3}", "one of monotone, adaptive"),
    "a number out of range": ("options: {mumps_pivtol: 2}", "a number from 0 to 1"),
    "a number that is not whole": ("options: {acceptable_iter: 1.5}", "a whole number from 0"),
    "an expression that is none": ("options: {mu_init: 1+}", "solver.options.mu_init"),
    "an unknown solver": ("method: magic", "solver.method"),
}


@pytest.mark.parametrize(("text", "message"), WRONG_OPTIONS.values(), ids=WRONG_OPTIONS.keys())
def test_options_that_the_solver_must_not_be_told(arm: Peer, tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "task.ocp.yaml"
    file.write_text((MODELS / "arm_reach.ocp.yaml").read_text("utf-8") + f"solver: {{{text}}}\n", "utf-8")
    with pytest.raises(InputError) as refusal:
        read_problem(file, lambda _: arm)
    assert message in str(refusal.value)


@pytest.mark.parametrize(("told", "seen", "iterations"), [(7, 8, 7), (1701978173, 0, 0), (-1, 0, 0), (0, 1, 0)])
def test_iterations_of_a_program_that_is_refused_at_once_are_none(told: int, seen: int, iterations: int) -> None:
    """IPOPT does not set its count where there are more equations than variables."""
    assert count_iterations({"iter_count": told}, seen) == iterations
