"""A first guess: a motion on a problem's grid, and the inputs that go with it.

The motion is rest at the start, or the joints move smoothly to a pose that meets the targets, found by inverse
kinematics; or it is an earlier solution, read on another grid. Its inputs are 0, the forces that hold each pose, or the
inverse dynamics of the motion, u = B^+ Phi(q, qd, qdd, 0) with Phi = M qdd + c - B u.

Closed loops stay closed along the motion: the independent coordinates move smoothly, and Newton's method finds the
others from point to point. Where that fails, all coordinates move smoothly, and each pose is closed. Inputs are then
u = (Z'B)^+ Z'Phi, with the columns of Z a basis of the velocities that keep the loops closed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mbsrun.closure import Closure, find_closure
from mbsrun.ocp.ground.grid import Grid
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.schemes import Family, Scheme, build
from mbsrun.ocp.ground.trajectory import NONE, Trajectory, resample
from mbsrun.ocp.guessing.state_guess import complete
from mbsrun.ocp.problem.contacts import list_held
from mbsrun.ocp.problem.driving import Guide, choose_rows, follow, give_nothing
from mbsrun.ocp.problem.given import place_unknown
from mbsrun.ocp.problem.problem import Inputs, Problem
from mbsrun.quantities import name_components
from mbsrun.quaternions import (
    find_rates,
    find_turn,
    find_velocities,
    list_divided,
    list_entries,
    list_quaternions,
    measure_lengths,
    normalise,
    turn,
)

Array = NDArray[np.float64]

REACHED = 1e-5  # the largest distance from the targets that counts as none [m, rad]
STARTS = 20  # poses to search from, before a target counts as out of reach
STEP = 1e-6  # of central differences [rad, m]
NEARNESS = 1e-6  # weight of the distance from the start, which chooses among poses that meet the targets
Curve = tuple[np.polynomial.Polynomial, ...]  # in t / T, with its derivatives of orders 1 and 2


def _list_derivatives(*coefficients: float) -> Curve:
    curve = np.polynomial.Polynomial(coefficients)
    return curve, curve.deriv(), curve.deriv(2)


_WAY = _list_derivatives(0, 0, 0, 10, -15, 6)  # from 0 to 1, at rest at both ends
_LINE, _NOTHING = _list_derivatives(0, 1), _list_derivatives(0)
_RUN_OUT = _list_derivatives(0, 1, 0, -6, 8, -3)  # leaves 0 at speed 1, and is back at 0, at rest


@dataclass(frozen=True)
class Pose:
    """A pose that inverse kinematics found."""

    q: Array
    distance: float  # the largest from a target [m, rad]
    is_upright: bool  # whether the frames that shall point up do
    has_way: bool = True  # whether a motion from the start to it was found that keeps loops closed

    @property
    def is_reached(self) -> bool:
        """Return whether the targets are met."""
        return self.distance <= REACHED


def find_pose(problem: Problem, plant: Plant) -> Pose:
    """Find a pose within the bounds in which sensors and coordinates are at their targets.

    Frames of `problem.guess.upright` point up in it if they can. The search goes on from other poses, always the same,
    where it fails from the start; a pose that is not reached is the nearest one found.
    """
    kinematics = _Kinematics(problem, plant)
    if (given := kinematics.read_coordinates(problem.guess.upright)) is not None:
        return given
    pose = kinematics.search(problem.guess.upright)
    return pose if pose.is_reached else kinematics.search(())


def scatter_poses(problem: Problem, plant: Plant, rng: np.random.Generator, tries: int) -> Array | None:
    """Find a pose that meets the targets from random poses within the bounds; None where `tries` of them do not.

    Other poses than the result of `find_pose` meet the same targets where inverse kinematics has several branches.
    """
    kinematics = _Kinematics(problem, plant)
    lower, upper = kinematics.extent()
    for _ in range(tries):
        pose = kinematics.descend(rng.uniform(lower, upper), ())
        if pose.is_reached:
            return pose.q
    return None


def make_guess(problem: Problem, plant: Plant, scheme: Scheme) -> Trajectory | Pose:
    """Make the guess that a problem describes; return the nearest pose found where none meets its targets."""
    if problem.guess.start:
        start = np.array(problem.start_q)
        start[[i for i, _ in problem.guess.start]] = [value for _, value in problem.guess.start]
        problem = replace(problem, start_q=tuple(start.tolist()))
    if not plant.manifest.coordinates:
        return rest(problem, scheme, plant)
    if problem.guess.motion == "rest":
        return balance(rest(problem, scheme, plant), problem, plant, problem.guess.inputs)
    pose = _choose_pose(problem) if problem.guess.end else find_pose(problem, plant)
    if not pose.is_reached:
        return pose
    motion = interpolate(problem, scheme, pose.q, plant)
    if not np.isfinite(motion.point_q).all():
        return replace(pose, has_way=False)
    return balance(motion, problem, plant, problem.guess.inputs)


def _choose_pose(problem: Problem) -> Pose:
    """Return the pose at the end that a problem guesses; coordinates without a guess or a value stay at the start's."""
    q = np.array(problem.start_q)
    for i, value in (*problem.end.coordinates, *problem.guess.end):
        q[i] = value
    return Pose(q, 0.0, is_upright=True)


