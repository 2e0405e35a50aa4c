/* A problem whose functions are quadratic, with numbers at random, and what its optimality conditions are.
 *
 * Row 0 is the cost of a stage; e, d and g follow. Scales are 1 and the solver is asked for none, so that its numbers are
 * the caller's. */
#ifndef DRAWN_H
#define DRAWN_H

#include "laws.h"

#include <math.h>
#include <stdlib.h>

enum { STAGES = 3, MOST = 4, FUNCTIONS = 8, W = 11, S = 5, ROWS = 3 + 4 + S, ALL = W + S + 2 * ROWS };

static mbs_stages_size drawn_sizes[STAGES] = {{2, 2, 1, 2, 0, 0}, {2, 2, 1, 2, 0, 0}, {2, 1, 1, 1, 0, 0}};
static real base[STAGES][FUNCTIONS], linear[STAGES][FUNCTIONS][MOST], bent[STAGES][FUNCTIONS][MOST][MOST];
static real w_lower[W], w_upper[W], g_least[S], g_most[S], w_scale[W];
static mbs_stages_problem drawn_problem;
static mbs_stages *drawn;
static void *drawn_room, *drawn_apart[15];
static unsigned drawn_seed = 5;
static int failing, failing_stage; /* the callback that has no result: 1, values; 2, Jacobians; 3, the Hessian */
static real held[W]; /* where rows hold */

static inline real pick(void)
{
    drawn_seed = drawn_seed * 1103515245u + 12345u;
    return (real)(drawn_seed / 65536 % 2001) / 1000 - 1;
}

static inline int count_next(int k)
{
    return k + 1 < STAGES ? drawn_sizes[k + 1].nx : 0;
}

static inline int count_variables(int k)
{
    return drawn_sizes[k].nx + drawn_sizes[k].nv;
}

static inline int count_rows(int k)
{
    return drawn_sizes[k].ne + count_next(k) + drawn_sizes[k].ng;
}

static inline real value_of(int k, int row, const real *w)
{
    real sum = base[k][row];
    int i, j;
    for (i = 0; i < count_variables(k); ++i) {
        sum += linear[k][row][i] * w[i];
        for (j = 0; j < count_variables(k); ++j)
            sum += bent[k][row][i][j] * w[i] * w[j] / 2;
    }
    return sum;
}

static inline real slope_of(int k, int row, const real *w, int i)
{
    real sum = linear[k][row][i];
    int j;
    for (j = 0; j < count_variables(k); ++j)
        sum += bent[k][row][i][j] * w[j];
    return sum;
}

static inline void gather_w(int k, const real *x, const real *v, real *w)
{
    int i;
    for (i = 0; i < count_variables(k); ++i)
        w[i] = i < drawn_sizes[k].nx ? x[i] : v[i - drawn_sizes[k].nx];
}

static int drawn_values(void *context, int k, const real *x, const real *v, real *f, real *e, real *d, real *g)
{
    real w[MOST];
    int i;
    (void)context;
    gather_w(k, x, v, w);
    *f = value_of(k, 0, w);
    for (i = 0; i < drawn_sizes[k].ne; ++i)
        e[i] = value_of(k, 1 + i, w);
    for (i = 0; i < count_next(k); ++i)
        d[i] = value_of(k, 2 + i, w);
    for (i = 0; i < drawn_sizes[k].ng; ++i)
        g[i] = value_of(k, 2 + count_next(k) + i, w);
    return failing == 1 && k == failing_stage;
}

static int drawn_jacobians(void *context, int k, const real *x, const real *v, real *df, real *de, real *dd, real *dg)
{
    real w[MOST];
    int i, j;
    (void)context;
    gather_w(k, x, v, w);
    for (j = 0; j < count_variables(k); ++j) {
        df[j] = slope_of(k, 0, w, j);
        for (i = 0; i < drawn_sizes[k].ne; ++i)
            de[j * drawn_sizes[k].ne + i] = slope_of(k, 1 + i, w, j);
        for (i = 0; i < count_next(k); ++i)
            dd[j * count_next(k) + i] = slope_of(k, 2 + i, w, j);
        for (i = 0; i < drawn_sizes[k].ng; ++i)
            dg[j * drawn_sizes[k].ng + i] = slope_of(k, 2 + count_next(k) + i, w, j);
    }
    return failing == 2 && k == failing_stage;
}

static int drawn_hessian(void *context, int k, const real *x, const real *v, real factor, const real *ye, const real *yd,
                         const real *yg, real *h)
{
    const int n = count_variables(k);
    int i, j, row;
    (void)context, (void)x, (void)v;
    for (j = 0; j < n; ++j)
        for (i = j; i < n; ++i) {
            real sum = factor * bent[k][0][i][j];
            for (row = 0; row < drawn_sizes[k].ne; ++row)
                sum += ye[row] * bent[k][1 + row][i][j];
            for (row = 0; row < count_next(k); ++row)
                sum += yd[row] * bent[k][2 + row][i][j];
            for (row = 0; row < drawn_sizes[k].ng; ++row)
                sum += yg[row] * bent[k][2 + count_next(k) + row][i][j];
            h[j * n + i] = sum;
        }
    return failing == 3 && k == failing_stage;
}

