/* Dry friction by the load of joints, in one state: forces of bearings, and the loads N of sliding joints,
 *
 *     N_i = sum_k |c_k + D_k N|,    k: bearings of joint i,
 *
 * with the forces c of bearings without this friction, and D by a load of 1. S_ij is the sum of |D_kj| over these bearings.
 * If (1 - S) weight = 1 has a positive solution, the spectral radius of S is below 1: S is not negative. The right side
 * contracts in the norm max |N_i|/weight_i then, and has one solution, which Newton's method finds.
 *
 * Berman, Plemmons, "Nonnegative matrices in the mathematical sciences" (1979), theorem 6.2.3.
 */
#ifndef MBS_LOADS_H
#define MBS_LOADS_H

#include "mbs_entries.h"
#include "mbs_least.h"

#include <math.h>

#define MBS_FIXED 4     /* roundings of the loads: a smaller change ends Newton's method */
#define MBS_MOST_STEPS 200

/* Numbers of the bearings' forces, of D, of two matrices, and of vectors of d loads. */
static inline casadi_int mbs_loads_reals(const mbs_loads *m, casadi_int n)
{
    return 3 * m->bearings * (n + 1) + 2 * n * n + 8 * n + 6 * m->joints + 3 * m->axes + n * n;
}

/* Where the numbers are. */
typedef struct {
    casadi_real *c;        /* bearings x 3, */
    casadi_real *D;        /* d x bearings x 3, */
    casadi_real *S, *A;    /* d x d: the second for systems of equations */
    casadi_real *N, *rest, *trial, *change, *weight, *length, *room, *spare; /* d */
    casadi_real *force, *moment; /* 3 x joints */
    casadi_real *turn;     /* 3 x axes */
    casadi_real *column;   /* d x n: accelerations by loads of 1 */
    casadi_int *sliding;   /* d joints */
    casadi_int *row;       /* d */
    casadi_int d;
} mbs_load_room;

static inline mbs_load_room mbs_open_loads(const mbs_loads *m, casadi_int n, casadi_real *reals, casadi_int *integers)
{
    mbs_load_room l;
    l.c = reals, l.D = l.c + 3 * m->bearings, l.S = l.D + 3 * m->bearings * n, l.A = l.S + n * n, l.N = l.A + n * n;
    l.rest = l.N + n, l.trial = l.rest + n, l.change = l.trial + n, l.weight = l.change + n, l.length = l.weight + n;
    l.room = l.length + n, l.spare = l.room + n, l.force = l.spare + n, l.moment = l.force + 3 * m->joints;
    l.turn = l.moment + 3 * m->joints, l.column = l.turn + 3 * m->axes;
    l.sliding = integers, l.row = integers + n, l.d = 0;
    return l;
}

/* Write the forces of bearings across their axes, in the frames of their joints, from the reactions. */
static inline void mbs_bear(const mbs_loads *m, mbs_load_room *l, casadi_real *forces)
{
    casadi_int k, i, j;
    mbs_fill_entries(m->force, 3 * m->joints, l->force);
    mbs_fill_entries(m->moment, 3 * m->joints, l->moment);
    for (k = 0; k < m->bearings; ++k) {
        const casadi_int f = m->frame[k];
        const casadi_real *by_force = m->by_force + 9 * k, *by_moment = m->by_moment + 9 * k;
        casadi_real local[6] = {0, 0, 0, 0, 0, 0};
        for (i = 0; i < 3; ++i)
            for (j = 0; j < 3; ++j) {
                const casadi_real turn = l->turn[j * m->axes + 3 * f + i];
                local[i] += turn * l->force[j * m->joints + f];
                local[3 + i] += turn * l->moment[j * m->joints + f];
            }
        for (i = 0; i < 3; ++i) {
            forces[3 * k + i] = 0;
            for (j = 0; j < 3; ++j)
                forces[3 * k + i] += by_force[3 * i + j] * local[j] + by_moment[3 * i + j] * local[3 + j];
        }
    }
}

static inline casadi_real mbs_size(const casadi_real *x)
{
    return sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
}

/* Return the sum of the forces of a joint's bearings. */
static inline casadi_real mbs_add_loads(const mbs_loads *m, const casadi_real *forces, casadi_int joint)
{
    casadi_real sum = 0;
    casadi_int k;
    for (k = 0; k < m->bearings; ++k)
        sum += m->owner[k] == joint ? mbs_size(forces + 3 * k) : 0;
    return sum;
}

