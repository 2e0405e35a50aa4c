"""Adding a method is one entry: toys, added here, are used from a file or the command line to the result."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import Bounds, NonlinearConstraint, minimize

from mbsgen.errors import InputError
from mbsrun import cli, load
from mbsrun.ocp.ground import integrators, schemes
from mbsrun.ocp.ground.integrators import INTEGRATORS, Kind
from mbsrun.ocp.ground.status import SOLVED
from mbsrun.ocp.methods import METHODS, Amount, Answer, Assignment, Instance, Iterate, Method, Solver
from mbsrun.ocp.problem.problem import Form, Representation, SolverOptions
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.runs import Progress
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.ocp.transcription.transcription import transcribe
from mbsrun.simulation import METHODS as SIMULATED
from mbsrun.simulation import Settings, simulate
from mbsrun.simulation.drive import hold
from mbsrun.simulation.integration import explicit
from mbsrun.simulation.integration.methods import Family
from mbsrun.simulation.integration.methods import Method as SimulationMethod
from tests.mbsrun.ocp.plants import push
from tests.mbsrun.ocp.programs import functions_of
from tests.mbsrun.peer import double_integrator

ROOT = Path(__file__).parents[2]


class Midpoint:
    """The explicit midpoint rule, of order 2; in between, its motion is the parabola of its derivatives."""

    c = np.array([0.0, 0.5])
    A = np.array([[0.0, 0.0], [0.5, 0.0]])

    def read(self, c: float) -> tuple[np.ndarray, np.ndarray]:
        return np.array([c - c**2, c**2]), np.array([1 - 2 * c, 2 * c])

    def integrate(self, c: float, v: np.ndarray) -> np.ndarray:  # noqa: ARG002
        return v @ self.A


@pytest.fixture
def midpoint(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = Kind("the explicit midpoint rule", lambda _: Midpoint(), is_explicit=True)
    monkeypatch.setitem(INTEGRATORS, "midpoint", kind)  # type: ignore[arg-type]  # a plain mapping


def make_slsqp(order: Assignment) -> Solver:
    """Solve the program by SciPy's SLSQP, with first derivatives by NumPy."""
    functions = order.program.numpy

    def run(start: Instance) -> Answer:
        p, iterations = start.parameters, [0]

        def watch(x: np.ndarray) -> None:
            iterations[0] += 1
            if start.watch is not None:
                start.watch(
                    Iterate(iterations[0], functions.objective(x, p), start.measure(functions.constraint(x, p)))
                )

        rows = NonlinearConstraint(
            lambda x: functions.constraint(x, p),
            start.g_lower,
            start.g_upper,
            jac=lambda x: functions.jacobian(x, p).toarray(),
        )
        found = minimize(
            lambda x: order.scaling * functions.objective(x, p),
            start.x,
            jac=lambda x: order.scaling * functions.gradient(x, p),
            method="SLSQP",
            bounds=Bounds(start.lower, start.upper),
            constraints=[rows],
            callback=watch,
            # the cost is of second order in the distance from the optimum
            options={"maxiter": order.max_iterations, "ftol": order.tolerance**1.5, **order.options},
        )
        return Answer(found.x, SOLVED if found.success else "Toy_Failed", int(found.nit))

    return run


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> None:
    method = Method("a toy", {"eps": Amount(1e-12, 1.0)}, make_slsqp)
    monkeypatch.setitem(METHODS, "toy", method)  # type: ignore[arg-type]


@pytest.mark.usefixtures("toy")
def test_an_nlp_method_that_is_added_solves_a_problem() -> None:
    """12 / (1 - 1/N^2) for a push from rest to rest, as by IPOPT; iterates are shown, and its own options known."""
    seen: list[Progress] = []
    options = SolverOptions(method="toy", options=(("eps", 1e-8),))
    outcome = solve(replace(push(8), solver=options), double_integrator(), seen.append)
    assert isinstance(outcome, Solution)
    assert outcome.cost.total == pytest.approx(12 / (1 - 1 / 64), rel=1e-6)
    assert len(seen) == outcome.run.iterations > 0


@pytest.mark.usefixtures("toy")
def test_a_failure_of_a_method_is_explained() -> None:
    """Its own word for the failure is in the finding."""
    options = SolverOptions(method="toy", max_iterations=1)
    outcome = solve(replace(push(8), solver=options), double_integrator())
    assert not isinstance(outcome, Solution)
    assert "Toy_Failed after 1 iterations" in outcome.finding


