"""Least solutions in C: the order of columns, ranks, solutions and weights against NumPy."""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cffi
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import lu, qr

from mbsgen import resources
from mbsrun.library import compile_library, find_compiler

Array = NDArray[np.float64]
EPS = float(np.finfo(float).eps)

INTERFACE = """
typedef struct {
    long long n, e, rank;
    double *A, *factor, *size, *y;
    long long *column;
} mbs_least;
double mbs_least_factorise(mbs_least *system, double tolerance);
double mbs_least_solve(const mbs_least *system, const double *g, double *x);
void mbs_least_weigh(const mbs_least *system, const double *x, double *lam);
double mbs_lu_factorise(long long n, double *A, long long *row, double *volume);
void mbs_lu_solve(long long n, const double *A, const long long *row, double *x, double *room);
int mbs_cholesky(long long n, double *M);
void mbs_cholesky_forward(long long n, const double *L, double *x);
void mbs_cholesky_backward(long long n, const double *L, double *x);
"""


@dataclass(frozen=True)
class Least:
    """The C functions, and their types."""

    ffi: Any
    lib: Any

    def factorise(self, B: Array, tolerance: float) -> tuple[Any, Array, list[int], list[Any]]:
        """Decompose the equations B x = g; return the struct, the sizes of the pivots, the order, and the memory."""
        e, n = B.shape
        A, order = np.array(B, order="C"), np.zeros(e, dtype=np.int64)
        rest = [np.zeros(e), np.zeros(2 * e), np.zeros(n)]
        system = self.ffi.new("mbs_least *")
        system.n, system.e = n, e
        system.A, system.factor, system.size, system.y = (self.ffi.from_buffer("double[]", x) for x in (A, *rest))
        system.column = self.ffi.from_buffer("long long[]", order)
        self.lib.mbs_least_factorise(system, tolerance)
        pivots = np.abs([A[i, i] for i in range(system.rank)])
        return system, pivots, [int(k) for k in order], [A, order, *rest]


@pytest.fixture(scope="module")
def least() -> Least:
    library = compile_library(resources.folder("csrc"), "least", ["mbs_least.c"], find_compiler(os.environ))
    ffi = cffi.FFI()
    ffi.cdef(INTERFACE)
    return Least(ffi, ffi.dlopen(str(library)))


@pytest.mark.parametrize("small", [1e-4, 1e-8, 1e-10])
def test_the_longest_rest_comes_next(least: Least, small: float) -> None:
    """Each pivot is the length of its column's rest, the longest of all rests, though almost all of it has cancelled.

    Columns share one direction and differ by parts of 1, 1/2, 1/4 ... of `small`. A length that is carried on by
    subtraction has an error of epsilon, above the square of these parts, so it must be computed anew.
    """
    rng = np.random.default_rng(4)
    n, e = 9, 6
    for _ in range(20):
        basis, _ = np.linalg.qr(rng.normal(size=(n, n)))
        parts = rng.permutation(small * 0.5 ** np.arange(e - 1))
        B = np.vstack([basis[0], *(0.99 * basis[0] + part * basis[k + 1] for k, part in enumerate(parts))])
        system, pivots, order, _memory = least.factorise(B, 1e-14)
        assert system.rank == e
        assert order[0] == 0
        wanted = [1 + k for k in np.argsort(-parts)]
        assert order[1:] == wanted
        np.testing.assert_allclose(pivots[1:], np.sort(parts)[::-1], rtol=100 * EPS / small)


