"""Functions to generate for motions, with the derivatives that these need: writing derivatives takes the longest."""

from __future__ import annotations

from mbsrun.models import Extent

# Evaluated and never differentiated: by explicit methods, at events, and where motions are differentiated.
VALUES = frozenset({"exp2", "semi", "energy", "power", "frames", "distances"})


def choose(*functions: str) -> Extent:
    """Return an extent with first derivatives, except of VALUES."""
    return Extent(functions, 1, values=tuple(name for name in functions if name in VALUES))
