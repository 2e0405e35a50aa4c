"""The usual sizes of states and controls that are guessed as 0 and have no bounds: by the rates, over the horizon.

A guess, a bound or an end that is not 0 is a size. Others follow from the rates r along the guess, whose horizon is T:

    a state s changes by T |r_s|: a velocity from rest to rest under gravity,
    a state or control z that moves a state s of known size balances its rate, |z| = R / |dr_s/dz|: a velocity, where
    positions are known, and then a force. R is the largest of |s| / T, |r_s|, and the terms of other known sizes.
    Where the slope is 0, the curvature counts, |z|^2 = 2 R / |d2r_s/dz2|: a force whose square a budget limits.
    Where z moves several states, the least of these sizes counts.

The larger of both counts. A size that is found this way gives sizes to others in turn.

Where nothing else gives a state a size, it has what terms of known sizes and reaches let it reach from 0, T (|r_s| +
sum |dr_s/dz| |z|), if that is small: a force of at most 1e-9 N. Larger reaches are limits that a state may stay far
from.
The same holds for a tree at rest at 0, by its accelerations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mbsgen.expressions import evaluate, names, parse
from mbsgen.roles import Role
from mbsrun.jets import Jet, Mask, make_jets, vary
from mbsrun.ocp.evaluation.values import Parts, Values
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.state_guess import list_parts
from mbsrun.ocp.problem.problem import Problem, Range, State

REACH = 1e-4  # the largest reach that is a size
ROUNDED = 1e-9  # computed sizes below this are zeros that rounded; numbers of a file are none


def size_added(motion: Trajectory, problem: Problem, plant: Plant) -> Trajectory:
    """Return a complete motion in which open states and controls that are guessed as 0 have their usual sizes.

    So has a mechanism that rests at 0 with tiny limits of inputs. It is the same motion where all have a size.
    """
    motion, states = _size_moving(motion, problem, plant), problem.every_state
    guessed = np.concatenate([_find_largest(motion.states), _find_largest(motion.controls)])
    stated = np.concatenate([[_find_stated(state) for state in states], guessed[len(states) :]])
    sizes = np.maximum(np.where((stated == 0) & (guessed < ROUNDED), 0.0, guessed), stated)
    limits = [*(state.bounds for state in states), *(control.bounds for control in problem.controls)]
    closed = np.array([_find_magnitude(pair) if np.isfinite(pair).all() else 0.0 for pair in limits])
    known = np.where(sizes == 0, closed, sizes)
    if states and (known == 0).any():
        found = _spread_sizes(known, *_differentiate_rates(motion, problem, plant), float(motion.t[-1]))
        sizes = np.where((sizes == 0) & (closed == 0), found, sizes)
    changed = np.flatnonzero(sizes != guessed)
    return _put(motion, changed, sizes) if changed.size else motion


def _size_moving(motion: Trajectory, problem: Problem, plant: Plant) -> Trajectory:
    """Return a motion of the sizes that limits of inputs let a tree reach, where it rests at 0 and they are small.

    It is the same motion elsewhere.
    """
    parts = (motion.q, motion.qd, motion.u, motion.point_q, motion.point_qdd)
    limits = np.array([_find_magnitude(pair) if np.isfinite(pair).all() else np.inf for pair in problem.bounds.u])
    if not limits.size or not np.isfinite(limits).all() or any(part.any() for part in parts):
        return motion
    is_tree = not (plant.manifest.dependent or plant.manifest.driven)
    read = {port.name for port in plant.describe("impl").inputs if port.role not in (Role.SETUP, Role.DESIGN)}
    if not is_tree or read != {"q", "qd", "qdd", "u"}:
        return motion
    a, T = _find_acceleration(limits, motion.qd.shape[1], plant), float(motion.t[-1])
    if not 0 < a * T**2 < REACH:
        return motion
    return replace(
        motion,
        q=motion.q + a * T**2,
        qd=motion.qd + a * T,
        point_q=motion.point_q + a * T**2,
        point_qd=motion.point_qd + a * T,
        point_qdd=motion.point_qdd + a,
    )


def _find_acceleration(limits: Array, n: int, plant: Plant) -> float:
    """Return the largest acceleration M^-1 (|Q| + |c|) at rest, by inputs within limits (m,) and all other forces."""
    m, rest = limits.size, np.zeros((1 + n + limits.size, n))
    qdd, u = rest.copy(), np.zeros((1 + n + m, m))
    qdd[1 : n + 1], u[n + 1 :] = np.eye(n), np.diag(limits)
    Phi = plant("impl", q=rest, qd=rest, qdd=qdd, u=u)["Phi"].reshape(1 + n + m, n)
    forces = np.abs(Phi[0]) + np.abs(Phi[n + 1 :] - Phi[0]).sum(axis=0)
    try:
        return float((np.abs(np.linalg.inv((Phi[1 : n + 1] - Phi[0]).T)) @ forces).max())
    except np.linalg.LinAlgError:
        return 0.0


def _spread_sizes(sizes: Array, rates: Array, slopes: Array, curvatures: Array, T: float) -> Array:
    """Return sizes (n,) with the unknown ones, 0, found from rates (ns,) of states and their derivatives (ns, n)."""
    sizes, ns = sizes.copy(), len(rates)
    changes = np.concatenate([rates * T, np.zeros(len(sizes) - ns)])
    changes[changes < ROUNDED] = 0.0
    while True:
        balanced = np.maximum(np.maximum(sizes[:ns] / T, rates), (slopes * sizes).max(axis=1, initial=0.0))
        moved = _balance(balanced[:, None], sizes[:ns, None] > 0, slopes, curvatures).min(axis=0, initial=np.inf)
        found = np.maximum(changes, np.where(np.isfinite(moved), moved, 0.0))
        is_new = (sizes == 0) & (found > 0)
        if not is_new.any():
            found = np.concatenate([_find_reach(sizes, rates, slopes, T), np.zeros(len(sizes) - ns)])
            is_new = (sizes == 0) & (found > 0)
        if not is_new.any():
            return sizes
        sizes[is_new] = found[is_new]


def _balance(balanced: Array, is_known: Mask, slopes: Array, curvatures: Array) -> Array:
    """Return the sizes (ns, n) by which states and controls balance rates (ns, 1); infinite where they have no part."""
    moves, bends = is_known & (slopes > 0), is_known & (slopes == 0) & (curvatures > 0)
    moved = np.where(moves, balanced / np.where(moves, slopes, 1.0), np.inf)
    return np.where(bends, np.sqrt(2 * balanced / np.where(bends, curvatures, 1.0)), moved)


def _find_reach(sizes: Array, rates: Array, slopes: Array, T: float) -> Array:
    """Return what states (ns,) reach from 0 by terms of known sizes and reaches, if it is small; else 0."""
    slopes, reached = slopes.copy(), sizes.copy()
    np.fill_diagonal(slopes, 0.0)  # a state moves others, not itself
    for _ in rates:
        is_known = ((slopes == 0) | (reached > 0)).all(axis=1) & (reached[: len(rates)] == 0)
        reach = np.where(is_known, T * (rates + slopes @ reached), 0.0)
        reached[: len(rates)] += np.where(np.isfinite(reach), reach, 0.0)
    return np.where(reached < REACH, reached, 0.0)[: len(rates)]


def _differentiate_rates(motion: Trajectory, problem: Problem, plant: Plant) -> tuple[Array, Array, Array]:
    """Return the largest rates (ns,) along a motion, and their first and second derivatives (ns, ns + nc).

    The derivatives are by states and controls, the second ones by each of them twice.
    """
    parts, states = list_parts(motion, plant), problem.every_state
    added = [*(state.name for state in states), *(control.name for control in problem.controls)]
    rates = Values([state.rate for state in states], problem, plant)(parts)
    derivatives = np.stack([_differentiate(state.rate, added, parts, problem, plant) for state in states])
    return _find_largest(rates), derivatives[:, 0], derivatives[:, 1]


def _differentiate(text: str, added: Sequence[str], parts: Parts, problem: Problem, plant: Plant) -> Array:
    """Return the largest magnitudes of an expression's first and second derivatives by some names, (2, names)."""
    expression = parse(text)
    every = sorted(names(expression))
    if not (read := [name for name in every if name in added]):
        return np.zeros((2, len(added)))
    n, values = len(read), Values(every, problem, plant)(parts)
    jets: Mapping[str, Jet] = {
        name: vary(column, read.index(name), n) if name in read else Jet(column, np.zeros((1, n)), np.zeros((1, n, n)))
        for name, column in zip(every, values.T, strict=True)
    }
    with np.errstate(all="ignore"):
        jet = evaluate(expression, jets, make_jets(n))
    slopes = _find_largest(jet.g.reshape(-1, n))
    curvatures = _find_largest(np.diagonal(jet.H.reshape(-1, n, n), axis1=1, axis2=2))
    found = dict(zip(read, zip(slopes, curvatures, strict=True), strict=True))
    return np.array([found.get(name, (0.0, 0.0)) for name in added]).T


