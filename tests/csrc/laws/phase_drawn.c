/* Functions of the barrier problem, and of restoration, against their definitions for a problem at random. */
#include "drawn.h"

#include "../../../csrc/stages/phase.c"

static real penalty(void)
{
    return drawn->options.resto_penalty_parameter;
}

static real along_rows(const real *x, const real *y, int i)
{
    real sum = 0;
    int row;
    for (row = 0; row < ROWS; ++row)
        sum += y[row] * entry_of(x, row, i);
    return sum;
}

static real slope_of_cost(const mbs_stages_phase *p, int i)
{
    const mbs_stages *s = drawn;
    if (i >= W)
        return i < W + S ? 0 : penalty();
    return p->elastic ? s->weight_factor * s->weight[i] * s->weight[i] * (p->x[i] - s->reference[i]) : cost_slope(p->x, i);
}

static real slope_of_rows(const mbs_stages_phase *p, int i)
{
    int row;
    if (i < W)
        return along_rows(p->x, p->y, i);
    for (row = 0; row < ROWS && i < W + S; ++row)
        if (slack_of(row) == i - W)
            return -p->y[row];
    return i < W + S + ROWS ? -p->y[i - W - S] : p->y[i - W - S - ROWS];
}

static real sum_cost(const mbs_stages_phase *p)
{
    real sum = 0;
    int i, k, at = 0;
    for (k = 0; k < STAGES && !p->elastic; at += count_variables(k++))
        sum += value_of(k, 0, p->x + at);
    for (i = 0; i < W && p->elastic; ++i)
        sum += drawn->weight_factor / 2 * pow(drawn->weight[i] * (p->x[i] - drawn->reference[i]), 2);
    for (i = W + S; i < p->size; ++i)
        sum += penalty() * p->x[i];
    return sum;
}

static void functions(int elastic)
{
    int turn, i, row;
    for (turn = 0; turn < 3; ++turn) {
        mbs_stages_phase *p = open_iterate(4, 0, elastic);
        real slope[ALL], most = 0, worst = 0, mean = 0, product = 0, all;
        mbs_stages_errors e;
        int count = 0;
        LAW("the cost is the sum of its terms", fabs(p->cost - sum_cost(p)) < 1e-12 * (1 + fabs(p->cost)));
        for (row = 0; row < ROWS; ++row) {
            const int slack = slack_of(row);
            real c = row_value(p->x, row) - (slack < 0 ? 0 : p->x[W + slack]);
            if (elastic)
                c += p->x[W + S + ROWS + row] - p->x[W + S + row];
            LAW("rows have their slacks", fabs(c - p->c[row]) < 1e-12);
            worst = fmax(worst, fabs(c));
        }
        mbs_stages_stationarity(drawn, p, 0, slope);
        for (i = 0; i < p->size; ++i) {
            const real of_cost = slope_of_cost(p, i), with_rows = of_cost + slope_of_rows(p, i);
            LAW("slopes of the cost", fabs(p->gradient[i] - of_cost) < 1e-12);
            LAW("and of rows", fabs(p->lagrangian[i] - with_rows) < 1e-11);
            LAW("and of bounds", drawn->fixed[i] ? slope[i] == 0 : fabs(slope[i] - with_rows - p->zu[i] + p->zl[i]) < 1e-11);
            most = fmax(most, fabs(slope[i]));
            if (drawn->fixed[i])
                continue;
            if (p->lower[i] > -1e19)
                mean += p->zl[i], ++count, product = fmax(product, fabs((p->x[i] - p->lower[i]) * p->zl[i] - p->mu));
            if (p->upper[i] < 1e19)
                mean += p->zu[i], ++count, product = fmax(product, fabs((p->upper[i] - p->x[i]) * p->zu[i] - p->mu));
        }
        e = mbs_stages_measure_errors(drawn, p, p->mu);
        LAW("errors are the largest of each kind", near(e.stationarity, most) && fabs(e.violation - worst) < 1e-12);
        LAW("of products, too", fabs(e.complementarity - product) < 1e-12);
        LAW("usual multipliers forgive nothing", e.scaled == fmax(e.stationarity, fmax(e.violation, e.complementarity)));
        memset(p->c, 0, ROWS * sizeof *p->c), memset(p->lagrangian, 0, (size_t)p->size * sizeof *p->lagrangian);
        drawn->options.s_max = mean / (real)count / 4;
        for (row = 0, all = mean; row < ROWS; ++row)
            all += fabs(p->y[row]);
        all = fmax(all / (real)(count + ROWS) / drawn->options.s_max, 1);
        e = mbs_stages_measure_errors(drawn, p, 0);
        LAW("errors beside the means of large multipliers, as Waechter and Biegler have them in (5) and (6)",
            fabs(e.scaled - fmax(e.complementarity / 4, e.stationarity / all)) < 1e-12);
    }
}

