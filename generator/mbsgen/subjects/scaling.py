"""A subject's settings and measured distances of markers -> the scaled model file, and what was changed.

Steps set factors of bodies, each over the ones before: the table by heights, measurements, given factors. Then
everything is stretched (`osim`, `plain`); bodies of the table get its masses, centres and inertias; the lengths of
fibres, slack tendons and slack springs follow the lengths of their lines in the start pose, from before to after.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbsgen.documents import Place, abbreviate, nearest, refuse
from mbsgen.errors import Fault, InputError
from mbsgen.expressions import FLOATS, evaluate
from mbsgen.importing import Choices, Imported
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element, read_markup, write_markup
from mbsgen.importing.osim.reading import read_osim
from mbsgen.model.following import list_joints
from mbsgen.model.model import Frame, Model
from mbsgen.model.reader import read_model
from mbsgen.model.writer import write_model
from mbsgen.subjects import osim, plain
from mbsgen.subjects.posing import Posed, has_loops, pose
from mbsgen.subjects.segments import STATURES, TABLES, Figures
from mbsgen.subjects.settings import FACTORS, MEASUREMENTS, TABLE, Measurement, Segment, Subject, Triple

Array = NDArray[np.float64]

WHOLE: Triple = (1.0, 1.0, 1.0)
_MARK = "frame of "  # a body: the sensor at its origin
SHORT = 1e-6  # m: a distance in the model with which nothing is compared


@dataclass(frozen=True)
class Distance:
    """A pair of markers."""

    measurement: str
    markers: tuple[str, str]
    model: float  # [m]
    subject: float


@dataclass(frozen=True)
class Weight:
    """Masses of a body before and after [kg]."""

    body: str
    before: float
    after: float


@dataclass(frozen=True)
class Scaled:
    """A scaled model."""

    source: Source
    factors: Mapping[str, Triple]  # of all bodies, in the order of the file
    distances: tuple[Distance, ...]
    weights: tuple[Weight, ...]
    lines: Mapping[str, float]  # ratios of the lengths of muscles and springs
    notices: tuple[str, ...]

    @property
    def text(self) -> str:
        """The model file."""
        return self.source.write()

    @property
    def suffix(self) -> str:
        """The suffix of the model file."""
        return self.source.suffix

    @property
    def markers(self) -> tuple[str, ...]:
        """The names of all markers."""
        return self.source.markers


class Source(ABC):
    """A model file that can be scaled; all names are the file's."""

    suffix: str

    @property
    @abstractmethod
    def bodies(self) -> tuple[str, ...]:
        """Names of bodies, in the order of the file."""

    @property
    @abstractmethod
    def markers(self) -> tuple[str, ...]:
        """Names of markers."""

    @property
    @abstractmethod
    def masses(self) -> Mapping[str, float]:
        """Masses of bodies [kg]."""

    @abstractmethod
    def measure(self, joints: Mapping[str, float] | None = None) -> Posed:
        """Pose the model at its start, or at coordinates of joints; bodies are sensors too. Raises InputError."""

    @abstractmethod
    def scale(self, factors: Mapping[str, Triple], masses: osim.Masses) -> Source:
        """Stretch everything but lengths of muscles."""

    @abstractmethod
    def scale_lines(self, ratios: Mapping[str, float]) -> Source:
        """Scale the lengths of muscles and springs, by the names of `measure`."""

    @abstractmethod
    def weigh(self, solids: Mapping[str, Solid]) -> Source:
        """Set masses and inertias."""

    @abstractmethod
    def place(self, shifts: Mapping[str, Array]) -> Source:
        """Shift markers along the axes of their attitudes in `measure` [m]."""

    @abstractmethod
    def find_joint(self, coordinate: str, value: float | None) -> tuple[str, float, float] | None:
        """Return the joint of a coordinate, its own coordinate at a value or the start, and their ratio; or None."""

    @abstractmethod
    def list_sensors(self) -> Mapping[str, str]:
        """Return names of markers by the sensors of the model that is made of the file."""

    @abstractmethod
    def list_coordinates(self, joints: Mapping[str, float]) -> dict[str, float]:
        """Return the coordinates of the file where joints have these."""

    @abstractmethod
    def list_fixed(self) -> tuple[str, ...]:
        """List the markers that must not move on their bodies."""

    @abstractmethod
    def list_kept(self) -> Iterator[tuple[str, str]]:
        """List places and names of lines whose lengths cannot be computed."""

    @abstractmethod
    def write(self) -> str:
        """Write the model file."""