def _put(motion: Trajectory, places: Indices, sizes: Array) -> Trajectory:
    """Put sizes into a motion in place of states and controls, by their places in the row of both."""
    ns = motion.states.shape[1]
    of_states, of_controls = places[places < ns], places[places >= ns]
    found = [array.copy() for array in (motion.states, motion.point_states, motion.controls)]
    for array, chosen, offset in zip(found, (of_states, of_states, of_controls), (0, 0, ns), strict=True):
        array[..., chosen - offset] = sizes[chosen]
    return replace(motion, states=found[0], point_states=found[1], controls=found[2])


def _find_largest(values: Array) -> Array:
    """Return the largest finite magnitude in each column."""
    return np.asarray(np.abs(np.nan_to_num(values, posinf=0.0, neginf=0.0)).max(axis=0, initial=0.0))


def _find_magnitude(limits: Range) -> float:
    """Return the largest finite magnitude of two limits; 0 where both are infinite."""
    return max((abs(limit) for limit in limits if np.isfinite(limit)), default=0.0)


def _find_stated(state: State) -> float:
    """Return the largest number that a file gives a state at its ends or as its guess."""
    guess = state.guess if isinstance(state.guess, tuple) else (state.guess or 0.0,)
    return max(_find_magnitude((a, b)) for a, b in (state.start, state.end, (min(guess), max(guess))))
