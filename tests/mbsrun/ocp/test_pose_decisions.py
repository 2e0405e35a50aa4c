"""The rules by which inverse kinematics searches, and by which a motion gets closed loops and inputs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import scipy.optimize
from numpy.typing import NDArray

from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing import guess
from mbsrun.ocp.guessing.guess import (
    Pose,
    _ends_at,
    _Kinematics,
    _pick_different,
    close_motion,
    find_inputs,
    find_pose,
    interpolate,
    make_guess,
    scatter_poses,
)
from mbsrun.ocp.problem.problem import Bounds, Drive, End, GuessOptions, Problem
from tests.mbsrun.ocp.plants import FREE_RANGE, push
from tests.mbsrun.peer import double_integrator

Array = NDArray[np.float64]
INF = np.inf
FRAMES = tuple(SimpleNamespace(name=n, sensor=s) for n, s in (("hand", True), ("hand", False), ("arm", False)))


class Arm:
    """Two links of 1 m in a plane: coordinates turn them about z; then perhaps entries that move nothing."""

    def __init__(self, entries: int = 2, turning: tuple[int, ...] = ()) -> None:
        names = tuple(f"q{i}" for i in range(entries))
        for k in turning:
            names = (*names[:k], *(f"ball.q{x}" for x in "xyzw"), *names[k + 4 :])
        self.manifest = SimpleNamespace(
            frames=FRAMES, positions=names, quaternions=turning, driven=(), dependent=(), coordinates=names
        )
        self.seen: list[Array] = []

    def __call__(self, name: str, *, q: Array) -> dict[str, Array]:
        assert name == "frames"
        self.seen.append(q)
        a, b, zero = q[:, 0], q[:, 0] + q[:, 1], 0 * q[:, 0]
        hand = np.stack((np.cos(a) + np.cos(b), np.sin(a) + np.sin(b), zero), axis=1)
        p = np.stack((hand, zero[:, None] + [7.0, 8, 9], zero[:, None] + [4.0, 5, 6]), axis=2)
        R = np.zeros((len(q), 3, 9))
        for i, angle in enumerate((b, a, zero)):  # x along the link, z of the hand in its plane
            R[:, :, 3 * i] = np.stack((np.cos(angle), np.sin(angle), zero), axis=1)
            R[:, :, 3 * i + 2] = np.stack((-np.sin(angle), np.cos(angle), zero), axis=1)
        return {"p": p, "R": R}


class Tilted(Arm):
    """The axes of all frames point up, except for a number."""

    def __init__(self, off: float) -> None:
        super().__init__()
        self.off = off

    def __call__(self, name: str, *, q: Array) -> dict[str, Array]:
        return {**super().__call__(name, q=q), "R": np.tile([[0.0], [0.0], [1.0]], (len(q), 1, 9)) + self.off}


def task(start: Sequence[float] = (0.3, 0.4), bounds: Sequence[tuple[float, float]] = (), **end: Any) -> Problem:
    n = len(start)
    return replace(
        push(4),
        start_q=tuple(start),
        start_qd=(0.0,) * n,
        bounds=Bounds(tuple(bounds) or (FREE_RANGE,) * n, (FREE_RANGE,) * n, ()),
        end=End(**end),
    )


def kinematics(problem: Problem, arm: Arm | None = None) -> _Kinematics:
    return _Kinematics(problem, cast(Any, arm or Arm(len(problem.start_q))))


def test_residuals_are_distances_from_targets() -> None:
    """Of the sensor of a name, of axes, coordinates, z axes from up, lengths, and 1e-6 of the way from the start."""
    ball = (0.0, 0.6, 0.0, 0.9)
    problem = task(
        (0.3, 0.4, *ball, 0.5),
        sensors=(("hand", (1.0, np.nan, 0.5)),),
        orientations=(("arm", ((0, (0.0, 1.0, 0.0)), (2, (0.0, 0.0, 1.0)))),),
        coordinates=((6, 0.75), (1, 0.25)),
    )
    found = kinematics(problem, Arm(7, (2,)))
    q = np.array([[0.1, 0.2, *ball, 1.0]])
    residual = found.residual(q, [0])[0]
    hand = np.array([np.cos(0.1) + np.cos(0.3), np.sin(0.1) + np.sin(0.3), 0.0])
    assert residual[:3] == pytest.approx([hand[0] - 1, 0.0, -0.5], abs=1e-15)
    assert residual[3:9] == pytest.approx([1, -1, 0, 0, 1, -1], abs=1e-15)
    assert residual[9:11] == pytest.approx([0.25, -0.05], abs=1e-15)
    assert residual[11:14] == pytest.approx([-np.sin(0.3), np.cos(0.3), -1], abs=1e-15)
    assert residual[14] == pytest.approx(np.sqrt(0.36 + 0.81) - 1, abs=1e-15)
    assert residual[15:] == pytest.approx([-2e-7, -2e-7, 0, 0, 0, 0, 5e-7], abs=1e-20)


def test_attitudes_have_the_sign_that_is_nearer() -> None:
    """Of all targets of a quaternion; other coordinates have theirs."""
    problem = task((0.0,) * 7, coordinates=((0, 1.0), (3, 0.6), (4, -0.8), (5, 0.0), (2, 0.0)))
    found = kinematics(problem, Arm(7, (2,)))
    q = np.array([[0, 0, 0, 0.5, 0.6, 0, 9], [0, 0, 0, 0.9, 0.6, 0, 9.0], [0, 0, 0, 0.8, 0.6, 0, 9], [0] * 7])
    assert found.sign(q).tolist() == [[1, -1, -1, -1, -1], [1] * 5, [1] * 5, [1] * 5]


def test_poses_are_given_by_coordinates_where_nothing_else_is_asked() -> None:
    """Others stay at the start, within bounds; not where the given ones leave them."""
    bounds = ((-1.0, 1.0), (0.5, 2.0))
    found = kinematics(task(bounds=bounds, coordinates=((0, 1.0),))).read_coordinates(())
    assert found is not None
    assert (found.q.tolist(), found.distance, found.is_upright) == ([1.0, 0.5], 0.0, True)
    assert kinematics(task(bounds=bounds, coordinates=((0, 1.01),))).read_coordinates(()) is None
    assert kinematics(task(bounds=bounds, coordinates=((1, 0.49),))).read_coordinates(()) is None
    assert kinematics(task(bounds=bounds, coordinates=((0, -1.0), (1, 2.0)))).read_coordinates(()) is not None
    assert kinematics(task()).read_coordinates(("arm",)) is None
    assert kinematics(task(sensors=(("hand", (0.0, 0, 0)),))).read_coordinates(()) is None
    assert kinematics(task(orientations=(("hand", ((0, (0.0, 0, 0)),)),))).read_coordinates(()) is None
    assert kinematics(task((0.0,) * 6), Arm(6, (2,))).read_coordinates(()) is None
    looped = kinematics(task())
    looped.closure = cast(Any, object())
    assert looped.read_coordinates(()) is None


def test_other_poses_are_spread_over_the_bounds() -> None:
    """Half a turn from the start where there is none; of quaternions from -1 to 1; twenty of Halton's sequence."""
    found = kinematics(task((0.5, 2.0, *(0.1,) * 4), [(-1, INF), (-INF, 3), *[FREE_RANGE] * 4]), Arm(6, (2,)))
    lower, upper = found.extent()
    assert lower == pytest.approx([-1, 2 - np.pi, *(-1.0,) * 4])
    assert upper == pytest.approx([0.5 + np.pi, 3, *(1.0,) * 4])
    starts = found.starts()
    assert starts.shape == (20, 6)
    assert starts[0] == pytest.approx(lower)
    assert ((starts - lower) / (upper - lower))[1:3, :2] == pytest.approx(np.array([[1 / 2, 1 / 3], [1 / 4, 2 / 3]]))


