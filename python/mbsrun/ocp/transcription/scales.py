"""The usual sizes of a program's variables: guess and bounds -> a scale for each, 1 where it is near that.

All variables of one quantity that a problem adds (a state, a control, an unknown, the horizon) have one scale. It is
the largest of its guess, but at least a thousandth of its largest bound, and at most that bound. Open states and
controls that are guessed as 0 have the sizes that rates give: see `guessing.sizes`. Variables of a mechanism, in metres
and radians, may rest in the guess. So each coordinate has the size of its guess or, if this is less, the size of all
coordinates together, which is at most 1; so have velocities, accelerations and inputs.

Near 1 the scale is 1, so problems in units that suit them are solved as they are; else it is a power of 2, by which
numbers are divided without rounding. Scales of rows follow from their first derivatives by the scaled variables: see
`csrc/stages/solve.c`. The cost of a program in scaled variables is multiplied by `scale_cost`, if its slopes by these
are far from 1.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.memory import Memory
from mbsrun.ocp.ground.program import Matrix
from mbsrun.ocp.transcription.transcription import Transcription

NEAR = (1e-1, 1e1)  # sizes that need no scale
USUAL = (1e-3, 1e3)  # the same of a mechanism
ROUNDED = 1e-9  # largest guesses of a mechanism that are zeros which rounded
SHARE = 1e-3  # of a bound: a guess may be smaller by chance
FLAT, STEEP = 1e-3, 1e2  # slopes of a cost that need no scale


def find_scales(own: Transcription, x: Array, bounds: tuple[Array, Array]) -> Array:
    """Return the scales of the variables that a solver sees, by their guess and their bounds."""
    size, kept = own.layout.size, own.program.kept
    guess, limits = np.zeros(size), np.full(size, np.inf)
    guess[kept] = np.abs(x)
    finite = [np.where(np.isfinite(bound), np.abs(bound), 0.0) for bound in bounds]
    limits[kept] = np.maximum(*finite)
    is_open = ~(np.isfinite(bounds[0]) & np.isfinite(bounds[1]))
    limits[kept[is_open]] = np.inf
    scales = np.ones(size)
    groups, moving = _GROUPS.find(lambda: (list(_list_groups(own)), list(_list_moving(own))), own)
    for group in groups:
        scales[group] = round_scale(float(guess[group].max()), limits[group])
    # coordinates round where loops or sensors give them; else they are the file's
    rounded = ROUNDED if own.closure is not None or own.structure.sensors else 0.0
    for groups in moving:  # coordinates first: rates of small ones are smaller
        largest = [float(guess[group].max(initial=0.0)) for group in groups]
        most = min(1.0, max(largest, default=0.0))
        common = most if most > rounded else 0.0
        for group, own_largest in zip(groups, largest, strict=True):
            scales[group] = round_scale(max(own_largest, common) if common else 0.0, limits[group], USUAL)
        rounded = ROUNDED * (common or 1.0)
    return scales[kept]


_GROUPS: Memory[tuple[list[Indices], list[list[Indices]]]] = Memory()


def round_scale(largest: float, limits: Array, near: tuple[float, float] = NEAR) -> float:
    """Return the scale of variables with a largest guess and the magnitudes of their bounds, infinite where open."""
    known = limits[np.isfinite(limits) & (limits > 0)]
    bound = float(known.max()) if known.size else np.inf
    found = largest if bound == np.inf else min(max(largest, SHARE * bound if largest else bound), bound)
    if not np.isfinite(found) or found == 0 or near[0] <= found <= near[1]:
        return 1.0
    return float(2.0 ** np.round(np.log2(found)))


def scale_cost(slope: float) -> float:
    """Return the factor, a power of 2, of a cost whose largest slope in scaled variables is given.

    Steep ones become as steep as is usual, as IPOPT scales them; flat ones, of which a tolerance sees nothing, 1.
    """
    if slope == 0 or FLAT <= slope <= STEEP:
        return 1.0
    return float(2.0 ** np.round(np.log2(STEEP / slope if slope > STEEP else 1 / slope)))


def find_terms(J: Matrix, scales: Array) -> Array:
    """Return the largest term of each row of derivatives by variables with scales."""
    largest, column = np.zeros(J.shape[0]), np.repeat(np.arange(J.shape[1]), np.diff(J.indptr))
    np.maximum.at(largest, J.indices, np.abs(J.data) * scales[column])
    return largest


def _list_groups(own: Transcription) -> Iterator[Indices]:
    """List the variables of each quantity that the problem adds."""
    layout, extras = own.layout, own.layout.extras
    for parts in (
        (extras.states, extras.nodes),
        (extras.controls, extras.point_controls),
        (layout.unknowns,),
        (layout.horizons,),
    ):
        for i in range(max(part.shape[-1] for part in parts)):
            yield np.concatenate([part[..., i].ravel() for part in parts if part.shape[-1]])


def _list_moving(own: Transcription) -> Iterator[list[Indices]]:
    """List the variables of coordinates, velocities, accelerations and inputs: of each entry, at meshes and points."""
    layout = own.layout
    mesh, points = (layout.split(part) for part in (layout.mesh, layout.points))
    for parts in (
        (mesh[0], points[0]),
        (mesh[1], points[1]),
        (layout.accelerations,),
        (layout.inputs, layout.point_inputs),
    ):
        sized = [part.reshape(-1, part.shape[-1]) for part in parts if part.shape[-1]]
        yield [*np.concatenate(sized).T] if sized else []
