"""The page of an identification: errors of made recordings, which are as large as the estimates state."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.identification import AIMED, LINKS, Weighing, bound, design_aimed, take_time, weigh, write_page
from tests.mbsrun.identification.motions import Inside, swing


def test_a_link_is_weighed_and_the_page_holds_it() -> None:
    q, qd, qdd = swing(7, np.arange(400) / 40, 3)
    motion = q + np.array([0, 0, 0, -1.5, 0, 1.8, 0]), qd, qdd
    found = weigh("link7", motion, 3)
    assert found is not None
    assert found.largest < 4 * found.deviation < 0.1
    assert found.bound == pytest.approx(found.deviation, rel=0.05)  # the estimate reaches it
    assert weigh("link1", motion, 1) is None  # it turns about the vertical
    _, identified = take_time(motion)
    page = write_page(0.5, identified, {"a motion": [found]}, {"a mechanism": Inside(0.95, 0.9)}, 20)
    assert "All 43 base parameters" in page
    assert f"| a motion | link7 | {found.mass:.4g} |" in page
    assert "| a mechanism | 95.0 | 90.0 |" in page
    assert isinstance(found, Weighing)


def test_a_motion_for_one_mass_is_designed(tmp_path: Path) -> None:
    """The second pass knows the noise of the first one's torques; the best of both has the smaller bounds."""
    wishes = replace(AIMED, starts=1, harmonics=3, samples=60, step=0.01)
    one, two = (design_aimed(tmp_path, wishes, passes) for passes in (1, 2))
    worst = [max(bound(link, motion) for link in LINKS) for motion in (one, two)]
    assert worst[1] <= worst[0] < 0.1
    assert all(len(x) == 1000 for x in two)
