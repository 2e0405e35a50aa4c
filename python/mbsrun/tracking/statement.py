"""Trial files: YAML and options -> Trial, and the plant's changes.

Numbers are expressions over the problem's constants and the file's own. Expressions of `updates`, pushes, measures and
references may use the loop's time t; of measures also the true state: q_NAME, qd_NAME, x_SENSOR, vx_SENSOR.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Discriminator, Field, Tag

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
from mbsgen.errors import Fault
from mbsgen.expressions import Expression, Number, is_free_name, names
from mbsgen.manifest import Manifest
from mbsrun.ocp.problem.problem import Problem
from mbsrun.quantities import list_quantities, name_quantities
from mbsrun.quaternions import normalise
from mbsrun.reading import Reading, attribute, read_settings
from mbsrun.simulation.drive import STATE
from mbsrun.simulation.integration.methods import METHODS, find_idle
from mbsrun.simulation.motion import Settings
from mbsrun.tracking.added import is_whole
from mbsrun.tracking.trial import TIME, Fallback, Horizon, Kick, Measure, Noise, Push, Trial

Array = NDArray[np.float64]

MAX_SAMPLES = 1_000_000
MAX_DELAY = 100  # periods
MAX_SECONDS = 10.0  # of processor time for a period, by default


@dataclass(frozen=True)
class Changes:
    """Differences between the true mechanism and the controller's."""

    model: str | None = None  # a model file beside the trial's; None: the controller's
    parameters: Mapping[str, Expression] | None = None  # values, by parameter or path of a number
    scale: Mapping[str, Expression] | None = None  # factors of the model's values

    @property
    def is_released(self) -> bool:
        """Return whether numbers of the model change."""
        return bool(self.parameters or self.scale)


def _check_method(name: str) -> str:
    if name not in METHODS:
        raise WrongValueError(f"found {abbreviate(name)}", f"give one of {', '.join(METHODS)}")
    return name


def _check_model(path: str) -> str:
    if not path.endswith((".yaml", ".yml")):
        raise WrongValueError(f"found {abbreviate(path)}", "give a model file (.yaml), from this file's folder")
    return path


def _form(value: Any) -> str:
    return "mapping" if isinstance(value, dict) else "number"


NumberField = Annotated[Expression, Read(read_number, float | str), Field(examples=[1.0])]
VectorField = tuple[NumberField, NumberField, NumberField]
SpreadField = Annotated[  # of all entries, or by name
    Annotated[NumberField, Tag("number")] | Annotated[dict[str, NumberField], Tag("mapping")], Discriminator(_form)
]


class _StartSection(Section):
    pose: dict[str, NumberField] = Field(default={}, examples=[{}])
    velocity: dict[str, NumberField] = Field(default={}, examples=[{}])
    states: dict[str, NumberField] = Field(default={}, examples=[{}])


class _HorizonSection(Section):
    end: NumberField = Field(examples=[2.0])
    least: NumberField = Field(examples=[0.5])


class _PlantSection(Section):
    model: Annotated[str, AfterValidator(_check_model)] | None = Field(default=None, examples=["model.yaml"])
    parameters: dict[str, NumberField] = Field(default={}, examples=[{}])
    scale: dict[str, NumberField] = Field(default={}, examples=[{}])
    method: Annotated[str, AfterValidator(_check_method)] = Field(default="dop853", examples=["dop853"])
    step: NumberField = Field(default=Number(Settings.step), examples=[1e-3])
    rtol: NumberField = Field(default=Number(Settings.rtol), examples=[1e-9])
    atol: NumberField = Field(default=Number(Settings.atol), examples=[1e-9])
    max_seconds: NumberField = Field(default=Number(MAX_SECONDS), examples=[10.0])


class _NoiseSection(Section):
    coordinates: SpreadField = Field(default=Number(0.0), examples=[1e-3])
    velocities: SpreadField = Field(default=Number(0.0), examples=[1e-2])
    inputs: SpreadField = Field(default=Number(0.0), examples=[0.1])
    seed: int = Field(default=0, ge=0, examples=[0])


