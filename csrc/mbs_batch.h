/* Call a kernel once per state of a batch. */
#ifndef MBS_BATCH_H
#define MBS_BATCH_H

#include "mbs_abi.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A kernel in CasADi's contract. */
typedef int (*mbs_kernel)(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int mem);

/* Call f `states` times; after each call arg[k] and res[k] advance by their steps (0: the same for all states).
 * Pointers may be NULL, as in CasADi's contract. The return values of f go into `status`, one for each state; where it
 * is not 0, the results of that state are not written. Returns the number of these states. */
casadi_int mbs_batch(mbs_kernel f, casadi_int states, casadi_int n_in, const casadi_real **arg,
                     const casadi_int *arg_step, casadi_int n_out, casadi_real **res, const casadi_int *res_step,
                     int *status);

#ifdef __cplusplus
}
#endif

#endif
