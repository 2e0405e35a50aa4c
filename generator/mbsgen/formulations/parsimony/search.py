"""Search for the plan with the fewest flops: descent over bodies, from a few sensible beginnings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import product

from mbsgen.formulations.parsimony.plan import Choice, Mass, Plan
from mbsgen.formulations.parsimony.segments import Segment, children

Cost = Callable[[Plan], int | None]  # None: the plan does not fit the model


def search(segments: Sequence[Segment], cost: Cost, *, trials: int, divide: bool) -> Plan:
    """Return the best plan found in `trials` evaluations of `cost`; `divide` allows plans that divide by parameters."""
    known: dict[Plan, int | None] = {}

    def evaluate(plan: Plan) -> int | None:
        if plan not in known:
            known[plan] = cost(plan)
        return known[plan]

    best, fewest = None, 0
    for plan in _beginnings(segments):
        found = evaluate(plan)
        if found is not None and (best is None or found < fewest):
            best, fewest = plan, found
    assert best is not None, "the plainest plan fits every model"
    improved = True
    while improved and len(known) < trials:
        improved = False
        for segment in reversed(segments):
            for choice in _alternatives(segments, segment, divide=divide):
                plan = best.put(segment.number, choice)
                found = evaluate(plan) if len(known) < trials or plan in known else None
                if found is not None and found < fewest:
                    best, fewest, improved = plan, found, True
    return best


def _beginnings(segments: Sequence[Segment]) -> Iterator[Plan]:
    """Begin with own frames, with shared frames in groups, and with those, but the last of each in its own."""
    yield Plan((Choice(),) * len(segments))
    continued = {s.parent for s in segments if not s.opens_group}
    grouped = [s.number in continued or not s.opens_group for s in segments]
    for ring, scaled in product((0, 1), (False, True)):
        shared = Choice(own_frame=False, ring=ring, scaled=scaled)
        yield Plan(tuple(shared if g else Choice(ring=ring) for g in grouped))
        yield Plan(
            tuple(
                shared if g and s.number in continued else Choice(ring=ring)
                for g, s in zip(grouped, segments, strict=True)
            )
        )


def _alternatives(segments: Sequence[Segment], segment: Segment, *, divide: bool) -> Iterator[Choice]:
    if not segment.is_revolute:
        return
    is_leaf = not children(segments, segment.number)
    masses = [Mass.PASSED]
    if divide and segment.parent:
        masses += [Mass.BALANCING, Mass.POINT] if is_leaf else [Mass.BALANCING]
    for own_frame, mass, ring, scaled in product((True, False), masses, (0, 1), (False, True)):
        if not (scaled and is_leaf):
            yield Choice(own_frame, mass, scaled, ring)
