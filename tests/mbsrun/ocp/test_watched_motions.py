"""Motions that are watched: worst places of bounds, kinks and poles of expressions, steps that are read; by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.expressions import parse
from mbsrun.jets import Jet
from mbsrun.ocp.ground.status import INFEASIBLE
from mbsrun.ocp.problem.problem import Range
from mbsrun.ocp.solution.solution import Margin, Margins
from mbsrun.ocp.solving import singularities
from mbsrun.ocp.solving.margins import Watch, Watched, _measure, find_tolerated
from mbsrun.ocp.solving.resimulation import Step, _read_steps
from mbsrun.ocp.solving.singularities import (
    Singularity,
    Stated,
    _advise,
    _find_singular_part,
    _find_wrong,
    _find_zero,
    _read_sides,
    find_cause,
    find_in_links,
)
from mbsrun.ocp.solving.stepping import Span, Stepper, _read_each
from mbsrun.simulation.motion import Chunk

Array = NDArray[np.float64]
INF = np.inf


@pytest.mark.parametrize(
    ("limits", "values", "tolerated"),
    [
        ((0.0, 2.0), [0.5, 2.5, 1.0], 0.02),  # the length of the range
        ((0.0, 9.0), [1.0, 1.5], 0.005),  # the spread
        ((-INF, 3.0), [0.0, 9.0], 0.03),  # the magnitude of the only limit
        ((-4.0, INF), [-9.0, 0.0], 0.04),
        ((-INF, 0.0), [-1.0, 4.0], 0.05),  # a limit of 0 is no scale
        ((5.0, 5.0), [5.0, 5.0], 0.05),  # an equation has the limit's
        ((0.0, INF), [1e-9, 1e-9], 1e-7),
        ((-INF, 1e3), [1e3, 1e3 + 1e-2], 1.00001e-3),
        ((0.0, 1.0), [np.nan], 1e-7),
        ((0.0, 2.0), [0.5, np.nan, 2.5], 0.02),
    ],
)
def test_a_violation_counts_from_a_hundredth_of_a_scale_on(
    limits: Range, values: list[float], tolerated: float
) -> None:
    assert find_tolerated(limits, np.array(values)) == pytest.approx(tolerated, rel=1e-12)


def test_values_leave_a_range_by_their_distance_and_without_end_where_there_are_none() -> None:
    found = _measure(np.array([0.5, 3.0, -2.0, np.nan]), (0.0, 1.0))
    assert found.tolist() == [-0.5, 2.0, 2.0, INF]
    assert _measure(np.array([1.0]), (-INF, INF)).tolist() == [-INF]


def watch(*watched: Watched, intervals: int = 3, slacks: tuple[int, ...] = ()) -> Watch:
    own: Any = object.__new__(Watch)
    own.watched, own._intervals, own._slacks = list(watched), intervals, list(slacks)
    own._values = lambda parts: np.zeros((len(parts["t"]), 0))
    return own  # type: ignore[no-any-return]


def test_the_worst_place_of_a_bound_is_found_between_samples() -> None:
    """Of 1 - (t - 1.37)^2, at 1.37 in the second interval, to 16^-5 of it; a constant has its own, once."""
    calls: list[int] = []

    def read(k: Array, c: Array) -> dict[str, Array]:
        t = k + c
        calls.append(len(t))
        return {"t": t[:, None], "q": np.stack((1 - (t - 1.37) ** 2, np.full_like(t, 0.25)), axis=1)}

    found = watch(Watched("x", (-INF, 0.9), "q", 0), Watched("y", (0.0, 9.0), "q", 1)).measure(read)
    x, y = found.each
    assert (x.interval, x.time) == (1, pytest.approx(1.37, abs=2 * 16.0**-5))
    assert x.value == pytest.approx(1.0, abs=1e-10)
    assert x.violation == pytest.approx(0.1)
    assert (y.value, y.tolerated) == (0.25, pytest.approx(0.09))
    assert calls == [51, *[33] * 4, 2]
    excess = [
        max(1 - (t - 1.37) ** 2 for t in ts) - 0.9
        for ts in np.linspace(0, 3, 49)[[range(17), range(16, 33), range(32, 49)]]
    ]
    tolerated = x.tolerated
    assert found.intervals == pytest.approx(
        (max(excess[0], 0) / tolerated, 0.1 / tolerated, max(excess[2], 0)), abs=1e-9
    )
    assert watch(intervals=2).measure(read) == Margins((), (0.0, 0.0))
    nothing = watch(Watched("x", (-INF, -1e9), "q", 0), intervals=1).measure(
        lambda k, _c: {"t": np.zeros((len(k), 1)), "q": np.full((len(k), 1), np.nan)}
    )
    assert nothing.intervals == (1e6,)


def test_slacks_widen_ranges_in_the_intervals_beside_theirs() -> None:
    own = watch(intervals=4, slacks=(1,))
    slack = np.array([0.0, 5.0, 1.0, 2.0])
    read = own._widen(lambda k, _c: {"controls": np.stack((slack[k], slack[k]), axis=1)})
    found = read(np.array([0, 1, 2, 3]), np.zeros(4))["controls"]
    assert found.T.tolist() == [[0, 5, 1, 2], [5, 5, 5, 2]]


def test_margins_are_ordered_by_what_is_tolerated() -> None:
    one, two = Margin("a", 1.5, (0.0, 1.0), 0.5, 0, 0.1), Margin("the bounds of b", -3.0, (-2.0, 1.0), 0.25, 1, 0.5)
    kept = Margin("c", 1.1, (0.0, 1.0), 0.5, 0, 0.2)
    found = Margins((kept, two, one), (0.0,))
    assert found.worst is one
    assert found.violated == (one, two)
    assert (one.violation, two.violation, kept.is_kept) == (0.5, 1.0, True)
    assert two.describe() == "b is -3 at 0.25 s, 1 below its limit -2"
    assert one.describe() == "a is 1.5 at 0.5 s, 0.5 above its limit 1"
    assert Margins((), ()).worst is None


@pytest.mark.parametrize(
    ("values", "place"),
    [
        ([1.0, 2.0, 3.0], None),
        ([1.0, 0.0, 3.0], 1),
        ([1.0, 2.0, -3.0, 1.0], 1),
        ([1.0, 0.9e-6, 0.5], 1),
        ([1.0, 1.1e-6, 0.5], None),
        ([1.0, 2.0, 0.0], None),  # at the last one, nothing follows
        ([0.0], 0),
        ([0.0, 0.0], 0),
        ([3.0], None),
        ([1.0, np.nan, 2.0], 1),
    ],
)
def test_a_kink_is_met_where_numbers_vanish_or_change_their_sign(values: list[float], place: int | None) -> None:
    assert _find_zero(np.array(values)) == place


def test_the_first_place_without_a_number_is_named_with_its_order() -> None:
    fine, g, H = np.ones(3), np.ones((3, 2)), np.ones((3, 2, 2))
    assert _find_wrong(Jet(fine, g, H), 3) == (None, "")
    assert _find_wrong(Jet(np.array([1.0, np.inf, np.nan]), g, H), 3) == (1, "value")
    g[2, 1] = np.nan
    assert _find_wrong(Jet(fine, g, H), 3) == (2, "derivative")
    g[2, 1] = 1
    H[1, 0, 1] = np.inf
    assert _find_wrong(Jet(fine, g, H), 3) == (1, "second derivative")
    assert _find_wrong(Jet(np.array([np.nan]), g, H), 3) == (0, "value")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x/(y - 1)", "on which y - 1 is not 0, or write it without"),
        ("y**(-2)", "on which y is not 0"),
        ("y**2", "guess another motion, or"),
        ("sqrt(y)", "on which y is positive, or write the square"),
        ("log(y)", "on which y is positive"),
        ("asin(y)", "between -1 and 1"),
        ("acos(y)", "between -1 and 1"),
        ("atan2(x, y)", "both arguments are 0"),
        ("exp(y)", "guess another motion, or"),
    ],
)
def test_the_remedy_is_of_the_part(text: str, words: str) -> None:
    assert words in _advise(parse(text))


def test_the_innermost_part_is_named_with_its_time() -> None:
    x = np.array([4.0, 1.0, 0.0])
    jet = Jet(x, np.ones((1, 1)), np.zeros((1, 1, 1)))
    stated = Stated("cost.running[0]", "running cost", "3 + 2*sqrt(x)")
    found = _find_singular_part(stated, {"x": jet}, np.array([0.0, 0.5, 0.75]))
    assert found is not None
    assert (found.part, found.finding, found.time) == ("sqrt(x)", "has no finite derivative", 0.75)
    assert found.describe("the guess") == (
        "sqrt(x) has no finite derivative at t = 0.75 s of the guess (in the running cost 3 + 2*sqrt(x))"
    )
    whole = Singularity(Stated("", "rate of s:", "sqrt(x)"), "sqrt(x)", "has no finite value", "", 0.5)
    assert whole.describe("m") == "sqrt(x) has no finite value at t = 0.5 s of m (the rate of s)"
    assert _find_singular_part(Stated("", "", "x**2"), {"x": jet}, np.zeros(3)) is None


def test_a_cause_is_looked_for_at_the_guess_then_at_the_end_then_as_a_kink(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[str, Any]] = []
    told = Singularity(Stated("place", "cost", "x"), "x", "is odd", "mend it", 0.0)
    singular: dict[Any, Any] = {}
    monkeypatch.setattr(singularities, "find_singularity", lambda *x: seen.append(("s", x[2])) or singular.get(x[2]))
    monkeypatch.setattr(singularities, "find_kink", lambda *x: seen.append(("k", x[2])) or singular.get("kink"))

    def find(status: str, end: Any) -> Any:
        seen.clear()
        return find_cause(None, None, SimpleNamespace(status=status), "first", end)  # type: ignore[arg-type]

    assert find(INFEASIBLE[0], "last") is None
    assert seen == []
    assert find("Lost", "last") is None
    assert seen == [("s", "first"), ("s", "last"), ("k", "last")]
    assert find("Lost", None) is None
    assert seen == [("s", "first"), ("k", "first")]
    singular["last"] = told
    found = find("Lost", "last")
    assert (found.remedy, found.place) == ("mend it", "place")
    assert "of the motion where the search ended" in found.finding
    singular.clear()
    singular["kink"] = told
    assert "of the guess" in find("Lost", None).finding


def span(begin: float, *ends: float) -> Span:
    """Make the motion (t, 1) in chunks of two steps each."""
    chunks = []
    for end in ends:
        t = np.array([begin, (begin + end) / 2, end])

        def read(at: Array, step: NDArray[np.intp], t: Array = t) -> tuple[Array, Array]:
            assert ((t[step] <= at + 1e-12) & (at <= t[step + 1] + 1e-12)).all()
            return at[:, None], np.ones((len(at), 1))

        chunks.append(Chunk(t, t[:, None], np.ones((3, 1)), read))
        begin = end
    return Span(tuple(chunks), 0.0)


def test_spans_are_read_in_the_step_of_each_time() -> None:
    whole = span(0.0, 1.0, 3.0)
    assert whole.end.tolist() == [3.0, 1.0]
    assert whole.steps[0].tolist() == [0.0, 0.5, 1.0, 2.0]
    assert whole.steps[1].tolist() == [[0, 1], [0.5, 1], [1, 1], [2, 1]]
    times = np.array([3.0, 0.0, 0.5, 1.0, 2.5, 0.75])
    assert whole.read(times)[:, 0] == pytest.approx(times)
    found = _read_each([whole, span(3.0, 4.0)], np.array([1, 0, 1]), np.array([3.5, 2.5, 4.0]))
    assert found.tolist() == [[3.5, 1.0], [2.5, 1.0], [4.0, 1.0]]


def test_steps_of_several_motions_are_read_at_fractions_of_each() -> None:
    """Two motions over 4 s of the integrator's time: state (t, motion), in steps to 1/4 and to 1."""

    def dense(at: Array) -> Array:
        return np.array([at, 0 * at, at, 0 * at + 1])

    steps = [Step(end, dense, 4.0, (2, 2)) for end in (0.25, 1.0)]  # type: ignore[arg-type]
    motions, fractions = np.array([1, 0, 1, 0]), np.array([0.1, 0.25, 1.0, 0.5])
    assert _read_steps(steps, motions, fractions).tolist() == [[0.4, 1], [1, 0], [4, 1], [2, 0]]
    beyond = _read_steps(steps, np.array([0]), np.array([1 + 1e-12]))
    assert beyond[0, 0] == pytest.approx(4.0)


