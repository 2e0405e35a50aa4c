"""The parts of a problem file that add to a mechanism: states, controls, integrals, unknown numbers.

`statement` reads the other parts; expressions everywhere read the names that are added here.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from mbsgen.documents import Document, Place, abbreviate, nearest
from mbsgen.expressions import Expression, is_free_name, names, parse
from mbsgen.manifest import TIME, Manifest
from mbsrun.ocp.problem.contacts import find_faults as find_contact_faults
from mbsrun.ocp.problem.design import list_changeable
from mbsrun.ocp.problem.driving import find_wrong_motions
from mbsrun.ocp.problem.given import find_faults, list_open_components
from mbsrun.ocp.problem.problem import (
    Constraint,
    Contact,
    Control,
    Drive,
    Force,
    Integral,
    Problem,
    Range,
    Relaxation,
    State,
    Unknown,
    WrenchComponent,
    list_names,
)
from mbsrun.ocp.problem.touching import SLIP, list_components, list_constraints, name_slip
from mbsrun.ocp.problem.touching import find_faults as find_touching_faults
from mbsrun.ocp.statement.referring import Referring
from mbsrun.ocp.statement.sections import (
    ContactSection,
    ControlSection,
    IntegralSection,
    Limits,
    ProblemSection,
    RelaxationSection,
    StateSection,
    UnknownForceSection,
    UnknownSection,
    WrenchSection,
)
from mbsrun.ocp.transcription.quantities import Quantity
from mbsrun.quantities import SIGNAL, find_component
from mbsrun.reading import Reading

FREE: Range = (-math.inf, math.inf)


class PartReading(Reading):
    """Reads expressions of a motion, and the parts that add to it; collects the faults."""

    def __init__(self, document: Document, stand_ins: frozenset[Place], manifest: Manifest) -> None:
        super().__init__(document, stand_ins)
        self.manifest = manifest
        self.is_linked = False  # a link gives the start
        self.referring = Referring(self, manifest, Path(document.file).parent)
        self.quantities: dict[str, Quantity] = {}  # everything that an expression of the motion reads
        self.used: set[str] = set()  # constants that formulas read
        self.standing: list[int] = []  # the contacts of the file that stand
        self.has_wrong_contacts = False

    def check_formula(self, place: Place, text: str) -> None:
        """Look up the names that an expression of the motion reads."""
        for name in sorted(names(parse(text))):
            if name in self.constants:
                self.used.add(name)
            elif name not in self.quantities and not self.referring.find(place, name):
                meant = nearest(name, [*self.quantities, *self.constants, *self.referring.list_names()])
                remedy = f"did you mean {abbreviate(meant)}?" if meant else "there are t, T, q_NAME, u_NAME, x_SENSOR"
                self.fault(place, f"unknown name {abbreviate(name)}", remedy)

    def add_names(self, section: ProblemSection) -> None:
        """Add the names of states, controls and unknowns to the names that expressions read."""
        for key, kind, given in (
            ("states", "a state", section.states),
            ("controls", "a control", section.controls),
            ("unknowns", "an unknown", section.unknowns),
        ):
            for i, name in enumerate(given):
                self.add_name((key, name), name, kind, Quantity(key, i))

    def add_name(self, place: Place, name: str, kind: str, quantity: Quantity) -> None:
        """Add a name to the names that expressions read."""
        if not is_free_name(name) or name in self.quantities or name in self.constants:
            named = "" if name in place else f": {abbreviate(name)}"
            self.fault(place, f"no name for {kind}{named}", "give a name that nothing else has")
        self.quantities.setdefault(name, quantity)

    def states(self, given: Mapping[str, StateSection]) -> tuple[State, ...]:
        """Read the states that the problem adds."""
        return tuple(self.state(name, section) for name, section in given.items())

    def state(self, name: str, section: StateSection) -> State:
        """Read a state."""
        place: Place = ("states", name)
        self.check_formula((*place, "rate"), section.rate)
        bounds = self.range((*place, "range"), section.range)
        if "start" not in section.model_fields_set and not self.is_linked:
            self.fault((*place, "start"), "missing", "give it, e.g. 0.0; null is free")
        start, end = (self.condition((*place, key), getattr(section, key), bounds) for key in ("start", "end"))
        guess = self.straight((*place, "guess"), section.guess, bounds)
        return State(name, section.rate, bounds, start, end, guess)

    def condition(self, place: Place, given: Expression | Limits | None, bounds: Range) -> Range:
        """Read a value of a state, or limits of it, which leave room within its range."""
        if given is None:
            return FREE
        if isinstance(given, tuple):
            lower, upper = self.range(place, given)
        else:
            lower = upper = self.limit(place, given)
        if lower > bounds[1] or upper < bounds[0]:
            finding = f"{lower:g} is out of [{bounds[0]:g}, {bounds[1]:g}]"
            self.fault(place, finding, "keep to the range of the state")
        return (lower, upper)

    def straight(
        self, place: Place, given: Expression | tuple[Expression, Expression] | None, bounds: Range
    ) -> float | tuple[float, float] | None:
        """Read the guess of a state: a number, two, or none."""
        if given is None:
            return None
        if not isinstance(given, tuple):
            return self.guessed(place, given, bounds)
        first, last = (self.guessed((*place, i), part, bounds) for i, part in enumerate(given))
        return (first, last)

    def guessed(self, place: Place, given: Expression, bounds: Range) -> float:
        """Read a number that a guess gives."""
        value = self.number(place, given)
        if value < bounds[0] or value > bounds[1]:
            self.fault(place, f"{value:g} is out of [{bounds[0]:g}, {bounds[1]:g}]", "guess within the range")
        return value

    def chosen(self, place: Place, section: ControlSection | UnknownForceSection, bounds: Range) -> float:
        """Read the guess of a control or a force: by default 0, or the number of its range that is nearest to 0."""
        if "guess" in section.model_fields_set or bounds[0] > bounds[1]:
            return self.guessed((*place, "guess"), section.guess, bounds)
        return min(max(0.0, bounds[0]), bounds[1])

    def controls(self, given: Mapping[str, ControlSection]) -> tuple[Control, ...]:
        """Read the inputs that the problem adds."""
        found = []
        for name, section in given.items():
            bounds = self.range(("controls", name, "range"), section.range)
            found.append(Control(name, bounds, self.chosen(("controls", name), section, bounds)))
        return tuple(found)

    def given_forces(self, given: Mapping[str, str], inputs: Sequence[str]) -> tuple[Force, ...]:
        """Read the inputs that expressions give."""
        found = []
        for name, text in given.items():
            place: Place = ("forces", name)
            self.check_formula(place, text)
            i = self.find(place, name, inputs, "actuated coordinate")
            if i is not None:
                found.append(Force(i, text))
        return tuple(found)

    def driven(self, given: Mapping[str, str], unknowns: Sequence[Unknown]) -> tuple[Drive, ...]:
        """Read the motions of driven joints."""
        names, found = [c.name for c in self.manifest.coordinates], []
        for name, text in given.items():
            self.used |= self.constants.keys() & list_names(text, ())
            i = self.find(("driven", name), name, names, "joint")
            found += [] if i is None else [Drive(i, text)]
        known = [*self.constants, *(unknown.name for unknown in unknowns)]
        for wrong in find_wrong_motions(found, known, self.manifest):
            numbers = [int(number) for number in wrong.place[1:]]
            self.fault(("driven", *(names[found[number].joint] for number in numbers)), wrong.finding, wrong.remedy)
        return tuple(sorted(found, key=lambda drive: drive.joint))

    def wrenches(self, given: Mapping[str, WrenchSection]) -> tuple[WrenchComponent, ...]:
        """Read the wrenches that the model leaves open."""
        found: list[WrenchComponent] = []
        for name, section in given.items():
            if self.find(("wrenches", name), name, [w.name for w in self.manifest.wrenches], "open wrench") is None:
                continue
            for key, first in (("force", 0), ("moment", 3)):
                place: Place = ("wrenches", name, key)
                components = getattr(section, key)
                if components is not None and find_component(self.manifest, name, first) is None:
                    self.fault(place, f"the model gives the {key} of this wrench", "leave it out")
                elif components is not None:
                    found += [self.component((*place, i), name, first + i, part) for i, part in enumerate(components)]
        return tuple(found)

    def signals(self, given: Mapping[str, str | UnknownForceSection], named: Sequence[str]) -> list[WrenchComponent]:
        """Read the signals of the model; a state or control of the same name gives one that is not listed."""
        known = [name for name in self.manifest.signals if name != TIME]
        found = [
            self.component(("signals", name), name, SIGNAL, section)
            for name, section in given.items()
            if self.find(("signals", name), name, known, "signal") is not None
        ]
        found += [WrenchComponent(name, SIGNAL, name) for name in known if name not in given and name in named]
        return [*found, *([WrenchComponent(TIME, SIGNAL, TIME)] if self.manifest.reads_time else [])]

    def component(
        self, place: Place, wrench: str, component: int, section: str | UnknownForceSection
    ) -> WrenchComponent:
        """Read a component of a wrench."""
        if isinstance(section, str):
            self.check_formula(place, section)
            return WrenchComponent(wrench, component, section)
        bounds = self.range((*place, "range"), section.range)
        return WrenchComponent(wrench, component, None, bounds, self.chosen(place, section, bounds))

    def contacts(self, given: Sequence[ContactSection]) -> tuple[Contact, ...]:
        """Read the points that stand on the ground."""
        self.standing = [i for i, section in enumerate(given) if section.mode == "stand"]
        return tuple(contact for contact, section in self._read_contacts(given) if section.mode == "stand")

    def touching(
        self, given: Sequence[ContactSection], relaxation: Relaxation, wrenches: tuple[WrenchComponent, ...]
    ) -> tuple[tuple[Contact, ...], tuple[Constraint, ...], tuple[WrenchComponent, ...], tuple[Control, ...]]:
        """Read the points whose times of contact are not given, their constraints, components of forces, and slips."""
        found: list[Contact] = []
        slips: list[Control] = []
        constraints: list[Constraint] = []
        added: list[WrenchComponent] = []
        for i, (contact, section) in enumerate(self._read_contacts(given)):
            if section.mode == "stand":
                if section.height is not None:
                    self.fault(("contacts", i, "height"), "a point that stands keeps its place", "leave the height out")
                continue
            faults = list(find_touching_faults(contact, self.manifest))
            for key, finding, remedy in faults:
                self.has_wrong_contacts = True
                self.fault(("contacts", i, key), finding, remedy)
            if not faults:
                height = 0.0 if section.height is None else self.number(("contacts", i, "height"), section.height)
                found.append(contact)
                slip = name_slip(contact, {*self.quantities, *self.constants})
                if slip is not None:
                    known = sum(quantity.kind == "controls" for quantity in self.quantities.values())
                    self.quantities[slip] = Quantity("controls", known)
                    slips.append(Control(slip, (0.0, math.inf), SLIP))
                constraints += list_constraints(contact, height, relaxation.last, self.manifest, slip)
                added += list_components(contact, wrenches)
        return tuple(found), tuple(constraints), tuple(added), tuple(slips)

    def relaxation(self, section: RelaxationSection | None) -> Relaxation:
        """Read the steps of complementarity."""
        given = RelaxationSection() if section is None else section
        usual = Relaxation()
        first, last, factor = (
            getattr(usual, key)
            if getattr(given, key) is None
            else self.number(("relaxation", key), getattr(given, key), least=math.ulp(0))
            for key in ("first", "last", "factor")
        )
        if factor > 0.9:
            self.fault(
                ("relaxation", "factor"), f"found {factor:g}", "give a number from 0 to 0.9: bounds decrease by it"
            )
            factor = usual.factor
        if first < last:
            self.fault(("relaxation", "first"), f"{first:g} is below the last, {last:g}", "give a larger number")
        return Relaxation(first, last, factor)

    def _read_contacts(self, given: Sequence[ContactSection]) -> list[tuple[Contact, ContactSection]]:
        found = []
        for i, section in enumerate(given):
            friction = None
            if section.friction is not None:
                friction = self.number(("contacts", i, "friction"), section.friction, least=0)
                friction = 0.0 if math.isnan(friction) else friction
            axes, normal = tuple("xyz".index(axis) for axis in section.axes), section.normal
            wrench = section.wrench or section.sensor
            place = None if normal is None else "xyz".index(normal)
            found.append((Contact(section.sensor, wrench, axes, place, friction), section))
        return found

    def check_given(self, problem: Problem) -> None:
        """Check that all components of open wrenches have a value, and that expressions can be put in an order."""
        for part, finding, remedy in find_faults(problem, self.manifest):
            self.fault(self._find_given(problem, part), finding, remedy)
        faults = list(find_contact_faults(problem, self.manifest))
        for part, finding, remedy in faults:
            place = _split(part)
            own = place if len(place) < 2 else ("contacts", self.standing[int(place[1])], *place[2:])
            self.fault(own, finding, remedy)
        if faults or self.has_wrong_contacts:  # which may be the ones that would give the components
            return
        if left := list_open_components(problem, self.manifest):
            finding = f"{', '.join(left)} have no value" if len(left) > 1 else f"{left[0]} has no value"
            key = "signals" if all(name.startswith("signal_") for name in left) else "wrenches"
            self.fault((key,), f"the model leaves {key} open, and {finding}", "give an expression or a range")

    def _find_given(self, problem: Problem, part: str) -> Place:
        """Return the place of an expression that gives a force: "wrenches[0].expression", of the problem's list."""
        key, i, *_ = _split(part)
        if key == "forces":
            return ("forces", self.manifest.coordinates[self.manifest.actuated[problem.forces[int(i)].input]].name)
        found = problem.every_component[int(i)]
        if found.component == SIGNAL:
            return ("signals", found.wrench)
        return ("wrenches", found.wrench, "moment" if found.component > 2 else "force", found.component % 3)

    def unknowns(self, given: Mapping[str, UnknownSection]) -> tuple[Unknown, ...]:
        """Read the numbers that the solver chooses."""
        found = []
        for name, section in given.items():
            bounds = self.range(("unknowns", name, "range"), section.range)
            found.append(Unknown(name, bounds, self.guessed(("unknowns", name, "guess"), section.guess, bounds)))
        return tuple(found)

    def parameters(self, given: Mapping[str, Expression]) -> tuple[tuple[str, float], ...]:
        """Read values of the model's parameters."""
        known, found = list(list_changeable(self.manifest)), []
        for name, expression in given.items():
            value = self.number(("parameters", name), expression)
            if self.find(("parameters", name), name, known, "parameter that may be changed") is not None:
                found.append((name, value))
        return tuple(found)

    def integrals(self, given: Sequence[IntegralSection]) -> tuple[Integral, ...]:
        """Read the integrals that have a range."""
        found = []
        for i, section in enumerate(given):
            self.check_formula(("integrals", i, "expression"), section.expression)
            found.append(Integral(section.expression, self.range(("integrals", i, "range"), section.range)))
        return tuple(found)


def _split(place: str) -> Place:
    """Return the place in a file of a part of a problem: "contacts[0].wrench" -> ("contacts", 0, "wrench")."""
    return tuple(int(part) if part.isdigit() else part for part in re.findall(r"\w+", place))
