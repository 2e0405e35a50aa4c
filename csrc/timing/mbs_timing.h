/* Time a function over a pool of states that are read from memory, so that caches and branch predictors see what a
 * solver would show them.
 *
 * MBS_TIMED defines a function that times an expression, in which arg[k] is the k-th input of the state at hand and
 * res[k] the place of the k-th result; mbs_time_kernel is made so, for any kernel in CasADi's contract. For a typed
 * function, in a file that includes its header:
 *
 *     MBS_TIMED(time_impl, arm_pendulum_compute_impl(arg[0], arg[1], arg[2], arg[3], res[0]))
 *
 * Lies in a folder of csrc: compile with -I csrc, and with -D_POSIX_C_SOURCE=199309L where C is not GNU C.
 */
#ifndef MBS_TIMING_H
#define MBS_TIMING_H

#include <time.h>

#include "mbs_many.h"

#define MBS_MAX_ARGUMENTS 64

/* Inputs of many states, and where results go: the same place for every state. */
typedef struct {
    casadi_int states;
    casadi_int n_in;            /* at most MBS_MAX_ARGUMENTS */
    const casadi_real **inputs; /* the k-th input of the first state */
    const casadi_int *steps;    /* from there to the arguments of the next state */
    casadi_real **results;
    casadi_int *iw; /* what a kernel asks for by f_work */
    casadi_real *w;
    mbs_kernel kernel; /* what mbs_time_kernel calls */
} mbs_pool;

/* Go through all states of a pool `passes` times; give the nanoseconds of a call, or -1 if one failed. */
double mbs_time_kernel(const mbs_pool *pool, casadi_int passes);

#define MBS_TIMED(name, call) \
    double name(const mbs_pool *pool, casadi_int passes) \
    { \
        struct timespec begin, end; \
        const casadi_real *arg[MBS_MAX_ARGUMENTS]; \
        casadi_real **res = pool->results; \
        const casadi_int n_in = pool->n_in, states = pool->states; \
        casadi_int pass, state, k; \
        int status = 0; \
        clock_gettime(CLOCK_MONOTONIC, &begin); \
        for (pass = 0; pass < passes; ++pass) { \
            for (k = 0; k < n_in; ++k) \
                arg[k] = pool->inputs[k]; \
            for (state = 0; state < states; ++state) { \
                status |= (call); \
                for (k = 0; k < n_in; ++k) \
                    arg[k] += pool->steps[k]; \
            } \
        } \
        clock_gettime(CLOCK_MONOTONIC, &end); \
        if (status) \
            return -1; \
        return ((double)(end.tv_sec - begin.tv_sec) * 1e9 + (double)(end.tv_nsec - begin.tv_nsec)) / \
               ((double)passes * (double)states); \
    }

#endif
