/* The recursion over stages: assemble each step from the stage, and from the cost and rows of the next state.
 *
 * A row of e or g that gives (compliance D > 0) costs (J dw + rc)^2 / (2 D), and dy = (J dw + rc) / D. Where d gives,
 * the next state is the prediction and a deviation t at a cost of t.t / (2 D): see soft.h.
 *
 * Work within stages comes before a pass through them, or after it, and may be done for several stages at once. */
#include "condense.h"
#include "step.h"

#include <string.h>

void mbs_stages_for_all(const mbs_stages_recursion *r, mbs_stages_task task, void *data)
{
    if (r->team)
        r->team->spread(r->team->pool, r->stages, task, data);
    else
        task(data, 0, r->stages, 0);
}

/* A row of (e, g) of a stage: its place in flat rows, and its derivatives, `stride` apart. */
typedef struct {
    int place, stride;
    const real *derivative;
} stage_row;

/* Rows of e that are not inner ones, deferred ones, rows of g. */
static stage_row row_of(const mbs_stages_stage *s, int i)
{
    const int ne = s->dense.ne, own = s->ne - s->inner.n;
    stage_row row;
    if (i < ne) {
        row.place = s->e + (i < own ? s->inner.n + i : s->inner.row[i - own]);
        row.stride = ne;
        row.derivative = s->dense.E + i;
    } else {
        row.place = s->g + (i - ne);
        row.stride = s->ng;
        row.derivative = s->dense.G + (i - ne);
    }
    return row;
}

static int count_rows(const mbs_stages_stage *s)
{
    return s->dense.ne + s->ng;
}

/* What a prediction of the state of stage k costs, and what it must meet. */
typedef struct {
    const real *P, *p, *C, *c;
    int rows;
} entrance;

static entrance enter(const mbs_stages_recursion *r, int k)
{
    const mbs_stages_step *s = &r->step[k];
    entrance e;
    e.P = r->soft_dynamics ? r->soft[k - 1].P : s->P;
    e.p = r->soft_dynamics ? r->soft[k - 1].p : s->p;
    e.C = s->C;
    e.c = s->c;
    e.rows = r->soft_dynamics ? 0 : s->passed;
    return e;
}

/* Q = H + diagonal + curvature, lower triangle. Where variables were condensed, H holds the diagonal already. */
static void start_cost(const mbs_stages_recursion *r, const mbs_stages_stage *s, real *Q)
{
    const size_t n = (size_t)s->dense.n;
    size_t i;
    if (r->plain && s->inner.n == 0)
        memset(Q, 0, n * n * sizeof *Q);
    else
        memcpy(Q, s->dense.H, n * n * sizeof *Q);
    for (i = 0; i < n; ++i)
        Q[i * n + i] += s->curvature + (s->inner.n == 0 ? r->diagonal[(size_t)s->w + i] : 0);
}

static int count_soft(const mbs_stages_recursion *r, const mbs_stages_stage *s)
{
    int i, soft = 0;
    for (i = 0; i < count_rows(s); ++i)
        soft += r->compliance[row_of(s, i).place] > 0;
    return soft;
}

/* Q += JT J / compliance, of the rows that give. */
static void add_soft_rows(const mbs_stages_recursion *r, const mbs_stages_stage *s, real *Q, real *turned, real *scaled)
{
    const int n = s->dense.n, soft = count_soft(r, s);
    int i, j, at = 0;
    for (i = 0; i < count_rows(s) && at < soft; ++i) {
        const stage_row row = row_of(s, i);
        const real give = r->compliance[row.place];
        if (!(give > 0))
            continue;
        for (j = 0; j < n; ++j) {
            const real a = row.derivative[(size_t)j * (size_t)row.stride];
            turned[(size_t)at * (size_t)n + (size_t)j] = a;
            scaled[(size_t)j * (size_t)soft + (size_t)at] = a / give;
        }
        ++at;
    }
    mbs_stages_multiply(n, n, soft, 1, turned, n, scaled, soft, Q, n, 1);
}