@dataclass(frozen=True)
class Solid:
    """A mass with its centre, and the inertia about it: xx, yy, zz, xy, xz, yz."""

    mass: float | None  # None: as it is
    centre: Array | None
    moments: tuple[float, ...] | None


# --- OpenSim's files -------------------------------------------------------------------------------------------------


class OsimSource(Source):
    """A file of OpenSim."""

    suffix = ".osim"

    def __init__(self, root: Element) -> None:
        self._root = root
        self._whole: Imported | None = None

    @property
    def bodies(self) -> tuple[str, ...]:
        return tuple(osim.list_bodies(self._root))

    @property
    def markers(self) -> tuple[str, ...]:
        return tuple(osim.list_markers(self._root))

    @property
    def masses(self) -> Mapping[str, float]:
        return {name: osim.read_mass(x) for name, x in osim.list_bodies(self._root).items()}

    @property
    def imported(self) -> Imported:
        """The model with all bodies and markers as sensors."""
        if self._whole is None:
            choices = Choices(sensors=(*self.bodies, *self.markers))
            self._whole = read_osim(self._root, choices, Findings(self._root.file))
        return self._whole

    def measure(self, joints: Mapping[str, float] | None = None) -> Posed:
        imported = self.imported
        if has_loops(imported.model):
            text = "the model has loops, and its start pose may have to be closed"
            raise InputError([self._root.fault(text, "remove them for the scaling, and add them to the result")])
        starts = {
            x.joint: (osim.read_default(self._root, x.name) - x.offset) / x.ratio
            for x in imported.coordinates
            if x.joint
        }
        found = pose(imported.model, starts if joints is None else joints)
        return found.rename(imported.labels)

    def scale(self, factors: Mapping[str, Triple], masses: osim.Masses) -> Source:
        return OsimSource(osim.scale_osim(self._root, factors, masses))

    def scale_lines(self, ratios: Mapping[str, float]) -> Source:
        return OsimSource(osim.scale_lines(self._root, ratios))

    def weigh(self, solids: Mapping[str, Solid]) -> Source:
        root = self._root
        for name, x in solids.items():
            root = osim.set_solid(root, name, x.mass, x.centre, x.moments)
        return OsimSource(root)

    def place(self, shifts: Mapping[str, Array]) -> Source:
        free = {name: x.tolist() for name, x in shifts.items() if name not in self.list_fixed()}
        return OsimSource(osim.move_markers(self._root, free))

    def find_joint(self, coordinate: str, value: float | None) -> tuple[str, float, float] | None:
        for x in self.imported.coordinates:
            if x.name == coordinate and x.joint:
                own = osim.read_default(self._root, coordinate) if value is None else value
                return x.joint, (own - x.offset) / x.ratio, x.ratio
        return None

    def list_sensors(self) -> Mapping[str, str]:
        return self.imported.labels

    def list_coordinates(self, joints: Mapping[str, float]) -> dict[str, float]:
        found = self.imported.coordinates
        return {x.name: x.ratio * joints[x.joint] + x.offset if x.joint else x.offset for x in found}

    def list_fixed(self) -> tuple[str, ...]:
        return tuple(name for name, x in osim.list_markers(self._root).items() if osim.is_fixed(x))

    def list_kept(self) -> Iterator[tuple[str, str]]:
        known = set(self.imported.labels.values())
        for name, line in osim.list_lines(self._root).items():
            if name not in known:
                yield f"{line.file}:{line.line}", name

    def write(self) -> str:
        return write_markup(self._root)


