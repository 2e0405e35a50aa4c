/* Many small dense systems of linear equations, by elimination with partial pivoting. */
#ifndef MBS_DENSE_H
#define MBS_DENSE_H

#include "mbs_abi.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Factorise `systems` matrices in place, each n by n, row by row, one after another: U above the diagonal, the inverses
 * of U's diagonal on it, L, whose diagonal is 1, below; row k was exchanged with row pivot[k]. Returns how many are
 * singular: there U is not numbers. */
casadi_int mbs_factorise(casadi_int systems, casadi_int n, double *matrix, casadi_int *pivot);

/* Put A^-1 b in the place of b, for each system n by k, row by row. */
void mbs_solve(casadi_int systems, casadi_int n, const double *factors, const casadi_int *pivot, casadi_int k,
               double *b);

/* Put A^-T b in the place of b, for each system n numbers. */
void mbs_solve_transposed(casadi_int systems, casadi_int n, const double *factors, const casadi_int *pivot, double *b);

#ifdef __cplusplus
}
#endif

#endif
