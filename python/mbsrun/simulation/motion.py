"""The settings and the result of a simulation, and the steps that integrators yield."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mbsrun.kernel import Kernels
from mbsrun.limits import Limits
from mbsrun.quantities import Added, list_quantities
from mbsrun.results import Numbers
from mbsrun.simulation.formulation import Formulation

Array = NDArray[np.float64]
Dense = Callable[[Array, NDArray[np.intp]], tuple[Array, Array]]  # within steps

DRIFT = 0.01  # of the energy that is exchanged; a larger drift brings a warning
STILL = 1e-9  # of kinetic energy: a smaller drift brings no warning
SINGULAR = 0.01  # a pivot of the loops' Jacobian, relative to the largest; a smaller one may bring a warning
STORED = 1000  # states that are kept of a motion, about, unless another distance of outputs is asked for


class Keeping(Enum):
    """How loops are kept closed."""

    PROJECTION = "projection"  # by the least change of coordinates and velocities, after each step
    MASS_PROJECTION = "mass-projection"  # by the change that is least in the mass matrix
    PARTITIONING = "partitioning"  # by dependent coordinates, at each stage
    BAUMGARTE = "baumgarte"  # by accelerations that make open loops close, with given gains
    GGL = "ggl"  # stabilised index 2: by multipliers of positions and of velocities
    INDEX_3 = "index-3"  # by multipliers of positions
    RATTLE = "rattle"  # by impulses at both ends of a step: one closes positions, one velocities


class Impacts(Enum):
    """The law of restitution in impacts of rigid contacts."""

    NEWTON = "newton"  # of velocities
    POISSON = "poisson"  # of impulses


@dataclass(frozen=True)
class Latch:
    """The times at which a stop that holds, or a coupling, may hold."""

    name: str  # of the stop
    times: tuple[tuple[float, float], ...]  # from, until: increasing

    def holds(self, time: float) -> bool:
        """Return whether it may hold from a time on."""
        return any(start <= time < end for start, end in self.times)


@dataclass(frozen=True)
class Settings:
    """How to integrate. Times in s."""

    duration: float
    method: str = "dop853"
    formulation: Formulation = Formulation.EXP2
    step: float = 1e-3  # of methods with a fixed step, at most: a piece of the inputs has steps of equal length
    rtol: float = 1e-9  # of adaptive methods: tolerance of a step, relative,
    atol: float = 1e-9  # and absolute (rad, m; rad/s, m/s)
    stages: int = 2  # of radau-iia and gauss
    rho: float = 0.8  # of generalized-alpha: the part of the highest frequencies' amplitude that a step keeps
    loops: Keeping | None = None  # None: the method's first
    impacts: Impacts = Impacts.NEWTON
    alpha: float = 5.0  # 1/s: gains of Baumgarte's terms, of the rate
    beta: float = 5.0  # 1/s: and of the gap
    latches: tuple[Latch, ...] = ()  # that hold at some times; of others, stops that hold do at all, couplings at none
    output_step: float | None = None  # between the states that are kept; None: duration / STORED
    max_steps: int = Limits.steps  # a motion that would take more is refused, or halts
    max_seconds: float = Limits.seconds  # of processor time; the motion halts when they are used up


class Mode(IntEnum):
    """The state of a joint with stops or dry friction."""

    BACKWARD = -1  # it slides
    FREE = 0
    FORWARD = 1  # it slides
    STICKS = 2
    LOWER = 3  # it rests on its lower stop
    UPPER = 4


class Kind(Enum):
    """A kind of event."""

    IMPACT = "hits"  # a stop
    REST = "rests"  # on a stop; the joint may have hit it infinitely often
    LEAVE = "leaves"  # a stop
    STICK = "sticks"
    SLIP = "slips"
    REVERSE = "reverses"  # it slides, without a time at rest


@dataclass(frozen=True)
class Event:
    """A switch of a joint."""

    time: float  # s
    joint: str
    kind: Kind
    before: float  # velocity [rad/s or m/s]
    after: float


@dataclass(frozen=True, eq=False)
class Jump:
    """An impact: M (after - before) = impulses, on some joints, whose velocities change by their restitutions."""

    before: Array  # (n,)
    after: Array
    joints: tuple[int, ...]  # the joints with impulses
    restitution: tuple[float, ...]


@dataclass(frozen=True)
class Guard:
    """A number of the state that is not negative while a mode lasts: side (x - level)."""

    kind: int  # PLACE, SPEED, or FORCE that holds the joint
    joint: int  # entry of qd
    place: int  # entry of q
    side: float
    level: float


PLACE, SPEED, FORCE = 0, 1, 2  # kinds of guards


# times (K,) and states (K, nq), (K, n) of a mode -> accelerations (K, n), forces (K, 3 points) of rigid contacts in the
# base frame [N], and the power that their friction takes (K,) [W]
Push = Callable[[Array, Array, Array], tuple[Array, Array, Array]]


@dataclass(frozen=True, eq=False)
class Bounces:
    """Impacts between steps of one mode, each between two states at one time."""

    rows: NDArray[np.intp]  # of the states after them
    events: tuple[Event, ...]
    losses: Array  # J
    guards: tuple[Guard, ...]  # that fell to 0
    restitution: tuple[float, ...]


@dataclass(frozen=True)
class Segment:
    """The mode of some steps, and what happened at their start."""

    modes: tuple[int, ...]  # by velocity
    events: tuple[Event, ...] = ()
    loss: float = 0.0  # J: of impacts
    driven: float = 0.0  # J: work of driven joints in impacts
    guards: tuple[Guard, ...] = ()  # that fell to 0
    jumps: tuple[Jump, ...] = ()
    push: Push | None = None  # of a model with rigid contacts
    bounces: Bounces | None = None  # between the steps
    locking: tuple[int, ...] | None = None  # joints at rest whose forces vary; None: all
    forces: tuple[float, ...] = ()  # (n,), of others at rest
    passage: object | None = None  # how a model with rigid contacts came into the mode: `touching.Passage`


@dataclass(frozen=True)
class Halt:
    """Why a simulation ended early."""

    time: float
    joint: str | None  # where; None where no joint can be named
    finding: str
    remedy: str
    loop: str | None = None

    def __str__(self) -> str:
        place = f", joint {self.joint}" if self.joint else f", loop {self.loop}" if self.loop else ""
        return f"stopped at t = {self.time:.6g} s{place}: {self.finding}; {self.remedy}"


@dataclass
class Effort:
    """The effort of an integration; counted while it goes on."""

    steps: int = 0  # accepted
    rejected: int | None = 0  # None: the method does not count them
    evaluations: int = 0  # of accelerations or residuals, in one state each
    jacobians: int = 0
    iterations: int = 0  # of Newton's method
    switches: int = 0  # of dependent coordinates
    pivot: float = 1.0  # of the loops' Jacobian, the smallest relative to the largest: small near a singular pose
    gap: float = 0.0  # of loops, the largest that an explicit step left before they were closed
    sweeps: int = 0  # of time stepping: rounds of Gauss-Seidel through all contacts,
    cone_steps: int = 0  # steps of Newton's method for their impulses,
    residual: float = 0.0  # and the largest relative error of these
    seconds: float = 0.0  # of processor time


@dataclass(frozen=True, eq=False)
class Energy:
    """Energies [J] at the times of a motion, (K,) each."""

    kinetic: Array
    potential: Array  # of gravity
    work: Array  # done so far by all other forces: inputs, springs, dampers, friction, wrenches
    friction: Array | None = None  # taken so far by dry friction, which is not in `work`; None: there is none
    impacts: Array | None = None  # and by impacts on stops

    @property
    def total(self) -> Array:
        """Sum kinetic and potential energy."""
        return self.kinetic + self.potential

    @property
    def drift(self) -> Array:
        """Return the total minus its start and the work done since, plus losses: the error of the integration."""
        lost = sum((x for x in (self.friction, self.impacts) if x is not None), start=np.zeros_like(self.work))
        return np.asarray(self.total - self.total[0] - self.work + lost)

    @property
    def exchanged(self) -> float:
        """Return the sum of the ranges of kinetic and potential energy [J]."""
        return float(np.ptp(self.kinetic) + np.ptp(self.potential))

    @property
    def is_kept(self) -> bool:
        """Return whether the drift is small enough."""
        return bool(np.abs(self.drift).max() <= self.tolerated)

    @property
    def tolerated(self) -> float:
        """Return the largest drift without a warning: a part of the energy exchanged or kinetic, or rounding.

        Every time adds its own rounding, to the state and to the work.
        """
        return float(max(DRIFT * self.exchanged, STILL * self.kinetic.max(), self.rounding * self.kinetic.size))

    @property
    def rounding(self) -> float:
        """Return the rounding error of the energies at one time: a smaller drift shows nothing of the integration."""
        sizes = [np.abs(x).max() for x in (self.kinetic, self.potential, self.work)]
        return float(np.finfo(float).eps * max(sizes))


@dataclass(frozen=True, eq=False)
class ClosureRecord:
    """The loops along a motion: e equations, d driven joints, at K times."""

    position: Array  # (K,): the largest |h|
    velocity: Array  # (K,): the largest |J qd|
    most: tuple[float, float]  # the same of all steps
    multipliers: Array  # (K, e), not a number at singular poses
    driving: Array  # (K, d): forces of driven joints


@dataclass(frozen=True, eq=False, repr=False)
class Motion:
    """A motion of nq coordinates, n velocities under m inputs, at K times; with `halt`, the part that was reached."""

    settings: Settings
    t: Array  # (K,)
    q: Array  # (K, nq)
    qd: Array  # (K, n)
    inputs: Array  # (K, m): u, then w; where they jump, the values after the jump
    energy: Energy | None  # None where it overflows, or a kernel fails on the way
    effort: Effort
    closure: ClosureRecord | None = None  # of a model with loops or driven joints
    halt: Halt | None = None
    events: tuple[Event, ...] = ()  # of joints with stops or dry friction
    modes: NDArray[np.int_] | None = None  # (K, n), as `Mode` lists them; None without such joints
    contacts: tuple[Array, Array, Array] | None = None  # of rigid contacts: forces (K, 3 points), their normal parts
    # (K, points), and distances of pairs of solids (K, pairs)
    warnings: tuple[str, ...] = ()
    qdd: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)  # (K, n), not a number where it fails
    kernels: Kernels | None = field(default=None, repr=False)  # of the mechanism, for further numbers

    @property
    def is_complete(self) -> bool:
        """Return whether the end was reached."""
        return self.halt is None

    @property
    def names(self) -> tuple[str, ...]:
        """List the names of quantities, as expressions have them: `q_NAME`, `qd_NAME`, `u_NAME`, `x_SENSOR`, ..."""
        return self.numbers.names

    @property
    def results(self) -> tuple[str, ...]:
        """List the names of the numbers that follow from the motion: energies, tensions, forces in joints, and more."""
        return self.numbers.results

    def __getitem__(self, name: str) -> Array:
        """Return a quantity, or a number that follows from the motion, (K,). Raises UnknownNameError."""
        return self.numbers[name]

    def unit(self, name: str) -> str:
        """Return the unit of a number; "" where it has none. Raises UnknownNameError."""
        return self.numbers.unit(name)

    @cached_property
    def numbers(self) -> Numbers:
        """The numbers of the motion by name."""
        assert self.kernels is not None, "a simulation knows its kernels"
        manifest, count = self.kernels.manifest, len(self.kernels.manifest.actuated)
        parts = {"t": self.t[:, None], "q": self.q, "qd": self.qd, "qdd": self.qdd}
        parts |= {"u": self.inputs[:, :count], "w": self.inputs[:, count:]}
        if self.contacts is not None:
            parts |= zip(("contact_force", "normal", "solid_gap"), self.contacts, strict=True)
        if self.closure is not None:
            parts |= {"lam": self.closure.multipliers, "tau": self.closure.driving}
        return Numbers(self.kernels, list_quantities(manifest, Added()), parts)

    def __repr__(self) -> str:
        """Return what was simulated, and how it ended."""
        model = "" if self.kernels is None else f"{self.kernels.manifest.model}, "
        end = "complete" if self.halt is None else f"incomplete: {self.halt}"
        return f"Motion({model}{self.t[-1]:.6g} s by {self.settings.method}, {len(self.t)} states, {end})"


class HaltError(Exception):
    """Raised by an integrator, after it has yielded the steps that it took."""

    def __init__(self, halt: Halt) -> None:
        super().__init__(str(halt))
        self.halt = halt


@dataclass(frozen=True, eq=False)
class Stages:
    """States within k steps at which a method evaluates integrals: s in each step."""

    t: Array  # (k, s)
    q: Array  # (k, s, nq)
    qd: Array  # (k, s, n)
    weights: Array  # (s,): an integral over a step is the step's length times their sum over the stages


@dataclass(frozen=True, eq=False)
class Strikes:
    """The impulses of k steps of time stepping, spread over their steps."""

    losses: Array  # (k, 2): the energy that impacts, and that friction took [J]
    rates: Array  # (k, n): accelerations
    forces: Array  # (k, 3 points): of rigid contacts on the bodies that touch, in the base frame [N]


@dataclass(frozen=True, eq=False)
class Chunk:
    """Some steps in a row, as an integrator yields them; the first state is the last of the chunk before."""

    t: Array  # (k + 1,)
    q: Array  # (k + 1, nq)
    qd: Array  # (k + 1, n)
    dense: Dense | None = None
    # times (j,) and the steps (j,) that they lie in, from 0 -> q, qd (j, n) by the method's own interpolation
    stages: Stages | None = None
    segment: Segment | None = None  # of a model with stops or dry friction, from event to event
    strikes: Strikes | None = None  # of time stepping

    def part(self) -> Iterator[Chunk]:
        """Yield the steps between impacts, each time with the events before them."""
        segment = self.segment
        if segment is None or segment.bounces is None:
            yield self
            return
        bounces, ends = segment.bounces, [*segment.bounces.rows.tolist(), len(self.t)]
        yield self._cut(0, ends[0], replace(segment, bounces=None))
        for k, first in enumerate(bounces.rows.tolist()):
            event, guard, e = bounces.events[k], bounces.guards[k], bounces.restitution[k]
            jump = Jump(self.qd[first - 1], self.qd[first], (guard.joint,), (e,))
            loss = float(bounces.losses[k])
            own = replace(
                segment,
                bounces=None,
                events=(event,),
                loss=loss,
                driven=0.0,
                guards=(guard,),
                jumps=(jump,),
            )
            yield self._cut(first, ends[k + 1], own)

    def _cut(self, first: int, end: int, segment: Segment) -> Chunk:
        """Return the steps between two rows."""
        dense = self.dense

        def read(times: Array, step: NDArray[np.intp]) -> tuple[Array, Array]:
            assert dense is not None, "steps between events can be read"
            return dense(times, step + first)

        return Chunk(self.t[first:end], self.q[first:end], self.qd[first:end], read, segment=segment)
