"""Statements of a simulation: a settings file and the options of a command line -> start, inputs and settings.

Numbers may be expressions over the file's `constants`; inputs and wrenches over those, the time t and the state.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from mbsgen.documents import (
    Data,
    Document,
    Place,
    Read,
    Section,
    WrongValueError,
    abbreviate,
    examine,
    expect,
    read_number,
    refuse,
)
from mbsgen.expressions import Expression, Number, is_free_name, names
from mbsgen.manifest import Manifest, Wrench
from mbsrun.ocp.ground.schemes import DEGREES
from mbsrun.quantities import list_quantities
from mbsrun.quaternions import list_quaternions, neutral, normalise
from mbsrun.reading import Reading, attribute, read_settings
from mbsrun.simulation.closing import Start
from mbsrun.simulation.course import Course, find_jump, follow, place_driven
from mbsrun.simulation.drive import STATE, TIME, Drive, express
from mbsrun.simulation.integration.joints import Joints
from mbsrun.simulation.integration.methods import METHODS, Formulation, find_idle, find_refusals, takes_too_many_steps
from mbsrun.simulation.motion import Impacts, Keeping, Latch, Settings

Array = NDArray[np.float64]

MAX_OUTPUTS = 1_000_000  # states kept


@dataclass(frozen=True, eq=False)
class Statement:
    """A simulation to run: n coordinates, m inputs. With loops, the start is yet to be closed: see `closing`."""

    settings: Settings
    start: Start
    drive: Drive
    parameters: Mapping[str, float]  # run-time parameters with other values than the model's
    course: Course  # of driven joints


@dataclass(frozen=True, eq=False)
class Recording:
    """Start, inputs, motions and parameters of another file, which a settings file then need not give."""

    drive: Drive
    q: Array | None = None  # (n,)
    qd: Array | None = None  # (n,)
    parameters: Mapping[str, float] = field(default_factory=dict)
    driven: Mapping[str, Expression] = field(default_factory=dict)  # in the time t, by joint


def read_statement(
    file: Path | None, options: dict[str, Data], manifest: Manifest, recording: Recording | None = None
) -> Statement:
    """Read a settings file, if there is one; options replace its values, and are nested as in a file.

    A recording takes the place of `inputs`, and of a start and parameters that are not given. Raises InputError with
    every fault.
    """
    document = read_settings(file, options)
    if file is not None:
        expect(document, "settings")
    examination = examine(document, SettingsSection)
    reading = _Reading(document, manifest, examination.stand_ins, recording)
    if options.keys() & {"method", "loops"}:  # another method than the file's, whose settings may be of no use to it
        reading.minded = frozenset(options)
    faults = list(examination.faults)
    if examination.value is not None:
        statement = reading.statement(examination.value)
        faults += reading.faults
    if examination.value is None or faults:
        raise refuse(attribute(faults, options, file))
    return statement


# --- schema --------------------------------------------------------------------------------------------------------


def _check_method(name: str) -> str:
    if name not in METHODS:
        raise WrongValueError(f"found {abbreviate(name)}", f"give one of {', '.join(METHODS)}")
    return name


NumberField = Annotated[Expression, Read(read_number, float | str), Field(examples=[1.0])]
VectorField = tuple[NumberField, NumberField, NumberField]


class _StartSection(Section):
    pose: dict[str, NumberField] = Field(default={}, examples=[{}])
    velocity: dict[str, NumberField] = Field(default={}, examples=[{}])


class _WrenchSection(Section):
    force: VectorField | None = Field(default=None, examples=[[0.0, 0.0, 1.0]])
    moment: VectorField | None = Field(default=None, examples=[[0.0, 0.0, 1.0]])


class SettingsSection(Section):
    constants: dict[str, NumberField] = Field(default={}, examples=[{}])
    parameters: dict[str, NumberField] = Field(default={}, examples=[{}])
    duration: NumberField | None = Field(default=None, examples=[10.0])
    method: Annotated[str, AfterValidator(_check_method)] = Field(default="dop853", examples=["dop853"])
    formulation: Formulation = Field(default=Settings.formulation, examples=["exp2"])
    step: NumberField = Field(default=Number(Settings.step), examples=[1e-3])
    output_step: NumberField | None = Field(default=None, examples=[0.01])
    rtol: NumberField = Field(default=Number(Settings.rtol), examples=[1e-9])
    atol: NumberField = Field(default=Number(Settings.atol), examples=[1e-9])
    stages: int = Field(default=Settings.stages, ge=DEGREES[0], le=DEGREES[-1], examples=[2])
    rho: NumberField = Field(default=Number(Settings.rho), examples=[0.8])
    max_steps: int = Field(default=Settings.max_steps, ge=1, examples=[1_000_000])
    max_seconds: NumberField = Field(default=Number(Settings.max_seconds), examples=[60.0])
    loops: Keeping | None = Field(default=None, examples=["projection"])
    impacts: Impacts = Field(default=Settings.impacts, examples=["newton"])
    alpha: NumberField = Field(default=Number(Settings.alpha), examples=[5.0])
    beta: NumberField = Field(default=Number(Settings.beta), examples=[5.0])
    start: _StartSection = Field(default=_StartSection(), examples=[{}])
    driven: dict[str, NumberField] = Field(default={}, examples=[{}])
    inputs: dict[str, NumberField] = Field(default={}, examples=[{}])
    input_period: NumberField | None = Field(default=None, examples=[1e-3])
    wrenches: dict[str, _WrenchSection] = Field(default={}, examples=[{}])
    signals: dict[str, NumberField] = Field(default={}, examples=[{}])
    latches: dict[str, list[tuple[NumberField, NumberField | None]]] = Field(default={}, examples=[{}])


# --- meaning -------------------------------------------------------------------------------------------------------


class _Reading(Reading):
    """Evaluates numbers and looks names up in a model; collects the faults."""

    def __init__(
        self, document: Document, manifest: Manifest, stand_ins: frozenset[Place], recording: Recording | None
    ) -> None:
        super().__init__(document, stand_ins)
        self.manifest, self.recording = manifest, recording
        self.minded: frozenset[str] | None = None  # settings that must have an effect; None: all that are given
        self.quantities = {name: x for name, x in list_quantities(manifest).items() if x.kind in STATE}
        self.known = (TIME, *self.quantities)  # names that expressions of inputs may use
        self.coordinates = [c.name for c in manifest.coordinates]

    def statement(self, section: SettingsSection) -> Statement:
        """Make the statement, which is valid only if there are no faults."""
        for key, expression in section.constants.items():
            if not is_free_name(key) or key in (TIME, *self.quantities):
                self.fault(("constants", key), "no name for a constant", "give a name that nothing else has")
            self.constants[key] = self.number(("constants", key), expression)
        settings, drive = self.settings(section), self.drive(section)
        start = self.start(section.start)
        course = self.course(section.driven, start, settings.duration)
        known = [p.name for p in (*self.manifest.parameters, *self.manifest.design)]
        parameters = {} if self.recording is None else dict(self.recording.parameters)
        for name, expression in section.parameters.items():
            if self.find(("parameters", name), name, known, "parameter that may be changed") is not None:
                parameters[name] = self.number(("parameters", name), expression)
        return Statement(settings, start, drive, parameters, course)

    def settings(self, section: SettingsSection) -> Settings:
        """Read how to integrate."""
        positive = math.ulp(0)
        settings = Settings(
            duration=self.duration(section.duration),
            method=section.method,
            formulation=section.formulation,
            step=self.number(("step",), section.step, positive),
            rtol=self.number(("rtol",), section.rtol, positive),
            atol=self.number(("atol",), section.atol, positive),
            stages=section.stages,
            rho=self.number(("rho",), section.rho, 0.0),
            output_step=None
            if section.output_step is None
            else self.number(("output_step",), section.output_step, positive),
            max_steps=section.max_steps,
            max_seconds=self.number(("max_seconds",), section.max_seconds, positive),
            loops=section.loops,
            impacts=section.impacts,
            alpha=self.number(("alpha",), section.alpha, 0.0),
            beta=self.number(("beta",), section.beta, 0.0),
            latches=tuple(self.latch(name, given) for name, given in section.latches.items()),
        )
        given = section.model_fields_set
        for name, finding, remedy in find_idle(settings, given if self.minded is None else given & self.minded):
            self.fault((name,), finding, remedy)
        for name, finding, remedy in find_refusals(settings, self.manifest):
            self.fault((name,), finding, remedy)
        if settings.rho > 1:
            self.fault(("rho",), f"found {settings.rho:g}", "give a number from 0 to 1")
        if self.manifest.quaternions and not METHODS[settings.method].takes_quaternions:
            finding = f"{settings.method} takes no quaternions"
            self.fault(("method",), finding, "give gauss; with stages: 1 it is the midpoint rule")
        if takes_too_many_steps(settings):
            finding = f"{settings.duration / settings.step:.3g} steps would be taken"
            self.fault(("step",), finding, f"take a longer step, or raise max_steps = {settings.max_steps}")
        if settings.output_step and settings.duration / settings.output_step > MAX_OUTPUTS:
            finding = f"{settings.duration / settings.output_step:.3g} states would be kept"
            self.fault(("output_step",), finding, f"keep at most {MAX_OUTPUTS}")
        return settings

    def latch(self, name: str, given: Sequence[tuple[Expression, Expression | None]]) -> Latch:
        """Read the times at which a latch or a coupling holds; the last may be without end."""
        times = [
            tuple(math.inf if x is None else self.number(("latches", name, i, k), x) for k, x in enumerate(pair))
            for i, pair in enumerate(given)
        ]
        return Latch(name, tuple((start, end) for start, end in times))

    def duration(self, expression: Expression | None) -> float:
        """Read the duration; a recording has its own."""
        end = math.inf if self.recording is None else self.recording.drive.end
        if expression is None:
            if math.isinf(end):
                remedy = "give how long to simulate, in s: `--duration 2`, or `duration: 2` in a file of settings"
                self.fault(("duration",), "missing", remedy)
            return end
        duration = self.number(("duration",), expression, math.ulp(0))
        if duration > end:
            self.fault(("duration",), f"found {duration:g}", f"give at most {end:g}: there the recorded inputs end")
        return duration

    def start(self, section: _StartSection) -> Start:
        """Read the state at time 0: by name, else the recording's, else where loops are closed, else 0."""
        starts, named = [], []
        places = self.manifest.positions
        for key, given, recorded, known in (
            ("pose", section.pose, "q", places),
            ("velocity", section.velocity, "qd", self.coordinates),
        ):
            values = neutral(self.manifest) if key == "pose" else np.zeros(len(known))
            if key == "pose" and self.manifest.pose:
                values = np.array(self.manifest.pose)
            names: dict[int, float] = {}
            if (own := getattr(self.recording, recorded, None)) is not None:
                values = np.array(own, dtype=np.float64)
            for name, expression in given.items():
                i = self.find(("start", key, name), name, list(known), "coordinate" if key == "pose" else "velocity")
                if i is not None:
                    names[i] = self.number(("start", key, name), expression)
            base = values.copy()
            values[list(names)] = list(names.values())
            starts.append((base, values))
            named.append(frozenset(names))
        for quaternion in list_quaternions(self.manifest):
            if not starts[0][1][quaternion.entries].any():
                finding = f"the quaternion of {quaternion.joint} is 0"
                self.fault(("start", "pose"), finding, f"give {places[quaternion.first + 3]} too")
        for joint, found, stop in Joints.of(self.manifest).find_beyond(starts[0][1]):
            self.fault(
                ("start", "pose", joint), f"{found:.9g} is beyond the stop at {stop:.9g}", "start within the limits"
            )
        q = normalise(starts[0][1], self.manifest)
        return Start(starts[0][0], q, starts[1][1], *named)

    def course(self, section: Mapping[str, Expression], start: Start, duration: float) -> Course:
        """Read the motion of driven joints; one that is not named moves as recorded, or stands where it starts."""
        driven, places = [self.coordinates[i] for i in self.manifest.driven], place_driven(self.manifest)
        recorded = {} if self.recording is None else self.recording.driven
        expressions: list[Expression] = [
            recorded[name] if name in recorded and i not in start.placed else Number(float(start.q[i]))
            for name, i in zip(driven, places, strict=True)
        ]
        for name, expression in section.items():
            i = self.find(("driven", name), name, driven, "driven joint")
            if i is None or not self.formula(("driven", name), expression, [TIME]):
                continue
            expressions[i] = expression
            self.jump(name, expression, duration)
            if places[i] in start.placed:
                self.fault(("start", "pose", name), "its motion is given under driven", "give one or the other")
        for i in start.moving & set(self.manifest.driven):
            name = self.coordinates[i]
            self.fault(("start", "velocity", name), "this joint is driven", "give its motion under driven")
        return follow(expressions, driven, {k: v for k, v in self.constants.items() if math.isfinite(v)})

    def jump(self, name: str, expression: Expression, duration: float) -> None:
        """Note a driven joint whose velocity jumps: an impact, which no method computes."""
        constants = {key: value for key, value in self.constants.items() if math.isfinite(value)}
        if not 0 < duration < math.inf or names(expression) - {TIME, *constants}:
            return
        jump = find_jump(expression, constants, duration)
        if jump is not None:
            finding = f"its velocity jumps by {jump.change:.3g} at t = {jump.time:.6g} s, at a kink of {jump.function}"
            self.fault(("driven", name), finding, "take softplus, step or tanh, which are smooth")

    def drive(self, section: SettingsSection) -> Drive:
        """Read the inputs over time; inputs that are not named are 0."""
        actuated = [self.coordinates[i] for i in self.manifest.actuated]
        expressions: list[Expression] = [Number(0.0)] * len(actuated)
        labels = [f"joint {name}" for name in actuated]
        for name, expression in section.inputs.items():
            i = self.find(("inputs", name), name, actuated, "actuated coordinate")
            if i is not None and self.formula(("inputs", name), expression, self.known):
                expressions[i] = expression
        known = [wrench.name for wrench in self.manifest.wrenches]
        for name in section.wrenches:
            self.find(("wrenches", name), name, known, "wrench with inputs")
        for wrench in self.manifest.wrenches:
            for part, vector in self.wrench(wrench, section.wrenches.get(wrench.name, _WrenchSection())):
                expressions += vector
                labels += [f"{wrench.name}, {part} along {axis}" for axis in "xyz"]
        expressions += self.signals(section.signals)
        labels += [f"signal {name}" for name in self.manifest.signals if name != TIME]
        if self.recording is not None:
            given = ("inputs", "wrenches", "signals", "input_period")
            if place := next(((key,) for key in given if getattr(section, key)), ()):
                self.fault(place, "a solution or a table gives the inputs", "give one or the other")
            return self.recording.drive
        constants = {k: v for k, v in self.constants.items() if math.isfinite(v)}
        period = None
        if section.input_period is not None:
            period = self.number(("input_period",), section.input_period, math.ulp(0))
        return express(expressions, labels, constants, self.quantities, period)

    def signals(self, section: Mapping[str, Expression]) -> list[Expression]:
        """Read the signals over time; a signal that is not named is 0."""
        known = [name for name in self.manifest.signals if name != TIME]
        for name, expression in section.items():
            if self.find(("signals", name), name, known, "signal of the model") is not None:
                self.formula(("signals", name), expression, self.known)
        return [section.get(name, Number(0.0)) for name in known]

    def wrench(self, wrench: Wrench, section: _WrenchSection) -> Iterator[tuple[str, list[Expression]]]:
        """Read the inputs of a wrench: its force, its moment, or both."""
        for part, is_input, given in (
            ("force", wrench.force, section.force),
            ("moment", wrench.moment, section.moment),
        ):
            place: Place = ("wrenches", wrench.name, part)
            if given is not None and not is_input:
                self.fault(place, f"the {part} of this wrench is not an input", "leave it out, or change the model")
            if is_input:
                vector: list[Expression] = [Number(0.0)] * 3
                for i, expression in enumerate(given or ()):
                    if self.formula((*place, i), expression, self.known):
                        vector[i] = expression
                yield part, vector
