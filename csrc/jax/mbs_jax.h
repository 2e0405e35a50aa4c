/* Kernels that compiled programs of JAX call: the table that Python fills. */
#ifndef MBS_JAX_H
#define MBS_JAX_H

#include "mbs_many.h"

#define MBS_JAX_MOST 512 /* arguments on either side of a kernel */

/* mbs_compute_many, compiled for some number of states at once. */
typedef casadi_int (*mbs_many_function)(mbs_kernel one, mbs_kernel_of_several several, casadi_int states,
                                        casadi_int begin, casadi_int end, casadi_int n_in, const mbs_given *in,
                                        casadi_int n_out, const mbs_found *out, void *room, int *status);

typedef struct mbs_jax_kernel mbs_jax_kernel;

/* A kernel, and the places and sizes of the arguments that programs pass: inputs `given`, at least one output `wanted`. */
struct mbs_jax_kernel {
    long long key;
    mbs_kernel kernel;
    mbs_many_function many;
    mbs_kernel_of_several several; /* NULL: `many` computes one state at a time */
    long long room; /* bytes that `many` needs */
    casadi_int n_in, n_out, given, wanted;
    const casadi_int *in_place, *in_size, *out_place, *out_size;
    mbs_jax_kernel *next;
};

/* Enter a kernel that stays where it is; the caller holds a lock. Returns 1 for a kernel with too many arguments. */
int mbs_jax_enter(mbs_jax_kernel *entry);

#endif
