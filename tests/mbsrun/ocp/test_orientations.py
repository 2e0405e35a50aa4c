"""Orientations of sensors at the end, and their axes in expressions: SciPy's rotations, closed forms, two solvers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mbsrun
from mbsgen.expressions import evaluate, parse
from mbsrun.ocp.ground.status import UNREACHABLE
from mbsrun.ocp.problem.problem import Aims
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.orienting import Condition, list_conditions, point, turn_by, turn_to
from mbsrun.optimal.control import OptimalControl
from mbsrun.optimal.result import Solved
from mbsrun.simulation.drive import ARRAYS

MODELS = Path(__file__).parents[3] / "models"
WRIST = """\
name: wrist
gravity: [0, 0, -9.81]
bodies:
  - {name: yaw, joint: {type: revolute, axis: z}, mass: 1, inertia: [0.1, 0.1, 0.1]}
  - {name: pitch, parent: yaw, joint: {type: revolute, axis: y}, mass: 1, inertia: [0.1, 0.1, 0.1]}
  - {name: roll, parent: pitch, joint: {type: revolute, axis: x}, mass: 1, com: [0.1, 0, 0], inertia: [0.1, 0.1, 0.1]}
frames:
  - {name: hand, body: roll, position: [0.2, 0, 0.1], orientation: {rpy: [0.1, 0.2, 0.3]}}
forces:
  - {name: rubber, from: {body: base, position: [0, 0, 0.5]}, to: {body: roll, position: [0.2, 0, 0]}, stiffness: 5}
