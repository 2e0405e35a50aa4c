"""Re-simulations by equations as a whole: balances of all forces, exact motions, and what is put back."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.contacts import Held
from mbsrun.ocp.problem.problem import Bounds, End, Loops, Problem
from mbsrun.ocp.solution.solution import Resimulation, Solution
from mbsrun.ocp.solving.resimulation import Constant, Course, Replay, _balance, integrate, resimulate
from tests.mbsrun.ocp.exact_motions import MESH, PUSHES, T, push_rails, push_sled, rails, sled
from tests.mbsrun.ocp.plants import FREE_RANGE, push
from tests.mbsrun.peer import Peer, double_integrator

Array = NDArray[np.float64]


class Everything:
    """Five coordinates: a loop holds the second one, the third is driven, contacts hold the fourth.

    Phi = M qdd + c - B u - W w - J' lam - D tau, with numbers that nothing changes.
    """

    def __init__(self) -> None:
        rng = np.random.default_rng(5)
        root = rng.normal(size=(5, 5))
        self.M, self.c = root @ root.T + np.eye(5), rng.normal(size=5)
        self.B, self.W, self.J = rng.normal(size=(5, 2)), rng.normal(size=(5, 3)), rng.normal(size=(1, 5))
        self.Jc, self.turning, self.gamma = rng.normal(size=(3, 5)), rng.normal(size=(3, 5)), rng.normal(size=1)
        self.manifest = SimpleNamespace(
            coordinates=tuple("abcde"), positions=tuple("abcde"), quaternions=(), configuration=(), independent=(0,),
            dependent=(1,), owners=(0,), driven=(2,), actuated=(0, 4),
        )  # fmt: skip

    def __call__(self, name: str, **given: Array) -> dict[str, Array]:
        n = len(given["q"])
        if name == "jac_impl":
            return {"jac_Phi_qdd": np.tile(self.M, (n, 1, 1)), "jac_Phi_w": np.tile(-self.W, (n, 1, 1))}
        if name == "impl":
            assert not given["qdd"].any()
            assert not given["lam"].any()
            assert not given["tau"].any()
            return {"Phi": self.c - given["u"] @ self.B.T - given["w"] @ self.W.T}
        if name == "loop_jacobian":
            return {"J": np.tile(self.J, (n, 1, 1)), "gamma": np.tile(self.gamma, (n, 1))}
        assert name == "jac_motion"
        return {"jac_v_q": np.tile(self.turning, (n, 1, 1)), "jac_v_qd": np.tile(self.Jc, (n, 1, 1))}


@pytest.mark.parametrize("drags", [(), ((0, 0, 0.5),)])
def test_all_forces_balance_and_keep_their_conditions(drags: tuple[tuple[int, int, float], ...]) -> None:
    """Of loops, driven joints and contacts together; what a contact had before does not count."""
    plant, held, rng = Everything(), Held([1], [2], drags), np.random.default_rng(6)
    q, qd, u, w = (rng.normal(size=(3, k)) for k in (5, 5, 2, 3))
    parts = {"u": u, "w": w, "a": np.array([[1.0], [-2.0], [0.5]])}
    qdd, forces = _balance(cast(Any, plant), q, qd, parts, held)
    assert (plant.J @ qdd.T + plant.gamma).tolist() == [pytest.approx([0.0] * 3, abs=1e-12)]
    assert qdd[:, 2] == pytest.approx(parts["a"][:, 0], abs=1e-12)
    assert plant.Jc[1] @ qdd.T == pytest.approx(-(qd @ plant.turning[1]), abs=1e-12)
    assert forces["tau"].shape == (3, 1)
    known = qdd @ plant.M.T + plant.c - u @ plant.B.T - forces["w"] @ plant.W.T
    known[:, 2] -= forces["tau"][:, 0]
    lam = known @ plant.J[0] / (plant.J[0] @ plant.J[0])
    assert known == pytest.approx(lam[:, None] * plant.J, abs=1e-11)
    if drags:
        assert forces["w"][:, 0] == pytest.approx(0.5 * forces["w"][:, 2])
    else:
        assert forces["w"][:, :2] == pytest.approx(w[:, :2])


def solution(problem: Problem, motion: Trajectory) -> Solution:
    none = cast(Any, None)
    return Solution(problem, "by hand", "", (), (), none, none, none, none, motion)


def check(problem: Problem, motion: Trajectory, plant: Peer) -> Resimulation:
    found = resimulate(solution(problem, motion), plant).resimulation
    assert found is not None
    return found


@pytest.mark.parametrize("family", [Family.RADAU, Family.LEGENDRE])
def test_an_exact_motion_of_everything_has_no_defect(family: Family) -> None:
    """Given forces and motions, a contact, a state, a control and an unknown; z is where it is to be at all times."""
    problem, motion = push_sled(family)
    found = check(problem, motion, sled())
    assert found.defect is not None
    assert found.defect < 1e-11
    assert found.open_loop_error is not None
    assert found.open_loop_error < 1e-11
    assert found.is_accurate
    assert found.closure is None
    assert found.slip == pytest.approx(0.0, abs=1e-12)
    assert found.slip_along == pytest.approx(0.0, abs=1e-11)
    assert len(found.defects) == 3
    states = motion.states.copy()
    states[3] += 3e-6
    wrong = check(problem, Trajectory(**{**vars(motion), "states": states}), sled())
    assert wrong.defects == pytest.approx([0, 0, 3e-6], abs=1e-10)
    assert wrong.defect_interval == 2
    assert not wrong.is_accurate


def test_an_exact_motion_keeps_its_loop_closed() -> None:
    problem = Problem(
        **{
            **vars(push(3)), "horizon": T, "mesh": MESH, "start_q": (0.3, 0.6), "start_qd": (0.5, 1.0), "end": End(),
            "bounds": Bounds((FREE_RANGE,) * 2, (FREE_RANGE,) * 2, (FREE_RANGE,)), "loops": Loops.REDUCED,
        }
    )  # fmt: skip
    motion = push_rails(problem)
    found = check(problem, motion, rails())
    assert found.defect == pytest.approx(0, abs=1e-11)
    assert found.open_loop_error == pytest.approx(0, abs=1e-11)
    assert found.closure == pytest.approx(0, abs=1e-12)
    assert found.is_accurate


def test_courses_read_inputs_at_any_time() -> None:
    """Constant ones, and polynomials through the values at points: of u_y = 1 + 2 t, w_y = -u_y; pieces agree."""
    problem, motion = push_sled(Family.RADAU)
    course = Course(problem, motion, sled())
    k, s = np.array([2, 0]), np.array([[0.1], [0.3]])
    t = motion.t[k, None] + s
    parts = course.inputs(2, 0).read(s, np.zeros((2, 3)), np.tile([2.0, 0, 0], (2, 1)), np.zeros((2, 1)))
    assert parts["t"] == pytest.approx(t)
    assert parts["T"].tolist() == [[T], [T]]
    assert parts["u"] == pytest.approx(np.hstack((PUSHES[k, None] - 0.2, 1 + 2 * t)))
    assert parts["w"] == pytest.approx(np.hstack((0 * t + 0.3 * 2 + 0.2, -1 - 2 * t, 0 * t + 0.7)))
    assert parts["controls"] == pytest.approx(motion.controls[k])
    assert parts["unknowns"].tolist() == [[3.0], [3.0]]
    assert parts["q"][:, 2:] == pytest.approx(0.4 * t**2 + 0.1 * t)
    assert parts["qd"][:, 2:] == pytest.approx(0.8 * t + 0.1)
    assert parts["a"] == pytest.approx(0 * t + 0.8)
    q, qd = course.inputs().place(np.zeros((3, 1)), np.ones((3, 3)), np.ones((3, 3)))
    assert q == pytest.approx(np.column_stack((np.ones((3, 2)), 0.4 * motion.t[:-1] ** 2 + 0.1 * motion.t[:-1])))
    assert qd == pytest.approx(np.column_stack((np.ones((3, 2)), 0.8 * motion.t[:-1] + 0.1)))
    piece = course.piece(2)
    assert (piece.start, piece.end) == (motion.t[2], motion.t[3])
    assert piece.values(t[0])[0, 1:2] == pytest.approx(1 + 2 * t[0])
    assert piece.law is not None
    assert piece.law(t[0], np.zeros((1, 3)), np.array([[2.0, 0, 0]])) == pytest.approx(
        np.hstack((parts["u"][:1], parts["w"][:1]))
    )
    assert not piece.is_constant
    gathered = course.gather(k, s[:, 0], np.zeros((2, 6)))
    assert gathered["states"].tolist() == [[0.0], [0.0]]


class Going:
    """Intervals of 1 s whose ends are given; None where a motion fails, by interval and whether it began closed."""

    def __init__(self, ends: dict[tuple[int, bool], Sequence[float] | None]) -> None:
        self._lengths, self._course, self.ends = (
            np.ones(4),
            SimpleNamespace(trajectory=SimpleNamespace(t=np.arange(5.0))),
            ends,
        )
        self.seen: list[tuple[int, list[float], bool]] = []

    def _go_on(self, k: int, state: Array, gaps: list[float], *, is_closed: bool) -> Array | None:
        self.seen.append((k, state.tolist(), is_closed))
        gaps.append(0.25 if k == 1 else 0.125)
        end = self.ends.get((k, is_closed), self.ends.get((k, True)))
        return None if end is None else np.array(end)


STATES = np.array([[0.0, 0.0], [1, 0], [2, 8], [3, 0], [4, 0]])


def test_a_motion_goes_on_from_where_it_is() -> None:
    going = Going({(k, True): [k + 1.9, 3.0] for k in range(4)})
    found = Replay.go_through(cast(Any, going), STATES)
    assert found is not None
    assert found.reached.tolist() == [[0, 0], [1.9, 3], [2.9, 3], [3.9, 3], [4.9, 3]]
    assert (found.gap, found.lost) == (0.25, ())
    assert [seen[0] for seen in going.seen] == [0, 1, 2, 3]
    assert [seen[2] for seen in going.seen] == [False, True, True, True]


def test_a_motion_that_is_lost_goes_on_from_the_solution() -> None:
    """Farther away than the range of a state, 1 at least: 4 of the first, 8 of the second; at the end it stays."""
    going = Going({(0, True): [5.0, 8.0], (1, True): [6.01, 8.0], (2, True): [3.0, 8.01], (3, True): [99.0, 0]})
    found = Replay.go_through(cast(Any, going), STATES)
    assert found is not None
    assert found.lost == (2.0, 3.0)
    assert found.reached.tolist() == [[0, 0], [5, 8], [2, 8], [3, 0], [99, 0]]
    assert going.seen == [(0, [0, 0], False), (1, [5, 8], True), (2, [2, 8], False), (3, [3, 0], False)]
    small = Going({(k, True): [0.99 if k == 1 else 1.01 if k == 2 else 0.0] for k in range(4)})
    found = Replay.go_through(cast(Any, small), np.zeros((5, 1)))
    assert found is not None
    assert found.lost == (3.0,)


def test_a_motion_that_fails_is_tried_from_the_solution() -> None:
    """Once; where that fails too, there is none."""
    ends: dict[tuple[int, bool], Sequence[float] | None] = {(k, True): [k + 1.5, 0] for k in range(4)}
    going = Going({**ends, (2, True): None, (2, False): [3.5, 0]})
    found = Replay.go_through(cast(Any, going), STATES)
    assert found is not None
    assert found.lost == (2.0,)
    assert found.reached.tolist() == [[0, 0], [1.5, 0], [2, 8], [3.5, 0], [4.5, 0]]
    assert going.seen[2:4] == [(2, [2.5, 0], True), (2, [2, 8], False)]
    assert going.seen[4] == (3, [3.5, 0], True)
    assert Replay.go_through(cast(Any, Going({**ends, (2, True): None, (2, False): None})), STATES) is None
    first = Going({**ends, (0, True): None})
    assert Replay.go_through(cast(Any, first), STATES) is None
    assert len(first.seen) == 1


def test_motions_of_different_durations_end_together() -> None:
    """Each after its own time; steps are read by fractions of it; constant inputs move no joint and no state."""
    taken = list[Any]()
    states, u = np.array([[0.0, 1.0], [2.0, -1.0]]), np.array([[2.0], [-4.0]])
    ends = integrate(double_integrator(), states, Constant(u), np.array([0.5, 2.0]), taken=taken)
    assert ends is not None
    assert ends == pytest.approx(np.array([[0.75, 2.0], [2 - 2 - 8, -9.0]]), abs=1e-12)
    assert taken[-1].end == 1.0
    assert (taken[-1].duration, taken[-1].shape) == (2.0, (2, 2))
    middle = taken[-1].read(np.array([0, 1]), np.array([1.0, 1.0]))
    assert middle == pytest.approx(ends, abs=1e-12)
    fixed = Constant(u)
    assert fixed.rates({"u": u}).shape == (2, 0)
    assert fixed.read(u, states, states, states)["w"].shape == (2, 0)
    assert fixed.place(u, states, u)[1] is u
