"""Which contacts stand at the start of a phase because of the link that leads to it.

At the end of the phase before, or after its impact, velocities v with J_b v = 0 are possible, where J_b holds the
contacts of that side, and the closed loops. A link takes them to the velocities T(v) of the phase after. A contact's
axis with velocity J_a T(v) stands by the link if

    J_a(map(q)) T(v) = 0    for every v with J_b(q) v = 0

at any q. Then a condition at the start would be one too many; otherwise it is needed. The velocities are compared at
random states: a product that vanishes at several of them vanishes at all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mbsgen.expressions import FLOATS, Expression, ExpressionError, Name, evaluate, parse, substitute
from mbsrun.closure import find_closure
from mbsrun.differentiation import differentiate
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.contacts import find_velocities, list_entries
from mbsrun.ocp.problem.phases import Link, PhasedProblem, Plants
from mbsrun.ocp.problem.problem import Contact
from mbsrun.ocp.transcription.sides import spell_coordinates, spell_velocities
from mbsrun.quaternions import list_quaternions, neutral

STATES = 3  # random states that are compared
SPREAD = 0.7  # of their coordinates about 0 [rad, m]
STANDS = 1e-8  # m/s: a velocity that counts as 0, beside velocities of 1 rad/s and 1 m/s


def find_standing(problem: PhasedProblem, plants: Plants, index: int) -> list[bool]:
    """Return whether each held axis, contact by contact, of the phase after a link stands by the link."""
    link = problem.links[index]
    source, target = problem.find(link.source), problem.find(link.target)
    held = problem.phases[source].problem.contacts if link.impact is None else link.impact.contacts
    before = plants.phases[source] if link.impact is None else plants.find_impact(index, source)
    contacts, after = problem.phases[target].problem.contacts, plants.phases[target]
    entries = [entry for contact in contacts for entry in list_entries(contact, after.manifest)]
    if not held or not entries:
        return [False] * len(entries)
    random = np.random.default_rng(0)
    numbers = dict(problem.constants)
    numbers |= {x.name: x.guess + float(random.normal()) for x in problem.every_unknown}
    speeds = [_carry(link, before, after, held, numbers, random)[entries] for _ in range(STATES)]
    return [bool(fast <= STANDS) for fast in np.abs(speeds).max(axis=0)]


def _carry(
    link: Link,
    before: Plant,
    after: Plant,
    held: Sequence[Contact],
    numbers: Mapping[str, float],
    random: np.random.Generator,
) -> Array:
    """Return the velocities of all sensors after a link, from a random state at which the contacts before stand."""
    q, qd = _stand(before, held, random)
    values = {**numbers, **_name(spell_coordinates(before.manifest), q)}
    values |= {f"@{name}": value for name, value in _name(spell_velocities(before.manifest), qd).items()}
    rates: dict[str, Expression] = {name: Name(f"@{name}") for name in spell_velocities(before.manifest)}
    places, speeds = _make_state(after, random)
    _copy_attitudes(before, after, q, places)
    chosen, given = dict(link.map), dict(link.velocities)
    known = [joint.name for joint in before.manifest.coordinates]
    for i, name in enumerate(after.manifest.positions):
        if name in chosen:
            places[i] = _evaluate(chosen[name], {}, values, random)
        elif name in before.manifest.positions:
            places[i] = q[before.manifest.positions.index(name)]
    for i, joint in enumerate(after.manifest.coordinates):
        name = joint.name
        if name in given:
            speeds[i] = _evaluate(given[name], rates, values, random)
        elif name in after.manifest.positions and chosen.get(name) is not None:
            rate = differentiate(parse(str(chosen[name])), rates)
            speeds[i] = _evaluate_expression(rate, values, random)
        elif name in known and name not in chosen:
            speeds[i] = qd[known.index(name)]
    return find_velocities(after, places, speeds)


def _stand(plant: Plant, held: Sequence[Contact], random: np.random.Generator) -> tuple[Array, Array]:
    """Return a random state in which contacts stand, and loops are closed."""
    q, qd = _make_state(plant, random)
    closure = find_closure(plant)
    rows = [find_velocities(plant, q, unit) for unit in np.eye(qd.size)]
    if closure is not None:
        q = closure.close(q)
        rows = [find_velocities(plant, q, unit) for unit in np.eye(qd.size)]
    entries = [entry for contact in held for entry in list_entries(contact, plant.manifest)]
    J = np.array(rows)[:, entries].T
    if closure is not None:
        J = np.concatenate((J, closure.jacobian(q)))
    return q, qd - np.linalg.pinv(J, rcond=1e-10) @ (J @ qd)


def _make_state(plant: Plant, random: np.random.Generator) -> tuple[Array, Array]:
    """Return random coordinates and velocities."""
    manifest = plant.manifest
    q = neutral(manifest) + random.uniform(-SPREAD, SPREAD, len(manifest.positions))
    for quaternion in list_quaternions(manifest):
        q[quaternion.entries] /= np.linalg.norm(q[quaternion.entries])
    return q, random.normal(size=len(manifest.coordinates))


def _copy_attitudes(before: Plant, after: Plant, q: Array, places: Array) -> None:
    """Copy the quaternions of joints that both mechanisms have."""
    known = {quaternion.joint: quaternion for quaternion in list_quaternions(before.manifest)}
    for quaternion in list_quaternions(after.manifest):
        if quaternion.joint in known:
            places[quaternion.entries] = q[known[quaternion.joint].entries]


def _name(places: Mapping[str, int], values: Array) -> dict[str, float]:
    return {name: float(values[i]) for name, i in places.items()}


def _evaluate(
    text: str | None, rates: Mapping[str, Expression], values: Mapping[str, float], random: np.random.Generator
) -> float:
    """Evaluate an expression of a link; any number where it is free."""
    if text is None:
        return float(random.normal())
    return _evaluate_expression(substitute(parse(text), rates), values, random)


def _evaluate_expression(expression: Expression, values: Mapping[str, float], random: np.random.Generator) -> float:
    """Evaluate an expression; any number where it has no value, or reads a state that a problem adds."""
    try:
        return evaluate(expression, values, FLOATS)
    except ExpressionError:
        return float(random.normal())
