"""Findings about the loops of a tree, for the report: degrees of freedom, choices, other assemblies."""

from __future__ import annotations

import numpy as np

from mbsgen.assembly.choice import measure
from mbsgen.assembly.mechanism import Array, Mechanism, name_equations
from mbsgen.assembly.poses import Attempt, close, find_solved, null_space, walk
from mbsgen.assembly.results import Findings
from mbsgen.formulations.closure import list_equations
from mbsgen.model.tree import Closure, Motion, Tree

STARTS = 48  # from which other assemblies are searched for
LARGEST = 12  # dependent coordinates, up to which they are
APART = 1e-6  # rad or m between two assemblies
RESTING = 1e-6  # of the velocity of a joint, where the velocities of all together have the length 1


def describe_loops(tree: Tree, closure: Closure) -> Findings:
    """Describe the loops of an assembled tree."""
    mechanism, names = Mechanism(tree), [joint.name for joint in tree.joints]
    J = mechanism.J(np.array(closure.pose))[list(closure.kept)]
    return Findings(
        list_redundant(tree),
        len(closure.kept),
        len(names),
        tuple(names[i] for i in closure.independent),
        bool(tree.chosen),
        measure(J, closure.dependent),
        tuple(find_assemblies(mechanism)),
        closure.distance,
    )


def list_redundant(tree: Tree) -> tuple[str, ...]:
    """Name the equations of an assembled tree that follow from others."""
    closure = tree.closure
    assert closure is not None, "the tree is assembled"
    return name_equations(tree, (i for i, _ in enumerate(list_equations(tree)) if i not in closure.kept))


def find_held(tree: Tree, closure: Closure) -> tuple[str, ...]:
    """Name the joints that the loops of an assembled tree keep at rest, wherever the others move."""
    mechanism, names = Mechanism(tree), [joint.name for joint in tree.joints]
    moves = np.zeros(len(names), bool)
    kept, slack = find_solved(closure)
    own = slice(None) if kept is None else list(kept)
    for q in walk(mechanism, np.array(closure.pose), kept, slack):
        moves |= np.linalg.norm(null_space(mechanism.J(q)[own]), axis=1) > RESTING
    return tuple(name for name, is_moving in zip(names, moves, strict=True) if not is_moving)


def find_assemblies(mechanism: Mechanism) -> list[tuple[float, ...]]:
    """Search for closed poses with the independent coordinates of the first one; it is the first of the list.

    Starts are random, so a list need not be complete. Trees with quaternions or many loops have only the first.
    """
    closure = mechanism.tree.closure
    assert closure is not None, "the tree is assembled"
    first = np.array(closure.pose)
    found = [first]
    if mechanism.tree.quaternions or len(closure.dependent) > LARGEST:
        return [closure.pose]
    kept, slack = find_solved(closure)
    draw, held = np.random.default_rng(3), list(closure.independent)
    turns = np.array([joint.motion is Motion.REVOLUTE for joint in mechanism.tree.joints])
    for _ in range(STARTS):
        shifts = first + mechanism.steps * draw.standard_normal(first.size)
        start = np.where(turns, draw.uniform(-np.pi, np.pi, first.size), shifts)
        start[held] = first[held]
        attempt = close(mechanism, start, kept, held=held, slack=slack)
        if attempt.is_closed and all(_differ(mechanism, attempt, other, turns) for other in found):
            found.append(_wind(attempt.q, turns, held))
    return [closure.pose, *(tuple(float(x) for x in q) for q in found[1:])]


def _differ(mechanism: Mechanism, attempt: Attempt, other: Array, turns: Array) -> bool:
    gap = (attempt.q - other) / mechanism.steps
    gap[turns] = np.remainder(gap[turns] + np.pi, 2 * np.pi) - np.pi
    return bool(np.abs(gap).max() > APART)


def _wind(q: Array, turns: Array, held: list[int]) -> Array:
    """Return angles between -pi and pi, except the independent ones."""
    wound = np.where(turns, np.remainder(q + np.pi, 2 * np.pi) - np.pi, q)
    wound[held] = q[held]
    return wound
