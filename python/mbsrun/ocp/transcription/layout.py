"""Where a motion lies among the variables of a program, and where functions of it are applied.

Interval by interval: the state x_k = (q, qd) at the mesh point; at each collocation point the state x_kj and, unless
the equations of motion are an ODE, the acceleration z_kj; the inputs u_k, constant over the interval, or u_kj at its
points. At the end x_N, and the horizon T where it is free. With quaternions there are more entries of q than of qd and
z.

In the integral form the states at the points are no variables. They are linear in x_k and the accelerations z_k at the
stages of an integrator, with the matrices of `integrators`, h being the length of their interval:

    q = q_k + h c qd_k + h^2 P z_k,    qd = qd_k + h V z_k,    qdd = W z_k

Where the horizon is free, that would not be linear. There, and for quaternions, and for an ODE, slopes s_kj take the
place of accelerations: derivatives of the state, times the length of the interval. With the matrix V alone,

    x = x_k + V s_k,    s_kj = h d/dt x

Where the first point of an interval is its start, the state there is x_k, and the variables of this point are the slope
of the state, times the length of the interval.

The states that a problem adds lie behind the mechanism's, at mesh points and within intervals; its controls, behind the
inputs.

With closed loops a point also has multipliers lam_kj and corrections mu_kj, or only the independent velocities and
accelerations: see `closing`. In the reduced form without states at the points, only independent entries are linear in
accelerations or slopes. The others are the ones at the mesh point before, plus shifts, which are variables wherever
loops are closed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.grid import Grid
from mbsrun.ocp.ground.inputs import Group, mix
from mbsrun.ocp.ground.integrators import Integrator, Reading
from mbsrun.ocp.ground.program import Column, Combination, Matrix

Scalar = TypeVar("Scalar", np.float64, np.int64)


@dataclass(frozen=True)
class Motions:
    """The parts of a motion that are variables; all of it without closed loops."""

    nq: int  # entries of q
    places: tuple[int, ...]  # entries of q that collocation carries on
    velocities: tuple[int, ...]  # entries of qd that are variables
    independent: tuple[int, ...]  # entries of qd that collocation carries on, and that have accelerations
    moved: tuple[int, ...]  # entries of qd whose velocities and accelerations kernels take: these and driven ones
    driven: tuple[int, ...] = ()  # entries of qd whose motion is given
    driven_places: tuple[int, ...] = ()  # the same of q
    multipliers: int = 0  # of loops, at a point
    corrections: int = 0  # of states, at a point
    lengths: tuple[int, ...] = ()  # first entries of quaternions that the loops give, and whose length is an equation

    @property
    def is_reduced(self) -> bool:
        """Return whether the loops give the dependent coordinates."""
        return len(self.places) + len(self.driven_places) < self.nq

    @property
    def carried(self) -> list[int]:
        """List the entries of a state, (q, velocities), that collocation carries on."""
        return [*self.places, *(self.nq + i for i in self.carried_velocities)]

    @property
    def found(self) -> list[int]:
        """List the other entries of a state, which the loops or given motions give."""
        return [i for i in range(self.nq + len(self.velocities)) if i not in set(self.carried)]

    @property
    def carried_velocities(self) -> list[int]:
        """List the places of `independent` among `velocities`."""
        return [self.velocities.index(i) for i in self.independent]

    @property
    def moved_velocities(self) -> list[int]:
        """List the places of `moved` among `velocities`."""
        return [self.velocities.index(i) for i in self.moved]

    @property
    def driven_states(self) -> list[int]:
        """List the entries of a state whose motion is given: of q, then of velocities."""
        return [*self.driven_places, *(self.nq + self.velocities.index(i) for i in self.driven)]


@dataclass(frozen=True)
class Extras:
    """Where the variables lie that a problem adds to the motion of its mechanism."""

    states: Indices  # (N + 1, ns): at the mesh points
    point_states: Indices  # (N, S, ns)
    nodes: Indices  # (N, S, ns): the same, or slopes at the first points
    controls: Indices  # (N, nc); (N, 0) where they are polynomials
    point_controls: Indices  # (N, S, nc), a steady one being the same at all; (N, S, 0) where all are constant
    forces: Indices  # (N, S, ...): inputs u that expressions give
    wrenches: Indices  # (N, S, nw): components of open wrenches
    given: tuple[int, ...]  # entries of u that expressions give
    m: int  # entries of u
    steady: tuple[int, ...] = ()  # controls that are constant over each interval, though others are polynomials

    @property
    def varying(self) -> list[int]:
        """List the controls with a value at each stage."""
        return [i for i in range(self.point_controls.shape[2]) if i not in self.steady]

    @property
    def free(self) -> tuple[int, ...]:
        """List the entries of u that no expression gives."""
        return tuple(i for i in range(self.m) if i not in self.given)


@dataclass(frozen=True)
class Layout:
    """Where a motion lies among the variables; nq coordinates, n velocities, m inputs, N intervals, S stages each."""

    motions: Motions
    grid: Grid
    mesh: Indices  # (N + 1, nq + n): states at the mesh points
    points: Indices  # (N, S, nq + n): states at the stages; (N, S, 0) in the integral form
    nodes: Indices  # (N, S, nq + n): the same, or slopes at the first stages where these are the intervals' starts
    slopes: (
        Indices  # (N, S, ...): derivatives of carried states at the stages, times the interval's length; or (N, S, 0)
    )
    accelerations: Indices  # (N, S, n): accelerations at the stages; (N, S, 0) for an ODE
    multipliers: Indices  # (N, S, ...): of loops, where they are variables
    corrections: Indices  # (N, S, ...): of coordinates, then of velocities
    drives: Indices  # (N, S, d): accelerations of driven joints
    driving: Indices  # (N, S, d): forces of driven joints
    shifts: Indices  # (N, P, ...): of entries that loops give, from the interval's start to each closed place; or P = 0
    inputs: Indices  # (N, m) without inputs that expressions give; (N, 0) where they are polynomials
    point_inputs: Indices  # (N, S, m) without these; (N, S, 0) where they are constant
    horizon: int | None  # T, where it is free
    unknowns: Indices  # numbers of the whole horizon that the solver chooses
    design: Indices  # the variables of theta; none where kernels read values of the model
    size: int
    extras: Extras

    @property
    def horizons(self) -> Indices:
        """Return T as a list, which is empty where it is given."""
        return np.array([] if self.horizon is None else [self.horizon], dtype=np.int64)

    @property
    def nq(self) -> int:
        """Count the coordinates."""
        return self.motions.nq

    @property
    def n(self) -> int:
        """Count the velocities that are variables."""
        return len(self.motions.velocities)

    def split_carried(self, states: NDArray[Scalar]) -> tuple[NDArray[Scalar], NDArray[Scalar]]:
        """Split carried states (..., carried), into coordinates and velocities."""
        count = len(self.motions.places)
        return states[..., :count], states[..., count:]

    @property
    def every_acceleration(self) -> Indices:
        """List the accelerations that kernels take, (N, S, moved); (N, S, 0) where they are no variables."""
        motions = self.motions
        if not self.drives.size or (motions.independent and not self.accelerations.size):
            return self.accelerations
        at = {i: self.accelerations[:, :, k] for k, i in enumerate(motions.independent)}
        at |= {i: self.drives[:, :, k] for k, i in enumerate(motions.driven)}
        return np.stack([at[i] for i in motions.moved], axis=2)

    @property
    def every_input(self) -> Indices:
        """List the inputs and controls of each interval, (N, ...)."""
        N, extras = self.grid.intervals, self.extras
        points = np.concatenate((self.point_inputs, extras.point_controls[:, :, extras.varying]), axis=2)
        steady = extras.point_controls[:, 0, list(extras.steady)]
        return np.concatenate((self.inputs, extras.controls, points.reshape(N, -1), steady), axis=1)

    def list_inputs(self) -> Indices:
        """List the inputs of the mechanism that the solver chooses."""
        return np.concatenate((self.inputs.ravel(), self.point_inputs.ravel()))

    def split(self, states: NDArray[Scalar]) -> tuple[NDArray[Scalar], NDArray[Scalar]]:
        """Split states (..., nq + n), or any array with their last axis, into coordinates and velocities."""
        return states[..., : self.nq], states[..., self.nq :]


@dataclass(frozen=True)
class ExtraSizes:
    """The variables that a problem adds to the motion of its mechanism."""

    states: int = 0
    controls: int = 0
    given: tuple[int, ...] = ()  # entries of u that expressions give
    wrenches: int = 0  # components
    steady: tuple[int, ...] = ()  # controls that are constant over each interval, though others are polynomials


@dataclass(frozen=True)
class ExtraRows:
    """Where the conditions on the states lie that a problem adds, and what expressions give."""

    start: Indices  # (ns,)
    rates: Indices  # (N, S, ns)
    given: Indices  # (N, S, ...): inputs, components of wrenches, and driven accelerations, that expressions give
    contacts: Indices  # (N, S, ...): velocities of contacts along the axes that are held, contact by contact
    contacts_at_start: Indices  # the same where the start is free, or empty
    friction: Indices  # (..., points)
    end: Indices  # (states with a condition there,)


@dataclass(frozen=True)
class Rows:
    """Where each constraint lies."""

    start: Indices  # (nq + n,)
    lengths: Indices  # (quaternions,) where the start is free, or empty
    states: Indices  # (N, S, nq + n); (N, S, 0) in the integral form
    dynamics: Indices  # (N, S, n): for an ODE, the rows of the states that hold the equations of motion
    closure: Indices  # (N, S or P, ...): of loops, and of their rates where velocities are variables
    start_closure: Indices  # the same where the start is free, or empty: loops, then rates
    driven: Indices  # (N, S or P, 2 d): coordinates, then velocities, of given motions
    driven_start: Indices  # (2 d,)
    driving: Indices  # (N, S, d): the equations of motion of driven joints
    continuity: Indices  # (N, nq + n)
    extras: ExtraRows
    inner: Indices  # (N, points, bounded states): where points have no states
    sensors: Indices  # (targets, 3)
    coordinates: Indices  # (targets,); quaternions apart
    attitudes: Indices  # (targets, 3)
    velocity: Indices  # (n,), or empty
    acceleration: Indices  # (n,), or empty
    velocities: Indices  # (targets,)
    accelerations: Indices  # (targets,)
    sensor_velocities: Indices  # (targets, 3)
    constraints: tuple[Indices, ...]  # of each, (places,)
    rates: Indices  # (N - 1, ...): of constant inputs, then of controls, whose rates have bounds
    size: int


def lay_out(
    motions: Motions,
    m: int,
    grid: Grid,
    stages: int,
    *,
    has_states: bool,
    has_slopes: bool,
    has_accelerations: bool,
    horizon_is_free: bool,
    added: ExtraSizes,
    unknowns: int = 0,
    has_constant_inputs: bool = True,
    closed: int = 0,
    begins_interval: bool = False,
) -> Layout:
    """Number the variables; `has_states`, `has_slopes`, `has_accelerations` say which variables the stages have.

    `closed` counts the places of an interval that have shifts; `begins_interval`: the first stage is its start.

    Inputs and controls are constant over an
    interval, or have a value at each stage.
    """
    N, S, width = grid.intervals, stages, motions.nq + len(motions.velocities)
    states, controls, free = added.states, added.controls, m - len(added.given)
    sizes = (
        width * has_states,
        states,
        len(motions.carried) * has_slopes,
        len(motions.independent) * has_accelerations,
        motions.multipliers,
        motions.corrections,
        len(added.given),
        added.wrenches,
        len(motions.driven),
        len(motions.driven),
    )
    at_stage = sum(sizes)
    steady = () if has_constant_inputs else added.steady
    varying = [i for i in range(controls) if i not in steady]
    values = free + controls if has_constant_inputs else (free + len(varying)) * S + len(steady)
    before = width + states + S * at_stage
    stride = before + closed * len(motions.found) + values
    first = np.arange(N + 1) * stride
    mesh = first[:, None] + np.arange(width + states)
    points = first[:N, None, None] + width + states + np.arange(S)[:, None] * at_stage + np.arange(at_stage)
    moved, further, slopes, accelerations, multipliers, corrections, forces, wrenches, drives, driving = np.split(
        points, np.cumsum(sizes)[:-1], axis=2
    )
    shifts = first[:N, None] + np.arange(before, stride - values)
    every = first[1:, None] - values + np.arange(values)
    if has_constant_inputs:
        inputs, point_inputs = every, np.zeros((N, S, 0), dtype=np.int64)
    else:
        at_points, held = np.split(every, [values - len(steady)], axis=1)
        inputs, point_inputs = every[:, :0], np.zeros((N, S, free + controls), dtype=np.int64)
        point_inputs[:, :, [*range(free), *(free + i for i in varying)]] = at_points.reshape(N, S, free + len(varying))
        point_inputs[:, :, [free + i for i in steady]] = held[:, None]
    return Layout(
        motions=motions,
        grid=grid,
        mesh=mesh[:, :width],
        points=_begin(moved, mesh[:-1, :width], begins_interval),
        nodes=moved,
        slopes=slopes,
        accelerations=accelerations,
        multipliers=multipliers,
        corrections=corrections,
        drives=drives,
        driving=driving,
        shifts=shifts.reshape(N, closed, len(motions.found)),
        inputs=inputs[:, :free],
        point_inputs=point_inputs[:, :, :free],
        horizon=N * stride + width + states if horizon_is_free else None,
        unknowns=N * stride + width + states + horizon_is_free + np.arange(unknowns),
        design=np.zeros(0, dtype=np.int64),
        size=N * stride + width + states + horizon_is_free + unknowns,
        extras=Extras(
            mesh[:, width:],
            _begin(further, mesh[:-1, width:], begins_interval),
            further,
            inputs[:, free:],
            point_inputs[:, :, free:],
            forces,
            wrenches,
            added.given,
            m,
            steady,
        ),
    )


def _begin(nodes: Indices, starts: Indices, begins_interval: bool) -> Indices:
    """Return states at the stages (N, S, ...), whose first ones may be the intervals' starts."""
    if not begins_interval:
        return nodes
    return np.concatenate((starts[:, None], nodes[:, 1:]), axis=1)


