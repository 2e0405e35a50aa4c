"""Check a problem that a program made: types first, then its meaning in a model; report all faults at once.

`statement` makes the same checks of a file, with its lines. Bounds that cross are a failure of the solve (`solve`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import fields, is_dataclass, replace
from functools import cache

from pydantic import TypeAdapter, ValidationError

from mbsgen.documents import Finding, abbreviate, write_path
from mbsgen.errors import MbsError
from mbsgen.expressions import ExpressionError, is_free_name, names, parse
from mbsgen.manifest import Manifest
from mbsgen.roles import Role
from mbsrun.closure import has_loops
from mbsrun.ocp.ground.integrators import INTEGRATORS, SECOND_ORDER
from mbsrun.ocp.ground.memory import Memory
from mbsrun.ocp.ground.schemes import DEGREES, Family
from mbsrun.ocp.methods import METHODS
from mbsrun.ocp.methods import choose as choose_method
from mbsrun.ocp.problem import driving
from mbsrun.ocp.problem.contacts import find_faults as find_contact_faults
from mbsrun.ocp.problem.design import list_changeable
from mbsrun.ocp.problem.given import find_faults, list_open_components
from mbsrun.ocp.problem.problem import (
    Control,
    Form,
    Loops,
    Problem,
    Representation,
    State,
    Unknown,
    find_conflicts,
    list_names,
)
from mbsrun.ocp.transcription.quantities import list_quantities
from mbsrun.quantities import Added, find_component
from mbsrun.quaternions import list_divided, list_quaternions
from mbsrun.recordings import references

MAX_INTERVALS = 10_000
MAX_STEPS = 100  # of an integrator in an interval
LEAST_TOLERANCE = 1e-14  # of a solver
LEAST_FRACTION = 1e-6  # of the horizon, of an interval
LEAST_ACCURACY = 1e-12  # that the re-simulation can confirm
MAX_ROUNDS = 100  # of a refinement
MAX_THREADS = 64  # of a solve
FRACTIONS_SUM = 1e-9  # how far from 1 the sum of all fractions may be

Line = tuple[str, str, str]  # of an error: the part of the problem, what was found, what to do


_FREE_OF_COST: Line = ("cost", "every weight is 0", "give inputs or input_rates a positive weight")
_UNCONTROLLED: Line = (
    "model",
    "the model has no actuated coordinate",
    "give it one, or the problem controls: there is nothing to control",
)


class ProblemError(MbsError, ValueError):
    """A problem with faults: one a line."""

    def __init__(self, name: object, findings: Sequence[Line]) -> None:
        self.findings = tuple(findings)
        lines = (f"problem {name}: {place}: {finding}; {remedy}" for place, finding, remedy in self.findings)
        super().__init__("\n".join(lines))


def check_problem(problem: Problem, manifest: Manifest, *, is_phase: bool = False) -> None:
    """Raise ProblemError with every fault of a problem for a model; a phase of several may cost and control nothing.

    A problem that was found right is not checked again.
    """
    _RIGHT[is_phase].find(lambda: _check(problem, manifest, is_phase=is_phase), problem, manifest)


_RIGHT: Mapping[bool, Memory[None]] = {False: Memory(), True: Memory()}


_TYPED: Memory[None] = Memory()


def trust_types(problem: Problem) -> None:
    """Take the types in a problem for right, as the sections of a file determine them; its meaning is still checked."""
    _TYPED.find(lambda: None, problem)


def _check(problem: Problem, manifest: Manifest, *, is_phase: bool) -> None:
    findings = [] if _TYPED.knows(problem) else list(_find_wrong_types(problem))
    findings = findings or list(_find_unknown_names(problem))
    findings = findings or [*_find_wrong_values(problem), *_find_strangers(problem, manifest)]
    findings = [found for found in findings if not (is_phase and found in (_FREE_OF_COST, _UNCONTROLLED))]
    if not findings:
        conflicts = [*find_conflicts(problem), *find_loop_conflicts(problem, manifest), *find_open_references(problem)]
        conflicts += find_unknown_conflicts(problem, manifest)
        conflicts += find_phase_conflicts(manifest) if is_phase else driving.find_conflicts(problem, manifest)
        findings = [(str(c.place[0]), c.finding, c.remedy) for c in conflicts]
        findings += _find_divided_quaternions(problem, manifest)
    if findings:
        raise ProblemError(getattr(problem, "name", "?"), findings)


def list_open_inputs(manifest: Manifest) -> list[str]:
    """List the inputs of a model's residual to which no part of a problem can give a value."""
    own = (
        Role.COORDINATE,
        Role.VELOCITY,
        Role.ACCELERATION,
        Role.MULTIPLIER,
        Role.DRIVE,  # these two are refused by themselves
        Role.DRIVING_FORCE,
        Role.FORCE,
        Role.WRENCH,  # of which components are refused by themselves
        Role.SETUP,
        Role.DESIGN,
    )
    inputs = manifest.kernel("impl").inputs if manifest.coordinates else ()
    return [i.name for i in inputs if i.role not in own and i.nnz]


