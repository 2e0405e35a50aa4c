"""The whole way: model file, generated kernels, the paper's task solved, re-simulated; beside the arm made by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun import Mechanism, load
from mbsrun.ocp.problem.problem import Problem, Representation
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem
from tests.mbsrun.ocp.programs import TABLE_3, functions_of
from tests.mbsrun.peer import Peer
from tests.mbsrun.peer_arm import peer_arm

MODELS = Path(__file__).parents[2] / "models"


@pytest.fixture(scope="module")
def generated(requires: Callable[[str], str]) -> tuple[Problem, Mechanism]:
    """The paper's task and the kernels of its model."""
    requires("cc")
    return read_problem(MODELS / "arm_reach.ocp.yaml", load)


@pytest.fixture(scope="module")
def peer() -> Peer:
    return peer_arm()


def test_generated_kernels_are_those_made_by_hand(generated: tuple[Problem, Mechanism], peer: Peer) -> None:
    """Residual and poses at random states, to 1e-13 of numbers of order 1 to 100."""
    _, mechanism = generated
    rng = np.random.default_rng(5)
    q, qd, qdd = rng.uniform(-1.5, 1.5, (3, 20, 6))
    u = rng.uniform(-10, 10, (20, 4))
    for name, inputs in (("impl", {"q": q, "qd": qd, "qdd": qdd, "u": u}), ("sensors", {"q": q}), ("frames", {"q": q})):
        found, expected = mechanism(name, **inputs), peer(name, **inputs)
        for key, value in expected.items():
            assert found[key] == pytest.approx(value, abs=1e-12), key
    assert [(f.name, f.sensor) for f in mechanism.manifest.frames] == [(f.name, f.sensor) for f in peer.manifest.frames]


@pytest.mark.parametrize(("representation", "sizes"), TABLE_3.items())
def test_sizes_with_generated_kernels(
    generated: tuple[Problem, Mechanism], representation: Representation, sizes: tuple[int, int, int, int]
) -> None:
    """Table 3: the patterns of the generated derivatives are exact."""
    problem, mechanism = generated
    program = functions_of(replace(problem, representation=representation), mechanism)
    nonzeros = (program.jacobian.nnz_out(0), program.hessian.nnz_out(0))
    assert (program.variables, program.constraints, *nonzeros) == sizes


def test_the_papers_task_with_generated_kernels(generated: tuple[Problem, Mechanism], peer: Peer) -> None:
    """2.8881463e7; the peer follows the same inputs, so the check is independent of the checked program."""
    problem, mechanism = generated
    outcome = solve(problem, mechanism)
    assert isinstance(outcome, Solution)
    assert outcome.run.status == "Solve_Succeeded"
    assert outcome.run.iterations <= 34
    assert outcome.cost.total == pytest.approx(2.8881463e7, rel=1e-7)
    for plant in (mechanism, peer):
        check = resimulate(outcome, plant).resimulation
        assert check is not None
        assert check.defect is not None
        assert check.defect < 1e-9


@pytest.mark.parametrize(("height", "cost"), [(-0.1, 15126.9986), (0.0, 38159.2981), (0.02, 38069.0180)])
def test_targets_before_the_base_are_reached(generated: tuple[Problem, Mechanism], height: float, cost: float) -> None:
    """Rows at the end that hold exactly take all digits of curvature there, until they are soft; IPOPT's optima."""
    problem, mechanism = generated
    sensor = problem.end.sensors[0][0]
    alone = replace(problem.solver, method="mbs", fallback=False)
    outcome = solve(replace(problem.with_target(sensor, (0.63, 0.0, height)), solver=alone), mechanism)
    assert isinstance(outcome, Solution)
    assert outcome.run.iterations <= 35
    assert outcome.cost.total == pytest.approx(cost, rel=1e-7)


def test_a_model_with_faults_is_refused_with_all_of_them(tmp_path: Path) -> None:
    """Faults of the problem file and of the model it names come in one error."""
    (tmp_path / "bad.yaml").write_text("name: bad\ngravity: [0, 0]\nbodies: []\n", "utf-8")
    problem = (MODELS / "arm_reach.ocp.yaml").read_text("utf-8").replace("arm_pendulum", "bad")
    (tmp_path / "task.ocp.yaml").write_text(problem.replace("radau", "gauss"), "utf-8")
    with pytest.raises(InputError) as refusal:
        read_problem(tmp_path / "task.ocp.yaml", load)
    assert {Path(fault.file).name for fault in refusal.value.faults} == {"bad.yaml", "task.ocp.yaml"}


def test_a_model_that_is_missing_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such file"):
        load(tmp_path / "nowhere.yaml")