/* Q += FT P F, with the cost P of the next state. */
static void add_next_cost(const mbs_stages_stage *s, const real *P, real *Q, real *turned, real *product)
{
    const int m = s->next, n = s->dense.n;
    memset(product, 0, (size_t)m * (size_t)n * sizeof *product);
    mbs_stages_multiply(m, n, m, 1, P, m, s->dense.F, m, product, m, 0);
    mbs_stages_transpose(m, n, s->dense.F, m, turned, n);
    mbs_stages_multiply(n, n, m, 1, turned, n, product, m, Q, n, 1);
}

/* Add a row that holds exactly: derivatives, or a unit vector where there are none. */
static void add_row(mbs_stages_step *p, const real *derivative, int stride, int unit)
{
    int j;
    for (j = 0; j < p->n; ++j)
        p->lu[(size_t)j * (size_t)p->capacity + (size_t)p->rows] =
            derivative ? derivative[(size_t)j * (size_t)stride] : (real)(j == unit);
    ++p->rows;
}

/* Whether variable i of stage k is fixed by a row of this stage. Fixed first states are rows of the root. */
static int has_row(const mbs_stages_recursion *r, int k, int i)
{
    return r->fixed[r->stage[k].w + i] && !(k == 0 && i < r->stage[k].nx);
}

