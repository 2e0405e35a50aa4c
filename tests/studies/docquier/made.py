"""Results of the paper's protocol with chosen numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np

from mbsrun.ocp.problem.problem import Problem, Representation
from mbsrun.ocp.searching.study import Study, Targets
from mbsrun.ocp.solution.record import Attempt, Task
from studies.docquier.results import Results

SMOOTH, ROUGH = (1.0, 10.0), (1.0, 0.0)
NAMES = tuple(r.value for r in Representation)
PLACES = 9
TARGETS = Targets(0.6, tuple(np.linspace(-1.5, 1.5, PLACES).tolist()), (0.0,))
# The judges read targets, costs and representations of a study; its problem is not looked at.
STUDY = Study(cast(Problem, None), "hand", TARGETS, (SMOOTH, ROUGH), tuple(Representation), ())

Number = Callable[[tuple[float, float], str, int], float]  # of a cost, a representation and a place


def make(
    cost: Number = lambda *_: 5.0,
    iterations: Number = lambda *_: 20.0,
    cpu: Number = lambda *_: 1.0,
    sizes: Callable[[str], tuple[int, int, int, int]] = lambda _: (10, 10, 10, 10),
) -> Results:
    """Make results of the paper's protocol at all places, in all representations, for both costs."""
    attempts = tuple(
        Attempt(
            Task((place, 0), w, name),
            *("paper", "paper", "zero", 0, ""),
            *(round(iterations(w, name, place)), cpu(w, name, place), 0.5, cost(w, name, place), None),
            *sizes(name),
        )
        for w in (SMOOTH, ROUGH)
        for name in NAMES
        for place in range(PLACES)
    )
    return Results(STUDY, attempts, (), (), ())
