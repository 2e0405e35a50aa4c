"""SciPy's steps by hand: an oscillator under inputs that are held, vary, or follow the state; limits; stiffness."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.kernel import KernelError, Place
from mbsrun.limits import Allowance, Limits
from mbsrun.simulation.drive import DriveError, Piece, hold
from mbsrun.simulation.dynamics import SingularError
from mbsrun.simulation.integration.adaptive import _gather, _make_solver, _step, find_stability, integrate
from mbsrun.simulation.integration.steps import count_steps, describe_singularity, find_longest, place_steps, sample
from mbsrun.simulation.motion import Chunk, Effort, HaltError, Settings

Array = NDArray[np.float64]


class Spring:
    """Two masses on springs, qdd = -k q - d qd + v; accelerations fail where q > `stop`."""

    def __init__(self, k: Any = (4.0, 9.0), d: Any = (0.0, 0.0), stop: float = np.inf) -> None:
        self.k, self.d, self.stop = np.array(k), np.array(d), stop
        self.places, self.effort = 2, Effort()
        self.course = SimpleNamespace(is_constant=True)
        joints = [SimpleNamespace(name="a"), SimpleNamespace(name="b")]
        self.kernels = SimpleNamespace(manifest=SimpleNamespace(coordinates=joints))

    def rates(self, _: Array, qd: Array) -> Array:
        return qd

    def accelerations(self, q: Array, qd: Array, v: Array) -> Array:
        if q[0] > self.stop:
            raise SingularError("a")
        return -self.k * q - self.d * qd + v

    def rate_slopes(self, *_: Array) -> tuple[Array, Array]:
        return np.zeros((2, 2)), np.eye(2)

    def slopes(self, *_: Array) -> tuple[Array, Array]:
        return -np.diag(self.k), -np.diag(self.d)


def play(dynamics: Any, piece: Piece, *start: Any, steps: int = 10_000, stepper: str = "LSODA") -> list[Chunk]:
    q, qd = (np.array(x, dtype=float) for x in start)
    settings, allowance = Settings(piece.end, rtol=1e-10, atol=1e-10), Allowance(Limits(steps))
    return list(integrate(stepper, dynamics, piece, q, qd, settings, allowance))


def held(end: float, *values: float) -> Piece:
    return Piece(0.0, end, hold(values).pieces[0].values, True)


def test_inputs_are_held_vary_or_follow_the_state() -> None:
    """The rates (qd, -k q + v), with v of the piece's beginning, of the time, or of time and state."""
    y = np.array([1.0, 2.0, 3.0, 4.0])
    varying = Piece(0.5, 2.0, lambda t: np.column_stack((t, 10 * t)), False)
    law = Piece(0.5, 2.0, varying.values, False, lambda t, q, qd: t[:, None] + q + 2 * qd)
    for piece, v in ((held(2.0, 5.0, 6.0), [5.0, 6.0]), (varying, [1.5, 15.0]), (law, [8.5, 11.5])):
        solver = _make_solver("Radau", Spring(), piece, y, Settings(2.0))  # type: ignore[arg-type]
        assert solver.fun(1.5, y).tolist() == [3.0, 4.0, -4.0 + v[0], -18.0 + v[1]]
        assert (solver.t, solver.t_bound) == (piece.start, piece.end)
        assert solver.max_step == (np.inf if piece.is_constant else 2.0 / 100)
        slopes = np.array(solver.J, dtype=float)
        exact = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag([4.0, 9.0]), np.zeros((2, 2))]])
        if piece.law is not None:
            exact[2:] += np.hstack((np.eye(2), 2 * np.eye(2)))
        np.testing.assert_allclose(slopes, exact, atol=0 if piece.law is None else 1e-5)


@pytest.mark.parametrize("stepper", ["LSODA", "Radau", "BDF"])
def test_springs_swing_as_cosines_at_ends_of_steps_and_between_them(stepper: str) -> None:
    dynamics = Spring()
    chunks = play(dynamics, held(3.0, 4.0, 0.0), [2.0, 1.0], [0.0, 0.0], stepper=stepper)
    assert (chunks[0].t[0], chunks[-1].t[-1]) == (0.0, 3.0)
    for before, after in itertools.pairwise(chunks):
        assert before.t[-1] == after.t[0]
        assert before.q[-1].tolist() == after.q[0].tolist()
    assert dynamics.effort.steps == sum(len(chunk.t) - 1 for chunk in chunks)
    assert dynamics.effort.rejected is None
    for chunk in chunks:
        assert len(chunk.t) <= 129
        for t, q, qd in ((chunk.t, chunk.q, chunk.qd), _read_between(chunk)):
            np.testing.assert_allclose(q, np.column_stack((1 + np.cos(2 * t), np.cos(3 * t))), atol=2e-6)
            np.testing.assert_allclose(qd, np.column_stack((-2 * np.sin(2 * t), -3 * np.sin(3 * t))), atol=2e-5)


def _read_between(chunk: Chunk) -> tuple[Array, Array, Array]:
    assert chunk.dense is not None
    t = (chunk.t[:-1] + chunk.t[1:]) / 2
    order = np.random.default_rng(1).permutation(len(t))
    return t[order], *chunk.dense(t[order], order)


def test_pictures_of_steps_are_read_by_their_steps() -> None:
    chunk = _gather(
        [0.0, 1.0, 2.0], [np.zeros(3)] * 3, [lambda t, k=k: np.stack((t, t + k, t * k)) for k in (10, 20)], 2
    )
    assert chunk.dense is not None
    q, qd = chunk.dense(np.array([0.5, 1.5, 0.25]), np.array([0, 1, 0]))
    assert q.tolist() == [[0.5, 10.5], [1.5, 21.5], [0.25, 10.25]]
    assert qd.tolist() == [[5.0], [30.0], [2.5]]


