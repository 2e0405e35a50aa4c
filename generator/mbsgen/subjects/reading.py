"""A file of settings (YAML), or of OpenSim's ScaleTool (XML) -> Subject."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from mbsgen.documents import Document, Place, Read, Section, abbreviate, examine, read_document, read_number, refuse
from mbsgen.errors import Fault, InputError
from mbsgen.expressions import FLOATS, Expression, ExpressionError, evaluate
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element, read_markup
from mbsgen.subjects.segments import NAMES
from mbsgen.subjects.settings import FACTORS, MEASUREMENTS, Measurement, Placing, Segment, Span, Subject, Triple

NumberField = Annotated[Expression, Read(read_number, float | str), Field(examples=[1.0])]
Axes = Literal["x", "y", "z", "xy", "xz", "yz", "xyz"]
Axis = Literal["x", "-x", "y", "-y", "z", "-z"]
LARGEST = 1e3  # of factors, lengths and masses: beyond it a number has another unit


class _MeasurementSection(Section):
    pairs: list[tuple[str, str]] = Field(min_length=1, examples=[[["hip", "knee"]]])
    bodies: dict[str, Literal["x", "y", "z", "xy", "xz", "yz", "xyz"]] = Field(
        min_length=1, examples=[{"thigh": "xyz"}]
    )


class _SegmentSection(Section):
    segment: Literal[
        "head", "trunk", "upper_trunk", "middle_trunk", "lower_trunk", "upper_arm", "forearm", "hand", "thigh", "shank",
        "foot",
    ] = Field(examples=["thigh"])  # fmt: skip
    end: str = Field(default="", examples=["shank"])
    along: Axis = Field(default="y", examples=["y"])
    forward: Axis = Field(default="x", examples=["x"])
    across: bool = Field(default=True, examples=[True])


class _CoordinateSection(Section):
    weight: NumberField = Field(examples=[1.0])
    value: NumberField = Field(examples=[0.0])


class _MarkersSection(Section):
    recording: str = Field(default="", examples=["static.trc"])
    times: tuple[NumberField, NumberField] | None = Field(default=None, examples=[[0.0, 1.0]])
    weights: dict[str, NumberField] = Field(default={}, examples=[{"hip": 10.0}])
    rest: NumberField | None = Field(default=None, examples=[1.0])
    coordinates: dict[str, _CoordinateSection] = Field(default={}, examples=[{"knee": {"weight": 1.0, "value": 0.0}}])
    fixed: list[str] = Field(default=[], examples=[["hip"]])


class SubjectSection(Section):
    """The keys of a file of settings."""

    model: str = Field(examples=["leg.osim"])
    recording: str = Field(default="", examples=["static.trc"])
    times: tuple[NumberField, NumberField] | None = Field(default=None, examples=[[0.0, 1.0]])
    mass: NumberField | None = Field(default=None, examples=[70.0])
    height: NumberField | None = Field(default=None, examples=[1.75])
    sex: Literal["female", "male"] | None = Field(default=None, examples=["female"])
    keep_mass_distribution: bool = Field(default=True, examples=[True])
    measurements: dict[str, _MeasurementSection] = Field(
        default={}, examples=[{"thigh": {"pairs": [["hip", "knee"]], "bodies": {"thigh": "xyz"}}}]
    )
    factors: dict[str, tuple[NumberField, NumberField, NumberField]] = Field(
        default={}, examples=[{"pelvis": [1.0, 1.1, 1.0]}]
    )
    segments: dict[str, _SegmentSection] = Field(default={}, examples=[{"thigh": {"segment": "thigh"}}])
    markers: _MarkersSection | None = Field(default=None, examples=[{}])


assert set(NAMES) == set(_SegmentSection.model_fields["segment"].annotation.__args__)  # type: ignore[union-attr]


def read_subject(path: Path) -> Subject:
    """Read settings; their form follows from the suffix. Raises InputError with every fault of the file."""
    return _Setup(path).read() if path.suffix.lower() == ".xml" else _read_settings(path)


def _read_settings(path: Path) -> Subject:
    document = read_document(path)
    examination = examine(document, SubjectSection)
    section = examination.value
    if examination.faults or section is None:
        raise refuse(examination.faults)
    return _Reading(document).read(section)


class _Reading:
    """Evaluates the numbers of a file."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._faults: list[Fault] = []

    def read(self, section: SubjectSection) -> Subject:
        """Make the settings. Raises InputError with every fault."""
        placing = None if section.markers is None else self._read_placing(section, section.markers)
        subject = Subject(
            file=self._document.file,
            lines=self._document.lines,
            model=section.model,
            recording=section.recording,
            times=self._span(("times",), section.times),
            mass=self._above(("mass",), section.mass),
            height=self._above(("height",), section.height, most=3.0),
            sex=section.sex or "",
            keeps_distribution=section.keep_mass_distribution,
            measurements={
                name: Measurement(tuple((a, b) for a, b in x.pairs), dict(x.bodies))
                for name, x in section.measurements.items()
            },
            factors={name: self._factors(name, x) for name, x in section.factors.items()},
            segments={
                name: Segment(x.segment, x.end, x.along, x.forward, x.across) for name, x in section.segments.items()
            },
            placing=placing,
        )
        self._check(section)
        if self._faults:
            raise refuse(self._faults)
        return subject

    def _check(self, section: SubjectSection) -> None:
        if section.measurements and not section.recording:
            self._fault(("measurements",), "distances without a recording", "name one: `recording: static.trc`")
        for key in ("mass", "height", "sex"):
            if section.segments and getattr(section, key) is None:
                self._fault(("segments",), f"the table of segments needs `{key}`", f"give {key} of the subject")
        for name, x in section.segments.items():
            if x.along[-1] == x.forward[-1]:
                self._fault(("segments", name), f"both axes are {x.along[-1]}", "give two axes: along, and forward")

    def _read_placing(self, section: SubjectSection, markers: _MarkersSection) -> Placing:
        recording = markers.recording or section.recording
        if not recording:
            self._fault(("markers",), "no recording of them", "name one: `recording: static.trc`")
        place = ("markers",)
        weights = {x: self._least(("markers", "weights", x), y) for x, y in markers.weights.items()}
        return Placing(
            recording,
            self._span(("markers", "times"), markers.times) or self._span(("times",), section.times),
            weights,
            1.0 if markers.rest is None else self._least((*place, "rest"), markers.rest),
            {
                name: (
                    self._least((*place, "coordinates", name, "weight"), x.weight),
                    self._number((*place, "coordinates", name, "value"), x.value),
                )
                for name, x in markers.coordinates.items()
            },
            fixed=tuple(markers.fixed),
        )

    def _number(self, place: Place, x: Expression) -> float:
        try:
            return evaluate(x, {}, FLOATS)
        except ExpressionError as error:
            self._fault(place, error.finding, error.remedy)
            return 1.0

    def _least(self, place: Place, x: Expression) -> float:
        value = self._number(place, x)
        if value < 0:
            self._fault(place, f"found {value:g}", "give 0 or more")
        return value

    def _above(self, place: Place, x: Expression | None, most: float = LARGEST) -> float | None:
        if x is None:
            return None
        value = self._number(place, x)
        if not 0 < value <= most:
            self._fault(place, f"found {value:g}", f"give a number above 0, up to {most:g}, in kg and m")
        return value

    def _factors(self, name: str, given: tuple[Expression, Expression, Expression]) -> Triple:
        x, y, z = (self._above(("factors", name, k), each) or 1.0 for k, each in enumerate(given))
        return x, y, z

    def _span(self, place: Place, given: tuple[Expression, Expression] | None) -> Span | None:
        if given is None:
            return None
        first, last = (self._number((*place, k), x) for k, x in enumerate(given))
        if first > last:
            self._fault(place, f"found {first:g} to {last:g} s", "give the first and the last time")
        return first, last

    def _fault(self, place: Place, finding: str, remedy: str) -> None:
        self._faults.append(self._document.fault(place, finding, remedy))


