"""The schema of problem files: every key with its type, default and an example."""

from __future__ import annotations

from collections.abc import Collection, Sized
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, Discriminator, Field, Tag

from mbsgen.documents import (
    Read,
    Section,
    WrongValueError,
    abbreviate,
    read_number,
)
from mbsgen.expressions import Expression, Number
from mbsrun.metabolics import USUAL, Metabolism
from mbsrun.ocp.ground.integrators import INTEGRATORS
from mbsrun.ocp.ground.schemes import DEGREES, Family
from mbsrun.ocp.methods import METHODS
from mbsrun.ocp.problem.problem import (
    Form,
    GuessedMotion,
    Loops,
    Problem,
    Refinement,
    Representation,
    SolverOptions,
)
from mbsrun.ocp.statement.checks import MAX_INTERVALS, MAX_ROUNDS, MAX_STEPS, MAX_THREADS
from mbsrun.recordings import READERS, Treatment

SOLUTION = ".json"
GUESSES = (SOLUTION, ".csv", ".mot", ".sto")  # files
MAX_EXPRESSIONS = 100  # of one kind

T = TypeVar("T", bound=Sized)


def is_solution(path: Path) -> bool:
    """Return whether a guess's file is named as a solution, not as a recording."""
    return path.suffix.lower() == SOLUTION


def _read_formula(value: Any) -> str:
    """Admit an expression, and keep its text."""
    read_number(value)
    return str(value)


def _check_count(sections: T) -> T:
    if len(sections) > MAX_EXPRESSIONS:
        raise WrongValueError(f"found {len(sections)} of them", f"give at most {MAX_EXPRESSIONS}")
    return sections


def _check_model(path: str) -> str:
    """Admit model files only: a folder of C would be code to run, and a problem file comes from anywhere."""
    if not path.endswith((".yaml", ".yml")):
        raise WrongValueError(f"found {abbreviate(path)}", "give a model file (.yaml), from this file's folder")
    return path


def _check_integrator(name: str) -> str:
    return _check_name(name, INTEGRATORS)


def _check_solver(name: str) -> str:
    return _check_name(name, METHODS)


def _check_name(name: str, known: Collection[str]) -> str:
    """Admit the keys of a registry."""
    if name not in known:
        raise WrongValueError(f"found {abbreviate(name)}", f"give one of {', '.join(known)}")
    return name


def _check_solution(path: str) -> str:
    if not path.lower().endswith(GUESSES):
        remedy = f"give a solution or a recorded motion ({', '.join(GUESSES)}), from this file's folder"
        raise WrongValueError(f"found {abbreviate(path)}", remedy)
    return path


def _check_recording(path: str) -> str:
    if Path(path).suffix.lower() not in READERS:
        finding = f"found {abbreviate(path)}"
        raise WrongValueError(finding, f"give a recording ({', '.join(READERS)}), from this file's folder")
    return path


def _form(value: Any) -> str:
    """Return the form of a value."""
    return "mapping" if isinstance(value, dict) else "list"


def _check_lengths(lengths: tuple[Expression, ...]) -> tuple[Expression, ...]:
    if not 1 <= len(lengths) <= MAX_INTERVALS:
        raise WrongValueError(
            f"found {len(lengths)} lengths", f"give from 1 to {MAX_INTERVALS}, or a number of intervals"
        )
    return lengths


def _form_of_end(value: Any) -> str:
    return "list" if isinstance(value, list | tuple) else "number"


