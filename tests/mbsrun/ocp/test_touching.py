"""Contacts by complementarity against closed forms: a block that is pushed, one that falls, and faults."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun import load
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.problem import Problem
from mbsrun.ocp.solution import Solution
from mbsrun.ocp.solve import solve
from mbsrun.ocp.statement import read_problem
from mbsrun.ocp.summary import summarise
from mbsrun.ocp.touching import list_steps
from tests.shipped import FOLDER

BLOCK, PUSH = FOLDER / "contact" / "block.yaml", FOLDER / "contact" / "push.ocp.yaml"
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


BAD = """
contacts:
  - {sensor: shoe, mode: complementarity, axes: z}
  - {sensor: block, wrench: hand, axes: xz, normal: z, mode: complementarity}
  - {sensor: block, axes: xy, friction: 1, mode: complementarity}
  - {sensor: block, axes: xz, height: 1}
  - {sensor: block, axes: xyz, friction: 1, mode: complementarity}
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
        ("contacts[4].axes", "complementarity takes friction along one axis"),
        ("relaxation.factor", "found 0.95"),
        ("relaxation.first", "1e-08 is below the last, 1e-06"),
    ):
        assert expected in faults
    for text, finding in (
        (FALL.replace("radau", "legendre"), "the points of legendre are no mesh points"),
        (FALL.replace(", mode: complementarity", ""), "no contact has mode: complementarity"),
    ):
        with pytest.raises(InputError, match=finding):
            read(tmp_path, text)
