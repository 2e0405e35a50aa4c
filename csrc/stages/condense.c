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

/* The row of V of inner variable i of all variables. */
static real *row_of_v(const mbs_stages_stage *s, int i)
{
    return s->inner.V + (size_t)(i - s->nx) * (size_t)s->inner.ld;
}

/* The part of it that is not 0. */
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
        if (r->stage[k].inner.n > 0 && FAILING_SHARE * p->failed > p->stages) {
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
        if (r->stage[k].inner.n > 0 && !p->ready && p->stage <= k && tries < ORDER_TRIES && choose(r, k)) {
            ++tries;
            p->stage = k + 1;
        }
    }
    for (k = 0; k < r->stages; ++k)
        if (r->stage[k].inner.n > 0 && !r->stage[k].inner.pivots->ready && tries < ORDER_TRIES)
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
        y->own = y->missing = y->poor = y->careful = 0;
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
    c.largest = m->spots + 2 * c.n;
    c.nonzero = m->spots + 3 * c.n;
    c.work = m->vector[5];
    return c;
}

static mbs_stages_complete factorise_completely(const mbs_stages_recursion *r, const mbs_stages_scratch *m,
                                                const mbs_stages_stage *s)
{
    mbs_stages_complete c = complete(m, s);
    mbs_stages_least_pivots least;
    least.zero = r->zero_pivot;
    least.small = s->inner.careful ? r->small_pivot : r->zero_pivot;
    least.room = s->inner.spare;
    mbs_stages_factorise_completely(&c, &s->E, s->nx, &least);
    return c;
}

/* Whether inner variables grow by more than `most` with outer ones. */
static int grows(const mbs_stages_stage *s, real most)
{
    int i, j;
    for (i = s->nx; i < s->nx + s->inner.n; ++i) {
        const real *row = row_of_v(s, i);
        for (j = 0; j < s->dense.width; ++j)
            if (real_abs(row[j]) > most)
                return 1;
    }
    return 0;
}

int mbs_stages_mind_growth(mbs_stages_recursion *r, int from)
{
    const real most = r->lost || !MBS_STAGES_SEARCHES ? r->growth : MBS_STAGES_OVERGROWN * r->growth;
    int k, count = 0;
    for (k = from; k < r->stages; ++k) {
        mbs_stages_inner *y = &r->stage[k].inner;
        if (y->n == 0 || y->careful || !grows(&r->stage[k], most))
            continue;
        y->careful = y->stale = 1;
        ++count;
    }
    return count;
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
    s->dense.width = mbs_stages_width(s->dense.n);
    s->inner.ld = mbs_stages_lines(s->dense.width - s->inner.skip) + mbs_stages_lines(s->inner.skip);
}

/* Rows for right-hand sides, laid out as rows of V are. */
static real *right_of(const mbs_stages_scratch *m, const mbs_stages_stage *s)
{
    return m->right + (MBS_STAGES_WIDE ? s->inner.shift : 0);
}

/* B = -r_u, in the order of the rows of r. */
static void write_right(const mbs_stages_scratch *m, const mbs_stages_stage *s)
{
    const mbs_stages_inner *y = &s->inner;
    const mbs_stages_matrix *E = &s->E;
    const size_t ld = (size_t)y->ld;
    real *right = right_of(m, s);
    int i, j, l;
    memset(right, 0, ((size_t)y->n * ld - (size_t)y->shift) * sizeof *right);
    for (j = 0; j < s->n; ++j) {
        real *column = right + (j < s->nx ? j : j - y->n);
        for (l = E->begin[j]; !is_inner(s, j) && l < E->end[j] && E->row[l] < y->n; ++l)
            column[(size_t)E->row[l] * ld] = -E->value[l];
    }
    for (i = 0; i < y->deferred; ++i) {
        j = s->nx + y->variable[i];
        for (l = E->begin[j]; l < E->end[j] && E->row[l] < y->n; ++l)
            right[(size_t)E->row[l] * ld + (size_t)(s->n - y->n + i)] = -E->value[l];
    }
}

/* Rows of V of deferred variables. */
static void write_units(const mbs_stages_stage *s)
{
    const mbs_stages_inner *y = &s->inner;
    int i;
    for (i = 0; i < y->deferred; ++i)
        row_of_v(s, s->nx + y->variable[i])[s->n - y->n + i] = 1;
}

/* Where number t of the stage's lane is. */
static const real *lane_of(const mbs_stages_inner *y, const real *numbers, int t)
{
    return numbers + (size_t)t * MBS_STAGES_TOGETHER + (size_t)y->lane;
}

