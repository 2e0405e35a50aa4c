/* Inner variables y and inner equations r of a stage, condensed.
 *
 * With outer variables u = (x, other v), the equations give y = S u + s with S = -r_y^-1 r_u and s = -r_y^-1 r. All
 * variables are z = V u + (0, s) with V = (I; S), so that cost and rows of u are
 *
 *     VT (H + diagonal) V,      J V,      VT (rw + (H + diagonal) (0, s)),      rc + J (0, s).
 *
 * Multipliers of r follow from the derivatives by y: r_yT dy = -(rw + (H + diagonal) z + JT dy of other rows). A variable
 * y that r does not determine is an outer one, and a row of r without a pivot is another row of e. */
#include "condense.h"

#include <string.h>

#define OFTEN 4 /* an order that fails in one of as many stages is given up */
#define TRIES 3

static real *row_of_v(const mbs_stages_stage *s, int i)
{
    return s->inner.V + (size_t)i * (size_t)s->inner.width;
}

/* The part of it that is not 0 for inner variables. */
static real *read_part_of_v(const mbs_stages_stage *s, int i)
{
    return row_of_v(s, i) + s->inner.skip;
}

static int is_inner(const mbs_stages_stage *s, int i)
{
    return i >= s->nx && i < s->nx + s->inner.n;
}

int mbs_stages_outer(const mbs_stages_stage *s, int i)
{
    if (is_inner(s, i))
        return -1;
    return i < s->nx ? i : i - s->inner.n;
}

void mbs_stages_apply_curvature(const mbs_stages_stage *s, const real *z, real *out)
{
    int i;
    for (i = 0; i < s->n && s->curvature > 0; ++i)
        if (!is_inner(s, i))
            out[i] += s->curvature * z[i];
    for (i = 0; i < s->inner.deferred && s->curvature > 0; ++i)
        out[s->nx + s->inner.variable[i]] += s->curvature * z[s->nx + s->inner.variable[i]];
}

const real *mbs_stages_variation(const mbs_stages_stage *s, int i)
{
    return is_inner(s, i) ? row_of_v(s, i) : NULL;
}

/* Count stages of each kind whose pivots were too small by the order; an order that failed in many is given up. */
static void review_orders(mbs_stages_recursion *r)
{
    int k;
    for (k = 0; k < r->stages; ++k)
        if (r->stage[k].inner.n > 0)
            r->stage[k].inner.pivots->failed = r->stage[k].inner.pivots->stages = 0;
    for (k = 0; k < r->stages; ++k) {
        const mbs_stages_inner *y = &r->stage[k].inner;
        if (y->n == 0)
            continue;
        ++y->pivots->stages;
        if (y->poor && ++y->pivots->failed == 1 && y->pivots->ready)
            y->pivots->stage = k;
    }
    for (k = 0; k < r->stages; ++k) {
        mbs_stages_pivots *p = r->stage[k].inner.pivots;
        if (r->stage[k].inner.n > 0 && OFTEN * p->failed > p->stages) {
            p->ready = 0;
            r->stage[k].inner.stale = 1;
        }
    }
}

static int choose(mbs_stages_recursion *r, int k)
{
    const mbs_stages_stage *s = &r->stage[k];
    const mbs_stages_scratch *m = &r->scratch[0];
    mbs_stages_pivots *p = s->inner.pivots;
    int l;
    if (mbs_stages_choose_pivots(p, &s->E, m->block, m->vector[5], r->marks, m->spots, r->zero_pivot))
        return -1;
    for (l = 0; l < r->stages; ++l)
        if (r->stage[l].inner.n > 0 && r->stage[l].inner.pivots == p)
            r->stage[l].inner.stale = 1;
    return 0;
}

/* Where a stage gives no order, because its block is singular, the next one is tried; a few in one factorisation. */
void mbs_stages_order_pivots(mbs_stages_recursion *r)
{
    int k, tries = 0;
    review_orders(r);
    for (k = 0; k < r->stages; ++k) {
        mbs_stages_pivots *p = r->stage[k].inner.pivots;
        if (r->stage[k].inner.n > 0 && !p->ready && p->stage <= k && tries < TRIES && choose(r, k)) {
            ++tries;
            p->stage = k + 1;
        }
    }
    for (k = 0; k < r->stages; ++k)
        if (r->stage[k].inner.n > 0 && !r->stage[k].inner.pivots->ready && tries < TRIES)
            r->stage[k].inner.pivots->stage = 0;
}