def find_loop_conflicts(problem: Problem, manifest: Manifest) -> Iterator[Finding]:
    """Find what a problem asks for that closed loops, or the form that they have, do not give."""
    loops, form, representation = problem.loops, problem.form, problem.representation
    if not has_loops(manifest):
        if loops is not None:
            yield Finding(("loops",), "the model has no closed loops", "leave this out")
        return
    if form is not Form.STANDARD and loops is Loops.MULTIPLIERS:
        finding = f"the {form.value} form has no multipliers of loops, and no corrections, at its points"
        remedy = "take standard, or loops: reduced where independent coordinates determine the others along the motion"
        yield Finding(("form",), finding, remedy)
    if problem.family is Family.LOBATTO:
        finding = "loops are closed at the mesh points, and lobatto would close them there twice"
        yield Finding(("scheme",), finding, "take scheme: radau")
    elif loops is Loops.MULTIPLIERS and problem.family is not Family.RADAU:
        finding = f"the points of {problem.family.value} are no mesh points, where loops would be open"
        yield Finding(("loops",), finding, "take scheme: radau, or loops: reduced")
    if loops is Loops.MULTIPLIERS and problem.integrator == SECOND_ORDER:
        finding = "corrections of the rates of coordinates, which second-order collocation does not have"
        yield Finding(("loops",), finding, "take integrator: collocation, or loops: reduced")
    if loops is Loops.REDUCED or (loops is None and form is not Form.STANDARD):
        # other forms are reduced without being asked
        key, other = ("form", "form: standard") if loops is None else ("loops", "loops: multipliers")
        other += ", in form: standard" if loops is not None and form is not Form.STANDARD else ""
        if representation in _WITHOUT_REDUCTION:
            finding = f"{representation.value} has no reduced form"
            yield Finding((key,), finding, f"take representation: IMPL or EXP1-O, or {other}")
        if divided := list_divided(manifest, manifest.independent):
            named = ", ".join(dict.fromkeys(manifest.positions[i].rpartition(".")[0] for i in divided))
            finding = f"some velocities of {named} are independent and some are not; the reduced form takes all or none"
            yield Finding((key,), finding, f"take {other}")
        if named := _find_dependent_accelerations(problem, manifest):
            finding = f"the problem reads the acceleration of {named}, which the reduced form does not compute"
            yield Finding((key,), finding, f"take {other}")


def find_phase_conflicts(manifest: Manifest) -> Iterator[Finding]:
    """Find models that no phase of a problem takes."""
    if manifest.driven:
        named = ", ".join(manifest.coordinates[i].name for i in manifest.driven)
        finding = f"the model drives {named}, and a problem of phases takes no driven joints"
        remedy = "give these joints actuators, and their motion as constraints along the path"
        yield Finding(("model",), finding, remedy)


