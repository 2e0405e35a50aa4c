#include "laws.h"

#include <math.h>

#include "../../../csrc/stages/phase.c"

#define SIZE 4
static real room[12][SIZE];
static char fixed[SIZE];
static mbs_stages solver;
static mbs_stages_phase phase;

/* Bounds on both sides, below, above, and of a fixed variable. */
static void anew(mbs_stages *s, mbs_stages_phase *p)
{
    const real lower[SIZE] = {0, 1, -1e20, 0}, upper[SIZE] = {10, 1e20, 9, 10}, x[SIZE] = {2, 3, 4, 5};
    memset(s, 0, sizeof *s);
    memset(p, 0, sizeof *p);
    memset(room, 0, sizeof room);
    s->options = mbs_stages_default_options();
    p->options = &s->options;
    p->x = room[0], p->lower = room[1], p->upper = room[2], p->zl = room[3], p->zu = room[4];
    p->gradient = room[5], p->lagrangian = room[6], p->slope = room[7], p->c = room[8], p->y = room[9];
    s->row_scale = room[10], s->fixed = fixed;
    fixed[3] = 1;
    p->size = SIZE;
    memcpy(p->x, x, sizeof x), memcpy(p->lower, lower, sizeof lower), memcpy(p->upper, upper, sizeof upper);
    p->mu = 0.5, p->tau = 0.75;
}

static void pushing(void)
{
    real x = 0;
    mbs_stages_push_inside(&x, -3, 1e20, 0.01);
    LAW("inside stays", x == 0);
    x = -3;
    mbs_stages_push_inside(&x, -3, 1e20, 0.01);
    LAW("by a part of the bound's size", near(x, -2.97));
    mbs_stages_push_inside(&x, 0.5, 1e20, 0.01);
    LAW("which is 1 at least", near(x, 0.51));
    mbs_stages_push_inside(&x, -1e20, -5, 0.01);
    LAW("below an upper bound", near(x, -5.05));
    mbs_stages_push_inside(&x, -1e20, -5.1, 0.01);
    LAW("below an upper bound by its size", near(x, -5.151));
    x = 9;
    mbs_stages_push_inside(&x, -1e20, 0.2, 0.01);
    LAW("by 0.01 of 1 at least", near(x, 0.19));
    mbs_stages_push_inside(&x, 100, 102, 0.01);
    LAW("by a part of the room between two bounds", near(x, 100.02));
    x = 200;
    mbs_stages_push_inside(&x, 100, 102, 0.01);
    LAW("on both sides", near(x, 101.98));
    x = NAN;
    mbs_stages_push_inside(&x, 0, 1e20, 0.01);
    LAW("no number becomes one", near(x, 0.01));
}

static void steps(void)
{
    mbs_stages_phase *p = &phase;
    real dx[SIZE] = {-1, -1, 1, -100};
    mbs_stages_direction d = {dx, room[11], p->slope, 0};
    anew(&solver, p);
    LAW("a step that stays inside is whole", mbs_stages_boundary(&solver, p, p->x, dx, 0.75) == 1);
    dx[0] = -3;
    LAW("a part of the distance stays below", near(mbs_stages_boundary(&solver, p, p->x, dx, 0.75), 0.5));
    dx[0] = 8;
    LAW("a part of the distance stays above", near(mbs_stages_boundary(&solver, p, p->x, dx, 0.75), 0.75));
    dx[0] = 0, dx[1] = -2;
    LAW("a distance is from the bound", near(mbs_stages_boundary(&solver, p, p->x, dx, 0.75), 0.75));
    dx[0] = 8, dx[1] = -6;
    LAW("the nearest bound counts", near(mbs_stages_boundary(&solver, p, p->x, dx, 0.75), 0.25));
    dx[1] = 1e9, dx[0] = 0;
    LAW("no bound stops nothing", mbs_stages_boundary(&solver, p, p->x, dx, 0.75) == 1);
    dx[1] = 0, dx[2] = 15;
    LAW("an upper bound alone stops", near(mbs_stages_boundary(&solver, p, p->x, dx, 0.75), 0.25));
    d.zu = room[7];
    p->zl[0] = 2, p->zu[0] = 4, d.zl[0] = -1, d.zu[0] = -2, d.zl[3] = -100;
    LAW("multipliers stay positive", mbs_stages_dual_boundary(&solver, p, &d) == 1);
    d.zl[0] = -3;
    LAW("of lower bounds", near(mbs_stages_dual_boundary(&solver, p, &d), 0.5));
    p->zl[1] = 1, d.zl[1] = -1;
    LAW("the nearest one counts", near(mbs_stages_dual_boundary(&solver, p, &d), 0.5));
    p->zu[1] = 1, d.zu[1] = -1;
    LAW("of both kinds", near(mbs_stages_dual_boundary(&solver, p, &d), 0.5));
    d.zu[0] = -12;
    LAW("and of upper ones", near(mbs_stages_dual_boundary(&solver, p, &d), 0.25));
}