/* Put an array into separate memory, beyond whose end nobody reads. */
static inline void *set_apart(int place, const void *from, size_t bytes)
{
    free(drawn_apart[place]);
    drawn_apart[place] = malloc(bytes);
    return memcpy(drawn_apart[place], from, bytes);
}

static inline void close_drawn(void)
{
    size_t i;
    for (i = 0; i < sizeof drawn_apart / sizeof *drawn_apart; ++i)
        free(drawn_apart[i]);
    free(drawn_room);
}

/* Draw the functions, of costs with the given curvature, and make a solver: bounds on both sides, one, none; some are
 * equal. With `inner`, rows of e give the first of v. */
static void open_drawn(real curvature, int inner)
{
    static const mbs_stages_problem none;
    int k, row, i, j;
    for (k = 0; k < STAGES; drawn_sizes[k++].inner = inner)
        for (row = 0; row < FUNCTIONS; ++row) {
            base[k][row] = pick();
            for (i = 0; i < MOST; ++i) {
                linear[k][row][i] = pick();
                for (j = 0; j <= i; ++j)
                    bent[k][row][i][j] = bent[k][row][j][i] = row ? pick() / 20 : pick() / 4 + (i == j ? curvature : 0);
            }
        }
    for (k = 0; k < STAGES && inner; ++k)
        linear[k][1][2] = 3;
    for (i = 0; i < W; ++i) {
        w_lower[i] = i % 4 == 1 ? (real)-1e20 : -2 - i / (real)8;
        w_upper[i] = i % 4 == 2 ? (real)1e20 : 2 + i / (real)4;
        w_scale[i] = 1;
    }
    w_upper[5] = (real)1e20, w_lower[5] = (real)-1e20;
    w_lower[0] = w_upper[0] = (real)0.25, w_lower[3] = w_upper[3] = (real)-0.5;
    for (i = 0; i < S; ++i) {
        g_least[i] = i == 1 ? (real)-1e20 : -3;
        g_most[i] = i == 2 ? (real)1e20 : 4 + i;
    }
    g_least[0] = g_most[0] = (real)0.125;
    drawn_problem = none;
    drawn_problem.stages = STAGES, drawn_problem.size = drawn_sizes;
    drawn_problem.values = drawn_values, drawn_problem.jacobians = drawn_jacobians, drawn_problem.hessian = drawn_hessian;
    drawn_problem.lower = w_lower, drawn_problem.upper = w_upper, drawn_problem.least = g_least;
    drawn_problem.most = g_most, drawn_problem.scale = w_scale;
    free(drawn_room);
    drawn_room = malloc(mbs_stages_bytes(&drawn_problem));
    drawn = mbs_stages_create(&drawn_problem, drawn_room, mbs_stages_bytes(&drawn_problem));
    drawn->recursion.stage = set_apart(0, drawn->recursion.stage, STAGES * sizeof *drawn->recursion.stage);
    drawn->point.w = set_apart(1, drawn->point.w, W * sizeof(real));
    drawn->point.y = set_apart(2, drawn->point.y, ROWS * sizeof(real));
    drawn->row_scale = set_apart(3, drawn->row_scale, ROWS * sizeof(real));
    drawn->variable_scale = set_apart(4, drawn->variable_scale, W * sizeof(real));
    drawn->main.x = set_apart(5, drawn->main.x, (W + S) * sizeof(real));
    drawn->main.y = set_apart(6, drawn->main.y, ROWS * sizeof(real));
    drawn->main.c = set_apart(7, drawn->main.c, ROWS * sizeof(real));
    drawn->main.slope = set_apart(8, drawn->main.slope, (W + S) * sizeof(real));
    drawn->dw = set_apart(10, drawn->dw, W * sizeof(real));
    drawn->dy = set_apart(11, drawn->dy, ROWS * sizeof(real));
    drawn->rc = set_apart(12, drawn->rc, ROWS * sizeof(real));
    drawn->best_w = set_apart(13, drawn->best_w, W * sizeof(real));
    drawn->best_y = set_apart(14, drawn->best_y, ROWS * sizeof(real));
    drawn->main.lagrangian = set_apart(9, drawn->main.lagrangian, (W + S) * sizeof(real));
}

/* Entry of the Jacobian of all rows at w, by variable i of w; dynamics have the next state, too. */
static inline real entry_of(const real *w, int row, int i)
{
    int k, at = 0, first = 0;
    for (k = 0; row >= first + count_rows(k); ++k)
        first += count_rows(k), at += count_variables(k);
    row -= first, i -= at;
    if (i >= 0 && i < count_variables(k))
        return slope_of(k, 1 + row, w + at, i);
    if (row >= drawn_sizes[k].ne && row < drawn_sizes[k].ne + count_next(k) && i >= 0)
        return i - count_variables(k) == row - drawn_sizes[k].ne ? -1 : 0;
    return 0;
}

