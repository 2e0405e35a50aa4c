/* Newton's step against the conditions that it solves: all of them, with slacks and elastic variables, written out. */
#include "drawn.h"

#include "../../../csrc/stages/newton.c"

static real mu_price(const mbs_stages_phase *p, int i)
{
    const int below = p->lower[i] > -1e19, above = p->upper[i] < 1e19;
    return (below - above) * p->options->kappa_d * p->mu; /* of a distance from one bound alone */
}

static real curvature_at(const mbs_stages *s, int stage_of_variable)
{
    return s->recursion.stage[stage_of_variable].curvature;
}

/* The stages of a variable of w, a slack and a row. */
static int stage_of(int i, int which)
{
    int k, at = 0;
    for (k = 0; k < STAGES; ++k) {
        at += which == 0 ? count_variables(k) : which == 1 ? drawn_sizes[k].ng : count_rows(k);
        if (i < at)
            return k;
    }
    return STAGES - 1;
}

static int is_inner(int i)
{
    const int k = stage_of(i, 0);
    int at = 0, l;
    for (l = 0; l < k; ++l)
        at += count_variables(l);
    return drawn_sizes[k].inner && i - at == drawn_sizes[k].nx;
}

/* The derivative by an unknown after the step, as far as its bounds and its added curvature make it. */
static real own_part(const mbs_stages *s, const mbs_stages_phase *p, int i, int stage)
{
    const mbs_stages_direction *d = &p->step;
    return p->zu[i] + d->zu[i] - p->zl[i] - d->zl[i] + mu_price(p, i) + curvature_at(s, stage) * d->x[i];
}

/* The largest residual of the derivatives of the Lagrangian. */
static real slopes_left(const mbs_stages *s, const mbs_stages_phase *p, int inner_too)
{
    const mbs_stages_direction *d = &p->step;
    const real rho = s->options.resto_penalty_parameter;
    real most = 0;
    int i, j, row;
    for (i = 0; i < W; ++i) {
        real sum = p->elastic ? s->weight_factor * s->weight[i] * s->weight[i] * (p->x[i] + d->x[i] - s->reference[i])
                              : cost_slope(p->x, i);
        for (j = 0; j < W; ++j)
            sum += curvature_of(p->y, p->elastic ? 0 : 1, i, j) * d->x[j];
        for (row = 0; row < ROWS; ++row)
            sum += (p->y[row] + d->y[row]) * entry_of(p->x, row, i);
        sum += own_part(s, p, i, stage_of(i, 0)) - (is_inner(i) && !inner_too ? curvature_at(s, stage_of(i, 0)) * d->x[i] : 0);
        most = s->fixed[i] ? most : fmax(most, fabs(sum));
    }
    for (row = 0; row < ROWS; ++row) {
        const int slack = W + slack_of(row), plus = W + S + row, minus = plus + ROWS, k = stage_of(row, 2);
        const real y = p->y[row] + d->y[row];
        if (slack >= W && !s->fixed[slack])
            most = fmax(most, fabs(own_part(s, p, slack, k) - y));
        if (p->elastic && !s->fixed[plus])
            most = fmax(most, fmax(fabs(rho + own_part(s, p, plus, k) - y), fabs(rho + own_part(s, p, minus, k) + y)));
    }
    return most;
}

static real rows_left(const mbs_stages *s, const mbs_stages_phase *p)
{
    const mbs_stages_direction *d = &p->step;
    real most = 0;
    int i, row;
    (void)s;
    for (row = 0; row < ROWS; ++row) {
        const int slack = W + slack_of(row), plus = W + S + row, minus = plus + ROWS;
        real sum = row_value(p->x, row);
        for (i = 0; i < W; ++i)
            sum += entry_of(p->x, row, i) * d->x[i];
        if (slack >= W)
            sum -= p->x[slack] + d->x[slack];
        if (p->elastic)
            sum += p->x[minus] + d->x[minus] - p->x[plus] - d->x[plus];
        most = fmax(most, fabs(sum));
    }
    return most;
}

/* Distances and multipliers after the step, to first order. */
static real products_left(const mbs_stages *s, const mbs_stages_phase *p)
{
    const mbs_stages_direction *d = &p->step;
    real most = 0;
    int i;
    for (i = 0; i < p->size; ++i) {
        const real below = p->x[i] - p->lower[i], above = p->upper[i] - p->x[i];
        if (s->fixed[i])
            most = fmax(most, fabs(d->x[i]) + fabs(d->zl[i]) + fabs(d->zu[i]));
        else {
            const real low = p->zl[i] * below + p->zl[i] * d->x[i] + d->zl[i] * below;
            const real high = p->zu[i] * above - p->zu[i] * d->x[i] + d->zu[i] * above;
            most = fmax(most, p->lower[i] > -1e19 ? fabs(low - p->mu) : fabs(d->zl[i]));
            most = fmax(most, p->upper[i] < 1e19 ? fabs(high - p->mu) : fabs(d->zu[i]));
        }
    }
    return most;
}

static void step(mbs_stages_phase *p)
{
    LAW("the conditions are factorised", mbs_stages_newton_factorise(drawn, p) == 0);
    mbs_stages_stationarity(drawn, p, 1, p->slope);
    mbs_stages_newton_solve(drawn, p, p->c, &p->step);
}

