"""A program in scaled variables and rows, for methods that know no units: functions of x -> functions of y = x / s.

    f(y) = f(s y),    g(y) = r g(s y),    dg/dy = R dg/dx S,    d2L/dy2 = S d2L/dx2 S with multipliers r lam

The scales s of variables and r of rows follow the program's parameters, so one set of functions serves all scales.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from mbsrun.ocp.evaluation.backends.casadi import Differentiated
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.methods.method import Answer, Instance


class ScaledFunctions:
    """Functions of a program as a solver takes them, of scaled variables; parameters are followed by s and r."""

    def __init__(self, functions: Differentiated) -> None:
        """Write them on top of the program's."""
        self.variables, self.constraints = functions.variables, functions.constraints
        self.parameters = functions.parameters + self.variables + self.constraints
        y, p = ca.MX.sym("x", self.variables), ca.MX.sym("p", self.parameters)
        own, s, r = ca.vertsplit(p, [0, functions.parameters, functions.parameters + self.variables, self.parameters])
        x, given, names = s * y, [y, p], ["x", "p"]
        self.objective = ca.Function("nlp_f", given, [functions.objective(x, own)], names, ["f"])
        self.constraint = ca.Function("nlp_g", given, [r * functions.constraint(x, own)], names, ["g"])
        f, gradient = functions.gradient(x, own)
        self.gradient = ca.Function("nlp_grad_f", given, [f, s * gradient], names, ["f", "grad_f_x"])
        J = _scale(functions.jacobian(x, own), r, s)
        self.jacobian = ca.Function("nlp_jac_g", given, [J], names, ["jac_g_x"])
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.constraints)
        H = _scale(functions.hessian(x, own, lam_f, r * lam_g), s, s)
        self.hessian = ca.Function(
            "nlp_hess_l", [y, p, lam_f, lam_g], [H], ["x", "p", "lam_f", "lam_g"], ["hess_gamma_x_x"]
        )


def _scale(matrix: ca.MX, rows: ca.MX, columns: ca.MX) -> ca.MX:
    """Return a sparse matrix with scaled rows and columns."""
    row, col = matrix.sparsity().get_triplet()
    return ca.MX(matrix.sparsity(), matrix.nz[:] * rows[row] * columns[col])


def scale_rows(functions: Differentiated, start: Instance, scales: Array) -> Array:
    """Return scales of rows: powers of 2 that make their largest derivatives by scaled variables 1, at the start."""
    jacobian = functions.jacobian(start.x, start.parameters)
    row, col = (np.array(part, dtype=np.int64) for part in jacobian.sparsity().get_triplet())
    largest = np.zeros(functions.constraints)
    np.maximum.at(largest, row, np.abs(np.array(jacobian.nonzeros())) * scales[col])
    is_known = np.isfinite(largest) & (largest > 0)
    return np.where(is_known, 2.0 ** -np.round(np.log2(np.where(is_known, largest, 1.0))), 1.0)


def scale_start(start: Instance, scales: Array, rows: Array) -> Instance:
    """Return the numbers of a solve in scaled variables and rows."""
    return replace(
        start,
        x=start.x / scales,
        parameters=np.concatenate((start.parameters, scales, rows)),
        lower=start.lower / scales,
        upper=start.upper / scales,
        g_lower=start.g_lower * rows,
        g_upper=start.g_upper * rows,
        scales=None,
    )


def unscale(answer: Answer, scales: Array, rows: Array) -> Answer:
    """Return an answer in the program's variables and rows."""
    multipliers = None if answer.multipliers is None else answer.multipliers * rows
    return replace(answer, x=answer.x * scales, multipliers=multipliers)