# --- models of this project ------------------------------------------------------------------------------------------


class ModelSource(Source):
    """A model file of this project; its sensors are the markers."""

    suffix = ".yaml"

    def __init__(self, model: Model) -> None:
        self._model = model

    @property
    def bodies(self) -> tuple[str, ...]:
        return tuple(x.name for x in self._model.bodies)

    @property
    def markers(self) -> tuple[str, ...]:
        return tuple(x.name for x in self._model.frames if x.is_sensor)

    @property
    def masses(self) -> Mapping[str, float]:
        values = plain.evaluate_parameters(self._model)
        return {x.name: evaluate(x.mass, values, FLOATS) for x in self._model.bodies}

    def measure(self, joints: Mapping[str, float] | None = None) -> Posed:
        more = tuple(Frame(_MARK + x, x) for x in self.bodies)
        found = pose(replace(self._model, frames=(*self._model.frames, *more)), joints or {})
        return found.rename({x.name: x.body for x in more if x.body not in self.markers})

    def scale(self, factors: Mapping[str, Triple], masses: osim.Masses) -> Source:
        return ModelSource(plain.scale_model(self._model, factors, masses))

    def scale_lines(self, ratios: Mapping[str, float]) -> Source:
        return ModelSource(plain.scale_model_lines(self._model, ratios))

    def weigh(self, solids: Mapping[str, Solid]) -> Source:
        model = self._model
        for name, x in solids.items():
            model = plain.set_model_solid(model, name, x.mass, x.centre, x.moments)
        return ModelSource(model)

    def place(self, shifts: Mapping[str, Array]) -> Source:
        return ModelSource(plain.move_frames(self._model, shifts))

    def find_joint(self, coordinate: str, value: float | None) -> tuple[str, float, float] | None:
        known = coordinate in {step.name for step in list_joints(self._model)}
        return (coordinate, value or 0.0, 1.0) if known else None

    def list_sensors(self) -> Mapping[str, str]:
        return {}

    def list_coordinates(self, joints: Mapping[str, float]) -> dict[str, float]:
        return dict(joints)

    def list_fixed(self) -> tuple[str, ...]:
        return ()

    def list_kept(self) -> Iterator[tuple[str, str]]:
        yield from ()

    def write(self) -> str:
        return write_model(self._model)


# --- scaling ---------------------------------------------------------------------------------------------------------


def open_source(subject: Subject) -> Source:
    """Read the model that settings name. Raises InputError."""
    path = Path(subject.file).parent / subject.model
    if not path.is_file():
        fault = subject.fault(
            ("model",), f"there is no file {abbreviate(str(path))}", "name a model, from this file on"
        )
        raise refuse([fault])
    if path.suffix.lower() == ".osim":
        source = OsimSource(read_markup(path))
        _ = source.imported  # with all faults of the file
        return source
    model = read_model(path)
    found = [
        text for is_there, text in ((has_loops(model), "loops"), (_has_tables(model), "tables of joints")) if is_there
    ]
    if found:
        remedy = "give a tree whose joints have positions"
        raise refuse([subject.fault(("model",), f"the model has {' and '.join(found)}", remedy)])
    return ModelSource(model)


def _has_tables(model: Model) -> bool:
    carriers = [x for body in model.bodies for x in (body.joints or (body.joint,))]
    return any(not isinstance(x, tuple) and x.row is not None for x in carriers)