/* Rows that hold exactly: of (e, g), of fixed variables, of conditions on the next state. */
static void stack_rows(const mbs_stages_recursion *r, int k)
{
    const mbs_stages_stage *s = &r->stage[k];
    mbs_stages_step *p = &r->step[k];
    int i, j;
    p->rows = 0;
    for (i = 0; i < count_rows(s); ++i) {
        const stage_row row = row_of(s, i);
        if (!(r->compliance[row.place] > 0))
            add_row(p, row.derivative, row.stride, 0);
    }
    for (i = 0; i < s->n; ++i)
        if (has_row(r, k, i))
            add_row(p, mbs_stages_variation(s, i), 1, mbs_stages_outer(s, i));
    p->own = p->rows;
    if (s->next > 0) {
        const entrance q = enter(r, k + 1);
        for (j = 0; j < s->dense.n; ++j) {
            real *a = p->lu + (size_t)j * (size_t)p->capacity + (size_t)p->rows;
            memset(a, 0, (size_t)q.rows * sizeof *a);
            mbs_stages_apply(q.rows, s->next, 1, q.C, q.rows, s->dense.F + (size_t)j * (size_t)s->next, a);
        }
        p->rows += q.rows;
    }
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

static int factorise_stage(mbs_stages_recursion *r, int k)
{
    mbs_stages_stage *s = &r->stage[k];
    mbs_stages_step *p = &r->step[k];
    real *Q = r->work[3];
    if (k < r->condensed)
        condense_next(r, k);
    s->inner.poor = s->inner.own && s->inner.missing == 0;
    p->n = s->dense.n;
    p->nv = s->dense.nv;
    start_cost(r, s, Q);
    add_soft_rows(r, s, Q, r->work[0], r->work[1]);
    if (s->next > 0)
        add_next_cost(s, enter(r, k + 1).P, Q, r->work[0], r->work[1]);
    stack_rows(r, k);
    return mbs_stages_reduce(p, Q, r->work, r->zero_pivot, r->zero_curvature);
}

static int soften(mbs_stages_recursion *r, int k)
{
    const mbs_stages_stage *next = &r->stage[k + 1];
    return mbs_stages_soften(&r->soft[k], r->step[k + 1].P, r->compliance + r->stage[k].d, r->fixed + next->w,
                             r->zero_curvature);
}

/* The first state is free, except for the rows passed to it and for its fixed variables. */
static int factorise_root(mbs_stages_recursion *r)
{
    const mbs_stages_step *q = &r->step[0];
    mbs_stages_step *p = &r->root;
    int i;
    p->rows = 0;
    for (i = 0; i < q->passed; ++i)
        add_row(p, q->C + i, q->passed, 0);
    for (i = 0; i < q->nx; ++i)
        if (r->fixed[r->stage[0].w + i])
            add_row(p, NULL, 0, i);
    return mbs_stages_reduce(p, q->P, r->work, r->zero_pivot, r->zero_curvature);
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
        if (k > 0 && r->soft_dynamics && soften(r, k - 1))
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
        mbs_stages_matrix_apply_transposed(A, force, gradient);
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

/* Add what the next state costs, and what it must meet. */
static void collect_next(const mbs_stages_recursion *r, int k)
{
    const mbs_stages_stage *s = &r->stage[k];
    const mbs_stages_step *p = &r->step[k];
    const entrance q = enter(r, k + 1);
    real *price = r->scratch[0].vector[2];
    memcpy(price, q.p, (size_t)s->next * sizeof *price);
    mbs_stages_apply(s->next, s->next, 1, q.P, s->next, p->ahead, price);
    mbs_stages_apply_transposed(s->next, s->dense.n, 1, s->dense.F, s->next, price, p->linear);
    memcpy(p->constant + p->own, q.c, (size_t)q.rows * sizeof *q.c);
    mbs_stages_apply(q.rows, s->next, 1, q.C, q.rows, p->ahead, p->constant + p->own);
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
        if (k > 0 && r->soft_dynamics)
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
    memcpy(x, p->ahead, (size_t)s->next * sizeof *x);
    mbs_stages_apply(s->next, s->dense.n, 1, s->dense.F, s->next, p->linear, x);
    if (r->soft_dynamics) {
        mbs_stages_deviate(&r->soft[k], r->compliance + s->d, x, dy + s->d);
        memset(passed, 0, (size_t)r->step[k + 1].passed * sizeof *passed);
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
        mbs_stages_matrix_apply(A, z, residual);
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
static void price_next(const mbs_stages_recursion *r, int k, real *dy)
{
    const mbs_stages_stage *s = &r->stage[k];
    const mbs_stages_step *p = &r->step[k], *q = &r->step[k + 1];
    memcpy(dy + s->d, q->p, (size_t)s->next * sizeof *dy);
    mbs_stages_apply(s->next, s->next, 1, q->P, s->next, q->linear, dy + s->d);
    mbs_stages_apply_transposed(q->passed, s->next, 1, q->C, q->passed, p->constant + p->own, dy + s->d);
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
    if (s->next > 0 && !r->soft_dynamics)
        price_next(r, k, t->dy);
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
void mbs_stages_add_stage_transposed(const mbs_stages_recursion *r, int k, const real *y, real *out)
{
    const mbs_stages_stage *s = &r->stage[k];
    int i;
    for (i = 0; k > 0 && i < s->nx; ++i)
        out[s->w + i] -= y[r->stage[k - 1].d + i];
    mbs_stages_matrix_apply_transposed(&s->E, y + s->e, out + s->w);
    mbs_stages_matrix_apply_transposed(&s->F, y + s->d, out + s->w);
    mbs_stages_matrix_apply_transposed(&s->G, y + s->g, out + s->w);
}

void mbs_stages_add_stage_rows(const mbs_stages_recursion *r, int k, const real *w, real *out)
{
    const mbs_stages_stage *s = &r->stage[k];
    int i;
    mbs_stages_matrix_apply(&s->E, w + s->w, out + s->e);
    mbs_stages_matrix_apply(&s->F, w + s->w, out + s->d);
    mbs_stages_matrix_apply(&s->G, w + s->w, out + s->g);
    for (i = 0; i < s->next; ++i)
        out[s->d + i] -= w[r->stage[k + 1].w + i];
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
        mbs_stages_add_stage_transposed(a->r, k, a->y, a->out);
}

void mbs_stages_add_transposed(const mbs_stages_recursion *r, const real *y, real *out)
{
    addition a;
    a.r = r;
    a.y = y;
    a.out = out;
    mbs_stages_for_all(r, add_transposed, &a);
}
