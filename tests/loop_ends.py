"""The frames at the ends of loops, placed as sensors: by the kernel `frames`, which knows no loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mbsgen.formulations.results.poses import build_frames
from mbsgen.model.tree import LoopFrame, Sensor, Tree
from mbsgen.tape.interpreter import evaluate
from tests.random_trees import values_of

Array = NDArray[np.float64]


def open_loops(tree: Tree) -> Tree:
    """Return the tree without its loops."""
    return replace(tree, loops=(), constraints=(), closure=None)


def place_ends(tree: Tree, q: Array) -> list[tuple[Array, Array, Array, Array]]:
    """Return origins p1, p2 and axes R1, R2 of the two ends of each loop, as poses of sensors."""

    def sense(end: LoopFrame) -> Sensor:
        return Sensor("end", end.body, end.position, end.axes)

    ends = tuple(sense(end) for loop in tree.loops for end in (loop.first, loop.second))
    bare = replace(open_loops(tree), sensors=ends)
    found = evaluate(build_frames(bare), {"q": list(q)} | ({"p": given} if (given := values_of(tree)) else {}))
    n = len(tree.bodies)
    p: Array = np.array(found["p"], float).reshape(-1, 3)[n:]
    R: Array = np.array(found["R"], float).reshape(-1, 3, 3)[n:].transpose(0, 2, 1)
    return [(p[i], p[i + 1], R[i], R[i + 1]) for i in range(0, len(ends), 2)]
