"""Recorded motions and loads by hand: columns, gaps, points and axes of forces, quaternions, jumps, predictions."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsrun.kernel import ArgumentError
from mbsrun.recordings import Recording, Treatment
from mbsrun.recordings.recording import Column
from mbsrun.simulation.inverse import Forces, _describe, _predict, check_kernels
from mbsrun.simulation.recorded import (
    Load,
    _find_faults,
    _find_loads,
    _fit_coordinates,
    _fit_loads,
    _pair_alone,
    _resolve,
    scale,
)

Array = NDArray[np.float64]
T = np.array([0.0, 1.0, 2.0])
FORCE, POINT, MOMENT = np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.0, 1.0]), np.array([0.1, 0.2, 0.3])
TURNED = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # of the body: 90 degrees about z


def make_manifest(**given: Any) -> Any:
    """A sliding joint x with a motor, a body that a wrench acts on, whose sensor is at (0, 0, 1), and a signal."""
    joint = SimpleNamespace(name="x", unit="m")
    wrench = {"name": "push", "frame": 1, "in_base": False, "force": True, "moment": True}
    wrench |= {name: given.pop(name) for name in [*wrench] if name in given}
    open_parts = [part for part in ("force", "moment") if wrench[part]]
    labels = [f"push.{part}.{axis}" for part in open_parts for axis in "xyz"]
    frames = [SimpleNamespace(name=name, sensor=name == "push") for name in ("base", "body", "push")]
    known = {
        "positions": ("x",), "coordinates": (joint,), "loops": (), "independent": (), "quaternions": (),
        "wrenches": (SimpleNamespace(**wrench),), "frames": frames, "signals": ("gain", "t"), "actuated": (0,),
        "inputs": ("x", *labels, "gain", "t"), "pose": (), "kernels": (), "model": "cart",
    }  # fmt: skip
    return SimpleNamespace(**(known | given))


def record(columns: dict[str, Any], units: dict[str, str] | None = None, times: Array = T) -> Recording:
    rows = [np.broadcast_to(np.asarray(x, dtype=float), times.shape) for x in columns.values()]
    named = tuple(Column(name, (units or {}).get(name, "")) for name in columns)
    return Recording("walk.csv", times, named, np.stack(rows, axis=1))


def spread(begin: str, values: Array, end: str = "") -> dict[str, float]:
    return {f"{begin}{axis}{end}": float(x) for axis, x in zip("xyz", values, strict=True)}


class Frames:
    """Kernels whose second frame is turned, and whose third one is at (0, 0, 1)."""

    def __init__(self, manifest: Any) -> None:
        self.manifest = manifest

    def __call__(self, name: str, q: Array) -> dict[str, Array]:
        assert (name, q.shape) == ("frames", (3, 1))
        p, R = np.zeros((3, 3, 3)), np.tile(np.hstack((np.eye(3), TURNED, np.eye(3))), (3, 1, 1))
        p[:, :, 2] = [0, 0, 1]
        return {"p": p, "R": R}


def resolve(manifest: Any, load: Load, columns: dict[str, Any]) -> dict[str, list[float]]:
    """Return the inputs w, by name, at the three times; the body is turned, and the sensor at (0, 0, 1)."""
    parts = _fit_loads(record(columns), manifest, {"push": load}, ())
    w = _resolve(Frames(manifest), T, np.zeros((3, 1)), {"push": load}, parts)  # type: ignore[arg-type]
    return dict(zip(manifest.inputs[1:], w.T.tolist(), strict=True))


FULL = {**spread("f", FORCE), **spread("p", POINT), **spread("m", MOMENT), "gain": [5.0, 6, 7]}


@pytest.mark.parametrize("in_base", [False, True])
def test_a_force_at_a_point_has_a_moment_about_the_wrenches_own(in_base: bool) -> None:
    """M + (P - p) x F, in axes of the base or of the body; the signal is read, and the time is known."""
    found = resolve(make_manifest(in_base=in_base), Load("f", "p", "m"), FULL)
    moment = MOMENT + np.cross(POINT - [0, 0, 1], FORCE)
    turn = np.eye(3) if in_base else TURNED.T
    assert [found[f"push.force.{axis}"][1] for axis in "xyz"] == pytest.approx(turn @ FORCE)
    assert [found[f"push.moment.{axis}"][2] for axis in "xyz"] == pytest.approx(turn @ moment)
    assert (found["gain"], found["t"]) == ([5.0, 6.0, 7.0], [0.0, 1.0, 2.0])


def test_components_as_the_model_takes_them_are_not_turned() -> None:
    found = resolve(make_manifest(), Load("f", None, "m", is_input=True), FULL)
    assert [found[f"push.force.{axis}"][0] for axis in "xyz"] == FORCE.tolist()
    assert [found[f"push.moment.{axis}"][0] for axis in "xyz"] == MOMENT.tolist()


def test_a_force_without_a_point_or_a_moment_acts_at_the_wrenches_own() -> None:
    found = resolve(make_manifest(in_base=True), Load("f"), FULL)
    assert [found[f"push.moment.{axis}"] for axis in "xyz"] == [[0.0] * 3] * 3
    only = resolve(make_manifest(in_base=True, moment=False), Load("f"), FULL)
    assert [name for name in only if "push" in name] == ["push.force.x", "push.force.y", "push.force.z"]
    assert only["push.force.z"] == [3.0] * 3


def test_wrenches_and_signals_that_nobody_recorded_are_0() -> None:
    """And no frame is computed."""
    w = _resolve(SimpleNamespace(manifest=make_manifest()), T, np.zeros((3, 1)), {}, {})  # type: ignore[arg-type]
    assert w[:, :-1].tolist() == [[0.0] * 7] * 3
    assert w[:, -1].tolist() == T.tolist()


def test_loads_are_found_by_the_names_that_simulations_write() -> None:
    """All components that the wrench leaves open, with the name of the input or without."""
    for begin, end in (("input[push", "]"), ("push", "")):
        force, moment = (spread(f"{begin}.{part}.", FORCE, end) for part in ("force", "moment"))
        found = _find_loads(record({**force, **moment}), make_manifest())
        assert found == {"push": Load(f"{begin}.force.", None, f"{begin}.moment.", is_input=True)}
        assert _find_loads(record(force), make_manifest()) == {}
        assert _find_loads(record(force), make_manifest(moment=False)) == {
            "push": Load(f"{begin}.force.", None, None, is_input=True)
        }
        assert _find_loads(record(moment), make_manifest(force=False)) == {
            "push": Load("", None, f"{begin}.moment.", is_input=True)
        }
    assert _find_loads(record({"a": 1.0}), make_manifest(force=False, moment=False)) == {}


def test_columns_of_loads_end_with_their_axis_and_lines_join_their_samples() -> None:
    for end in ("", "]"):
        columns = {**spread("w[push.", FORCE, end), "w[signal_gain]": [0.0, 4.0, 0.0]}
        parts = _fit_loads(record(columns), make_manifest(), {"push": Load("w[push.")}, ())
        assert sorted(parts["push"]) == ["force.x", "force.y", "force.z"]
        assert parts["push"]["force.y"].evaluate(np.array([0.5])).tolist() == [2.0]
        assert parts["signal[gain]"]["signal"].evaluate(np.array([0.5, 1.5])).tolist() == [2.0, 2.0]


def test_idle_signals_and_the_time_need_no_column() -> None:
    assert _fit_loads(record({"a": 1.0}), make_manifest(), {}, {"gain"}) == {}
    for name in ("input[gain]", "w[signal_gain]", "gain"):
        assert list(_fit_loads(record({name: 1.0}), make_manifest(), {}, ())) == ["signal[gain]"]
    with pytest.raises(InputError, match='no column is named "gain"'):
        _fit_loads(record({"a": 1.0}), make_manifest(), {}, ())


def test_all_faults_of_loads_are_found_at_once() -> None:
    """Missing columns, columns in other units, and signals."""
    columns = {**spread("f", FORCE), **spread("p", POINT)}
    del columns["fy"]
    recording = record(columns, {"fx": "m", "px": "N"})
    with pytest.raises(InputError) as error:
        _fit_loads(recording, make_manifest(), {"push": Load("f", "p"), "pull": Load("f")}, ())
    told = [f"{fault.path} {fault.finding}" for fault in error.value.faults]
    assert len(told) == 7
    assert sum('no column is named "fy"' in x for x in told) == 2
    assert sum('"fx" it is in "m"' in x and "is in N" in x for x in told) == 2
    assert sum('"px" it is in "N"' in x and "is in m" in x for x in told) == 1
    assert sum('leaves no wrench "pull" open' in x for x in told) == 1
    assert sum('no column is named "gain"' in x for x in told) == 1


def test_a_wrench_takes_what_it_leaves_open() -> None:
    """A point makes a moment, and needs a sensor of the wrench's name."""
    for given, load, sensors, found in (
        ({}, Load("f", "p", "m"), {"push"}, []),
        ({}, Load("f", "p", "m"), set(), ["the point of push is unknown"]),
        ({"force": False}, Load("f"), set(), ["the force of push"]),
        ({"force": False}, Load("", None, "m"), set(), []),
        ({"moment": False}, Load("f"), set(), []),
        ({"moment": False}, Load("f", None, "m"), set(), ["the moment of push"]),
        ({"moment": False}, Load("f", "p"), {"push"}, ["the moment of push"]),
    ):
        wrench = make_manifest(**given).wrenches[0]
        told = _find_faults("push", load, {"push": wrench}, sensors)
        assert [finding[: len(x)] for (finding, _), x in zip(told, found, strict=True)] == found
    (_, remedy), = _find_faults("other", Load("f"), {"push": wrench, "pull": wrench}, set())  # fmt: skip
    assert remedy.startswith("there are push, pull;")
    assert _find_faults("other", Load("f"), {}, set())[0][1].startswith("there are none;")