/* The slack of a row, or -1: of g alone. */
static inline int slack_of(int row)
{
    int k, first = 0, at = 0;
    for (k = 0; row >= first + count_rows(k); ++k)
        first += count_rows(k), at += drawn_sizes[k].ng;
    row -= first + drawn_sizes[k].ne + count_next(k);
    return row >= 0 ? at + row : -1;
}

/* Second derivative of factor * cost + y . rows. */
static inline real curvature_of(const real *y, real factor, int i, int j)
{
    real sum;
    int k, row, at = 0, first = 0;
    for (k = 0; i >= at + count_variables(k); ++k)
        at += count_variables(k), first += count_rows(k);
    i -= at, j -= at;
    if (j < 0 || j >= count_variables(k))
        return 0;
    sum = factor * bent[k][0][i][j];
    for (row = 0; row < count_rows(k); ++row)
        sum += y[first + row] * bent[k][1 + row][i][j];
    return sum;
}

static inline real cost_slope(const real *w, int i)
{
    int k, at = 0;
    for (k = 0; i >= at + count_variables(k); ++k)
        at += count_variables(k);
    return slope_of(k, 0, w + at, i - at);
}

static inline real row_value(const real *w, int row)
{
    int k, at = 0, first = 0;
    real sum;
    for (k = 0; row >= first + count_rows(k); ++k)
        first += count_rows(k), at += count_variables(k);
    sum = value_of(k, 1 + row - first, w + at);
    if (row - first >= drawn_sizes[k].ne && row - first < drawn_sizes[k].ne + count_next(k))
        sum -= w[at + count_variables(k) + row - first - drawn_sizes[k].ne];
    return sum;
}


/* Let the rows hold at a point within the bounds. */
static inline void let_hold(void)
{
    real *w = held;
    int i, k, row, at = 0, s = 0;
    for (i = 0; i < W; ++i)
        w[i] = w_lower[i] == w_upper[i] ? w_lower[i] : pick();
    for (k = 0; k < STAGES; at += count_variables(k++))
        for (row = 1; row <= count_rows(k); ++row) {
            const int next = row - 1 - drawn_sizes[k].ne;
            const real value = value_of(k, row, w + at);
            if (next < 0)
                base[k][row] -= value;
            else if (next < count_next(k))
                base[k][row] += w[at + count_variables(k) + next] - value;
            else
                base[k][row] += (g_least[s] == g_most[s] ? g_least[s] : pick()) - value, ++s;
        }
}

/* Numbers at random, inside the bounds. */
static inline void scatter(mbs_stages *s, mbs_stages_phase *p)
{
    int i;
    for (i = 0; i < p->size; ++i) {
        const int below = p->lower[i] > -1e19, above = p->upper[i] < 1e19;
        const real low = below ? p->lower[i] : above ? p->upper[i] - 2 : -1, high = above ? p->upper[i] : low + 2;
        p->x[i] = s->fixed[i] ? p->lower[i] : low + (high - low) * (pick() + (real)1.2) / (real)2.4;
        p->zl[i] = !s->fixed[i] && below ? pick() + (real)1.5 : 0;
        p->zu[i] = !s->fixed[i] && above ? pick() + (real)1.5 : 0;
    }
    for (i = 0; i < ROWS; ++i)
        p->y[i] = pick();
    p->mu = (real)0.25;
}

/* An iterate at random, of the problem or of its restoration, with derivatives and rows. */
static inline mbs_stages_phase *open_iterate(real curvature, int inner, int elastic)
{
    mbs_stages_phase *p;
    int i;
    open_drawn(curvature, inner);
    drawn->options = mbs_stages_default_options();
    drawn->options.scaled = 0, drawn->options.kappa_d = (real)0.01;
    LAW("a problem at random can begin", mbs_stages_start(drawn) == MBS_STAGES_RUNNING);
    p = elastic ? &drawn->least : &drawn->main;
    if (elastic) {
        memcpy(p->lower, drawn->main.lower, (W + S) * sizeof *p->lower);
        memcpy(p->upper, drawn->main.upper, (W + S) * sizeof *p->upper);
        for (i = W + S; i < ALL; ++i) {
            drawn->fixed[i] = (char)(inner && (i - W - S) % ROWS == 0); /* inner rows: the first of each stage */
            p->lower[i] = 0, p->upper[i] = 2e19;
        }
        for (i = 0; i < 2 && inner; ++i)
            drawn->fixed[W + S + count_rows(0) + i * ROWS] = drawn->fixed[W + S + count_rows(0) + count_rows(1) + i * ROWS] = 1;
        for (i = 0; i < W; ++i)
            drawn->reference[i] = pick(), drawn->weight[i] = (real)1.5 + pick();
        drawn->weight_factor = (real)0.75, drawn->options.resto_penalty_parameter = 3;
        mbs_stages_begin(drawn, p);
    }
    scatter(drawn, p);
    LAW("its derivatives are there", !mbs_stages_phase_derivatives(drawn, p) && !mbs_stages_phase_hessian(drawn, p));
    mbs_stages_find_lagrangian(drawn, p);
    LAW("its rows, too", !mbs_stages_phase_values(drawn, p, p->x, &p->cost, p->c));
    return p;
}

#endif