_STEPS = {"measurements": MEASUREMENTS, "manualScale": FACTORS}
_NONE = ("", "Unassigned")


class _Setup:
    """A file of OpenSim's ScaleTool."""

    def __init__(self, path: Path) -> None:
        self._root = read_markup(path)
        self._findings = Findings(str(path))
        self._lines: dict[Place, int] = {}
        self._notices: list[str] = []

    def read(self) -> Subject:
        """Make the settings. Raises InputError with every fault."""
        tool = self._root if self._root.tag == "ScaleTool" else self._root.first("ScaleTool")
        if tool is None:
            finding = f"it holds <{self._root.tag[:40]}>, and no <ScaleTool>"
            raise InputError([self._root.fault(finding, "give settings in YAML, or the setup of a ScaleTool")])
        maker = tool.first("GenericModelMaker") or tool
        model = self._text(maker, "model_file")
        if model in _NONE:
            self._findings.fault(maker, "it names no model", "give <model_file>")
        if self._text(maker, "marker_set_file") not in _NONE:
            self._leave(maker.first("marker_set_file"), "markers of another file; add them to the model")
        mass = self._number(tool, "mass")
        subject = Subject(
            file=self._root.file,
            lines=self._lines,
            model=model,
            mass=None if mass is None or mass <= 0 else mass,
            placing=self._read_placer(tool.first("MarkerPlacer")),
            **self._read_scaler(tool.first("ModelScaler")),
        )
        if self._findings.faults:
            raise self._findings.refuse()
        return replace(subject, notices=tuple(self._notices))

    def _read_scaler(self, scaler: Element | None) -> dict[str, Any]:
        if scaler is None or not self._is_on(scaler):
            return {"steps": ()}
        measurements = dict[str, Measurement]()
        for element in self._objects(scaler, "MeasurementSet"):
            if self._is_on(element):
                name = element.attributes.get("name", "") or f"measurement_{len(measurements) + 1}"
                self._lines["measurements", name] = element.line
                measurements[name] = self._read_measurement(element)
        factors = {}
        for element in self._objects(scaler, "ScaleSet"):
            if self._is_on(element):
                body = self._text(element, "segment")
                self._lines["factors", body] = element.line
                factors[body] = self._read_factors(element)
        steps = []
        for word in self._text(scaler, "scaling_order").split():
            if word not in _STEPS:
                order = scaler.first("scaling_order") or scaler
                self._findings.fault(order, f"found {abbreviate(word)}", f"give {' or '.join(_STEPS)}")
            else:
                steps.append(_STEPS[word])
        keep = self._text(scaler, "preserve_mass_distribution").lower() in ("true", "1")
        return {
            "recording": self._file(scaler, "marker_file"),
            "times": self._span(scaler),
            "keeps_distribution": keep,
            "steps": tuple(steps),
            "measurements": measurements,
            "factors": factors,
        }

    def _read_measurement(self, element: Element) -> Measurement:
        pairs, axes = [], dict[str, str]()
        for pair in self._objects(element, "MarkerPairSet"):
            words = self._text(pair, "markers").split()
            if len(words) == 2:
                pairs.append((words[0], words[1]))
            else:
                self._findings.fault(pair, f"a pair of {len(words)} markers", "name two")
        for scale in self._objects(element, "BodyScaleSet"):
            body = scale.attributes.get("name", "")
            chosen = "".join(x for x in "xyz" if x in self._text(scale, "axes").lower().split())
            axes[body] = chosen or "xyz"
        return Measurement(tuple(pairs), axes)

    def _read_factors(self, element: Element) -> Triple:
        child = element.first("scales")
        if child is None:
            self._findings.fault(element, "no <scales>", "give three factors")
            return 1.0, 1.0, 1.0
        x, y, z = self._findings.numbers(child, "scales", (1.0, 1.0, 1.0), attributes={"scales": child.text})
        if min(x, y, z) <= 0:
            self._findings.fault(child, f"found {child.text[:40]}", "give factors above 0")
        return x, y, z

    def _read_placer(self, placer: Element | None) -> Placing | None:
        if placer is None or not self._is_on(placer):
            return None
        recording = self._file(placer, "marker_file")
        if not recording:
            self._findings.fault(placer, "no recording of markers", "give <marker_file>, or <apply> false")
        if (self._number(placer, "max_marker_movement") or -1.0) > 0:
            self._leave(placer.first("max_marker_movement"), "frames are averaged, however far markers move")
        weights, coordinates = dict[str, float](), dict[str, tuple[float, float]]()
        for task in self._objects(placer, "IKTaskSet"):
            if not self._is_on(task):
                continue
            name, weight = task.attributes.get("name", ""), self._number(task, "weight")
            weight = 1.0 if weight is None else weight
            if task.tag == "IKMarkerTask":
                self._lines["markers", "weights", name] = task.line
                weights[name] = weight
            elif task.tag == "IKCoordinateTask":
                self._lines["markers", "coordinates", name] = task.line
                self._read_task(task, name, weight, coordinates)
        return Placing(recording, self._span(placer), weights, 0.0, coordinates, is_mean=True)

    def _read_task(self, task: Element, name: str, weight: float, coordinates: dict[str, tuple[float, float]]) -> None:
        kind = self._text(task, "value_type") or "default_value"
        if kind == "from_file":
            self._leave(task, "values of a coordinate over time")
        else:
            value = self._number(task, "value") if kind == "manual_value" else None
            coordinates[name] = (weight, float("nan") if value is None else value)  # nan: the model's default value

    def _span(self, element: Element) -> Span | None:
        words = self._text(element, "time_range").split()
        child = element.first("time_range")
        if child is None or len(words) != 2:
            return None
        first, last = (self._findings.number(child, "time", 0.0, {"time": x}) for x in words)
        return None if first < 0 and last < 0 else (first, last)

    def _file(self, element: Element, tag: str) -> str:
        text = self._text(element, tag)
        return "" if text in _NONE else text

    def _leave(self, element: Element | None, text: str) -> None:
        if element is not None:
            self._notices.append(f"{element.file}:{element.line}: {element.path}: left out: {text}")

    def _is_on(self, element: Element) -> bool:
        return self._text(element, "apply").lower() not in ("false", "0")

    def _objects(self, element: Element, name: str) -> Iterator[Element]:
        found = element.first(name)
        objects = None if found is None else found.first("objects")
        yield from () if objects is None else objects.children

    def _text(self, element: Element, tag: str) -> str:
        child = element.first(tag)
        return "" if child is None else child.text

    def _number(self, element: Element, tag: str) -> float | None:
        child = element.first(tag)
        return None if child is None or not child.text else self._findings.number(child, tag, 0.0, {tag: child.text})