def gather(*spans: Span, law: Any = None) -> tuple[Any, list[Any]]:
    """Return what reads several spans, and the steps that it starts from."""
    asked: list[Any] = []

    def read_pieces(pieces: Any, which: Any, begins: Array, lengths: Array, starts: Array) -> Array:
        asked.append((len(pieces), which.tolist(), begins.tolist(), starts[:, 0].tolist()))
        return begins + lengths

    stepper: Any = SimpleNamespace(_equations=SimpleNamespace(kept={"plant": SimpleNamespace(read_pieces=read_pieces)}))
    pieces: Any = [SimpleNamespace(law=law)] * len(spans)
    return Stepper.gather(stepper, pieces, spans), asked


def test_times_of_several_motions_are_read_from_the_step_of_their_own_motion() -> None:
    """Also at the time at which one ends and the next one begins, and beyond the last step by rounding."""
    read, asked = gather(span(0.0, 1.0), span(1.0, 2.0, 4.0), span(4.0, 8.0))
    which, times = np.array([0, 1, 0, 1, 1, 2, 2, 0]), np.array([1.0, 1.0, 0.25, 3.5, 4.0, 4.0, 8.0, 0.5])
    assert read(which, times) == pytest.approx(times)
    begins = [0.5, 1.0, 0.0, 3.0, 3.0, 4.0, 6.0, 0.5]
    assert asked == [(3, which.tolist(), begins, begins)]