/* Write the right side less N to `rest`, and 1 less its derivative to A. */
static inline void mbs_look_at_loads(const mbs_loads *m, mbs_load_room *l, const casadi_real *N)
{
    const casadi_int d = l->d, size = 3 * m->bearings;
    casadi_int i, j, k, c;
    for (i = 0; i < d; ++i) {
        l->rest[i] = -N[i];
        for (j = 0; j < d; ++j)
            l->A[i * d + j] = i == j;
        for (k = 0; k < m->bearings; ++k) {
            casadi_real force[3], length;
            if (m->owner[k] != l->sliding[i])
                continue;
            for (c = 0; c < 3; ++c)
                for (j = 0, force[c] = l->c[3 * k + c]; j < d; ++j)
                    force[c] += l->D[j * size + 3 * k + c] * N[j];
            length = mbs_size(force);
            l->rest[i] += length;
            for (j = 0; j < d && length > 0; ++j)
                for (c = 0; c < 3; ++c)
                    l->A[i * d + j] -= force[c] / length * l->D[j * size + 3 * k + c];
        }
    }
}

/* Return the largest of |x| over the weights. */
static inline casadi_real mbs_weigh_loads(const mbs_load_room *l, const casadi_real *x)
{
    casadi_real most = 0;
    casadi_int i;
    for (i = 0; i < l->d; ++i)
        if (!(fabs(x[i]) <= most * l->weight[i]))
            most = fabs(x[i]) / l->weight[i];
    return most;
}

/* Solve for the weights; return whether the right side contracts. */
static inline int mbs_find_weights(const mbs_loads *m, mbs_load_room *l)
{
    const casadi_int d = l->d, size = 3 * m->bearings;
    casadi_real volume;
    casadi_int i, j, k;
    for (i = 0; i < d; ++i) {
        l->length[i] = mbs_add_loads(m, l->c, l->sliding[i]);
        l->weight[i] = 1;
        for (j = 0; j < d; ++j) {
            l->S[i * d + j] = mbs_add_loads(m, l->D + j * size, l->sliding[i]);
            l->A[i * d + j] = (i == j) - l->S[i * d + j];
        }
    }
    if (!(mbs_lu_factorise(d, l->A, l->row, &volume) > 0))
        return 0;
    mbs_lu_solve(d, l->A, l->row, l->weight, l->room);
    for (k = 0; k < d; ++k)
        if (!(l->weight[k] > 0) || l->weight[k] - l->weight[k] != 0)
            return 0;
    return 1;
}

/* Take a step of Newton's method from N, whose `rest` and A are there, to `trial`; a step that is no better is one of the
 * iteration N = right side. */
static inline void mbs_step_to_loads(const mbs_loads *m, mbs_load_room *l)
{
    const casadi_int d = l->d;
    const casadi_real before = mbs_weigh_loads(l, l->rest);
    casadi_real volume;
    casadi_int i;
    for (i = 0; i < d; ++i)
        l->change[i] = l->spare[i] = l->rest[i];
    mbs_lu_factorise(d, l->A, l->row, &volume);
    mbs_lu_solve(d, l->A, l->row, l->change, l->room);
    for (i = 0; i < d; ++i)
        l->trial[i] = l->N[i] + l->change[i];
    mbs_look_at_loads(m, l, l->trial);
    if (mbs_weigh_loads(l, l->rest) <= before)
        return;
    for (i = 0; i < d; ++i)
        l->trial[i] = l->N[i] + l->spare[i];
    mbs_look_at_loads(m, l, l->trial);
}

/* Solve for the loads N of sliding joints. Returns 0, or MBS_LOADED where they are not known. */
static inline int mbs_find_loads(const mbs_loads *m, mbs_load_room *l)
{
    const casadi_int d = l->d;
    casadi_int i, j, k;
    const int contracts = mbs_find_weights(m, l);
    for (i = 0; i < d; ++i)
        l->N[i] = l->length[i];
    if (!contracts)
        return d == 1 && l->length[0] == 0 ? 0 : MBS_LOADED;
    mbs_look_at_loads(m, l, l->N);
    for (k = 0; k < MBS_MOST_STEPS; ++k) {
        int is_found = 1;
        mbs_step_to_loads(m, l);
        for (i = 0; i < d; ++i) {
            casadi_real size = l->length[i];
            for (j = 0; j < d; ++j)
                size += l->S[i * d + j] * fabs(l->trial[j]);
            is_found &= fabs(l->trial[i] - l->N[i]) <= MBS_FIXED * MBS_EPSILON * l->weight[i] * size;
        }
        for (i = 0; i < d; ++i)
            l->N[i] = l->trial[i];
        if (is_found)
            return 0;
    }
    return MBS_LOADED;
}

#endif
