"""Problem files with phases: YAML -> PhasedProblem and its plants.

Keys outside of `phases` are defaults of every phase; a mapping of a phase replaces the values of the default mapping
that it names. A file without `phases`, but with `links`, is a problem of one phase.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from mbsgen.documents import Data, Document, Place, examine, lies_under, read_document, refuse
from mbsgen.errors import Fault, InputError
from mbsrun.ocp.ground.no_mechanism import NO_MECHANISM
from mbsrun.ocp.ground.plant import Openable, Plant
from mbsrun.ocp.problem.modes import arrive, find_wrong_hits, strike
from mbsrun.ocp.problem.phases import Condition, Impact, Link, Phase, PhasedProblem, Plants
from mbsrun.ocp.problem.problem import Contact, Problem, Term
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.phase_checks import find_faults
from mbsrun.ocp.statement.phase_sections import ContactSection, ImpactSection, LinkSection, PhaseSection, WholeSection
from mbsrun.ocp.statement.sections import is_solution
from mbsrun.ocp.statement.statement import PHASED, SEALED, find_open_axes, name_problem, read_phase
from mbsrun.ocp.transcription.impacts import AXES, find_axes, find_wrench
from mbsrun.reading import Reading, overlay, relate

SHARED = ("solver", "unknowns", *PHASED)  # keys that a phase does not repeat
STANDS = "stand"  # the mode of contacts that say none
ONLY = "motion"  # the name of the phase of a file without `phases`

Load = Callable[[Path], Plant]


class Extension(Protocol):
    """Parts of a phase that no file says."""

    @property
    def reads(self) -> frozenset[str]:
        """Return the names that they read."""

    def extend(self, problem: Problem, data: Data) -> Problem:
        """Add them to the problem of a phase, whose data hold the defaults."""


NO_EXTENSIONS: Mapping[str, Extension] = MappingProxyType({})


def has_phases(path: Path) -> bool:
    """Return whether a file describes a problem with phases or links. Raises InputError for a file that is no YAML."""
    data = read_document(path).data
    return isinstance(data, dict) and not set(PHASED).isdisjoint(data)


def read_phased_problem(path: Path, load: Load) -> tuple[PhasedProblem, Plants]:
    """Read a problem file with phases, and load its models. Raises InputError with every fault of all files."""
    return interpret_phases(read_document(path), name_problem(path), path.parent, load)


def state_phases(
    data: Mapping[str, Data], name: str, folder: Path, load: Load, extensions: Mapping[str, Extension] = NO_EXTENSIONS
) -> tuple[PhasedProblem, Plants]:
    """Make a problem of plain data, with the keys of a file; other files of it are in `folder`.

    `extensions` add to phases by name. Raises ProblemError with every fault.
    """
    document = Document(str(folder / "problem"), dict(data), dict.fromkeys(_list_places(dict(data)), 0), {})
    try:
        return interpret_phases(document, name, folder, load, extensions)
    except InputError as error:
        raise ProblemError(name, [(x.path or "problem", x.finding, x.remedy) for x in error.faults]) from None


def _list_places(data: Data, place: Place = ()) -> Iterator[Place]:
    """List the places of all values."""
    yield place
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from _list_places(value, (*place, key))


def interpret_phases(
    document: Document, name: str, folder: Path, load: Load, extensions: Mapping[str, Extension] = NO_EXTENSIONS
) -> tuple[PhasedProblem, Plants]:
    """Make the problem of a document; its models are in `folder`. Raises InputError with every fault of all files."""
    data = document.data if isinstance(document.data, dict) else {}
    chosen: Data = {key: value for key, value in data.items() if key in WholeSection.model_fields}
    examination = examine(replace(document, data=chosen), WholeSection)
    whole, faults = examination.value, list(examination.faults)
    if whole is None:
        raise refuse(faults)
    loading = _Loading(folder, load)
    reading = _Links(document, examination.stand_ins, whole)
    linked = _list_linked(reading.name_links(), [str(phase.get("name", ONLY)) for phase in whole.phases])
    phases = [
        _read_phase(document, k, linked, loading, extensions)
        for k in range(len(whole.phases))
        if not lies_under(("phases",), examination.stand_ins)
    ]
    faults += [fault for phase in phases for fault in phase.faults]
    models = reading.load_impacts(loading)
    faults += loading.faults
    if not phases or any(phase.problem is None or phase.plant is None for phase in phases):
        raise refuse([*faults, *reading.faults])
    problem, plants = reading.problem(name, phases, models)
    if "relaxation" in data and not any(phase.problem.touching for phase in problem.phases):
        faults.append(document.fault(("relaxation",), "no contact has mode: complementarity", "leave it out"))
    if faults or reading.faults:
        raise refuse([*faults, *reading.faults])
    return problem, plants


def _list_linked(links: Sequence[Link], names: Sequence[str]) -> set[str]:
    """List the phases to which a link leads: perhaps all, where a link leads to a name that no phase has."""
    linked = {link.target for link in links}
    return linked if linked <= set(names) else linked | set(names)


@dataclass(frozen=True)
class PhaseDocument(Document):
    """The data of one phase, defaults included; faults name the place in the whole file."""

    whole: Document
    phase: int

    def line(self, place: Place) -> int:
        """Return the line of a value in the file."""
        return self.whole.line(self.find(place))

    def fault(self, place: Place, finding: str, remedy: str) -> Fault:
        """Make the fault of one place."""
        return self.whole.fault(self.find(place), finding, remedy)

    def find(self, place: Place) -> Place:
        """Return a place of a phase as one of the file."""
        return find_in_file(self.whole, self.phase, place)


def find_in_file(whole: Document, phase: int, place: Place) -> Place:
    """Return a place of a phase as one of the file: among the phase's own keys, or among the defaults."""
    own: Place = ("phases", phase)
    for size in range(len(place), 0, -1):
        if (*own, *place[:size]) in whole.lines:
            return (*own, *place)
        if place[:size] in whole.lines:
            return place
    return (*own, *place) if ("phases",) in whole.lines else place