def test_motions_whose_inputs_follow_the_state_are_read_one_by_one() -> None:
    read, asked = gather(span(0.0, 1.0), span(1.0, 2.0), law=1)
    assert read(np.array([1, 0]), np.array([1.5, 0.25])).tolist() == [[1.5, 1.0], [0.25, 1.0]]
    assert asked == []


# --- links ----------------------------------------------------------------------------------------------------------


class Side:
    """One side of a link: numbers of its motion at its start and at its end, by name."""

    def __init__(self, kinds: dict[str, str], start: float, end: float, times: tuple[float, ...] = (0.0, 2.0)) -> None:
        self.known = {name: SimpleNamespace(kind=kind) for name, kind in kinds.items()}
        self.start, self.end, self.times = start, end, np.array(times)

    def read_end(self, named: Any, *, is_last: bool) -> Array:
        base = self.end if is_last else self.start
        return np.array([[base + list(self.known).index(name) for name in named]])


KINDS = {"q_x": "q", "qd_x": "qd", "act": "states", "t": "t"}


@pytest.mark.parametrize(
    ("place", "names", "found"),
    [
        ("links[0].conditions[1]", ("end_q_x", "start_act"), {"end_q_x": 20, "start_act": 32}),
        ("links[0].conditions[1]", ("x", "q_x"), {}),
        ("links[0].map.y", ("x", "act", "t", "end_q_x", "start_t"), {"x": 20, "act": 22, "start_t": 33}),
        ("links[0].velocities.y", ("x", "act", "qd_x"), {"x": 21}),
    ],
)  # fmt: skip
def test_expressions_of_links_read_the_end_before_and_the_start_after(
    place: str, names: tuple[str, ...], found: dict[str, float]
) -> None:
    """Conditions by names of both; maps and velocities by coordinates, states and velocities of the phase before."""
    before, after = Side(KINDS, 10.0, 20.0), Side(KINDS, 30.0, 40.0)
    stated = Stated(place, "title", "text")
    read = _read_sides(stated, names, before, after)  # type: ignore[arg-type]
    assert {name: x.tolist() for name, x in read.items()} == {name: [x] for name, x in found.items()}


