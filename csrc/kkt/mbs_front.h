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

/* Round up to a multiple of MBS_LANES. */
int mbs_stride(int rows);

/* A = L D LT for all of the first `pivots` unknowns that have acceptable pivots; the others follow them.
 *
 * `front` holds the lower triangle of A, `rows` by `rows`, column by column, `stride` apart. On return its first
 * `eliminated` columns hold L below its diagonal of ones; D goes into `d`, two numbers a pivot: the diagonal entry, and
 * its coupling to the next one, 0 except for the first of a pair. From there on it holds the remainder of A. `name[i]`
 * is the name of row i, and moves with it. If `last`, all unknowns are eliminated as well as possible, and rows without
 * any pivot count as zeros. `front` has room for MBS_LANES more, `work` for pivots * (stride + MBS_LANES).
 *
 * Pivots of one and two unknowns: Bunch and Kaufman, 1977; with a threshold: Duff and Reid, 1983. */
mbs_eliminated mbs_eliminate(double *front, int rows, int stride, int pivots, int last, const mbs_pivoting *pivoting,
                             double *d, int *name, double *work);

/* b -= x a, and aT b, of n numbers */
void mbs_subtract(int n, double x, const double *a, double *b);
double mbs_dot(int n, const double *a, const double *b);

#endif
