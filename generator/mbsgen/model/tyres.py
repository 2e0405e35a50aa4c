"""Tyres: their numbers -> the force and the moment of the ground on a wheel, as expressions of slips and load.

The wheel turns about the axis a at the rate s = OM.a, and the plane has the normal n. In the axes of the contact,

    x = a x n / |a x n|,    y = n x x,    z = n,

the centre moves forward by vx = v.x, and the slip velocities are sx = vx - re s and, at the point on the plane, sy.
With |v| smoothed to V = softplus(2 vx, speed) - vx, at most speed log 2 above it,

    kappa = -sx/V,    tan alpha = sy/V,    sin gamma = a.n.

The Magic Formula is MF-Tyre 5.2's, without turn slip: Pacejka, "Tyre and vehicle dynamics", 2002, chapter 4, in
the signs of TYDEX's W axes. The coefficients have their names in TIR files; re falls with the depth by BREFF, DREFF,
FREFF. Load is the only divisor that may vanish, and it cancels: sin(2 atan(x)) = 2 x/(1 + x^2), and cos(atan(x)) =
1/sqrt(1 + x^2). A sign, and the root in the equivalent slips, are smoothed within 1e-8.

The brush model has the slips sx/W and sy/W, where W is |re s|, smoothed likewise; re is the wheel's radius. With the
elastic force r = |(longitudinal sx, lateral sy)|/W, and p = r/(3 friction load), m = max(1 - p, 0),

    F = -(longitudinal sx, lateral sy)/W (1 + m + m^2)/(3 max(p, 1)),    Mz = lateral sy/W m^3 length/3.

It is the law of a row of bristles under a parabolic pressure, over a contact of half the length `length`, where both
stiffnesses are the same (Pacejka, chapter 3).

With relaxation lengths, slips follow from the deflections u forward and v to the left, which are states:

    du/dt = re s - vx - V u/sigma_x,   kappa = u/sigma_x,        dv/dt = sy - V v/sigma_y,   tan alpha = v/sigma_y,

with W in place of V for a brush. At a constant speed they tend to the slips above. By MF-Tyre 5.2,

    sigma_x = Fz (PTX1 + PTX2 dfz) exp(-PTX3 dfz) R0/FNOMIN LSGKP,
    sigma_y = PTY1 sin(2 atan(Fz/(PTY2 Fz0))) (1 - PKY3 |gamma|) R0 LFZO LSGAL,

here at least a hundredth of the radius, since both vanish with the load.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Literal

from mbsgen.expressions import Expression, Number, parse

FADING = Number(0.1)  # [m/s] below which slips fade, unless a tyre says otherwise
LONGITUDINAL, LATERAL = "longitudinal", "lateral"
WAYS = MappingProxyType({LONGITUDINAL: "PTX1", LATERAL: "PTY1"})  # in which slips relax, and what decides whether
BRUSH: Mapping[str, Expression | None] = MappingProxyType(
    {"longitudinal": None, "lateral": None, "friction": None, "length": Number(0.0)}
)  # numbers of a brush, and their values where a file leaves them out

NEEDED = ("FNOMIN", "PCX1", "PDX1", "PKX1", "PCY1", "PDY1", "PKY1", "PKY2")
POSITIVE = ("FNOMIN", "LFZO", "LMUX", "LMUY", "LCX", "LCY", "PCX1", "PCY1", "PKY2", "LONGVL")
RELAXING = ("PTX1", "PTX2", "PTX3", "PTY1", "PTY2", "LSGKP", "LSGAL")  # of transient tyres alone
_SCALES = (
    "LFZO LCX LMUX LEX LKX LHX LVX LGAX LCY LMUY LEY LKY LHY LVY LGAY LTR LRES LGAZ LXAL LYKA LVYKA LS LMX LVMX LMY"
    " LSGKP LSGAL"
)
_ZEROS = (
    "PDX2 PDX3 PEX1 PEX2 PEX3 PEX4 PKX2 PKX3 PHX1 PHX2 PVX1 PVX2 RBX1 RBX2 RCX1 REX1 REX2 RHX1 PDY2 PDY3 PEY1 PEY2 PEY3"
    " PEY4 PKY3 PHY1 PHY2 PHY3 PVY1 PVY2 PVY3 PVY4 RBY1 RBY2 RBY3 RCY1 REY1 REY2 RHY1 RHY2 RVY1 RVY2 RVY3 RVY4 RVY5"
    " RVY6 QSX1 QSX2 QSX3 QSY1 QSY2 QSY3 QSY4 QBZ1 QBZ2 QBZ3 QBZ4 QBZ5 QBZ9 QBZ10 QCZ1 QDZ1 QDZ2 QDZ3 QDZ4 QDZ6 QDZ7"
    " QDZ8 QDZ9 QEZ1 QEZ2 QEZ3 QEZ4 QEZ5 QHZ1 QHZ2 QHZ3 QHZ4 SSZ1 SSZ2 SSZ3 SSZ4 BREFF DREFF FREFF"
    " PTX1 PTX2 PTX3 PTY1 PTY2"
)
MAGIC: Mapping[str, float | None] = MappingProxyType(
    {
        **dict.fromkeys(NEEDED),
        "LONGVL": 16.7,
        **dict.fromkeys(_SCALES.split(), 1.0),
        **dict.fromkeys(_ZEROS.split(), 0.0),
    }
)  # coefficients of the Magic Formula, and their values where a file leaves them out


def _curve(x: str, E: str) -> str:
    return f"atan({x} - {E}*({x} - atan({x})))"


_SLIPS = {  # over vx, sx, sy, spin, depth, speed, radius
    "V": "softplus(2*vx, speed) - vx",
    "kappa": "(rolling*spin - vx)/V",
    "alpha": "atan(sy/V)",
}
_MAGIC = {  # in turn, over the slips, load, gamma, and coefficients
    "dfz": "load/nominal - 1",
    "kappa_x": "kappa + (PHX1 + PHX2*dfz)*LHX",
    "mu_x": "(PDX1 + PDX2*dfz)*(1 - PDX3*(gamma*LGAX)**2)*LMUX",
    "E_x": "min((PEX1 + PEX2*dfz + PEX3*dfz**2)*(1 - PEX4*kappa_x/sqrt(kappa_x**2 + 1e-16))*LEX, 1)",
    "K_x": "(PKX1 + PKX2*dfz)*exp(PKX3*dfz)*LKX",  # over the load
    "b_x": "K_x*kappa_x/(PCX1*LCX*mu_x)",
    "F_x0": f"load*(mu_x*sin(PCX1*LCX*{_curve('b_x', 'E_x')}) + (PVX1 + PVX2*dfz)*LVX*LMUX)",
    "B_xa": "RBX1*LXAL/sqrt(1 + (RBX2*kappa)**2)",
    "E_xa": "min(REX1 + REX2*dfz, 1)",
    "b_xa": "B_xa*(alpha + RHX1)",
    "c_xa": "B_xa*RHX1",
    "Fx": f"F_x0*cos(RCX1*{_curve('b_xa', 'E_xa')})/cos(RCX1*{_curve('c_xa', 'E_xa')})",
    "gamma_y": "gamma*LGAY",
    "K_y": "2*PKY1*LKY/(PKY2*(1 + (load/(PKY2*nominal))**2))*(1 - PKY3*abs(gamma_y))",  # over the load
    "mu_y": "(PDY1 + PDY2*dfz)*(1 - PDY3*gamma_y**2)*LMUY",
    "H_y": "(PHY1 + PHY2*dfz)*LHY + PHY3*gamma_y",
    "V_y": "((PVY1 + PVY2*dfz)*LVY + (PVY3 + PVY4*dfz)*gamma_y)*LMUY",  # over the load
    "alpha_y": "alpha + H_y",
    "E_y": "min((PEY1 + PEY2*dfz)*(1 - (PEY3 + PEY4*gamma_y)*alpha_y/sqrt(alpha_y**2 + 1e-16))*LEY, 1)",
    "B_y": "K_y/(PCY1*LCY*mu_y)",
    "b_y": "B_y*alpha_y",
    "F_y0": f"load*(mu_y*sin(PCY1*LCY*{_curve('b_y', 'E_y')}) + V_y)",
    "B_yk": "RBY1*LYKA/sqrt(1 + (RBY2*(alpha - RBY3))**2)",
    "E_yk": "min(REY1 + REY2*dfz, 1)",
    "H_yk": "RHY1 + RHY2*dfz",
    "b_yk": "B_yk*(kappa + H_yk)",
    "c_yk": "B_yk*H_yk",
    "pure": f"F_y0*cos(RCY1*{_curve('b_yk', 'E_yk')})/cos(RCY1*{_curve('c_yk', 'E_yk')})",
    "D_yk": "mu_y*load*(RVY1 + RVY2*dfz + RVY3*gamma)/sqrt(1 + (RVY4*alpha)**2)",
    "Fy": "pure + D_yk*sin(RVY5*atan(RVY6*kappa))*LVYKA",
    "gamma_z": "gamma*LGAZ",
    "alpha_t": "alpha + QHZ1 + QHZ2*dfz + (QHZ3 + QHZ4*dfz)*gamma_z",
    "alpha_r": "alpha + H_y + V_y/K_y",
    "turned": "(K_x/K_y*kappa)**2 + 1e-16",
    "equal_t": "atan(sqrt(tan(alpha_t)**2 + turned))",
    "equal_r": "atan(sqrt(tan(alpha_r)**2 + turned))",
    "B_t": "(QBZ1 + QBZ2*dfz + QBZ3*dfz**2)*(1 + QBZ4*gamma_z + QBZ5*abs(gamma_z))*LKY/LMUY",
    "E_t": "min((QEZ1 + QEZ2*dfz + QEZ3*dfz**2)*(1 + (QEZ4 + QEZ5*gamma_z)*2/pi*atan(B_t*QCZ1*alpha_t)), 1)",
    "b_t": "B_t*equal_t",
    "cosine": "vx/sqrt(V**2 + sy**2)",
    "trail": "load/nominal*radius*(QDZ1 + QDZ2*dfz)*(1 + QDZ3*gamma_z + QDZ4*gamma_z**2)*LTR*cosine"
    f"*cos(QCZ1*{_curve('b_t', 'E_t')})",
    "residual": "load*radius*((QDZ6 + QDZ7*dfz)*LRES + (QDZ8 + QDZ9*dfz)*gamma_z)*LMUY*cosine"
    "/sqrt(1 + ((QBZ9*LKY/LMUY + QBZ10*B_y*PCY1*LCY)*equal_r)**2)",
    "arm": "radius*(SSZ1 + SSZ2*Fy/nominal + (SSZ3 + SSZ4*dfz)*gamma)*LS",
    "Mx": "radius*load*(QSX1*LVMX + (QSX3*Fy/nominal - QSX2*gamma)*LMX)",
    "My": "-radius*load*LMY*(QSY1 + QSY2*Fx/nominal + QSY3*V/LONGVL + QSY4*(V/LONGVL)**4)*tanh(rolling*spin/speed)",
    "Mz": "residual - trail*pure + arm*Fx",
}
_BRUSH = {
    "W": "softplus(2*radius*spin, speed) - radius*spin",
    "ex": "longitudinal*(radius*spin - vx)/W",
    "ey": "-lateral*sy/W",
    "p": "sqrt(ex**2 + ey**2 + 1e-16)/(3*friction*load + 1e-9)",
    "m": "max(1 - p, 0)",
    "share": "(1 + m + m**2)/(3*max(p, 1))",
    "Fx": "share*ex",
    "Fy": "share*ey",
    "Mz": "-ey*m**3*length/3",
}
_ROLLING = "radius - at*(DREFF*atan(BREFF*depth/at) + FREFF*depth/at)"

_RELAXED = {  # by kinds and ways: what replaces or precedes definitions of the law
    ("magic", LONGITUDINAL): {
        "sigma_x": "max(load*(PTX1 + PTX2*(load/nominal - 1))*exp(-PTX3*(load/nominal - 1))*radius/FNOMIN*LSGKP,"
        " radius/100)",
        "kappa": "u/sigma_x",
    },
    ("magic", LATERAL): {
        "sigma_y": "max(2*PTY1*load/(PTY2*nominal)/(1 + (load/(PTY2*nominal))**2)*(1 - PKY3*abs(gamma*LGAY))"
        "*radius*LFZO*LSGAL, radius/100)",
        "alpha": "atan(v/sigma_y)",
        "cosine": "vx/(V*sqrt(1 + (v/sigma_y)**2))",
    },
    ("brush", LONGITUDINAL): {"ex": "longitudinal*u/sigma_x"},
    ("brush", LATERAL): {"ey": "-lateral*v/sigma_y"},
}
_RATES = {  # of the deflections
    ("magic", LONGITUDINAL): {"du": "rolling*spin - vx - V*u/sigma_x"},
    ("magic", LATERAL): {"dv": "sy - V*v/sigma_y"},
    ("brush", LONGITUDINAL): {"du": "radius*spin - vx - W*u/sigma_x"},
    ("brush", LATERAL): {"dv": "sy - W*v/sigma_y"},
}

Law = tuple[tuple[str, Expression], ...]


def _read(texts: Mapping[str, str]) -> Law:
    return tuple((key, parse(text)) for key, text in texts.items())


_LAWS: Mapping[str, Law] = MappingProxyType(
    {
        "magic": _read({"nominal": "FNOMIN*LFZO", "at": "nominal/stiffness", "rolling": _ROLLING, **_SLIPS, **_MAGIC}),
        "brush": _read({**_BRUSH, "Mx": "0", "My": "0"}),
    }
)


def drop_unread(numbers: tuple[tuple[str, Expression], ...], transient: bool) -> tuple[tuple[str, Expression], ...]:
    """Leave out the coefficients that only transient tyres read."""
    return tuple((key, x) for key, x in numbers if transient or key not in RELAXING)


@cache
def _relax(kind: str, ways: tuple[str, ...]) -> Law:
    """Return a law whose slips relax in some ways; the lengths come before the first definition that reads one."""
    law = dict(_LAWS[kind])
    for way in ways:
        own = dict(_read(_RELAXED[kind, way]))
        first = next(k for k, key in enumerate(law) if key in own)
        before = {key: x for key, x in own.items() if key not in law}
        items = [*law.items()]
        law = {**dict(items[:first]), **before, **dict(items[first:]), **{k: x for k, x in own.items() if k in law}}
        law |= dict(_read(_RATES[kind, way]))
    return tuple(law.items())


@dataclass(frozen=True)
class Tyre:
    """A tyre of a wheel on a plane."""

    kind: Literal["magic", "brush"]
    numbers: tuple[tuple[str, Expression], ...]  # by their names: of MAGIC or BRUSH, in order
    speed: Expression = FADING  # [m/s]
    mirrored: bool = False  # measured on the other side of a car
    transient: bool = False  # a Magic Formula's slips relax by the lengths of its coefficients
    lengths: tuple[tuple[str, Expression], ...] = ()  # of relaxation of a brush, by WAYS [m]

    @property
    def relaxed(self) -> tuple[str, ...]:
        """The ways in which slips are states."""
        if self.kind == "brush":
            return tuple(way for way, _ in self.lengths)
        numbers = dict(self.numbers)
        return tuple(way for way, key in WAYS.items() if self.transient and numbers[key] != Number(0.0))

    @property
    def law(self) -> Law:
        """Return what is computed in turn, with names: over slips, load and numbers; Fx, Fy, Mx, My, Mz are in it.

        Where slips relax, the law is also over the deflections u and v, whose rates du and dv are in it.
        """
        return _relax(self.kind, self.relaxed)
