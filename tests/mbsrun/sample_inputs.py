"""Inputs of the sample's kernels, and how far rounding takes their results."""

from __future__ import annotations

import numpy as np

from mbsgen.tape.interpreter import evaluate
from mbsgen.tape.types import Tape
from tests.sample import setup_tape

EPS = float(np.finfo(float).eps)
# Forty roundings at most lie between inputs and any result of the sample; the sums are of a few terms of like size.
ROUNDING = 40 * EPS


def draw(tape: Tape, seed: int, states: int | None = None) -> dict[str, np.ndarray]:
    """Draw the inputs of a tape, as the NumPy face takes them; adj_g has its nonzeros only."""
    rng = np.random.default_rng(seed)
    batch = () if states is None else (states,)
    inputs = {}
    for source in (i for i in tape.inputs if i.name != "h"):
        pattern = source.sparsity
        array = np.zeros((*batch, pattern.rows, pattern.cols))
        for r, c in pattern.entries:
            array[..., r, c] = rng.uniform(0.2, 1.5, batch)
        inputs[source.name] = array[..., 0] if pattern.cols == 1 else array
    return inputs


def hidden(parameters: dict[str, float]) -> list[float]:
    return evaluate(setup_tape(), {"p": list(parameters.values())})["h"]