def rest(problem: Problem, scheme: Scheme, plant: Plant | None = None) -> Trajectory:
    """Stay at the start, at rest. Inputs are 0. Where there are quaternions, the plant is needed."""
    still = replace(problem, start_qd=(0.0,) * len(problem.start_qd), guess=replace(problem.guess, motion="rest"))
    return interpolate(still, scheme, np.array(problem.start_q), plant)


def interpolate(problem: Problem, scheme: Scheme, q: Array, plant: Plant | None = None) -> Trajectory:
    """Move from the start, with its velocity, to rest at the pose q: a polynomial of degree 5 in time. Inputs are 0.

    A problem that guesses a line moves at constant velocity.

    Quaternions turn by the shorter way, about one axis, by that polynomial of the angle; for their velocities the plant
    is needed. Raises ValueError without. Where closed loops have no such motion, the numbers are not finite.
    """
    if problem.has_quaternions and plant is None:
        raise ValueError("the rates of quaternions are not their velocities: give the plant, which knows both")
    T, start, speed = problem.horizon, np.array(problem.start_q), np.array(problem.start_qd)
    traced = _trace(problem.guess.motion == "line", T, problem.grid, scheme.family, scheme.degree)
    changes = speed if plant is None else find_rates(plant, start, speed)
    turning = () if plant is None else list_quaternions(plant.manifest)

    def read(curves: _Curves, order: int) -> Array:
        w, r = (curve[order] for curve in curves)
        return np.asarray((start if order == 0 else 0.0) + (w * (q - start) + r * changes * T) / T**order)

    def move(curves: _Curves) -> tuple[Array, Array, Array]:
        """Return q, qd and qdd; without quaternions, these are q and its derivatives."""
        motion = read(curves, 0), read(curves, 1), read(curves, 2)
        if plant is None or not turning:
            return motion
        w, r = (np.stack([values / T**k for k, values in enumerate(curve)]) for curve in curves)
        for x in turning:
            way, run_out = find_turn(start[x.entries], q[x.entries]), T * speed[x.spins]
            for part, turned in zip(motion, turn(start[x.entries], way, w, run_out, r), strict=True):
                part[..., x.entries] = turned
        return motion[0], *find_velocities(plant, *motion)

    u = np.zeros((problem.intervals, len(problem.bounds.u)))
    motion = Trajectory(traced.t, *move(traced.at_mesh)[:2], u, traced.point_t, *move(traced.at_points))
    motion = motion if plant is None else follow(motion, problem, plant.manifest)
    closure = None if plant is None else find_closure(plant)
    return motion if closure is None else close_motion(motion, closure)


_Curves = tuple[list[Array], list[Array]]  # of the way and of the run-out: values and derivatives, (..., 1) each


@dataclass(frozen=True, eq=False)
class _Traced:
    """The curves of guesses on a grid."""

    t: Array
    point_t: Array
    at_mesh: _Curves
    at_points: _Curves


@lru_cache(maxsize=32)
def _trace(is_line: bool, T: float, grid: Grid, family: Family, degree: int) -> _Traced:
    """Evaluate the curves of guesses on a grid of a horizon T, once for all problems that share it."""
    t, point_t = grid.times(T, build(family, degree).points)
    curves = (_LINE, _NOTHING) if is_line else (_WAY, _RUN_OUT)

    def read(times: Array) -> _Curves:
        s = (times / T)[..., None]
        way, run_out = ([np.asarray(p(s)) for p in curve] for curve in curves)
        return way, run_out

    traced = _Traced(t, point_t, read(t), read(point_t))
    for values in (t, point_t, *(x for part in (traced.at_mesh, traced.at_points) for curve in part for x in curve)):
        values.flags.writeable = False
    return traced


