"""Search for the plan with the fewest flops: coordinate descent over the bodies, from a few starting plans."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import product

from mbsgen.formulations.parsimony.plan import Choice, Mass, Meeting, Plan
from mbsgen.formulations.parsimony.segments import Segment, children
from mbsgen.formulations.reductions import Reductions

Cost = Callable[[Plan], int | None]  # None: the plan does not fit the model
Restraint = Callable[[Plan], Plan | None]  # the nearest plan that meets other criteria; None: there is none


def leave(plan: Plan) -> Plan:
    """Return a plan unchanged: no restraint."""
    return plan


def search(
    segments: Sequence[Segment],
    cost: Cost,
    reductions: Reductions,
    trials: int,
    start: Sequence[Plan] = (),
    restrain: Restraint = leave,
) -> Plan:
    """Return the best plan found in about `trials` evaluations of `cost`, from the given plans and standard ones."""
    known: dict[Plan, int | None] = {}

    def evaluate(plan: Plan) -> int | None:
        if plan not in known:
            known[plan] = cost(plan)
        return known[plan]

    best, fewest = None, 0
    for plan in map(restrain, (*_beginnings(segments, reductions), *start)):
        found = evaluate(plan) if plan is not None else None
        if plan is not None and found is not None and (best is None or found < fewest):
            best, fewest = plan, found
    assert best is not None, "the plainest plan fits every model"
    improved = True
    while improved:
        improved = False
        for segment in reversed(segments):
            for choice in _alternatives(segments, segment, best[segment.number], reductions):
                if len(known) >= trials:
                    return best
                plan = restrain(best.put(segment.number, choice))
                found = evaluate(plan) if plan is not None else None
                if plan is not None and found is not None and found < fewest:
                    best, fewest, improved = plan, found, True
    return best


def _beginnings(segments: Sequence[Segment], reductions: Reductions) -> Iterator[Plan]:
    """List plans to start from: own frames; frames shared in groups; shared, with the last of each group in its own."""
    runtime = reductions.lump_runtime
    yield Plan((Choice(),) * len(segments), runtime)
    if not reductions.share_frames:
        return
    continued = {s.parent for s in segments if not s.opens_group}
    grouped = [s.number in continued or not s.opens_group for s in segments]
    for spin_from, scaled in product((0, 1), (False, True) if reductions.lump else (False,)):
        shared, own = Choice(own_frame=False, spin_from=spin_from, scaled=scaled), Choice(spin_from=spin_from)
        yield Plan(tuple(shared if g else own for g in grouped), runtime)
        yield Plan(tuple(shared if s.number in continued else own for s in segments), runtime)


def _alternatives(
    segments: Sequence[Segment], segment: Segment, choice: Choice, reductions: Reductions
) -> Iterator[Choice]:
    """List choices that differ in one thing (a mass with the axis of its spin inertia), then in all at once."""
    if not segment.is_revolute:
        return
    is_leaf = not children(segments, segment.number)
    masses, lengths, frames = [Mass.PASSED], [False], [True]
    if reductions.lump and reductions.regroup and segment.parent and not segment.floats:
        masses += [Mass.BALANCING, Mass.POINT] if is_leaf else [Mass.BALANCING]
    if reductions.lump and not is_leaf:
        lengths.append(True)
    if reductions.share_frames:
        frames.append(False)
    yield from (replace(choice, own_frame=own) for own in frames)
    yield from (replace(choice, scaled=scaled) for scaled in lengths)
    yield from (replace(choice, mass=mass, spin_from=spin_from) for mass, spin_from in product(masses, (0, 1)))
    for own_frame, mass, spin_from, scaled in product(frames, masses, (0, 1), lengths):
        yield replace(choice, own_frame=own_frame, mass=mass, spin_from=spin_from, scaled=scaled)


def spin(segments: Sequence[Segment], cost: Cost, plan: Plan, reductions: Reductions) -> Plan:
    """Choose how each body takes field, second moments and momentum from rates, one by one from the leaves."""
    fewest = cost(plan)
    for segment in (s for s in reversed(segments) if s.parent and s.is_revolute):
        for flags in _list_rates(segment, reductions):
            trial = plan
            for number, flag in flags:
                trial = trial.put(number, trial[number].flip(flag))
            found = cost(trial)
            if found is not None and (fewest is None or found < fewest):
                plan, fewest = trial, found
    return plan


def _list_rates(segment: Segment, reductions: Reductions) -> Iterator[tuple[tuple[int, str], ...]]:
    """List the choices of rates that may change for a body: one by one, then with a choice of the body before."""
    field, momentum = (segment.number, "by_spin"), (segment.number, "passes_spin")
    if reductions.spin and segment.opens_group:
        yield (field,)
    if reductions.momentum:
        yield (momentum,)
        yield ((segment.number, "by_rates"),)
        if reductions.spin and segment.opens_group:
            yield field, momentum, (segment.parent, "by_rates")


def meet(segments: Sequence[Segment], cost: Cost, plan: Plan) -> Plan:
    """Choose the bodies that M meets, one by one from the leaves, and the place of each."""
    fewest = cost(plan)
    for segment in (s for s in reversed(segments) if s.parent):
        for meeting in Meeting:
            trial = plan.put(segment.number, replace(plan[segment.number], meeting=meeting))
            found = cost(trial)
            if found is not None and (fewest is None or found < fewest):
                plan, fewest = trial, found
    return plan


def flip_each(segments: Sequence[Segment], cost: Cost, plan: Plan, flag: str, *, by_group: bool = False) -> Plan:
    """Choose a flag of each body, or of all bodies of each group but its last, one by one from the leaves."""
    fewest = cost(plan)
    for bodies in _list_groups(segments) if by_group else ([s] for s in reversed(segments)):
        trial = plan
        for segment in bodies:
            trial = trial.put(segment.number, trial[segment.number].flip(flag))
        found = cost(trial)
        if found is not None and (fewest is None or found < fewest):
            plan, fewest = trial, found
    return plan


def _list_groups(segments: Sequence[Segment]) -> list[list[Segment]]:
    """List the bodies of each group that others continue, last group first."""
    groups: dict[int, list[Segment]] = {}
    first: dict[int, int] = {}
    for segment in segments:
        i, is_continued = segment.number, any(not c.opens_group for c in children(segments, segment.number))
        first[i] = i if segment.opens_group else first[segment.parent]
        if is_continued:
            groups.setdefault(first[i], []).append(segment)
    return [groups[i] for i in sorted(groups, reverse=True)]