@pytest.mark.usefixtures("toy", "midpoint")
def test_files_and_checks_know_what_is_added(tmp_path: Path) -> None:
    """And refuse other names with all of the registry, in files and in programs."""
    plant = double_integrator()
    text = (
        "model: m.yaml\nhorizon: 1\nintervals: 4\nscheme: radau\ndegree: 2\nform: shooting\nrepresentation: EXP1-O\n"
        "cost: {inputs: 1}\nstart: {pose: [0]}\nintegrator: midpoint\nsolver: {method: toy, options: {eps: 1e-3}}\n"
    )
    file = tmp_path / "a.ocp.yaml"
    file.write_text(text, "utf-8")
    problem, _ = read_problem(file, lambda _: plant)
    assert (problem.integrator, problem.solver.method, problem.solver.options) == ("midpoint", "toy", (("eps", 1e-3),))
    file.write_text(text.replace("midpoint", "leapfrog").replace("toy", "magic"), "utf-8")
    with pytest.raises(InputError) as refusal:
        read_problem(file, lambda _: plant)
    for names in ("collocation, second-order, rk4, midpoint", "ipopt, sqpmethod, mbs, toy"):
        assert f"give one of {names}" in str(refusal.value)
    wrong = replace(problem, integrator="leapfrog", solver=SolverOptions(method="magic"))
    with pytest.raises(ProblemError) as findings:
        solve(wrong, plant)
    assert [place for place, *_ in findings.value.findings] == ["integrator", "solver.method"]


@pytest.mark.usefixtures("midpoint")
def test_an_integrator_that_is_added_shoots() -> None:
    """Rows of continuity hold the rule's own step; with a residual it is refused."""
    plant = double_integrator()
    shot = replace(push(4), form=Form.SHOOTING, representation=Representation.EXP1_O, integrator="midpoint", steps=2)
    transcription, functions = transcribe(shot, plant), functions_of(shot, plant)
    x = np.random.default_rng(0).uniform(-1, 1, functions.variables)
    motion = transcription.unpack(functions.complete(x))
    h = shot.horizon / 4
    q = motion.q[:-1, 0] + h * motion.qd[:-1, 0] + h**2 / 2 * motion.u[:, 0]
    g = functions.constraint(x, transcription.parameters(shot)).full().ravel()
    gaps = g[np.isin(transcription.program.kept_rows, transcription.rows.continuity)].reshape(4, 2)
    assert gaps[:, 0] == pytest.approx(motion.q[1:, 0] - q, abs=1e-14)
    outcome = solve(shot, plant)
    assert isinstance(outcome, Solution)
    assert outcome.cost.total == pytest.approx(12 / (1 - 1 / 16), rel=1e-8)  # exact for constant accelerations
    with pytest.raises(ProblemError, match="midpoint needs accelerations, and IMPL returns a residual"):
        solve(replace(shot, representation=Representation.IMPL), plant)


def test_a_step_that_is_added_keeps_its_order(midpoint: None) -> None:  # noqa: ARG001
    """Accelerations of degree 1 are integrated exactly at the end of every step."""
    method = integrators.build("midpoint", schemes.build(schemes.Family.RADAU, 2), 3)
    assert method.is_explicit
    assert method.ends.V[1] @ method.stages.c == pytest.approx(0.5, abs=1e-15)


def test_a_simulation_method_that_is_added_runs_from_the_command_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    requires: Callable[[str], str],
) -> None:
    """Heun's method: halving its steps divides its error by 4; help and messages list it."""
    requires("cc")
    heun = explicit.Pair(explicit.Tableau(((0.0, 0.0), (1.0, 0.0)), (0.5, 0.5)))
    method = SimulationMethod(Family.EXPLICIT, 2, "Heun's method", partial(explicit.integrate, heun), ("step",), 2.0)
    monkeypatch.setitem(SIMULATED, "heun", method)  # type: ignore[arg-type]
    model = ROOT / "models" / "pendulum.yaml"
    pendulum = load(model)
    settings = [Settings(0.5, "heun", step=2e-3), Settings(0.5, "heun", step=1e-3), Settings(0.5)]
    forces = hold(np.zeros(len(pendulum.manifest.actuated)))
    coarse, fine, exact = (simulate(pendulum, forces, [1.0], [0.0], x).q[-1, 0] for x in settings)
    assert (coarse - exact) / (fine - exact) == pytest.approx(4, rel=0.02)
    monkeypatch.chdir(tmp_path)
    options = ["--duration", "0.01", "--method", "heun", "-o", "out"]
    monkeypatch.setattr(sys, "argv", ["mbsrun", "simulate", str(model), *options])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code in (0, None)
    assert "heun (Heun's method)" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", ["mbsrun", "simulate", str(model), "--method", "magic"])
    with pytest.raises(SystemExit):
        cli.main()
    assert ", ".join(SIMULATED) in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(("page", "known"), [("problem", INTEGRATORS), ("problem", METHODS), ("simulation", SIMULATED)])
def test_documents_name_all_that_is_registered(page: str, known: dict[str, object]) -> None:
    text = (ROOT / "docs" / f"{page}.md").read_text("utf-8")
    assert [name for name in known if f"`{name}`" not in text] == []
