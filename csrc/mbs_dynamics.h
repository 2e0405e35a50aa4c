/* The recursions over the joints of a tree, with loops over tables, for the kernels that include this file: the
 * factors of M, the accelerations, and dPhi/dq and dPhi/dqd as right-hand sides of their derivatives.
 *
 * Vectors are in the axes of the base, and of body i about its own joint point. A motion is (angular, linear), a force
 * (moment, force). `procedure/tree_dynamics.py` states the equations. Bodies follow their parents. C99, reentrant.
 */
#ifndef MBS_DYNAMICS_H
#define MBS_DYNAMICS_H

#include "mbs_abi.h"
#include "mbs_columns.h"
#include "mbs_spatial.h"

/* A body, then what is summed over all that it carries. */
typedef struct {
    mbs_real E[9];             /* rotation to the base, by rows */
    mbs_real r[3];             /* joint point from the parent's */
    mbs_real S[6], V[6], A[6]; /* the joint's unit motion; velocity; acceleration, less gravity */
    mbs_real V_S[6], A_S[6];   /* V x S, and A x S + V x (V x S), of the parent's V and A */
    mbs_real I[10];            /* mass, first moments, second moments xx yy zz xy xz yz */
    mbs_real sum[10], p[3], C[9], F[6]; /* of I, of momenta, of C = w~ P + h~ v~ by rows, of forces */
    mbs_real axis[3], U[6], W[6], inverse; /* of S; force on a unit motion of the free joint; -U / D; -1 / D */
    int first, carried; /* where the axis stands in S; the last body that it carries itself, or 0 */
} mbs_body;

/* Give a motion about a point at r from the one that it is known about. */
static inline void mbs_carry_motion(const mbs_real *r, const mbs_real *x, mbs_real *y)
{
    int k;
    for (k = 0; k < 6; ++k)
        y[k] = x[k];
    mbs_add_cross(x, r, y + 3);
}

/* y += a x b of two motions, and y += V x* f of a motion and a force. */
static inline void mbs_add_bracket(const mbs_real *a, const mbs_real *b, mbs_real *y)
{
    mbs_add_cross(a, b, y);
    mbs_add_cross(a, b + 3, y + 3);
    mbs_add_cross(a + 3, b, y + 3);
}

static inline void mbs_add_turned(const mbs_real *V, const mbs_real *f, mbs_real *y)
{
    mbs_add_cross(V, f, y);
    mbs_add_cross(V + 3, f + 3, y);
    mbs_add_cross(V, f + 3, y + 3);
}

/* y += D x, with D = -2 (C w; p x w) of the angular part w. */
static inline void mbs_add_gyration(const mbs_real *C, const mbs_real *p, const mbs_real *x, mbs_real *y)
{
    const mbs_real w[3] = {MBS_C(-2.0) * x[0], MBS_C(-2.0) * x[1], MBS_C(-2.0) * x[2]};
    y[0] += mbs_dot(C, w);
    y[1] += mbs_dot(C + 3, w);
    y[2] += mbs_dot(C + 6, w);
    mbs_add_cross(p, w, y + 3);
}

/* Place body i beside its parent (a null one at the base), and give its own inertia and motion at qdd = 0. Placement: R
 * by rows, then the joint point; joint: its axis, and 3 more where it slides. */
