"""Muscles of Hill's type: their numbers -> tension, fibre, and equilibrium, as expressions.

Fibres of length l and rate v pull at the angle a to a tendon in series; both together have the length and rate of the
path. With x = 1 + (l/fibre - 1)/width and y = v/(speed fibre),

    l cos a = length - tendon's length,    l sin a = fibre sin(pennation)
    F = strength (activation f_l(x) f_v(y) + f_p(l/fibre) + damping y) cos a

A rigid tendon has the length `tendon`, and the tension is F. An elastic one has the tension strength s, where s is a
signal, `tendon_force`, and the length tendon f_t^-1(s). Then s - F/strength = 0 is an equation of the motion, which
determines the rate of s. Fibres do not damp where this rate is solved for: else it would need an iteration.

Curves: De Groote, Kinney, Rao, Fregly, "Evaluation of direct collocation optimal control problem formulations for
solving the muscle redundancy problem", Annals of Biomedical Engineering 44, 2016, with the digits of OpenSim's
DeGrooteFregly2016Muscle, whose f_p is 0 at x = 0.2 (OpenSim 4.6, Apache License 2.0).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

from mbsgen.expressions import Expression, Name, Number, Operation, parse, substitute

ZERO, ONE = Number(0.0), Number(1.0)
SPEED, PASSIVE, STRAIN = Number(10.0), Number(0.6), Number(0.049)  # of a muscle, unless it says otherwise
LENGTH, LENGTH_RATE = "length", "rate"  # in the force of a force element: its own
TENDON_RATE = "tendon_force_rate"
FIBRE, COSINE = "fibre_length", "fibre_cosine"  # in equilibrium: `fibre_length` and `cosine`
GIVEN = ("activation", "tendon_force")  # by a use of the model

_ACTIVE = parse(
    "0.8150671134243542*exp(-((x - 1.055033428970575)/(0.162384573599574 + 0.063303448465465*x))**2/2)"
    " + 0.433004984392647*exp(-((x - 0.716775413397760)/(0.200356847296188*x - 0.029947116970696))**2/2)"
    " + 0.1*exp(-((x - 1)/0.353553390593274)**2/2)"
)
_SPEED = parse("0.8825327733249912 - 0.3211346127989808*log(sqrt(z**2 + 1) + z)")
_PASSIVE = parse("(exp(4*(n - 1)/passive) - exp(-3.2/passive))/(exp(4) - exp(-3.2/passive))")
_TENDON = parse("tendon*(1 + log((tendon_force + 0.2)/0.2)*tendon_strain/log(6))")
_TENDON_RATE = parse("tendon*tendon_force_rate*tendon_strain/(log(6)*(tendon_force + 0.2))")
_FIBRE = parse("sqrt(along**2 + (fibre*sin(pennation))**2)")
_PULL = parse("activation*active*faster + slack")
_DAMPING = parse("damping*y")
_HYPERBOLIC = parse("(k - 0.8825327733249912)/0.3211346127989808")
_SOLVED = parse("((exp(-h) - exp(h))/2 + 0.374)/(-8.149)")  # y, as f_v(y) = k


@dataclass(frozen=True)
class Muscle:
    """The numbers of a muscle: its tendon is rigid, unless a signal gives the force in it."""

    strength: Expression  # the largest isometric force [N]
    fibre: Expression  # length at which fibres are strongest [m]
    tendon: Expression  # length of the slack tendon [m]
    activation: Expression  # over signals, and other numbers of the state
    pennation: Expression = ZERO  # angle between fibres of that length and the tendon [rad]
    speed: Expression = SPEED  # at which fibres shorten without force [lengths/s]
    damping: Expression = ZERO  # of fibres: force over strength at that speed
    passive: Expression = PASSIVE  # strain of passive fibres that pull with the strength; 0: they do not pull
    width: Expression = ONE  # by which the curve of active force is stretched
    tendon_force: Expression | None = None  # over strength; None: a rigid tendon
    tendon_strain: Expression = STRAIN  # of an elastic tendon that pulls with the strength

    @property
    def numbers(self) -> Mapping[str, Expression]:
        """Return the numbers of the model by their names."""
        given = {x.name: getattr(self, x.name) for x in fields(self)}
        return {key: x for key, x in given.items() if key not in GIVEN}

    @property
    def tension(self) -> Expression:
        """Return the tension [N], over LENGTH and LENGTH_RATE of the path."""
        if self.tendon_force is not None:
            return Operation("*", self.strength, self.tendon_force)
        own = {FIBRE: self.fibre_length, COSINE: self.cosine}
        return Operation("*", self.strength, substitute(self._pull, own))

    @property
    def fibre_length(self) -> Expression:
        """Return the length of the fibres [m]."""
        return self._along if self.pennation == ZERO else self._read(_FIBRE, along=self._along)

    @property
    def cosine(self) -> Expression:
        """Return the cosine of the angle between fibres and tendon."""
        return ONE if self.pennation == ZERO else Operation("/", self._along, self.fibre_length)

    @property
    def equilibrium(self) -> Expression:
        """Return the tension less the force of the fibres, over the strength; TENDON_RATE, FIBRE, COSINE are in it."""
        return Operation("-", self._share, self._pull)

    @property
    def settling(self) -> Expression:
        """Return the rate of the tendon's force at equilibrium [1/s], without damping; FIBRE and COSINE are in it."""
        given = {"s": self._share, "cosine": Name(COSINE), "slack": self._slack, "active": self._active}
        known = self._read(parse("(s/cosine - slack)/(activation*active)"), **given)
        y = substitute(_SOLVED, {"h": substitute(_HYPERBOLIC, {"k": known})})
        text = f"({LENGTH_RATE} - speed*fibre*y/cosine)*log(6)*(tendon_force + 0.2)/(tendon*tendon_strain)"
        return self._read(parse(text), y=y, cosine=Name(COSINE))

    @property
    def _share(self) -> Expression:
        assert self.tendon_force is not None, "an elastic tendon"
        return self.tendon_force

    @property
    def _along(self) -> Expression:
        return Operation("-", Name(LENGTH), self.tendon if self.tendon_force is None else self._read(_TENDON))

    @property
    def _slack(self) -> Expression:
        """Return f_p."""
        if self.passive == ZERO:
            return ZERO
        return self._read(_PASSIVE, n=Operation("/", Name(FIBRE), self.fibre))

    @property
    def _active(self) -> Expression:
        """Return f_l."""
        n = Operation("/", Name(FIBRE), self.fibre)
        stretched = parse("1 + (n - 1)/width")
        return self._read(_ACTIVE, x=n if self.width == ONE else self._read(stretched, n=n))

    @property
    def _pull(self) -> Expression:
        """Return the force of the fibres along the tendon, over the strength; FIBRE and COSINE are in it."""
        rate: Expression = Name(LENGTH_RATE)
        if self.tendon_force is not None:
            rate = Operation("-", rate, self._read(_TENDON_RATE))
        turned = "rate/(speed*fibre)" if self.pennation == ZERO else "rate*cosine/(speed*fibre)"
        y = self._read(parse(turned), rate=rate, cosine=Name(COSINE))
        faster = self._read(_SPEED, z=substitute(parse("-8.149*y - 0.374"), {"y": y}))
        force = self._read(_PULL, active=self._active, faster=faster, slack=self._slack)
        if self.damping != ZERO:
            force = Operation("+", force, self._read(_DAMPING, y=y))
        return force if self.pennation == ZERO else Operation("*", force, Name(COSINE))

    def _read(self, expression: Expression, **more: Expression) -> Expression:
        own = {**self.numbers, "activation": self.activation, **more}
        if self.tendon_force is not None:
            own["tendon_force"] = self.tendon_force
        return substitute(expression, own)
