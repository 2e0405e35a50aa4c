"""The structure of a problem: everything that shapes its program; problems with equal structures share one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mbsrun.ocp.ground.grid import Grid
from mbsrun.ocp.ground.memory import Memory
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Contact, Course, Form, Loops, Problem, Range, Representation, Symbolic
from mbsrun.quantities import Added
from mbsrun.recordings.references import Reference


@dataclass(frozen=True)
class Structure:
    """The parts of a problem that shape its program: not start, targets, bounds, weights and constants."""

    horizon: float | None  # None where it is free
    intervals: int
    family: Family
    degree: int
    representation: Representation
    form: Form
    integrator: str
    steps: int
    bounded: tuple[int, ...]  # indices into (q, qd) of states whose bounds are constraints: where points have no states
    start_is_free: bool
    running: tuple[str, ...]  # expressions
    terminal: tuple[str, ...]
    constraints: tuple[tuple[str, str], ...]  # expression, where it holds
    labels: tuple[str, ...]  # of the constraints
    constants: tuple[str, ...]
    sensors: tuple[str, ...]
    coordinates: tuple[int, ...]
    velocity_zero: bool
    acceleration_zero: bool
    velocities: tuple[int, ...]
    accelerations: tuple[int, ...]
    sensor_velocities: tuple[str, ...]
    references: tuple[Reference, ...] = ()
    functions: tuple[Symbolic, ...] = ()
    loops: Loops | None = None
    mesh: tuple[float, ...] | None = None  # fractions of the horizon; None: intervals are equal
    parameters: tuple[tuple[str, float], ...] = ()  # of the model, which kernels read
    known_velocities: tuple[int, ...] = ()  # indices into qd of velocities with bounds or a given start, when reduced
    added: Added = field(default_factory=Added)
    rates: tuple[str, ...] = ()  # of the states that the problem adds
    ending: tuple[int, ...] = ()  # of them, the ones with a condition at the end
    starting: tuple[int, ...] = ()  # of them, the ones that are free at the start, or have a range there
    forces: tuple[tuple[int, str], ...] = ()  # inputs that expressions give, in order
    wrenches: tuple[tuple[str, int, str | None], ...] = ()  # components of open wrenches: name, number, expression
    driven: tuple[str, ...] = ()  # the motions of driven joints, in the order of the joints
    contacts: tuple[Contact, ...] = ()
    contacts_hold_at_start: bool = True
    inputs: Course = "constant"
    rated_inputs: tuple[int, ...] = ()  # whose rates have bounds
    rated_controls: tuple[int, ...] = ()
    priced_controls: tuple[int, ...] = ()  # whose rates have a weight
    steady: tuple[int, ...] = ()  # controls that are constant over each interval, though inputs are polynomials
    implicit: tuple[tuple[int, int], ...] = ()  # a constraint, and the control that it determines at each point

    @property
    def grid(self) -> Grid:
        """Return the intervals of the horizon."""
        return Grid(self.intervals, self.mesh)

    @property
    def takes_slopes(self) -> bool:
        """Return whether derivatives of states take the place of accelerations, without regard to quaternions."""
        is_curved = self.horizon is None or (self.form is Form.SHOOTING and self.mesh is not None)
        return (self.form is not Form.STANDARD and is_curved) or (
            self.form is Form.INTEGRAL and self.representation.is_ode
        )

    @property
    def expressions(self) -> tuple[str, ...]:
        """List all expressions of the motion."""
        given = (*(text for _, text in self.forces), *(text for *_, text in self.wrenches if text is not None))
        return (*self.running, *self.terminal, *(text for text, _ in self.constraints), *self.rates, *given)


def structure(problem: Problem) -> Structure:
    """Return the structure of a problem, found once."""
    return _STRUCTURES.find(lambda: _find_structure(problem), problem)


_STRUCTURES: Memory[Structure] = Memory()


def _find_structure(problem: Problem) -> Structure:
    cost, end = problem.cost, problem.end
    states = problem.bounds.q + problem.bounds.qd
    bounded = [i for i, bounds in enumerate(states) if np.isfinite(bounds).any()]
    return Structure(
        horizon=problem.horizon if problem.is_timed else None,
        intervals=problem.intervals,
        family=problem.family,
        degree=problem.degree,
        representation=problem.representation,
        form=problem.form,
        integrator=problem.integrator,
        steps=problem.steps,
        bounded=() if problem.form is Form.STANDARD else tuple(bounded),
        start_is_free=bool(problem.free_start),
        running=tuple(term.expression for term in cost.running),
        terminal=tuple(term.expression for term in cost.terminal),
        constraints=tuple((constraint.expression, constraint.at) for constraint in problem.constraints),
        labels=tuple(constraint.label for constraint in problem.constraints),
        implicit=tuple(
            (i, problem.added.controls.index(constraint.gives))
            for i, constraint in enumerate(problem.constraints)
            if constraint.gives
        ),
        constants=tuple(name for name, _ in problem.constants),
        sensors=tuple(name for name, _ in end.sensors),
        coordinates=tuple(i for i, _ in end.coordinates),
        velocity_zero=end.velocity_zero,
        acceleration_zero=end.acceleration_zero,
        velocities=tuple(i for i, _ in end.velocities),
        accelerations=tuple(i for i, _ in end.accelerations),
        sensor_velocities=tuple(name for name, _ in end.sensor_velocities),
        references=problem.references,
        functions=problem.functions,
        loops=problem.loops,
        mesh=problem.mesh,
        parameters=problem.parameters,
        inputs=problem.inputs,
        rated_inputs=tuple(list_bounded(problem.bounds.rates)),
        rated_controls=tuple(list_bounded([control.rates for control in problem.controls])),
        steady=tuple(i for i, control in enumerate(problem.controls) if control.is_steady),
        priced_controls=tuple(problem.added.controls.index(name) for name, _ in cost.control_rates),
        known_velocities=_list_known_velocities(problem) if problem.loops is Loops.REDUCED else (),
        added=problem.added,
        rates=tuple(state.rate for state in problem.every_state),
        contacts=problem.contacts,
        contacts_hold_at_start=problem.contacts_hold_at_start,
        forces=tuple(sorted((force.input, force.expression) for force in problem.forces)),
        driven=tuple(drive.expression for drive in sorted(problem.driven, key=lambda drive: drive.joint)),
        wrenches=tuple((part.wrench, part.component, part.expression) for part in problem.every_component),
        ending=tuple(i for i, state in enumerate(problem.every_state) if np.isfinite(state.end).any()),
        starting=tuple(i for i, state in enumerate(problem.every_state) if state.start[0] != state.start[1]),
    )


def list_bounded(ranges: Sequence[Range]) -> list[int]:
    """List the indices of ranges that have a bound."""
    return [i for i, limits in enumerate(ranges) if np.isfinite(limits).any()]


def _list_known_velocities(problem: Problem) -> tuple[int, ...]:
    """List the velocities that have bounds, or a value at a start that is free otherwise."""
    free = {i - len(problem.start_q) for i in problem.free_start}
    return tuple(
        i
        for i, bounds in enumerate(problem.bounds.qd)
        if np.isfinite(bounds).any() or (problem.free_start and i not in free)
    )
