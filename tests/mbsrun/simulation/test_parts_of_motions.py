"""Small parts of motions by hand: chunks between impacts, directions across normals, and forces that are rounding."""

from __future__ import annotations

from importlib import import_module
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.kernel import KernelError
from mbsrun.simulation import sharing
from mbsrun.simulation.drive import DriveError
from mbsrun.simulation.dynamics import SingularError
from mbsrun.simulation.integration.contacts import Contacts, Search, span
from mbsrun.simulation.motion import PLACE, Bounces, Chunk, Event, Guard, Jump, Kind, Segment
from mbsrun.simulation.sharing import _list_motions
from tests.mbsrun.simulation.particles import Floor, drop

Array = NDArray[np.float64]


def test_directions_across_normals_are_a_frame() -> None:
    """Of length 1, at right angles, right-handed with the normal; the first is across its least axis."""
    rng = np.random.default_rng(1)
    normals = np.concatenate((np.eye(3), -np.eye(3), rng.standard_normal((6, 3))))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for n, first, second in zip(normals, *span(normals), strict=True):
        frame = np.stack((first, second, n))
        assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-14)
        assert np.linalg.det(frame) == pytest.approx(1.0)
        axis = int(np.abs(n).argmin())
        assert first[axis] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("along", [(0.0, 0.0), (5.0, 0.0)])
def test_a_normal_force_is_rounding_by_the_largest_acceleration(along: tuple[float, float]) -> None:
    """1e-9 of |row| a + |pull|, over the mobility row M^-1 row: (0.5 + 2) 7 + 3 = 20.5 over 0.25/4 + 4/8."""
    dynamics = drop(Floor(row=(0.5, -2.0), along=along), M=[[4.0, 0.0], [0.0, 8.0]])
    contacts = Contacts(dynamics)
    touch = contacts.touch(np.zeros((1, 2)), np.zeros((1, 2)))
    object.__setattr__(touch, "pull", np.array([[-3.0]]))
    search = Search(contacts, touch, (dynamics.M[None], np.array([[5.0, -7.0]])), [0], [])
    assert search._find_rounding(0) == pytest.approx(1e-9 * 20.5 / (0.25 / 4 + 4 / 8))
    still = drop(Floor(row=(0.0, 0.0)))
    contacts = Contacts(still)
    touch = contacts.touch(np.zeros((1, 2)), np.zeros((1, 2)))
    search = Search(contacts, touch, (np.eye(2)[None], np.array([[5.0, -7.0]])), [0], [])
    assert search._find_rounding(0) == 0


def test_steps_between_impacts_are_parts_of_a_chunk() -> None:
    """Each with the event before it, and with the chunk's own interpolation."""
    t = np.array([0.0, 1.0, 2.0, 2.0, 3.0, 3.0, 4.0])
    q, qd = np.arange(7.0)[:, None], 10 * np.arange(7.0)[:, None]
    events = tuple(Event(x, "a", Kind.IMPACT, -1.0, 1.0) for x in (2.0, 3.0))
    guards = tuple(Guard(PLACE, 0, 0, side, 0.0) for side in (1.0, -1.0))
    bounces = Bounces(np.array([3, 5]), events, np.array([0.25, 0.5]), guards, (0.7, 0.8))
    segment = Segment((1,), events=(events[0],) * 3, loss=9.0, driven=8.0, bounces=bounces)
    asked: list[list[int]] = []

    def read(times: Array, steps: NDArray[np.intp]) -> tuple[Array, Array]:
        asked.append(steps.tolist())
        return times, times

    parts = list(Chunk(t, q, qd, read, segment=segment).part())
    assert [x.t.tolist() for x in parts] == [[0.0, 1.0, 2.0], [2.0, 3.0], [3.0, 4.0]]
    assert [x.q[:, 0].tolist() for x in parts] == [[0.0, 1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]
    assert [x.qd[:, 0].tolist() for x in parts] == [[0.0, 10.0, 20.0], [30.0, 40.0], [50.0, 60.0]]
    owns = [x.segment for x in parts]
    assert [(x.loss, x.driven) for x in owns if x] == [(9.0, 8.0), (0.25, 0.0), (0.5, 0.0)]
    assert [x.events for x in owns if x] == [segment.events, (events[0],), (events[1],)]
    assert [x.guards for x in owns if x] == [(), (guards[0],), (guards[1],)]
    assert all(x is not None and x.bounces is None for x in owns)
    jumps: list[Jump] = [jump for x in owns if x for jump in x.jumps]
    assert [(j.before.tolist(), j.after.tolist(), j.joints, j.restitution) for j in jumps] == [
        ([20.0], [30.0], (0,), (0.7,)),
        ([40.0], [50.0], (0,), (0.8,)),
    ]
    for part in parts:
        assert part.dense is not None
        part.dense(np.zeros(2), np.array([0, 1]))
    assert asked == [[0, 1], [3, 4], [5, 6]]
    for whole in (Chunk(t, q, qd, segment=Segment((1,))), Chunk(t, q, qd)):
        assert list(whole.part()) == [whole]


def test_dependent_velocities_follow_from_independent_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """J Z = 0, with 1 for the independent ones themselves; without loops all are."""
    rng = np.random.default_rng(2)
    J = rng.standard_normal((3, 2, 5))
    monkeypatch.setattr(sharing, "Closure", lambda _: SimpleNamespace(jacobian=lambda _: J))
    kernels: Any = SimpleNamespace(manifest=SimpleNamespace(loops=("a",)))
    Z = _list_motions(kernels, np.zeros((3, 5)), [1, 2, 4])
    assert pytest.approx(np.zeros((3, 2, 3)), abs=1e-12) == J @ Z
    assert Z[:, [1, 2, 4]].tolist() == [np.eye(3).tolist()] * 3
    open_: Any = SimpleNamespace(manifest=SimpleNamespace(loops=()))
    assert _list_motions(open_, np.zeros((3, 5)), [0, 1]).tolist() == [np.eye(2).tolist()] * 3


@pytest.mark.parametrize("error", [SingularError("a"), DriveError("no", "mend"), KernelError.__new__(KernelError)])
def test_work_that_cannot_be_computed_is_unknown_from_then_on(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    """It counts as 0 for each step."""
    calls = []

    def fail(*given: Any) -> Array:
        calls.append(given)
        if len(calls) == 2:
            raise error
        return np.array([3.0, 4.0])

    simulate = import_module("mbsrun.simulation.simulate")  # the package has a function of this name
    monkeypatch.setattr(simulate, "add_up_work", fail)
    record: Any = simulate._Record.__new__(simulate._Record)
    record.piece, record.observer, record.work_is_known = object(), object(), True
    chunk: Any = SimpleNamespace(t=np.zeros(3))
    assert record._add_up(chunk).tolist() == [3.0, 4.0]
    assert record._add_up(chunk).tolist() == [0.0, 0.0]
    assert not record.work_is_known
    assert record._add_up(chunk).tolist() == [0.0, 0.0]
    assert len(calls) == 2