void mbs_stages_forget_orders(mbs_stages_recursion *r)
{
    int k;
    for (k = 0; k < r->stages; ++k) {
        mbs_stages_inner *y = &r->stage[k].inner;
        if (y->n == 0)
            continue;
        y->pivots->ready = y->pivots->stage = 0;
        y->own = y->missing = y->poor = 0;
        y->stale = 1;
    }
}

static mbs_stages_complete complete(const mbs_stages_scratch *m, const mbs_stages_stage *s)
{
    mbs_stages_complete c;
    c.n = s->inner.n;
    c.rank = 0;
    c.a = m->block;
    c.row = m->spots;
    c.column = m->spots + c.n;
    c.work = m->vector[5];
    return c;
}

static mbs_stages_complete factorise_completely(const mbs_stages_recursion *r, const mbs_stages_scratch *m,
                                                const mbs_stages_stage *s)
{
    mbs_stages_complete c = complete(m, s);
    mbs_stages_factorise_completely(&c, &s->E, s->nx, r->zero_pivot);
    return c;
}

/* Variables and rows without pivots go to the recursion, as many as it has room for. */
static void defer(mbs_stages_stage *s, const mbs_stages_complete *c)
{
    mbs_stages_inner *y = &s->inner;
    int i;
    y->missing = c->n - c->rank;
    y->deferred = y->missing < y->spare ? y->missing : y->spare;
    for (i = 0; i < y->deferred; ++i) {
        y->variable[i] = c->column[c->rank + i];
        y->row[i] = c->row[c->rank + i];
    }
}

static void set_outer_sizes(mbs_stages_stage *s)
{
    s->dense.nv = s->nv - s->inner.n + s->inner.deferred;
    s->dense.n = s->nx + s->dense.nv;
    s->dense.ne = s->ne - s->inner.n + s->inner.deferred;
    s->inner.width = mbs_stages_width(s->dense.n);
}

/* B = -r_u, in the order of the rows of r. */
static void write_right(const mbs_stages_scratch *m, const mbs_stages_stage *s)
{
    const mbs_stages_inner *y = &s->inner;
    const mbs_stages_matrix *E = &s->E;
    const size_t width = (size_t)y->width;
    int i, j, l;
    memset(m->right, 0, (size_t)y->n * width * sizeof *m->right);
    for (j = 0; j < s->n; ++j) {
        const int at = mbs_stages_outer(s, j);
        for (l = E->begin[j]; at >= 0 && l < E->end[j] && E->row[l] < y->n; ++l)
            m->right[(size_t)E->row[l] * width + (size_t)at] = -E->value[l];
    }
    for (i = 0; i < y->deferred; ++i) {
        j = s->nx + y->variable[i];
        for (l = E->begin[j]; l < E->end[j] && E->row[l] < y->n; ++l)
            m->right[(size_t)E->row[l] * width + (size_t)(s->n - y->n + i)] = -E->value[l];
    }
}

/* Rows of V of outer variables, and of deferred ones. */
static void write_units(const mbs_stages_stage *s)
{
    const mbs_stages_inner *y = &s->inner;
    int i;
    for (i = 0; i < s->n; ++i)
        if (!is_inner(s, i)) {
            real *row = row_of_v(s, i);
            memset(row, 0, (size_t)y->width * sizeof *row);
            row[mbs_stages_outer(s, i)] = 1;
        }
    for (i = 0; i < y->deferred; ++i)
        row_of_v(s, s->nx + y->variable[i])[s->n - y->n + i] = 1;
}

/* Where number t of the stage's lane is. */
static const real *lane_of(const mbs_stages_inner *y, const real *numbers, int t)
{
    return numbers + (size_t)t * MBS_STAGES_TOGETHER + (size_t)y->lane;
}

