"""Published problems, each with the optimum that its source prints, and with its statement in plain CasADi.

The files are `models/classics/NAME.ocp.yaml`. States and inputs have the order of the file; coordinates and velocities
of a mechanism come first. Nothing of a file's equations is read here: the statements are independent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Decimal

import casadi as ca

from benchmarks.kkt.problems import PROBLEMS
from benchmarks.kkt.transcription import FREE, POSITIVE, Bounds, Expression, Problem, Terminal

COPS = "COPS 3.0 (2004)"
BETTS = "Betts (2010, 2015)"
DEGREE = math.pi / 180

_KNOWN = {problem.name: problem for problem in PROBLEMS}


@dataclass(frozen=True)
class Classic:
    """A published problem."""

    name: str  # of its file
    title: str
    source: str
    printed: str  # the optimum, with the digits that the source prints
    peer: Problem  # in plain CasADi
    factor: float = 1.0  # times the cost of the file is the figure that is printed
    peer_factor: float = 1.0  # times the peer's cost is the same
    remark: str = ""

    @property
    def optimum(self) -> float:
        """Return the printed optimum as a number."""
        return float(self.printed)

    @property
    def digits(self) -> int:
        """Count the digits that the source prints."""
        return len(Decimal(self.printed).as_tuple().digits)

    def count_digits(self, found: float) -> int:
        """Count the printed digits that are found: to within one unit of the last of them."""
        first, gap = Decimal(self.printed).adjusted(), abs(found - self.optimum)
        return sum(gap <= (1 + 1e-6) * 10.0 ** (first - k) for k in range(self.digits))


def _rows(*terms: ca.SX | float) -> ca.SX:
    return ca.vertcat(*terms)


def _final_time(_: ca.SX, p: ca.SX) -> ca.SX:
    return p[0]


def _state(
    name: str,
    rates: Expression,
    x: tuple[Bounds, ...],
    u: tuple[Bounds, ...],
    start: Sequence[float | None],
    end: Sequence[float | None],
    horizon: float | Bounds,
    *,
    running: Expression | None = None,
    final: Terminal | None = None,
) -> Problem:
    """State a problem; a horizon is given, or free within bounds. The guess comes from elsewhere."""
    is_free = isinstance(horizon, tuple)
    problem = Problem(
        name,
        "",
        rates,
        x,
        u,
        tuple(start),
        tuple(end),
        None if isinstance(horizon, tuple) else horizon,
        lambda _: (0.0,) * len(x),
        lambda _: (0.0,) * len(u),
        p=(horizon,) if isinstance(horizon, tuple) else (),
        guess_p=(1.0,) if is_free else (),
    )
    if running is not None:
        problem = replace(problem, running=running)
    return problem if final is None else replace(problem, final=final)


def _make_brachistochrone() -> Problem:
    return _state(
        "brachistochrone",
        lambda x, u, p, t: _rows(x[2] * ca.sin(u[0]), -x[2] * ca.cos(u[0]), 9.81 * ca.cos(u[0])),
        (FREE, FREE, POSITIVE),
        ((0.0, math.pi),),
        (0.0, 0.0, 0.0),
        (10.0, -3.0, None),
        (0.1, 10.0),
        final=_final_time,
    )


def _make_glider() -> Problem:
    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        place, vx, vy, lift = x[0], x[2], x[3], u[0]
        r = (place / 100 - 2.5) ** 2
        w = vy - 2.5 * (1 - r) * ca.exp(-r)
        push = 0.5 * 1.13 * 14.0 * ca.sqrt(vx**2 + w**2)
        D, L = push * (0.034 + 0.069662 * lift**2), push * lift
        return _rows(vx, vy, (-L * w - D * vx) / 100, (L * vx - D * w) / 100 - 9.80665)

    return _state(
        "hang glider",
        rates,
        ((0.0, 1500.0), FREE, POSITIVE, FREE),
        ((0.0, 1.4),),
        (0.0, 1000.0, 13.2275675, -1.28750052),
        (None, 900.0, 13.2275675, -1.28750052),
        (10.0, 200.0),
        final=lambda x, p: -x[0],
    )


def _make_crane() -> Problem:
    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        swing = -(u[0] + 27.0756 * x[2] + 2 * x[4] * x[5]) / x[1]
        return _rows(x[3], x[4], x[5], u[0] + 17.2656 * x[2], u[1], swing)

    return _state(
        "container crane",
        rates,
        (FREE, FREE, FREE, (-2.5, 2.5), (-1.0, 1.0), FREE),
        ((-2.83374, 2.83374), (-0.80865, 0.71265)),
        (0.0, 22.0, 0.0, 0.0, -1.0, 0.0),
        (10.0, 14.0, 0.0, 2.5, 0.0, 0.0),
        9.0,
        running=lambda x, u, p, t: 0.5 * (x[2] ** 2 + x[5] ** 2 + 0.01 * ca.sumsqr(u)),
    )


def _make_ship() -> Problem:
    return _state(
        "Zermelo",
        lambda x, u, p, t: _rows(ca.cos(u[0]) - x[1], ca.sin(u[0])),
        (FREE, FREE),
        ((-2 * math.pi, 2 * math.pi),),
        (3.5, -1.8),
        (0.0, 0.0),
        (0.1, 20.0),
        final=_final_time,
    )


def _make_block(u: Bounds, target: float, horizon: float | Bounds) -> Problem:
    """Return a double integrator that moves from rest to rest, in the least time or with the least effort."""
    if isinstance(horizon, tuple):
        return _state(
            "car",
            lambda x, u, p, t: _rows(x[1], u[0]),
            (FREE, FREE),
            (u,),
            (0.0, 0.0),
            (target, 0.0),
            horizon,
            final=_final_time,
        )
    return _state(
        "block",
        lambda x, u, p, t: _rows(x[1], u[0]),
        (FREE, FREE),
        (u,),
        (0.0, 0.0),
        (target, 0.0),
        horizon,
        running=lambda x, u, p, t: u[0] ** 2,
    )


def _make_two_links() -> Problem:
    """Return the arm, by Lagrange's equations of two rods with a load at the tip; the states are (q, qd)."""

    def rates(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
        c, s = ca.cos(x[1]), ca.sin(x[1])
        first, second = x[2], x[2] + x[3]  # rates of the two rods
        # (7/3) a + (3/2) c b = u0 - u1 + (3/2) s second^2,  (3/2) c a + (4/3) b = u1 - (3/2) s first^2
        right = (u[0] - u[1] + 1.5 * s * second**2, u[1] - 1.5 * s * first**2)
        det = 28 / 9 - 9 / 4 * c**2
        a = (4 / 3 * right[0] - 1.5 * c * right[1]) / det
        b = (7 / 3 * right[1] - 1.5 * c * right[0]) / det
        return _rows(x[2], x[3], a, b - a)

    return _state(
        "two links",
        rates,
        (FREE,) * 4,
        ((-1.0, 1.0),) * 2,
        (0.0, 0.5, 0.0, 0.0),
        (0.522, 0.5, 0.0, 0.0),
        (0.1, 10.0),
        final=_final_time,
    )


CLASSICS: tuple[Classic, ...] = (
    Classic("brachistochrone", "Brachistochrone", "PROPT's manual; closed form", "1.87894033", _make_brachistochrone()),
    Classic(
        "goddard_rocket",
        "Goddard's rocket",
        COPS,
        "1.01283",
        _KNOWN["Goddard rocket"],
        -1.0,
        -1.0,
        "The thrust has a singular arc.",
    ),
    Classic("hang_glider", "Hang glider", BETTS, "1248.03103", _make_glider(), -1.0, -1.0),
    Classic(
        "robot_arm",
        "Robot arm",
        COPS,
        "9.14093",
        _KNOWN["robot arm"],
        remark="Every input is bang-bang; the switching times lie between mesh points.",
    ),
    Classic("particle_steering", "Particle steering", BETTS, "0.554570879", _KNOWN["particle steering"]),
    Classic(
        "catalyst_mixing",
        "Catalyst mixing",
        COPS,
        "-0.0480556",
        _KNOWN["catalyst mixing"],
        remark="The input has a singular arc.",
    ),
    Classic("container_crane", "Container crane", BETTS, "0.0375195", _make_crane()),
    Classic(
        "van_der_pol",
        "Van der Pol",
        BETTS,
        "2.95369916",
        _KNOWN["van der Pol"],
        remark="The printed figure is 8e-7 below the limit of fine grids, 2.953701, of ours and of the peer.",
    ),
    Classic(
        "rayleigh",
        "Rayleigh, mixed constraint",
        BETTS,
        "44.8044433",
        _KNOWN["Rayleigh"],
        remark="The printed figure is 3e-8 below the limit of fine grids, 44.8044445, of ours and of the peer.",
    ),
    Classic("bryson_denham", "Bryson-Denham", "Bryson, Ho (1975); closed form", "4.00000", _KNOWN["Bryson-Denham"]),
    Classic(
        "minimum_energy",
        "Double integrator",
        "Kelly (2017); closed form",
        "12.00000",
        _make_block(FREE, 1.0, 1.0),
    ),
    Classic("zermelo", "Zermelo's ship", BETTS, "5.26493205", _make_ship()),
    Classic(
        "alp_rider",
        "Alp rider",
        BETTS,
        "2030.85609",
        _KNOWN["alp rider"],
        remark="Four short arcs on the constraint need a grid that is fine there; equal intervals approach from above. "
        "This run keeps them; `mbsrun solve` refines them, and finds 2030.8551 on 238 intervals.",
    ),
    Classic("moon_lander", "Moon lander", "Meditch (1964); closed form", "8.24621", _KNOWN["moon lander"]),
    Classic("space_shuttle", "Space shuttle", BETTS, "34.1412", _KNOWN["space shuttle"], -1.0, -1 / DEGREE),
    Classic(
        "orbit_raising", "Orbit raising", "Bryson, Ho (1975); YAPSS", "1.5252777", _KNOWN["orbit transfer"], -1.0, -1.0
    ),
    Classic(
        "car", "Car", "Logsdon, Biegler (1989); closed form", "30.0000", _make_block((-2.0, 1.0), 300.0, (1.0, 100.0))
    ),
    Classic(
        "hypersensitive",
        "Hypersensitive",
        "Rao, Mease (2000); closed form for an infinite horizon",
        "1.330807",
        _KNOWN["hypersensitive"],
        remark="Layers at both ends of the horizon need a mesh that is fine there.",
    ),
    Classic("cart_pole", "Cart-pole swing-up", "Kelly (2017)", "58.8", _KNOWN["cart-pole"]),
    Classic(
        "two_links",
        "Arm of two links",
        "Luus (2000); PROPT's manual",
        "2.98335",
        _make_two_links(),
        remark="The figure is of a coarse mesh; the optimum is lower.",
    ),
)
