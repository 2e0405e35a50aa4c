"""Our motions of the loop benchmarks, by the simulation's own methods; energies and open loops are not timed."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.candidates import OURS
from benchmarks.loops.motions import Run, Way
from benchmarks.loops.problems import Problem
from mbsrun import Mechanism, load
from mbsrun.simulation import Settings, simulate
from mbsrun.simulation.drive import hold
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.motion import Keeping

TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11, 1e-13)
KEEPINGS = (Keeping.PROJECTION, Keeping.MASS_PROJECTION, Keeping.PARTITIONING)
STEPS = (50, 100, 400)  # of implicit methods


def list_ours(problem: Problem) -> Iterator[Way]:
    """List our methods for a problem, from coarse to fine."""
    kernels = load(problem.model)
    if problem.is_stiff:
        for stages in (3, 5, 7):
            settings = (
                Settings(problem.span, "radau-iia", Formulation.IMPL, problem.span / n, stages=stages) for n in STEPS
            )
            runs = tuple(_bind(kernels, problem, x) for x in settings)
            yield Way(OURS, f"Radau IIA of order {2 * stages - 1}, index 2 stabilised", runs)
        return
    for formulation in (Formulation.EXP1, Formulation.EXP2):
        for keeping in KEEPINGS:
            chosen = (
                Settings(problem.span, "dop853", formulation, rtol=x, atol=x, loops=keeping, output_step=problem.span)
                for x in TOLERANCES
            )
            runs = tuple(_bind(kernels, problem, x) for x in chosen)
            yield Way(OURS, f"DOP853, {formulation.value}, {keeping.value}", runs)


def _bind(kernels: Mechanism, problem: Problem, settings: Settings) -> Callable[[], Run]:
    def run() -> Run:
        q, qd = problem.start
        motion = simulate(kernels, hold(np.zeros(0)), q, qd, settings)
        if motion.halt is not None:
            raise ArithmeticError(str(motion.halt))
        return Run(problem.measure(motion.q[-1], motion.qd[-1]), motion.effort.seconds, motion.effort.steps)

    return run
