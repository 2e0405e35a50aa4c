/* Systems of linear equations with a symmetric matrix that need not be definite: P A PT = L D LT with blocks of one row
 * or two in D (Bunch and Kaufman, 1977; as in LAPACK's dsytf2).
 *
 * Matrices are kept by rows, both triangles. C99, reentrant.
 */
#ifndef MBS_SYMMETRIC_H
#define MBS_SYMMETRIC_H

#include "mbs_wires.h"

/* Rows of one state's numbers. */
static inline void mbs_exchange_numbers(int width, MBS_REAL *a, MBS_REAL *b)
{
    int k;
    for (k = 0; k < width; ++k) {
        const MBS_REAL x = a[k];
        a[k] = b[k];
        b[k] = x;
    }
}

static inline void mbs_subtract_numbers(int width, MBS_REAL factor, const MBS_REAL *a, MBS_REAL *b)
{
    int k;
    for (k = 0; k < width; ++k)
        b[k] -= factor * a[k];
}

static inline void mbs_scale_numbers(int width, MBS_REAL factor, MBS_REAL *a)
{
    int k;
    for (k = 0; k < width; ++k)
        a[k] *= factor;
}

/* Return the row after k whose entry in column k is the largest. */
static inline int mbs_find_partner(int n, const MBS_REAL *A, int k)
{
    int i, r = k + 1;
    for (i = k + 2; i < n; ++i)
        if (MBS_ABS_OF_ONE(A[i * n + k]) > MBS_ABS_OF_ONE(A[r * n + k]))
            r = i;
    return r;
}

/* Return how many rows the next pivot has, and give the row that is exchanged with its last. 41/64 is
 * (1 + sqrt(17))/8, nearly: the least growth. */
static inline int mbs_choose_block(int n, const MBS_REAL *A, int k, int *p)
{
    MBS_REAL diagonal, largest, other = 0;
    int i, r;
    *p = k;
    if (k == n - 1)
        return 1;
    r = mbs_find_partner(n, A, k);
    diagonal = MBS_ABS_OF_ONE(A[k * n + k]);
    largest = MBS_ABS_OF_ONE(A[r * n + k]);
    if (!(64 * diagonal < 41 * largest))
        return 1;
    for (i = k; i < n; ++i)
        if (i != r && MBS_ABS_OF_ONE(A[r * n + i]) > other)
            other = MBS_ABS_OF_ONE(A[r * n + i]);
    if (!(64 * diagonal * other < 41 * largest * largest))
        return 1;
    *p = r;
    return 64 * MBS_ABS_OF_ONE(A[r * n + r]) < 41 * other ? 2 : 1;
}

/* Exchange two rows and columns of what is left from row k on. */
static inline void mbs_exchange_both(int n, MBS_REAL *A, int k, int i, int j)
{
    int r;
    mbs_exchange_numbers(n - k, A + i * n + k, A + j * n + k);
    for (r = k; r < n; ++r)
        mbs_exchange_numbers(1, A + r * n + i, A + r * n + j);
}

/* Subtract, from what is left after a pivot of row k alone, its part. */
static inline void mbs_eliminate_one(int n, MBS_REAL *A, int k)
{
    int i, j;
    A[k * n + k] = 1 / A[k * n + k];
    for (i = k + 1; i < n; ++i) {
        const MBS_REAL entry = A[i * n + k] * A[k * n + k];
        for (j = k + 1; j <= i; ++j)
            A[j * n + i] = A[i * n + j] -= entry * A[k * n + j];
        A[i * n + k] = entry;
    }
}

/* The same for a pivot of rows k and k + 1. */
static inline void mbs_eliminate_two(int n, MBS_REAL *A, int k)
{
    MBS_REAL *upper = A + k * n + k, *lower = upper + n;
    const MBS_REAL a = upper[0] / lower[0], c = lower[1] / lower[0], scale = 1 / (lower[0] * (a * c - 1));
    int i, j;
    upper[0] = c * scale;
    lower[0] = -scale;
    lower[1] = a * scale;
    for (i = k + 2; i < n; ++i) {
        const MBS_REAL x = A[i * n + k], y = A[i * n + k + 1];
        const MBS_REAL first = x * upper[0] + y * lower[0], second = x * lower[0] + y * lower[1];
        for (j = k + 2; j <= i; ++j)
            A[j * n + i] = A[i * n + j] -= first * A[k * n + j] + second * A[(k + 1) * n + j];
        A[i * n + k] = first;
        A[i * n + k + 1] = second;
    }
}

/* Factorise A in place: L below, the inverse of D on the diagonal and, in blocks of two rows, below it. An exchange is p
 * for a block of one row, and -1 - p twice for one of two, whose second row it is. `scales` holds n numbers for the while.
 * Returns 0, or k > 0 where row k, from 1, has no pivot above `threshold` times its largest entry in A. */
