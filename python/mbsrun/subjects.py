"""A subject's recordings and settings -> the model scaled to it, its pose in the recording, and errors of markers.

Distances of pairs of markers are means over a span of time, and so are places of markers. The scaled model is fitted to
the places by least squares (`recordings.fitting`); markers then move to where the subject has them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mbsgen.documents import refuse
from mbsgen.errors import Fault, InputError
from mbsgen.style import PALETTE, save_plot, styled
from mbsrun.external import Mechanism, load
from mbsrun.models import import_robot, place_markers, read_subject, scale_subject
from mbsrun.recordings import AXES, Recording, read_column, read_recording
from mbsrun.recordings.fitting import FITTED, Fitter, Targets

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Marker:
    """A marker of the scaled model in the pose that fits best."""

    name: str
    weight: float
    error: float  # distance from the subject's, before it moves [m]
    left: float  # and after [m]


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model fitted to a subject."""

    scaled: Any  # an mbsgen.subjects.scaling.Scaled
    markers: tuple[Marker, ...] = ()
    pose: Mapping[str, float] = field(default_factory=dict)  # of coordinates of the file [rad, m]
    converged: bool = True
    undetermined: tuple[str, ...] = ()  # coordinates that the markers leave open
    notices: tuple[str, ...] = ()


def fit_subject(path: Path) -> Fitted:
    """Scale, and place markers, by a file of settings. Raises InputError with every fault."""
    subject = read_subject(path)
    recordings = _Recordings(subject, path.parent)
    distances = recordings.measure()
    scaled = scale_subject(subject, distances)
    notices = scaled.notices
    if subject.placing is None:
        return Fitted(scaled, notices=notices)
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"scaled{scaled.suffix}"
        file.write_text(scaled.text, encoding="utf-8")
        return _Placing(subject, scaled, recordings.average(), file).run()


class _Recordings:
    """Reads means of recorded markers."""

    def __init__(self, subject: Any, folder: Path) -> None:
        self._subject, self._folder = subject, folder

    def measure(self) -> dict[tuple[str, str], float]:
        """Return the mean distances of all pairs [m]."""
        subject = self._subject
        if not subject.pairs:
            return {}
        if not subject.recording:
            raise refuse([subject.fault(("recording",), "no recording of the distances", "name one")])
        recording = self._read(("recording",), subject.recording, ("times",), subject.times)
        faults = [*self._find_missing(recording)]
        if faults:
            raise refuse(faults)
        places = {name: _read_marker(recording, name) for pair in subject.pairs for name in pair}
        found = {}
        for a, b in subject.pairs:
            steps = np.linalg.norm(places[a] - places[b], axis=1)
            if not np.isfinite(steps).any():
                fault = subject.fault(("measurements",), f"{a} and {b} are never seen together", "give other markers")
                raise refuse([fault])
            found[a, b] = float(np.nanmean(steps))
        return found

    def _find_missing(self, recording: Recording) -> Iterator[Fault]:
        for name, x in self._subject.measurements.items():
            for k, pair in enumerate(x.pairs):
                for marker in pair:
                    if marker not in recording.markers:
                        known = ", ".join(recording.markers[:8]) or "none"
                        finding = f"{recording.file} has no marker {marker!r}"
                        yield self._subject.fault(("measurements", name, "pairs", k), finding, f"there are {known}")

    def average(self) -> dict[str, Array]:
        """Return the mean places of the markers that are placed [m]."""
        placing = self._subject.placing
        recording = self._read(("markers", "recording"), placing.recording, ("markers", "times"), placing.times)
        found = {}
        for name in recording.markers:
            rows = _read_marker(recording, name)
            seen = rows[np.isfinite(rows).all(axis=1)]
            if len(seen):
                found[name] = seen.mean(axis=0)
        return found

    def _read(
        self, place: tuple[str, ...], name: str, span_place: tuple[str, ...], span: tuple[float, float] | None
    ) -> Recording:
        path = self._folder / name
        if not path.is_file():
            fault = self._subject.fault(place, f"there is no file {str(path)!r}", "name one, relative to this file")
            raise refuse([fault])
        recording = read_recording(path)
        first, last = recording.times[[0, -1]]
        kept = recording if span is None else recording.cut(*span)
        if not len(kept.times):
            finding = f"no sample lies in it; the recording is from {first:g} to {last:g} s"
            raise refuse([self._subject.fault(span_place, finding, "give times of the recording")])
        return kept


def _read_marker(recording: Recording, name: str) -> Array:
    """Return the places of a marker, (K, 3) [m]."""
    return np.column_stack([read_column(recording, f"{axis}[{name}]", "m") for axis in AXES])


