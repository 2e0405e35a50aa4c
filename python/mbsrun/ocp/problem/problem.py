"""An optimal control problem, as a value; `statement` reads it from a file.

    minimise    k1 * integral of |u|^2  +  k2 * sum over the N - 1 steps of  h |(u_(k+1) - u_k) / h|^2
                + integrals of expressions of the motion + expressions of its end
    subject to  the equations of motion, (q, qd)(0) given, bounds and constraints at all times, and conditions at T

with inputs u that are constant over each of the N intervals of length h = T / N (Docquier, Bruls, Fisette, eqs. 22-27),
or polynomials of degree d - 1 over each, by their values at the d collocation points.
Where lengths of intervals differ, h of the second sum is the distance of the midpoints of both.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, PlainSerializer

from mbsgen.documents import Finding
from mbsgen.expressions import Expression, names, parse
from mbsrun.ocp.ground.grid import Grid
from mbsrun.ocp.ground.integrators import INTEGRATORS, SECOND_ORDER, IntegratorName
from mbsrun.ocp.ground.representations import Loops as Loops
from mbsrun.ocp.ground.representations import Representation as Representation
from mbsrun.ocp.ground.schemes import Family, list_degrees
from mbsrun.quantities import Added
from mbsrun.recordings.references import Reference

SAME_TIME = 1e-9  # of the horizon: a delay that is as near to a mesh point ends there


class Form(Enum):
    """The variables that a motion has within an interval."""

    STANDARD = "standard"  # states and accelerations at the points: direct collocation
    INTEGRAL = "integral"  # accelerations at the points; states there are their integrals
    SHOOTING = "shooting"  # nothing: an integrator takes the state from mesh point to mesh point


# A missing bound: infinite in a program, null in a file.
Lower = Annotated[
    float, BeforeValidator(lambda x: -math.inf if x is None else x), PlainSerializer(lambda x: _finite(x))
]
Upper = Annotated[float, BeforeValidator(lambda x: math.inf if x is None else x), PlainSerializer(lambda x: _finite(x))]
Range = tuple[Lower, Upper]
Point = tuple[float, float, float]
Target = tuple[float | None, float | None, float | None]  # None: free
Inputs = Literal["zero", "static", "dynamic"]  # of a guess
GuessedMotion = Literal["interpolation", "line", "rest"]
Course = Literal["constant", "polynomial"]  # of inputs over an interval
SolverName = str  # a key of methods.METHODS


@dataclass(frozen=True)
class Term:
    """A term of the cost: an expression, as `quantities` reads it, and its weight."""

    expression: str
    weight: float
    name: str = ""  # in summaries; empty: the expression

    @property
    def title(self) -> str:
        """Return the name in summaries."""
        return self.name or self.expression


@dataclass(frozen=True)
class Symbolic:
    """A function in CasADi of numbers of the motion; expressions read its value by its name.

    Files hold no code: what a file says is never run.
    """

    name: str
    reads: tuple[str, ...]  # the names of its arguments, in order
    text: str  # for readers
    code: Annotated[str, BeforeValidator(lambda _: ""), Field(exclude=True)] = ""  # CasADi's serialisation


@dataclass(frozen=True)
class Cost:
    """The weights of the cost, and its other terms."""

    inputs: float = 0.0  # k1
    input_rates: float = 0.0  # k2
    running: tuple[Term, ...] = ()  # integrated over the horizon
    terminal: tuple[Term, ...] = ()  # at its end
    control_rates: tuple[tuple[str, float], ...] = ()  # as k2, of a control: its name and weight

    @property
    def weights(self) -> tuple[float, ...]:
        """Return the weight of every term, in order."""
        terms = (term.weight for term in self.running + self.terminal)
        return (self.inputs, self.input_rates, *terms, *(weight for _, weight in self.control_rates))

    @property
    def names(self) -> tuple[str, ...]:
        """Name every term."""
        terms = (term.title for term in self.running + self.terminal)
        return ("inputs", "input rates", *terms, *(f"rates of {name}" for name, _ in self.control_rates))


@dataclass(frozen=True)
class Bounds:
    """Lower and upper bound of each coordinate, velocity and input at all times; infinite where there is none."""

    q: tuple[Range, ...]
    qd: tuple[Range, ...]
    u: tuple[Range, ...]
    rates: tuple[Range, ...] = ()  # of each constant input: its differences over time; empty where none is bounded
    tau: tuple[Range, ...] = ()  # of the force of each driven joint; empty where none is bounded


Aims = tuple[tuple[int, tuple[float, float, float]], ...]  # axes of a sensor, 0 to 2: directions in the base frame


@dataclass(frozen=True)
class End:
    """The conditions at the end of the horizon."""

    sensors: tuple[tuple[str, Target], ...] = ()  # name, position in the base frame [m]
    coordinates: tuple[tuple[int, float], ...] = ()  # index into q, value
    velocity_zero: bool = False
    acceleration_zero: bool = False
    velocities: tuple[tuple[int, float], ...] = ()  # index into qd, value
    accelerations: tuple[tuple[int, float], ...] = ()  # index into qdd, value
    sensor_velocities: tuple[tuple[str, Target], ...] = ()  # name, velocity in the base frame [m/s]
    orientations: tuple[tuple[str, Aims], ...] = ()  # name, directions of axes; constraints hold the conditions


@dataclass(frozen=True)
class Constraint:
    """An expression, as `quantities` reads it, that stays within a range."""

    expression: str
    range: Range
    at: Literal["start", "path", "end"] = "path"
    is_relaxed: bool = False  # a product of complementary numbers, whose upper bound is lowered in steps
    name: str = ""  # in messages, in place of the expression
    gives: str = ""  # a control that this equation determines at each point, whatever the other ones are

    @property
    def label(self) -> str:
        """Return the constraint's name."""
        return self.name or self.expression


