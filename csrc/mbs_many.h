/* A kernel in many states whose numbers lie anywhere in memory.
 *
 * Compiled with -DMBS_STATES=8, mbs_many.c gives mbs_compute_many_at_8, which calls a kernel that is compiled so, too, for
 * 8 states at a time. C99, reentrant.
 */
#ifndef MBS_MANY_H
#define MBS_MANY_H

#include <stddef.h>

#include "mbs_abi.h"

#ifdef __cplusplus
extern "C" {
#endif

#ifdef MBS_STATES
#define mbs_compute_many MBS_STATES_NAME(mbs_compute_many)
#define mbs_room_of_many MBS_STATES_NAME(mbs_room_of_many)
#endif
#if defined(MBS_SINGLE) && !defined(MBS_MANY_NAMES) /* names in object files say the precision; a folder has its own */
#ifndef MBS_STATES
#define mbs_room_of_many mbs_room_of_many_float
#define mbs_compute_many mbs_compute_many_float
#endif
#define mbs_room_of_many_at_2 mbs_room_of_many_float_at_2
#define mbs_compute_many_at_2 mbs_compute_many_float_at_2
#define mbs_room_of_many_at_4 mbs_room_of_many_float_at_4
#define mbs_compute_many_at_4 mbs_compute_many_float_at_4
#define mbs_room_of_many_at_8 mbs_room_of_many_float_at_8
#define mbs_compute_many_at_8 mbs_compute_many_float_at_8
#define mbs_room_of_many_at_16 mbs_room_of_many_float_at_16
#define mbs_compute_many_at_16 mbs_compute_many_float_at_16
#endif

/* Where an input lies: the numbers of state s begin at first + s * step, and stand there one after the other, or each at
 * its place. */
typedef struct {
    const MBS_REAL *first; /* NULL: zeros */
    casadi_int step;       /* numbers from a state to the next; 0: all states have the same numbers */
    casadi_int nonzeros;
    const casadi_int *places; /* of each nonzero, counted from a state's beginning; NULL: one after the other */
} mbs_given;

/* Where a result goes: number k of state s to first + s * step + k * apart. */
typedef struct {
    MBS_REAL *first; /* NULL: it is not wanted */
    casadi_int step, apart;
    casadi_int nonzeros;
    casadi_int numbers;        /* in a state, */
    const casadi_int *entries; /* and which nonzero each of them is; -1: 0; NULL: all are, in turn */
} mbs_found;

/* A kernel in CasADi's contract, of one state; and of several, with vectors for numbers. */
typedef int (*mbs_kernel)(const MBS_REAL **arg, MBS_REAL **res, casadi_int *iw, MBS_REAL *w, int mem);
typedef int (*mbs_kernel_of_several)(const mbs_real **arg, mbs_real **res, casadi_int *iw, mbs_real *w, int mem);

/* Return how many bytes of memory the work needs. */
size_t mbs_room_of_many(casadi_int n_in, const mbs_given *in, casadi_int n_out, const mbs_found *out);

/* Compute the states from `begin` to `end` - 1, of `states` that the arguments hold. Each state's status, what `one` returns
 * for it, is written to status[state]; where it is not 0, no result of that state is written. Groups of states begin at
 * multiples of their number, so that parts of the work may begin there, in any threads, and give the same bits. `several`
 * is not called where the kernel is compiled for one state. Returns the number of states with a status other than 0. */
casadi_int mbs_compute_many(mbs_kernel one, mbs_kernel_of_several several, casadi_int states, casadi_int begin,
                            casadi_int end, casadi_int n_in, const mbs_given *in, casadi_int n_out, const mbs_found *out,
                            void *room, int *status);

#ifndef MBS_STATES
/* The same functions, and a kernel in CasADi's contract, as files compiled with -DMBS_STATES=width give them. */
#define MBS_DECLARE_MANY(width) \
    size_t mbs_room_of_many_at_##width(casadi_int n_in, const mbs_given *in, casadi_int n_out, const mbs_found *out); \
    casadi_int mbs_compute_many_at_##width( \
        mbs_kernel one, mbs_kernel_of_several several, casadi_int states, casadi_int begin, casadi_int end, \
        casadi_int n_in, const mbs_given *in, casadi_int n_out, const mbs_found *out, void *room, int *status)
#define MBS_DECLARE_SEVERAL(f, width) MBS_DECLARE_SEVERAL_(f, width)
#define MBS_DECLARE_SEVERAL_(f, width) \
    int f##_at_##width(const mbs_real **arg, mbs_real **res, casadi_int *iw, mbs_real *w, int mem)
#endif

#ifdef __cplusplus
}
#endif

#endif
