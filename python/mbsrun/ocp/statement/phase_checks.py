"""Check a problem of phases: every phase, and what links say of both sides; report all faults at once.

`find_faults` gives the places of faults in a problem file; `check_phases` raises them for a problem made in Python.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbsgen.documents import Finding, Place, abbreviate, nearest, write_path
from mbsgen.expressions import ExpressionError, names, parse
from mbsgen.manifest import Manifest
from mbsrun.differentiation import DerivativeError, differentiate
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.methods import METHODS, choose
from mbsrun.ocp.problem.phases import Impact, Link, Map, Phase, PhasedProblem, Plants
from mbsrun.ocp.problem.problem import Contact, Loops, Problem
from mbsrun.ocp.problem.rewriting import RATE, RATE_OF
from mbsrun.ocp.statement.checks import Line, ProblemError, check_problem
from mbsrun.ocp.transcription.delays import Half, Shift, find_misfits, find_shifts
from mbsrun.ocp.transcription.impacts import AXES, find_axes, find_wrench
from mbsrun.ocp.transcription.sides import (
    END,
    START,
    list_plain,
    list_readable,
    name_blows,
    name_impulses,
    spell_coordinates,
    spell_velocities,
)
from mbsrun.quaternions import find_quaternion, list_quaternions, neutral

APART = 1e-9  # m: a wrench that acts farther from a sensor than this is not the force at it
SHOWN = 8  # names


def check_phases(problem: PhasedProblem, plants: Plants) -> None:
    """Raise ProblemError with every fault of a problem of phases."""
    findings: list[Line] = []
    for phase, plant in zip(problem.phases, plants.phases, strict=True):
        try:
            check_problem(phase.problem, plant.manifest, is_phase=not problem.is_single)
        except ProblemError as error:
            findings += [name_phase(phase, finding) for finding in error.findings]
    faults = [] if findings or problem.is_single else list(find_faults(problem, plants))
    findings += [(write_path(fault.place), fault.finding, fault.remedy) for fault in faults]
    if findings:
        raise ProblemError(problem.name, findings)


def name_phase(phase: Phase, finding: Line) -> Line:
    """Return a finding in a phase as one in the whole problem."""
    place, found, remedy = finding
    return f"{phase.title}{place}", found, remedy


def find_faults(problem: PhasedProblem, plants: Plants) -> Iterator[Finding]:
    """Find the faults of phases among each other, and of links; each phase by itself has none."""
    yield from _check_whole(problem)
    known = [phase.name for phase in problem.phases]
    for i, link in enumerate(problem.links):
        place: Place = ("links", i)
        missing = [(key, name) for key, name in (("from", link.source), ("to", link.target)) if name not in known]
        for key, name in missing:
            remedy = _suggest(name, known) or f"there are {', '.join(known)}"
            finding = f"there is no phase {abbreviate(name)}" if name else "missing"
            yield Finding((*place, key), finding, remedy)
        if link.target in [other.target for other in problem.links[:i]]:
            finding = f"a second link leads to the start of {link.target}"
            yield Finding((*place, "to"), finding, "leave one out: one link gives a start")
        if not missing:
            yield from _Link(problem, plants, i).check()


def _check_whole(problem: PhasedProblem) -> Iterator[Finding]:
    if not problem.phases:
        yield Finding(("phases",), "there are none", "give at least one phase")
        return
    if not problem.weight:
        yield Finding(("phases",), "every weight of every phase's cost is 0", "give one of them a cost")
    for k, phase in enumerate(problem.phases):
        place: Place = ("phases", k)
        if not re.fullmatch(r"[A-Za-z]\w*", phase.name, re.ASCII):
            yield Finding((*place, "name"), f"found {abbreviate(phase.name)}", "give a word of letters and digits")
        if phase.name in [other.name for other in problem.phases[:k]]:
            yield Finding((*place, "name"), f"a second phase {phase.name}", "give it another name")
    calls_casadi = any(phase.problem.functions for phase in problem.phases)
    method = choose(problem.solver, calls_casadi=calls_casadi)
    if calls_casadi and not METHODS[method].calls_casadi:
        finding = f"{method} takes no expressions of CasADi, which a phase has"
        yield Finding(("solver", "method"), finding, "take ipopt")
    if problem.solver.threads > 1 and not METHODS[method].has_threads:
        finding = f"found {problem.solver.threads}, but {method} has one thread"
        yield Finding(("solver", "threads"), finding, "leave it out, or choose mbs")


@dataclass(frozen=True)
class _Link:
    """A link and both of its sides."""

    problem: PhasedProblem
    plants: Plants
    index: int

    @property
    def link(self) -> Link:
        return self.problem.links[self.index]

    @property
    def place(self) -> Place:
        return ("links", self.index)

    @property
    def free(self) -> list[str]:
        """List constants and unknowns."""
        return [
            *(name for name, _ in self.problem.constants),
            *(unknown.name for unknown in self.problem.every_unknown),
        ]

    def check(self) -> Iterator[Finding]:
        """Find the faults."""
        link, problem = self.link, self.problem
        source, target = problem.find(link.source), problem.find(link.target)
        before, after = self.plants.phases[source], self.plants.phases[target]
        left, own = before.manifest, problem.phases[source].problem
        if link.impact is not None:
            plant = self.plants.find_impact(self.index, source)
            yield from self.check_impact(link.impact, plant, left, own)
            yield from self.check_rebound(link.impact, problem.phases[target].problem)
            left = plant.manifest
        elif own.loops is Loops.REDUCED and set(left.independent) < set(range(len(left.coordinates))):
            yield from self.check_speeds(problem.phases[target].problem)
        states = [[state.name for state in x.states] for x in (own, problem.phases[target].problem)]
        yield from self.check_map((*self.place, "map"), link.map, left, after.manifest, link.velocities, *states)
        yield from self.check_velocities(link.velocities, left, after.manifest)
        yield from self.check_ends(own, problem.phases[target].problem, before, after)
        known = [
            prefix + name
            for prefix, plant, part in ((END, before, own), (START, after, problem.phases[target].problem))
            for name in list_readable(plant.manifest, part)
        ]
        known += self.free
        if link.impact is not None:
            known += [name for name, _, _ in name_impulses(link.impact.contacts)]
            known += [name for name, _ in name_blows(link.impact.blows)]
        yield from self.check_delays(own, problem.phases[target].problem, before.manifest, after.manifest)
        for i, term in enumerate(link.cost):
            yield from _check_expression((*self.place, "cost", i, "expression"), term.expression, known)
            if not math.isfinite(term.weight):
                yield Finding((*self.place, "cost", i, "weight"), f"found {term.weight:g}", "give a finite number")
        for i, condition in enumerate(link.conditions):
            place = (*self.place, "conditions", i)
            yield from _check_expression((*place, "expression"), condition.expression, known)
            lower, upper = condition.range
            if lower > upper:
                yield Finding(
                    (*place, "range"), f"{lower:g} is above {upper:g}", "give [lower, upper]; null is no bound"
                )

    def check_speeds(self, target: Problem) -> Iterator[Finding]:
        """Refuse a mechanism that reads velocities which the reduced form of loops leaves out."""
        if target.loops is not Loops.REDUCED:
            finding = f"phase {self.link.source} has loops: reduced, phase {self.link.target} has all velocities"
            yield Finding(self.place, finding, "take loops: multipliers in both, or reduced in both")

    def check_map(
        self,
        place: Place,
        given: Map,
        before: Manifest,
        after: Manifest,
        velocities: Map = (),
        states_before: Sequence[str] = (),
        states_after: Sequence[str] = (),
    ) -> Iterator[Finding]:
        """Check the coordinates and states that a map gives, and the ones that it does not."""
        known = [*spell_coordinates(before), *states_before, *self.free]
        plain = list_plain(after)
        for name, text in given:
            if name in states_after:
                if text is not None:
                    yield from _check_expression((*place, name), text, known)
            elif name not in plain:
                remedy = _suggest(name, plain) or f"there are {', '.join(plain)}"
                yield Finding((*place, name), f"{after.model} has no such coordinate to map", remedy)
            elif text is not None:
                yield from _check_expression((*place, name), text, known)
                yield from _check_rate((*place, name), text, before)
        joints = {x.joint for x in list_quaternions(before)}
        missing = [name for name in plain if name not in dict(given) and name not in before.positions]
        missing += [x.joint for x in list_quaternions(after) if x.joint not in joints]
        if missing:
            finding = f"{before.model} has no coordinate {', '.join(missing)}, which {after.model} has"
            yield Finding(place, finding, "give each an expression, or null where it is free")
        twice = sorted({name for name in known if known.count(name) > 1} | (set(plain) & set(states_after)))
        if twice:
            finding = f"{', '.join(twice)} has two meanings, among coordinates, states, constants and unknowns"
            yield Finding(place, finding, "rename one of them")
        speeds = [c.name for c in before.coordinates]
        lost = [
            c.name
            for c in after.coordinates
            if c.name not in speeds and c.name not in dict(velocities) and c.name not in dict(given)
        ]
        if lost and not missing:
            finding = f"{before.model} has no velocity of {', '.join(lost)}"
            yield Finding((*place[:-1], "velocities"), finding, "give each an expression, or null where it is free")

    def check_velocities(self, given: Map, before: Manifest, after: Manifest) -> Iterator[Finding]:
        """Check velocities that are not the rates of the map."""
        known = [*spell_velocities(before), *self.free]
        joints = [c.name for c in after.coordinates]
        for name, text in given:
            place = (*self.place, "velocities", name)
            if name not in joints:
                remedy = _suggest(name, joints) or f"there are {', '.join(joints)}"
                yield Finding(place, f"{after.model} has no such velocity", remedy)
            elif text is not None:
                yield from _check_expression(place, text, known)

    def check_ends(self, source: Problem, target: Problem, before: Plant, after: Plant) -> Iterator[Finding]:
        """Refuse coordinates that the end before, the start after and the link all give."""
        given, chosen = dict(source.end.coordinates), dict(self.link.map)
        plain = list_plain(after.manifest)
        turning = list_quaternions(before.manifest)
        for i, name in enumerate(before.manifest.positions):
            if i not in given or name in chosen or name not in plain or find_quaternion(turning, i) is not None:
                continue
            if after.manifest.positions.index(name) not in target.free_start:
                finding = f"{name} has a value at the end of {self.link.source} and at the start of {self.link.target}"
                yield Finding(self.place, finding, "leave one out: the link gives the other")

    def check_delays(self, source: Problem, target: Problem, before: Manifest, after: Manifest) -> Iterator[Finding]:
        """Refuse histories by this link which the phase before cannot give."""
        halves = Half(self.link.source, source, before), Half(self.link.target, target, after)
        k = self.problem.find(self.link.target)
        for shift in find_shifts(*halves):
            if not shift.repeats:
                continue
            for finding, remedy in find_misfits(shift, *halves):
                yield Finding(("phases", k, *_place_history(shift)), finding, remedy)
            if shift.kind == "state" and shift.name in dict(self.link.map):
                finding = "inputs of the phase before give it, since it has history: link and a longer delay"
                yield Finding((*self.place, "map", shift.name), finding, "leave it out, or give another history")

    def check_impact(self, impact: Impact, plant: Plant, before: Manifest, own: Problem) -> Iterator[Finding]:
        """Check the contacts of an impact, and its model."""
        place, manifest = (*self.place, "impact"), plant.manifest
        if not impact.contacts and not impact.blows:
            yield Finding((*place, "contacts"), "there are none", "name the sensors that hit the ground")
        if not 0 <= impact.restitution <= 1:
            finding = f"found {impact.restitution:g}"
            yield Finding((*place, "restitution"), finding, "give a number from 0 to 1")
        if own.loops is Loops.REDUCED:
            finding = f"phase {self.link.source} has loops: reduced, and an impact changes all velocities"
            yield Finding(place, finding, "take loops: multipliers")
        if manifest is not before or impact.map:
            yield from self.check_map((*place, "map"), impact.map, before, manifest)
        sensors = [frame.name for frame in manifest.frames if frame.sensor]
        for i, contact in enumerate(impact.contacts):
            yield from _check_contact((*place, "contacts", i), contact, plant, sensors)

    def check_rebound(self, impact: Impact, after: Problem) -> Iterator[Finding]:
        """Refuse contacts that leave the ground after an impact, and that the phase after holds."""
        held = {(contact.sensor, contact.normal) for contact in after.contacts}
        for contact in impact.contacts if impact.restitution else ():
            if contact.normal in contact.axes and (contact.sensor, contact.normal) in held:
                finding = f"{contact.sensor} rebounds, and phase {self.link.target} holds it"
                remedy = "give restitution: 0, or leave the contact out of that phase"
                yield Finding((*self.place, "impact", "restitution"), finding, remedy)


def _place_history(shift: Shift) -> Place:
    """Return the place of a history in the file of a phase."""
    is_control = shift.kind == "control" or (
        shift.kind == "state" and shift.rate in (RATE + shift.name, RATE_OF + shift.name)
    )
    return ("controls", shift.name, "history") if is_control else ("inputs", "history")


def _check_contact(place: Place, contact: Contact, plant: Plant, sensors: Sequence[str]) -> Iterator[Finding]:
    manifest = plant.manifest
    if contact.sensor not in sensors:
        remedy = _suggest(contact.sensor, sensors) or f"there are {', '.join(sensors) or 'none'}"
        yield Finding(place, f"{manifest.model} has no sensor {abbreviate(contact.sensor)}", remedy)
        return
    if contact.friction is not None and not contact.friction >= 0:
        yield Finding((*place, "friction"), f"found {contact.friction:g}", "give a number that is not negative")
    moving = find_axes(plant, contact.sensor)
    still = [AXES[axis] for axis in contact.axes if axis not in moving]
    if still:
        finding = f"{contact.sensor} cannot move along {', '.join(still)}"
        yield Finding((*place, "axes"), finding, f"give axes: {''.join(AXES[axis] for axis in moving)}")
    first = find_wrench(manifest, contact.wrench)
    if first is None:
        open_ones = [x.name for x in manifest.wrenches if x.force and x.in_base]
        finding = f"{manifest.model} leaves no force {abbreviate(contact.wrench)} open, in axes of the base"
        remedy = "give the model wrenches: [{name: NAME, body: ..., position: ..., frame: base, force: input}]"
        if open_ones:
            remedy = f"there are {', '.join(open_ones)}"
        yield Finding(place, finding, remedy)
        return
    apart = _measure_distance(plant, sensors.index(contact.sensor), first)
    if apart > APART:
        finding = f"the wrench {contact.wrench} does not act at the sensor {contact.sensor}"
        yield Finding(place, finding, "give both the same body and position in the model")


def _measure_distance(plant: Plant, sensor: int, first: int) -> float:
    """Compare the velocities of a sensor with the forces of a wrench, J_c' and -dPhi/dw, at some pose."""
    manifest = plant.manifest
    n = len(manifest.coordinates)
    q = neutral(manifest) + 0.3 * np.sin(np.arange(1, len(manifest.positions) + 1))
    state: dict[str, Any] = {a.name: np.zeros(a.rows) for a in plant.describe("impl").inputs if a.name in _STATE} | {
        "q": q
    }
    by_force = plant("jac_impl", **state)["jac_Phi_w"][:, first : first + 3]
    J = plant("jac_motion", q=q, qd=np.zeros(n))["jac_v_qd"][3 * sensor : 3 * sensor + 3]
    return float(np.abs(by_force + J.T).max())


_STATE = ("q", "qd", "qdd", "u", "w", "lam")


def _check_expression(place: Place, text: str, known: Sequence[str]) -> Iterator[Finding]:
    """Check the names that an expression reads."""
    try:
        read = sorted(names(parse(text)))
    except ExpressionError as error:
        yield Finding(place, error.finding, error.remedy)
        return
    for name in read:
        if name not in known:
            some = ", ".join(known[:SHOWN]) + (", ..." if len(known) > SHOWN else "")
            remedy = _suggest(name, known) or f"known here are {some}"
            yield Finding(place, f"unknown name {abbreviate(name)}", remedy)


def _check_rate(place: Place, text: str, before: Manifest) -> Iterator[Finding]:
    try:
        differentiate(parse(text), {name: parse("1") for name in spell_coordinates(before)})
    except DerivativeError as error:
        yield Finding(place, error.finding, error.remedy)
    except ExpressionError:
        return  # another check refuses what cannot be read


def _suggest(name: str, known: Sequence[str] | Mapping[str, object]) -> str | None:
    meant = nearest(name, list(known))
    return f"did you mean {abbreviate(meant)}?" if meant else None
