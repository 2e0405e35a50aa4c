"""Problem files: YAML -> Problem.

A file names a model beside it, a horizon, a collocation, the cost, a start, bounds, constraints, conditions at the
end, and a guess. Lengths are in m, angles in rad, times in s. A number may be an expression over the file's
`constants`, such as `acos(0.55/0.6)` or `-2*alpha`; coordinates, frames and sensors have their names in the model.
Terms of the cost and constraints are expressions of the motion, and are kept as text.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mbsgen.documents import (
    Data,
    Document,
    Examination,
    Place,
    abbreviate,
    examine,
    expect,
    lies_under,
    nearest,
    read_document,
    refuse,
)
from mbsgen.errors import Fault, InputError
from mbsgen.expressions import FLOATS, Expression, ExpressionError, Number, evaluate, is_free_name, parse, spell
from mbsrun.closure import Closure, find_closure
from mbsrun.ocp.ground.grid import divide
from mbsrun.ocp.ground.plant import Openable, Plant
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.methods import METHODS, Amount, choose
from mbsrun.ocp.problem.conditions import (
    Completion,
    complete_pose,
    complete_velocities,
    find_divided_attitudes,
    find_strays,
    find_surplus,
    find_surplus_places,
)
from mbsrun.ocp.problem.design import equip
from mbsrun.ocp.problem.driving import SAME, Guide
from mbsrun.ocp.problem.driving import find_conflicts as find_driven_conflicts
from mbsrun.ocp.problem.modes import add_modes, begin, find_wrong_start
from mbsrun.ocp.problem.modes import complete as complete_modes
from mbsrun.ocp.problem.modes import find_faults as find_mode_faults
from mbsrun.ocp.problem.problem import (
    Aims,
    Bounds,
    Constraint,
    Cost,
    End,
    GuessOptions,
    Problem,
    Range,
    Refinement,
    SolverOptions,
    Target,
    Term,
    cylindrical,
    find_conflicts,
)
from mbsrun.ocp.statement.checks import (
    LEAST_ACCURACY,
    LEAST_FRACTION,
    LEAST_TOLERANCE,
    ProblemError,
    find_loop_conflicts,
    find_open_references,
    find_phase_conflicts,
    find_unknown_conflicts,
    list_open_inputs,
    trust_types,
)
from mbsrun.ocp.statement.muscles import add_muscles, list_equilibria, list_metabolic_rates
from mbsrun.ocp.statement.orienting import list_conditions, point, turn_by, turn_to
from mbsrun.ocp.statement.parts import PartReading
from mbsrun.ocp.statement.restating import Rewriting
from mbsrun.ocp.statement.sections import (
    BoundsSection,
    ConstraintSection,
    EndSection,
    GuessSection,
    HorizonSection,
    Limits,
    OrientationSection,
    PositionSection,
    ProblemSection,
    RefinementSection,
    SolverSection,
    StartSection,
    TermSection,
    is_solution,
)
from mbsrun.ocp.transcription.impacts import find_axes
from mbsrun.ocp.transcription.quantities import Added, list_quantities
from mbsrun.quaternions import (
    Quaternion,
    find_quaternion,
    list_quaternions,
    measure_lengths,
    neutral,
    normalise,
)
from mbsrun.reading import relate
from mbsrun.smoothness import find_hidden

PHASED = ("phases", "links")  # keys of problems that `phases.statement` reads
ROUNDED = 1e-9  # of a start that loops complete, beyond its bounds

StartValues = tuple[Expression | None, ...] | dict[str, Expression | None]  # of a start: in order, or by name

SEALED = (
    "the kernels of a generated folder do not have switching forces as inputs",
    "name the model's file in place of the folder",
)

SomePlant = TypeVar("SomePlant", bound=Plant)
SomeSection = TypeVar("SomeSection", bound=ProblemSection)


def read_problem(
    path: Path, load: Callable[[Path], SomePlant], none: SomePlant | None = None
) -> tuple[Problem, SomePlant]:
    """Read a problem file, and load its model with `load`. Raises InputError with every fault of both files.

    A file without a model has the plant `none`; without that, a model is required.
    """
    document = read_document(path)
    expect(document, "problem")
    for key in PHASED:
        if isinstance(document.data, dict) and key in document.data:
            remedy = "only `mbsrun solve`, and mbsrun.read_problem in Python, take such problems"
            raise refuse([document.fault((key,), f"a problem with {key}", remedy)])
    return interpret(document, name_problem(path), lambda model: load(path.parent / model), none)


def name_problem(path: Path) -> str:
    """Name the problem of a file."""
    return path.name.removesuffix(".yaml").removesuffix(".ocp")


def state_problem(
    data: Mapping[str, Data], name: str, plant: Plant, folder: Path, reads: Collection[str] = ()
) -> Problem:
    """Make a problem of plain data, with the keys of a file, for a plant that is loaded; `model` is not read.

    Other files of it are in `folder`. Of the constants, the ones that expressions read are kept, and the ones of
    `reads`. Raises ProblemError with every fault.
    """
    own: dict[str, Data] = {key: value for key, value in data.items() if key != "model"}
    model: dict[str, Data] = {"model": "model.yaml"} if plant.manifest.coordinates else {}
    document = Document(str(folder / "problem"), own | model, {}, {})
    try:
        return interpret(document, name, lambda _: plant, plant, reads)[0]
    except InputError as error:
        raise ProblemError(name, [(x.path or "problem", x.finding, x.remedy) for x in error.faults]) from None


def interpret(
    document: Document,
    name: str,
    load: Callable[[str], SomePlant],
    none: SomePlant | None = None,
    reads: Collection[str] = (),
) -> tuple[Problem, SomePlant]:
    """Make the problem of a document; `load` loads the model that it names, and `none` stands for no model.

    Constants of `reads` are kept, beside the ones that expressions read. Raises InputError with every fault.
    """
    examination = examine(document, ProblemSection)
    section, faults = examination.value, list(examination.faults)
    if section is None or lies_under(("model",), examination.stand_ins):
        raise refuse(faults)
    try:
        plant = none if section.model is None else load(section.model)
    except InputError as error:
        raise refuse([*faults, *relate(error.faults, document, ("model",))]) from None
    if plant is not None and section.modes is not None:
        if not isinstance(plant, Openable):
            raise refuse([*faults, document.fault(("modes",), *SEALED)])
        plant = plant.open_forces()
    if plant is None:
        remedy = "name a model file; only `mbsrun solve` takes problems without a mechanism"
        raise refuse([*faults, document.fault(("model",), "no model", remedy)])
    reading = _Reading(document, plant, examination.stand_ins)
    reading.used.update(reads)
    problem = reading.problem(name, section)
    if faults or reading.faults:
        raise refuse([*faults, *reading.faults])
    return problem, equip(plant, problem)


def find_open_axes(plant: Plant) -> dict[str, tuple[int, ...]]:
    """Return the axes along which each open contact of a model can move."""
    return {law.name: find_axes(plant, law.point) for law in plant.manifest.open_contacts}


def read_phase(
    document: Document,
    examination: Examination[SomeSection],
    plant: Plant,
    name: str,
    *,
    is_linked: bool,
    reads: Collection[str] = (),
) -> tuple[Problem | None, list[Fault]]:
    """Read a phase of a problem, and its faults; what a linked one does not give of its start is free.

    Constants of `reads` are kept, beside the ones that expressions read.
    """
    if examination.value is None:
        return None, []
    reading = _Reading(document, plant, examination.stand_ins, is_phase=True, is_linked=is_linked)
    reading.used.update(reads)
    return reading.problem(name, examination.value), reading.faults


class _Reading(PartReading):
    """Evaluates numbers and looks names up in a model; collects the faults."""

    def __init__(
        self,
        document: Document,
        plant: Plant,
        stand_ins: frozenset[Place],
        *,
        is_phase: bool = False,
        is_linked: bool = False,
    ) -> None:
        super().__init__(document, stand_ins, plant.manifest)
        self.is_phase, self.is_linked = is_phase, is_linked
        manifest = plant.manifest
        self.manifest, self.plant = manifest, plant
        self.closure: Closure | None = None
        self.lengths: list[str] = []  # the unknowns that change the loops
        self.following: tuple[int, ...] = ()  # states of the start that loops give, where parameters change the loops
        self.coordinates = _Names("coordinate", list(manifest.positions))
        kind = "velocity" if manifest.configuration else "coordinate"
        self.velocities = _Names(kind, [c.name for c in manifest.coordinates])
        self.inputs = _Names("actuated coordinate", [manifest.coordinates[i].name for i in manifest.actuated])
        self.frames = _Names("frame", [f.name for f in manifest.frames])
        self.sensors = _Names("sensor", [f.name for f in manifest.frames if f.sensor])
        self.open_inputs = list_open_inputs(manifest)
        self.quantities = dict(list_quantities(manifest, Added()))
        limits = {
            c.name: (-math.inf if c.lower is None else c.lower, math.inf if c.upper is None else c.upper)
            for c in manifest.coordinates
        }
        self.limits = [limits.get(name, _both_ways(None)) for name in manifest.positions]
        self.speeds = [_both_ways(c.max_speed) for c in manifest.coordinates]
        self.forces = [_both_ways(manifest.coordinates[i].max_force) for i in manifest.actuated]

    def problem(self, name: str, section: ProblemSection) -> Problem:
        """Make the problem, which is valid only if there are no faults."""
        section = add_muscles(section, self.plant, self.fault, is_phase=self.is_phase)
        for key, expression in section.constants.items():
            if not is_free_name(key) or key in self.quantities:
                self.fault(("constants", key), "no name for a constant", "give a name that nothing else has")
            self.constants[key] = self.number(("constants", key), expression)
        self.add_names(section)
        equilibria = list_equilibria(section, self.plant)
        determined = [x.gives for x in equilibria if x.gives]
        prefix = f"{name}_" if self.is_phase else ""
        self.rewriting = Rewriting(self, section, self.inputs.known, prefix, determined)
        parameters, unknowns = self.parameters(section.parameters), self.unknowns(section.unknowns)
        if not self.faults:
            changed = dict(parameters) | {x.name: x.guess for x in unknowns if x.name in self.plant.parameters}
            self.plant = self.plant.with_parameters(**changed) if changed else self.plant
        self.closure = find_closure(self.plant)
        hidden = find_hidden(self.manifest, stops=False)
        if hidden is not None and section.modes is None:
            remedy = hidden[1] if self.manifest.loaded else f"{hidden[1]}, or give `modes`"
            self.fault(("model",), f"an optimal control problem would miss {hidden[0]}", remedy)
        chosen_names = [x.name for x in unknowns]
        self.lengths = [name for name in self.closure.parameters if name in chosen_names] if self.closure else []
        chosen = section.controls or section.wrenches or section.signals or section.contacts or section.unknowns
        is_timed = bool(section.driven) and isinstance(section.horizon, HorizonSection)
        if not (self.inputs.known or chosen or is_timed or self.is_phase):
            remedy = "give it one, or the problem controls: there is nothing to control"
            finding = "the model has no actuated coordinate" if self.coordinates.known else "no model and no controls"
            self.fault(("model",) if self.coordinates.known else ("controls",), finding, remedy)
        if self.open_inputs:
            left = f"the model leaves {', '.join(self.open_inputs)} open, beside the inputs u"
            self.fault(("model",), left, "give them in the model: here they have no value")
        drives = self.driven(section.driven, unknowns) if section.driven or not self.is_phase else ()
        self.referring.read(section.references)
        bounds = self.bounds(section.bounds)
        horizon, horizon_range = self.horizon(section.horizon)
        intervals, mesh = self.intervals(section.intervals)
        accuracy = self.number(("accuracy",), section.accuracy, least=math.ulp(0))
        start = section.start
        if drives and start is not None and not self.faults:
            guesses = {unknown.name: unknown.guess for unknown in unknowns}
            guide = Guide(drives, self.manifest, self.constants, guesses)
            start = self.start_driven(start, guide, horizon)
        start_q, free_q, start_qd, free_qd = self.read_start(start, bounds)
        cost, end = self.cost(section, horizon), self.end(section.end, bounds)
        if self.closure is not None:
            end = self.closed_end(self.closure, end, start_q)
        constraints = tuple(self.constraint(i, part) for i, part in enumerate(section.constraints) if part.soft is None)
        wrenches, relaxation = self.wrenches(section.wrenches), self.relaxation(section.relaxation)
        touching, complements, forces, slips = self.touching(section.contacts, relaxation, wrenches)
        if slips and section.degree > 1 and self.rewriting.course != "polynomial":
            finding = "friction along two axes has an unknown slip at each point, where controls have one an interval"
            self.fault(("degree",), finding, "take degree: 1, or inputs: polynomial")
        if touching and section.scheme is Family.LEGENDRE:
            finding = "the points of legendre are no mesh points, where contacts would be open"
            self.fault(("scheme",), finding, "take scheme: radau")
        if section.relaxation is not None and not touching:
            self.fault(("relaxation",), "no contact has mode: complementarity", "leave it out")
        problem = Problem(
            name=name,
            horizon=horizon,
            intervals=intervals,
            mesh=mesh,
            inputs=self.rewriting.course,
            family=section.scheme,
            degree=section.degree,
            representation=section.representation,
            form=section.form,
            loops=section.loops,
            integrator=section.integrator,
            steps=section.steps,
            cost=cost,
            start_q=start_q,
            start_qd=start_qd,
            bounds=bounds,
            end=end,
            horizon_range=horizon_range,
            free_start=(*free_q, *(len(start_q) + i for i in free_qd)),
            constraints=(*constraints, *complements, *self.orient(end), *equilibria),
            guess=self.guess(section.guess, bounds, start_q, free_q, section.start.pose if section.start else {}, end),
            parameters=parameters,
            unknowns=unknowns,
            accuracy=accuracy,
            refine=self.refinement(section.refine, accuracy),
            solver=self.solver(section.solver),
            states=self.states(section.states),
            controls=self.controls(section.controls),
            forces=self.given_forces(section.forces, self.inputs.known),
            wrenches=(*wrenches, *forces, *self.signals(section.signals, [*section.states, *section.controls])),
            driven=drives,
            contacts=self.contacts(section.contacts),
            touching=touching,
            relaxation=relaxation if touching else None,
            integrals=self.integrals(section.integrals),
            following=self.following,
        )
        problem = self.rewriting.apply(self.set_modes(problem, section.modes))
        used = tuple((key, self.constants[key]) for key in section.constants if key in self.used)
        controls, references = (*problem.controls, *slips), self.referring.references()
        problem = replace(problem, constants=used, references=references, controls=controls)
        self.check_given(problem)
        is_driven = bool(drives) and not self.faults
        for conflict in (
            *(find_phase_conflicts(self.manifest) if self.is_phase else ()),
            *(find_driven_conflicts(problem, self.manifest) if is_driven else ()),
            *find_conflicts(problem),
            *find_loop_conflicts(problem, self.manifest),
            *find_open_references(problem),
            *find_unknown_conflicts(problem, self.manifest),
        ):
            self.fault(conflict.place, conflict.finding, conflict.remedy)
        trust_types(problem)
        return problem

    def set_modes(self, problem: Problem, given: Mapping[str, str] | None) -> Problem:
        """Add what the modes of the problem state, if it has any."""
        if given is None:
            return problem
        axes = find_open_axes(self.plant)
        faults = list(find_mode_faults(given, self.manifest, axes))
        for fault in faults:
            self.fault(("modes", *fault.place), fault.finding, fault.remedy)
        for law in self.manifest.open_joints:
            if any(part.wrench == law.signal for part in problem.wrenches):
                self.fault(("signals", law.signal), f"the mode of {law.name} gives it", "leave it out")
        if faults:
            self.has_wrong_contacts = True
            return problem
        problem = replace(problem, modes=tuple(complete_modes(given, self.manifest).items()))
        if not self.is_linked:
            for fault in find_wrong_start(problem, self.manifest):
                self.fault(("start", *fault.place), fault.finding, fault.remedy)
            problem = begin(problem, self.manifest)
        return add_modes(problem, self.manifest, axes)

    def read_start(
        self, section: StartSection | None, bounds: Bounds
    ) -> tuple[tuple[float, ...], tuple[int, ...], tuple[float, ...], tuple[int, ...]]:
        """Return coordinates and velocities of the start, each with the indices of free ones."""
        if section is None and self.coordinates.known and not self.is_linked:
            self.fault(("start",), "missing", "give pose, by coordinate or as a list; null is free")
        section = section or StartSection(pose={})
        if self.closure is not None:
            return self.closed_start(self.closure, section, bounds)
        start_q, free_q = self.start("pose", section.pose, self.coordinates, bounds.q)
        start_qd, free_qd = self.start("velocity", section.velocity, self.velocities, bounds.qd)
        return start_q, free_q, start_qd, free_qd

    def start_driven(self, section: StartSection, guide: Guide, horizon: float) -> StartSection:
        """Return a start in which driven joints are where their motions begin."""
        q, qd = (part[0] for part in guide.read(np.zeros(1), horizon)[:2])
        given = {
            key: self.put_driven(key, getattr(section, key), among.known, entries, values.tolist())
            for key, among, entries, values in (
                ("pose", self.coordinates, guide.places, q),
                ("velocity", self.velocities, guide.joints, qd),
            )
        }
        return section.model_copy(update=given)

    def put_driven(
        self, key: str, given: StartValues, names: Sequence[str], entries: Sequence[int], values: Sequence[float]
    ) -> StartValues:
        """Put the first values of driven joints into a pose or a velocity, which gives no others."""
        own = {names[i]: Number(value) for i, value in zip(entries, values, strict=True) if math.isfinite(value)}
        if isinstance(given, dict):
            for name in given.keys() & own.keys():
                self.fault(("start", key, name), "its motion is given under driven", "leave it out")
            return {**own, **{name: value for name, value in given.items() if name not in own}}
        found = list(given)
        for i, value in zip(entries, values, strict=True):
            if i >= len(found):
                continue
            first = value if given[i] is None else self.number(("start", key, i), given[i] or Number(0.0))
            if abs(first - value) > SAME * (1 + abs(value)):
                finding = f"{names[i]} starts at {first:g}, and its motion under driven at {value:g}"
                self.fault(("start", key, i), finding, "give null, or the same number")
            found[i] = Number(value) if math.isfinite(value) else Number(0.0)
        return tuple(found)

    def horizon(self, section: Expression | HorizonSection) -> tuple[float, Range | None]:
        """Return the horizon, or the guess of it and its range."""
        if not isinstance(section, HorizonSection):
            return self.number(("horizon",), section, least=math.ulp(0)), None
        guess = self.number(("horizon", "guess"), section.guess, least=math.ulp(0))
        lower, upper = self.range(("horizon", "range"), section.range)
        if lower <= 0:
            self.fault(("horizon", "range"), f"the least is {lower:g}", "give a positive one")
        elif guess < lower or guess > upper:
            self.fault(("horizon", "guess"), f"{guess:g} is out of [{lower:g}, {upper:g}]", "guess within the range")
        return guess, (lower, upper)

    def intervals(self, section: int | tuple[Expression, ...]) -> tuple[int, tuple[float, ...] | None]:
        """Return the number of intervals, and their fractions of the horizon where they differ."""
        if isinstance(section, int):
            return section, None
        lengths = [self.number(("intervals", k), length, least=math.ulp(0)) for k, length in enumerate(section)]
        is_faulty = not all(0 < length < math.inf for length in lengths)  # and reported
        return len(lengths), None if is_faulty else self.divide(lengths)

    def divide(self, lengths: Sequence[float]) -> tuple[float, ...] | None:
        """Return the fractions of the horizon that lengths make, and report one that vanishes beside the others."""
        fractions = divide(np.array(lengths) / max(lengths))
        for k, fraction in enumerate(fractions or ()):
            if fraction < LEAST_FRACTION:
                finding = f"{lengths[k]:g} is {fraction:.1e} of the horizon"
                self.fault(("intervals", k), finding, f"give at least {LEAST_FRACTION:g} of the horizon")
        return fractions

    def refinement(self, section: RefinementSection | None, accuracy: float) -> Refinement | None:
        """Return the accuracy that a refinement aims at, by default the problem's, and its rounds."""
        if section is None:
            return None
        if section.accuracy is not None:
            accuracy = self.number(("refine", "accuracy"), section.accuracy, least=LEAST_ACCURACY)
        return Refinement(accuracy, section.rounds)

    def cost(self, whole: ProblemSection, horizon: float) -> Cost:
        section = whole.cost
        running = tuple(self.term("running", i, term) for i, term in enumerate(section.running))
        running += self.metabolics(whole)
        running += tuple(x for i, part in enumerate(section.track) for x in self.referring.track(i, part, horizon))
        terminal = tuple(self.term("terminal", i, term) for i, term in enumerate(section.terminal))
        rates = self.number(("cost", "input_rates"), section.input_rates, least=0)
        if section.inputs is None:
            inputs = 0.0 if running or terminal or rates or section.largest else 1.0
        else:
            inputs = self.number(("cost", "inputs"), section.inputs, least=0)
        cost = Cost(inputs, rates, running, terminal)
        if not any(cost.weights) and not section.largest and not self.is_phase:
            self.fault(("cost",), "every weight is 0", "give inputs or input_rates a positive weight")
        return cost

    def metabolics(self, section: ProblemSection) -> tuple[Term, ...]:
        """Return the terms of the muscles' metabolic rates."""
        rates = list_metabolic_rates(section, self.plant)
        if section.muscles is None or section.muscles.metabolics is None:
            return ()
        weight = self.number(("muscles", "metabolics", "weight"), section.muscles.metabolics.weight, least=0)
        return tuple(Term(text, weight, name) for name, text in rates.items())

    def term(self, key: str, i: int, section: TermSection) -> Term:
        place: Place = ("cost", key, i)
        self.check_formula((*place, "expression"), section.expression)
        return Term(section.expression, self.number((*place, "weight"), section.weight))

    def constraint(self, i: int, section: ConstraintSection) -> Constraint:
        place: Place = ("constraints", i)
        self.check_formula((*place, "expression"), section.expression)
        return Constraint(section.expression, self.range((*place, "range"), section.range), section.at)

    def start(
        self,
        key: str,
        given: tuple[Expression | None, ...] | dict[str, Expression | None],
        among: _Names,
        bounds: Sequence[Range],
    ) -> tuple[tuple[float, ...], tuple[int, ...]]:
        """Return the value of each entry, and the indices of free ones, whose values are guesses within bounds."""
        place: Place = ("start", key)
        known = among.known
        if isinstance(given, tuple) and len(given) != len(known):
            self.fault(place, f"found {len(given)} numbers", f"give {len(known)}: {', '.join(known)}")
            return (0.0,) * len(known), ()
        named = dict(zip(known, given, strict=True)) if isinstance(given, tuple) else self.free_others(given, known)
        values = neutral(self.manifest).tolist() if key == "pose" else [0.0] * len(known)
        places: list[Place] = [place] * len(known)
        free = []
        for k, (name, expression) in enumerate(named.items()):
            inner = (*place, k if isinstance(given, tuple) else name)
            i = self.look_up(inner, name, among)
            value = 0.0 if expression is None else self.number(inner, expression)
            if i is not None and expression is None:
                free.append(i)
                value = min(max(values[i], bounds[i][0]), bounds[i][1])
            if i is not None:
                values[i], places[i] = value, inner
        if key == "pose":
            self.check_free(place, free)
            values = self.attitudes(place, values)
        for inner, name, value, (lower, upper) in zip(places, known, values, bounds, strict=True):
            if value < lower or value > upper:
                self.fault(inner, f"{name} = {value:g} is out of [{lower:g}, {upper:g}]", "start within the bounds")
        return tuple(values), tuple(sorted(free))

    def free_others(self, given: dict[str, Expression | None], known: Sequence[str]) -> dict[str, Expression | None]:
        """Free what a start leaves out, where a link gives it."""
        return {**dict.fromkeys(known), **given} if self.is_linked else given

    # --- closed loops ---

    def closed_start(
        self, closure: Closure, section: StartSection, bounds: Bounds
    ) -> tuple[tuple[float, ...], tuple[int, ...], tuple[float, ...], tuple[int, ...]]:
        """Return coordinates and velocities of the start, each with the indices of free ones; close the loops."""
        named_q = self.whole(("start", "pose"), self.named(("start", "pose"), section.pose, self.coordinates))
        named_qd = self.named(("start", "velocity"), section.velocity, self.velocities)
        usual = [i for i in closure.places_independent if i not in named_q]
        pose = complete_pose(closure, np.array(self.manifest.pose), _list_given(named_q), usual)
        self.check_completion(("start", "pose"), pose, self.coordinates)
        usual = [i for i in closure.independent if i not in named_qd]
        speeds = complete_velocities(closure, pose.values, _list_given(named_qd), usual)
        self.check_completion(("start", "velocity"), speeds, self.velocities)
        is_free = None in named_q.values() or bool(self.lengths)
        self.check_lengths(named_q, pose, named_qd, speeds)
        self.check_free(("start", "pose"), [i for i, value in named_q.items() if value is None])
        free_q = _list_others(pose, is_free=is_free)
        free_qd = _list_others(speeds, is_free=is_free or None in named_qd.values())
        if closure.parameters:
            other_q, other_qd = (_list_others(x, is_free=True) for x in (pose, speeds))
            self.following = (*other_q, *(len(pose.values) + i for i in other_qd))
        for key, known, values, free, limits in (
            ("pose", self.coordinates.known, pose.values, free_q, bounds.q),
            ("velocity", self.velocities.known, speeds.values, free_qd, bounds.qd),
        ):
            for i, (name, value, (lower, upper)) in enumerate(zip(known, values, limits, strict=True)):
                if i not in free and (value < lower - ROUNDED or value > upper + ROUNDED):
                    finding = f"{name} = {value:g} is out of [{lower:g}, {upper:g}]"
                    self.fault(("start", key), finding, "start within the bounds")
        return tuple(pose.values.tolist()), free_q, tuple(speeds.values.tolist()), free_qd

    def named(
        self, place: Place, given: tuple[Expression | None, ...] | dict[str, Expression | None], among: _Names
    ) -> dict[int, float | None]:
        """Return the values that are given, by index; None for free ones."""
        known = among.known
        if isinstance(given, tuple) and len(given) != len(known):
            self.fault(place, f"found {len(given)} numbers", f"give {len(known)}: {', '.join(known)}")
            return {}
        if isinstance(given, dict):
            given = self.free_others(given, known)
        found: dict[int, float | None] = {}
        for k, (name, expression) in enumerate(
            zip(known, given, strict=True) if isinstance(given, tuple) else given.items()
        ):
            inner = (*place, k if isinstance(given, tuple) else name)
            i = self.look_up(inner, name, among)
            if i is not None:
                found[i] = None if expression is None else self.number(inner, expression)
        return {i: value for i, value in found.items() if value is None or math.isfinite(value)}

    def whole(self, place: Place, given: dict[int, float | None]) -> dict[int, float | None]:
        """Complete quaternions of which some entries are given by zeros, and scale them to length 1."""
        for x in list_quaternions(self.manifest):
            entries = [given.get(i, 0.0) for i in x.entries]
            values = [value for value in entries if value is not None]
            if len(values) == 4 and given.keys() & set(x.entries):
                q = np.zeros(len(self.coordinates.known))
                q[[y.first + 3 for y in list_quaternions(self.manifest)]] = 1.0
                q[x.entries] = values
                q = np.array(self.attitudes(place, list(q)))
                given = {**given, **{i: float(q[i]) for i in x.entries}}
        return given

    def check_completion(self, place: Place, completion: Completion, among: _Names) -> None:
        """Report loops that do not close, and values that they contradict."""
        if completion.gap is not None:
            self.fault(place, str(completion.gap), "give values that the mechanism can have, or fewer of them")
        for stray in completion.strays:
            finding = (
                f"{among.known[stray.index]} = {stray.given:g}, but the loops put it at {stray.found:.9g}, "
                f"{stray.distance:.3g} away"
            )
            self.fault(place, finding, "leave it out: the loops give it")

    def check_lengths(
        self, named_q: dict[int, float | None], pose: Completion, named_qd: dict[int, float | None], speeds: Completion
    ) -> None:
        """Report values of the start that follow from others, where unknowns change the loops that give them."""
        if not self.lengths:
            return
        moving = named_qd if speeds.values.any() else {}
        for key, given, completion, known in (
            ("pose", named_q, pose, self.coordinates.known),
            ("velocity", moving, speeds, self.velocities.known),
        ):
            for i in [i for i in _list_given(given) if i not in completion.kept]:
                self.fault(("start", key, known[i]), *self.describe_surplus(known[i], "leave it out"))

    def describe_surplus(self, name: str, remedy: str) -> tuple[str, str]:
        """Return finding and remedy of a value that follows from others by loops that unknowns change."""
        return f"{name} follows from the others by the loops, which change with {', '.join(self.lengths)}", remedy

    def closed_end(self, closure: Closure, end: End, start_q: Sequence[float]) -> End:
        """Drop coordinates of the end that follow from others; refuse values that contradict the others."""
        given, near = dict(end.coordinates), np.array(start_q)
        surplus = find_surplus_places(closure, near, list(given))
        for i in surplus if self.lengths else []:
            remedy = "leave it out, or write it as a constraint at: end"
            name = self.coordinates.known[i]
            self.fault(("end", "pose", name), *self.describe_surplus(name, remedy))
        if surplus:
            kept = {i: x for i, x in given.items() if i not in surplus}
            turned = near.copy()
            for x in list_quaternions(self.manifest):
                if set(x.entries) <= set(surplus):
                    turned[x.entries] = [given[i] for i in x.entries]
            found = complete_pose(closure, turned, kept, ())
            self.check_completion(("end", "pose"), find_strays(found, given), self.coordinates)
            for joint in find_divided_attitudes(closure, near, list(kept), surplus):
                finding = f"the loops give a part of the attitude of {joint}, and leave the rest free"
                self.fault(("end", "pose"), finding, "give other coordinates, or constrain its entries at: end")
        for key, targets in (("velocity", end.velocities), ("acceleration", end.accelerations)):
            for i in find_surplus(closure, near, [i for i, _ in targets]):
                finding = f"{self.velocities.known[i]} follows from the others by the loops"
                self.fault(("end", key, self.velocities.known[i]), finding, "leave it out")
        return replace(end, coordinates=tuple((i, x) for i, x in end.coordinates if i not in surplus))

    def attitudes(self, place: Place, values: Sequence[float]) -> list[float]:
        """Normalise the quaternions among coordinates."""
        q = np.array(values)
        for x, length in zip(list_quaternions(self.manifest), measure_lengths(q, self.manifest), strict=True):
            if length == 0:
                remedy = f"give {self.coordinates.known[x.first + 3]} too; 0, 0, 0, 1 turns nothing"
                self.fault(place, f"the quaternion of {x.joint} is 0", remedy)
        return [float(x) for x in normalise(q, self.manifest)]

    def check_free(self, place: Place, free: Sequence[int]) -> None:
        """Refuse a quaternion that is free in part."""
        for x in list_quaternions(self.manifest):
            if 0 < len(set(free) & set(x.entries)) < 4:
                remedy = "give null for all four of its entries, or constrain them by expressions at: start"
                self.fault(place, f"the quaternion of {x.joint} is free in part", remedy)

    def bounds(self, section: BoundsSection) -> Bounds:
        bounds = Bounds(
            self.ranges("coordinates", section.coordinates, self.coordinates, self.limits),
            self.ranges("velocities", section.velocities, self.velocities, self.speeds),
            self.ranges("inputs", section.inputs, self.inputs, self.forces),
            self.rates(section),
            self.driving(section),
        )
        for x in list_quaternions(self.manifest):
            lower, upper = np.array([bounds.q[i] for i in x.entries]).T
            least, most = np.clip(0.0, lower, upper), np.maximum(np.abs(lower), np.abs(upper))
            if np.linalg.norm(least) > 1 or np.linalg.norm(most) < 1:
                finding = f"no quaternion of {x.joint} has length 1 within these bounds"
                self.fault(("bounds", "coordinates"), finding, "widen them; null is no bound")
        return bounds

    def driving(self, section: BoundsSection) -> tuple[Range, ...]:
        """Read the bounds of the forces of driven joints; none where no force has one."""
        joints = _Names("driven joint", [self.velocities.known[i] for i in self.manifest.driven])
        found = self.ranges("tau", section.tau, joints, [_both_ways(None)] * len(joints.known))
        return found if any(limits != _both_ways(None) for limits in found) else ()

    def rates(self, section: BoundsSection) -> tuple[Range, ...]:
        """Read the bounds of rates; none where no input has one."""
        found = self.ranges("input_rates", section.input_rates, self.inputs, [_both_ways(None)] * len(self.forces))
        return found if any(limits != _both_ways(None) for limits in found) else ()

    def ranges(
        self, key: str, given: Limits | dict[str, Limits], among: _Names, usual: Sequence[Range]
    ) -> tuple[Range, ...]:
        place, ranges = ("bounds", key), list(usual)
        if isinstance(given, tuple):
            return (self.range(place, given),) * len(ranges)
        for name, limits in given.items():
            i, value = self.look_up((*place, name), name, among), self.range((*place, name), limits)
            if i is not None:
                ranges[i] = value
        return tuple(ranges)

    def end(self, section: EndSection, bounds: Bounds) -> End:
        sensors, velocities = [], []
        for name, position in section.sensors.items():
            place = ("end", "sensors", name)
            self.look_up(place, name, self.sensors)
            sensors.append((name, self.position(place, position)))
        for name, velocity in section.sensor_velocities.items():
            place = ("end", "sensor_velocities", name)
            self.look_up(place, name, self.sensors)
            x, y, z = (self.number((*place, key), getattr(velocity, key)) for key in ("x", "y", "z"))
            velocities.append((name, (x, y, z)))
        orientations = ((name, self.orientation(name, part)) for name, part in section.orientations.items())
        return End(
            orientations=tuple((name, aims) for name, aims in orientations if aims is not None),
            sensors=tuple(sensors),
            coordinates=self.pose(section.pose, bounds),
            velocity_zero=section.velocity == "zero",
            acceleration_zero=section.acceleration == "zero",
            velocities=self.targets("velocity", section.velocity, self.velocities, bounds.qd),
            accelerations=self.targets("acceleration", section.acceleration, self.velocities, ()),
            sensor_velocities=tuple(velocities),
        )

    def orientation(self, name: str, section: OrientationSection) -> Aims | None:
        """Read the orientation of a sensor at the end."""
        place: Place = ("end", "orientations", name)
        known = self.look_up(place, name, self.sensors) is not None
        given = {key: x for key in OrientationSection.model_fields if (x := getattr(section, key)) is not None}
        values = {key: [self.number((*place, key, i), x) for i, x in enumerate(own)] for key, own in given.items()}
        aims: Aims | None = None
        if values.keys() == {"rpy"}:
            aims = turn_by(*values["rpy"])
        elif values.keys() == {"quaternion"}:
            aims = turn_to(*values["quaternion"])
        elif values and values.keys() <= {"x", "y", "z"}:
            aims = point({"xyz".index(key): direction for key, direction in values.items()})
        if aims is None:
            finding = f"found {', '.join(given) or 'nothing'}"
            remedy = "give rpy, a quaternion that is not 0, the direction of one axis, or perpendicular ones of two"
            self.fault(place, finding, remedy)
        return aims if known else None

    def orient(self, end: End) -> Iterator[Constraint]:
        """Yield the constraints of orientations at the end."""
        spelled = dict(zip(self.sensors.known, spell(self.sensors.known), strict=True))
        for name, aims in end.orientations:
            place: Place = ("end", "orientations", name)
            own = spelled[name]
            if own is None:
                self.fault(place, "two sensors have one name in expressions", "rename the frame in the model")
                continue
            for found in list_conditions(aims, self.sensors.known.index(name), own, self.plant):
                if isinstance(found, float):
                    finding = f"no coordinate turns {name} there: an axis stays {found:.3g} off"
                    self.fault(place, finding, "give an orientation that the mechanism can have, or one axis of it")
                    break
                yield Constraint(found.expression, found.range, "end", name=f"the orientation of {name}")

    def pose(
        self, given: tuple[Expression | None, ...] | dict[str, Expression | None] | None, bounds: Bounds
    ) -> tuple[tuple[int, float], ...]:
        """Read the values of coordinates at the end; a quaternion is given whole, and normalised."""
        known = self.coordinates.known
        if isinstance(given, tuple) and len(given) != len(known):
            self.fault(("end", "pose"), f"found {len(given)} numbers", f"give {len(known)}: {', '.join(known)}")
            return ()
        if isinstance(given, tuple):
            given = dict(zip(known, given, strict=True))
        turning, free = list_quaternions(self.manifest), (-math.inf, math.inf)
        ranges = [free if find_quaternion(turning, i) else limits for i, limits in enumerate(bounds.q)]
        targets = dict(self.targets("pose", given, self.coordinates, ranges))
        q = self.attitudes(("end", "pose"), [targets.get(i, x) for i, x in enumerate(neutral(self.manifest))])
        for x in turning:
            self.check_attitude(x, [i for i in x.entries if i in targets], q, bounds)
        return tuple((i, q[i]) for i in targets)

    def check_attitude(self, quaternion: Quaternion, given: Sequence[int], q: Sequence[float], bounds: Bounds) -> None:
        """Refuse part of a quaternion, and an attitude that is out of bounds with either sign."""
        if not given:
            return
        place: Place = ("end", "pose", self.coordinates.known[given[0]])
        missing = [self.coordinates.known[i] for i in quaternion.entries if i not in given]
        if missing:
            remedy = f"give {', '.join(missing)} too, or constrain what is meant by an expression at: end"
            self.fault(place, f"only a part of the quaternion of {quaternion.joint}", remedy)
        elif not any(
            all(bounds.q[i][0] <= sign * q[i] <= bounds.q[i][1] for i in quaternion.entries) for sign in (1, -1)
        ):
            self.fault(place, f"the attitude of {quaternion.joint} is out of bounds", "end within the bounds")

    def targets(
        self, key: str, given: dict[str, Expression | None] | str | None, among: _Names, bounds: Sequence[Range]
    ) -> tuple[tuple[int, float], ...]:
        """Read the values of some entries of the state, or accelerations, at the end; null leaves one free."""
        targets = []
        for name, expression in (given if isinstance(given, dict) else {}).items():
            place = ("end", key, name)
            i = self.look_up(place, name, among)
            value = 0.0 if expression is None else self.number(place, expression)
            if i is not None and expression is not None:
                targets.append((i, value))
                lower, upper = bounds[i] if bounds else (-math.inf, math.inf)
                if value < lower or value > upper:
                    self.fault(place, f"{value:g} is out of [{lower:g}, {upper:g}]", "end within the bounds")
        return tuple(targets)

    def position(self, place: Place, section: PositionSection) -> Target:
        given = {key: value for key in PositionSection.model_fields if (value := getattr(section, key)) is not None}
        if not given or not (set(given) <= {"x", "y", "z"} or set(given) == {"radius", "azimuth", "height"}):
            remedy = "give radius, azimuth and height, or x, y, z; what is left out of x, y, z is free"
            self.fault(place, f"found {', '.join(given) or 'nothing'}", remedy)
            return (None, None, None)
        values = {key: self.number((*place, key), expression) for key, expression in given.items()}
        if "radius" in values:
            return cylindrical(**values)
        return values.get("x"), values.get("y"), values.get("z")

    def guess(
        self,
        section: GuessSection,
        bounds: Bounds,
        start_q: Sequence[float],
        free: Sequence[int],
        given: StartValues,
        end: End,
    ) -> GuessOptions:
        """Read how to guess; `free` are the coordinates without a value at the start, whose pose is given."""
        for i, name in enumerate(section.upright):
            self.look_up(("guess", "upright", i), name, self.frames)
        start = self.guessed_pose("start", section.start, bounds)
        for i, _ in start:
            if i not in free:
                name, finding = self.coordinates.known[i], "this coordinate has a value at the start"
                remedy = "leave it out, or free it by null there"
                if self.closure is not None and isinstance(given, dict) and name not in given:
                    finding = "the loops give this coordinate at the start"
                    remedy = "leave it out; the model's assembly chooses the way to close them"
                self.fault(("guess", "start", name), finding, remedy)
        last = self.guessed_pose("end", section.end, bounds)
        if self.closure is not None and not self.faults:
            held = {i: value for i, value in enumerate(start_q) if i not in free}
            start, first = self.closed_guess("start", self.closure, start, held, np.array(start_q))
            last, _ = self.closed_guess("end", self.closure, last, dict(end.coordinates), first)
        return GuessOptions(
            section.upright, section.motion, section.inputs, section.solution, self.guessed_times(section), start, last
        )

    def closed_guess(
        self,
        key: str,
        closure: Closure,
        guessed: Sequence[tuple[int, float]],
        held: Mapping[int, float],
        near: NDArray[np.float64],
    ) -> tuple[tuple[tuple[int, float], ...], NDArray[np.float64]]:
        """Close the loops at a guessed pose; return its entries without a value in the problem, and all of it."""
        if not guessed:
            return (), near
        usual = [i for i in closure.places_independent if i not in {*held, *dict(guessed)}]
        found = complete_pose(closure, near, {**held, **dict(guessed)}, usual)
        self.check_completion(("guess", key), found, self.coordinates)
        return tuple((i, value) for i, value in enumerate(found.values.tolist()) if i not in held), found.values

    def guessed_times(self, section: GuessSection) -> tuple[float | None, float | None]:
        """Read the part of a recording that is a guess."""
        first, last = (
            None if limit is None else self.number(("guess", "times", i), limit)
            for i, limit in enumerate(section.times)
        )
        place: Place = ("guess", "times")
        if first is not None and last is not None and first >= last:
            self.fault(place, f"{first:g} is not before {last:g}", "give [from, to], in s of the recording")
        if (first, last) != (None, None):
            if section.solution is None:
                self.fault(place, "there is no recording to take a part of", "give it as solution, or leave this out")
            elif is_solution(Path(section.solution)):
                self.fault(place, "a solution is taken as a whole", "leave it out, or give a recording as solution")
        return first, last

    def guessed_pose(self, key: str, given: dict[str, Expression], bounds: Bounds) -> tuple[tuple[int, float], ...]:
        """Read guesses of coordinates at the start or at the end."""
        place: Place = ("guess", key)
        found = []
        for name, expression in given.items():
            inner = (*place, name)
            i, value = self.look_up(inner, name, self.coordinates), self.number(inner, expression)
            if i is None:
                continue
            lower, upper = bounds.q[i]
            if find_quaternion(list_quaternions(self.manifest), i) is not None:
                self.fault(inner, "a part of a quaternion", "guess the coordinates of other joints")
            elif value < lower or value > upper:
                self.fault(inner, f"{value:g} is out of [{lower:g}, {upper:g}]", "guess within the bounds")
            else:
                found.append((i, value))
        return tuple(found)

    def solver(self, section: SolverSection) -> SolverOptions:
        place, scaling = ("solver",), section.objective_scaling
        return SolverOptions(
            tolerance=self.number((*place, "tolerance"), section.tolerance, least=LEAST_TOLERANCE),
            max_iterations=section.max_iterations,
            objective_scaling=None
            if scaling is None
            else self.number((*place, "objective_scaling"), scaling, least=math.ulp(0)),
            method=section.method,
            options=tuple(self.options(section)),
            threads=self.threads(section),
            fallback=section.fallback,
        )

    def threads(self, section: SolverSection) -> int:
        """Check that the method may have as many threads."""
        method = choose(SolverOptions(method=section.method, options=tuple(section.options.items())))
        if section.threads > 1 and not METHODS[method].has_threads:
            finding = f"found {section.threads}, but {method} has one thread"
            self.fault(("solver", "threads"), finding, "leave it out, or choose mbs")
        return section.threads

    def options(self, section: SolverSection) -> Iterator[tuple[str, float | int | str]]:
        """Check options of the solver against its table."""
        method = choose(SolverOptions(method=section.method, options=tuple(section.options.items())))
        known = METHODS[method].options
        for name, given in section.options.items():
            place: Place = ("solver", "options", name)
            if name not in known:
                meant = nearest(name, [*known, *(() if section.method else METHODS["ipopt"].options)])
                remedy = f"did you mean {abbreviate(meant)}?" if meant else f"there are {', '.join(known)}"
                self.fault(place, f"{method} takes no option {abbreviate(name)} here", remedy)
                continue
            option, value = known[name], given
            if isinstance(value, bool):  # YAML reads yes and no so
                value = "yes" if value else "no"
            elif isinstance(option, Amount) and isinstance(value, str):  # 1e-3 is text in YAML
                try:
                    value = evaluate(parse(value), self.constants, FLOATS)
                except ExpressionError as error:
                    self.fault(place, error.finding, error.remedy)
                    continue
            if option.admits(value):
                yield name, int(value) if isinstance(option, Amount) and option.whole else value
            else:
                self.fault(place, f"found {abbreviate(given)}", f"give {option.wanted}")

    def look_up(self, place: Place, name: str, among: _Names) -> int | None:
        """Look a name of one kind up; report it where it is unknown."""
        return self.find(place, name, among.known, among.kind)


def _list_given(named: Mapping[int, float | None]) -> dict[int, float]:
    return {i: value for i, value in named.items() if value is not None}


def _list_others(completion: Completion, *, is_free: bool) -> tuple[int, ...]:
    """List the entries that are no conditions, where some are free."""
    return tuple(i for i in range(completion.values.size) if i not in completion.kept) if is_free else ()


@dataclass(frozen=True)
class _Names:
    """The names of one kind in a model, in order."""

    kind: str
    known: list[str]


def _both_ways(bound: float | None) -> Range:
    return (-math.inf, math.inf) if bound is None else (-bound, bound)
