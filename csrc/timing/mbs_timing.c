/* The timing loop for kernels in CasADi's contract. */
#include "mbs_timing.h"

MBS_TIMED(mbs_time_kernel, pool->kernel(arg, res, pool->iw, pool->w, 0))
