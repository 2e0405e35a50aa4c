"""Contacts by complementarity against closed forms: a block that is pushed, one that falls, and faults."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbsgen.errors import InputError
from mbsrun import load
from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.problem.touching import list_steps
from mbsrun.ocp.showing.phase_summary import summarise_phases
from mbsrun.ocp.showing.summary import summarise
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.phases import solve_phases
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.phases import read_phased_problem
from mbsrun.ocp.statement.statement import read_problem
from tests.shipped import FOLDER

BLOCK, PUSH = FOLDER / "contact" / "block.yaml", FOLDER / "contact" / "push.ocp.yaml"
PUCK_PUSH = FOLDER / "contact" / "puck_push.ocp.yaml"
FALL = """
model: block.yaml
horizon: 1
intervals: 20
scheme: radau
degree: 1
start: {pose: {z: 0.8}, velocity: {x: 1.5}}
bounds: {inputs: [0, 0]}
contacts: [{sensor: block, axes: xz, friction: 0.2, mode: complementarity}]
relaxation: {first: 0.01, last: 1e-6}
cost: {inputs: 1}
"""


def read(folder: Path, text: str) -> tuple[Problem, Plant]:
    (folder / "block.yaml").write_text(BLOCK.read_text("utf-8"))
    (folder / "block.ocp.yaml").write_text(text)
    return read_problem(folder / "block.ocp.yaml", load)


def found(problem: Problem, plant: Plant) -> Solution:
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution), outcome
    return outcome


def test_a_pushed_block_takes_the_least_time() -> None:
    """It gains speed with (20 - 8)/2 m/s2 and loses it with 4 m/s2: T = sqrt(2 (1/6 + 1/4)) over 1 m."""
    problem, plant = read_problem(PUSH, load)
    assert list_steps(problem) == pytest.approx([0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6])
    solution = found(problem, plant)
    assert solution.cost.total == pytest.approx(np.sqrt(2 * (1 / 6 + 1 / 4)), abs=1e-6)
    assert solution.violation.complementarity is not None
    assert solution.violation.complementarity <= 1.1e-6
    assert "of force times distance" in summarise(solution)["complementarity"]


def test_a_block_falls_slides_and_stops(tmp_path: Path) -> None:
    """By Euler's implicit steps it lands after 0.375 s, loses mu times its speed at once, then mu g per second."""
    motion = found(*read(tmp_path, FALL)).trajectory
    h, v = 0.05, 1.5
    for k, (z, normal) in enumerate(zip(motion.q[1:, 1], motion.point_w[:, 0, 2], strict=True), 1):
        assert z == pytest.approx(max(0.8 - 10 * h**2 * k * (k + 1) / 2, 0.0), abs=1e-5)
        v = max(v - 0.2 * normal * h / 2, 0.0)
        assert motion.qd[k, 0] == pytest.approx(v, abs=2e-3)
    assert motion.point_w[:, 0, 2].sum() * h == pytest.approx(20.0, abs=1e-3)  # m g T: it comes to rest
    assert motion.qd[-1] == pytest.approx([0.0, 0.0], abs=1e-4)


PUCK = """
model: puck.yaml
horizon: 1
intervals: 20
scheme: radau
degree: 1
start: {pose: {}}
contacts: [{sensor: puck, axes: xyz, friction: 0.2, mode: complementarity}]
cost: {running: [{expression: fz_puck**2, weight: 1e-3}]}
solver: {method: METHOD}
"""


def slide(folder: Path, method: str, *changes: tuple[str, str]) -> Trajectory:
    """Solve for the motion of a puck of 2 kg, whose friction takes 2 m/s2."""
    text = PUCK.replace("METHOD", method)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "puck.yaml").write_text((FOLDER / "contact" / "puck.yaml").read_text("utf-8"))
    (folder / "puck.ocp.yaml").write_text(text)
    return found(*read_problem(folder / "puck.ocp.yaml", load)).trajectory


