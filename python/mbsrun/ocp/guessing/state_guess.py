"""The first guess of the parts that a problem adds to a motion: its states, its controls, what expressions give.

A control is held at its guess. A state is held, or goes straight from a number to another; else it is integrated along
the guessed motion from its start, s' = rate(t, q, qd, qdd, u, s), by LSODA at a loose tolerance. Where that fails, as
with a rate that has a pole on the way, the state is held at its start. A state that is an input itself goes through the
guessed inputs. Unknown components of wrenches are held; what expressions give follows from all others. The guess of an
unknown that bounds expressions is their largest value along the guessed motion.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mbsrun.ocp.evaluation.values import GivenValues, Values
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.driving import find_point_forces, follow
from mbsrun.ocp.problem.problem import Problem, Range, State
from mbsrun.quantities import name_components

Array = NDArray[np.float64]

TOLERANCE = 1e-4  # relative; a hundredth of it absolute
MAX_CALLS = 20_000  # of the rates


class _TooLongError(Exception):
    """The rates were computed too often."""


def complete(motion: Trajectory, problem: Problem, plant: Plant) -> Trajectory:
    """Return a motion with guesses of the unknowns, states and controls that it lacks; others stay as they are."""
    is_new = motion.unknowns.size != len(problem.unknowns)
    if is_new:
        motion = replace(motion, unknowns=np.array([unknown.guess for unknown in problem.unknowns]))
    motion = follow(motion, problem, plant.manifest)
    states, controls = problem.every_state, problem.controls
    if motion.controls.shape[1] != len(controls):
        values = np.array([np.clip(control.guess, *control.bounds) for control in controls])
        motion = replace(motion, controls=np.tile(values, (len(motion.u), 1)))
    if motion.states.shape[1] != len(states):
        motion = _add_states(motion, problem, plant)
    motion = _add_given(motion, problem, plant) if problem.forces or plant.manifest.open_entries else motion
    return guess_largest(motion, problem, plant) if is_new else motion


def guess_largest(motion: Trajectory, problem: Problem, plant: Plant) -> Trajectory:
    """Return a motion whose unknowns that bound expressions are the largest values of these along it."""
    unknowns = motion.unknowns.copy()
    for i, unknown in enumerate(problem.unknowns):
        if unknown.largest:
            found = Values(unknown.largest, problem, plant)(list_parts(motion, plant))
            unknowns[i] = max(found[np.isfinite(found)], default=unknown.guess)
    return replace(motion, unknowns=unknowns)


def list_parts(motion: Trajectory, plant: Plant) -> dict[str, Array]:
    """List the parts of a motion at its points, (N d, size) each."""
    N, d = motion.point_t.shape
    u, controls = motion.spread_inputs()
    whole = {
        "q": motion.point_q,
        "qd": motion.point_qd,
        "qdd": motion.point_qdd,
        "states": motion.point_states,
        "controls": controls,
        "u": u,
    }
    parts = {kind: array.reshape(N * d, array.shape[2]) for kind, array in whole.items()}
    parts |= {"t": motion.point_t.reshape(-1, 1), "T": np.full((N * d, 1), motion.t[-1])}
    if motion.point_w.shape[2] == len(name_components(plant.manifest)):
        parts["w"] = motion.point_w.reshape(N * d, -1)
    parts["unknowns"] = np.tile(motion.unknowns, (N * d, 1))
    if plant.manifest.driven:
        parts["tau"] = find_point_forces(plant, motion)[1].reshape(N * d, -1)
    return parts


def _add_given(motion: Trajectory, problem: Problem, plant: Plant) -> Trajectory:
    """Add what expressions give, and unknown components of wrenches; 0 where an expression has no value."""
    (N, d), m = motion.point_t.shape, motion.u.shape[1]
    found = GivenValues(problem, plant)(list_parts(motion, plant))
    point_u, point_w = (np.nan_to_num(found[kind], posinf=0, neginf=0).reshape(N, d, -1) for kind in ("u", "w"))
    if not problem.forces:
        return replace(motion, point_w=point_w)
    return replace(motion, point_u=point_u.reshape(N, d, m), point_w=point_w)


def _add_states(motion: Trajectory, problem: Problem, plant: Plant) -> Trajectory:
    """Add all states."""
    states = problem.every_state
    t = np.unique(np.concatenate((motion.t, motion.point_t.ravel())))
    values = _guess(states, t, motion, problem, plant)
    return replace(motion, states=_read(values, t, motion.t), point_states=_read(values, t, motion.point_t))


def _read(values: Array, t: Array, times: Array) -> Array:
    """Read values (K, ns) at some of the times t (K,)."""
    return values[np.searchsorted(t, times)]


def _guess(states: tuple[State, ...], t: Array, motion: Trajectory, problem: Problem, plant: Plant) -> Array:
    """Return the values of all states at times t (K,): shape (K, ns)."""
    ends = [_choose_ends(state) for state in states]
    straight = (pair or [_find_start(state)] * 2 for state, pair in zip(states, ends, strict=True))
    values = np.stack([np.interp(t, t[[0, -1]], pair) for pair in straight], axis=1)
    given = {force.expression: force.input for force in problem.forces}
    known = [i for i, pair in enumerate(ends) if pair is None and states[i].name in given]
    middles = (motion.t[:-1] + motion.t[1:]) / 2
    for i in known:
        values[:, i] = np.interp(t, middles, motion.u[:, given[states[i].name]])
    integrated = [i for i, pair in enumerate(ends) if pair is None and i not in known]
    if integrated:
        found = _integrate(values, integrated, t, motion, problem, plant)
        if found is not None:
            values[:, integrated] = found
    lower, upper = np.array([state.bounds for state in states]).T
    return np.clip(values, lower, upper)


def _choose_ends(state: State) -> tuple[float, float] | None:
    """Return the first and last value of a straight guess; None where the state is integrated."""
    if state.guess is None:
        given = [pair[0] for pair in (state.start, state.end) if pair[0] == pair[1]]
        return (given[0], given[1]) if len(given) == 2 else None
    return state.guess if isinstance(state.guess, tuple) else (state.guess, state.guess)


def _find_start(state: State) -> float:
    """Return the number within the conditions of the start and the bounds that is the nearest to 0."""
    return _clip(_clip(0.0, state.bounds), state.start)


def _clip(value: float, limits: Range) -> float:
    return min(max(value, limits[0]), limits[1])


def _integrate(
    values: Array, integrated: list[int], t: Array, motion: Trajectory, problem: Problem, plant: Plant
) -> Array | None:
    """Integrate some states along a motion, the others being known: (K, states); None where that fails."""
    rates = Values([problem.every_state[i].rate for i in integrated], problem, plant)
    given = GivenValues(problem, plant)
    table = {"states": values, **_tabulate(motion, t)}
    if plant.manifest.driven:
        table["tau"] = _spread(find_point_forces(plant, motion)[1], motion, t)
    calls, unknowns = 0, motion.unknowns[None]

    def rate(time: float, own: Array) -> Array:
        nonlocal calls
        calls += 1
        if calls > MAX_CALLS:
            raise _TooLongError
        parts = {kind: _interpolate(time, t, array) for kind, array in table.items()}
        parts["states"][:, integrated] = own
        interval = min(int(np.searchsorted(motion.t, time, side="right")) - 1, len(motion.u) - 1)
        parts |= {"u": motion.u[[interval]], "controls": motion.controls[[interval]]}
        parts |= {"t": np.full((1, 1), time), "T": np.full((1, 1), motion.t[-1]), "unknowns": unknowns}
        return np.asarray(rates(given(parts))[0])

    from scipy.integrate import solve_ivp  # here, and late: it takes long to load

    begin = values[0, integrated]
    try:
        if not np.isfinite(rate(float(t[0]), begin)).all():
            return None
        with np.errstate(all="ignore"):
            found = solve_ivp(
                rate, (t[0], t[-1]), begin, "LSODA", t_eval=t, rtol=TOLERANCE, atol=TOLERANCE / 100, max_step=t[-1] / 10
            )
    except (_TooLongError, ValueError):
        return None
    return np.asarray(found.y.T) if found.success and np.isfinite(found.y).all() else None


def _tabulate(motion: Trajectory, t: Array) -> dict[str, Array]:
    """Return coordinates, velocities and accelerations at times t; accelerations by linear interpolation."""
    nodes = np.concatenate((motion.t, motion.point_t.ravel()))
    order = np.unique(nodes, return_index=True)[1]

    def join(mesh: Array, points: Array) -> Array:
        return np.concatenate((mesh, points.reshape(motion.point_t.size, points.shape[2])))[order]

    qdd = _spread(motion.point_qdd, motion, t)
    return {"q": join(motion.q, motion.point_q), "qd": join(motion.qd, motion.point_qd), "qdd": qdd}


def _spread(points: Array, motion: Trajectory, t: Array) -> Array:
    """Return values at the points, (N, d, size), at times t (K,) by linear interpolation: (K, size)."""
    flat = points.reshape(motion.point_t.size, points.shape[2])
    times, kept = np.unique(motion.point_t.ravel(), return_index=True)
    columns = [np.interp(t, times, column[kept]) for column in flat.T]
    return np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))


def _interpolate(time: float, t: Array, values: Array) -> Array:
    """Return values (K, size) at times t (K,) at one time: (1, size)."""
    k = int(np.clip(np.searchsorted(t, time) - 1, 0, len(t) - 2))
    place = (time - t[k]) / (t[k + 1] - t[k])
    return np.asarray((1 - place) * values[[k]] + place * values[[k + 1]])