@dataclass(frozen=True)
class Places:
    """Where functions of the motion are applied: parts of the variables as a block takes them."""

    q: Column  # size nq
    qd: Column  # velocities that are variables
    qdd: Column  # size 0 where accelerations are no variables
    u: Column  # size m
    s: Array  # (places,): time over the horizon
    stage: Indices  # (places,): of the states
    interval: Indices  # (places,): of inputs and accelerations
    yd: Column  # velocities that kernels of the reduced form take
    lam: Indices  # (..., places): multipliers; size 0 where they are no variables
    states: Indices  # (ns, places): the ones that a problem adds
    controls: Column  # size nc
    w: Column  # size nw: components of open wrenches
    a: Column  # size d: accelerations of driven joints
    tau: Column  # size d: forces of driven joints

    def restrict(self, chosen: Indices) -> Places:
        """Keep some places."""

        def pick(part: Column) -> Column:
            return part[:, chosen] if isinstance(part, np.ndarray) else part.restrict(chosen)

        return Places(
            pick(self.q),
            pick(self.qd),
            pick(self.qdd),
            pick(self.u),
            self.s[chosen],
            self.stage[chosen],
            self.interval[chosen],
            pick(self.yd),
            self.lam[..., chosen],
            self.states[:, chosen],
            pick(self.controls),
            pick(self.w),
            pick(self.a),
            pick(self.tau),
        )

    @property
    def parts(self) -> Mapping[str, Column]:
        """Return the parts by the names of the kernels' inputs."""
        return {
            "q": self.q,
            "qd": self.qd,
            "qdd": self.qdd,
            "u": self.u,
            "yd": self.yd,
            "ydd": self.qdd,
            "lam": self.lam,
            "states": self.states,
            "controls": self.controls,
            "w": self.w,
            "a": self.a,
            "tau": self.tau,
        }