BOTH = pytest.mark.parametrize("method", ["mbs", "ipopt"])


@BOTH
def test_a_puck_slows_down_along_its_velocity_and_stops(tmp_path: Path, method: str) -> None:
    """It loses 2 m/s per s, which Euler's implicit steps integrate exactly; the direction (0.6, 0.8) stays."""
    motion = slide(
        tmp_path,
        method,
        ("{pose: {}}", "{pose: {}, velocity: {x: 0.6, y: 0.8}}"),
        ("cost:", "forces: {x: 0, y: 0}\ncost:"),
    )
    v = motion.qd[:, :2]
    assert np.hypot(*v.T) == pytest.approx(np.maximum(1 - 2 * motion.t, 0), abs=1e-4)
    assert v @ [0.8, -0.6] == pytest.approx(np.zeros(21), abs=1e-9)
    assert motion.controls[:9, 0] == pytest.approx(1 - 2 * motion.t[1:10], abs=1e-4)


@BOTH
def test_a_block_sticks_and_then_slides(tmp_path: Path, method: str) -> None:
    """A force of 8 t N along (0.6, 0.8): it sticks up to 4 N, at 0.5 s, and then gains 4 t - 2 m/s2."""
    motion = slide(tmp_path, method, ("cost:", "forces: {x: 4.8*t, y: 6.4*t}\ncost:"))
    speed, expected = 0.0, [0.0]
    for t in motion.t[1:]:
        speed = max(0.0, speed + 0.05 * (4 * t - 2))
        expected.append(speed)
    assert motion.qd[:, :2] == pytest.approx(np.outer(expected, [0.6, 0.8]), abs=1e-4)
    assert motion.point_w[4, 0, :2] == pytest.approx(-8 * motion.t[5] * np.array([0.6, 0.8]), abs=1e-2)


@BOTH
def test_a_puck_that_is_pushed_aside_takes_a_curve(tmp_path: Path, method: str) -> None:
    """Its velocity turns: v' = (0, 1.5) - 2 v/|v|, integrated by SciPy; the slip is the speed at every point."""
    changes = (
        ("{pose: {}}", "{pose: {}, velocity: {x: 1.5}}"),
        ("cost:", "forces: {x: 0, y: 3}\ncost:"),
        ("degree: 1", "degree: 3\ninputs: polynomial"),
    )
    motion = slide(tmp_path, method, *changes)
    exact = solve_ivp(
        lambda _, v: np.array([0, 1.5]) - 2 * v / np.linalg.norm(v),
        (0, 1),
        [1.5, 0],
        "DOP853",
        motion.t,
        rtol=1e-11,
        atol=1e-12,
    )
    assert motion.qd[:, :2] == pytest.approx(exact.y.T, abs=1e-5)
    assert motion.point_controls[..., 0] == pytest.approx(np.linalg.norm(motion.point_qd[..., :2], axis=2), abs=1e-5)


def test_a_puck_falls_slides_and_stops(tmp_path: Path) -> None:
    """The speed across loses mu times the impulse along the normal, step by step, also where it lands."""
    motion = slide(
        tmp_path,
        "ipopt",
        ("{pose: {}}", "{pose: {z: 0.3}, velocity: {x: 1.2, y: 1.6}}"),
        ("cost:", "forces: {x: 0, y: 0}\ncost:"),
    )
    speed = 2.0
    for v, normal in zip(motion.qd[1:, :2], motion.point_w[:, 0, 2], strict=True):
        speed = max(speed - 0.2 * normal * 0.05 / 2, 0.0)
        assert v == pytest.approx([0.6 * speed, 0.8 * speed], abs=1e-4)
    assert motion.point_w[:, 0, 2].sum() * 0.05 == pytest.approx(20.0, abs=1e-4)  # m g T


