"""The sparse factorisation of indefinite systems: solutions, inertia, singular systems, and fill-in.

The reference is LAPACK: dense eigenvalues and residuals.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cffi
import numpy as np
import pytest
import scipy.sparse as sp
from numpy.typing import NDArray

from mbsgen.resources import folder
from mbsrun.library import find_compiler
from mbsrun.ocp.ground.linear import compile_own
from tests.mbsgen.targets.compilation import STRICT, run

Array = NDArray[np.float64]

CDEF = """
typedef struct mbs_plan mbs_plan;
typedef struct mbs_factors mbs_factors;
typedef struct { double threshold, zero; } mbs_pivoting;
typedef struct { int failed, negative, zeros, delayed, front; long entries; } mbs_met;
int mbs_mark_weak(int n, const int *start, const int *row, const double *value, char *weak, double *work);
int mbs_find_partners(int n, const int *start, const int *row, const double *value, const char *weak, int all,
                      int *partner);
mbs_plan *mbs_make_plan(int n, const int *start, const int *row, const char *weak, const int *partner);
void mbs_release_plan(mbs_plan *plan);
mbs_factors *mbs_make_factors(mbs_plan *plan);
void mbs_free_factors(mbs_factors *factors);
mbs_met mbs_factorise(mbs_factors *factors, const double *value, const mbs_pivoting *pivoting);
void mbs_solve(const mbs_factors *factors, double *x);
"""
THRESHOLD, ZERO = 1e-8, 1e-20  # IPOPT starts with these
EPS = float(np.finfo(float).eps)


def load(library: Path) -> tuple[cffi.FFI, Any]:
    ffi = cffi.FFI()
    ffi.cdef(CDEF)
    return ffi, ffi.dlopen(str(library))


class Factorisation:
    """A system, given by its lower triangle, and its factors."""

    def __init__(
        self,
        lower: sp.csc_array,
        ordered_for: Array | None = None,
        library: Path | None = None,
        *,
        every: bool = True,
    ) -> None:
        """Plan for the values of the system, or for others; with the library that IPOPT uses, or another.

        Every multiplier gets a partner, or only multipliers of variables that need one do.
        """
        self.ffi, self.lib = load(library or compile_own())
        self.n = lower.shape[0]
        start, row = (self._integers(x) for x in (lower.indptr, lower.indices))
        weak, partner = self.ffi.new("char[]", self.n + 1), self.ffi.new("int[]", self.n + 1)
        values = lower.data if ordered_for is None else ordered_for
        numbers, work = self._numbers(values), self.ffi.new("double[]", 2 * self.n + 1)
        self.lib.mbs_mark_weak(self.n, start, row, numbers, weak, work)
        assert self.lib.mbs_find_partners(self.n, start, row, numbers, weak, every, partner) == 0
        plan = self.lib.mbs_make_plan(self.n, start, row, weak, partner)
        self.plan = self.ffi.gc(plan, self.lib.mbs_release_plan)
        self.factors = self.ffi.gc(self.lib.mbs_make_factors(self.plan), self.lib.mbs_free_factors)
        self.pairs = sum(partner[i] >= 0 for i in range(self.n)) // 2

    def _integers(self, x: NDArray[Any]) -> Any:
        return self.ffi.new("int[]", [int(i) for i in x] or 1)

    def _numbers(self, x: Array) -> Any:
        return self.ffi.new("double[]", [float(v) for v in x] or 1)

    def factorise(self, values: Array) -> Any:
        return self.lib.mbs_factorise(
            self.factors, self._numbers(values), self.ffi.new("mbs_pivoting *", [THRESHOLD, ZERO])
        )

    def solve(self, b: Array) -> Array:
        x = self._numbers(b)
        self.lib.mbs_solve(self.factors, x)
        return np.array(list(x))


def optimality(rng: np.random.Generator, variables: int, multipliers: int, kept: float) -> sp.csc_array:
    """Make [H JT; J 0] at random, H indefinite with part of its diagonal 0; return the lower triangle."""
    density = min(1.0, 3 / variables)
    H = sp.random_array((variables, variables), density=density, rng=rng, data_sampler=rng.standard_normal)
    diagonal = rng.standard_normal(variables) * (rng.random(variables) < kept)
    J = sp.random_array((multipliers, variables), density=density, rng=rng)
    J = J + sp.eye_array(multipliers, variables, k=int(rng.integers(0, variables - multipliers + 1)))
    top = sp.tril(H + H.T, -1) + sp.diags_array(diagonal)
    return triangle(stack(top, J))


def stack(top: Any, below: Any) -> Any:
    """Put J below H, and zeros beside it."""
    blocks: list[Any] = [[top, None], [below, sp.csr_array((below.shape[0], below.shape[0]))]]
    return sp.block_array(blocks)


def triangle(lower: Any) -> sp.csc_array:
    """Store every diagonal entry, zeros too, as IPOPT does."""
    coo = sp.coo_array(lower)
    n = coo.shape[0]
    missing = np.setdiff1d(np.arange(n), coo.row[coo.row == coo.col])
    row, col = np.concatenate([coo.row, missing]), np.concatenate([coo.col, missing])
    order = np.lexsort((row, col))
    start = np.concatenate([[0], np.cumsum(np.bincount(col, minlength=n))])
    return sp.csc_array((np.concatenate([coo.data, 0.0 * missing])[order], row[order], start), shape=(n, n))


def dense(lower: sp.csc_array) -> Array:
    a: Array = lower.toarray()
    return a + np.tril(a, -1).T


@pytest.mark.parametrize("kept", [1.0, 0.5, 0.0])
def test_random_systems(kept: float) -> None:
    """The inertia is LAPACK's, and the residual is small relative to the norms of matrix and solution."""
    rng = np.random.default_rng(int(10 * kept))
    solved = 0
    for _ in range(40):
        variables = int(rng.integers(1, 80))
        lower = optimality(rng, variables, int(rng.integers(0, variables // 2 + 1)), kept)
        a = dense(lower)
        eigenvalues = np.linalg.eigvalsh(a)
        if np.abs(eigenvalues).min() <= 1e-6 * np.abs(eigenvalues).max():
            continue
        solved += 1
        system = Factorisation(lower)
        met = system.factorise(lower.data)
        assert (met.failed, met.zeros, met.negative) == (0, 0, np.count_nonzero(eigenvalues < 0))
        b = rng.standard_normal(len(a))
        x = system.solve(b)
        assert np.abs(a @ x - b).max() < 1e-9 * np.abs(a).sum(axis=1).max() * np.abs(x).max()
    assert solved >= 15


def test_values_that_it_was_not_ordered_for() -> None:
    """Pivots are chosen by their values: an order made for other values costs time, but no digits."""
    rng = np.random.default_rng(0)
    lower = optimality(rng, 60, 25, 0.6)
    system = Factorisation(lower, ordered_for=np.ones(lower.nnz))
    for scale in (1.0, 1e6):
        values = lower.data * rng.uniform(1.0, scale, lower.nnz)
        a = dense(sp.csc_array((values, lower.indices, lower.indptr), shape=lower.shape))
        met = system.factorise(values)
        b = rng.standard_normal(len(a))
        x = system.solve(b)
        assert met.negative == np.count_nonzero(np.linalg.eigvalsh(a) < 0)
        assert np.abs(a @ x - b).max() < 1e-9 * np.abs(a).sum(axis=1).max() * np.abs(x).max()


def test_variables_without_pivots_get_multipliers() -> None:
    """In [0 JT; J 0] no unknown is a pivot alone, but nearly every pair is one in its front."""
    rng = np.random.default_rng(1)
    J = sp.eye_array(30) + sp.diags_array(rng.uniform(0.1, 0.5, 29), offsets=1)
    lower = triangle(stack(sp.csr_array((30, 30)), J))
    system = Factorisation(lower)
    met = system.factorise(lower.data)
    assert (system.pairs, met.negative, met.zeros) == (30, 30, 0)
    assert met.delayed < 3


SINGULAR = {
    "nothing at all": np.zeros((3, 3)),
    "a row twice": np.array([[2.0, 1.0, 1.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]),
    "a constraint on nothing": np.diag([1.0, 2.0, 0.0]),
    "not a number": np.diag([1.0, np.nan, 2.0]),
}


@pytest.mark.parametrize("a", SINGULAR.values(), ids=SINGULAR.keys())
def test_singular_systems_are_said_to_be(a: Array) -> None:
    lower = triangle(sp.coo_array(np.tril(a)))
    assert Factorisation(lower).factorise(lower.data).zeros > 0


@pytest.fixture(scope="module")
def unfused(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compile the solver for machines that round every product, as those without fused multiply-add do."""
    library = tmp_path_factory.mktemp("unfused") / "kkt.so"
    compiler = find_compiler(os.environ).command
    sources = sorted((folder("csrc") / "kkt").glob("*.c"))
    run(*compiler, "-O1", "-ffp-contract=off", "-shared", "-fPIC", *sources, "-lm", "-o", library)
    return library


@pytest.mark.parametrize("seed", range(2))
def test_a_pair_whose_determinant_cancels_is_no_pivot(unfused: Path, seed: int) -> None:
    """The residual is at rounding for [[a, b], [b, d]] with a d = b^2 to the last digit: such a pair is not inverted.

    A fused product would hide the loss of digits: it computes the determinant exactly.
    """
    rng = np.random.default_rng(seed)
    solved = 0
    for _ in range(60):
        b = 10 ** rng.uniform(-1, 1)
        a = b * 10 ** rng.uniform(-6, -2.1)
        pair = np.array([[a, b], [b, b * b / a * (1 + rng.integers(0, 3) * EPS)]])
        lower = triangle(sp.coo_array(np.tril(pair)))
        system = Factorisation(lower, library=unfused)
        if system.factorise(lower.data).zeros:
            continue
        solved += 1
        right = pair @ rng.standard_normal(2)
        x = system.solve(right)
        assert np.abs(pair @ x - right).max() < 4 * EPS * np.abs(pair).sum(axis=1).max() * np.abs(x).max()
    assert solved >= 10


def test_a_long_chain_stays_sparse() -> None:
    """The factors of a band matrix grow with its length; an order that lets them fill in would grow with its square."""
    entries = []
    for n in (400, 800):
        lower = triangle(sp.tril(sp.diags_array([1.0, 1.0, 4.0, 1.0, 1.0], offsets=[-2, -1, 0, 1, 2], shape=(n, n))))
        entries.append(Factorisation(lower).factorise(lower.data).entries)
    assert entries[1] < 2.2 * entries[0]


@pytest.mark.parametrize("n", [31, 33, 64, 150])
def test_fronts_of_more_than_a_panel(n: int) -> None:
    """Dense systems are one front; with zeros on the diagonal, a candidate may get its pivot in a later panel."""
    rng = np.random.default_rng(n)
    a = rng.standard_normal((n, n))
    a += a.T
    a[: n // 2, : n // 2] = 0.0
    lower = triangle(sp.coo_array(np.tril(a)))
    system = Factorisation(lower)
    met = system.factorise(lower.data)
    assert (met.failed, met.zeros, met.front) == (0, 0, n)
    assert met.negative == np.count_nonzero(np.linalg.eigvalsh(a) < 0)
    b = rng.standard_normal(n)
    x = system.solve(b)
    assert np.abs(a @ x - b).max() < 1e-9 * np.abs(a).sum(axis=1).max() * np.abs(x).max()


@pytest.mark.parametrize("every", [True, False])
def test_parameters_of_a_whole_trajectory(*, every: bool) -> None:
    """Unknowns that all steps share come last, so factors grow with the number of steps."""
    rng = np.random.default_rng(5)
    entries = []
    for steps in (100, 200):
        J = sp.diags_array(
            [rng.uniform(0.5, 1.0, steps), rng.uniform(0.5, 1.0, steps)], offsets=[0, 1], shape=(steps, steps + 1)
        )
        J = sp.hstack([J, sp.csr_array(rng.uniform(0.5, 1.0, (steps, 3)))])
        diagonal = np.append(rng.uniform(0.0, 1.0, steps + 1) * (np.arange(steps + 1) % 3 == 0), np.ones(3))
        lower = triangle(stack(sp.diags_array(diagonal), J))
        a = dense(lower)
        system = Factorisation(lower, every=every)
        met = system.factorise(lower.data)
        assert (met.zeros, met.negative) == (0, np.count_nonzero(np.linalg.eigvalsh(a) < 0))
        b = rng.standard_normal(len(a))
        x = system.solve(b)
        assert np.abs(a @ x - b).max() < 1e-9 * np.abs(a).sum(axis=1).max() * np.abs(x).max()
        entries.append(met.entries)
    assert entries[1] < 2.2 * entries[0]


def test_every_multiplier_gets_a_partner() -> None:
    """Also where all variables have pivots by themselves; without `every`, nobody needs one there."""
    J = sp.eye_array(30, 40) + sp.diags_array(np.full(30, 2.0), offsets=3, shape=(30, 40))
    lower = triangle(stack(sp.eye_array(40), J))
    assert [Factorisation(lower, every=every).pairs for every in (True, False)] == [30, 0]


def test_no_compiler_warns_and_no_memory_is_misused(tmp_path: Path) -> None:
    """A program calls the interface that IPOPT uses, under sanitizers."""
    place = folder("csrc") / "kkt"
    program = tmp_path / "program.c"
    program.write_text(PROGRAM, "utf-8")
    compiler = find_compiler(os.environ).command
    flags = [*STRICT, "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", f"-I{place}"]
    run(*compiler, *flags, program, *sorted(place.glob("*.c")), "-lm", "-o", tmp_path / "program")
    run(tmp_path / "program")


PROGRAM = r"""
#include "mbs_ipopt.h"
#include <math.h>
enum { N = 200, M = 150, DENSE = 3, ENTRIES = N + M * (3 + DENSE) };

/* [H JT; J 0] by rows of the lower triangle's transpose: each constraint joins three variables, and the last ones. */
static int solve_larger(void)
{
    static int start[N + M + 1], row[ENTRIES + M];
    static double value[ENTRIES + M], x[N + M], b[N + M];
    unsigned seed = 1;
    void *pattern = 0, *factors = 0;
    ipopt_settings settings;
    ipopt_report report;
    int turn, i, j, k, used = 0;
    ma97_default_control_d(&settings);
    settings.threshold = 1e-8;
    settings.zero = 1e-20;
    for (j = 0; j < N + M; ++j) { /* column j: the diagonal, then the constraints that it is in */
        start[j] = used;
        row[used++] = j;
        for (i = 0; j < N && i < M; ++i)
            if (j >= N - DENSE || j == i || j == i + 1 || j == (7 * i) % (N - DENSE))
                row[used++] = N + i;
    }
    start[N + M] = used;
    ma97_analyse_d(0, N + M, start, row, 0, &pattern, &settings, &report, 0);
    for (turn = 0; turn < 3; ++turn) {
        for (j = 0; j < N + M; ++j) {
            b[j] = x[j] = 1.0 + j % 5;
            for (k = start[j]; k < start[j + 1]; ++k) {
                seed = seed * 1664525u + 1013904223u;
                value[k] = 0.1 + (seed >> 8) / 16777216.0;
                if (row[k] == j)
                    value[k] = j >= N || (turn && j < M && j % 2) ? 0.0 : value[k];
            }
        }
        ma97_factor_solve_d(4, start, row, value, 1, x, N + M, &pattern, &factors, &settings, &report, 0);
        if (report.flag || report.negative != M)
            return 1;
        for (j = 0; j < N + M; ++j)
            for (k = start[j]; k < start[j + 1]; ++k) {
                b[row[k]] -= value[k] * x[j];
                if (row[k] != j)
                    b[j] -= value[k] * x[row[k]];
            }
        for (j = 0; j < N + M; ++j)
            if (!(fabs(b[j]) < 1e-6))
                return 1;
    }
    ma97_finalise_d(&pattern, &factors);
    return 0;
}

/* minimise x1^2/2 - x2^2/2 with x1 + x2 = b3, and the same without its constraint */
int main(void)
{
    const int start[] = {1, 3, 5, 6}, row[] = {1, 3, 2, 3, 3};
    double value[] = {1.0, 1.0, -0.5, 1.0, 0.0}, x[] = {0.0, 0.0, 1.0, 1.0, 0.0, 0.0};
    const int second[] = {1, 2, 3}, diagonal[] = {1, 2};
    void *pattern = 0, *factors = 0;
    ipopt_settings settings;
    ipopt_report report;
    ma97_default_control_d(&settings);
    settings.one_based = 1;
    settings.threshold = 1e-8;
    settings.zero = 1e-20;
    ma97_analyse_d(0, 3, start, row, 0, &pattern, &settings, &report, 0);
    if (report.flag)
        return 1;
    ma97_factor_solve_d(4, start, row, value, 2, x, 3, &pattern, &factors, &settings, &report, 0);
    if (report.flag || report.negative != 1 || x[0] + x[1] < 1.0 - 1e-12 || x[3] + x[4] > 1e-12)
        return 2;
    value[1] = value[3] = 0.0; /* the constraint has lost its variables */
    ma97_factor_d(4, start, row, value, &pattern, &factors, &settings, &report, 0);
    if (report.flag != -7)
        return 3;
    /* another pattern: factors of the first one must not be taken for it */
    value[1] = -2.0;
    ma97_analyse_d(0, 2, second, diagonal, 0, &pattern, &settings, &report, 0);
    ma97_factor_solve_d(4, second, diagonal, value, 1, x, 2, &pattern, &factors, &settings, &report, 0);
    if (report.flag || report.negative != 1)
        return 5;
    ma97_finalise_d(&pattern, &factors);
    if (solve_larger())
        return 6;
    return pattern || factors ? 4 : 0;
}
"""
