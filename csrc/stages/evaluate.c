/* The caller's functions, scaled.
 *
 * With w = scale * w', cost' = cost_scale * cost and rows' = row_scale * rows, the multipliers are
 * y = y' row_scale / cost_scale. Rows of d are scaled as the states that they give. */
#include "solver.h"

#include <string.h>

static int is_finite(int n, const real *x)
{
    int i, finite = 1;
    for (i = 0; i < n; ++i)
        finite &= real_abs(x[i]) <= MBS_STAGES_LARGEST;
    return finite;
}

/* An evaluation of all stages. */
typedef struct {
    mbs_stages *s;
    const real *w, *y;
    real factor, *rows, *gradient;
} evaluation;

/* Do a task for all stages. Returns the first stage whose callback failed, or the number of stages. */
static int evaluate(mbs_stages *s, mbs_stages_task task, evaluation *t)
{
    int k;
    t->s = s;
    memset(s->failed, 0, (size_t)s->problem->stages);
    mbs_stages_for_all(&s->recursion, task, t);
    for (k = 0; k < s->problem->stages && !s->failed[k]; ++k)
        ;
    return k;
}

static int fail(mbs_stages *s, int k)
{
    s->failed_stage = k;
    return -1;
}

static void *context_of(const mbs_stages_problem *p, int worker)
{
    return p->team && p->team->contexts ? p->team->contexts[worker] : p->context;
}

static const real *unscale(mbs_stages *s, const mbs_stages_stage *t, const real *w)
{
    int i;
    for (i = 0; i < t->n; ++i)
        s->raw_w[t->w + i] = w[t->w + i] * s->variable_scale[t->w + i];
    return s->raw_w + t->w;
}

/* The state that the rows of d aim at is subtracted from them. */
static void subtract_states(const mbs_stages *s, const mbs_stages_stage *t, const real *w, real *rows)
{
    const mbs_stages_stage *next = t + 1;
    int i;
    for (i = 0; i < t->next; ++i)
        rows[t->d + i] = rows[t->d + i] * s->row_scale[t->d + i] - w[next->w + i];
}

static int stage_values(mbs_stages *s, void *context, int k, const real *w, real *rows)
{
    const mbs_stages_stage *t = &s->recursion.stage[k];
    const mbs_stages_problem *p = s->problem;
    const real *x = unscale(s, t, w);
    const int count = t->ne + t->next + t->ng;
    int i;
    s->costs[k] = 0;
    memset(rows + t->e, 0, (size_t)count * sizeof *rows);
    if (p->values(context, k, x, x + t->nx, &s->costs[k], rows + t->e, rows + t->d, rows + t->g))
        return -1;
    if (!is_finite(1, &s->costs[k]) || !is_finite(count, rows + t->e))
        return -1;
    for (i = 0; i < t->ne; ++i)
        rows[t->e + i] *= s->row_scale[t->e + i];
    for (i = 0; i < t->ng; ++i)
        rows[t->g + i] *= s->row_scale[t->g + i];
    subtract_states(s, t, w, rows);
    return 0;
}

static void values_of_stages(void *data, int from, int to, int worker)
{
    const evaluation *t = data;
    mbs_stages *s = t->s;
    int k;
    for (k = from; k < to; ++k)
        if (stage_values(s, context_of(s->problem, worker), k, t->w, t->rows)) {
            s->failed[k] = 1;
            return;
        }
}

/* Where a stage fails, later ones may have numbers or not; their rows are 0 then. */
int mbs_stages_values(mbs_stages *s, const real *w, real *cost, real *rows)
{
    evaluation t = {0};
    int k, failed;
    t.w = w;
    t.rows = rows;
    ++s->result.evaluations;
    failed = evaluate(s, values_of_stages, &t);
    *cost = 0;
    for (k = 0; k < failed; ++k)
        *cost += s->costs[k] * s->cost_scale;
    if (failed == s->problem->stages)
        return is_finite(1, cost) ? 0 : fail(s, failed - 1);
    memset(rows + s->recursion.stage[failed].e, 0, (size_t)(s->rows - s->recursion.stage[failed].e) * sizeof *rows);
    return fail(s, failed);
}

static void clear(const mbs_stages_matrix *A)
{
    memset(A->value, 0, (size_t)A->count * sizeof *A->value);
}

/* The upper triangle of a dense Hessian is nobody's: it may hold anything. */
static int is_finite_symmetric(const mbs_stages_matrix *H)
{
    int j;
    for (j = 0; j < H->columns; ++j) {
        const size_t at = H->begin ? (size_t)H->begin[j] : (size_t)j * (size_t)(H->rows + 1);
        if (!is_finite(H->begin ? H->end[j] - H->begin[j] : H->rows - j, H->value + at))
            return 0;
    }
    return 1;
}

