"""Muscles of Hill's type: their numbers -> tension, fibre, and equilibrium, as expressions.

Fibres of length l and rate v pull at the angle a to a tendon in series; both together have the length and rate of the
path. With x = 1 + (l/fibre - 1)/width and y = v/(speed fibre),

    l cos a = length - tendon's length,    l sin a = fibre sin(pennation)
    F = strength (activation f_l(x) f_v(y) + f_p(l/fibre) + damping y) cos a

with the curves of `mbsgen.model.muscle_curves`. A rigid tendon has the length `tendon`, and the tension is F; fibres do
not push on it, unless they have De Groote's curves. The force and the length of an elastic tendon are functions of a
signal s, `tendon_state`. Then force - F/strength = 0 is an equation of the motion, which determines the rate of s.
Fibres do not damp where this rate is solved for: else it would need an iteration.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

from mbsgen.expressions import Call, Expression, Name, Number, Operation, parse, substitute
from mbsgen.model.muscle_curves import DEGROOTE, SLOPE, Curves, DeGroote

ZERO, ONE = Number(0.0), Number(1.0)
SPEED, PASSIVE, STRAIN = Number(10.0), Number(0.6), Number(0.049)  # of a muscle, unless it says otherwise
LENGTH, LENGTH_RATE = "length", "rate"  # in the force of a force element: its own
TENDON_RATE = "tendon_state_rate"
FIBRE, COSINE = "fibre_length", "fibre_cosine"  # in equilibrium: `fibre_length` and `cosine`
GIVEN = ("activation", "tendon_state")  # by a use of the model
SHAPE = "curves"

_FIBRE = parse("sqrt(along**2 + (fibre*sin(pennation))**2)")
_PULL = parse("activation*active*faster + slack")
_DAMPING = parse("damping*y")


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
    tendon_state: Expression | None = None  # the signal of an elastic tendon; None: a rigid one
    tendon_strain: Expression = STRAIN  # of an elastic tendon that pulls with the strength
    curves: Curves = DEGROOTE

    @property
    def numbers(self) -> Mapping[str, Expression]:
        """Return the numbers of the model by their names."""
        given = {x.name: getattr(self, x.name) for x in fields(self)}
        return {key: x for key, x in given.items() if key not in (*GIVEN, SHAPE)}

    @property
    def tension(self) -> Expression:
        """Return the tension [N], over LENGTH and LENGTH_RATE of the path."""
        if self.tendon_state is not None:
            return Operation("*", self.strength, self._share)
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
    def settling(self) -> Expression | None:
        """Return the rate of the tendon's force at equilibrium [1/s], without damping; FIBRE and COSINE are in it.

        None for curves of force over velocity that are not solved for the velocity.
        """
        if not isinstance(self.curves, DeGroote) or self.damping != ZERO:
            return None
        given = {"s": self._share, "cosine": Name(COSINE), "slack": self._slack, "active": self._active}
        known = self._read(parse("(s/cosine - slack)/(activation*active)"), **given)
        y = substitute(self.curves.solved, {"k": known})
        text = f"({LENGTH_RATE} - speed*fibre*y/cosine)*{SLOPE}/(tendon*tendon_strain)"
        return self._read(parse(text), y=y, cosine=Name(COSINE), s=self._share)

    @property
    def active_force(self) -> Expression:
        """Return the active force of the fibres [N]; TENDON_RATE, FIBRE and COSINE are in it, as in all that follow."""
        return self._read(parse("strength*activation*active*faster"), active=self._active, faster=self._faster)

    @property
    def passive_force(self) -> Expression:
        """Return the passive force of the fibres, and of their damping [N]."""
        return self._read(parse("strength*(slack + damping*y)"), slack=self._slack, y=self._quickness)

    @property
    def isometric_force(self) -> Expression:
        """Return the active force that the fibres would have at rest [N]."""
        return self._read(parse("strength*activation*active"), active=self._active)

    @property
    def fibre_velocity(self) -> Expression:
        """Return the rate of the fibres' length [m/s]."""
        return self._read(parse("y*speed*fibre"), y=self._quickness)

    @property
    def stretch(self) -> Expression:
        """Return the length of the fibres over their best length."""
        return Operation("/", Name(FIBRE), self.fibre)

    @property
    def _share(self) -> Expression:
        """Return the force of an elastic tendon, over the strength."""
        assert self.tendon_state is not None, "an elastic tendon"
        return self._bend(self.curves.pull, self.tendon_strain)

    @property
    def _along(self) -> Expression:
        tendon = self.tendon
        if self.tendon_state is not None:
            tendon = Operation("*", tendon, self._bend(self.curves.stretch, self.tendon_strain))
        return Operation("-", Name(LENGTH), tendon)

    @property
    def _slack(self) -> Expression:
        """Return f_p."""
        if self.passive == ZERO:
            return ZERO
        return self._bend(self.curves.passive, self.passive, n=self.stretch)

    @property
    def _active(self) -> Expression:
        """Return f_l."""
        n = self.stretch
        return substitute(
            self.curves.active, {"n": n if self.width == ONE else self._read(parse("1 + (n - 1)/width"), n=n)}
        )

    @property
    def _quickness(self) -> Expression:
        """Return y."""
        rate: Expression = Name(LENGTH_RATE)
        if self.tendon_state is not None:
            longer = self._bend(self.curves.stretch_rate, self.tendon_strain, rate=Name(TENDON_RATE))
            rate = Operation("-", rate, Operation("*", self.tendon, longer))
        turned = "rate/(speed*fibre)" if self.pennation == ZERO else "rate*cosine/(speed*fibre)"
        return self._read(parse(turned), rate=rate, cosine=Name(COSINE))

    @property
    def _faster(self) -> Expression:
        """Return f_v."""
        velocity = self.curves.rigid_velocity if self.tendon_state is None else self.curves.velocity
        return substitute(velocity, {"y": self._quickness, "activation": self.activation})

    @property
    def _pull(self) -> Expression:
        """Return the force of the fibres along the tendon, over the strength; FIBRE and COSINE are in it."""
        force = self._read(_PULL, active=self._active, faster=self._faster, slack=self._slack)
        if self.damping != ZERO:
            force = Operation("+", force, self._read(_DAMPING, y=self._quickness))
        if self.tendon_state is None and not self.curves.may_push:
            force = Call("max", (force, ZERO))
        return force if self.pennation == ZERO else Operation("*", force, Name(COSINE))

    def _bend(self, curve: Expression, strain: Expression, **more: Expression) -> Expression:
        """Put numbers into a curve."""
        signal = {} if self.tendon_state is None else {"s": self.tendon_state}
        return substitute(curve, {"strain": strain, **signal, **more})

    def _read(self, expression: Expression, **more: Expression) -> Expression:
        own = {**self.numbers, "activation": self.activation, **more}
        if self.tendon_state is not None:
            own["tendon_state"] = self.tendon_state
        return substitute(expression, own)
