/* Integrate a motion with steps of a fixed length, explicitly. */
#ifndef MBS_SIMULATE_H
#define MBS_SIMULATE_H

#include "mbs_batch.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The functions for accelerations. Either `rate` computes them, in qdd; or, where `mass` is not NULL, `rate` computes
 * the residual for accelerations of 0, and `mass` the nonzeros of the mass matrix: then M qdd = -residual is solved.
 * The rates of the coordinates are the velocities; or, where `change` is not NULL, its results: with quaternions there
 * are more coordinates than velocities. */
typedef struct {
    casadi_int n;  /* velocities */
    casadi_int nq; /* coordinates */
    casadi_int m; /* inputs */
    casadi_real *q, *qd, *v; /* where the kernels read coordinates, velocities and inputs */
    casadi_real *qdd;        /* where `rate` writes */
    mbs_kernel rate;
    const casadi_real **rate_arg;
    casadi_real **rate_res;
    mbs_kernel mass;
    const casadi_real **mass_arg;
    casadi_real **mass_res;
    const casadi_real *M;   /* where `mass` writes */
    casadi_int entries;     /* nonzeros of M, */
    const casadi_int *place; /* and which entry of the matrix each is, row by row */
    casadi_real *matrix;    /* room for n n numbers */
    mbs_kernel change;
    const casadi_real **change_arg;
    casadi_real **change_res;
    const casadi_real *qt; /* where `change` writes */
} mbs_plant;

/* Take `steps` steps of length h by the Runge-Kutta method with the coefficients A (stages x stages, row by row; only
 * entries left of the diagonal count) and b. The inputs of stage i in step k begin at v + (k stages + i) v_step.
 * states: (steps + 1) x (nq + n) numbers, of each step q, then qd; the first is given, the others are written. work:
 * room for (nq + n) stages numbers. Returns the number of steps taken. If it is smaller than `steps`, `status` holds
 * the failure of the next step: k > 0 for a failure at joint k, -1 for numbers that are not finite. */
casadi_int mbs_simulate_rk(const mbs_plant *plant, casadi_int stages, const casadi_real *A, const casadi_real *b,
                           casadi_real h, casadi_int steps, const casadi_real *v, casadi_int v_step,
                           casadi_real *states, casadi_real *work, int *status);

#ifdef __cplusplus
}
#endif

#endif
