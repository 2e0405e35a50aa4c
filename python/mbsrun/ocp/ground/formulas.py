"""Formulas that transcription writes itself: rates, turns, lengths, attitudes, costs of inputs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce
from typing import Literal

from mbsgen.expressions import Expression, Name, Number, Operation, Power
from mbsrun.ocp.ground.functions import Formula, Input, KernelResult


def _name(kind: str, size: int) -> list[Expression]:
    return [Name(f"{kind}{i}") for i in range(size)]


def _sum(terms: Iterable[Expression]) -> Expression:
    return reduce(lambda a, b: Operation("+", a, b), terms)


def _formula(expressions: Sequence[Expression], inputs: Sequence[Input], parameters: Input | None = None) -> Formula:
    known = (*inputs, *([] if parameters is None else [parameters]))
    names = {f"{part.kind}{i}": (part.kind, i) for part in known for i in range(part.size)}
    return Formula(tuple(expressions), names, tuple(inputs), parameters)


def copy(size: int) -> Formula:
    """Return v of v: a variable as it is, so that a block can multiply it by another."""
    return _formula(_name("v", size), [Input("v", size)])


def measure_length() -> Formula:
    """Return |x|^2 of a quaternion x."""
    return _formula([_sum(Power(x, 2) for x in _name("x", 4))], [Input("x", 4)])


def fix_length() -> Formula:
    """Return |x|^2 - 1 of a quaternion x."""
    length = _sum(Power(x, 2) for x in _name("x", 4))
    return _formula([Operation("-", length, Number(1.0))], [Input("x", 4)])


Turn = tuple[Sequence[int], Sequence[int]]  # the four entries of a quaternion in q, and three of velocities


def turn(spins: Sequence[Turn], moves: Sequence[Turn], sizes: tuple[int, int], kernel: KernelResult) -> Formula:
    """Return the rates of quaternions, and then of the places of free bodies, for velocities that a kernel computes.

    The kernel computes v (n,) of q (nq,) and lam (m,); `sizes` are nq and m. With a quaternion (x, s), the rates are
    (x, s) * (w, 0) / 2 for the angular velocity w, and v + 2 (s x * v + x * (x * v)) / (|x|^2 + s^2) for a velocity v
    along the axes of the body, * between vectors being the cross product.
    """
    results = [rate for places, speeds in spins for rate in _turn(places, speeds)]
    results += [rate for places, speeds in moves for rate in _rotate(places, speeds)]
    velocities = sorted({i for _, speeds in (*spins, *moves) for i in speeds})
    names = {f"q{i}": ("q", i) for i in range(sizes[0])} | {f"v{i}": ("forces", i) for i in velocities}
    inputs = (Input("q", sizes[0]), Input("lam", sizes[1]))
    return Formula(tuple(results), names, inputs, computed=(("forces", kernel),))


def _turn(places: Sequence[int], speeds: Sequence[int]) -> list[Expression]:
    (*x, s), w = [Name(f"q{i}") for i in places], [Name(f"v{i}") for i in speeds]
    half = Number(0.5)
    vector = [_operate("*", half, _operate("+", _operate("*", s, a), b)) for a, b in zip(w, _cross(x, w), strict=True)]
    return [*vector, _operate("*", Number(-0.5), _dot(x, w))]


def _rotate(places: Sequence[int], speeds: Sequence[int]) -> list[Expression]:
    q, v = [Name(f"q{i}") for i in places], [Name(f"v{i}") for i in speeds]
    x, s = q[:3], q[3]
    once = _cross(x, v)
    turned = [_operate("+", _operate("*", s, a), b) for a, b in zip(once, _cross(x, once), strict=True)]
    factor = _operate("/", Number(2.0), _dot(q, q))
    return [_operate("+", a, _operate("*", factor, b)) for a, b in zip(v, turned, strict=True)]


def _operate(symbol: Literal["+", "-", "*", "/"], a: Expression, b: Expression) -> Expression:
    return Operation(symbol, a, b)


def _dot(a: Sequence[Expression], b: Sequence[Expression]) -> Expression:
    return _sum(_operate("*", x, y) for x, y in zip(a, b, strict=True))


def _cross(a: Sequence[Expression], b: Sequence[Expression]) -> list[Expression]:
    pairs = [((i + 1) % 3, (i + 2) % 3) for i in range(3)]
    return [_operate("-", _operate("*", a[j], b[k]), _operate("*", a[k], b[j])) for j, k in pairs]


def compare_attitudes() -> Formula:
    """Return the vector of target^-1 * found, (3,), of a quaternion; the target is a parameter.

    With quaternions (v, s) it is s_t v - s v_t - v_t x v: 0 where both are one attitude, and linear in what is found.
    Its derivatives are independent there, and it does not change along `found`. So these are three equations; four on a
    quaternion whose length is given already would be one too many.
    """
    return _formula(_compare(), [Input("found", 4)], Input("target", 4))


def compare_two_attitudes() -> Formula:
    """Return the same of two quaternions that are both variables: `found`, then `target`."""
    return _formula(_compare(), [Input("found", 4), Input("target", 4)])


def _compare() -> list[Expression]:
    found, target = _name("found", 4), _name("target", 4)

    def times(a: Expression, b: Expression) -> Expression:
        return Operation("*", a, b)

    def entry(i: int) -> Expression:
        j, k = (i + 1) % 3, (i + 2) % 3
        turned = Operation("-", times(target[3], found[i]), times(found[3], target[i]))
        cross = Operation("-", times(target[j], found[k]), times(target[k], found[j]))
        return Operation("-", turned, cross)

    return [entry(i) for i in range(3)]


def square_inputs(m: int) -> Formula:
    """Return |u|^2."""
    return _formula([_sum(Power(x, 2) for x in _name("u", m))], [Input("u", m)])


def square_rates(m: int, intervals: int) -> Formula:
    """Return h |(u - before) / h|^2 for the length h = T / intervals."""
    steps = (Power(Operation("-", u, before), 2) for u, before in zip(_name("u", m), _name("before", m), strict=True))
    rate = Operation("/", Operation("*", Number(float(intervals)), _sum(steps)), Name("T0"))
    return _formula([rate], [Input("before", m), Input("u", m), Input("T", 1)])


def find_rates(m: int) -> Formula:
    """Return (u - before) / T: rates over a horizon T, which a scale turns into rates over a part of it."""
    rates = [
        Operation("/", Operation("-", u, before), Name("T0"))
        for u, before in zip(_name("u", m), _name("before", m), strict=True)
    ]
    return _formula(rates, [Input("before", m), Input("u", m), Input("T", 1)])
