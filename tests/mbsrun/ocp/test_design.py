"""Numbers that the solver chooses with the motion, and values that a problem gives to a model's parameters."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun.external import OnDemand, load_on_demand
from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.optima.sensitivity import find_phased_sensitivities, find_sensitivities
from mbsrun.ocp.problem.design import equip
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.problem.problem import Form, Problem, Representation, Unknown
from mbsrun.ocp.showing.phase_summary import summarise_phases
from mbsrun.ocp.solution.phases import PhasedSolution, read_phased_solution, write_phased_solution
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.phases import solve_phases
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import Solver, solve
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.statement import read_problem
from tests.mbsrun.ocp.phases.motions import split

MODELS = Path(__file__).parents[3] / "models"

CART = """\
name: cart
gravity: [0, 0, 0]
parameters:
  k: {value: 1, kind: differentiated}
  m: {value: 1, kind: differentiated}
  ballast: {value: 0, kind: runtime}
bodies:
  - {name: cart, joint: {type: prismatic, axis: x, stiffness: k}, mass: m + ballast}
"""
SWING = """\
model: cart.yaml
horizon: 0.8
intervals: 16
scheme: radau
degree: 4
parameters: {ballast: 1.5, m: 2}
unknowns: {k: {guess: 10, range: [0, null]}}
cost: {inputs: 1}
start: {pose: {cart: -0.3}}
end: {pose: {cart: 0.3}, velocity: zero}
"""


@pytest.fixture
def folder(tmp_path: Path, requires: Callable[[str], str]) -> Path:
    requires("cc")
    (tmp_path / "cart.yaml").write_text(CART, "utf-8")
    return tmp_path


def read(folder: Path, text: str = SWING) -> tuple[Problem, OnDemand]:
    path = folder / "swing.ocp.yaml"
    path.write_text(text, "utf-8")
    problem, plant = read_problem(path, load_on_demand)
    assert isinstance(plant, OnDemand)
    return problem, plant


def solved(problem: Problem, plant: Plant) -> Solution:
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution), outcome
    return outcome


@pytest.mark.parametrize("representation", [Representation.IMPL, Representation.EXP1_O, Representation.EXP2_A])
@pytest.mark.parametrize("method", ["ipopt", "mbs"])
def test_a_spring_that_swings_by_itself(folder: Path, representation: Representation, method: str) -> None:
    """Half a period of the free cart is the horizon: k = m (pi / T)^2, with the mass that the file gives, costs 0."""
    problem, plant = read(folder)
    solution = solved(replace(problem.with_solver(method), representation=representation), plant)
    assert solution.trajectory.unknowns == pytest.approx([3.5 * (math.pi / 0.8) ** 2], rel=1e-4)
    assert solution.cost.total == pytest.approx(0, abs=1e-8)
    checked = resimulate(solution, plant).resimulation
    assert checked is not None
    assert checked.is_accurate


def test_forms_agree(folder: Path) -> None:
    problem, plant = read(folder, SWING.replace("cart: 0.3}", "cart: 0.2}").replace("[0, null]", "[0, 40]"))
    optima = [solved(replace(problem, form=form), plant) for form in Form]
    for other in optima[1:]:
        assert other.cost.total == pytest.approx(optima[0].cost.total, rel=1e-7)
        assert other.trajectory.unknowns == pytest.approx(optima[0].trajectory.unknowns, rel=1e-5)


def test_no_other_number_is_better() -> None:
    """At an optimum over the motion, given the design, the cost is stationary in the design: by solving again."""
    problem, plant = read_problem(MODELS / "design" / "lifting_arm.ocp.yaml", load_on_demand)
    found = solved(problem, plant)
    names = [unknown.name for unknown in problem.unknowns]
    best = dict(zip(names, found.trajectory.unknowns.tolist(), strict=True))
    price = problem.cost.terminal[0].weight

    def cost(**changes: float) -> float:
        given = best | changes
        fixed = replace(
            problem,
            unknowns=(),
            parameters=(*problem.parameters, *given.items()),
            cost=replace(problem.cost, terminal=()),
        )
        return float(solved(fixed, plant).cost.total + price * given["stiffness"] ** 2)

    assert cost() == pytest.approx(found.cost.total, rel=1e-6)
    step = 1e-2
    assert cost(stiffness=best["stiffness"] + step) > found.cost.total
    assert cost(stiffness=best["stiffness"] - step) > found.cost.total
    slope = (cost(stiffness=best["stiffness"] + step) - cost(stiffness=best["stiffness"] - step)) / (2 * step)
    assert abs(slope) <= 1e-4 * found.cost.total
    assert cost(upper=best["upper"] - step) > found.cost.total  # which is at its bound


@pytest.mark.parametrize("representation", [Representation.IMPL, Representation.EXP1_O])
def test_derivatives_by_the_design(representation: Representation) -> None:
    """Both backends agree, and with differences: sensors, dynamics and expressions read the unknowns."""
    problem, plant = read_problem(MODELS / "design" / "lifting_arm.ocp.yaml", load_on_demand)
    problem = replace(problem, intervals=2, degree=2, representation=representation)
    solver = Solver(problem, plant)
    program = Prepared(solver.transcription.program, equip(plant, problem))
    functions, other = program.casadi, program.numpy
    rng = np.random.default_rng(1)
    x, p = rng.normal(size=functions.variables), solver.transcription.parameters(problem)
    x[solver.transcription.layout.unknowns] = [0.4, 3.0, 1.2]
    J = functions.jacobian(x, p).full()
    assert other.jacobian(x, p).toarray() == pytest.approx(J, abs=1e-10)
    step = 1e-6
    for i in solver.transcription.layout.unknowns:
        e = np.eye(x.size)[i] * step
        difference = (functions.constraint(x + e, p) - functions.constraint(x - e, p)).full().ravel() / (2 * step)
        assert J[:, i] == pytest.approx(difference, abs=1e-5 * np.abs(J).max())
        assert np.abs(difference).max() > 1e-3


BAD = {
    "range": ("guess: 10", "guess: -1", "unknowns.k.guess", "-1 is out of [0, inf]", "guess within the range"),
    "crossed": ("[0, null]", "[3, 1]", "unknowns.k.range", "3 is above 1", "give [lower, upper]; null is no bound"),
    "runtime": (
        "{k: {",
        "{ballast: {guess: 1}, k: {",
        "unknowns.ballast",
        "ballast has a value in parameters, too",
        "leave one of them out",
    ),
    "no parameter": (
        "ballast: 1.5",
        "balast: 1.5",
        "parameters.balast",
        'the model has no parameter that may be changed "balast"',
        'did you mean "ballast"?',
    ),
    "a quantity": (
        "{k: {",
        "{q_cart: {",
        "unknowns.q_cart",
        "no name for an unknown",
        "give a name that nothing else has",
    ),
    "an unknown name": (
        "cost: {inputs: 1}",
        "cost: {inputs: 1, terminal: [{expression: kk}]}",
        "cost.terminal[0].expression",
        'unknown name "kk"',
        'did you mean "k"?',
    ),
}


@pytest.mark.parametrize(("old", "new", "path", "finding", "remedy"), BAD.values(), ids=BAD.keys())
def test_bad_files(folder: Path, old: str, new: str, path: str, finding: str, remedy: str) -> None:
    with pytest.raises(InputError) as caught:
        read(folder, SWING.replace(old, new))
    assert (path, finding, remedy) in [(f.path, f.finding, f.remedy) for f in caught.value.faults]


def test_a_runtime_parameter_is_no_unknown(folder: Path) -> None:
    text = SWING.replace("parameters: {ballast: 1.5, m: 2}", "").replace("{k: {", "{ballast: {guess: 1}, k: {")
    with pytest.raises(InputError, match="ballast is a run-time parameter, by which kernels have no derivatives"):
        read(folder, text)


def test_values_made_in_python_are_checked(folder: Path) -> None:
    problem, plant = read(folder)
    for part, message in (
        (replace(problem, unknowns=(Unknown("k", (0.0, 1.0), 2.0),)), "the guess of k is 2"),
        (replace(problem, parameters=(("c", 1.0),)), "cart has no parameter .c. that may be changed"),
    ):
        with pytest.raises(ProblemError, match=message):
            solve(part, plant)


def test_sensitivities_are_differences_of_optima(folder: Path) -> None:
    """The derivative of the optimal cost by a parameter, and the costs of solves at values beside it."""
    problem, plant = read(folder, SWING.replace("unknowns: {k: {guess: 10, range: [0, null]}}", ""))
    problem = replace(problem, solver=replace(problem.solver, tolerance=1e-12))
    found = dict(find_sensitivities(solved(problem, plant), plant).sensitivities)
    assert set(found) == {"k", "m"}
    for name, value in (("k", 1.0), ("m", 2.0)):
        h = 1e-3 * value
        given = dict(problem.parameters)
        above, below = (
            solved(replace(problem, parameters=tuple((given | {name: value + d}).items())), plant).cost.total
            for d in (h, -h)
        )
        assert found[name] == pytest.approx((above - below) / (2 * h), rel=1e-5)


def test_phases_share_the_parameters_of_sensitivities(folder: Path, tmp_path: Path) -> None:
    """A motion and its two halves have one optimum, and so one derivative of its cost; the file keeps it."""
    problem, plant = read(folder, SWING.replace("unknowns: {k: {guess: 10, range: [0, null]}}", ""))
    problem = replace(problem, solver=replace(problem.solver, tolerance=1e-12))
    whole = dict(find_sensitivities(solved(problem, plant), plant).sensitivities)
    halves, plants = replace(split(problem), solver=problem.solver), Plants((plant, plant))
    solution = solve_phases(halves, plants)
    assert isinstance(solution, PhasedSolution)
    found = find_phased_sensitivities(solution, plants)
    assert dict(found.sensitivities) == pytest.approx(whole, rel=1e-6)
    assert summarise_phases(found)["d cost / d m "] == f"{found.sensitivities[1][1]:.8g}"
    write_phased_solution(found, tmp_path / "solution.json")
    assert read_phased_solution(tmp_path / "solution.json").sensitivities == found.sensitivities


def test_without_differentiated_parameters_there_are_no_sensitivities(folder: Path) -> None:
    problem, plant = read(folder, SWING.replace("{k: {", "{m: {guess: 2}, k: {").replace(", m: 2", ""))
    solution = solved(problem, plant)
    assert find_sensitivities(solution, plant) is solution


SLIDE = """
name: slide
gravity: [0, 0, 0]
parameters: {m: {value: 1, kind: differentiated}}
bodies: [{name: slide, joint: {name: x, type: prismatic, axis: x}, mass: m}]
"""
PUSH = """
model: slide.yaml
horizon: 1
intervals: 6
scheme: radau
degree: 3
inputs: linear
start: {pose: {}}
end: {pose: {x: 1}, velocity: zero}
unknowns: {m: {guess: 1, range: [0.1, 10]}}
cost: {inputs: 1, terminal: [{expression: 1/m, weight: 192}]}
"""


def test_the_mass_of_a_slide_where_kernels_of_places_read_no_parameter(tmp_path: Path) -> None:
    """From rest to rest in unit time and way, a force costs at least 12 m^2; 12 m^2 + 192 / m is least at m = 2."""
    (tmp_path / "slide.yaml").write_text(SLIDE)
    (tmp_path / "push.ocp.yaml").write_text(PUSH)
    found = solve(*read_problem(tmp_path / "push.ocp.yaml", load_on_demand))
    assert isinstance(found, Solution)
    assert found.trajectory.unknowns == pytest.approx([2.0], abs=1e-6)
    assert found.cost.total == pytest.approx(144.0)
