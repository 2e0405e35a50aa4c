"""The project's own interior-point method for problems in stages, in C: see csrc/stages.

The program is written as tables of stages, once for all solves whose bounds and weights vanish in the same places.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mbsrun.ocp.evaluation.backends.prepared import Prepared
from mbsrun.ocp.evaluation.stages import binding
from mbsrun.ocp.evaluation.stages.building import build
from mbsrun.ocp.evaluation.stages.tables import StageProgram
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.memory import Memory
from mbsrun.ocp.ground.program import Program
from mbsrun.ocp.ground.status import ACCEPTABLE, INVALID, SOLVED, STALLED, NoNumbersError
from mbsrun.ocp.methods.method import Answer, Assignment, Instance, Iterate, Method, Near, Solver
from mbsrun.ocp.methods.options import COUNT, FRACTION, POSITIVE, SWITCH, Amount, Option, Settings

LANES = "lanes"  # the option by which the points of an interval are computed at once
# Other ones are fields of mbs_stages_options in mbs_stages.h, which states what they mean, and their defaults.
STAGES_OPTIONS: Mapping[str, Option] = {
    "acceptable_iter": COUNT,
    "acceptable_tol": POSITIVE,
    "adaptive": SWITCH,
    "alpha_min_frac": FRACTION,
    "barrier_tol_factor": POSITIVE,
    "bound_mult_reset_threshold": POSITIVE,
    "bound_push": Amount(1e-20, 0.5),
    "bound_relax_factor": Amount(0.0, 0.5),
    "by_stage": SWITCH,
    "constr_viol_tol": POSITIVE,
    "delta": POSITIVE,
    "diverging_iterates_tol": POSITIVE,
    "eta_phi": Amount(1e-20, 0.5),
    "first_hessian_perturbation": POSITIVE,
    "gamma_phi": FRACTION,
    "gamma_theta": FRACTION,
    "kappa_d": FRACTION,
    "kappa_sigma": Amount(1.0, 1e20),
    "kappa_soc": FRACTION,
    LANES: SWITCH,
    "max_hessian_perturbation": POSITIVE,
    "max_refinement_steps": COUNT,
    "max_soc": COUNT,
    "max_soft_resto_iters": COUNT,
    "max_wall_time": POSITIVE,
    "min_hessian_perturbation": POSITIVE,
    "mu_init": POSITIVE,
    "mu_linear_decrease_factor": Amount(1e-10, 1 - 1e-10),
    "mu_superlinear_decrease_power": Amount(1 + 1e-10, 2 - 1e-10),
    "mu_target": Amount(0.0, 1e20),
    "nlp_scaling_max_gradient": POSITIVE,
    "nlp_scaling_min_value": POSITIVE,
    "obj_max_inc": Amount(1.0, 100.0),
    "perturb_inc_fact": Amount(1.0 + 1e-10, 1e20),
    "perturb_inc_fact_first": Amount(1.0 + 1e-10, 1e20),
    "required_infeasibility_reduction": FRACTION,
    "resto_penalty_parameter": POSITIVE,
    "s_max": POSITIVE,
    "s_phi": Amount(1.0 + 1e-10, 100.0),
    "s_theta": Amount(1.0 + 1e-10, 100.0),
    "scale_by_bounds": SWITCH,
    "scaled": SWITCH,
    "soft_resto_pderror_reduction_factor": FRACTION,
    "tau_min": Amount(1e-10, 1 - 1e-10),
    "theta_max_fact": POSITIVE,
    "theta_min_fact": POSITIVE,
    "watchdog_shortened_iter_trigger": COUNT,
    "watchdog_trial_iter_max": COUNT,
}

INFEASIBLE, OVERDETERMINED = "Infeasible_Problem_Detected", "Not_Enough_Degrees_Of_Freedom"
OTHER_LAYOUT = "Not_Near"  # a start near a solution whose variables have another order
STATUSES = {
    "MBS_STAGES_SOLVED": SOLVED,
    "MBS_STAGES_ACCEPTABLE": ACCEPTABLE,
    "MBS_STAGES_INFEASIBLE": INFEASIBLE,
    "MBS_STAGES_ITERATION_LIMIT": "Maximum_Iterations_Exceeded",
    "MBS_STAGES_TIME_LIMIT": "Maximum_WallTime_Exceeded",
    "MBS_STAGES_OUT_OF_DIGITS": STALLED,
    "MBS_STAGES_UNBOUNDED": "Diverging_Iterates",
    "MBS_STAGES_CALLBACK_FAILED": INVALID,
}


def make_stages(order: Assignment) -> Solver:
    """Make the method for a program."""
    settings, has_lanes = read_settings(order), order.options.get(LANES) == "yes"
    tables: dict[bytes, binding.Tables] = {}
    free: dict[bytes, list[binding.Solver]] = {}  # solvers that nobody uses now
    lock = threading.Lock()
    starts = dict[int, binding.Settings]()  # options near a solution, by the most iterations
    program = order.program.data

    def lay(numbers: binding.Numbers) -> bytes:
        """Build tables unless there are some; return their key."""
        weights = numbers.parameters[: len(program.H)] != 0
        rows = np.isfinite(numbers.least) | np.isfinite(numbers.most)
        key = bytes(weights.tobytes() + rows.tobytes())
        with lock:
            if key not in tables:
                plants = order.program.plant, order.program.others
                tables[key] = binding.Tables(build(program, plants[0], weights, rows, plants[1]), *plants)
                free[key] = []
        return key

    def solve(start: Instance) -> Answer:
        numbers = _expand(program, start, order.scaling)
        begin, cpu_begin = time.perf_counter(), time.process_time()
        key = lay(numbers)
        preparing = time.perf_counter() - begin, time.process_time() - cpu_begin
        crossed = binding.find_crossed(tables[key].data, numbers)
        if crossed:
            return Answer(start.x, INFEASIBLE, 0, clash=crossed)
        if start.near is not None and start.near.layout != key:
            return Answer(start.x, OTHER_LAYOUT, 0)
        with lock:
            solver = free[key].pop() if free[key] else binding.Solver(tables[key], order.threads, has_lanes=has_lanes)

        def show(progress: binding.Progress) -> None:
            assert start.watch is not None, "only a watch is shown iterates"
            start.watch(Iterate(progress.iteration, progress.cost / order.scaling, progress.violation))

        try:
            watch = None if start.watch is None else show
            if start.near is None:
                outcome = solver.solve(_complete(order.program, start.x), numbers, settings, watch)
            else:
                most = start.most_iterations
                if most not in starts:
                    starts[most] = start_near(settings, most)
                outcome = solver.solve(start.near.point, numbers, starts[most], watch)
        finally:
            with lock:
                free[key].append(solver)
        answer = _answer(program, tables[key].data, outcome, order.scaling)
        if answer.status == INFEASIBLE and _count_equations(start) > np.count_nonzero(start.lower < start.upper):
            answer = replace(answer, status=OVERDETERMINED)
        near = Near(key, outcome.point)
        return replace(answer, near=near, preparing=preparing[0], cpu_preparing=preparing[1])

    return solve


def read_settings(order: Assignment) -> binding.Settings:
    """Return the options by the names of the C structure; switches are 1 or 0.

    Where the program eliminates variables, as in shooting, they follow the others in line searches, too.
    """
    given: Settings = {"acceptable_tol": max(order.tolerance, 1e-6), **order.options}
    words = {"yes": 1.0, "no": 0.0}
    apart = ("max_wall_time", LANES)
    numbers = {name: float(words.get(str(value), value)) for name, value in given.items() if name not in apart}
    program = order.program.data
    limits = {"tol": order.tolerance, "max_iter": float(order.max_iterations)}
    limits["follow"] = float(len(program.kept) < program.variables)
    return binding.Settings({**limits, **numbers}, float(given.get("max_wall_time", 0.0)))


def start_near(settings: binding.Settings, most_iterations: int) -> binding.Settings:
    """Return the options of a start from the solution of another problem, with its multipliers."""
    most = min(settings.values["max_iter"], float(most_iterations or np.inf))
    return replace(settings, values={**settings.values, "warm_start_init_point": 2.0, "max_iter": most})


def _expand(program: Program, start: Instance, scaling: float) -> binding.Numbers:
    """Return the numbers of a solve for all variables and rows; equations of inner variables are 0."""
    lower, upper = np.full(program.variables, -np.inf), np.full(program.variables, np.inf)
    lower[program.kept], upper[program.kept] = start.lower, start.upper
    least, most = np.zeros(program.constraints), np.zeros(program.constraints)
    least[program.kept_rows], most[program.kept_rows] = start.g_lower, start.g_upper
    parameters = start.parameters.astype(np.float64)
    parameters[: len(program.H)] *= scaling
    scales = np.ones(program.variables)
    if start.scales is not None:
        scales[program.kept] = start.scales
    return binding.Numbers(parameters, lower, upper, least, most, scales)


def _count_equations(start: Instance) -> int:
    return int(np.count_nonzero(start.g_lower == start.g_upper))


def _complete(program: Prepared, x: Array) -> Array:
    """Return all variables; inner ones are 0 where their equations have no solution."""
    try:
        return program.numpy.complete(x)
    except NoNumbersError:
        whole = np.zeros(program.data.variables)
        whole[program.data.kept] = x
        return whole


def _answer(program: Program, tables: StageProgram, outcome: binding.Outcome, scaling: float) -> Answer:
    x = np.zeros(program.variables)
    known = tables.variables >= 0
    x[tables.variables[known]] = outcome.point.w[known]
    status = STATUSES.get(outcome.status, outcome.status)
    clash = tuple(row for clash in outcome.clashes if (row := _find_row(tables, clash)) >= 0)
    return Answer(
        x[program.kept],
        status,
        outcome.iterations,
        outcome.evaluating,
        outcome.cpu_evaluating,
        multipliers=_read_multipliers(program, tables, outcome) / scaling,
        clash=clash,
    )


def _read_multipliers(program: Program, tables: StageProgram, outcome: binding.Outcome) -> Array:
    """Return multipliers of the program's rows.

    A row that gives a next state has the factor -1 / a in the tables, where a is the coefficient of that state. A row
    that is a first state gives bounds of it, which have its multiplier.
    """
    places, rows, factors = MULTIPLIERS.find(lambda: place_multipliers(program, tables), tables, program)
    weights = factors * outcome.point.y[places]
    found = np.asarray(np.bincount(rows, weights, minlength=program.constraints), dtype=np.float64)
    variable, row = tables.fixed.T
    found[row] += outcome.z[variable]
    return found[program.kept_rows]


def place_multipliers(program: Program, tables: StageProgram) -> tuple[Indices, Indices, Array]:
    """Return the multipliers of the tables that the program's rows have, these rows, and factors."""
    kinds = [tables.kinds[kind] for kind in tables.kind_of_stage]
    first = np.cumsum([0, *(kind.nx + kind.nv for kind in kinds)])
    nexts = [*(kind.nx for kind in kinds[1:]), 0]
    sizes = np.array([(kind.ne, after, kind.ng) for kind, after in zip(kinds, nexts, strict=True)])
    part = np.repeat(np.tile(np.arange(3), len(kinds)), sizes.ravel())
    following = [np.arange(first[k + 1], first[k + 1] + nexts[k]) for k in range(len(kinds) - 1)]
    states = tables.variables[np.concatenate([_NONE, *following])]
    places, every = (
        [np.flatnonzero(part == number) for number in range(3)],
        (tables.rows_e, tables.rows_d, tables.rows_g),
    )
    known = [every[0] >= 0, (every[1] >= 0) & (states >= 0), every[2] >= 0]
    rows = [own[chosen] for own, chosen in zip(every, known, strict=True)]
    factors = [np.ones(own.size) for own in rows]
    factors[1] = -1 / np.asarray(program.A[rows[1], states[known[1]]]).ravel()
    chosen = [own[which] for own, which in zip(places, known, strict=True)]
    return np.concatenate(chosen), np.concatenate(rows), np.concatenate(factors)


MULTIPLIERS = Memory[tuple[Indices, Indices, Array]]()
_NONE = np.zeros(0, dtype=np.int64)


def _find_row(tables: StageProgram, clash: binding.Clash) -> int:
    """Return the program's row of a row of the tables; -1: one of the tables alone."""
    kinds = [tables.kinds[kind] for kind in tables.kind_of_stage]
    nx = [kind.nx for kind in kinds[1:]]
    counts = ([kind.ne for kind in kinds], nx, [kind.ng for kind in kinds])[clash.kind]
    rows = (tables.rows_e, tables.rows_d, tables.rows_g)[clash.kind]
    return int(rows[sum(counts[: clash.stage]) + clash.row])


STAGES = Method(
    "the project's own interior-point method, by stages",
    STAGES_OPTIONS,
    make_stages,
    {"mu_init": 1e-5},
    calls_casadi=False,
    has_threads=True,
)
