/* Time stepping of Moreau and Jean: rigid contacts with dry friction, rigid stops and dry friction of joints.
 *
 * A step of length h goes from q, v to q tau(h vm), v1, with vm = (v + v1)/2 at the middle place qm = q tau(h/2 vm):
 *
 *     h Phi(qm, vm, (v1 - v)/h) = J^T P,    w = J v1 + e min(0, J v)   and P as mbs_cone.h states, in each closed contact
 *
 * Without contacts it is the implicit midpoint rule, of order 2. A contact is closed where its distance g would vanish
 * within the step, by g + (1 - e/2) h (J v + J vf)/2 <= 0 with the velocity vf without impulses. Two solids touch at the
 * points that mbs_solids.h finds at the place q tau(h/2 v). Impacts have Newton's law
 * for the normal parts; where impulses would create energy, the restitutions e of the step are smaller. Newton's
 * iterations for v1 keep their matrix A = h dPhi/dv1 while they shrink fast.
 *
 * Energy never exceeds its balance: where the midpoint rule would make it larger than the start's, plus the work of forces
 * at the middle, less the losses, the velocities v1 are shortened; directions and zeros of contacts stay.
 *
 * Moreau, "Unilateral contact and dry friction in finite freedom dynamics" (1988); Jean, Computer Methods in Applied
 * Mechanics and Engineering 177 (1999); Acary, Brogliato, "Numerical methods for nonsmooth dynamical systems" (2008),
 * chapter 10.
 *
 * C99, reentrant except for the arrays that kernels read and write, no allocation.
 */
#ifndef MBS_STEPPING_H
#define MBS_STEPPING_H

#include "mbs_cone.h"
#include "mbs_explicit.h"
#include "mbs_group.h"
#include "mbs_solids.h"

#ifdef MBS_SINGLE /* names in object files say the precision */
#define mbs_stepping_reals mbs_stepping_reals_float
#define mbs_stepping_integers mbs_stepping_integers_float
#define mbs_stepping_width mbs_stepping_width_float
#define mbs_stepping_run mbs_stepping_run_float
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* Rigid stops: side (q[place] - level) >= 0. */
typedef struct {
    casadi_int place, rate;
    casadi_real side, level, restitution;
} mbs_stop;

/* Dry friction of a joint: torque + fall exp(-(qd slowness)^2) at most; at rest `still`. */
typedef struct {
    casadi_int rate;
    casadi_real torque, fall, slowness, still;
} mbs_brake;

/* Two solids in rigid contact, at `spots` points at most. */
typedef struct {
    const mbs_solid *first, *other;
    casadi_int spots;
    casadi_real restitution, coefficient;
} mbs_meeting;

typedef struct {
    casadi_int n, m, points, pairs, stops, brakes; /* velocities, inputs, points of rigid contact, pairs of solids, stops,
                                                      joints with friction */
    casadi_real *q, *qd, *qdd, *v;          /* where kernels read */
    const casadi_real *Phi, *clearance, *direction, *kinetic, *potential, *power; /* and write */
    const casadi_real *places, *axes; /* of solids, two of each pair: 3 and 9 each */
    mbs_entries K, C, M, N, J; /* dPhi by q, qd, qdd; rates of q by qd; velocities of points, 3 points x n */
    mbs_entries twist;         /* of pairs, 6 pairs x n: velocity at the base's origin, and angular velocity */
    mbs_call linearised;       /* Phi with these derivatives */
    mbs_call residual;         /* Phi alone */
    mbs_call touching;         /* clearance, direction, J; NULL without points */
    mbs_call meetings;         /* places, axes, twist; NULL without pairs */
    mbs_call change;           /* N; NULL where rates are velocities */
    mbs_call energy, work;     /* kinetic, potential; power */
    mbs_group group;
    const casadi_real *restitution, *coefficient; /* by point */
    const mbs_meeting *pair;
    const mbs_stop *stop;
    const mbs_brake *brake;
} mbs_stepping;

/* Why a run ends early. */
enum { MBS_STEPPED, MBS_KERNEL, MBS_SINGULAR, MBS_CONE, MBS_DIVERGED, MBS_INFINITE };

/* A run: what it keeps from step to step, and what it counts. */
typedef struct {
    casadi_real allowed;    /* energy by its balance [J]; not a number before the first step */
    casadi_real residual;   /* the largest of the cone problems */
    casadi_int iterations;  /* of steps */
    casadi_int jacobians;
    casadi_int sweeps, newton; /* of cone problems */
    int kernel;             /* the status of a kernel that failed */
} mbs_stepping_record;

/* Room for a run. */
casadi_int mbs_stepping_reals(const mbs_stepping *plant);
casadi_int mbs_stepping_integers(const mbs_stepping *plant);

/* Entries of a row of results: coordinates and velocities at the end of a step, both in its middle, the energy that impacts
 * and friction took, then three components of the impulse of each point, points of pairs last, in the base frame. */
casadi_int mbs_stepping_width(const mbs_stepping *plant);

/* Take at most `steps` steps of length h from a state of nq + n numbers. `inputs` has a row of m for each step, v_step
 * apart. `impulses` holds 3 numbers for each point, points of pairs last, then one for each stop and each joint with friction: a guess, and
 * afterwards the last step's. Writes a row of results for each step; returns how many were taken, and in `status` why no
 * more. Cone problems are solved to the tolerance, or end the run. */
casadi_int mbs_stepping_run(const mbs_stepping *plant, casadi_real tolerance, casadi_real h, casadi_int steps,
                            const casadi_real *inputs, casadi_int v_step, const casadi_real *start, casadi_real *results,
                            casadi_real *impulses, mbs_stepping_record *record, int *status, casadi_real *reals,
                            casadi_int *integers);

#ifdef __cplusplus
}
#endif

#endif