def test_expressions_of_a_link_are_listed_with_their_places() -> None:
    link: Any = SimpleNamespace(
        source="a", target="b", map=(("y", "x"), ("z", None)), velocities=(("y", "2*x"),),
        conditions=[SimpleNamespace(expression="c0"), SimpleNamespace(expression="c1")],
        cost=[SimpleNamespace(expression="k0")],
    )  # fmt: skip
    found = [(x.place, x.title, x.text) for x in singularities._list_of_link(3, link)]
    assert found == [
        ("links[3].map.y", "y by link a to b:", "x"),
        ("links[3].velocities.y", "y by link a to b:", "2*x"),
        ("links[3].conditions[0]", "condition of link a to b:", "c0"),
        ("links[3].conditions[1]", "condition of link a to b:", "c1"),
        ("links[3].cost[0]", "cost of link a to b:", "k0"),
    ]


def find_in_link(
    monkeypatch: pytest.MonkeyPatch, *conditions: str, ends: tuple[float, float] = (0.0, 4.0), unknown: float = 1.0
) -> Any:
    """Find what is singular in conditions of a link of two phases, whose coordinate x is at 0 where they meet."""
    sides = {"a": Side({"q_x": "q"}, 7.0, ends[0], (0.0, 2.5)), "b": Side({"q_x": "q"}, ends[1], 9.0, (0.0, 8.0))}
    monkeypatch.setattr(singularities, "_Points", lambda problem, *_: sides[problem])
    link = SimpleNamespace(
        source="a",
        target="b",
        map=(),
        velocities=(),
        cost=(),
        conditions=[SimpleNamespace(expression=x) for x in conditions],
    )
    problem: Any = SimpleNamespace(
        phases=[SimpleNamespace(problem="a"), SimpleNamespace(problem="b")], links=[link], find="ab".index,
        constants=(("k", 0.0),), every_unknown=[SimpleNamespace(name="n", guess=unknown)],
    )  # fmt: skip
    plants: Any = SimpleNamespace(phases=[None, None])
    return find_in_links(problem, plants, [None, None], "the guess")  # type: ignore[list-item]


