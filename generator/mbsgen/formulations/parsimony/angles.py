"""Absolute angles: forces, accelerations and M of groups of parallel axes, from and to the joints' own angles.

The coordinate of a body that continues a group is its angle to the frame before the group, p. Then q = T p with T of
1 and -1: the own angle is the body's less its predecessor's. Forces of p are TT Q, and M of q is T^-T M T^-1. A joint
that counts its angle by itself, as one with a rotor does, keeps it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mbsgen.formulations.parsimony.elimination import Entries
from mbsgen.formulations.parsimony.segments import Segment
from mbsgen.tape.builder import Scalar


def absolute_forces(segments: Sequence[Segment], Q: Sequence[Scalar]) -> list[Scalar]:
    """Return the forces of absolute angles: a joint's own, less the forces of joints that continue its group."""
    along = [s.signed(force) for s, force in zip(segments, Q, strict=True)]
    forces = list(along)
    for s in segments:
        if not s.counts_angle:
            forces[s.parent - 1] = forces[s.parent - 1] - along[s.number - 1]
    return forces


def relative_acceleration(segment: Segment, x: Mapping[int, Scalar]) -> Scalar:
    """Return a joint's acceleration, from the accelerations of absolute angles by number."""
    own = x[segment.number]
    return segment.signed(own if segment.counts_angle else own - x[segment.parent])


def relative_entries(segments: Sequence[Segment], absolute: Entries) -> Entries:
    """Return one triangle of M in the joints' own angles: a body carries what continues its group, from the leaves."""
    M = dict(absolute)

    def place(i: int, j: int) -> tuple[int, int]:
        return (i, j) if i < j else (j, i)

    def add(i: int, j: int, value: Scalar) -> None:
        at = place(i, j)
        M[at] = M[at] + value if at in M else value

    for s in reversed(segments):
        if s.counts_angle:
            continue
        row = {k.number: M[place(s.number, k.number)] for k in segments if place(s.number, k.number) in M}
        crossing = row.pop(s.parent)
        add(s.parent, s.parent, crossing + (crossing + row[s.number]))
        for k, value in row.items():
            add(s.parent, k, value)
    return {(i, j): value if segments[i - 1].sense == segments[j - 1].sense else -value for (i, j), value in M.items()}