def close_motion(motion: Trajectory, closure: Closure) -> Trajectory:
    """Close the loops along a motion that begins closed; numbers that are not finite show that none was found."""
    N, d = motion.point_t.shape
    order = np.argsort(np.concatenate((motion.t, motion.point_t.ravel())), kind="stable")
    q, qd = (
        np.concatenate((mesh, points.reshape(N * d, mesh.shape[1])))
        for mesh, points in ((motion.q, motion.point_q), (motion.qd, motion.point_qd))
    )
    found, closed = None, np.empty_like(q)
    is_whole = not list_divided(closure.manifest, closure.independent)
    driven = list(closure.manifest.driven)
    least = list_entries(closure.manifest, driven)
    for held in (closure.places_independent, least) if is_whole else (least,):
        path = closure.follow(q[order], q[0], held)
        if path is not None and (held == least or _ends_at(path[-1], motion.q[-1])):
            found = held
            closed[order] = path
            break
    if found is None:
        return replace(motion, point_q=np.full_like(motion.point_q, np.nan))
    qdd = motion.point_qdd.reshape(N * d, qd.shape[1])
    if found != least:
        found = closure.independent
        qd = closure.complete_velocities(closed, found, qd[:, found])
        qdd = closure.complete_accelerations(closed[N + 1 :], qd[N + 1 :], found, qdd[:, found])
    else:
        qd = closure.project_velocities(closed, qd, driven)
        qdd = closure.project_accelerations(closed[N + 1 :], qd[N + 1 :], qdd, driven)
    (mesh_q, point_q), (mesh_qd, point_qd) = (np.split(x, [N + 1]) for x in (closed, qd))
    return replace(
        motion,
        q=mesh_q,
        qd=mesh_qd,
        point_q=point_q.reshape(N, d, -1),
        point_qd=point_qd.reshape(N, d, -1),
        point_qdd=qdd.reshape(N, d, -1),
    )


def _ends_at(q: Array, end: Array) -> bool:
    return bool(np.abs(q - end).max(initial=0.0) <= REACHED)


def adapt(trajectory: Trajectory, problem: Problem, scheme: Scheme) -> Trajectory:
    """Read a motion, found on whatever grid, on the grid of a problem."""
    return resample(trajectory, *problem.grid.times(problem.horizon, scheme.points))


def bump(trajectory: Trajectory, coordinates: Sequence[int], rng: np.random.Generator) -> Trajectory:
    """Add smooth random bumps to some coordinates, of up to 1 rad or m; both ends keep state and acceleration.

    Raises ValueError for a motion with quaternions.
    """
    if trajectory.q.shape != trajectory.qd.shape:
        raise ValueError("a bump on a quaternion has no velocity")
    T = float(trajectory.t[-1])
    once = 64 * np.polynomial.Polynomial([0, 1]) ** 3 * np.polynomial.Polynomial([1, -1]) ** 3  # in t / T; 1 at 1/2
    there_and_back = once * np.polynomial.Polynomial([-2, 4])
    shapes = [a * once + b * there_and_back for a, b in rng.uniform(-1.0, 1.0, (len(coordinates), 2))]

    def add(values: Array, t: Array, order: int) -> Array:
        bumped = values.copy()
        for i, shape in zip(coordinates, shapes, strict=True):
            bumped[..., i] += (shape.deriv(order) if order else shape)(t / T) / T**order
        return bumped

    t, point_t = trajectory.t, trajectory.point_t
    return replace(
        trajectory,
        q=add(trajectory.q, t, 0),
        qd=add(trajectory.qd, t, 1),
        point_q=add(trajectory.point_q, point_t, 0),
        point_qd=add(trajectory.point_qd, point_t, 1),
        point_qdd=add(trajectory.point_qdd, point_t, 2),
        slopes=NONE,
    )


def balance(trajectory: Trajectory, problem: Problem, plant: Plant, inputs: Inputs) -> Trajectory:
    """Return a motion with inputs: 0, the forces that hold each pose at rest, or the inverse dynamics of the motion.

    The residual of passive joints is least in the sense of least squares. Wrenches and signals have the values that the
    problem gives or guesses. The inputs of an interval are the mean over its collocation points; they stay within their
    bounds.
    """
    u = np.zeros_like(trajectory.u)
    if inputs != "zero" and u.size:
        N, d, _ = trajectory.point_q.shape
        rates = (trajectory.point_qd, trajectory.point_qdd)
        q, qd, qdd = (
            np.ascontiguousarray(a.reshape(N * d, -1))
            for a in (trajectory.point_q, *(rate * (inputs == "dynamic") for rate in rates))
        )
        w = _find_given(replace(trajectory, u=u), problem, plant)
        held = [i for i in list_held(problem.contacts, plant.manifest) if not w[:, i].any()]
        forces = np.nan_to_num(find_inputs(plant, q, qd, qdd, w, held))
        u = forces[:, : u.shape[1]].reshape(N, d, -1).mean(axis=1)
        if held:
            w[:, held] = forces[:, u.shape[1] :]
            trajectory = replace(trajectory, point_w=w.reshape(N, d, -1))
    return replace(trajectory, u=np.clip(u, *np.array(problem.bounds.u).reshape(-1, 2).T))


