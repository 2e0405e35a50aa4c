/* The recursion over stages: assemble each step from the stage, and from the cost and rows of the next state.
 *
 * A row of e or g that gives (compliance D > 0) costs (J dw + rc)^2 / (2 D), and dy = (J dw + rc) / D. Where d gives,
 * the next state is the prediction and a deviation t at a cost of t.t / (2 D): see soft.h.
 *
 * Work within stages comes before a pass through them, or after it, and may be done for several stages at once. */
#include "condense.h"
#include "step.h"

#include <string.h>

/* Whether states deviate from the dynamics; they never do where there is no restoration. */
static int is_soft(const mbs_stages_recursion *r)
{
    return MBS_STAGES_SEARCHES && r->soft_dynamics;
}

void mbs_stages_for_all(const mbs_stages_recursion *r, mbs_stages_task task, void *data)
{
    if (r->team)
        r->team->spread(r->team->pool, r->stages, task, data);
    else
        task(data, 0, r->stages, 0);
}

/* A row of (e, g) of a stage: its place in flat rows, and its derivatives. */
typedef struct {
    int place;
    const real *derivative;
} stage_row;

/* Rows of e that are not inner ones, deferred ones, rows of g. */
static stage_row row_of(const mbs_stages_stage *s, int i)
{
    const int ne = s->dense.ne, own = s->ne - s->inner.n, width = s->dense.width;
    stage_row row;
    if (i < ne) {
        row.place = s->e + (i < own ? s->inner.n + i : s->inner.row[i - own]);
        row.derivative = s->dense.E + (size_t)i * (size_t)width;
    } else {
        row.place = s->g + (i - ne);
        row.derivative = s->dense.G + (size_t)(i - ne) * (size_t)width;
    }
    return row;
}

static int count_rows(const mbs_stages_stage *s)
{
    return s->dense.ne + s->ng;
}

/* What a prediction of the state of stage k costs, and what it must meet. Rows of P and C have `width` numbers. */
typedef struct {
    const real *P, *p, *C, *c;
    int rows, width;
} entrance;

static entrance enter(const mbs_stages_recursion *r, int k)
{
    const mbs_stages_step *s = &r->step[k];
    entrance e;
    e.P = is_soft(r) ? r->soft[k - 1].P : s->P;
    e.p = is_soft(r) ? r->soft[k - 1].p : s->p;
    e.C = s->C;
    e.c = s->c;
    e.rows = is_soft(r) ? 0 : s->passed;
    e.width = mbs_stages_width(s->nx);
    return e;
}

/* Q = H + diagonal + curvature, lower triangle. Where variables were condensed, H holds the diagonal already. */
static void start_cost(const mbs_stages_recursion *r, const mbs_stages_stage *s, real *Q)
{
    const size_t n = (size_t)s->dense.n, width = (size_t)s->dense.width;
    size_t i;
    if (r->plain && s->inner.n == 0)
        memset(Q, 0, n * width * sizeof *Q);
    else
        memcpy(Q, s->dense.H, n * width * sizeof *Q);
    for (i = 0; i < n; ++i)
        Q[i * width + i] += s->curvature + (s->inner.n == 0 ? r->diagonal[(size_t)s->w + i] : 0);
}

static int count_soft(const mbs_stages_recursion *r, const mbs_stages_stage *s)
{
    int i, soft = 0;
    for (i = 0; i < count_rows(s); ++i)
        soft += r->compliance[row_of(s, i).place] > 0;
    return soft;
}

/* Q += JT J / compliance, of the rows that give. */
static void add_soft_rows(const mbs_stages_recursion *r, const mbs_stages_stage *s, real *Q, real *rows, real *scaled)
{
    const int width = s->dense.width, soft = count_soft(r, s);
    int i, j, at = 0;
    for (i = 0; i < count_rows(s) && at < soft; ++i) {
        const stage_row row = row_of(s, i);
        const real give = r->compliance[row.place];
        const size_t to = (size_t)at * (size_t)width;
        if (!(give > 0))
            continue;
        memcpy(rows + to, row.derivative, (size_t)width * sizeof *rows);
        for (j = 0; j < width; ++j)
            scaled[to + (size_t)j] = row.derivative[j] / give;
        ++at;
    }
    mbs_stages_gram(soft, width, width, 1, 1, rows, width, scaled, width, Q, width);
}

