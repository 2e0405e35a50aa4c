"""Optimal control: coarse meshes, quadrature, many minima, unstable motions, statuses of solvers (F19 to F23)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbsrun.external import Mechanism
from mbsrun.forms import DIFFERENTIATED
from mbsrun.models import Extent, find_folder
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.ground.status import BAD_GUESS, SOLVED
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import interpolate
from mbsrun.ocp.problem.problem import (
    Bounds,
    Constraint,
    Cost,
    End,
    Form,
    GuessOptions,
    Problem,
    Range,
    Representation,
    SolverOptions,
    Term,
)
from mbsrun.ocp.solution.solution import Failure, Solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import Solver, solve
from studies.laboratory.case import Finding, Workspace, check, demand, show_failure, tell
from studies.laboratory.mechanisms import CART_POLE, LOCKS, SLIDE, UNSTABLE, describe_lock, write

Array = NDArray[np.float64]

FREE: Range = (-np.inf, np.inf)
OPTIMUM = 58.8076674583  # J of the published swing-up, by an independent program with degree 5 and 80 intervals
STARTS = 40
NOISE = 3.0  # rad and m: of the random starts
MINIMA = (57.95, 58.81, 303.5)  # J: local minima of the swing-up, by the same program
SAME_MINIMUM = 5e-3  # what 80 intervals of constant input cost at most, by the cost; minima differ by 1.5e-2
GRID_WAYS = (Representation.IMPL, Representation.SEMI, Representation.EXP1_O, Representation.EXP2_O)
GRID_STEPS = {1: (8, 16, 32), 2: (2, 4, 8), 3: (1, 2, 4)}  # in an interval, by degree
EXTENT = Extent((*DIFFERENTIATED, "frames"), 2)


def state_swing_up(intervals: int, degree: int) -> Problem:
    """Swing the pole up in 2 s, 1 m on, with the least integral of the force squared, of at most 20 N."""
    return Problem(
        name="swing-up",
        horizon=2.0,
        intervals=intervals,
        family=Family.RADAU,
        degree=degree,
        cost=Cost(1.0),
        start_q=(0.0, 0.0),
        start_qd=(0.0, 0.0),
        bounds=Bounds(((-2.0, 2.0), FREE), (FREE,) * 2, ((-20.0, 20.0),)),
        end=End(coordinates=((0, 1.0), (1, np.pi)), velocity_zero=True),
    )


def state_push(intervals: int) -> Problem:
    """Push a mass of 1 kg over 1 m in 1 s, from rest to rest."""
    return Problem(
        name="push",
        horizon=1.0,
        intervals=intervals,
        family=Family.RADAU,
        degree=2,
        cost=Cost(1.0),
        start_q=(0.0,),
        start_qd=(0.0,),
        bounds=Bounds((FREE,), (FREE,), (FREE,)),
        end=End(coordinates=((0, 1.0),), velocity_zero=True),
    )


def state_catch(intervals: int, degree: int) -> Problem:
    """Bring an unstable motion from x = 1 to 0 in 2 s."""
    return Problem(
        name="catch",
        horizon=2.0,
        intervals=intervals,
        family=Family.RADAU,
        degree=degree,
        cost=Cost(1.0),
        start_q=(1.0,),
        start_qd=(0.0,),
        bounds=Bounds((FREE,), (FREE,), (FREE,)),
        end=End(coordinates=((0, 0.0),)),
    )


def measure_meshes(workspace: Workspace) -> list[Finding]:
    """F19: the solver succeeds on every mesh; the defect by re-simulation shows which to believe."""
    findings = []
    for representation in Representation:
        defects = {}
        for intervals in (4, 10, 20, 40):  # three constant inputs cannot meet four conditions at the end
            problem = replace(state_swing_up(intervals, 3), representation=representation)
            found, defects[intervals] = _try_mesh(workspace, problem)
            findings.append(found)
        order = _find_orders([defects[n] for n in (10, 20, 40)]).min()
        findings.append(check(representation.value, "order of defects missing", 2 - order, 0, f"order {order:.1f}"))
    return findings


def believe_success(workspace: Workspace) -> list[Finding]:
    """F19: the solver calls ten intervals solved; the largest defect is a thousand times the allowed one, and more."""
    plant, problem = _load(workspace, CART_POLE), state_swing_up(10, 3)
    outcome = solve(problem, plant)
    found, way = _find_defect(outcome, plant), "success of the solver alone"
    remark = f"N = 10, {outcome.run.status}"
    return [show_failure(way, "largest defect of an interval", found, problem.accuracy, remark)]


def measure_lowest_degree(workspace: Workspace) -> list[Finding]:
    """F19: at degree 1 even 1280 intervals are not accurate; the report does not call them so."""
    findings = []
    for representation in (Representation.IMPL, Representation.EXP2_O):
        meshes = (20, 80, 320, 1280)
        problems = [replace(state_swing_up(n, 1), representation=representation) for n in meshes]
        pairs = [_try_mesh(workspace, problem) for problem in problems]
        findings += [found for found, _ in pairs]
        order = (
            float(_find_orders([defect for _, defect in pairs[1:]]).min()) / 2
        )  # from mesh to mesh four times as fine
        remark = f"order {order:.2f} of an interval's defect"
        findings.append(check(representation.value, "order of defects missing", 2 - order, 0.1, remark))
    return findings


def measure_control_grid(workspace: Workspace, degree: int) -> list[Finding]:
    """F19: with 20 constant inputs, and 1 to 32 steps of Radau in each, cost and defect have order 2d - 1."""
    plant, findings = _load(workspace, CART_POLE), []
    theory = 2 * degree - 1
    for representation in GRID_WAYS:
        stated = replace(state_swing_up(20, 5), representation=representation, form=Form.SHOOTING, steps=8)
        way, best = representation.value, solve(stated, plant)
        if isinstance(best, Failure):
            findings.append(demand(way, "solved", False, best.finding))
            continue
        costs, defects = [], []
        for steps in GRID_STEPS[degree]:
            problem = replace(
                state_swing_up(20, degree), representation=representation, form=Form.SHOOTING, steps=steps
            )
            outcome = solve(problem, plant, guess=best.trajectory)
            is_solved = isinstance(outcome, Solution)
            costs.append(abs(outcome.cost.total - best.cost.total) if isinstance(outcome, Solution) else np.nan)
            defects.append(_find_defect(outcome, plant) if is_solved else np.nan)
        for quantity, lost in (("cost", costs), ("defect", defects)):
            order = float(_find_orders(lost)[-1])
            remark = f"order {order:.2f} of {theory}, errors " + ", ".join(f"{x:.1e}" for x in lost)
            off = abs(order - theory)
            findings.append(check(way, f"order of the {quantity}, off 2d - 1 = {theory}", off, 0.1, remark))
    return findings


def _try_mesh(workspace: Workspace, problem: Problem) -> tuple[Finding, float]:
    """Solve on a mesh that is too coarse: the defect, and whether the report says that it is not accurate."""
    plant, way = _load(workspace, CART_POLE), problem.representation.value
    label = f"the report names the inaccuracy, degree {problem.degree}"
    outcome = solve(problem, plant)
    if isinstance(outcome, Failure):
        return demand(way, f"solved, N = {problem.intervals}", False, outcome.finding), float("nan")
    found = resimulate(outcome, plant).resimulation
    defect = float("nan") if found is None or found.defect is None else found.defect
    off = abs(outcome.cost.total / OPTIMUM - 1)
    remark = f"N = {problem.intervals}: defect {defect:.1e}, cost off by {off:.1e}, {outcome.run.status}"
    is_told = found is not None and not found.is_accurate and found.open_loop_error is not None
    if found is not None and found.open_loop_error is not None:
        remark += f", off by {found.open_loop_error:.1e} at the end"
    return demand(way, label, is_told and defect > problem.accuracy, remark), defect


def _find_defect(outcome: Solution | Failure, plant: Mechanism) -> float:
    found = resimulate(outcome, plant).resimulation if isinstance(outcome, Solution) else None
    return float("nan") if found is None or found.defect is None else found.defect


def _find_orders(errors: Sequence[float]) -> Array:
    """Compute orders of errors, each at half the step of the one before; not numbers where one is not positive."""
    with np.errstate(all="ignore"):
        return np.asarray(-np.diff(np.log2(np.array(errors, dtype=np.float64))))


def measure_fine_mesh(workspace: Workspace) -> list[Finding]:
    """F19: degree 5 and 80 intervals are accurate, and have one cost in all representations."""
    plant, findings = _load(workspace, CART_POLE), []
    first = solve(state_swing_up(80, 5), plant)
    if isinstance(first, Failure):
        return [demand(Representation.IMPL.value, "solved", False, first.finding)]
    for representation in Representation:
        problem, way = replace(state_swing_up(80, 5), representation=representation), representation.value
        own, shared = solve(problem, plant), solve(problem, plant, guess=first.trajectory)
        if isinstance(own, Failure) or isinstance(shared, Failure):
            findings.append(demand(way, "solved", False, own.run.status + ", " + shared.run.status))
            continue
        findings.append(check(way, "defect", _find_defect(own, plant), 1e-6))
        findings.append(tell(way, "cost from the own guess", own.cost.total))
        findings.append(check(way, "cost off, from one optimum", abs(shared.cost.total / first.cost.total - 1), 1e-8))
    return findings


def measure_quadrature(_: Workspace) -> list[Finding]:
    """F20: weights sum to one, and integrate what a scheme of that degree integrates, at degree 1 too."""
    findings = []
    for family in Family:
        for degree in schemes.list_degrees(family):
            scheme = schemes.build(family, degree)
            way = f"{family.value}, own weights"
            findings.append(
                check(way, "sum of weights off 1", abs(scheme.weights.sum() - 1), 1e-12, f"degree {degree}")
            )
            powers = range(scheme.exactness + 1)
            off = max(abs(float(scheme.weights @ scheme.points**k) - 1 / (k + 1)) for k in powers)
            findings.append(check(way, "error of exact powers", off, 1e-12, f"degree {degree}"))
    weights = np.array(ca.collocation_coeff([1.0])[2]).ravel()
    way = "radau, weights of CasADi"
    findings.append(show_failure(way, "sum of weights off 1", abs(weights.sum() - 1), 1e-12, "degree 1"))
    return findings


def measure_halved_cost(workspace: Workspace) -> list[Finding]:
    """F20: the force squared as an expression, at degree 1, is h |u|^2, and not half of it."""
    plant, findings = _load(workspace, CART_POLE), []
    for representation in Representation:
        problem = replace(state_swing_up(80, 1), representation=representation)
        problem = replace(problem, cost=Cost(running=(Term("u_cart**2", 1.0),)))
        outcome = solve(problem, plant)
        if isinstance(outcome, Failure):
            findings.append(demand(representation.value, "solved", False, outcome.finding))
            continue
        exact = float((outcome.trajectory.u**2).sum() * 2.0 / 80)
        findings.append(check(representation.value, "cost off its sum", abs(outcome.cost.total / exact - 1), 1e-12))
    return findings


def measure_minima(workspace: Workspace, representation: Representation) -> list[Finding]:
    """F21: forty starts, the same for all representations, reach three minima; failures have a status."""
    plant = _load(workspace, CART_POLE)
    problem = replace(state_swing_up(80, 3), representation=representation)
    solver, costs, failures = Solver(problem, plant), Counter[float](), Counter[str]()
    smooth = interpolate(problem, solver.transcription.scheme, np.array([1.0, np.pi]))
    for seed in range(STARTS):
        outcome = solver.solve(problem, scatter(smooth, seed))
        if isinstance(outcome, Solution):
            costs[float(f"{outcome.cost.total:.4g}")] += 1
        else:
            failures[outcome.run.status] += 1
    return judge_minima(representation.value, costs, failures)


def start_once(workspace: Workspace) -> list[Finding]:
    """F21: from the guess of the problem alone, a minimum is found that is not the lowest."""
    outcome = solve(state_swing_up(80, 3), _load(workspace, CART_POLE))
    cost = outcome.cost.total if isinstance(outcome, Solution) else np.nan
    remark = f"{cost:.4g}, and {min(MINIMA):.4g} is known"
    return [show_failure("one start", "cost above the lowest", cost / min(MINIMA) - 1, SAME_MINIMUM, remark)]


def scatter(smooth: Trajectory, seed: int) -> Trajectory:
    """Replace the inputs of a guess by random ones, and add noise to all its positions."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(-20, 20, smooth.u.shape)
    point_q = smooth.point_q + NOISE * rng.normal(0, 1, smooth.point_q.shape)
    return replace(smooth, u=u, point_q=point_q, q=smooth.q + NOISE * rng.normal(0, 1, smooth.q.shape))