/* The Hessian of a stage: of its cost, which counts nothing in restoration, and of its rows. */
static void curvatures(int elastic)
{
    mbs_stages_phase *p = open_iterate(4, 0, elastic);
    int i, j, k, at = 0;
    for (k = 0; k < STAGES; at += count_variables(k++))
        for (j = 0; j < count_variables(k); ++j)
            for (i = j; i < count_variables(k); ++i)
                LAW("curvature is of the Lagrangian", fabs(drawn->recursion.stage[k].H.value[j * count_variables(k) + i] -
                        curvature_of(p->y, elastic ? 0 : 1, at + i, at + j)) < 1e-12);
}

/* In restoration the distance from the reference weighs less as mu falls. */
static void weights(void)
{
    mbs_stages_phase *p = open_iterate(4, 0, 1);
    int i;
    p->mu = (real)0.04;
    mbs_stages_reweigh(drawn, p);
    LAW("by the root of the barrier parameter", near(drawn->weight_factor, (real)0.2));
    LAW("in the cost", fabs(p->cost - sum_cost(p)) < 1e-12 * p->cost);
    for (i = 0; i < W; ++i)
        LAW("and in its slopes", fabs(p->lagrangian[i] - slope_of_cost(p, i) - slope_of_rows(p, i)) < 1e-11);
    p = open_iterate(4, 0, 0);
    drawn->weight_factor = 7, p->mu = (real)0.04;
    mbs_stages_reweigh(drawn, p);
    LAW("there alone", drawn->weight_factor == 7 && fabs(p->cost - sum_cost(p)) < 1e-12 * (1 + fabs(p->cost)));
}

static void failures(void)
{
    int elastic;
    for (elastic = 0; elastic < 2; ++elastic)
        for (failing_stage = 0; failing_stage < STAGES; ++failing_stage) {
            mbs_stages_phase *p = open_iterate(4, 0, elastic);
            failing = 1;
            LAW("values may fail", mbs_stages_phase_values(drawn, p, p->x, &p->cost, p->c) == -1);
            failing = 2;
            LAW("and derivatives", mbs_stages_phase_derivatives(drawn, p) == -1);
            failing = 3;
            LAW("and curvature", mbs_stages_phase_hessian(drawn, p) == -1);
            failing = 0;
        }
}

/* Each of nine numbers counts in a sum, and may be the largest. */
static void sums(void)
{
    real numbers[9];
    int n, i, k;
    for (n = 0; n <= 9; ++n)
        for (k = 0; k < n; ++k) {
            for (i = 0; i < n; ++i)
                numbers[i] = i == k ? -100 : i % 2 ? 1 : -1;
            LAW("a sum of sizes", mbs_stages_sum(n, numbers) == 100 + n - 1);
            LAW("the largest size", mbs_stages_largest(n, numbers) == 100);
        }
    LAW("of nothing", mbs_stages_sum(0, numbers) == 0 && mbs_stages_largest(0, numbers) == 0);
}

int main(void)
{
    functions(0), functions(1), curvatures(0), curvatures(1), weights(), failures(), sums();
    close_drawn();
    return broken > 0;
}
