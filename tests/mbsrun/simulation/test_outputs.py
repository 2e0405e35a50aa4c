"""States that are kept, steps of equal length, starts on a course, and work: small numbers by hand."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsgen.expressions import parse
from mbsrun.external import load
from mbsrun.models import INTEGRATED
from mbsrun.simulation.course import Course, check_course, find_jump, follow, stand
from mbsrun.simulation.drive import DriveError, Piece
from mbsrun.simulation.integration.energy import MANY, add_up_friction, add_up_work
from mbsrun.simulation.integration.joints import Joints
from mbsrun.simulation.integration.steps import count_steps, place_steps, sample
from mbsrun.simulation.motion import Bounces, Chunk, Segment, Stages
from mbsrun.simulation.outputs import Outputs, find_stride, list_times
from mbsrun.simulation.statement import read_statement
from tests.mbsrun.simulation.particles import wait
from tests.model_kinds import write_model

Array = NDArray[np.float64]


def chunk(times: list[float], *, dense: bool = True, **given: Any) -> Chunk:
    """Make the motion q = t^2 in steps, with its interpolation or without."""
    t = np.array(times)

    def read(at: Array, step: NDArray[np.intp]) -> tuple[Array, Array]:
        assert ((t[step] <= at + 1e-12) & (at <= t[step + 1] + 1e-12)).all()  # each time in its own step
        return (at**2)[:, None], (2 * at)[:, None]

    return Chunk(t, (t**2)[:, None], (2 * t)[:, None], read if dense else None, **given)


def test_every_kth_step_is_kept_over_all_chunks_of_a_piece() -> None:
    outputs = Outputs(0.3)
    first = chunk([0.0, 0.1, 0.2, 0.3, 0.4], dense=False)
    found, kept = outputs.choose(first)
    assert (found is first, kept.tolist()) == (True, [3])
    assert outputs.choose(chunk([0.4, 0.5, 0.6, 0.7], dense=False))[1].tolist() == [2]
    outputs.open()
    assert outputs.choose(chunk([0.0, 0.1, 0.2, 0.3], dense=False))[1].tolist() == [3]
    assert [find_stride(0.3, step) for step in (0.1, 0.12, 0.19, 0.3, 7.0)] == [3, 2, 2, 1, 1]


def test_steps_are_cut_at_the_times_of_outputs() -> None:
    """At multiples of 0.25 after the start, up to the end; the states between are read in their own steps."""
    found, kept = Outputs(0.25).choose(chunk([0.1, 0.4, 0.75, 1.1]))
    assert found.t == pytest.approx([0.1, 0.25, 0.4, 0.5, 0.75, 1.0, 1.1])
    assert found.t[kept] == pytest.approx([0.25, 0.5, 0.75, 1.0])
    assert found.q[:, 0] == pytest.approx(found.t**2)
    assert found.qd[:, 0] == pytest.approx(2 * found.t)
    assert found.dense is not None
    at = np.array([0.2, 0.3, 0.45, 0.6, 0.8, 1.05])
    assert found.dense(at, np.arange(6))[0][:, 0] == pytest.approx(at**2)
    plain = chunk([0.0, 0.25, 0.5])
    same, kept = Outputs(0.25).choose(plain)
    assert (same is plain, kept.tolist()) == (True, [1, 2])
    assert Outputs(5.0).choose(plain)[1].tolist() == []


def test_an_output_as_near_as_a_billionth_to_a_step_is_its_end() -> None:
    for off, count in ((0.9e-9, 3), (1.1e-9, 4)):
        for sign in (-1, 1):
            found, kept = Outputs(1.0).choose(chunk([0.5, 1.0 + sign * off, 1.5]))
            assert len(found.t) == count
            assert len(kept) == 1
            assert found.t[kept[0]] == (1.0 + sign * off if count == 3 else 1.0)


def test_bounces_keep_their_states() -> None:
    bounces = Bounces(np.array([1, 2]), (), np.zeros(2), (), ())
    given = chunk([0.1, 0.4, 0.75], segment=Segment((0,), bounces=bounces))
    found, _ = Outputs(0.25).choose(given)
    assert found.segment is not None
    assert found.segment.bounces is not None
    assert found.t[found.segment.bounces.rows] == pytest.approx([0.4, 0.75])


def test_times_of_outputs_end_with_the_piece() -> None:
    assert list_times(0.25, 0.1, 0.8) == pytest.approx([0.25, 0.5, 0.75, 0.8])
    assert list_times(0.25, 0.25, 0.75) == pytest.approx([0.5, 0.75])
    assert list_times(0.25, 0.25 - 0.9 * 0.25e-9, 0.75 + 0.9 * 0.25e-9) == pytest.approx([0.5, 0.75])
    assert len(list_times(0.25, 0.25 - 1.1 * 0.25e-9, 0.75 + 1.1 * 0.25e-9)) == 4
    assert list_times(9.0, 0.25, 0.75).tolist() == [0.75]


def test_steps_of_a_piece_are_equal_and_no_longer_than_asked() -> None:
    assert [count_steps(wait(1.0, 2.0), step) for step in (0.1, 0.3, 1.0, 5.0)] == [10, 4, 1, 1]
    assert count_steps(wait(0.0, 1.0 + 0.9e-12), 0.1) == 10
    assert count_steps(wait(0.0, 1.0 + 1e-11), 0.1) == 11
    found = place_steps(wait(1.0, 2.1), np.array([0, 1, 3]), 3)
    assert found.tolist()[2] == 2.1
    assert found == pytest.approx([1.0, 1.0 + 1.1 / 3, 2.1])
    times = np.array([0.0, 0.5])
    assert sample(Piece(0, 1, lambda t: t[:, None], False), times).tolist() == [[0.0], [0.5]]
    assert sample(Piece(0, 1, lambda t: t[:, None], True), times).tolist() == [[0.0]]


def test_courses_have_exact_derivatives() -> None:
    course = follow([parse("a*t**3"), parse("a")], ["x", "y"], {"a": 2.0})
    assert [x.tolist() for x in course.at(0.5)] == [[0.25, 2.0], [1.5, 0.0], [6.0, 0.0]]
    assert (course.is_constant, follow([parse("a")], ["y"], {"a": 1.0}).is_constant) == (False, True)
    still = stand([3.0, 4.0])
    assert ([x.tolist() for x in still.at(9.0)], still.is_constant) == ([[3, 4], [0, 0], [0, 0]], True)
    q, qd, _ = still.states(np.zeros(3))
    assert (q.shape, qd.shape) == ((3, 2), (3, 2))
    with pytest.raises(DriveError, match=r"joint y has no finite value or derivative at t = 0.25 s"):
        follow([parse("t"), parse("1/(t - 0.25)")], ["x", "y"], {}).states(np.array([0.0, 0.25]))


def test_starts_are_on_the_course_to_a_billionth() -> None:
    coordinates = tuple(SimpleNamespace(name=name) for name in "abc")
    manifest: Any = SimpleNamespace(coordinates=coordinates, positions=("c", "b", "a"), driven=(2, 0))
    course = Course(
        lambda t: (np.tile([5.0, -1.0], (len(t), 1)), np.tile([2.0, 0.0], (len(t), 1)), np.zeros((1, 2))), True
    )
    q, qd = np.array([5.0, 7.0, -1.0]), np.array([0.0, 9.0, 2.0])
    check_course(manifest, course, q, qd)
    for i, kind, size in ((0, "q", 6e-9), (2, "q", 2e-9), (2, "qd", 3e-9), (0, "qd", 1e-9)):
        for part, is_wrong in ((0.9, False), (1.1, True), (-1.1, True)):
            moved = {"q": q.copy(), "qd": qd.copy()}
            moved[kind][i] += part * size
            if is_wrong:
                with pytest.raises(ValueError, match=f"{kind} of driven joint"):
                    check_course(manifest, course, **moved)
            else:
                check_course(manifest, course, **moved)
    with pytest.raises(ValueError, match=r"has shape \(1,\); 2 driven joints expected"):
        check_course(manifest, stand([1.0]), q, qd)
    check_course(SimpleNamespace(coordinates=coordinates, driven=()), stand([1.0]), q, qd)  # type: ignore[arg-type]


JOINTS = SimpleNamespace(
    torque=np.array([2.0, 5.0, 7.0]), static=np.array([3.0, 5.0, 9.0]), stribeck=np.array([0.5, 0.0, 0.0]),
    is_dry=np.array([True, True, False]), place=[0, 1, 2],
)  # fmt: skip


def test_dry_friction_falls_over_its_speed() -> None:
    """From 3 to 2 as exp(-(v/0.5)^2); a joint without such a speed keeps its torque; starts take the static one."""
    v = np.array([[0.25, 0.3, -1.0], [0.0, 0.0, 0.0]])
    found = Joints.rub(JOINTS, v)  # type: ignore[arg-type]
    assert found == pytest.approx(np.array([[2 + np.exp(-0.25), 5, 7], [3, 5, 7]]))
    own: Any = SimpleNamespace(**vars(JOINTS), rub=lambda v: Joints.rub(JOINTS, v))  # type: ignore[arg-type]
    slope = Joints.steepen(own, v)
    assert slope == pytest.approx(np.array([[-8 * 0.25 * np.exp(-0.25), 0, 0], [0, 0, 0]]))
    starting = Joints.starting.fget  # type: ignore[attr-defined]
    assert starting(JOINTS).tolist() == [3.0, 5.0, 7.0]


@pytest.mark.parametrize(("q", "beyond"), [(-2 - 1.9e-12, False), (5 + 4.9e-12, False), (-3.0, True), (6.0, True)])
def test_joints_beyond_a_stop_are_named(q: float, *, beyond: bool) -> None:
    own: Any = SimpleNamespace(
        manifest=SimpleNamespace(coordinates=[SimpleNamespace(name="a"), SimpleNamespace(name="b")]),
        place=[1, 0], lower=np.array([-2.0, -np.inf]), upper=np.array([5.0, np.inf]),
    )  # fmt: skip
    found = Joints.find_beyond(own, np.array([99.0, q]))
    assert found == ([("a", q, -2.0 if q < 0 else 5.0)] if beyond else [])


def test_friction_takes_its_torque_times_the_way_and_the_power_of_contacts() -> None:
    """Of joints that slide and are dry; with a Stribeck speed the rest is integrated, as is the power of contacts."""
    own: Any = SimpleNamespace(**vars(JOINTS), rub=lambda v: Joints.rub(JOINTS, v))  # type: ignore[arg-type]
    t = np.array([0.0, 0.5, 1.5])
    q = np.stack((0.25 * t, -t, 4 * t), axis=1)
    qd = np.tile([0.25, -1.0, 4.0], (3, 1))

    def read(at: Array, _step: NDArray[np.intp]) -> tuple[Array, Array]:
        return np.outer(at, [0.25, -1.0, 4.0]), np.tile([0.25, -1.0, 4.0], (len(at), 1))

    def add_up(*modes: int, push: Any = None) -> list[float]:
        return add_up_friction(own, Chunk(t, q, qd, read, segment=Segment(modes, push=push))).tolist()

    assert add_up(0, -1, 1) == pytest.approx([2.5, 5.0])
    assert add_up(2, -1, 1) == pytest.approx([2.5, 5.0])
    whole = (2 + np.exp(-0.25)) * 0.25
    assert add_up(1, 0, 0) == pytest.approx([0.5 * whole, whole])
    assert add_up(0, 0, 1) == [0.0, 0.0]

    def push(at: Array, _q: Array, _qd: Array) -> tuple[Array, Array, Array]:
        return _q, _qd, at**8

    assert add_up(0, 0, 0, push=push) == pytest.approx([0.5**9 / 9, (1.5**9 - 0.5**9) / 9], rel=1e-12)
    assert MANY[0].size == 5


def test_work_is_the_integral_of_power_with_the_power_of_driven_joints() -> None:
    """By the nodes that a step brings, or by Gauss's: power t^4, and a driving force of 3 on a velocity of 2 t."""
    nodes, weights = (np.polynomial.legendre.leggauss(5)[k] / 2 + (0.5, 0)[k] for k in range(2))
    t = np.array([0.0, 0.5, 2.0])
    at = t[:-1, None] + np.diff(t)[:, None] * nodes
    stages = Stages(at, (at**2)[..., None], (2 * at)[..., None], weights)

    def make(driven: tuple[int, ...]) -> Any:
        return SimpleNamespace(
            kernels=SimpleNamespace(manifest=SimpleNamespace(driven=driven, configuration=())),
            call=lambda _name, q, _qd, _v: {"power": q**2},
            forces=lambda t, _q, _qd, _v: (None, np.full((len(t), 1), 3.0)),
        )

    motion = Chunk(t, (t**2)[:, None], (2 * t)[:, None], None, stages=stages)
    own = np.array([0.5**5 / 5, (2.0**5 - 0.5**5) / 5])
    assert add_up_work(make(()), wait(0, 2), motion) == pytest.approx(own)
    assert add_up_work(make((0,)), wait(0, 2), motion) == pytest.approx(own + 3 * np.array([0.25, 3.75]))
    assert add_up_work(make(()), wait(0, 2), chunk(t.tolist())) == pytest.approx(own)


