"""Records of motions by hand: losses, forces and states that are kept, and warnings."""

from __future__ import annotations

import csv
import io
import json
import math
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.simulation.motion import (
    Bounces,
    ClosureRecord,
    Effort,
    Energy,
    Event,
    Halt,
    Impacts,
    Keeping,
    Kind,
    Segment,
    Settings,
    Strikes,
)
from mbsrun.simulation.record import _summarise, _tabulate, describe_settings
from mbsrun.simulation.simulate import (
    InsideError,
    _check_outside,
    _find_drift,
    _find_exceeded_limits,
    _find_singularity,
    _Record,
    _timed,
)

Array = NDArray[np.float64]

MODULE = import_module("mbsrun.simulation.simulate")  # the package has a function of this name


def make(**given: Any) -> Any:
    """Make a record at its start, with the parts that a test reads."""
    record: Any = _Record.__new__(_Record)
    vars(record).update(
        t=[0.0], q=[np.zeros(1)], qd=[np.zeros(1)], work=[0.0], inputs=[np.zeros(1)], rates=[], pushes=[], ends=[],
        events=[], modes=[], friction=1.0, impacts=2.0, losses=[(0.0, 0.0)], done=5.0, joints=None, piece=object(),
    )  # fmt: skip
    vars(record).update(given)
    return record


def test_losses_of_time_stepping_are_sums_of_steps() -> None:
    """States after steps 1 and 3 are kept, with the accelerations and forces of these steps."""
    record = make()
    losses = np.array([[0.25, 10.0], [0.5, 20.0], [1.0, 40.0]])  # of impacts, of friction
    strikes = Strikes(losses, np.array([[1.0], [2.0], [3.0]]), np.array([[4.0], [5.0], [6.0]]))
    record._add_strikes(strikes, np.array([1, 3]))
    assert record.losses == [(0.0, 0.0), (11.0, 2.25), (71.0, 3.75)]
    assert (record.friction, record.impacts) == (71.0, 3.75)
    assert np.array(record.rates).ravel().tolist() == [1.0, 1.0, 3.0]
    assert np.array(record.pushes).ravel().tolist() == [4.0, 4.0, 6.0]
    assert [x.tolist() for x in record.ends] == [[3.0], [6.0]]
    record._add_strikes(strikes, np.array([2]))
    assert record.losses[3:] == [(101.0, 4.5)]
    assert np.array(record.rates).ravel().tolist() == [1.0, 1.0, 3.0, 2.0]