/* S by the factors of the stage. */
static void solve_rows(const mbs_stages_scratch *m, const mbs_stages_stage *s)
{
    const mbs_stages_inner *y = &s->inner;
    const mbs_stages_pivots *p = y->pivots;
    const mbs_stages_factors *f = &y->factors;
    const int width = y->width - y->skip;
    real *B = m->right + y->skip, *S = read_part_of_v(s, s->nx);
    int i;
    for (i = 0; i < y->n; ++i)
        mbs_stages_combine(width, p->lower[i + 1] - p->lower[i], p->lower_row + p->lower[i],
                           lane_of(y, f->lower, p->lower[i]), MBS_STAGES_TOGETHER, B, y->width,
                           *lane_of(y, f->inverse, i), B + (size_t)p->row[i] * (size_t)y->width);
    for (i = y->n - 1; i >= 0; --i) {
        real *to = S + (size_t)p->column[i] * (size_t)y->width;
        memset(to - y->skip, 0, (size_t)y->skip * sizeof *to);
        memcpy(to, B + (size_t)p->row[i] * (size_t)y->width, (size_t)width * sizeof *to);
        mbs_stages_combine(width, p->upper[i + 1] - p->upper[i], p->upper_column + p->upper[i],
                           lane_of(y, f->upper, p->upper[i]), MBS_STAGES_TOGETHER, S, y->width, 1, to);
    }
}

int mbs_stages_group(const mbs_stages_recursion *r, int k)
{
    while (k < r->stages && r->stage[k].inner.lane > 0)
        ++k;
    return k;
}

int mbs_stages_after_group(const mbs_stages_recursion *r, int k)
{
    return mbs_stages_group(r, k + 1);
}

/* Factorise the inner equations of the group that begins at stage k, if any of them have new numbers. */
static void factorise_inner(const mbs_stages_recursion *r, const mbs_stages_scratch *m, int k)
{
    const int end = mbs_stages_after_group(r, k);
    mbs_stages_inner *first = &r->stage[k].inner;
    mbs_stages_pivots *p = first->pivots;
    mbs_stages_together several;
    int l, stale = 0;
    for (l = k; l < end; ++l) {
        stale |= r->stage[l].inner.stale;
        several.value[l - k] = r->stage[l].E.value;
    }
    if (!stale)
        return;
    several.count = end - k;
    first->factors.upper = first->factors.lower + (size_t)p->lower[p->n] * MBS_STAGES_TOGETHER;
    mbs_stages_factorise_together(p, &several, &first->factors, m->together[0], r->zero_pivot);
    for (l = k; l < end; ++l) {
        r->stage[l].inner.factors = first->factors;
        r->stage[l].inner.own = several.failed[l - k] >= 0;
    }
}

/* S by the factors that are there, or by complete pivoting. */
static void find_variation(const mbs_stages_recursion *r, const mbs_stages_scratch *m, mbs_stages_stage *s)
{
    mbs_stages_inner *y = &s->inner;
    y->deferred = y->missing = 0;
    if (y->own) {
        const mbs_stages_complete c = factorise_completely(r, m, s);
        defer(s, &c);
        set_outer_sizes(s);
        write_right(m, s);
        mbs_stages_solve_rows_completely(&c, y->width, m->right, row_of_v(s, s->nx));
    } else {
        set_outer_sizes(s);
        write_right(m, s);
        solve_rows(m, s);
    }
    write_units(s);
}

static void add_row(int width, real factor, const real *restrict a, real *restrict b)
{
    int i, c;
    for (i = 0; i < width; i += MBS_STAGES_LANES)
        for (c = 0; c < MBS_STAGES_LANES; ++c)
            b[i + c] += factor * a[i + c];
}

/* to += factor times row j of V */
static void add_variation(const mbs_stages_stage *s, int j, real factor, real *to)
{
    if (is_inner(s, j))
        add_row(s->inner.width - s->inner.skip, factor, read_part_of_v(s, j), to + s->inner.skip);
    else
        to[mbs_stages_outer(s, j)] += factor;
}

/* `to` = rows of A V; row i of A comes to place[i], or nowhere if that is -1; `count` rows in all. */
static void reduce_rows(const mbs_stages_scratch *m, const mbs_stages_stage *s, const mbs_stages_matrix *A,
                        const int *place, int count, real *to)
{
    const int width = s->inner.width;
    int j, l;
    if (count == 0)
        return;
    memset(m->right, 0, (size_t)count * (size_t)width * sizeof *m->right);
    for (j = 0; j < s->n; ++j)
        for (l = A->begin[j]; l < A->end[j]; ++l) {
            const int i = place ? place[A->row[l]] : A->row[l];
            if (i >= 0)
                add_variation(s, j, A->value[l], m->right + (size_t)i * (size_t)width);
        }
    mbs_stages_transpose(s->dense.n, count, m->right, width, to, count);
}

