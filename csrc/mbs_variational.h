/* Variational steps of a fixed length, with quaternions and with closed loops.
 *
 * A velocity w holds for a step h and moves q0 to q1 = q0 tau(h w). With momenta p = M(q) qd, x = h w and A = A(x),
 *
 *     A(x)^T (M(q0) + M(q1)) w / 2  = p0 + h/2 (G(q0, w) + J(q0)^T lam),     h(q1) = 0
 *     A(-x)^T (M(q0) + M(q1)) w / 2 = p1 - h/2 (G(q1, w) + J(q1)^T lam1),    J(q1) qd1 = 0
 *
 * Numbers add, quaternions turn by the exponential, free bodies shift along the mean of both attitudes:
 *
 *     place + R (d + (2 c x d + c x (c x d)) / (4 + c.c)),    c = k w,  k = 2 tan(|w| / 2) / |w|
 *     A(x) (a, b) = ((1 - c~/2) (a - d~ b / 2), (1 - w~/2 + s w~ w~) b),    s = (1 - 1/k) / w.w
 *
 * Marsden, West, Acta Numerica 10 (2001), section 3.5; Hante, Arnold, Journal of Computational and Applied Mathematics 387
 * (2021). Inputs depend on time alone, and no joint is driven.
 *
 * C99, reentrant except for the arrays that kernels read and write, no allocation.
 */
#ifndef MBS_VARIATIONAL_H
#define MBS_VARIATIONAL_H

#include "mbs_explicit.h"
#include "mbs_group.h"

#ifdef MBS_SINGLE /* names in object files say the precision */
#define mbs_variational_reals mbs_variational_reals_float
#define mbs_variational_integers mbs_variational_integers_float
#define mbs_variational_run mbs_variational_run_float
#endif

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    casadi_int n, nq, m, e;         /* velocities, coordinates, inputs, equations of loops */
    casadi_real *q, *qd, *qdd, *v;  /* where kernels read */
    const casadi_real *Phi, *gap;   /* and write */
    mbs_entries K, C, M;            /* dPhi by q, qd, qdd */
    mbs_entries J, N;               /* of loops; the rates of q by qd */
    mbs_call dynamics;              /* Phi without forces of loops, with these derivatives */
    mbs_call closure, jacobian;     /* h; J. NULL without loops */
    mbs_call change;                /* N; NULL where rates are velocities */
    casadi_int attitudes, scalars;  /* joints with a quaternion, and with one coordinate: */
    const mbs_attitude *attitude;
    const casadi_int *place, *rate; /* their entries of q and of qd */
} mbs_variational;

/* When an iteration ends: at a change below `converged`, or at one below `noise` that shrinks no more. */
typedef struct {
    casadi_real converged, noise;
    casadi_int most; /* iterations of a step */
} mbs_variational_end;

/* Room for a run. */
casadi_int mbs_variational_reals(const mbs_variational *plant);
casadi_int mbs_variational_integers(const mbs_variational *plant);

/* Take at most `steps` steps of length h from states[0]: nq coordinates and n velocities in each row. `inputs` has a row of
 * m for each state, v_step apart. speeds[k] is the velocity of step k, n numbers; `guess` holds n + e numbers, a velocity
 * and multipliers, and afterwards the last step's. Adds to `iterations`; returns how many steps were taken: fewer where an
 * iteration does not converge, a kernel fails or a matrix is singular. */
casadi_int mbs_variational_run(const mbs_variational *plant, mbs_variational_end end, casadi_real h, casadi_int steps,
                               const casadi_real *inputs, casadi_int v_step, casadi_real *states, casadi_real *speeds,
                               casadi_real *guess, casadi_int *iterations, casadi_real *reals, casadi_int *integers);

#ifdef __cplusplus
}
#endif

#endif