def pose(distance: float, is_upright: bool = True) -> Pose:
    return Pose(np.array([distance, float(is_upright)]), distance, is_upright)


@pytest.mark.parametrize(
    ("poses", "chosen", "count"),
    [
        ([pose(1e-6)], 0, 1),
        ([pose(1.0), pose(1e-6)], 1, 2),
        ([pose(1.0), pose(2.0), pose(0.5), pose(0.5, False), pose(0.7)], 2, 21),
        ([pose(0.5, False), pose(0.5), pose(0.5, False)], 1, 21),
        ([pose(1e-6, False), pose(1e-6, False), pose(1e-6)], 2, 3),
        ([pose(1e-6, False), pose(1.0)], 0, 21),
    ],
)
def test_the_nearest_pose_is_returned(poses: list[Pose], chosen: int, count: int) -> None:
    """An upright one of two that are as near; the search ends with the first that is reached and upright."""
    found, starts = kinematics(task()), []

    def descend(start: Array, _: object) -> Pose:
        starts.append(start.tolist())
        return poses[min(len(starts), len(poses)) - 1]

    found.descend = descend  # type: ignore[assignment,method-assign]
    assert found.search(("arm",)) is poses[chosen]
    assert len(starts) == count
    assert starts[0] == [0.3, 0.4]


