"""The NLP methods that a problem may choose, by name. To add one, write a file, and an entry here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from mbsrun.ocp.methods.ipopt import IPOPT
from mbsrun.ocp.methods.method import (
    Answer,
    AnswerStack,
    Assignment,
    Instance,
    Iterate,
    Method,
    Near,
    Solver,
    Stack,
    StackSolver,
    mix,
    mix_many,
)
from mbsrun.ocp.methods.options import Amount, Choice, Option
from mbsrun.ocp.methods.sqp import SQP
from mbsrun.ocp.methods.stacks import make_stacks
from mbsrun.ocp.methods.stages import STAGES
from mbsrun.ocp.problem.problem import SolverName, SolverOptions

__all__ = [
    "METHODS",
    "Amount",
    "Answer",
    "AnswerStack",
    "Assignment",
    "Choice",
    "Instance",
    "Iterate",
    "Method",
    "Near",
    "Option",
    "Solver",
    "Stack",
    "StackSolver",
    "choose",
    "mix",
    "mix_many",
    "settle",
    "warm",
]

METHODS: Mapping[str, Method] = {"ipopt": IPOPT, "sqpmethod": SQP, "mbs": replace(STAGES, make_many=make_stacks)}


def choose(solver: SolverOptions, *, calls_casadi: bool = False) -> SolverName:
    """Return the method of a problem: the given one, else `mbs`.

    Where none is given, options that IPOPT alone has ask for IPOPT; so does what CasADi alone can call.
    """
    if solver.method is not None:
        return solver.method
    of_ipopt = any(name in IPOPT.options and name not in STAGES.options for name, _ in solver.options)
    return "ipopt" if calls_casadi or of_ipopt else "mbs"


def settle(solver: SolverOptions, *, calls_casadi: bool = False) -> SolverOptions:
    """Return options with their method chosen."""
    return replace(solver, method=choose(solver, calls_casadi=calls_casadi), fallback=solver.falls_back)


def warm(solver: SolverOptions) -> SolverOptions:
    """Return options for starts near a solution; what is given stays."""
    method = choose(solver)
    options = tuple((dict(METHODS[method].warm) | dict(solver.options)).items())
    return replace(solver, method=method, options=options, fallback=solver.falls_back)