class _Loading:
    """Loads each model once; collects the faults of models."""

    def __init__(self, folder: Path, load: Load) -> None:
        self._folder, self._load = folder, load
        self._known: dict[str, Plant | None] = {}
        self._opened: dict[str, Plant] = {}
        self.faults: list[Fault] = []

    def load(self, model: str | None, document: Document, place: Place) -> Plant | None:
        """Return the plant of a model that a place names, or of no mechanism; None for one with faults."""
        if model is None:
            return NO_MECHANISM
        if model not in self._known:
            try:
                self._known[model] = self._load(self._folder / model)
            except InputError as error:
                self._known[model] = None
                self.faults += relate(error.faults, document, place)
        return self._known[model]

    def open(self, model: str | None, plant: Plant) -> Plant | None:
        """Return a loaded plant with its switching forces as inputs; None where it cannot have these."""
        if model is None or not isinstance(plant, Openable):
            return None
        if model not in self._opened:
            self._opened[model] = plant.open_forces()
        return self._opened[model]


@dataclass(frozen=True)
class _Read:
    """A phase as it was read."""

    name: str
    problem: Problem | None
    plant: Plant | None
    faults: list[Fault]
    stand_ins: frozenset[Place]  # places of the file whose values are examples


def _read_phase(
    document: Document, k: int, linked: set[str], loading: _Loading, extensions: Mapping[str, Extension]
) -> _Read:
    """Read a phase with the defaults of the file."""
    data = document.data if isinstance(document.data, dict) else {}
    given = data.get("phases")
    own = given[k] if isinstance(given, list) else {"name": ONLY}
    assert isinstance(own, dict), "the schema admits mappings alone"
    place: Place = ("phases", k)
    faults = [
        document.fault((*place, key), f"{key} belongs to the whole problem", "move it out of the phase")
        for key in SHARED
        if key in own
    ]
    faults += _find_wrong_solution(document, k, own)
    name = str(own.get("name", ""))
    usual: dict[str, Data] = {"cost": {"inputs": 0.0}} if "cost" not in data else {}
    if name in linked:
        usual["start"] = {}
    defaults: dict[str, Data] = {key: value for key, value in data.items() if key not in PHASED}
    kept: Data = {key: value for key, value in own.items() if key not in SHARED}
    merged = overlay(overlay(usual, defaults), kept)
    if isinstance(merged, dict) and "relaxation" not in own and not _touches(merged.get("contacts")):
        merged.pop("relaxation", None)  # of other phases
    if name in linked and isinstance(merged, dict) and isinstance(merged.get("start"), dict):
        merged["start"] = {"pose": {}, **merged["start"]}  # type: ignore[dict-item]
    part = PhaseDocument(document.file, merged, document.lines, _pick_faults(document, k), document, k)
    examination = examine(part, PhaseSection)
    faults += examination.faults
    section, stand_ins = examination.value, frozenset(map(part.find, examination.stand_ins))
    if section is None or lies_under(("model",), examination.stand_ins):
        return _Read(name, None, None, faults, stand_ins)
    plant = loading.load(section.model, part, ("model",))
    if plant is None:
        return _Read(name, None, None, faults, stand_ins)
    if section.modes is not None:
        opened = loading.open(section.model, plant)
        if opened is None:
            return _Read(name, None, plant, [*faults, part.fault(("modes",), *SEALED)], stand_ins)
        plant = opened
    extension = extensions.get(name)
    reads = frozenset[str]() if extension is None else extension.reads
    problem, found = read_phase(part, examination, plant, name, is_linked=name in linked, reads=reads)
    if extension is not None and problem is not None:
        problem = extension.extend(problem, merged)
    return _Read(name, problem, plant, [*faults, *found], stand_ins)