def judge_minima(way: str, costs: Mapping[float, int], failures: Mapping[str, int]) -> list[Finding]:
    """Compare costs, with how often each was found, with the known minima; failures are by their status."""
    spread = ", ".join(f"{count} at {cost:g}" for cost, count in sorted(costs.items())) or "none"
    estimate = ", ".join(f"{count} {status}" for status, count in failures.items()) or "none"
    total = sum(costs.values()) + sum(failures.values())
    findings = [demand(way, "all starts are reported", total == STARTS, f"{spread}; failed: {estimate}")]
    for known in MINIMA:
        off = min((abs(cost / known - 1) for cost in costs), default=float("inf"))
        times = sum(count for cost, count in costs.items() if abs(cost / known - 1) <= SAME_MINIMUM)
        remark = f"{times} of {total} starts; all: {spread}; failed: {estimate}"
        findings.append(check(way, f"minimum of {known:g}, off", off, SAME_MINIMUM, remark))
    return findings


def measure_runaway(workspace: Workspace, rate: float) -> list[Finding]:
    """F22: motions grow by exp(rate T); collocation and multiple shooting bound the growth by intervals."""
    plant, findings = _load(workspace, UNSTABLE.format(rate=rate)), []
    stated = state_catch(40, 4)
    ways = {r.value: replace(stated, representation=r) for r in Representation}
    shooting = replace(stated, representation=Representation.EXP2_O, form=Form.SHOOTING)
    ways["EXP2-O, shooting by Radau"] = shooting
    ways["EXP2-O, shooting by RK4"] = replace(shooting, integrator="rk4", steps=4)
    for way, problem in ways.items():
        solver = Solver(problem, plant)
        zeros = interpolate(replace(problem, start_q=(0.0,)), solver.transcription.scheme, np.zeros(1))
        outcome = solver.solve(problem, zeros)
        growth = f"exp(rate T) = {np.exp(2 * rate):.0e}"
        if isinstance(outcome, Failure):
            findings.append(demand(way, "solved", False, f"{growth}: {outcome.finding}"))
            continue
        findings.append(check(way, "iterations", outcome.run.iterations, 50, growth))
        findings.append(check(way, "error of the end [m]", abs(float(outcome.trajectory.q[-1, 0])), 1e-7, growth))
    moved = 2.0**-53 * np.cosh(2 * rate)  # near 0, sin x is x
    if moved > 1e-7:
        remark = "one rounding of the start, at the end"
        findings.append(show_failure("single shooting", "error of the end [m]", float(moved), 1e-7, remark))
    return findings


