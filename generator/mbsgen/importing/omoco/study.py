"""A MocoStudy of one phase -> its model, and the parts of a problem: bounds, goals, grid.

States of Moco are a coordinate's value and speed, and an activation and a tendon's force of a muscle; controls are
fractions of an actuator's force. Bounds of a variable are the ones given by its name, else by a pattern, else the range
of the coordinate, the bounds of all speeds, or the least and largest control. A bound of the whole motion also holds at
its start and its end.

Hermite and Simpson's transcription is collocation at Lobatto's three points with linear controls, the trapezoidal one
at two; running goals are summed at these points, as in Moco.

Source: OpenSim's documentation of Moco's classes and their defaults, and files that OpenSim 4.6 wrote.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from mbsgen.documents import abbreviate, nearest
from mbsgen.expressions import spell
from mbsgen.importing.choices import Choices, FileCoordinate, Imported
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element, read_markup
from mbsgen.importing.osim.muscles import MUSCLES, spell_signal
from mbsgen.importing.osim.reading import read_osim

Range = tuple[float | None, float | None]
FREE: Range = (None, None)
SPEEDS: Range = (-50.0, 50.0)  # rad/s or m/s, of all coordinates, unless the phase gives others
INTERVALS = 100
TOLERANCE = 1e-8
_LEAST = {"Millard2012EquilibriumMuscle": 0.01, "Thelen2003Muscle": 0.01}  # excitations; of others 0
_ACTUATORS = ("CoordinateActuator", "ActivationCoordinateActuator")
_LAGS = {"Millard2012EquilibriumMuscle": (0.01, 0.04), "Thelen2003Muscle": (0.015, 0.05)}  # s, without numbers
_USUAL_LAGS = 0.015, 0.06
_RIGID, _DEGROOTE = "ModOpIgnoreTendonCompliance", "ModOpReplaceMusclesWithDeGrooteFregly2016"
_SCHEMES = {"trapezoidal": ("lobatto", 2), "hermite-simpson": ("lobatto", 3)}
_POINTS = re.compile(r"legendre-gauss(-radau)?-([1-9])")
_PATTERN = re.compile(r"([\w/.|\-\[\]^\\]|\.[*+]|\((?:[\w/|\-]*)\))*")  # no repeated groups, which may take for ever
_REPEATS = 4
_IDLE = {  # of no meaning for the solution, or for a solver of another kind
    "MocoPhase": ("bound_activation_from_excitation", "kinematic_constraint_bounds", "multiplier_bounds"),
    "MocoStudy": ("write_solution", "results_directory"),
    "solver": (
        "verbosity",
        "optim_solver",
        "optim_hessian_approximation",
        "optim_ipopt_print_level",
        "optim_constraint_tolerance",
        "optim_sparsity_detection",
        "optim_write_sparsity",
        "optim_finite_difference_scheme",
        "parallel",
        "output_interval",
        "scale_variables_using_bounds",
        "parameters_require_initsystem",
        "multibody_dynamics_mode",
        "implicit_multibody_acceleration_bounds",
        "implicit_auxiliary_derivative_bounds",
        "enforce_constraint_derivatives",
        "kinematic_constraint_method",
        "velocity_correction_bounds",
        "projection_slack_variable_bounds",
        "state_projection_distance_weight",
        "minimize_state_projection_distance",
        "lagrange_multiplier_weight",
        "implicit_multibody_accelerations_weight",
        "implicit_auxiliary_derivatives_weight",
        "enforce_path_constraint_mesh_interior_points",
    ),
}
_SOLVER = (
    "num_mesh_intervals",
    "mesh",
    "transcription_scheme",
    "interpolate_control_mesh_interior_points",
    "optim_max_iterations",
    "optim_convergence_tolerance",
)
_PHASE = (
    "model",
    "time_initial_bounds",
    "time_final_bounds",
    "default_speed_bounds",
    "state_infos",
    "state_infos_pattern",
    "control_infos",
    "control_infos_pattern",
    "goals",
)


@dataclass(frozen=True)
class Limits:
    """Bounds of a variable: along the motion, at its start and at its end."""

    whole: Range = FREE
    start: Range = FREE
    end: Range = FREE


@dataclass(frozen=True)
class Variable:
    """A state or a control of Moco, as an affine function of a number of the problem: slope name + offset."""

    path: str
    name: str  # in expressions: q_hip
    kind: str  # value, speed, activation, tendon, control, excitation
    own: str  # the joint or the signal
    slope: float = 1.0
    offset: float = 0.0
    limits: Limits = field(default_factory=Limits)
    origin: Element | None = None  # that has given its bounds

    @property
    def text(self) -> str:
        """Write it over the number of the problem."""
        scaled = self.name if self.slope == 1 else f"{self.slope!r}*{self.name}"
        return scaled if self.offset == 0 else f"{scaled} + {self.offset!r}"

    def invert(self, bounds: Range) -> Range:
        """Return bounds of the number of the problem."""
        values = [None if x is None else (x - self.offset) / self.slope for x in bounds]
        low, high = values if self.slope > 0 else values[::-1]
        return low, high


@dataclass(frozen=True)
class Lag:
    """The activation dynamics of a muscle."""

    rise: float
    fall: float
    sharp: bool = False  # the time changes where the activation is the excitation


@dataclass(frozen=True)
class Grid:
    """The times of a problem, and its points."""

    duration: Range
    start: float = 0.0
    intervals: tuple[float, ...] | int = INTERVALS
    scheme: str = "lobatto"
    degree: int = 3
    inputs: str = "linear"
    tolerance: float = TOLERANCE
    iterations: int | None = None


@dataclass(frozen=True)
class Study:
    """A study without its goals."""

    name: str
    imported: Imported
    grid: Grid
    variables: Mapping[str, Variable]  # by path
    goals: tuple[Element, ...]
    lags: Mapping[str, Lag | None]  # of muscles, by the signals of their activations; None: none
    folder: Path
    unread: Mapping[str, str]  # variables without a counterpart by their paths, or muscles that are left out: why

    def find_reason(self, path: str) -> str:
        """Return why a variable of the study has no counterpart; "" for one that has."""
        return find_reason(self.unread, path)


def find_reason(unread: Mapping[str, str], path: str) -> str:
    """Return why a variable, or the muscle that has it, has no counterpart; "" for one that has."""
    return next((why for own, why in unread.items() if path == own or path.startswith(f"{own}/")), "")


def read_study(path: Path, choices: Choices, findings: Findings) -> Study:
    """Read a study. Raises InputError with all faults of the file, and of its model."""
    return _File(path, read_markup(path), choices, findings).read()


class _File:
    """A study during reading."""

    def __init__(self, path: Path, root: Element, choices: Choices, findings: Findings) -> None:
        self._path, self._root, self._choices, self._findings = path, root, choices, findings
        self._lags: dict[str, Lag | None] = {}
        self._unread: dict[str, str] = {}

    def read(self) -> Study:
        study = self._root.first("MocoStudy")
        if self._root.tag != "OpenSimDocument" or study is None:
            inner = self._root.children[0].tag if self._root.children else self._root.tag
            self._findings.fault(self._root, f"it holds <{inner[:40]}>, and no <MocoStudy>", "give a study's file")
            raise self._findings.refuse()
        problem = study.first("MocoProblem") or study.first("problem")
        phases = [] if problem is None else [x for x in list_within(problem) if x.tag == "MocoPhase"]
        if len(phases) != 1:
            remedy = "give one: others are problems in phases here"
            self._findings.fault(problem or study, f"it has {len(phases)} phases", remedy)
            raise self._findings.refuse()
        (phase,) = phases
        solver = next((x for x in study.children if x.attributes.get("name") == "solver" or "Solver" in x.tag), None)
        self._name_rest(study, ("MocoProblem", "problem", *((solver.tag,) if solver else ())), _IDLE["MocoStudy"])
        named = [x.tag for x in phase.children if "name" in x.attributes]
        self._name_rest(phase, (*_PHASE, *named), _IDLE["MocoPhase"])
        goals = tuple(list_within(phase.first("goals")))
        root = self._find_model(phase)
        marks = [x.attributes.get("name", "") for x in root.walk() if x.tag == "Marker"]
        imported = read_osim(root, replace(self._choices, sensors=tuple(marks)), Findings(root.file))
        grid = self._read_solver(solver, self._read_duration(phase))
        variables = self._list_variables(root, imported, phase)
        if self._findings.faults:
            raise self._findings.refuse()
        name = study.attributes.get("name", "") or "study"
        return Study(name, imported, grid, variables, goals, self._lags, self._path.parent, self._unread)

    def _name_rest(self, element: Element, read: Sequence[str], idle: Sequence[str]) -> None:
        """Warn of each child that is not read, unless it is empty."""
        for child in element.children:
            if child.tag not in (*read, *idle) and (child.children or child.text not in ("", "false")):
                self._findings.warn(child, "it is not part of the problem: left out")

    # --- the model ---------------------------------------------------------------------------------------------------

    def _find_model(self, phase: Element) -> Element:
        """Find the document of the model, and take the operators that have a counterpart as choices."""
        processor = _find_part(phase, "model", "ModelProcessor")
        if processor is None:
            self._findings.fault(phase, "no model", "give a ModelProcessor with a model, or the file of one")
            raise self._findings.refuse()
        for operator in list_within(processor.first("operators")):
            if operator.tag == _RIGID:
                self._choices = replace(self._choices, rigid_tendons=True)
            elif operator.tag == _DEGROOTE:
                self._choices = replace(self._choices, degroote=True)
            else:
                self._findings.warn(operator, "this change of the model is not made: change the model file")
        held, named = processor.first("model"), processor.first("filepath")
        model = None if held is None else next((x for x in held.children if x.tag == "Model"), None)
        if model is not None:
            root = self._root
            return Element(root.tag, root.attributes, (model,), "", root.file, root.line, root.path)
        text = "" if named is None else named.text
        folder = (self._choices.root or self._path.parent).resolve()
        path = (self._path.parent / text).resolve()
        if not text or not path.is_relative_to(folder):
            finding = f"its model is {abbreviate(text)}, outside its folder" if text else "no model"
            self._findings.fault(named or processor, finding, "name a file in the folder of the study, or --root")
            raise self._findings.refuse()
        return read_markup(self._path.parent / text)

    def _list_variables(self, root: Element, imported: Imported, phase: Element) -> dict[str, Variable]:
        """List states and controls by their paths, with their bounds."""
        model = root.first("Model")
        assert model is not None, "it has been imported"
        found = [*self._list_states(model, imported), *self._list_controls(model, imported)]
        known = {x.path: x for x in found}
        states, controls = ("value", "speed", "activation", "tendon"), ("control", "excitation")
        for kinds, tag in ((states, "state"), (controls, "control")):
            own = [path for path, x in known.items() if x.kind in kinds]
            for info in list_within(phase.first(f"{tag}_infos_pattern")):
                for path in self._match(info, own):
                    known[path] = self._bound(known[path], info)
            for info in list_within(phase.first(f"{tag}_infos")):
                path = info.attributes.get("name", "")
                if path in own:
                    known[path] = self._bound(known[path], info)
                elif reason := find_reason(self._unread, path):
                    self._findings.warn(info, f"{reason}: these bounds are left out")
                else:
                    self._miss(info, path, own)
        given = phase.first("default_speed_bounds")
        default = self._read_range(given)
        for path, x in known.items():
            if x.kind == "speed" and x.limits.whole == FREE:
                whole, origin = (SPEEDS, phase) if default == FREE else (default, given)
                known[path] = replace(x, limits=replace(x.limits, whole=whole), origin=x.origin or origin)
        return known

    def _list_states(self, model: Element, imported: Imported) -> Iterator[Variable]:
        own = {x.name: x for x in imported.coordinates}
        sets = {"JointSet": "jointset", "ComponentSet": "componentset"}
        for owner, path in _walk_components(model, sets):
            if owner.tag != "Coordinate":
                continue
            name = owner.attributes.get("name", "")
            coordinate = own.get(name)
            if coordinate is None or not coordinate.joint:
                continue
            word = _spell(coordinate.joint)
            limits = Limits(self._read_range(owner.first("range")))
            yield Variable(
                f"{path}/value", f"q_{word}", "value", coordinate.joint, coordinate.ratio, coordinate.offset, limits
            )
            yield Variable(f"{path}/speed", f"qd_{word}", "speed", coordinate.joint, coordinate.ratio)

    def _list_controls(self, model: Element, imported: Imported) -> Iterator[Variable]:
        own = {x.name: x for x in imported.coordinates}
        used: dict[str, str] = {}
        for element, path in _walk_components(model, {"ForceSet": "forceset", "ComponentSet": "componentset"}):
            name = element.attributes.get("name", "")
            if element.tag in _ACTUATORS:
                held = element.first("coordinate") or element.first("socket_coordinate")
                coordinate = own.get("" if held is None else held.text.rsplit("/", 1)[-1])
                if coordinate is None or not coordinate.joint:
                    continue
                if coordinate.joint in used:
                    finding = f"a second actuator of {abbreviate(coordinate.joint)}, beside {used[coordinate.joint]}"
                    self._findings.fault(element, finding, "give each coordinate one")
                used[coordinate.joint] = abbreviate(name)
                if element.tag == _ACTUATORS[1]:
                    self._findings.warn(element, "it acts without the lag of its activation")
                yield self._make_control(element, path, coordinate)
            elif element.tag in MUSCLES:
                signal = spell_signal(name)
                if signal not in imported.model.signals:
                    self._unread[path] = "its muscle is not in the model"
                    continue
                self._lags[signal] = lag = self._read_lag(element)
                low = self._bound_of(element, "min_control", _LEAST.get(element.tag, 0.0))
                limits = Limits((low, self._bound_of(element, "max_control", 1.0)))
                excitation = signal if lag is None else f"{signal}_excitation"
                yield Variable(path, excitation, "excitation", signal, limits=limits, origin=element)
                if lag is not None:
                    yield Variable(f"{path}/activation", signal, "activation", signal)
                if f"{signal}_tendon" in imported.model.signals and element.tag in _LAGS and not self._choices.degroote:
                    self._unread[f"{path}/fiber_length"] = "the state here is the strain of the tendon"
                elif f"{signal}_tendon" in imported.model.signals:
                    self._warn_of_damping(element)
                    yield Variable(f"{path}/normalized_tendon_force", f"{signal}_tendon", "tendon", signal)

    def _warn_of_damping(self, element: Element) -> None:
        """Warn of fibre damping that OpenSim leaves out where the dynamics of a tendon is explicit, as by default."""
        is_implicit = find_text(element, "tendon_compliance_dynamics_mode") == "implicit"
        if not is_implicit and self._number(element, "fiber_damping", 0.0):
            finding = "explicit dynamics of its tendon have no fibre damping in OpenSim, but here they have: give 0"
            self._findings.warn(element.first("fiber_damping") or element, finding)

    def _read_lag(self, element: Element) -> Lag | None:
        """Read the activation dynamics of a muscle."""
        if element.tag == "RigidTendonMuscle" or find_text(element, "ignore_activation_dynamics").lower() == "true":
            return None
        own = _LAGS.get(element.tag, _USUAL_LAGS)
        rise, fall = (
            self._number(element, f"{k}activation_time_constant", x) for k, x in zip(("", "de"), own, strict=True)
        )
        if rise <= 0 or fall <= 0:
            self._findings.fault(element, f"time constants of {rise:g} and {fall:g} s", "give more than 0")
        return Lag(rise, fall, element.tag in _LAGS and not self._choices.degroote)

    def _make_control(self, element: Element, path: str, coordinate: FileCoordinate) -> Variable:
        optimal = self._number(element, "optimal_force", 1.0)
        if optimal == 0:
            self._findings.fault(element, "its optimal_force is 0", "give a force, or remove it")
            optimal = 1.0
        limits = Limits((self._bound_of(element, "min_control"), self._bound_of(element, "max_control")))
        slope = 1 / (optimal * coordinate.ratio)
        return Variable(path, f"u_{_spell(coordinate.joint)}", "control", coordinate.joint, slope, limits=limits)

    def _bound(self, variable: Variable, info: Element) -> Variable:
        """Put the bounds of an info in the place of a variable's own."""
        whole, start, end = (self._read_range(info.first(tag)) for tag in ("bounds", "initial_bounds", "final_bounds"))
        limits = Limits(variable.limits.whole if whole == FREE else whole, start, end)
        return replace(variable, limits=limits, origin=info)

    def _match(self, info: Element, paths: Sequence[str]) -> list[str]:
        text = info.attributes.get("name", "")
        found = match_pattern(text, paths)
        if found is None:
            remedy = "name each variable, or use . * + [] and a choice of words in ()"
            self._findings.fault(info, f"the pattern {abbreviate(text)} is not read", remedy)
        elif not found:
            self._findings.tell(info, "it matches no variable of the model")
        return found or []

    def _miss(self, info: Element, path: str, known: Sequence[str]) -> None:
        meant = nearest(path, list(known))
        remedy = f"did you mean {abbreviate(meant)}?" if meant else "give the path of a variable of the model"
        self._findings.fault(info, f"there is no variable {abbreviate(path)}", remedy)

    # --- times and the grid ------------------------------------------------------------------------------------------

    def _read_duration(self, phase: Element) -> tuple[Range, float]:
        first = self._read_range(_find_bounds(phase, "time_initial_bounds", "MocoInitialBounds"))
        last = self._read_range(_find_bounds(phase, "time_final_bounds", "MocoFinalBounds"))
        begin = first[0]
        if begin is None or begin != first[1]:
            self._findings.fault(phase, "the initial time is free", "give one value, such as 0")
            begin = 0.0
        if None in last:
            self._findings.fault(phase, "the final time is unbounded", "give a value, or two")
            return (1.0, 1.0), begin
        low, high = (x - begin for x in last if x is not None)
        if high <= 0 or high < low:
            self._findings.fault(phase, f"the motion lasts from {low:g} to {high:g} s", "let it end after its start")
        return (low, high), begin

    def _read_solver(self, solver: Element | None, times: tuple[Range, float]) -> Grid:
        grid = Grid(*times)
        if solver is None:
            return grid
        self._name_rest(solver, _SOLVER, _IDLE["solver"])
        scheme = find_text(solver, "transcription_scheme") or "hermite-simpson"
        points = _POINTS.fullmatch(scheme)
        if scheme in _SCHEMES:
            name, degree = _SCHEMES[scheme]
        elif points is not None:
            name, degree = "radau" if points[1] else "legendre", int(points[2])
        else:
            schemes = f"{', '.join(_SCHEMES)}, legendre-gauss-3 or legendre-gauss-radau-3"
            self._findings.fault(solver, f"the scheme {abbreviate(scheme)} is not read", f"give {schemes}")
            name, degree = "lobatto", 3
        count = self._number(solver, "num_mesh_intervals", INTERVALS)
        if count != int(count) or count < 1:
            self._findings.fault(solver, f"{count:g} intervals", "give a whole number of 1 or more")
        mesh = [float(x) for x in find_text(solver, "mesh").split() if _is_number(x)]
        intervals: tuple[float, ...] | int = int(count)
        if mesh:
            steps = [b - a for a, b in itertools.pairwise(mesh)]
            if len(mesh) < 2 or min(steps) <= 0:
                self._findings.fault(solver, "its mesh does not increase", "give numbers from 0 to 1, in order")
            intervals = tuple(steps)
        is_linear = find_text(solver, "interpolate_control_mesh_interior_points").lower() != "false"
        tolerance = self._number(solver, "optim_convergence_tolerance", -1.0)
        most = self._number(solver, "optim_max_iterations", -1.0)
        return replace(
            grid,
            intervals=intervals,
            scheme=name,
            degree=degree,
            inputs="linear" if is_linear or scheme == "trapezoidal" else "polynomial",
            tolerance=min(TOLERANCE, tolerance) if tolerance > 0 else TOLERANCE,
            iterations=int(most) if most >= 1 else None,
        )

    def _read_range(self, element: Element | None) -> Range:
        """Read no value, one, or two; infinite ones are no bounds."""
        if element is None:
            return FREE
        words = element.text.split()
        if not words:
            return FREE
        values = [self._findings.bound(element, element.tag, {element.tag: word}) for word in words]
        if len(values) > 2:
            self._findings.fault(element, f"{len(values)} bounds", "give one value, or a lower and an upper one")
            return FREE
        low, high = values[0], values[-1]
        if low is not None and high is not None and low > high:
            self._findings.fault(element, f"bounds from {low:g} to {high:g}", "swap them")
            return FREE
        return low, high

    def _bound_of(self, element: Element, tag: str, default: float | None = None) -> float | None:
        child = element.first(tag)
        return default if child is None else self._findings.bound(child, tag, {tag: child.text})

    def _number(self, element: Element, tag: str, default: float) -> float:
        child = element.first(tag)
        if child is None or not child.text or child.text.lower() in ("inf", "-inf"):
            return default
        return self._findings.number(child, tag, default, {tag: child.text})


