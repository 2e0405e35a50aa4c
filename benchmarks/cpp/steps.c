/* Steps of many states in lanes, and their gradients: kernels of accelerations, and of their adjoint. */
#include "mbs_many.h"

#define MOST 64 /* coordinates */

/* Which arguments a kernel takes: q, qd, u, and for the adjoint the weights of qdd; and results: qdd, or the adjoints. */
typedef struct {
    mbs_kernel_of_several f;
    casadi_int n_in, n_out, in[4], out[3];
} steps_kernel;

typedef struct {
    steps_kernel accelerate, adjoint;
    casadi_int n, m; /* coordinates and inputs */
    MBS_REAL h;
} steps_plan;

typedef struct {
    mbs_real x[2 * MOST], u[MOST], weights[2 * MOST], next[2 * MOST], slopes[3 * MOST];
} steps_lanes;

static int call(const steps_kernel *kernel, const mbs_real *q, const mbs_real *qd, const mbs_real *u,
                const mbs_real *weights, mbs_real **found)
{
    const mbs_real *arg[16] = {0};
    mbs_real *res[16] = {0};
    casadi_int i;
    arg[kernel->in[0]] = q;
    arg[kernel->in[1]] = qd;
    arg[kernel->in[2]] = u;
    if (weights)
        arg[kernel->in[3]] = weights;
    for (i = 0; i < (weights ? 3 : 1); ++i)
        res[kernel->out[i]] = found[i];
    return kernel->f(arg, res, 0, 0, 0);
}

/* qd' = qd + h qdd(q, qd, u), q' = q + h qd' */
static int step_euler(const steps_plan *plan, steps_lanes *x, int is_gradient)
{
    const casadi_int n = plan->n;
    mbs_real qdd[MOST], seeds[MOST], *found[3] = {qdd};
    casadi_int k;
    if (call(&plan->accelerate, x->x, x->x + n, x->u, 0, found))
        return 1;
    for (k = 0; k < n; ++k) {
        x->next[n + k] = x->x[n + k] + plan->h * qdd[k];
        x->next[k] = x->x[k] + plan->h * x->next[n + k];
        seeds[k] = plan->h * (x->weights[n + k] + plan->h * x->weights[k]);
    }
    if (!is_gradient)
        return 0;
    for (k = 0; k < 3; ++k)
        found[k] = x->slopes + k * n;
    if (call(&plan->adjoint, x->x, x->x + n, x->u, seeds, found))
        return 1;
    for (k = 0; k < n; ++k) {
        x->slopes[k] += x->weights[k];
        x->slopes[n + k] += x->weights[n + k] + plan->h * x->weights[k];
    }
    return 0;
}

/* The classical method of Runge and Kutta. */
static int step_rk4(const steps_plan *plan, steps_lanes *x, int is_gradient)
{
    static const MBS_REAL a[5] = {0, 0.5, 0.5, 1, 0}, b[4] = {1 / 6.0, 1 / 3.0, 1 / 3.0, 1 / 6.0};
    const casadi_int n = plan->n;
    const MBS_REAL h = plan->h;
    mbs_real stage[4][2 * MOST], rate[2 * MOST], seeds[2 * MOST], back[2 * MOST], own[MOST], *found[3] = {rate + n};
    casadi_int k;
    int i;
    for (k = 0; k < 2 * n; ++k)
        x->next[k] = x->x[k];
    for (i = 0; i < 4; ++i) {
        for (k = 0; k < 2 * n; ++k)
            stage[i][k] = i ? x->x[k] + h * a[i] * rate[k] : x->x[k];
        if (call(&plan->accelerate, stage[i], stage[i] + n, x->u, 0, found))
            return 1;
        for (k = 0; k < n; ++k)
            rate[k] = stage[i][n + k];
        for (k = 0; k < 2 * n; ++k)
            x->next[k] += h * b[i] * rate[k];
    }
    if (!is_gradient)
        return 0;
    for (k = 0; k < 2 * n; ++k) {
        x->slopes[k] = x->weights[k];
        back[k] = (mbs_real){0};
    }
    for (k = 0; k < plan->m; ++k)
        x->slopes[2 * n + k] = (mbs_real){0};
    for (i = 3; i >= 0; --i) {
        for (k = 0; k < 2 * n; ++k)
            seeds[k] = h * b[i] * x->weights[k] + h * a[i + 1] * back[k];
        found[0] = back;
        found[1] = back + n;
        found[2] = own;
        if (call(&plan->adjoint, stage[i], stage[i] + n, x->u, seeds + n, found))
            return 1;
        for (k = 0; k < n; ++k)
            back[n + k] += seeds[k];
        for (k = 0; k < 2 * n; ++k)
            x->slopes[k] += back[k];
        for (k = 0; k < plan->m; ++k)
            x->slopes[2 * n + k] += own[k];
    }
    return 0;
}

static void gather(const MBS_REAL *from, casadi_int numbers, mbs_real *to)
{
    casadi_int k;
    int s;
    for (k = 0; k < numbers; ++k)
        for (s = 0; s < MBS_ABREAST; ++s)
            ((MBS_REAL *)(to + k))[s] = from[s * numbers + k];
}

static void put(const mbs_real *from, casadi_int numbers, MBS_REAL *to)
{
    casadi_int k;
    int s;
    for (s = 0; s < MBS_ABREAST; ++s)
        for (k = 0; k < numbers; ++k)
            to[s * numbers + k] = ((const MBS_REAL *)(from + k))[s];
}

/* Take a step in each state, of a multiple of the lanes' number; a row holds q and qd, or u. `slopes` is the gradient of
 * the weighted sum of the step's results by q, qd and u; NULL: it is left out. Returns 1 where a kernel fails. */
int take_steps(const steps_plan *plan, int is_rk4, casadi_int states, const MBS_REAL *x, const MBS_REAL *u,
               const MBS_REAL *weights, MBS_REAL *next, MBS_REAL *slopes)
{
    const casadi_int n = plan->n, m = plan->m;
    casadi_int i;
    for (i = 0; i + MBS_ABREAST <= states; i += MBS_ABREAST) {
        steps_lanes lanes;
        gather(x + i * 2 * n, 2 * n, lanes.x);
        gather(u + i * m, m, lanes.u);
        gather(weights + i * 2 * n, 2 * n, lanes.weights);
        if ((is_rk4 ? step_rk4 : step_euler)(plan, &lanes, slopes != 0))
            return 1;
        put(lanes.next, 2 * n, next + i * 2 * n);
        if (slopes)
            put(lanes.slopes, 2 * n + m, slopes + i * (2 * n + m));
    }
    return 0;
}
