/* Impulses of contacts with dry friction: the cone problem of one instant.
 *
 * Velocities w = W P + free belong to impulses P, both in blocks of rows:
 *
 *     touch  P_n >= 0, w_n >= 0, P_n w_n = 0;  |P_t| <= mu P_n, and against the slip where it slips:  rows n, t1, t2
 *     push   P >= 0, w >= 0, P w = 0
 *     brake  |P| <= bound, w = 0 inside; at the bound P is against w
 *
 * The residual is the largest |P - project(P - rho w)|, with rho = 1/W_ii, relative to the largest of |P_i| and
 * rho |free_i|. It vanishes at solutions only. Rounds of projected Gauss-Seidel find the modes of the blocks, and Newton's
 * method on the projection (Alart, Curnier, Computer Methods in Applied Mechanics and Engineering 92, 1991) the digits:
 * matrices of redundant contacts are singular, so W is shifted by a part of its diagonal there, as in the proximal point
 * method, which changes no solution. Where no step makes the residual smaller, whole steps change the modes.
 *
 * C99, reentrant, no allocation.
 */
#ifndef MBS_CONE_H
#define MBS_CONE_H

#include "mbs_abi.h"

#ifdef MBS_SINGLE /* names in object files say the precision */
#define mbs_cone_reals mbs_cone_reals_float
#define mbs_cone_integers mbs_cone_integers_float
#define mbs_cone_solve mbs_cone_solve_float
#endif

#ifdef __cplusplus
extern "C" {
#endif

enum { MBS_TOUCH, MBS_PUSH, MBS_BRAKE };

typedef struct {
    casadi_int rows, blocks;
    const casadi_int *kind, *first; /* by block: touch, push or brake; its first row */
    const casadi_real *grip;        /* by block: mu, nothing, the bound */
    const casadi_real *W, *free;    /* rows x rows, rows */
} mbs_cone;

/* What a solution took: its residual; rounds of Gauss-Seidel, and steps of Newton's method. */
typedef struct {
    casadi_real residual;
    casadi_int sweeps, steps;
} mbs_cone_effort;

/* Room for a solution, for a number of rows that no problem exceeds. */
casadi_int mbs_cone_reals(casadi_int rows);
casadi_int mbs_cone_integers(casadi_int rows);

/* Solve for P, whose entries are a guess before; adds to `effort`. Goes on to a residual near rounding, and returns 0 where
 * it is at most `tolerance`, else 1: P is of no use then. */
int mbs_cone_solve(const mbs_cone *problem, casadi_real tolerance, casadi_real *P, mbs_cone_effort *effort,
                   casadi_real *reals, casadi_int *integers);

#ifdef __cplusplus
}
#endif

#endif