class _KickSection(Section):
    time: NumberField
    velocity: dict[str, NumberField] = Field(examples=[{}])


class _PushSection(Section):
    wrench: str = Field(examples=["push"])
    start: NumberField = Field(alias="from", examples=[1.0])
    end: NumberField = Field(alias="until", examples=[1.2])
    force: VectorField | None = Field(default=None, examples=[[0.0, 0.0, 1.0]])
    moment: VectorField | None = Field(default=None, examples=[[0.0, 0.0, 1.0]])


class _MeasureSection(Section):
    name: str = Field(examples=["error"])
    expression: NumberField
    start: NumberField = Field(alias="from", default=Number(0.0), examples=[1.0])
    end: NumberField | None = Field(alias="until", default=None, examples=[2.0])
    most: NumberField | None = Field(default=None, examples=[0.01])


class TrialSection(Section):
    constants: dict[str, NumberField] = Field(default={}, examples=[{}])
    duration: NumberField = Field(examples=[5.0])
    rate: NumberField = Field(examples=[20.0])
    delay: int = Field(default=Trial.delay, ge=0, le=MAX_DELAY, examples=[1])
    predict: bool = Field(default=Trial.predicts, examples=[True])
    fallback: Fallback = Field(default=Trial.fallback, examples=["plan"])
    horizon: _HorizonSection | None = Field(default=None, examples=[{"end": 2.0, "least": 0.5}])
    start: _StartSection = Field(default=_StartSection(), examples=[{}])
    updates: dict[str, NumberField] = Field(default={}, examples=[{}])
    plant: _PlantSection = Field(default=_PlantSection(), examples=[{}])
    noise: _NoiseSection = Field(default=_NoiseSection(), examples=[{}])
    kicks: tuple[_KickSection, ...] = Field(default=(), examples=[[]])
    wrenches: tuple[_PushSection, ...] = Field(default=(), examples=[[]])
    measures: tuple[_MeasureSection, ...] = Field(default=(), examples=[[]])
    leeway: dict[str, NumberField] = Field(default={}, examples=[{}])
    references: dict[str, NumberField] = Field(default={}, examples=[{}])


class TrialStatement:
    """A trial file and options, checked against its schema; the plant's model is loaded before the rest is read."""

    def __init__(self, file: Path | None, options: Mapping[str, Data]) -> None:
        """Read the file, if there is one; options replace its values. Raises InputError with every fault."""
        self._file, self._options = file, options
        self._document = read_settings(file, options)
        if file is not None:
            expect(self._document, "trial")
        examination = examine(self._document, TrialSection)
        if examination.value is None or examination.faults:
            raise refuse(attribute(list(examination.faults), options, file))
        self._section = examination.value
        plant = self._section.plant
        self.changes = Changes(plant.model, plant.parameters, plant.scale)

    def trial(
        self, problem: Problem, manifest: Manifest, values: Mapping[str, float]
    ) -> tuple[Trial, dict[str, float]]:
        """Return the trial, and the parameters of the plant, of which `values` are the model's.

        Raises InputError with every fault.
        """
        reading = _Reading(self._document, problem, manifest)
        trial, parameters = reading.trial(self._section), reading.parameters(self._section.plant, values)
        if reading.faults:
            raise refuse(attribute(reading.faults, self._options, self._file))
        return trial, parameters

    def fault(self, place: Place, finding: str, remedy: str) -> Fault:
        """Make the fault of a place of the file or the options."""
        fault = self._document.fault(place, finding, remedy)
        return attribute([fault], self._options, self._file)[0]


