/* Swing a pendulum up with a torque that cannot hold it: least effort, 60 steps of Euler's method. */
#include "mbs_stages.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { INTERVALS = 60 };
static const double STEP = 0.06, LIMIT = 4.0;

/* x = (angle, rate), v = torque; the last stage has no v, and its equalities ask for the top, at rest. */
static int values(void *context, int k, const double *x, const double *v, double *f, double *e, double *d, double *g)
{
    (void)context, (void)g;
    if (k == INTERVALS) {
        e[0] = x[0] - acos(-1.0);
        e[1] = x[1];
        return 0;
    }
    *f = STEP * v[0] * v[0];
    d[0] = x[0] + STEP * x[1];
    d[1] = x[1] + STEP * (v[0] - 9.81 * sin(x[0]));
    return 0;
}

static int jacobians(void *context, int k, const double *x, const double *v, double *df, double *de, double *dd,
                     double *dg)
{
    (void)context, (void)dg;
    if (k == INTERVALS) {
        de[0] = de[3] = 1.0;
        return 0;
    }
    df[2] = 2.0 * STEP * v[0];
    dd[0] = dd[3] = 1.0; /* by columns: of the angle, of the rate, of the torque */
    dd[1] = -STEP * 9.81 * cos(x[0]);
    dd[2] = dd[5] = STEP;
    return 0;
}

static int hessian(void *context, int k, const double *x, const double *v, double factor, const double *ye,
                   const double *yd, const double *yg, double *h)
{
    (void)context, (void)v, (void)ye, (void)yg;
    if (k == INTERVALS)
        return 0;
    h[0] = yd[1] * STEP * 9.81 * sin(x[0]);
    h[8] = 2.0 * STEP * factor;
    return 0;
}

/* Sizes and bounds: the first state is fixed at rest below, torques are limited. */
static void describe(mbs_stages_size *size, double *lower, double *upper)
{
    const mbs_stages_size interval = {2, 1, 0, 0, 0, NULL}, last = {2, 0, 2, 0, 0, NULL};
    int k, i;
    for (k = 0; k <= INTERVALS; ++k)
        size[k] = k < INTERVALS ? interval : last;
    for (i = 0; i < 3 * INTERVALS + 2; ++i) {
        const int is_torque = i % 3 == 2 && i < 3 * INTERVALS;
        upper[i] = i < 2 ? 0.0 : is_torque ? LIMIT : INFINITY;
        lower[i] = -upper[i];
    }
}

static void print_solution(const mbs_stages *solver, const mbs_stages_result *result)
{
    const mbs_stages_point point = mbs_stages_iterate(solver);
    int k;
    printf("%s\n%d iterations, effort %.6f\n", mbs_stages_explain(result->status), result->iterations, result->cost);
    for (k = 0; k <= INTERVALS; k += 10) {
        const mbs_stages_place place = mbs_stages_places(solver, k);
        printf("%5.2f s  angle %7.4f  rate %7.4f\n", k * STEP, point.w[place.x], point.w[place.x + 1]);
    }
}

int main(void)
{
    static mbs_stages_size size[INTERVALS + 1];
    static double lower[3 * INTERVALS + 2], upper[3 * INTERVALS + 2];
    mbs_stages_problem problem = {0};
    mbs_stages_result result;
    mbs_stages *solver;
    void *workspace;
    size_t bytes;
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
    result = mbs_stages_solve(solver, NULL); /* from zeros */
    print_solution(solver, &result);
    free(workspace);
    return result.status == MBS_STAGES_SOLVED ? 0 : 2;
}
