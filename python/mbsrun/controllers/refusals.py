"""Parts of a problem that a controller in C cannot have: what was found, where a problem file says it, what to do."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from mbsgen.documents import Data, Document, Place
from mbsgen.errors import Fault
from mbsgen.manifest import Manifest
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.problem.rewriting import INPUT
from mbsrun.quantities import SIGNAL

EVERY = "*"  # in a place: each key of a mapping, each entry of a list

_HOLDS = "a controller holds its inputs from sample to sample"
_CHOOSES = "a controller chooses the inputs of the model alone"
_REMEMBERS = "a controller remembers the inputs that it gave"


@dataclass(frozen=True)
class Refusal:
    """A part that a controller cannot have; EVERY in `place` stands for all keys or entries."""

    place: Place
    finding: str
    remedy: str

    @property
    def key(self) -> str:
        """Return the key of a problem file that holds the part."""
        return ".".join(str(step) for step in self.place if step != EVERY)


@dataclass(frozen=True)
class _Rule:
    refusal: Refusal
    is_broken: Callable[[Problem], object]


def _rule(place: Place, finding: str, remedy: str, is_broken: Callable[[Problem], object]) -> _Rule:
    return _Rule(Refusal(place, finding, remedy), is_broken)


def _list_lifted(problem: Problem) -> list[str]:
    """List the states that `inputs: linear` makes."""
    return [force.expression for force in problem.forces if force.expression.startswith(INPUT)]


def _bounds_rates_of_controls(problem: Problem) -> bool:
    return any(math.isfinite(limit) for control in problem.controls for limit in control.rates)


_RULES = (
    _rule(
        ("intervals",),
        "a controller moves its plan ahead by equal intervals, and these differ",
        "give their number",
        lambda problem: problem.mesh is not None,
    ),
    _rule(
        ("scheme",),
        "a controller keeps states at points, and lobatto has slopes beside them",
        "take radau or legendre",
        lambda problem: problem.family is Family.LOBATTO,
    ),
    _rule(
        ("inputs",),
        f"{_HOLDS}, and these change within an interval",
        "take constant ones",
        lambda problem: problem.inputs != "constant" or _list_lifted(problem),
    ),
    _rule(
        ("inputs", "history"),
        f"{_REMEMBERS}, and these are free",
        "give their values at the start",
        lambda problem: any(delay.kind == "input" and delay.history is None for delay in problem.delays),
    ),
    _rule(
        ("bounds", "input_rates"),
        f"{_REMEMBERS} a period before, and the length of a period is free here",
        "give the horizon, or price rates by cost.input_rates",
        lambda problem: problem.bounds.rates and not problem.is_timed,
    ),
    _rule(
        ("driven",),
        "a controller plans from any time on, and driven joints move by the time of the problem",
        "give these joints actuators in the model, and references or constraints that they follow",
        lambda problem: problem.driven,
    ),
    _rule(
        ("contacts",),
        f"{_CHOOSES}, and contacts have unknown forces",
        "leave contacts out, or give the model compliant ones under its key contacts",
        lambda problem: problem.contacts or problem.touching,
    ),
    _rule(
        ("controls", EVERY, "delay"),
        f"{_REMEMBERS} to joints alone, and controls act late",
        "delay an input of the model, or leave the delay out",
        lambda problem: any(delay.kind == "control" for delay in problem.delays),
    ),
    _rule(
        ("controls", EVERY, "rate"),
        f"{_REMEMBERS} to joints alone, and rates of controls have bounds",
        "price the rates by weight, or make a state of the control and a control of its rate",
        _bounds_rates_of_controls,
    ),
    _rule(
        ("functions",),
        "a controller is C, and the problem has expressions of CasADi",
        "write them as text",
        lambda problem: problem.functions,
    ),
)


def find_refusals(problem: Problem, manifest: Manifest) -> list[Refusal]:
    """List all parts of a problem that a controller cannot have."""
    found = [rule.refusal for rule in _RULES if rule.is_broken(problem)]
    return [*found, *_find_open_wrenches(problem, manifest)]


def _find_open_wrenches(problem: Problem, manifest: Manifest) -> Iterator[Refusal]:
    """Find wrenches and signals of the model; the wrenches of contacts are refused with these."""
    if manifest.signals:
        finding = f"{_CHOOSES}, and forces of the model read {', '.join(manifest.signals)} too"
        yield Refusal(("signals",), finding, "put constants into the model in place of these")
    touched = {contact.wrench for contact in (*problem.contacts, *problem.touching)}
    left = {part.wrench for part in problem.wrenches if part.component != SIGNAL} - touched
    if left:
        finding = f"{_CHOOSES}, and the model leaves {', '.join(sorted(left))} open"
        yield Refusal(("wrenches",), finding, "describe them under forces of the model, or leave them out there")


def locate(refusals: Sequence[Refusal], document: Document) -> list[Fault]:
    """Return the faults of a problem file; a part that is in several places is a fault in each."""
    return [
        document.fault(place, refusal.finding, refusal.remedy)
        for refusal in refusals
        for place in _expand(document.data, refusal.place)
    ]


def _expand(data: Data, pattern: Place) -> list[Place]:
    """List the places of a pattern that the data has; where there is none, the part of it before EVERY."""
    found = list(_walk(data, pattern))
    return found or [pattern[: pattern.index(EVERY)] if EVERY in pattern else pattern]


def _walk(data: Data, pattern: Place) -> Iterator[Place]:
    if not pattern:
        yield ()
        return
    step, *rest = pattern
    entries: dict[str | int, Data] = {}
    if isinstance(data, dict):
        entries = dict(data.items())
    elif isinstance(data, list):
        entries = dict(enumerate(data))
    for key in entries if step == EVERY else [step] if step in entries else []:
        for inner in _walk(entries[key], tuple(rest)):
            yield (key, *inner)
