"""A film: what a picture of motions shows, and where it is at each time; independent of how it is drawn.

`page` makes a page for a browser of a film, `raster` draws its pictures one by one. Lengths are in m, in the base frame
or in the frame that is named; -1 is the base.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Frame, Point

Array = NDArray[np.float64]
Triple = tuple[float, float, float]


class Layer(StrEnum):
    """A group of solids that is shown or hidden together."""

    SOLIDS = "solids"  # sized from inertia
    MESHES = "meshes"
    JOINTS = "joints"
    CONTACTS = "contacts"


class Kind(StrEnum):
    """A shape, with the meaning of its size."""

    BOX = "box"  # edges
    ELLIPSOID = "ellipsoid"  # axes
    CYLINDER = "cylinder"  # diameter, diameter, length; along its z
    MESH = "mesh"  # scales


class Course(StrEnum):
    """A kind of line between two points."""

    ROD = "rod"
    GAP = "gap"  # between points that coincide where a loop is closed
    SPRING = "spring"
    CABLE = "cable"


class Force(StrEnum):
    """A kind of arrow."""

    FORCE = "force"
    MOMENT = "moment"


@dataclass(frozen=True)
class Solid:
    """A shape that is fixed in a frame."""

    layer: Layer
    frame: int
    kind: Kind
    size: Triple
    color: str  # "#rrggbb"
    at: Triple = (0.0, 0.0, 0.0)
    axes: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)  # one after the other, in the frame
    mesh: int | None = None  # index in the film's meshes


@dataclass(frozen=True)
class Line:
    """A line between two points."""

    kind: Course
    ends: tuple[Point, Point]


@dataclass(frozen=True)
class Actor:
    """A mechanism as it is drawn."""

    name: str
    color: str  # of its edges
    frames: tuple[Frame, ...]
    solids: tuple[Solid, ...]
    lines: tuple[Line, ...]
    floating: frozenset[int] = frozenset()  # frames to which no edge is drawn
    size: float = 1.0  # of the mechanism at one time [m]


@dataclass(frozen=True, eq=False)
class Arrow:
    """A force or a moment over time."""

    kind: Force
    foot: Point
    in_base: bool  # its components; else in the frame of its foot
    values: Array  # (K, 3) [N or N m]
    scale: float = 1.0  # m in the picture, for 1 N or 1 N m


@dataclass(frozen=True, eq=False)
class Track:
    """The poses of an actor's frames, and its arrows, over the film's times."""

    p: Array  # (K, F, 3)
    R: Array  # (K, F, 3, 3), axes as columns
    arrows: tuple[Arrow, ...] = ()
    shown: tuple[float, float] | None = None  # the actor is seen from the first time to before the other; None: always


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface of triangles."""

    vertices: NDArray[np.float32]  # (V, 3) [m]
    faces: NDArray[np.uint32]  # (T, 3)


@dataclass(frozen=True)
class Marker:
    """A point to show, such as a target; in the base frame, m."""

    name: str
    position: Triple


@dataclass(frozen=True)
class Plane:
    """A plane to show; the one with a grid is the ground, on which shadows fall."""

    at: Triple
    normal: Triple
    grid: bool = False


@dataclass(frozen=True)
class View:
    """The direction from which a film is first seen: angles about the vertical and above the horizon [rad]."""

    azimuth: float = -0.9
    elevation: float = 0.35


@dataclass(frozen=True, eq=False)
class Film:
    """Motions of mechanisms over common times."""

    title: str
    times: Array  # (K,)
    actors: tuple[Actor, ...]
    tracks: tuple[Track, ...]  # of the actors
    up: Triple
    low: Triple  # the bounds of everything that moves
    high: Triple
    hull: tuple[Triple, ...]  # points of it that lie farthest out
    thickness: float  # radius of an edge
    view: View = View()
    planes: tuple[Plane, ...] = ()
    markers: tuple[Marker, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    parts: tuple[tuple[str, float], ...] = ()  # names of the parts, such as phases, and when they begin
    is_apart: bool = False  # actors stand side by side

    @property
    def is_sequence(self) -> bool:
        """Return whether actors are shown one after the other, as parts of one motion."""
        return any(track.shown is not None for track in self.tracks)

    @property
    def has_visuals(self) -> bool:
        """Return whether bodies have given shapes; edges are hidden then."""
        return any(solid.layer is Layer.MESHES for actor in self.actors for solid in actor.solids)

    @property
    def size(self) -> float:
        """Return the length of the diagonal of the bounds."""
        return max(float(np.linalg.norm(np.subtract(self.high, self.low))), 1e-6)
