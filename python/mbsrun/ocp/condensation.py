"""A program without the variables that some of its equations give: they are solved for at every evaluation.

With w the variables that stay and z those that equations r(w, z) = 0 give, by the implicit function theorem

    dz/dw = -r_z^-1 r_w,    V = (1; dz/dw),    d/dw g(w, z(w)) = g_w + g_z dz/dw,
    the Hessian of f + lam' g by w = V' (that of f + lam' g + mu' r by w and z) V,    r_z' mu = -(f_z + g_z' lam),

so derivatives are as exact as those of the program, from which they are made; nothing is differenced, and no iteration
is differentiated. What is of the equations, `elimination` computes, once at each place; what is of the rest, CasADi.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbsrun.ocp.elimination import Elimination, Groups, eliminate
from mbsrun.ocp.program import Indices, Program

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Condensed:
    """A program in fewer variables, with fewer rows; what it offers is what a program offers.

    Its functions may be called as long as it is there.
    """

    rest: Program  # the cost, and the rows that stay
    equations: Program  # the rows that are solved, group by group
    groups: Groups
    elimination: Elimination
    kept: Indices  # the variables that stay
    kept_rows: Indices

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
        found = np.empty(self.rest.variables)
        found[self.kept], found[self.groups.unknowns] = x, self.elimination.solve(np.asarray(x)[self._knowns])
        if not np.isfinite(found).all():
            raise ValueError("the equations that are condensed have no solution")
        return found

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
        f, gradient = self.rest.gradient(self._costing(x), p)
        by_x = gradient[self.kept.tolist()]
        if self._cost_feels_unknowns:
            by_x += self._slopes(x).T @ gradient[self._z]
        return ca.Function("nlp_grad_f", [x, p], [f, by_x], ["x", "p"], ["f", "grad_f_x"])

    @cached_property
    def jacobian(self) -> ca.Function:
        """(x, p) -> g, its Jacobian."""
        x, p = self._symbols()
        g, J = self.rest.jacobian(self._completion(x), p)
        by_x = J[:, self.kept.tolist()] + J[:, self._z] @ self._slopes(x)
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
        H = ca.triu2symm(self.rest.hessian(v, p, lam_f, lam_g))
        whole = H[kept, kept]
        if H[:, self._z].nnz():
            slopes = self._slopes(x)
            mixed = H[kept, self._z] @ slopes
            whole += mixed + mixed.T + slopes.T @ (H[self._z, self._z] @ slopes)
        arguments, names = [x, p, lam_f, lam_g], ["x", "p", "lam_f", "lam_g"]
        hessian = ca.triu(whole) + self._curvature(x, gradient[self._z])
        return ca.Function("nlp_hess_l", arguments, [hessian], names, ["hess_gamma_x_x"])

    # --- the unknowns ---

    @cached_property
    def _z(self) -> list[int]:
        return [int(i) for i in self.groups.unknowns.ravel()]

    @cached_property
    def _knowns(self) -> Indices:
        """(G, k): where the knowns of each group are in x."""
        return np.searchsorted(self.kept, self.groups.knowns)

    @cached_property
    def _completion(self) -> ca.Function:
        """x -> the variables of the whole program; not numbers where the equations have no solution."""
        x = ca.MX.sym("x", self.variables)
        return ca.Function("completion", [x], [self._spread(x, self._solution(x))], ["x"], ["v"])

    @cached_property
    def _solution(self) -> _Function:
        """x -> z, group by group."""
        dense = ca.Sparsity.dense(len(self._z), 1)
        return _Function("solution", [self.variables], dense, lambda x: self.elimination.solve(x[self._knowns]).ravel())

    @cached_property
    def _slopes(self) -> _Function:
        """x -> dz/dx."""
        s = self.groups.unknowns.shape[1]
        row = np.arange(self.groups.unknowns.size).reshape(-1, s, 1)
        pattern, order = _order(
            row, self._knowns[:, None, :], self.elimination.slope_pattern, len(self._z), self.variables
        )
        return _Function(
            "slopes",
            [self.variables],
            pattern,
            lambda x: self.elimination.differentiate(x[self._knowns]).ravel()[order],
        )

    @cached_property
    def _curvature(self) -> _Function:
        """(x, gradient by z) -> upper triangle of what the equations add to the Hessian."""
        row, col = self._knowns[:, :, None], self._knowns[:, None, :]
        upper = self.elimination.curvature_pattern & (row <= col)
        pattern, order = _order(row, col, upper, self.variables, self.variables)

        def curve(x: Array, gradient: Array) -> Array:
            by_z = gradient.reshape(self.groups.unknowns.shape)
            return np.asarray(self.elimination.curve(x[self._knowns], by_z).ravel()[order])

        return _Function("curvature", [self.variables, len(self._z)], pattern, curve)

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

    def _symbols(self) -> tuple[ca.MX, ca.MX]:
        return ca.MX.sym("x", self.variables), ca.MX.sym("p", self.parameters)


class _Function(ca.Callback):
    """Vectors -> nonzeros of a matrix, computed by NumPy; it has no derivatives."""

    def __init__(self, name: str, sizes: Sequence[int], pattern: ca.Sparsity, evaluate: Callable[..., Array]) -> None:
        super().__init__()
        self._sizes, self._pattern, self._evaluate = sizes, pattern, evaluate
        self.construct(name)

    def get_n_in(self) -> int:
        return len(self._sizes)

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[i], 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return (self._pattern,)[i]

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arguments: Sequence[memoryview | None], results: Sequence[memoryview | None]) -> int:
        (result,) = results
        if result is not None:
            given = [
                np.zeros(size) if argument is None else np.frombuffer(argument)
                for argument, size in zip(arguments, self._sizes, strict=True)
            ]
            np.frombuffer(result)[:] = self._evaluate(*given)
        return 0


def condense(
    program: Program, unknowns: Indices, equations: Indices, knowns: Indices, *, is_triangular: bool
) -> Condensed:
    """Solve some rows of a program, which read no parameters, for as many variables: G groups of S orders.

    unknowns and equations are (G, S, size), knowns (G, k); groups are alike. is_triangular: the equations of an order
    are the unknowns of that order minus a function of those of lower ones.
    """
    G, S, size = unknowns.shape
    solved = program.restrict(equations.ravel())
    groups = Groups(unknowns.reshape(G, -1), np.arange(solved.constraints).reshape(G, -1), knowns)
    kept_rows = np.setdiff1d(np.arange(program.constraints), equations)
    return Condensed(
        rest=program.restrict(kept_rows, with_cost=True),
        equations=solved,
        groups=groups,
        elimination=eliminate(solved, groups, list(np.arange(S * size).reshape(S, size)) if is_triangular else []),
        kept=np.setdiff1d(np.arange(program.variables), unknowns),
        kept_rows=kept_rows,
    )


def _order(row: Indices, col: Indices, mask: NDArray[np.bool_], rows: int, cols: int) -> tuple[ca.Sparsity, Indices]:
    """Give the pattern that groups' matrices make where a mask holds, and which entries are its nonzeros, in order."""
    row, col, mask = np.broadcast_arrays(row, col, mask)
    (chosen,) = np.nonzero(mask.ravel())
    order = chosen[np.lexsort((row.ravel()[chosen], col.ravel()[chosen]))]
    return ca.Sparsity.triplet(rows, cols, row.ravel()[order].tolist(), col.ravel()[order].tolist()), order