def at_points(layout: Layout, integrator: Integrator, h: Array) -> Places:
    """Return all points of the scheme, interval by interval; the integral form needs h, the intervals' lengths."""
    return _at(layout, integrator.points, h, integrator.first_point)


def at_stages(layout: Layout, integrator: Integrator, h: Array) -> Places:
    """Return all stages of the integrator, interval by interval."""
    return _at(layout, integrator.stages, h)


def at_closed(layout: Layout, integrator: Integrator, h: Array) -> Places:
    """Return all places that have shifts, interval by interval."""
    return _at(layout, integrator.closed, h)


def _at(layout: Layout, reading: Reading, h: Array, first: int = 0) -> Places:
    """Return the places of a reading, the first of which has a number among the closed ones."""
    N, k = len(layout.inputs), len(reading.c)
    s = layout.grid.places(reading.c).ravel()
    interval = np.repeat(np.arange(N), k)
    accelerations, multipliers = (_flatten(part) for part in (layout.every_acceleration, layout.multipliers))
    u, controls, w, a, tau = _read_inputs(layout, reading, np.tile(np.arange(k), N), interval)
    added = (_flatten(layout.extras.point_states), controls, w, a, tau)
    if layout.points.size or not layout.mesh.shape[1]:
        q, qd = map(_flatten, layout.split(layout.points))
        yd = qd[layout.motions.moved_velocities]
        return Places(q, qd, accelerations, u, s, interval, interval, yd, multipliers, *added)
    motion = read_slopes(layout, reading) if layout.slopes.size else read_motion(layout, reading, h)
    qdd = accelerations if reading.are_stages or not layout.accelerations.size else motion.qdd
    whole = fill_in(motion, layout, first)
    return Places(whole[0], whole[1], qdd, u, s, interval, interval, motion.qd, multipliers, *added)