/* Q += FT P F, with the cost P of the next state. With the first states x1 that are carried alone,
 *
 *     F = (f 0; 0 F2),   P = (P11 P12; P21 P22),   FT P F = (f P11 f, f P12 F2; F2T P21 f, F2T P22 F2). */
static void add_next_cost(const mbs_stages_stage *s, const entrance *next, real *Q, real *product)
{
    const int first = MBS_STAGES_SEARCHES ? s->carried : 0, m = s->next - first, width = s->dense.width, columns = width - first;
    const size_t ld = (size_t)width, ldp = (size_t)next->width, from = (size_t)first;
    const real *F = s->dense.F, *F2 = F + from * (ld + 1);
    real *below = product + from * ld, *corner = Q + from * (ld + 1);
    size_t i, j;
    memset(product, 0, ldp * ld * sizeof *product);
    mbs_stages_product_few(&s->dense.few, first, first, m, columns, next->P + from * (ldp + 1), next->width, F2, width,
                           below + from, width);
    mbs_stages_gram_few(&s->dense.few, first, first, m, columns, columns, 1, F2, width, below + from, width, corner,
                        width);
    for (i = from; i < (size_t)s->next; ++i)
        for (j = 0; j < from; ++j)
            product[i * ld + j] = next->P[i * ldp + j] * F[j * (ld + 1)];
    if (first > 0)
        mbs_stages_gram_few(&s->dense.few, first, first, m, columns, first, 0, F2, width, below, width, Q + from * ld,
                            width);
    for (i = 0; i < from; ++i)
        for (j = 0; j <= i; ++j)
            Q[i * ld + j] += F[i * (ld + 1)] * next->P[i * ldp + j] * F[j * (ld + 1)];
}

/* Add a row that holds exactly: derivatives, or a unit vector where there are none. */
static void add_row(mbs_stages_step *p, const real *derivative, int unit)
{
    int j;
    for (j = 0; j < p->n; ++j)
        p->lu[(size_t)j * (size_t)p->capacity + (size_t)p->rows] = derivative ? derivative[j] : (real)(j == unit);
    ++p->rows;
}

/* Whether variable i of stage k is fixed by a row of this stage. Fixed first states are rows of the root. */
static int has_row(const mbs_stages_recursion *r, int k, int i)
{
    return r->fixed[r->stage[k].w + i] && !(k == 0 && i < r->stage[k].nx);
}

/* Conditions on the next state, as rows of stage k. */
static void stack_conditions(const mbs_stages_recursion *r, int k, real *row)
{
    const mbs_stages_stage *s = &r->stage[k];
    const entrance q = enter(r, k + 1);
    const int width = s->dense.width;
    int i;
    for (i = 0; i < q.rows; ++i) {
        memset(row, 0, (size_t)width * sizeof *row);
        mbs_stages_add_rows(width, s->next, 1, q.C + (size_t)i * (size_t)q.width, 1, s->dense.F, width, row);
        add_row(&r->step[k], row, 0);
    }
}

/* Rows that hold exactly: of (e, g), of fixed variables, of conditions on the next state. */
static void stack_rows(const mbs_stages_recursion *r, int k)
{
    const mbs_stages_stage *s = &r->stage[k];
    mbs_stages_step *p = &r->step[k];
    int i;
    p->rows = 0;
    for (i = 0; i < count_rows(s); ++i) {
        const stage_row row = row_of(s, i);
        if (!(r->compliance[row.place] > 0))
            add_row(p, row.derivative, 0);
    }
    for (i = 0; i < s->n; ++i)
        if (has_row(r, k, i))
            add_row(p, mbs_stages_variation(s, i), mbs_stages_outer(s, i));
    p->own = p->rows;
    if (s->next > 0)
        stack_conditions(r, k, r->work[0]);
}

