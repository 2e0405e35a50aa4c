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

static int fail(mbs_stages *s, int k)
{
    s->failed_stage = k;
    return -1;
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

static int stage_values(mbs_stages *s, int k, const real *w, real *cost, real *rows)
{
    const mbs_stages_stage *t = &s->recursion.stage[k];
    const mbs_stages_problem *p = s->problem;
    const real *x = unscale(s, t, w);
    const int count = t->ne + t->next + t->ng;
    real f = 0;
    int i;
    memset(rows + t->e, 0, (size_t)count * sizeof *rows);
    if (p->values(p->context, k, x, x + t->nx, &f, rows + t->e, rows + t->d, rows + t->g))
        return -1;
    if (!is_finite(1, &f) || !is_finite(count, rows + t->e))
        return -1;
    *cost += f * s->cost_scale;
    for (i = 0; i < t->ne; ++i)
        rows[t->e + i] *= s->row_scale[t->e + i];
    for (i = 0; i < t->ng; ++i)
        rows[t->g + i] *= s->row_scale[t->g + i];
    subtract_states(s, t, w, rows);
    return 0;
}

int mbs_stages_values(mbs_stages *s, const real *w, real *cost, real *rows)
{
    int k;
    ++s->result.evaluations;
    *cost = 0;
    for (k = 0; k < s->problem->stages; ++k)
        if (stage_values(s, k, w, cost, rows))
            return fail(s, k);
    return is_finite(1, cost) ? 0 : fail(s, s->problem->stages - 1);
}

static void scale_block(int m, int n, const real *row, const real *column, real *A)
{
    int i, j;
    for (j = 0; j < n; ++j, A += m)
        for (i = 0; i < m; ++i)
            A[i] *= row[i] * column[j];
}

static int stage_jacobians(mbs_stages *s, int k, const real *w, real *gradient)
{
    const mbs_stages_stage *t = &s->recursion.stage[k];
    const mbs_stages_problem *p = s->problem;
    const real *x = unscale(s, t, w), *scale = s->variable_scale + t->w;
    const size_t n = (size_t)t->n;
    int i;
    memset(gradient + t->w, 0, n * sizeof *gradient);
    memset(t->E, 0, (size_t)t->ne * n * sizeof(real));
    memset(t->F, 0, (size_t)t->next * n * sizeof(real));
    memset(t->G, 0, (size_t)t->ng * n * sizeof(real));
    if (p->jacobians(p->context, k, x, x + t->nx, gradient + t->w, t->E, t->F, t->G))
        return -1;
    if (!is_finite(t->n, gradient + t->w) || !is_finite(t->ne * t->n, t->E) || !is_finite(t->next * t->n, t->F) ||
        !is_finite(t->ng * t->n, t->G))
        return -1;
    for (i = 0; i < t->n; ++i)
        gradient[t->w + i] *= s->cost_scale * scale[i];
    scale_block(t->ne, t->n, s->row_scale + t->e, scale, t->E);
    scale_block(t->next, t->n, s->row_scale + t->d, scale, t->F);
    scale_block(t->ng, t->n, s->row_scale + t->g, scale, t->G);
    return 0;
}

int mbs_stages_jacobians(mbs_stages *s, const real *w, real *gradient)
{
    int k;
    for (k = 0; k < s->problem->stages; ++k)
        if (stage_jacobians(s, k, w, gradient))
            return fail(s, k);
    return 0;
}

static int stage_hessian(mbs_stages *s, int k, const real *w, real factor, const real *y)
{
    const mbs_stages_stage *t = &s->recursion.stage[k];
    const mbs_stages_problem *p = s->problem;
    const real *x = unscale(s, t, w), *scale = s->variable_scale + t->w;
    const int n = t->n;
    int i;
    for (i = t->e; i < t->g + t->ng; ++i)
        s->raw_rows[i] = y[i] * s->row_scale[i];
    memset(t->H, 0, (size_t)n * (size_t)n * sizeof(real));
    if (p->hessian(p->context, k, x, x + t->nx, factor * s->cost_scale, s->raw_rows + t->e, s->raw_rows + t->d,
                   s->raw_rows + t->g, t->H))
        return -1;
    for (i = 0; i < n; ++i)
        if (!is_finite(n - i, t->H + (size_t)i * (size_t)n + (size_t)i))
            return -1;
    scale_block(n, n, scale, scale, t->H);
    return 0;
}

int mbs_stages_hessian(mbs_stages *s, const real *w, real factor, const real *y)
{
    int k;
    for (k = 0; k < s->problem->stages; ++k)
        if (stage_hessian(s, k, w, factor, y))
            return fail(s, k);
    return 0;
}
