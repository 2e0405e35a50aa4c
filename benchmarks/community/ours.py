"""Our motions: explicit pairs in C, as `simulate_many` takes them, and stiff ones by collocation.

The clock runs while C integrates, as the peers' clocks do. Short motions are repeated within one call.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.candidates import OURS
from benchmarks.loops.motions import Run, Way
from benchmarks.loops.ours import KEEPINGS, list_ours
from benchmarks.loops.problems import Problem
from mbsrun import Mechanism, load
from mbsrun.simulation import Settings
from mbsrun.simulation.course import stand
from mbsrun.simulation.drive import hold
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.integration.explicit import DOP853, RK45, Pair, Plant

PAIRS = {
    "DOP853": (DOP853, tuple(10.0**-k for k in range(2, 15))),
    "RK45": (RK45, tuple(10.0**-k for k in range(2, 11))),
}
LEAST = 0.02  # s: a call takes at least so long
MOST = 200  # motions of a call
SHORT = 1e-13  # of the span: no output lies so close to another one


def list_community(problem: Problem) -> Iterator[Way]:
    """List our methods for a problem, from coarse to fine."""
    if problem.is_stiff:
        yield from list_ours(problem)
        return
    kernels = load(problem.model)
    closed = bool(problem.tree.loops)
    for name, (pair, tolerances) in PAIRS.items():
        for formulation in (Formulation.EXP1, Formulation.EXP2):
            for keeping in KEEPINGS if closed else (None,):
                chosen = (
                    Settings(problem.span, name.lower(), formulation, rtol=x, atol=x, loops=keeping) for x in tolerances
                )
                runs = tuple(_bind(kernels, problem, pair, settings) for settings in chosen)
                label = f", {keeping.value}" if keeping else ""
                yield Way(OURS, f"{name}, {formulation.value}{label}", runs)


def _bind(kernels: Mechanism, problem: Problem, pair: Pair, settings: Settings) -> Callable[[], Run]:
    def run() -> Run:
        q, qd = problem.start
        dynamics = Dynamics(kernels, settings.formulation, stand(np.zeros(0)))
        plant = Plant(dynamics, pair, settings)
        piece = next(hold(np.zeros(0)).play(kernels, problem.span, lambda: (q, qd)))

        def move(count: int) -> tuple[float, np.ndarray]:
            kept = np.full((count, 2, len(q) + len(qd)), np.nan)
            kept[:, 0] = np.concatenate((q, qd))
            status, lengths = np.zeros(count, dtype=np.int32), np.zeros(count)
            ends, most = np.array([problem.span]), settings.max_steps
            before = time.process_time()
            plant.run_series(piece, ends, SHORT * problem.span, {}, kept, lengths, status, range(count), most)
            seconds = time.process_time() - before
            if status.any():
                raise ArithmeticError("the motion ends early")
            return seconds / count, kept[0, 1]

        seconds, end = move(1)
        count = int(min(MOST, LEAST / max(seconds, 1e-6)))
        if count > 1:
            seconds, end = move(count)
        return Run(problem.measure(*np.split(end, [len(q)])), seconds, 0)

    return run
