"""States that a problem adds to a mass on a rail, x'' = u: at every time that is asked for, by their integrals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.expressions import parse
from mbsrun.ocp.problem.problem import Control, Force, Problem, State
from mbsrun.simulation.motion import Settings
from mbsrun.tracking import Noise, Trial
from mbsrun.tracking.added import AddedStates
from tests.mbsrun.ocp.plants import push
from tests.mbsrun.peer import double_integrator

Array = NDArray[np.float64]

NONE = np.zeros(0)
TRIAL = Trial("push", 1.0, 0.1, NONE, NONE, Noise(NONE, NONE, NONE), Settings(1.0), updates={"k": parse("10*t")})
BEGUN, TIMES = 0.3, np.array([0.31, 0.35, 0.4])
START = (np.array([2.0]), np.array([3.0]), np.array([5.0]))


def carry(
    rate: str,
    force: Callable[[float], Array] = lambda _: np.zeros(1),
    *,
    seconds: float = 10.0,
    begun: float | None = BEGUN,
    held: Array | None = None,
    times: Array = TIMES,
    sample: float = 0.2,
    **changes: Any,
) -> Array | str:
    problem: Problem = replace(push(4), states=(State("s", rate),), constants=(("k", 7.0), ("l", 4.0)), **changes)
    found = AddedStates(problem, double_integrator(), seconds)
    return found.carry(START, force, sample, times, TRIAL, begun, held)


@pytest.mark.parametrize(
    ("rate", "integral"),
    [
        ("2", lambda t: 2 * (t - BEGUN)),
        ("l", lambda t: 4 * (t - BEGUN)),
        ("t", lambda t: ((t - 0.2) ** 2 - (BEGUN - 0.2) ** 2) / 2),  # a plan begins at the sample
        ("k", lambda t: 2 * (t - BEGUN)),  # as it was updated for the sample
        ("T", lambda t: t - BEGUN),
        ("qd_slide", lambda t: 3 * (t - BEGUN)),
        ("q_slide", lambda t: 2 * (t - BEGUN) + 3 * (t - BEGUN) ** 2 / 2),
        ("-2*s", lambda t: 5 * np.exp(-2 * (t - BEGUN)) - 5),
    ],
)
def test_states_are_integrals_of_their_rates(rate: str, integral: Callable[[Array], Array]) -> None:
    found = carry(rate)
    assert isinstance(found, np.ndarray)
    assert found.shape == (3, 3)
    assert found[:, 2] == pytest.approx(5 + integral(TIMES), abs=1e-9)
    assert found[:, 0] == pytest.approx(2 + 3 * (TIMES - BEGUN), abs=1e-9)
    assert found[:, 1] == pytest.approx(3.0, abs=1e-9)


def test_forces_follow_the_time_of_the_loop() -> None:
    """u = 6 t: v gains 3 t^2, and s' = u gains as much."""
    found = carry("u_slide", lambda t: np.array([6 * t]))
    assert isinstance(found, np.ndarray)
    gain = 3 * (TIMES**2 - BEGUN**2)
    assert found[:, 1] == pytest.approx(3 + gain, abs=1e-9)
    assert found[:, 2] == pytest.approx(5 + gain, abs=1e-9)
    assert found[:, 0] == pytest.approx(2 + 3 * (TIMES - BEGUN) + TIMES**3 - BEGUN**3 - 3 * BEGUN**2 * (TIMES - BEGUN))


def test_a_motion_begins_at_the_sample_where_no_other_time_is_given() -> None:
    found = carry("t", begun=None)
    assert isinstance(found, np.ndarray)
    assert found[:, 2] == pytest.approx(5 + (TIMES - 0.2) ** 2 / 2, abs=1e-9)


def test_a_control_is_held_and_an_expression_gives_the_input() -> None:
    """u = 2 c, s' = c: v gains twice what s gains."""
    given = {"controls": (Control("c"),), "forces": (Force(0, "2*c"),)}
    found = carry("c", held=np.array([4.0]), **given)
    assert isinstance(found, np.ndarray)
    assert found[:, 2] == pytest.approx(5 + 4 * (TIMES - BEGUN), abs=1e-9)
    assert found[:, 1] == pytest.approx(3 + 8 * (TIMES - BEGUN), abs=1e-9)


def test_a_state_without_an_end_is_described() -> None:
    """No rate on the way, and a limit of time that is used up."""
    assert carry("sqrt(0 - t)") == "the motion or a state of the problem has no rate on the way"
    found = carry("q_slide", seconds=0.0)
    assert isinstance(found, str)
    assert found.startswith("the added states have no end: ")


def test_inputs_by_expressions_are_those_of_each_state_and_time() -> None:
    """u = c + 2 t + s + k of a plan that begins at the sample; controls stay."""
    problem = replace(
        push(4), states=(State("s", "c"),), controls=(Control("c"),), constants=(("k", 7.0),),
        forces=(Force(0, "c + 2*t + s + k*T"),),
    )  # fmt: skip
    added = AddedStates(problem, double_integrator(), 1.0)
    state = np.zeros((3, 1)), np.zeros((3, 1)), np.array([[1.0], [2.0], [3.0]])
    inputs = np.array([[99.0, 4.0]] * 3)
    found = added.complete(state, inputs, 0.2, TIMES, TRIAL)
    assert found[:, 0] == pytest.approx(4 + 2 * (TIMES - 0.2) + np.array([1, 2, 3]) + 2)
    assert found[:, 1].tolist() == [4.0] * 3
    assert (added.is_whole, added.names, len(added.bounds)) == (True, ("s",), 1)
    assert added.move_to(double_integrator()).names == ("s",)