def _flatten(points: Indices) -> Indices:
    """Put the points (N, S, size) of all intervals in a row: (size, N S)."""
    N, S, size = points.shape
    return points.reshape(N * S, size).T


@dataclass(frozen=True)
class Carried:
    """A motion at k places of every interval, (N k) in all: the entries that collocation carries on."""

    q: Combination
    qd: Combination
    qdd: Combination


def fill_in(motion: Carried, layout: Layout, first: int) -> tuple[Combination, Combination]:
    """Return q and qd with the entries that loops give; the first place has a number among the closed ones."""
    motions, N = layout.motions, layout.shifts.shape[0]
    found, k = motions.found, len(motion.q.which) // N
    if not found:
        return motion.q, motion.qd
    variables = np.concatenate(
        (
            np.repeat(layout.mesh[:-1, found], k, axis=0),
            layout.shifts[:, first : first + k].reshape(N * k, len(found)),
        ),
        axis=1,
    ).reshape(N * k, 2, len(found))
    split = sum(i < motions.nq for i in found)
    return (
        _fill(motion.q, motions.nq, motions.places, variables[:, :, :split]),
        _fill(motion.qd, layout.n, motions.carried_velocities, variables[:, :, split:]),
    )


def _fill(part: Combination, size: int, own: Sequence[int], variables: Indices) -> Combination:
    """Put a part into a vector; its other entries are sums of two variables each, (places, 2, entries)."""
    kinds, _, width = part.matrices.shape
    others = np.setdiff1d(np.arange(size), own)
    matrices = np.zeros((kinds, size, width + 2 * others.size))
    matrices[:, list(own), :width] = part.matrices
    for first in (width, width + others.size):
        matrices[:, others, first + np.arange(others.size)] = 1.0
    every = np.concatenate((part.variables, variables.reshape(len(variables), -1)), axis=1)
    return Combination(matrices, part.which, every)


