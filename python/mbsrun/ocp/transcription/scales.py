"""The usual sizes of a program's variables: guess and bounds -> a scale for each, 1 where it is near that.

Variables of a mechanism, in metres and radians, have none: a guess at rest says nothing of their sizes. All variables
of one quantity that a problem adds (a state, a control, an unknown, the horizon) have one scale. It is the largest of
its guess, but at least a thousandth of its largest bound, and at most that bound. Open states and controls that are
guessed as 0 have the sizes that rates give: see `state_guess.size_states`. Between LEAST and MOST the scale is 1, so
problems in units that suit them are solved as they are; else it is a power of 2, by which numbers are divided without
rounding. Scales of rows follow from their first derivatives by the scaled variables: see `csrc/stages/solve.c`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.transcription.transcription import Transcription

LEAST, MOST = 1e-1, 1e1  # sizes that need no scale
NOTHING = 1e-9  # guesses below this are zeros that rounded
SHARE = 1e-3  # of a bound: a guess may be smaller by chance


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
    for group in _list_groups(own):
        scales[group] = round_scale(float(guess[group].max()), limits[group])
    return scales[kept]


def round_scale(largest: float, limits: Array) -> float:
    """Return the scale of variables with a largest guess and the magnitudes of their bounds, infinite where open."""
    known = limits[np.isfinite(limits) & (limits > 0)]
    bound = float(known.max()) if known.size else np.inf
    found = largest if bound == np.inf else min(max(largest, SHARE * bound if largest else bound), bound)
    if not np.isfinite(found) or found < NOTHING or LEAST <= found <= MOST:
        return 1.0
    return float(2.0 ** np.round(np.log2(found)))


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
