"""The numbers of csrc/mbs_sincos.h: minimax polynomials by Remez's exchange, and pi/2 in pieces. Prints them when run.

With z = r^2: sin r = r + r z S(z), cos r = 1 - z/2 + z^2 C(z). S and C minimise the largest relative error of sine and
cosine for r up to a little more than pi/4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from mpmath import MPContext, mpf

MP = MPContext()
MP.dps = 40
_END = (MP.pi / 4 * (1 + MP.mpf(2) ** -10)) ** 2  # of z: the quotient is rounded to an integer with an error
_POINTS = 800
_EXCHANGES = 6

Function = Callable[[mpf], mpf]


@dataclass(frozen=True)
class Numbers:
    """The constants of the header for a type of numbers, rounded to it; coefficients by rising powers."""

    sine: tuple[float, ...]
    cosine: tuple[float, ...]
    pieces: tuple[float, float, float]  # their sum is pi/2; the first two end in zeros
    reciprocal: float  # 2/pi
    error: float  # of the polynomials before rounding, relative


def find_numbers(real: type[np.floating], terms: tuple[int, int], bits: tuple[int, int]) -> Numbers:
    """Compute the numbers for a type: `terms` of sine and of cosine, `bits` of the first two pieces of pi/2."""
    sine, sine_error = minimise(
        lambda z: (MP.sin(MP.sqrt(z)) / MP.sqrt(z) - 1) / z, lambda z: z * MP.sqrt(z) / MP.sin(MP.sqrt(z)), terms[0]
    )
    cosine, cosine_error = minimise(
        lambda z: ((MP.cos(MP.sqrt(z)) - 1) / z + 0.5) / z, lambda z: z * z / MP.cos(MP.sqrt(z)), terms[1]
    )
    first = _cut(MP.pi / 2, bits[0])
    second = _cut(MP.pi / 2 - first, bits[1])
    rest = MP.pi / 2 - first - second

    def rounded(x: mpf) -> float:
        return float(real(float(x)))

    return Numbers(
        tuple(map(rounded, sine)),
        tuple(map(rounded, cosine)),
        (float(first), float(second), rounded(rest)),
        rounded(2 / MP.pi),
        float(max(sine_error, cosine_error)),
    )


def minimise(target: Function, weight: Function, terms: int) -> tuple[list[mpf], mpf]:
    """Find the polynomial p for which the largest weight (target - p) on (0, _END] is least, and that largest."""
    nodes = [_END * (1 - MP.cos(MP.pi * (2 * k + 1) / (2 * terms + 2))) / 2 for k in range(terms + 1)]
    grid = [_END * (1 - MP.cos(MP.pi * k / _POINTS)) / 2 for k in range(1, _POINTS + 1)]
    values = [(z, target(z), weight(z)) for z in grid]
    coefficients: list[mpf] = []
    errors: list[tuple[mpf, mpf]] = []
    for _ in range(_EXCHANGES):
        rows = [[*(z**k for k in range(terms)), (-1) ** i / weight(z)] for i, z in enumerate(nodes)]
        solution = MP.lu_solve(MP.matrix(rows), MP.matrix([target(z) for z in nodes]))
        coefficients = [solution[k] for k in range(terms)]
        errors = [(z, w * (t - MP.polyval(coefficients[::-1], z))) for z, t, w in values]
        nodes = _find_extremes(errors, terms + 1)
    return coefficients, max(abs(e) for _, e in errors)


def _find_extremes(errors: list[tuple[mpf, mpf]], count: int) -> list[mpf]:
    """Take the largest error of each run of one sign; of more than `count` runs, those at the ends may go."""
    extremes: list[tuple[mpf, mpf]] = []
    for z, e in errors:
        if not extremes or (extremes[-1][1] > 0) != (e > 0):
            extremes.append((z, e))
        elif abs(e) > abs(extremes[-1][1]):
            extremes[-1] = (z, e)
    while len(extremes) > count:
        extremes.pop(0 if abs(extremes[0][1]) < abs(extremes[-1][1]) else -1)
    return [z for z, _ in extremes]


def _cut(x: mpf, bits: int) -> mpf:
    """Keep the first bits of a number."""
    mantissa, exponent = MP.frexp(x)
    return MP.ldexp(MP.floor(MP.ldexp(mantissa, bits)), exponent - bits)


DOUBLE = (np.float64, (6, 6), (36, 36))
FLOAT = (np.float32, (3, 3), (17, 17))

if __name__ == "__main__":
    for found in (find_numbers(*DOUBLE), find_numbers(*FLOAT)):
        for name, value in vars(found).items():
            print(name, *(x.hex() for x in (value if isinstance(value, tuple) else (value,))))
