"""Points of bodies in the base frame: links, velocities -> what forces read of them.

From the base to the leaves, with parent h, rotation R_i from body i to the base, and joint axis e,

    R_i = R_h R,    p_i = p_h + R_h dpt,    OM_i = OM_h + R_i e qd,    v_i = v_h + OM_h x R_h dpt

where a prismatic joint has R_i e qd in v_i instead of OM_i. A point r of body i has position p_i + R_i r and velocity
v_i + OM_i x R_i r.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mbsgen.algebra.vectors import Matrix, Vector
from mbsgen.formulations.links import Link
from mbsgen.model.tree import Reading
from mbsgen.tape.builder import Scalar


@dataclass(frozen=True)
class _Place:
    """The pose and the velocity of a body, in the base frame."""

    p: Vector[Scalar]
    R: Matrix[Scalar] | None  # None: the base's axes
    v: Vector[Scalar]
    OM: Vector[Scalar]

    def turn(self, v: Vector[Scalar]) -> Vector[Scalar]:
        """Take a vector of the body's frame to the base frame."""
        return v if self.R is None else self.R.apply(v)


class Points:
    """The bodies of a chain; each is computed when a point of it is asked for."""

    def __init__(self, links: Sequence[Link], qd: Sequence[Scalar], still: Vector[Scalar]) -> None:
        self._links, self._qd = links, qd
        self._places = {0: _Place(still, None, still, still)}

    def read(self, reading: Reading, body: int, point: Vector[Scalar]) -> Vector[Scalar]:
        """Return the position, velocity, direction or angular velocity of a point of a body."""
        place = self._place(body)
        match reading:
            case Reading.POSITION:
                return place.p + place.turn(point)
            case Reading.VELOCITY:
                return place.v + place.OM.cross(place.turn(point))
            case Reading.DIRECTION:
                return place.turn(point)
        return place.OM

    def _place(self, number: int) -> _Place:
        if number not in self._places:
            self._places[number] = self._move(number)
        return self._places[number]

    def _move(self, number: int) -> _Place:
        link, qd = self._links[number - 1], self._qd[number - 1]
        parent = self._place(link.parent)
        arm = parent.turn(link.dpt)
        R = link.R if parent.R is None else parent.R.times(link.R)
        relative = R.column(link.joint.axis).scale(qd)
        v, OM = parent.v + parent.OM.cross(arm), parent.OM
        if link.is_revolute:
            return _Place(parent.p + arm, R, v, OM + relative)
        return _Place(parent.p + arm, R, v + relative, OM)
