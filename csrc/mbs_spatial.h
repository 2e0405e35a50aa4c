/* Motions and forces of bodies, and their moments, for recursions with loops over tables.
 *
 * Vectors are in the axes of the base, and of body i about its own joint point. A motion is (angular, linear), a force
 * (moment, force). Moments are the mass, first moments, and second moments xx yy zz xy xz yz. C99, reentrant.
 */
#ifndef MBS_SPATIAL_H
#define MBS_SPATIAL_H

#include "mbs_abi.h"

static inline void mbs_add_cross(const mbs_real *a, const mbs_real *b, mbs_real *c)
{
    c[0] += a[1] * b[2] - a[2] * b[1];
    c[1] += a[2] * b[0] - a[0] * b[2];
    c[2] += a[0] * b[1] - a[1] * b[0];
}

static inline mbs_real mbs_dot(const mbs_real *a, const mbs_real *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline mbs_real mbs_power(const mbs_real *motion, const mbs_real *force)
{
    return mbs_dot(motion, force) + mbs_dot(motion + 3, force + 3);
}

/* Take a force, known about a point at r, to the point that r leads from. */
static inline void mbs_carry_force(const mbs_real *r, mbs_real *f)
{
    mbs_add_cross(r, f + 3, f);
}

/* y += I x: m, h, P and a motion give a force. */
static inline void mbs_add_momentum(const mbs_real *I, const mbs_real *x, mbs_real *y)
{
    const mbs_real *P = I + 4, t = P[0] + P[1] + P[2];
    y[0] += (t - P[0]) * x[0] - P[3] * x[1] - P[4] * x[2];
    y[1] += (t - P[1]) * x[1] - P[3] * x[0] - P[5] * x[2];
    y[2] += (t - P[2]) * x[2] - P[4] * x[0] - P[5] * x[1];
    mbs_add_cross(I + 1, x + 3, y);
    mbs_add_cross(x, I + 1, y + 3);
    y[3] += I[0] * x[3];
    y[4] += I[0] * x[4];
    y[5] += I[0] * x[5];
}

/* Place a frame beside its parent's, whose rotation is `from`: R by rows, then the joint point. */
static inline void mbs_place_frame(const mbs_real *from, const mbs_real *placement, mbs_real *E, mbs_real *r)
{
    int c, k;
    for (k = 0; k < 3; ++k) {
        const mbs_real *row = from + 3 * k;
        for (c = 0; c < 3; ++c)
            E[3 * k + c] = row[0] * placement[c] + row[1] * placement[3 + c] + row[2] * placement[6 + c];
        r[k] = mbs_dot(row, placement + 9);
    }
}

/* Turn first and second moments to the axes of the base. */
static inline void mbs_turn_moments(const mbs_real *rotation, const mbs_real *moments, mbs_real *I)
{
    static const int rows[6] = {0, 1, 2, 0, 0, 1}, columns[6] = {0, 1, 2, 1, 2, 2};
    mbs_real T[9];
    int k;
    I[0] = moments[0];
    for (k = 0; k < 3; ++k) {
        const mbs_real *E = rotation + 3 * k, *P = moments + 4;
        I[1 + k] = mbs_dot(E, moments + 1);
        T[3 * k] = E[0] * P[0] + E[1] * P[3] + E[2] * P[4];
        T[3 * k + 1] = E[0] * P[3] + E[1] * P[1] + E[2] * P[5];
        T[3 * k + 2] = E[0] * P[4] + E[1] * P[5] + E[2] * P[2];
    }
    for (k = 0; k < 6; ++k)
        I[4 + k] = mbs_dot(T + 3 * rows[k], rotation + 3 * columns[k]);
}

/* Add moments, known about a point at r, to moments about the point that r leads from. */
static inline void mbs_join_moments(const mbs_real *r, const mbs_real *s, mbs_real *to)
{
    const mbs_real m = s[0], h[3] = {s[1] + m * r[0], s[2] + m * r[1], s[3] + m * r[2]};
    int k;
    to[0] += m;
    for (k = 0; k < 3; ++k) {
        to[1 + k] += h[k];
        to[4 + k] += s[4 + k] + (s[1 + k] + h[k]) * r[k];
    }
    to[7] += s[7] + s[1] * r[1] + r[0] * h[1];
    to[8] += s[8] + s[1] * r[2] + r[0] * h[2];
    to[9] += s[9] + s[2] * r[2] + r[1] * h[2];
}

#endif