def test_losses_between_events_are_sums_of_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of impacts before the steps, of impacts between them, and of friction in them; driven joints do work."""
    monkeypatch.setattr(MODULE, "add_up_friction", lambda *_: np.array([10.0, 20.0, 40.0, 80.0]))
    event = Event(0.0, "a", Kind.IMPACT, -1.0, 1.0)
    record, chunk = make(), SimpleNamespace(t=np.zeros(5))
    record._add_losses(chunk, Segment((1,), (event,), loss=0.25, driven=3.0), np.array([2, 4]))
    assert record.done == 8.0
    assert record.losses[1:] == [(31.0, 2.25), (151.0, 2.25)]
    assert (record.friction, record.impacts, record.events) == (151.0, 2.25, [event])
    assert record.modes == [(1,), (1,), (1,)]
    bounces = Bounces(np.array([1, 3]), (event, event), np.array([0.5, 1.0]), (), (0.5, 0.5))
    record.t = [0.0, 1.0, 2.0]
    record._add_losses(chunk, Segment((2,), bounces=bounces), np.array([1, 2, 3]))
    assert record.losses[3:] == [(161.0, 2.75), (181.0, 2.75), (221.0, 3.75)]
    assert (record.friction, record.impacts, len(record.events)) == (301.0, 3.75, 3)
    assert record.modes[3:] == [(2,), (2,), (2,)]


def test_forces_between_events_are_noted_at_states_that_are_kept() -> None:
    record = make()
    values = np.arange(4.0)[:, None]

    def push(*_: Any) -> tuple[Array, Array, None]:
        return 10 + values, 20 + values, None

    chunk = SimpleNamespace(t=values[:, 0], q=values, qd=values)
    record._add_pushes(chunk, push, np.array([2]))
    assert np.array(record.rates).ravel().tolist() == [10.0, 12.0]
    assert np.array(record.pushes).ravel().tolist() == [20.0, 22.0]
    assert [x.tolist() for x in record.ends] == [[13.0], [23.0]]
    record._add_pushes(chunk, push, np.array([1, 3]))
    assert np.array(record.rates).ravel().tolist() == [10.0, 12.0, 11.0, 13.0]


def test_the_last_state_is_kept_in_any_case() -> None:
    ends = [np.array([7.0]), np.array([8.0])]
    piece = SimpleNamespace(law=None, values=lambda t: 100 * t[:, None])
    given: dict[str, Any] = {"last": (np.array([3.0]), np.array([4.0])), "ends": ends, "modes": [(1,)], "piece": piece}
    record = make(last_time=2.0, **given)
    record.close()
    assert (record.t, record.work, record.modes) == ([0.0, 2.0], [0.0, 5.0], [(1,), (1,)])
    assert record.losses == [(0.0, 0.0), (1.0, 2.0)]
    assert (record.q[1].tolist(), record.qd[1].tolist(), record.inputs[1].tolist()) == ([3.0], [4.0], [200.0])
    assert (record.rates, record.pushes) == (ends[:1], ends[1:])
    for still in (make(last_time=0.0, **given), make(last_time=2.0, **{**given, "piece": None})):
        still.close()
        assert still.t == [0.0]


def test_forces_of_contacts_leave_stops_out_and_normal_parts_do_not() -> None:
    """Of two points, the second a stop: in the base frame, and along the normals."""
    points = SimpleNamespace(is_stop=False), SimpleNamespace(is_stop=True)
    normals = np.array([[[0.0, 1.0], [0.6, 0.0], [0.8, 0.0]]] * 2)  # (K, 3, points)

    class Kernels:
        manifest = SimpleNamespace(rigid=points, meetings=())

        def __call__(self, *_: Any, **__: Any) -> dict[str, Array]:
            return {"direction": normals}

    pushes = [np.array([1.0, 10.0, 20.0, 4.0, 5.0, 6.0]), np.array([2.0, 0.0, 10.0, 7.0, 8.0, 9.0])]
    found = make(kernels=Kernels(), pushes=pushes)._find_contacts(np.zeros((2, 1)))
    assert found[0].tolist() == [[1.0, 10.0, 20.0], [2.0, 0.0, 10.0]]
    assert found[1] == pytest.approx(np.array([[22.0, 4.0], [8.0, 7.0]]))
    none = make(kernels=Kernels())._find_contacts(np.zeros((2, 1)))
    assert (none[0].shape, np.isnan(none[0]).all(), none[1].shape) == ((2, 3), True, (2, 2))
    free = make(kernels=SimpleNamespace(manifest=SimpleNamespace(rigid=(), meetings=())))
    assert free._find_contacts(np.zeros((2, 1))) is None


# --- warnings -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("limit", "size"), [(0.5, 1.0), (40.0, 40.0), (-40.0, 40.0)])
@pytest.mark.parametrize("side", ["lower", "upper"])
def test_limits_that_nothing_keeps_are_warned_of(limit: float, size: float, side: str) -> None:
    """From the first time on at which they are exceeded by 1e-6, of their size or of 1."""
    sign = 1 if side == "upper" else -1
    other = "lower" if side == "upper" else "upper"
    joints = [
        SimpleNamespace(name="ball", lower=0.0, upper=0.0, stops=None),
        SimpleNamespace(name="stopped", lower=0.0, upper=0.0, stops=object()),
        SimpleNamespace(name="a", stops=None, **{side: limit, other: None}),
    ]
    kernels: Any = SimpleNamespace(manifest=SimpleNamespace(positions=("ball.qx", "stopped", "a"), coordinates=joints))
    t = np.array([0.0, 0.5, 1.0, 1.5])
    q = np.full((4, 3), 99.0)
    q[:, 2] = limit - sign * 9
    q[1, 2] = limit + sign * 0.9e-6 * size
    assert _find_exceeded_limits(kernels, t, q) == []
    q[2:, 2] = limit + sign * 1.1e-6 * size
    (found,) = _find_exceeded_limits(kernels, t, q)
    assert found == f"joint a is beyond its limit {limit:.4g} from t = 1 s on; nothing stops it there"


def test_drifts_of_energy_are_warned_of() -> None:
    kinetic, potential, work = np.array([1.0, 3.0, 2.0]), np.array([2.0, 0.0, 1.0]), np.zeros(3)
    assert _find_drift(Energy(kinetic, potential, work)) == []
    drifting = Energy(kinetic + np.array([0.0, -0.5, 0.25]), potential, work)
    (found,) = _find_drift(drifting)
    assert found.startswith(f"energy drifts by 0.5 J, where {drifting.exchanged:.2g} J are exchanged;")


def test_baumgartes_terms_are_doubted_beside_singular_poses() -> None:
    few, many = 0.99 * MODULE.SINGULAR, 1.01 * MODULE.SINGULAR
    for loops, pivot, is_doubted in (
        (Keeping.BAUMGARTE, few, True),
        (Keeping.BAUMGARTE, many, False),
        (Keeping.PROJECTION, few, False),
    ):
        found = _find_singularity(Settings(1.0, loops=loops), Effort(pivot=pivot))
        assert bool(found) == is_doubted


@pytest.mark.parametrize(
    ("method", "decay", "step", "warns"),
    [
        ("rk4", 0.99, 1.0, False),
        ("rk4", 1.01, 1.0, True),
        ("rk4", 1.01, 0.5, False),
        ("dop853", 0.99, None, False),
        ("dop853", 1.01, None, True),
    ],
)
def test_stiff_motion_is_warned_of(
    monkeypatch: pytest.MonkeyPatch, method: str, decay: float, step: float | None, warns: bool
) -> None:
    """Decay times step at the limit of stability of fixed steps, or at half of it, of adaptive ones."""
    own = MODULE.METHODS[method]
    asked: list[float] = []
    fixed = step is not None
    rate = decay * own.stability * (1.0 if fixed else 0.5)

    def find(_dynamics: Any, q: Array, *_: Any) -> tuple[float, str]:
        asked.append(float(q[0]))
        return (rate, "b") if q[0] else (rate / 3, "a")

    monkeypatch.setattr(MODULE.adaptive, "find_stability", find)
    monkeypatch.setattr(MODULE, "Dynamics", lambda *_: None)
    record = make(settings=Settings(9000.0, method, step=step or 1e-3), is_closed=False, kernels=None)
    count = 9000
    t, q = np.linspace(0, 9000.0, 5), np.arange(5.0)[:, None]
    found = record._find_stiffness(Effort(steps=count), t, q, q, q)
    assert asked == [0.0, 2.0]
    assert bool(found) == warns
    if warns:
        assert found[0].startswith(f"stiff: motion of joint b decays at {rate:.3g} 1/s")
        assert f"must stay below {own.stability / rate:.2g} s;" in found[0]
    record.is_closed = True
    assert record._find_stiffness(Effort(steps=count), t, q, q, q) == []
    record.is_closed = False
    assert record._find_stiffness(Effort(steps=count), 0 * t, q, q, q) == []
    record.settings = Settings(1.0, "radau")
    assert record._find_stiffness(Effort(steps=count), t, q, q, q) == []


@pytest.mark.parametrize(("part", "warns"), [(0.99, False), (1.01, True)])
def test_motion_that_decays_a_few_times_alone_is_not_stiff(
    monkeypatch: pytest.MonkeyPatch, part: float, warns: bool
) -> None:
    """Up to 500 times in adaptive steps; a motion without a step has one."""
    monkeypatch.setattr(MODULE.adaptive, "find_stability", lambda *_: (500.0 * part, "a"))
    monkeypatch.setattr(MODULE, "Dynamics", lambda *_: None)
    record = make(settings=Settings(1.0, "dop853"), is_closed=False, kernels=None)
    t, q = np.array([0.0, 1.0]), np.zeros((2, 1))
    for steps in (0, 1):
        assert bool(record._find_stiffness(Effort(steps=steps), t, q, q, q)) == warns
        slow = np.array([0.0, 1e-9])
        assert record._find_stiffness(Effort(steps=steps), slow, q, q, q) == []


@pytest.mark.parametrize(("depth", "is_inside"), [(0.9e-6, False), (1.1e-6, True)])
def test_starts_inside_the_other_side_are_refused(depth: float, is_inside: bool) -> None:
    """From a micrometre on, with the deepest point's name."""
    points = [SimpleNamespace(name=x, is_stop=False, is_coupling=False) for x in "ab"]

    class Kernels:
        manifest = SimpleNamespace(rigid=points, meetings=())

        def __call__(self, *_: Any, **__: Any) -> dict[str, Array]:
            return {"clearance": np.array([[-0.5e-6], [-depth]])}

    kernels: Any = Kernels()
    if is_inside:
        with pytest.raises(InsideError, match=r"contact b starts 1\.1e-06 m inside"):
            _check_outside(kernels, np.zeros(1))
    else:
        _check_outside(kernels, np.zeros(1))


