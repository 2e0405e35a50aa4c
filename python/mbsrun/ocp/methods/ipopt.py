"""IPOPT, with the program's own derivatives: an interior-point method with a filter line search.

Waechter, Biegler, "On the implementation of an interior-point filter line-search algorithm for large-scale nonlinear
programming", Mathematical Programming 106 (2006). See `linear` for the linear solvers.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

from mbsrun.ocp.ground.linear import LINEAR_SOLVERS, MUMPS, OWN, set_up
from mbsrun.ocp.methods.method import Answer, Assignment, Instance, Method, Solver
from mbsrun.ocp.methods.options import COUNT, FRACTION, POSITIVE, SWITCH, Amount, Choice, Option, Settings

if TYPE_CHECKING:
    import casadi as ca

    from mbsrun.ocp.evaluation.backends.casadi import Differentiated

LINEAR_SOLVER = "linear_solver"  # by default MUMPS, if one of MUMPS's options is given; else the project's

IPOPT_OPTIONS: Mapping[str, Option] = {
    "accept_every_trial_step": SWITCH,
    "acceptable_iter": COUNT,
    "acceptable_tol": POSITIVE,
    "adaptive_mu_globalization": Choice(("kkt-error", "obj-constr-filter", "never-monotone-mode")),
    "alpha_for_y": Choice(("primal", "bound-mult", "min", "max", "full", "primal-and-full")),
    "barrier_tol_factor": POSITIVE,
    "bound_frac": Amount(1e-20, 0.5),
    "bound_mult_init_method": Choice(("constant", "mu-based")),
    "bound_push": POSITIVE,
    "bound_relax_factor": Amount(0.0, 1.0),
    "compl_inf_tol": POSITIVE,
    "constr_viol_tol": POSITIVE,
    "diverging_iterates_tol": POSITIVE,
    "dual_inf_tol": POSITIVE,
    "expect_infeasible_problem": SWITCH,
    "fast_step_computation": SWITCH,
    "fixed_variable_treatment": Choice(("make_parameter", "make_constraint", "relax_bounds")),
    "hessian_approximation": Choice(("exact", "limited-memory")),
    "least_square_init_duals": SWITCH,
    "least_square_init_primal": SWITCH,
    "limited_memory_max_history": COUNT,
    LINEAR_SOLVER: Choice(LINEAR_SOLVERS),
    "line_search_method": Choice(("filter", "cg-penalty", "penalty")),
    "max_cpu_time": POSITIVE,
    "max_wall_time": POSITIVE,
    "max_refinement_steps": COUNT,
    "max_soc": COUNT,
    "min_refinement_steps": COUNT,
    "mu_init": POSITIVE,
    "mu_linear_decrease_factor": Amount(1e-10, 1 - 1e-10),
    "mu_max": POSITIVE,
    "mu_min": POSITIVE,
    "mu_oracle": Choice(("probing", "loqo", "quality-function")),
    "mu_strategy": Choice(("monotone", "adaptive")),
    "mu_superlinear_decrease_power": Amount(1 + 1e-10, 2 - 1e-10),
    "mu_target": Amount(0.0, 1e20),
    "mumps_pivot_order": Amount(0, 7, whole=True),
    "mumps_pivtol": FRACTION,
    "mumps_pivtolmax": FRACTION,
    "mumps_permuting_scaling": Amount(0, 7, whole=True),
    "mumps_scaling": Amount(-2, 77, whole=True),
    "nlp_scaling_max_gradient": POSITIVE,
    "nlp_scaling_method": Choice(("none", "gradient-based")),
    "perturb_always_cd": SWITCH,
    "recalc_y": SWITCH,
    "warm_start_init_point": SWITCH,
}

QUIET: Settings = {"print_level": 0, "sb": "yes", "nlp_scaling_method": "none"}


def make_ipopt(order: Assignment) -> Solver:
    """Make IPOPT for a program: in scaled variables and rows, where a start has usual sizes other than 1."""
    from mbsrun.ocp.methods.scaling import ScaledFunctions, scale_rows, scale_start, unscale  # loads CasADi

    functions = order.program.casadi
    plain, scaled = _make(order, functions), cache(lambda: _make(order, ScaledFunctions(functions)))

    def solve(start: Instance) -> Answer:
        if start.scales is None or (start.scales == 1).all():
            return plain(start)
        rows = scale_rows(functions, start, start.scales)
        return unscale(scaled()(scale_start(start, start.scales, rows)), start.scales, rows)

    return solve


def _make(order: Assignment, functions: Differentiated) -> Solver:
    """Make IPOPT for functions of a program."""
    from mbsrun.ocp.methods.nlpsol import UNDIFFERENTIATED, make

    given = {"tol": order.tolerance, "max_iter": order.max_iterations, "obj_scaling_factor": order.scaling}
    settings: dict[str, Any] = {
        **UNDIFFERENTIATED,
        "grad_f": functions.gradient,
        "jac_g": pair(functions.jacobian),
        "ipopt": {**QUIET, **given, **_choose_linear_solver(order.options)},
    }
    if order.options.get("hessian_approximation") != "limited-memory":
        settings["hess_lag"] = functions.hessian
    return make("ipopt", functions, settings)


def pair(jacobian: ca.Function) -> ca.Function:
    """Return (x, p) -> g, Jacobian, as `nlpsol` takes it; IPOPT does not read g here, so it is left out."""
    import casadi as ca

    x, p = jacobian.mx_in()
    outputs = [ca.MX(jacobian.size1_out(0), 1), jacobian(x, p)]
    return ca.Function("nlp_jac_g", [x, p], outputs, ["x", "p"], ["g", "jac_g_x"])


def _choose_linear_solver(options: Settings) -> Settings:
    """Replace the name of a linear solver, given or not, by the options that make IPOPT use it."""
    default = MUMPS if any(name.startswith("mumps_") for name in options) else OWN
    others = {name: value for name, value in options.items() if name != LINEAR_SOLVER}
    return {**set_up(str(options.get(LINEAR_SOLVER, default))), **others}


IPOPT = Method("interior points with a filter line search", IPOPT_OPTIONS, make_ipopt, {"mu_init": 1e-5})