/* S by the factors of the stage; without vectors, row by row here, which takes less code. */
#if MBS_STAGES_ROOMY
static void solve_rows(const mbs_stages_scratch *m, const mbs_stages_stage *s)
{
    const mbs_stages_inner *y = &s->inner;
    int i;
    mbs_stages_solve_rows(y->pivots, &y->factors, y->lane, s->dense.width - y->skip, y->ld, right_of(m, s) + y->skip,
                          read_part_of_v(s, s->nx));
    for (i = 0; i < y->n && y->skip > 0; ++i)
        memset(row_of_v(s, s->nx + i), 0, (size_t)y->skip * sizeof *y->V);
}
#else
static void solve_rows(const mbs_stages_scratch *m, const mbs_stages_stage *s)
{
    const mbs_stages_inner *y = &s->inner;
    const mbs_stages_pivots *p = y->pivots;
    const mbs_stages_factors *f = &y->factors;
    const int ld = y->ld, width = ld - y->skip;
    real *B = m->right + y->skip, *S = read_part_of_v(s, s->nx);
    int i;
    for (i = 0; i < y->n; ++i) {
        real *row = B + (size_t)p->row[i] * (size_t)ld;
        mbs_stages_combine(width, p->lower[i + 1] - p->lower[i], p->lower_row + p->lower[i], 0,
                           lane_of(y, f->lower, p->lower[i]), MBS_STAGES_TOGETHER, B, ld, *lane_of(y, f->inverse, i),
                           row, row);
    }
    for (i = y->n - 1; i >= 0; --i) {
        real *to = S + (size_t)p->column[i] * (size_t)ld;
        int j;
        for (j = 0; j < y->skip; ++j)
            to[j - y->skip] = 0;
        mbs_stages_combine(width, p->upper[i + 1] - p->upper[i], p->upper_column + p->upper[i], 0,
                           lane_of(y, f->upper, p->upper[i]), MBS_STAGES_TOGETHER, S, ld, 1,
                           B + (size_t)p->row[i] * (size_t)ld, to);
    }
}
#endif

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
        r->stage[l].inner.own = several.failed[l - k] >= 0 || r->stage[l].inner.careful;
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
        mbs_stages_solve_rows_completely(&c, s->dense.width, y->ld, right_of(m, s), row_of_v(s, s->nx));
    } else {
        set_outer_sizes(s);
        write_right(m, s);
        solve_rows(m, s);
    }
    write_units(s);
    mbs_stages_find_few(&y->few, y->n, s->dense.width - y->skip, read_part_of_v(s, s->nx), y->ld);
}

/* to += factor times row j of V */
static void add_variation(const mbs_stages_stage *s, int j, real factor, real *to)
{
    if (is_inner(s, j))
        mbs_stages_add_row_few(&s->inner.few, j - s->nx, s->dense.width - s->inner.skip, factor, read_part_of_v(s, j),
                               to + s->inner.skip);
    else
        to[mbs_stages_outer(s, j)] += factor;
}

/* `to` = rows of A V; row i of A comes to place[i], or nowhere if that is -1; `count` rows in all. */
static void reduce_rows(const mbs_stages_stage *s, const mbs_stages_matrix *A, const int *place, int count, real *to)
{
    const size_t width = (size_t)s->dense.width;
    int j, l;
    if (count == 0)
        return;
    memset(to, 0, (size_t)count * width * sizeof *to);
    for (j = 0; j < s->n; ++j)
        for (l = A->begin[j]; l < A->end[j]; ++l) {
            const int i = place ? place[A->row[l]] : A->row[l];
            if (i >= 0)
                add_variation(s, j, A->value[l], to + (size_t)i * width);
        }
}

/* Rows of e of which rounding alone is left are 0, so that none of it becomes a pivot. */
static void clear_rounding(const mbs_stages_recursion *r, const mbs_stages_scratch *m, const mbs_stages_stage *s,
                           const int *place)
{
    real *size = m->vector[5];
    int i, j;
    mbs_stages_matrix_row_maxima(&s->E, size);
    for (i = 0; i < s->ne; ++i) {
        real *row, left = 0;
        if (place[i] < 0)
            continue;
        row = s->dense.E + (size_t)place[i] * (size_t)s->dense.width;
        for (j = 0; j < s->dense.n; ++j)
            left = real_abs(row[j]) > left ? real_abs(row[j]) : left;
        if (!(left > r->zero_pivot * size[i]))
            memset(row, 0, (size_t)s->dense.n * sizeof *row);
    }
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
    reduce_rows(s, &s->E, m->spots, s->dense.ne, s->dense.E);
    if (s->dense.ne > 0)
        clear_rounding(r, m, s, m->spots);
    reduce_rows(s, &s->F, NULL, s->next, s->dense.F);
    mbs_stages_find_few(&s->dense.few, s->next, s->dense.width, s->dense.F, s->dense.width);
    reduce_rows(s, &s->G, NULL, s->ng, s->dense.G);
}