def find_open_references(problem: Problem) -> Iterator[Finding]:
    """Find references in seconds under a free horizon, and expressions that read a reference where it is unknown.

    An expression that reads known_NAME beside ref_NAME minds the gaps itself.
    """
    named, open_ones = references.list_names(problem.references), set()
    for reference in problem.references:
        if not (problem.is_timed or reference.is_normalised):
            open_ones.add(reference.name)
            finding = f"the horizon is free, and the reference {reference.name} is in seconds"
            remedy = "write time: normalised into it, or give the horizon"
            yield Finding(("references", reference.name), finding, remedy)
    for text in [text for _, texts in list_expressions(problem) for text in texts]:
        read = names(parse(text)) & set(named)
        for name in sorted(read):
            reference, track = named[name]
            minded = name.replace(references.VALUE, references.KNOWN, 1)
            if reference.name in open_ones or name.startswith(references.KNOWN):
                continue
            unknown = references.list_unknown(reference, track, problem.horizon)
            factors = [named[other] for other in read if other.startswith(references.KNOWN)]
            if unknown and unknown not in [references.list_unknown(*pair, problem.horizon) for pair in factors]:
                spans = ", ".join(f"{a:.6g} to {b:.6g} s" for a, b in unknown[:3]) + (", ..." if unknown[3:] else "")
                finding = f"{name} is unknown at {spans} of its recording, and {abbreviate(text)} reads it"
                remedy = f"multiply by {minded}, which is 0 there, or bridge longer gaps"
                yield Finding(("references", reference.name), finding, remedy)


def find_unknown_conflicts(problem: Problem, manifest: Manifest) -> Iterator[Finding]:
    """Find unknowns and parameters that a model does not allow."""
    changeable, given = list_changeable(manifest), dict(problem.parameters)
    for name in given:
        if name not in changeable:
            finding = f"{manifest.model} has no parameter {abbreviate(name)} that may be changed"
            yield Finding(("parameters", name), finding, f"there are {', '.join(changeable) or 'none'}")
    for name in (unknown.name for unknown in problem.unknowns):
        if name in given:
            yield Finding(("unknowns", name), f"{name} has a value in parameters, too", "leave one of them out")
        if changeable.get(name) is False:
            finding = f"{name} is a run-time parameter, by which kernels have no derivatives"
            yield Finding(("unknowns", name), finding, "write kind: differentiated in the model")


_WITHOUT_REDUCTION = (Representation.SEMI, Representation.EXP2_O, Representation.EXP2_A)


def _find_dependent_accelerations(problem: Problem, manifest: Manifest) -> str:
    """Name the dependent coordinates whose accelerations are read, which are no variables in the reduced form."""
    known = list_quantities(manifest, problem.added)
    texts = [text for _, own in list_expressions(problem) for text in own]
    read = [known[name] for text in texts for name in list_names(text, problem.functions) if name in known]
    found = {x.index for x in read if x.kind == "qdd"} | {i for i, _ in problem.end.accelerations}
    return ", ".join(manifest.coordinates[i].name for i in sorted(found & set(manifest.dependent)))


@cache
def _adapter() -> TypeAdapter[Problem]:
    return TypeAdapter(Problem)


def _find_wrong_types(problem: Problem) -> Iterator[Line]:
    try:
        plain = _take_apart(replace(problem, references=()))  # which may hold many thousand numbers
    except TypeError:
        yield ("problem", f"found {abbreviate(type(problem).__name__)}", "give a Problem")
        return
    for i, reference in enumerate(problem.references):
        if not isinstance(reference, references.Reference):
            yield (f"references[{i}]", f"found {abbreviate(type(reference).__name__)}", "give a Reference")
    try:
        _adapter().validate_python(plain)
    except ValidationError as error:
        for fault in error.errors(include_url=False):
            place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in fault["loc"]).lstrip(".")
            kind = type(fault["input"]).__name__
            yield (place, f"found {abbreviate(str(fault['input']))} ({kind})", f"{fault['msg']}")


def _take_apart(value: object) -> object:
    """Return a dataclass as a mapping, at any depth; other values stay the same objects, as copies take long."""
    if (names := _name_fields(type(value))) is not None:
        return {name: _take_apart(getattr(value, name)) for name in names}
    return tuple(map(_take_apart, value)) if isinstance(value, tuple) else value