def test_coordinates_are_splines_of_their_columns() -> None:
    """By the column that is named, or by their own names; gaps of all are counted; units count."""
    t = np.arange(12.0)
    manifest = make_manifest(
        positions=("x", "y"), coordinates=[SimpleNamespace(name=n, unit=u) for n, u in (("x", "m"), ("y", "rad"))]
    )
    gaps = np.where((t == 3) | (t == 7) | (t == 8), np.nan, 2 * t)
    recording = record({"q[x]": t, "other": -t, "y": gaps}, {"y": "rad"}, t)
    tracks, bridged, left_open = _fit_coordinates(recording, manifest, Treatment(gap=2.5), {"x": "other"})
    assert (bridged, left_open) == (1, 1)
    assert tracks["x"].evaluate(np.array([3.5])) == pytest.approx([-3.5])
    assert tracks["y"].evaluate(np.array([3.0])) == pytest.approx([6.0])
    assert not tracks["y"].is_known(np.array([7.5])).any()
    tracks, *counts = _fit_coordinates(record({"q[x]": gaps, "y": gaps}, {}, t), manifest, Treatment(gap=2.5), {})
    assert counts == [2, 2]
    with pytest.raises(InputError, match='"y": it is in "m", and what it is read for is in rad'):
        _fit_coordinates(record({"x": t, "y": t}, {"y": "m"}, t), manifest, Treatment(gap=2.0), {})
    with pytest.raises(InputError) as error:
        _fit_coordinates(record({"z": t}, {}, t), manifest, Treatment(gap=2.0), {})
    assert [fault.finding for fault in error.value.faults] == [f'no column is named "q[{x}]"' for x in "xy"]


