#include "laws.h"

#include <math.h>
#include <stdlib.h>

#include "../../../csrc/stages/evaluate.c"

/* Three stages of two states and one variable, with a row of e, two rows of g, and the next states. Each function is a
 * sum of terms of its variables (a, b, c), with k, the stage, in them. */
enum { STAGES = 3, N = 3, ALL = 9, ROWS = 13 };
static const real units[ALL] = {2, 0.5, 4, 1, 8, 0.25, 2, 2, 0.125};
static const real scales[ROWS] = {3, 0.5, 2, 4, 0.25, 5, 1, 0.5, 2, 4, 7, 0.5, 3};
static const real point[ALL] = {1, -2, 0.5, 3, 0.25, -4, 1.5, -1, 2};

/* What a callback finds, and what it does: numbers of which stage are wrong, and how. */
static struct {
    void *context[STAGES];
    real x[STAGES][2], v[STAGES], multipliers[STAGES][5], factor[STAGES];
    int wrong, place; /* the stage, or -1; of a number */
    real by;          /* that number; 0: no result instead */
    int calls;
} met;

static int is_wrong(int k, int place, real *number)
{
    if (k == met.wrong && place == met.place && met.by != 0)
        *number = met.by;
    return k == met.wrong && met.by == 0;
}

static void meet(void *context, int k, const real *x, const real *v)
{
    met.context[k] = context, met.x[k][0] = x[0], met.x[k][1] = x[1], met.v[k] = v[0];
    ++met.calls;
}

/* f = a a + 3 k b c; e = a b + k; d = (a + c c, b c); g = (c - a, 5 b b) */
static int values(void *context, int k, const real *x, const real *v, real *f, real *e, real *d, real *g)
{
    const real a = x[0], b = x[1], c = v[0];
    meet(context, k, x, v);
    LAW("numbers are 0 on entry",
        *f == 0 && e[0] == 0 && g[0] == 0 && g[1] == 0 && (k == 2 || (d[0] == 0 && d[1] == 0)));
    *f = a * a + 3 * k * b * c, e[0] = a * b + k, g[0] = c - a, g[1] = 5 * b * b;
    if (k < 2)
        d[0] = a + c * c, d[1] = b * c;
    return is_wrong(k, 0, f) | is_wrong(k, 1, e) | (k < 2 ? is_wrong(k, 2, &d[1]) : 0) | is_wrong(k, 3, &g[1]);
}

static const int e_column[4] = {0, 1, 2, 2}, e_row[2] = {0, 0};
static const int d_column[4] = {0, 1, 2, 4}, d_row[4] = {0, 1, 0, 1};
static const int none_column[4] = {0, 0, 0, 0};
static const int g_column[4] = {0, 1, 2, 3}, g_row[3] = {0, 1, 0}, h_column[4] = {0, 3, 5, 6}, h_row[6] = {0, 1, 2,
    1, 2, 2};
static const mbs_stages_patterns patterns[2] = {
    {{e_column, e_row}, {d_column, d_row}, {g_column, g_row}, {h_column, h_row}},
    {{e_column, e_row}, {none_column, NULL}, {g_column, g_row}, {h_column, h_row}}};
static mbs_stages_size sizes[STAGES];

static int jacobians(void *context, int k, const real *x, const real *v, real *df, real *de, real *dd, real *dg)
{
    const real a = x[0], b = x[1], c = v[0];
    meet(context, k, x, v);
    LAW("derivatives are 0 on entry", df[0] == 0 && df[2] == 0 && de[0] == 0 && de[1] == 0 && dg[0] == 0 && dg[2] == 0);
    df[0] = 2 * a, df[1] = 3 * k * c, df[2] = 3 * k * b;
    if (sizes[k].patterns) {
        de[0] = b, de[1] = a, dg[0] = -1, dg[1] = 10 * b, dg[2] = 1;
        if (k < 2)
            dd[0] = 1, dd[1] = c, dd[2] = 2 * c, dd[3] = b;
    } else {
        de[0] = b, de[1] = a, dg[0] = -1, dg[3] = 10 * b, dg[4] = 1;
        if (k < 2)
            dd[0] = 1, dd[3] = c, dd[4] = 2 * c, dd[5] = b;
    }
    return is_wrong(k, 0, df) | is_wrong(k, 1, de) | (k < 2 ? is_wrong(k, 2, dd) : 0) | is_wrong(k, 3, dg);
}