def measure_statuses(workspace: Workspace) -> list[Finding]:
    """F23: an unsolved problem is a failure with its own status; the guess is never the answer."""
    plant = _load(workspace, SLIDE)
    return [
        judge_status(representation.value, name, wanted, attempt(plant, representation))
        for representation in Representation
        for name, wanted, attempt in ATTEMPTS
    ]


def ask_ipopt(_: Workspace) -> list[Finding]:
    """F23: IPOPT alone calls the saddle of a cost without bound solved, though lower costs are beside it."""
    x = ca.SX.sym("x")
    options: dict[str, Any] = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}}
    solver = ca.nlpsol("saddle", "ipopt", {"x": x, "f": x**3}, options)
    found = float(solver(x0=0.0)["x"])
    status = solver.stats()["return_status"]
    above = found**3 - (found - 0.1) ** 3 if status == SOLVED else np.nan
    remark = f"{status} at {found:g}, of x^3 from 0"
    return [show_failure("IPOPT alone", "cost above a point 0.1 away", above, 0, remark)]


def judge_status(way: str, name: str, wanted: str, outcome: Solution | Failure) -> Finding:
    """Demand one status, and with it a solution, or none."""
    remark = f"{outcome.run.status}, {wanted} is right"
    if isinstance(outcome, Solution):
        remark += f"; cost {outcome.cost.total:.6g}"
    is_right = outcome.run.status == wanted and isinstance(outcome, Solution) == (wanted == SOLVED)
    return demand(way, name, is_right, remark)