@dataclass(frozen=True)
class State:
    """A state beside the mechanism's, with an ordinary differential equation of first order."""

    name: str
    rate: str  # its time derivative, an expression of the motion
    bounds: Range = (-math.inf, math.inf)
    start: Range = (-math.inf, math.inf)  # equal ends give a value
    end: Range = (-math.inf, math.inf)
    # held, or going straight from the first to the second; None: straight between start and end where both are given,
    # else integrated along the guessed motion
    guess: float | tuple[float, float] | None = None


@dataclass(frozen=True)
class Control:
    """An input beside the mechanism's, constant over each interval; expressions read it by its name."""

    name: str
    bounds: Range = (-math.inf, math.inf)
    guess: float = 0.0
    rates: Range = (-math.inf, math.inf)  # of (c_(k+1) - c_k) / h, where it is constant
    softens: str = ""  # the constraint that it lets be violated, where it is a slack
    bounds_from_above: str = ""  # the term of the cost that it stands for, an absolute value or a maximum
    is_steady: bool = False  # it is constant over each interval, though inputs are polynomials

    @property
    def is_auxiliary(self) -> bool:
        """Return whether nothing but the problem's statement needs it."""
        return bool(self.softens or self.bounds_from_above)


@dataclass(frozen=True)
class Delay:
    """An input that acts later than it is given: until then, it is what was given before the start.

    The problem's input is the one that acts, u(t) = command(t - delay); so the first intervals have known inputs.
    """

    kind: Literal["input", "control"]
    index: int  # into u, or into the controls
    seconds: float
    history: float | None = 0.0  # the command before the start; None: free
    is_linked: bool = False  # whether these are commands of the phase before
    state: int | None = None  # the state that is this input, where it is continuous; `index` is its rate, a control
    commands: tuple[float, ...] = ()  # of each interval before the start, oldest first; empty: all are the history


@dataclass(frozen=True)
class Force:
    """An input u of the mechanism that an expression gives at every point: no unknown of the solver's choice."""

    input: int  # index into u
    expression: str


@dataclass(frozen=True)
class Drive:
    """The motion of a driven joint: its coordinate as an expression of t, T, constants and unknowns."""

    joint: int  # index into qd
    expression: str


@dataclass(frozen=True)
class WrenchComponent:
    """A component of a wrench that the model leaves open: given by an expression, or an unknown at every point."""

    wrench: str  # a name of the model's: of a wrench, or of a signal
    component: int  # 0 to 2: force along x, y, z; 3 to 5: moment; SIGNAL: of a signal, or the time
    expression: str | None = None  # None: an unknown, which constraints determine
    bounds: Range = (-math.inf, math.inf)
    guess: float = 0.0