Written = float | str  # a number, or an expression
NumberField = Annotated[Expression, Read(read_number, Written), Field(examples=[1.0])]
LimitField = Annotated[
    Expression | None,
    Read(lambda v: None if v is None else read_number(v), Written | None),
]
TripleField = tuple[NumberField, NumberField, NumberField]
RangeField = tuple[LimitField, LimitField]  # null: no bound
StartField = Annotated[  # one for each coordinate, or by name; null: not given
    Annotated[tuple[LimitField, ...], Tag("list")] | Annotated[dict[str, LimitField], Tag("mapping")],
    Discriminator(_form),
]
RestField = Annotated[  # of all coordinates, or of some, by name; null: not given
    Annotated[Literal["zero"], Tag("list")] | Annotated[dict[str, LimitField], Tag("mapping")], Discriminator(_form)
]
NamesField = Annotated[  # of some, or by name
    Annotated[tuple[str, ...], Tag("list")] | Annotated[dict[str, str], Tag("mapping")], Discriminator(_form)
]
FormulaField = Annotated[str, Read(_read_formula, Written), Field(examples=["q_NAME**2"])]
RangesField = Annotated[  # the same for all, or by name
    Annotated[RangeField, Tag("list")] | Annotated[dict[str, RangeField], Tag("mapping")], Discriminator(_form)
]
Limits = tuple[Expression | None, Expression | None]
EndField = Annotated[  # a number, limits of one, or none
    Annotated[LimitField, Tag("number")] | Annotated[RangeField, Tag("list")], Discriminator(_form_of_end)
]
StraightField = Annotated[  # a number, or two between which it goes straight
    Annotated[LimitField, Tag("number")] | Annotated[tuple[NumberField, NumberField], Tag("list")],
    Discriminator(_form_of_end),
]


class HorizonSection(Section):
    """A free horizon: its guess and its range."""

    guess: NumberField = Field(examples=[1.0])
    range: RangeField = Field(examples=[[0.1, 10.0]])


HorizonField = Annotated[
    Annotated[NumberField, Tag("number")] | Annotated[HorizonSection, Tag("mapping")],
    Discriminator(lambda value: "mapping" if isinstance(value, dict | list) else "number"),
]


IntervalsField = Annotated[  # their number, where they are equal; or the length of each, relative to the others
    Annotated[int, Field(ge=1, le=MAX_INTERVALS), Tag("number")]
    | Annotated[tuple[NumberField, ...], AfterValidator(_check_lengths), Tag("list")],
    Discriminator(lambda value: "list" if isinstance(value, list | tuple) else "number"),
]


class TermSection(Section):
    """A term of the cost."""

    expression: FormulaField
    weight: NumberField = Field(default=Number(1.0), examples=[1.0])


class TrackSection(Section):
    """Terms of the cost: squared distances from a reference."""

    reference: str = Field(examples=["NAME"])
    coordinates: NamesField = Field(default=(), examples=[[]])  # or by name: the column
    markers: NamesField = Field(default=(), examples=[[]])  # sensors; or by name: the marker
    weight: NumberField = Field(default=Number(1.0), examples=[1.0])
    weights: dict[str, NumberField] = Field(default={}, examples=[{}])  # times these, by name


class ReferenceSection(Section):
    """A recorded motion as functions of the time."""

    file: Annotated[str, AfterValidator(_check_recording)] = Field(examples=["walk.csv"])
    columns: dict[str, str] = Field(default={}, examples=[{}])  # by their names in expressions
    time: Literal["seconds", "normalised"] = Field(default="seconds", examples=["seconds"])
    start: NumberField | None = Field(default=None, examples=[0.0])  # of the recording; by default its first time
    end: NumberField | None = Field(default=None, examples=[1.0])
    degree: Literal[3, 5] = Field(default=5, examples=[5])
    noise: NumberField | None = Field(default=None, examples=[1e-3])
    gap: NumberField = Field(default=Number(Treatment.gap), examples=[0.1])
    cutoff: NumberField | None = Field(default=None, examples=[6.0])


class LargestSection(Section):
    """The largest value of an expression along the path, as a term of the cost."""

    expression: FormulaField
    weight: NumberField = Field(default=Number(1.0), examples=[1.0])
    absolute: bool = Field(default=False, examples=[False])  # of the expression's absolute value
    name: str | None = Field(default=None, examples=["peak"])  # which expressions read