def _name_fields(kind: type) -> tuple[str, ...] | None:
    """Name the fields of a dataclass; None for any other type."""
    if kind not in _FIELDS:
        _FIELDS[kind] = tuple(field.name for field in fields(kind)) if is_dataclass(kind) else None
    return _FIELDS[kind]


_FIELDS: dict[type, tuple[str, ...] | None] = {}  # each found once


def _find_unknown_names(problem: Problem) -> Iterator[Line]:
    """Find names of methods that no registry has."""
    for place, name, known in (
        ("integrator", problem.integrator, INTEGRATORS),
        ("solver.method", problem.solver.method, METHODS),
    ):
        if name is not None and name not in known:
            yield (place, f"found {abbreviate(name)}", f"give one of {', '.join(known)}")


def _find_wrong_values(problem: Problem) -> Iterator[Line]:
    solver, cost = problem.solver, problem.cost
    for place, whole, least, most in (
        ("intervals", problem.intervals, 1, MAX_INTERVALS),
        ("degree", problem.degree, DEGREES[0], DEGREES[-1]),
        ("steps", problem.steps, 1, MAX_STEPS),
        ("solver.max_iterations", solver.max_iterations, 1, None),
        ("solver.threads", solver.threads, 1, MAX_THREADS),
    ):
        if whole < least or (most is not None and whole > most):
            limit = f"from {least} to {most}" if most is not None else f"of at least {least}"
            yield (place, f"found {whole}", f"give a whole number {limit}")
    for place, value in (
        ("horizon", problem.horizon),
        ("accuracy", problem.accuracy),
        ("solver.tolerance", solver.tolerance),
        *([] if solver.objective_scaling is None else [("solver.objective_scaling", solver.objective_scaling)]),
    ):
        least_value = LEAST_TOLERANCE if place == "solver.tolerance" else math.ulp(0)
        if not (math.isfinite(value) and value >= least_value):
            wanted = f"a number of at least {least_value:g}" if place == "solver.tolerance" else "a positive number"
            yield (place, f"found {value:g}", f"give {wanted}")
    method = choose_method(solver, calls_casadi=bool(problem.functions))
    if solver.threads > 1 and not METHODS[method].has_threads:
        yield ("solver.threads", f"found {solver.threads}, but {method} has one thread", "leave it out, or choose mbs")
    yield from _find_wrong_mesh(problem)
    yield from _find_wrong_refinement(problem)
    if problem.horizon_range is not None:
        lower, upper = problem.horizon_range
        if not lower > 0:
            yield ("horizon_range", f"the least is {lower:g}", "give a positive one")
        elif not lower <= problem.horizon <= upper:
            yield ("horizon", f"{problem.horizon:g} is out of [{lower:g}, {upper:g}]", "guess within the range")
    if not all(map(math.isfinite, cost.weights)) or cost.inputs < 0 or cost.input_rates < 0:
        yield (
            "cost",
            f"the weights are {cost.weights}",
            "give finite ones, and inputs and rates not negative ones",
        )
    elif not any(cost.weights):
        yield _FREE_OF_COST
    method = choose_method(solver, calls_casadi=bool(problem.functions))
    known = METHODS[method].options
    for name, option in solver.options:
        if name not in known:
            yield ("solver.options", f"{method} takes no option {abbreviate(name)} here", "leave it out")
        elif not known[name].admits(option):
            yield (f"solver.options.{name}", f"found {abbreviate(option)}", f"give {known[name].wanted}")


def _find_wrong_mesh(problem: Problem) -> Iterator[Line]:
    mesh = problem.mesh
    if mesh is None:
        return
    if len(mesh) != problem.intervals:
        remedy = "give one fraction for each, or None for equal intervals"
        yield ("mesh", f"found {len(mesh)} fractions for {problem.intervals} intervals", remedy)
    elif not all(LEAST_FRACTION <= fraction <= 1 for fraction in mesh):
        remedy = f"give positive parts of the horizon, at least {LEAST_FRACTION:g} each"
        yield ("mesh", f"the fractions are from {min(mesh):g} to {max(mesh):g}", remedy)
    elif abs(math.fsum(mesh) - 1) > FRACTIONS_SUM:
        yield ("mesh", f"the fractions sum to {math.fsum(mesh):.12g}", "divide them by their sum")