class _Reading(Reading):
    """Evaluates numbers and looks names up in the problem and the plant's model; collects the faults."""

    def __init__(self, document: Document, problem: Problem, manifest: Manifest) -> None:
        super().__init__(document, frozenset())
        self.problem, self.manifest = problem, manifest
        self.constants = dict(problem.constants)
        self.quantities = {name: x for name, x in list_quantities(manifest).items() if x.kind in STATE}
        self.velocities = [c.name for c in manifest.coordinates]
        self.inputs = [self.velocities[i] for i in manifest.actuated]

    def trial(self, section: TrialSection) -> Trial:
        """Make the trial, which is valid only if there are no faults."""
        added = [state.name for state in self.problem.states]
        controls = tuple(control.name for control in self.problem.controls)
        for key, expression in section.constants.items():
            place: Place = ("constants", key)
            if not is_free_name(key) or key in (
                TIME,
                *self.quantities,
                *added,
                *controls,
                *dict(self.problem.constants),
            ):
                self.fault(place, "no name for a constant", "give a name that nothing else has")
            self.constants[key] = self.number(place, expression)
        if self.problem.references:
            finding = f"the problem reads the recording {self.problem.references[0].name}, each plan from its start"
            self.fault((), finding, "follow an expression in t0 + t instead, with updates: {t0: t}")
        if self.manifest.signals:
            finding = f"its forces read {', '.join(self.manifest.signals)}, which nothing gives in a closed loop"
            self.fault(("plant", "model"), finding, "give the plant forces of the state alone, or wrenches")
        if self.manifest.driven:
            finding = (
                f"it drives {', '.join(self.velocities[i] for i in self.manifest.driven)}, which nothing moves here"
            )
            self.fault(("plant", "model"), finding, "give these joints actuators in the model")
        positive = math.ulp(0)
        duration, rate = (self.number((key,), getattr(section, key), positive) for key in ("duration", "rate"))
        if duration * rate > MAX_SAMPLES:
            self.fault(("duration",), f"{duration * rate:.3g} samples would be taken", f"take at most {MAX_SAMPLES}")
        if (len(self.manifest.positions), len(self.inputs)) != (
            len(self.problem.start_q),
            len(self.problem.bounds.u),
        ) or len(self.velocities) != len(self.problem.start_qd):
            finding = "its coordinates or inputs are not the controller's"
            self.fault(("plant", "model"), finding, "give a model with the same joints and actuators")
            start = np.array(self.problem.start_q), np.array(self.problem.start_qd)
        else:
            start = self.start(section.start)
        return Trial(
            name=self.problem.name,
            duration=duration,
            period=1 / rate,
            start_q=start[0],
            start_qd=start[1],
            noise=self.noise(section.noise),
            integration=self.integration(section.plant, 1 / rate),
            constants=dict(self.constants),
            updates=self.updates(section.updates),
            states=tuple(added),
            start_states=self.start_states(section.start),
            controls=controls,
            delay=section.delay,
            predicts=section.predict,
            fallback=section.fallback,
            horizon=self.horizon(section.horizon, 1 / rate),
            kicks=tuple(self.kick(i, kick, duration) for i, kick in enumerate(section.kicks)),
            pushes=tuple(self.push(i, push) for i, push in enumerate(section.wrenches)),
            measures=tuple(self.measure(i, measure, duration) for i, measure in enumerate(section.measures)),
            leeway=self.leeway(section.leeway),
            references=self.references(section.references),
        )

    def start(self, section: _StartSection) -> tuple[Array, Array]:
        """Read the plant's start: the problem's, where no other number is given."""
        states = []
        for key, given, values, known, kind in (
            ("pose", section.pose, self.problem.start_q, self.manifest.positions, "coordinate"),
            ("velocity", section.velocity, self.problem.start_qd, self.velocities, "velocity"),
        ):
            state = np.array(values)
            for name, expression in given.items():
                i = self.find(("start", key, name), name, known, kind)
                if i is not None:
                    state[i] = self.number(("start", key, name), expression)
            states.append(state)
        return normalise(states[0], self.manifest), states[1]

    def start_states(self, section: _StartSection) -> Array:
        """Read where the states begin that the problem adds: as the problem says, where no other number is given."""
        known = [state.name for state in self.problem.states]
        for name in section.states:
            self.find(("start", "states", name), name, known, "state")
        values = np.zeros(len(known))
        for i, state in enumerate(self.problem.states):
            if state.name in section.states:
                values[i] = self.number(("start", "states", state.name), section.states[state.name])
            elif state.start[0] == state.start[1]:
                values[i] = state.start[0]
            else:
                finding = f"the problem does not say where the state {state.name} begins"
                self.fault(("start", "states"), finding, f"give it, e.g. start: {{states: {{{state.name}: 0}}}}")
        return values

    def noise(self, section: _NoiseSection) -> Noise:
        return Noise(
            self.spread("coordinates", section.coordinates, self.manifest.positions),
            self.spread("velocities", section.velocities, self.velocities),
            self.spread("inputs", section.inputs, [*self.inputs, *(x.name for x in self.problem.controls)]),
            section.seed,
        )

    def spread(self, key: str, given: Expression | dict[str, Expression], known: Sequence[str]) -> Array:
        """Read standard deviations: one for all entries, or by name, 0 for the others."""
        if not isinstance(given, dict):
            return np.full(len(known), self.number(("noise", key), given, 0.0))
        values = np.zeros(len(known))
        for name, expression in given.items():
            i = self.find(("noise", key, name), name, known, "entry")
            if i is not None:
                values[i] = self.number(("noise", key, name), expression, 0.0)
        return values

    def integration(self, section: _PlantSection, period: float) -> Settings:
        """Read how the plant is integrated."""
        positive = math.ulp(0)
        if self.manifest.quaternions and not METHODS[section.method].takes_quaternions:
            self.fault(("plant", "method"), f"{section.method} takes no quaternions", "give dop853")
        if self.manifest.loops and METHODS[section.method].closed is None:
            self.fault(("plant", "method"), f"{section.method} takes no loops", "give dop853")
        settings = Settings(
            duration=period,
            method=section.method,
            step=self.number(("plant", "step"), section.step, positive),
            rtol=self.number(("plant", "rtol"), section.rtol, positive),
            atol=self.number(("plant", "atol"), section.atol, positive),
            max_seconds=self.number(("plant", "max_seconds"), section.max_seconds, positive),
        )
        for name in (
            sorted({"method", "step", "rtol", "atol"} & section.model_fields_set) if is_whole(self.problem) else ()
        ):
            finding = "controls and forces of the problem move the plant with its states, by DOP853 at 1e-13"
            self.fault(("plant", name), finding, "leave it out")
        for name, finding, remedy in find_idle(settings, section.model_fields_set):
            self.fault(("plant", name), finding, remedy)
        return settings

    def parameters(self, section: _PlantSection, values: Mapping[str, float]) -> dict[str, float]:
        """Return changed numbers of the plant, by name."""
        changed = {}
        for key, given in (("parameters", section.parameters), ("scale", section.scale)):
            for name, expression in given.items():
                place: Place = ("plant", key, name)
                if self.find(place, name, list(values), "number") is None:
                    continue
                if name in changed:
                    self.fault(place, "this number has a value under parameters", "give one or the other")
                value = self.number(place, expression)
                changed[name] = value if key == "parameters" else value * values[name]
        return changed

    def updates(self, section: Mapping[str, Expression]) -> dict[str, Expression]:
        """Read how constants of the problem change over time."""
        known = list(dict(self.problem.constants))
        found = {}
        for name, expression in section.items():
            place: Place = ("updates", name)
            if name not in known:
                finding = f"no expression of the problem reads a constant {abbreviate(name)}"
                self.fault(place, finding, f"there are {', '.join(known) or 'none'}")
            elif self.formula(place, expression, [TIME]):
                found[name] = expression
        return found

    def horizon(self, section: _HorizonSection | None, period: float) -> Horizon | None:
        """Read how the horizon shrinks."""
        if section is None:
            if not self.problem.is_timed:
                self.fault(("horizon",), "the problem's horizon is free", "give it a fixed one, or end and least here")
            return None
        return Horizon(
            self.number(("horizon", "end"), section.end, math.ulp(0)),
            self.number(("horizon", "least"), section.least, period),
        )

    def kick(self, i: int, section: _KickSection, duration: float) -> Kick:
        time = self.number(("kicks", i, "time"), section.time, 0.0)
        if time >= duration:
            self.fault(("kicks", i, "time"), f"found {time:g}", f"give a time before the end, {duration:g} s")
        changes = []
        for name, expression in section.velocity.items():
            index = self.find(("kicks", i, "velocity", name), name, self.velocities, "velocity")
            if index is not None:
                changes.append((index, self.number(("kicks", i, "velocity", name), expression)))
        return Kick(time, tuple(changes))

    def push(self, i: int, section: _PushSection) -> Push:
        """Read a wrench in a span of time: entries of w in the model's order."""
        place: Place = ("wrenches", i)
        start, end = (self.number((*place, key), x) for key, x in (("from", section.start), ("until", section.end)))
        if end <= start:
            self.fault((*place, "until"), f"found {end:g}, and from is {start:g}", "give a later time")
        known = [wrench.name for wrench in self.manifest.wrenches]
        self.find((*place, "wrench"), section.wrench, known, "wrench with inputs")
        entries: list[tuple[int, Expression]] = []
        first = 0
        for wrench in self.manifest.wrenches:
            for key, is_input in (("force", wrench.force), ("moment", wrench.moment)):
                given = getattr(section, key) if wrench.name == section.wrench else None
                if given is not None and not is_input:
                    self.fault((*place, key), f"the {key} of this wrench is not an input", "change the plant's model")
                elif given is not None:
                    for k, expression in enumerate(given):
                        if self.formula((*place, key, k), expression, [TIME]):
                            entries.append((first + k, expression))
                first += 3 * is_input
        return Push(start, end, tuple(entries))

    def measure(self, i: int, section: _MeasureSection, duration: float) -> Measure:
        place: Place = ("measures", i)
        added = (state.name for state in self.problem.states)
        self.formula((*place, "expression"), section.expression, [TIME, *self.quantities, *added])
        start = self.number((*place, "from"), section.start)
        end = math.inf if section.end is None else self.number((*place, "until"), section.end)
        if start >= min(end, duration):
            finding = f"nothing is measured from {start:g} s on"
            self.fault((*place, "from"), finding, f"give a time before {min(end, duration):g} s")
        most = None if section.most is None else self.number((*place, "most"), section.most)
        return Measure(section.name, section.expression, start, end, most)

    def leeway(self, section: Mapping[str, Expression]) -> dict[str, float]:
        """Read by how much ranges may be left: of bounds by quantity, of constraints by expression."""
        known = [
            name
            for kind, entries, ranges in (
                ("q", self.manifest.positions, self.problem.bounds.q),
                ("qd", self.velocities, self.problem.bounds.qd),
                ("u", self.inputs, self.problem.bounds.u),
            )
            for name, limits in zip(name_quantities(kind, entries), ranges, strict=False)
            if any(map(math.isfinite, limits))
        ]
        known += [state.name for state in self.problem.states]
        known += [constraint.expression for constraint in self.problem.constraints if constraint.at == "path"]
        found = {}
        for name, expression in section.items():
            place: Place = ("leeway", name)
            if self.find(place, name, known, "bound or constraint of", "problem") is not None:
                found[name] = self.number(place, expression, 0.0)
        return found

    def references(self, section: Mapping[str, Expression]) -> dict[str, Expression]:
        """Read the values that quantities of the state should have over time."""
        found = {}
        for name, expression in section.items():
            place: Place = ("references", name)
            if self.find(place, name, list(self.quantities), "quantity of the state") is None:
                continue
            if self.formula(place, expression, [TIME]) and not names(expression) & set(self.quantities):
                found[name] = expression
        return found
