"""How an optimum may move, in words: each status with its sentence."""

from __future__ import annotations

from collections.abc import Mapping

SMOOTH = "Differentiable"
NOT_CONVERGED = "Not_Converged"
DEPENDENT = "Dependent_Constraints"
FLAT = "No_Strict_Minimum"
CHANGING = "Active_Set_Changes"
SPLIT = "Equality_Splits"
STUCK = "Condition_Cannot_Follow"

SENTENCES: Mapping[str, str] = {
    SMOOTH: "the optimum has derivatives",
    NOT_CONVERGED: "the solution is no optimum to enough digits; solve to a smaller tolerance",
    DEPENDENT: "equations depend on each other, so their multipliers are not unique; leave one of them out",
    FLAT: "the second-order condition fails: the cost does not grow in every direction that the constraints permit; "
    "add a cost for the open ones",
    CHANGING: "a bound or constraint is about to become active or inactive; ask for one-sided derivatives",
    SPLIT: "the number moves one limit of an equality, or one of two equal bounds; move both",
    STUCK: "the number moves a condition that nothing in the motion can follow; ask for another number",
}
