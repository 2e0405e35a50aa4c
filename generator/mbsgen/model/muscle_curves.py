"""Curves of muscles: forces over lengths and rates, over the strength, as expressions; of three published models.

Over the length n of fibres, their rate y, the activation, the signal s of an elastic tendon with its rate, and the
strain at which passive fibres, or the tendon, pull with the strength:

    active, passive, velocity    factors of the fibres' force, of n, of n and y, and of y; y < 0 shortens
    pull                         the force of the tendon, of s
    stretch, stretch_rate        its length over the slack length, of s, and the rate of that

The signal s is the force itself for De Groote's curves, whose tendon can be inverted, and else the strain of the tendon
over its strain at the strength, which has a value where the tendon is slack, too.

De Groote: De Groote, Kinney, Rao, Fregly, "Evaluation of direct collocation optimal control problem formulations for
solving the muscle redundancy problem", Annals of Biomedical Engineering 44, 2016, with the digits of OpenSim's
DeGrooteFregly2016Muscle, whose f_p is 0 at 0.2 (OpenSim 4.6, Apache License 2.0).

Millard: Millard, Uchida, Seth, Delp, "Flexing computational muscle: modeling and simulation of musculotendon dynamics",
Journal of Biomechanical Engineering 135, 2013: quintic Bezier curves from point to point with given slopes, with the
points of OpenSim 4.6. Lines continue them.

Thelen: Thelen, "Adjustment of muscle mechanics model parameters to simulate dynamic contractions in older adults",
Journal of Biomechanical Engineering 125, 2003, eqs. (1) to (7). Lines continue the force over velocity where fibres
shorten without force, and from a part `reach` of the largest force on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import ClassVar, Self

from mbsgen.expressions import BEZIER, Call, Expression, Name, Number, Operation, fold, names, parse, substitute

N, Y, S, STRAIN = Name("n"), Name("y"), Name("s"), Name("strain")
SLOPE = "log(6)*(s + 0.2)"  # of the force of De Groote's tendon by its length, times slack length and strain
_ZERO, _ONE = Number(0.0), Number(1.0)
_PART = "0", "1"


@dataclass(frozen=True)
class Limits:
    """Bounds of a number of a curve, over the others and `passive` and `strain` of the muscle."""

    key: str
    lower: str
    upper: str = ""  # "": none
    is_strict: bool = True  # the bounds themselves are refused

    @property
    def reads(self) -> frozenset[str]:
        """Return the names in the bounds."""
        return frozenset().union(*(names(parse(text)) for text in (self.lower, self.upper) if text))


@dataclass(frozen=True)
class _Shape:
    """The numbers of curves."""

    @property
    def numbers(self) -> Mapping[str, Expression]:
        """Return the numbers by their names; numbers that follow from others are absent."""
        given = {x.name: getattr(self, x.name) for x in fields(self)}
        return {key: x for key, x in given.items() if x is not None}

    def exchange(self, exchange: Callable[[str, Expression], Expression]) -> Self:
        """Return the same curves with other numbers, by their names and values."""
        make: Callable[..., Self] = type(self)
        return make(**{key: exchange(key, x) for key, x in self.numbers.items()})


@dataclass(frozen=True)
class DeGroote(_Shape):
    """The curves of De Groote and others (2016)."""

    name = "degroote"
    limits: ClassVar[tuple[Limits, ...]] = ()
    has_force = True  # the signal of an elastic tendon is its force
    may_push = True  # on a rigid tendon

    active = parse(
        "0.8150671134243542*exp(-((n - 1.055033428970575)/(0.162384573599574 + 0.063303448465465*n))**2/2)"
        " + 0.433004984392647*exp(-((n - 0.716775413397760)/(0.200356847296188*n - 0.029947116970696))**2/2)"
        " + 0.1*exp(-((n - 1)/0.353553390593274)**2/2)"
    )
    velocity = substitute(
        parse("0.8825327733249912 - 0.3211346127989808*log(sqrt(z**2 + 1) + z)"), {"z": parse("-8.149*y - 0.374")}
    )
    passive = parse("(exp(4*(n - 1)/strain) - exp(-3.2/strain))/(exp(4) - exp(-3.2/strain))")
    pull: Expression = S
    stretch = parse("1 + log((s + 0.2)/0.2)*strain/log(6)")
    stretch_rate = parse(f"rate*strain/({SLOPE})")
    solved = substitute(  # y where the factor of active force is k
        parse("((exp(-h) - exp(h))/2 + 0.374)/(-8.149)"), {"h": parse("(k - 0.8825327733249912)/0.3211346127989808")}
    )

    @property
    def rigid_velocity(self) -> Expression:
        """Return `velocity` at a rigid tendon."""
        return self.velocity


@dataclass(frozen=True)
class _Strained(_Shape):
    """Curves of tendons whose signal is a strain over `strain`."""

    has_force = False
    may_push = False
    stretch = parse("1 + strain*s")
    stretch_rate = parse("strain*rate")


@dataclass(frozen=True)
class Thelen(_Strained):
    """The curves of Thelen (2003)."""

    name = "thelen"
    limits = (
        Limits("active_shape", "0"),
        Limits("passive_shape", "0"),
        Limits("velocity_shape", "0"),
        Limits("greatest", "1"),
        Limits("reach", "1/greatest", "1"),
    )

    active_shape: Expression = Number(0.45)  # the width of active force over length, squared
    passive_shape: Expression = Number(5.0)  # exponent of passive force
    velocity_shape: Expression = Number(0.25)  # curvature of force over velocity
    greatest: Expression = Number(1.4)  # force of fibres that lengthen
    reach: Expression = Number(0.95)  # of it, up to which the curve is Thelen's

    @property
    def active(self) -> Expression:
        """Return the factor of active force over length."""
        return _read("exp(-(n - 1)**2/active_shape)", **self.numbers)

    @property
    def velocity(self) -> Expression:
        """Return the factor of active force over velocity."""
        own: dict[str, Expression] = {"A": self.velocity_shape, "F": self.greatest}
        own["top"] = _read("reach*greatest", **self.numbers)
        own["k"] = _read("(2 + 2/A)/(F - 1)", **own)
        own["last"] = _read("(top - 1)/(k*(F - top))", **own)
        own["slope"] = _read("k*(F - top)**2/(F - 1)", **own)
        own["w"] = parse("y/(0.25 + 0.75*activation)")
        short, long = (_read(text, **own) for text in ("max(min(w, 0), -1)", "max(min(w, last), 0)"))
        curve = "(1 + short)/(1 - short/A) + (1 + k*F*long)/(1 + k*long) - 1"
        return _read(f"{curve} + min(w + 1, 0)/(1 + 1/A) + max(w - last, 0)*slope", short=short, long=long, **own)

    @property
    def rigid_velocity(self) -> Expression:
        """Return `velocity` at a rigid tendon, on which fibres do not push."""
        return Call("max", (self.velocity, _ZERO))

    @property
    def passive(self) -> Expression:
        """Return the passive force."""
        return _read("(exp(k*max(n - 1, 0)/strain) - 1)/(exp(k) - 1)", k=self.passive_shape)

    @property
    def pull(self) -> Expression:
        """Return the force of the tendon: exponential up to a third of the strength, then a line."""
        toe = _read("0.99*exp(3)/(1.66*exp(3) - 0.67)")
        return _read("0.33*(exp(3*max(min(s, e), 0)/e) - 1)/(exp(3) - 1) + 0.67*max(s - e, 0)/(1 - e)", e=toe)


@dataclass(frozen=True)
class Millard(_Strained):
    """The curves of Millard and others (2013)."""

    name = "millard"
    limits = (
        Limits("shortest", "0"),
        Limits("transition", "shortest", "0.95"),
        Limits("longest", "1.1"),
        Limits("shallow", "0", "1/(1 - transition)"),
        Limits("floor", "0", "(1 - shallow*(0.95 - transition))/2", is_strict=False),
        Limits("shortening_end", "0", "shortening_near", is_strict=False),
        Limits("shortening_near", "0", "1"),
        Limits("isometric", "1"),
        Limits("lengthening_near", "0", "greatest - 1"),
        Limits("lengthening_end", "0", "lengthening_near", is_strict=False),
        Limits("greatest", "1"),
        Limits("shortening_curviness", *_PART, is_strict=False),
        Limits("lengthening_curviness", *_PART, is_strict=False),
        Limits("slack", "-1", "passive"),
        Limits("passive_low", "0", "1/(passive - slack)"),
        Limits("passive_slope", "1/(passive - slack)"),
        Limits("passive_curviness", *_PART, is_strict=False),
        Limits("tendon_slope", "1/strain"),
        Limits("tendon_toe", *_PART),
        Limits("tendon_curviness", *_PART, is_strict=False),
    )

    shortest: Expression = Number(0.4441)  # fibres that are active
    transition: Expression = Number(0.73)  # from the steep to the shallow part of their active force
    longest: Expression = Number(1.8123)
    shallow: Expression = Number(0.8616)  # slope
    floor: Expression = _ZERO  # of active force
    shortening_end: Expression = _ZERO  # slope of force over velocity at the largest speed
    shortening_near: Expression = Number(0.25)  # near it
    isometric: Expression = Number(5.0)
    lengthening_near: Expression = Number(0.15)
    lengthening_end: Expression = _ZERO
    greatest: Expression = Number(1.4)  # force of fibres that lengthen at the largest speed
    shortening_curviness: Expression = Number(0.6)
    lengthening_curviness: Expression = Number(0.9)
    slack: Expression = _ZERO  # strain at which passive fibres begin to pull
    passive_low: Expression = Number(0.2)  # slope at low force
    passive_slope: Expression | None = None  # at the strength; None: 2/(passive - slack)
    passive_curviness: Expression = Number(0.75)
    tendon_slope: Expression | None = None  # at the strength; None: 1.375/strain
    tendon_toe: Expression = Number(2 / 3)  # force at which the curve becomes a line
    tendon_curviness: Expression = Number(0.5)

    @property
    def active(self) -> Expression:
        """Return the factor of active force over length."""
        own = {**self.numbers, "low": _read("1 - shallow*(0.95 - transition)", **self.numbers)}
        texts = (
            ("shortest", "floor", "0"),
            ("(shortest + transition)/2", "low/2", "1.25*low/(transition - shortest)"),
            ("(transition + 0.95)/2", "(1 + low)/2", "shallow"),
            ("1", "1", "0"),
            ("(1.05 + longest)/2", "1/2", "1/(1.1 - longest)"),
            ("longest", "floor", "0"),
        )
        return _join(N, _list_points(texts, own), [_ONE] * 5)

    @property
    def velocity(self) -> Expression:
        """Return the factor of active force over velocity."""
        texts = (
            ("-1", "0", "shortening_end"),
            ("-0.9", "0.05*(shortening_near + shortening_end)", "shortening_near"),
            ("0", "1", "isometric"),
            ("0.9", "greatest - 0.05*(lengthening_near + lengthening_end)", "lengthening_near"),
            ("1", "greatest", "lengthening_end"),
        )
        curviness = [self.shortening_curviness] * 2 + [self.lengthening_curviness] * 2
        return _join(Y, _list_points(texts, self.numbers), curviness)

    @property
    def rigid_velocity(self) -> Expression:
        """Return `velocity` at a rigid tendon."""
        return self.velocity

    @property
    def passive(self) -> Expression:
        """Return the passive force."""
        own: dict[str, Expression] = {"slack": self.slack, "low": self.passive_low}
        own["slope"] = _read("2/(strain - slack)", **own) if self.passive_slope is None else self.passive_slope
        own["step"] = _read("min(0.1/slope, 0.1*(strain - slack))", **own)
        texts = ("1 + slack", "0", "0"), ("1 + slack + step", "low*step/2", "low"), ("1 + strain", "1", "slope")
        return _join(N, _list_points(texts, own), [self.passive_curviness] * 2)

    @property
    def pull(self) -> Expression:
        """Return the force of the tendon."""
        own: dict[str, Expression] = {"toe": self.tendon_toe, "end": Number(1.375)}
        if self.tendon_slope is not None:
            own["end"] = _read("slope*strain", slope=self.tendon_slope)
        own["place"] = _read("1 + (toe - 1)/end", **own)  # where the line begins
        own["foot"] = _read("place/10", **own)
        own["middle"] = _read("1 + (toe/2 - 1)/end", **own)
        own["slope"] = _read("toe/2/(middle - foot)", **own)
        corner = "(foot + middle)/2", "slope*(middle - foot)/2", "slope"
        texts = ("0", "0", "0"), corner, ("place", "toe", "end")
        return _join(S, _list_points(texts, own), [self.tendon_curviness] * 2)


Curves = DeGroote | Thelen | Millard
DEGROOTE = DeGroote()
CURVES: Mapping[str, type[Curves]] = {x.name: x for x in (DeGroote, Thelen, Millard)}


_Point = tuple[Expression, Expression, Expression]  # x, y and the slope


def _list_points(texts: Sequence[tuple[str, str, str]], numbers: Mapping[str, Expression]) -> list[_Point]:
    return [(_read(x, **numbers), _read(y, **numbers), _read(slope, **numbers)) for x, y, slope in texts]


def _join(x: Expression, points: Sequence[_Point], curviness: Sequence[Expression]) -> Expression:
    """Join points by Bezier curves; lines go on from the first and the last."""
    total = points[0][1]
    for (a, b), c in zip(pairwise(points), curviness, strict=True):
        given = dict(zip(("x0", "y0", "s0", "x1", "y1", "s1"), (*a, *b), strict=True))
        xc = _read("(y1 - y0 - x1*s1 + x0*s0)/(s0 - s1)", **given)
        yc = _read("y1 + (xc - x1)*s1", **given, xc=xc)
        arguments = (x, a[0], a[1], xc, yc, b[0], b[1], _read("0.1 + 0.8*c", c=c))
        total = Operation("+", total, Operation("-", Call(BEZIER, arguments), a[1]))
    for text, (place, _, slope) in (("min(x - x0, 0)", points[0]), ("max(x - x0, 0)", points[-1])):
        if slope != _ZERO:
            total = Operation("+", total, Operation("*", slope, _read(text, x=x, x0=place)))
    return total


def _read(text: str, **given: Expression) -> Expression:
    """Read an expression, and compute its known parts."""
    return fold(substitute(parse(text), given))
