"""Formulas that transcription writes, as functions of numbers: against SciPy's rotations, and by hand."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mbsgen.expressions import FLOATS, evaluate
from mbsrun.ocp.ground import formulas
from mbsrun.ocp.ground.functions import Formula, Input, KernelResult

Array = NDArray[np.float64]


def call(formula: Formula, **values: Array) -> Array:
    """Evaluate a formula; its names belong to inputs, parameters and kernels."""
    known: Mapping[str, float] = {name: float(values[kind][i]) for name, (kind, i) in formula.names.items()}
    return np.array([evaluate(expression, known, FLOATS) for expression in formula.expressions])


def draw(rng: np.random.Generator) -> Array:
    """Draw a quaternion, the scalar last."""
    return np.asarray(Rotation.random(random_state=int(rng.integers(1 << 30))).as_quat())


def sizes(inputs: tuple[Input, ...]) -> list[tuple[str, int]]:
    return [(each.kind, each.size) for each in inputs]


def test_lengths_and_copies(rng: np.random.Generator) -> None:
    x, v = rng.normal(size=4), rng.normal(size=3)
    assert call(formulas.measure_length(), x=x) == pytest.approx([x @ x], rel=1e-14)
    assert call(formulas.fix_length(), x=x) == pytest.approx([x @ x - 1], rel=1e-13)
    assert call(formulas.copy(3), v=v).tolist() == v.tolist()
    lengths = formulas.measure_length(), formulas.fix_length()
    assert [sizes(each.inputs) for each in (*lengths, formulas.copy(3))] == [[("x", 4)], [("x", 4)], [("v", 3)]]


def test_quaternions_turn_by_the_angular_velocity_and_bodies_move_along_their_axes(rng: np.random.Generator) -> None:
    """Rates are the differences of SciPy's rotations; a velocity in body axes turns as SciPy turns a vector."""
    kernel = KernelResult("rates", ("q", "lam"), "v")
    formula = formulas.turn([((2, 3, 4, 5), (0, 1, 2))], [((2, 3, 4, 5), (3, 4, 5))], (7, 2), kernel)
    assert sizes(formula.inputs) == [("q", 7), ("lam", 2)]
    assert formula.computed == (("forces", kernel),)
    q, v, h = rng.normal(size=7), rng.normal(size=6), 1e-6
    q[2:6] = draw(rng)
    found = call(formula, q=q, forces=v)
    here = Rotation.from_quat(q[2:6])
    ends = [(here * Rotation.from_rotvec(side * h * v[:3])).as_quat() for side in (1, -1)]
    ends = [end * np.sign(end @ q[2:6]) for end in ends]
    assert found[:4] == pytest.approx((ends[0] - ends[1]) / (2 * h), abs=1e-9)
    assert found[4:] == pytest.approx(here.apply(v[3:]), rel=1e-13)
    q[2:6] *= 1.7  # of any length
    assert call(formula, q=q, forces=v)[4:] == pytest.approx(here.apply(v[3:]), rel=1e-13)


def test_attitudes_differ_by_half_the_sine_of_the_turn_between_them(rng: np.random.Generator) -> None:
    """The vector of target^-1 found; of two variables the same."""
    found, target = draw(rng), draw(rng)
    between = (Rotation.from_quat(target).inv() * Rotation.from_quat(found)).as_quat()
    one, two = formulas.compare_attitudes(), formulas.compare_two_attitudes()
    for formula in (one, two):
        result = call(formula, found=found, target=target)
        assert np.abs(result) == pytest.approx(np.abs(between[:3]), rel=1e-12)
        assert result @ between[:3] == pytest.approx(math.copysign(result @ result, result @ between[:3]), rel=1e-12)
        assert call(formula, found=target, target=target) == pytest.approx(np.zeros(3), abs=1e-15)
        turned = Rotation.from_rotvec([0.2, 0, 0])
        small = (Rotation.from_quat(target) * turned).as_quat()
        small *= np.sign(small @ target)
        assert call(formula, found=small, target=target) == pytest.approx([math.sin(0.1), 0, 0], abs=1e-14)
    assert sizes(one.inputs) == [("found", 4)]
    assert one.parameters == Input("target", 4)
    assert sizes(two.inputs) == [("found", 4), ("target", 4)]
    assert two.parameters is None


def test_costs_and_rates_of_inputs(rng: np.random.Generator) -> None:
    """The integral of |du/dt|^2 over an interval, with a straight line from one input to the next."""
    before, u, T = rng.normal(size=3), rng.normal(size=3), np.array([0.8])
    assert call(formulas.square_inputs(3), u=u) == pytest.approx([u @ u], rel=1e-14)
    h = T[0] / 5
    rate = (u - before) / h
    assert call(formulas.square_rates(3, 5), before=before, u=u, T=T) == pytest.approx([h * rate @ rate], rel=1e-13)
    assert call(formulas.find_rates(3), before=before, u=u, T=T) == pytest.approx((u - before) / T[0], rel=1e-14)
    for formula in (formulas.square_rates(3, 5), formulas.find_rates(3)):
        assert sizes(formula.inputs) == [("before", 3), ("u", 3), ("T", 1)]