def _find_wrong_refinement(problem: Problem) -> Iterator[Line]:
    asked = problem.refine
    if asked is None:
        return
    if not LEAST_ACCURACY <= asked.accuracy < math.inf:
        remedy = f"give at least {LEAST_ACCURACY:g}, which the re-simulation can confirm"
        yield ("refine.accuracy", f"found {asked.accuracy:g}", remedy)
    if not 1 <= asked.rounds <= MAX_ROUNDS:
        yield ("refine.rounds", f"found {asked.rounds}", f"give a whole number from 1 to {MAX_ROUNDS}")


def _find_strangers(problem: Problem, manifest: Manifest) -> Iterator[Line]:
    """Find lengths, indices and names that do not fit the model."""
    nq, n, m = len(manifest.positions), len(manifest.coordinates), len(manifest.actuated)
    chooses_motion = problem.unknowns or (manifest.driven and not problem.is_timed)
    if not (m or problem.controls or problem.every_component or chooses_motion):
        yield _UNCONTROLLED
    if left := list_open_inputs(manifest):
        remedy = "give them in the model: here they have no value"
        yield ("model", f"the model leaves {', '.join(left)} open, beside the inputs u", remedy)
    bounds, end = problem.bounds, problem.end
    for place, values, size in (
        ("start_q", problem.start_q, nq),
        ("start_qd", problem.start_qd, n),
        ("bounds.q", bounds.q, nq),
        ("bounds.qd", bounds.qd, n),
        ("bounds.u", bounds.u, m),
        ("bounds.rates", bounds.rates, m if bounds.rates else 0),
        ("first_inputs", problem.first_inputs, m if problem.first_inputs else 0),
        ("first_controls", problem.first_controls, len(problem.controls) if problem.first_controls else 0),
        ("bounds.tau", bounds.tau, len(manifest.driven) if bounds.tau else 0),
    ):
        if len(values) != size:
            yield (place, f"found {len(values)} entries", f"give {size}, as the model {manifest.model} has")
        elif place.startswith("start") and not all(isinstance(x, float | int) and math.isfinite(x) for x in values):
            yield (place, f"found {abbreviate(str(values))}", "give finite numbers")
    for place, indices, size in (
        ("free_start", problem.free_start, nq + n),
        ("following", problem.following, nq + n),
        ("end.coordinates", [i for i, _ in end.coordinates], nq),
        ("end.velocities", [i for i, _ in end.velocities], n),
        ("end.accelerations", [i for i, _ in end.accelerations], n),
    ):
        for i in indices:
            if not 0 <= i < size:
                yield (place, f"found index {i}", f"give one from 0 to {size - 1}")
    for unknown in problem.unknowns:
        if not (math.isfinite(unknown.guess) and unknown.bounds[0] <= unknown.guess <= unknown.bounds[1]):
            yield ("unknowns", f"the guess of {unknown.name} is {unknown.guess:g}", "guess within the range")
    ends = [value for _, value in (*end.coordinates, *end.velocities, *end.accelerations)]
    points = [value for _, point in (*end.sensors, *end.sensor_velocities) for value in point if value is not None]
    if not all(map(math.isfinite, (*ends, *points))):
        yield ("end", "a value is not finite", "give finite numbers")
    yield from _find_unknown_frames(problem, manifest)
    known = [*(name for name, _ in problem.constants), *(unknown.name for unknown in problem.unknowns)]
    for found in driving.find_wrong_motions(problem.driven, known, manifest):
        yield write_path(found.place), found.finding, found.remedy
    yield from _find_wrong_rates(problem, m)
    yield from _find_wrong_additions(problem, manifest)
    yield from _find_wrong_wrenches(problem, manifest)
    yield from find_faults(problem, manifest)
    yield from find_contact_faults(problem, manifest)
    yield from _find_wrong_expressions(problem, manifest)


