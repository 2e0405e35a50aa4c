"""Problems that ship, for the project's own method."""

from __future__ import annotations

from dataclasses import replace

from mbsrun.external import OnDemand, load_on_demand
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.statement.statement import read_problem
from tests.mbsrun.ocp.conftest import MODELS


def read(name: str, **changes: object) -> tuple[Problem, OnDemand]:
    """Read a problem that ships, to be solved by the method."""
    problem, plant = read_problem(MODELS / f"{name}.ocp.yaml", load_on_demand)
    assert isinstance(plant, OnDemand)
    return replace(problem, solver=replace(problem.solver, method="mbs"), **changes), plant  # type: ignore[arg-type]
