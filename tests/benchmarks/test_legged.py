"""Problems in phases beside plain CasADi: the equations are the same, and so are the optima, one of them published."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from benchmarks.legged import biped, carrier, quadruped, walker
from benchmarks.legged.cases import CASES, FOLDER
from benchmarks.legged.chains import Mechanism
from benchmarks.legged.collocation import Answer
from benchmarks.legged.measuring import SOLVED, choose_setting, measure_balance
from mbsgen.formulations import impl
from mbsgen.pipeline import read_tree
from mbsgen.tape.interpreter import evaluate
from mbsrun.external import load_on_demand
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solving.phases import solve_phases
from mbsrun.ocp.statement.phases import read_phased_problem
from tests.random_trees import values_of

MECHANISMS: dict[str, Callable[[], Mechanism]] = {
    "walker": walker.describe_stance,
    "walker_free": walker.describe_free,
    "biped": biped.describe_biped,
    "bounder": quadruped.describe_quadruped,
    "carrier": lambda: carrier.describe_carrier(0.0),
}


@pytest.mark.parametrize("name", MECHANISMS)
def test_models_have_the_equations_of_the_plain_recursion(name: str) -> None:
    """Phi of the generator's tape, without inputs and forces, against Newton and Euler's equations in world axes."""
    tree, mechanism = read_tree(FOLDER / f"{name}.yaml"), MECHANISMS[name]()
    rng = np.random.default_rng(0)
    q, qd, qdd = (rng.uniform(-1, 1, mechanism.n) for _ in range(3))
    given = {"q": list(q), "qd": list(qd), "qdd": list(qdd), "u": [0.0] * sum(x.joint.actuated for x in tree.bodies)}
    tape = impl.build(tree)
    given |= {i.name: [0.0] * i.sparsity.nnz for i in tape.inputs if i.name == "w"}
    given |= {"p": p} if (p := values_of(tree)) else {}
    expected = mechanism.residual(q, qd, qdd, np.zeros((3, len(mechanism.points)))).full().ravel()
    found = np.array(evaluate(tape, given)["Phi"], float)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())


def test_the_plain_walker_has_a_published_optimum() -> None:
    """Of 0.4 m in 0.6 s; inputs that are constant over intervals cost more by a multiple of h^2, which is removed."""
    costs = [walker.write(walker.Step(0.4, 0.6, is_free=True), N, 2).solve().cost for N in (20, 40)]
    limit = (4 * costs[1] - costs[0]) / 3
    assert min(abs(limit / cost - 1) for cost in walker.PUBLISHED) < 1e-4


def test_the_walker_steps_as_in_plain_casadi(tmp_path: Path) -> None:
    """On a coarse mesh; the impact balances momentum to rounding, by equations that are not the kernels'."""
    text = (FOLDER / "walker.ocp.yaml").read_text("utf-8").replace("intervals: 25", "intervals: 8")
    path = tmp_path / "walker.ocp.yaml"
    path.write_text(text.replace("model: walker", f"model: {FOLDER}/walker"), "utf-8")
    problem, plants = read_phased_problem(path, load_on_demand)
    solution = solve_phases(problem, plants)
    assert isinstance(solution, PhasedSolution)
    plain = walker.write(walker.Step(), 8, 3).solve()
    assert plain.status == "Solve_Succeeded"
    assert solution.cost == pytest.approx(plain.cost, rel=1e-8)
    assert measure_balance(solution, walker.describe_free()) < 1e-12


def test_the_walker_starts_its_step_as_others_found_it() -> None:
    """Angles from the vertical and their rates, printed in github.com/Garyandtang/trajectory-optimization-examples for
    the step of 0.5 m in 0.7 s, by another method on another grid.
    """
    angles, rates = (0.0848, 0.4941, -0.1262, -0.3469, -0.3587), (-1.4975, -0.6145, 0.0161, -0.5520, -2.0082)
    solution = solve_phases(*read_phased_problem(FOLDER / "walker.ocp.yaml", load_on_demand))
    assert isinstance(solution, PhasedSolution)
    mesh = solution.phases[0].trajectory
    np.testing.assert_allclose(np.cumsum(mesh.q[0]), angles, atol=2e-3)
    np.testing.assert_allclose(np.cumsum(mesh.qd[0]), rates, atol=1e-2)


def test_every_problem_has_its_file() -> None:
    assert sorted(case.file for case in CASES.values()) == sorted(FOLDER.glob("*.ocp.yaml"))


def test_the_quickest_setting_that_solves_a_plain_program_counts() -> None:
    """The quickest of three fails; where all fail, IPOPT's defaults count."""

    def end(status: str, seconds: float) -> Answer:
        return Answer(status, 1.0, 10, seconds, 0.0, np.zeros(0), ca.MX(), 0)

    tried = {"defaults": end(SOLVED, 3.0), "tuned": end(SOLVED, 2.0), "failed": end("Maximum_CpuTime_Exceeded", 1.0)}
    assert choose_setting(tried) == "tuned"
    assert choose_setting({name: end("Infeasible_Problem_Detected", 1.0) for name in tried}) == "defaults"
