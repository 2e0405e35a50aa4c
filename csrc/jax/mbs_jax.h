/* Kernels that compiled programs of JAX call: the table that Python fills. */
#ifndef MBS_JAX_H
#define MBS_JAX_H

#include "mbs_batch.h"

#define MBS_JAX_MOST 512 /* arguments on either side of a kernel */

/* The meaning of mbs_batch. */
typedef casadi_int (*mbs_batch_function)(mbs_kernel f, casadi_int states, casadi_int n_in, const casadi_real **arg,
                                         const casadi_int *arg_step, casadi_int n_out, casadi_real **res,
                                         const casadi_int *res_step, int *status);

typedef struct mbs_jax_kernel mbs_jax_kernel;

/* A kernel, and the places and sizes of the arguments that programs pass: inputs `given`, at least one output `wanted`. */
struct mbs_jax_kernel {
    long long key;
    mbs_batch_function batch;
    mbs_kernel kernel;
    casadi_int n_in, n_out, given, wanted;
    const casadi_int *in_place, *in_size, *out_place, *out_size;
    mbs_jax_kernel *next;
};

/* Enter a kernel that stays where it is; the caller holds a lock. Returns 1 for a kernel with too many arguments. */
int mbs_jax_enter(mbs_jax_kernel *entry);

#endif