def measure_locked_start(workspace: Workspace) -> list[Finding]:
    """F23: a kernel that fails at the guess is no number for the solver: explicit forms at a lock; residuals go on."""
    plant, findings = _load(workspace, describe_lock(LOCKS["Cardan"])), []
    for representation in Representation:
        outcome = solve(state_locked_start(20, representation), plant)
        wanted = "Invalid_Number_Detected" if representation.is_explicit else SOLVED
        findings.append(judge_status(representation.value, "a start at a lock", wanted, outcome))
    return findings


def state_locked_start(intervals: int, representation: Representation) -> Problem:
    """Turn out of a lock with the least accelerations.

    Least forces would leave the motion near the lock to rounding: links without mass may turn there at no price.
    """
    return Problem(
        name="locked",
        horizon=1.0,
        intervals=intervals,
        family=Family.RADAU,
        degree=2,
        representation=representation,
        cost=Cost(running=(Term("qdd_q1**2 + qdd_q2**2 + qdd_q3**2", 1.0),)),
        start_q=(0.0, np.pi / 2, 0.0),
        start_qd=(0.0,) * 3,
        bounds=Bounds((FREE,) * 3, (FREE,) * 3, (FREE,) * 3),
        end=End(coordinates=((0, 0.1), (1, np.pi / 2 - 0.5), (2, 0.2))),
        guess=GuessOptions(inputs="static"),
        solver=SolverOptions(max_iterations=200),
    )