@dataclass(frozen=True)
class Contact:
    """A point that stands still on the ground for the whole horizon, held by an unknown force."""

    sensor: str  # the point
    wrench: str  # the open wrench whose force, in axes of the base, acts there
    axes: tuple[int, ...] = (0, 1, 2)  # along which it is held
    normal: int | None = 2  # the force along this axis is not negative; None: it may pull
    friction: float | None = None  # the force across is at most this times the normal one; None: no limit
    drag: tuple[int, float] | None = None  # the axis across along which it slides, and the force there over the normal


@dataclass(frozen=True)
class Unknown:
    """A number that the solver chooses, the same over the whole horizon; expressions read it by its name.

    A differentiated parameter of the model with the same name takes its value.
    """

    name: str
    bounds: Range = (-math.inf, math.inf)
    guess: float = 0.0
    softens: str = ""  # the constraint that it lets be violated, where it is a slack
    largest: tuple[str, ...] = ()  # expressions that it bounds along the path; their largest value is its guess


@dataclass(frozen=True)
class Integral:
    """An integral over the horizon that stays within a range."""

    expression: str
    range: Range


@dataclass(frozen=True)
class GuessOptions:
    """The first guess: a motion of the joints, and its inputs."""

    upright: tuple[str, ...] = ()  # frames whose z axis points up in the pose that meets the end's targets
    motion: GuessedMotion = "interpolation"  # smoothly from the start to that pose; evenly; or staying at the start
    inputs: Inputs = "dynamic"  # 0, the forces that hold each pose, or the inverse dynamics of the motion
    solution: str | None = None  # a solution's file to start from instead, beside the problem's
    times: tuple[float | None, float | None] = (None, None)  # the part of a recording [s]; None: its first or last time
    start: tuple[tuple[int, float], ...] = ()  # index into q, guess of a coordinate that is free at the start
    end: tuple[tuple[int, float], ...] = ()  # index into q, guess at the end; given any, no pose is searched


@dataclass(frozen=True)
class Relaxation:
    """The upper bounds of products of complementary numbers, in steps: first, first*factor, ..., last."""

    first: float = 0.1
    last: float = 1e-6
    factor: float = 0.1


@dataclass(frozen=True)
class Refinement:
    """Solves on finer grids, until the re-simulation confirms an accuracy."""

    accuracy: float = 1e-6  # the largest defect of an interval, in rad and m, and these per s
    rounds: int = 8  # solves after the first, at most


@dataclass(frozen=True)
class SolverOptions:
    """The NLP method, and its options."""

    tolerance: float = 1e-8
    max_iterations: int = 500
    objective_scaling: float | None = None  # None: one over the largest weight of the cost
    method: SolverName | None = None  # None: see `methods.choose`
    options: tuple[tuple[str, float | int | str], ...] = ()  # by name, as `methods` admits them
    threads: int = 1  # of a solve
    fallback: bool | None = None  # whether IPOPT solves what `mbs` does not; None: where no method is named

    @property
    def falls_back(self) -> bool:
        """Return whether IPOPT solves what `mbs` does not."""
        return self.method is None if self.fallback is None else self.fallback

    def with_method(self, method: SolverName) -> SolverOptions:
        """Return the same options for a method; another one drops the options of the former one.

        It drops the threads too, except `mbs`, which alone has some.
        """
        if method == self.method:
            return self
        return replace(self, method=method, options=(), threads=self.threads if method == "mbs" else 1)


