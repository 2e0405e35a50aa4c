"""Findings about the loops of a tree, for the report: degrees of freedom, choices, other assemblies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbsgen.assembly.choice import measure
from mbsgen.assembly.mechanism import Array, Mechanism
from mbsgen.assembly.poses import Attempt, close, null_space, walk
from mbsgen.model.tree import Motion, Tree

STARTS = 48  # from which other assemblies are searched for
LARGEST = 12  # dependent coordinates, up to which they are
APART = 1e-6  # rad or m between two assemblies
RESTING = 1e-6  # of the velocity of a joint, where the velocities of all together have the length 1


@dataclass(frozen=True)
class Findings:
    """The loops of a tree, in names and numbers."""

    redundant: tuple[str, ...]  # equations that follow from others
    kept: int  # equations that remain
    coordinates: int  # entries of qd
    independent: tuple[str, ...]
    is_chosen: bool  # by the author
    regularity: float  # the least singular value of the dependent columns of J, as a part of J's largest
    assemblies: tuple[tuple[float, ...], ...]  # poses with the same independent coordinates; the first is computed with

    @property
    def freedoms(self) -> int:
        """Count the degrees of freedom, driven joints included."""
        return self.coordinates - self.kept


def describe(tree: Tree) -> Findings | None:
    """Describe the loops of an assembled tree; None without any."""
    if tree.closure is None or not (tree.loops or tree.constraints):
        return None
    mechanism, closure, names = Mechanism(tree), tree.closure, [joint.name for joint in tree.joints]
    owners = [*(loop.name for loop in tree.loops), *(constraint.name for constraint in tree.constraints)]
    every = enumerate(mechanism.equations)
    J = mechanism.J(np.array(closure.pose))[list(closure.kept)]
    return Findings(
        tuple(f"{owners[k]}.{equation}" for i, (k, equation) in every if i not in closure.kept),
        len(closure.kept),
        len(names),
        tuple(names[i] for i in closure.independent),
        bool(tree.chosen),
        measure(J, closure.dependent),
        tuple(find_assemblies(mechanism)),
    )


def list_held(tree: Tree) -> tuple[str, ...]:
    """Name the joints that the loops of an assembled tree keep at rest, wherever the others move."""
    if tree.closure is None:
        return ()
    mechanism, names = Mechanism(tree), [joint.name for joint in tree.joints]
    moves = np.zeros(len(names), bool)
    for q in walk(mechanism, np.array(tree.closure.pose)):
        moves |= np.linalg.norm(null_space(mechanism.J(q)), axis=1) > RESTING
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
    draw, held = np.random.default_rng(3), list(closure.independent)
    turns = np.array([joint.motion is Motion.REVOLUTE for joint in mechanism.tree.joints])
    for _ in range(STARTS):
        start = np.where(turns, draw.uniform(-np.pi, np.pi, first.size), first + draw.standard_normal(first.size))
        start[held] = first[held]
        attempt = close(mechanism, start, held=held)
        if attempt.is_closed and all(_differ(attempt, other, turns) for other in found):
            found.append(_wind(attempt.q, turns, held))
    return [closure.pose, *(tuple(float(x) for x in q) for q in found[1:])]


def _differ(attempt: Attempt, other: Array, turns: Array) -> bool:
    gap = attempt.q - other
    gap[turns] = np.remainder(gap[turns] + np.pi, 2 * np.pi) - np.pi
    return bool(np.abs(gap).max() > APART)


def _wind(q: Array, turns: Array, held: list[int]) -> Array:
    """Return angles between -pi and pi, except the independent ones."""
    wound = np.where(turns, np.remainder(q + np.pi, 2 * np.pi) - np.pi, q)
    wound[held] = q[held]
    return wound