def test_solutions_are_of_least_norm(least: Least) -> None:
    """As the pseudoinverse gives them; weights give the solution back, as B^T lam."""
    rng = np.random.default_rng(5)
    for n, e in ((5, 2), (7, 7), (9, 4)):
        B, g = rng.normal(size=(e, n)), rng.normal(size=e)
        system, _, _, _memory = least.factorise(B, 1e-10)
        x, lam = np.zeros(n), np.zeros(e)
        worst = least.lib.mbs_least_solve(
            system, least.ffi.from_buffer("double[]", g), least.ffi.from_buffer("double[]", x)
        )
        least.lib.mbs_least_weigh(system, least.ffi.from_buffer("double[]", x), least.ffi.from_buffer("double[]", lam))
        condition = np.linalg.cond(B)
        assert worst == 0
        np.testing.assert_allclose(x, np.linalg.pinv(B) @ g, rtol=0, atol=100 * EPS * condition * np.linalg.norm(x))
        np.testing.assert_allclose(B.T @ lam, x, rtol=0, atol=100 * EPS * condition**2 * np.linalg.norm(x))


def test_dependent_equations_are_left_out_and_judged(least: Least) -> None:
    """The rank is the one of the equations; the largest error of the ones left out is returned."""
    rng = np.random.default_rng(6)
    B = rng.normal(size=(3, 6))
    B = np.vstack([B, B[0] - 2 * B[1]])
    g = np.array([1.0, 2.0, 3.0, 1.0 - 4.0])
    system, _, order, _memory = least.factorise(B, 1e-10)
    assert system.rank == 3
    x = np.zeros(6)
    room = least.ffi.from_buffer("double[]", x)
    assert least.lib.mbs_least_solve(system, least.ffi.from_buffer("double[]", g), room) < 1e-13
    np.testing.assert_allclose(B @ x, g, rtol=0, atol=1e-13)
    g[order[3]] += 0.5
    assert least.lib.mbs_least_solve(system, least.ffi.from_buffer("double[]", g), room) == pytest.approx(
        0.5, rel=1e-12
    )


def test_the_strength_of_equations_is_the_least_pivot_over_the_largest(least: Least) -> None:
    """By LAPACK's decomposition with exchanges of columns; 0 where equations depend on each other, 1 without any."""
    rng = np.random.default_rng(7)
    for n, e in ((5, 2), (7, 7), (9, 4), (3, 1), (4, 0)):
        B = rng.normal(size=(e, n)) * 0.01
        pivots = np.abs(np.diag(qr(B.T, mode="r", pivoting=True)[0])) if e else np.ones(1)
        system, _, _, _memory = least.factorise(B, 0.0)
        system.A[0 : e * n] = B.ravel().tolist()
        found = least.lib.mbs_least_factorise(system, 1e-10)
        assert found == pytest.approx(pivots.min() / pivots.max(), rel=1e-10)
    system, _, _, _memory = least.factorise(np.ones((2, 3)), 1e-10)
    system.A[0:6] = [1.0] * 6
    assert least.lib.mbs_least_factorise(system, 1e-10) == 0


def test_lu_solves_and_measures_the_determinant(least: Least) -> None:
    """A x = b as NumPy solves it; log |det A|; the least pivot over the largest, 0 of singular matrices."""
    rng = np.random.default_rng(8)
    for n in (1, 2, 5, 9):
        A, b = rng.normal(size=(n, n)) * 3, rng.normal(size=n)
        factors, row, volume, x, room = A.copy(), np.zeros(n, dtype=np.int64), np.zeros(1), b.copy(), np.zeros(n)
        strength = _call(least, "mbs_lu_factorise", n, factors, row, volume)
        _call(least, "mbs_lu_solve", n, factors, row, x, room)
        tolerance = 100 * EPS * np.linalg.cond(A)
        np.testing.assert_allclose(A @ x, b, rtol=0, atol=tolerance * np.abs(b).max())
        assert volume[0] == pytest.approx(np.linalg.slogdet(A)[1], rel=1e-12, abs=1e-12)
        pivots = np.abs(np.diag(lu(A)[2]))
        assert strength == pytest.approx(pivots.min() / pivots.max(), rel=tolerance)
    assert _call(least, "mbs_lu_factorise", 2, np.array([[1.0, 2.0], [2.0, 4.0]]), row, volume) == 0