/* Rows of e of which rounding alone is left are 0, so that none of it becomes a pivot. */
static void clear_rounding(const mbs_stages_recursion *r, const mbs_stages_scratch *m, const mbs_stages_stage *s,
                           const int *place)
{
    real *size = m->vector[5], *left = m->vector[0];
    int i, j;
    mbs_stages_matrix_row_maxima(&s->E, size);
    for (i = 0; i < s->dense.ne; ++i)
        left[i] = 0;
    for (j = 0; j < s->dense.n; ++j)
        for (i = 0; i < s->dense.ne; ++i) {
            const real a = real_abs(s->dense.E[(size_t)j * (size_t)s->dense.ne + (size_t)i]);
            left[i] = a > left[i] ? a : left[i];
        }
    for (i = 0; i < s->ne; ++i)
        for (j = 0; place[i] >= 0 && !(left[place[i]] > r->zero_pivot * size[i]) && j < s->dense.n; ++j)
            s->dense.E[(size_t)j * (size_t)s->dense.ne + (size_t)place[i]] = 0;
}

/* Rows of e that the recursion sees: rows that are not inner, then deferred ones. */
static void place_rows(const mbs_stages_stage *s, int *place)
{
    const mbs_stages_inner *y = &s->inner;
    int i;
    for (i = 0; i < s->ne; ++i)
        place[i] = i < y->n ? -1 : i - y->n;
    for (i = 0; i < y->deferred; ++i)
        place[y->row[i]] = s->ne - y->n + i;
}

static void reduce_jacobians(const mbs_stages_recursion *r, const mbs_stages_scratch *m, mbs_stages_stage *s)
{
    place_rows(s, m->spots);
    reduce_rows(m, s, &s->E, m->spots, s->dense.ne, s->dense.E);
    if (s->dense.ne > 0)
        clear_rounding(r, m, s, m->spots);
    reduce_rows(m, s, &s->F, NULL, s->next, s->dense.F);
    reduce_rows(m, s, &s->G, NULL, s->ng, s->dense.G);
}

/* Row j of (H + diagonal) V from the diagonal on, and half of the diagonal; columns from `skip` on. */
static void find_half(const mbs_stages_recursion *r, const mbs_stages_stage *s, int j, int skip, real *half)
{
    const mbs_stages_matrix *H = &s->H;
    const real *v = row_of_v(s, j) + skip;
    const int width = s->inner.width - skip;
    real diagonal = r->diagonal[s->w + j];
    int i, l = H->begin[j];
    if (!r->plain && l < H->end[j] && H->row[l] == j)
        diagonal += H->value[l++];
    for (i = 0; i < width; ++i)
        half[i] = diagonal / 2 * v[i];
    if (!r->plain && l < H->end[j])
        mbs_stages_combine(width, H->end[j] - l, H->row + l, H->value + l, 1, s->inner.V + skip, s->inner.width, 1,
                           half);
}

/* H = VT Z + ZT V, with rows of Z as above. */
static void reduce_cost(const mbs_stages_recursion *r, const mbs_stages_scratch *m, mbs_stages_stage *s)
{
    const int n = s->dense.n, inner = s->inner.n, skip = s->inner.skip;
    const size_t width = (size_t)s->inner.width;
    real *M = m->product, *Z = m->right;
    int i, j;
    memset(M + (size_t)(s->n - inner) * width, 0, (width - (size_t)(s->n - inner)) * width * sizeof *M);
    for (j = 0; j < s->nx; ++j)
        find_half(r, s, j, 0, M + (size_t)j * width);
    for (j = s->nx + inner; j < s->n; ++j)
        find_half(r, s, j, 0, M + (size_t)(j - inner) * width);
    for (j = 0; j < inner; ++j)
        find_half(r, s, s->nx + j, skip, Z + (size_t)j * width + skip);
    mbs_stages_gram(inner, s->inner.width - skip, read_part_of_v(s, s->nx), Z + skip,
                    M + (size_t)skip * width + skip, s->inner.width);
    for (j = 0; j < n; ++j)
        for (i = j; i < n; ++i)
            s->dense.H[(size_t)j * (size_t)n + (size_t)i] =
                M[(size_t)i * width + (size_t)j] + M[(size_t)j * width + (size_t)i];
}