static int hessian(void *context, int k, const real *x, const real *v, real f, const real *ye, const real *yd,
                   const real *yg, real *h)
{
    real *bb = h + (sizes[k].patterns ? 3 : 4), *cb = h + (sizes[k].patterns ? 4 : 5);
    meet(context, k, x, v);
    LAW("second derivatives are 0 on entry", h[0] == 0 && h[1] == 0 && h[2] == 0 && *bb == 0 && *cb == 0);
    met.factor[k] = f;
    met.multipliers[k][0] = ye[0], met.multipliers[k][1] = k < 2 ? yd[0] : 0, met.multipliers[k][2] = k < 2 ? yd[1] : 0;
    met.multipliers[k][3] = yg[0], met.multipliers[k][4] = yg[1];
    h[0] = 2 * f, h[1] = ye[0], *bb = 10 * yg[1], *cb = 3 * k * f + (k < 2 ? yd[1] : 0);
    h[sizes[k].patterns ? 5 : 8] = k < 2 ? 2 * yd[0] : 0;
    if (!sizes[k].patterns)
        h[3] = h[6] = h[7] = (real)NAN; /* nobody's */
    return is_wrong(k, 0, h) | is_wrong(k, 1, bb) | is_wrong(k, 2, h + (sizes[k].patterns ? 5 : 8)) |
           (sizes[k].patterns ? 0 : is_wrong(k, 3, h + 6) * 0);
}

static void spread(void *pool, int count, mbs_stages_task task, void *data)
{
    (void)pool;
    task(data, 1, count, 0);
    task(data, 0, 1, 1);
}

static void *contexts[2];
static mbs_stages_team team = {2, spread, NULL, contexts};
static mbs_stages_problem problem;
static mbs_stages *s;
static void *memory;
static real *curvatures[STAGES];

/* A solver with scales of rows and of the cost, and, where `has_units`, of variables. */
static void anew(int is_sparse, int has_units, int has_team)
{
    static const mbs_stages_problem none;
    static const mbs_stages_size size = {2, 1, 1, 2, 0, NULL};
    int i;
    problem = none;
    for (i = 0; i < STAGES; ++i) {
        sizes[i] = size;
        sizes[i].patterns = is_sparse ? &patterns[i == 2] : NULL;
    }
    problem.stages = STAGES, problem.size = sizes, problem.context = &problem;
    problem.values = values, problem.jacobians = jacobians, problem.hessian = hessian;
    problem.team = has_team ? &team : NULL;
    contexts[0] = &contexts[1], contexts[1] = &contexts[0], team.contexts = has_team > 1 ? NULL : contexts;
    free(memory);
    memory = malloc(mbs_stages_bytes(&problem));
    s = mbs_stages_create(&problem, memory, mbs_stages_bytes(&problem));
    for (i = 0; i < STAGES; ++i) { /* beyond whose ends nobody reads */
        mbs_stages_matrix *H = &s->recursion.stage[i].H;
        free(curvatures[i]);
        H->value = curvatures[i] = calloc((size_t)H->count, sizeof *H->value);
    }
    for (i = 0; i < ALL; ++i)
        s->variable_scale[i] = has_units ? units[i] : 1;
    for (i = 0; i < ROWS; ++i)
        s->row_scale[i] = scales[i];
    s->has_units = has_units, s->cost_scale = 0.5, s->failed_stage = -1;
    memset(&met, 0, sizeof met);
    met.wrong = -1;
}

static real unit(int i)
{
    return s->has_units ? units[i] : 1;
}

/* Rows of stage k, unscaled: e, d, g. */
static void find_rows(int k, const real *w, real *rows)
{
    const real a = w[3 * k] * unit(3 * k), b = w[3 * k + 1] * unit(3 * k + 1), c = w[3 * k + 2] * unit(3 * k + 2);
    const int g = k < 2 ? 3 : 1;
    rows[0] = a * b + k, rows[g] = c - a, rows[g + 1] = 5 * b * b;
    if (k < 2)
        rows[1] = a + c * c, rows[2] = b * c;
}

static real find_cost(const real *w)
{
    real cost = 0;
    int k;
    for (k = 0; k < STAGES; ++k) {
        const real a = w[3 * k] * unit(3 * k), b = w[3 * k + 1] * unit(3 * k + 1), c = w[3 * k + 2] * unit(3 * k + 2);
        cost += (a * a + 3 * k * b * c) / 2;
    }
    return cost;
}

