/* Eliminate the first unknowns of a small dense symmetric system. */
#ifndef MBS_FRONT_H
#define MBS_FRONT_H

#define MBS_LANES 8 /* columns of a front begin at multiples of it, and are filled up with zeros */

/* What may be a pivot. */
typedef struct {
    double threshold; /* least ratio of a pivot to the largest entry of its column, 0 to 0.5 */
    double zero;      /* what is not above is zero */
} mbs_pivoting;

typedef struct {
    int eliminated, negative, zeros; /* unknowns; eigenvalues of the pivots */
} mbs_eliminated;

/* Round up, and down, to a multiple of MBS_LANES. */
static inline int mbs_stride(int rows)
{
    return (rows + MBS_LANES - 1) / MBS_LANES * MBS_LANES;
}
static inline int mbs_lane(int row)
{
    return row / MBS_LANES * MBS_LANES;
}

/* A = L D LT for all of the first `pivots` unknowns that have acceptable pivots; the others follow them.
 *
 * `front` holds the lower triangle of A, `rows` by `rows`, column by column, `stride` apart. A column is
 * zero below its last row, and, down from mbs_lane of its diagonal, finite above it. On return the first `eliminated`
 * columns hold L below its diagonal of ones, which is 0, as is what is above it in its lanes. D goes into `d`, two numbers a pivot: the diagonal entry, and
 * its coupling to the next one, 0 except for the first of a pair. From there on it holds the remainder of A. `name[i]`
 * is the name of row i, and moves with it. If `last`, all unknowns are eliminated as well as possible, and rows without
 * any pivot count as zeros. `front` has room for MBS_LANES more, `work` for pivots * (stride + MBS_LANES).
 *
 * Pivots of one and two unknowns: Bunch and Kaufman, 1977; with a threshold: Duff and Reid, 1983. */
mbs_eliminated mbs_eliminate(double *front, int rows, int stride, int pivots, int last, const mbs_pivoting *pivoting,
                             double *d, int *name, double *work);

/* b -= x a, of n numbers, a multiple of MBS_LANES */
static inline void mbs_subtract(int n, double x, const double *restrict a, double *restrict b)
{
    int i, m;
    for (i = 0; i < n; i += MBS_LANES)
        for (m = 0; m < MBS_LANES; ++m)
            b[i + m] -= a[i + m] * x;
}

/* aT b, of n numbers, a multiple of MBS_LANES */
static inline double mbs_dot(int n, const double *a, const double *b)
{
    double sum[MBS_LANES] = {0.0};
    int i, m;
    for (i = 0; i < n; i += MBS_LANES)
        for (m = 0; m < MBS_LANES; ++m)
            sum[m] += a[i + m] * b[i + m];
    return ((sum[0] + sum[4]) + (sum[1] + sum[5])) + ((sum[2] + sum[6]) + (sum[3] + sum[7]));
}

#endif
