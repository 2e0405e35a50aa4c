"""The forms of the equations of motion, by the names of their functions: what is generated before a manifest is there.

    IMPL        impl(q, qd, qdd, u) = 0
    SEMI        semi gives M and c, semi_res(q, qd, qdd, u) = M qdd + c - Q = 0
    EXP1, EXP2  qdd = exp1(q, qd, u) = exp2(q, qd, u)

Where a manifest is at hand, functions are found by the roles of their results.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Form:
    """A form of the equations of motion."""

    name: str  # in tables and in files of users
    function: str
    residual: str | None  # the function that vanishes along a motion; None where `function` gives accelerations

    @property
    def is_direct(self) -> bool:
        """Return whether the function gives accelerations."""
        return self.residual is None

    @property
    def differentiated(self) -> str:
        """Return the function that has derivatives."""
        return self.residual or self.function


IMPL = Form("IMPL", "impl", "impl")
SEMI = Form("SEMI", "semi", "semi_res")
EXP1 = Form("EXP1", "exp1", None)
EXP2 = Form("EXP2", "exp2", None)
FORMS = (IMPL, SEMI, EXP1, EXP2)

VALUES = tuple(form.function for form in FORMS)
DIFFERENTIATED = tuple(form.differentiated for form in FORMS)
RESIDUALS = tuple(form.residual for form in FORMS if form.residual)
ACCELERATIONS = tuple(form.function for form in FORMS if form.is_direct)
FUNCTIONS = tuple(dict.fromkeys((*VALUES, *DIFFERENTIATED)))
