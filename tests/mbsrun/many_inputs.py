"""Inputs of many states, for tests of batches."""

from __future__ import annotations

import numpy as np

from mbsgen.manifest import Kernel
from mbsgen.roles import Role
from mbsrun.kernel import Array


def draw(kernel: Kernel, states: int, seed: int = 0, pose: tuple[float, ...] = ()) -> dict[str, Array]:
    """Draw inputs; coordinates of closed loops near a pose in which they are closed."""
    rng = np.random.default_rng(seed)
    inputs = {}
    for a in kernel.inputs:
        if a.nnz and a.role not in (Role.SETUP, Role.DESIGN, Role.REMAINDER):
            shape = (a.rows,) if a.cols == 1 and not a.matrix else (a.rows, a.cols)
            values = rng.normal(size=(states, *shape))
            if a.row is not None and a.colind is not None:
                pattern = np.zeros((a.rows, a.cols), dtype=bool)
                pattern[np.array(a.row, dtype=int), np.repeat(np.arange(a.cols), np.diff(a.colind))] = True
                values *= pattern.reshape(shape)
            is_near = pose and a.role is Role.COORDINATE
            inputs[a.name] = np.array(pose) + 0.05 * values if is_near else values
    return inputs
