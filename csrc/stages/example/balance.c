/* Swing a pendulum up and balance it in real time: one Newton step in each sampling period, pushes from outside. */
#include "mbs_stages.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { INTERVALS = 30, PERIODS = 200, SUBSTEPS = 20 };
static const double STEP = 0.06, LIMIT = 6.0, UP = 3.14159265358979324, GRAVITY = 9.81;

/* x = (angle, rate), v = torque; the cost is the distance from the top, and effort. */
static int values(void *context, int k, const double *x, const double *v, double *f, double *e, double *d, double *g)
{
    const double weight = k < INTERVALS ? STEP : 10.0, angle = x[0] - UP;
    (void)context, (void)e, (void)g;
    *f = weight * (angle * angle + 0.1 * x[1] * x[1]);
    if (k == INTERVALS)
        return 0;
    *f += STEP * 0.01 * v[0] * v[0];
    d[0] = x[0] + STEP * x[1];
    d[1] = x[1] + STEP * (v[0] - GRAVITY * sin(x[0]));
    return 0;
}

static int jacobians(void *context, int k, const double *x, const double *v, double *df, double *de, double *dd,
                     double *dg)
{
    const double weight = k < INTERVALS ? STEP : 10.0;
    (void)context, (void)de, (void)dg;
    df[0] = 2.0 * weight * (x[0] - UP);
    df[1] = 0.2 * weight * x[1];
    if (k == INTERVALS)
        return 0;
    df[2] = 0.02 * STEP * v[0];
    dd[0] = dd[3] = 1.0; /* by columns: of the angle, of the rate, of the torque */
    dd[1] = -STEP * GRAVITY * cos(x[0]);
    dd[2] = dd[5] = STEP;
    return 0;
}

static int hessian(void *context, int k, const double *x, const double *v, double factor, const double *ye,
                   const double *yd, const double *yg, double *h)
{
    const double weight = k < INTERVALS ? STEP : 10.0;
    const int n = k < INTERVALS ? 3 : 2;
    (void)context, (void)v, (void)ye, (void)yg;
    h[0] = 2.0 * weight * factor;
    h[n + 1] = 0.2 * weight * factor;
    if (k == INTERVALS)
        return 0;
    h[0] += yd[1] * STEP * GRAVITY * sin(x[0]);
    h[8] = 0.02 * STEP * factor;
    return 0;
}

/* Sizes and bounds: equal bounds mark the first state as measured, torques are limited. */
static void describe(mbs_stages_size *size, double *lower, double *upper)
{
    const mbs_stages_size interval = {2, 1, 0, 0, 0, NULL}, last = {2, 0, 0, 0, 0, NULL};
    int k, i;
    for (k = 0; k <= INTERVALS; ++k)
        size[k] = k < INTERVALS ? interval : last;
    for (i = 0; i < 3 * INTERVALS + 2; ++i) {
        const int is_torque = i % 3 == 2 && i < 3 * INTERVALS;
        upper[i] = i < 2 ? 0.0 : is_torque ? LIMIT : INFINITY;
        lower[i] = -upper[i];
    }
}

/* The real pendulum: some friction that the controller knows nothing of, and a push in every 60th period. */
static void swing(int period, double torque, double *x)
{
    const double h = STEP / SUBSTEPS;
    int i;
    for (i = 0; i < SUBSTEPS; ++i) {
        x[1] += h * (torque - GRAVITY * sin(x[0]) - 0.1 * x[1]);
        x[0] += h * x[1];
    }
    if (period % 60 == 59)
        x[1] += 1.5;
}

/* Returns how many periods failed. */
static int control(mbs_stages *solver, double *x)
{
    const mbs_stages_options options = mbs_stages_default_options();
    int period, failures = 0;
    for (period = 0; period < PERIODS; ++period) {
        mbs_stages_realtime step;
        double torque;
        mbs_stages_prepare(solver, &options, period > 0); /* before the measurement is there */
        step = mbs_stages_feedback(solver, x, &torque);
        failures += step.status != MBS_STAGES_STEPPED || fabs(torque) > LIMIT;
        if (period % 10 == 0)
            printf("%5.2f s  angle %7.4f  rate %7.4f  torque %7.4f\n", period * STEP, x[0], x[1], torque);
        swing(period, torque, x);
    }
    return failures;
}

int main(void)
{
    static mbs_stages_size size[INTERVALS + 1];
    static double lower[3 * INTERVALS + 2], upper[3 * INTERVALS + 2];
    double x[2] = {0.0, 0.0};
    mbs_stages_problem problem = {0};
    mbs_stages_result first;
    mbs_stages *solver;
    void *workspace;
    size_t bytes;
    int failures;
    describe(size, lower, upper);
    problem.stages = INTERVALS + 1;
    problem.size = size;
    problem.values = values;
    problem.jacobians = jacobians;
    problem.hessian = hessian;
    problem.lower = lower;
    problem.upper = upper;
    bytes = mbs_stages_bytes(&problem);
    workspace = malloc(bytes);
    solver = mbs_stages_create(&problem, workspace, bytes);
    if (solver == NULL)
        return 1;
    first = mbs_stages_solve(solver, NULL); /* where there is time: a plan to start from */
    failures = control(solver, x);
    free(workspace);
    printf("%s\n%d failures, %.4f from the top\n", mbs_stages_explain(first.status), failures, fabs(x[0] - UP));
    return first.status == MBS_STAGES_SOLVED && failures == 0 && fabs(x[0] - UP) < 0.05 ? 0 : 2;
}
