"""Bundles of measured points are found by everything that they depend on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from mbsrun.measuring.store import Store
from tests.mbsrun.ocp.plants import push


@dataclass(frozen=True)
class Point:
    """A measured number."""

    value: int


LONG = np.arange(2000.0)
DIFFERENT = {
    "degree of a problem": (push(4), replace(push(4), degree=3)),
    "entry of a long array": (LONG, np.where(LONG == 1000, 0.5, LONG)),
    "value of a mapping": ({"m": 1.0}, {"m": 2.0}),
}


@pytest.mark.parametrize(("first", "second"), DIFFERENT.values(), ids=DIFFERENT.keys())
def test_what_differs_anywhere_is_measured_again(tmp_path: Path, first: object, second: object) -> None:
    """Each bundle stays in the file: another store finds both."""
    for store in (Store(tmp_path / "points.jsonl", Point), Store(tmp_path / "points.jsonl", Point)):
        assert store.find_or_measure(("fact", first), lambda: [Point(1)]) == [Point(1)]
        assert store.find_or_measure(("fact", second), lambda: [Point(2)]) == [Point(2)]
