"""The page of rigid contacts: steps of both programs in one table, with their ratio to real time."""

from __future__ import annotations

from benchmarks.contacts import Run, write_page


def test_the_page_shows_times_residuals_and_slips() -> None:
    runs = [Run(0.0, "mbsrun", 40.0, 1e-14, 1e-5, 1e-8), Run(0.02, "MuJoCo", 12.5, None, 6e-4, 5e-4)]
    page = write_page(runs)
    assert "| stands | mbsrun | 40 | 25 | 1.0e-14 | 1.0e-05 | 1.0e-08 |" in page
    assert "| falls 2 cm | MuJoCo | 12.5 | 80 | – | 6.0e-04 | 5.0e-04 |" in page