/* Nonzeros of a column of H below its diagonal: of outer variables before inner ones from `begin` on, of inner ones
 * from `inner` on, of outer variables after them from `after` on. */
typedef struct {
    int begin, inner, after, end;
    real diagonal; /* the barrier's added */
} column;

static column find_column(const mbs_stages_recursion *r, const mbs_stages_stage *s, int j)
{
    const mbs_stages_matrix *H = &s->H;
    const int begin = H->begin[j], end = r->plain ? begin : H->end[j], own = begin < end && H->row[begin] == j;
    column c;
    c.end = c.after = end;
    c.diagonal = r->diagonal[s->w + j] + (own ? H->value[begin] : 0);
    c.begin = c.inner = begin + own;
    while (c.inner < end && H->row[c.inner] < s->nx)
        ++c.inner;
    while (c.after > c.inner && H->row[c.after - 1] >= s->nx + s->inner.n)
        --c.after;
    return c;
}

/* Add a row to row and column i of the lower triangle of a symmetric matrix. */
static void add_to_both(int n, const real *row, int i, real *lower, int width)
{
    int j;
    for (j = 0; j <= i; ++j)
        lower[(size_t)i * (size_t)width + (size_t)j] += row[j];
    for (j = i; j < n; ++j)
        lower[(size_t)j * (size_t)width + (size_t)i] += row[j];
}

/* The part of outer variable j in the cost: its own curvature, and that which it shares with later variables. */
static void add_outer_cost(const mbs_stages_recursion *r, const mbs_stages_scratch *m, mbs_stages_stage *s, int j)
{
    const mbs_stages_matrix *H = &s->H;
    const column c = find_column(r, s, j);
    const int width = s->dense.width, skip = s->inner.skip, at = mbs_stages_outer(s, j);
    real *to = s->dense.H + at, *row = right_of(m, s);
    int l;
    to[(size_t)at * (size_t)width] += c.diagonal;
    for (l = c.begin; l < c.inner; ++l)
        to[(size_t)H->row[l] * (size_t)width] += H->value[l];
    for (l = c.after; l < c.end; ++l)
        to[(size_t)(H->row[l] - s->inner.n) * (size_t)width] += H->value[l];
    if (c.inner == c.after)
        return;
    memset(row, 0, (size_t)width * sizeof *row);
    mbs_stages_combine(width - skip, c.after - c.inner, H->row + c.inner, s->nx, H->value + c.inner, 1,
                       s->inner.V + skip, s->inner.ld, 1, row + skip, row + skip);
    add_to_both(s->dense.n, row, at, s->dense.H, width);
}

/* Rows of inner variables of (H + diagonal) V: from the diagonal on, and `share` of the diagonal; columns from `skip` on.
 * Works in spots and vector[5]. */
#if MBS_STAGES_ROOMY
static void find_rows(const mbs_stages_recursion *r, const mbs_stages_scratch *m, const mbs_stages_stage *s, real share,
                      real *Z)
{
    const mbs_stages_matrix *H = &s->H;
    const mbs_stages_inner *y = &s->inner;
    int *begin = m->spots, *end = m->spots + y->n;
    real *diagonal = m->vector[5];
    mbs_stages_part part;
    int j, l;
    for (j = 0; j < y->n; ++j) {
        const column c = find_column(r, s, s->nx + j);
        begin[j] = c.inner;
        end[j] = c.after;
        diagonal[j] = share * c.diagonal;
    }
    part.first = s->nx;
    part.count = y->n;
    part.begin = begin;
    part.end = end;
    part.diagonal = diagonal;
    mbs_stages_matrix_multiply_rows(H, &part, s->dense.width - y->skip, y->ld, y->V + y->skip, Z);
    for (j = 0; j < y->n && !r->plain; ++j)
        for (l = end[j]; l < H->end[s->nx + j]; ++l)
            Z[(size_t)j * (size_t)y->ld + (size_t)(H->row[l] - y->n - y->skip)] += H->value[l];
}
#else
static void find_rows(const mbs_stages_recursion *r, const mbs_stages_scratch *m, const mbs_stages_stage *s, real share,
                      real *Z)
{
    const mbs_stages_matrix *H = &s->H;
    const int skip = s->inner.skip, ld = s->inner.ld, width = ld - skip;
    int j, l;
    (void)m;
    for (j = s->nx; j < s->nx + s->inner.n; ++j, Z += ld) {
        const column c = find_column(r, s, j);
        mbs_stages_scale_row(width, share * c.diagonal, read_part_of_v(s, j), Z);
        for (l = c.after; l < c.end; ++l)
            Z[H->row[l] - s->inner.n - skip] += H->value[l];
        mbs_stages_combine(width, c.after - c.inner, H->row + c.inner, s->nx, H->value + c.inner, 1, s->inner.V + skip, ld, 1,
                           Z, Z);
    }
}
#endif

