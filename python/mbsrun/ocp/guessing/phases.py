"""A first guess of all phases: each phase's own, from where the guess of the phase before ends; some may be known.

A start that a phase leaves free is guessed by the link that leads to it, from an earlier phase in the problem's order.
Variables of links, such as impulses, solve the rows of links at these trajectories.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbsgen.expressions import FLOATS, ExpressionError, evaluate, parse
from mbsrun.closure import has_loops
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.program import Matrix
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import Pose, adapt, make_guess
from mbsrun.ocp.problem.phases import Link, PhasedProblem, Plants
from mbsrun.ocp.problem.problem import Problem, State
from mbsrun.ocp.solution.phases import OWN_GUESS, Guess, PartialGuess
from mbsrun.ocp.transcription.linking import Defined
from mbsrun.ocp.transcription.sides import spell_coordinates


@dataclass(frozen=True)
class Unreached:
    """A phase whose targets no pose meets."""

    phase: int
    pose: Pose


def guess_phases(problem: PhasedProblem, plants: Plants, given: PartialGuess = OWN_GUESS) -> Guess | Unreached:
    """Make the guess that a problem describes, of the phases that are not given."""
    found: list[Trajectory] = []
    known = dict(given.trajectories)
    for k, (phase, plant) in enumerate(zip(problem.phases, plants.phases, strict=True)):
        own = phase.problem
        if phase.name in known:
            found.append(adapt_motion(own, known[phase.name]))
            continue
        for link in problem.links:
            source = problem.find(link.source)
            if link.target == phase.name and source < k:
                own = _carry_on(problem, own, link, found[source], plants.phases[source], plant)
        motion = make_guess(own, plant, schemes.build(own.family, own.degree))
        if isinstance(motion, Pose):
            return Unreached(k, motion)
        found.append(motion)
    return Guess(tuple(found), given.unknowns)


def adapt_guess(problem: PhasedProblem, guess: Guess) -> Guess:
    """Read a guess on the grids of a problem's phases."""
    pairs = zip(problem.phases, guess.trajectories, strict=True)
    return replace(guess, trajectories=tuple(adapt_motion(phase.problem, motion) for phase, motion in pairs))


def adapt_motion(own: Problem, motion: Trajectory) -> Trajectory:
    """Read a motion on the grid of a phase, whose horizon it guesses where that is free."""
    return adapt(motion, own.with_duration(float(motion.t[-1])), schemes.build(own.family, own.degree))


def _carry_on(
    problem: PhasedProblem, own: Problem, link: Link, before: Trajectory, source: Plant, target: Plant
) -> Problem:
    """Guess the free coordinates of a start from the end of the motion before, where that is possible."""
    if (has_loops(target.manifest) and target is not source) or not np.isfinite(before.q).all():
        return own
    known = dict(problem.constants) | {unknown.name: unknown.guess for unknown in problem.every_unknown}
    known |= {name: float(before.q[-1, i]) for name, i in spell_coordinates(source.manifest).items()}
    plain = dict(zip(source.manifest.positions, before.q[-1].tolist(), strict=True))
    chosen, values = dict(link.map), list(own.start_q)
    for i, name in enumerate(target.manifest.positions):
        text = chosen.get(name)
        if i not in own.free_start or i in dict(own.guess.start) or (name in chosen and text is None):
            continue
        try:
            value = plain.get(name, values[i]) if text is None else evaluate(parse(text), known, FLOATS)
        except ExpressionError:
            continue
        lower, upper = own.bounds.q[i]
        values[i] = min(max(value, lower), upper)
    return replace(own, start_q=tuple(values))


def carry_states(problem: PhasedProblem, k: int, found: Sequence[Trajectory], plants: Plants) -> Problem:
    """Return phase k with starts of the states that it adds: free ones begin where a guess of a phase before ends.

    The trajectories of the phases before are complete. A state with its own guess, or a given start, keeps it.
    """
    own = problem.phases[k].problem
    for link in problem.links:
        source = problem.find(link.source)
        if link.target != problem.phases[k].name or source >= k:
            continue
        before, names = found[source], [state.name for state in problem.phases[source].problem.states]
        known = dict(problem.constants) | {unknown.name: unknown.guess for unknown in problem.every_unknown}
        known |= {name: float(before.q[-1, i]) for name, i in spell_coordinates(plants.phases[source].manifest).items()}
        known |= dict(zip(names, before.states[-1].tolist(), strict=False))
        own = replace(own, states=tuple(_carry(state, link, known) for state in own.states))
    return own


def _carry(state: State, link: Link, known: Mapping[str, float]) -> State:
    """Return a state with the start that a link gives it, as far as the state leaves it open."""
    text = dict(link.map).get(state.name, state.name)
    if state.guess is not None or state.start[0] == state.start[1] or text is None:
        return state
    try:
        value = evaluate(parse(text), known, FLOATS)
    except ExpressionError:
        return state
    for lower, upper in (state.bounds, state.start):
        value = min(max(value, lower), upper)
    return replace(state, start=(value, value)) if np.isfinite(value) else state


def solve_links(
    x: Array, defined: tuple[Defined, ...], evaluate_rows: Callable[[Array], Array], slopes: Callable[[Array], Matrix]
) -> Array:
    """Find the variables that links define, group by group: a step of Newton's method, exact where rows are linear."""
    x = x.copy()
    for group in defined:
        g, J = evaluate_rows(x)[group.rows], slopes(x)[group.rows][:, group.variables].toarray()
        if np.isfinite(g).all() and np.isfinite(J).all():
            x[group.variables] -= np.linalg.lstsq(J, g, rcond=None)[0]
    return x
