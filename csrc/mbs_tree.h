/* Systems of linear equations with the matrix of a tree: A = LT D L > 0, L of unit diagonal, rows from the last to the
 * first (Featherstone, 2008, 6.5).
 *
 * Row k of L has its other entries at starts[k] to starts[k + 1] - 1 of `lower`, in the columns that `ancestors` gives.
 * C99, reentrant. `mbs_columns.h` solves for many columns at once.
 */
#ifndef MBS_TREE_H
#define MBS_TREE_H

#include "mbs_wires.h"

/* Give L and 1/D of a matrix by rows, which is used up; `scales` holds n numbers for the while.
 * Returns 0, or k > 0 where the pivot of row k, from 1, is not above `threshold` times the row's entry on the diagonal. */
static inline int mbs_factorise_tree(int n, const int *starts, const int *ancestors, mbs_real threshold, mbs_real *A,
                                     mbs_real *scales, mbs_real *lower, mbs_real *inverses)
{
    int d, e, k;
    for (k = 0; k < n; ++k)
        scales[k] = MBS_ABS(A[k * n + k]);
    for (k = n - 1; k >= 0; --k) {
        const mbs_real *row = A + k * n;
        if (!MBS_EXCEEDS(row[k], threshold * scales[k]))
            return k + 1;
        inverses[k] = MBS_C(1.0) / row[k];
        for (d = starts[k]; d < starts[k + 1]; ++d) {
            mbs_real *above = A + ancestors[d] * n;
            lower[d] = row[ancestors[d]] * inverses[k];
            for (e = starts[k]; e <= d; ++e)
                above[ancestors[e]] -= lower[d] * row[ancestors[e]];
        }
    }
    return 0;
}

/* Replace the rows B, of `width` numbers each, by A^-1 B. */
static inline void mbs_solve_tree(int n, const int *starts, const int *ancestors, const mbs_real *lower,
                                  const mbs_real *inverses, int width, mbs_real *B)
{
    int e, k;
    for (k = n - 1; k >= 0; --k)
        for (e = starts[k]; e < starts[k + 1]; ++e)
            mbs_subtract_row(width, lower[e], B + k * width, B + ancestors[e] * width);
    for (k = 0; k < n; ++k) {
        mbs_scale_row(width, inverses[k], B + k * width);
        for (e = starts[k]; e < starts[k + 1]; ++e)
            mbs_subtract_row(width, lower[e], B + ancestors[e] * width, B + k * width);
    }
}

#endif