static inline void mbs_place_body(const mbs_body *from, int joint, const mbs_real *placement, const mbs_real *moments,
                                  mbs_real rate, mbs_body *to)
{
    const int axis = joint % 3, first = joint < 3 ? 0 : 3;
    mbs_real f[6], L[6] = {0};
    int c, k;
    mbs_place_frame(from->E, placement, to->E, to->r);
    for (k = 0; k < 3; ++k) {
        to->S[k] = to->S[k + 3] = MBS_EVERY(0.0);
        to->S[first + k] = to->axis[k] = to->E[3 * k + axis];
    }
    to->first = first;
    mbs_carry_motion(to->r, from->V, to->V);
    mbs_carry_motion(to->r, from->A, to->A);
    for (k = 0; k < 6; ++k)
        to->V_S[k] = MBS_EVERY(0.0);
    mbs_add_bracket(to->V, to->S, to->V_S);
    for (k = 0; k < 6; ++k) {
        to->V[k] += to->S[k] * rate;
        to->A[k] += to->V_S[k] * rate;
    }

    mbs_turn_moments(to->E, moments, to->I);
    for (k = 0; k < 10; ++k)
        to->sum[k] = to->I[k];
    mbs_add_momentum(to->I, to->V, L);
    for (k = 0; k < 6; ++k)
        f[k] = MBS_EVERY(0.0);
    mbs_add_momentum(to->I, to->A, f);
    mbs_add_turned(to->V, L, f);
    for (k = 0; k < 6; ++k)
        to->F[k] = f[k];
    for (k = 0; k < 3; ++k)
        to->p[k] = L[3 + k];
    {
        /* columns of C: w x (P e) + h x (v x e) */
        const mbs_real *P = to->I + 4, *h = to->I + 1, *v = to->V + 3, full = mbs_dot(h, v);
        const mbs_real Q[9] = {P[0], P[3], P[4], P[3], P[1], P[5], P[4], P[5], P[2]};
        for (c = 0; c < 3; ++c) {
            mbs_real y[3] = {v[0] * h[c], v[1] * h[c], v[2] * h[c]};
            y[c] -= full;
            mbs_add_cross(to->V, Q + 3 * c, y);
            for (k = 0; k < 3; ++k)
                to->C[3 * k + c] = y[k];
        }
    }
}

/* Add what a body carries to what its parent carries. */
static inline void mbs_join_body(const mbs_body *body, mbs_body *to)
{
    const mbs_real *r = body->r, *p = body->p;
    const mbs_real full = mbs_dot(r, p);
    mbs_real F[6];
    int c, k;
    mbs_join_moments(r, body->sum, to->sum);
    for (k = 0; k < 3; ++k)
        to->p[k] += p[k];
    for (k = 0; k < 3; ++k) {
        for (c = 0; c < 3; ++c)
            to->C[3 * k + c] += body->C[3 * k + c] + p[k] * r[c];
        to->C[4 * k] -= full;
    }
    for (k = 0; k < 6; ++k)
        F[k] = body->F[k];
    mbs_carry_force(r, F);
    for (k = 0; k < 6; ++k)
        to->F[k] += F[k];
}

/* The inertia that a body shows while the joints beyond it are free: moment = J w + H v, force = HT w + M v. */
typedef struct {
    mbs_real J[9], H[9], M[9];
} mbs_free_inertia;

static inline void mbs_free_body(const mbs_real *I, mbs_free_inertia *free)
{
    static const int places[9] = {0, 3, 4, 3, 1, 5, 4, 5, 2};
    const mbs_real *h = I + 1, *P = I + 4, total = P[0] + P[1] + P[2];
    int k;
    for (k = 0; k < 9; ++k) {
        free->J[k] = (k % 4 ? MBS_EVERY(0.0) : total) - P[places[k]];
        free->M[k] = k % 4 ? MBS_EVERY(0.0) : I[0];
    }
    free->H[0] = free->H[4] = free->H[8] = MBS_EVERY(0.0);
    free->H[5] = -(free->H[7] = h[0]);
    free->H[6] = -(free->H[2] = h[1]);
    free->H[1] = -(free->H[3] = h[2]);
}

static inline void mbs_apply_free(const mbs_free_inertia *free, const mbs_real *x, mbs_real *y)
{
    int k;
    for (k = 0; k < 3; ++k) {
        const mbs_real *H = free->H;
        y[k] = mbs_dot(free->J + 3 * k, x) + mbs_dot(H + 3 * k, x + 3);
        y[3 + k] = H[k] * x[0] + H[3 + k] * x[1] + H[6 + k] * x[2] + mbs_dot(free->M + 3 * k, x + 3);
    }
}

/* Add a body's inertia, less the share of its free joint, to its parent's. About the parent's point,
 * H' = H + r~ M and J' = J - H r~ + r~ H'T. */
