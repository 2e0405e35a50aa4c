"""Settings of a simulation at their limits, and mass matrices whose pivots have lost their digits."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsrun.simulation.drive import hold, hold_steps
from mbsrun.simulation.dynamics import Dynamics, SingularError
from mbsrun.simulation.integration.methods import METHODS
from mbsrun.simulation.motion import Settings
from mbsrun.simulation.simulate import check_inputs, check_settings
from tests.mbsrun.peer import double_integrator

MANIFEST = double_integrator().manifest
PLANT: Any = SimpleNamespace(manifest=MANIFEST, list_missing=lambda _: [])
EPSILON = np.finfo(np.float64).eps
SETTINGS = Settings(duration=2.0, method="rk4", step=0.5)


def find_fault(settings: Settings, drive: Any = None) -> str:
    """Return the message of a refusal; empty without one."""
    try:
        check_settings(PLANT, hold([0.0]) if drive is None else drive, settings)
    except ValueError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({}, ""),
        ({"max_steps": 4}, ""),
        ({"max_steps": 3}, "step = 0.5 takes more than max_steps = 3 steps"),
        ({"max_steps": 0}, "max_steps and max_seconds must be positive"),
        ({"max_seconds": 0.0}, "max_steps and max_seconds must be positive"),
        ({"max_seconds": 1e-9}, ""),
        ({"duration": 0.0}, "duration = 0.0 must be a positive number"),
        ({"duration": np.inf}, "duration = inf must be a positive number"),
        ({"step": -1.0}, "step = -1.0 must be a positive number"),
        ({"rtol": np.nan}, "rtol = nan must be a positive number"),
        ({"atol": 0.0}, "atol = 0.0 must be a positive number"),
        ({"output_step": 0.0}, "output_step = 0.0 must be a positive number"),
        ({"output_step": 5.0}, ""),
        ({"method": "magic"}, f"no method 'magic'; there are {', '.join(METHODS)}"),
    ],
)
def test_numbers_of_settings_are_positive(changes: dict[str, Any], fault: str) -> None:
    assert find_fault(replace(SETTINGS, **changes)) == fault


def test_methods_without_quaternions_are_for_models_without_them() -> None:
    """Each method takes a mass on a rail; of a ball, only some."""
    ball = SimpleNamespace(manifest=MANIFEST.model_copy(update={"quaternions": (0,)}))
    for name, method in METHODS.items():
        settings = Settings(1.0, method=name)
        assert "quaternions" not in find_fault(settings)
        if not method.takes_quaternions:
            with pytest.raises(ValueError, match=f"{name} takes no quaternions; gauss with one stage does"):
                check_settings(ball, hold([0.0]), settings)  # type: ignore[arg-type]


def test_inputs_last_as_long_as_the_motion() -> None:
    steps = hold_steps(np.array([0.0, 1.0, 2.0]), np.array([[1.0], [2.0]]))
    assert find_fault(SETTINGS, steps) == ""
    fault = find_fault(replace(SETTINGS, duration=2.01), steps)
    assert fault == "the inputs end at 2.0 s, before the duration of 2.01 s"
    assert find_fault(SETTINGS, [0.0]).startswith("inputs: found a value of type list; give a Drive")
    state = np.zeros(1), np.zeros(1)
    assert [check_inputs(PLANT, piece, *state).tolist() for piece in steps.pieces] == [[1.0], [2.0]]
    with pytest.raises(ValueError, match=r"the inputs have shape \(2,\), \(1,\) expected"):
        check_inputs(PLANT, hold([1.0, 2.0]).pieces[0], *state)


def factorise(M: np.ndarray[Any, Any], chosen: list[int]) -> np.ndarray[Any, Any]:
    coordinates = [SimpleNamespace(name=name) for name in "abc"]
    own: Any = SimpleNamespace(size=3, kernels=SimpleNamespace(manifest=SimpleNamespace(coordinates=coordinates)))
    own.find_pivot = partial(Dynamics.find_pivot, own)
    return Dynamics.factorise(own, M, np.array(chosen))


@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_a_pivot_that_is_rounding_of_its_entry_is_named(scale: float) -> None:
    """Below 1000 n epsilon of the entry of the diagonal, n = 3; of the chosen joints alone, in every state."""
    limit = 3e3 * EPSILON
    for part, is_lost in ((0.9, True), (1.1, False)):
        M = scale * np.diag([4.0, 9.0, 1.0])
        M[0, 2] = M[2, 0] = scale * 2 * np.sqrt(1 - part * limit)
        every = np.stack((scale * np.eye(3), M))
        if is_lost:
            with pytest.raises(SingularError, match="c"):
                factorise(every, [0, 1, 2])
            with pytest.raises(SingularError, match="a"):
                factorise(M, [2, 0])
        else:
            L = factorise(every, [0, 1, 2])
            assert L @ np.swapaxes(L, -1, -2) == pytest.approx(every)
        L = factorise(M, [1, 2])
        assert pytest.approx(M[1:, 1:]) == L @ L.T
    with pytest.raises(SingularError, match="b"):
        factorise(np.diag([1.0, -1.0, 1.0]), [0, 1, 2])
