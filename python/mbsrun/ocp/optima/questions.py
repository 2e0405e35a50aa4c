"""Which numbers of a problem an optimum is to be differentiated by: a solution and Numbers -> Movement.

A number may enter a problem anywhere: through constants, through a start or a pose that they give, through parameters
of the model. So the problem is stated anew with the number a little smaller and larger, and the numbers of the program,
which are smooth functions of it, are differentiated by differences of order four. The rest is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np

from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.methods import Instance
from mbsrun.ocp.optima.held import hold, list_parameters
from mbsrun.ocp.optima.movement import Movement, Numbers, take_differences
from mbsrun.ocp.optima.point import find_optimum
from mbsrun.ocp.problem.phases import Phase, PhasedProblem, Plants, equip_phases
from mbsrun.ocp.problem.problem import Unknown
from mbsrun.ocp.solution.phases import Guess, PhasedSolution
from mbsrun.ocp.solving.phases import Make, PhasedSolver
from mbsrun.ocp.statement.checks import Line, ProblemError
from mbsrun.ocp.statement.surplus import leave_out_surplus

T = TypeVar("T")

WAYS = (  # how a problem is written, and no part of the question
    "intervals", "mesh", "family", "degree", "loops", "representation", "form", "integrator", "steps", "solver", "name",
)  # fmt: skip
STEPS = (-2, -1, 1, 2)
STEP = 1e-3  # of a number, over its size
LEAST = 1e-4  # where it is 0
SPAN = 1e-3  # of a step: a derivative is none if the active set stays for less
SAME = 1e-12  # of numbers that a file keeps


@dataclass(frozen=True, eq=False)
class Number:
    """A number of a problem, and the problem with another value of it."""

    name: str
    value: float
    state: Callable[[float], PhasedProblem]  # the problem with a value; raises ProblemError

    @property
    def step(self) -> float:
        """Return a small change."""
        return STEP * abs(self.value) or LEAST


@dataclass(frozen=True, eq=False)
class Answer:
    """How a solution moves, and the program that it belongs to."""

    numbers: tuple[Number, ...]
    solver: PhasedSolver
    problem: PhasedProblem  # with the parameters that matter as unknowns
    guess: Guess  # the solution
    movement: Movement
    held: tuple[str, ...]  # these parameters
    count: Callable[[PhasedProblem], Numbers]  # the numbers of the program for a problem of the same structure

    def list_unknowns(self, phase: int) -> list[str]:
        """List the unknowns of a phase that the problem has without these parameters."""
        names = (x.name for x in self.problem.phases[phase].problem.unknowns)
        return [name for name in names if name not in self.held]


def ask(
    solution: PhasedSolution,
    own: PhasedProblem,
    plants: Plants,
    numbers: Sequence[Number],
    make: Make = PhasedSolver,
    *,
    is_strict: bool = True,
) -> Answer:
    """Find how a solution of a problem moves with numbers of it.

    Raises ProblemError for a solution of other numbers, and for a number by which nothing can be differentiated: one
    that shapes the program, an unknown, or a parameter of the model that is not differentiated. Unless it `is_strict`,
    such numbers are left out.
    """
    base = _take_found(solution)
    plants = equip_phases(base, plants)
    stating = _Stating(base, plants, solution.guess)
    found = [_try(partial(stating.find, x), is_strict=is_strict) for x in numbers]
    stated = [x for x in found if x is not None]
    held = sorted(set().union(*(x.held for x in stated)))
    is_timed = any(x.is_timed for x in stated)

    def fix(problem: PhasedProblem) -> PhasedProblem:
        given = _read_parameters(problem, plants)
        return hold(problem, plants, {name: given[name] for name in held}, horizon=is_timed)

    fixed = fix(base)
    try:
        solver = make(fixed, plants)
    except ProblemError:  # a horizon cannot be a variable beside delays, and references in seconds
        if is_strict or not is_timed:
            raise
        others = [x.number for x in stated if not x.is_timed]
        return ask(solution, own, plants, others, make, is_strict=False)
    outcome = solver.resume(fixed, solution.guess)
    guess = solver.complete(fixed, solution.guess)

    def count(problem: PhasedProblem) -> Sequence[Array]:
        return _read(solver.number(fix(problem), guess)).parts

    start = outcome.start
    remedy = "solve this problem, and differentiate its solution"
    try:
        given = Numbers(*count(stating.adapt(own)))
    except ProblemError:
        raise
    except ValueError:
        raise ProblemError(base.name, [("solution", "it belongs to a problem of another form", remedy)]) from None
    if not _is_same(_read(start), given):
        raise ProblemError(base.name, [("solution", "it belongs to a problem with other numbers", remedy)])
    changes = [_try(partial(_differentiate, x, count, base.name), is_strict=is_strict) for x in stated]
    known = [pair for pair in changes if pair is not None]
    assert outcome.multipliers is not None, "all methods return multipliers"
    program = solver.program
    answer = outcome.x, outcome.multipliers
    optimum = find_optimum(program.numpy, program.data, start, 1 / (fixed.weight or 1.0), answer)
    asked = tuple(number for number, _ in known)
    spans = tuple(SPAN * number.step for number in asked)
    movement = Movement(program, optimum, tuple(change for _, change in known), spans)
    return Answer(asked, solver, fixed, guess, movement, tuple(held), lambda x: Numbers(*count(stating.adapt(x))))


def _try(find: Callable[[], T], *, is_strict: bool) -> T | None:
    try:
        return find()
    except ProblemError:
        if is_strict:
            raise
        return None


@dataclass(frozen=True, eq=False)
class _Stated:
    """A number, the problem with values of it beside its own, and what of models changes with it."""

    number: Number
    variants: tuple[PhasedProblem, ...]  # at STEPS; none where the ones of one side cannot be stated
    held: frozenset[str]  # parameters of models
    is_timed: bool  # whether a given horizon changes


@dataclass(frozen=True, eq=False)
class _Stating:
    """States a problem anew, for the grid of a solution."""

    base: PhasedProblem
    plants: Plants
    guess: Guess  # the solution

    def find(self, number: Number) -> _Stated:
        """State the problem with values of a number. Raises ProblemError."""
        base, plants = self.base, self.plants
        variants = self._list_variants(number)
        before, changed = _read_parameters(base, plants), set[str]()
        for variant in variants:
            changed |= {own for own, x in _read_parameters(variant, plants).items() if x != before.get(own, x)}
        strangers = changed - set(list_parameters(base, plants))
        if strangers:
            raise ProblemError(base.name, [self._refuse(number.name, own) for own in sorted(strangers)])
        pairs = ((x.problem, y.problem) for v in variants for x, y in zip(v.phases, base.phases, strict=True))
        is_timed = any(x.is_timed and x.horizon != y.horizon for x, y in pairs)
        return _Stated(number, variants, frozenset(changed), is_timed)

    def _list_variants(self, number: Number) -> tuple[PhasedProblem, ...]:
        """State the problem; none where values of one side alone have no problem, as limits that cross."""
        found, errors = [], dict[int, ProblemError]()
        for k in STEPS:
            try:
                found.append(self.adapt(number.state(number.value + k * number.step)))
            except ProblemError as error:
                errors[k] = error
        if errors and len({k > 0 for k in errors}) == 2:
            raise errors[1]
        return () if errors else tuple(found)

    def adapt(self, problem: PhasedProblem) -> PhasedProblem:
        """Return a problem with the grid and the form of loops that the solution has, its unknowns and its conditions.

        Raises ProblemError for an end that contradicts contacts.
        """
        parts = zip(problem.phases, self.base.phases, self.plants.phases, self.guess.trajectories, strict=True)
        phases = []
        for own, known, plant, motion in parts:
            x, y = own.problem, known.problem
            guesses = {unknown.name: unknown.guess for unknown in y.unknowns}
            unknowns = tuple(replace(u, guess=guesses.get(u.name, u.guess)) for u in x.unknowns)
            ways = {name: getattr(y, name) for name in WAYS}
            stated = replace(x, unknowns=unknowns, **ways)
            phases.append(Phase(known.name, leave_out_surplus(stated, plant, motion.q[-1], y.end)))
        return replace(problem, phases=tuple(phases), solver=self.base.solver)

    def _refuse(self, name: str, own: str) -> Line:
        if own in {x.name for x in self.base.every_unknown}:
            return name, f"{own} is an unknown, which the solver chooses", "ask for another number"
        finding = f"{own} is no differentiated parameter of every model, or moves loops whose start is open"
        return name, finding, "declare it `kind: differentiated` in the model"


def _take_found(solution: PhasedSolution) -> PhasedProblem:
    """Return the problem of a solution with the unknowns found as their guesses."""
    problem, values = solution.problem, dict(solution.guess.unknowns)

    def find(unknowns: tuple[Unknown, ...]) -> tuple[Unknown, ...]:
        return tuple(replace(x, guess=float(np.clip(values[x.name], *x.bounds))) for x in unknowns)

    problem = problem.change(lambda own: replace(own, unknowns=find(own.unknowns)))
    return replace(problem, unknowns=find(problem.unknowns))


def _read_parameters(problem: PhasedProblem, plants: Plants) -> Mapping[str, float]:
    """Return the values of all parameters of the models."""
    found: dict[str, float] = {}
    for plant in plants.every:
        found |= dict(plant.parameters)
    for phase in problem.phases:
        found |= dict(phase.problem.parameters)
    return found


def _read(instance: Instance) -> Numbers:
    return Numbers(instance.parameters, instance.lower, instance.upper, instance.g_lower, instance.g_upper)


def _is_same(one: Numbers, other: Numbers) -> bool:
    """Return whether all numbers agree up to rounding."""
    pairs = zip(one.parts, other.parts, strict=True)
    return all(a.shape == b.shape and np.allclose(a, b, rtol=SAME, atol=SAME) for a, b in pairs)


def _differentiate(
    stated: _Stated, count: Callable[[PhasedProblem], Sequence[Array]], name: str
) -> tuple[Number, Numbers | None]:
    """Return the derivatives of a program's numbers; none where these are not smooth.

    Raises ProblemError for a number that shapes the program.
    """
    if not stated.variants:
        return stated.number, None
    number, variants = stated.number, dict(zip(STEPS, stated.variants, strict=True))
    try:
        found = take_differences(lambda d: count(variants[round(d / number.step)]), number.step)
    except ProblemError:
        raise
    except ValueError:
        finding = "it shapes the program, so no derivative by it is known"
        raise ProblemError(name, [(number.name, finding, "ask for another number")]) from None
    return number, Numbers(*found)
