"""CasADi functions of a program whose inner variables are solved for at every evaluation.

With w the variables that stay and z the unknowns of the inner equations r(w, z) = 0, by the implicit function theorem

    dz/dw = -r_z^-1 r_w,    V = (1; dz/dw),    d/dw g(w, z(w)) = g_w + g_z dz/dw,
    d2/dw2 (f + lam' g) = V' (f + lam' g + mu' r)'' V,    r_z' mu = -(f_z + g_z' lam),

with '' by w and z. Derivatives are as exact as the program's: nothing is differenced, and no iteration is
differentiated. `elimination` computes the terms of the equations, once at each place; CasADi computes the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from mbsrun.ocp.evaluation.backends.casadi import CasadiProgram, Functions
from mbsrun.ocp.evaluation.backends.mapped import MappedFunction
from mbsrun.ocp.evaluation.backends.places import make_function
from mbsrun.ocp.evaluation.elimination import Bind, Entries, Inner, eliminate
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.program import Program
from mbsrun.ocp.ground.status import NoNumbersError


def build(program: Program, plant: Plant, others: tuple[Plant, ...] = ()) -> Functions:
    """Make the functions of a program for CasADi's solvers; `others` are plants beside plant 0."""
    return condense(program, plant, others) if program.solved else CasadiProgram(program, plant, others)


@dataclass(frozen=True)
class Condensed:
    """Functions of fewer variables, with fewer rows; they may be called as long as this object exists."""

    program: Program
    rest: CasadiProgram  # the cost, and the rows that stay
    inner: Inner

    @property
    def variables(self) -> int:
        """Count the entries of x."""
        return self.program.kept.size

    @property
    def constraints(self) -> int:
        """Count the entries of g."""
        return self.program.kept_rows.size

    @property
    def parameters(self) -> int:
        """Count the entries of p."""
        return self.rest.parameters

    def complete(self, x: Array) -> Array:
        """Return all variables of the program. Raises NoNumbersError where the equations have no solution."""
        found = np.empty(self.rest.variables)
        found[self.program.kept] = x
        found[self.inner.unknowns] = self.inner.solve(np.asarray(x))
        if not np.isfinite(found).all():
            raise NoNumbersError("the equations that are condensed have no solution")
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
        by_x = gradient[self.program.kept.tolist()]
        if self._cost_reads_unknowns:
            by_x += self._slopes(x).T @ gradient[self._z]
        return ca.Function("nlp_grad_f", [x, p], [f, by_x], ["x", "p"], ["f", "grad_f_x"])

    @cached_property
    def jacobian(self) -> ca.Function:
        """(x, p) -> the Jacobian of g."""
        x, p = self._symbols()
        J = self.rest.jacobian(self._completion(x), p)
        by_x = J[:, self.program.kept.tolist()] + J[:, self._z] @ self._slopes(x)
        return ca.Function("nlp_jac_g", [x, p], [by_x], ["x", "p"], ["jac_g_x"])

    @cached_property
    def hessian(self) -> ca.Function:
        """(x, p, lam_f, lam_g) -> upper triangle of the Hessian of lam_f f + lam_g' g."""
        x, p = self._symbols()
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.constraints)
        v, kept = self._completion(x), self.program.kept.tolist()
        gradient = self.rest.jacobian(v, p).T @ lam_g
        if self._cost_reads_unknowns:
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
        return [int(i) for i in self.inner.unknowns]

    @cached_property
    def _completion(self) -> ca.Function:
        """x -> the variables of the whole program; not numbers where the equations have no solution."""
        x = ca.MX.sym("x", self.variables)
        return ca.Function("completion", [x], [self._spread(x, self._solution(x))], ["x"], ["v"])

    @cached_property
    def _solution(self) -> _Function:
        """x -> z, group by group."""
        dense = ca.Sparsity.dense(len(self._z), 1)
        return _Function("solution", [self.variables], dense, self.inner.solve)

    @cached_property
    def _slopes(self) -> _Function:
        """x -> dz/dx."""
        pattern, order, _ = _order(self.inner.slopes, len(self._z), self.variables)
        return _Function("slopes", [self.variables], pattern, lambda x: self.inner.differentiate(x)[order])

    @cached_property
    def _curvature(self) -> _Function:
        """(x, gradient by z) -> upper triangle of the term that the equations add to the Hessian."""
        whole = self.inner.curvature
        upper = replace(whole, mask=whole.mask & (whole.row <= whole.col))
        pattern, order, begin = _order(upper, self.variables, self.variables)

        def curve(x: Array, gradient: Array) -> Array:
            found = self.inner.curve(x, gradient)[order]
            # groups share the variables that are common to all of them
            return np.asarray(found if begin.size == found.size else np.add.reduceat(found, begin))

        return _Function("curvature", [self.variables, len(self._z)], pattern, curve)

    def _spread(self, x: ca.MX, z: ca.MX) -> ca.MX:
        """Put x and the unknowns in the order of the whole program."""
        order = np.argsort(np.concatenate((self.program.kept, self.inner.unknowns)))
        return ca.vertcat(x, z)[order.tolist()]

    def _costing(self, x: ca.MX) -> ca.MX:
        """Return all variables as far as the cost needs them."""
        return self._completion(x) if self._cost_reads_unknowns else self._spread(x, ca.MX.zeros(len(self._z)))

    @cached_property
    def _cost_reads_unknowns(self) -> bool:
        program = self.rest.program
        read = [program.list_variables(block)[self._z].any() for block in program.costs]
        return any(read) or any(H[:, self._z].nnz for H in program.H)

    def _symbols(self) -> tuple[ca.MX, ca.MX]:
        return ca.MX.sym("x", self.variables), ca.MX.sym("p", self.parameters)


class _Function(ca.Callback):
    """Vectors -> nonzeros of a matrix, computed by NumPy; it has no derivatives in CasADi."""

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


def condense(program: Program, plant: Plant, others: tuple[Plant, ...] = ()) -> Condensed:
    """Solve the inner equations of a program; they read no parameters, and intervals differ in scales alone."""
    plants = (plant, *others)

    def bind(number: int) -> Bind:
        return lambda function, places: MappedFunction(make_function(function, plants[number]), places)

    return Condensed(
        program=program,
        rest=CasadiProgram(program.restrict(program.kept_rows, with_cost=True), plant, others),
        inner=eliminate(program, bind),
    )


def _order(entries: Entries, rows: int, cols: int) -> tuple[ca.Sparsity, Indices, Indices]:
    """Return the pattern of groups' matrices where a mask holds, which entries make its nonzeros, and where they begin.

    Entries are in the order of nonzeros; several groups may have entries at one place.
    """
    (chosen,) = np.nonzero(entries.mask)
    order = chosen[np.lexsort((entries.row[chosen], entries.col[chosen]))]
    placed = np.stack((entries.row[order], entries.col[order]))
    is_first = np.append(True, (np.diff(placed, axis=1) != 0).any(axis=0))[: order.size]
    begin = np.flatnonzero(is_first)
    return ca.Sparsity.triplet(rows, cols, *placed[:, begin].tolist()), order, begin
