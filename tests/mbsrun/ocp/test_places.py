"""The order in which a search visits its places, their neighbours and opposites: by hand."""

from __future__ import annotations

import pytest

from mbsrun.ocp.searching.study import Targets

HEIGHTS = (0.0, 1.0, 2.0)


def test_coarse_grids_come_first() -> None:
    """By the factors of 2 in the indices: 0 has all, 4 two, 2 one, odd ones none; the finer index decides."""
    line = Targets(1.0, (-2.0, -1.0, 0.0, 1.0, 2.0), (0.0,))
    assert [i for i, _ in line.spread] == [0, 4, 2, 1, 3]
    plane = Targets(1.0, (-1.0, 0.0, 1.0), HEIGHTS)
    assert plane.spread == ((0, 0), (0, 2), (2, 0), (2, 2), (0, 1), (1, 0), (1, 1), (1, 2), (2, 1))
    wide = Targets(1.0, tuple(map(float, range(9))), (0.0,), every=(2, 1))
    assert [i for i, _ in wide.spread] == [0, 8, 4, 2, 6]


def test_neighbours_are_a_step_away() -> None:
    targets = Targets(1.0, tuple(map(float, range(5))), HEIGHTS, every=(2, 1))
    assert list(targets.neighbours((2, 1))) == [(0, 1), (4, 1), (2, 0), (2, 2)]
    assert list(targets.neighbours((0, 0))) == [(2, 0), (0, 1)]


@pytest.mark.parametrize(
    ("azimuths", "every", "place", "opposite"),
    [
        ((-1.0, 0.0, 1.0), (1, 1), (0, 1), (2, 1)),
        ((-1.0, 0.0, 1.0), (1, 1), (1, 0), None),  # its own
        ((-1.0, 0.0, 1.1), (1, 1), (0, 0), None),
        ((-1.0, -0.5, 0.5, 1.0), (2, 1), (2, 0), None),  # not taken
    ],
)
def test_opposites_have_the_opposite_azimuth(
    azimuths: tuple[float, ...], every: tuple[int, int], place: tuple[int, int], opposite: tuple[int, int] | None
) -> None:
    assert Targets(1.0, azimuths, HEIGHTS, every).opposite(place) == opposite


def test_places_lie_on_a_cylinder() -> None:
    x, y, z = Targets(2.0, (0.0, 0.5235987755982988), HEIGHTS).position((1, 2))
    assert (x, y, z) == pytest.approx((3**0.5, 1.0, 2.0))
