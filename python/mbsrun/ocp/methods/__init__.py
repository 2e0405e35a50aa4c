"""The NLP methods that a problem may choose, by name. To add one, write a file, and an entry here."""

from __future__ import annotations

from collections.abc import Mapping

from mbsrun.ocp.methods.ipopt import IPOPT
from mbsrun.ocp.methods.method import Answer, Iterate, Method, Order, Solver, Start
from mbsrun.ocp.methods.options import Amount, Choice, Option
from mbsrun.ocp.methods.sqp import SQP
from mbsrun.ocp.methods.stages import STAGES

__all__ = [
    "METHODS",
    "Amount",
    "Answer",
    "Choice",
    "Iterate",
    "Method",
    "Option",
    "Order",
    "Solver",
    "Start",
]

METHODS: Mapping[str, Method] = {"ipopt": IPOPT, "sqpmethod": SQP, "mbs": STAGES}
