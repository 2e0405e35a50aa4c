"""The choice of cuts: the most flops saved while every function keeps the tolerance.

Each cut is measured alone. Cuts that keep the tolerance are taken in the order of error per saved flop, as long as all
together keep it. Then cuts that save nothing are put back. The choice leaves a margin, so that other states keep the
tolerance too; the margin is widened if states drawn anew do not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mbsgen.approximation import slopes
from mbsgen.approximation.cuts import Cut, Released, release
from mbsgen.approximation.effects import Comparison, ReleasedFunctions, Wanted
from mbsgen.approximation.states import draw
from mbsgen.families import list_functions, write_families
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.model.tree import Kind, Tree
from mbsgen.procedure.procedure import straight
from mbsgen.request import Request
from mbsgen.tape.counts import count
from mbsgen.tape.types import Tape

CHOOSING, CHECKING = 64, 4096  # states at which cuts are chosen, and states at which all are measured together
SEEDS = 1, 2  # of the two sets of states
SLOPES = 64  # states at which Jacobians are compared: the first of the second set
POSES = 8  # of the first set, at which M is checked; of the second set, all are
MARGIN = 0.8  # fraction of the tolerance that the choice may use
NARROWER = 5  # times that the fraction is reduced
AHEAD = 16  # sets that are measured at a time

Chosen = NDArray[np.bool_]  # of each cut


@dataclass(frozen=True)
class Taken:
    """A cut that was made."""

    cut: Cut
    error: float  # of this cut alone
    flops: int  # that all functions would take more with the cut put back, by the estimate of the choice


@dataclass(frozen=True)
class Approximation:
    """A tree with some numbers set to 0."""

    tolerance: float
    tree: Tree
    taken: tuple[Taken, ...]
    errors: Mapping[str, float]  # of the functions as they are generated, at states that were not used for the choice
    states: int = CHECKING  # number of these states
    slopes: Mapping[str, float] = field(default_factory=dict)  # errors of Jacobians, where these are written
    slope_states: int = SLOPES


def approximate(tree: Tree, tolerance: float, request: Request) -> Approximation:
    """Remove numbers from a tree that change the requested functions by at most a tolerance: a relative error, above 0.

    The tree stays as it is where nothing can be removed, or removing saves nothing.
    """
    names, scene = list_functions(tree, request), request.scene
    released = release(tree)
    wanted = Wanted(names, dict(scene.results), motion=scene.motion)
    functions = ReleasedFunctions(released, wanted)
    choosing, checking = (
        Comparison(functions, draw(tree, count, seed, motion=wanted.motion), poses)
        for count, seed, poses in zip((CHOOSING, CHECKING), SEEDS, (POSES, CHECKING), strict=True)
    )
    whole = _write(tree, request, names)
    choice = _Choice(released, functions, choosing)
    share = MARGIN
    for _ in range(NARROWER):
        chosen = choice.choose(share * tolerance)
        if not chosen.any():
            break
        reduced = released.reduce({cut.name for cut, is_taken in zip(released.cuts, chosen, strict=True) if is_taken})
        error = float(checking.judge(chosen[None])[0])
        tapes = _write(reduced, request, names) if error <= tolerance else {}
        errors = checking.measure(tapes)
        if tapes and max(errors.values(), default=0.0) <= tolerance:
            if _total(tapes) < _total(whole):
                taken = choice.describe(chosen)
                found = _compare_slopes(functions, request, whole, tapes)
                return Approximation(tolerance, reduced, taken, errors, slopes=found)
            break
        share *= MARGIN * min(1.0, tolerance / error)
    return Approximation(tolerance, tree, (), checking.measure(whole))


def _compare_slopes(
    functions: ReleasedFunctions, request: Request, whole: Mapping[str, Tape], reduced: Mapping[str, Tape]
) -> dict[str, float]:
    """Return the errors of the Jacobians that are written."""
    if not request.derivatives:
        return {}
    states = draw(functions.released.whole, SLOPES, SEEDS[1], motion=functions.wanted.motion)
    written = {name: tape for name, tape in whole.items() if FUNCTIONS[name].order}
    return slopes.measure(Comparison(functions, states, poses=1), written, reduced)


def _write(tree: Tree, request: Request, names: tuple[str, ...]) -> dict[str, Tape]:
    """Write functions as they are generated, except that parameters have their values."""
    fixed = replace(tree, parameters=tuple(replace(p, kind=Kind.CONSTANT) for p in tree.parameters))
    plain = replace(request.values_alone, functions=names, scene=replace(request.scene, together=()))
    return {family.value.name: straight(family.value) for family in write_families(fixed, plain)}


def _total(tapes: Mapping[str, Tape]) -> int:
    return sum(count(tape).paper for tape in tapes.values())


class _Choice:
    def __init__(self, released: Released, functions: ReleasedFunctions, comparison: Comparison) -> None:
        self._released, self._functions, self._comparison = released, functions, comparison
        self._alone = comparison.judge(np.eye(len(released.cuts), dtype=bool))

    def choose(self, tolerance: float) -> Chosen:
        """Choose cuts whose error together is at most a tolerance."""
        possible = self._alone <= tolerance
        saved = self._count_put_back(possible)
        with np.errstate(divide="ignore", invalid="ignore"):
            price = np.where(self._alone == 0.0, 0.0, self._alone / saved)
        order = [int(k) for k in np.argsort(price, kind="stable") if possible[k] and saved[k] > 0]
        return self._put_back(self._fill(order, tolerance))

    def _fill(self, order: list[int], tolerance: float) -> Chosen:
        """Take cuts in order, except cuts that would break the tolerance."""
        chosen = np.zeros(len(self._alone), bool)
        while order:
            ahead = order[:AHEAD]
            steps = [_with(chosen, ahead[: k + 1]) for k in range(len(ahead))]
            kept = self._comparison.judge(np.array(steps)) <= tolerance
            fit = len(ahead) if kept.all() else int(np.argmin(kept))
            chosen = _with(chosen, ahead[:fit])
            order = order[fit + 1 :] if fit < len(ahead) else order[fit:]
        return chosen

    def _put_back(self, chosen: Chosen) -> Chosen:
        """Put back cuts that save nothing, the largest error first."""
        while True:
            more = self._count_put_back(chosen)
            unused = [k for k in range(len(chosen)) if chosen[k] and more[k] == 0]
            if not unused:
                return chosen
            chosen = _without(chosen, max(unused, key=lambda k: (self._alone[k], k)))

    def _count_put_back(self, chosen: Chosen) -> NDArray[np.int64]:
        """Count the flops that all functions take more with each of the chosen cuts put back; 0 for others."""
        members = [int(k) for k in np.flatnonzero(chosen)]
        counts = self._functions.count(np.array([chosen, *(_without(chosen, k) for k in members)]))
        more = np.zeros(len(chosen), np.int64)
        more[members] = counts[1:] - counts[0]
        return more

    def describe(self, chosen: Chosen) -> tuple[Taken, ...]:
        """Return the chosen cuts, in the order of the tree."""
        more = self._count_put_back(chosen)
        return tuple(
            Taken(cut, float(self._alone[k]), int(more[k])) for k, cut in enumerate(self._released.cuts) if chosen[k]
        )


def _with(chosen: Chosen, more: list[int]) -> Chosen:
    found = chosen.copy()
    found[more] = True
    return found


def _without(chosen: Chosen, one: int) -> Chosen:
    found = chosen.copy()
    found[one] = False
    return found
