"""An NLP method: a table of options, and a function that makes a solver of a program."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.evaluation.stages.binding import Point
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.methods.options import Option, Settings


@dataclass(frozen=True)
class Assignment:
    """The program and the settings of a solver."""

    program: Prepared
    tolerance: float
    max_iterations: int
    scaling: float  # of the objective, as the solver sees it
    options: Settings
    threads: int


@dataclass(frozen=True)
class Iterate:
    """An iterate of a solver."""

    number: int
    cost: float
    violation: float  # of the constraints, the largest


Watch = Callable[[Iterate], None]  # an exception in it ends the solver, and is raised again


@dataclass(frozen=True, eq=False)
class Near:
    """Where a solve ended, in the method's own variables, for the solve of a problem nearby."""

    layout: bytes  # names the order of these variables
    point: Point

    def fits(self, other: Near) -> bool:
        """Return whether another one has the same variables."""
        return self.layout == other.layout and self.point.fits(other.point)

    def scale(self, factor: float) -> Near:
        """Return it with multipliers of a cost that is multiplied by a factor."""
        point = self.point
        return Near(self.layout, Point(point.w, factor * point.below, factor * point.above, factor * point.y))


def mix(ends: Sequence[Near], weights: Array) -> Near:
    """Return the mean of ends that fit, with weights that may be negative; multipliers of bounds stay at least 0."""
    return mix_many(ends, sparse.csr_array(weights[None]))[0]


def mix_many(ends: Sequence[Near], weights: sparse.csr_array) -> list[Near]:
    """Return means of ends that fit, with weights (means, ends), as `mix` does."""
    w, below, above, y = (
        np.asarray(weights @ np.stack(parts)) for parts in zip(*(end.point.parts for end in ends), strict=True)
    )
    rows = zip(w, np.maximum(below, 0.0), np.maximum(above, 0.0), y, strict=True)
    return [Near(ends[0].layout, Point(*row)) for row in rows]


@dataclass(frozen=True, eq=False)
class Stack:
    """The numbers of many solves that start near solutions, (cases, size) each; see `Instance`."""

    parameters: Array
    lower: Array
    upper: Array
    g_lower: Array
    g_upper: Array
    scales: Array
    scaling: Array  # of the objective, as the solver sees it, (cases,)
    near: tuple[Near, ...]
    most_iterations: Indices  # (cases,); 0: as many as the method has

    @property
    def count(self) -> int:
        """Count the solves."""
        return len(self.near)


@dataclass(frozen=True, eq=False)
class AnswerStack:
    """The results of many solves, (cases, size) each; see `Answer`."""

    x: Array
    statuses: tuple[str, ...]
    iterations: Indices
    multipliers: Array
    near: tuple[Near, ...]
    seconds: Array
    evaluating: Array
    cpu_seconds: Array


@dataclass(frozen=True)
class Instance:
    """The numbers of one solve."""

    x: Array
    parameters: Array
    lower: Array  # of x
    upper: Array
    g_lower: Array
    g_upper: Array
    watch: Watch | None = None
    scales: Array | None = None  # usual sizes of x; None: 1
    cost_scale: float = 1.0  # of the cost, as a method in scaled variables sees it, beside the one of its weights
    near: Near | None = None  # where to start instead of x
    most_iterations: int = 0  # of a start near a solution; 0: as many as the method has

    def measure(self, g: Array) -> float:
        """Return by how much constraints leave their bounds: the largest."""
        return float(np.maximum(self.g_lower - g, g - self.g_upper).max(initial=0.0))


@dataclass(frozen=True)
class Answer:
    """The result of a solver."""

    x: Array
    status: str  # SOLVED or ACCEPTABLE of `status`, or the solver's word for a failure
    iterations: int
    evaluating: float = 0.0  # s in functions and derivatives
    cpu_evaluating: float = 0.0
    multipliers: Array | None = None  # of the constraints, where the method returns them: L = f + multipliers' g
    clash: tuple[int, ...] = ()  # of a failure: rows of the program that stay violated, the worst first
    near: Near | None = None  # for solves of problems nearby, where the method can start so
    preparing: float = 0.0  # s before the first iterate that serve later solves too, such as a structure laid in memory
    cpu_preparing: float = 0.0


Solver = Callable[[Instance], Answer]
StackSolver = Callable[[Stack], AnswerStack]


@dataclass(frozen=True)
class Method:
    """A way to solve programs."""

    title: str
    options: Mapping[str, Option]
    make: Callable[[Assignment], Solver]
    warm: Settings = field(default_factory=dict)  # options of starts near a solution
    calls_casadi: bool = True  # whether programs may hold expressions of CasADi
    has_threads: bool = False  # whether a solve may have several
    make_many: Callable[[Assignment, int], StackSolver] | None = None  # solves stacks in a number of threads
