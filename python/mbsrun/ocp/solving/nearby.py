"""Many problems of one structure, solved at once from solutions nearby: statements, starts -> answers.

One call of the method solves all; their functions are evaluated and judged at once, too. Motions are read when somebody
asks for them. Results are the ones of `PhasedSolver.solve_near`, one by one: points have the same bits, and the judge's
numbers are the same to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbsrun.closure import find_closure
from mbsrun.ocp import methods
from mbsrun.ocp.evaluation.backends.numpy import NumpyProgram
from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.evaluation.backends.stacked import StackedProgram
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.memory import Memory
from mbsrun.ocp.ground.status import SOLVED
from mbsrun.ocp.methods import AnswerStack, Instance, Stack
from mbsrun.ocp.problem.phases import PhasedProblem
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import Run
from mbsrun.ocp.solving.judging import Outcome
from mbsrun.ocp.solving.phases import Neighbour, PhasedSolver
from mbsrun.ocp.solving.stacked import Limits, StackedJudge

State = Callable[[], PhasedProblem]

ROOM = 200_000  # numbers of Jacobians that are evaluated at once
KEPT = 2  # numbers of points whose functions are kept


@dataclass(frozen=True, eq=False)
class Late:
    """A solution that was judged, and whose motion is read when it is asked for."""

    solver: PhasedSolver
    problem: PhasedProblem
    run: Run
    cost: float
    x: Array
    state: State | None = None  # the very problem, where `problem` stands for it

    @cached_property
    def solution(self) -> PhasedSolution:
        """Return the solution. Raises ProblemError where its problem, which is stated now, has faults."""
        own = self.problem if self.state is None else self.state()
        return self.solver.read(own, self.run, self.x)


@dataclass(frozen=True, eq=False)
class NearStart:
    """A problem whose open choices are made, and the solution that it starts from."""

    problem: PhasedProblem
    own: Neighbour
    most_iterations: int
    instance: Instance | None = None  # the numbers of the solve, where they are known
    state: State | None = None  # the very problem, where `problem` stands for it: its weights and options are the same


@dataclass(frozen=True, eq=False)
class NearAnswer:
    """A solution, and itself as a start of others."""

    found: Late | PhasedSolution
    neighbour: Neighbour | None


def solve_all_near(solver: PhasedSolver, starts: Sequence[NearStart], threads: int = 1) -> list[NearAnswer | None]:
    """Solve problems of the structure of a solver from solutions nearby; None where that does not succeed soon.

    Raises ProblemError, or ValueError, as `PhasedSolver.solve_near` does.
    """
    found: list[NearAnswer | None] = [None] * len(starts)
    groups: dict[int, list[int]] = {}
    stacks: dict[int, methods.StackSolver] = {}
    for k, start in enumerate(starts):
        own = solver.make_stacks(start.problem, threads) if can_stack(solver) else None
        if own is None:
            found[k] = _solve_alone(solver, start)
        else:
            stacks[id(own)] = own
            groups.setdefault(id(own), []).append(k)
    for key, chosen in groups.items():
        answers = _solve_stack(solver, stacks[key], [starts[k] for k in chosen])
        for k, answer in zip(chosen, answers, strict=True):
            found[k] = answer
    return found


def can_stack(solver: PhasedSolver) -> bool:
    """Return whether answers of a solver are judged by rows and bounds alone, without loops or condensed variables."""
    plants = solver.plants.every
    is_plain = not solver.problem.links and all(not p.manifest.driven and find_closure(p) is None for p in plants)
    return is_plain and isinstance(solver.program.numpy, NumpyProgram)


def _solve_alone(solver: PhasedSolver, start: NearStart) -> NearAnswer | None:
    kept: list[Neighbour] = []
    found = solver.solve_near(start.problem, start.own, start.most_iterations, kept.append)
    return None if found is None else NearAnswer(found, kept[-1] if kept else None)


def _solve_stack(
    solver: PhasedSolver, method: methods.StackSolver, starts: Sequence[NearStart]
) -> list[NearAnswer | None]:
    found: list[NearAnswer | None] = [None] * len(starts)
    numbered = [_number(solver, start) for start in starts]
    chosen = [k for k, own in enumerate(numbered) if own is not None]
    given = [own for own in numbered if own is not None]
    if not chosen:
        return found
    scaling = np.array([solver.scale(problem, start.cost_scale) for problem, start in given])
    stack = _stack([start for _, start in given], [starts[k] for k in chosen], scaling)
    answer = method(stack)
    good = [i for i, status in enumerate(answer.statuses) if status == SOLVED and bool(np.isfinite(answer.x[i]).all())]
    size = max(1, ROOM // max(1, solver.program.numpy.count_nonzeros()[0]))
    for begin in range(0, len(good), size):
        part = good[begin : begin + size]
        for i, late in zip(part, _read_part(solver, given, stack, answer, part), strict=True):
            own, state = starts[chosen[i]].own, starts[chosen[i]].state
            if late is not None:
                late = late if state is None else replace(late, state=state)
                found[chosen[i]] = NearAnswer(late, replace(own, x=late.x, near=answer.near[i]))
                continue
            problem = given[i][0] if state is None else solver.check(state())
            found[chosen[i]] = _finish_alone(solver, (problem, given[i][1]), answer, i, own, float(scaling[i]))
    return found


def _number(solver: PhasedSolver, start: NearStart) -> tuple[PhasedProblem, Instance] | None:
    """Return a checked problem and its numbers; None where bounds cross."""
    if start.instance is not None:
        return start.problem, start.instance
    return solver.number_near(start.problem, start.own, start.most_iterations)


def _stack(given: Sequence[Instance], starts: Sequence[NearStart], scaling: Array) -> Stack:
    """Put the numbers of solves side by side."""

    def join(name: str) -> Array:
        return np.stack([getattr(own, name) for own in given])

    ones = np.ones(given[0].lower.size)
    return Stack(
        parameters=join("parameters"),
        lower=join("lower"),
        upper=join("upper"),
        g_lower=join("g_lower"),
        g_upper=join("g_upper"),
        scales=np.stack([ones if own.scales is None else own.scales for own in given]),
        scaling=scaling,
        near=tuple(start.own.near for start in starts),
        most_iterations=np.array([start.most_iterations for start in starts], dtype=np.int64),
    )


def _read_part(
    solver: PhasedSolver,
    given: Sequence[tuple[PhasedProblem, Instance]],
    stack: Stack,
    answer: AnswerStack,
    part: Sequence[int],
) -> Iterator[Late | None]:
    """Yield the answers of some cases; None where the judge of single points has to decide."""
    functions = _bind_functions(solver.program, len(part))
    x, p = answer.x[part], stack.parameters[part]
    values = functions.evaluate(x, p)
    judge = _JUDGES.find(lambda: StackedJudge(functions.pattern), solver.program)
    limits = Limits(stack.lower[part], stack.upper[part], stack.g_lower[part], stack.g_upper[part], stack.scales[part])
    tolerance = given[part[0]][0].solver.tolerance
    weights = np.array([given[i][0].weight / given[i][1].cost_scale for i in part])
    judgements = judge.judge(x, values, limits, answer.multipliers[part], tolerance, weights)
    costs = np.einsum("ij,ij->i", values.terms, p[:, : values.terms.shape[1]])
    is_bent = solver.program.numpy.has_curved_rows if isinstance(solver.program.numpy, NumpyProgram) else False
    for k, i in enumerate(part):
        (problem, start), judgement, cost = given[i], judgements[k], float(costs[k])
        if judgement is None or not judgement.is_feasible or not is_bent or not np.isfinite(cost):
            yield None
            continue
        run = _make_run(solver, problem, answer, i)
        run = replace(run, decrease=judgement.decrease, reach=judgement.reach)
        if solver.needs_sharpening(problem, run, cost, start.cost_scale):
            yield None
            continue
        yield Late(solver, problem, run, cost, x[k])


def _make_run(solver: PhasedSolver, problem: PhasedProblem, answer: AnswerStack, i: int) -> Run:
    evaluating = float(answer.evaluating[i])
    return Run(
        answer.statuses[i],
        int(answer.iterations[i]),
        float(answer.seconds[i]),
        evaluating,
        float(answer.cpu_seconds[i]),
        evaluating,
        methods.choose(solver.choose_method(problem)),
    )


def _finish_alone(
    solver: PhasedSolver,
    given: tuple[PhasedProblem, Instance],
    answer: AnswerStack,
    i: int,
    own: Neighbour,
    scaling: float,
) -> NearAnswer | None:
    """Read and judge one answer as one of a single solve."""
    problem, start = given
    run, near = _make_run(solver, problem, answer, i), answer.near[i].scale(scaling)
    kept: list[Neighbour] = []
    outcome = Outcome(run, answer.x[i], (), answer.multipliers[i], start, near)
    found = solver.finish_near(problem, outcome, own, kept.append)
    return None if found is None else NearAnswer(found, kept[-1] if kept else None)


def _bind_functions(program: Prepared, count: int) -> StackedProgram:
    """Return the functions of a program at a number of points; the ones of few numbers are kept."""
    known = _FUNCTIONS.find(dict, program)
    if count not in known:
        if len(known) == KEPT:
            known.pop(next(iter(known)))
        known[count] = StackedProgram(program, count)
    return known[count]


_JUDGES: Memory[StackedJudge] = Memory()
_FUNCTIONS: Memory[dict[int, StackedProgram]] = Memory()