static inline void mbs_join_free(const mbs_body *body, mbs_free_inertia *free, mbs_free_inertia *to)
{
    const mbs_real *U = body->U, *W = body->W, *r = body->r;
    int c, k;
    for (k = 0; k < 3; ++k)
        for (c = 0; c < 3; ++c) {
            free->J[3 * k + c] += U[k] * W[c];
            free->H[3 * k + c] += U[k] * W[3 + c];
            free->M[3 * k + c] += U[3 + k] * W[3 + c];
        }
    for (k = 0; k < 3; ++k) {
        const mbs_real *row = free->H + 3 * k;
        mbs_real turned[3];
        for (c = 0; c < 3; ++c)
            turned[c] = free->J[3 * k + c];
        mbs_add_cross(r, row, turned); /* -H r~, by rows */
        for (c = 0; c < 3; ++c)
            to->J[3 * k + c] += turned[c];
    }
    for (c = 0; c < 3; ++c) {
        mbs_real column[3] = {free->H[c], free->H[3 + c], free->H[6 + c]};
        const mbs_real moved[3] = {free->M[c], free->M[3 + c], free->M[6 + c]};
        mbs_add_cross(r, moved, column);
        for (k = 0; k < 3; ++k) {
            to->H[3 * k + c] += column[k];
            to->M[3 * k + c] += moved[k];
            free->H[3 * k + c] = column[k];
        }
    }
    for (c = 0; c < 3; ++c) {
        mbs_real column[3] = {MBS_EVERY(0.0), MBS_EVERY(0.0), MBS_EVERY(0.0)};
        mbs_add_cross(r, free->H + 3 * c, column);
        for (k = 0; k < 3; ++k)
            to->J[3 * k + c] += column[k];
    }
}

/* Eliminate the joints from the last to the first. A pivot must exceed its scale: the joint's entry of M, or a given
 * one. Returns 0, or the number of a joint. */
static inline int mbs_free_joints(int n, const int *parents, const int *owned, mbs_real alone, mbs_real locking,
                                  const mbs_real *rotors, const mbs_real *scales, mbs_free_inertia *free,
                                  mbs_body *bodies)
{
    int i, k;
    for (i = 1; i <= n; ++i)
        mbs_free_body(bodies[i].I, free + i);
    for (i = n; i >= 1; --i) {
        mbs_body *body = bodies + i;
        mbs_real felt[6], pivot, inverse;
        mbs_apply_free(free + i, body->S, body->U);
        pivot = rotors[i - 1] + mbs_power(body->S, body->U);
        for (k = 0; k < 6; ++k)
            felt[k] = MBS_EVERY(0.0);
        mbs_add_momentum(body->sum, body->S, felt);
        felt[0] = rotors[i - 1] + mbs_power(body->S, felt);
        if (!MBS_EXCEEDS(pivot, owned[i - 1] ? alone * felt[0] : locking * scales[i - 1]))
            return i;
        inverse = MBS_C(-1.0) / pivot;
        for (k = 0; k < 6; ++k)
            body->W[k] = body->U[k] * inverse;
        body->inverse = inverse;
        if (parents[i - 1])
            mbs_join_free(body, free + i, free + parents[i - 1]);
    }
    return 0;
}

#define MBS_JOIN(a, b) MBS_SUBTRACT(a, MBS_C(-1.0), b)

static inline void mbs_carry_lanes(const mbs_real *r, const mbs_lanes *x, mbs_lanes *y)
{
    MBS_SUBTRACT(y[0], r[2], x[1]);
    MBS_SUBTRACT(y[0], -r[1], x[2]);
    MBS_SUBTRACT(y[1], r[0], x[2]);
    MBS_SUBTRACT(y[1], -r[2], x[0]);
    MBS_SUBTRACT(y[2], r[1], x[0]);
    MBS_SUBTRACT(y[2], -r[0], x[1]);
}

/* Replace columns of B, `count` lanes of them, by -M^-1 B: forces on the bodies towards the base, then their
 * accelerations. Rows of B are `step` lanes apart; below row `last`, from 1, they are 0, and X is not computed. `work`
 * holds 6 (n + 1) times `count` lanes. Several lanes keep a processor busy while one waits for the body before. */
