"""The outcome of a solve in Python: arrays by name, tables, pictures and files; or the reason why there are none."""

from __future__ import annotations

import importlib
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import MbsError
from mbsgen.expressions import ExpressionError, evaluate, parse
from mbsgen.expressions import names as names_of
from mbsrun.jets import Jet, make_jets
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.showing.summary import list_shortcomings, summarise
from mbsrun.ocp.solution.solution import Failure, Margin, Solution, write_solution
from mbsrun.ocp.solution.table import measure, write_table
from mbsrun.optimal import display
from mbsrun.optimal.display import Page, Picture
from mbsrun.results import Numbers, UnknownNameError

Array = NDArray[np.float64]

_NO_DERIVATIVES = (np.zeros(0), np.zeros((0, 0)))
_KINDS = ("q", "qd", "qdd", "u")  # of which whole arrays have names


class NotSolvedError(MbsError):
    """A number of a motion that was not found."""


class MissingPackageError(MbsError, ImportError):
    """A package that is not installed."""


def import_pandas() -> Any:
    """Import pandas. Raises MissingPackageError."""
    try:
        return importlib.import_module("pandas")
    except ImportError:
        remedy = "run in the folder of the project: pip install '.[notebook]'"
        raise MissingPackageError(f"pandas is not installed; {remedy}") from None


@dataclass(frozen=True, eq=False, repr=False)
class Solved:
    """A solution, with its numbers at all mesh and collocation points by name.

    Names are the same as in expressions: `q_NAME`, `qd_NAME`, `qdd_NAME`, `u_NAME`, `x_SENSOR`, `vx_SENSOR`, and the
    problem's own states and controls; numbers that follow from the motion are among `results`. `unknowns` holds the
    numbers that the solver chose. `q`, `qd`, `qdd` and `u` are whole arrays, (rows, size), unless the problem has these
    names. At a mesh point, accelerations and inputs belong to the interval that begins there.
    """

    solution: Solution
    plant: Plant
    is_solved: bool = field(default=True, init=False)

    @property
    def status(self) -> str:
        """Return the solver's word."""
        return self.solution.run.status

    @property
    def cost(self) -> float:
        """Return the whole cost."""
        return self.solution.cost.total

    @property
    def terms(self) -> MappingProxyType[str, float]:
        """Return the cost by term, weights included."""
        found: dict[str, float] = {}
        for name, value in self.solution.cost.terms:
            found[name] = found.get(name, 0.0) + value
        return MappingProxyType(found)

    @property
    def horizon(self) -> float:
        """Return T."""
        return float(self.solution.trajectory.t[-1])

    @property
    def trajectory(self) -> Trajectory:
        """Return the arrays by mesh and collocation points; a solve takes it as a guess."""
        return self.solution.trajectory

    @property
    def unknowns(self) -> MappingProxyType[str, float]:
        """Return the numbers that the solver chose, by name."""
        names = [unknown.name for unknown in self.solution.problem.unknowns]
        return MappingProxyType(dict(zip(names, self.trajectory.unknowns.tolist(), strict=True)))

    @property
    def defect(self) -> float | None:
        """Return the largest error of an interval, by re-simulation; None where that was left out or gave up."""
        check = self.solution.resimulation
        return None if check is None else check.defect

    @property
    def margins(self) -> tuple[Margin, ...]:
        """Return bounds and constraints at their worst along the re-simulated motion, between the points too.

        Each has a name, a value, a range, a time [s], a violation (negative inside), and the one that is tolerated.
        None are known without a re-simulation.
        """
        check = self.solution.resimulation
        return () if check is None or check.margins is None else check.margins.each

    @property
    def shortcomings(self) -> list[str]:
        """List the shortcomings of the solution; none in a good one."""
        return list_shortcomings(self.solution)

    @property
    def t(self) -> Array:
        """Return the times of all rows."""
        return self["t"]

    @property
    def names(self) -> tuple[str, ...]:
        """List the names of all quantities of expressions."""
        return self._numbers.names

    @property
    def results(self) -> tuple[str, ...]:
        """List the names of the numbers that follow from the motion: energies, tensions, forces in joints, and more."""
        return self._numbers.results

    def __getitem__(self, name: str) -> Array:
        """Return a quantity, or a number that follows from the motion, at all rows. Raises UnknownNameError."""
        if not isinstance(name, str):
            raise UnknownNameError(f"a quantity has a name, such as {self.names[-1]}; found {name!r}")
        if name in _KINDS and name not in self._numbers.names:
            return self._numbers.whole(name)
        return self._numbers[name]

    def __contains__(self, name: object) -> bool:
        return name in _KINDS or name in self._numbers

    def unit(self, name: str) -> str:
        """Return the unit of a number; "" where it has none, or the problem does not say. Raises UnknownNameError."""
        return self._numbers.unit(name)

    def evaluate(self, expression: str) -> Array:
        """Compute an expression of quantities and constants, as in a problem, at all rows.

        Raises UnknownNameError for a name, ExpressionError for a text that is no expression.
        """
        if not isinstance(expression, str):
            raise ExpressionError(f"found a value of type {type(expression).__name__}", "give a text")
        tree = parse(expression)
        values = {name: np.array(value) for name, value in self.solution.problem.constants}
        values |= {name: np.array(value) for name, value in self.unknowns.items()} | {"T": np.array(self.horizon)}
        values |= {name: self[name] for name in sorted(names_of(tree) - set(values))}
        found = evaluate(tree, {name: Jet(x, *_NO_DERIVATIVES) for name, x in values.items()}, make_jets(0))
        return np.broadcast_to(found.f, self.t.shape).copy()

    def to_frame(self, *more: str) -> Any:
        """Return all quantities as a pandas frame, indexed by time; `more` are names or patterns of `results`.

        Raises MissingPackageError without pandas, UnknownNameError.
        """
        pandas = import_pandas()
        columns = {name: self[name] for name in (*self.names, *self._numbers.select(more)) if name != "t"}
        return pandas.DataFrame(columns, index=pandas.Index(self.t, name="t"))

    def to_csv(self, path: str | Path, *more: str) -> None:
        """Write the table that `mbsrun solve` writes: a row for each point, names and units on top.

        `more` are further columns, by names or patterns such as `tension_*`. Raises UnknownNameError.
        """
        write_table(self.solution, self.plant, Path(path), more)

    def save(self, path: str | Path) -> None:
        """Write the file that `OptimalControl.load` and `mbsrun solve --guess` read."""
        write_solution(self.solution, Path(path))

    def plot(self, *names: str) -> Picture:
        """Plot coordinates, velocities and inputs over time; or the numbers that are named, one panel for each unit.

        Names may be patterns, such as `tension_*`. Raises UnknownNameError.
        """
        from mbsrun.ocp.showing import pictures

        if not names:
            return Picture(pictures.make_trajectories(self.solution, self.plant.manifest))
        curves = [(name, self.unit(name), self[name]) for name in self._numbers.select(names)]
        return Picture(pictures.plot_curves(self.t, curves))

    def draw(self) -> Picture:
        """Draw the mechanism on its way."""
        from mbsrun.ocp.showing import pictures

        return Picture(pictures.make_mechanism(self.solution, self.plant))

    def animate(self) -> Page:
        """Return a page that plays the motion."""
        from mbsrun.ocp.showing import pictures

        return Page(pictures.make_animation(self.solution, self.plant))

    def __repr__(self) -> str:
        return "\n".join([display.write_text("solved", summarise(self.solution)), *self.shortcomings])

    def _repr_html_(self) -> str:
        return display.write_table("solved", summarise(self.solution), tuple(self.shortcomings))

    @cached_property
    def _numbers(self) -> Numbers:
        return measure(self.solution, self.plant)


