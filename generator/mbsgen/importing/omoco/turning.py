"""Speeds of balls and free joints: angular velocities in OpenSim, rates of turns in problems -> warnings with lines.

The three speeds of a joint are zero together in both, so bounds of zero on all of them need no warning.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.omoco.study import FREE, Study, Variable

_RATES = "speeds of balls and free joints are angular velocities in the study, but rates of turns in the problem"


def warn_of_bounds(study: Study, findings: Findings) -> None:
    """Warn of each element that bounds a speed which is an angular velocity in OpenSim."""
    found: dict[int, Element] = {}  # an element with a pattern may bound several
    for turns in _list_turns(study):
        for ranges in zip(*((x.limits.whole, x.limits.start, x.limits.end) for x in turns), strict=True):
            if any(bounds != (0.0, 0.0) for bounds in ranges):
                bounded = [x for x, bounds in zip(turns, ranges, strict=True) if bounds != FREE]
                found |= {id(x.origin): x.origin for x in bounded if x.origin is not None}
    for element in found.values():
        findings.warn(element, _RATES)


def warn_of_goal(goal: Element, used: Collection[Variable], study: Study, findings: Findings) -> None:
    """Warn of a goal that uses such a speed."""
    turning = {x.path for turns in _list_turns(study) for x in turns}
    if any(x.path in turning for x in used):
        findings.warn(goal, _RATES)


def _list_turns(study: Study) -> Iterator[list[Variable]]:
    """Yield the speeds of each ball and free joint that turn it."""
    speeds = {x.path.split("/")[-2]: x for x in study.variables.values() if x.kind == "speed"}
    for names in study.imported.balls:
        yield [speeds[name] for name in names if name in speeds]
