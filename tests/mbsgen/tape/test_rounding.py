"""Bounds of rounding errors: never violated against 50 digits, in both precisions, and not far above the errors."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsgen.families import write_families
from mbsgen.pipeline import Options, generate, read_tree
from mbsgen.request import Request
from mbsgen.tape.builder import Builder
from mbsgen.tape.interpreter import DECIMALS, FLOATS, Numbers, evaluate, fifty_digits, run
from mbsgen.tape.rounding import add_bounds, name_bound
from mbsgen.tape.types import Op, Tape
from mbsrun.kernel import KernelError, Kernels
from tests.random_trees import random_tree
from tests.shipped import FOLDER

DOUBLE, SINGLE = 2.0**-53, 2.0**-24
DIGITS = Decimal("1e-45")  # relative errors of the reference


def _round(function: Callable[..., float]) -> Callable[..., np.float32]:
    return lambda *numbers: np.float32(function(*map(float, numbers)))


SINGLES = Numbers(
    lambda x: np.float32(float(x)),
    {op: _round(function) for op, function in FLOATS.functions.items()},
    np.float32(2 * SINGLE),
)


@dataclass(frozen=True)
class Found:
    """The ratios of one evaluation, and whether it failed."""

    ratios: tuple[float, ...]  # of bounds to errors that are not 0
    failed: bool


def _check(tape: Tape, bounded: Tape, arguments: Mapping[str, Sequence[Any]], numbers: Numbers, unit: Any) -> Found:
    status, results = run(bounded, {**arguments, "unit": [unit]}, numbers, tested=True)
    if status:
        return Found((), True)
    with fifty_digits():
        exact = evaluate(tape, {n: [Decimal(float(x)) for x in v] for n, v in arguments.items()}, DECIMALS)
        ratios = []
        for output in tape.outputs:
            bounds = results[name_bound(output.name)]
            for x, e, bound in zip(results[output.name], exact[output.name], bounds, strict=True):
                error = abs(Decimal(float(x)) - e)
                assert error <= Decimal(float(bound)) + DIGITS * abs(e), (tape.name, output.name, x, bound)
                if error:
                    ratios.append(float(bound) / float(error))
    return Found(tuple(ratios), False)


def _draw(tape: Tape, seed: int, convert: Callable[[float], Any], size: float) -> dict[str, list[Any]]:
    draw = random.Random(seed)
    return {i.name: [convert(draw.uniform(-size, size)) for _ in range(i.sparsity.nnz)] for i in tape.inputs}


def _list_tapes(tree: Any, derivatives: int = 2) -> list[Tape]:
    request = Request(functions=("impl", "semi", "exp1", "exp2"), derivatives=derivatives)
    return [tape for family in write_families(tree, request) for tape in family.tapes]


@pytest.mark.parametrize("name", ["double_pendulum", "leg", "acrobot"])
def test_bounds_hold_and_are_near(name: str) -> None:
    ratios: list[float] = []
    for tape in _list_tapes(read_tree(FOLDER / f"{name}.yaml")):
        bounded = add_bounds(tape)
        for seed in range(2):
            for numbers, unit, convert in ((FLOATS, DOUBLE, float), (SINGLES, np.float32(SINGLE), np.float32)):
                found = _check(tape, bounded, _draw(tape, seed, convert, 3.0), numbers, unit)
                assert not found.failed
                ratios += found.ratios
    assert np.median(ratios) < 200


@pytest.mark.parametrize("seed", range(2))
def test_bounds_hold_for_random_trees_and_sizes(seed: int) -> None:
    for tape in _list_tapes(random_tree(seed, 4), derivatives=1):
        bounded = add_bounds(tape)
        for size in (1e-6, 1.0, 1e3):
            _check(tape, bounded, _draw(tape, seed, float, size), FLOATS, DOUBLE)


ARGUMENTS = {Op.ASIN: 0.99, Op.ACOS: 0.99, Op.LOG: 0.4}  # about which an argument is drawn, from exact parts


@pytest.mark.parametrize("op", [op for op in Op if op.arity == 1 and op is not Op.NEG] + [Op.DIV, Op.ATAN2, Op.MUL])
@pytest.mark.parametrize("seed", range(10))
def test_every_operation_keeps_its_bound(op: Op, seed: int) -> None:
    """Arguments are differences, so that they have errors; near singularities the function may fail instead."""
    builder = Builder()
    a, b, c, d = builder.vector("x", 4)
    x, y = a * b - c, c * d - a
    value = {Op.DIV: lambda: x / y, Op.MUL: lambda: x * y}.get(
        op, lambda: builder.apply(op, x, y if op.arity == 2 else None)
    )()
    builder.output_dense("z", [[value]])
    tape = builder.build("one")
    draw = random.Random(seed)
    target = {Op.ASIN: 0.999, Op.ACOS: -0.999, Op.LOG: 1e-3, Op.SQRT: 1e-3, Op.TAN: 1.57}.get(op, draw.uniform(-2, 2))
    p, q = draw.uniform(1, 2), draw.uniform(1, 2)
    numbers = [p, q, p * q - target * draw.uniform(0.99, 1.0), draw.uniform(-2, 2)]
    for kind, unit, convert in ((FLOATS, DOUBLE, float), (SINGLES, np.float32(SINGLE), np.float32)):
        found = _check(tape, add_bounds(tape), {"x": [convert(x) for x in numbers]}, kind, unit)
        assert not (found.failed and kind is FLOATS)


@pytest.mark.parametrize("op", [Op.DIV, Op.LOG, Op.ASIN, Op.SQRT])
def test_an_argument_that_may_be_singular_fails(op: Op) -> None:
    builder = Builder()
    a, b = builder.vector("x", 2)
    x = a * b * b * b * b - builder.number(1.0 if op is not Op.ASIN else 0.0)
    value = builder.number(1.0) / x if op is Op.DIV else builder.apply(op, x)
    builder.output_dense("z", [[value]])
    bounded = add_bounds(builder.build("one"))
    near = math.nextafter(1.0, 2.0 if op is not Op.ASIN else 0.0)
    status, _ = run(bounded, {"x": [near, 1.0], "unit": [DOUBLE]}, FLOATS, tested=True)
    assert status == 1
    status, _ = run(bounded, {"x": [1.5 if op is not Op.ASIN else 0.5, 1.0], "unit": [DOUBLE]}, FLOATS, tested=True)
    assert status == 0


@pytest.mark.parametrize("unit", [0.0, 2.0**-23])
def test_a_unit_of_nothing_and_a_coarse_one_are_refused(unit: float) -> None:
    (tape,) = (t for t in _list_tapes(read_tree(FOLDER / "pendulum.yaml"), 0) if t.name == "impl")
    arguments = _draw(tape, 0, float, 1.0)
    assert run(add_bounds(tape), {**arguments, "unit": [unit]}, FLOATS, tested=True)[0] == 1


def test_bounds_cover_both_sides_of_a_branch() -> None:
    """Where rounding decides the larger of two numbers, its derivative may be the other one's: 0 instead of c."""
    builder = Builder()
    a, b, c = builder.vector("x", 3)
    x = a * b - c
    side = builder.apply(Op.SIGN, x)
    half = builder.number(0.5)
    builder.output_dense("z", [[half * (x + side * x)]])  # max(0, x)
    builder.output_dense("slope", [[half * (c + side * c)]])
    tape = builder.build("branch")
    bounded = add_bounds(tape)
    a_, b_ = 1 + 2.0**-30, 1 - 2.0**-30  # the product is 1 - 2^-60, rounded to 1
    for c_, is_wide in ((1.0, True), (math.nextafter(1.0, 0.0), True), (0.9, False), (1.1, False)):
        arguments = {"x": [a_, b_, c_]}
        assert not _check(tape, bounded, arguments, FLOATS, DOUBLE).failed
        results = run(bounded, {**arguments, "unit": [DOUBLE]}, FLOATS, tested=True)[1]
        assert results["bound_z"][0] < 1e-14
        assert (results["bound_slope"][0] > 0.5) == is_wide


