"""Problems as values: horizon, grid, cost, bounds, phases, and additions to the mechanism."""

from mbsrun.ocp.problem.problem import Bounds, Problem

__all__ = ["Bounds", "Problem"]
