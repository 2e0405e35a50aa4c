"""Judge the answer of a search independently, and ask another method where it has none.

The judge (`optimality`) evaluates the program anew, by NumPy, at the answer of any method. It replaces a status that
calls a point solved although its cost can still fall, or its constraints are violated. Where the project's own method
has no answer, IPOPT is asked, unless the problem's options say otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
from scipy import sparse

from mbsrun.ocp.evaluation.backends.numpy import NumpyProgram
from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.program import Matrix
from mbsrun.ocp.ground.status import ACCEPTABLE, ELSEWHERE, JUMPED, NOT_FEASIBLE, NOT_OPTIMAL, SOLVED, STALLED, explain
from mbsrun.ocp.methods import Instance, Near
from mbsrun.ocp.problem.problem import SolverOptions
from mbsrun.ocp.solution.solution import Run
from mbsrun.ocp.solving.optimality import Judgement, judge, linearise

OWN, OTHER = "mbs", "ipopt"
FINAL = (  # ends of a search after which no other method is asked: it had an answer, or the time was over
    SOLVED,
    ACCEPTABLE,
    JUMPED,
    ELSEWHERE,
    "Maximum_CpuTime_Exceeded",
    "Maximum_WallTime_Exceeded",
)
FLAT = 1e-12  # entries of second derivatives, over the largest, that are 0
SEED = 0


@dataclass(frozen=True, eq=False)
class Outcome:
    """The end of a search."""

    run: Run
    x: Array
    clash: tuple[int, ...]  # rows that stay violated
    multipliers: Array | None  # of the rows, where the method returns them
    start: Instance  # the numbers of the program
    near: Near | None = None  # for solves of problems nearby, where the method can start so


def appeal(program: Prepared, outcome: Outcome, solver: SolverOptions, weight: float) -> Outcome:
    """Return an outcome without more digits as acceptable where the judge finds it optimal.

    Where constraints leave hardly any room, multipliers grow without end, and no method meets conditions on them.
    """
    if outcome.run.status != STALLED or not np.isfinite(outcome.x).all():
        return outcome
    found = _judge(program, outcome, solver.tolerance, weight)
    if found is None or not (found.is_feasible and found.is_optimal):
        return outcome
    return replace(outcome, run=replace(outcome.run, status=ACCEPTABLE))


def examine(
    program: Prepared, outcome: Outcome, solver: SolverOptions, weight: float, g: Array | None = None
) -> tuple[Run, str]:
    """Judge an answer; return its run with the findings, and why it is refused, or nothing. Its rows g may be known."""
    run, found = outcome.run, _judge(program, outcome, solver.tolerance, weight, g)
    if found is None:
        return run, ""
    if not found.is_feasible:
        cause = f"by {found.violation:.1e} of the sizes of their terms, where {found.allowed_violation:.0e} is allowed"
        return replace(run, status=NOT_FEASIBLE), cause
    if not found.is_sure:
        return run, ""
    run = replace(run, decrease=found.decrease, reach=found.reach)
    if not found.is_optimal:
        allowed = found.allowed / found.reach
        limit = f"{allowed:.0e} is the limit"
        cause = f"to first order by {found.ratio:.1e} of the decrease that its gradient alone permits; {limit}"
        return replace(run, status=NOT_OPTIMAL), cause
    return (replace(run, gap=found.decrease) if _is_convex(program, outcome) else run), ""


def _judge(
    program: Prepared, outcome: Outcome, tolerance: float, weight: float, g: Array | None = None
) -> Judgement | None:
    """Judge a point; None where its functions have no numbers."""
    start, x, functions = outcome.start, outcome.x, program.numpy
    p = start.parameters
    c, J, g = functions.gradient(x, p), functions.jacobian(x, p), functions.constraint(x, p) if g is None else g
    if not all(np.isfinite(part).all() for part in (c, J.data, g)):
        return None
    scales = 1.0 if start.scales is None else start.scales
    point = linearise(x, g, c, J, (start.lower, start.upper), (start.g_lower, start.g_upper), scales)
    return judge(point, tolerance, weight / start.cost_scale, outcome.multipliers)


def _is_convex(program: Prepared, outcome: Outcome) -> bool:
    """Return whether rows are linear and the cost is a convex quadratic function, as three random points show."""
    functions = program.numpy
    if not isinstance(functions, NumpyProgram) or functions.has_curved_rows:
        return False
    rng = np.random.default_rng(SEED)
    rows, x, p = np.zeros(program.data.constraints), outcome.x, outcome.start.parameters
    H = functions.hessian(x, p, 1.0, rows)
    largest = float(np.abs(H.data).max(initial=0.0))
    for _ in range(2):
        other = functions.hessian(x + rng.standard_normal(x.size), p, 1.0, rows)
        if not np.isfinite(other.data).all() or np.abs((other - H).data).max(initial=0.0) > FLAT * largest:
            return False
    return _is_semidefinite(Matrix(H + sparse.triu(H, 1).T), largest)


def _is_semidefinite(H: Matrix, largest: float) -> bool:
    """Return whether no pivot of a symmetric matrix is negative; blocks that do not touch are taken apart."""
    from scipy.sparse.csgraph import connected_components  # here, and late: it takes long to load

    _, labels = connected_components(H, directed=False)
    order = np.argsort(labels, kind="stable")
    sorted_labels = labels[order]
    for block in np.split(order, np.flatnonzero(np.diff(sorted_labels)) + 1):
        part = H.tocsr()[block].tocsc()[:, block].toarray()
        if np.linalg.eigvalsh(part).min(initial=0.0) < -FLAT * largest:
            return False
    return True


def wants_other(solver: SolverOptions, run: Run) -> bool:
    """Return whether IPOPT is asked after a run."""
    return solver.falls_back and run.method == OWN and run.status not in FINAL


class Ended(Protocol):
    """The end of a search: a solution or a failure."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def run(self) -> Run:
        """Return the run."""


class Failed(Ended, Protocol):
    """A search without an answer."""

    @property
    def finding(self) -> str:
        """Return what is wrong."""

    @property
    def place(self) -> str:
        """Return the part of the problem that is at fault, where one is known."""


F = TypeVar("F", bound=Failed)
S = TypeVar("S", bound=Ended)


def tell_both(first: F, other: S) -> F | S:
    """Return what another method found, with a sentence on the first one; or the first failure, where it failed too."""
    if type(other) is type(first):
        finding, _ = explain(other.run.status, other.run.iterations)
        if first.place and getattr(other, "place", "") == first.place:  # both fail at one expression
            return replace(first, finding=f"{first.finding}; {OTHER}, asked next, had no answer either")
        return replace(first, finding=f"{first.finding}; {OTHER}, asked next, had no answer either ({finding})")
    told = f"{first.run.method} had no answer ({first.finding}); this one is of {OTHER}"
    return replace(other, run=replace(other.run, instead=told))