def _touches(contacts: Data) -> bool:
    """Return whether a contact finds its times by itself."""
    every = contacts if isinstance(contacts, list) else []
    return any(isinstance(x, dict) and x.get("mode", STANDS) != STANDS for x in every)


def _find_wrong_solution(document: Document, k: int, own: Mapping[str, Data]) -> Iterator[Fault]:
    """Find a solution that a phase has by itself, and a recording of the file that is not divided among the phases."""
    data = document.data if isinstance(document.data, dict) else {}
    place: Place = ("phases", k, "guess")
    usual, given = (part.get("guess") for part in (data, own))
    own_guess, usual_guess = (part if isinstance(part, dict) else {} for part in (given, usual))
    if isinstance(chosen := own_guess.get("solution"), str) and is_solution(Path(chosen)):
        remedy = "move it out of the phase: one file holds all phases; or give the phase a recording"
        yield document.fault((*place, "solution"), "the solution is of the whole problem", remedy)
    shared, phases = usual_guess.get("solution"), data.get("phases")
    is_undivided = isinstance(phases, list) and len(phases) > 1 and own_guess.keys().isdisjoint(("solution", "times"))
    if is_undivided and isinstance(shared, str) and not is_solution(Path(shared)):
        finding = f"phase {own.get('name')} takes the whole recording, as other phases do"
        yield document.fault(("guess", "solution"), finding, "give the phase guess: {times: [from, to]}")


def _pick_faults(document: Document, k: int) -> Mapping[Place, Fault]:
    """Pick the faults of reading that concern a phase, at its places."""
    own: Place = ("phases", k)
    return {
        place[2:] if place[:2] == own else place: fault
        for place, fault in document.faults.items()
        if place[:2] == own or place[:1] not in [(key,) for key in PHASED]
    }


