"""Inertias whose last digits are rounded are taken, with a warning; what rounding does not explain is refused."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsgen.model.reader import ModelWarning, read_model
from tests.random_trees import random_rotation

KEYS = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


def read(tensor: dict[str, str], folder: Path) -> None:
    file, entries = folder / "model.yaml", ", ".join(f"{key}: {value}" for key, value in tensor.items())
    file.write_text(
        "name: plate\ngravity: [0, 0, -9.81]\nbodies:\n"
        f"  - {{name: plate, joint: {{type: revolute, axis: x}}, mass: 1, com: [0, 1, 0], inertia: {{{entries}}}}}\n",
        encoding="utf-8",
    )
    read_model(file)


@pytest.mark.parametrize("digits", [3, 4, 6, 9])
def test_a_thin_plate_may_be_written_with_few_digits(digits: int, tmp_path: Path) -> None:
    """A plate has no thickness: one moment is the sum of the others, and digits that are left out break that."""
    rng, warned = np.random.default_rng(digits), 0
    for _ in range(30):
        R, (a, b) = random_rotation(rng), rng.uniform(0.01, 2, 2)
        exact = R @ np.diag([a, b, a + b]) @ R.T
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            read({key: f"{exact[place]:.{digits}g}" for key, place in KEYS.items()}, tmp_path)
        warned += len(told)
        assert all(w.category is ModelWarning and "rounding" in str(w.message) for w in told)
    assert (warned > 5) == (digits < 9)  # nine digits are within the tolerance of a double's own


@pytest.mark.parametrize("excess", [1e-7, 5e-7, 1e-3, 0.1])
def test_what_rounding_does_not_explain_is_refused_with_numbers_that_show_it(excess: float, tmp_path: Path) -> None:
    """All digits of a double are given: as they stand, they exceed. The message never contradicts itself."""
    a, b = 0.1234567891234567, 0.2345678912345678
    with pytest.raises(InputError) as refused:
        read({"xx": f"{a!r}", "yy": f"{b!r}", "zz": f"{(a + b) * (1 + excess)!r}"}, tmp_path)
    shown = re.search(r"principal moments of inertia (\S+), (\S+), (\S+);", str(refused.value))
    assert shown is not None
    small, middle, large = map(float, shown.groups())
    assert small + middle < large
