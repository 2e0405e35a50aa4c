/* The functions of the problem: see pendulum.h. */
#include "pendulum.h"

#include <math.h>
#include <string.h>

enum { INTERVALS = PENDULUM_INTERVALS };
#define STEP PENDULUM_STEP
#define GRAVITY ((real)9.81)

typedef mbs_stages_real real;
#ifdef MBS_STAGES_FLOAT /* not a number of double precision: a small processor computes these by software */
#define sine sinf
#define cosine cosf
#else
#define sine sin
#define cosine cos
#endif
static const real TOP = (real)3.14159265358979324;

/* x = (angle, rate), v = torque; the last stage has no v, and its equalities ask for the top, at rest. */
static int values(void *context, int k, const real *x, const real *v, real *f, real *e, real *d, real *g)
{
    (void)context, (void)g;
    if (k == INTERVALS) {
        e[0] = x[0] - TOP;
        e[1] = x[1];
        return 0;
    }
    *f = STEP * v[0] * v[0];
    d[0] = x[0] + STEP * x[1];
    d[1] = x[1] + STEP * (v[0] - GRAVITY * sine(x[0]));
    return 0;
}

static int jacobians(void *context, int k, const real *x, const real *v, real *df, real *de, real *dd, real *dg)
{
    (void)context, (void)dg;
    if (k == INTERVALS) {
        de[0] = de[3] = 1;
        return 0;
    }
    df[2] = 2 * STEP * v[0];
    dd[0] = dd[3] = 1; /* by columns: of the angle, of the rate, of the torque */
    dd[1] = -STEP * GRAVITY * cosine(x[0]);
    dd[2] = dd[5] = STEP;
    return 0;
}

static int hessian(void *context, int k, const real *x, const real *v, real factor, const real *ye, const real *yd,
                   const real *yg, real *h)
{
    (void)context, (void)v, (void)ye, (void)yg;
    if (k == INTERVALS)
        return 0;
    h[0] = yd[1] * STEP * GRAVITY * sine(x[0]);
    h[8] = 2 * STEP * factor;
    return 0;
}

/* Sizes and bounds: the first state is fixed at rest below, torques are limited. */
void pendulum_describe(pendulum *p, mbs_stages_real limit)
{
    const mbs_stages_size interval = {2, 1, 0, 0, 0, NULL}, last = {2, 0, 2, 0, 0, NULL};
    int k, i;
    memset(p, 0, sizeof *p);
    for (k = 0; k <= INTERVALS; ++k)
        p->size[k] = k < INTERVALS ? interval : last;
    for (i = 0; i < PENDULUM_VARIABLES; ++i) {
        const int is_torque = i % 3 == 2 && i < 3 * INTERVALS;
        p->upper[i] = i < 2 ? 0 : is_torque ? limit : INFINITY;
        p->lower[i] = -p->upper[i];
    }
    p->problem.stages = INTERVALS + 1;
    p->problem.size = p->size;
    p->problem.values = values;
    p->problem.jacobians = jacobians;
    p->problem.hessian = hessian;
    p->problem.lower = p->lower;
    p->problem.upper = p->upper;
}