/* Copy matrices with patterns into dense ones. */
static void spread_matrices(const mbs_stages_recursion *r, const mbs_stages_stage *s)
{
    if (s->H.begin == NULL)
        return;
    mbs_stages_matrix_spread(&s->E, s->dense.E, s->ne);
    mbs_stages_matrix_spread(&s->F, s->dense.F, s->next);
    mbs_stages_matrix_spread(&s->G, s->dense.G, s->ng);
    if (!r->plain)
        mbs_stages_matrix_spread(&s->H, s->dense.H, s->n);
}

static void condense_stage(const mbs_stages_recursion *r, const mbs_stages_scratch *m, mbs_stages_stage *s)
{
    if (s->inner.n == 0) {
        spread_matrices(r, s);
        return;
    }
    if (s->inner.stale) {
        find_variation(r, m, s);
        reduce_jacobians(r, m, s);
        s->inner.stale = 0;
    }
    reduce_cost(r, m, s);
}

/* Condense the group that begins at stage k. */
static void condense_group(const mbs_stages_recursion *r, const mbs_stages_scratch *m, int k)
{
    const int end = mbs_stages_after_group(r, k), inner = r->stage[k].inner.n > 0;
    int l;
    for (l = k; inner && l < end; ++l)
        if (r->stage[l].inner.stale && !r->stage[l].inner.pivots->ready)
            r->stage[l].inner.own = 1;
    if (inner && r->stage[k].inner.pivots->ready)
        factorise_inner(r, m, k);
    for (l = k; l < end; ++l)
        condense_stage(r, m, &r->stage[l]);
}

void mbs_stages_condense(const mbs_stages_recursion *r, const mbs_stages_scratch *m, int from, int to)
{
    int k;
    for (k = mbs_stages_group(r, from); k < to; k = mbs_stages_after_group(r, k))
        condense_group(r, m, k);
}

/* The same for one stage, by complete pivoting. */
static void solve_inner_completely(const mbs_stages_recursion *r, const mbs_stages_scratch *m, mbs_stages_stage *s,
                                   const real *rc)
{
    mbs_stages_inner *y = &s->inner;
    const mbs_stages_complete c = factorise_completely(r, m, s);
    const real left = mbs_stages_solve_completely(&c, rc + s->e, y->constant);
    if (y->missing > y->deferred)
        y->left = left;
}

/* s = -r_y^-1 r; deferred variables are 0. */
void mbs_stages_solve_inner(const mbs_stages_recursion *r, const mbs_stages_scratch *m, int k, const real *rc)
{
    const mbs_stages_inner *first = &r->stage[k].inner;
    const int count = mbs_stages_after_group(r, k) - k;
    const real *b[MBS_STAGES_TOGETHER];
    int c, i;
    if (first->n == 0)
        return;
    for (c = 0; c < count; ++c)
        b[c] = rc + r->stage[k + c].e;
    if (first->pivots->ready)
        mbs_stages_solve_together(first->pivots, &first->factors, b, count, m->together[0], m->together[1]);
    for (c = 0; c < count; ++c) {
        mbs_stages_inner *y = &r->stage[k + c].inner;
        y->left = 0;
        if (y->own)
            solve_inner_completely(r, m, &r->stage[k + c], rc);
        for (i = 0; i < y->n; ++i)
            y->constant[i] = y->own ? -y->constant[i] : -*lane_of(y, m->together[0], i);
    }
}

void mbs_stages_condense_right(const mbs_stages_recursion *r, const mbs_stages_scratch *m, int k, real *gradient,
                               real *rows)
{
    const mbs_stages_stage *s = &r->stage[k];
    const mbs_stages_inner *y = &s->inner;
    real *z = m->vector[5];
    int i;
    memset(z, 0, (size_t)s->n * sizeof *z);
    memcpy(z + s->nx, y->constant, (size_t)y->n * sizeof *z);
    if (!r->plain)
        mbs_stages_matrix_apply_symmetric(&s->H, z, gradient);
    for (i = s->nx; i < s->nx + y->n; ++i)
        gradient[i] += r->diagonal[s->w + i] * z[i];
    if (s->dense.ne > 0)
        mbs_stages_matrix_apply(&s->E, z, rows);
    mbs_stages_matrix_apply(&s->F, z, rows + s->ne);
    mbs_stages_matrix_apply(&s->G, z, rows + s->ne + s->next);
}