def test_processor_time_of_steps_adds_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the steps alone, without the time between them."""
    clock = iter([1.0, 3.0, 10.0, 14.0, 20.0, 28.0])
    monkeypatch.setattr(MODULE.time, "process_time", lambda: next(clock))
    effort: Any = Effort()
    chunks: Any = iter(["a", "b"])
    passed: list[Any] = list(_timed(chunks, effort))
    assert passed == ["a", "b"]
    assert effort.seconds == 14.0


def test_accelerations_are_noted_unknown_or_computed_by_their_modes() -> None:
    """Time stepping notes its own; with impacts between steps, there are none; modes have their forces."""
    qd = np.ones((2, 1))
    record = make(
        strikes=(), switches=False, observer=SimpleNamespace(find_accelerations=lambda *_: "of the equations"),
        forces=SimpleNamespace(find_all=lambda *given: (f"of {given[-1]}", "multipliers", "driving")),
    )  # fmt: skip

    def find(modes: Any = None) -> Any:
        return record._find_accelerations(None, None, qd, None, modes)

    assert find() == "of the equations"
    assert find("modes") == "of modes"
    record.switches = True
    assert find("modes") == "of modes"
    record.strikes = (1,)
    assert np.isnan(find("modes")).all()
    assert find("modes").shape == (2, 1)
    record.rates = [[1.0], [2.0]]
    assert find().tolist() == [[1.0], [2.0]]


# --- files ----------------------------------------------------------------------------------------------------------


def describe(kind: str, **given: Any) -> tuple[Any, Any]:
    """Make a motion of a slider and a bob, and a stand-in of its kernels."""
    joints = [
        SimpleNamespace(name="s", unit="m", force_unit="N", is_smooth=True),
        SimpleNamespace(name="b", unit="rad", force_unit="N m", is_smooth=False),
    ]
    loop = SimpleNamespace(name="cut", cut="constraint", equations=("h",), redundant=())
    manifest: Any = SimpleNamespace(
        model="cart", model_hash="h4", coordinates=joints, positions=("s", "b"), configuration=(), inputs=("s",),
        actuated=(0,), loops=(loop,), driven=(1,), quaternions=(), wrenches=(), signals=(), frames=(),
        equations=("cut.h",),
    )  # fmt: skip
    x = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    energy = Energy(np.array([1.0, 4, 2]), np.array([10.0, 20, 40]), np.array([0.0, 7, 9]), *given.pop("losses", ()))
    motion: Any = SimpleNamespace(
        t=np.array([0.0, 0.5, 1.5]), q=x, qd=10 * x, inputs=100 * x[:, :1], energy=energy, halt=None, closure=None,
        warnings=("a",), modes=None, events=(), effort=Effort(3), settings=Settings(1.5, "rk4"), is_complete=True,
        numbers=SimpleNamespace(label="{} [x]".format),
    )  # fmt: skip
    vars(motion).update(given)
    return motion, SimpleNamespace(manifest=manifest, parameters={"k": 2.0}) if kind == "kernels" else manifest


def summarise(**given: Any) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(_summarise(*describe("kernels", **given)))
    return found


def test_a_summary_has_the_energies_at_both_ends_and_the_last_state() -> None:
    """The total at the start and at the end, the work and the losses until then; the largest drift of all times."""
    found = summarise()
    drift = max(abs(24 - 11 - 7.0), abs(42 - 11 - 9.0))
    assert found["energy"] == {"start": 11.0, "end": 42.0, "work": 9.0, "largest_drift": drift}
    assert found["end"] == {"t": 1.5, "q": [5.0, 6.0], "qd": [50.0, 60.0]}
    assert (found["complete"], found["halt"], found["warnings"]) == (True, None, ["a"])
    assert (found["model"], found["model_hash"], found["parameters"]) == ("cart", "h4", {"k": 2.0})
    assert (found["coordinates"], found["inputs"], found["effort"]["steps"]) == (["s", "b"], ["s"], 3)
    assert {"configuration", "closure", "modes", "events"}.isdisjoint(found)
    losses = (np.array([0.0, 1, 3]), np.array([0.0, 2, 5]))
    energy = summarise(losses=losses)["energy"]
    assert (energy["friction"], energy["impacts"], energy["largest_drift"]) == (3.0, 5.0, 42 - 11 - 9 + 8)
    assert summarise(energy=None)["energy"] is None
    assert summarise(losses=(None, losses[1]))["energy"].keys().isdisjoint({"friction"})


def test_a_summary_has_what_ends_a_motion_and_what_happens_on_the_way() -> None:
    halt = Halt(1.5, None, "it is singular", "look there")
    event = Event(0.5, "b", Kind.IMPACT, -1.0, 0.5)
    closure = ClosureRecord(np.zeros(3), np.zeros(3), (1e-9, 2e-9), np.zeros((3, 1)), np.zeros((3, 1)))
    modes = np.zeros((3, 2), dtype=int)
    found = summarise(halt=halt, is_complete=False, events=(event,), modes=modes, closure=closure)
    assert (found["complete"], found["halt"]["finding"]) == (False, "it is singular")
    assert found["events"] == [{"t": 0.5, "joint": "b", "event": "hits", "before": -1.0, "after": 0.5}]
    assert found["modes"] == {"backward": -1, "free": 0, "forward": 1, "sticks": 2, "lower": 3, "upper": 4}
    closed = {"loops": ["cut"], "driven": ["b"], "largest_position": 1e-9, "largest_velocity": 2e-9}
    assert found["closure"] == closed


def test_settings_that_matter_are_listed() -> None:
    """Of the method, of loops and impacts that are not the first ones, and of latches, which may have no end."""
    plain = describe_settings(Settings(2.0, "rk4", step=1e-2))
    assert plain == {"duration": 2.0, "method": "rk4", "step": 1e-2, "formulation": "exp2"}
    assert {"rtol", "atol"} <= describe_settings(Settings(2.0)).keys()
    latch: Any = SimpleNamespace(name="hook", times=((0.5, 1.0), (2.0, math.inf)))
    found = describe_settings(
        Settings(2.0, "rk4", loops=Keeping.BAUMGARTE, impacts=Impacts.POISSON, alpha=3.0, beta=4.0, latches=(latch,))
    )
    assert found["latches"] == {"hook": [[0.5, 1.0], [2.0, None]]}
    assert (found["loops"], found["impacts"], found["alpha"], found["beta"]) == ("baumgarte", "poisson", 3.0, 4.0)
    kept = describe_settings(Settings(2.0, "rk4", loops=Keeping.PROJECTION))
    assert kept["loops"] == Keeping.PROJECTION.value
    assert {"alpha", "beta", "impacts", "latches"}.isdisjoint(kept)


def tabulate(**given: Any) -> dict[str, list[float]]:
    header, *rows = csv.reader(io.StringIO(_tabulate(*describe("manifest", **given), [])))
    return {name: [float(row[k]) for row in rows] for k, name in enumerate(header)}


def test_a_table_has_a_row_for_each_time() -> None:
    found = tabulate()
    assert found["t [s]"] == [0.0, 0.5, 1.5]
    assert [x for name, x in found.items() if name.startswith("q[b]")] == [[2.0, 4.0, 6.0]]
    assert [x for name, x in found.items() if name.startswith("qd[s]")] == [[10.0, 30.0, 50.0]]
    assert [x for name, x in found.items() if name.startswith("input[s]")] == [[100.0, 300.0, 500.0]]
    assert (found["kinetic [J]"], found["potential [J]"]) == ([1, 4, 2], [10, 20, 40])
    assert found["work [J]"] == [0, 7, 9]
    assert not [name for name in found if name.startswith(("friction", "impacts", "mode", "open"))]
    assert "work [J]" not in tabulate(energy=None)
    losses = (np.array([0.0, 1, 3]), np.array([0.0, 2, 5]))
    both = tabulate(losses=losses)
    assert (both["friction [J]"], both["impacts [J]"]) == ([0, 1, 3], [0, 2, 5])
    assert "friction [J]" not in tabulate(losses=(losses[0], None))
    assert "impacts [J]" not in tabulate(losses=(None, losses[1]))


def test_a_table_has_modes_of_joints_that_switch_and_forces_of_loops() -> None:
    modes = np.array([[0, 2], [0, 1], [0, -1]])
    closure = ClosureRecord(
        np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.5, 0.6]), (1.0, 2.0), np.full((3, 1), 7.0), np.full((3, 1), 8.0)
    )
    found = tabulate(modes=modes, closure=closure)
    assert found["mode[b]"] == [2, 1, -1]
    assert "mode[s]" not in found
    assert (found["open"], found["opening"]) == ([0.1, 0.2, 0.3], [0.4, 0.5, 0.6])
    assert [7.0] * 3 in found.values()
    assert [8.0] * 3 in found.values()
