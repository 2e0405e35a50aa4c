/* M of a tree by composite bodies, with loops over tables, for the kernels that include this file.
 *
 * `procedure/tree_dynamics.py` states the equations. Bodies follow their parents. C99, reentrant.
 */
#ifndef MBS_MATRIX_H
#define MBS_MATRIX_H

#include "mbs_spatial.h"

/* What M needs of a body: its rotation, its joint point from the parent's, its axis, and the moments of all that it
 * carries. */
typedef struct {
    mbs_real E[9], r[3], axis[3], sum[10];
    int first; /* where the axis stands in the joint's unit motion */
} mbs_composite;

/* M in full, column by column; `rotors` are added to its diagonal. Used for the while: n + 1 bodies. */
static inline void mbs_write_matrix(int n, const int *parents, const int *joints, const mbs_real *placements,
                                       const mbs_real *moments, const mbs_real *rotors, mbs_composite *bodies,
                                       mbs_real *MBS_RESTRICT M)
{
    int i, j, k, is_chain = 1;
    for (k = 0; k < 9; ++k)
        bodies[0].E[k] = MBS_EVERY(k % 4 ? 0.0 : 1.0);
    for (i = 1; i <= n; ++i) {
        mbs_composite *body = bodies + i;
        is_chain &= parents[i - 1] == i - 1;
        mbs_place_frame(bodies[parents[i - 1]].E, placements + 12 * (i - 1), body->E, body->r);
        mbs_turn_moments(body->E, moments + 10 * (i - 1), body->sum);
        for (k = 0; k < 3; ++k)
            body->axis[k] = body->E[3 * k + joints[i - 1] % 3];
        body->first = joints[i - 1] < 3 ? 0 : 3;
    }
    if (!is_chain)
        for (k = 0; k < n * n; ++k)
            M[k] = MBS_EVERY(0.0);
    for (i = n; i >= 1; --i) { /* all that body i carries is known: branches join their bodies later */
        const mbs_composite *body = bodies + i;
        mbs_real motion[6], force[6];
        for (k = 0; k < 6; ++k)
            motion[k] = force[k] = MBS_EVERY(0.0);
        for (k = 0; k < 3; ++k)
            motion[body->first + k] = body->axis[k];
        mbs_add_momentum(body->sum, motion, force);
        for (j = i; j; j = parents[j - 1]) {
            const mbs_composite *carrier = bodies + j;
            M[(i - 1) * n + j - 1] = mbs_dot(carrier->axis, force + carrier->first);
            mbs_carry_force(carrier->r, force);
        }
        M[(i - 1) * n + i - 1] += rotors[i - 1];
        if (parents[i - 1])
            mbs_join_moments(body->r, body->sum, bodies[parents[i - 1]].sum);
    }
    for (i = 0; i < n; i += 8) /* the other triangle, by tiles that the caches hold */
        for (j = 0; j <= i; j += 8)
            for (k = i; k < n && k < i + 8; ++k) {
                int l;
                for (l = j; l < k && l < j + 8; ++l)
                    M[l * n + k] = M[k * n + l];
            }
}

#endif