static inline void mbs_solve_lanes(int last, const int *parents, const mbs_body *bodies, int count, int step,
                                   mbs_lanes *work, mbs_lanes *B)
{
    const int size = 6 * count;
    int i, k, l;
    for (i = 0; i <= last; ++i)
        if (!bodies[i].carried || bodies[i].carried > last)
            for (k = 0; k < size; ++k)
                work[size * i + k] = (mbs_lanes){0};
    for (i = last; i >= 1; --i) {
        const mbs_body *body = bodies + i;
        const mbs_real *axis = body->axis;
        const int is_first = bodies[parents[i - 1]].carried == i;
        for (l = 0; l < count; ++l) {
            const mbs_lanes *f = work + size * i + 6 * l, *own = f + body->first;
            mbs_lanes *row = B + (i - 1) * step + l, *above = work + size * parents[i - 1] + 6 * l, b = *row, sum[6];
            MBS_UNROLLED
            for (k = 0; k < 3; ++k)
                MBS_SUBTRACT(b, axis[k], own[k]);
            *row = b;
            MBS_UNROLLED
            for (k = 0; k < 6; ++k) {
                sum[k] = f[k];
                MBS_SUBTRACT(sum[k], body->W[k], b);
            }
            mbs_carry_lanes(body->r, sum + 3, sum); /* r x f */
            if (!is_first)
                MBS_UNROLLED
                for (k = 0; k < 6; ++k)
                    MBS_JOIN(sum[k], above[k]);
            MBS_UNROLLED
            for (k = 0; k < 6; ++k)
                above[k] = sum[k];
        }
    }
    for (k = 0; k < size; ++k)
        work[k] = (mbs_lanes){0};
    for (i = 1; i <= last; ++i) {
        const mbs_body *body = bodies + i;
        const mbs_real *axis = body->axis, back[3] = {-body->r[0], -body->r[1], -body->r[2]};
        for (l = 0; l < count; ++l) {
            const mbs_lanes *from = work + size * parents[i - 1] + 6 * l;
            mbs_lanes *row = B + (i - 1) * step + l, *a = work + size * i + 6 * l, x = *row, sum[6];
            MBS_UNROLLED
            for (k = 0; k < 6; ++k)
                sum[k] = from[k];
            mbs_carry_lanes(back, sum, sum + 3); /* w x r */
            MBS_SCALE(x, body->inverse);
            MBS_UNROLLED
            for (k = 0; k < 6; ++k)
                MBS_SUBTRACT(x, -body->W[k], sum[k]);
            *row = x;
            if (body->first)
                MBS_UNROLLED
                for (k = 0; k < 3; ++k)
                    MBS_SUBTRACT(sum[3 + k], -axis[k], x);
            else
                MBS_UNROLLED
                for (k = 0; k < 3; ++k)
                    MBS_SUBTRACT(sum[k], -axis[k], x);
            MBS_UNROLLED
            for (k = 0; k < 6; ++k)
                a[k] = sum[k];
        }
    }
}

static inline mbs_real mbs_first(const mbs_lanes *lanes)
{
    return *(const mbs_real *)lanes;
}

/* Write -M^-1 b in the first numbers of a lane for each joint. */
static inline void mbs_solve_column(int n, const int *parents, const mbs_body *bodies, const mbs_real *b,
                                    mbs_lanes *work, mbs_lanes *column)
{
    int i;
    for (i = 0; i < n; ++i) {
        column[i] = (mbs_lanes){0};
        *(mbs_real *)(column + i) = b[i];
    }
    mbs_solve_lanes(n, parents, bodies, 1, 1, work, column);
}

/* Add accelerations of the joints to the motion of the bodies, and to the forces. */
static inline void mbs_accelerate(int n, const int *parents, const mbs_real *qdd, mbs_real *work, mbs_body *bodies)
{
    mbs_real *forces = work + 6 * (n + 1);
    int i, k;
    for (k = 0; k < 6; ++k)
        work[k] = MBS_EVERY(0.0);
    for (i = 1; i <= n; ++i) {
        mbs_real *more = work + 6 * i, *force = forces + 6 * i;
        mbs_carry_motion(bodies[i].r, work + 6 * parents[i - 1], more);
        for (k = 0; k < 6; ++k) {
            more[k] += bodies[i].S[k] * qdd[i - 1];
            bodies[i].A[k] += more[k];
            force[k] = MBS_EVERY(0.0);
        }
        mbs_add_momentum(bodies[i].I, more, force);
    }
    for (i = n; i >= 1; --i) {
        mbs_real *force = forces + 6 * i, *above = forces + 6 * parents[i - 1];
        for (k = 0; k < 6; ++k)
            bodies[i].F[k] += force[k];
        mbs_carry_force(bodies[i].r, force);
        if (parents[i - 1])
            for (k = 0; k < 6; ++k)
                above[k] += force[k];
    }
}

