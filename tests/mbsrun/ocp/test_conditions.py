"""Conditions on states of closed loops that are linear, a circle, or turn: there all is known by hand."""

from __future__ import annotations

from itertools import combinations, permutations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun.closure import Closure
from mbsrun.ocp.problem.conditions import (
    Completion,
    Stray,
    complete_pose,
    complete_velocities,
    find_divided_attitudes,
    find_open_states,
    find_strays,
    find_surplus,
    find_surplus_places,
    list_lengths,
)

Array = NDArray[np.float64]
A = np.array([[1.0, 1.0, 0, 0, 0], [0, 0, 1.0, -2.0, 1.0]])  # a pair, and a triple
b = np.array([0.5, 1.0])
NAMES = ("a", "b", "c", "d", "e")


class _Mechanism:
    """Loops h(q), with their Jacobian J(q); q' = E(q) qd, where quaternions turn."""

    def __init__(self, h: Any, J: Any, names: tuple[str, ...], quaternions: tuple[int, ...] = ()) -> None:
        n = len(names) - len(quaternions)
        self.h, self.J, self.quaternions = h, J, quaternions
        count = len(h(np.ones(len(names))))
        self.manifest = SimpleNamespace(
            independent=(),
            dependent=tuple(range(n)),
            positions=names,
            coordinates=tuple(SimpleNamespace(name=f"v{i}") for i in range(n)),
            owners=(0,) * count,
            loops=(SimpleNamespace(name="bar"),),
            quaternions=quaternions,
            configuration=quaternions,
            design=(),
        )

    def __call__(self, name: str, q: Array, qd: Array | None = None) -> dict[str, Array]:
        if name == "loops":
            return {"gap": np.array([self.h(x) for x in np.atleast_2d(q)])}
        if name == "rates":  # of one quaternion, (v, s)' = (s w + v x w, -v w) / 2, before all others
            assert qd is not None
            v, s, w = q[:, :3], q[:, 3:4], qd[:, :3]
            turn = np.concatenate((s * w + np.cross(v, w), -(v * w).sum(axis=1, keepdims=True)), axis=1) / 2
            return {"rate": np.concatenate((turn, qd[:, 3:]), axis=1)}
        J = np.array([self.J(x) for x in np.atleast_2d(q)])
        assert qd is not None
        return {"J": J, "hd": (J @ np.atleast_2d(qd)[..., None])[..., 0]}


def _linear() -> Closure:
    return Closure(_Mechanism(lambda q: A @ q - b, lambda _: A, NAMES))  # type: ignore[arg-type]


def _circle() -> Closure:
    """A point on the unit circle, q = (x, y)."""
    return Closure(_Mechanism(lambda q: np.array([q @ q - 1]) / 2, lambda q: q[None], ("x", "y")))  # type: ignore[arg-type]


def _greedy(rows: Array, chosen: Any) -> list[int]:
    """List the entries whose unit vectors add nothing to the ranks of these rows and of the ones before."""
    surplus, held = [], rows
    for i in chosen:
        more = np.concatenate((held, np.eye(rows.shape[1])[[i]]))
        if np.linalg.matrix_rank(more) == np.linalg.matrix_rank(held):
            surplus.append(i)
        held = more
    return surplus


def test_entries_that_follow_from_the_ones_before_are_surplus() -> None:
    """As the ranks of all choices of three and four entries of linear loops show, in their order."""
    closure, q = _linear(), np.zeros(5)
    for chosen in [*permutations(range(5), 3), *combinations(range(5), 4)]:
        wanted = _greedy(A, chosen)
        assert find_surplus(closure, q, chosen) == wanted
        assert find_surplus_places(closure, q, chosen) == wanted


def test_what_is_held_in_a_singular_pose_alone_is_no_surplus() -> None:
    """At (0, 1) the circle holds y, and x is free; beside it, either may be given, and the other one follows."""
    closure, top = _circle(), np.array([0.0, 1.0])
    assert find_surplus(closure, top, [1]) == find_surplus_places(closure, top, [1]) == []
    assert find_surplus(closure, top, [0, 1]) == find_surplus_places(closure, top, [0, 1]) == [1]
    assert find_surplus(closure, np.array([0.6, 0.8]), [1, 0]) == [0]


def test_a_pose_keeps_the_first_values_that_can_be_given_and_names_the_others() -> None:
    """a + b = 0.5 and c - 2 d + e = 1: of a and b one is kept; the others follow."""
    near = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    given = {1: 0.7, 0: 0.3, 3: 2.0}
    found = complete_pose(_linear(), near, given, (4, 2))
    assert found.kept == (1, 3, 4)
    assert found.gap is None
    np.testing.assert_allclose(found.values, [-0.2, 0.7, 1 + 2 * 2.0 - 0.5, 2.0, 0.5], atol=1e-12)
    (stray,) = found.strays
    assert (stray.index, stray.given) == (0, 0.3)
    assert stray.found == pytest.approx(-0.2)
    assert stray.distance == pytest.approx(0.5)


