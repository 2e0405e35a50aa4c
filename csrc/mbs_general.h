/* Systems of linear equations with a general matrix: P A = L U, partial pivoting (Golub and Van Loan, 3.4).
 *
 * Matrices are kept by rows. C99, reentrant.
 */
#ifndef MBS_GENERAL_H
#define MBS_GENERAL_H

#include "mbs_wires.h"

/* Exchange rows of `width` numbers, in one of the states that lie side by side. */
static inline void mbs_exchange_rows(int state, int width, mbs_real *a, mbs_real *b)
{
    MBS_REAL *x = (MBS_REAL *)a + state, *y = (MBS_REAL *)b + state;
    int k;
    for (k = 0; k < width * MBS_ABREAST; k += MBS_ABREAST) {
        const MBS_REAL number = x[k];
        x[k] = y[k];
        y[k] = number;
    }
}

/* Exchange row k with the row, not before it, whose entry in column k is the largest: in each state its own. */
static inline void mbs_exchange_pivots(int n, int k, mbs_real *A, int *exchanges)
{
    int state, i;
    for (state = 0; state < MBS_ABREAST; ++state) {
        const MBS_REAL *column = (const MBS_REAL *)(A + k) + state;
        int p = k;
        for (i = k + 1; i < n; ++i)
            if (MBS_ABS_OF_ONE(column[i * n * MBS_ABREAST]) > MBS_ABS_OF_ONE(column[p * n * MBS_ABREAST]))
                p = i;
        exchanges[k * MBS_ABREAST + state] = p;
        if (p != k)
            mbs_exchange_rows(state, n, A + k * n, A + p * n);
    }
}

/* Factorise A in place: L below, U above, the inverses of U's diagonal on it; row k was exchanged with exchanges[k].
 * `scales` holds n numbers for the while. Returns 0, or k > 0 where column k, from 1, has no pivot above `threshold` times
 * its largest entry in A. */
static inline int mbs_factorise_general(int n, mbs_real threshold, mbs_real *A, mbs_real *scales, int *exchanges)
{
    int i, j, k;
    for (k = 0; k < n; ++k) {
        scales[k] = MBS_C(0.0);
        for (i = 0; i < n; ++i)
            scales[k] = MBS_LARGER(MBS_ABS(A[i * n + k]), scales[k]);
    }
    for (k = 0; k < n; ++k) {
        mbs_real *row = A + k * n;
        mbs_exchange_pivots(n, k, A, exchanges);
        if (!MBS_EXCEEDS(MBS_ABS(row[k]), threshold * scales[k]))
            return k + 1;
        row[k] = MBS_C(1.0) / row[k];
        for (i = k + 1; i < n; ++i) {
            mbs_real *below = A + i * n;
            below[k] *= row[k];
            for (j = k + 1; j < n; ++j)
                below[j] -= below[k] * row[j];
        }
    }
    return 0;
}

/* Exchange the rows of B as the rows k of A were. */
static inline void mbs_exchange_again(int k, const int *exchanges, int width, mbs_real *B)
{
    int state;
    for (state = 0; state < MBS_ABREAST; ++state) {
        const int p = exchanges[k * MBS_ABREAST + state];
        if (p != k)
            mbs_exchange_rows(state, width, B + k * width, B + p * width);
    }
}

/* Replace the rows B, of `width` numbers each, by A^-1 B. */
static inline void mbs_solve_general(int n, const mbs_real *A, const int *exchanges, int width, mbs_real *B)
{
    int i, k;
    for (k = 0; k < n; ++k)
        mbs_exchange_again(k, exchanges, width, B);
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
        mbs_exchange_again(k, exchanges, width, B);
}

#endif
