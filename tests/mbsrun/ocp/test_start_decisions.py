"""Random starts by hand: what is drawn, how large, and what is made of it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing import starts
from mbsrun.ocp.guessing.guess import Pose, interpolate
from mbsrun.ocp.guessing.starts import (
    Variation,
    _close,
    _move,
    add_noise,
    add_waves,
    coarsen,
    count_turns,
    describe_starts,
    describe_turns,
    disturb,
    hop,
    list_turning,
    vary,
)
from mbsrun.ocp.guessing.state_guess import complete
from mbsrun.ocp.problem.problem import Bounds, Control, End, Form, GuessOptions, Problem, State
from mbsrun.ocp.solution.solution import Start, Starts
from tests.mbsrun.ocp.plants import FREE_RANGE, push
from tests.mbsrun.peer import double_integrator

Array = NDArray[np.float64]
INF = np.inf
SCHEME = schemes.build(Family.RADAU, 2)


class Drawn:
    """Random numbers that are known: normal ones are 1, uniform ones a part of the way; asked ranges are kept."""

    def __init__(self, part: float = 0.25) -> None:
        self.part, self.asked = part, list[tuple[Any, Any]]()

    def uniform(self, low: Any = 0.0, high: Any = 1.0, size: Any = None) -> Any:
        self.asked.append((np.asarray(low).tolist(), np.asarray(high).tolist()))
        found = np.asarray(low) + self.part * (np.asarray(high) - np.asarray(low))
        return float(found) if size is None else np.broadcast_to(found, size)

    def normal(self, size: Any) -> Array:
        return np.ones(size)


def moving(**changes: Any) -> tuple[Trajectory, Problem]:
    """Move from 0 to 1 within 2 s."""
    problem = replace(push(3), horizon=2.0, **changes)
    plant = double_integrator()
    motion = interpolate(problem, SCHEME, np.array([1.0]), plant)
    return complete(replace(motion, u=np.array([[1.0], [-4.0], [2.0]])), problem, plant), problem


def noise(
    motion: Trajectory, problem: Problem, kind: str = "prismatic", part: float = 0.25
) -> tuple[Trajectory, Drawn]:
    manifest = double_integrator().manifest
    own = manifest.coordinates[0].model_copy(update={"motion": kind})
    drawn = Drawn(part)
    found = add_noise(motion, problem, manifest.model_copy(update={"coordinates": (own,)}), cast(Any, drawn))
    return found, drawn


WIDTH = 0.5**0.75 * 4**0.25  # a quarter of the way from 1/2 to 4, by their logarithms


def test_noise_is_as_wide_as_drawn() -> None:
    """A quarter of the range of a coordinate in metres counts as 1; inputs reach the width times the most."""
    motion, problem = moving()
    found, drawn = noise(motion, problem)
    assert drawn.asked[0] == pytest.approx((np.log(0.5), np.log(4.0)))
    assert found.q == pytest.approx(motion.q + WIDTH)
    assert found.point_q == pytest.approx(motion.point_q + WIDTH)
    assert found.u == pytest.approx(np.full((3, 1), -4 * WIDTH + 0.25 * 8 * WIDTH))
    assert found.qd.tolist() == motion.qd.tolist()
    wide = Bounds(((-6.0, 10.0),), (FREE_RANGE,), ((-1.0, 7.0),))
    found, _ = noise(motion, replace(problem, bounds=wide))
    assert found.q == pytest.approx(motion.q + 4 * WIDTH)
    assert found.u == pytest.approx(np.full((3, 1), 1.0))
    found, _ = noise(motion, replace(problem, bounds=wide), "revolute")
    assert found.q == pytest.approx(motion.q + WIDTH)
    half = Bounds(((-6.0, INF),), (FREE_RANGE,), ((9.0, INF),))
    found, _ = noise(motion, replace(problem, bounds=half))
    assert found.q == pytest.approx(motion.q + WIDTH)
    assert found.u == pytest.approx(np.full((3, 1), 9.0))  # above what the motion has
    tight = Bounds(((0.0, 1.0),), (FREE_RANGE,), ((-INF, 0.5),))
    found, _ = noise(motion, replace(problem, bounds=tight), part=0.99)
    width = 0.5**0.01 * 4**0.99
    assert (found.q.min(), found.q.max()) == (pytest.approx(width / 4), 1.0)
    assert found.u == pytest.approx(np.full((3, 1), -4 * width + 0.99 * (0.5 + 4 * width)))


def test_noise_of_states_and_controls_has_their_ranges() -> None:
    """A quarter of a range; 1 without one; within bounds."""
    states = (State("s", "0", bounds=(-2.0, 10.0)), State("r", "0", bounds=(-INF, 0.5)))
    motion, problem = moving(states=states, controls=(Control("c", bounds=(2.0, 6.0)), Control("d", guess=3.0)))
    found, drawn = noise(motion, problem)
    assert found.states == pytest.approx(np.tile([3 * WIDTH, 0.5], (4, 1)))
    assert found.point_states == pytest.approx(np.tile([3 * WIDTH, 0.5], (3, 2, 1)))
    assert found.controls == pytest.approx(np.tile([3.0, -3 * WIDTH / 2], (3, 1)))
    assert len(drawn.asked) == 3
    alone, _ = noise(*moving(controls=(Control("c", bounds=(2.0, 6.0)),)))
    assert alone.controls == pytest.approx(np.full((3, 1), 3.0))


def test_waves_are_a_window_times_eight_harmonics() -> None:
    """64 s^3 (1 - s)^3 times h sin(pi k s + phase) / k, and its derivatives; h is drawn by its logarithm."""
    motion, problem = moving(bounds=Bounds(((-INF, 1.5),), (FREE_RANGE,), (FREE_RANGE,)))
    drawn = Drawn()
    found = add_waves(motion, problem, cast(Any, drawn), (2.0, 32.0))
    assert drawn.asked == [(pytest.approx(np.log(2.0)), pytest.approx(np.log(32.0))), (0.0, pytest.approx(2 * np.pi))]
    height, phase = 4.0, np.pi / 2
    window = 64 * Polynomial([0, 1]) ** 3 * Polynomial([1, -1]) ** 3

    def wave(t: Array) -> Array:
        s = t / 2.0
        return np.asarray(window(s) * sum(height * np.sin(np.pi * k * s + phase) / k for k in range(1, 9)))

    h = 1e-4
    assert found.q[:, 0] == pytest.approx(np.minimum(motion.q[:, 0] + wave(motion.t), 1.5), abs=1e-12)
    assert found.point_q[..., 0] == pytest.approx(np.minimum(motion.point_q[..., 0] + wave(motion.point_t), 1.5))
    for part, t in (("qd", motion.t), ("point_qd", motion.point_t)):
        slope = (wave(t + h) - wave(t - h)) / (2 * h)
        assert getattr(found, part)[..., 0] == pytest.approx(getattr(motion, part)[..., 0] + slope, abs=1e-4)
    second = (wave(motion.point_t + h) - 2 * wave(motion.point_t) + wave(motion.point_t - h)) / h**2
    assert found.point_qdd[..., 0] == pytest.approx(motion.point_qdd[..., 0] + second, abs=1e-3)
    usual = Drawn()
    add_waves(motion, problem, cast(Any, usual))
    assert usual.asked[0] == (0.0, pytest.approx(np.log(4.0)))


def test_hops_are_smaller_waves_with_their_inputs() -> None:
    """Heights from 1/2 to 5/2; u is the mean acceleration of the mass."""
    motion, problem = moving()
    plant = double_integrator()
    waved = add_waves(motion, problem, np.random.default_rng((3, 1)), (0.5, 2.5))
    found = hop(motion, problem, plant, (3, 1))
    assert found.q.tolist() == waved.q.tolist()
    assert found.u[:, 0] == pytest.approx(waved.point_qdd[..., 0].mean(axis=1))


@pytest.mark.parametrize(
    ("kind", "part", "has_quaternions", "made"),
    [
        ("bumps", 0.9, False, "bump"),
        ("waves", 0.9, False, "waves"),
        ("noise", 0.1, False, "noise"),
        ("branches", 0.49, False, "waves"),
        ("branches", 0.5, False, "noise"),
        ("turns", 0.49, False, "waves"),
        ("turns", 0.51, False, "noise"),
        ("waves", 0.1, True, "noise"),
        ("turns", 0.1, True, "noise"),
    ],
)
def test_kinds_choose_waves_or_noise(
    monkeypatch: pytest.MonkeyPatch, kind: Any, part: float, has_quaternions: bool, made: str
) -> None:
    """Branches and turns one of both, with even chances; quaternions have no waves."""
    called: list[str] = []

    def note(name: str, result: object) -> Any:
        return lambda *_: called.append(name) or result  # type: ignore[func-returns-value]

    monkeypatch.setattr(starts, "bump", note("bump", "moved"))
    monkeypatch.setattr(starts, "add_waves", note("waves", "moved"))
    monkeypatch.setattr(starts, "add_noise", note("noise", "moved"))
    monkeypatch.setattr(starts, "_close", lambda motion, _: motion)
    monkeypatch.setattr(starts, "balance", lambda motion, _p, _q, inputs: (motion, inputs))
    monkeypatch.setattr(starts, "complete", lambda motion, *_: motion)
    problem = SimpleNamespace(has_quaternions=has_quaternions, guess=SimpleNamespace(inputs="zero"))
    plant = SimpleNamespace(manifest=None)
    found = disturb(cast(Any, "motion"), kind, cast(Any, problem), cast(Any, plant), (), cast(Any, Drawn(part)))
    assert called == [made]
    assert cast(Any, found) == ("moved" if made == "noise" else ("moved", "dynamic"))


def test_a_motion_begins_with_a_pose_and_its_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rest where the guess rests, except with turns; none where no pose is reached."""
    plant, rng = double_integrator(), np.random.default_rng(0)
    problem = push(3)
    found = _move(Variation("noise", (0,)), problem, plant, SCHEME, rng)
    assert found is not None
    assert found.q[-1] == pytest.approx([1.0])
    found = _move(Variation("turns", (0,), (0, -2)), problem, plant, SCHEME, rng)
    assert found is not None
    assert found.q[-1] == pytest.approx([1 - 4 * np.pi])
    still = replace(problem, guess=GuessOptions(motion="rest"))
    found = _move(Variation("noise", (0,)), still, plant, SCHEME, rng)
    assert found is not None
    assert found.q[-1] == pytest.approx([0.0])
    found = _move(Variation("turns", (0,), (0, 1)), still, plant, SCHEME, rng)
    assert found is not None
    assert found.q[-1] == pytest.approx([1 + 2 * np.pi])
    monkeypatch.setattr(starts, "find_pose", lambda *_: Pose(np.zeros(1), 1.0, True))
    assert _move(Variation("noise", (0,)), problem, plant, SCHEME, rng) is None
    assert vary(Variation("noise", (0,)), problem, plant, SCHEME, ()) is None
    tries: list[int] = []
    monkeypatch.setattr(starts, "scatter_poses", lambda *given: tries.append(given[3]))
    assert _move(Variation("branches", (0,)), problem, plant, SCHEME, rng) is None
    assert tries == [20]
    monkeypatch.setattr(starts, "scatter_poses", lambda *_: np.array([7.0]))
    found = _move(Variation("branches", (0,)), problem, plant, SCHEME, rng)
    assert found is not None
    assert found.q[-1] == pytest.approx([7.0])
    monkeypatch.setattr(starts, "interpolate", lambda *_: replace(found, point_q=np.nan * found.point_q))
    assert vary(Variation("branches", (0,)), problem, plant, SCHEME, ()) is None