static void condense_stages(void *recursion, int from, int to, int worker)
{
    const mbs_stages_recursion *r = recursion;
    mbs_stages_condense(r, &r->scratch[worker], from, to);
}

/* Condense the group of stage k, the last one of it, while the recursion has it in the cache. */
static void condense_next(mbs_stages_recursion *r, int k)
{
    const int first = k - r->stage[k].inner.lane;
    condense_stages(r, first, k + 1, 0);
    r->condensed = first;
}

/* Reduce a step to its first variables; `lost`: where it fails, digits may be lost. */
static int reduce(mbs_stages_recursion *r, mbs_stages_step *p, real *quadratic)
{
    const int failed = mbs_stages_reduce(p, quadratic, r->work, r->zero_pivot, r->zero_curvature);
    if (MBS_STAGES_SEARCHES)
        r->lost = p->lost;
    return failed;
}

static int factorise_stage(mbs_stages_recursion *r, int k)
{
    mbs_stages_stage *s = &r->stage[k];
    mbs_stages_step *p = &r->step[k];
    real *Q = r->work[3];
    if (k < r->condensed)
        condense_next(r, k);
    s->inner.poor = s->inner.own && s->inner.missing == 0 && !s->inner.careful;
    p->n = s->dense.n;
    p->nv = s->dense.nv;
    start_cost(r, s, Q);
    add_soft_rows(r, s, Q, r->work[0], r->work[1]);
    if (s->next > 0) {
        const entrance next = enter(r, k + 1);
        add_next_cost(s, &next, Q, r->work[0]);
    }
    stack_rows(r, k);
    return reduce(r, p, Q);
}

static int soften(mbs_stages_recursion *r, int k)
{
    const mbs_stages_stage *next = &r->stage[k + 1];
    r->lost = 1;
    return mbs_stages_soften(&r->soft[k], r->step[k + 1].P, r->compliance + r->stage[k].d, r->fixed + next->w,
                             r->zero_curvature);
}

/* The first state is free, except for the rows passed to it and for its fixed variables. */
static int factorise_root(mbs_stages_recursion *r)
{
    const mbs_stages_step *q = &r->step[0];
    mbs_stages_step *p = &r->root;
    const size_t width = (size_t)mbs_stages_width(q->nx);
    int i;
    p->rows = 0;
    for (i = 0; i < q->passed; ++i)
        add_row(p, q->C + (size_t)i * width, 0);
    for (i = 0; i < q->nx; ++i)
        if (r->fixed[r->stage[0].w + i])
            add_row(p, NULL, i);
    return reduce(r, p, q->P);
}

static int dependent_rows(const mbs_stages_step *p)
{
    return p->rows - p->pivots - p->passed;
}

/* Nothing is condensed yet; a team condenses all stages at once. */
static void condense_anew(mbs_stages_recursion *r)
{
    mbs_stages_order_pivots(r);
    r->condensed = r->stages;
    if (r->team) {
        mbs_stages_for_all(r, condense_stages, r);
        r->condensed = 0;
    }
}

int mbs_stages_factorise(mbs_stages_recursion *r, int again)
{
    int k;
    if (!again)
        condense_anew(r);
    r->dependent = r->singular = 0;
    for (k = r->stages - 1; k >= 0; --k) {
        if (factorise_stage(r, k))
            return k;
        r->dependent += dependent_rows(&r->step[k]);
        r->singular += r->stage[k].inner.missing > 0;
        if (k > 0 && is_soft(r) && soften(r, k - 1))
            return k;
    }
    if (factorise_root(r))
        return 0;
    r->dependent += dependent_rows(&r->root);
    return -1;
}

