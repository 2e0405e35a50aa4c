"""Steps of a fixed length through a piece of the inputs, and the words for poses at which no step goes on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mbsrun.kernel import KernelError, Place
from mbsrun.simulation.course import Course
from mbsrun.simulation.drive import Piece
from mbsrun.simulation.dynamics import SingularError
from mbsrun.simulation.motion import Halt

Array = NDArray[np.float64]

DEPENDENT = "the accelerations cannot be computed here: its equations depend on others, at a singular pose"
LENGTHS = 100  # steps at least of a motion with inputs or driven joints that vary
SINGULAR = "the accelerations cannot be computed here: the mass matrix is singular, or has lost its digits"


def count_steps(piece: Piece, step: float) -> int:
    """Count the equal steps of a piece; none is longer than requested, except by rounding."""
    return max(1, int(np.ceil((piece.end - piece.start) / step * (1 - 1e-12))))


def find_longest(duration: float, piece: Piece, course: Course) -> float:
    """Return the longest step that may be taken by a tolerance.

    While nothing moves, inputs may vary, and errors of steps do not show it.
    """
    return np.inf if piece.is_constant and course.is_constant else duration / LENGTHS


def place_steps(piece: Piece, numbers: NDArray[np.intp], count: int) -> Array:
    """Return the times after `numbers` of `count` steps; the last is exactly the piece's end."""
    times = piece.start + (piece.end - piece.start) / count * numbers
    return np.where(numbers == count, piece.end, times)


def sample(piece: Piece, times: Array) -> Array:
    """Return the inputs at times of a piece, (K, m); one row where they are constant."""
    return np.ascontiguousarray(piece.values(times[:1] if piece.is_constant else times))


def describe_singularity(place: Place | KernelError | SingularError, time: float) -> Halt:
    """Describe accelerations that cannot be computed."""
    remedy = "start elsewhere, or keep away from this configuration"
    if isinstance(place, SingularError) or place.loop is None:
        return Halt(time, place.joint, SINGULAR, remedy)
    return Halt(time, None, DEPENDENT, remedy, loop=place.loop)
