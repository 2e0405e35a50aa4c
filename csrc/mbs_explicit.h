/* Integrate a motion explicitly, of a tree or with closed loops, h(q) = 0 with J = dh/dv.
 *
 * The accelerations are results of `direct`, or solve M qdd + c = J^T lam, J qdd + gamma = 0. All coordinates are integrated
 * by a Runge-Kutta method; with loops, coordinates and velocities are put back on h = 0, J qd = 0 by a correction
 *
 *     MBS_PARTITIONING      of the dependent ones alone, at every stage: the independent ones move as if they were alone
 *     MBS_PROJECTION        of least norm, after every step; near a singular pose at every stage too
 *     MBS_MASS_PROJECTION   likewise, of least norm in the mass matrix
 *     MBS_BAUMGARTE         by no correction: J qdd + gamma + 2 alpha hd + beta^2 h = 0 instead
 *
 * Of a tree, joints may be held where they are, and sliding ones braked; a run stops at the first time at which a guard, a
 * number of the state, falls below 0.
 *
 * Hairer, Lubich, Wanner, "Geometric Numerical Integration", section IV.4; Wehage, Haug, Journal of Mechanical Design 104
 * (1982); Baumgarte, Computer Methods in Applied Mechanics and Engineering 1 (1972).
 */
#ifndef MBS_EXPLICIT_H
#define MBS_EXPLICIT_H

#include "mbs_many.h"

#ifdef MBS_SINGLE /* names in object files say the precision */
#define mbs_explicit_reals mbs_explicit_reals_float
#define mbs_explicit_integers mbs_explicit_integers_float
#define mbs_explicit_run mbs_explicit_run_float
#define mbs_explicit_read mbs_explicit_read_float
#define mbs_explicit_series mbs_explicit_series_float
#endif

