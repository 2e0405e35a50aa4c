"""The Magic Formula as the manual of MF-Tyre 5.2 prints it, and a tyre of a passenger car."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy import arctan, cos, sign, sin, tan
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROAD = Path(__file__).parents[3] / "models" / "vehicles" / "road.tir"
RADIUS = 0.313


def print_formulas(c: dict[str, float], Fz: float, kappa: float, alpha: float, gamma: float, V: float) -> Array:
    """Return Fx, Fy, Mx, My, Mz as MF-Tyre's manual prints them: not simplified, with signs and absolute values."""

    def curve(x: float, E: float) -> float:
        return float(arctan(x - E * (x - arctan(x))))

    Fz0, R0 = c["FNOMIN"] * c["LFZO"], RADIUS
    dfz = (Fz - Fz0) / Fz0
    kx = kappa + (c["PHX1"] + c["PHX2"] * dfz) * c["LHX"]
    mux = (c["PDX1"] + c["PDX2"] * dfz) * (1 - c["PDX3"] * (gamma * c["LGAX"]) ** 2) * c["LMUX"]
    Cx, Dx = c["PCX1"] * c["LCX"], mux * Fz
    Ex = (c["PEX1"] + c["PEX2"] * dfz + c["PEX3"] * dfz**2) * (1 - c["PEX4"] * sign(kx)) * c["LEX"]
    Kx = Fz * (c["PKX1"] + c["PKX2"] * dfz) * np.exp(c["PKX3"] * dfz) * c["LKX"]
    SVx = Fz * (c["PVX1"] + c["PVX2"] * dfz) * c["LVX"] * c["LMUX"]
    Fx0 = Dx * sin(Cx * curve(Kx / (Cx * Dx) * kx, min(Ex, 1))) + SVx
    Bxa, Exa = c["RBX1"] * cos(arctan(c["RBX2"] * kappa)) * c["LXAL"], c["REX1"] + c["REX2"] * dfz
    Gxa = [cos(c["RCX1"] * curve(Bxa * a, Exa)) for a in (alpha + c["RHX1"], c["RHX1"])]
    Fx = Fx0 * Gxa[0] / Gxa[1]

    gy = gamma * c["LGAY"]
    SHy = (c["PHY1"] + c["PHY2"] * dfz) * c["LHY"] + c["PHY3"] * gy
    SVy = Fz * ((c["PVY1"] + c["PVY2"] * dfz) * c["LVY"] + (c["PVY3"] + c["PVY4"] * dfz) * gy) * c["LMUY"]
    ay = alpha + SHy
    muy = (c["PDY1"] + c["PDY2"] * dfz) * (1 - c["PDY3"] * gy**2) * c["LMUY"]
    Cy, Dy = c["PCY1"] * c["LCY"], muy * Fz
    Ey = (c["PEY1"] + c["PEY2"] * dfz) * (1 - (c["PEY3"] + c["PEY4"] * gy) * sign(ay)) * c["LEY"]
    Ky = c["PKY1"] * Fz0 * sin(2 * arctan(Fz / (c["PKY2"] * Fz0))) * c["LKY"] * (1 - c["PKY3"] * abs(gy))
    By = Ky / (Cy * Dy)
    Fy0 = Dy * sin(Cy * curve(By * ay, min(Ey, 1))) + SVy
    Byk = c["RBY1"] * cos(arctan(c["RBY2"] * (alpha - c["RBY3"]))) * c["LYKA"]
    Eyk, SHyk = c["REY1"] + c["REY2"] * dfz, c["RHY1"] + c["RHY2"] * dfz
    Gyk = [cos(c["RCY1"] * curve(Byk * k, Eyk)) for k in (kappa + SHyk, SHyk)]
    DVyk = muy * Fz * (c["RVY1"] + c["RVY2"] * dfz + c["RVY3"] * gamma) * cos(arctan(c["RVY4"] * alpha))
    SVyk = DVyk * sin(c["RVY5"] * arctan(c["RVY6"] * kappa)) * c["LVYKA"]
    Fy = Fy0 * Gyk[0] / Gyk[1] + SVyk

    gz = gamma * c["LGAZ"]
    at, ar = alpha + c["QHZ1"] + c["QHZ2"] * dfz + (c["QHZ3"] + c["QHZ4"] * dfz) * gz, ay + SVy / Ky
    ateq, areq = (arctan(np.sqrt(tan(a) ** 2 + (Kx / Ky * kappa) ** 2)) * sign(a) for a in (at, ar))
    Bt = (c["QBZ1"] + c["QBZ2"] * dfz + c["QBZ3"] * dfz**2) * (1 + c["QBZ4"] * gz + c["QBZ5"] * abs(gz))
    Bt, Ct = Bt * c["LKY"] / c["LMUY"], c["QCZ1"]
    Dt = Fz * (c["QDZ1"] + c["QDZ2"] * dfz) * (1 + c["QDZ3"] * gz + c["QDZ4"] * gz**2) * R0 / Fz0 * c["LTR"]
    Et = (c["QEZ1"] + c["QEZ2"] * dfz + c["QEZ3"] * dfz**2) * (
        1 + (c["QEZ4"] + c["QEZ5"] * gz) * 2 / np.pi * arctan(Bt * Ct * at)
    )
    trail = Dt * cos(Ct * curve(Bt * ateq, min(Et, 1))) * cos(alpha)
    Br = c["QBZ9"] * c["LKY"] / c["LMUY"] + c["QBZ10"] * By * Cy
    Dr = Fz * ((c["QDZ6"] + c["QDZ7"] * dfz) * c["LRES"] + (c["QDZ8"] + c["QDZ9"] * dfz) * gz) * R0 * c["LMUY"]
    s = R0 * (c["SSZ1"] + c["SSZ2"] * Fy / Fz0 + (c["SSZ3"] + c["SSZ4"] * dfz) * gamma) * c["LS"]
    Mz = -trail * (Fy - SVyk) + Dr * cos(arctan(Br * areq)) * cos(alpha) + s * Fx
    Mx = R0 * Fz * (c["QSX1"] * c["LVMX"] + (-c["QSX2"] * gamma + c["QSX3"] * Fy / Fz0) * c["LMX"])
    fast = V / c["LONGVL"]
    My = -R0 * Fz * c["LMY"] * (c["QSY1"] + c["QSY2"] * Fx / Fz0 + c["QSY3"] * fast + c["QSY4"] * fast**4)
    return np.array([Fx, Fy, Mx, My, Mz])