def _find_wrong_rates(problem: Problem, m: int) -> Iterator[Line]:
    """Find prices of rates and delays without a control or an input, and histories out of bounds."""
    controls, given = [control.name for control in problem.controls], {force.input for force in problem.forces}
    for name, weight in problem.cost.control_rates:
        if name not in controls:
            yield ("cost.control_rates", f"no control {abbreviate(name)}", f"there are {', '.join(controls) or 'none'}")
        if not 0 <= weight < math.inf:
            yield ("cost.control_rates", f"the weight of {name} is {weight:g}", "give one that is not negative")
    for i, limits in enumerate(problem.bounds.rates):
        if i in given and limits != (-math.inf, math.inf):
            finding = f"input {i} is given by an expression, and has no rate"
            yield (f"bounds.rates[{i}]", finding, "bound the rate of a state in its expression")
    for i, delay in enumerate(problem.delays):
        size = m if delay.kind == "input" else len(controls)
        if not 0 <= delay.index < size or (delay.kind == "input" and delay.index in given):
            remedy = "name an input that no expression gives, or a control"
            yield (f"delays[{i}].index", f"found {delay.kind} {delay.index}", remedy)
            continue
        ranges = problem.bounds.u if delay.kind == "input" else [control.bounds for control in problem.controls]
        lower, upper = ranges[delay.index] if delay.index < len(ranges) else (-math.inf, math.inf)
        if delay.history is not None and not lower <= delay.history <= upper:
            finding = f"{delay.history:g} is out of [{lower:g}, {upper:g}]"
            yield (f"delays[{i}].history", finding, "give a history within the bounds, or None")


def _find_unknown_frames(problem: Problem, manifest: Manifest) -> Iterator[Line]:
    frames = [frame.name for frame in manifest.frames]
    sensors = [frame.name for frame in manifest.frames if frame.sensor]
    for place, kind, wanted, known in (
        ("end.sensors", "sensor", [name for name, _ in problem.end.sensors], sensors),
        ("end.sensor_velocities", "sensor", [name for name, _ in problem.end.sensor_velocities], sensors),
        ("end.orientations", "sensor", [name for name, _ in problem.end.orientations], sensors),
        ("guess.upright", "frame", problem.guess.upright, frames),
    ):
        for name in wanted:
            if name not in known:
                yield (place, f"the model has no {kind} {abbreviate(name)}", f"there are {', '.join(known) or 'none'}")


def list_expressions(problem: Problem) -> Iterator[tuple[str, tuple[str, ...]]]:
    """List the expressions of the motion, by the part of the problem that they are in."""
    cost = problem.cost
    yield "cost.running", tuple(term.expression for term in cost.running)
    yield "cost.terminal", tuple(term.expression for term in cost.terminal)
    yield "constraints", tuple(constraint.expression for constraint in problem.constraints)
    yield "states", tuple(state.rate for state in problem.states)
    yield "integrals", tuple(part.expression for part in problem.integrals)
    yield "forces", tuple(part.expression for part in problem.forces)
    yield "wrenches", tuple(part.expression or "0" for part in problem.wrenches)


def _find_wrong_wrenches(problem: Problem, manifest: Manifest) -> Iterator[Line]:
    """Find inputs and components of wrenches that the model has not, that are given twice, or not at all."""
    m = len(manifest.actuated)
    inputs = [force.input for force in problem.forces]
    for i, index in enumerate(inputs):
        if not 0 <= index < m:
            yield (f"forces[{i}].input", f"found index {index}", f"give one from 0 to {m - 1}")
        elif index in inputs[:i]:
            yield (f"forces[{i}].input", f"input {index} is given twice", "give it once")
    components = [(part.wrench, part.component) for part in problem.wrenches]
    for i, (part, named) in enumerate(zip(problem.wrenches, components, strict=True)):
        if find_component(manifest, *named) is None:
            finding = f"the model has no open component {part.component} of {abbreviate(part.wrench)}"
            yield (f"wrenches[{i}]", finding, "name a wrench that is an input, and 0 to 2 of its force, 3 to 5 moment")
        elif named in components[:i]:
            yield (f"wrenches[{i}]", "the component is given twice", "give it once")
        lower, upper = part.bounds
        if not lower <= upper:
            yield (f"wrenches[{i}].bounds", f"found [{lower:g}, {upper:g}]", "give bounds that leave room")
    if left := list_open_components(problem, manifest):
        finding = f"the model leaves {', '.join(left)} open"
        yield ("wrenches", finding, "give each an expression, or let it be an unknown")


