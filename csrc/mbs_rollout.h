/* Motions of many states of a tree, by a Runge-Kutta method of fixed steps.
 *
 * Compiled with -DMBS_STATES=8, mbs_rollout.c gives mbs_rollout_at_8, which moves 8 states at a time. C99, reentrant.
 */
#ifndef MBS_ROLLOUT_H
#define MBS_ROLLOUT_H

#include <stddef.h>

#include "mbs_abi.h"

#ifdef __cplusplus
extern "C" {
#endif

#ifdef MBS_STATES
#define mbs_rollout MBS_STATES_NAME(mbs_rollout)
#define mbs_room_of_rollout MBS_STATES_NAME(mbs_room_of_rollout)
#endif
#if defined(MBS_SINGLE) /* names in object files say the precision */
#ifndef MBS_STATES
#define mbs_rollout mbs_rollout_float
#define mbs_room_of_rollout mbs_room_of_rollout_float
#endif
#define mbs_rollout_at_2 mbs_rollout_float_at_2
#define mbs_room_of_rollout_at_2 mbs_room_of_rollout_float_at_2
#define mbs_rollout_at_4 mbs_rollout_float_at_4
#define mbs_room_of_rollout_at_4 mbs_room_of_rollout_float_at_4
#define mbs_rollout_at_8 mbs_rollout_float_at_8
#define mbs_room_of_rollout_at_8 mbs_room_of_rollout_float_at_8
#define mbs_rollout_at_16 mbs_rollout_float_at_16
#define mbs_room_of_rollout_at_16 mbs_room_of_rollout_float_at_16
#endif

#define MBS_GROUP_FAILED (-1) /* the status of states that lie beside one that fails */

/* A kernel in CasADi's contract, for as many states as mbs_real holds. */
typedef int (*mbs_kernel_at_once)(const mbs_real **arg, mbs_real **res, casadi_int *iw, mbs_real *w, int mem);

/* A function of coordinates and velocities, with its only result: which arguments these are, of how many. */
typedef struct {
    mbs_kernel_at_once f; /* NULL: there is none */
    casadi_int n_in, n_out, q, qd;
} mbs_function;

/* Numbers of a state begin at first + state * step; of step k of its motion at + k * pace, of stage i at + i * stage_pace:
 * with 0 they are the same in all steps, and in all stages of a step. */
typedef struct {
    const MBS_REAL *first;
    casadi_int step, pace, stage_pace, numbers;
    casadi_int place, rates_place; /* which argument of the accelerations and of the rates they are; -1: none */
} mbs_course;

typedef struct {
    mbs_function accelerations, rates; /* qdd(q, qd, u, ...), and q' where it is not qd */
    casadi_int nq, n;                 /* coordinates and velocities */
    casadi_int quaternions;           /* four coordinates each, of length 1: where they begin */
    const casadi_int *quaternion;
    casadi_int courses;               /* inputs and parameters */
    const mbs_course *course;
    casadi_int stages;                /* of the method: */
    const MBS_REAL *A, *b;            /* rows of stages, and weights */
    MBS_REAL h;                       /* length of a step */
    casadi_int steps, every;          /* each `every`th state of the motion is kept, from the first on */
} mbs_motion;

/* Return how many bytes of memory the work needs. */
size_t mbs_room_of_rollout(const mbs_motion *motion);

/* Move states `begin` to `end` - 1. `kept` holds 1 + steps / every states of nq + n numbers, q and qd, for each state; the
 * first is the start. A status is 0, what f returns, or MBS_GROUP_FAILED; motions with another one than 0 end early. */
void mbs_rollout(const mbs_motion *motion, casadi_int begin, casadi_int end, MBS_REAL *kept, void *room, int *status);

#ifdef __cplusplus
}
#endif

#endif
