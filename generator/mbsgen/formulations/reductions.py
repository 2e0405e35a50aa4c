"""Reductions: the transformations that lower the operation count. Each can be switched off."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Reductions:
    """The transformations to use. With all off, the recursions are the textbook's, in body frames."""

    regroup: bool = True  # move inertia that a joint cannot feel to the parent body
    share_frames: bool = True  # write consecutive bodies on parallel axes in one frame, and add up their angles
    lump: bool = True  # place free masses where terms vanish; divides by lengths and inertias that are numbers
    lump_runtime: bool = False  # ... and by run-time parameters, which must not be 0 then
    absolute: bool = True  # eliminate in absolute angles within groups of parallel axes
    meet: bool = True  # carry motions of joints up to inertia in M, instead of loads and inertia down
    together: bool = True  # eliminate joints near the base together in EXP2
    spin: bool = True  # take a body's field from its angular acceleration, where this takes fewer operations
    momentum: bool = True  # let the momentum of spin turn with the body before; second moments by rates
    rest: bool = True  # let joints of EXP2's bias motion rest: no acceleration along axes of joints eliminated alone
    series: bool = True  # put a point mass in series with the rotor between the two joints before it, in EXP2
    factor: bool = True  # take common factors out of sums
    share: bool = True  # compute common parts of sums and of products once
    order: bool = True  # add terms in the order in which they are ready: this saves time, not operations
    trials: int | None = None  # plans to try for each function; None: fewer for larger trees

    @property
    def is_textbook(self) -> bool:
        """Return whether the recursions are to be the textbook's."""
        return not (self.regroup or self.share_frames)


ALL = Reductions()
NONE = Reductions(
    regroup=False,
    share_frames=False,
    lump=False,
    absolute=False,
    meet=False,
    together=False,
    spin=False,
    momentum=False,
    rest=False,
    series=False,
    factor=False,
    share=False,
)
