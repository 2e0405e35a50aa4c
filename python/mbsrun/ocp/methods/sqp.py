"""CasADi's sequential quadratic programming, with the program's derivatives; IPOPT solves its quadratic programs."""

from __future__ import annotations

from collections.abc import Mapping

from mbsrun.ocp.ground.linear import OWN, set_up
from mbsrun.ocp.methods.ipopt import QUIET
from mbsrun.ocp.methods.method import Assignment, Method, Solver
from mbsrun.ocp.methods.options import COUNT, FRACTION, Amount, Choice, Option

SQP_OPTIONS: Mapping[str, Option] = {
    "beta": FRACTION,
    "c1": FRACTION,
    "convexify_strategy": Choice(("NONE", "regularize", "eigen-reflect", "eigen-clip")),
    "max_iter_ls": COUNT,
    "merit_memory": COUNT,
    "min_step_size": Amount(0.0, 1.0),
}


def make_sqp(order: Assignment) -> Solver:
    """Make the SQP method for a program; it does not scale, so the objective that it sees is scaled."""
    import casadi as ca

    from mbsrun.ocp.methods.nlpsol import UNDIFFERENTIATED, make

    functions, scale = order.program.casadi, order.scaling
    x, p, lam_f, lam_g = functions.hessian.mx_in()
    hessian = ca.triu2symm(functions.hessian(x, p, scale * lam_f, lam_g))
    f, gradient = functions.gradient(x, p)
    inputs, names = [x, p, lam_f, lam_g], functions.hessian.name_in()
    outputs = [scale * f, scale * gradient, functions.constraint(x, p), functions.jacobian(x, p)]
    ipopt = {**QUIET, **set_up(OWN), "tol": order.tolerance / 100}
    quiet = {"print_time": False, "error_on_fail": False}
    settings = {
        **UNDIFFERENTIATED,
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
    return make("sqpmethod", functions, settings, scale=scale)


SQP = Method("sequential quadratic programming", SQP_OPTIONS, make_sqp)
