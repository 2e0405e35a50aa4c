/* Motion of coordinates along velocities: numbers add, quaternions turn by the exponential, free bodies shift along the
 * mean of both attitudes. See mbs_variational.h. */
#ifndef MBS_GROUP_H
#define MBS_GROUP_H

#include "mbs_abi.h"

#include <math.h>

#define STRAIGHT 1e-6 /* of a square of an angle: below it functions of the angle are at their limits */

/* A joint with a quaternion: the first of its four entries of q, of its three turns in qd, and whether three entries of
 * q and of qd before them are a shift. */
typedef struct {
    casadi_int first, spin, is_free;
} mbs_attitude;

typedef struct {
    casadi_int nq, attitudes, scalars;  /* coordinates; joints with a quaternion, and with one coordinate: */
    const mbs_attitude *attitude;
    const casadi_int *place, *rate;     /* their entries of q and of qd */
} mbs_group;

static inline void write(casadi_int size, casadi_real factor, const casadi_real *x, casadi_real *y)
{
    casadi_int k;
    for (k = 0; k < size; ++k)
        y[k] = factor * x[k];
}

static inline casadi_real dot(const casadi_real *a, const casadi_real *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Add f a x b. */
static inline void add_cross(casadi_real f, const casadi_real *a, const casadi_real *b, casadi_real *sum)
{
    sum[0] += f * (a[1] * b[2] - a[2] * b[1]);
    sum[1] += f * (a[2] * b[0] - a[0] * b[2]);
    sum[2] += f * (a[0] * b[1] - a[1] * b[0]);
}

static inline casadi_real find_k(casadi_real square)
{
    const casadi_real angle = sqrt(square);
    return square < STRAIGHT * STRAIGHT ? 1 : 2 * tan(angle / 2) / angle;
}

/* Turn the vector b by the quaternion a, in place. */
static inline void rotate(const casadi_real *a, casadi_real *b)
{
    casadi_real t[3] = {0, 0, 0};
    add_cross(2, a, b, t);
    b[0] += a[3] * t[0], b[1] += a[3] * t[1], b[2] += a[3] * t[2];
    add_cross(1, a, t, b);
}

static inline void move_attitude(mbs_attitude a, const casadi_real *x, casadi_real *q)
{
    const casadi_real *w = x + a.spin, square = dot(w, w), half = sqrt(square) / 2;
    const casadi_real sine = half < STRAIGHT ? 0.5 : sin(half) / (2 * half), cosine = cos(half);
    casadi_real *turn = q + a.first, found[4], length;
    int i;
    if (a.is_free) {
        const casadi_real *d = w - 3;
        casadi_real c[3], once[3] = {0, 0, 0}, shift[3];
        write(3, find_k(square), w, c);
        write(3, 1, d, shift);
        add_cross(1, c, d, once);
        for (i = 0; i < 3; ++i)
            shift[i] += 2 * once[i] / (4 + dot(c, c));
        add_cross(1 / (4 + dot(c, c)), c, once, shift);
        rotate(turn, shift);
        for (i = 0; i < 3; ++i)
            turn[i - 3] += shift[i];
    }
    for (i = 0; i < 3; ++i)
        found[i] = turn[3] * sine * w[i] + cosine * turn[i];
    add_cross(sine, turn, w, found);
    found[3] = turn[3] * cosine - sine * dot(turn, w);
    length = sqrt(dot(found, found) + found[3] * found[3]);
    write(4, 1 / length, found, turn);
}

static inline void mbs_move(mbs_group g, const casadi_real *q, const casadi_real *x, casadi_real *end)
{
    casadi_int k;
    write(g.nq, 1, q, end);
    for (k = 0; k < g.scalars; ++k)
        end[g.place[k]] += x[g.rate[k]];
    for (k = 0; k < g.attitudes; ++k)
        move_attitude(g.attitude[k], x, end);
}

#endif