def test_usual_entries_give_way_to_given_ones() -> None:
    """A usual entry keeps its value where it is free, and is changed where a given one decides it."""
    near = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    found = complete_pose(_linear(), near, {1: 0.0}, (0, 1, 2, 3))
    assert found.kept == (1, 2, 3)
    np.testing.assert_allclose(found.values, [0.5, 0.0, 0.3, 0.4, 1.5], atol=1e-12)


def test_a_pose_out_of_reach_names_its_loop_and_its_gap() -> None:
    """x = 2 is not on the unit circle: the nearest place is (2, 0), open by 3/2; strays are not looked for."""
    found = complete_pose(_circle(), np.array([0.9, 0.3]), {0: 2.0}, ())
    assert found.gap is not None
    assert found.gap.name == "bar"
    assert found.gap.size >= 1.5
    assert not found.strays
    assert found.kept == (0,)
    assert find_strays(found, {0: 5.0, 1: 7.0}) == found


def test_velocities_follow_from_the_given_ones_and_others_are_0() -> None:
    given = {3: 1.0, 0: 2.0, 1: 3.0}
    found = complete_velocities(_linear(), np.zeros(5), given, (2, 4))
    assert found.kept == (3, 0, 2)
    np.testing.assert_allclose(found.values, [2.0, -2.0, 0.0, 1.0, 2.0], atol=1e-12)
    assert [(x.index, x.given) for x in found.strays] == [(1, 3.0)]


@pytest.mark.parametrize(("apart", "is_stray"), [(0.9e-6, False), (1.1e-6, True), (-0.9e-6, False), (-1.1e-6, True)])
def test_a_stray_differs_by_more_than_a_millionth(apart: float, is_stray: bool) -> None:
    found = find_strays(Completion(np.array([1.0, 2.0]), (0,)), {1: 2.0 + apart})
    assert bool(found.strays) is is_stray
    assert Stray(0, 1.0, -2.5).distance == 3.5


def _problem(q: Any, qd: Any, free: Any = (), end: tuple[Any, Any, Any] = ((), (), ()), unknowns: Any = ()) -> Any:
    ends = [tuple((i, 0.0) for i in entries) for entries in end]
    return SimpleNamespace(
        start_q=tuple(q),
        start_qd=tuple(qd),
        free_start=tuple(free),
        unknowns=tuple(SimpleNamespace(name=name) for name in unknowns),
        end=SimpleNamespace(coordinates=ends[0], velocities=ends[1], accelerations=ends[2]),
    )


CLOSED = np.array([0.2, 0.3, 1.0, 0.5, 1.0])
STILL, FIRST = np.zeros(5), np.eye(5)[0]


def test_a_closed_start_has_no_faults() -> None:
    """Neither at rest nor with velocities that keep it closed, or open it by rounding."""
    closure = _linear()
    assert not list(find_open_states(_problem(CLOSED, STILL), closure))
    moving = np.array([1.0, -1.0, 2.0, 1.0, 0.0])
    assert not list(find_open_states(_problem(CLOSED, moving), closure))
    assert not list(find_open_states(_problem(CLOSED, moving + 5e-7 * FIRST), closure))


def test_an_open_start_hides_what_its_velocities_do() -> None:
    """Both would be named where the start is closed."""
    found = find_open_states(_problem(CLOSED + 0.25 * FIRST, STILL + FIRST), _linear())
    assert [key for key, _, _ in found] == ["start_q"]


def test_an_open_start_is_named_by_its_gap() -> None:
    ((key, finding, remedy),) = find_open_states(_problem(CLOSED + 0.25 * FIRST, STILL + 1), _linear())
    assert (key, finding) == ("start_q", "the loop bar stays open by 0.25")
    assert "complete_pose" in remedy


def test_velocities_that_open_loops_are_named_by_their_rate() -> None:
    ((key, finding, remedy),) = find_open_states(_problem(CLOSED, STILL + 0.5 * FIRST), _linear())
    assert (key, finding) == ("start_qd", "the loops open at 0.5 m/s or 1/s")
    assert "complete_velocities" in remedy


