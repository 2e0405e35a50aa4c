"""Force laws keep the form that they are written in: products are not multiplied out, sines are not put together."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from mbsgen.formulations import impl
from mbsgen.pipeline import read_tree
from tests.mbsgen.failures.mechanisms import NONE, REDUCED, compute, compute_exactly, np

STIFFNESS, REST = 100.0, 0.7
MODEL = """
name: spring
gravity: [0, 0, 0]
parameters: {k: 100, rest: 0.7}
bodies:
  - name: arm
    joint:
      type: revolute
      axis: z
      actuated: false
      force: -k*((cos(q) - cos(rest))**2 + (sin(q) - sin(rest))**2)
    mass: 1
    com: [0.5, 0, 0]
    inertia: [0.1, 0.1, 0.1]
"""


def factored(q: float) -> float:
    """Write the law by hand."""
    return STIFFNESS * ((math.cos(q) - math.cos(REST)) ** 2 + (math.sin(q) - math.sin(REST)) ** 2)


@pytest.mark.parametrize("reductions", [REDUCED, NONE], ids=["reduced", "textbook"])
def test_the_square_of_a_length_is_not_multiplied_out(reductions, tmp_path: Path):
    """At 1e-6 from where it vanishes, 2 - 2 cos(q - rest) is right to 1e-4; differences first, to 1e-9."""
    file = tmp_path / "model.yaml"
    file.write_text(MODEL, encoding="utf-8")
    tape = impl.build(read_tree(file), reductions)
    errors, by_hand = [], []
    for k in range(20):
        q = REST + 1e-6 * (1 + k / 20)
        at = {"q": np.array([q]), "qd": np.zeros(1), "qdd": np.zeros(1), "u": np.zeros(0)}
        (exact,) = compute_exactly(tape, at)["Phi"]
        errors.append(abs(float(compute(tape, at)["Phi"][0] - exact)) / exact)
        by_hand.append(abs(factored(q) - exact) / exact)
    assert max(errors) <= 10 * max(by_hand) <= 1e-8