"""


@pytest.fixture(scope="module")
def wrist(tmp_path_factory: pytest.TempPathFactory) -> OptimalControl:
    path = tmp_path_factory.mktemp("wrist") / "wrist.yaml"
    path.write_text(WRIST)
    return mbsrun.problem(path, horizon=1, intervals=8, degree=3, end={"velocity": "zero"})


def turned(solved: Solved, row: int = -1) -> np.ndarray[Any, Any]:
    return np.array([[solved[f"{axis}{part}_hand"][row] for axis in "xyz"] for part in "xyz"])


def rotate(aims: Aims) -> np.ndarray[Any, Any]:
    return np.array([direction for _, direction in aims]).T


def test_orientations_are_rotations() -> None:
    assert rotate(turn_by(0.3, -0.7, 2.1)) == pytest.approx(Rotation.from_euler("xyz", [0.3, -0.7, 2.1]).as_matrix())
    q = [0.2, -0.9, 0.4, 1.3]
    assert rotate(turn_to(*q) or ()) == pytest.approx(Rotation.from_quat(q).as_matrix())
    for i, j in ((0, 1), (0, 2), (1, 2)):
        whole = Rotation.from_quat(q).as_matrix()
        assert rotate(point({i: 2 * whole[:, i], j: whole[:, j]}) or ()) == pytest.approx(whole)
    assert turn_to(0, 0, 0, 0) is None
    assert point({0: (1, 0, 0), 1: (1, 1, 0)}) is None


def test_conditions_are_the_sine_of_the_angle_between(wrist: OptimalControl) -> None:
    """Of a turn by the angle a about n: sin(a) n, and 1 + 2 cos(a) at least 1."""
    target = Rotation.from_euler("xyz", [0.4, 0.5, -2.0])
    aims = tuple((k, tuple(column.tolist())) for k, column in enumerate(target.as_matrix().T))
    for turn in ([0.3, -0.4, 0.2], [np.pi, 0, 0], [0, 2.0, 0]):
        R = (Rotation.from_rotvec(turn) * target).as_matrix()
        names = {f"{axis}{part}_hand": R[j, k] for k, axis in enumerate("xyz") for j, part in enumerate("xyz")}
        found = [x for x in list_conditions(aims, 0, "hand", wrist.plant) if isinstance(x, Condition)]
        values = [evaluate(parse(x.expression), names, ARRAYS).item() for x in found]
        angle = np.linalg.norm(turn)
        assert values[:3] == pytest.approx(np.sin(angle) * np.array(turn) / angle, abs=1e-14)
        assert values[3] == pytest.approx(1 + 2 * np.cos(angle))
        assert [x.range for x in found] == [(0.0, 0.0)] * 3 + [(1.0, np.inf)]


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"rpy": [0.5, -0.4, 1.0]}, Rotation.from_euler("xyz", [0.5, -0.4, 1.0])),
        ({"quaternion": [0.1, 0.5, -0.3, 0.9]}, Rotation.from_quat([0.1, 0.5, -0.3, 0.9])),
        ({"x": [0, 1, 0], "z": [0.6, 0, 0.8]}, Rotation.from_matrix([[0, -0.8, 0.6], [1, 0, 0], [0, 0.6, 0.8]])),
    ],
)
def test_a_hand_ends_in_its_orientation(wrist: OptimalControl, given: dict[str, Any], expected: Rotation) -> None:
    """By both solvers, at one cost."""
    problem = wrist.with_changes(end={"orientations": {"hand": given}})
    found = [problem.with_solver(method).solve(check=False) for method in ("mbs", "ipopt")]
    assert all(isinstance(solved, Solved) for solved in found)
    for solved in found:
        assert turned(solved) == pytest.approx(expected.as_matrix(), abs=1e-8)
    assert found[0].cost == pytest.approx(found[1].cost, rel=1e-7)
    assert "hand turned: x along" in repr(problem)


def test_an_axis_has_a_direction_and_may_turn_about_it(wrist: OptimalControl) -> None:
    problem = wrist.with_changes(end={"orientations": {"hand": {"z": [0.6, 0, -0.8]}}})
    assert turned(problem.solve(check=False))[:, 2] == pytest.approx([0.6, 0, -0.8], abs=1e-8)
    both = wrist.with_changes(end={"orientations": {"hand": {"x": [0.8, 0, 0.6], "z": [0.6, 0, -0.8]}}})
    whole = both.solve(check=False)
    assert isinstance(whole, Solved)
    assert problem.solve(guess=whole, check=False).cost < whole.cost  # of the same turns: there are other minima


def test_axes_rates_and_lengths_are_in_costs_and_constraints(wrist: OptimalControl) -> None:
    """Both solvers find one optimum; the angular velocity is bounded, and the length is the distance of its ends."""
    problem = wrist.with_changes(
        end={"orientations": {"hand": {"rpy": [0.5, -0.4, 1.0]}}},
        cost={"inputs": 1, "running": [{"expression": "(1 - zz_hand)**2 + (length_rubber - 0.4)**2", "weight": 5}]},
        constraints=[{"expression": "wz_hand", "range": [-1.05, 1.05]}],
    )
    found = [problem.with_solver(method).solve(check=False) for method in ("mbs", "ipopt")]
    assert found[0].cost == pytest.approx(found[1].cost, rel=1e-7)
    solved = found[0]
    assert np.abs(solved["wz_hand"]).max() == pytest.approx(1.05, abs=1e-6)
    frames = solved.plant("frames", q=solved["q"])
    ends = frames["p"][:, :, 2] + 0.2 * frames["R"][:, :, 6] - [0, 0, 0.5]
    assert solved["length_rubber"] == pytest.approx(np.linalg.norm(ends, axis=1), rel=1e-12)


def test_what_a_mechanism_cannot_turn_is_left_out_or_refused() -> None:
    """A planar arm turns about z alone: of three equations one is left, and z keeps its direction."""
    arm = mbsrun.problem(MODELS / "planar_arm.yaml", horizon=1, intervals=5)
    problem = arm.with_changes(end={"orientations": {"hand": {"rpy": [0, 0, 0.7]}}})
    assert [x.range for x in problem.value.constraints] == [(0.0, 0.0), (0.0, np.inf)]  # 2 cos(a) >= 0
    solved = problem.solve(check=False)
    assert solved["yaw_hand"][-1] == pytest.approx(0.7, abs=1e-9)
    with pytest.raises(ProblemError, match=r"no coordinate turns hand there: an axis stays 1 off"):
        arm.with_changes(end={"orientations": {"hand": {"z": [1, 0, 0]}}})
    tight = problem.with_changes(bounds={"coordinates": {"shoulder": [-0.1, 0.1], "elbow": [-0.1, 0.1]}})
    assert tight.solve(check=False).status == UNREACHABLE


def test_faults_of_orientations_name_their_places(wrist: OptimalControl) -> None:
    for given, finding in (
        ({"hand": {}}, r"end\.orientations\.hand: found nothing; give rpy"),
        ({"hand": {"rpy": [0, 0, 0], "x": [1, 0, 0]}}, r"end\.orientations\.hand: found rpy, x"),
        ({"hand": {"quaternion": [0, 0, 0, 0]}}, r"end\.orientations\.hand: found quaternion"),
        ({"hnd": {"x": [1, 0, 0]}}, r"the model has no sensor \"hnd\"; did you mean \"hand\"\?"),
    ):
        with pytest.raises(ProblemError, match=finding):
            wrist.with_changes(end={"orientations": given})


def stack(aims: Aims) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the axes as columns."""
    return np.array([axis for _, axis in aims]).T


def test_axes_are_the_columns_of_scipys_rotations(rng: np.random.Generator) -> None:
    """Of turns about fixed axes, of quaternions of any length, and of directions of two axes."""
    for _ in range(4):
        angles = rng.uniform(-3, 3, 3)
        R = Rotation.from_euler("xyz", angles).as_matrix()
        assert [k for k, _ in turn_by(*angles)] == [0, 1, 2]
        assert stack(turn_by(*angles)) == pytest.approx(R, abs=1e-14)
        turned = turn_to(*(1.7 * Rotation.from_matrix(R).as_quat()))
        assert turned is not None
        assert stack(turned) == pytest.approx(R, abs=1e-14)
        for i, j in ((0, 1), (1, 2), (0, 2), (2, 0)):
            aims = point({i: 3 * R[:, i], j: 0.1 * R[:, j]})
            assert aims is not None
            assert stack(aims) == pytest.approx(R, abs=1e-14)
    assert turn_to(0, 0, 0, 0) is None
    assert point({0: (1, 0, 0), 1: (0, 0, 0)}) is None
    assert point({0: (1, 0, 0), 1: (1e-8, 1, 0)}) is None
    assert point({0: (1, 0, 0), 1: (1e-10, 1, 0)}) is not None
    assert point({k: np.eye(3)[k] for k in range(3)}) is None
