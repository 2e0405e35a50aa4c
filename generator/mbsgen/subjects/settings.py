"""The settings of a scaling, as values: measurements by markers, factors, segments of a table, masses, markers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mbsgen.documents import Place, write_path
from mbsgen.errors import Fault

Triple = tuple[float, float, float]
Span = tuple[float, float]

MEASUREMENTS, FACTORS, TABLE = "measurements", "factors", "table"  # steps, in the order in which they act


@dataclass(frozen=True)
class Measurement:
    """Distances of pairs of markers; the mean of their ratios, subject to model, is a factor."""

    pairs: tuple[tuple[str, str], ...]
    axes: Mapping[str, str]  # of bodies: the ones of x, y, z that the factor is for


@dataclass(frozen=True)
class Segment:
    """A segment of the table that a body is."""

    name: str  # in the table
    end: str = ""  # the body whose frame's origin is at the other end; "": the table gives no length
    along: str = "y"  # the axis of the body along the segment, in either way
    forward: str = "x"  # the axis forward
    across: bool = True  # whether the factor is for the other axes, too


@dataclass(frozen=True)
class Placing:
    """How markers are moved to where the subject has them, in the pose that fits best."""

    recording: str  # relative to the settings
    times: Span | None = None  # over which places are averaged [s]
    weights: Mapping[str, float] = field(default_factory=dict)  # of squared distances
    rest: float = 1.0  # the weight of markers that `weights` does not name
    coordinates: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # weights, and values [rad or m]
    is_mean: bool = (
        False  # weights of coordinates stand beside the mean of squared distances, as in OpenSim; else the sum
    )
    fixed: tuple[str, ...] = ()  # markers that stay, beside the ones of the file


@dataclass(frozen=True)
class Subject:
    """All settings of a scaling."""

    file: str
    lines: Mapping[Place, int]
    model: str  # relative to the settings
    recording: str = ""  # of the distances
    times: Span | None = None  # over which they are averaged [s]
    mass: float | None = None  # of the subject [kg]; None: what follows from the factors
    height: float | None = None  # [m]
    sex: str = ""
    keeps_distribution: bool = True  # of masses
    steps: tuple[str, ...] = (TABLE, MEASUREMENTS, FACTORS)
    measurements: Mapping[str, Measurement] = field(default_factory=dict)
    factors: Mapping[str, Triple] = field(default_factory=dict)
    segments: Mapping[str, Segment] = field(default_factory=dict)  # by body
    placing: Placing | None = None  # None: markers stay
    notices: tuple[str, ...] = ()  # parts of a file that have no counterpart

    def fault(self, place: Place, finding: str, remedy: str) -> Fault:
        """Make the fault of one place."""
        known = place
        while known and known not in self.lines:
            known = known[:-1]
        return Fault(self.file, self.lines.get(known, 0), write_path(place), finding, remedy)

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Return all pairs of markers whose distances are measured."""
        used = self.measurements.values() if MEASUREMENTS in self.steps else ()
        return tuple(dict.fromkeys(pair for x in used for pair in x.pairs))
