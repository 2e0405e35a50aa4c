"""Optimal control of loops with quaternions: against the same mechanism cut elsewhere, which has none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun import Mechanism
from mbsrun.closure import CLOSED, Closure
from mbsrun.measuring.mechanisms import draw_states
from mbsrun.measuring.reference import Reference
from mbsrun.models import Extent, find_folder
from mbsrun.ocp.guessing.guess import find_inputs
from mbsrun.ocp.problem.problem import Form, Loops, Problem
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.checks import find_loop_conflicts
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.quaternions import list_divided, list_entries

LOOPS = ("loops", "loop_rates", "loop_jacobian", "loop_forces")
FUNCTIONS = ("impl", "impl_red", "frames", *LOOPS)

CRANK = (
    "  - {name: crank, joint: {name: crank, type: revolute, axis: x}, mass: 1, com: [0, 0, 0.05], "
    "inertia: [0.02, 0.03, 0.04]}\n"
)
SLIDER = (
    "  - {name: slider, joint: {name: slider, type: prismatic, axis: x, position: [0, 0.1, 0], actuated: false}, "
    "mass: 0.8}\n"
)
MODELS = {
    # the rod hangs on the crank by a ball, and a universal joint ties it to the slider
    "ball": (Path(__file__).parents[3] / "models" / "spatial" / "ball_crank.yaml").read_text("utf-8"),
    # the rod hangs on the slider by the universal joint, and the ball is cut
    "hinges": f"""\
name: hinges
gravity: [0, 0, -9.81]
bodies:
{CRANK}{SLIDER}  - {{name: rod, parent: slider, joint: {{type: universal, axis: y, axis2: z, actuated: false}}, \
mass: 0.6, com: [-0.3, 0, 0], inertia: [0.001, 0.02, 0.0205]}}
loops:
  - {{name: ball, type: ball, from: {{body: crank, position: [0, 0, 0.1]}}, to: {{body: rod, position: [-0.6, 0, 0]}}}}
independent: [crank]
assembly: {{slider: 0.57}}
""",
}
PROBLEM = """\
model: {model}.yaml
horizon: 0.5
intervals: 6
scheme: radau
degree: 3
cost: {{inputs: 1, running: [{{expression: q_slider**2, weight: 10}}]}}
start: {{pose: {{crank: 0.2}}}}
end: {{pose: {{crank: 1.5}}, velocity: zero}}
constraints: [{{expression: qd_slider, range: [-1, 1]}}]
"""


def write(folder: Path, model: str, problem: str) -> tuple[Problem, Mechanism]:
    (folder / f"{model}.yaml").write_text(MODELS[model], "utf-8")
    path = folder / f"{model}.ocp.yaml"
    path.write_text(problem.format(model=model), "utf-8")
    return read_problem(path, lambda file: Mechanism(find_folder(file, Extent(FUNCTIONS, optional=("rates",)))))


@cache
def make(model: str) -> tuple[Problem, Mechanism]:
    with TemporaryDirectory() as folder:
        return write(Path(folder), model, PROBLEM)


@cache
def solved(model: str, loops: Loops) -> Solution:
    problem, plant = make(model)
    found = solve(replace(problem, loops=loops), plant)
    assert isinstance(found, Solution), found
    return resimulate(found, plant)


def test_a_ball_in_a_loop_moves_as_the_same_loop_cut_at_the_ball() -> None:
    """Both carry on the crank alone, by the same collocation: all that differs is rounding and the tolerance."""
    one, other = (solved(model, Loops.REDUCED) for model in ("ball", "hinges"))
    assert one.cost.total == pytest.approx(other.cost.total, rel=1e-8)
    assert one.trajectory.u == pytest.approx(other.trajectory.u, abs=1e-6)
    assert one.trajectory.point_q[..., [0, 5]] == pytest.approx(other.trajectory.point_q[..., [0, 1]], abs=1e-8)


@pytest.mark.parametrize("loops", Loops)
def test_loops_with_quaternions_stay_closed(loops: Loops) -> None:
    """At all points, and along the re-simulated motion; both forms have one optimum, up to the discretisation."""
    found, check = solved("ball", loops), solved("ball", loops).resimulation
    assert check is not None
    assert found.violation.closure == pytest.approx(0, abs=CLOSED)
    assert found.violation.closure_rate == pytest.approx(0, abs=1e-9)
    assert check.closure == pytest.approx(0, abs=CLOSED)
    assert check.defect == pytest.approx(0, abs=2e-4)
    assert found.cost.total == pytest.approx(solved("hinges", Loops.REDUCED).cost.total, rel=1e-4)


@pytest.mark.parametrize(
    ("form", "method"), [(Form.INTEGRAL, "ipopt"), (Form.SHOOTING, "ipopt"), (Form.SHOOTING, "mbs")]
)
def test_forms_without_states_at_points_turn_as_collocation(form: Form, method: str) -> None:
    """The loop gives the rod's quaternion, its length, and velocities, which the problem reads."""
    problem, plant = make("ball")
    found = solve(replace(problem, loops=Loops.REDUCED, form=form).with_solver(method), plant)
    expected = solved("ball", Loops.REDUCED)
    assert isinstance(found, Solution), found
    assert found.cost.total == pytest.approx(expected.cost.total, rel=1e-6)
    assert found.trajectory.point_q == pytest.approx(expected.trajectory.point_q, abs=1e-4)
    assert found.violation.closure == pytest.approx(0, abs=CLOSED)
    assert found.violation.lengths == pytest.approx(0, abs=CLOSED)
    check = resimulate(found, plant).resimulation
    assert check is not None
    assert check.closure == pytest.approx(0, abs=1e-10)