/* dPhi/dq and dPhi/dqd of the bodies, and M, of 3 blocks the first `blocks` ones, in the first columns of B, which has
 * rows of `width` numbers. */
static MBS_APART void mbs_write_slopes(int n, const int *parents, int blocks, int width, mbs_body *bodies,
                                       mbs_real *MBS_RESTRICT B)
{
    int i, j, k, is_chain = 1;
    for (i = 1; i <= n; ++i)
        is_chain &= parents[i - 1] == i - 1;
    for (i = 0; i < n; ++i)
        for (k = is_chain ? blocks * n : 0; k < width; ++k)
            B[i * width + k] = MBS_EVERY(0.0);
    for (i = 1; i <= n; ++i) {
        mbs_body *body = bodies + i;
        mbs_real A[6], *A_S = body->A_S;
        mbs_carry_motion(body->r, bodies[parents[i - 1]].A, A);
        for (k = 0; k < 6; ++k)
            A_S[k] = MBS_EVERY(0.0);
        mbs_add_bracket(A, body->S, A_S);
        mbs_carry_motion(body->r, bodies[parents[i - 1]].V, A);
        mbs_add_bracket(A, body->V_S, A_S);
    }
    for (i = 1; i <= n; ++i) {
        const mbs_body *body = bodies + i;
        const mbs_real *S = body->S, *C = body->C;
        mbs_real unit[6], by_q[6], by_qd[6], turned[3], twice[6], *row = B + (i - 1) * width;
        for (k = 0; k < 6; ++k) {
            unit[k] = by_q[k] = by_qd[k] = MBS_EVERY(0.0);
            twice[k] = MBS_C(2.0) * body->V_S[k];
        }
        mbs_add_momentum(body->sum, S, unit);
        mbs_add_gyration(C, body->p, S, by_qd);
        mbs_add_momentum(body->sum, twice, by_qd);
        mbs_add_gyration(C, body->p, body->V_S, by_q);
        mbs_add_momentum(body->sum, body->A_S, by_q);
        mbs_add_turned(S, body->F, by_q);
        for (k = 0; k < 3; ++k)
            turned[k] = -(C[k] * S[0] + C[3 + k] * S[1] + C[6 + k] * S[2]);
        mbs_add_cross(body->p, S + 3, turned);
        for (k = 0; k < 3; ++k)
            turned[k] *= MBS_C(2.0);
        for (j = i; j; j = parents[j - 1]) {
            const mbs_body *carrier = bodies + j;
            B[(j - 1) * width + i - 1] = mbs_dot(carrier->axis, by_q + carrier->first);
            B[(j - 1) * width + n + i - 1] = mbs_dot(carrier->axis, by_qd + carrier->first);
            row[j - 1] = mbs_dot(turned, carrier->V_S) + mbs_power(carrier->A_S, unit);
            row[n + j - 1] = mbs_dot(turned, carrier->S) + MBS_C(2.0) * mbs_power(carrier->V_S, unit);
            if (blocks == 3)
                row[2 * n + j - 1] = B[(j - 1) * width + 2 * n + i - 1] =
                    mbs_dot(carrier->axis, unit + carrier->first);
            mbs_carry_force(carrier->r, unit);
            mbs_carry_force(carrier->r, by_q);
            mbs_carry_force(carrier->r, by_qd);
        }
    }
}

/* The bodies of n joints with rates qd, at qdd = 0. */
static inline void mbs_write_bodies(int n, const int *parents, const int *joints, const mbs_real *placements,
                                    const mbs_real *moments, const mbs_real *gravity, const mbs_real *qd,
                                    mbs_body *bodies)
{
    int i, k;
    for (k = 0; k < 9; ++k)
        bodies[0].E[k] = MBS_EVERY(k % 4 ? 0.0 : 1.0);
    for (k = 0; k < 6; ++k)
        bodies[0].V[k] = bodies[0].A[k] = MBS_EVERY(0.0);
    for (k = 0; k < 3; ++k)
        bodies[0].A[3 + k] -= gravity[k];
    bodies[0].carried = 0;
    for (i = 1; i <= n; ++i) {
        mbs_place_body(bodies + parents[i - 1], joints[i - 1], placements + 12 * (i - 1), moments + 10 * (i - 1),
                       qd[i - 1], bodies + i);
        bodies[i].carried = 0;
        bodies[parents[i - 1]].carried = i;
    }
    for (i = n; i >= 1; --i)
        if (parents[i - 1])
            mbs_join_body(bodies + i, bodies + parents[i - 1]);
}

