"""A solution as CSV: the names of its columns, and the numbers of the motion."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solution.table import write_table
from mbsrun.ocp.solving.solve import solve
from tests.mbsrun.ocp.plants import push
from tests.mbsrun.peer import Peer, double_integrator


def read(path: Path) -> tuple[list[str], dict[str, list[float]]]:
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    columns = np.array(rows, dtype=float).T.tolist()
    return header, dict(zip(header, columns, strict=True))


@pytest.mark.parametrize(("family", "rows"), [(Family.RADAU, 8 * 2 + 1), (Family.LEGENDRE, 8 * 3 + 1)])
def test_the_columns_are_the_motion(tmp_path: Path, family: Family, rows: int) -> None:
    """A push of 1 kg: the acceleration is the input everywhere, q and qd are its integrals; the sensor is at (q, 0, 0).

    With Radau points the last of an interval is the next mesh point, and stands there once.
    """
    outcome = solve(push(8, family), double_integrator())
    assert isinstance(outcome, Solution)
    write_table(outcome, double_integrator(), tmp_path / "solution.csv")
    header, columns = read(tmp_path / "solution.csv")
    assert header == [
        "t [s]", "q[slide] [m]", "qd[slide] [m/s]", "qdd[slide] [m/s^2]", "u[slide] [N]",
        "x[place] [m]", "y[place] [m]", "z[place] [m]",
    ]  # fmt: skip
    t, q, qd, qdd, u = (np.array(columns[name]) for name in header[:5])
    assert len(t) == rows
    assert (np.diff(t) > 0).all()
    assert (t[0], t[-1]) == (0.0, 1.0)
    assert qdd == pytest.approx(u, abs=1e-7)
    steps = np.diff(t)
    assert np.diff(qd) == pytest.approx(steps * u[:-1], abs=1e-9)
    assert np.diff(q) == pytest.approx(steps * qd[:-1] + steps**2 / 2 * u[:-1], abs=1e-9)
    assert columns["x[place] [m]"] == columns["q[slide] [m]"]
    assert set(columns["y[place] [m]"]) == {0.0}


def test_all_of_an_arm_is_there(tmp_path: Path, arm: Peer, reached: Solution) -> None:
    """Angles and moments; every digit of the mesh points; the hand ends at its target."""
    write_table(reached, arm, tmp_path / "solution.csv")
    header, columns = read(tmp_path / "solution.csv")
    assert header[1:3] == ["q[q1] [rad]", "q[q2] [rad]"]
    assert [name for name in header if name.startswith("u[")] == [f"u[q{i}] [N m]" for i in range(1, 5)]
    for i in range(6):
        assert columns[f"q[q{i + 1}] [rad]"][::4] == reached.trajectory.q[:, i].tolist()
    ((_, target),) = reached.problem.end.sensors
    assert [columns[f"{axis}[hand] [m]"][-1] for axis in "xyz"] == pytest.approx(target, abs=1e-7)


def test_a_model_without_sensors_has_no_columns_for_them(tmp_path: Path) -> None:
    plant, problem = double_integrator(), push(4)
    bare = plant.with_functions({})
    bare.manifest = plant.manifest.model_copy(update={"frames": plant.manifest.frames[:1]})
    outcome = solve(problem, bare)
    assert isinstance(outcome, Solution)
    write_table(outcome, bare, tmp_path / "solution.csv")
    assert read(tmp_path / "solution.csv")[0][-1] == "u[slide] [N]"
