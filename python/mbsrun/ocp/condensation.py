"""A program without the variables that some of its equations give: they are solved for at every evaluation.

With w the variables that stay and z those that equations r(w, z) = 0 give, by the implicit function theorem

    dz/dw = -r_z^-1 r_w,    V = (1; dz/dw),    d/dw g(w, z(w)) = g_w + g_z dz/dw,
    the Hessian of f + lam' g by w = V' (that of f + lam' g + mu' r by w and z) V,    r_z' mu = -(f_z + g_z' lam),

so derivatives are as exact as those of the program, from which they are made; nothing is differenced, and no iteration
is differentiated. Equations are in groups that share no unknowns, so r_z is block diagonal.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.program import Indices, Program, to_casadi

Array = NDArray[np.float64]

ITERATIONS = 15  # of Newton's method, before the equations count as having no solution
STEP = 1e-8  # relative to unknowns above 1: a step so small leaves an error of its square


@dataclass(frozen=True)
class Groups:
    """Equations that share no unknowns: G groups of as many equations as unknowns, in matching order."""

    unknowns: Indices  # (G, s): variables of the program
    equations: Indices  # (G, s): rows of it
    knowns: Indices  # (G, k): the other variables that the equations feel; none is in two groups


@dataclass(frozen=True)
class Condensed:
    """A program in fewer variables, with fewer rows; what it offers is what a program offers."""

    rest: Program  # the cost, and the rows that stay
    equations: Program  # the rows that are solved
    groups: Groups
    kept: Indices  # the variables that stay
    kept_rows: Indices
    orders: tuple[tuple[Program, Indices], ...]  # for a triangular system: equations, their unknowns, one after another

    @property
    def variables(self) -> int:
        """Count the entries of x."""
        return self.kept.size

    @property
    def constraints(self) -> int:
        """Count the entries of g."""
        return self.kept_rows.size

    @property
    def parameters(self) -> int:
        """Count the entries of p."""
        return self.rest.parameters

    def complete(self, x: Array) -> Array:
        """Give the variables of the whole program. Raises ValueError where the equations have no solution."""
        found = self._completion(x).full().ravel()
        if not np.isfinite(found).all():
            raise ValueError("the equations that are condensed have no solution")
        return np.asarray(found)

    @cached_property
    def terms(self) -> ca.Function:
        """(x, p) -> c: the terms of the cost, without their weights."""
        x, p = self._symbols()
        return ca.Function("nlp_c", [x, p], [self.rest.terms(self._costing(x), p)], ["x", "p"], ["c"])

    @cached_property
    def objective(self) -> ca.Function:
        """(x, p) -> f."""
        x, p = self._symbols()
        return ca.Function("nlp_f", [x, p], [self.rest.objective(self._costing(x), p)], ["x", "p"], ["f"])

    @cached_property
    def constraint(self) -> ca.Function:
        """(x, p) -> g."""
        x, p = self._symbols()
        return ca.Function("nlp_g", [x, p], [self.rest.constraint(self._completion(x), p)], ["x", "p"], ["g"])

    @cached_property
    def gradient(self) -> ca.Function:
        """(x, p) -> f, its gradient."""
        x, p = self._symbols()
        v = self._costing(x)
        f, gradient = self.rest.gradient(v, p)
        by_x = gradient[self.kept.tolist()]
        if self._cost_feels_unknowns:
            by_z, by_w = self._split(self.equations.jacobian(v, p)[1])
            by_x += by_w.T @ self._weigh(by_z, gradient)
        return ca.Function("nlp_grad_f", [x, p], [f, by_x], ["x", "p"], ["f", "grad_f_x"])

    @cached_property
    def jacobian(self) -> ca.Function:
        """(x, p) -> g, its Jacobian."""
        x, p = self._symbols()
        v = self._completion(x)
        g, J = self.rest.jacobian(v, p)
        slopes = self._slopes(*self._split(self.equations.jacobian(v, p)[1]))
        by_x = J[:, self.kept.tolist()] + J[:, self._z] @ slopes
        return ca.Function("nlp_jac_g", [x, p], [g, by_x], ["x", "p"], ["g", "jac_g_x"])

    @cached_property
    def hessian(self) -> ca.Function:
        """(x, p, lam_f, lam_g) -> upper triangle of the Hessian of lam_f f + lam_g' g."""
        x, p = self._symbols()
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.constraints)
        v, kept = self._completion(x), self.kept.tolist()
        gradient = self.rest.jacobian(v, p)[1].T @ lam_g
        if self._cost_feels_unknowns:
            gradient += lam_f * self.rest.gradient(v, p)[1]
        by_z, by_w = self._split(self.equations.jacobian(v, p)[1])
        mu = self._weigh(by_z, gradient)
        half = self.rest.hessian(v, p, lam_f, lam_g) + self.equations.hessian(v, p, 0, mu)
        H, slopes = ca.triu2symm(half), self._slopes(by_z, by_w)
        mixed = H[kept, self._z] @ slopes
        whole = H[kept, kept] + mixed + mixed.T + slopes.T @ (H[self._z, self._z] @ slopes)
        arguments, names = [x, p, lam_f, lam_g], ["x", "p", "lam_f", "lam_g"]
        return ca.Function("nlp_hess_l", arguments, [ca.triu(whole)], names, ["hess_gamma_x_x"])

    # --- the unknowns ---

    @cached_property
    def _z(self) -> list[int]:
        return [int(i) for i in self.groups.unknowns.ravel()]

    @cached_property
    def _completion(self) -> ca.Function:
        """x -> the variables of the whole program; not a number where the equations have no solution."""
        x = ca.MX.sym("x", self.variables)
        v = self._spread(x, ca.MX.zeros(len(self._z)))
        return ca.Function("completion", [x], [self._substitute(v) if self.orders else self._iterate(x)], ["x"], ["v"])

    def _substitute(self, v: ca.MX) -> ca.MX:
        """Solve a triangular system with ones on its diagonal, order by order."""
        for equations, unknowns in self.orders:
            v -= _place(unknowns, v.numel()) @ equations.constraint(v, self._nothing)
        return v

    def _iterate(self, x: ca.MX) -> ca.MX:
        """Solve by Newton's method from 0, until a step is small enough."""
        z, given, size = ca.MX.sym("z", len(self._z)), ca.MX.sym("x", self.variables), ca.MX.sym("size")
        v = self._spread(given, z)
        r, J = self.equations.jacobian(v, self._nothing)
        better = z - ca.solve(self._split(J)[0], r, "qr")
        moved = ca.norm_inf(better - z) / (1 + ca.norm_inf(better))
        inputs = [given, z, size]
        go, stay = ca.Function("go", inputs, [better, moved]), ca.Function("stay", inputs, [z, size])
        step = ca.Function.if_else("step", go, stay)  # evaluates one of them only
        found, last = ca.MX.zeros(len(self._z)), ca.MX(np.inf)
        for _ in range(ITERATIONS):
            found, last = step(last > STEP, x, found, last)
        return self._spread(x, ca.if_else(last <= STEP, found, np.nan))

    def _spread(self, x: ca.MX, z: ca.MX) -> ca.MX:
        """Put what stays and the unknowns in the order of the whole program."""
        order = np.argsort(np.concatenate((self.kept, self.groups.unknowns.ravel())))
        return ca.vertcat(x, z)[order.tolist()]

    def _costing(self, x: ca.MX) -> ca.MX:
        """Give the variables of the whole program as far as the cost needs them."""
        return self._completion(x) if self._cost_feels_unknowns else self._spread(x, ca.MX.zeros(len(self._z)))

    @cached_property
    def _cost_feels_unknowns(self) -> bool:
        felt = np.zeros(self.rest.variables, dtype=bool)
        for block in self.rest.costs:
            for part in block.columns:
                felt[part.ravel() if isinstance(part, np.ndarray) else sparse.csc_array(part).tocoo().coords[1]] = True
        return bool(felt[self._z].any()) or any(H[:, self._z].nnz for H in self.rest.H)

    # --- linear algebra ---

    def _split(self, J: ca.MX) -> tuple[ca.MX, ca.MX]:
        """Split the Jacobian of the equations: by the unknowns, by what stays."""
        return J[:, self._z], J[:, self.kept.tolist()]

    def _weigh(self, by_z: ca.MX, gradient: ca.MX) -> ca.MX:
        """Give the multipliers of the equations that make a gradient by the unknowns vanish."""
        return _solve(by_z.T, -gradient[self._z])

    def _slopes(self, by_z: ca.MX, by_w: ca.MX) -> ca.MX:
        """Give dz/dw; all groups are solved at once, the first knowns of each as one right-hand side, and so on."""
        G, size = self.groups.unknowns.shape
        knowns = np.searchsorted(self.kept, self.groups.knowns)  # (G, k): columns of by_w
        local = np.full(self.variables, -1)
        local[knowns] = np.arange(knowns.shape[1])
        rows, cols = (np.asarray(k, dtype=np.int64) for k in by_w.sparsity().get_triplet())
        felt, right = np.unique(local[cols], return_inverse=True)
        assert felt.min() >= 0, "the equations feel their knowns and unknowns alone"
        order = np.lexsort((rows, right))
        pattern = ca.Sparsity.triplet(G * size, felt.size, rows[order].tolist(), right[order].tolist())
        solved = ca.densify(_solve(by_z, -ca.MX(pattern, by_w.nz[order.tolist()])))
        columns = knowns[:, felt].T.ravel()  # of dz/dw; by right-hand side, then by group, as `solved` is
        row = (np.arange(G)[:, None] * size + np.arange(size))[None].repeat(felt.size, axis=0).ravel()
        col = columns.repeat(size)
        order = np.lexsort((row, col))
        pattern = ca.Sparsity.triplet(G * size, self.variables, row[order].tolist(), col[order].tolist())
        return ca.MX(pattern, ca.vec(solved)[order.tolist()])

    def _symbols(self) -> tuple[ca.MX, ca.MX]:
        return ca.MX.sym("x", self.variables), ca.MX.sym("p", self.parameters)

    @property
    def _nothing(self) -> ca.DM:
        """Stand for parameters, which equations that are solved do not read."""
        return ca.DM.zeros(self.parameters)