class _Placing:
    """Finds the pose, and moves markers."""

    def __init__(self, subject: Any, scaled: Any, places: Mapping[str, Array], file: Path) -> None:
        self._subject, self._scaled, self._places, self._file = subject, scaled, places, file
        self._notices = [*scaled.notices]

    def run(self) -> Fitted:
        """Fit the pose, and place the markers in it."""
        weights = self._choose()
        mechanism, warnings = self._load()
        targets = self._aim(mechanism, weights)
        fit = Fitter(mechanism, targets).fit()
        pose = dict(zip(mechanism.manifest.positions, fit.q[0].tolist(), strict=True))
        placed = place_markers(self._subject, self._scaled, pose, self._places)
        errors = self._measure(mechanism, fit.q[0])
        fixed = set(self._scaled.source.list_fixed()) | set(self._subject.placing.fixed)
        markers = tuple(
            Marker(name, weights.get(name, 0.0), error, error if name in fixed else 0.0)
            for name, error in errors.items()
        )
        undetermined = [x for x, is_open in zip(pose, fit.is_undetermined[0], strict=True) if is_open]
        shown = self._scaled.source.list_coordinates(pose)
        return Fitted(
            placed, markers, shown, bool(fit.converged.all()), tuple(undetermined), (*warnings, *self._notices)
        )

    def _load(self) -> tuple[Mechanism, Sequence[str]]:
        """Load the scaled model with its markers as sensors."""
        if self._file.suffix == ".yaml":
            return load(self._file, extent=FITTED), ()
        model, warnings = import_robot(self._file, {"sensors": self._scaled.markers})
        return load(model, extent=FITTED), warnings

    def _choose(self) -> dict[str, float]:
        """Return the weights of markers that the model and the recording have."""
        placing = self._subject.placing
        both = [name for name in self._scaled.markers if name in self._places]
        if not both:
            finding = f"no marker of the model is recorded; it has {', '.join(self._scaled.markers[:8]) or 'none'}"
            raise InputError([self._subject.fault(("markers",), finding, "rename markers, in one of the files")])
        for name in placing.weights:
            if name not in both:
                owner = "the model" if name not in self._scaled.markers else "the recording"
                fault = self._subject.fault(("markers", "weights", name), f"{owner} has no such marker", "left out")
                self._notices.append(str(fault))
        lost = [name for name in self._scaled.markers if name not in self._places]
        if lost:
            self._notices.append(f"markers stay, since they are not recorded: {', '.join(lost)}")
        return {name: w for name in both if (w := placing.weights.get(name, placing.rest)) > 0}

    def _aim(self, mechanism: Mechanism, weights: Mapping[str, float]) -> Targets:
        """Return the markers and the coordinates to fit."""
        sensors = [frame.name for frame in mechanism.manifest.frames if frame.sensor]
        labels = self._scaled.source.list_sensors()
        chosen = {labels.get(name, name): k for k, name in enumerate(sensors)}
        goals: dict[str, tuple[float, float]] = {}
        for name, (weight, value) in self._subject.placing.coordinates.items():
            joint = self._scaled.source.find_joint(name, None if math.isnan(value) else value)
            if joint is None:
                place = ("markers", "coordinates", name)
                raise refuse([self._subject.fault(place, f"the model has no coordinate {name!r}", "name one of it")])
            total = sum(weights.values()) if self._subject.placing.is_mean else 1.0
            goals[joint[0]] = (weight * total * joint[2] ** 2, joint[1])
        positions = mechanism.manifest.positions
        kept = {name: x for name, x in goals.items() if name in positions and x[0] > 0}
        return Targets(
            times=np.zeros(1),
            sensors=tuple(chosen[name] for name in weights),
            markers=np.array([self._places[name] for name in weights]).reshape(1, -1, 3),
            marker_weights=np.array([*weights.values()]),
            coordinates=tuple(positions.index(name) for name in kept),
            values=np.array([[x[1] for x in kept.values()]]),
            value_weights=np.array([x[0] for x in kept.values()]),
        )

    def _measure(self, mechanism: Mechanism, q: Array) -> dict[str, float]:
        """Return the distances of all recorded markers from the model's [m]."""
        found = mechanism("sensors", q=q)["position"].T
        labels = self._scaled.source.list_sensors()
        sensors = [labels.get(x.name, x.name) for x in mechanism.manifest.frames if x.sensor]
        return {
            name: float(np.linalg.norm(place - self._places[name]))
            for name, place in zip(sensors, found, strict=True)
            if name in self._places
        }


@styled
def plot_subject(fitted: Fitted, title: str, path: Path) -> None:
    """Draw the factors of bodies, and the errors of markers before they move."""
    factors = {name: x for name, x in fitted.scaled.factors.items() if x != (1.0, 1.0, 1.0)}
    panels = 1 + bool(fitted.markers)
    rows = max(len(factors), len(fitted.markers), 4)
    figure = Figure(figsize=(4.5 * panels, 1.2 + 0.24 * rows), layout="constrained")
    axes = figure.subplots(1, panels, squeeze=False)[0]
    for k, axis in enumerate("xyz"):
        places = np.arange(len(factors)) + 0.25 * (k - 1)
        axes[0].barh(places, [x[k] - 1 for x in factors.values()], 0.22, left=1, color=PALETTE[k], label=axis)
    axes[0].axvline(1, color="#5d6b7a", linewidth=0.8)
    axes[0].set_yticks(range(len(factors)), [*factors])
    axes[0].set_xlabel("factor")
    axes[0].legend()
    if fitted.markers:
        shown = sorted(fitted.markers, key=lambda x: (x.error, x.name))
        colors = [PALETTE[0] if x.weight else PALETTE[7] for x in shown]
        axes[1].barh([x.name for x in shown], [1e3 * x.error for x in shown], color=colors)
        axes[1].set_xlabel("error of markers before they move [mm]")
    for each in axes:
        each.grid(alpha=0.3, axis="x")
    figure.suptitle(title)
    save_plot(figure, path)