static inline int mbs_factorise_symmetric_alone(int n, MBS_REAL threshold, MBS_REAL *A, MBS_REAL *scales, int *exchanges)
{
    int i, k, p, width;
    for (k = 0; k < n; ++k) {
        scales[k] = 0;
        for (i = 0; i < n; ++i)
            if (!(MBS_ABS_OF_ONE(A[k * n + i]) <= scales[k]))
                scales[k] = MBS_ABS_OF_ONE(A[k * n + i]);
    }
    for (k = 0; k < n; k += width) {
        MBS_REAL largest = MBS_ABS_OF_ONE(A[k * n + k]);
        for (i = k + 1; i < n; ++i)
            if (!(MBS_ABS_OF_ONE(A[i * n + k]) <= largest))
                largest = MBS_ABS_OF_ONE(A[i * n + k]);
        if (!(largest > threshold * scales[k]))
            return k + 1;
        width = mbs_choose_block(n, A, k, &p);
        exchanges[k] = exchanges[k + width - 1] = width == 1 ? p : -1 - p;
        if (p != k + width - 1) {
            mbs_exchange_both(n, A, k, k + width - 1, p);
            mbs_exchange_numbers(1, scales + k + width - 1, scales + p);
        }
        if (width == 1)
            mbs_eliminate_one(n, A, k);
        else
            mbs_eliminate_two(n, A, k);
    }
    return 0;
}

/* Replace the rows B, of `width` numbers each, by A^-1 B. */
static inline void mbs_solve_symmetric_alone(int n, const MBS_REAL *A, const int *exchanges, int width, MBS_REAL *B)
{
    int i, j, k, c;
    for (k = 0; k < n;) {
        const int is_one = exchanges[k] >= 0, last = is_one ? k : k + 1, p = is_one ? exchanges[k] : -1 - exchanges[k];
        if (p != last)
            mbs_exchange_numbers(width, B + last * width, B + p * width);
        for (i = last + 1; i < n; ++i)
            for (j = k; j <= last; ++j)
                mbs_subtract_numbers(width, A[i * n + j], B + j * width, B + i * width);
        if (is_one)
            mbs_scale_numbers(width, A[k * n + k], B + k * width);
        else {
            MBS_REAL *upper = B + k * width, *lower = upper + width;
            for (c = 0; c < width; ++c) {
                const MBS_REAL x = upper[c], y = lower[c];
                upper[c] = A[k * n + k] * x + A[last * n + k] * y;
                lower[c] = A[last * n + k] * x + A[last * n + last] * y;
            }
        }
        k = last + 1;
    }
    for (k = n - 1; k >= 0;) {
        const int is_one = exchanges[k] >= 0, first = is_one ? k : k - 1, p = is_one ? exchanges[k] : -1 - exchanges[k];
        for (j = first; j <= k; ++j)
            for (i = k + 1; i < n; ++i)
                mbs_subtract_numbers(width, A[i * n + j], B + i * width, B + j * width);
        if (p != k)
            mbs_exchange_numbers(width, B + k * width, B + p * width);
        k = first - 1;
    }
}

#ifdef MBS_STATES

/* Take the numbers of one of the states that lie side by side, and put them back. */
static inline void mbs_take_state(int state, int count, const mbs_real *from, MBS_REAL *to)
{
    int k;
    for (k = 0; k < count; ++k)
        to[k] = from[k][state];
}

static inline void mbs_put_state(int state, int count, const MBS_REAL *from, mbs_real *to)
{
    int k;
    for (k = 0; k < count; ++k)
        to[k][state] = from[k];
}

/* Each state chooses its own pivots. */
static inline int mbs_factorise_symmetric(int n, mbs_real threshold, mbs_real *A, mbs_real *scales, int *exchanges)
{
    MBS_REAL alone[n * n], scale[n];
    int state, status;
    (void)scales;
    for (state = 0; state < MBS_STATES; ++state) {
        mbs_take_state(state, n * n, A, alone);
        status = mbs_factorise_symmetric_alone(n, threshold[state], alone, scale, exchanges + state * n);
        if (status)
            return status;
        mbs_put_state(state, n * n, alone, A);
    }
    return 0;
}

static inline void mbs_solve_symmetric(int n, const mbs_real *A, const int *exchanges, int width, mbs_real *B)
{
    MBS_REAL alone[n * n], rows[n * width];
    int state;
    for (state = 0; state < MBS_STATES; ++state) {
        mbs_take_state(state, n * n, A, alone);
        mbs_take_state(state, n * width, B, rows);
        mbs_solve_symmetric_alone(n, alone, exchanges + state * n, width, rows);
        mbs_put_state(state, n * width, rows, B);
    }
}

#else

#define mbs_factorise_symmetric mbs_factorise_symmetric_alone
#define mbs_solve_symmetric mbs_solve_symmetric_alone

#endif

#endif