def scale_subject(subject: Subject, distances: Mapping[tuple[str, str], float]) -> Scaled:
    """Scale a model by settings and measured distances of pairs of markers [m]. Raises InputError."""
    source = open_source(subject)
    before = source.measure()
    faults = [*_check_names(subject, source)]
    if faults:
        raise refuse(faults)
    factors, used = _find_factors(subject, source, before, distances)
    masses = osim.Masses(subject.mass, subject.keeps_distribution)
    scaled = source.scale(factors, masses)
    if TABLE in subject.steps and subject.segments:
        scaled = scaled.weigh({**_weigh_rest(subject, scaled), **_weigh_segments(subject, scaled)})
    ratios = _compare_lines(before, scaled.measure())
    kept = [
        f"{place}: the lengths of {name} are kept, as its line is not computed" for place, name in source.list_kept()
    ]
    old, new = source.masses, scaled.masses
    return Scaled(
        source=scaled.scale_lines(ratios),
        factors=factors,
        distances=tuple(used),
        weights=tuple(Weight(name, old[name], new[name]) for name in source.bodies),
        lines=ratios,
        notices=(*subject.notices, *kept),
    )


def place_markers(subject: Subject, scaled: Scaled, joints: Mapping[str, float], places: Mapping[str, Array]) -> Scaled:
    """Move markers to places, (3,) [m], where joints have these coordinates."""
    placing = subject.placing
    assert placing is not None, "the settings place markers"
    posed = scaled.source.measure(joints)
    shifts = {
        name: posed.attitudes[name].T @ (places[name] - posed.places[name])
        for name in scaled.markers
        if name in places and name not in placing.fixed
    }
    return replace(scaled, source=scaled.source.place(shifts))


def _compare_lines(before: Posed, after: Posed) -> dict[str, float]:
    return {name: after.lengths[name] / x for name, x in before.lengths.items() if x > 0}


def _check_names(subject: Subject, source: Source) -> Iterator[Fault]:
    """Find names of bodies and markers that the model does not have."""
    bodies: list[tuple[Place, str]] = []
    markers: list[tuple[Place, str]] = []
    if MEASUREMENTS in subject.steps:
        for name, x in subject.measurements.items():
            bodies += [(("measurements", name, "bodies", body), body) for body in x.axes]
            markers += [
                (("measurements", name, "pairs", k), marker) for k, pair in enumerate(x.pairs) for marker in pair
            ]
    if FACTORS in subject.steps:
        bodies += [(("factors", body), body) for body in subject.factors]
    for body, segment in subject.segments.items():
        bodies += [(("segments", body), body)]
        bodies += [(("segments", body, "end"), segment.end)] if segment.end else []
    if subject.placing is not None:
        markers += [(("markers", "fixed", k), marker) for k, marker in enumerate(subject.placing.fixed)]
    for kind, found, known in (("body", bodies, source.bodies), ("marker", markers, source.markers)):
        for place, name in found:
            if name not in known:
                meant = nearest(name, list(known))
                remedy = f"did you mean {abbreviate(meant)}?" if meant else f"there are {_list_some(known)}"
                yield subject.fault(place, f"the model has no {kind} {abbreviate(name)}", remedy)


def _list_some(names: Sequence[str]) -> str:
    return (", ".join(names[:8]) or "none") + (", ..." if len(names) > 8 else "")


def _find_factors(
    subject: Subject, source: Source, posed: Posed, distances: Mapping[tuple[str, str], float]
) -> tuple[dict[str, Triple], list[Distance]]:
    """Find the factors of all bodies, step by step."""
    factors = dict.fromkeys(source.bodies, WHOLE)
    used: list[Distance] = []
    for step in subject.steps:
        if step == TABLE:
            for body, segment in subject.segments.items():
                if segment.end:
                    factors[body] = _stretch(subject, body, segment, posed)
        elif step == MEASUREMENTS:
            for name, x in subject.measurements.items():
                found = [*_measure(subject, name, x, posed, distances)]
                used += found
                ratio = float(np.mean([each.subject / each.model for each in found])) if found else 1.0
                for body, axes in x.axes.items():
                    factors[body] = _set_axes(factors[body], ratio, axes)
        else:
            factors |= subject.factors
    return factors, used


def _set_axes(old: Triple, factor: float, axes: str) -> Triple:
    x, y, z = (factor if axis in axes else before for axis, before in zip("xyz", old, strict=True))
    return x, y, z