static void errors(void)
{
    mbs_stages_phase *p = &phase;
    mbs_stages_errors e;
    real sum, dx[SIZE] = {1, 1, 1, 1}, dz[SIZE] = {1, 1, 1, 1};
    mbs_stages_direction d = {dx, dz, dz, 0};
    int count;
    anew(&solver, p);
    p->zl[0] = 3, p->zu[0] = 0.125, p->zl[1] = 2, p->zu[2] = 1, p->zl[3] = 50;
    LAW("the largest product", complementarity(&solver, p, 0.5, &sum, &count) == 5.5 && count == 4 && sum == 6.125);
    p->zu[2] = 2;
    LAW("of an upper bound", complementarity(&solver, p, 0.5, &sum, &count) == 9.5);
    p->zl[0] = 0, p->zl[1] = p->zu[2] = p->zu[0] = 0;
    LAW("products that are too small count too", complementarity(&solver, p, 0.5, &sum, &count) == 0.5);
    p->zl[0] = 3, p->zu[0] = 0.125, p->zl[1] = 2, p->zu[2] = 2;
    LAW("the mean product", near(mbs_stages_mean_product(&solver, p, NULL, 0, 0), (6 + 1 + 4 + 10) / 4.0));
    LAW("after a step", near(mbs_stages_mean_product(&solver, p, &d, 0.5, 0.25),
                             (2.5 * 3.25 + 7.5 * 0.375 + 2.5 * 2.25 + 4.5 * 2.25) / 4.0));
    p->size = 0;
    LAW("without bounds there is none", mbs_stages_mean_product(&solver, p, NULL, 0, 0) == 0);
    LAW("usual multipliers forgive nothing", size_of(300, 3, 100) == 1 && size_of(0, 0, 100) == 1);
    LAW("larger ones do", near(size_of(600, 3, 100), 2));
    LAW("to a limit: those that diverge are no solution", size_of(1e9, 3, 100) == 100);
    LAW("residuals are in the row's unit", near(unscale_residual(-3, 2), 1.5) && near(unscale_residual(3, 1), 3));
    LAW("rounding of steep rows is none", unscale_residual(4000 * MBS_STAGES_EPSILON, 0.01) == 0);
    LAW("more is", near(unscale_residual(-6000 * MBS_STAGES_EPSILON, 0.01), 1e5 * MBS_STAGES_EPSILON));
    LAW("others are not steep", unscale_residual(4000 * MBS_STAGES_EPSILON, 1) > 0 && isnan(unscale_residual(NAN, 0.1)));
    LAW("rounding counts in restoration alone", mbs_stages_rounding(p) == 0);
    p->elastic = 1;
    LAW("there by its penalty", near(mbs_stages_rounding(p), 1e5 * MBS_STAGES_EPSILON));
    anew(&solver, p);
    solver.rows = 2, p->c[0] = -1e-3, p->c[1] = 4e-3, solver.row_scale[0] = 0.125, solver.row_scale[1] = 8;
    p->lagrangian[0] = 6, p->zl[0] = 3, p->zu[0] = 0.0625, p->lagrangian[3] = 1e9, p->zl[1] = p->zu[2] = 0;
    e = mbs_stages_measure_errors(&solver, p, 0.5);
    LAW("stationarity with multipliers of bounds", near(e.stationarity, 6 - 3 + 0.0625));
    LAW("complementarity beside the barrier parameter", near(e.complementarity, 5.5));
    LAW("violation in the units of rows", real_abs(e.violation - 8e-3) < 1e-11);
    LAW("all errors together", near(e.scaled, 5.5));
    p->y[0] = 1194, p->y[1] = -3; /* of six numbers, with 3.0625 of bounds: a mean of 200.01 */
    p->lagrangian[0] = 20;
    e = mbs_stages_measure_errors(&solver, p, 0.5);
    LAW("stationarity beside usual multipliers", near(e.scaled, 17.0625 / (1200.0625 / 6 / 100)));
    p->c[0] = 60;
    LAW("rows beside nothing", mbs_stages_measure_errors(&solver, p, 0.5).scaled == 60);
}

static void functions(void)
{
    mbs_stages_phase *p = &phase;
    const real numbers[7] = {1, -2, 3, -4, 5, -6, 7}, one[SIZE] = {1, 1, 1, 1};
    const real logarithms = log(2) + log(8) + log(2) + log(5), distances = 2 + 5;
    anew(&solver, p);
    LAW("sums are of sizes", mbs_stages_sum(7, numbers) == 28 && mbs_stages_sum(3, numbers) == 6);
    LAW("the largest has no sign", mbs_stages_largest(7, numbers) == 7 && mbs_stages_largest(4, numbers) == 4);
    LAW("the barrier function, with a price of bounds on one side",
        near(mbs_stages_barrier(&solver, p, p->x, 3), 3 - 0.5 * (logarithms - 1e-5 * distances)));
    p->gradient[0] = 7;
    LAW("its slope", near(mbs_stages_descent(&solver, p, one),
                          7 - 0.5 / 2 + 0.5 / 8 - 0.5 / 2 + 0.5e-5 + 0.5 / 5 - 0.5e-5));
    p->zl[0] = 3, p->zu[0] = 1;
    mbs_stages_stationarity(&solver, p, 0, p->slope);
    LAW("a slope with multipliers", p->slope[0] == -2 && p->slope[3] == 0);
    mbs_stages_stationarity(&solver, p, 1, p->slope);
    LAW("a slope of the barrier", near(p->slope[0], -0.5 / 2 + 0.5 / 8));
}

int main(void)
{
    pushing();
    steps();
    errors();
    functions();
    return broken > 0;
}
