"""Delays across random links: each phase reads the commands as they were its own delay ago.

A delay that grows lets the last inputs of the phase before act again; a delay that shrinks leaves commands out.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.fuzz.own_sections import NEAR, Demand, Sections
from tests.fuzz.problem_drawing import Data
from tests.fuzz.problem_names import spell

Array = NDArray[np.float64]

STEP = 0.08  # s: an interval of both phases
DELAYED = 0.6  # of their inputs


def can_fit(part: Data) -> bool:
    """Return whether a phase can have delays that the grid of another one admits."""
    return "inputs" in part and not isinstance(part["horizon"], dict)


def fit(first: Data, second: Data, inputs: tuple[str, ...], pick: random.Random) -> None:
    """Fit the grids of two phases, so that inputs of one may act again in the other; draw other delays."""
    course, degree = pick.choice(["constant", "linear", "polynomial"]), pick.choice([1, 2, 3])
    for part, fine in ((first, 1), (second, pick.choice([1, 1, 2]))):
        count = pick.randint(2, 4)
        part |= {"intervals": count * fine, "horizon": STEP * count, "degree": degree}
        open_inputs = [x for x in inputs if x not in part.get("forces", {}) and pick.random() < DELAYED]
        part["inputs"] = {"course": course}
        if open_inputs:
            part["inputs"]["delay"] = {x: STEP * pick.randint(1, count - 1) for x in open_inputs}
        for control in part["controls"].values():
            control.pop("delay", None)
            control.pop("history", None)
            if pick.random() < DELAYED:
                control["delay"] = STEP * pick.randint(1, count - 1)


def link(target: Data, pick: random.Random) -> None:
    """Choose what acts first in a phase that a link leads to."""
    histories = ["link", "link", "link", "free", 0.2]
    inputs = target.get("inputs", {})
    if isinstance(inputs, dict) and "delay" in inputs:
        inputs["history"] = {name: pick.choice(histories) for name in inputs["delay"]}
    for control in target.get("controls", {}).values():
        if "delay" in control:
            control["history"] = pick.choice(histories)


@dataclass(frozen=True)
class Delayed:
    """An input on both sides of a link."""

    name: str
    state: str  # its name where it is continuous; else empty
    rate: str
    before: float  # its delay [s]
    after: float
    is_linked: bool

    @property
    def differs(self) -> bool:
        """Return whether it acts with another delay after the link."""
        return abs(self.after - self.before) > NEAR

    def read(self, part: Sections) -> Array:
        """Return the values at the points, (N, d): of the input, or of its rate."""
        values = part.points[self.rate if self.state else self.name]
        return np.asarray(values).reshape(part.motion.intervals, -1)


def list_delayed(before: Sections, after: Sections) -> Iterator[Delayed]:
    """List the inputs and controls of which one phase at least has a delay."""
    left, right = before.problem, after.problem
    for x in before.own.inputs:
        delays = [part.inputs.get("delay", {}).get(x, 0.0) for part in (left, right)]
        is_linked = right.inputs.get("history", {}).get(x) == "link"
        state = f"input_{spell(x)}" if x in left.lifted or x in right.lifted else ""
        yield Delayed(f"u_{spell(x)}", state, f"rate_u_{spell(x)}", delays[0], delays[1], is_linked)
    both = [part.data.get("controls", {}) for part in (left, right)]
    for x in dict.fromkeys((*both[0], *both[1])):
        delays = [part.get(x, {}).get("delay", 0.0) for part in both]
        state = x if x in left.lifted_controls or x in right.lifted_controls else ""
        yield Delayed(x, state, f"rate_{x}", delays[0], delays[1], both[1].get(x, {}).get("history") == "link")


def list_demands(before: Sections, after: Sections) -> Iterator[Demand]:
    """List what commands ask that act twice, or never."""
    for delayed in list_delayed(before, after):
        if not delayed.differs:
            continue
        if delayed.after > delayed.before:
            if delayed.is_linked:
                yield from _repeat(delayed, before, after)
        elif delayed.state in before.motion.states and delayed.state in after.motion.states:
            yield from _jump(delayed, before, after)


def _repeat(delayed: Delayed, before: Sections, after: Sections) -> Iterator[Demand]:
    """Ask that the last inputs of the phase before act again; the numbers are differences from them."""
    shift = delayed.after - delayed.before
    old, new = before.motion, after.motion
    given, found = delayed.read(before), delayed.read(after)
    t = old.t - old.T + shift  # in the phase after
    differences: list[float] = []
    for j in range(new.intervals):
        if new.t[j + 1] > shift + NEAR:
            break
        k = int(np.flatnonzero(t <= new.t[j] + NEAR)[-1])
        if before.problem.course != "polynomial":
            differences.append(float(found[j, 0] - given[k, 0]))
            continue
        places = (new.point_t[j] - t[k]) / (t[k + 1] - t[k])
        curve = np.polyfit(before.problem.nodes, given[k], len(given[k]) - 1)
        differences += (found[j] - np.polyval(curve, places)).tolist()
    if delayed.state:
        k = int(np.argmin(abs(t)))
        differences.append(float(new.states[delayed.state][0] - old.states[delayed.state][k]))
    yield Demand(f"{delayed.name} again", np.array(differences), (0.0, 0.0))


def _jump(delayed: Delayed, before: Sections, after: Sections) -> Iterator[Demand]:
    """Ask that a continuous input changes no farther than its rate permits."""
    shift, rates = delayed.before - delayed.after, None
    if delayed.rate.startswith("rate_u_"):
        given = before.data.get("bounds", {}).get("input_rates", {})
        (name,) = (x for x in before.own.inputs if f"u_{spell(x)}" == delayed.name)
        rates = given if isinstance(given, list) else given.get(name)
    else:
        rates = before.data["controls"][delayed.name].get("rate", {}).get("range")
    low, high = before.read(rates or (None, None))
    jump = after.motion.states[delayed.state][0] - before.motion.states[delayed.state][-1]
    if np.isfinite((low, high)).any():
        yield Demand(f"the jump of {delayed.name}", np.array([jump]), (shift * low, shift * high))
