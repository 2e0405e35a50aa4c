/* One step of Radau collocation with closed loops, by Newton's method.
 *
 * The unknowns are, at each stage i, the accelerations a, the multipliers lam and the corrections mu of the rates:
 *
 *     v_i = v_0 + h sum_j A_ij a_j,    q_i = q_0 + h sum_j A_ij (v_j + B mu_j),    B = J^T at the start of the step
 *     Phi(q_i, v_i, a_i, lam_i) = 0,    h(q_i) = 0,    J(q_i) v_i = 0
 *
 * Gear, Gupta, Leimkuhler, Journal of Computational and Applied Mathematics 12 (1985); Hairer, Wanner, "Solving Ordinary
 * Differential Equations II", section VII.1. Coordinates are integrals of velocities: no quaternions.
 *
 * C99, reentrant except for the arrays that kernels read and write, no allocation.
 */
#ifndef MBS_RADAU_H
#define MBS_RADAU_H

#include "mbs_explicit.h"

#ifdef MBS_SINGLE /* names in object files say the precision */
#define mbs_radau_reals mbs_radau_reals_float
#define mbs_radau_integers mbs_radau_integers_float
#define mbs_radau_step mbs_radau_step_float
#endif

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    casadi_int n, m, e, d, s;  /* coordinates, inputs, equations of loops, driven joints, stages */
    casadi_real *q, *qd, *qdd, *lam, *v;     /* where kernels read */
    const casadi_real *Phi, *gap, *hd;       /* and write */
    mbs_entries K, C, M, L;                  /* dPhi by q, qd, qdd, lam */
    mbs_entries G, R, J;                     /* dh by q; d(J qd) by q and by qd */
    mbs_call dynamics, closure, rates;       /* Phi, h and J qd with these derivatives; without loops the last two are NULL */
    const casadi_int *driven;                /* entries of q, and of qd */
    const casadi_real *A;                    /* s x s */
} mbs_radau;

/* When an iteration ends: at a change below `converged`, or at one below `noise` that shrinks no more. */
typedef struct {
    casadi_real converged, noise;
    casadi_int most; /* iterations */
} mbs_radau_end;

/* Room for a step. */
casadi_int mbs_radau_reals(const mbs_radau *plant);
casadi_int mbs_radau_integers(const mbs_radau *plant);

/* Take a step of length h from q0, v0. z holds the guess of the unknowns, s rows of n + 2 e, and then the solution; changes
 * are judged times `weights`, n + 2 e. `inputs` and `courses` have a row for each stage: m inputs; coordinates, velocities
 * and accelerations of the driven joints. Writes coordinates and velocities at the stages, s x n. Returns the number of
 * iterations; 0 where they do not converge, a kernel fails or the matrix is singular. */
casadi_int mbs_radau_step(const mbs_radau *plant, mbs_radau_end end, casadi_real h, const casadi_real *inputs,
                          const casadi_real *courses, const casadi_real *q0, const casadi_real *v0,
                          const casadi_real *weights, casadi_real *z, casadi_real *q, casadi_real *v,
                          casadi_real *reals, casadi_int *integers);

#ifdef __cplusplus
}
#endif

#endif
