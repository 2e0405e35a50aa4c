"""The metabolic rate of a muscle, as text: Bhargava, Pandy, Anderson (2004), smoothed.

With the excitation e, the part s of slow fibres, the mass m of the muscle, the active and passive forces F and P of its
fibres, their isometric force F0 at the same activation, and their rate v, negative where they shorten,

    E = A + M + S + W,    W = -F v
    A = m (40 s sin(pi e/2) + 133 (1 - s) (1 - cos(pi e/2)))             heat of activation
    M = m g(l) (74 s sin(pi e/2) + 111 (1 - s) (1 - cos(pi e/2)))        heat of maintenance, at the length l of fibres
    S = (F + P) r(-v)/4                                                  heat of shortening, or
    S = (0.16 F0 + 0.18 (F + P)) r(-v) - 0.157 (F + P) r(v)              if it is `force_dependent`

in W, where r(x) = smoothmax(0, x, w), and g is piecewise linear. Heat is added where E would be negative; and the heat,
E - W, is 1 W/kg at least. Both bounds are smooth.

Bhargava, Pandy, Anderson, "A phenomenological model for estimating metabolic energy consumption in muscle contraction",
Journal of Biomechanics 37, 2004; with the numbers and the smoothing of OpenSim's Bhargava2004SmoothedMuscleMetabolics
(OpenSim 4.6, Apache License 2.0).
"""

from __future__ import annotations

from mbsgen.expressions import Expression, parse, substitute
from mbsgen.manifest import Contraction
from mbsrun.ocp.statement.sections import MetabolicsSection

_MASS = parse("strength/tension*density*best")
_HEAT = parse("mass*((40 + 74*g)*share*sin(pi/2*excitation) + (133 + 111*g)*(1 - share)*(1 - cos(pi/2*excitation)))")
_LENGTH = parse("max(min(stretch, 1), 0.5) - 2*max(min(stretch, 1.5) - 1, 0)")  # g
_PLAIN = parse("0.25*smoothmax(0, -velocity, w)")  # S over F + P
_DEPENDENT = parse("0.18*smoothmax(0, -velocity, w) - 0.157*smoothmax(0, velocity, w)")
_FURTHER = parse("0.16*isometric*smoothmax(0, -velocity, w)")
_RATE = parse("heat + active*(share - velocity) + passive*share")
_TOTAL = parse("smoothmax(smoothmax(rate, 0, power) + active*velocity, mass, least) - active*velocity")


def write_rate(parts: Contraction, excitation: Expression, wanted: MetabolicsSection) -> Expression:
    """Write the metabolic rate of a muscle [W], over what its fibres read."""
    own: dict[str, Expression] = {key: parse(text) for key, text in parts.model_dump().items()}
    own |= {"tension": wanted.specific_tension, "density": wanted.density, "excitation": excitation}
    widths = {"w": wanted.velocity_smoothing, "power": wanted.power_smoothing, "least": wanted.heat_smoothing}
    own |= {key: substitute(parse("1/(2*k)"), {"k": x}) for key, x in widths.items()}
    own["mass"] = substitute(_MASS, own)
    heat = substitute(_HEAT, {**own, "share": wanted.slow, "g": substitute(_LENGTH, own)})
    share = substitute(_DEPENDENT if wanted.force_dependent else _PLAIN, own)
    rate = substitute(_RATE, {**own, "heat": heat, "share": share})
    if wanted.force_dependent:
        rate = substitute(parse("rate + further"), {"rate": rate, "further": substitute(_FURTHER, own)})
    return substitute(_TOTAL, {**own, "rate": rate})
