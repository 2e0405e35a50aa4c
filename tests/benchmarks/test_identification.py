"""The page of an identification: errors of made recordings, which are as large as the estimates state."""

from __future__ import annotations

import numpy as np

from benchmarks.identification import Weighing, take_time, weigh, write_page
from tests.mbsrun.identification.motions import Inside, swing


def test_a_link_is_weighed_and_the_page_holds_it() -> None:
    q, qd, qdd = swing(7, np.arange(400) / 40, 3)
    motion = q + np.array([0, 0, 0, -1.5, 0, 1.8, 0]), qd, qdd
    found = weigh("link7", motion, 3)
    assert found is not None
    assert found.largest < 4 * found.deviation < 0.1
    assert weigh("link1", motion, 1) is None  # it turns about the vertical
    _, identified = take_time(motion)
    page = write_page(0.5, identified, [found], {"a mechanism": Inside(0.95, 0.9)}, 20)
    assert "All 43 base parameters" in page
    assert f"| link7 | {found.mass:.4g} |" in page
    assert "| a mechanism | 95.0 | 90.0 |" in page
    assert isinstance(found, Weighing)
