"""Phases with modes that are simulated again: their intervals, which events and modes differ, and by how much.

Two phases last 1 and 2 s; the accuracy that is asked for is 1e-4, so that events may be 1 and 2 % of a second away.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsrun.ocp.problem.modes import FREE, LOWER, STICK, UPPER
from mbsrun.ocp.solving import following
from mbsrun.ocp.solving.following import TOUCHES, _list_rows, _place_start, _Run
from mbsrun.simulation.motion import Kind, Mode

LAW = SimpleNamespace(name="a", friction=None, stops=None)
RUBBING = SimpleNamespace(name="b", friction=object(), stops=None)


def make(*modes: dict[str, str], laws: Any = (), contacts: Any = (), inputs: Any = ("u",)) -> _Run:
    """Make a run of two phases with two and four intervals; q = t and qd = 10 t in each, from its own start."""
    coordinates = [SimpleNamespace(name=name) for name in "ab"]
    manifest = SimpleNamespace(
        coordinates=coordinates, positions=("a", "b"), open_joints=laws, open_contacts=contacts, inputs=("w", *inputs)
    )
    kernels = SimpleNamespace(manifest=SimpleNamespace(inputs=inputs))
    phases = []
    for k, (T, N) in enumerate(((1.0, 2), (2.0, 4))):
        t = np.linspace(0.0, T, N + 1)
        point_t = t[:-1, None] + np.array([0.25, 0.5])
        values = 100 * k + point_t[:, :, None]
        motion = SimpleNamespace(
            t=t, q=np.tile(t, (2, 1)).T, qd=10 * np.tile(t, (2, 1)).T, point_t=point_t, point_w=values,
            spread_inputs=lambda values=values: (0 * values - 7, None),
        )  # fmt: skip
        own = dict(modes[k]) if modes else {}
        problem = SimpleNamespace(asked_accuracy=1e-4, modes=tuple(own.items()))
        phases.append(SimpleNamespace(trajectory=motion, problem=problem))
    given: Any = (SimpleNamespace(manifest=manifest), kernels, phases)
    return _Run(*given, ("first", "second"))


def move(q: float = 0.0, qd: float = 0.0, **given: Any) -> Any:
    """Make the motion of a part that ends at a state."""
    usual = {"halt": None, "events": (), "t": np.array([0.0, 0.5]), "modes": np.zeros((2, 2), dtype=int)}
    own = {**usual, **given, "q": np.array([[9.0, 9.0], [q, q]]), "qd": np.array([[9.0, 9.0], [qd, qd]])}
    gaps = own.pop("gaps", {})

    class Moved(SimpleNamespace):
        def __getitem__(self, name: str) -> Any:
            return np.array([1.0, gaps[name]])

    return Moved(**own)


def test_parts_are_the_intervals_of_all_phases() -> None:
    parts = list(make().list_parts())
    assert [(part.begin, part.end) for part in parts] == [
        (0.0, 0.5), (0.5, 1.0), (1.0, 1.5), (1.5, 2.0), (2.0, 2.5), (2.5, 3.0)
    ]  # fmt: skip
    assert [(part.phase, part.mesh) for part in parts] == [(0, 1), (0, 2), (1, 1), (1, 2), (1, 3), (1, 4)]


def test_inputs_of_a_part_are_the_ones_that_the_closed_model_has() -> None:
    """Polynomials through the points, from time 0 of the part on; other inputs of the opened model are left out."""
    run = make(inputs=("v",))
    for part, start in zip(run.list_parts(), (0.0, 0.5, 100.0, 100.5, 101.0, 101.5), strict=True):
        (piece,) = run.drive(part).pieces
        assert (piece.start, piece.end) == (0.0, 0.5)
        for t in (0.0, 0.2, 0.5):
            value = piece.at(t, np.zeros(2), np.zeros(2))
            assert value == pytest.approx([start + t])


def test_the_error_of_a_part_leaves_out_velocities_where_a_phase_ends() -> None:
    """They may be before an impact or after it."""
    run = make()
    parts = list(run.list_parts())
    assert run.measure(parts[0], move(0.5, 5.0)) == 0.0
    assert run.measure(parts[0], move(0.5, 5.5)) == pytest.approx(0.5)
    assert run.measure(parts[0], move(0.7, 5.0)) == pytest.approx(0.2)
    assert run.measure(parts[1], move(1.25, 99.0)) == pytest.approx(0.25)
    assert run.measure(parts[4], move(1.5, 14.0)) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("time", "where"),
    [
        (0.009, ""),
        (0.011, "first"),
        (0.989, "first"),
        (0.991, ""),
        (1.019, ""),
        (1.021, "second"),
        (2.979, "second"),
        (2.981, ""),
    ],
)
def test_events_are_near_the_ends_of_phases(time: float, where: str) -> None:
    """Within the square root of the accuracy, relative to the duration of the phase."""
    run = make()
    part = next(part for part in run.list_parts() if part.begin <= time < part.end)
    event = SimpleNamespace(time=time - part.begin, joint="a", kind=Kind.IMPACT)
    found = run.compare(part, move(events=(event,)))
    expected = f"a {Kind.IMPACT.value} at {time:.6g} s, phase {where}, amid it" if where else ""
    assert found == expected
    assert run.find_margin(0) == pytest.approx(0.01)
    assert run.find_margin(1) == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("errors", "finding"),
    [
        ([0.0, 5e-5, 2e-5, 1e-5, 0.0, 3e-5], ""),
        ([0.0, 3e-4, 2e-5, 0.0, 0.0, 0.0], "its states differ by 3.0e-04, more than the accuracy asked for, 1.0e-04"),
    ],
)
def test_the_largest_error_of_all_parts_counts(
    errors: list[float], finding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each part begins where the one before ended; the motion is never put back."""
    run = make({"b": FREE}, {"b": FREE})
    parts, begun = list(run.list_parts()), list[tuple[float, float]]()

    def simulate(_kernels: Any, _drive: Any, q: Any, _qd: Any, settings: Any) -> Any:
        part = parts[len(begun)]
        begun.append((q[0], settings.duration))
        own = run.motions[part.phase]
        return move(own.q[part.mesh, 0] + errors[len(begun) - 1], own.qd[part.mesh, 0])

    monkeypatch.setattr("mbsrun.ocp.solving.following.simulate", simulate)
    assert run.go() == (pytest.approx(max(errors)), finding)
    assert [duration for _, duration in begun] == [0.5] * 6
    ends = [run.motions[part.phase].q[part.mesh, 0] + error for part, error in zip(parts, errors, strict=True)]
    assert [q for q, _ in begun] == pytest.approx([0.0, *ends[:-1]])