static int is_one(int n, const real *scale)
{
    int i;
    for (i = 0; i < n; ++i)
        if (scale[i] != 1)
            return 0;
    return 1;
}

static void scale_matrix(const mbs_stages *s, const mbs_stages_matrix *A, const real *row, const real *column)
{
    if (s->has_units || !is_one(A->rows, row))
        mbs_stages_matrix_scale(A, row, column);
}

static int stage_jacobians(mbs_stages *s, void *context, int k, const real *w, real *gradient)
{
    const mbs_stages_stage *t = &s->recursion.stage[k];
    const mbs_stages_problem *p = s->problem;
    const real *x = unscale(s, t, w), *scale = s->variable_scale + t->w;
    int i;
    s->recursion.stage[k].inner.stale = 1;
    memset(gradient + t->w, 0, (size_t)t->n * sizeof *gradient);
    clear(&t->E);
    clear(&t->F);
    clear(&t->G);
    if (p->jacobians(context, k, x, x + t->nx, gradient + t->w, t->E.value, t->F.value, t->G.value))
        return -1;
    if (!is_finite(t->n, gradient + t->w) || !is_finite(t->E.count, t->E.value) ||
        !is_finite(t->F.count, t->F.value) || !is_finite(t->G.count, t->G.value))
        return -1;
    for (i = 0; i < t->n; ++i)
        gradient[t->w + i] *= s->cost_scale * scale[i];
    scale_matrix(s, &t->E, s->row_scale + t->e, scale);
    scale_matrix(s, &t->F, s->row_scale + t->d, scale);
    scale_matrix(s, &t->G, s->row_scale + t->g, scale);
    return 0;
}

static void jacobians_of_stages(void *data, int from, int to, int worker)
{
    const evaluation *t = data;
    mbs_stages *s = t->s;
    int k;
    for (k = from; k < to; ++k)
        if (stage_jacobians(s, context_of(s->problem, worker), k, t->w, t->gradient)) {
            s->failed[k] = 1;
            return;
        }
}

/* Where a stage fails, its derivatives and later ones are 0. */
int mbs_stages_jacobians(mbs_stages *s, const real *w, real *gradient)
{
    evaluation t = {0};
    int k, failed;
    t.w = w;
    t.gradient = gradient;
    failed = evaluate(s, jacobians_of_stages, &t);
    for (k = failed; k < s->problem->stages; ++k) {
        mbs_stages_stage *stage = &s->recursion.stage[k];
        memset(gradient + stage->w, 0, (size_t)stage->n * sizeof *gradient);
        clear(&stage->E);
        clear(&stage->F);
        clear(&stage->G);
        stage->inner.stale = 1;
    }
    return failed < s->problem->stages ? fail(s, failed) : 0;
}

static int stage_hessian(mbs_stages *s, void *context, int k, const real *w, real factor, const real *y)
{
    const mbs_stages_stage *t = &s->recursion.stage[k];
    const mbs_stages_problem *p = s->problem;
    const real *x = unscale(s, t, w), *scale = s->variable_scale + t->w;
    int i;
    for (i = t->e; i < t->g + t->ng; ++i)
        s->raw_rows[i] = y[i] * s->row_scale[i];
    clear(&t->H);
    if (p->hessian(context, k, x, x + t->nx, factor * s->cost_scale, s->raw_rows + t->e, s->raw_rows + t->d,
                   s->raw_rows + t->g, t->H.value))
        return -1;
    if (!is_finite_symmetric(&t->H))
        return -1;
    scale_matrix(s, &t->H, scale, scale);
    return 0;
}

static void hessians_of_stages(void *data, int from, int to, int worker)
{
    const evaluation *t = data;
    mbs_stages *s = t->s;
    int k;
    for (k = from; k < to; ++k)
        if (stage_hessian(s, context_of(s->problem, worker), k, t->w, t->factor, t->y)) {
            s->failed[k] = 1;
            return;
        }
}

/* Nobody reads Hessians where a stage fails. */
int mbs_stages_hessian(mbs_stages *s, const real *w, real factor, const real *y)
{
    evaluation t = {0};
    int failed;
    t.w = w;
    t.factor = factor;
    t.y = y;
    failed = evaluate(s, hessians_of_stages, &t);
    return failed < s->problem->stages ? fail(s, failed) : 0;
}
