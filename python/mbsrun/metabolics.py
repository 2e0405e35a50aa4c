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

from collections.abc import Container, Mapping
from dataclasses import dataclass

from mbsgen.expressions import Expression, Name, Number, names, parse, spell, substitute
from mbsgen.manifest import Contraction, Element, Fibres, Manifest

EXCITATION, RATE = "{}_excitation", "{}_rate"  # of an activation, and of a tendon's state: names in a problem
PRICED = "metabolics {}"  # the name of a muscle's term of the cost
BASAL = 1.2  # of a body at rest [W/kg], as in OpenSim

_MASS = parse("strength/tension*density*best")
_HEAT = parse("mass*((40 + 74*g)*share*sin(pi/2*excitation) + (133 + 111*g)*(1 - share)*(1 - cos(pi/2*excitation)))")
_LENGTH = parse("max(min(stretch, 1), 0.5) - 2*max(min(stretch, 1.5) - 1, 0)")  # g
_PLAIN = parse("0.25*smoothmax(0, -velocity, w)")  # S over F + P
_DEPENDENT = parse("0.18*smoothmax(0, -velocity, w) - 0.157*smoothmax(0, velocity, w)")
_FURTHER = parse("0.16*isometric*smoothmax(0, -velocity, w)")
_RATE = parse("heat + active*(share - velocity) + passive*share")
_TOTAL = parse("smoothmax(smoothmax(rate, 0, power) + active*velocity, mass, least) - active*velocity")


@dataclass(frozen=True)
class Metabolism:
    """The numbers of metabolic rates."""

    slow: Expression = Number(0.5)  # part of slow fibres
    specific_tension: Expression = Number(0.25e6)  # Pa: the mass of a muscle follows
    density: Expression = Number(1059.7)  # kg/m3
    force_dependent: bool = False  # heat of shortening by the isometric force
    velocity_smoothing: Expression = Number(10.0)  # s/m, as OpenSim has them
    power_smoothing: Expression = Number(10.0)  # 1/W
    heat_smoothing: Expression = Number(10.0)  # 1/W


USUAL = Metabolism()


def write_rate(parts: Contraction, excitation: Expression, wanted: Metabolism) -> Expression:
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


def name_numbers(fibres: Fibres, name: str, rate: Expression | None, expression: Expression) -> Expression:
    """Write an expression of a muscle's numbers over quantities of a motion; `rate` is of the tendon's state."""
    own: dict[str, Expression] = {"length": Name(f"length_{name}"), "rate": Name(f"rate_{name}")}
    fibre, cosine = (substitute(parse(text), own) for text in (fibres.fibre, fibres.cosine))
    own |= {"fibre_length": fibre, "fibre_cosine": cosine}
    own |= {} if rate is None else {"tendon_state_rate": substitute(rate, own)}
    return substitute(expression, own)


def list_contracting(manifest: Manifest) -> list[tuple[Element, Fibres, Contraction]]:
    """List the muscles of a model whose contraction is known."""
    elements = () if manifest.appearance is None else manifest.appearance.elements
    pairs = [(x, x.muscle, None if x.muscle is None else x.muscle.contraction) for x in elements]
    return [(x, fibres, parts) for x, fibres, parts in pairs if fibres is not None and parts is not None]


def list_rates(manifest: Manifest, known: Container[str]) -> Mapping[str, Expression | None]:
    """Return the metabolic rate [W] of each muscle over quantities of a motion, by its name.

    `known` has the names of these. Where the motion has no excitation, the activation is taken for it. A rate is None
    where the motion lacks a number that it reads, such as the activation or the rate of an elastic tendon.
    """
    found: dict[str, Expression | None] = {}
    elements = list_contracting(manifest)
    for (element, fibres, parts), name in zip(elements, spell([x.name for x, *_ in elements]), strict=True):
        activation = parse(fibres.activation)
        drive = EXCITATION.format(activation.name) if isinstance(activation, Name) else ""
        rate = write_rate(parts, Name(drive) if drive in known else activation, USUAL)
        tendon = _find_tendon(fibres, known)
        whole = rate if name is None else name_numbers(fibres, name, tendon, rate)
        is_known = all(x in known or x in manifest.signals for x in names(whole))
        found[element.name] = whole if is_known else None
    return found


def _find_tendon(fibres: Fibres, known: Container[str]) -> Expression | None:
    """Return the rate of the state of an elastic tendon."""
    state = parse(fibres.tendon_state) if fibres.tendon_state else None
    if isinstance(state, Name) and (own := RATE.format(state.name)) in known:
        return Name(own)
    return parse(fibres.settling) if fibres.settling else None