def test_a_descent_has_exact_enough_slopes_and_moves_what_may_move(monkeypatch: pytest.MonkeyPatch) -> None:
    """Central differences of 1e-6; held coordinates stay; least squares to 1e-12, in at most 100 evaluations."""
    arm, calls = Arm(3), []
    problem = task((0.3, 0.4, 2.0), [(-2, 2), (0.1, 0.2), (2.0, 2.0)], sensors=(("hand", (1.2, 1.1, 0.0)),))

    def squares(residual: Any, x: Array, jacobian: Any, bounds: Any, **given: float) -> Any:
        calls.append((x.tolist(), [b.tolist() for b in bounds], given))
        at, h = residual(x), 1e-4
        slopes = jacobian(x)
        both = arm.seen[-1]
        assert both[:, :2] == pytest.approx(x + 1e-6 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]]), abs=1e-15)
        assert both[:, 2].tolist() == [2.0] * 4
        for k in range(2):
            e = h * np.eye(2)[k]
            assert slopes[:, k] == pytest.approx((residual(x + e) - residual(x - e)) / (2 * h), abs=1e-7)
        assert slopes.shape == (at.size, 2)
        return SimpleNamespace(x=np.array([0.5, 0.15]))

    monkeypatch.setattr(scipy.optimize, "least_squares", squares)
    found = kinematics(problem, arm).descend(np.array([9.0, -9.0, 9.0]), ())
    assert calls == [
        ([2.0, 0.1], [[-2, 0.1], [2, 0.2]], {"xtol": 1e-12, "ftol": 1e-12, "gtol": 1e-12, "max_nfev": 100})
    ]
    assert found.q.tolist() == [0.5, 0.15, 2.0]
    way = np.array([np.cos(0.5) + np.cos(0.65) - 1.2, np.sin(0.5) + np.sin(0.65) - 1.1])
    assert found.distance == pytest.approx(np.hypot(*way))


def test_a_pose_is_as_far_as_its_farthest_target() -> None:
    """Places and axes by their lengths, coordinates and gaps by their sizes; upright to 1e-5."""
    held = [(0.0, 0.0), (0.0, 0.0)]

    def at_rest(**end: Any) -> _Kinematics:
        return kinematics(task((0.0, 0.0), held, **end))

    near = at_rest(sensors=(("hand", (1.7, 0.4, 0.0)),), coordinates=((1, -0.4),))
    assert near.descend(np.zeros(2), ()).distance == pytest.approx(0.5)
    near = at_rest(sensors=(("hand", (1.7, 0.4, 0.0)),), coordinates=((1, -0.6),))
    assert near.descend(np.zeros(2), ()).distance == pytest.approx(0.6)
    axes = at_rest(orientations=(("arm", ((0, (1.0, 0.8, 0.6)),)),))
    assert axes.descend(np.zeros(2), ()).distance == pytest.approx(1.0)
    assert at_rest().descend(np.zeros(2), ()).distance == 0.0
    looped = at_rest(coordinates=((1, -0.4),))
    looped.closure = cast(Any, SimpleNamespace(dependent=[0], gaps=lambda q: np.full((len(q), 1), -0.7)))
    assert looped.descend(np.zeros(2), ()).distance == pytest.approx(0.7)
    tilted = at_rest()
    for off, is_upright in ((0.9e-5, True), (1.1e-5, False)):
        tilted.plant = cast(Any, Tilted(off))
        assert tilted.descend(np.zeros(2), ("arm",)).is_upright is is_upright
        assert tilted.descend(np.zeros(2), ("arm",)).distance == 0.0


