"""The NLP solvers that a problem may choose, and the options that they take.

A problem file comes from anywhere, and solvers have options that write files or load libraries: only the options in
these tables are passed on. IPOPT and `sqpmethod`, whose quadratic programs IPOPT solves, get the program's own
derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from mbsrun.ocp.linear import LINEAR_SOLVERS, MUMPS, OWN, set_up
from mbsrun.ocp.program import NonlinearProgram

Setting = float | int | str
Settings = Mapping[str, Setting]

SUCCEEDED = "Solve_Succeeded"


@dataclass(frozen=True)
class Amount:
    """An option that is a number within a range; a whole one, if `whole`."""

    least: float
    most: float
    whole: bool = False

    @property
    def wanted(self) -> str:
        """Say what is wanted."""
        return f"a {'whole ' if self.whole else ''}number from {self.least:g} to {self.most:g}"

    def admits(self, value: object) -> bool:
        """Tell whether a value will do."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            return False
        return self.least <= value <= self.most and (not self.whole or value == int(value))


@dataclass(frozen=True)
class Choice:
    """An option that is one of some words."""

    words: tuple[str, ...]

    @property
    def wanted(self) -> str:
        """Say what is wanted."""
        return f"one of {', '.join(self.words)}"

    def admits(self, value: object) -> bool:
        """Tell whether a value will do."""
        return value in self.words


Option = Amount | Choice

_POSITIVE = Amount(1e-20, 1e20)
_FRACTION = Amount(0.0, 1.0)
_COUNT = Amount(0, 100_000, whole=True)
_SWITCH = Choice(("yes", "no"))

LINEAR_SOLVER = "linear_solver"  # MUMPS, if one of its own options is told; else the project's

IPOPT_OPTIONS: Mapping[str, Option] = {
    "accept_every_trial_step": _SWITCH,
    "acceptable_iter": _COUNT,
    "acceptable_tol": _POSITIVE,
    "adaptive_mu_globalization": Choice(("kkt-error", "obj-constr-filter", "never-monotone-mode")),
    "alpha_for_y": Choice(("primal", "bound-mult", "min", "max", "full", "primal-and-full")),
    "barrier_tol_factor": _POSITIVE,
    "bound_frac": Amount(1e-20, 0.5),
    "bound_mult_init_method": Choice(("constant", "mu-based")),
    "bound_push": _POSITIVE,
    "bound_relax_factor": Amount(0.0, 1.0),
    "compl_inf_tol": _POSITIVE,
    "constr_viol_tol": _POSITIVE,
    "dual_inf_tol": _POSITIVE,
    "expect_infeasible_problem": _SWITCH,
    "fast_step_computation": _SWITCH,
    "fixed_variable_treatment": Choice(("make_parameter", "make_constraint", "relax_bounds")),
    "hessian_approximation": Choice(("exact", "limited-memory")),
    "least_square_init_duals": _SWITCH,
    "least_square_init_primal": _SWITCH,
    "limited_memory_max_history": _COUNT,
    LINEAR_SOLVER: Choice(LINEAR_SOLVERS),
    "line_search_method": Choice(("filter", "cg-penalty", "penalty")),
    "max_cpu_time": _POSITIVE,
    "max_wall_time": _POSITIVE,
    "max_refinement_steps": _COUNT,
    "max_soc": _COUNT,
    "min_refinement_steps": _COUNT,
    "mu_init": _POSITIVE,
    "mu_linear_decrease_factor": Amount(1e-10, 1 - 1e-10),
    "mu_max": _POSITIVE,
    "mu_min": _POSITIVE,
    "mu_oracle": Choice(("probing", "loqo", "quality-function")),
    "mu_strategy": Choice(("monotone", "adaptive")),
    "mu_superlinear_decrease_power": Amount(1 + 1e-10, 2 - 1e-10),
    "mu_target": Amount(0.0, 1e20),
    "mumps_pivot_order": Amount(0, 7, whole=True),
    "mumps_pivtol": _FRACTION,
    "mumps_pivtolmax": _FRACTION,
    "mumps_permuting_scaling": Amount(0, 7, whole=True),
    "mumps_scaling": Amount(-2, 77, whole=True),
    "nlp_scaling_max_gradient": _POSITIVE,
    "nlp_scaling_method": Choice(("none", "gradient-based")),
    "perturb_always_cd": _SWITCH,
    "recalc_y": _SWITCH,
    "warm_start_init_point": _SWITCH,
}

SQP_OPTIONS: Mapping[str, Option] = {
    "beta": _FRACTION,
    "c1": _FRACTION,
    "convexify_strategy": Choice(("NONE", "regularize", "eigen-reflect", "eigen-clip")),
    "max_iter_ls": _COUNT,
    "merit_memory": _COUNT,
    "min_step_size": Amount(0.0, 1.0),
}