@dataclass(frozen=True, repr=False)
class Problem:
    """Everything that a solve needs, beside the model."""

    name: str
    horizon: float  # T [s]; where it is free, the guess
    intervals: int  # N
    family: Family
    degree: int
    cost: Cost
    start_q: tuple[float, ...]
    start_qd: tuple[float, ...]
    bounds: Bounds
    end: End
    representation: Representation = Representation.IMPL
    form: Form = Form.STANDARD
    integrator: IntegratorName = "collocation"  # of shooting: the method of the scheme, or the classical one of order 4
    steps: int = 1  # of the integrator in an interval
    horizon_range: Range | None = None  # where the horizon is free: its bounds [s]
    free_start: tuple[
        int, ...
    ] = ()  # indices into (q, qd) of states that are free at the start: their values are a guess
    constraints: tuple[Constraint, ...] = ()
    constants: tuple[tuple[str, float], ...] = ()  # that expressions read
    guess: GuessOptions = field(default_factory=GuessOptions)
    solver: SolverOptions = field(default_factory=SolverOptions)
    loops: Loops | None = None  # None: there are none, or the guess decides
    states: tuple[State, ...] = ()
    controls: tuple[Control, ...] = ()
    forces: tuple[Force, ...] = ()
    wrenches: tuple[WrenchComponent, ...] = ()
    driven: tuple[Drive, ...] = ()  # of every driven joint of the model
    contacts: tuple[Contact, ...] = ()
    touching: tuple[Contact, ...] = ()  # contacts whose times are not given; constraints hold their equations
    relaxation: Relaxation | None = None  # of the constraints of `touching`
    modes: tuple[tuple[str, str], ...] = ()  # of stops, dry friction and rigid contacts; other parts hold their forces
    unknowns: tuple[Unknown, ...] = ()
    integrals: tuple[Integral, ...] = ()
    functions: tuple[Symbolic, ...] = ()  # that expressions read
    inputs: Course = "constant"  # over an interval; polynomial: of degree d - 1, by a value at each point
    delays: tuple[Delay, ...] = ()
    contacts_hold_at_start: bool = True  # where the start is free, and no link gives it: then by separate rows
    parameters: tuple[tuple[str, float], ...] = ()  # values of the model's run-time and differentiated parameters
    mesh: tuple[float, ...] | None = None  # the fraction of the horizon that each interval has; None: they are equal
    references: tuple[Reference, ...] = ()  # that expressions read
    refine: Refinement | None = None  # None: the grid stays
    accuracy: float = 1e-6  # the largest defect of an interval that counts as accurate, in rad and m, and these per s
    first_inputs: tuple[Range, ...] = ()  # further bounds of each constant input in the first interval; empty: none
    first_controls: tuple[Range, ...] = ()  # and of each constant control
    following: tuple[int, ...] = ()  # states of the start that loops give, where differentiated parameters change loops

    def __repr__(self) -> str:
        """Return the name, the horizon and its grid, and the way of writing the equations."""
        horizon = f"{self.horizon:g} s" + ("" if self.is_timed else " (free)")
        ways = f"{self.representation.value}, {self.form.value}, {self.solver.method or 'mbs'}"
        return f"Problem({self.name}: {horizon}, {self.intervals} intervals of degree {self.degree}, {ways})"

    @property
    def is_timed(self) -> bool:
        """Return whether the horizon is given, and none that the solver chooses."""
        return self.horizon_range is None

    @property
    def horizon_limits(self) -> Range:
        """Return the range of the horizon, a point where it is given."""
        return self.horizon_range or (self.horizon, self.horizon)

    def with_duration(self, seconds: float) -> Problem:
        """Return the same problem with a guess of the horizon as near to a duration as its range permits."""
        lower, upper = self.horizon_limits
        return replace(self, horizon=min(max(seconds, lower), upper))

    @property
    def asked_accuracy(self) -> float:
        """Return the largest defect of an interval that counts as accurate."""
        return self.accuracy if self.refine is None else self.refine.accuracy

    @property
    def grid(self) -> Grid:
        """Return the intervals of the horizon."""
        return Grid(self.intervals, self.mesh)

    @cached_property
    def added(self) -> Added:
        """Return the names of everything that expressions read beside the model; integrals have none that they can."""
        integrals = (f"@integral {i}" for i in range(len(self.integrals)))
        return Added(
            states=(*(state.name for state in self.states), *integrals),
            controls=tuple(control.name for control in self.controls),
            unknowns=tuple(unknown.name for unknown in self.unknowns),
        )

    @cached_property
    def every_state(self) -> tuple[State, ...]:
        """Return the states beside the mechanism's; integrals are states that begin at 0."""
        integrals = zip(self.added.states[len(self.states) :], self.integrals, strict=True)
        own = (State(name, part.expression, start=(0.0, 0.0), end=part.range) for name, part in integrals)
        return (*self.states, *own)

    @cached_property
    def every_component(self) -> tuple[WrenchComponent, ...]:
        """Return the components of open wrenches; contacts add the ones of their forces that the problem leaves out."""
        known = {(part.wrench, part.component) for part in self.wrenches}
        normals = {(contact.wrench, contact.normal) for contact in self.contacts}
        added = (
            WrenchComponent(contact.wrench, axis, None if axis in contact.axes else "0")
            for contact in self.contacts
            for axis in range(3)
            if (contact.wrench, axis) not in known
        )
        return tuple(
            replace(part, bounds=(max(0.0, part.bounds[0]), part.bounds[1]))
            if (part.wrench, part.component) in normals
            else part
            for part in (*self.wrenches, *added)
        )

    @property
    def has_quaternions(self) -> bool:
        """Return whether there are more coordinates than velocities."""
        return len(self.start_q) > len(self.start_qd)

    def with_target(self, sensor: str, position: Target) -> Problem:
        """Return the same problem with another target of a sensor that has one."""
        if sensor not in dict(self.end.sensors):
            raise KeyError(f"{sensor} has no target in {self.name}")
        sensors = tuple((name, position if name == sensor else old) for name, old in self.end.sensors)
        return replace(self, end=replace(self.end, sensors=sensors))

    def with_solver(self, method: SolverName) -> Problem:
        """Return the same problem for an NLP method; another method drops the options of the former one."""
        return replace(self, solver=self.solver.with_method(method))