@dataclass(frozen=True, eq=False, repr=False)
class Unsolved:
    """A solve that found no solution, and why."""

    failure: Failure | Failure
    is_solved: bool = field(default=False, init=False)

    @property
    def status(self) -> str:
        """Return the solver's word."""
        return self.failure.run.status

    @property
    def reason(self) -> str:
        """Return the finding and the remedy."""
        return f"{self.failure.finding}; {self.failure.remedy}"

    def __getitem__(self, name: str) -> Array:
        """Raise NotSolvedError: there are no numbers."""
        raise self._refuse()

    def __getattr__(self, name: str) -> Any:
        """Raise NotSolvedError for an attribute that a solution has."""
        if name.startswith("_") or name not in dir(Solved) + list(Solved.__dataclass_fields__):
            raise AttributeError(f"{type(self).__name__} has no attribute {name}")
        raise self._refuse()

    def __repr__(self) -> str:
        return display.write_text("not solved", self._rows)

    def _repr_html_(self) -> str:
        return display.write_table("not solved", self._rows)

    @property
    def _rows(self) -> dict[str, str]:
        run = self.failure.run
        return {
            "problem": self.failure.problem.name,
            "status": f"{run.status}, {run.iterations} iterations",
            "finding": self.failure.finding,
            "remedy": self.failure.remedy,
        }

    def _refuse(self) -> NotSolvedError:
        return NotSolvedError(f"{self.failure.problem.name} was not solved ({self.status}): {self.reason}")