@pytest.mark.parametrize(
    ("text", "time", "change", "function"),
    [
        ("max(0, t - 0.1)", 0.1, 1.0, "max"),
        ("2*min(t, a) + abs(t - 0.9)", 0.3, -2.0, "min"),
        ("abs(cos(9*t))", np.pi / 18, 18.0, "abs"),
        ("abs(sin(9*t))", 0.0, 9.0, "abs"),
        ("max(0, t)", 0.0, 0.5, "max"),  # the derivative at a kink is the mean of both sides
        ("1e-9*max(t, 0.5) + 3", 0.5, 1e-9, "max"),
    ],
)
def test_a_velocity_that_jumps_is_found(text: str, time: float, change: float, function: str) -> None:
    jump = find_jump(parse(text), {"a": 0.3}, 1.0)
    assert jump is not None
    assert (jump.time, jump.change) == pytest.approx((time, change), rel=1e-4, abs=1e-12)
    assert jump.function == function


@pytest.mark.parametrize(
    "text", ["max(0, t - 0.1)**2", "abs(t + 1)", "max(0, t)**2", "abs(t - 0.5)**3", "sin(t)*max(a, 0)"]
)
def test_smooth_motions_have_no_jump(text: str) -> None:
    assert find_jump(parse(text), {"a": 0.3}, 1.0) is None


def test_a_driven_joint_that_jumps_is_refused_with_its_line(tmp_path: Path) -> None:
    settings = tmp_path / "settings.yaml"
    (tmp_path / "table.yaml").write_text(write_model("driven"), encoding="utf-8")
    manifest = load(tmp_path / "table.yaml", extent=INTEGRATED).manifest
    name = manifest.coordinates[manifest.driven[0]].name
    settings.write_text(f"duration: 0.5\ndriven: {{{name}: 'max(0, t - 0.1)'}}\n", encoding="utf-8")
    with pytest.raises(InputError, match=rf"settings.yaml:2: driven.{name}: its velocity jumps by 1 at t = 0.1 s"):
        read_statement(settings, {}, manifest)
