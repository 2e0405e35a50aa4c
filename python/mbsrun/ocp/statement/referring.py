"""References of a problem file: files of recordings -> columns that expressions and tracking costs read.

A column is looked up by the name that `columns` gives it, or by its own, written as an identifier. Only columns that
are read become part of a problem. `cost.track` becomes running terms, a squared distance for each coordinate or marker:

    known (q - ref)^2,    known ((x - ref_x)^2 + (y - ref_y)^2 + (z - ref_z)^2)
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mbsgen.documents import Place, abbreviate, nearest
from mbsgen.errors import InputError
from mbsgen.expressions import is_free_name
from mbsgen.manifest import Manifest
from mbsrun.ocp.problem.problem import Term
from mbsrun.ocp.statement.sections import ReferenceSection, TrackSection
from mbsrun.quantities import list_quantities
from mbsrun.reading import Reading, relate
from mbsrun.recordings import (
    AXES,
    Recording,
    SplineError,
    Track,
    Treatment,
    find_column,
    fit,
    name_coordinate,
    read_column,
    read_recording,
    spell,
)
from mbsrun.recordings.recording import UNITS
from mbsrun.recordings.references import Reference, list_unknown, name_known, name_value

_UNIT = re.compile(r"(?P<name>.*\S)\s+\[(?P<unit>[^\[\]]*)\]")


@dataclass
class _Source:
    """A recording, the names of its columns in expressions, and the columns that were read."""

    recording: Recording
    treatment: Treatment
    start: float
    end: float
    is_normalised: bool
    columns: Mapping[str, tuple[str, str]]  # by the name in expressions: name, and unit if one is stated
    used: dict[str, Track] = field(default_factory=dict)


class Referring:
    """Reads the references of a problem file; faults go to its reading."""

    def __init__(self, reading: Reading, manifest: Manifest, folder: Path) -> None:
        self.reading, self.manifest, self.folder = reading, manifest, folder
        self.sources: dict[str, _Source] = {}
        self.missing: set[str] = set()  # references of which no recording could be read
        self.units = {c.name: c.unit for c in manifest.coordinates}
        self.spelled = {(x.kind, x.index): name for name, x in list_quantities(manifest).items()}

    def read(self, sections: Mapping[str, ReferenceSection]) -> None:
        """Read the files."""
        for name, section in sections.items():
            place: Place = ("references", name)
            if not is_free_name(name):
                self.missing.add(name)
                self.reading.fault(place, "no name for a reference", "give a name that nothing else has")
                continue
            try:
                recording = read_recording(self.folder / section.file)
            except InputError as error:
                self.missing.add(name)
                self.reading.faults += relate(error.faults, self.reading.document, (*place, "file"))
                continue
            self.sources[name] = self.source(place, section, recording)
        known = list(self.list_names())
        for name in sorted({x for x in known if known.count(x) > 1 or x in self.reading.constants}):
            finding = f"{name} has two meanings"
            self.reading.fault(("references",), finding, "rename a reference, a column, or a constant")

    def source(self, place: Place, section: ReferenceSection, recording: Recording) -> _Source:
        """Check the settings of a reference."""
        number, tiny = self.reading.number, float(np.nextafter(0, 1))
        first, last = float(recording.times[0]), float(recording.times[-1])
        noise, cutoff = (
            None if given is None else number((*place, key), given, least=tiny)
            for key, given in (("noise", section.noise), ("cutoff", section.cutoff))
        )
        start, end = (
            usual if given is None else number((*place, key), given)
            for key, given, usual in (("start", section.start, first), ("end", section.end, last))
        )
        if start >= end:
            self.reading.fault((*place, "start"), f"{start:g} is not before the end, {end:g}", "give an earlier one")
        if section.end is not None and section.time == "seconds":
            self.reading.fault((*place, "end"), "the horizon gives the end", "leave it out, or take time: normalised")
        return _Source(
            recording=recording,
            treatment=Treatment(section.degree, noise, number((*place, "gap"), section.gap, least=0), cutoff),
            start=start,
            end=end,
            is_normalised=section.time == "normalised",
            columns=self.columns(place, section, recording),
        )

    def columns(self, place: Place, section: ReferenceSection, recording: Recording) -> Mapping[str, tuple[str, str]]:
        """Name the columns: as the section does, or all of them by their own names."""
        if not section.columns:
            return {spell(name): (name, "") for name in reversed(recording.names)}
        found = {}
        for key, text in section.columns.items():
            stated = _UNIT.fullmatch(text)
            name, unit = (text, "") if stated is None or text in recording.names else (stated["name"], stated["unit"])
            inner = (*place, "columns", key)
            if not re.fullmatch(r"\w+", key, re.ASCII):
                self.reading.fault(inner, "no name for a column", "give letters, digits and _")
            if unit and unit not in UNITS:
                self.reading.fault(inner, f"unknown unit {abbreviate(unit)}", f"give one of {', '.join(UNITS)}")
            elif name not in recording.names:
                meant = nearest(name, recording.names)
                remedy = f"did you mean {abbreviate(meant)}?" if meant else f"there are {_list(recording.names)}"
                self.reading.fault(inner, f"the recording has no column {abbreviate(name)}", remedy)
            else:
                found[key] = (name, unit)
        return found

    def find(self, place: Place, name: str) -> bool:
        """Return whether a name of an expression is a reference's; note that it is read, or report why it cannot be."""
        for prefix in ("ref_", "known_"):
            for key, source in self.sources.items():
                column = name.removeprefix(f"{prefix}{key}_")
                if column != name and column in source.columns:
                    self.use(place, key, column)
                    return True
            if any(name.startswith(f"{prefix}{key}_") for key in self.missing):
                return True
        return False

    def list_names(self) -> Iterator[str]:
        """List the names that expressions may read."""
        for key, source in self.sources.items():
            for column in source.columns:
                yield from (name_value(key, column), name_known(key, column))

    def use(self, place: Place, key: str, column: str, unit: str = "") -> Track | None:
        """Fit splines to a column; return None where that is at fault."""
        source = self.sources[key]
        if column in source.used:
            return source.used[column]
        name, stated = source.columns[column]
        unit = unit or self.find_unit(column, name)
        known = source.recording.columns[source.recording.names.index(name)].unit
        try:
            if stated:
                si, factor = UNITS[stated]
                if known or (unit and unit != si):
                    finding = f"{abbreviate(name)} is stated to be in {stated}"
                    self.reading.fault(place, finding, f"it is in {known or unit}: leave its unit out")
                    return None
                values = source.recording.column(name) * factor
            elif not known and not unit and source.recording.in_degrees is not False:
                finding = f"the unit of {abbreviate(name)} is open: an angle may be in degrees"
                self.reading.fault(place, finding, f"write it under columns: {column}: {name} [deg]")
                return None
            else:
                values = read_column(source.recording, name, unit)
            source.used[column] = fit(source.recording.times, values, source.treatment)
        except InputError as error:
            self.reading.faults += error.faults
        except SplineError as error:
            self.reading.fault(place, f"{abbreviate(name)}: {error.finding}", error.remedy)
        return source.used.get(column)

    def find_unit(self, column: str, name: str) -> str:
        """Return the unit of a column that has the name of a coordinate."""
        for coordinate, unit in self.units.items():
            if name in name_coordinate(coordinate) or column in (coordinate, f"q_{coordinate}"):
                return unit
        return ""

    def references(self) -> tuple[Reference, ...]:
        """Return the references, with the columns that were read."""
        return tuple(
            Reference(name, tuple(source.used.items()), source.start, source.end, source.is_normalised)
            for name, source in self.sources.items()
            if source.used
        )

    # --- tracking ---

    def track(self, i: int, section: TrackSection, horizon: float) -> tuple[Term, ...]:
        """Return the terms of a tracking cost."""
        place: Place = ("cost", "track", i)
        source = self.sources.get(section.reference)
        if source is None:
            if section.reference not in self.missing:
                known = list(self.sources)
                self.reading.find((*place, "reference"), section.reference, known, "reference", "problem")
            return ()
        weight = self.reading.number((*place, "weight"), section.weight, least=0)
        weights = {
            name: self.reading.number((*place, "weights", name), value, least=0)
            for name, value in section.weights.items()
        }
        terms = [
            Term(text, weight * weights.get(name, 1.0), f"track {section.reference}: {name}")
            for name, text in (
                *self.list_coordinates(place, section, source, horizon),
                *self.list_markers(place, section, source, horizon),
            )
        ]
        named = [*section.coordinates, *section.markers]
        if not named:
            self.reading.fault(place, "nothing is tracked", "give coordinates or markers")
        for name in section.weights:
            if name not in named:
                self.reading.fault((*place, "weights", name), "it is not tracked", f"there are {_list(named)}")
        return tuple(terms)

    def list_coordinates(
        self, place: Place, section: TrackSection, source: _Source, horizon: float
    ) -> Iterator[tuple[str, str]]:
        """Yield the name and the squared distance of each coordinate."""
        positions = self.manifest.positions
        for k, name in enumerate(section.coordinates):
            inner = (*place, "coordinates", k if isinstance(section.coordinates, tuple) else name)
            i = self.reading.find(inner, name, positions, "coordinate")
            if i is None:
                continue
            wanted = (name, f"q_{spell(name)}", *map(spell, name_coordinate(name)))
            column = self.find_source(inner, section.coordinates, name, source, wanted)
            track = column and self.use(inner, section.reference, column, self.units.get(name, ""))
            if column and track:
                square = f"({self.spelled['q', i]} - {name_value(section.reference, column)})**2"
                yield name, self.mind(square, section.reference, {column: track}, horizon)

    def list_markers(
        self, place: Place, section: TrackSection, source: _Source, horizon: float
    ) -> Iterator[tuple[str, str]]:
        """Yield the name and the squared distance of each marker."""
        sensors = [frame.name for frame in self.manifest.frames if frame.sensor]
        for j, name in enumerate(section.markers):
            inner = (*place, "markers", j if isinstance(section.markers, tuple) else name)
            i = self.reading.find(inner, name, sensors, "sensor")
            if i is None:
                continue
            marker = name if isinstance(section.markers, tuple) else section.markers[name]
            squares, tracks = [], {}
            for k, axis in enumerate(AXES):
                wanted = (f"{axis}_{spell(marker)}", spell(f"{axis}[{marker}]"))
                column = next((c for c in wanted if c in source.columns), None)
                track = column and self.use(inner, section.reference, column, "m")
                if column and track:
                    tracks[column] = track
                    squares.append(
                        f"({self.spelled['position', 3 * i + k]} - {name_value(section.reference, column)})**2"
                    )
                elif column is None:
                    finding = f"the reference has no column {axis}[{marker}]"
                    self.reading.fault(
                        inner, finding, f"give the marker's name; there are {_list(source.recording.markers)}"
                    )
            if len(squares) == len(AXES):
                yield name, self.mind(f"({' + '.join(squares)})", section.reference, tracks, horizon)

    def mind(self, square: str, key: str, tracks: Mapping[str, Track], horizon: float) -> str:
        """Multiply a squared distance by 0 where columns are unknown; columns with the same gaps need one factor."""
        source, factors = self.sources[key], dict[tuple[tuple[float, float], ...], str]()
        for column, track in tracks.items():
            reference = Reference(key, ((column, track),), source.start, source.end, source.is_normalised)
            unknown = list_unknown(reference, track, horizon)
            if unknown:
                factors.setdefault(unknown, f"{name_known(key, column)}*")
        return "".join(factors.values()) + square

    def find_source(
        self, place: Place, given: Sequence[str] | Mapping[str, str], name: str, source: _Source, usual: Sequence[str]
    ) -> str | None:
        """Find the column of a coordinate: the one that the section names, or one with a usual name."""
        if isinstance(given, Mapping):
            wanted: Sequence[str] = (given[name], spell(given[name]))
        else:
            own = find_column(source.recording, name_coordinate(name))
            wanted = (*usual, *(key for key, (column, _) in source.columns.items() if column == own))
        found = next((column for column in wanted if column in source.columns), None)
        if found is None:
            shown = given[name] if isinstance(given, Mapping) else name
            meant = nearest(shown, list(source.columns))
            remedy = f"did you mean {abbreviate(meant)}?" if meant else f"there are {_list(list(source.columns))}"
            self.reading.fault(place, f"the reference has no column for {abbreviate(shown)}", remedy)
        return found


def _list(names: Sequence[str]) -> str:
    return (", ".join(names[:8]) or "none") + (", ..." if len(names) > 8 else "")