/* gradient += AT (rows / compliance), of rows that give, from `first` on; the constants of the others follow each other.
 * Row 0 has the compliance at `place`. Returns how many constants there are. */
static int collect_rows(const mbs_stages_recursion *r, const mbs_stages_scratch *m, const mbs_stages_matrix *A,
                        int first, int place, const real *rows, real *gradient, real *constant)
{
    real *force = m->vector[5];
    int i, exact = 0;
    for (i = 0; i < first; ++i)
        force[i] = 0;
    for (i = first; i < A->rows; ++i) {
        const real give = r->compliance[place + i];
        force[i] = give > 0 ? rows[i] / give : 0;
        if (!(give > 0))
            constant[exact++] = rows[i];
    }
    if (exact < A->rows - first)
        mbs_stages_matrix_apply_transposed(A, 0, A->columns, force, gradient);
    return exact;
}

/* Rows of stage k, and the derivatives of its cost. */
static void collect_all_rows(const mbs_stages_recursion *r, const mbs_stages_scratch *m, int k, const real *rows,
                             real *gradient, real *constant)
{
    const mbs_stages_stage *s = &r->stage[k];
    const mbs_stages_inner *y = &s->inner;
    int i, at = collect_rows(r, m, &s->E, y->n, s->e, rows, gradient, constant);
    for (i = 0; i < y->deferred; ++i)
        constant[at++] = rows[y->row[i]];
    at += collect_rows(r, m, &s->G, 0, s->g, rows + s->ne + s->next, gradient, constant + at);
    for (i = 0; i < s->n; ++i)
        if (has_row(r, k, i))
            constant[at++] = mbs_stages_outer(s, i) < 0 ? y->constant[i - s->nx] : 0;
}

/* Right-hand sides and solutions of a sweep; `rw` may be NULL where there is no sweep back: 0. */
typedef struct {
    const mbs_stages_recursion *r;
    const real *rw, *rc;
    real *dw, *dy;
    int first; /* fixed variables from here on do not move */
} sweep;

/* Right-hand sides of stage k, of its cost and of its rows, without the stages after it. */
static void collect_stage(const sweep *t, const mbs_stages_scratch *m, int k)
{
    const mbs_stages_recursion *r = t->r;
    const mbs_stages_stage *s = &r->stage[k];
    mbs_stages_step *p = &r->step[k];
    real *gradient = s->inner.n > 0 ? m->vector[6] : p->linear, *rows = m->vector[7];
    memcpy(gradient, t->rw + s->w, (size_t)s->n * sizeof *gradient);
    memcpy(rows, t->rc + s->e, (size_t)(s->ne + s->next + s->ng) * sizeof *rows);
    if (s->inner.n > 0)
        mbs_stages_condense_right(r, m, k, gradient, rows);
    collect_all_rows(r, m, k, rows, gradient, p->constant);
    memcpy(p->ahead, rows + s->ne, (size_t)s->next * sizeof *rows);
    if (s->inner.n > 0)
        mbs_stages_condense_gradient(s, gradient, p->linear);
}

static void collect_stages(void *data, int from, int to, int worker)
{
    const sweep *t = data;
    const mbs_stages_scratch *m = &t->r->scratch[worker];
    int k, end;
    for (k = mbs_stages_group(t->r, from); k < to; k = end) {
        int l;
        end = mbs_stages_after_group(t->r, k);
        mbs_stages_solve_inner(t->r, m, k, t->rc);
        for (l = k; l < end; ++l)
            collect_stage(t, m, l);
    }
}

/* out = a + B x; B has `count` rows */
static void add_products(int count, int width, const real *a, const real *B, const real *x, real *out)
{
    int i;
    for (i = 0; i < count; ++i, B += width)
        out[i] = a[i] + mbs_stages_dot(width, B, x);
}