def test_a_simulation_that_ends_early_is_said() -> None:
    run = make()
    found = run.compare(list(run.list_parts())[3], move(halt="it stops", t=np.array([0.0, 0.25])))
    assert found == "it ends at 1.75 s, it stops"


def test_modes_are_compared_amid_each_phase() -> None:
    """The name of the joint, the time of the phase, and both modes; friction may hold a joint at a stop, too."""
    run = make({"a": FREE, "b": LOWER}, {"a": STICK, "b": UPPER}, laws=(LAW, RUBBING))
    parts = list(run.list_parts())
    free, sticks = int(Mode.FREE), int(Mode.STICKS)
    modes = lambda a, b: {"modes": np.array([[9, 9], [a, b]])}  # noqa: E731
    assert run.compare(parts[0], move(**modes(free, sticks))) == ""
    assert (
        run.compare(parts[0], move(**modes(free, free)))
        == f"b has mode {FREE} at 0.5 s of phase first, which states {LOWER}"
    )
    assert run.compare(parts[3], move(**modes(sticks, sticks))) == ""
    found = run.compare(parts[3], move(**modes(free, sticks)))
    assert found == f"a has mode {FREE} at 1 s of phase second, which states {STICK}"
    for other in (1, 2, 4, 5):
        assert run.compare(parts[other], move(**modes(free, free))) == ""