def _find_given(motion: Trajectory, problem: Problem, plant: Plant) -> Array:
    """Return components of open wrenches and signals at the points of a motion (B, nw), where its inputs are 0."""
    if any(part.expression is not None for part in problem.wrenches):
        return np.array(complete(motion, problem, plant).point_w).reshape(motion.point_t.size, -1)
    w = np.zeros((motion.point_t.size, len(name_components(plant.manifest))))
    for i, value in place_unknown(problem, plant.manifest).items():
        w[:, i] = value
    return w


def find_inputs(
    plant: Plant, q: Array, qd: Array, qdd: Array, w: Array | None = None, held: Sequence[int] = ()
) -> Array:
    """Return the inputs (B, m) of least squares that leave the least of the equations of motion; 0 where B fails.

    w (B, nw) are components of open wrenches, if there are any. The ones of `held` are found too, behind the inputs.
    """
    manifest = plant.manifest
    none = np.zeros((len(q), len(manifest.actuated)))
    state = give_nothing(manifest, {"q": q, "qd": qd, "qdd": qdd, "u": none})
    if w is not None and w.size:
        state["w"] = w
    Phi = plant("impl", **state)["Phi"]
    slopes = plant("jac_impl", **state)
    B = -slopes["jac_Phi_u"]
    if held:
        B = np.concatenate((B, -slopes["jac_Phi_w"][:, :, list(held)]), axis=2)
    if not np.isfinite(B).all():
        return np.zeros((len(q), B.shape[2]))
    right = Phi[..., None]
    if manifest.dependent or manifest.driven:
        rows = [choose_rows(manifest, len(q)), *([Closure(plant).jacobian(q)] if manifest.dependent else [])]
        kept = np.concatenate(rows, axis=1)
        whole = np.linalg.svd(kept)[2]  # its last rows are velocities that keep loops closed, and driven joints at rest
        free = whole[:, kept.shape[1] :]
        B, right = free @ B, free @ right
    return np.asarray((np.linalg.pinv(_pick_different(B)) @ right)[..., 0])


def _pick_different(B: Array) -> Array:
    """Return the first of matrices (B, rows, cols) where all are the same, as of joints with a motor each; else all."""
    bits = np.ascontiguousarray(B).view(np.uint64)
    return B[:1] if B.size and (bits == bits[:1]).all() else B