class CostSection(Section):
    """The cost."""

    inputs: NumberField | None = Field(default=None, examples=[1.0])  # 1 where nothing else is paid for
    input_rates: NumberField = Field(default=Number(0.0), examples=[0.0])
    running: Annotated[tuple[TermSection, ...], AfterValidator(_check_count)] = Field(default=(), examples=[[]])
    terminal: Annotated[tuple[TermSection, ...], AfterValidator(_check_count)] = Field(default=(), examples=[[]])
    track: Annotated[tuple[TrackSection, ...], AfterValidator(_check_count)] = Field(default=(), examples=[[]])
    largest: Annotated[tuple[LargestSection, ...], AfterValidator(_check_count)] = Field(default=(), examples=[[]])


class SoftSection(Section):
    """The price of violating a constraint."""

    linear: NumberField = Field(default=Number(0.0), examples=[100.0])
    quadratic: NumberField = Field(default=Number(0.0), examples=[0.0])
    name: str | None = Field(default=None, examples=["slack"])  # which expressions read


SoftField = Annotated[  # the linear price, or both
    Annotated[NumberField, Tag("list")] | Annotated[SoftSection, Tag("mapping")], Discriminator(_form)
]


class ConstraintSection(Section):
    """A constraint by an expression."""

    expression: FormulaField
    range: RangeField = Field(examples=[[None, 1.0]])
    at: Literal["start", "path", "end"] = Field(default="path", examples=["path"])
    soft: SoftField | None = Field(default=None, examples=[100.0])


class StartSection(Section):
    """The start; null where it is free."""

    pose: StartField = Field(examples=[{}])
    velocity: StartField = Field(default={}, examples=[{}])


class BoundsSection(Section):
    """Bounds at all times."""

    coordinates: dict[str, RangeField] = Field(default={}, examples=[{}])  # others keep the limits of the model
    velocities: RangesField = Field(default={}, examples=[[-10.0, 10.0]])  # the same, by name or of all
    inputs: RangesField = Field(default={}, examples=[[-10.0, 10.0]])
    input_rates: RangesField = Field(default={}, examples=[[-10.0, 10.0]])
    tau: RangesField = Field(default={}, examples=[[-10.0, 10.0]])  # forces of driven joints


class PositionSection(Section):
    """A position, Cartesian or cylindrical; of Cartesian ones, axes without a number are free."""

    x: NumberField | None = Field(default=None, examples=[1.0])  # some of these
    y: NumberField | None = Field(default=None, examples=[1.0])
    z: NumberField | None = Field(default=None, examples=[1.0])
    radius: NumberField | None = Field(default=None, examples=[1.0])  # or these
    azimuth: NumberField | None = Field(default=None, examples=[1.0])
    height: NumberField | None = Field(default=None, examples=[1.0])


class VelocitySection(Section):
    """A velocity in the base frame."""

    x: NumberField = Field(default=Number(0.0), examples=[0.0])
    y: NumberField = Field(default=Number(0.0), examples=[0.0])
    z: NumberField = Field(default=Number(0.0), examples=[0.0])


class OrientationSection(Section):
    """The orientation of a frame: whole, or the direction of an axis."""

    rpy: TripleField | None = Field(default=None, examples=[[0.0, 0.5, 0.0]])  # about x, then y, then z of the base
    quaternion: tuple[NumberField, NumberField, NumberField, NumberField] | None = Field(
        default=None, examples=[[0.0, 0.0, 0.0, 1.0]]
    )  # its scalar last
    x: TripleField | None = Field(default=None, examples=[[1.0, 0.0, 0.0]])  # of one axis, or of two
    y: TripleField | None = Field(default=None, examples=[[0.0, 1.0, 0.0]])
    z: TripleField | None = Field(default=None, examples=[[0.0, 0.0, -1.0]])


class EndSection(Section):
    """The conditions at the end; null where it is free."""

    sensors: dict[str, PositionSection] = Field(default={}, examples=[{}])
    orientations: dict[str, OrientationSection] = Field(default={}, examples=[{}])
    pose: StartField | None = Field(default=None, examples=[{}])
    velocity: RestField | None = Field(default=None, examples=["zero"])
    acceleration: RestField | None = Field(default=None, examples=["zero"])
    sensor_velocities: dict[str, VelocitySection] = Field(default={}, examples=[{}])


