#define _POSIX_C_SOURCE 199309L

#include "mbs_timed_program.h"

#include <time.h>

typedef mbs_stages_real real;

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

int mbs_timed_values(void *timed, int k, const real *x, const real *v, real *f, real *e, real *d, real *g)
{
    mbs_timed_program *p = timed;
    const double begin = now();
    const int status = mbs_program_values(p->instance, k, x, v, f, e, d, g);
    p->seconds += now() - begin;
    return status;
}

int mbs_timed_jacobians(void *timed, int k, const real *x, const real *v, real *df, real *de, real *dd, real *dg)
{
    mbs_timed_program *p = timed;
    const double begin = now();
    const int status = mbs_program_jacobians(p->instance, k, x, v, df, de, dd, dg);
    p->seconds += now() - begin;
    return status;
}

int mbs_timed_hessian(void *timed, int k, const real *x, const real *v, real factor, const real *ye, const real *yd,
                      const real *yg, real *h)
{
    mbs_timed_program *p = timed;
    const double begin = now();
    const int status = mbs_program_hessian(p->instance, k, x, v, factor, ye, yd, yg, h);
    p->seconds += now() - begin;
    return status;
}
