/* What passes between the stages of a kernel: nonzeros laid out in full, and taken from there.
 *
 * C99, reentrant.
 */
#ifndef MBS_WIRES_H
#define MBS_WIRES_H

#include "mbs_abi.h"

/* Write a full array of `size` numbers: nonzeros at the given places, zeros elsewhere. */
static inline void mbs_spread(int count, const int *places, const mbs_real *nonzeros, int size, mbs_real *full)
{
    int k;
    for (k = 0; k < size; ++k)
        full[k] = MBS_C(0.0);
    for (k = 0; k < count; ++k)
        full[places[k]] = nonzeros[k];
}

/* Write a full symmetric matrix of n rows from the triangle below its diagonal, which stands at the given places. */
static inline void mbs_spread_symmetric(int count, const int *places, const mbs_real *nonzeros, int n, mbs_real *full)
{
    int k;
    mbs_spread(count, places, nonzeros, n * n, full);
    for (k = 0; k < count; ++k)
        full[places[k] % n * n + places[k] / n] = nonzeros[k];
}

/* Take numbers from the given places, with the sign of `sign`. */
static inline void mbs_take(int count, const int *places, const mbs_real *full, int sign, mbs_real *taken)
{
    int k;
    for (k = 0; k < count; ++k)
        taken[k] = sign < 0 ? -full[places[k]] : full[places[k]];
}

static inline void mbs_copy(int count, const mbs_real *from, mbs_real *to)
{
    int k;
    for (k = 0; k < count; ++k)
        to[k] = from[k];
}

/* Subtract a multiple of one row from another. */
static inline void mbs_subtract_row(int width, mbs_real factor, const mbs_real *a, mbs_real *b)
{
    int k;
    for (k = 0; k < width; ++k)
        b[k] -= factor * a[k];
}

static inline void mbs_scale_row(int width, mbs_real factor, mbs_real *a)
{
    int k;
    for (k = 0; k < width; ++k)
        a[k] *= factor;
}

#endif