def test_poses_are_closed_one_by_one_where_no_motion_closes(monkeypatch: pytest.MonkeyPatch) -> None:
    motion, _ = moving()
    assert _close(motion, double_integrator()) is motion
    closure = SimpleNamespace(project=lambda q, qd: (q + 1, qd + 2))
    monkeypatch.setattr(starts, "find_closure", lambda _: closure)
    monkeypatch.setattr(starts, "close_motion", lambda *_: replace(motion, point_q=np.nan * motion.point_q))
    found = _close(motion, double_integrator())
    assert found.q.tolist() == (motion.q + 1).tolist()
    assert found.point_qd.tolist() == (motion.point_qd + 2).tolist()
    monkeypatch.setattr(starts, "close_motion", lambda *_: motion)
    assert _close(motion, double_integrator()) is motion


def test_fine_meshes_become_coarse_by_two_or_five() -> None:
    """From 40 intervals on, to 16 at least; the degree is 3 at most, and a solve takes 200 iterations."""
    fine = replace(push(100, degree=5), mesh=(0.01,) * 100, steps=30)
    fine = replace(fine, solver=replace(fine.solver, max_iterations=3000))
    made = {k: coarsen(fine, Variation("noise", (k,))) for k in range(12)}
    for k, problem in made.items():
        assert problem is not None
        divisor = (2, 5)[int(np.random.default_rng((k, 1)).integers(2))]
        assert (problem.intervals, problem.degree, problem.mesh, problem.steps) == (100 // divisor, 3, None, 30)
        assert problem.solver.max_iterations == 200
        shot = coarsen(replace(fine, form=Form.SHOOTING), Variation("noise", (k,)))
        assert shot is not None
        assert shot.steps == min(30 * divisor, 100)
    assert {problem.intervals for problem in made.values() if problem is not None} == {50, 20}
    small = coarsen(replace(push(40, degree=2), mesh=None), Variation("waves", (1,)))
    assert small is not None
    assert small.degree == 2
    assert {p.intervals for k in range(9) if (p := coarsen(push(40), Variation("noise", (k,)))) is not None} == {20, 16}
    assert coarsen(push(39), Variation("noise", (0,))) is None
    assert coarsen(fine, Variation("bumps", (0,))) is None
    few = replace(fine, solver=replace(fine.solver, max_iterations=7))
    found = coarsen(few, Variation("noise", (0,)))
    assert found is not None
    assert found.solver.max_iterations == 7


def test_turns_are_of_free_angles() -> None:
    manifest = SimpleNamespace(
        coordinates=[
            SimpleNamespace(name=n, motion=m)
            for n, m in (("a", "revolute"), ("b", "revolute"), ("c", "prismatic"), ("d", "revolute"), ("e", "revolute"))
        ],
        positions=("a", "b", "c", "d", "e"),
    )
    ranges = (FREE_RANGE, (-INF, 3.0), FREE_RANGE, FREE_RANGE, FREE_RANGE)
    problem = replace(push(3), bounds=Bounds(ranges, (), ()), end=End(coordinates=((3, 0.0),)))
    assert list_turning(problem, cast(Any, manifest)) == (0, 4)
    motion = SimpleNamespace(q=np.array([[1.0] * 5, [1 + 2 * np.pi * x for x in (1.4, 9, 9, 9, -2.6)]]))
    assert count_turns(cast(Any, motion), problem, cast(Any, manifest)) == "a +1, e -3"
    motion.q[1] = motion.q[0] + 2 * np.pi * 0.4
    assert count_turns(cast(Any, motion), problem, cast(Any, manifest)) == ""
    assert describe_turns("a +1, e -3") == "with +1 turn of a, with -3 turns of e"
    assert describe_turns("") == ""


@pytest.mark.parametrize(
    ("results", "hops", "text"),
    [
        ([None, None], 0, "no solution in 2 starts"),
        ([3.0, None], 0, "the lowest cost was found once in 2 starts; lower ones may exist"),
        ([3.0, 3.0, 4.0], 0, "the lowest cost was found 2 times in 3 starts; lower ones may exist"),
        (
            [3.0, 3.0],
            2,
            "the lowest cost was found 0 times in 2 starts, by 2 hops from the best of them; lower ones may exist",
        ),
    ],
)
def test_starts_are_described(results: list[float | None], hops: int, text: str) -> None:
    every = tuple(Start(k, "noise", "status", 5, 1.0, cost, "") for k, cost in enumerate(results))
    below = tuple(Start(k, "hop", "status", 5, 1.0, 1.0, "") for k in range(hops))
    made = Starts(0, len(every), every, hops=below) if hops else Starts(0, len(every), every)
    assert describe_starts(made) == text
    if not hops and results[0] is not None:
        turned = replace(made, results=(replace(every[0], cost=1.0, turns="a +1"), *every[1:]))
        assert describe_starts(turned).startswith("the lowest cost (with +1 turn of a) was found once")
