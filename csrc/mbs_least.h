/* Small dense systems: Cholesky's decomposition, LU, and equations B x = g with fewer equations than unknowns.
 *
 * The last are solved for the x of least norm by Householder's decomposition B^T P = Q R with column pivoting (Golub, Van
 * Loan, "Matrix Computations", algorithm 5.4.1), which shows the rank: pivots below a part of the first are taken for 0, and
 * their equations are left out.
 *
 * C99, reentrant, no allocation.
 */
#ifndef MBS_LEAST_H
#define MBS_LEAST_H

#include "mbs_abi.h"

#ifdef MBS_SINGLE /* names in object files say the precision */
#define mbs_least_factorise mbs_least_factorise_float
#define mbs_least_solve mbs_least_solve_float
#define mbs_least_weigh mbs_least_weigh_float
#define mbs_lu_factorise mbs_lu_factorise_float
#define mbs_lu_solve mbs_lu_solve_float
#define mbs_cholesky mbs_cholesky_float
#define mbs_cholesky_forward mbs_cholesky_forward_float
#define mbs_cholesky_backward mbs_cholesky_backward_float
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* e equations in n unknowns, e <= n. Column i of A, n numbers in a row, is equation i; mbs_least_factorise overwrites it. */
typedef struct {
    casadi_int n, e, rank;
    casadi_real *A;       /* room for n e numbers */
    casadi_real *factor;  /* for e: of Householder's reflections */
    casadi_real *size;    /* for 2 e */
    casadi_real *y;       /* for n */
    casadi_int *column;   /* for e: the equation that each column of R is of */
} mbs_least;

/* Decompose; the rank counts pivots above `tolerance` times the first. Returns the last pivot relative to the first: 0
 * where the rank is smaller than e. */
casadi_real mbs_least_factorise(mbs_least *system, casadi_real tolerance);

/* Write the least solution x (n) for the right-hand side g (e); returns the largest error of the equations left out. */
casadi_real mbs_least_solve(const mbs_least *system, const casadi_real *g, casadi_real *x);

/* Write lam (e) with B^T lam = x, for an x of mbs_least_solve; 0 for the equations left out. */
void mbs_least_weigh(const mbs_least *system, const casadi_real *x, casadi_real *lam);

/* Decompose A (n x n, row by row) = P L U in place; write the logarithm of its determinant's size. Returns the smallest pivot
 * relative to the largest: 0 for a singular matrix. */
casadi_real mbs_lu_factorise(casadi_int n, casadi_real *A, casadi_int *row, casadi_real *volume);

/* Solve A x = b in place of x, which holds b; `room` for n numbers. */
void mbs_lu_solve(casadi_int n, const casadi_real *A, const casadi_int *row, casadi_real *x, casadi_real *room);

/* Decompose M (n x n, lower triangle, row by row) = L L^T in place. Returns 0, or j for a lost pivot, from 1. */
int mbs_cholesky(casadi_int n, casadi_real *M);

/* Solve L x = b, or L^T x = b, in place. */
void mbs_cholesky_forward(casadi_int n, const casadi_real *L, casadi_real *x);
void mbs_cholesky_backward(casadi_int n, const casadi_real *L, casadi_real *x);

#ifdef __cplusplus
}
#endif

#endif