class GuessSection(Section):
    """How to guess."""

    upright: tuple[str, ...] = Field(default=(), examples=[[]])
    motion: GuessedMotion = Field(default="interpolation", examples=["interpolation"])
    inputs: Literal["zero", "static", "dynamic"] = Field(default="dynamic", examples=["dynamic"])
    solution: Annotated[str, AfterValidator(_check_solution)] | None = Field(default=None, examples=["solution.json"])
    times: RangeField = Field(default=(None, None), examples=[[0.0, 1.0]])
    start: dict[str, NumberField] = Field(default={}, examples=[{}])
    end: dict[str, NumberField] = Field(default={}, examples=[{}])


class RefinementSection(Section):
    """Solves on finer grids until the re-simulation confirms an accuracy."""

    accuracy: NumberField | None = Field(default=None, examples=[1e-6])  # by default the problem's
    rounds: int = Field(default=Refinement.rounds, ge=1, le=MAX_ROUNDS, examples=[8])


class SolverSection(Section):
    """The NLP method and its options."""

    tolerance: NumberField = Field(default=Number(SolverOptions.tolerance), examples=[1e-8])
    max_iterations: int = Field(default=SolverOptions.max_iterations, ge=1, examples=[500])
    objective_scaling: NumberField | None = Field(default=None, examples=[1.0])
    method: Annotated[str, AfterValidator(_check_solver)] | None = Field(default=None, examples=["ipopt"])
    options: dict[str, bool | int | float | str] = Field(default={}, examples=[{}])
    threads: int = Field(default=SolverOptions.threads, ge=1, le=MAX_THREADS, examples=[2])
    fallback: bool | None = Field(default=None, examples=[False])


class UnknownSection(Section):
    """A number that the solver chooses."""

    guess: NumberField = Field(examples=[1.0])
    range: RangeField = Field(default=(None, None), examples=[[0.1, 10.0]])


class StateSection(Section):
    """A state beside the mechanism's."""

    rate: FormulaField
    start: EndField = Field(default=None, examples=[0.0])  # left out only where a link gives it
    end: EndField = Field(default=None, examples=[[None, 1.0]])
    range: RangeField = Field(default=(None, None), examples=[[0.0, 2.0]])
    guess: StraightField = Field(default=None, examples=[0.5])


class RateSection(Section):
    """The rate of a control: its bounds and its price."""

    range: RangeField = Field(default=(None, None), examples=[[-1.0, 1.0]])
    weight: NumberField = Field(default=Number(0.0), examples=[0.0])


HistoryField = Annotated[  # a number, or free, or of the phase before
    Annotated[Literal["free", "link"], Tag("text")] | Annotated[NumberField, Tag("number")],
    Discriminator(lambda value: "text" if value in ("free", "link") else "number"),
]


class ControlSection(Section):
    """An input beside the mechanism's."""

    range: RangeField = Field(default=(None, None), examples=[[0.0, 1.0]])
    guess: NumberField = Field(default=Number(0.0), examples=[0.1])
    rate: RateSection | None = Field(default=None, examples=[{"range": [-1.0, 1.0]}])
    delay: NumberField | None = Field(default=None, examples=[0.1])
    history: HistoryField | None = Field(default=None, examples=[0.0])  # what it was before the start; by default 0


CourseField = Literal["constant", "linear", "polynomial"]
DelayField = Annotated[  # of all inputs, or by name
    Annotated[NumberField, Tag("list")] | Annotated[dict[str, NumberField], Tag("mapping")], Discriminator(_form)
]
HistoriesField = Annotated[
    Annotated[HistoryField, Tag("list")] | Annotated[dict[str, HistoryField], Tag("mapping")], Discriminator(_form)
]


class InputsSection(Section):
    """The course of inputs over an interval, and their delays."""

    course: CourseField = Field(default="constant", examples=["polynomial"])
    delay: DelayField | None = Field(default=None, examples=[0.1])
    history: HistoriesField | None = Field(default=None, examples=[0.0])


InputsField = Annotated[
    Annotated[CourseField, Tag("list")] | Annotated[InputsSection, Tag("mapping")], Discriminator(_form)
]


