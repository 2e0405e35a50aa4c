"""Starts of a search among local minima: the kinds of random motions that a solve can begin from.

    bumps      the guess with smooth random bumps, which break symmetries too
    noise      the guess with random numbers added to coordinates at every point, and random inputs
    waves      the guess with large random oscillations of all coordinates, and the inputs that make them
    branches   noise or waves about a motion to another pose that meets the end's targets, if there is one
    turns      noise or waves about a motion with whole turns of a joint that has no limits, on the way to the pose

A start is a function of the problem and of the seed of its variation, so that any process can make it again. A solve
takes many iterations from such starts; all but bumps are therefore solved on a coarse mesh first (`coarsen`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Manifest
from mbsrun.closure import find_closure
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.schemes import Scheme
from mbsrun.ocp.ground.trajectory import NONE, Trajectory
from mbsrun.ocp.guessing.guess import balance, bump, close_motion, find_pose, interpolate, rest, scatter_poses
from mbsrun.ocp.guessing.state_guess import complete
from mbsrun.ocp.problem.problem import Form, Problem, Range
from mbsrun.ocp.solution.solution import Starts
from mbsrun.quaternions import normalise

Array = NDArray[np.float64]
Kind = Literal["bumps", "noise", "waves", "branches", "turns"]

WIDTHS = (0.5, 4.0)  # least and most standard deviation of noise [rad]; each start draws its own
HEIGHTS = (1.0, 4.0)  # least and most standard deviation of the first harmonic of waves [rad, m]
HARMONICS = 8  # of waves
TURNS = (1, -1, 2, -2)  # numbers of whole turns to try, of each joint without limits
TRIES = 20  # random poses from which to look for a branch
FINE, LEAST = 40, 16  # the fewest intervals of a problem that is solved on a coarse mesh first, and of that mesh
COARSE, DEGREE, ITERATIONS = (2, 5), 3, 200  # divisors of the intervals, degree, limit of a coarse solve
HOPS = (0.5, 2.5)  # as `HEIGHTS`, for waves on an earlier solution
MOST_STEPS = 100  # of shooting, in an interval of a coarse mesh


@dataclass(frozen=True)
class Variation:
    """One random start: its kind, and the seed of its random numbers."""

    kind: Kind
    seed: tuple[int, ...]
    turn: tuple[int, int] | None = None  # index into q, whole turns added


def list_turning(problem: Problem, manifest: Manifest) -> tuple[int, ...]:
    """List the entries of q that whole turns can be added to: angles without bounds or a value at the end."""
    angles = {c.name for c in manifest.coordinates if c.motion == "revolute"}
    fixed = {i for i, _ in problem.end.coordinates}
    return tuple(
        i
        for i, (name, limits) in enumerate(zip(manifest.positions, problem.bounds.q, strict=True))
        if name in angles and i not in fixed and limits == (-math.inf, math.inf)
    )


def count_turns(trajectory: Trajectory, problem: Problem, manifest: Manifest) -> str:
    """Name the whole turns that joints without limits make from start to end, such as "q1 +2"; "" for none."""
    change = (trajectory.q[-1] - trajectory.q[0]) / (2 * np.pi)
    counts = {manifest.positions[i]: round(float(change[i])) for i in list_turning(problem, manifest)}
    return ", ".join(f"{name} {count:+d}" for name, count in counts.items() if count)


def describe_turns(turns: str) -> str:
    """Describe turns: "with +2 turns of q1"."""
    told = (part.rpartition(" ") for part in turns.split(", ") if part)
    return ", ".join(f"with {count} turn{'s' * (abs(int(count)) > 1)} of {name}" for name, _, count in told)


def describe_starts(starts: Starts) -> str:
    """Describe the lowest cost and the number of starts that found it, in words."""
    made, best = len(starts.results), starts.best
    if best is None:
        return f"no solution in {made} starts"
    times = "once" if starts.times == 1 else f"{starts.times} times"
    turns = f" ({describe_turns(best.turns)})" if best.turns else ""
    hops = f", by {len(starts.hops)} hops from the best of them" if starts.hops and not starts.times else ""
    return f"the lowest cost{turns} was found {times} in {made} starts{hops}; lower ones may exist"


def vary(
    variation: Variation, problem: Problem, plant: Plant, scheme: Scheme, bumped: Sequence[int]
) -> Trajectory | None:
    """Make the motion of a variation on the problem's grid; None where no motion leads to a pose of the end's targets.

    `bumped` are the coordinates that bumps move. Raises ValueError for bumps on a motion with quaternions.
    """
    rng = np.random.default_rng(variation.seed)
    motion = _move(variation, problem, plant, scheme, rng)
    if motion is None or not np.isfinite(motion.point_q).all():
        return None
    return disturb(motion, variation.kind, problem, plant, bumped, rng)


def disturb(
    motion: Trajectory, kind: Kind, problem: Problem, plant: Plant, bumped: Sequence[int], rng: np.random.Generator
) -> Trajectory:
    """Add bumps, waves or noise to a motion; raises ValueError for bumps on a motion with quaternions."""
    if kind == "bumps":
        return balance(_close(bump(motion, bumped, rng), plant), problem, plant, "dynamic")
    is_mixed = kind in ("branches", "turns")
    if not problem.has_quaternions and (kind == "waves" or (is_mixed and rng.uniform() < 0.5)):
        return balance(_close(add_waves(motion, problem, rng), plant), problem, plant, "dynamic")
    whole = complete(balance(motion, problem, plant, problem.guess.inputs), problem, plant)
    return _close(add_noise(whole, problem, plant.manifest, rng), plant)


def add_noise(motion: Trajectory, problem: Problem, manifest: Manifest, rng: np.random.Generator) -> Trajectory:
    """Add normal noise to coordinates and states at every point, and take random inputs; all of it within the bounds.

    Its width is drawn between `WIDTHS`; of coordinates in metres and of states that the problem adds, a quarter of the
    range between their bounds counts as 1 rad. Inputs and controls are uniform between their bounds; without these, up
    to the width times the largest of the motion.
    """
    width = float(np.exp(rng.uniform(*np.log(WIDTHS))))
    lengths = {c.name for c in manifest.coordinates if c.motion == "prismatic"}
    scales = np.array(
        [
            (limits[1] - limits[0]) / 4 if name in lengths and np.isfinite(limits).all() else 1.0
            for name, limits in zip(manifest.positions, problem.bounds.q, strict=True)
        ]
    )

    def move(q: Array) -> Array:
        noisy = _clip(q + width * scales * rng.normal(size=q.shape), problem.bounds.q)
        return normalise(noisy, manifest)

    def draw(u: Array, bounds: Sequence[Range]) -> Array:
        largest = width * np.abs(u).max(axis=0, initial=0.0)
        ends = np.array(bounds).reshape(-1, 2).T
        lower, upper = np.where(np.isfinite(ends), ends, [-largest, largest])
        return _clip(rng.uniform(np.minimum(lower, upper), np.maximum(lower, upper), u.shape), bounds)

    u = draw(motion.u, problem.bounds.u)
    none = {"point_u": NONE, "point_controls": NONE, "slopes": NONE}  # which follow from the others
    moved = replace(motion, q=move(motion.q), point_q=move(motion.point_q), u=u, **none)
    if not (problem.every_state or problem.controls):
        return moved
    limits = [state.bounds for state in problem.every_state]
    ranges = np.diff(np.array(limits).reshape(-1, 2), axis=1)[:, 0]
    sizes = np.where(np.isfinite(ranges), ranges / 4, 1.0)
    states, point_states = (
        _clip(x + width * sizes * rng.normal(size=x.shape), limits) for x in (motion.states, motion.point_states)
    )
    controls = draw(motion.controls, [control.bounds for control in problem.controls])
    return replace(moved, states=states, point_states=point_states, controls=controls)


def hop(motion: Trajectory, problem: Problem, plant: Plant, seed: tuple[int, ...]) -> Trajectory:
    """Add waves to a motion, and return it with the inputs of its inverse dynamics."""
    waved = add_waves(motion, problem, np.random.default_rng(seed), HOPS)
    return balance(_close(waved, plant), problem, plant, "dynamic")


def _close(motion: Trajectory, plant: Plant) -> Trajectory:
    """Close the loops along a motion from point to point; where that fails, close each pose by itself."""
    closure = find_closure(plant)
    closed = motion if closure is None else close_motion(motion, closure)
    if closure is None or np.isfinite(closed.point_q).all():
        return closed

    q, qd = closure.project(motion.q, motion.qd)
    point_q, point_qd = closure.project(motion.point_q, motion.point_qd)
    return replace(motion, q=q, qd=qd, point_q=point_q, point_qd=point_qd)


def add_waves(
    motion: Trajectory, problem: Problem, rng: np.random.Generator, heights: tuple[float, float] = HEIGHTS
) -> Trajectory:
    """Add random oscillations to all coordinates, none of them a quaternion's; both ends keep state and acceleration.

    Amplitudes are normal and fall with the number of the harmonic; the first deviation is drawn between `heights`.
    Coordinates are cut at their bounds, velocities and accelerations not.
    """
    T, n = float(motion.t[-1]), motion.q.shape[1]
    height = float(np.exp(rng.uniform(*np.log(heights))))
    number = np.arange(1, HARMONICS + 1)
    amplitude = height * rng.normal(size=(n, HARMONICS)) / number
    phase = rng.uniform(0, 2 * np.pi, (n, HARMONICS))
    window = 64 * np.polynomial.Polynomial([0, 1]) ** 3 * np.polynomial.Polynomial([1, -1]) ** 3  # in t / T

    def wave(t: Array, order: int) -> Array:
        """Return a derivative of the product of window and oscillations: Leibniz's rule."""
        s, total = t[..., None] / T, np.zeros((*t.shape, n))
        for k in range(order + 1):
            angle = np.pi * number * s[..., None] + phase + k * np.pi / 2
            oscillation = (amplitude * (np.pi * number) ** k * np.sin(angle)).sum(axis=-1)
            total += math.comb(order, k) * (window.deriv(order - k) if order > k else window)(s) * oscillation
        return np.asarray(total / T**order)

    return replace(
        motion,
        q=_clip(motion.q + wave(motion.t, 0), problem.bounds.q),
        qd=motion.qd + wave(motion.t, 1),
        point_q=_clip(motion.point_q + wave(motion.point_t, 0), problem.bounds.q),
        point_qd=motion.point_qd + wave(motion.point_t, 1),
        point_qdd=motion.point_qdd + wave(motion.point_t, 2),
        slopes=NONE,
    )