def test_given_entries_of_a_start_are_independent() -> None:
    """All choices of free entries, of coordinates and of velocities: surplus as ranks show it, by its names."""
    closure = _linear()
    for size in range(1, 5):
        for free in combinations(range(5), size):
            kept = [i for i in range(5) if i not in free]
            surplus = _greedy(A, kept)
            for offset, names in ((0, NAMES), (5, tuple(f"v{i}" for i in range(5)))):
                found = list(find_open_states(_problem(CLOSED, STILL, [offset + i for i in free]), closure))
                named = ", ".join(names[i] for i in surplus)
                finding = f"{named} follows from the others by the loops"
                assert found == ([("free_start", finding, "leave it out")] if surplus else [])


@pytest.mark.parametrize(("place", "key"), [*enumerate(("coordinates", "velocities", "accelerations"))])
def test_conditions_on_the_end_are_independent(place: int, key: str) -> None:
    end: list[Any] = [(), (), ()]
    end[place] = (2, 0, 3, 1, 4)
    ((found, finding, _),) = find_open_states(_problem(CLOSED, STILL, end=tuple(end)), _linear())
    names = NAMES if key == "coordinates" else [f"v{i}" for i in range(5)]
    assert found == f"end.{key}"
    assert finding == f"{names[1]}, {names[4]} follows from the others by the loops"
    end[place] = (2, 0, 3)
    assert not list(find_open_states(_problem(CLOSED, STILL, end=tuple(end)), _linear()))


class _Sized(Closure):
    """A mechanism whose loops read two lengths."""

    parameters = ("reach", "width")  # type: ignore[assignment]


def test_lengths_that_are_looked_for_are_the_ones_that_loops_read() -> None:
    closure = _Sized(_linear().plant)
    problem = _problem(CLOSED, STILL, unknowns=("mass", "width", "reach"))
    assert list_lengths(problem, closure) == ("reach", "width")
    assert list_lengths(problem, None) == ()
    assert list_lengths(_problem(CLOSED, STILL, unknowns=("mass",)), closure) == ()


def test_a_start_given_whole_does_not_go_with_unknown_lengths() -> None:
    """Velocities of 0 keep any length closed; others do not, and a start with free entries follows the lengths."""
    closure = _Sized(_linear().plant)
    moving = np.array([1.0, -1.0, 0.0, 0.0, 0.0])

    def name(free: Any, qd: Array) -> list[str]:
        found = list(find_open_states(_problem(CLOSED, qd, free, unknowns=("width",)), closure))
        assert all(finding.startswith("all entries are given, and width changes") for _, finding, _ in found)
        return [key for key, _, _ in found]

    assert name((), STILL) == ["start_q"]
    assert name((), moving) == ["start_q", "start_qd"]
    assert name((1, 2), moving) == ["start_qd"]
    assert name((1, 2), STILL) == []
    assert name((1, 2, 6, 7), moving) == []
    assert name((6, 7), moving) == ["start_q"]


@pytest.mark.parametrize(("held", "names"), [(((0, 1), (2,)), []), (((0, 1),), ["ball"]), (((2,),), ["ball"])])
def test_an_attitude_is_divided_where_loops_hold_a_part_of_it(held: Any, names: list[str]) -> None:
    """At the attitude 1, h = the entries of the vector part: of three freedoms all, two or one are held."""
    rows = np.eye(4)[[i for group in held for i in group]]
    h, turn = (lambda q: rows[:, :4] @ q[:4]), rows[:, :3] / 2  # v' = w / 2
    J = np.concatenate((turn, np.zeros((len(turn), 1))), axis=1)
    places = ("ball.qx", "ball.qy", "ball.qz", "ball.qw", "slide")
    closure = Closure(_Mechanism(h, lambda _: J, places, (0,)))  # type: ignore[arg-type]
    one = np.array([0.0, 0, 0, 1, 0.3])
    assert find_divided_attitudes(closure, one, [4], [0, 1, 2, 3]) == names
    assert find_divided_attitudes(closure, one, [], [0, 1, 2, 3, 4]) == names
    assert find_divided_attitudes(closure, one, [4], [0, 1, 2]) == []
    assert find_divided_attitudes(closure, one, [], [4]) == []


def test_an_attitude_that_kept_entries_hold_is_not_divided() -> None:
    """A slide that loops tie to an attitude is free with it, and holds it."""
    J = np.array([[0.5, 0, 0, -1.0], [0, 0.5, 0, 0], [0, 0, 0.5, 0]])
    places = ("ball.qx", "ball.qy", "ball.qz", "ball.qw", "slide")

    def h(q: Array) -> Array:
        return np.array([q[0] - q[4], q[1], q[2]])

    closure = Closure(_Mechanism(h, lambda _: J, places, (0,)))  # type: ignore[arg-type]
    one = np.array([0.0, 0, 0, 1, 0])
    assert find_divided_attitudes(closure, one, [4], [0, 1, 2, 3]) == []
    assert find_divided_attitudes(closure, one, [], [0, 1, 2, 3]) == ["ball"]