def _measure(
    subject: Subject, name: str, x: Measurement, posed: Posed, distances: Mapping[tuple[str, str], float]
) -> Iterator[Distance]:
    for k, pair in enumerate(x.pairs):
        model = float(np.linalg.norm(posed.places[pair[0]] - posed.places[pair[1]]))
        if model < SHORT:
            place = ("measurements", name, "pairs", k)
            raise refuse([subject.fault(place, f"both are {model:g} m apart in the model", "give a longer distance")])
        yield Distance(name, pair, model, distances[pair])


# --- the table -------------------------------------------------------------------------------------------------------


def _read_figures(subject: Subject, segment: Segment) -> tuple[Figures, float]:
    """Return the figures of a segment, and its length in the subject [m]."""
    assert subject.height is not None, "settings of segments have a height"
    figures = TABLES[subject.sex][segment.name]
    return figures, figures.length * subject.height / STATURES[subject.sex]


def _find_end(body: str, segment: Segment, posed: Posed) -> Array:
    """Return the other end of a segment, in the body's frame [m]."""
    found: Array = posed.attitudes[body].T @ (posed.places[segment.end] - posed.places[body])
    return found


def _stretch(subject: Subject, body: str, segment: Segment, posed: Posed) -> Triple:
    """Return the factors by which a body gets the length of its segment."""
    end, length = _find_end(body, segment, posed), _read_figures(subject, segment)[1]
    along = "xyz".index(segment.along[-1])
    if segment.across:
        size = float(np.linalg.norm(end))
        if size > SHORT:
            return _set_axes(WHOLE, length / size, "xyz")
    rest = length**2 - float(end @ end - end[along] ** 2)
    if abs(end[along]) <= SHORT or rest <= 0:
        finding = f"{abbreviate(segment.end)} lies beside the axis {segment.along}, at {_show(end)} m"
        raise refuse([subject.fault(("segments", body), finding, "give the axis `along` to it, or leave `end` out")])
    return _set_axes(WHOLE, math.sqrt(rest) / abs(float(end[along])), segment.along[-1])


def _show(vector: Array) -> str:
    return f"[{', '.join(f'{x:.3g}' for x in vector)}]"


def _weigh_segments(subject: Subject, scaled: Source) -> dict[str, Solid]:
    """Return the solids of bodies that are segments."""
    assert subject.mass is not None, "settings of segments have a mass"
    posed, found = scaled.measure(), {}
    for body, segment in subject.segments.items():
        figures, length = _read_figures(subject, segment)
        mass = figures.mass * subject.mass
        centre = figures.centre * _find_end(body, segment, posed) if segment.end else None
        forward, along = ("xyz".index(x[-1]) for x in (segment.forward, segment.along))
        radii = {forward: figures.sagittal, along: figures.longitudinal, 3 - forward - along: figures.transverse}
        moments = tuple(mass * (radii[k] * length) ** 2 for k in range(3))
        found[body] = Solid(mass, centre, (*moments, 0.0, 0.0, 0.0))
    return found


def _weigh_rest(subject: Subject, scaled: Source) -> dict[str, Solid]:
    """Return the other bodies with masses by which the sum is the subject's, where the table leaves them any."""
    assert subject.mass is not None, "settings of segments have a mass"
    own = sum(TABLES[subject.sex][x.name].mass for x in subject.segments.values()) * subject.mass
    rest = {name: x for name, x in scaled.masses.items() if name not in subject.segments and x > 0}
    left = subject.mass - own
    if not rest:
        return {}
    if left <= 0:
        finding = f"the segments have {own:.6g} kg of {subject.mass:.6g} kg, and {', '.join(rest)} none"
        raise refuse([subject.fault(("segments",), finding, "name fewer segments, or bodies for all masses")])
    ratio = left / sum(rest.values())
    return {name: Solid(x * ratio, None, None) for name, x in rest.items()}