class _Links(Reading):
    """Reads links, constants and unknowns."""

    def __init__(self, document: Document, stand_ins: frozenset[Place], whole: WholeSection) -> None:
        super().__init__(document, stand_ins)
        self.whole = whole
        for key, expression in whole.constants.items():
            self.constants[key] = self.number(("constants", key), expression)

    def name_links(self) -> list[Link]:
        """Return links with their phases alone; the names are left out only where there is one phase."""
        phases = [phase.get("name", ONLY) for phase in self.whole.phases]
        only = phases[0] if len(phases) == 1 else None
        return [Link(str(link.source or only or ""), str(link.target or only or "")) for link in self.whole.links]

    def load_impacts(self, loading: _Loading) -> list[Plant | None]:
        """Load the models of impacts that have one."""
        models = [None if link.impact is None else link.impact.model for link in self.whole.links]
        known = [not lies_under(("links", i, "impact", "model"), self.stand_ins) for i in range(len(models))]
        return [
            loading.load(model, self.document, ("links", i, "impact", "model")) if model and own else None
            for i, (model, own) in enumerate(zip(models, known, strict=True))
        ]

    def problem(self, name: str, phases: list[_Read], models: list[Plant | None]) -> tuple[PhasedProblem, Plants]:
        """Make the problem, which is valid only if there are no faults."""
        plants = Plants(tuple(phase.plant for phase in phases if phase.plant is not None), tuple(models))
        problems = [phase.problem for phase in phases if phase.problem is not None]
        problem = PhasedProblem(
            name=name,
            phases=tuple(Phase(phase.name, own) for phase, own in zip(phases, problems, strict=True)),
            links=tuple(
                self.link(i, section, named, phases, models[i])
                for i, (section, named) in enumerate(zip(self.whole.links, self.name_links(), strict=True))
            ),
            constants=tuple(self.constants.items()),
            unknowns=problems[0].unknowns,
            solver=problems[0].solver,
        )
        if not any(phase.faults for phase in phases):
            problem = self.join_modes(problem, plants)
        self.stand_ins |= frozenset().union(*(phase.stand_ins for phase in phases))
        for fault in find_faults(problem, plants):
            place = fault.place
            if place[:1] == ("phases",) and len(place) > 2:
                place = find_in_file(self.document, int(place[1]), place[2:])
            self.fault(place, fault.finding, fault.remedy)
        return problem, plants

    def link(self, i: int, section: LinkSection, named: Link, phases: list[_Read], model: Plant | None) -> Link:
        place: Place = ("links", i)
        source = next((phase.plant for phase in phases if phase.name == named.source), None)
        after = next((phase.problem for phase in phases if phase.name == named.target), None)
        held, given = () if after is None else after.contacts, section.impact
        conditions = tuple(
            Condition(part.expression, self.range((*place, "conditions", k, "range"), part.range))
            for k, part in enumerate(section.conditions)
        )
        cost = tuple(
            Term(part.expression, self.number((*place, "cost", k, "weight"), part.weight))
            for k, part in enumerate(section.cost)
        )
        return replace(
            named,
            map=tuple(section.map.items()),
            velocities=tuple(section.velocities.items()),
            impact=None if given is None else self.impact((*place, "impact"), given, model or source, held),
            conditions=conditions,
            cost=cost,
        )

    def join_modes(self, problem: PhasedProblem, plants: Plants) -> PhasedProblem:
        """End phases with modes where the phases after them begin, and add the impacts between them."""
        for i, section in enumerate(self.whole.links):
            link, place = problem.links[i], ("links", i)
            names = [phase.name for phase in problem.phases]
            if link.source not in names or link.target not in names:
                continue
            first, second = (problem.find(name) for name in (link.source, link.target))
            before, after = problem.phases[first].problem, problem.phases[second].problem
            if not before.modes and not after.modes:
                if section.hits:
                    self.fault((*place, "hits"), "neither phase has modes", "give them modes, or leave hits out")
                continue
            plant = plants.phases[first]
            if finding := self.find_unlike(link, plants.phases[second] is plant, before, after):
                self.fault(place, *finding)
                continue
            modes = dict(before.modes), dict(after.modes), section.hits
            faults = list(find_wrong_hits(*modes, plant.manifest))
            for fault in faults:
                self.fault((*place, "hits", *fault.place), fault.finding, fault.remedy)
            if not faults:
                impact = strike(*modes, plant.manifest, find_open_axes(plant))
                ended = arrive(before, modes[1], section.hits, plant.manifest, jumps=impact is not None)
                phases = [replace(x, problem=ended) if k == first else x for k, x in enumerate(problem.phases)]
                links = [replace(x, impact=impact) if k == i else x for k, x in enumerate(problem.links)]
                problem = replace(problem, phases=tuple(phases), links=tuple(links))
        return problem

    @staticmethod
    def find_unlike(link: Link, same: bool, before: Problem, after: Problem) -> tuple[str, str] | None:
        """Return why modes of both sides of a link cannot be joined, and a remedy; None where they can."""
        if not same or not before.modes or not after.modes:
            return "modes are continued in the same model only", "give both phases one model, and modes"
        if link.map or link.velocities:
            return "a link with a map joins no modes", "leave map and velocities out, or give the phases no modes"
        if link.impact is not None:
            return "modes have their impacts by the model's laws", "leave impact out; hits name what rebounds"
        return None

    def impact(self, place: Place, section: ImpactSection, plant: Plant | None, held: Sequence[Contact]) -> Impact:
        """Read an impact; a contact that is only named is one of the phase after, if that holds it."""
        known = {
            contact.sensor: contact
            for contact in held
            if plant is not None and find_wrench(plant.manifest, contact.wrench) is not None
        }
        contacts = []
        for i, part in enumerate(section.contacts):
            if isinstance(part, str) and part in known:
                contacts.append(known[part])
            else:
                own = ContactSection(sensor=part) if isinstance(part, str) else part
                contacts.append(self.contact((*place, "contacts", i), own, plant))
        restitution = self.number((*place, "restitution"), section.restitution)
        return Impact(tuple(contacts), restitution, tuple(section.map.items()))

    def contact(self, place: Place, section: ContactSection, plant: Plant | None) -> Contact:
        axes = tuple(AXES.index(axis) for axis in section.axes or "xyz")
        sensors = [] if plant is None else [frame.name for frame in plant.manifest.frames if frame.sensor]
        if section.axes is None and plant is not None and section.sensor in sensors:
            axes = find_axes(plant, section.sensor)
        friction = None if section.friction is None else self.number((*place, "friction"), section.friction)
        normal = None if section.normal is None else AXES.index(section.normal)
        return Contact(section.sensor, section.wrench or section.sensor, axes, normal, friction)
