"""Solve a problem by this project and in plain CasADi, and check the solution by separate programs.

Times are of the processor, without what is done once: reading, code, derivatives. Momentum at impacts and the places
of feet are computed by the recursion of `chains`, which shares nothing with the generated kernels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.classics.peers import SETTINGS
from benchmarks.legged.cases import Case
from benchmarks.legged.chains import Mechanism
from benchmarks.legged.collocation import Answer
from mbsrun.external import load_on_demand
from mbsrun.ocp.guessing.phases import Unreached, guess_phases
from mbsrun.ocp.problem.phases import PhasedProblem, Plants, equip_phases
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solving.phases import PhasedSolver, resimulate_phases
from mbsrun.ocp.statement.phases import read_phased_problem

LIMIT = 20.0  # s of the processor, for a solve of a plain program
LONG = 5.0  # s: such a solve is not repeated
SOLVED = "Solve_Succeeded"

Array = NDArray[np.float64]


class UnsolvedError(Exception):
    """A problem that was not solved."""


@dataclass(frozen=True)
class Effort:
    """A solver's work: the quickest of several solves."""

    cost: float
    iterations: int
    seconds: float  # of the processor
    evaluating: float | None = None  # of these, for functions and derivatives
    is_solved: bool = True
    setting: str = ""  # of a plain program, one of SETTINGS: the quickest one that solves it

    @property
    def each(self) -> float:
        """Return the time of an iteration."""
        return self.seconds / max(1, self.iterations)


@dataclass(frozen=True)
class Row:
    """A problem's figures."""

    name: str
    phases: int
    freedoms: int
    variables: int
    constraints: int
    ours: Effort
    expanded: Effort  # plain CasADi, expanded to SX
    graph: Effort  # plain CasADi, the MX graph
    momentum: float | None  # the largest defect of the balance at impacts, relative to the largest impulse
    slip: float  # of standing feet: the largest way from where they stand [m]
    defect: float  # of an interval, by re-simulation


def measure_case(name: str, case: Case, rounds: int) -> Row:
    """Solve a problem by all solvers, several times, and check the solution. Raises UnsolvedError."""
    problem, plants = read_phased_problem(case.file, load_on_demand)
    solution, ours = _solve(problem, plants, rounds)
    expanded, graph = (_solve_plainly(case, rounds, expand=expand) for expand in (True, False))
    checked = resimulate_phases(solution, plants)
    defects = [phase.resimulation.defect for phase in checked.phases if phase.resimulation is not None]
    return Row(
        name=name,
        phases=len(solution.phases),
        freedoms=max(len(plant.manifest.coordinates) for plant in plants.phases),
        variables=solution.size.variables,
        constraints=solution.size.constraints,
        ours=ours,
        expanded=expanded,
        graph=graph,
        momentum=None if case.struck is None else measure_balance(solution, case.struck()),
        slip=measure_slip(solution, plants),
        defect=max(np.inf if defect is None else defect for defect in defects),
    )


def _solve(problem: PhasedProblem, plants: Plants, rounds: int) -> tuple[PhasedSolution, Effort]:
    """Solve by this project from the guess of the file."""
    plants = equip_phases(problem, plants)
    guess = guess_phases(problem, plants)
    if isinstance(guess, Unreached):
        raise UnsolvedError(f"{problem.name}: no pose meets the targets of a phase")
    solver = PhasedSolver(problem, plants)
    found = [solver.solve(solver.problem, guess) for _ in range(rounds)]
    first = found[0]
    if not isinstance(first, PhasedSolution):
        raise UnsolvedError(f"{problem.name}: {first.finding}")
    run = min((solution.run for solution in found), key=lambda run: run.cpu_seconds)
    return first, Effort(first.cost, run.iterations, run.cpu_seconds, run.cpu_seconds_evaluating)


def _solve_plainly(case: Case, rounds: int, *, expand: bool) -> Effort:
    """Solve the plain program by IPOPT with MUMPS, in all settings, and again in the quickest one."""

    def solve(setting: str) -> Answer:
        return case.write().solve(expand=expand, limit=LIMIT, settings=SETTINGS[setting])

    tried = {setting: solve(setting) for setting in SETTINGS}
    setting = choose_setting(tried)
    found, is_solved = [tried[setting]], tried[setting].status == SOLVED
    if is_solved and found[0].seconds < LONG:
        found += [solve(setting) for _ in range(rounds - 1)]
    seconds = min(answer.seconds for answer in found)
    return Effort(found[0].cost, found[0].iterations, seconds, is_solved=is_solved, setting=setting)


def choose_setting(tried: Mapping[str, Answer]) -> str:
    """Return the quickest setting that solves a program; the first one where none does."""
    solved = {name: answer.seconds for name, answer in tried.items() if answer.status == SOLVED}
    return min(solved, key=lambda name: solved[name]) if solved else next(iter(tried))


def measure_balance(solution: PhasedSolution, mechanism: Mechanism) -> float:
    """Return the largest entry of M dv - J' L over all impacts, relative to the largest impulse."""
    found = [0.0]
    for values in solution.values:
        if not values.impulses:
            continue
        before = solution.find(values.source).trajectory
        q = np.concatenate((np.zeros(mechanism.n - before.q.shape[1]), before.q[-1]))
        impulses = np.zeros((3, len(mechanism.points)))
        for impulse in values.impulses:
            impulses[:, mechanism.points.index(impulse.sensor)] = impulse.components
        balance = mechanism.momentum(q, np.array(values.changes), impulses).full()
        found.append(float(np.abs(balance).max() / np.abs(impulses).max()))
    return max(found)


def measure_slip(solution: PhasedSolution, plants: Plants) -> float:
    """Return the largest way that a standing point moves within a phase, at mesh points [m]."""
    found = [0.0]
    for phase, plant in zip(solution.phases, plants.phases, strict=True):
        sensors = [frame.name for frame in plant.manifest.frames if frame.sensor]
        for contact in phase.problem.contacts:
            position = plant("sensors", q=phase.trajectory.q)["position"]
            place = position[:, list(contact.axes), sensors.index(contact.sensor)]
            found.append(float(np.abs(place - place[0]).max()))
    return max(found)