def test_forces_of_loops_do_no_work() -> None:
    """Their power on velocities that keep the loops closed is 0."""
    found, (_, plant) = solved("ball", Loops.MULTIPLIERS), make("ball")
    assert found.multipliers is not None
    q, qd, lam = (
        x.reshape(-1, x.shape[2]) for x in (found.trajectory.point_q, found.trajectory.point_qd, found.multipliers)
    )
    forces = plant("loop_forces", q=q, lam=lam)["Q"]
    assert np.abs((forces * qd).sum(axis=1)).max() < 1e-9 * np.abs(forces).max()


def test_a_start_is_closed_near_the_given_quaternion() -> None:
    """A whole attitude is more than the loop leaves free: what agrees with it is accepted, what does not is refused."""
    q = Closure(make("ball")[1]).close(np.array(make("ball")[0].start_q))
    entries = ", ".join(f"rod.q{x}: {value:.12f}" for x, value in zip("xyzw", q[1:5], strict=True))
    for pose, finding in ((f"crank: 0.2, {entries}", None), (f"crank: 0.5, {entries}", "but the loops put it at")):
        with TemporaryDirectory() as folder:
            text = PROBLEM.replace("crank: 0.2", pose)
            if finding is None:
                assert write(Path(folder), "ball", text)[0].start_q == pytest.approx(q, abs=1e-10)
            else:
                with pytest.raises(InputError, match=finding):
                    write(Path(folder), "ball", text)


def test_a_joint_that_is_independent_in_part_takes_multipliers() -> None:
    """Two of three velocities of the ball have no coordinates that collocation could carry on."""
    problem, plant = make("ball")
    manifest = plant.manifest.model_copy(update={"independent": (0, 2), "dependent": (1, 3, 4)})
    assert list_entries(manifest, (0, 1, 2, 3)) == [0, 1, 2, 3, 4]
    assert list_entries(manifest, (0, 2)) == [0]
    assert list_divided(manifest, (0, 2)) == [1, 2, 3, 4]
    findings = [x.finding for x in find_loop_conflicts(replace(problem, loops=Loops.REDUCED), manifest)]
    assert findings == ["some velocities of rod are independent and some are not; the reduced form takes all or none"]


def test_random_states_are_closed_at_unit_quaternions(tmp_path: Path) -> None:
    """Charts and advice measure there: the residual is the textbook's in 50 digits."""
    _, plant = make("ball")
    states = draw_states(plant, 8)
    q, qd = states["q"], states["qd"]
    assert np.linalg.norm(q[:, 1:5], axis=1) == pytest.approx(1, abs=1e-15)
    assert Closure(plant).measure(q) < 1e-7
    assert Closure(plant).measure_rates(q, qd) < 1e-5
    assert np.ptp(q[:, 0]) > 1
    (tmp_path / "ball.yaml").write_text(MODELS["ball"], "utf-8")
    moment = Reference(tmp_path / "ball.yaml").at({name: values[1] for name, values in states.items()})
    given = {name: states[name][1] for name in ("q", "qd", "qdd", "u", "lam")}
    expected = np.array(moment.residual(), dtype=float)
    assert plant("impl", **given)["Phi"].ravel() == pytest.approx(expected, abs=1e-12)


def test_a_motion_along_the_path_gives_the_force_that_it_takes(tmp_path: Path) -> None:
    """The crank turns at a constant speed; its torque is the inverse dynamics of the closed motion."""
    lines = PROBLEM.partition("end:")[0].replace("intervals: 6", "intervals: 12\ninputs: polynomial")
    text = lines.replace("crank: 0.2}}}}", "crank: 0.2}}, velocity: {{crank: 3}}}}")
    problem, plant = write(
        tmp_path, "ball", text + "constraints: [{{expression: q_crank - 0.2 - 3*t, range: [0, 0]}}]\n"
    )
    found = solve(problem, plant)
    assert isinstance(found, Solution), found
    t, closure = found.trajectory.point_t.ravel(), Closure(plant)
    q = np.array(found.trajectory.point_q.reshape(t.size, -1))
    q[:, 0] = 0.2 + 3 * t
    q = closure.close(q, [0])
    qd = closure.complete_velocities(q, [0], np.full((t.size, 1), 3.0))
    qdd = closure.complete_accelerations(q, qd, [0], np.zeros((t.size, 1)))
    assert found.trajectory.point_u.ravel() == pytest.approx(find_inputs(plant, q, qd, qdd).ravel(), abs=1e-4)