def test_the_first_expression_of_a_link_without_a_number_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the time at which the phase before ends; constants and guesses of unknowns count."""
    found = find_in_link(monkeypatch, "start_q_x + n", "1/end_q_x", "log(end_q_x)")
    assert found.place == "links[0].conditions[1]"
    assert "1/end_q_x has no finite value at t = 2.5 s of the guess, phase a" in found.finding
    assert find_in_link(monkeypatch, "1/start_q_x", "sqrt(start_q_x)") is None
    assert find_in_link(monkeypatch, "sqrt(end_q_x + 1)", ends=(0.0, 4.0)) is None
    assert "derivative" in find_in_link(monkeypatch, "sqrt(end_q_x)").finding
    assert find_in_link(monkeypatch, "1/(n*start_q_x)", unknown=0.0).place == "links[0].conditions[0]"
    assert find_in_link(monkeypatch, "1/(start_q_x*k)").place == "links[0].conditions[0]"


def test_numbers_alone_and_impulses_are_no_expressions_to_look_at(monkeypatch: pytest.MonkeyPatch) -> None:
    assert find_in_link(monkeypatch, "1/0", "1/jz_foot") is None
    assert find_in_link(monkeypatch, "1/jz_foot", "1/end_q_x").place == "links[0].conditions[1]"