def test_loops_determine_coordinates_that_nobody_recorded() -> None:
    joints = [SimpleNamespace(name=name, unit="m") for name in "xy"]
    told = {"positions": ("x", "y"), "coordinates": joints, "loops": ("cut",)}
    tracks, *_ = _fit_coordinates(record({"y": T}), make_manifest(**told, independent=(1,)), Treatment(gap=2.0), {})
    assert list(tracks) == ["y"]
    with pytest.raises(InputError, match="no column is named"):
        _fit_coordinates(record({"y": T}), make_manifest(**told, independent=(1, 5)), Treatment(gap=2.0), {})


def test_coordinates_of_quaternions_have_no_velocity_of_their_own() -> None:
    joints = [SimpleNamespace(name=name, unit="") for name in ("ball.x", "ball.y", "ball.z", "hip")]
    positions = ("ball.a", "ball.b", "ball.c", "ball.d", "hip")
    manifest = make_manifest(positions=positions, coordinates=joints, quaternions=(0,))
    assert _pair_alone(manifest) == {3: "hip"}


def test_scaled_quaternions_have_the_derivatives_of_unit_ones() -> None:
    """q = (2 + sin t) n, with n = (a sin wt, cos wt): n, n' and n'' = -w^2 n; other coordinates are kept."""
    t, w, a = np.linspace(0.0, 2.0, 5), 1.3, np.array([0.6, 0.0, 0.8])
    n = np.column_stack((np.outer(np.sin(w * t), a), np.cos(w * t)))
    turned = w * np.column_stack((np.outer(np.cos(w * t), a), -np.sin(w * t)))
    r, rd, rdd = ((x[:, None]) for x in (2 + np.sin(t), np.cos(t), -np.sin(t)))
    rates = [r * n, rd * n + r * turned, rdd * n + 2 * rd * turned - r * w**2 * n]
    given = [np.column_stack((t, x, 7 * t)) for x in rates]
    found = scale(given, make_manifest(quaternions=(1,), positions=tuple("xabcdy")))
    for mine, expected, raw in zip(found, (n, turned, -(w**2) * n), given, strict=True):
        np.testing.assert_allclose(mine[:, 1:5], expected, rtol=1e-12, atol=1e-13)
        np.testing.assert_array_equal(mine[:, [0, 5]], raw[:, [0, 5]])
    np.testing.assert_array_equal(given[1][:, 1:5], rates[1])