/* Add what the next state costs, and what it must meet. */
static void collect_next(const mbs_stages_recursion *r, int k)
{
    const mbs_stages_stage *s = &r->stage[k];
    const mbs_stages_step *p = &r->step[k];
    const entrance q = enter(r, k + 1);
    real *price = r->scratch[0].vector[2];
    memcpy(price, q.p, (size_t)s->next * sizeof *price);
    mbs_stages_add_rows(q.width, s->next, 1, p->ahead, 1, q.P, q.width, price); /* P is symmetric */
    mbs_stages_add_rows(s->dense.width, s->next, 1, price, 1, s->dense.F, s->dense.width, p->linear);
    add_products(q.rows, q.width, q.c, q.C, p->ahead, p->constant + p->own);
}

static void note_left(mbs_stages_recursion *r, real left)
{
    r->left = left > r->left ? left : r->left;
}

/* Fixed first states change by `first`, or not at all if it is NULL. */
static void sweep_root(mbs_stages_recursion *r, const real *first)
{
    const mbs_stages_step *q = &r->step[0];
    real *constant = r->scratch[0].vector[1];
    int i, at = q->passed;
    memcpy(constant, q->c, (size_t)q->passed * sizeof *constant);
    for (i = 0; i < q->nx; ++i)
        if (r->fixed[r->stage[0].w + i])
            constant[at++] = first ? -first[i] : 0;
    mbs_stages_step_back(&r->root, q->p, constant, r->scratch[0].vector[3]);
}

static void sweep_back(mbs_stages_recursion *r)
{
    int k;
    r->left = 0;
    for (k = r->stages - 1; k >= 0; --k) {
        mbs_stages_step *p = &r->step[k];
        if (r->stage[k].next > 0)
            collect_next(r, k);
        mbs_stages_step_back(p, p->linear, p->constant, r->scratch[0].vector[3]);
        note_left(r, r->stage[k].inner.left);
        note_left(r, p->left);
        if (k > 0 && is_soft(r))
            mbs_stages_soften_linear(&r->soft[k - 1], p->p, r->compliance + r->stage[k - 1].d);
    }
    sweep_root(r, NULL);
    note_left(r, r->root.left);
}

/* The next state `x`, and its multipliers of conditions on it. Where the dynamics give, fixed states are the only rows of
 * the next state, and nobody asks for their multipliers. */
static void advance(const mbs_stages_recursion *r, int k, real *x, real *passed, real *dy)
{
    const mbs_stages_stage *s = &r->stage[k];
    const mbs_stages_step *p = &r->step[k];
    memcpy(passed, p->constant + p->own, (size_t)enter(r, k + 1).rows * sizeof *passed);
    add_products(s->next, s->dense.width, p->ahead, s->dense.F, p->linear, x);
    if (is_soft(r)) {
        mbs_stages_deviate(&r->soft[k], r->compliance + s->d, x, dy + s->d);
        memset(passed, 0, (size_t)s->next * sizeof *passed);
    }
}

/* The step of the recursion's variables, and the multipliers of rows that hold exactly. */
static void sweep_ahead(const mbs_stages_recursion *r, real *dy)
{
    real *const *vector = r->scratch[0].vector;
    real *exact = vector[1], *x = vector[2], *passed = vector[4];
    int k;
    mbs_stages_step_ahead(&r->root, x, passed, x, exact, vector[3]);
    memcpy(passed, exact, (size_t)r->step[0].passed * sizeof *passed);
    for (k = 0; k < r->stages; ++k) {
        const mbs_stages_step *p = &r->step[k];
        mbs_stages_step_ahead(p, x, passed, p->linear, p->constant, vector[3]);
        if (r->stage[k].next > 0)
            advance(r, k, x, passed, dy);
    }
}

/* Multipliers of rows from `first` on: of rows that give from their residuals, of the others from `exact`. Row 0 has its
 * number at `place`. Returns how many of `exact` it took. */