_IPOPT: Settings = {"print_level": 0, "sb": "yes", "nlp_scaling_method": "none"}


# Sensitivities to parameters, which nobody asks for, and for which CasADi would differentiate the whole.
_UNDIFFERENTIATED: Mapping[str, bool] = {"calc_lam_p": False, "no_nlp_grad": True}


@dataclass(frozen=True)
class Order:
    """What a solver is to do with a program."""

    program: NonlinearProgram
    tolerance: float
    max_iterations: int
    scaling: float  # of the objective
    options: Settings
    callback: ca.Callback


@dataclass(frozen=True)
class Method:
    """A solver: the options it takes, how it is made, and what it says when it is through."""

    options: Mapping[str, Option]
    make: Callable[[Order], ca.Function]
    scales_outside: bool  # whether the solver sees, and reports, the scaled objective


def _symbols(order: Order) -> tuple[ca.MX, ca.MX]:
    return ca.MX.sym("x", order.program.variables), ca.MX.sym("p", order.program.parameters)


def _make(name: str, order: Order, scale: float, settings: Mapping[str, Any]) -> ca.Function:
    x, p = _symbols(order)
    nlp: dict[str, Any] = {
        "x": x,
        "p": p,
        "f": scale * order.program.objective(x, p),
        "g": order.program.constraint(x, p),
    }
    quiet = {"print_time": False, "error_on_fail": False, "show_eval_warnings": False}
    return ca.nlpsol("ocp", name, nlp, {"iteration_callback": order.callback, **quiet, **settings})


def _choose_linear_solver(options: Settings) -> Settings:
    """Replace the name of a linear solver, told or not, by what makes IPOPT use it."""
    default = MUMPS if any(name.startswith("mumps_") for name in options) else OWN
    others = {name: value for name, value in options.items() if name != LINEAR_SOLVER}
    return {**set_up(str(options.get(LINEAR_SOLVER, default))), **others}


def _make_ipopt(order: Order) -> ca.Function:
    program = order.program
    told = {"tol": order.tolerance, "max_iter": order.max_iterations, "obj_scaling_factor": order.scaling}
    settings: dict[str, Any] = {
        **_UNDIFFERENTIATED,
        "grad_f": program.gradient,
        "jac_g": program.jacobian,
        "hess_lag": program.hessian,
        "ipopt": {**_IPOPT, **told, **_choose_linear_solver(order.options)},
    }
    if order.options.get("hessian_approximation") == "limited-memory":
        del settings["hess_lag"]
    return _make("ipopt", order, 1.0, settings)


def _make_sqp(order: Order) -> ca.Function:
    """Make the SQP method of CasADi; it has no scaling of its own, so the objective is scaled outside."""
    program, scale = order.program, order.scaling
    x, p, lam_f, lam_g = program.hessian.mx_in()
    hessian = ca.triu2symm(program.hessian(x, p, scale * lam_f, lam_g))
    f, gradient = program.gradient(x, p)
    inputs, names = [x, p, lam_f, lam_g], program.hessian.name_in()
    outputs = [scale * f, scale * gradient, *program.jacobian(x, p)]
    ipopt = {**_IPOPT, **set_up(OWN), "tol": order.tolerance / 100}
    quiet = {"print_time": False, "error_on_fail": False}
    settings = {
        **_UNDIFFERENTIATED,
        "hess_lag": ca.Function("nlp_hess_l", inputs, [hessian], names, ["hess_gamma_x_x"]),
        "jac_fg": ca.Function("nlp_jac_fg", [x, p], outputs, ["x", "p"], ["f", "grad_f_x", "g", "jac_g_x"]),
        "qpsol": "nlpsol",
        "qpsol_options": {"nlpsol": "ipopt", "nlpsol_options": {"ipopt": ipopt, **quiet}, "error_on_fail": False},
        "tol_pr": order.tolerance,
        "tol_du": order.tolerance,
        "max_iter": order.max_iterations,
        "print_header": False,
        "print_iteration": False,
        "print_status": False,
        **order.options,
    }
    return _make("sqpmethod", order, scale, settings)


METHODS: Mapping[str, Method] = {
    "ipopt": Method(IPOPT_OPTIONS, _make_ipopt, scales_outside=False),
    "sqpmethod": Method(SQP_OPTIONS, _make_sqp, scales_outside=True),
}


def read_status(statistics: Mapping[str, Any]) -> str:
    """Give a solver's word for how it ended; where it has a number only, a word made of it."""
    status = statistics["return_status"]
    if isinstance(status, str):
        return status
    return SUCCEEDED if statistics["success"] else f"Ended_With_Status_{status}"
