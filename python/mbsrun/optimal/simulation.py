"""A simulation in Python: the keys of a settings file, as values and names; a motion with tables, pictures, pages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.errors import InputError
from mbsrun.animation import render_animation
from mbsrun.external import Mechanism, load
from mbsrun.models import INTEGRATED
from mbsrun.optimal import display
from mbsrun.optimal.display import Page, Picture
from mbsrun.optimal.plain import make_plain
from mbsrun.optimal.result import import_pandas
from mbsrun.quaternions import find_rates
from mbsrun.simulation.closing import close_start
from mbsrun.simulation.drive import control
from mbsrun.simulation.motion import Motion
from mbsrun.simulation.simulate import simulate as integrate
from mbsrun.simulation.statement import Statement, read_statement

Array = NDArray[np.float64]

Law = Callable[[float, Array, Array], ArrayLike]  # t, q, qd -> the inputs


@dataclass(frozen=True, eq=False, repr=False)
class Simulated(Motion):
    """A simulated motion with its mechanism: what `Motion` has, as tables, pictures and pages.

    Names are the same as in expressions: `q_NAME`, `qd_NAME`, `u_NAME`, `x_SENSOR`; numbers that follow from the motion
    are among `results`. Where the end was not reached, `halt` says why, and the motion is the part before.
    """

    mechanism: Mechanism = field(kw_only=True)
    note: str = ""  # what was changed to close loops at the start

    @property
    def shortcomings(self) -> list[str]:
        """List why the motion ended early, and its warnings; none of a good one."""
        halt = [] if self.halt is None else [f"{self.halt}; the motion is incomplete"]
        return [*halt, *(f"warning: {warning}" for warning in self.warnings)]

    def to_frame(self, *more: str) -> Any:
        """Return all quantities as a pandas frame, indexed by time; `more` are names or patterns of `results`.

        Raises MissingPackageError without pandas, UnknownNameError.
        """
        pandas = import_pandas()
        columns = {name: self[name] for name in (*self.names, *self.numbers.select(more)) if name != "t"}
        return pandas.DataFrame(columns, index=pandas.Index(self.t, name="t"))

    def save(self, folder: str | Path, *more: str) -> None:
        """Write the folder that `mbsrun simulate` writes; `more` are further columns of its table.

        Raises UnknownNameError.
        """
        from mbsrun.simulation.record import write_motion

        write_motion(self, self.mechanism, Path(folder), more)

    def plot(self, *names: str) -> Picture:
        """Plot coordinates, velocities, inputs and energies; or the numbers that are named, one panel for each unit.

        Names may be patterns, such as `tension_*`. Raises UnknownNameError.
        """
        if not names:
            from mbsrun.simulation.record import draw_motion

            return Picture(draw_motion(self, self.mechanism.manifest))
        from mbsrun.ocp.showing.pictures import plot_curves

        curves = [(name, self.unit(name), self[name]) for name in self.numbers.select(names)]
        return Picture(plot_curves(self.t, curves))

    def animate(self) -> Page:
        """Return a page that plays the motion."""
        rates = find_rates(self.mechanism, self.q, self.qd)
        return Page(render_animation(self.mechanism, self.t, self.q, qd=rates, inputs=self.inputs))

    def __repr__(self) -> str:
        return "\n".join([display.write_text("simulated", self._rows), *self.shortcomings])

    def _repr_html_(self) -> str:
        return display.write_table("simulated", self._rows, tuple(self.shortcomings))

    @property
    def _rows(self) -> dict[str, str]:
        effort = self.effort
        rows = {
            "model": self.mechanism.manifest.model,
            "time": f"{self.t[-1]:.6g} s, {len(self.t)} states",
            "method": f"{self.settings.method}, {effort.steps} steps, {effort.evaluations} evaluations",
        }
        if self.energy is not None:
            rows["energy drift"] = f"{np.abs(self.energy.drift).max():.2g} J at most"
        if self.events:
            rows["events"] = str(len(self.events))
        return rows | ({"note": self.note} if self.note else {})


def simulate(
    model: str | Path | Mechanism,
    *,
    inputs: Mapping[str, Any] | Law | None = None,
    watch: Callable[[float], None] = lambda _: None,
    **keys: Any,
) -> Simulated:
    """Integrate the motion of a model: a model file, a generated folder, or loaded kernels.

    It takes the keys of a settings file of `mbsrun simulate`: `duration` [s], `start` with `pose` and `velocity` by
    name, `inputs` by name as numbers or expressions of the time and the state, `method`, tolerances, and more. `inputs`
    may also be a function of t, q and qd that returns the inputs, then the components of open wrenches, then signals;
    with an `input_period` [s] it is called once in each, in order, and may have a memory. Driven joints stand still
    unless `driven` moves them. `watch` is called with the time that is reached. Raises InputError with every fault,
    OpenError for a start at which loops do not close.
    """
    mechanism = model if isinstance(model, Mechanism) else load(Path(model), extent=INTEGRATED)
    name = mechanism.manifest.model
    data = make_plain(name, keys if inputs is None or callable(inputs) else {**keys, "inputs": inputs})
    try:
        statement = read_statement(None, data, mechanism.manifest)
    except InputError as error:
        raise InputError([replace(fault, file=f"simulation of {name}") for fault in error.faults]) from None
    if callable(inputs):
        statement = replace(statement, drive=control(inputs, statement.drive.period))
    return _run(mechanism.with_parameters(**statement.parameters), statement, watch)


def _run(mechanism: Mechanism, statement: Statement, watch: Callable[[float], None]) -> Simulated:
    q, qd, note = close_start(mechanism, statement.start, statement.course)
    motion = integrate(mechanism, statement.drive, q, qd, statement.settings, watch, statement.course)
    found = {part.name: getattr(motion, part.name) for part in fields(motion)}
    return Simulated(**found, mechanism=mechanism, note=note)