class _Kinematics:
    """Inverse kinematics as a least-squares problem in the coordinates that can move.

    A quaternion's length is part of it; of the two signs of an attitude at the end, the nearer one is the target. So
    are the gaps of closed loops.
    """

    def __init__(self, problem: Problem, plant: Plant) -> None:
        self.plant = plant
        frames = plant.manifest.frames  # of a joint and a sensor with one name, the sensor is meant
        self.indices = {frame.name: i for i, frame in sorted(enumerate(frames), key=lambda f: f[1].sensor)}
        self.sensors = [(self.indices[name], np.array(place, dtype=float)) for name, place in problem.end.sensors]
        self.aims = [(self.indices[name], k, np.array(t)) for name, aims in problem.end.orientations for k, t in aims]
        self.coordinates = [i for i, _ in problem.end.coordinates]
        self.values = np.array([value for _, value in problem.end.coordinates])
        self.turning = list_quaternions(plant.manifest)
        self.start = np.array(problem.start_q)
        self.lower, self.upper = np.array(problem.bounds.q).reshape(-1, 2).T
        self.held = list(self.coordinates)
        if plant.manifest.driven:
            guide, end = Guide.of(problem, plant.manifest), np.array([problem.horizon])
            given = guide.read(end, problem.horizon)[0][0]
            for part in (self.start, self.lower, self.upper):
                part[guide.places] = given
            self.held += guide.places
        self.free = self.lower < self.upper
        self.closure = find_closure(plant)

    def search(self, upright: tuple[str, ...]) -> Pose:
        """Descend from the start, then from poses spread over the bounds; return one that is reached, or the best."""
        best = self.descend(self.start, upright)
        if best.is_reached and best.is_upright:
            return best
        for start in self.starts():
            if best.is_reached and best.is_upright:
                break
            pose = self.descend(start, upright)
            if (pose.distance, not pose.is_upright) < (best.distance, not best.is_upright):
                best = pose
        return best

    def read_coordinates(self, upright: tuple[str, ...]) -> Pose | None:
        """Return the pose that targets of coordinates give, the others at the start; None where more is to be met."""
        if self.sensors or self.aims or upright or self.turning or self.closure is not None:
            return None
        q = np.clip(self.start, self.lower, self.upper)
        q[self.coordinates] = self.values
        is_within = bool(((self.lower <= q) & (q <= self.upper)).all())
        return Pose(q, 0.0, is_upright=True) if is_within else None

    def starts(self) -> Array:
        """Spread poses over the bounds."""
        from scipy.stats import qmc  # only here, and late: it takes a while to load

        lower, upper = self.extent()
        spread = qmc.Halton(len(self.start), scramble=False).random(STARTS)
        return np.asarray(lower + spread * (upper - lower))

    def extent(self) -> tuple[Array, Array]:
        """Return the bounds; where there is none, half a turn, or pi metres, from the start."""
        least, most = self.start - np.pi, self.start + np.pi
        for x in self.turning:
            least[x.entries], most[x.entries] = -1.0, 1.0
        lower = np.where(np.isfinite(self.lower), self.lower, least)
        return lower, np.where(np.isfinite(self.upper), self.upper, most)

    def descend(self, start: Array, upright: tuple[str, ...]) -> Pose:
        """Solve the least-squares problem from one pose."""
        frames = [self.indices[name] for name in upright]
        q = np.clip(start, self.lower, self.upper)

        def complete(free: Array) -> Array:
            poses: Array = np.tile(q, (*free.shape[:-1], 1))
            poses[..., self.free] = free
            return poses

        def residual(free: Array) -> Array:
            return np.asarray(self.residual(complete(free[None]), frames)[0])

        def jacobian(free: Array) -> Array:
            steps = STEP * np.eye(len(free))
            both = self.residual(complete(np.concatenate((free + steps, free - steps))), frames)
            return np.asarray((both[: len(free)] - both[len(free) :]).T / (2 * STEP))

        if self.free.any():
            from scipy.optimize import least_squares  # here, and late: it takes long to load

            bounds = (self.lower[self.free], self.upper[self.free])
            found = least_squares(
                residual, q[self.free], jacobian, bounds, xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=100
            )
            q = normalise(complete(found.x), self.plant.manifest)
            if self.closure is not None:
                q = self.closure.close(q, self.held)
        m = 0 if self.closure is None else len(self.closure.dependent)
        places, coordinates, gaps, axes, _ = np.split(
            self.residual(q[None], frames)[0],
            np.cumsum([3 * (len(self.sensors) + len(self.aims)), len(self.coordinates), m, 3 * len(frames)]),
        )
        distances = [*np.linalg.norm(places.reshape(-1, 3), axis=1), *np.abs(coordinates), *np.abs(gaps)]
        return Pose(q, float(max(distances, default=0.0)), bool((np.abs(axes) < REACHED).all()))

    def residual(self, q: Array, upright: list[int]) -> Array:
        """Compute the residual of each pose: distances to targets, of axes too, gaps, of z axes from up, and two more.

        These are the lengths of quaternions minus 1, and a small multiple of the distance from the start.
        """
        frames = self.plant("frames", q=q) if self.sensors or self.aims or upright else {}
        places = [np.nan_to_num(frames["p"][:, :, i] - target) for i, target in self.sensors]  # NaN: free
        places += [frames["R"][:, :, 3 * i + k] - target for i, k, target in self.aims]
        coordinates = q[:, self.coordinates] - self.sign(q) * self.values
        axes = [frames["R"][:, :, 3 * i + 2] - [0.0, 0.0, 1.0] for i in upright]
        lengths = measure_lengths(q, self.plant.manifest) - 1.0
        gaps = np.zeros((len(q), 0)) if self.closure is None else self.closure.gaps(q)
        return np.concatenate([*places, coordinates, gaps, *axes, lengths, NEARNESS * (q - self.start)], axis=1)

    def sign(self, q: Array) -> Array:
        """Return the sign of each target's attitude that is nearer to the pose, for each of its entries."""
        signs = np.ones((len(q), len(self.coordinates)))
        for x in self.turning:
            at = [self.coordinates.index(i) for i in x.entries if i in self.coordinates]
            products = (q[:, [self.coordinates[k] for k in at]] * self.values[at]).sum(axis=1, keepdims=True)
            signs[:, at] = np.where(products < 0, -1.0, 1.0)
        return signs