#ifdef __cplusplus
extern "C" {
#endif

#define MBS_PARTITIONING 0
#define MBS_PROJECTION 1
#define MBS_MASS_PROJECTION 2
#define MBS_BAUMGARTE 3

/* Guards: of a coordinate, of a velocity, of the force that holds a joint. */
#define MBS_PLACE 0
#define MBS_SPEED 1
#define MBS_FORCE 2

/* Statuses; kernels have positive ones. */
#define MBS_EVENT (-7)     /* not a failure: a guard is 0 at the end of the last step */
#define MBS_RUNAWAY (-1)   /* numbers that are not finite */
#define MBS_STOPPED (-2)   /* a function for inputs returned a number other than 0 */
#define MBS_SHORT (-3)     /* the step has become too short */
#define MBS_OPEN (-4)      /* a loop cannot be closed */
#define MBS_BRANCHED (-5)  /* closing a loop changes the velocities by more than a step may */
#define MBS_LONG (-8)      /* a motion of a series takes more steps than it may */
#define MBS_LOADED (-9)    /* friction by the load of joints allows no motion, or several, or it is not known */
#define MBS_DEPENDENT (-6) /* equations of a loop contradict each other here: its Jacobian has lost its rank */

/* A kernel with its lists of arguments; f is NULL where there is none. */
typedef struct {
    mbs_kernel f;
    const casadi_real **arg;
    casadi_real **res;
} mbs_call;

/* A matrix as a kernel writes it: its nonzeros, and which entry, row by row, each of them is. */
typedef struct {
    const casadi_real *nonzeros;
    casadi_int entries;
    const casadi_int *place;
} mbs_entries;

/* More friction by the forces that bearings carry across their axes: of a sliding joint -sign (coefficient + fall
 * exp(-(qd/speed)^2)) N, with the sum N of the sizes of its bearings' forces; one that is held bears `hold` N more. */
typedef struct {
    casadi_int bearings, joints, axes; /* columns of `force`, and of `turn` */
    const casadi_int *owner, *frame;           /* of each bearing: the entry of qd; its column of `force` */
    const casadi_real *by_force, *by_moment;   /* 3 x 3 each: its force by the joint's force and moment, in its frame */
    const casadi_real *coefficient, *fall, *hold; /* n */
    mbs_entries force, moment; /* 3 x joints: where `reactions` writes, in axes of the base, at the accelerations `rest` */
    mbs_entries turn;          /* 3 x axes: where `poses` writes rotations into the base */
    mbs_call reactions, poses;
} mbs_loads;

/* The joints that are held, the friction -sign (torque + fall exp(-(qd/speed)^2)) of sliding ones, and guards
 * side (x - level) >= 0. Accelerations are no results of `direct` then. */
typedef struct {
    const casadi_int *held;                             /* n: 1, where a joint does not move */
    const casadi_real *sign, *torque, *fall, *slowness; /* n: slowness: 1/speed */
    casadi_int guards;
    const casadi_int *kind, *joint, *place; /* of each guard: MBS_PLACE, ...; the entry of qd, and of q */
    const casadi_real *side, *level;
    casadi_int *fired; /* written at an event: 1 where a guard falls below 0 */
    /* Impacts that need no decision: a joint hits a stop alone, is thrown back at `slow` or more, and changes no other
     * joint's way of sliding. They are passed, and noted, while there is room for `most` of them; 0: every event ends a run.
     * At an impact two rows have one time. */
    casadi_int most;
    casadi_real slow, still, touch;   /* still: of the fastest velocity, a slower one is 0; touch: of max(1, |level|) */
    const casadi_real *restitution;   /* n */
    casadi_int bounces;               /* written: how many; */
    casadi_int *row, *guard;          /* of each, the row with the state after it, and the guard that fell, */
    casadi_real *impulse;             /* and the impulse away from the stop */
    const mbs_loads *loads;           /* of a tree; or NULL */
} mbs_modes;

typedef struct {
    casadi_int n, nq, m, e, d; /* velocities, coordinates, inputs, equations of loops, driven joints */
    casadi_real *q, *qd;       /* where kernels read coordinates and velocities, */
    casadi_real *v;            /* m inputs, */
    casadi_real *course;       /* d coordinates, d velocities and d accelerations of driven joints, */
    casadi_real *rest;         /* the accelerations of `residual` */
    const casadi_real *qdd, *r, *h, *hd, *gamma, *qt; /* where `direct`, `residual`, `closure`, ... write */
    mbs_entries M, J;
    mbs_call direct;   /* qdd; may be NULL; alone, without `residual` and `mass`, it serves trees */
    mbs_call residual; /* r = M rest + c - Q, without lam */
    mbs_call mass;     /* M */
    mbs_call closure;  /* h */
    mbs_call rates;    /* hd = J qd */
    mbs_call jacobian; /* J and gamma */
    mbs_call change;   /* qt, the rates of the coordinates; NULL where they are the velocities */
    const casadi_int *driven; /* their entries of qd */
    const casadi_int *place;  /* and of q */
    const casadi_int *loop;   /* of each equation: the number of its loop, from 1 */
    mbs_modes *modes;         /* NULL: no joint is held or braked, and there are no guards */
} mbs_explicit;

/* How to step: A, b, c and E of a Runge-Kutta method; E has a row for each of `estimates` estimates of a step's error: none
 * for steps of a fixed length, one, or two of DOP853. */
typedef struct {
    casadi_int stages, estimates, order; /* order: of the estimate, plus 1 */
    const casadi_real *A, *b, *c, *E;
    casadi_real rtol, atol, alpha, beta;
    casadi_real longest;          /* no step by a tolerance is longer; 0: any may be */
    int keeping;                  /* MBS_PARTITIONING, ... */
    int (*guide)(casadi_real t);  /* writes `course`; NULL: it is constant */
    int (*inputs)(casadi_real t); /* writes the inputs, and may read q and qd; NULL: they are constant */
} mbs_manner;

/* What a run counts, and how it ended. */
typedef struct {
    casadi_int evaluations, rejected, switches, steps;
    casadi_real pivot; /* the smallest pivot of J met, as a part of the largest: small near a singular pose */
    casadi_real gap;   /* the largest |h| that a step left before its loops were closed */
    int status, loop;  /* of status MBS_OPEN to MBS_DEPENDENT: the number of the loop, from 1 */
} mbs_outcome;

/* Room for a run; `plant` has its modes, with as many guards as there will be. */
casadi_int mbs_explicit_reals(const mbs_explicit *plant, casadi_int stages);
casadi_int mbs_explicit_integers(const mbs_explicit *plant);

/* Take at most `steps` steps from times[0] and states[0], which is closed, until `end`. Steps of a fixed length have length
 * *h; else *h is the first to try, or 0, and on return the next one. Of each step times[k] and states[k] are written: nq
 * coordinates, then n velocities. Steps of a fixed length end where the caller's times say, times[1], ... are given, and
 * inputs and courses may be given for them: for all stages of each step, then for its end, rows of m and of 3 d numbers;
 * NULL: the manner's functions are asked. The place of an event is found to rounding, by shorter steps, for
 * which the manner's functions are asked in any case. */
void mbs_explicit_run(const mbs_explicit *plant, const mbs_manner *manner, casadi_real end, casadi_real *h,
                      casadi_int steps, const casadi_real *inputs, const casadi_real *courses, casadi_real *times,
                      casadi_real *states, casadi_real *reals, casadi_int *integers, mbs_outcome *outcome);

/* Take `count` steps, each from a time and a state (starts), with a length, and write where they end: the motion
 * within the steps of a run, to its order. Inputs and courses may be given as above. */
void mbs_explicit_read(const mbs_explicit *plant, const mbs_manner *manner, casadi_int count, const casadi_real *times,
                       const casadi_real *lengths, const casadi_real *inputs, const casadi_real *courses,
                       const casadi_real *starts, casadi_real *ends, casadi_real *reals, casadi_int *integers,
                       mbs_outcome *outcome);

/* Parameters as kernels read them: the numbers of motion k begin at first + k * step, and go to `to`. */
typedef struct {
    const casadi_real *first;
    casadi_int step, numbers;
    casadi_real *to;
} mbs_parameters;

/* Motions from `begin` to `end` that are kept at the same times, the last of which is `end`. */
typedef struct {
    casadi_real begin, end;
    casadi_int sets; /* of parameters */
    const mbs_parameters *set;
    casadi_int outputs;
    const casadi_real *times;
    casadi_real near;       /* a step that ends so near to an output ends there */
    casadi_int chunk, most; /* steps that are taken at a time, and at most */
} mbs_series;

/* Integrate motions `first` to `last` - 1 of a series by a tolerance, without events. Of each, `kept` holds 1 + outputs
 * states, the first of which is its start, and `lengths` the first step to try, or 0, and then the next one. Room: chunk + 1
 * times and states. A motion with another status than 0 is not complete. */
void mbs_explicit_series(const mbs_explicit *plant, const mbs_manner *manner, const mbs_series *series, casadi_int first,
                         casadi_int last, casadi_real *kept, casadi_real *lengths, casadi_real *times,
                         casadi_real *states, casadi_real *reals, casadi_int *integers, int *status);

#ifdef __cplusplus
}
#endif

#endif