def list_names(text: str | Expression, functions: Sequence[Symbolic]) -> frozenset[str]:
    """List the names that an expression reads, functions replaced by the names that they read."""
    reads = {function.name: frozenset(function.reads) for function in functions}
    expression = parse(text) if isinstance(text, str) else text
    return frozenset().union(*(reads.get(name, frozenset((name,))) for name in names(expression)))


def count_delayed(delay: Delay, problem: Problem) -> int | None:
    """Count the intervals before the first command of a delayed input acts; None where it acts within an interval."""
    times = problem.grid.mesh(problem.horizon).tolist()
    return next((k for k, t in enumerate(times) if abs(t - delay.seconds) <= SAME_TIME * problem.horizon), None)


def find_conflicts(problem: Problem) -> list[Finding]:
    """Find conflicts among form, integrator, representation, horizon and kinds of coordinates."""
    form, representation, found = problem.form, problem.representation, []
    if form is not Form.STANDARD and (problem.every_state or problem.controls):
        finding = f"the {form.value} form takes no states, controls and integrals beside the mechanism's"
        found.append(Finding(("form",), finding, "take standard"))
    if form is not Form.STANDARD and (problem.forces or problem.wrenches):
        finding = f"the {form.value} form takes no forces and wrenches by expressions"
        found.append(Finding(("form",), finding, "take standard"))
    if form is not Form.STANDARD and problem.inputs != "constant":
        finding = f"the {form.value} form takes no inputs that change within an interval"
        found.append(Finding(("inputs",), finding, "take constant ones, or form: standard"))
    if problem.cost.input_rates and problem.inputs != "constant":
        finding = "cost.input_rates prices steps of inputs from interval to interval, and these change within them"
        found.append(Finding(("inputs",), finding, "take constant ones; or let a control be the rate of a state"))
    if form is Form.SHOOTING and representation.is_explicit and not representation.is_ode:
        finding = f"{representation.value} has accelerations as variables, shooting has none"
        ode = representation.as_ode
        found.append(Finding(("representation",), finding, f"take {ode.value if ode else 'form: standard'}"))
    if problem.integrator == SECOND_ORDER and problem.has_quaternions:
        finding = "a quaternion is not the integral of a velocity, as coordinates of second-order collocation are"
        found.append(Finding(("integrator",), finding, "take integrator: collocation"))
    found += _find_slopes(problem)
    found += _find_delays(problem)
    found += _find_starts(problem)
    if problem.inputs != "constant" and _has_rates(problem):
        finding = "rates are differences of constant inputs over time, and these inputs change within an interval"
        found.append(Finding(("inputs",), finding, "let a control be the rate of a state, as `lift_inputs` does"))
    if form is not Form.SHOOTING and (not INTEGRATORS[problem.integrator].is_collocation or problem.steps != 1):
        finding = f"{problem.integrator} with {problem.steps} steps is for shooting, and the form is {form.value}"
        key = "steps" if INTEGRATORS[problem.integrator].is_collocation else "integrator"
        found.append(Finding((key,), finding, "take form: shooting, or integrator: collocation and 1 step"))
    elif INTEGRATORS[problem.integrator].is_explicit and not representation.is_explicit:
        finding = f"{problem.integrator} needs accelerations, and {representation.value} returns a residual"
        found.append(Finding(("integrator",), finding, "take representation: EXP2-O, or integrator: collocation"))
    return found