@BOTH
def test_the_best_push_in_a_plane_is_straight(tmp_path: Path, method: str) -> None:
    """It costs as much as the push of a block along a line, whose friction has one axis across."""
    problem, plant = read_problem(PUCK_PUSH, load)
    in_plane = found(problem.with_solver(method), plant)
    line = (
        PUCK_PUSH.read_text("utf-8")
        .replace("puck", "block")
        .replace("xyz", "xz")
        .replace("{x: 0.3, y: 0.4}", "{x: 0.5}")
    )
    assert in_plane.cost.total == pytest.approx(found(*read(tmp_path, line)).cost.total, rel=1e-5)
    assert in_plane.trajectory.q[:, :2] @ [0.8, -0.6] == pytest.approx(np.zeros(21), abs=1e-6)


def test_a_block_falls_and_slides_through_two_phases(tmp_path: Path) -> None:
    """The same motion as in one phase: contacts are found across the link; relaxations are for all phases."""
    text = FALL.replace("horizon: 1", "horizon: 0.5").replace("intervals: 20", "intervals: 10")
    start = "start: {pose: {z: 0.8}, velocity: {x: 1.5}}\n"
    text = text.replace(start, "") + f"phases:\n  - {{name: fall, {start.strip()}}}\n  - {{name: slide}}\n"
    (tmp_path / "block.yaml").write_text(BLOCK.read_text("utf-8"))
    (tmp_path / "two.ocp.yaml").write_text(text + "links: [{from: fall, to: slide}]\n")
    outcome = solve_phases(*read_phased_problem(tmp_path / "two.ocp.yaml", load_on_demand))
    assert isinstance(outcome, PhasedSolution), outcome
    one = found(*read(tmp_path, FALL)).trajectory
    first, second = (phase.trajectory for phase in outcome.phases)
    assert np.concatenate((first.q, second.q[1:])) == pytest.approx(one.q, abs=1e-5)
    assert np.concatenate((first.qd, second.qd[1:])) == pytest.approx(one.qd, abs=2e-3)
    assert all(phase.violation.complementarity <= 1.1e-6 for phase in outcome.phases)
    assert "of force times distance" in summarise_phases(outcome)["slide: complementarity"]


BAD = """
contacts:
  - {sensor: shoe, mode: complementarity, axes: z}
  - {sensor: block, wrench: hand, axes: xz, normal: z, mode: complementarity}
  - {sensor: block, axes: xy, friction: 1, mode: complementarity}
  - {sensor: block, axes: xz, height: 1}
  - {sensor: block, axes: xyz, mode: complementarity}
relaxation: {first: 1e-8, factor: 0.95}
"""


def test_faults_of_complementarity_have_places(tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        read(tmp_path, "\n".join([*(x for x in FALL.splitlines() if x[:4] not in ("cont", "rela")), BAD]))
    faults = {(fault.path, fault.finding) for fault in error.value.faults}
    for expected in (
        ("contacts[0].sensor", "the model has no sensor shoe"),
        ("contacts[1].wrench", "the model has no open wrench hand with a force"),
        ("contacts[1].friction", "forces along x without friction would not know when to act"),
        ("contacts[2].normal", "complementarity needs a normal among the axes"),
        ("contacts[3].height", "a point that stands keeps its place"),
        ("contacts[4].friction", "forces along x, y without friction would not know when to act"),
        ("relaxation.factor", "found 0.95"),
        ("relaxation.first", "1e-08 is below the last, 1e-06"),
    ):
        assert expected in faults
    for text, finding in (
        (FALL.replace("xz", "xyz").replace("degree: 1", "degree: 2"), "friction along two axes has an unknown slip"),
        (FALL.replace("radau", "legendre"), "the points of legendre are no mesh points"),
        (FALL.replace(", mode: complementarity", ""), "no contact has mode: complementarity"),
    ):
        with pytest.raises(InputError, match=finding):
            read(tmp_path, text)