/* Solve for the accelerations, and move the bodies by them: `rest` are the forces of joints and wrenches at qdd = 0, and
 * `rotors` their share of M. Used for the while: n + 1 inertias, 12 (n + 1) lanes, a lane for each joint. Returns the
 * number of a joint whose pivot is lost, or 0. */
static inline int mbs_find_accelerations(int n, const int *parents, const int *owned, mbs_real alone, mbs_real locking,
                                         const mbs_real *rest, const mbs_real *rotors, const mbs_real *scales,
                                         mbs_free_inertia *free, mbs_lanes *work, mbs_lanes *column, mbs_body *bodies,
                                         mbs_real *qdd)
{
    int i;
    const int status = mbs_free_joints(n, parents, owned, alone, locking, rotors, scales, free, bodies);
    if (status)
        return status;
    for (i = 0; i < n; ++i)
        qdd[i] = rest[i] + mbs_power(bodies[i + 1].S, bodies[i + 1].F);
    mbs_solve_column(n, parents, bodies, qdd, work, column);
    for (i = 0; i < n; ++i)
        qdd[i] = mbs_first(column + i);
    mbs_accelerate(n, parents, qdd, (mbs_real *)work, bodies);
    return 0;
}

/* Move the bodies by given accelerations, at which `rest` are the forces of joints, wrenches and rotors. */
static inline void mbs_find_residual(int n, const int *parents, const mbs_real *qdd, const mbs_real *rest,
                                     mbs_lanes *work, mbs_body *bodies, mbs_real *Phi)
{
    int i;
    mbs_accelerate(n, parents, qdd, (mbs_real *)work, bodies);
    for (i = 0; i < n; ++i)
        Phi[i] = rest[i] + mbs_power(bodies[i + 1].S, bodies[i + 1].F);
}

/* Replace B, of rows of `width` numbers, by -M^-1 B. */
static inline void mbs_solve_bodies(int n, const int *parents, const mbs_body *bodies, int width, mbs_lanes *work,
                                    mbs_real *B)
{
    const int step = width / (MBS_LANES / 2);
    int k;
    for (k = 0; k < step; k += 2)
        mbs_solve_lanes(n, parents, bodies, 2, step, work, (mbs_lanes *)B + k);
}

/* Add numbers at the given places. */
static inline void mbs_add_places(int count, const int *places, const mbs_real *numbers, mbs_real *B)
{
    int k;
    for (k = 0; k < count; ++k)
        B[places[k]] += numbers[k];
}

/* Give some columns of B, one after another. */
static inline void mbs_give_columns(int n, int count, const int *columns, int width, const mbs_real *B,
                                    mbs_real *result)
{
    int c, first, k;
    for (first = 0; first < count; first += MBS_LANES) { /* not all at once: the caches hold a place of each */
        const int end = first + MBS_LANES < count ? first + MBS_LANES : count;
        for (k = 0; k < n; ++k)
            for (c = first; c < end; ++c)
                result[c * n + k] = B[k * width + columns[c]];
    }
}

static inline void mbs_give_entries(int count, const int *places, const mbs_real *B, mbs_real *result)
{
    int k;
    for (k = 0; k < count; ++k)
        result[k] = B[places[k]];
}

/* Add up columns of B, each row times its weight, the first number of a lane. */
static inline void mbs_weigh_columns(int n, int width, int count, const mbs_real *B, const mbs_lanes *weights,
                                     mbs_real *sums)
{
    int c, k;
    for (c = 0; c < count; ++c)
        sums[c] = MBS_EVERY(0.0);
    for (k = 0; k < n; ++k)
        for (c = 0; c < count; ++c)
            sums[c] += mbs_first(weights + k) * B[k * width + c];
}

#endif
