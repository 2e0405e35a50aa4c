"""A free horizon, as a variable, computes what the same horizon does that is given: rows, costs and slopes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mbsrun.ocp.evaluation.backends.numpy import NumpyProgram
from mbsrun.ocp.transcription.transcription import Transcription
from tests.mbsrun.ocp.horizons import CASES, LONGER, MESH, pair, plant

SUM = 1e-12  # of some hundred products


def list_points(one: Transcription, other: Transcription, rng: np.random.Generator) -> Iterator[tuple[Any, Any]]:
    """Draw points of both, with the same values."""
    horizon = other.layout.horizon
    assert horizon is not None
    for _ in range(2):
        x = rng.uniform(0.2, 0.9, one.program.variables)
        yield x, np.insert(x, horizon, LONGER)


@pytest.mark.parametrize("name", [name for name in CASES if name != "integral"])  # which has other variables then
def test_a_free_horizon_computes_what_a_given_one_does(name: str, rng: np.random.Generator) -> None:
    one, other, given, free = pair(name)
    a, b = (
        NumpyProgram(replace(one.program, solved=()), plant()),
        NumpyProgram(replace(other.program, solved=()), plant()),
    )
    p, r = one.parameters(given), other.parameters(free)
    for x, y in list_points(one, other, rng):
        np.testing.assert_allclose(b.constraint(y, r), a.constraint(x, p), rtol=SUM, atol=SUM)
        np.testing.assert_allclose(b.terms(y, r), a.terms(x, p), rtol=SUM, atol=SUM)
        slopes = np.delete(b.jacobian(y, r).toarray(), other.layout.horizon, axis=1)
        np.testing.assert_allclose(slopes, a.jacobian(x, p).toarray(), rtol=SUM, atol=SUM)
        gradient = np.delete(b.gradient(y, r), other.layout.horizon)
        np.testing.assert_allclose(gradient, a.gradient(x, p), rtol=SUM, atol=SUM)


@pytest.mark.parametrize("name", CASES)
def test_slopes_by_the_horizon_are_differences(name: str, rng: np.random.Generator) -> None:
    """Central ones, of rows and terms that are smooth: to the square of the step."""
    _, other, _, free = pair(name)
    program, r, horizon, h = (
        NumpyProgram(replace(other.program, solved=()), plant()),
        other.parameters(free),
        other.layout.horizon,
        1e-5,
    )
    assert horizon is not None
    x = rng.uniform(0.2, 0.9, other.program.variables)
    x[horizon] = LONGER
    step = h * np.eye(x.size)[horizon]
    rows = (program.constraint(x + step, r) - program.constraint(x - step, r)) / (2 * h)
    cost = (program.objective(x + step, r) - program.objective(x - step, r)) / (2 * h)
    np.testing.assert_allclose(program.jacobian(x, r).toarray()[:, horizon], rows, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(program.gradient(x, r)[horizon], cost, rtol=1e-8)


@pytest.mark.parametrize("is_free", [False, True])
def test_rates_of_inputs_are_steps_over_distances_of_midpoints(is_free: bool, rng: np.random.Generator) -> None:
    """And their price is the sum of the squares of steps over distances, in the same units."""
    transcription, problem = pair("a state and a control")[is_free::2]
    layout, program = transcription.layout, NumpyProgram(transcription.program, plant())
    x = rng.uniform(0.2, 0.9, transcription.program.variables)
    T = LONGER
    if layout.horizon is not None:
        x[layout.horizon] = T
    u, c = x[layout.inputs], x[layout.extras.controls]
    h = T * np.array(MESH)
    steps = ((h[:-1] + h[1:]) / 2)[:, None]
    p = transcription.parameters(problem)
    rates = np.concatenate((np.diff(u, axis=0), np.diff(c, axis=0)), axis=1) / steps
    np.testing.assert_allclose(program.constraint(x, p)[transcription.rows.rates], rates, rtol=SUM)
    terms = program.terms(x, p)
    np.testing.assert_allclose(terms[0], (h[:, None] * u**2).sum(), rtol=SUM)
    np.testing.assert_allclose(terms[1], (np.diff(u, axis=0) ** 2 / steps).sum(), rtol=SUM)
