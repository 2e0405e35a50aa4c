"""Coefficients of explicit Runge-Kutta methods, with the estimates of their error: tables of numbers.

Euler's method; the classical one; Dormand and Prince's of order 5, Journal of Computational and Applied Mathematics 6
(1980); theirs of order 8, as in Hairer, Norsett, Wanner, "Solving ordinary differential equations I", section II.5.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Tableau:
    """Coefficients of an explicit Runge-Kutta method."""

    A: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]

    @property
    def c(self) -> NDArray[np.float64]:
        """Return the times of the stages within a step."""
        return np.asarray(np.array(self.A).sum(axis=1))


@dataclass(frozen=True)
class Pair:
    """A Runge-Kutta method with estimates of its error: none for steps of a fixed length."""

    tableau: Tableau
    E: tuple[tuple[float, ...], ...] = ()  # a row for each estimate
    order: int = 0  # of the first estimate, plus 1


Row = Mapping[int, float]  # the coefficients that are not 0


def _tabulate(A: Sequence[Row], b: Row) -> Tableau:
    return Tableau(tuple(_fill(row, len(A)) for row in A), _fill(b, len(A)))


def _fill(row: Row, size: int) -> tuple[float, ...]:
    return tuple(row.get(k, 0.0) for k in range(size))


EULER = Pair(_tabulate(({},), {0: 1.0}))
RK4 = Pair(_tabulate(({}, {0: 0.5}, {1: 0.5}, {2: 1.0}), {0: 1 / 6, 1: 1 / 3, 2: 1 / 3, 3: 1 / 6}))
FIXED: Mapping[str, Tableau] = {"euler": EULER.tableau, "rk4": RK4.tableau}  # methods of fixed steps, by name

_FIFTH: Row = {0: 35 / 384, 2: 500 / 1113, 3: 125 / 192, 4: -2187 / 6784, 5: 11 / 84}
RK45 = Pair(  # the estimate takes the rates at the end of the step too: a seventh stage of weight 0
    _tabulate(
        (
            {},
            {0: 1 / 5},
            {0: 3 / 40, 1: 9 / 40},
            {0: 44 / 45, 1: -56 / 15, 2: 32 / 9},
            {0: 19372 / 6561, 1: -25360 / 2187, 2: 64448 / 6561, 3: -212 / 729},
            {0: 9017 / 3168, 1: -355 / 33, 2: 46732 / 5247, 3: 49 / 176, 4: -5103 / 18656},
            _FIFTH,
        ),
        _FIFTH,
    ),
    (
        (
            *(-71 / 57600, 0.0, 71 / 16695, -71 / 1920),
            *(17253 / 339200, -22 / 525, 1 / 40),
        ),
    ),
    5,
)

DOP853 = Pair(
    _tabulate(
        (
            {},
            {0: 0.05260015195876773},
            {0: 0.0197250569845379, 1: 0.0591751709536137},
            {0: 0.02958758547680685, 2: 0.08876275643042054},
            {0: 0.2413651341592667, 2: -0.8845494793282861, 3: 0.924834003261792},
            {0: 0.037037037037037035, 3: 0.17082860872947386, 4: 0.12546768756682242},
            {0: 0.037109375, 3: 0.17025221101954405, 4: 0.06021653898045596, 5: -0.017578125},
            {
                0: 0.03709200011850479,
                3: 0.17038392571223998,
                4: 0.10726203044637328,
                5: -0.015319437748624402,
                6: 0.008273789163814023,
            },
            {
                0: 0.6241109587160757,
                3: -3.3608926294469414,
                4: -0.868219346841726,
                5: 27.59209969944671,
                6: 20.154067550477894,
                7: -43.48988418106996,
            },
            {
                0: 0.47766253643826434,
                3: -2.4881146199716677,
                4: -0.590290826836843,
                5: 21.230051448181193,
                6: 15.279233632882423,
                7: -33.28821096898486,
                8: -0.020331201708508627,
            },
            {
                0: -0.9371424300859873,
                3: 5.186372428844064,
                4: 1.0914373489967295,
                5: -8.149787010746927,
                6: -18.52006565999696,
                7: 22.739487099350505,
                8: 2.4936055526796523,
                9: -3.0467644718982196,
            },
            {
                0: 2.273310147516538,
                3: -10.53449546673725,
                4: -2.0008720582248625,
                5: -17.9589318631188,
                6: 27.94888452941996,
                7: -2.8589982771350235,
                8: -8.87285693353063,
                9: 12.360567175794303,
                10: 0.6433927460157636,
            },
        ),
        {
            0: 0.054293734116568765,
            5: 4.450312892752409,
            6: 1.8915178993145003,
            7: -5.801203960010585,
            8: 0.3111643669578199,
            9: -0.1521609496625161,
            10: 0.20136540080403034,
            11: 0.04471061572777259,
        },
    ),
    (
        _fill(
            {
                0: 0.01312004499419488,
                5: -1.2251564463762044,
                6: -0.4957589496572502,
                7: 1.6643771824549864,
                8: -0.35032884874997366,
                9: 0.3341791187130175,
                10: 0.08192320648511571,
                11: -0.022355307863886294,
            },
            12,
        ),
        _fill(
            {
                0: -0.18980075407240762,
                5: 4.450312892752409,
                6: 1.8915178993145003,
                7: -5.801203960010585,
                8: -0.4226823213237919,
                9: -0.1521609496625161,
                10: 0.20136540080403034,
                11: 0.02265179219836082,
            },
            12,
        ),
    ),
    8,
)