/* All rows, scaled; rows of d less the state that they give. */
static void find_all(const real *w, real *rows)
{
    int k, i;
    for (k = 0; k < STAGES; ++k)
        find_rows(k, w, rows + 5 * k);
    for (i = 0; i < ROWS; ++i)
        rows[i] *= scales[i];
    for (k = 0; k < 2; ++k)
        for (i = 0; i < 2; ++i)
            rows[5 * k + 1 + i] -= w[3 * k + 3 + i];
}

static void evaluates(void)
{
    real cost = 99, rows[ROWS], wanted[ROWS];
    int i, k;
    LAW("values have a result", mbs_stages_values(s, point, &cost, rows) == 0 && s->result.evaluations == 1);
    LAW("costs are added, scaled", near(cost, find_cost(point)));
    find_all(point, wanted);
    for (i = 0; i < ROWS; ++i)
        LAW("rows are scaled", near(rows[i], wanted[i]));
    for (k = 0; k < STAGES; ++k)
        LAW("callbacks get numbers in the caller's units",
            met.x[k][0] == point[3 * k] * unit(3 * k) && met.x[k][1] == point[3 * k + 1] * unit(3 * k + 1) &&
            met.v[k] == point[3 * k + 2] * unit(3 * k + 2));
    LAW("once each", met.calls == STAGES);
    for (k = 0; k < STAGES; ++k)
        LAW("with the worker's context, or the problem's",
            met.context[k] == (problem.team && team.contexts ? contexts[k < 1] : &problem));
}

/* Entry (i, j) of a matrix. */
static real entry(const mbs_stages_matrix *A, int i, int j)
{
    int l;
    if (!A->begin)
        return A->value[j * A->rows + i];
    for (l = A->begin[j]; l < A->end[j]; ++l)
        if (A->row[l] == i)
            return A->value[l];
    return 0;
}

/* Derivatives, compared with differences of the values: the functions are quadratic, so these are exact. */
static void differentiates(void)
{
    real gradient[ALL], ahead[ROWS], behind[ROWS], y[ROWS], w[ALL], f_ahead, f_behind, lagrangian[2][ALL];
    int i, j, k, side;
    for (k = 0; k < STAGES; ++k)
        s->recursion.stage[k].inner.stale = 0;
    LAW("derivatives have a result", mbs_stages_jacobians(s, point, gradient) == 0);
    memcpy(w, point, sizeof w);
    for (j = 0; j < ALL; ++j) {
        const mbs_stages_stage *t = &s->recursion.stage[j / 3];
        w[j] = point[j] + 0.25, find_all(w, ahead), f_ahead = find_cost(w);
        w[j] = point[j] - 0.25, find_all(w, behind), f_behind = find_cost(w);
        w[j] = point[j];
        LAW("the gradient is scaled", near(gradient[j], (f_ahead - f_behind) * 2));
        LAW("derivatives of e", near(entry(&t->E, 0, j % 3), (ahead[t->e] - behind[t->e]) * 2));
        for (i = 0; i < 2; ++i)
            LAW("of g", near(entry(&t->G, i, j % 3), (ahead[t->g + i] - behind[t->g + i]) * 2));
        for (i = 0; i < t->next; ++i)
            LAW("of d", near(entry(&t->F, i, j % 3), (ahead[t->d + i] - behind[t->d + i]) * 2));
    }
    for (k = 0; k < STAGES; ++k)
        LAW("what is condensed is old now", s->recursion.stage[k].inner.stale);
    for (i = 0; i < ROWS; ++i)
        y[i] = 1 + (real)i / 4;
    LAW("second ones too", mbs_stages_hessian(s, point, 0.75, y) == 0);
    for (k = 0; k < STAGES; ++k)
        LAW("a factor is of the scaled cost",
            near(met.factor[k], 0.375) && near(met.multipliers[k][0], y[5 * k] * scales[5 * k]));
    for (j = 0; j < ALL; ++j) {
        const mbs_stages_stage *t = &s->recursion.stage[j / 3];
        real second[3];
        for (i = 0; i < 3; ++i)
            second[i] = entry(&t->H, i > j % 3 ? i : j % 3, i > j % 3 ? j % 3 : i);
        for (side = 0; side < 2; ++side) {
            w[j] = point[j] + (side ? 0.25 : -0.25);
            mbs_stages_jacobians(s, w, lagrangian[side]);
            for (i = 0; i < ALL; ++i)
                lagrangian[side][i] *= 0.75;
            mbs_stages_add_transposed(&s->recursion, y, lagrangian[side]);
        }
        w[j] = point[j];
        for (i = 0; i < 3; ++i)
            LAW("they are of the scaled Lagrangian",
                real_abs(second[i] - 2 * (lagrangian[1][j / 3 * 3 + i] - lagrangian[0][j / 3 * 3 +
                i])) < 1e-11 * (1 + real_abs(second[i])));
        mbs_stages_hessian(s, point, 0.75, y);
    }
}

