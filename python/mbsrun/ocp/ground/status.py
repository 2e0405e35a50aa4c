"""How a solve can end, and how a failure is explained: finding and remedy by status."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

SOLVED = "Solve_Succeeded"
ACCEPTABLE = "Solved_To_Acceptable_Level"
STALLED = "Search_Direction_Becomes_Too_Small"  # no more progress in double precision
UNREACHABLE = "Target_Out_Of_Reach"  # these four without a call of the solver
BAD_BOUNDS = "Bad_Bounds"
BAD_GUESS = "Bad_Guess"
BAD_PROBLEM = "Bad_Problem"  # a case of many: with its numbers the problem has faults
INFEASIBLE = ("Infeasible_Problem_Detected", "Restoration_Failed")  # the solver's words where constraints clash
OVERDETERMINED = "Not_Enough_Degrees_Of_Freedom"
INVALID = "Invalid_Number_Detected"  # the solver's word, or ours where it found a point at which kernels fail
OPEN = "Loops_Open"  # the solver's word is good, but loops are not closed
JUMPED = "Loops_Jumped"  # the same, but the loops change their branch between two points
NOT_OPTIMAL = "Not_Optimal"  # the same, but the judge finds that the cost can still fall
NOT_FEASIBLE = "Not_Feasible"  # the same, but constraints are violated
ELSEWHERE = "Loops_Elsewhere"  # the same, but the mechanism may be assembled otherwise than the guess

_UNKNOWN = ("the solver ended with {status} after {iterations} iterations", "check bounds, horizon and guess")
_NO_NUMBER = (
    "an expression of the problem has a value or a derivative that is not finite",
    "check the guess and the bounds for values at which expressions have no derivative",
)
_REASONS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "Infeasible_Problem_Detected": (
            "the search ended where the constraints contradict each other",
            "check target, bounds and horizon",
        ),
        "Maximum_Iterations_Exceeded": (
            "the search was not over after {iterations} iterations",
            "raise solver.max_iterations, or check bounds and horizon",
        ),
        INVALID: (
            "a kernel failed, or returned a number that is not finite",
            "check the start and the bounds for poses that the model cannot take",
        ),
        OVERDETERMINED: (
            "the problem has more constraints than the inputs can meet",
            "drop a constraint, or take more intervals",
        ),
        "NonIpopt_Exception_Thrown": ("the search was interrupted", "let it run to its end"),
        STALLED: (
            "the search makes no more progress in double precision after {iterations} iterations",
            "try another guess, or a larger solver.tolerance",
        ),
        "Diverging_Iterates": (
            "the iterates diverge: the cost seems to have no lower bound",
            "bound what can grow, or give the cost a term that grows with it",
        ),
        "Restoration_Failed": (
            "the search could not come closer to meeting the constraints after {iterations} iterations",
            "try another guess, or check target, bounds and horizon",
        ),
        OPEN: (
            "the solver stopped where loops stay open",
            "take a smaller solver.tolerance, another guess, or loops: multipliers",
        ),
        JUMPED: (
            "the points found lie on two branches of the loops, and no motion leads from one to the other in this form",
            "take loops: multipliers",
        ),
        NOT_OPTIMAL: (
            "the method called it solved after {iterations} iterations, but small changes that keep all constraints "
            "lower the cost",
            "try another guess or another solver.method",
        ),
        NOT_FEASIBLE: (
            "the method called it solved after {iterations} iterations, but constraints are violated",
            "try another guess or another solver.method",
        ),
        ELSEWHERE: (
            "with the unknowns found, the mechanism may be assembled otherwise than it is guessed",
            "guess the unknowns nearer to their best values, or narrow their ranges",
        ),
        "Maximum_CpuTime_Exceeded": (
            "the search was not over in its time",
            "raise its limit, or drop it",
        ),
        "Maximum_WallTime_Exceeded": (
            "the search was not over in its time",
            "raise its limit, or drop it",
        ),
    }
)


class NoNumbersError(ValueError):
    """The functions of a program have no numbers at a point: a kernel fails, or Newton's method does not end."""


def explain(status: str, iterations: int, *, has_model: bool = True) -> tuple[str, str]:
    """Return what a failure means, and what to do."""
    finding, remedy = _REASONS.get(status, _UNKNOWN)
    if status == INVALID and not has_model:
        finding, remedy = _NO_NUMBER
    return finding.format(status=status, iterations=iterations), remedy