class UnknownForceSection(Section):
    """A component of a wrench that is unknown at every point."""

    range: RangeField = Field(default=(None, None), examples=[[0.0, None]])
    guess: NumberField = Field(default=Number(0.0), examples=[1.0])


ComponentField = Annotated[  # an expression, or an unknown
    Annotated[FormulaField, Tag("list")] | Annotated[UnknownForceSection, Tag("mapping")], Discriminator(_form)
]


class WrenchSection(Section):
    """A wrench that the model leaves open: along x, y, z of the frame that the model gives."""

    force: tuple[ComponentField, ComponentField, ComponentField] | None = Field(default=None, examples=[[0, 0, 1]])
    moment: tuple[ComponentField, ComponentField, ComponentField] | None = Field(default=None, examples=[[0, 0, 1]])


def check_axes(axes: str) -> str:
    """Admit some of the axes x, y, z."""
    if not axes or sorted(set(axes)) != sorted(axes) or set(axes) - set("xyz"):
        raise WrongValueError(f"found {abbreviate(axes)}", "give some of x, y, z, such as xz")
    return axes


class ContactSection(Section):
    """A point that stands on the ground."""

    sensor: str = Field(examples=["foot"])
    wrench: str | None = Field(default=None, examples=["foot"])  # by default of the sensor's name
    axes: Annotated[str, AfterValidator(check_axes)] = Field(default="xyz", examples=["xz"])
    normal: Literal["x", "y", "z"] | None = Field(default="z", examples=["z"])
    friction: NumberField | None = Field(default=None, examples=[0.8])
    mode: Literal["stand", "complementarity"] = Field(default="stand", examples=["complementarity"])
    height: NumberField | None = Field(default=None, examples=[0.0])


class RelaxationSection(Section):
    """The steps in which complementarity is approached."""

    first: NumberField | None = Field(default=None, examples=[1.0])
    last: NumberField | None = Field(default=None, examples=[1e-6])
    factor: NumberField | None = Field(default=None, examples=[0.1])


class IntegralSection(Section):
    """An integral over the horizon that stays within a range."""

    expression: FormulaField
    range: RangeField = Field(examples=[[None, 1.0]])


class MetabolicsSection(Section):
    """The metabolic rates of all muscles, as a term of the cost each."""

    weight: NumberField = Field(default=Number(1.0), examples=[0.001])
    slow: NumberField = Field(default=USUAL.slow, examples=[0.5])
    specific_tension: NumberField = Field(default=USUAL.specific_tension, examples=[0.25e6])
    density: NumberField = Field(default=USUAL.density, examples=[1059.7])
    force_dependent: bool = Field(default=USUAL.force_dependent, examples=[True])
    velocity_smoothing: NumberField = Field(default=USUAL.velocity_smoothing, examples=[10.0])
    power_smoothing: NumberField = Field(default=USUAL.power_smoothing, examples=[10.0])
    heat_smoothing: NumberField = Field(default=USUAL.heat_smoothing, examples=[10.0])

    @property
    def metabolism(self) -> Metabolism:
        """The numbers of the rates."""
        return Metabolism(**{x.name: getattr(self, x.name) for x in fields(Metabolism)})


class LagSection(Section):
    """The activation dynamics of one muscle."""

    rise: NumberField | None = Field(default=None, examples=[0.01])  # s; without, its activation is its excitation
    fall: NumberField | None = Field(default=None, examples=[0.04])
    sharp: bool = Field(default=False, examples=[True])


class MusclesSection(Section):
    """Excitations of all muscles of the model, as controls."""

    excitation: RangeField = Field(default=(Number(0.01), Number(1.0)), examples=[[0.01, 1.0]])
    rise: NumberField | None = Field(default=None, examples=[0.015])  # of activations, s; without, they are excitations
    fall: NumberField | None = Field(default=None, examples=[0.06])
    sharp: bool = Field(default=False, examples=[True])  # rise and fall change where an activation is its excitation
    own: dict[str, LagSection] = Field(default={}, examples=[{}])  # in place of the three numbers above, by muscle
    effort: NumberField = Field(default=Number(1.0), examples=[1.0])  # weight of the squares of excitations
    metabolics: MetabolicsSection | None = Field(default=None, examples=[None])
    start: EndField = Field(default=None, examples=[0.05])  # of activations
    guess: NumberField = Field(default=Number(0.2), examples=[0.2])