def read_slopes(layout: Layout, reading: Reading) -> Carried:
    """Read a motion off the states at the mesh points and the slopes at the stages; accelerations, if there are any."""
    (N, S, _), k = layout.slopes.shape, len(reading.c)
    which = np.tile(np.arange(k), N)
    carried = layout.mesh[:-1, layout.motions.carried]
    starts, slopes = layout.split_carried(carried), layout.split_carried(layout.slopes)
    weights = np.concatenate((np.ones((k, 1)), reading.V), axis=1)

    def combine(start: Indices, stages: Indices, coefficients: Array) -> Combination:
        size = stages.shape[2]
        variables = np.concatenate((start, stages.reshape(N, S * size)), axis=1)
        return Combination(spread(coefficients, size), which, np.repeat(variables, k, axis=0))

    q, qd = (combine(start, stages, weights) for start, stages in zip(starts, slopes, strict=True))
    return Carried(q, qd, combine(layout.mesh[:-1, :0], layout.accelerations, reading.W))


def read_motion(layout: Layout, reading: Reading, h: Array) -> Carried:
    """Read a motion, without quaternions, off the states at the mesh points and the accelerations at the stages.

    Intervals of equal length share their matrices.
    """
    (N, S, n), k = layout.accelerations.shape, len(reading.c)
    carried = layout.mesh[:-1, layout.motions.carried]
    variables = np.concatenate((carried, layout.accelerations.reshape(N, S * n)), axis=1)
    lengths, kind = (h[:1], np.zeros(N, dtype=np.int64)) if layout.grid.is_equal else (h, np.arange(N))
    which, repeated = (kind[:, None] * k + np.arange(k)).ravel(), np.repeat(variables, k, axis=0)
    step = np.repeat(lengths, k)
    c, V, P, W = (
        np.tile(part, (len(lengths), *[1] * (part.ndim - 1))) for part in (reading.c, reading.V, reading.P, reading.W)
    )
    one, zero = np.ones(step.size), np.zeros(step.size)

    def combine(q: Array, qd: Array, weights: Array) -> Combination:
        """Combine with a coefficient of q_k and of qd_k for each kind of place, and of accelerations, (kinds, S)."""
        coefficients = np.concatenate((q[:, None], qd[:, None], weights), axis=1)
        return Combination(spread(coefficients, n), which, repeated)

    return Carried(
        q=combine(one, step * c, step[:, None] ** 2 * P),
        qd=combine(zero, one, step[:, None] * V),
        qdd=combine(zero, zero, W),
    )