def _find_starts(problem: Problem) -> Iterator[Finding]:
    """Find parts of a problem that need points other than Lobatto's."""
    if problem.family is not Family.LOBATTO:
        return
    if problem.degree not in list_degrees(problem.family):
        yield Finding(("degree",), "lobatto has points at both ends of an interval", "take degree: 2 or more")
    if problem.form is not Form.STANDARD or problem.integrator != "collocation":
        finding = "the points of lobatto begin at the interval's start, where nothing is integrated"
        yield Finding(("scheme",), finding, "take form: standard and integrator: collocation; or scheme: radau")
    if problem.driven or problem.contacts or problem.touching:
        finding = "driven joints and contacts have conditions at each point, and lobatto has each mesh point twice"
        yield Finding(("scheme",), finding, "take scheme: radau")


def _has_rates(problem: Problem) -> bool:
    ranges = (*problem.bounds.rates, *(control.rates for control in problem.controls))
    return bool(problem.cost.control_rates) or any(map(math.isfinite, (x for limits in ranges for x in limits)))


def _find_delays(problem: Problem) -> list[Finding]:
    """Find delays that no grid of the problem can have."""
    found = []
    if problem.delays and not problem.is_timed:
        finding = "the horizon is free, so the mesh points move, and a delay ends at one of them"
        place = _place_delay(problem, problem.delays[0])
        return [Finding((place[0], *place[1:]), finding, "give the horizon, or leave the delay out")]
    for delay in problem.delays:
        key, *entry = _place_delay(problem, delay)
        if not 0 < delay.seconds < problem.horizon:
            finding = f"a delay of {delay.seconds:g} s, and the horizon is {problem.horizon:g} s"
            found.append(Finding((key, *tuple(entry)), finding, "give a positive delay below the horizon"))
        elif count_delayed(delay, problem) is None:
            times = problem.grid.mesh(problem.horizon).tolist()
            k = next(k for k, t in enumerate(times) if t > delay.seconds)
            finding = f"a delay of {delay.seconds:g} s ends within an interval, from {times[k - 1]:g} to {times[k]:g} s"
            remedy = "let it end at a mesh point: give a multiple of the intervals' length, or lengths of intervals"
            found.append(Finding((key, *tuple(entry)), finding, remedy))
    return found


def _place_delay(problem: Problem, delay: Delay) -> tuple[str, ...]:
    """Return the place of a delay in a file; rates of continuous inputs have the delays of these."""
    if delay.kind == "input" or delay.index >= len(problem.controls):
        return ("inputs",)
    name = problem.controls[delay.index].name
    if delay.state is None:
        return ("controls", name, "delay")
    lifted = problem.states[delay.state].name
    return ("controls", lifted, "delay") if name in (f"rate_{lifted}", f"rate_of_{lifted}") else ("inputs",)


def _find_slopes(problem: Problem) -> list[Finding]:
    """Find what makes forms with slopes of first order, where second-order collocation is asked for."""
    form = problem.form
    if form is Form.STANDARD or problem.integrator != SECOND_ORDER:
        return []
    found = []
    if not problem.is_timed:
        found.append(("a horizon that is free", "give the horizon"))
    if form is Form.SHOOTING and problem.mesh is not None:
        found.append(("intervals of unequal length", "give their number"))
    if form is Form.INTEGRAL and problem.representation.is_ode:
        found.append((f"accelerations that are no variables, as in {problem.representation.value}", "take IMPL"))
    finding = f"second-order collocation in the {form.value} form does not go with"
    remedy = "take form: standard, or integrator: collocation"
    return [Finding(("integrator",), f"{finding} {what}", f"{other}, or {remedy}") for what, other in found]


def cylindrical(radius: float, azimuth: float, height: float) -> Point:
    """Turn cylindrical coordinates about the base's z axis [m, rad, m] into a position."""
    return (radius * math.cos(azimuth), radius * math.sin(azimuth), height)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
