"""Motions through many impacts: a short part of the benchmark, against its closed forms."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import pytest

from benchmarks.events import Row, find_order, strike, swing, write_page

TOLERANCES = (1e-7, 1e-8, 1e-9, 1e-10, 1e-11)


@pytest.mark.parametrize("move", [swing, strike])
def test_the_order_is_kept_through_impacts(move: Callable[[int, Sequence[float]], Iterator[Row]]) -> None:
    """The error of the last speed falls with the steps to the power of 8; the energy is kept with all losses."""
    rows = list(move(50, TOLERANCES))
    assert all(row.impacts == 50 for row in rows)
    assert find_order(rows) == pytest.approx(8.5, abs=1.2)
    assert rows[-1].late < 1e-9
    assert rows[-1].error < 1e-9
    assert rows[-1].drift < 1e-10
    assert f"50 impacts; the error falls with the number of steps to the power of {find_order(rows):.1f}" in write_page(
        50, rows, rows
    )
