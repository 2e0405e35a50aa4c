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

static int stage_jacobians(mbs_stages *s, int k, const real *w, real *gradient)
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
    if (p->jacobians(p->context, k, x, x + t->nx, gradient + t->w, t->E.value, t->F.value, t->G.value))
        return -1;
    if (!is_finite(t->n, gradient + t->w) || !is_finite(t->E.count, t->E.value) ||
        !is_finite(t->F.count, t->F.value) || !is_finite(t->G.count, t->G.value))
        return -1;
    for (i = 0; i < t->n; ++i)
        gradient[t->w + i] *= s->cost_scale * scale[i];
    mbs_stages_matrix_scale(&t->E, s->row_scale + t->e, scale);
    mbs_stages_matrix_scale(&t->F, s->row_scale + t->d, scale);
    mbs_stages_matrix_scale(&t->G, s->row_scale + t->g, scale);
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
    int i;
    for (i = t->e; i < t->g + t->ng; ++i)
        s->raw_rows[i] = y[i] * s->row_scale[i];
    clear(&t->H);
    if (p->hessian(p->context, k, x, x + t->nx, factor * s->cost_scale, s->raw_rows + t->e, s->raw_rows + t->d,
                   s->raw_rows + t->g, t->H.value))
        return -1;
    if (!is_finite_symmetric(&t->H))
        return -1;
    mbs_stages_matrix_scale(&t->H, scale, scale);
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
