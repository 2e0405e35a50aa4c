/* The workspace: one pass counts its bytes, the same pass hands them out. */
#include "solver.h"

#include <string.h>

#define SEARCHES MBS_STAGES_SEARCHES
#if MBS_STAGES_WIDE
#define ALIGNMENT 64 /* a line */
#define SPACE ALIGNMENT /* before the first one: the caller's memory need not begin with a line */
#else
#define ALIGNMENT ((SEARCHES ? 2 : 1) * sizeof(void *)) /* small machines have small pointers, and no vectors */
#define SPACE 0
#endif

/* Memory from `base` on, or only a count of it where base is NULL. */
typedef struct {
    char *base;
    size_t used;
} arena;

static void *take(arena *a, size_t count, size_t bytes)
{
    void *p = a->base ? a->base + a->used : NULL;
    a->used += (count * bytes + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
    return p;
}

static real *numbers(arena *a, int rows, int columns)
{
    return take(a, (size_t)rows * (size_t)columns, sizeof(real));
}

static int smaller(int a, int b)
{
    return a < b ? a : b;
}

static int larger(int a, int b)
{
    return a > b ? a : b;
}

static void lay_step(arena *a, mbs_stages_step *p, int nx, int nv, int capacity, int next)
{
    const int n = nx + nv, pivots = smaller(nv, capacity), width = mbs_stages_width(n), wide = mbs_stages_width(nx);
    p->nx = nx;
    p->nv = nv;
    p->n = n;
    p->capacity = capacity;
    p->row = take(a, (size_t)capacity, sizeof(int));
    p->column = take(a, (size_t)capacity, sizeof(int));
    p->order = take(a, (size_t)n, sizeof(int));
    p->lu = numbers(a, capacity, n);
    p->U = numbers(a, pivots, pivots);
    p->T = numbers(a, pivots, width);
    p->Y = numbers(a, pivots, width);
    p->Q = numbers(a, pivots, pivots);
    p->L = numbers(a, nv, width);
    p->P = numbers(a, nx, wide);
    p->C = numbers(a, smaller(nx, capacity), wide);
    p->p = numbers(a, nx, 1);
    p->c = numbers(a, nx, 1);
    p->t = numbers(a, pivots, 1);
    p->l = numbers(a, nv, 1);
    p->qp = numbers(a, pivots, 1);
    p->linear = numbers(a, width, 1);
    p->constant = numbers(a, capacity, 1);
    p->ahead = numbers(a, mbs_stages_width(next), 1);
}

static void lay_soft(arena *a, mbs_stages_soft *p, int n)
{
    p->n = n;
    p->width = mbs_stages_width(n);
    p->rows = numbers(a, n, n);
    p->sum = numbers(a, n, 1);
    p->own = numbers(a, n, 1);
    p->P = numbers(a, n, p->width);
    p->p = numbers(a, n, 1);
    p->fixed = take(a, (size_t)n, 1);
}

static void lay_direction(arena *a, mbs_stages_direction *d, int size, int rows)
{
    d->x = numbers(a, size, 1);
    d->zl = numbers(a, size, 1);
    d->zu = numbers(a, size, 1);
    d->y = numbers(a, rows, 1);
}

static void lay_watchdog(arena *a, mbs_stages_watchdog *w, int size, int rows)
{
    w->x = numbers(a, size, 1);
    w->zl = numbers(a, size, 1);
    w->zu = numbers(a, size, 1);
    w->y = numbers(a, rows, 1);
    w->c = numbers(a, rows, 1);
    lay_direction(a, &w->step, size, rows);
}

static void lay_phase(arena *a, mbs_stages_phase *p, int size, int rows)
{
    real **const vectors[] = {&p->x,        &p->lower, &p->upper, &p->zl,        &p->zu,
                              &p->gradient, &p->slope, &p->sigma, &p->lagrangian};
    size_t i;
    p->size = size;
    for (i = 0; i < sizeof vectors / sizeof *vectors; ++i)
        *vectors[i] = numbers(a, size, 1);
    p->y = numbers(a, rows, 1);
    p->c = numbers(a, rows, 1);
    lay_direction(a, &p->step, size, rows);
    if (!SEARCHES)
        return;
    p->trial = numbers(a, size, 1);
    p->filter.theta = numbers(a, MBS_STAGES_ENTRIES, 1);
    p->filter.phi = numbers(a, MBS_STAGES_ENTRIES, 1);
    p->trial_c = numbers(a, rows, 1);
    p->soc_c = numbers(a, rows, 1);
    lay_direction(a, &p->other, size, rows);
}

static void lay_matrix(arena *a, mbs_stages_matrix *A, int rows, int columns, const mbs_stages_pattern *pattern)
{
    A->rows = rows;
    A->columns = columns;
    A->begin = pattern ? pattern->column : NULL;
    A->end = pattern ? pattern->column + 1 : NULL;
    A->row = pattern ? pattern->row : NULL;
    A->count = pattern ? pattern->column[columns] : rows * columns;
    A->value = numbers(a, A->count, 1);
}

/* Give a dense matrix the pattern of all its entries, or of its lower triangle. */
static void lay_full_pattern(arena *a, mbs_stages_matrix *A, int triangle)
{
    const size_t columns = (size_t)A->columns;
    int *begin = take(a, columns, sizeof(int)), *end = take(a, columns, sizeof(int));
    int *row = take(a, (size_t)A->count, sizeof(int)), i, j;
    for (j = 0; a->base && j < A->columns; ++j) {
        begin[j] = j * A->rows + (triangle ? j : 0);
        end[j] = (j + 1) * A->rows;
        for (i = 0; i < A->rows; ++i)
            row[j * A->rows + i] = i;
    }
    A->begin = begin;
    A->end = end;
    A->row = row;
}

static void share_pattern(mbs_stages_matrix *A, const mbs_stages_matrix *from)
{
    A->begin = from->begin;
    A->end = from->end;
    A->row = from->row;
}

static int are_alike(const mbs_stages_problem *problem, int k, int l)
{
    const mbs_stages_size *a = &problem->size[k], *b = &problem->size[l];
    return a->nx == b->nx && a->nv == b->nv && a->ne == b->ne && a->ng == b->ng && a->inner == b->inner &&
           a->patterns == b->patterns && (l == problem->stages - 1) == (k == problem->stages - 1) &&
           (k == problem->stages - 1 || a[1].nx == b[1].nx);
}

/* The last stage before stage k of its kind; k itself if it is the first. */
static int last_alike(const mbs_stages_problem *problem, int k)
{
    int l;
    for (l = k - 1; l >= 0; --l)
        if (are_alike(problem, k, l))
            return l;
    return k;
}

static int count_block(const mbs_stages_stage *t, const mbs_stages_patterns *patterns)
{
    int l, count = 0;
    if (patterns == NULL)
        return t->inner.n * t->inner.n;
    for (l = patterns->de.column[t->nx]; l < patterns->de.column[t->nx + t->inner.n]; ++l)
        count += patterns->de.row[l] < t->inner.n;
    return count;
}

/* The order of pivots of a kind of stages, and how large factors are. */
static void lay_pivots(arena *a, mbs_stages_pivots *p, int n, int first, int entries, int capacity)
{
    int **const of_rows[] = {&p->row, &p->column}, **const of_places[] = {&p->entry, &p->lower, &p->upper};
    int **const of_nonzeros[] = {&p->lower_place, &p->lower_row, &p->upper_place, &p->upper_column};
    size_t i;
    p->n = n;
    p->first = first;
    p->entries = entries;
    p->capacity = capacity;
    for (i = 0; i < 2; ++i)
        *of_rows[i] = take(a, (size_t)n, sizeof(int));
    for (i = 0; i < 3; ++i)
        *of_places[i] = take(a, (size_t)n + 1, sizeof(int));
    for (i = 0; i < 4; ++i)
        *of_nonzeros[i] = take(a, (size_t)capacity, sizeof(int));
    p->entry_at = take(a, (size_t)entries, sizeof(int));
    p->entry_place = take(a, (size_t)entries, sizeof(int));
}

/* What stages of a kind share, in the first of them: patterns, the order of pivots. */
static void lay_shared(arena *a, mbs_stages *s, const mbs_stages_problem *problem, int k, mbs_stages_stage *t)
{
    mbs_stages_matrix *const own[] = {&t->E, &t->F, &t->G, &t->H};
    const int alike = last_alike(problem, k), entries = count_block(t, problem->size[k].patterns);
    const mbs_stages_stage *other = s->recursion.stage ? &s->recursion.stage[alike] : t;
    const mbs_stages_matrix *const others[] = {&other->E, &other->F, &other->G, &other->H};
    mbs_stages_pivots spare;
    int i;
    for (i = 0; i < 4 && problem->size[k].patterns == NULL; ++i)
        if (alike == k)
            lay_full_pattern(a, own[i], i == 3);
        else
            share_pattern(own[i], others[i]);
    t->inner.capacity = smaller(t->inner.n * (t->inner.n - 1), FILL * (entries + t->inner.n));
    if (alike < k) {
        t->inner.pivots = other->inner.pivots;
        return;
    }
    t->inner.pivots = take(a, 1, sizeof spare);
    lay_pivots(a, a->base ? t->inner.pivots : &spare, t->inner.n, t->nx, entries, t->inner.capacity);
}

static int is_read(const mbs_stages_stage *t, int j)
{
    int l;
    for (l = t->E.begin[j]; l < t->E.end[j]; ++l)
        if (t->E.row[l] < t->inner.n)
            return 1;
    return 0;
}

/* Count the first states that no inner equation reads, in whole lanes. */
static int count_unread(const mbs_stages_stage *t)
{
    int j = 0;
    while (t->E.begin && j < t->nx && !is_read(t, j))
        ++j;
    return j / MBS_STAGES_LANES * MBS_STAGES_LANES;
}

static int is_empty(const mbs_stages_matrix *A, int j)
{
    return A->begin[j] == A->end[j];
}

/* Whether column j of the dynamics gives state j alone, and is all of variable j. */
static int is_carried(const mbs_stages_stage *t, int j)
{
    const mbs_stages_matrix *F = &t->F;
    return is_empty(&t->E, j) && is_empty(&t->G, j) && is_empty(&t->H, j) && F->end[j] == F->begin[j] + 1 &&
           F->row[F->begin[j]] == j;
}

/* Count the first states that the next stage gets as they are, in whole lanes; steps alone have none of the code. */
static int count_carried(const mbs_stages_stage *t)
{
    int j, l, count = 0;
    while (MBS_STAGES_SEARCHES && t->F.begin && count < t->nx && is_carried(t, count))
        ++count;
    for (j = count; MBS_STAGES_SEARCHES && t->F.begin && j < t->n; ++j)
        for (l = t->F.begin[j]; l < t->F.end[j]; ++l)
            count = smaller(count, t->F.row[l]);
    return count / MBS_STAGES_LANES * MBS_STAGES_LANES;
}

/* Whether H has nonzeros of inner variables. */
static int is_curved(const mbs_stages_stage *t)
{
    const int end = t->nx + t->inner.n;
    int j, l;
    for (j = 0; t->H.begin && j < end; ++j)
        for (l = t->H.begin[j]; l < t->H.end[j]; ++l)
            if (j >= t->nx || (t->H.row[l] >= t->nx && t->H.row[l] < end))
                return 1;
    return 0;
}

static void lay_few(arena *a, mbs_stages_few *f, int rows)
{
#if MBS_STAGES_LOOKS
    f->count = take(a, (size_t)rows, sizeof(int));
    f->column = take(a, (size_t)rows * MBS_STAGES_FEW, sizeof(int));
#else
    (void)a, (void)f, (void)rows;
#endif
}

static void lay_inner(arena *a, mbs_stages *s, const mbs_stages_problem *problem, int k, int lane, mbs_stages_stage *t)
{
    mbs_stages_inner *y = &t->inner;
    if (y->n == 0)
        return;
    lay_shared(a, s, problem, k, t);
    y->spare = smaller(y->n, SEARCHES ? SPARE : 0);
    if (lane == 0) {
        y->factors.lower = numbers(a, y->capacity, MBS_STAGES_TOGETHER);
        y->factors.inverse = numbers(a, y->n, MBS_STAGES_TOGETHER);
    } else if (s->recursion.stage) {
        y->factors = s->recursion.stage[k - 1].inner.factors;
    }
    y->lane = lane;
    y->skip = count_unread(t);
    y->curved = is_curved(t);
    y->ld = mbs_stages_lines(mbs_stages_width(t->n - y->n + y->spare) - y->skip) + mbs_stages_lines(y->skip);
    y->shift = mbs_stages_lines(y->skip) - y->skip;
    y->V = numbers(a, y->n, y->ld);
    y->V = y->V ? y->V + y->shift : NULL;
    y->constant = numbers(a, y->n, 1);
    lay_few(a, &y->few, y->n);
    y->variable = take(a, (size_t)y->spare, sizeof(int));
    y->row = take(a, (size_t)y->spare, sizeof(int));
    y->stale = 1;
}

static void lay_dense(arena *a, mbs_stages_stage *t)
{
    mbs_stages_dense *d = &t->dense;
    const int ne = t->ne - t->inner.n + t->inner.spare, n = t->n - t->inner.n + t->inner.spare;
    const int width = mbs_stages_width(n);
    d->nv = t->nv - t->inner.n;
    d->n = t->nx + d->nv;
    d->ne = t->ne - t->inner.n;
    d->width = mbs_stages_width(d->n);
    d->E = numbers(a, ne, width);
    d->F = numbers(a, t->next, width);
    d->G = numbers(a, t->ng, width);
    lay_few(a, &d->few, t->next);
    d->H = numbers(a, t->inner.n > 0 ? width : n, width); /* products for inner variables fill whole lanes of rows */
}

/* Places of a stage come after the places of earlier stages. */
static void lay_stage(arena *a, mbs_stages *s, const mbs_stages_problem *problem, int k, int lane, mbs_stages_stage *t)
{
    const mbs_stages_size *z = &problem->size[k];
    const mbs_stages_patterns *p = z->patterns;
    memset(t, 0, sizeof *t);
    t->nx = z->nx;
    t->nv = z->nv;
    t->n = z->nx + z->nv;
    t->ne = z->ne;
    t->ng = z->ng;
    t->next = k + 1 < problem->stages ? problem->size[k + 1].nx : 0;
    t->w = s->variables;
    t->e = s->rows;
    t->d = t->e + t->ne;
    t->g = t->d + t->next;
    t->s = s->slacks;
    s->variables += t->n;
    s->rows += t->ne + t->next + t->ng;
    s->slacks += t->ng;
    t->inner.n = z->inner;
    lay_matrix(a, &t->E, t->ne, t->n, p ? &p->de : NULL);
    lay_matrix(a, &t->F, t->next, t->n, p ? &p->dd : NULL);
    lay_matrix(a, &t->G, t->ng, t->n, p ? &p->dg : NULL);
    lay_matrix(a, &t->H, t->n, t->n, p ? &p->h : NULL);
    lay_inner(a, s, problem, k, lane, t);
    lay_dense(a, t);
    t->carried = count_carried(t);
}

/* Equal bounds of a stage, each of which is a row that holds exactly. */
static int count_equal(const mbs_stages_problem *problem, const mbs_stages_stage *t)
{
    int i, equal = 0;
    for (i = 0; problem->lower && problem->upper && i < t->n; ++i)
        equal += problem->lower[t->w + i] == problem->upper[t->w + i];
    for (i = 0; problem->least && problem->most && i < t->ng; ++i)
        equal += problem->least[t->s + i] == problem->most[t->s + i];
    return equal;
}

/* The most that the stages need to work in. */
typedef struct {
    int variables, rows;                /* of a stage */
    int outer, outer_rows;              /* of the recursion; `outer` in whole lanes */
    int inner, width;                   /* of inner variables, and of right-hand sides for them */
} extent;

static void extend(extent *e, const mbs_stages_stage *t)
{
    const int outer = mbs_stages_width(t->n - t->inner.n + t->inner.spare), ne = t->ne - t->inner.n + t->inner.spare;
    e->variables = larger(e->variables, t->n);
    e->rows = larger(e->rows, t->ne + t->ng + t->n + t->next);
    e->outer = larger(e->outer, outer);
    e->outer_rows = larger(e->outer_rows, ne + t->ng + t->n + t->next);
    if (t->inner.n == 0)
        return;
    e->inner = larger(e->inner, t->inner.n);
    e->width = larger(e->width, t->inner.ld);
}

static int count_workers(const mbs_stages_problem *problem)
{
    return problem->team ? problem->team->workers : 1;
}

static void lay_scratch(arena *a, mbs_stages_scratch *m, const extent *e)
{
    int i;
    for (i = 0; i < 8; ++i)
        m->vector[i] = numbers(a, 2 * (e->variables + MBS_STAGES_LANES) + e->rows, 1);
    m->block = numbers(a, e->inner, e->inner);
    for (i = 0; i < 3; ++i)
        m->together[i] = numbers(a, e->inner, MBS_STAGES_TOGETHER);
    m->right = numbers(a, e->inner, e->width);
    m->spots = take(a, (size_t)larger(e->rows, 4 * e->inner), sizeof(int)); /* equations; or four for each inner variable */
}

static void lay_work(arena *a, mbs_stages_recursion *r, const extent *e, int workers)
{
    mbs_stages_scratch spare;
    int i;
    for (i = 0; i < 4; ++i)
        r->work[i] = numbers(a, e->outer + e->outer_rows, e->outer);
    r->marks = take(a, (size_t)e->inner * (size_t)e->inner, 1);
    r->scratch = take(a, (size_t)workers, sizeof spare);
    for (i = 0; i < workers; ++i)
        lay_scratch(a, a->base ? &r->scratch[i] : &spare, e);
}

/* The most rows that hold exactly: the rows of e, fixed variables, those passed from the next stage. Where rows of g are
 * exact in factorisations, fixed slacks are among them. */
static int count_exact(const mbs_stages_stage *t)
{
    return t->dense.ne + t->inner.spare + t->equal + t->next + (SEARCHES ? t->ng : 0);
}

static void lay_recursion(arena *a, mbs_stages *s, const mbs_stages_problem *problem)
{
    mbs_stages_recursion *r = &s->recursion;
    extent most = {0};
    int k, lane = 0;
    mbs_stages_stage spare;
    for (k = 0; k < problem->stages; ++k) {
        mbs_stages_stage *t = r->stage ? &r->stage[k] : &spare;
        mbs_stages_step step, *p = r->step ? &r->step[k] : &step;
        mbs_stages_soft soft, *q = r->soft ? &r->soft[k] : &soft;
        lane = k > 0 && are_alike(problem, k, k - 1) ? (lane + 1) % MBS_STAGES_TOGETHER : 0;
        lay_stage(a, s, problem, k, lane, t);
        t->equal = count_equal(problem, t);
        lay_step(a, p, t->nx, t->dense.nv + t->inner.spare, count_exact(t), t->next);
        lay_soft(a, q, SEARCHES ? t->next : 0);
        if (k == 0)
            lay_step(a, &r->root, 0, t->nx, 2 * t->nx, 0); /* rows passed to it, and fixed states */
        extend(&most, t);
    }
    lay_work(a, r, &most, count_workers(problem));
    r->team = problem->team;
    r->diagonal = numbers(a, s->variables, 1);
    r->compliance = numbers(a, s->rows, 1);
}

static void lay_solver(arena *a, mbs_stages *s)
{
    const int n = s->variables, m = s->rows;
    real **const of_w[] = {&s->point.w, &s->point.below, &s->point.above, &s->variable_scale, &s->raw_w,
                           &s->rw,      &s->dw,          &s->residual_w,  &s->best_w};
    real **const of_restoration[] = {&s->reference, &s->weight};
    real **const of_rows[] = {&s->point.y, &s->row_scale, &s->raw_rows, &s->rc, &s->dy, &s->residual_c, &s->best_y};
    real **const of_slacks[] = {&s->slack, &s->slack_below, &s->slack_above};
    size_t i;
    s->point.variables = n;
    s->point.rows = m;
    lay_phase(a, &s->main, n + s->slacks, m);
    if (SEARCHES) {
        lay_watchdog(a, &s->main.watchdog, n + s->slacks, m);
        lay_phase(a, &s->least, n + s->slacks + 2 * m, m);
    }
    s->fixed = take(a, (size_t)(n + s->slacks + (SEARCHES ? 2 * m : 0)), 1);
    s->softened = take(a, (size_t)m, 1);
    s->failed = take(a, (size_t)s->problem->stages, 1);
    s->costs = numbers(a, s->problem->stages, 1);
    for (i = 0; i < sizeof of_w / sizeof *of_w; ++i)
        *of_w[i] = numbers(a, n, 1);
    for (i = 0; SEARCHES && i < sizeof of_restoration / sizeof *of_restoration; ++i)
        *of_restoration[i] = numbers(a, n, 1);
    for (i = 0; i < sizeof of_rows / sizeof *of_rows; ++i)
        *of_rows[i] = numbers(a, m, 1);
    for (i = 0; i < sizeof of_slacks / sizeof *of_slacks; ++i)
        *of_slacks[i] = numbers(a, s->slacks, 1);
    s->gives = SEARCHES ? numbers(a, m, 1) : s->recursion.compliance;
    s->least.elastic = 1;
    s->main.options = s->least.options = &s->options;
    s->recursion.zero_pivot = MBS_STAGES_ZERO;
    s->recursion.small_pivot = MBS_STAGES_SMALL;
    s->recursion.growth = MBS_STAGES_GROWTH;
    s->recursion.zero_curvature = 10 * MBS_STAGES_EPSILON;
    s->recursion.fixed = s->fixed;
    s->recursion.stages = s->problem->stages;
    s->recursion.variables = n;
    s->recursion.rows = m;
}

/* Lay out all of a solver `s`, which has its place already. */
static void lay(arena *a, const mbs_stages_problem *problem, mbs_stages *s)
{
    const size_t stages = (size_t)problem->stages;
    memset(s, 0, sizeof *s);
    s->problem = problem;
    s->recursion.stage = take(a, stages, sizeof *s->recursion.stage);
    s->recursion.step = take(a, stages, sizeof *s->recursion.step);
    s->recursion.soft = take(a, stages, sizeof *s->recursion.soft);
    lay_recursion(a, s, problem);
    lay_solver(a, s);
}

/* Whether rows increase in each column, from row j of column j on in a triangle. */
static int is_pattern(const mbs_stages_pattern *p, int rows, int columns, int triangle)
{
    int j, l;
    if (!p->column || p->column[0] != 0)
        return 0;
    for (j = 0; j < columns; ++j) {
        int least = triangle ? j : 0;
        for (l = p->column[j]; l < p->column[j + 1]; ++l) {
            if (!p->row || p->row[l] < least || p->row[l] >= rows)
                return 0;
            least = p->row[l] + 1;
        }
        if (p->column[j + 1] < p->column[j])
            return 0;
    }
    return 1;
}

static int are_patterns(const mbs_stages_size *z, int next)
{
    const mbs_stages_patterns *p = z->patterns;
    const int n = z->nx + z->nv;
    return is_pattern(&p->de, z->ne, n, 0) && is_pattern(&p->dd, next, n, 0) && is_pattern(&p->dg, z->ng, n, 0) &&
           is_pattern(&p->h, n, n, 1);
}

static int is_possible(const mbs_stages_problem *problem)
{
    int k;
    if (problem->stages < 1 || !problem->size || !problem->values || !problem->jacobians || !problem->hessian)
        return 0;
    if (problem->team && (problem->team->workers < 1 || !problem->team->spread))
        return 0;
    for (k = 0; k < problem->stages; ++k) {
        const mbs_stages_size *z = &problem->size[k];
        if (z->nx < 0 || z->nv < 0 || z->ne < 0 || z->ng < 0)
            return 0;
        if (z->inner < 0 || z->inner > z->nv || z->inner > z->ne)
            return 0;
        if (z->patterns && !are_patterns(z, k + 1 < problem->stages ? problem->size[k + 1].nx : 0))
            return 0;
    }
    return 1;
}

size_t mbs_stages_bytes(const mbs_stages_problem *problem)
{
    arena a = {NULL, 0};
    mbs_stages s;
    if (!is_possible(problem))
        return 0;
    take(&a, 1, sizeof s);
    lay(&a, problem, &s);
    return a.used + SPACE;
}

mbs_stages *mbs_stages_create(const mbs_stages_problem *problem, void *workspace, size_t bytes)
{
    const size_t needed = mbs_stages_bytes(problem);
    arena a = {NULL, 0};
    mbs_stages *s;
    if (needed == 0 || workspace == NULL || bytes < needed)
        return NULL;
    memset(workspace, 0, needed);
    a.base = workspace;
#if SPACE > 0
    a.base += SPACE - (size_t)a.base % SPACE;
#endif
    s = take(&a, 1, sizeof *s);
    lay(&a, problem, s);
    return s;
}

mbs_stages_point mbs_stages_iterate(const mbs_stages *solver)
{
    return solver->point;
}

mbs_stages_place mbs_stages_places(const mbs_stages *solver, int k)
{
    const mbs_stages_stage *t = &solver->recursion.stage[k];
    mbs_stages_place place;
    place.x = t->w;
    place.v = t->w + t->nx;
    place.e = t->e;
    place.d = t->d;
    place.g = t->g;
    return place;
}