static int spread_rows(const mbs_stages_recursion *r, const mbs_stages_matrix *A, int first, int place, const real *z,
                       const real *rc, const real *exact, real *dy)
{
    real *residual = dy + place;
    int i, taken = 0, soft = 0;
    for (i = first; i < A->rows; ++i)
        soft += r->compliance[place + i] > 0;
    memcpy(residual, rc + place, (size_t)A->rows * sizeof *residual);
    if (soft > 0)
        mbs_stages_matrix_apply(A, 0, A->columns, z, residual);
    for (i = 0; i < first; ++i)
        residual[i] = 0;
    for (i = first; i < A->rows; ++i) {
        const real give = r->compliance[place + i];
        residual[i] = give > 0 ? residual[i] / give : exact[taken++];
    }
    return taken;
}

/* Multipliers of rows of stage k except inner ones; `force`: multipliers of fixed inner variables, 0 for others. */
static void spread_multipliers(const mbs_stages_recursion *r, int k, const real *z, const real *rc, const real *exact,
                               real *force, real *dy)
{
    const mbs_stages_stage *s = &r->stage[k];
    const mbs_stages_inner *y = &s->inner;
    int i, at = spread_rows(r, &s->E, y->n, s->e, z, rc, exact, dy);
    for (i = 0; i < y->deferred; ++i)
        dy[s->e + y->row[i]] = exact[at++];
    at += spread_rows(r, &s->G, 0, s->g, z, rc, exact + at, dy);
    for (i = 0; i < s->n; ++i) {
        const int fixed = has_row(r, k, i);
        force[i] = fixed && mbs_stages_outer(s, i) < 0 ? exact[at] : 0;
        at += fixed;
    }
}

/* Multipliers of the dynamics from stage k, where these hold exactly. */
static void price_next(const mbs_stages_recursion *r, int k, real *price, real *dy)
{
    const mbs_stages_stage *s = &r->stage[k];
    const mbs_stages_step *p = &r->step[k], *q = &r->step[k + 1];
    const int width = mbs_stages_width(s->next);
    memcpy(price, q->p, (size_t)s->next * sizeof *price);
    mbs_stages_add_rows(width, s->next, 1, q->linear, 1, q->P, width, price); /* P is symmetric */
    mbs_stages_add_rows(width, q->passed, 1, p->constant + p->own, 1, q->C, width, price);
    memcpy(dy + s->d, price, (size_t)s->next * sizeof *dy);
}

/* All variables and multipliers of stage k, from the recursion's, but inner multipliers. */
static void expand_stage(const sweep *t, const mbs_stages_scratch *m, int k)
{
    const mbs_stages_recursion *r = t->r;
    const mbs_stages_stage *s = &r->stage[k];
    const mbs_stages_step *p = &r->step[k];
    real *z = t->dw + s->w, *force = m->vector[7];
    int i;
    if (s->inner.n > 0)
        mbs_stages_expand(s, p->linear, z);
    else
        memcpy(z, p->linear, (size_t)s->n * sizeof *z);
    spread_multipliers(r, k, z, t->rc, p->constant, force, t->dy);
    if (s->next > 0 && !is_soft(r))
        price_next(r, k, m->vector[2], t->dy);
    if (s->inner.n > 0)
        mbs_stages_expand_gradient(r, m, k, t->rw, z, force, t->dy);
    for (i = s->w; i < s->w + s->n; ++i)
        if (i >= t->first && r->fixed[i])
            t->dw[i] = 0;
}

static void expand_stages(void *data, int from, int to, int worker)
{
    const sweep *t = data;
    const mbs_stages_scratch *m = &t->r->scratch[worker];
    int k, end;
    for (k = mbs_stages_group(t->r, from); k < to; k = end) {
        int l;
        end = mbs_stages_after_group(t->r, k);
        for (l = k; l < end; ++l)
            expand_stage(t, m, l);
        if (t->r->stage[k].inner.n > 0)
            mbs_stages_expand_multipliers(t->r, m, k, t->dy);
    }
}