def test_generated_functions_return_bounds(tmp_path: Path) -> None:
    """In C, compiled with contraction of products and sums, against the textbook in 50 digits."""
    generate(FOLDER / "leg.yaml", tmp_path / "leg", Options(functions=("impl",), derivatives=1, targets=("bounds",)))
    kernels = Kernels(tmp_path / "leg")
    (tape,) = (t for t in _list_tapes(read_tree(FOLDER / "leg.yaml"), 0) if t.name == "impl")
    rng = np.random.default_rng(1)
    states: dict[str, Any] = {x: rng.uniform(-3, 3, (200, 3)) for x in ("q", "qd", "qdd", "u")}
    found = kernels("bounded_impl", **states, unit=np.full((200, 1), DOUBLE))
    for k in range(200):
        with fifty_digits():
            given = {x: [Decimal(float(v)) for v in states[x][k]] for x in states}
            exact = evaluate(tape, given, DECIMALS)["Phi"]
            for value, bound, e in zip(found["Phi"][k], found["bound_Phi"][k], exact, strict=True):
                assert abs(Decimal(float(value)) - e) <= Decimal(float(bound))
    assert np.median(found["bound_Phi"] / np.maximum(np.abs(found["Phi"]), 1)) < 1e-13
    with pytest.raises(KernelError):
        kernels("bounded_impl", **{x: v[0] for x, v in states.items()}, unit=[0.0])