def coarsen(problem: Problem, variation: Variation) -> Problem | None:
    """Return a problem on a coarse mesh, for a first solve from a variation; None where its own is coarse enough.

    A coarser mesh has fewer minima, a finer one is nearer to the problem: variations take one or the other.
    """
    if problem.intervals < FINE or variation.kind == "bumps":
        return None
    divisor = COARSE[int(np.random.default_rng((*variation.seed, 1)).integers(len(COARSE)))]
    solver = replace(problem.solver, max_iterations=min(problem.solver.max_iterations, ITERATIONS))
    degree = min(problem.degree, DEGREE)
    steps = problem.steps
    if problem.form is Form.SHOOTING:
        steps = min(steps * divisor, MOST_STEPS)
    intervals = max(problem.intervals // divisor, LEAST)
    return replace(problem, intervals=intervals, mesh=None, degree=degree, steps=steps, solver=solver)


def _move(
    variation: Variation, problem: Problem, plant: Plant, scheme: Scheme, rng: np.random.Generator
) -> Trajectory | None:
    """Make the motion to which noise or bumps are added."""
    if variation.kind == "branches":
        q = scatter_poses(problem, plant, rng, TRIES)
        return None if q is None else interpolate(problem, scheme, q, plant)
    if problem.guess.motion == "rest" and variation.turn is None:
        return rest(problem, scheme, plant)
    pose = find_pose(problem, plant)
    if not pose.is_reached:
        return None
    q = pose.q.copy()
    if variation.turn is not None:
        q[variation.turn[0]] += 2 * np.pi * variation.turn[1]
    return interpolate(problem, scheme, q, plant)


def _clip(values: Array, bounds: Sequence[Range]) -> Array:
    return np.asarray(np.clip(values, *np.array(bounds).reshape(-1, 2).T))
