"""Optimal control: coarse meshes, quadrature, many minima, motions that run away, what solvers say (F19 to F23)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mbsrun.external import Mechanism
from mbsrun.lab.case import Bench, Finding, check, demand, tell
from mbsrun.lab.mechanisms import CART_POLE, LOCKS, SLIDE, UNSTABLE, describe_lock, write
from mbsrun.models import Extent, find_folder
from mbsrun.ocp import schemes
from mbsrun.ocp.guess import interpolate
from mbsrun.ocp.problem import (
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
from mbsrun.ocp.resimulation import resimulate
from mbsrun.ocp.schemes import Family
from mbsrun.ocp.solution import Failure, Solution
from mbsrun.ocp.solve import Solver, solve

Array = NDArray[np.float64]

FREE: Range = (-np.inf, np.inf)
OPTIMUM = 58.8076674583  # J of the published swing-up, by an independent program with degree 5 and 80 intervals
STARTS = 40
EXTENT = Extent(("impl", "semi_res", "exp1", "exp2", "frames"), 2)


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
    """Bring what runs away from x = 1 to 0 in 2 s."""
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


def measure_meshes(bench: Bench) -> list[Finding]:
    """F19: the solver succeeds on every mesh; the defect by re-simulation tells which to believe."""
    plant, findings = _load(bench, CART_POLE), []
    for representation in Representation:
        defects = []
        for intervals in (4, 10, 20, 40):
            outcome = solve(replace(state_swing_up(intervals, 3), representation=representation), plant)
            if isinstance(outcome, Failure):
                findings.append(demand(representation.value, f"solved, N = {intervals}", False, outcome.finding))
                continue
            check_ = resimulate(outcome, plant).resimulation
            defect = np.inf if check_ is None or check_.defect is None else check_.defect
            off = abs(outcome.cost.total / OPTIMUM - 1)
            remark = f"N = {intervals}: defect {defect:.1e}, cost off by {off:.1e}, {outcome.run.status}"
            is_told = check_ is not None and not check_.is_accurate and check_.open_loop_error is not None
            findings.append(demand(representation.value, "inaccuracy is told", is_told, remark))
            defects.append(defect)
        orders = -np.diff(np.log2(defects[1:]))  # between meshes that each halve the intervals of the one before
        order = float(orders.min(initial=np.inf)) if len(orders) == 2 else 0.0
        findings.append(demand(representation.value, "order of defects", order >= 2, f"order {order:.1f}"))
    return findings


def measure_fine_mesh(bench: Bench) -> list[Finding]:
    """F19: degree 5 and 80 intervals are accurate, and have one cost in all representations."""
    plant, findings = _load(bench, CART_POLE), []
    first = solve(state_swing_up(80, 5), plant)
    if isinstance(first, Failure):
        return [demand(Representation.IMPL.value, "solved", False, first.finding)]
    for representation in Representation:
        problem, way = replace(state_swing_up(80, 5), representation=representation), representation.value
        own, shared = solve(problem, plant), solve(problem, plant, guess=first.trajectory)
        if isinstance(own, Failure) or isinstance(shared, Failure):
            findings.append(demand(way, "solved", False, own.run.status + ", " + shared.run.status))
            continue
        found = resimulate(own, plant).resimulation
        defect = np.inf if found is None or found.defect is None else found.defect
        findings.append(check(way, "defect", defect, 1e-6))
        findings.append(tell(way, "cost from the own guess", own.cost.total))
        findings.append(check(way, "cost off, from one optimum", abs(shared.cost.total / first.cost.total - 1), 1e-8))
    return findings


def measure_quadrature(_: Bench) -> list[Finding]:
    """F20: weights sum to one, and integrate what a scheme of that degree integrates, at degree 1 too."""
    findings = []
    for family in Family:
        for degree in schemes.DEGREES:
            scheme = schemes.build(family, degree)
            way = f"{family.value}, own weights"
            findings.append(
                check(way, "sum of weights off 1", abs(scheme.weights.sum() - 1), 1e-12, f"degree {degree}")
            )
            powers = range(scheme.exactness + 1)
            off = max(abs(float(scheme.weights @ scheme.points**k) - 1 / (k + 1)) for k in powers)
            findings.append(check(way, "error of exact powers", off, 1e-12, f"degree {degree}"))
    return findings


def measure_halved_cost(bench: Bench) -> list[Finding]:
    """F20: the force squared as an expression, at degree 1, is h |u|^2, and not half of it."""
    plant, findings = _load(bench, CART_POLE), []
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


def measure_minima(bench: Bench, representation: Representation) -> list[Finding]:
    """F21: forty starts, the same for all representations; what fails says so, and the best known is found."""
    plant = _load(bench, CART_POLE)
    problem = replace(state_swing_up(25, 3), representation=representation)
    solver, costs, failures = Solver(problem, plant), Counter[float](), Counter[str]()
    smooth = interpolate(problem, solver.transcription.scheme, np.array([1.0, np.pi]))
    for seed in range(STARTS):
        rng = np.random.default_rng(seed)
        u = rng.uniform(-20, 20, smooth.u.shape)
        noise = rng.normal(0, 1, smooth.point_q.shape)
        start = replace(smooth, u=u, point_q=smooth.point_q + noise, q=smooth.q + rng.normal(0, 1, smooth.q.shape))
        outcome = solver.solve(problem, start)
        if isinstance(outcome, Solution):
            costs[float(f"{outcome.cost.total:.4g}")] += 1
        else:
            failures[outcome.run.status] += 1
    way = representation.value
    spread = ", ".join(f"{count} at {cost:g}" for cost, count in sorted(costs.items()))
    told = ", ".join(f"{count} {status}" for status, count in failures.items()) or "none"
    best = min(costs, default=np.inf)
    return [
        demand(way, "failures are failures", "Solve_Succeeded" not in failures, told),
        check(way, "best minimum, off the published one", best / OPTIMUM - 1, 0.05, f"of {STARTS} starts {spread}"),
        tell(way, "starts in the best minimum", costs[best], f"and {sum(failures.values())} failed: {told}"),
    ]


def measure_runaway(bench: Bench, rate: float) -> list[Finding]:
    """F22: motions grow by exp(rate T); collocation and multiple shooting bound the growth by intervals."""
    plant, findings = _load(bench, UNSTABLE.format(rate=rate)), []
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
    return findings


def measure_statuses(bench: Bench) -> list[Finding]:
    """F23: what is not solved is a failure, in the solver's word, and never the guess."""
    plant, findings = _load(bench, SLIDE), []
    for representation in Representation:
        for name, wanted, attempt in ATTEMPTS:
            outcome = attempt(plant, representation)
            is_failure = isinstance(outcome, Failure)
            remark = f"{name}: {outcome.run.status}"
            if isinstance(outcome, Solution):
                remark += f", cost {outcome.cost.total:.6g}"
            findings.append(demand(representation.value, wanted, is_failure == (wanted == "failure"), remark))
    return findings


