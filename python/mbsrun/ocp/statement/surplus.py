"""Conditions on the end of a motion that its contacts, or driven joints, imply: they are left out, if they agree.

With contacts, J_c qd = 0 at the end, and J_h qd = 0 with closed loops. If N spans the velocities that remain, a
condition on qd_i has the gradient N_i (row i of N). Of all conditions, as many as N has columns are kept, so that their
rows are as independent as possible (QR with pivots); the others follow from them. The same holds for accelerations, and
for coordinates, where places are known: contacts stay where a given start has them, and modes keep points on planes.
A condition that follows would make the program's Jacobian lose rank, and an interior-point method then takes hundreds
of iterations.

What contacts imply for values that are not 0 may depend on lengths: with unknown lengths such values are refused.

Where driven joints leave fewer freedoms than sensors have targets, some targets follow from the others in every pose.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from mbsrun.closure import find_closure
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.contacts import Held, find_held, list_entries, locate
from mbsrun.ocp.problem.problem import End, Problem, Target
from mbsrun.ocp.statement.checks import ProblemError

RANK = 1e-8  # of rows and columns, relative to the largest
AGREES = 1e-6  # the difference from an implied value that counts as rounding [rad, m, 1/s]
ITERATIONS = 30  # of Newton's method
CHANGE = 1e-3  # of a parameter, to find out whether it moves contacts

Values = Mapping[int, float]


def leave_out_surplus(problem: Problem, plant: Plant, q: Array, like: End | None = None) -> Problem:
    """Leave out the conditions on the end that contacts imply, for an end near the pose q.

    Of conditions that are as good, the ones of `like` stay: what was kept of the same end with other values.
    Raises ProblemError for values that contradict the contacts, or that unknown parameters of the model decide.
    """
    held, end, manifest = find_held(problem, plant.manifest), problem.end, plant.manifest
    if held is None:
        return problem
    from scipy.linalg import null_space  # here, and late: it takes long to load

    independent = manifest.independent or range(len(manifest.coordinates))
    speeds = dict(end.velocities) | (dict.fromkeys(independent, 0.0) if end.velocity_zero else {})
    changes = dict(end.accelerations) | (dict.fromkeys(independent, 0.0) if end.acceleration_zero else {})
    free = null_space(_constrain(plant, held, q), rcond=RANK)
    kept = _choose(free, list(speeds), () if like is None else dict(like.velocities))
    if len(kept) < len(speeds):
        _check_unknowns(problem, plant, held, q, "end.velocities", any(speeds.values()))
        _check_velocities(problem, free, speeds, kept)
        values = tuple((i, speeds[i]) for i in kept)
        end = replace(end, velocity_zero=False, velocities=values)
    kept = _choose(free, list(changes), () if like is None else dict(like.accelerations))
    if len(kept) < len(changes):
        is_moving = any(changes.values()) or any(speeds.values())
        _check_unknowns(problem, plant, held, q, "end.accelerations", is_moving)
        _check_accelerations(problem, plant, held, q, free, speeds, changes, kept)
        values = tuple((i, changes[i]) for i in kept)
        end = replace(end, acceleration_zero=False, accelerations=values)
    places, known = dict(end.coordinates), _find_places(problem, plant)
    if not manifest.quaternions and known is not None and places:
        free = null_space(_join(plant, held, q, (), known[0]), rcond=RANK)
        kept = _choose(free, list(places), () if like is None else dict(like.coordinates))
        if len(kept) < len(places):
            _check_unknowns(problem, plant, held, q, "end.coordinates", True)
            _check_pose(problem, plant, held, q, places, kept, (known[0], known[1]()))
            end = replace(end, coordinates=tuple((i, places[i]) for i in kept))
    return replace(problem, end=end)


def free_targets(problem: Problem, plant: Plant, q: Array) -> Problem:
    """Free targets of sensors that follow from others as driven joints stand at the end, near a pose that meets all.

    Nothing is freed where the end of the given motions is not known, or where the targets' rank is lost in the pose.
    """
    manifest, end = plant.manifest, problem.end
    given = [(k, axis) for k, (_, target) in enumerate(end.sensors) for axis in range(3) if target[axis] is not None]
    if not manifest.driven or not problem.is_timed or problem.unknowns or not given:
        return problem
    from scipy.linalg import null_space  # here, and late: it takes long to load

    n, closure = len(manifest.coordinates), find_closure(plant)
    rows = np.eye(n)[list(manifest.driven)]
    free = null_space(rows if closure is None else np.concatenate((rows, closure.jacobian(q))), rcond=RANK)
    if manifest.quaternions or len(given) <= free.shape[1]:
        return problem
    names = [frame.name for frame in manifest.frames if frame.sensor]
    entries = [3 * names.index(end.sensors[k][0]) + axis for k, axis in given]
    wanted = np.array([end.sensors[k][1][axis] for k, axis in given], dtype=float)
    places = np.asarray(plant("sensors", q=q)["position"]).ravel(order="F")[entries]
    slopes = plant("jac_sensors", q=q)["jac_position_q"][entries] @ free
    kept = _choose(slopes, range(len(given)))
    if len(kept) < free.shape[1] or np.abs(places - wanted).max() > AGREES:
        return problem
    stay = {given[i] for i in kept}
    sensors: list[tuple[str, Target]] = []
    for k, (name, target) in enumerate(end.sensors):
        x, y, z = (value if (k, axis) in stay else None for axis, value in enumerate(target))
        sensors.append((name, (x, y, z)))
    return replace(problem, end=replace(end, sensors=tuple(sensors)))


def _find_places(problem: Problem, plant: Plant) -> tuple[list[int], Callable[[], Array]] | None:
    """Return the places among the held ones that a motion keeps, by index, and their values; None where they are open.

    All are known where the whole start is given, and distances from planes where modes are.
    """
    manifest = plant.manifest
    entries = [(contact, axis) for contact in problem.contacts for axis in contact.axes]
    if not any(i < len(manifest.positions) for i in problem.free_start):
        held = [entry for contact in problem.contacts for entry in list_entries(contact, manifest)]
        return [*range(len(held))], lambda: locate(plant, np.array(problem.start_q), held)
    planes = {law.point: law.height for law in manifest.open_contacts} if problem.modes else {}
    known = [k for k, (contact, axis) in enumerate(entries) if contact.sensor in planes and axis == contact.normal]
    return (known, lambda: np.array([planes[entries[k][0].sensor] for k in known])) if known else None


def _constrain(plant: Plant, held: Held, q: Array) -> Array:
    """Return J_c, and J_h below it, in one pose."""
    J = held.differentiate(plant, q[None], np.zeros((1, len(plant.manifest.coordinates))))[0][0]
    closure = find_closure(plant)
    return J if closure is None else np.concatenate((J, closure.jacobian(q)))


def _choose(free: Array, given: Sequence[int], liked: Collection[int] = ()) -> list[int]:
    """Choose entries that are independent of each other, in the order in which they are given; `liked` if they do."""
    if not given or not free.shape[1]:
        return []
    if liked and set(liked) < set(given):
        same = [i for i in given if i in liked]
        if _choose(free, same) == same and len(same) == len(_choose(free, given)):
            return same
    from scipy.linalg import qr  # here, and late: it takes long to load

    _, R, order = qr(free[list(given)].T, mode="economic", pivoting=True)
    sizes = np.abs(np.diag(R))
    chosen = {given[i] for i in order[: int((sizes > RANK).sum())]}
    return [i for i in given if i in chosen]


def _check_unknowns(problem: Problem, plant: Plant, held: Held, q: Array, place: str, is_refused: bool) -> None:
    """Raise ProblemError where values that follow from others change with unknown parameters of the model."""
    names = [unknown.name for unknown in problem.unknowns if unknown.name in plant.parameters]
    if not is_refused or not names:
        return
    J = _constrain(plant, held, q)

    def moves_contacts(name: str) -> bool:
        value = plant.parameters[name]
        other = plant.with_parameters(**{name: value + CHANGE * max(1.0, abs(value))})
        return not np.array_equal(_constrain(other, held, q), J)

    moving = ", ".join(name for name in names if moves_contacts(name))
    if moving:
        finding = f"some of these values follow from the others by the contacts, which change with {moving}"
        raise ProblemError(problem.name, [(place, finding, "give fewer values, or write them as constraints at: end")])


def _check_velocities(problem: Problem, free: Array, given: Values, kept: Sequence[int]) -> None:
    """Raise ProblemError for velocities that differ from the ones that the others imply."""
    found = free @ np.linalg.lstsq(free[kept], np.array([given[i] for i in kept]), rcond=None)[0]
    _compare(problem, "end.velocities", given, found, "1/s")


def _check_accelerations(
    problem: Problem,
    plant: Plant,
    held: Held,
    q: Array,
    free: Array,
    speeds: Values,
    given: Values,
    kept: Sequence[int],
) -> None:
    """Raise ProblemError for accelerations that differ from the ones that the others and the velocities imply."""
    known = _choose(free, list(speeds))
    if len(known) < free.shape[1]:
        finding = (
            "some of these values follow from the others by the contacts and the velocities, which are not all given"
        )
        raise ProblemError(
            problem.name, [("end.accelerations", finding, "give the velocities, or fewer accelerations")]
        )
    qd = free @ np.linalg.lstsq(free[known], np.array([speeds[i] for i in known]), rcond=None)[0]
    bias, closure = held.differentiate(plant, q[None], qd[None])[1][0], find_closure(plant)
    bias = bias if closure is None else np.concatenate((bias, closure.bias(q, qd)))
    bent = np.linalg.lstsq(_constrain(plant, held, q), -bias, rcond=RANK)[0]
    wanted = np.array([given[i] for i in kept]) - bent[kept]
    found = bent + free @ np.linalg.lstsq(free[kept], wanted, rcond=None)[0]
    _compare(problem, "end.accelerations", given, found, "1/s²")


def _check_pose(
    problem: Problem,
    plant: Plant,
    held: Held,
    q: Array,
    given: Values,
    kept: Sequence[int],
    known: tuple[list[int], Array],
) -> None:
    """Raise ProblemError for coordinates that differ from the ones that the others imply."""
    closure, (chosen, there) = find_closure(plant), known
    entries, values = [held.entries[k] for k in chosen], np.array([given[i] for i in kept])

    def measure(pose: Array) -> Array:
        parts = [locate(plant, pose, entries) - there, pose[kept] - values]
        return np.concatenate(parts if closure is None else [*parts, closure.gaps(pose)])

    found = _solve(measure, lambda pose: _join(plant, held, pose, kept, chosen), q)
    if np.abs(measure(found)).max(initial=0.0) > AGREES:
        named = ", ".join(plant.manifest.positions[i] for i in kept)
        finding = f"no pose with these values of {named} keeps the contacts where they are"
        raise ProblemError(problem.name, [("end.coordinates", finding, "give values at which they stand, or fewer")])
    _compare(problem, "end.coordinates", given, found, "rad or m")


def _join(plant: Plant, held: Held, pose: Array, kept: Sequence[int], chosen: Sequence[int]) -> Array:
    """Return the Jacobian of chosen places, of kept coordinates and of loops' gaps."""
    J, count = _constrain(plant, held, pose), len(held.entries)
    return np.concatenate((J[list(chosen)], np.eye(pose.size)[list(kept)], J[count:]))


def _solve(measure: Callable[[Array], Array], slope: Callable[[Array], Array], q: Array) -> Array:
    """Take steps of Newton's method from q."""
    for _ in range(ITERATIONS):
        step = np.linalg.lstsq(slope(q), -measure(q), rcond=None)[0]
        q = q + step * min(1.0, 0.5 / max(float(np.abs(step).max(initial=0.0)), 1e-300))
    return q


def _compare(problem: Problem, place: str, given: Values, found: Array, unit: str) -> None:
    apart = max(abs(found[i] - value) for i, value in given.items())
    if apart > AGREES:
        finding = f"the contacts imply values that differ from the given ones by {apart:.3g} {unit}"
        raise ProblemError(problem.name, [(place, finding, "give values at which the contacts stand, or fewer")])
