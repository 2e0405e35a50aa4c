/* A kernel with INPUTS and RESULTS numbers, a sine, a root and a guard: f_k = sin x_k + sqrt |x_{k+1}| p / x_0, x_0 > 0. */
#include "mbs_abi.h"
#include <math.h>
#include "mbs_sincos.h"

#ifdef MBS_STATES
#define kernel MBS_STATES_NAME(kernel)
#endif

int kernel(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int mem);

int kernel(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int mem)
{
    const mbs_real *x = arg[0], *p = arg[1];
    mbs_real sines[MBS_PADDED(INPUTS)], cosines[MBS_PADDED(INPUTS)], angles[MBS_PADDED(INPUTS)];
    int k;
    (void)iw;
    (void)w;
    (void)mem;
    for (k = 0; k < MBS_PADDED(INPUTS); ++k)
        angles[k] = k < INPUTS ? x[k] : MBS_EVERY(0);
    mbs_sincos(INPUTS, angles, sines, cosines);
    if (!MBS_EXCEEDS(x[0], MBS_THRESHOLD(MBS_C(8.0)) * MBS_EVERY(1)))
        return 3;
    for (k = 0; k < RESULTS; ++k)
        res[0][k] = sines[k % INPUTS] + MBS_SQRT(MBS_ABS(x[(k + 1) % INPUTS])) * p[0] / x[0];
    return 0;
}
