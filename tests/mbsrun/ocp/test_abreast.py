"""Calls of an interval's points at once: the bits of calls in turn, where no call reads another's results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbsrun
from mbsrun import many
from mbsrun.library import find_compiler
from mbsrun.ocp.evaluation.stages import binding
from mbsrun.ocp.evaluation.stages.abreast import LANES, Abreast, find_repeated, is_independent
from mbsrun.ocp.evaluation.stages.tables import Call, Script, Step, Terms
from mbsrun.optimal.result import Solved

MODELS = Path(__file__).parents[3] / "models"
SIZES = [2, 1], [3]  # numbers of a function's arguments and its result


def script(*steps: Call | Terms) -> Script:
    made = [Step(None, x) if isinstance(x, Call) else Step(x, None) for x in steps]
    return Script(tuple(made), np.zeros(20), 60, (0,))


def calls(*places: tuple[int, int, int], function: int = 5) -> list[Call]:
    return [Call(function, places_of[:2], places_of[2:]) for places_of in places]


def test_functions_are_repeated_without_terms_in_between() -> None:
    one, two = calls((0, 2, 20), (3, 5, 23))
    (other,) = calls((0, 2, 30), function=4)
    some = Terms(np.array([7]), np.array([8]), np.ones(1))
    assert find_repeated([script(one, two)]) == {5}
    assert find_repeated([script(one), script(two)]) == set()
    assert find_repeated([script(one, other, two)]) == set()
    assert find_repeated([script(one, some, two)]) == set()
    assert find_repeated([script(some, one, two, other, other)]) == {4, 5}


@pytest.mark.parametrize(
    ("places", "is_fit"),
    [
        ([(0, 2, 20), (3, 5, 23), (0, 2, 26)], True),
        ([(0, 2, 20), (18, 5, 26)], True),
        ([(0, 2, 20), (19, 5, 26)], False),  # which reads entry 20, too
        ([(0, 2, 20), (3, 22, 26)], False),  # the last of the three
        ([(0, 2, 20), (3, 23, 26)], True),
        ([(0, -1, 20), (3, -1, 23)], True),
        ([(0, -1, 20), (3, 5, 23)], False),  # other arguments
    ],
)
def test_calls_are_independent_where_none_reads_the_results_of_another(
    places: Sequence[tuple[int, int, int]], is_fit: bool
) -> None:
    assert is_independent([script(), script(*calls(*places))], 5, SIZES) == is_fit
    assert is_independent([script(*calls(*places))], 4, SIZES)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_solve_has_the_same_bits(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a pole's swing-up, in which lanes compute values, Jacobians and Hessians."""
    served: list[set[int]] = []

    class Watched(Abreast):
        def __init__(self, ffi: Any, functions: Any, count: int) -> None:
            served.append(set(functions))
            super().__init__(ffi, functions, count)

    monkeypatch.setattr(binding, "Abreast", Watched)
    problem = mbsrun.read_problem(MODELS / "cart_pole_swing_up.ocp.yaml")
    alone, abreast = (problem.with_solver("mbs", threads=threads, options={"lanes": x}).solve() for x in ("no", "yes"))
    if many.find_width(find_compiler({})) < LANES:
        assert not served
        return
    assert [len(functions) for functions in served] == [3]
    assert isinstance(alone, Solved)
    assert isinstance(abreast, Solved)
    assert alone.cost == abreast.cost
    for name in ("q", "qd", "u"):
        np.testing.assert_array_equal(getattr(alone.trajectory, name), getattr(abreast.trajectory, name), err_msg=name)