/* The stage of a callback without result, or with numbers that are none. */
static void fails(int is_sparse, int has_team)
{
    static const real bad[] = {0, (real)NAN, (real)INFINITY, -(real)INFINITY};
    real cost, rows[ROWS], gradient[ALL], y[ROWS] = {0};
    int k, place, i, j;
    for (k = 0; k < STAGES; ++k)
        for (place = 0; place < 4; ++place)
            for (i = 0; i < 4; ++i) {
                const int is_there = k < 2 || place != 2, first = k < 1 ? 0 : 5 * k;
                anew(is_sparse, 1, has_team);
                met.wrong = k, met.place = place, met.by = bad[i];
                for (j = 0; j < ROWS; ++j)
                    rows[j] = 99;
                LAW("values without a result have none",
                    (mbs_stages_values(s, point, &cost, rows) == 0) == !(is_there || i == 0));
                LAW("the stage is kept", s->failed_stage == (is_there || i == 0 ? k : -1));
                for (j = first; j < ROWS && (is_there || i == 0); ++j)
                    LAW("rows from there on are 0", rows[j] == 0);
                for (j = 0; j < ALL; ++j)
                    gradient[j] = 99;
                s->failed_stage = -1;
                LAW("nor have derivatives", (mbs_stages_jacobians(s, point, gradient) == 0) == !(is_there || i == 0));
                LAW("of that stage", s->failed_stage == (is_there || i == 0 ? k : -1));
                for (j = 0; j < ALL && s->failed_stage >= 0; ++j)
                    LAW("which are 0 from there on", (gradient[j] == 0) == (j / 3 >= k || (j > 0 && j < 3)));
                for (j = k; j < STAGES && s->failed_stage >= 0; ++j) {
                    const mbs_stages_stage *t = &s->recursion.stage[j];
                    int l, sum = 0;
                    for (l = 0; l < 3; ++l)
                        sum += entry(&t->E, 0, l) != 0 || entry(&t->G, 0, l) != 0 || entry(&t->G, 1, l) != 0 ||
                               (j < 2 && (entry(&t->F, 0, l) != 0 || entry(&t->F, 1, l) != 0));
                    LAW("all of them", sum == 0 && t->inner.stale);
                }
                s->failed_stage = -1;
                if (place < 3)
                    LAW("nor second ones", mbs_stages_hessian(s, point, 1, y) == -1 && s->failed_stage == k);
            }
    anew(is_sparse, 1, has_team);
    met.wrong = 1, met.by = MBS_STAGES_LARGEST, s->cost_scale = 4;
    LAW("a sum that is no number has no result",
        mbs_stages_values(s, point, &cost, rows) == -1 && s->failed_stage == 2);
    s->cost_scale = 0.5, s->failed_stage = -1;
    LAW("large numbers are numbers", mbs_stages_values(s, point, &cost, rows) == 0 && s->failed_stage == -1);
}

/* Matrices of units of 1 and rows of scale 1 stay as they are. */
static void leaves(void)
{
    real gradient[ALL], was;
    int i;
    anew(1, 0, 0);
    for (i = 0; i < ROWS; ++i)
        s->row_scale[i] = 1;
    LAW("scales of 1", is_one(ROWS, s->row_scale) && is_one(0, NULL));
    s->row_scale[ROWS - 1] = 2;
    LAW("are all of 1", !is_one(ROWS, s->row_scale) && is_one(ROWS - 1, s->row_scale));
    mbs_stages_jacobians(s, point, gradient);
    was = entry(&s->recursion.stage[0].E, 0, 0);
    LAW("leave derivatives", was == point[1]);
    LAW("others do not", entry(&s->recursion.stage[2].G, 1, 1) == 2 * 10 * point[7]);
}

int main(void)
{
    int is_sparse, has_units, has_team;
    for (is_sparse = 0; is_sparse < 2; ++is_sparse)
        for (has_team = 0; has_team < 3; ++has_team) {
            for (has_units = 0; has_units < 2; ++has_units) {
                anew(is_sparse, has_units, has_team);
                evaluates();
                differentiates();
            }
            fails(is_sparse, has_team);
        }
    leaves();
    free(memory);
    return broken > 0;
}
