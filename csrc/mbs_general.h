/* Systems of linear equations with a general matrix: P A = L U, partial pivoting (Golub and Van Loan, 3.4).
 *
 * Matrices are kept by rows. C99, reentrant.
 */
#ifndef MBS_GENERAL_H
#define MBS_GENERAL_H

#include "mbs_wires.h"

/* Factorise A in place: L below, U above, the inverses of U's diagonal on it; row k was exchanged with exchanges[k].
 * `scales` holds n numbers for the while. Returns 0, or k > 0 where column k, from 1, has no pivot above `threshold` times
 * its largest entry in A. */
static inline int mbs_factorise_general(int n, mbs_real threshold, mbs_real *A, mbs_real *scales, int *exchanges)
{
    int i, j, k;
    for (k = 0; k < n; ++k) {
        scales[k] = 0;
        for (i = 0; i < n; ++i)
            if (!(MBS_ABS(A[i * n + k]) <= scales[k]))
                scales[k] = MBS_ABS(A[i * n + k]);
    }
    for (k = 0; k < n; ++k) {
        mbs_real *row = A + k * n;
        int p = k;
        for (i = k + 1; i < n; ++i)
            if (MBS_ABS(A[i * n + k]) > MBS_ABS(A[p * n + k]))
                p = i;
        exchanges[k] = p;
        if (p != k)
            mbs_exchange_rows(n, row, A + p * n);
        if (!(MBS_ABS(row[k]) > threshold * scales[k]))
            return k + 1;
        row[k] = 1 / row[k];
        for (i = k + 1; i < n; ++i) {
            mbs_real *below = A + i * n;
            below[k] *= row[k];
            for (j = k + 1; j < n; ++j)
                below[j] -= below[k] * row[j];
        }
    }
    return 0;
}

/* Replace the rows B, of `width` numbers each, by A^-1 B. */
static inline void mbs_solve_general(int n, const mbs_real *A, const int *exchanges, int width, mbs_real *B)
{
    int i, k;
    for (k = 0; k < n; ++k)
        if (exchanges[k] != k)
            mbs_exchange_rows(width, B + k * width, B + exchanges[k] * width);
    for (k = 0; k < n; ++k)
        for (i = k + 1; i < n; ++i)
            mbs_subtract_row(width, A[i * n + k], B + k * width, B + i * width);
    for (k = n - 1; k >= 0; --k) {
        mbs_scale_row(width, A[k * n + k], B + k * width);
        for (i = 0; i < k; ++i)
            mbs_subtract_row(width, A[i * n + k], B + k * width, B + i * width);
    }
}

/* Replace the rows B by A^-T B. */
static inline void mbs_solve_transposed(int n, const mbs_real *A, const int *exchanges, int width, mbs_real *B)
{
    int i, k;
    for (k = 0; k < n; ++k) {
        mbs_scale_row(width, A[k * n + k], B + k * width);
        for (i = k + 1; i < n; ++i)
            mbs_subtract_row(width, A[k * n + i], B + k * width, B + i * width);
    }
    for (k = n - 1; k >= 0; --k)
        for (i = 0; i < k; ++i)
            mbs_subtract_row(width, A[k * n + i], B + k * width, B + i * width);
    for (k = n - 1; k >= 0; --k)
        if (exchanges[k] != k)
            mbs_exchange_rows(width, B + k * width, B + exchanges[k] * width);
}

#endif
