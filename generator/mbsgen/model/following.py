"""Joints that follow others: which joint leads each in the end, the faults of their rules, and their limits.

q of a follower is ratio * q of its leader + offset. A leader may follow another joint itself; rules are combined until
they name a joint that has a coordinate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from mbsgen.documents import Finding, abbreviate, nearest
from mbsgen.expressions import Expression, Operation
from mbsgen.model.expansion import Step, list_steps
from mbsgen.model.model import ONE, ZERO, Follow, Model
from mbsgen.model.valuation import Valuation

MAX_CHAIN = 32  # joints that follow each other in a row: the size of a combined offset is the square of it


def list_joints(model: Model) -> list[Step]:
    """List all joints of a model."""
    return [step for i, body in enumerate(model.bodies) for step in list_steps(i, body)]


def find_rules(steps: Sequence[Step]) -> dict[str, Follow]:
    """Return the rule of each follower, which names a joint with a coordinate. The model has no faults."""
    own = {step.name: step.joint.follows for step in steps if step.joint.follows is not None}
    found = {}
    for name in own:
        rule = own[name]
        while rule.joint in own:
            further = own[rule.joint]
            offset = _sum(_product(rule.ratio, further.offset), rule.offset)
            rule = Follow(further.joint, _product(rule.ratio, further.ratio), offset)
        found[name] = rule
    return found


def place_followers(steps: Sequence[Step], coordinates: Mapping[str, Expression]) -> dict[str, Expression]:
    """Return the coordinates of some joints, and of all their followers."""
    rules = find_rules(steps)
    found = {
        name: _sum(_product(rule.ratio, coordinates[rule.joint]), rule.offset)
        for name, rule in rules.items()
        if rule.joint in coordinates
    }
    return {**found, **coordinates}


def check_followers(model: Model, valuation: Valuation) -> Iterator[Finding]:
    """Find what keeps joints from following others."""
    steps = list_joints(model)
    by_name = {step.name: step for step in steps}
    faults = [*_check_rules(steps, by_name, valuation)]
    yield from faults
    if not faults and not valuation.findings:
        yield from _check_bounds(steps, by_name, valuation)
        yield from _check_limits(steps, by_name, valuation)


def _check_rules(steps: Sequence[Step], by_name: Mapping[str, Step], valuation: Valuation) -> Iterator[Finding]:
    for step in steps:
        follow = step.joint.follows
        if follow is None:
            continue
        place = (*step.place, "follows")
        for key, number in (("ratio", follow.ratio), ("offset", follow.offset)):
            if valuation.number((*place, key), number) == 0 and key == "ratio":
                yield Finding((*place, key), "a ratio of 0", "make the joint fixed, or give another ratio")
        if step.joint.actuated:
            finding = "an input of a joint that follows another"
            yield Finding((*step.place, "actuated"), finding, "leave it out: its force is felt in the other joint")
        if follow.joint not in by_name:
            meant = nearest(follow.joint, list(by_name))
            remedy = f"did you mean {abbreviate(meant)}?" if meant else "name another joint"
            yield Finding((*place, "joint"), f"there is no joint {abbreviate(follow.joint)}", remedy)
        elif by_name[follow.joint].joint.floats:
            finding = f"{abbreviate(follow.joint)} is part of a joint with a quaternion"
            yield Finding((*place, "joint"), finding, "name a joint that turns about, or slides along, one axis")
        elif _leads_back(step, by_name):
            yield Finding((*place, "joint"), "the joint follows itself in the end", "let one joint follow none")
        elif len(leaders := _list_leaders(step, by_name)) > MAX_CHAIN:
            finding = f"a chain of more than {MAX_CHAIN} joints that follow each other"
            yield Finding((*place, "joint"), finding, f"let it follow {abbreviate(leaders[-1])}")


def _leads_back(step: Step, by_name: Mapping[str, Step]) -> bool:
    return step.name in _list_leaders(step, by_name)


def _list_leaders(step: Step, by_name: Mapping[str, Step]) -> list[str]:
    """List the joints that lead a joint, from the next one on, each once."""
    name, found = step.name, dict[str, None]()
    while name in by_name:
        follow = by_name[name].joint.follows
        if follow is None or follow.joint in found:
            break
        name = follow.joint
        found[name] = None
    return [*found]


@dataclass(frozen=True)
class Range:
    """Where a joint may be, and how fast it may be; infinite where nothing bounds it."""

    lower: float = -math.inf
    upper: float = math.inf
    speed: float = math.inf

    def seen_by_leader(self, ratio: float, offset: float) -> Range:
        """Return the range of a leader that belongs to a follower's range."""
        low, high = sorted(((self.lower - offset) / ratio, (self.upper - offset) / ratio))
        return Range(low, high, self.speed / abs(ratio))

    def met(self, other: Range) -> Range:
        """Meet two ranges."""
        return Range(max(self.lower, other.lower), min(self.upper, other.upper), min(self.speed, other.speed))


def find_range(name: str, ranges: Mapping[str, Range], rules: Mapping[str, tuple[str, float, float]]) -> Range:
    """Return the range of a joint with a coordinate, including the ranges of all its followers."""
    found = ranges[name]
    for follower, (leader, ratio, offset) in rules.items():
        if leader == name:
            found = found.met(ranges[follower].seen_by_leader(ratio, offset))
    return found


def _check_bounds(steps: Sequence[Step], by_name: Mapping[str, Step], valuation: Valuation) -> Iterator[Finding]:
    """Find followers whose bounds would bind the leader by a run-time number."""
    for name, rule in find_rules(steps).items():
        joint, place = by_name[name].joint, by_name[name].place
        key = "max_speed" if (joint.lower, joint.upper) == (None, None) else "limits"
        is_bound = key == "limits" or joint.max_speed is not None
        if is_bound and (valuation.changes(rule.ratio) or valuation.changes(rule.offset)):
            finding = f"a bound of a joint that follows {abbreviate(rule.joint)} at a ratio that may change at run time"
            yield Finding((*place, key), finding, "bound the other joint")


def _check_limits(steps: Sequence[Step], by_name: Mapping[str, Step], valuation: Valuation) -> Iterator[Finding]:
    def number(limit: Expression | None, otherwise: float) -> float:
        return otherwise if limit is None else valuation.number((), limit)

    ranges = {
        step.name: Range(number(step.joint.lower, -math.inf), number(step.joint.upper, math.inf)) for step in steps
    }
    rules = {
        name: (rule.joint, valuation.number((), rule.ratio), valuation.number((), rule.offset))
        for name, rule in find_rules(steps).items()
    }
    for leader in dict.fromkeys(leader for leader, _, _ in rules.values()):
        found = find_range(leader, ranges, rules)
        if found.lower > found.upper:
            finding = "the limits of its followers leave the joint no range"
            yield Finding((*by_name[leader].place, "limits"), finding, "widen them")


def _sum(a: Expression, b: Expression) -> Expression:
    return b if a == ZERO else a if b == ZERO else Operation("+", a, b)


def _product(a: Expression, b: Expression) -> Expression:
    if ZERO in (a, b):
        return ZERO
    return b if a == ONE else a if b == ONE else Operation("*", a, b)