class ProblemSection(Section):
    """A problem file."""

    # Sections that are left out are constructed: a call would build their validators now, and again in this section's.

    model: Annotated[str, AfterValidator(_check_model)] | None = Field(default=None, examples=["model.yaml"])
    constants: dict[str, NumberField] = Field(default={}, examples=[{}])
    references: dict[str, ReferenceSection] = Field(default={}, examples=[{}])
    parameters: dict[str, NumberField] = Field(default={}, examples=[{}])
    unknowns: dict[str, UnknownSection] = Field(default={}, examples=[{}])
    horizon: HorizonField = Field(examples=[1.0])
    intervals: IntervalsField = Field(default=50, examples=[100])
    scheme: Family = Field(default=Family.RADAU, examples=["radau"])
    degree: int = Field(default=4, ge=DEGREES[0], le=DEGREES[-1], examples=[4])
    representation: Representation = Field(default=Problem.representation, examples=["IMPL"])
    loops: Loops | None = Field(default=Problem.loops, examples=["reduced"])
    form: Form = Field(default=Problem.form, examples=["standard"])
    integrator: Annotated[str, AfterValidator(_check_integrator)] = Field(default=Problem.integrator, examples=["rk4"])
    steps: int = Field(default=Problem.steps, ge=1, le=MAX_STEPS, examples=[1])
    states: Annotated[dict[str, StateSection], AfterValidator(_check_count)] = Field(default={}, examples=[{}])
    controls: Annotated[dict[str, ControlSection], AfterValidator(_check_count)] = Field(default={}, examples=[{}])
    inputs: InputsField = Field(default=Problem.inputs, examples=["polynomial"])
    forces: Annotated[dict[str, FormulaField], AfterValidator(_check_count)] = Field(default={}, examples=[{}])
    relaxation: RelaxationSection | None = Field(default=None, examples=[{"first": 1.0, "last": 1e-6}])
    contacts: Annotated[tuple[ContactSection, ...], AfterValidator(_check_count)] = Field(default=(), examples=[[]])
    modes: Annotated[dict[str, str], AfterValidator(_check_count)] | None = Field(
        default=None, examples=[{"foot": "stick"}]
    )  # of rigid stops, dry friction and rigid contacts
    wrenches: Annotated[dict[str, WrenchSection], AfterValidator(_check_count)] = Field(default={}, examples=[{}])
    muscles: MusclesSection | None = Field(default=None, examples=[None])
    signals: Annotated[dict[str, ComponentField], AfterValidator(_check_count)] = Field(default={}, examples=[{}])
    driven: Annotated[dict[str, FormulaField], AfterValidator(_check_count)] = Field(default={}, examples=[{}])
    cost: CostSection = Field(examples=[{"inputs": 1.0}])
    start: StartSection | None = Field(default=None, examples=[{"pose": {}}])
    bounds: BoundsSection = Field(default=BoundsSection.model_construct(), examples=[{}])
    end: EndSection = Field(default=EndSection.model_construct(), examples=[{}])
    constraints: Annotated[tuple[ConstraintSection, ...], AfterValidator(_check_count)] = Field(
        default=(), examples=[[]]
    )
    integrals: Annotated[tuple[IntegralSection, ...], AfterValidator(_check_count)] = Field(default=(), examples=[[]])
    guess: GuessSection = Field(default=GuessSection.model_construct(), examples=[{}])
    accuracy: NumberField = Field(default=Number(Problem.accuracy), examples=[1e-6])
    refine: RefinementSection | None = Field(default=None, examples=[{"accuracy": 1e-6}])
    solver: SolverSection = Field(default=SolverSection.model_construct(), examples=[{}])