def measure_locked_start(bench: Bench) -> list[Finding]:
    """F23: a kernel that fails at the guess is no number for the solver: explicit forms at a lock; residuals go on."""
    plant, findings = _load(bench, describe_lock(LOCKS["Cardan"])), []
    problem = Problem(
        name="locked",
        horizon=1.0,
        intervals=5,
        family=Family.RADAU,
        degree=2,
        cost=Cost(1.0),
        start_q=(0.0, np.pi / 2, 0.0),
        start_qd=(0.0,) * 3,
        bounds=Bounds((FREE,) * 3, (FREE,) * 3, (FREE,) * 3),
        end=End(coordinates=((0, 0.1), (1, np.pi / 2), (2, 0.2))),
        guess=GuessOptions(inputs="zero"),
        solver=SolverOptions(max_iterations=100),
    )
    for representation in Representation:
        outcome = solve(replace(problem, representation=representation), plant)
        status = outcome.run.status
        if representation.is_explicit:
            is_told = isinstance(outcome, Failure) and status == "Invalid_Number_Detected"
            findings.append(demand(representation.value, "failure at a lock", is_told, status))
        else:
            findings.append(
                demand(representation.value, "answer at a lock", status != "Invalid_Number_Detected", status)
            )
    return findings


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
    problem = replace(problem, solver=SolverOptions(max_iterations=60))
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
    ("less force than it takes", "failure", _ask_too_much),
    ("a guess that is not a number", "failure", _guess_nothing),
    ("a cost without bound, guessed at its saddle", "failure", _start_at_saddle),
    ("more equations than unknowns", "failure", _leave_no_freedom),
    ("two ends at once", "failure", _contradict),
    ("an end that is asked for twice", "solution", _repeat_constraint),
)


def _load(bench: Bench, text: str) -> Mechanism:
    return Mechanism(find_folder(write(bench.folder, text), EXTENT))