def condense(
    program: Program, unknowns: Indices, equations: Indices, knowns: Indices, *, is_triangular: bool
) -> Condensed:
    """Solve some rows of a program, which read no parameters, for as many variables: G groups of S orders.

    unknowns and equations are (G, S, size), knowns (G, k). is_triangular: the equations of an order are the unknowns of
    that order minus a function of those of lower ones.
    """
    groups = Groups(unknowns.reshape(len(unknowns), -1), equations.reshape(len(equations), -1), knowns)
    kept = np.setdiff1d(np.arange(program.variables), unknowns)
    kept_rows = np.setdiff1d(np.arange(program.constraints), equations)
    orders = (
        [(program.restrict(equations[:, s].ravel()), unknowns[:, s].ravel()) for s in range(unknowns.shape[1])]
        if is_triangular
        else []
    )
    return Condensed(
        program.restrict(kept_rows, with_cost=True),
        program.restrict(groups.equations.ravel()),
        groups,
        kept,
        kept_rows,
        tuple(orders),
    )


def _solve(matrix: ca.MX, right: ca.MX) -> ca.MX:
    """Solve by substitution where the matrix is triangular, by QR else."""
    is_triangular = matrix.sparsity().is_tril() or matrix.sparsity().is_triu()
    return ca.solve(matrix, right) if is_triangular else ca.solve(matrix, right, "qr")


def _place(rows: Indices, size: int) -> ca.DM:
    """Give the matrix that puts values in some rows."""
    return to_casadi(sparse.coo_array((np.ones(rows.size), (rows, np.arange(rows.size))), (size, rows.size)).tocsc())
