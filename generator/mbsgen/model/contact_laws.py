"""Laws of OpenSim for a sphere that presses on a plane or a sphere: their numbers -> forces, as expressions.

With the gap g, the velocity v of the sphere relative to the other side, rate = n.v along the normal and v_t across it,
`hunt_crossley` is Simbody's HuntCrossleyForce,

    N = stiffness max(-g, 0)^(3/2) max(1 - dissipation rate, 0),

and `smooth` its smooth form, SmoothSphereHalfSpaceForce, with a small force before contact,

    N = stiffness (g^2 + rounding)^(3/4) s(-depth_slope g) (1 - dissipation rate) s(speed_slope (1/dissipation - rate)),
    s(x) = (1 + tanh x)/2.

In both, with slip^2 = v_t.v_t + rounding (of `smooth` alone) and w = slip/speed, friction is Stribeck's,

    F = -N (min(w, 1) (coefficient + 2 (static - coefficient)/(1 + w^2)) + viscous slip) v_t/slip.

They act at the point p - share g n, where p is the sphere's point that is nearest to the other side.

Sources: Hunt, Crossley (1975); Sherman, Seth, Delp, "Simbody", Procedia IUTAM 2, 2011; Serrancoli, Falisse, Dembia,
Vantilt, Tanghe, Lefeber, Jonkers, De Schutter, De Groote, "Subject-exoskeleton contact model calibration leads to
accurate interaction force predictions", IEEE Trans. Neural Syst. Rehabil. Eng. 27, 2019; Simbody's documentation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mbsgen.expressions import Expression, Number, parse

_TINY = "1e-30"  # m: a root has no derivative at 0
_BLUNT = parse(f"stiffness*max(-gap, 0)*sqrt(max(-gap, {_TINY}))*max(1 - dissipation*rate, 0)")
_NEAR = parse("sqrt(gap**2 + rounding)")
_TOUCH = "stiffness*near*sqrt(near)*(1 - tanh(depth_slope*gap))/2"
_SMOOTH = parse(f"{_TOUCH}*(1 - dissipation*rate)*(1 + tanh(speed_slope*(1/dissipation - rate)))/2")
_LOSSLESS = parse(_TOUCH)
_STRIBECK = "(coefficient + 2*(static - coefficient)/(1 + {0}/speed**2))/sqrt(max({0}, speed**2)) + viscous"
_DRAGS = {
    "hunt_crossley": parse(f"normal*({_STRIBECK.format('square')})"),
    "smooth": parse(f"normal*({_STRIBECK.format('(square + rounding)')})"),
}


@dataclass(frozen=True)
class SphereLaw:
    """A law of a sphere, beside the stiffness, the dissipation and the friction of its contact."""

    kind: Literal["hunt_crossley", "smooth"]
    static: Expression | None = None  # coefficient of friction where slip begins; None: as of slip
    viscous: Expression = Number(0.0)  # part of friction that grows with the speed of slip [s/m]
    share: Expression = Number(0.5)  # of the depth, by which the sphere yields
    rounding: Expression = Number(1e-5)  # of `smooth`: of depths [m2] and of speeds of slip [m2/s2]
    depth_slope: Expression = Number(300.0)  # of `smooth` [1/m]
    speed_slope: Expression = Number(50.0)  # of `smooth` [s/m]

    @property
    def keys(self) -> tuple[str, ...]:
        """Return the names of its numbers; `static` may have none."""
        smooth = ("rounding", "depth_slope", "speed_slope") if self.kind == "smooth" else ()
        return ("static", "viscous", "share", *smooth)

    @property
    def drag(self) -> Expression:
        """Return friction over the speed of slip: over `normal`, `square` of the slip, and all numbers."""
        return _DRAGS[self.kind]

    @property
    def near(self) -> Expression | None:
        """Return the smooth distance that the normal force of `smooth` reads as `near`."""
        return _NEAR if self.kind == "smooth" else None

    def press(self, dissipation: Expression) -> Expression:
        """Return the normal force: over `gap`, `near`, `rate`, `stiffness`, `dissipation` and its own numbers."""
        if self.kind == "hunt_crossley":
            return _BLUNT
        return _LOSSLESS if dissipation == Number(0.0) else _SMOOTH