void mbs_stages_condense_gradient(const mbs_stages_stage *s, const real *gradient, real *out)
{
    int i;
    memset(out, 0, (size_t)s->inner.width * sizeof *out);
    for (i = 0; i < s->n; ++i)
        add_variation(s, i, gradient[i], out);
}

static real dot(int width, const real *restrict a, const real *restrict b)
{
    real sum[MBS_STAGES_LANES] = {0};
    int i, c;
    for (i = 0; i < width; i += MBS_STAGES_LANES)
        for (c = 0; c < MBS_STAGES_LANES; ++c)
            sum[c] += a[i + c] * b[i + c];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

void mbs_stages_expand(const mbs_stages_stage *s, real *outer, real *z)
{
    const mbs_stages_inner *y = &s->inner;
    int i;
    for (i = s->dense.n; i < y->width; ++i)
        outer[i] = 0;
    for (i = 0; i < s->n; ++i)
        z[i] = is_inner(s, i) ? y->constant[i - s->nx] +
                                    dot(y->width - y->skip, read_part_of_v(s, i), outer + y->skip)
                              : outer[mbs_stages_outer(s, i)];
}

void mbs_stages_expand_gradient(const mbs_stages_recursion *r, const mbs_stages_scratch *m, int k, const real *rw,
                                const real *z, real *force, const real *dy)
{
    const mbs_stages_stage *s = &r->stage[k];
    const mbs_stages_inner *y = &s->inner;
    const real *gradient = force + s->nx;
    real *to = m->together[0] + y->lane;
    int i;
    for (i = s->nx; i < s->nx + y->n; ++i)
        force[i] += (rw ? rw[s->w + i] : 0) + r->diagonal[s->w + i] * z[i];
    if (!r->plain)
        mbs_stages_matrix_apply_symmetric(&s->H, z, force);
    if (s->dense.ne > 0)
        mbs_stages_matrix_apply_transposed(&s->E, dy + s->e, force);
    mbs_stages_matrix_apply_transposed(&s->F, dy + s->d, force);
    mbs_stages_matrix_apply_transposed(&s->G, dy + s->g, force);
    for (i = 0; i < y->n; ++i, to += MBS_STAGES_TOGETHER)
        *to = gradient[i];
}

/* The same for one stage, by complete pivoting. Multipliers of deferred rows are there. */
static void expand_completely(const mbs_stages_recursion *r, const mbs_stages_scratch *m, const mbs_stages_stage *s,
                              real *dy)
{
    const mbs_stages_inner *y = &s->inner;
    const mbs_stages_complete c = factorise_completely(r, m, s);
    real *gradient = m->vector[0], *found = m->vector[1];
    int i;
    for (i = 0; i < y->n; ++i)
        gradient[i] = *lane_of(y, m->together[0], i);
    mbs_stages_solve_completely_transposed(&c, gradient, found);
    for (i = 0; i < y->deferred; ++i)
        found[y->row[i]] = -dy[s->e + y->row[i]];
    for (i = 0; i < y->n; ++i)
        dy[s->e + i] = -found[i];
}

void mbs_stages_expand_multipliers(const mbs_stages_recursion *r, const mbs_stages_scratch *m, int k, real *dy)
{
    const mbs_stages_inner *first = &r->stage[k].inner;
    const int end = mbs_stages_after_group(r, k);
    int l, i;
    for (l = k; l < end; ++l)
        if (r->stage[l].inner.own)
            expand_completely(r, m, &r->stage[l], dy);
    if (!first->pivots->ready)
        return;
    mbs_stages_solve_together_transposed(first->pivots, &first->factors, m->together[0], m->together[1],
                                         m->together[2]);
    for (l = k; l < end; ++l) {
        const mbs_stages_inner *y = &r->stage[l].inner;
        for (i = 0; !y->own && i < y->n; ++i)
            dy[r->stage[l].e + i] = -*lane_of(y, m->together[1], i);
    }
}
