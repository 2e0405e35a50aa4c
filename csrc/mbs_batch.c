/* Call a kernel once per state of a batch. */
#include "mbs_batch.h"

casadi_int mbs_batch(mbs_kernel f, casadi_int states, casadi_int n_in, const casadi_real **arg,
                     const casadi_int *arg_step, casadi_int n_out, casadi_real **res, const casadi_int *res_step,
                     int *status)
{
    casadi_int state, k, failures = 0;
    for (state = 0; state < states; ++state) {
        status[state] = f(arg, res, 0, 0, 0);
        if (status[state])
            ++failures;
        for (k = 0; k < n_in; ++k)
            if (arg[k])
                arg[k] += arg_step[k];
        for (k = 0; k < n_out; ++k)
            if (res[k])
                res[k] += res_step[k];
    }
    return failures;
}