def _find_wrong_additions(problem: Problem, manifest: Manifest) -> Iterator[Line]:
    """Find states and controls with names that are taken, or numbers that do not fit each other."""
    taken = {*list_quantities(manifest, Added()), *(name for name, _ in problem.constants)}
    named: list[tuple[str, State | Control | Unknown]] = [
        (f"states[{i}]", state) for i, state in enumerate(problem.states)
    ]
    named += [(f"controls[{i}]", control) for i, control in enumerate(problem.controls)]
    named += [(f"unknowns[{i}]", unknown) for i, unknown in enumerate(problem.unknowns)]
    for place, part in named:
        if not is_free_name(part.name) or part.name in taken:
            yield (f"{place}.name", f"found {abbreviate(part.name)}", "give a name that nothing else has")
        taken.add(part.name)
        guess = part.guess if isinstance(part.guess, tuple) else (0.0 if part.guess is None else part.guess,)
        if not all(map(math.isfinite, guess)):
            yield (f"{place}.guess", f"found {part.guess}", "give finite numbers")
    for i, state in enumerate(problem.states):
        for place, (lower, upper) in (("start", state.start), ("end", state.end)):
            if not (lower <= upper and lower <= state.bounds[1] and upper >= state.bounds[0]):
                finding = f"[{lower:g}, {upper:g}] leaves nothing within [{state.bounds[0]:g}, {state.bounds[1]:g}]"
                yield (f"states[{i}].{place}", finding, "give limits that leave room")


def _find_wrong_expressions(problem: Problem, manifest: Manifest) -> Iterator[Line]:
    motion = {*list_quantities(manifest, problem.added), *(name for name, _ in problem.constants)}
    motion |= set(references.list_names(problem.references))
    yield from _find_wrong_functions(problem, motion)
    known = motion | {function.name for function in problem.functions}
    for place, texts in list_expressions(problem):
        for i, text in enumerate(texts):
            own = f"{place}[{i}].{'rate' if place == 'states' else 'expression'}"
            try:
                unknown = sorted(names(parse(text)) - known)
            except ExpressionError as error:
                yield (own, error.finding, error.remedy)
                continue
            for name in unknown:
                yield (own, f"unknown name {abbreviate(name)}", "there are t, T, q_NAME, u_NAME, x_SENSOR, constants")


def _find_wrong_functions(problem: Problem, known: Set[str]) -> Iterator[Line]:
    """Find functions in CasADi that read unknown names or have no code, and methods that cannot call them."""
    named = [function.name for function in problem.functions]
    for i, function in enumerate(problem.functions):
        if function.name in known or named.count(function.name) > 1 or not is_free_name(function.name):
            yield (f"functions[{i}].name", f"found {abbreviate(function.name)}", "give a name that nothing else has")
        for name in sorted(set(function.reads) - known):
            yield (f"functions[{i}].reads", f"unknown name {abbreviate(name)}", "take symbols of `quantities()`")
        if not function.code:
            finding = f"{abbreviate(function.name)} has no code, which files do not hold"
            yield (f"functions[{i}].code", finding, "make the problem anew, with its expressions")
    method = choose_method(problem.solver, calls_casadi=True)
    if problem.functions and not METHODS[method].calls_casadi:
        finding = f"{method} writes a problem in C, and an expression of CasADi has no C here"
        yield ("solver.method", finding, "take ipopt, or write the expression as text")


def _find_divided_quaternions(problem: Problem, manifest: Manifest) -> Iterator[Line]:
    for quaternion in list_quaternions(manifest):
        for key, named in (("free_start", problem.free_start), ("end.coordinates", dict(problem.end.coordinates))):
            if 0 < len([i for i in quaternion.entries if i in named]) < 4:
                yield (key, f"a part of the quaternion of {quaternion.joint}", "name all four entries")