def test_cholesky_is_the_root_of_a_matrix(least: Least) -> None:
    """L and L^T applied one after the other solve M x = b; a matrix that is not positive is named by its row."""
    rng = np.random.default_rng(9)
    for n in (1, 3, 6):
        root, b = rng.normal(size=(n, n)) + 3 * np.eye(n), rng.normal(size=n)
        M = root @ root.T
        L, x = M.copy(), b.copy()
        assert _call(least, "mbs_cholesky", n, L) == 0
        np.testing.assert_allclose(np.tril(L), np.linalg.cholesky(M), rtol=1e-12, atol=1e-12)
        _call(least, "mbs_cholesky_forward", n, L, x)
        np.testing.assert_allclose(np.tril(L) @ x, b, rtol=1e-11, atol=1e-11)
        _call(least, "mbs_cholesky_backward", n, L, x)
        np.testing.assert_allclose(M @ x, b, rtol=0, atol=1e-12 * np.linalg.cond(M))
    for k in range(3):
        M = np.eye(3)
        M[k, k] = 1e-30 * k
        M[k, :k] = M[:k, k] = 1e-15
        assert _call(least, "mbs_cholesky", 3, M) == k + 1


def _call(least: Least, name: str, n: int, *arrays: Array | NDArray[np.int64]) -> float:
    kinds = {np.dtype(float): "double[]", np.dtype(np.int64): "long long[]"}
    return float(getattr(least.lib, name)(n, *(least.ffi.from_buffer(kinds[x.dtype], x) for x in arrays)) or 0)


CHOICE = """\
#include "mbs_explicit.c"
double choose(long long e, long long n, double *J, double *B, long long *moves, long long *best);
double choose(long long e, long long n, double *J, double *B, long long *moves, long long *best)
{
    mbs_explicit plant;
    mbs_run run;
    plant.e = e, plant.n = n;
    run.p = &plant, run.free = n, run.moves = moves, run.best = best, run.J = J, run.B = B;
    return find_best(&run);
}
"""


def test_dependent_joints_have_the_largest_pivots(tmp_path: Path) -> None:
    """By elimination with exchanges of rows and columns in NumPy; the volume is the size of their determinant."""
    (tmp_path / "choice.c").write_text(CHOICE, encoding="utf-8")
    sources = [resources.folder("csrc") / name for name in ("mbs_least.c", "mbs_dense.c")]
    command = [*find_compiler(os.environ).command, "-std=c99", "-O1", "-fPIC", "-shared", f"-I{sources[0].parent}"]
    target = tmp_path / "choice.so"
    subprocess.run([*command, str(tmp_path / "choice.c"), *map(str, sources), "-lm", "-o", str(target)], check=True)
    ffi = cffi.FFI()
    ffi.cdef("double choose(long long e, long long n, double *J, double *B, long long *moves, long long *best);")
    library, rng = ffi.dlopen(str(target)), np.random.default_rng(11)
    for e, n in ((1, 3), (2, 4), (3, 5), (4, 6), (5, 9)):
        J = rng.normal(size=(e, n)) * 10.0 ** rng.integers(-2, 3, size=(e, n))
        rest, order = J.copy(), np.arange(n)
        for k in range(e):
            row, column = np.unravel_index(np.abs(rest[k:, k:]).argmax(), (e - k, n - k))
            rest[[k, k + row]] = rest[[k + row, k]]
            rest[:, [k, k + column]] = rest[:, [k + column, k]]
            order[[k, k + column]] = order[[k + column, k]]
            rest[k + 1 :] -= np.outer(rest[k + 1 :, k] / rest[k, k], rest[k])
        moves, best = np.arange(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
        kept, room = J.copy(), np.zeros((n, e))
        reals = (ffi.from_buffer("double[]", x) for x in (kept, room))
        volume = library.choose(e, n, *reals, *(ffi.from_buffer("long long[]", x) for x in (moves, best)))
        assert best.tolist() == order.tolist()
        assert volume == pytest.approx(np.linalg.slogdet(J[:, order[:e]])[1], abs=1e-9)