@pytest.mark.parametrize(("gap", "is_closed"), [(0.0, True), (0.9 * TOUCHES, True), (1.1 * TOUCHES, False)])
def test_contacts_are_closed_up_to_rounding(gap: float, is_closed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbsrun.ocp.solving.following.is_closed", lambda _, mode: mode == "closed")
    foot = SimpleNamespace(name="foot")
    for mode in ("closed", "open"):
        run = make({"foot": mode}, {"foot": mode}, contacts=(foot,))
        found = run.compare(next(iter(run.list_parts())), move(gaps={"gap_foot": gap}))
        word = "closed" if is_closed else "open"
        expected = "" if word == mode else f"foot has mode {word} at 0.5 s of phase first, which states {mode}"
        assert found == expected


def test_rows_of_phases_are_joined_by_links_in_their_order() -> None:
    def list_rows(modes: str, *links: tuple[str, str]) -> list[list[int]]:
        phases = tuple(SimpleNamespace(problem=SimpleNamespace(modes=m != "-")) for m in modes)
        joined = tuple(SimpleNamespace(source=a, target=b) for a, b in links)
        solution: Any = SimpleNamespace(names=tuple("abcd"[: len(modes)]), phases=phases, links=joined)
        return list(_list_rows(solution))

    every = (("a", "b"), ("b", "c"), ("c", "d"))
    assert list_rows("xxxx", *every) == [[0, 1, 2, 3]]
    assert list_rows("xx-x", *every) == [[0, 1], [3]]
    assert list_rows("-xx", *every) == [[1, 2]]
    assert list_rows("xxxx", ("a", "b"), ("d", "c")) == [[0, 1], [2], [3]]
    assert list_rows("--") == []


def test_a_start_is_put_on_its_stop_and_at_rest() -> None:
    """At a stop exactly, within both elsewhere; a closed joint rests."""
    stops = SimpleNamespace(lower=-1.0, upper=None)
    law = SimpleNamespace(name="b", friction=None, stops=stops)
    manifest: Any = SimpleNamespace(
        positions=("a", "b"), coordinates=[SimpleNamespace(name=name) for name in "ab"], open_joints=(law,)
    )
    for mode, q, at, rests in (
        (LOWER, -1.0 + 1e-9, -1.0, True),
        (FREE, -1.0 - 1e-9, -1.0, False),
        (FREE, 0.5, 0.5, False),
    ):
        problem: Any = SimpleNamespace(modes=(("b", mode),))
        motion: Any = SimpleNamespace(q=np.array([[7.0, q]]), qd=np.array([[8.0, 1e-9]]))
        found, speeds = _place_start(problem, motion, manifest)
        assert found.tolist() == [7.0, at]
        assert speeds.tolist() == [8.0, 0.0 if rests else 1e-9]
        assert motion.q[0, 1] == q
        assert math.isfinite(found[1])


# --- a whole run ----------------------------------------------------------------------------------------------------


def go(monkeypatch: pytest.MonkeyPatch, errors: list[float], finding: str = "") -> tuple[Any, list[Any]]:
    """Follow six parts with these errors; the third one may differ in a finding. Returns what each part starts from."""
    run, asked = make(), list[Any]()
    left = iter(errors)

    def follow(kernels: Any, drive: Any, q: Any, qd: Any, settings: Any) -> Any:
        assert (kernels, drive) == (run.kernels, "inputs")
        asked.append((np.asarray(q).tolist(), np.asarray(qd).tolist(), settings.duration, settings.rtol, settings.atol))
        return move(10.0 + len(asked), 20.0 + len(asked))

    monkeypatch.setattr(following, "simulate", follow)
    monkeypatch.setattr(following, "_place_start", lambda *_: (np.array([1.0]), np.array([2.0])))
    monkeypatch.setattr(run, "drive", lambda _: "inputs", raising=False)
    monkeypatch.setattr(run, "compare", lambda part, _: finding if (part.phase, part.mesh) == (1, 1) else "")
    monkeypatch.setattr(run, "measure", lambda *_: next(left))
    return run.go(), asked


def test_each_part_starts_where_the_one_before_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """At a tolerance of 1e-12; the largest error of all is judged by the accuracy that is asked for."""
    found, asked = go(monkeypatch, [0.0, 1e-5, 9e-5, 0.0, 1e-6, 0.0])
    assert found == (9e-5, "")
    assert asked[0] == ([1.0], [2.0], 0.5, 1e-12, 1e-12)
    for k in range(1, 6):
        assert asked[k][:2] == ([10.0 + k] * 2, [20.0 + k] * 2)
    assert go(monkeypatch, [1e-4, 0, 0, 0, 0, 0])[0] == (1e-4, "")
    largest, finding = go(monkeypatch, [0, 2e-4, 0, 0, 0, 0])[0]
    assert largest == 2e-4
    assert finding == "its states differ by 2.0e-04, more than the accuracy asked for, 1.0e-04"


def test_a_part_that_differs_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    found, asked = go(monkeypatch, [0.0] * 6, "it slides")
    assert (found, len(asked)) == ((None, "it slides"), 3)


def test_rows_of_phases_are_followed_by_their_own_mechanism(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the first phase of each row; a mechanism that cannot be opened is left out, and an error is a finding."""

    class Opened:
        def __init__(self, name: str) -> None:
            self.name = name

        def load_closed(self) -> str:
            return f"closed {self.name}"

    seen: list[Any] = []

    class Run:
        def __init__(self, plant: Any, kernels: Any, phases: Any, names: Any) -> None:
            seen.append((plant, kernels, [phase.name for phase in phases], names))
            self.names = names

        def go(self) -> tuple[float | None, str]:
            if "d" in self.names:
                raise ValueError("it cannot move")
            return 0.5, "late"

    monkeypatch.setattr(following, "Openable", Opened)
    monkeypatch.setattr(following, "_Run", Run)
    monkeypatch.setattr(following, "_list_rows", lambda _: iter([[1, 2], [0], [3]]))
    monkeypatch.setattr(following, "equip", lambda plant, problem, unknowns: (plant.name, problem, unknowns))
    phases = [
        SimpleNamespace(name=name, problem=f"problem {name}", trajectory=SimpleNamespace(unknowns=name))
        for name in "abcd"
    ]
    solution: Any = SimpleNamespace(phases=phases, names="abcd")
    plants: Any = SimpleNamespace(phases=[object(), Opened("B"), Opened("C"), Opened("D")])
    found = [(x.phases, x.error, x.finding) for x in following.follow_modes(solution, plants)]
    assert found == [(("b", "c"), 0.5, "late"), (("d",), None, "it cannot move")]
    assert seen == [
        (("B", "problem b", "b"), "closed B", ["b", "c"], ("b", "c")),
        (("D", "problem d", "d"), "closed D", ["d"], ("d",)),
    ]
