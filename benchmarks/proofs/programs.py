"""A problem file -> its nonlinear program in CasADi's symbols, kernels included, and a point near its optimum.

Kernels are the module in Python that mbsgen writes beside the C, traced in symbols: the same tape, whose derivatives
here are CasADi's. Costs are divided by the largest weight.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmarks.proofs.monotone import drop_between
from benchmarks.proofs.proof import Nonlinear, Point
from benchmarks.proofs.rest import balance, drop_limits, find_rest
from mbsgen.manifest import Kernel, Manifest
from mbsrun.measuring.candidates import load_equations, trace
from mbsrun.measuring.mechanisms import Subject
from mbsrun.models import Extent
from mbsrun.ocp.ground.no_mechanism import NO_MECHANISM
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.program import Program
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import Solver, solve
from mbsrun.ocp.statement.statement import read_problem

Array = NDArray[np.float64]
Signs = NDArray[np.int8]

EXACT = {
    "tol": 1e-13,
    "acceptable_tol": 1e-12,
    "bound_relax_factor": 0.0,
    "mu_init": 1e-9,
    "warm_start_init_point": "yes",
    "warm_start_bound_push": 1e-10,
    "warm_start_mult_bound_push": 1e-10,
    "max_iter": 200,
    "print_level": 0,
    "sb": "yes",
}


@dataclass(frozen=True)
class Traced:
    """A mechanism whose kernels are symbols for CasADi."""

    subject: Subject

    @property
    def manifest(self) -> Manifest:
        """Describe the kernels."""
        return self.subject.manifest

    @property
    def parameters(self) -> Mapping[str, float]:
        """Return the parameters' values."""
        return self.subject.kernels.parameters

    def with_parameters(self, **parameters: float) -> Traced:
        """Return the same. Raises ValueError for values."""
        if parameters:
            raise ValueError("a traced mechanism keeps its parameters")
        return self

    def describe(self, name: str) -> Kernel:
        """Describe a kernel."""
        return self.subject.kernels.describe(name)

    def __call__(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, Array]:
        """Evaluate a kernel in C."""
        return self.subject.kernels(name, sparse=sparse, **inputs)

    def casadi(self, name: str, *, design: bool = False) -> ca.Function:
        """Return a kernel in symbols."""
        del design
        return trace(load_equations(self.subject), self.describe(name))

    def find_family(self, name: str) -> Traced:
        """Return this: symbols have all derivatives."""
        del name
        return self


def load_traced(path: Path) -> Plant:
    """Load a mechanism with its kernels as symbols."""
    return Traced(Subject(path, Extent(targets=("python",))))


def state(problem: Problem, plant: Plant) -> Nonlinear:
    """Write a problem's program in symbols."""
    solver = Solver(problem, plant)
    transcription, data = solver.transcription, solver.program.data
    balanced = replace(data, A=balance(data.A, transcription.layout))
    rest = find_rest(problem, balanced, transcription.layout)
    even = write_program(problem, solver, balanced)
    if rest is not None:
        return drop_limits(drop_implied(even), rest)
    freed = drop_between(even, transcription, data)
    return drop_implied(write_program(problem, solver, data) if freed is even else freed)


def write_program(problem: Problem, solver: Solver, data: Program) -> Nonlinear:
    """Write a program in symbols, with the bounds of the problem."""
    transcription, functions = solver.transcription, replace(solver.program, data=data).casadi
    p, scale = transcription.parameters(problem), 1 / max(map(abs, problem.cost.weights))
    symbols = ca.MX.sym("x", functions.variables)
    objective = ca.Function("f", [symbols], [scale * functions.objective(symbols, p)])
    constraint = ca.Function("g", [symbols], [functions.constraint(symbols, p)])
    bounds = (*transcription.variable_bounds(problem), *transcription.constraint_bounds(problem))
    return Nonlinear(objective, constraint, *bounds)


def find_start(problem: Problem, plant: Plant) -> Array:
    """Return the optimum that `mbs` finds. Raises ArithmeticError where it finds none."""
    found = solve(problem, plant)
    if not isinstance(found, Solution):
        raise ArithmeticError(f"{problem.name} is not solved")
    return Solver(problem, plant).transcription.pack(found.trajectory)


def read(path: Path) -> tuple[Problem, Plant]:
    """Read a problem file."""
    return read_problem(path, load_traced, NO_MECHANISM)


def drop_implied(program: Nonlinear) -> Nonlinear:
    """Take the bounds from x_j where a row says x_i = x_j, and x_i has the same bounds."""
    x = ca.SX.sym("x", len(program.lower))
    jacobian = ca.jacobian(program.constraint.expand()(x), x).T
    starts, places = jacobian.sparsity().colind(), jacobian.sparsity().row()
    values: list[Any] = jacobian.nonzeros()
    lower, upper = program.lower.copy(), program.upper.copy()
    for k in np.flatnonzero((np.diff(starts) == 2) & (program.g_lower == 0) & (program.g_upper == 0)):
        a, b = values[starts[k] : starts[k + 1]]
        i, j = places[starts[k] : starts[k + 1]]
        same = lower[i] == lower[j] and upper[i] == upper[j] and lower[j] < upper[j]
        if same and a.is_constant() and b.is_constant() and float(a) == -float(b):
            lower[j], upper[j] = -np.inf, np.inf
    return replace(program, lower=lower, upper=upper)


def find_point(program: Nonlinear, start: Array) -> Point:
    """Return a point near the optimum with its multipliers, by IPOPT; what holds it has the larger multiplier."""
    x = ca.MX.sym("x", len(start))
    nlp = {"x": x, "f": program.objective(x), "g": program.constraint(x)}
    options: dict[str, Any] = {"ipopt": EXACT, "print_time": False}
    solver = ca.nlpsol("exact", "ipopt", nlp, options)
    bounds = {"lbx": program.lower, "ubx": program.upper, "lbg": program.g_lower, "ubg": program.g_upper}
    answer: dict[str, Any] = solver(x0=start, **bounds)
    found, g, lam_x, lam = (answer[name].full().ravel() for name in ("x", "g", "lam_x", "lam_g"))
    held = _hold(found, lam_x, program.lower, program.upper)
    rows = _hold(g, lam, program.g_lower, program.g_upper)
    found = np.where(held < 0, program.lower, np.where(held > 0, program.upper, found))
    return Point(found, np.where(rows == 0, 0.0, lam), held, rows)


def _hold(values: Array, multipliers: Array, lower: Array, upper: Array) -> Signs:
    """Return which bounds hold: their multiplier is larger than the distance."""
    below, above = -multipliers > values - lower, multipliers > upper - values
    signs = np.where(below, -1, np.where(above, 1, 0))
    return np.where(lower == upper, 1, signs).astype(np.int8)