Attempt = Callable[[Mechanism, Representation], Solution | Failure]


def _ask_too_much(plant: Mechanism, representation: Representation) -> Solution | Failure:
    weak = Bounds((FREE,), (FREE,), ((-2.0, 2.0),))
    return solve(replace(state_push(8), representation=representation, bounds=weak), plant)


def _guess_nothing(plant: Mechanism, representation: Representation) -> Solution | Failure:
    problem = replace(state_push(8), representation=representation)
    guess = interpolate(problem, schemes.build(Family.RADAU, 2), np.array([np.nan]))
    return Solver(problem, plant).solve(problem, guess)


def _start_at_saddle(plant: Mechanism, representation: Representation) -> Solution | Failure:
    cost = Cost(0.0, 0.0, terminal=(Term("q_slide**3", 1.0),))
    problem = replace(state_push(4), representation=representation, cost=cost, end=End())
    runaway = (("diverging_iterates_tol", 1e8),)
    problem = replace(problem, solver=SolverOptions(options=runaway))
    solver = Solver(problem, plant)
    return solver.solve(problem, interpolate(problem, solver.transcription.scheme, np.zeros(1)))


def _repeat_constraint(plant: Mechanism, representation: Representation) -> Solution | Failure:
    again = (Constraint("q_slide", (1.0, 1.0), "end"),)
    return solve(replace(state_push(8), representation=representation, constraints=again), plant)


def _leave_no_freedom(plant: Mechanism, representation: Representation) -> Solution | Failure:
    return solve(replace(state_push(1), representation=representation), plant)


def _contradict(plant: Mechanism, representation: Representation) -> Solution | Failure:
    other = (Constraint("q_slide", (2.0, 2.0), "end"),)
    return solve(replace(state_push(8), representation=representation, constraints=other), plant)


ATTEMPTS: tuple[tuple[str, str, Attempt], ...] = (
    ("less force than it takes", "Infeasible_Problem_Detected", _ask_too_much),
    ("a guess that is not a number", BAD_GUESS, _guess_nothing),
    ("a cost without bound, guessed at its saddle", "Diverging_Iterates", _start_at_saddle),
    ("more equations than unknowns", "Not_Enough_Degrees_Of_Freedom", _leave_no_freedom),
    ("two ends at once", "Infeasible_Problem_Detected", _contradict),
    ("an end that is asked for twice", SOLVED, _repeat_constraint),
)


def _load(workspace: Workspace, text: str) -> Mechanism:
    return Mechanism(find_folder(write(workspace.folder, text), EXTENT))
