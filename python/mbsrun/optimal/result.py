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

from mbsgen.documents import abbreviate, nearest
from mbsgen.errors import MbsError
from mbsgen.expressions import evaluate, parse
from mbsgen.expressions import names as names_of
from mbsrun.jets import Jet, make_jets
from mbsrun.ocp.design import equip
from mbsrun.ocp.phases.solution import PhasedFailure
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.solution import Failure, Margin, Solution, write_solution
from mbsrun.ocp.summary import list_shortcomings, summarise
from mbsrun.ocp.table import list_additions, list_forces, list_motion, list_wrenches, write_table
from mbsrun.ocp.trajectory import Trajectory
from mbsrun.optimal import display
from mbsrun.optimal.display import Page, Picture
from mbsrun.quantities import Quantity, list_quantities

Array = NDArray[np.float64]

_NO_DERIVATIVES = (np.zeros(0), np.zeros((0, 0)))
_ADDED = ("states", "controls")  # as `list_additions` lists them
_NUMBERS = ("T", "unknowns")  # kinds that do not change along a motion
_KINDS = ("t", "q", "qd", "qdd", "u")  # as `list_motion` lists them


class UnknownNameError(MbsError, KeyError):
    """A name that no quantity has."""

    def __str__(self) -> str:
        return str(self.args[0])


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
    problem's own states and controls; `unknowns` holds the numbers that the solver chose. `t`, `q`, `qd`, `qdd` and `u`
    are whole arrays, (rows,) or (rows, size), unless the problem has these names. At a mesh point, accelerations and
    inputs belong to the interval that begins there.
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
        """List the names of all quantities."""
        return tuple(name for name, quantity in self._quantities.items() if quantity.kind not in _NUMBERS)

    def __getitem__(self, name: str) -> Array:
        """Return a quantity at all rows. Raises UnknownNameError."""
        quantity = self._quantities.get(name)
        if quantity is None and name in _KINDS:
            return self._motion[name]
        if quantity is None or quantity.kind in _NUMBERS:
            raise self._refuse(name)
        return np.asarray(self._whole(quantity.kind)[:, quantity.index])

    def __contains__(self, name: object) -> bool:
        return name in _KINDS or name in self.names

    def evaluate(self, expression: str) -> Array:
        """Compute an expression of quantities and constants, as in a problem, at all rows.

        Raises UnknownNameError for a name, ExpressionError for a text that is no expression.
        """
        tree = parse(expression)
        values = {name: np.array(value) for name, value in self.solution.problem.constants}
        values |= {name: np.array(value) for name, value in self.unknowns.items()} | {"T": np.array(self.horizon)}
        values |= {name: self[name] for name in sorted(names_of(tree) - set(values))}
        found = evaluate(tree, {name: Jet(x, *_NO_DERIVATIVES) for name, x in values.items()}, make_jets(0))
        return np.broadcast_to(found.f, self.t.shape).copy()

    def to_frame(self) -> Any:
        """Return all quantities as a pandas frame, indexed by time. Raises MissingPackageError without pandas."""
        pandas = import_pandas()
        columns = {name: self[name] for name in self.names if name != "t"}
        return pandas.DataFrame(columns, index=pandas.Index(self.t, name="t"))

    def to_csv(self, path: str | Path) -> None:
        """Write the table that `mbsrun solve` writes: a row for each point, names and units on top."""
        write_table(self.solution, self.plant, Path(path))

    def save(self, path: str | Path) -> None:
        """Write the file that `OptimalControl.load` and `mbsrun solve --guess` read."""
        write_solution(self.solution, Path(path))

    def plot(self, *names: str) -> Picture:
        """Plot coordinates, velocities and inputs over time; or the quantities that are named, in one picture."""
        from mbsrun.ocp import pictures

        if not names:
            return Picture(pictures.make_trajectories(self.solution, self.plant.manifest))
        return Picture(pictures.plot_curves(self.t, {name: self[name] for name in names}))

    def draw(self) -> Picture:
        """Draw the mechanism on its way."""
        from mbsrun.ocp import pictures

        return Picture(pictures.make_mechanism(self.solution, self.plant))

    def animate(self) -> Page:
        """Return a page that plays the motion."""
        from mbsrun.ocp import pictures

        return Page(pictures.make_animation(self.solution, self.plant))

    def __repr__(self) -> str:
        return "\n".join([display.write_text("solved", summarise(self.solution)), *self.shortcomings])

    def _repr_html_(self) -> str:
        return display.write_table("solved", summarise(self.solution), tuple(self.shortcomings))

    @cached_property
    def _quantities(self) -> dict[str, Quantity]:
        known = list_quantities(self.plant.manifest, self.solution.problem.added)
        return {name: x for name, x in known.items() if x.kind != "w" or self.trajectory.point_w.size}

    @cached_property
    def _motion(self) -> dict[str, Array]:
        found = dict(zip(_KINDS, list_motion(self.trajectory), strict=True))
        return found | {"t": found["t"][:, 0]}

    def _whole(self, kind: str) -> Array:
        """Return all entries of a kind, (rows, size)."""
        if kind == "t":
            return self._motion["t"][:, None]
        if kind == "w":
            return list_wrenches(self.trajectory)
        if kind == "tau" and self.solution.driving is not None:
            return list_forces(self.trajectory, self.solution.driving)
        if kind in _ADDED:
            return list_additions(self.trajectory)[_ADDED.index(kind)]
        return self._motion[kind] if kind in self._motion else self._of_sensors[kind]

    @cached_property
    def _of_sensors(self) -> dict[str, Array]:
        q, qd = self._motion["q"], self._motion["qd"]
        plant = equip(self.plant, self.solution.problem, self.trajectory.unknowns)
        positions, velocities = plant("sensors", q=q)["position"], plant("motion", q=q, qd=qd)["v"]
        return {"position": _flatten(positions), "v": _flatten(velocities)}

    def _refuse(self, name: str) -> UnknownNameError:
        known = [*_KINDS, *self.names]
        meant = nearest(name, known)
        remedy = f"did you mean {meant}?" if meant else f"there are {', '.join(known)}"
        return UnknownNameError(f"the solution has no quantity {abbreviate(name)}; {remedy}")


@dataclass(frozen=True, eq=False, repr=False)
class Unsolved:
    """A solve that found no solution, and why."""

    failure: Failure | PhasedFailure
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


def _flatten(values: Array) -> Array:
    """Return matrices (rows, 3, sensors) as vectors, sensor by sensor."""
    return values.swapaxes(1, 2).reshape(len(values), -1) if values.ndim == 3 else values