# --- inverse dynamics -----------------------------------------------------------------------------------------------


def find_jump(t: Array, q: Array, qd: Array, names: tuple[str, ...] = ("x",)) -> tuple[float, str] | None:
    none = np.zeros((len(t), 0))
    forces = Forces(t, q, qd, qd, none, none, none, none, 0, none)
    joints = [SimpleNamespace(name=name) for name in ("x", "y")]
    return forces.find_jump(SimpleNamespace(coordinates=joints, positions=names))  # type: ignore[arg-type]


def test_places_that_leave_their_velocities_jump() -> None:
    """The mean of both velocities leaves at most a quarter of a step at the larger speed, or 1e-9."""
    t = np.array([0.0, 0.5, 1.0, 1.5])
    for speeds, step, has_jump in (
        ([2.0, 2.0], 0.5 * 2 + 0.249 * 0.5 * 2, False),
        ([2.0, 2.0], 0.5 * 2 + 0.251 * 0.5 * 2, True),
        ([2.0, 2.0], 0.5 * 2 - 0.251 * 0.5 * 2, True),
        ([-4.0, 0.0], -0.5 * 2 - 0.249 * 0.5 * 4, False),
        ([0.0, 4.0], 0.5 * 2 + 0.251 * 0.5 * 4, True),
        ([0.0, 0.0], 0.9e-9, False),
        ([0.0, 0.0], 1.1e-9, True),
    ):
        q, qd = np.zeros((4, 2)), np.zeros((4, 2))
        qd[1:3, 1] = speeds
        q[1, 1] = 0.25 * speeds[0]
        q[2, 1] = q[1, 1] + step
        q[3, 1] = q[2, 1] + 0.25 * speeds[1]
        assert find_jump(t, q, qd, ("x", "y")) == ((1.0, "y") if has_jump else None)
        assert find_jump(t, q, qd, ("x",)) is None
    assert find_jump(t[:2], np.array([[0.0, 0], [5.0, 5]]), np.zeros((2, 2)), ("x", "y")) is None
    assert find_jump(t[:3], np.array([[0.0, 0], [5.0, 0], [5.0, 9]]), np.zeros((3, 2)), ("x", "y")) == (0.5, "x")


def test_poses_are_extrapolated_by_the_parabola_through_the_last_ones() -> None:
    kernels: Any = SimpleNamespace(manifest=make_manifest(positions=("x", "y")))
    t = np.array([0.0, 0.3, 0.4, 1.0])
    q = np.column_stack((1 + 2 * t - 3 * t**2, 5 - t))
    assert _predict(t, list(q[:3]), kernels) == pytest.approx(q[3], rel=1e-12)
    assert _predict(t, list(q[1:3]), kernels) == pytest.approx(q[2] + (q[2] - q[1]) / 0.1 * 0.6, rel=1e-12)
    assert _predict(t[:2], list(q[:1]), kernels) is None
    assert _predict(t[:1], [], kernels) is None
    ball: Any = SimpleNamespace(manifest=make_manifest(positions=tuple("abcd"), quaternions=(0,)))
    turns = [np.array([0.0, 0, s, 1.0]) for s in (0.0, 1.0)]
    assert _predict(np.array([0.0, 1.0, 2.0]), turns, ball) == pytest.approx(np.array([0, 0, 2, 1]) / np.sqrt(5))


def test_words_of_inverse_dynamics() -> None:
    manifest = make_manifest()
    assert _describe(manifest, [0], 0.25, np.array([1 / 3])) == "t = 0.25 s, x = 0.333333"
    kernels: Any = SimpleNamespace(manifest=manifest)
    with pytest.raises(ArgumentError, match=r"cart was generated without impl$"):
        check_kernels(kernels)
    kernels.manifest = make_manifest(loops=("cut",), kernels=[SimpleNamespace(name=x) for x in ("impl", "loops")])
    with pytest.raises(ArgumentError, match=r"without loop_jacobian, loop_rates$"):
        check_kernels(kernels)
    kernels.manifest = make_manifest(kernels=[SimpleNamespace(name="impl")])
    check_kernels(kernels)
    rest = Forces(*[T] * 7, np.array([[1.0, -3], [0, 2]]), 0, T)
    assert rest.unbalanced.tolist() == [3.0, 2.0]
