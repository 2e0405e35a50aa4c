"""The tolerance of a model's geometry: within it, an equation of a loop follows from others as far as the file shows.

Files round: an axis of six digits is off by some 1e-6 rad. A model file says its tolerance under `loop_tolerance`. Else
it follows from the last digits that its author wrote in lengths, axes and angles: ROUNDING of the smallest one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from mbsgen.expressions import Call, Expression, Name, Negation, Number, Operation, Power
from mbsgen.model.model import Fixed, LoopEnd, Model, Placement, Triple

LEAST, LARGEST = 1e-5, 3e-4  # rad, or of the size of a loop: what a file has without regard to its digits, and at most
ROUNDING = 100.0  # last digits: a small number of two digits, and what several rounded numbers add up to
COMPUTED = 15  # digits of a number that no author rounded
SHORT = 6  # decimals of an angle in degrees, or of a square, whose number has all digits and is exact
TINY = 1e-12  # numbers that stand for 0, such as the cosine of a quarter turn


def find_tolerance(digits: Iterable[float]) -> float:
    """Return the tolerance of a file with these numbers in its geometry."""
    sizes = [(abs(x), _find_last_digit(abs(x))) for x in digits if abs(x) > TINY]
    last = min((digit for x, digit in sizes if digit or not _is_exact(x)), default=0.0)
    return min(max(LEAST, ROUNDING * last), LARGEST)


def list_geometry(model: Model) -> Iterator[float]:
    """List the numbers that an author wrote in lengths, axes and angles, also of the parameters that they use."""
    waiting, seen = [*_list_expressions(model)], set[str]()
    values = {parameter.name: parameter.value for parameter in model.parameters}
    while waiting:
        match waiting.pop():
            case Number(value):
                yield value
            case Negation(operand):
                waiting.append(operand)
            case Operation(_, left, right):
                waiting += [left, right]
            case Power(base, _):
                waiting.append(base)
            case Call(_, arguments):
                waiting += arguments
            case Name(name) if name in values and name not in seen:
                seen.add(name)
                waiting.append(values[name])


def _list_expressions(model: Model) -> Iterator[Expression]:
    for body in model.bodies:
        carriers = [body.joint] if isinstance(body.joint, Fixed) else body.joints
        for carrier in carriers:
            yield from _place(carrier.placement)
            if not isinstance(carrier, Fixed):
                yield from carrier.axis
    for loop in model.loops:
        yield from (*_end(loop.first), *_end(loop.second), *loop.axis, *loop.axis2, loop.length, loop.pitch)
    yield from (constraint.equation for constraint in model.constraints)


def _end(end: LoopEnd) -> Iterator[Expression]:
    return _place(end.placement)


def _place(placement: Placement) -> Iterator[Expression]:
    position: Triple = placement.position
    yield from position
    yield from (rotation.angle for rotation in placement.orientation)


def _find_last_digit(x: float) -> float:
    """Return the size of the last decimal of a number as it is written; 0 of one with all digits of a double."""
    mantissa, exponent = next(t for t in (f"{x:.{n}e}" for n in range(18)) if float(t) == x).split("e")
    digits = mantissa.replace(".", "")
    return 0.0 if len(digits) >= COMPUTED else 10.0 ** (int(exponent) - len(digits) + 1)


def _is_exact(x: float) -> bool:
    """Return whether all digits of a number follow from few: an angle of whole degrees, or a root like sqrt(3)/2."""
    few = (round(y, SHORT) for y in (math.degrees(x), x * x))
    return any(y and abs(y - z) < 1e-12 * y for y, z in zip(few, (math.degrees(x), x * x), strict=True))