def test_a_pose_that_cannot_be_upright_is_searched_without(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it is reached so, or not, the first one is returned."""
    asked: list[Any] = []
    ends: Iterator[Pose] = iter([pose(1e-6, False), pose(1.0), pose(2.0)])

    def search(_: object, upright: tuple[str, ...]) -> Pose:
        asked.append(upright)
        return next(ends)

    monkeypatch.setattr(_Kinematics, "search", search)
    problem = replace(task(), guess=GuessOptions(upright=("arm",)))
    assert find_pose(problem, cast(Any, Arm())).distance == 1e-6
    assert find_pose(problem, cast(Any, Arm())).distance == 2.0
    assert asked == [("arm",), ("arm",), ()]


def test_poses_are_scattered_within_the_bounds_until_one_is_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    starts: list[Array] = []

    def descend(_: object, start: Array, __: object) -> Pose:
        starts.append(start)
        return pose(2.0 - len(starts))

    monkeypatch.setattr(_Kinematics, "descend", descend)
    problem = task(bounds=[(-1.0, 1.0), (5.0, 6.0)])
    found = scatter_poses(problem, cast(Any, Arm()), np.random.default_rng(0), 5)
    assert found is not None
    assert (found[0], len(starts)) == (0.0, 2)
    drawn = np.random.default_rng(0).uniform([-1, 5], [1, 6], (2, 2))
    assert np.array(starts) == pytest.approx(drawn)
    starts.clear()
    assert scatter_poses(problem, cast(Any, Arm()), np.random.default_rng(0), 1) is None
    assert len(starts) == 1


def test_driven_coordinates_are_where_they_are_at_the_end() -> None:
    """Of a joint that moves by t**2 within 3 s: 9, whatever the start and the bounds say."""
    arm = Arm(2)
    arm.manifest.driven = (1,)
    problem = replace(task(coordinates=((0, 0.5),)), horizon=3.0, driven=(Drive(1, "t**2"),))
    found = kinematics(problem, arm)
    assert found.start.tolist() == [0.3, 9.0]
    assert (found.lower[1], found.upper[1]) == (9.0, 9.0)
    assert found.free.tolist() == [True, False]
    assert found.held == [0, 1]


def test_a_guessed_start_takes_the_place_of_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """And a motion without a way to the pose has none."""
    plant, scheme = double_integrator(), schemes.build(Family.RADAU, 2)
    options = GuessOptions(motion="line", inputs="zero", start=((0, 2.0),), end=((0, 4.0),))
    found = make_guess(replace(push(2), guess=options), plant, scheme)
    assert isinstance(found, Trajectory)
    assert found.q[:, 0].tolist() == [2.0, 3.0, 4.0]
    still = make_guess(replace(push(2), guess=replace(options, motion="rest")), plant, scheme)
    assert isinstance(still, Trajectory)
    assert still.q[:, 0].tolist() == [2.0, 2.0, 2.0]
    monkeypatch.setattr(guess, "interpolate", lambda *_: replace(found, point_q=np.nan * found.point_q))
    lost = make_guess(replace(push(2), guess=options), plant, scheme)
    assert isinstance(lost, Pose)
    assert (lost.has_way, lost.is_reached, lost.is_upright, lost.distance) == (False, True, True, 0.0)


# --- closed loops: q = (x, y), y = 2 x ---


class Rods:
    """A closure of y = 2 x, which notes what it follows."""

    def __init__(self, fails: Sequence[bool] = (), off: float = 0.0, driven: tuple[int, ...] = ()) -> None:
        self.manifest = SimpleNamespace(
            driven=driven, positions=("x", "y"), quaternions=(), coordinates=("x", "y"), configuration=()
        )
        self.independent, self.places_independent = [0], [0]
        self.fails, self.off, self.calls = list(fails), off, list[Any]()

    def follow(self, path: Array, start: Array, held: list[int]) -> Array | None:
        self.calls.append((path.tolist(), start.tolist(), list(held)))
        if self.fails.pop(0) if self.fails else False:
            return None
        closed = np.stack((path[:, 0], 2 * path[:, 0]), axis=1) if held == [0] else path + 100.0
        closed[-1] += self.off
        return closed

    def complete_velocities(self, q: Array, given: list[int], values: Array) -> Array:
        self.calls.append(("complete qd", q.shape, given, values.tolist()))
        return np.hstack((values, 2 * values))

    def complete_accelerations(self, q: Array, qd: Array, given: list[int], values: Array) -> Array:
        self.calls.append(("complete qdd", q.tolist(), qd.tolist(), given))
        return np.hstack((values, 2 * values))

    def project_velocities(self, q: Array, qd: Array, held: list[int]) -> Array:
        self.calls.append(("project qd", q.shape, held))
        return qd + 10.0

    def project_accelerations(self, q: Array, qd: Array, qdd: Array, held: list[int]) -> Array:
        self.calls.append(("project qdd", q.tolist(), qd.tolist(), held))
        return qdd + 20.0


def moving(end: float = 6.0) -> Trajectory:
    """Move from (1, 2) to (3, end) within 2 s, by 2 intervals with a point in their middle, and one at their end."""
    t, point_t = np.array([0.0, 1, 2]), np.array([[0.5, 1.0], [1.5, 2.0]])

    def read(t: Array) -> Array:
        return np.stack((1 + t, 2 + (end - 2) / 2 * t), axis=-1)

    qd = np.array([1.0, 2.0])
    return Trajectory(
        t, read(t), np.tile(qd, (3, 1)), np.zeros((2, 0)), point_t, read(point_t), np.tile(qd, (2, 2, 1)),
        np.tile([0.5, 7.0], (2, 2, 1)),
    )  # fmt: skip


def test_independent_coordinates_lead_where_the_motion_ends_at_its_pose() -> None:
    """In the order of time, each mesh point before the collocation point with it; rates follow at all of them."""
    rods = Rods()
    found = close_motion(moving(), cast(Any, rods))
    times = [0.0, 0.5, 1, 1, 1.5, 2, 2]
    assert rods.calls[0] == ([[1 + t, 2 + 2 * t] for t in times], [1, 2], [0])
    assert rods.calls[1] == ("complete qd", (7, 2), [0], [[1.0]] * 7)
    assert rods.calls[2] == ("complete qdd", [[1.5, 3], [2, 4], [2.5, 5], [3, 6]], [[1, 2]] * 4, [0])
    assert len(rods.calls) == 3
    assert found.q.tolist() == moving().q.tolist()
    assert found.point_q.tolist() == moving().point_q.tolist()
    assert found.qd.tolist() == [[1, 2]] * 3
    assert found.point_qd.tolist() == [[[1, 2]] * 2] * 2
    assert found.point_qdd.tolist() == [[[0.5, 1]] * 2] * 2


@pytest.mark.parametrize("rods", [Rods([True]), Rods(off=1.1e-5), Rods([True], driven=(1,))])
def test_all_coordinates_move_where_independent_ones_lead_elsewhere(rods: Rods) -> None:
    """Each pose is closed then, with driven joints alone held; the end may be another one."""
    found = close_motion(moving(), cast(Any, rods))
    driven = list(rods.manifest.driven)
    assert [call[2] for call in rods.calls[:2]] == [[0], driven]
    assert rods.calls[2] == ("project qd", (7, 2), driven)
    assert rods.calls[3][0] == "project qdd"
    assert rods.calls[3][3] == driven
    assert len(rods.calls) == 4
    assert found.q[:2] == pytest.approx(moving().q[:2] + 100)
    assert found.point_q[0] == pytest.approx(moving().point_q[0] + 100)
    assert rods.calls[3][1] == found.point_q.reshape(4, 2).tolist()
    assert found.qd.tolist() == [[11, 12]] * 3
    assert rods.calls[3][2] == [[11, 12]] * 4
    assert found.point_qdd.tolist() == [[[20.5, 27]] * 2] * 2


def test_a_motion_that_cannot_be_closed_has_no_numbers() -> None:
    found = close_motion(moving(), cast(Any, Rods([True, True])))
    assert np.isnan(found.point_q).all()
    assert found.point_q.shape == (2, 2, 2)


def test_ends_are_the_same_to_1e_5() -> None:
    assert _ends_at(np.array([1.0, 2.0]), np.array([1.0, 2.0 + 0.99e-5]))
    assert not _ends_at(np.array([1.0, 2.0]), np.array([1.0, 2.0 - 1.01e-5]))
    assert _ends_at(np.zeros(0), np.zeros(0))


# --- inputs ---


class Residual:
    """Phi = qdd + 3 qd - B u - W w, of two coordinates, with loops and driven joints."""

    def __init__(self, B: Array, dependent: tuple[int, ...] = (), driven: tuple[int, ...] = ()) -> None:
        self.B, self.W = B, np.array([[5.0, 0.0], [0.0, 2.0]])
        self.manifest = SimpleNamespace(
            actuated=tuple(range(B.shape[1])), dependent=dependent, driven=driven, coordinates=("x", "y"),
            positions=("x", "y"), independent=(), owners=(0,) * len(dependent), quaternions=(), configuration=(),
        )  # fmt: skip

    def __call__(self, name: str, **given: Array) -> dict[str, Array]:
        n = len(given["q"])
        if name == "loop_jacobian":
            return {"J": np.tile([[2.0, -1.0]], (n, 1, 1))}
        assert given["u"].tolist() == [[0.0] * self.B.shape[1]] * n
        if name == "impl":
            w = given.get("w", np.zeros((n, 2)))
            return {"Phi": given["qdd"] + 3 * given["qd"] - w @ self.W.T}
        return {"jac_Phi_u": np.tile(-self.B, (n, 1, 1)), "jac_Phi_w": np.tile(-self.W, (n, 1, 1))}


def test_inputs_leave_the_least_of_the_residual() -> None:
    """One input on both coordinates: the mean; open components are given, or found behind the inputs."""
    one = Residual(np.array([[1.0], [1.0]]))
    q, qd, qdd = np.zeros((3, 2)), np.array([[1.0, 0], [0, 1], [0, 0]]), np.array([[1.0, 2], [0, 0], [5, 7]])
    found = find_inputs(cast(Any, one), q, qd, qdd)
    assert found[:, 0] == pytest.approx([3.0, 1.5, 6.0])
    w = np.tile([1.0, -1.0], (3, 1))
    found = find_inputs(cast(Any, one), q, qd, qdd, w)
    assert found[:, 0] == pytest.approx([1.5, 0.0, 4.5])
    found = find_inputs(cast(Any, one), q, qd, qdd, 0 * w, [1])
    assert found == pytest.approx(np.array([[4, -1], [0, 1.5], [5, 1]]))
    spoilt = Residual(np.array([[np.nan], [1.0]]))
    assert find_inputs(cast(Any, spoilt), q, qd, qdd).tolist() == [[0.0]] * 3
    assert find_inputs(cast(Any, spoilt), q, qd, qdd, w, [1]).tolist() == [[0.0] * 2] * 3


def test_loops_and_driven_joints_bear_their_part() -> None:
    """Along y = 2 x: (1, 2)'(Phi - B u) = 0; with a driven y the x alone counts."""
    q, qd, qdd = np.zeros((2, 2)), np.zeros((2, 2)), np.array([[1.0, 2.0], [3.0, -1.0]])
    looped = Residual(np.array([[1.0], [0.0]]), dependent=(1,))
    assert find_inputs(cast(Any, looped), q, qd, qdd)[:, 0] == pytest.approx([5.0, 1.0])
    driven = Residual(np.array([[2.0], [9.0]]), driven=(1,))
    assert find_inputs(cast(Any, driven), q, qd, qdd)[:, 0] == pytest.approx([0.5, 1.5])


def test_equal_matrices_are_inverted_once() -> None:
    B = np.array([[[1.0, 2]], [[1, 2]], [[1, 2]]])
    assert _pick_different(B).shape == (1, 1, 2)
    B[2, 0, 1] = 3
    assert _pick_different(B).shape == (3, 1, 2)
    assert _pick_different(B[:0]).shape == (0, 1, 2)


def test_quaternions_need_their_plant() -> None:
    problem = replace(push(2), start_q=(0.0, 0, 0, 1), start_qd=(0.0,) * 3)
    assert problem.has_quaternions
    with pytest.raises(ValueError, match="give the plant"):
        interpolate(problem, schemes.build(Family.RADAU, 2), np.zeros(4))