void mbs_stages_sweep(mbs_stages_recursion *r, const real *rw, const real *rc, real *dw, real *dy)
{
    sweep t;
    t.r = r;
    t.rw = rw;
    t.rc = rc;
    t.dw = dw;
    t.dy = dy;
    t.first = 0;
    mbs_stages_for_all(r, collect_stages, &t);
    sweep_back(r);
    sweep_ahead(r, dy);
    mbs_stages_for_all(r, expand_stages, &t);
}

static void clear_sweep(mbs_stages_step *p, int next)
{
    const size_t pivots = (size_t)p->pivots;
    memset(p->p, 0, (size_t)p->nx * sizeof *p->p);
    memset(p->c, 0, (size_t)p->nx * sizeof *p->c);
    memset(p->l, 0, (size_t)p->nv * sizeof *p->l);
    memset(p->t, 0, pivots * sizeof *p->t);
    memset(p->qp, 0, pivots * sizeof *p->qp);
    memset(p->ahead, 0, (size_t)next * sizeof *p->ahead);
}

void mbs_stages_respond(mbs_stages_recursion *r, const real *first, const real *zero, real *dw, real *dy)
{
    sweep t;
    int k;
    t.r = r;
    t.rw = NULL;
    t.rc = zero;
    t.dw = dw;
    t.dy = dy;
    t.first = r->stage[0].nx;
    for (k = 0; k < r->stages; ++k) {
        clear_sweep(&r->step[k], r->stage[k].next);
        if (r->stage[k].inner.n > 0)
            memset(r->stage[k].inner.constant, 0, (size_t)r->stage[k].inner.n * sizeof *dw);
    }
    sweep_root(r, first);
    sweep_ahead(r, dy);
    mbs_stages_for_all(r, expand_stages, &t);
}

/* The state of stage k is subtracted in the rows of d before it. */
static void add_stage_transposed(const mbs_stages_recursion *r, int k, const real *y, real *out)
{
    const mbs_stages_stage *s = &r->stage[k];
    int i;
    for (i = 0; k > 0 && i < s->nx; ++i)
        out[s->w + i] -= y[r->stage[k - 1].d + i];
    mbs_stages_matrix_apply_transposed(&s->E, 0, s->n, y + s->e, out + s->w);
    mbs_stages_matrix_apply_transposed(&s->F, 0, s->n, y + s->d, out + s->w);
    mbs_stages_matrix_apply_transposed(&s->G, 0, s->n, y + s->g, out + s->w);
}

void mbs_stages_add_stage_both(const mbs_stages_recursion *r, int k, const real *w, real *rows, const real *y,
                               real *gradient)
{
    const mbs_stages_stage *s = &r->stage[k];
    int i;
    for (i = 0; k > 0 && i < s->nx; ++i)
        gradient[s->w + i] -= y[r->stage[k - 1].d + i];
    for (i = 0; i < s->next; ++i)
        rows[s->d + i] -= w[r->stage[k + 1].w + i];
    mbs_stages_matrix_apply_both(&s->E, w + s->w, rows + s->e, y + s->e, gradient + s->w);
    mbs_stages_matrix_apply_both(&s->F, w + s->w, rows + s->d, y + s->d, gradient + s->w);
    mbs_stages_matrix_apply_both(&s->G, w + s->w, rows + s->g, y + s->g, gradient + s->w);
}

/* What is added to what. */
typedef struct {
    const mbs_stages_recursion *r;
    const real *y;
    real *out;
} addition;

static void add_transposed(void *data, int from, int to, int worker)
{
    const addition *a = data;
    int k;
    (void)worker;
    for (k = from; k < to; ++k)
        add_stage_transposed(a->r, k, a->y, a->out);
}

void mbs_stages_add_transposed(const mbs_stages_recursion *r, const real *y, real *out)
{
    addition a;
    a.r = r;
    a.y = y;
    a.out = out;
    mbs_stages_for_all(r, add_transposed, &a);
}