/* The lower triangle of VT (H + diagonal) V: of inner variables ST Z + ZT S, or ST Z where they share no curvature. */
static void reduce_cost(const mbs_stages_recursion *r, const mbs_stages_scratch *m, mbs_stages_stage *s)
{
    const int inner = s->inner.n, width = s->dense.width, skip = s->inner.skip, columns = width - skip;
    const int curved = s->inner.curved && !r->plain, ld = s->inner.ld;
    real *S = s->inner.V + skip, *Z = right_of(m, s) + skip;
    real *H = s->dense.H, *to = H + (size_t)skip * (size_t)(width + 1);
    int j;
    memset(H, 0, (size_t)s->dense.n * (size_t)width * sizeof *H);
    for (j = 0; j < s->n; ++j)
        if (!is_inner(s, j))
            add_outer_cost(r, m, s, j);
    find_rows(r, m, s, curved ? (real)0.5 : 1, Z);
    mbs_stages_square_few(&s->inner.few, inner, columns, curved, S, ld, Z, ld, to, width);
}

/* Copy matrices of a stage without inner variables into dense ones. */
static void spread_matrices(const mbs_stages_recursion *r, const mbs_stages_stage *s)
{
    const mbs_stages_dense *d = &s->dense;
    mbs_stages_matrix_spread(&s->E, 0, d->E, d->width);
    mbs_stages_matrix_spread(&s->F, 0, d->F, d->width);
    mbs_stages_find_few(&d->few, s->next, d->width, d->F, d->width);
    mbs_stages_matrix_spread(&s->G, 0, d->G, d->width);
    if (!r->plain)
        mbs_stages_matrix_spread(&s->H, 1, d->H, d->width);
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
    const int end = s->nx + y->n;
    real *z = m->vector[5];
    int i;
    memset(z, 0, (size_t)s->n * sizeof *z);
    memcpy(z + s->nx, y->constant, (size_t)y->n * sizeof *z);
    if (!r->plain && y->curved)
        mbs_stages_matrix_apply_symmetric(&s->H, z, gradient);
    for (i = s->nx; i < end; ++i)
        gradient[i] += r->diagonal[s->w + i] * z[i];
    if (s->dense.ne > 0)
        mbs_stages_matrix_apply(&s->E, s->nx, end, z, rows);
    mbs_stages_matrix_apply(&s->F, s->nx, end, z, rows + s->ne);
    mbs_stages_matrix_apply(&s->G, s->nx, end, z, rows + s->ne + s->next);
}

void mbs_stages_condense_gradient(const mbs_stages_stage *s, const real *gradient, real *out)
{
    const mbs_stages_inner *y = &s->inner;
    int i;
    memset(out, 0, (size_t)s->dense.width * sizeof *out);
    memcpy(out, gradient, (size_t)s->nx * sizeof *out);
    for (i = s->nx + y->n; i < s->n; ++i)
        out[i - y->n] = gradient[i];
    mbs_stages_add_rows_few(&y->few, y->n, s->dense.width - y->skip, gradient + s->nx, y->V + y->skip, y->ld,
                            out + y->skip);
}

void mbs_stages_expand(const mbs_stages_stage *s, const real *outer, real *z)
{
    const mbs_stages_inner *y = &s->inner;
    int i;
    for (i = 0; i < s->n; ++i)
        z[i] = is_inner(s, i) ? y->constant[i - s->nx] +
                                    mbs_stages_dot_few(&y->few, i - s->nx, s->dense.width - y->skip,
                                                       read_part_of_v(s, i), outer + y->skip)
                              : outer[mbs_stages_outer(s, i)];
}

void mbs_stages_expand_gradient(const mbs_stages_recursion *r, const mbs_stages_scratch *m, int k, const real *rw,
                                const real *z, real *force, const real *dy)
{
    const mbs_stages_stage *s = &r->stage[k];
    const mbs_stages_inner *y = &s->inner;
    const real *gradient = force + s->nx;
    real *to = m->together[0] + y->lane;
    const int end = s->nx + y->n;
    int i;
    for (i = s->nx; i < end; ++i)
        force[i] += (rw ? rw[s->w + i] : 0) + r->diagonal[s->w + i] * z[i];
    if (!r->plain && y->curved)
        mbs_stages_matrix_apply_symmetric(&s->H, z, force);
    if (s->dense.ne > 0)
        mbs_stages_matrix_apply_transposed(&s->E, s->nx, end, dy + s->e, force);
    mbs_stages_matrix_apply_transposed(&s->F, s->nx, end, dy + s->d, force);
    mbs_stages_matrix_apply_transposed(&s->G, s->nx, end, dy + s->g, force);
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