static void steps(int inner, int elastic)
{
    int turn;
    for (turn = 0; turn < 3; ++turn) {
        mbs_stages_phase *p = open_iterate(4, inner, elastic);
        step(p);
        LAW("a convex problem gets no curvature", p->added == 0 && curvature_at(drawn, 0) == 0);
        LAW("the step solves the conditions of the variables", slopes_left(drawn, p, 0) < 1e-9);
        LAW("and of the rows", rows_left(drawn, p) < 1e-10);
        LAW("and of the bounds", products_left(drawn, p) < 1e-10);
        LAW("with the digits of one factorisation", drawn->result.factorisations == 1 && drawn->result.refinements == 0);
        LAW("no row is softened", drawn->softening == MBS_STAGES_HARD && drawn->left < 1e-10);
        LAW("and none is missing", drawn->result.dependent == 0 && drawn->result.singular == 0);
    }
}

/* A cost that is not convex gets curvature: in all stages, or from the one on that lacks it. */
static void curvatures(int by_stage, int inner, int elastic)
{
    mbs_stages_phase *p = open_iterate(by_stage ? 4 : -12, inner, elastic);
    int i;
    for (i = 0; i < MOST && by_stage; ++i)
        bent[0][0][i][i] = 400, bent[1][0][i][i] = -40;
    for (i = 0; i < ROWS && elastic; ++i)
        p->y[i] = 300 * pick();
    drawn->options.by_stage = by_stage;
    LAW("there are derivatives", !mbs_stages_phase_derivatives(drawn, p) && !mbs_stages_phase_hessian(drawn, p));
    mbs_stages_find_lagrangian(drawn, p);
    step(p);
    LAW("what is not convex gets curvature", p->added > 0 && curvature_at(drawn, STAGES - 1) == p->added);
    LAW("everywhere, or from its stage on", curvature_at(drawn, 0) == (by_stage ? 0 : p->added));
    LAW("by the rule of growth", p->added == (real)1e-4 * pow(100, drawn->result.factorisations - 2));
    LAW("the step solves conditions with it", slopes_left(drawn, p, 0) < 1e-7);
    LAW("and rows", rows_left(drawn, p) < 1e-9);
    LAW("and bounds", products_left(drawn, p) < 1e-9);
    p->restraint = 4 * p->added;
    step(p);
    LAW("a step that is restrained has it from the first", p->added == p->restraint && curvature_at(drawn, 0) == p->added);
    p->restraint = 0;
    if (by_stage)
        return;
    p->cautious = 1; /* inner variables get it, too */
    step(p);
    LAW("on demand in all variables", slopes_left(drawn, p, 1) < 1e-7 && rows_left(drawn, p) < 1e-9);
}

/* Residuals of a step by stages, and rows that hardly give and are taken as exact. */
static void refinements(int inner)
{
    mbs_stages_phase *p = open_iterate(4, inner, 0);
    int i;
    step(p);
    for (i = 0; i < W; ++i)
        drawn->residual_w[i] = 9;
    for (i = 0; i < ROWS; ++i)
        drawn->residual_c[i] = 9;
    find_residuals(drawn, 1, 2, 0);
    LAW("residuals are found by stages", drawn->residual_w[0] == 9 && drawn->residual_c[ROWS - 1] == 9);
    LAW("of the step", mbs_stages_largest(4, drawn->residual_w + 4) < 1e-9 && mbs_stages_largest(5, drawn->residual_c + 5) < 1e-9);
    find_residuals(drawn, 0, STAGES, 0);
    LAW("all of them", mbs_stages_largest(W, drawn->residual_w) < 1e-9 && mbs_stages_largest(ROWS, drawn->residual_c) < 1e-9);
    drawn->dw[5] += 1, drawn->dy[5] += 1;
    find_residuals(drawn, 0, STAGES, 0);
    LAW("of another one they are not 0", mbs_stages_largest(W, drawn->residual_w) > 1e-2);
    p = open_iterate(4, inner, 0);
    p->zl[W + 3] = (real)1e12, drawn->exact = 1; /* a slack near its bound */
    mbs_stages_find_lagrangian(drawn, p);
    step(p);
    LAW("exact rows give what they give", rows_left(drawn, p) < 1e-7 && slopes_left(drawn, p, 0) < 1e-3);
    LAW("they were exact", drawn->recursion.compliance[8] == 0 || drawn->recursion.compliance[9] == 0);
}

/* First multipliers: the derivatives that they leave, of all numbers that are not fixed, have no part along the rows. */
static void multipliers(int inner)
{
    mbs_stages_phase *p = open_iterate(4, inner, 0);
    real left[W + S];
    int i, row;
    mbs_stages_estimate_multipliers(drawn, p);
    for (i = 0; i < W + S; ++i) {
        left[i] = (i < W ? cost_slope(p->x, i) : 0) + p->zu[i] - p->zl[i];
        for (row = 0; row < ROWS; ++row)
            left[i] += p->y[row] * (i < W ? entry_of(p->x, row, i) : slack_of(row) == i - W ? -1 : 0);
    }
    for (row = 0; row < ROWS; ++row) {
        real along = 0;
        for (i = 0; i < W + S; ++i)
            along += drawn->fixed[i] ? 0 : left[i] * (i < W ? entry_of(p->x, row, i) : slack_of(row) == i - W ? -1 : 0);
        LAW("first multipliers are those of least squares", fabs(along) < 1e-10);
    }
}

int main(void)
{
    int inner, elastic;
    for (inner = 0; inner < 2; ++inner) {
        for (elastic = 0; elastic < 2; ++elastic)
            steps(inner, elastic), curvatures(0, inner, elastic);
        curvatures(1, inner, 0), multipliers(inner), refinements(inner);
    }
    close_drawn();
    return broken > 0;
}