def match_pattern(text: str, paths: Sequence[str]) -> list[str] | None:
    """Return the paths that a regular expression matches as a whole; None for one that is not read."""
    if not _PATTERN.fullmatch(text) or len(re.findall(r"[*+]", text)) > _REPEATS or len(text) > 200:
        return None
    try:
        pattern = re.compile(text)
    except re.error:
        return None
    return [path for path in paths if pattern.fullmatch(path)]


def _walk_components(model: Element, sets: Mapping[str, str]) -> Iterator[tuple[Element, str]]:
    """Yield components of a model below some sets, with their paths."""

    def walk(element: Element, path: str) -> Iterator[tuple[Element, str]]:
        for child in element.children:
            name = child.attributes.get("name")
            if child.tag in ("objects", "coordinates", "components", "CoordinateSet"):
                yield from walk(child, path)
            elif name is not None:
                yield child, f"{path}/{name}"
                yield from walk(child, f"{path}/{name}")

    for child in model.children:
        if child.tag in sets:
            yield from walk(child, f"/{child.attributes.get('name', sets[child.tag])}")
        elif child.tag == "components":
            yield from walk(child, "")


def _find_part(element: Element, name: str, tag: str) -> Element | None:
    """Find a part of one object: by its tag, with its name."""
    return next((x for x in element.children if x.attributes.get("name") == name), element.first(tag))


def _find_bounds(phase: Element, name: str, tag: str) -> Element | None:
    part = _find_part(phase, name, tag)
    return None if part is None else part.first("bounds")


def list_within(element: Element | None) -> tuple[Element, ...]:
    """Return the objects of a set, whose element may hold them in another one."""
    if element is None:
        return ()
    held = element.first("objects")
    return held.children if held is not None else element.children


def find_text(element: Element, tag: str) -> str:
    """Return the text of a part, or none."""
    child = element.first(tag)
    return "" if child is None else child.text


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _spell(name: str) -> str:
    (word,) = spell([name])
    assert word is not None, "one word has no other like it"
    return word