def test_a_motion_keeps_its_steps_before_the_limit_or_a_singular_pose() -> None:
    for dynamics, steps, found in (
        (Spring(), 7, "the limit of 7 steps is reached"),
        (Spring(stop=1.9), 10_000, "the accelerations cannot be computed here"),
    ):
        chunks: list[Chunk] = []
        q, qd = np.array([1.0, 0.0]), np.array([2.0, 0.0])
        with pytest.raises(HaltError) as error:  # noqa: PT012
            for chunk in integrate(
                "LSODA", dynamics, held(3.0, 4.0, 0.0), q, qd, Settings(3.0), Allowance(Limits(steps))  # type: ignore[arg-type]
            ):  # fmt: skip
                chunks.append(chunk)
        assert found in error.value.halt.finding
        assert error.value.halt.time == chunks[-1].t[-1] > 0


def test_inputs_without_a_value_end_a_motion_where_they_follow_the_state() -> None:
    """Over time alone they are an error of whoever gave them."""

    def fail(t: Array, *_: Array) -> Array:
        if (t > 0.5).any():
            raise DriveError("no value", "mend it")
        return np.zeros((len(t), 2))

    with pytest.raises(HaltError, match="no value; mend it"):
        play(Spring(), Piece(0.0, 1.0, fail, False, fail), [1.0, 0.0], [0.0, 0.0])
    with pytest.raises(DriveError, match="no value"):
        play(Spring(), Piece(0.0, 1.0, fail, False), [1.0, 0.0], [0.0, 0.0])


@pytest.mark.parametrize(
    ("y", "status", "message", "joint", "finding"),
    [
        ([9.0, 8, 3, -5], "failed", "Too small.", "b", "too small"),
        ([9.0, 8, -6, -5], "running", "Odd.", "a", "odd"),
        ([9.0, 8, -6, np.nan], "running", None, "b", "the motion diverges: its numbers overflow"),
        ([np.inf, 8, 1, 2], "running", None, "b", "the motion diverges: its numbers overflow"),
    ],
)
def test_motions_that_no_step_goes_on_name_their_fastest_joint(
    y: list[float], status: str, message: str | None, joint: str, finding: str
) -> None:
    solver = SimpleNamespace(y=np.array(y), t=2.5, status=status, step=lambda: message)
    with pytest.raises(HaltError) as error:
        _step(solver, Spring())  # type: ignore[arg-type]
    halt = error.value.halt
    assert (halt.time, halt.joint, halt.finding) == (2.5, joint, finding)
    _step(SimpleNamespace(y=np.zeros(4), t=2.5, status="running", step=lambda: None), Spring())  # type: ignore[arg-type]


def test_the_fastest_decay_and_its_joint() -> None:
    """lambda^2 + d lambda + k = 0: -1 and -99 of b; a motion that only grows or swings has none."""
    q = np.zeros(2)
    rate, joint = find_stability(Spring((5.0, 99.0), (2.0, 100.0)), q, q, q)  # type: ignore[arg-type]
    assert (rate, joint) == (pytest.approx(99.0), "b")
    rate, joint = find_stability(Spring((99.0, 5.0), (100.0, 2.0)), q, q, q)  # type: ignore[arg-type]
    assert (rate, joint) == (pytest.approx(99.0), "a")
    assert find_stability(Spring((4.0, 9.0), (-1.0, -1.0)), q, q, q)[0] == 0.0  # type: ignore[arg-type]
    assert find_stability(Spring((np.nan, 9.0)), q, q, q) == (0.0, "a")  # type: ignore[arg-type]


# --- steps of a fixed length ----------------------------------------------------------------------------------------


def test_steps_of_a_piece_are_equal_and_none_is_longer() -> None:
    piece = Piece(0.5, 1.1, lambda t: 10 * t[:, None], False)
    assert [count_steps(piece, h) for h in (0.6, 0.2, 0.21, 0.19, 9.0)] == [1, 3, 3, 4, 1]
    assert place_steps(piece, np.array([0, 1, 3]), 3).tolist() == [0.5, 0.5 + (1.1 - 0.5) / 3, 1.1]
    assert sample(piece, np.array([0.5, 0.75])).tolist() == [[5.0], [7.5]]
    assert sample(held(1.0, 3.0), np.array([0.5, 0.75])).tolist() == [[3.0]]


def test_steps_of_motions_that_vary_are_at_most_a_hundredth_of_the_duration() -> None:
    varying, still, moving = (
        Piece(0.0, 1.0, lambda t: t[:, None], False),
        SimpleNamespace(is_constant=True),
        SimpleNamespace(is_constant=False),
    )
    constant = held(1.0, 3.0)
    assert find_longest(8.0, constant, still) == np.inf  # type: ignore[arg-type]
    found = [find_longest(8.0, x, y) for x, y in ((varying, still), (constant, moving), (varying, moving))]  # type: ignore[arg-type]
    assert found == [0.08] * 3


def test_singular_poses_are_of_a_joint_or_of_a_loop() -> None:
    for place, joint, loop, word in (
        (SingularError("hip"), "hip", None, "mass matrix is singular"),
        (Place("hip", None, 1), "hip", None, "mass matrix is singular"),
        (KernelError("exp2", Place(None, "cut", 3), 0), None, "cut", "depend on others"),
    ):
        halt = describe_singularity(place, 2.5)
        assert (halt.time, halt.joint, halt.loop, word in halt.finding) == (2.5, joint, loop, True)