def at_mesh(layout: Layout, integrator: Integrator, k: Sequence[int]) -> Places:
    """Return some mesh points, with the inputs of the interval before; the first has the inputs of the interval after.

    Accelerations there, and inputs that are polynomials, are read off the stages of that interval.
    """
    at, stages = np.array(k, dtype=np.int64), layout.every_acceleration
    interval = np.maximum(at - 1, 0)
    q, qd = (part.T for part in layout.split(layout.mesh[at]))
    s = layout.grid.mesh()[at] if layout.grid.fractions else at / layout.grid.intervals
    none, which = np.zeros((0, at.size), dtype=np.int64), (at > 0).astype(np.int64)
    qdd: Column = none
    if stages.size:
        matrices = spread(integrator.ends.W, stages.shape[2])
        qdd = Combination(matrices, which, stages[interval].reshape(at.size, matrices.shape[2]))
    u, controls, w, a, tau = _read_inputs(layout, integrator.ends, which, interval)
    yd = qd[layout.motions.moved_velocities]
    return Places(q, qd, qdd, u, s, at, interval, yd, none, layout.extras.states[at].T, controls, w, a, tau)


def _read_inputs(
    layout: Layout, reading: Reading, which: Indices, interval: Indices
) -> tuple[Column, Column, Column, Column, Column]:
    """Return inputs, controls, components of wrenches, and accelerations and forces of driven joints at places.

    Place k is reading.c[which[k]] of its interval. Polynomials through the values at the stages give the others.
    """
    extras, one = layout.extras, np.ones((len(reading.c), 1))

    def group(entries: Sequence[int], constant: Indices, points: Indices) -> Group:
        if points.size:
            return Group(tuple(entries), points[interval], reading.W)
        return Group(tuple(entries), constant[interval, None], one)

    def read(points: Indices) -> Column:
        size = points.shape[2]
        return mix(size, (Group(tuple(range(size)), points[interval], reading.W),), which)

    nc = extras.controls.shape[1] + extras.point_controls.shape[2]
    own = group(extras.free, layout.inputs, layout.point_inputs)
    given = Group(extras.given, extras.forces[interval], reading.W)
    courses = [group(extras.varying or range(nc), extras.controls, extras.point_controls[:, :, extras.varying])]
    if extras.steady:
        held = extras.point_controls[:, 0, list(extras.steady)]
        courses.append(group(extras.steady, held, extras.point_controls[:, :, :0]))
    return (
        mix(extras.m, (own, given), which),
        mix(nc, tuple(courses), which),
        read(extras.wrenches),
        read(layout.drives),
        read(layout.driving),
    )


def spread(coefficients: Array, n: int) -> Array:
    """Repeat coefficients (places, width) for n entries alike: (places, n, width * n)."""
    whole = coefficients[:, None, :, None] * np.eye(n)[None, :, None, :]
    return np.asarray(whole.reshape(len(coefficients), n, coefficients.shape[1] * n))


class Entries:
    """Entries of a sparse matrix, collected; exact zeros are left out, entries of one place are summed."""

    def __init__(self) -> None:
        self.parts: list[tuple[Indices, Indices, Array]] = []

    def put(self, row: ArrayLike, col: ArrayLike, value: ArrayLike) -> None:
        """Add entries; the three are broadcast against each other."""
        row, col, values = np.broadcast_arrays(row, col, np.asarray(value, dtype=np.float64))
        kept = values.ravel() != 0.0
        self.parts.append((row.ravel()[kept], col.ravel()[kept], values.ravel()[kept]))

    def put_part(self, rows: Indices, part: Combination, entries: Sequence[int]) -> None:
        """Add some entries of a part of the variables at every place: rows are (places, entries)."""
        coefficients = part.matrices[part.which][:, list(entries)]  # (places, entries, width)
        self.put(rows[:, :, None], part.variables[:, None, :], coefficients)

    def matrix(self, shape: tuple[int, int]) -> Matrix:
        """Return the matrix."""
        row, col, value = (np.concatenate(part) for part in zip(*self.parts, strict=True))
        matrix = sparse.coo_array((value, (row, col)), shape=shape).tocsc()
        matrix.sum_duplicates()
        return matrix
