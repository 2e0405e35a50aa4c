#include "laws.h"

#include <stdlib.h>

#include "../../../csrc/stages/layout.c"

/* --- arrays, each with exactly the room that its numbers take --------------------------------------------------- */

typedef struct {
    const char *at;
    size_t bytes;
} array;

static array arrays[2000];
static int listed;

static void list(const void *at, int count, size_t bytes)
{
    arrays[listed].at = at;
    arrays[listed++].bytes = (size_t)count * bytes;
}

static void list_numbers(const real *at, int count)
{
    list(at, count, sizeof(real));
}

static void list_integers(const int *at, int count)
{
    list(at, count, sizeof(int));
}

static int by_place(const void *a, const void *b)
{
    const array *first = a, *second = b;
    if (first->at != second->at)
        return first->at < second->at ? -1 : 1;
    return first->bytes < second->bytes ? -1 : first->bytes > second->bytes;
}

static void compare_rooms(const char *begin, size_t bytes)
{
    int i;
    qsort(arrays, (size_t)listed, sizeof *arrays, by_place);
    LAW("a solver begins its workspace", arrays[0].at == begin);
    for (i = 0; i < listed; ++i) {
        const char *end = i + 1 < listed ? arrays[i + 1].at : begin + bytes;
        const size_t room = (size_t)(end - arrays[i].at);
        LAW("an array has room", room >= arrays[i].bytes);
        LAW("and no more than its alignment asks for", room < arrays[i].bytes + 2 * sizeof(void *));
        LAW("arrays are aligned", (size_t)(arrays[i].at - begin) % (2 * sizeof(void *)) == 0);
    }
}

static int wide(int n)
{
    return (n + 3) / 4 * 4;
}

static int least_of(int a, int b)
{
    return a < b ? a : b;
}

static int most_of(int a, int b)
{
    return a > b ? a : b;
}

/* Rows that hold exactly: `capacity` of them at most. */
static void list_step(const mbs_stages_step *p, int nx, int nv, int capacity, int next)
{
    const int n = nx + nv, pivots = least_of(nv, capacity);
    LAW("a step has its sizes", p->nx == nx && p->nv == nv && p->n == n && p->capacity == capacity);
    list_integers(p->row, capacity), list_integers(p->column, capacity), list_integers(p->order, n);
    list_numbers(p->lu, capacity * n), list_numbers(p->U, pivots * pivots), list_numbers(p->Q, pivots * pivots);
    list_numbers(p->T, pivots * wide(n)), list_numbers(p->Y, pivots * wide(n)), list_numbers(p->L, nv * wide(n));
    list_numbers(p->P, nx * wide(nx)), list_numbers(p->C, least_of(nx, capacity) * wide(nx));
    list_numbers(p->p, nx), list_numbers(p->c, nx), list_numbers(p->t, pivots), list_numbers(p->qp, pivots);
    list_numbers(p->l, nv), list_numbers(p->linear, wide(n)), list_numbers(p->constant, capacity);
    list_numbers(p->ahead, wide(next));
}

static void list_soft(const mbs_stages_soft *p, int n)
{
    LAW("deviations are of the next states", p->n == n && p->width == wide(n));
    list_numbers(p->rows, n * n), list_numbers(p->sum, n), list_numbers(p->own, n), list_numbers(p->P, n * wide(n));
    list_numbers(p->p, n), list(p->fixed, n, 1);
}

static void list_direction(const mbs_stages_direction *d, int size, int rows)
{
    list_numbers(d->x, size), list_numbers(d->zl, size), list_numbers(d->zu, size), list_numbers(d->y, rows);
}

static void list_phase(const mbs_stages_phase *p, int size, int rows)
{
    LAW("a barrier problem has its size", p->size == size);
    list_numbers(p->x, size), list_numbers(p->trial, size), list_numbers(p->lower, size), list_numbers(p->upper, size);
    list_numbers(p->zl, size), list_numbers(p->zu, size), list_numbers(p->gradient, size);
    list_numbers(p->lagrangian, size), list_numbers(p->slope, size), list_numbers(p->sigma, size);
    list_numbers(p->y, rows), list_numbers(p->c, rows), list_numbers(p->trial_c, rows), list_numbers(p->soc_c, rows);
    list_numbers(p->filter.theta, MBS_STAGES_ENTRIES), list_numbers(p->filter.phi, MBS_STAGES_ENTRIES);
    list_direction(&p->step, size, rows), list_direction(&p->other, size, rows);
}

/* --- problems: stages 0 and 1 are alike, then a group of 5, then one of another kind ---------------------------- */

enum { STAGES = 9, PLACES = 200 };

static int values(void *c, int k, const real *x, const real *v, real *f, real *e, real *d, real *g)
{
    (void)c, (void)k, (void)x, (void)v, (void)f, (void)e, (void)d, (void)g;
    return 0;
}

static int jacobians(void *c, int k, const real *x, const real *v, real *df, real *de, real *dd, real *dg)
{
    (void)c, (void)k, (void)x, (void)v, (void)df, (void)de, (void)dd, (void)dg;
    return 0;
}

static int hessian(void *c, int k, const real *x, const real *v, real f, const real *ye, const real *yd, const real *yg,
                   real *h)
{
    (void)c, (void)k, (void)x, (void)v, (void)f, (void)ye, (void)yd, (void)yg, (void)h;
    return 0;
}

static void spread(void *pool, int count, mbs_stages_task task, void *data)
{
    (void)pool;
    task(data, 0, count, 0);
}

/* A stage of 5 states, 12 variables, of which 10 are inner ones,
    and 11 rows of e: its columns 0 .. 3 have no inner row,
 * its inner rows the diagonal, and the first one the fifth state. */
static const int de_column[18] = {0, 1, 1, 1, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 14};
static const int de_row[14] = {10, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 0, 10};
static const int dd_column[18] = {0, 1, 2, 3, 4, 5, 5, 5, 5, 5, 5, 5, 5, 5, 5, 5, 6, 7}, dd_row[7] = {0, 1, 2, 3, 4,
    0, 4};
static const int dg_column[18] = {0}, dg_row[1] = {0};
static const int h_column[18] = {0, 2, 3, 4, 5, 6, 6, 6, 6, 6, 6, 6, 6, 6, 6, 6, 7, 8}, h_row[8] = {0, 16, 1, 2, 3,
    4, 15, 16};
static mbs_stages_patterns patterns = {
    {de_column, de_row}, {dd_column, dd_row}, {dg_column, dg_row}, {h_column, h_row}};
static mbs_stages_size sizes[STAGES];
static real lower[PLACES], upper[PLACES], least[PLACES], most[PLACES];
static mbs_stages_team team;
static mbs_stages_problem problem;
static char *memory;

static mbs_stages *make(void)
{
    const size_t bytes = mbs_stages_bytes(&problem);
    free(memory);
    memory = malloc(bytes);
    memset(memory, 0x5a, bytes);
    return mbs_stages_create(&problem, memory, bytes);
}

static void anew(void)
{
    static const mbs_stages_size plain = {5, 3, 2, 4, 0, NULL}, inner = {5, 12, 11, 1, 10, &patterns},
                                 full = {3, 4, 3, 2, 2, NULL};
    int k;
    memset(&problem, 0, sizeof problem);
    for (k = 0; k < STAGES; ++k)
        sizes[k] = k < 2 ? plain : k < 7 ? inner : full;
    sizes[6] = full, sizes[5].patterns = NULL; /* its next stage has fewer states: it is not of the kind before it */
    for (k = 0; k < PLACES; ++k)
        lower[k] = least[k] = 0, upper[k] = most[k] = 1;
    problem.stages = STAGES, problem.size = sizes;
    problem.values = values, problem.jacobians = jacobians, problem.hessian = hessian;
    problem.lower = lower, problem.upper = upper, problem.least = least, problem.most = most;
}

/* --- laws --------------------------------------------------------------------------------------------------------- */

static void rooms(int workers)
{
    static const int equal[STAGES] = {3, 1, 1, 0, 0, 2, 0, 1, 1};
    const mbs_stages *s;
    const mbs_stages_recursion *r;
    int k, i, n = 0, m = 0, slacks = 0, marks = 0, outer = 0, rows = 0, variables = 0, own_rows = 0;
    anew();
    /* variables of stage k begin at 0 8 16 33 50 67 84 91 98, slacks at 0 4 8 9 10 11 12 14 16 */
    upper[0] = upper[4] = most[3] = most[4] = 0, upper[16] = 0, upper[67] = upper[83] = 0, upper[91] = 0, most[17] = 0;
    team = (mbs_stages_team){workers, spread, NULL, NULL};
    problem.team = workers ? &team : NULL;
    s = make(), r = &s->recursion;
    listed = 0;
    list(s, 1, sizeof *s);
    list(r->stage, STAGES, sizeof *r->stage), list(r->step, STAGES, sizeof *r->step);
    list(r->soft, STAGES, sizeof *r->soft);
    for (k = 0; k < STAGES; ++k) {
        const mbs_stages_stage *t = &r->stage[k];
        const mbs_stages_size *z = &sizes[k];
        const mbs_stages_inner *y = &t->inner;
        const int all = z->nx + z->nv, next = k + 1 < STAGES ? sizes[k + 1].nx : 0, spare = least_of(z->inner, SPARE);
        const int nv = z->nv - z->inner, ne = z->ne - z->inner, width = wide(z->nx + nv + spare);
        LAW("places follow each other", t->w == n && t->e == m && t->d == m + z->ne && t->g == m + z->ne + next);
        LAW("of slacks too", t->s == slacks);
        LAW("a stage has its sizes",
            t->nx == z->nx && t->nv == z->nv && t->n == all && t->ne == z->ne && t->ng == z->ng);
        LAW("its rows of d give the next states", t->next == next);
        LAW("equal bounds are counted", t->equal == equal[k]);
        LAW("the recursion has the variables that are not inner ones",
            t->dense.nv == nv && t->dense.n == z->nx + nv && t->dense.ne == ne && t->dense.width == wide(z->nx + nv));
        LAW("and room for more", y->n == z->inner && y->spare == spare);
        n += all, m += z->ne + next + z->ng, slacks += z->ng;
        list_numbers(t->E.value, z->patterns ? 14 : z->ne * all), list_numbers(t->F.value,
            z->patterns ? 7 : next * all);
        list_numbers(t->G.value, z->patterns ? 0 : z->ng * all), list_numbers(t->H.value, z->patterns ? 8 : all * all);
        LAW("matrices have their numbers", t->E.count == (z->patterns ? 14 : z->ne * all) && t->E.rows == z->ne);
        LAW("in all columns", t->E.columns == all && t->F.columns == all && t->G.columns == all && t->H.columns == all);
        LAW("and rows", t->F.rows == next && t->G.rows == z->ng && t->H.rows == all);
        list_numbers(t->dense.E, (ne + spare) * width), list_numbers(t->dense.F, next * width);
        list_numbers(t->dense.G, z->ng * width);
        list_integers(t->dense.few.count, next), list_integers(t->dense.few.column, next * MBS_STAGES_FEW);
        list_numbers(t->dense.H, z->inner ? width * width : all * width); /* whole lanes of rows where some are inner */
        list_step(&r->step[k], z->nx, nv + spare, ne + spare + equal[k] + next + z->ng, next);
        list_soft(&r->soft[k], next);
        variables = most_of(variables, all), own_rows = most_of(own_rows, z->ne + z->ng + all + next);
        outer = most_of(outer, width), rows = most_of(rows, ne + spare + z->ng + all + next);
        if (z->inner == 0)
            continue;
        list_numbers(y->V, z->inner * width), list_numbers(y->constant, z->inner);
        list_integers(y->few.count, z->inner), list_integers(y->few.column, z->inner * MBS_STAGES_FEW);
        list_integers(y->variable, spare), list_integers(y->row, spare);
        if (y->lane == 0) {
            list_numbers(y->factors.lower, y->capacity * MBS_STAGES_TOGETHER);
            list_numbers(y->factors.inverse, z->inner * MBS_STAGES_TOGETHER);
        }
        LAW("patterns are the caller's", !z->patterns || (t->E.begin == de_column && t->H.row == h_row));
        if (k > 0 && y->pivots == r->stage[k - 1].inner.pivots)
            continue;
        list(y->pivots, 1, sizeof *y->pivots);
        list_integers(y->pivots->row, z->inner), list_integers(y->pivots->column, z->inner);
        list_integers(y->pivots->entry, z->inner + 1), list_integers(y->pivots->lower, z->inner + 1);
        list_integers(y->pivots->upper, z->inner + 1);
        list_integers(y->pivots->lower_place, y->capacity), list_integers(y->pivots->lower_row, y->capacity);
        list_integers(y->pivots->upper_place, y->capacity), list_integers(y->pivots->upper_column, y->capacity);
        list_integers(y->pivots->entry_at, y->pivots->entries), list_integers(y->pivots->entry_place,
            y->pivots->entries);
        LAW("orders are of the inner block", y->pivots->n == z->inner && y->pivots->first == z->nx);
        LAW("with room for its factors", y->pivots->capacity == y->capacity);
        for (i = 0; i < 4 && z->patterns == NULL; ++i) {
            const mbs_stages_matrix *const each[] = {&t->E, &t->F, &t->G, &t->H};
            list_integers(each[i]->begin, all), list_integers(each[i]->end, all);
            list_integers(each[i]->row, each[i]->count);
        }
    }
    marks = 10;
    list_step(&r->root, 0, 5, 10, 0);
    for (i = 0; i < 4; ++i)
        list_numbers(r->work[i], (outer + rows) * outer);
    list(r->marks, marks * marks, 1);
    list(r->scratch, workers ? workers : 1, sizeof *r->scratch);
    for (k = 0; k < (workers ? workers : 1); ++k) {
        for (i = 0; i < 8; ++i)
            list_numbers(r->scratch[k].vector[i], 2 * (variables + 4) + own_rows);
        for (i = 0; i < 3; ++i)
            list_numbers(r->scratch[k].together[i], marks * MBS_STAGES_TOGETHER);
        list_numbers(r->scratch[k].block, marks * marks), list_numbers(r->scratch[k].right, marks * 16);
        list_integers(r->scratch[k].spots, most_of(own_rows, 4 * marks));
    }
    list_numbers(r->diagonal, n), list_numbers(r->compliance, m);
    list_phase(&s->main, n + slacks, m), list_phase(&s->least, n + slacks + 2 * m, m);
    list_numbers(s->main.watchdog.x, n + slacks), list_numbers(s->main.watchdog.zl, n + slacks);
    list_numbers(s->main.watchdog.zu, n + slacks), list_numbers(s->main.watchdog.y, m);
    list_numbers(s->main.watchdog.c, m), list_direction(&s->main.watchdog.step, n + slacks, m);
    list(s->fixed, n + slacks + 2 * m, 1), list(s->softened, m, 1), list(s->failed, STAGES, 1);
    list_numbers(s->costs, STAGES);
    list_numbers(s->point.w, n), list_numbers(s->point.below, n), list_numbers(s->point.above, n);
    list_numbers(s->variable_scale, n), list_numbers(s->raw_w, n), list_numbers(s->rw, n), list_numbers(s->dw, n);
    list_numbers(s->residual_w, n), list_numbers(s->best_w, n), list_numbers(s->reference, n),
        list_numbers(s->weight, n);
    list_numbers(s->point.y, m), list_numbers(s->row_scale, m), list_numbers(s->raw_rows, m), list_numbers(s->rc, m);
    list_numbers(s->dy, m), list_numbers(s->residual_c, m), list_numbers(s->best_y, m), list_numbers(s->gives, m);
    list_numbers(s->slack, slacks), list_numbers(s->slack_below, slacks), list_numbers(s->slack_above, slacks);
    compare_rooms(memory, mbs_stages_bytes(&problem));
    LAW("all are counted", s->variables == n && s->rows == m && s->slacks == slacks);
    LAW("for the caller", s->point.variables == n && s->point.rows == m);
    LAW("and the recursion", r->variables == n && r->rows == m && r->stages == STAGES && r->fixed == s->fixed);
    LAW("which has the team", r->team == problem.team);
}

/* Stages of a kind share patterns and orders; stages of a group share factors. */
static void shares(void)
{
    static const int lane[STAGES] = {0, 0, 0, 1, 2, 0, 0, 1, 0};
    const mbs_stages *s;
    const mbs_stages_stage *t;
    int k, i, j;
    anew();
    s = make(), t = s->recursion.stage;
    for (k = 2; k < STAGES; ++k)
        LAW("stages of a kind that follow each other are in a group", t[k].inner.lane == lane[k]);
    LAW("stages of a kind share an order",
        t[2].inner.pivots == t[3].inner.pivots && t[6].inner.pivots == t[7].inner.pivots);
    LAW("not others", t[4].inner.pivots != t[5].inner.pivots && t[7].inner.pivots != t[8].inner.pivots);
    LAW("stages of a group share factors", t[3].inner.factors.lower == t[2].inner.factors.lower &&
                                            t[4].inner.factors.inverse == t[2].inner.factors.inverse);
    LAW("dense stages of a kind share the pattern",
        t[6].E.row == t[7].E.row && t[6].H.begin == t[7].H.begin && t[7].E.row != t[8].E.row);
    for (j = 0; j < 7; ++j) {
        LAW("of all entries", t[7].E.begin[j] == 3 * j && t[7].E.end[j] == 3 * j + 3);
        LAW("or of the lower triangle", t[7].H.begin[j] == 7 * j + j && t[7].H.end[j] == 7 * j + 7);
        for (i = 0; i < 7; ++i)
            LAW("row by row", t[7].H.row[7 * j + i] == i && (i > 2 || t[7].E.row[3 * j + i] == i));
    }
    LAW("stages without inner variables need none", t[0].E.begin == NULL && t[0].inner.pivots == NULL);
    LAW("first states that no inner equation reads are skipped in whole lanes",
        t[2].inner.skip == 4 && t[5].inner.skip == 0);
    LAW("inner variables without curvature are known", !t[2].inner.curved && t[5].inner.curved && t[7].inner.curved);
    LAW("an inner block has its nonzeros", t[2].inner.pivots->entries == 10 && t[5].inner.pivots->entries == 100);
    LAW("factors have room for four times as many, and equations", t[2].inner.capacity == 80);
    LAW("if there are so many places", t[5].inner.capacity == 90 && t[7].inner.capacity == 2);
    LAW("nothing is condensed yet", t[2].inner.stale == 1 && t[8].inner.stale == 1);
}

/* Which inner variables are curved, and which states are read, by the pattern. */
static void reads(void)
{
    static int column[18], row[18];
    int j, k;
    anew();
    for (j = 0; j < 17; ++j) {
        for (k = 0; k < 18; ++k)
            column[k] = k > j;
        row[0] = j < 12 ? 12 : 16;
        patterns.h.column = column, patterns.h.row = row;
        LAW("a nonzero of a column or a row of inner variables", make()->recursion.stage[2].inner.curved == (j < 15));
        row[0] = j < 5 ? 4 : 16;
        LAW("but not of others", j >= 5 || !make()->recursion.stage[2].inner.curved);
        row[0] = j < 5 ? 15 : 16;
        LAW("nor of those after them", j >= 5 || !make()->recursion.stage[2].inner.curved);
        row[0] = j < 5 ? 5 : 16;
        LAW("from the first on", j >= 5 || make()->recursion.stage[2].inner.curved);
        row[0] = j < 5 ? 14 : 16;
        LAW("to the last", j >= 5 || make()->recursion.stage[2].inner.curved);
    }
    patterns.h.column = h_column, patterns.h.row = h_row;
    for (j = 0; j < 17; ++j) {
        for (k = 0; k < 18; ++k)
            column[k] = k > j;
        row[0] = 9, patterns.de.column = column, patterns.de.row = row;
        LAW("states are skipped up to one that an inner equation reads",
            make()->recursion.stage[2].inner.skip == (j < 4 ? 0 : 4));
        row[0] = 10;
        LAW("others may be read", make()->recursion.stage[2].inner.skip == 4);
    }
    sizes[2].nx = 3, sizes[2].nv = 14; /* 10 inner variables from column 3 on, and none is read */
    LAW("inner variables are no states", make()->recursion.stage[2].inner.skip == 0);
    patterns.de.column = de_column, patterns.de.row = de_row;
}

/* Stages are of one kind if all their sizes are, and the next stages have as many states. */
static void kinds(void)
{
    int *const each[] = {&sizes[4].nx, &sizes[4].nv, &sizes[4].ne, &sizes[4].ng, &sizes[4].inner};
    int i, k;
    anew();
    problem.stages = 5;
    for (k = 2; k < 5; ++k)
        LAW("the last one of a kind is found", last_alike(&problem, k) == (k == 3 ? 2 : k));
    problem.stages = STAGES;
    LAW("wherever it is", last_alike(&problem, 4) == 3 && last_alike(&problem, 0) == 0 && last_alike(&problem, 1) == 0);
    for (i = 0; i < 5; ++i) {
        anew();
        --*each[i];
        LAW("sizes differ", last_alike(&problem, 4) == 4 && are_alike(&problem, 3, 2) == (i > 0));
    }
    anew();
    sizes[4].patterns = NULL;
    LAW("or patterns do", !are_alike(&problem, 4, 3) && are_alike(&problem, 3, 2));
    sizes[0].nx = sizes[2].nx = 9, sizes[2] = sizes[0], sizes[3].nx = sizes[1].nx;
    LAW("next stages may have other sizes", are_alike(&problem, 2, 0) && are_alike(&problem, 0, 2));
    ++sizes[3].nx;
    LAW("the same ones", !are_alike(&problem, 2, 0) && !are_alike(&problem, 0, 2));
    sizes[3].nx = 9;
    LAW("in the next ones", !are_alike(&problem, 2, 0) && !are_alike(&problem, 0, 2));
    LAW("the last one is none of them",
        !are_alike(&problem, 8, 7) && !are_alike(&problem, 7, 8) && are_alike(&problem, 8, 8));
}

static void refuses(void)
{
    int *const negative[] = {&sizes[3].nx, &sizes[3].nv, &sizes[3].ne, &sizes[3].ng, &sizes[3].inner};
    static int column[18], row[18];
    mbs_stages *s;
    size_t bytes;
    int i, k;
    for (i = 0; i < 5; ++i) {
        anew();
        *negative[i] = -1;
        LAW("sizes are not negative",
            mbs_stages_bytes(&problem) == 0 && mbs_stages_create(&problem, memory, 1000000) == NULL);
    }
    anew();
    problem.stages = 0;
    LAW("there is a stage", mbs_stages_bytes(&problem) == 0);
    anew(), problem.size = NULL;
    LAW("with sizes", mbs_stages_bytes(&problem) == 0);
    anew(), problem.values = NULL;
    LAW("values", mbs_stages_bytes(&problem) == 0);
    anew(), problem.jacobians = NULL;
    LAW("derivatives", mbs_stages_bytes(&problem) == 0);
    anew(), problem.hessian = NULL;
    LAW("and second ones", mbs_stages_bytes(&problem) == 0);
    anew();
    problem.team = &team, team = (mbs_stages_team){0, spread, NULL, NULL};
    LAW("a team has a worker", mbs_stages_bytes(&problem) == 0);
    team = (mbs_stages_team){1, NULL, NULL, NULL};
    LAW("and spreads its work", mbs_stages_bytes(&problem) == 0);
    team.spread = spread;
    LAW("one is enough", mbs_stages_bytes(&problem) > 0);
    anew();
    sizes[7].inner = 3, sizes[7].nv = 3, sizes[7].ne = 3;
    LAW("all variables and rows may be inner ones", mbs_stages_bytes(&problem) > 0);
    sizes[7].nv = 2;
    LAW("no more", mbs_stages_bytes(&problem) == 0);
    sizes[7].nv = 3, sizes[7].ne = 2;
    LAW("of either", mbs_stages_bytes(&problem) == 0);
    anew();
    sizes[0] = (mbs_stages_size){0, 0, 0, 0, 0, NULL}, problem.stages = 1;
    LAW("a stage may be empty", mbs_stages_bytes(&problem) > 0);
    anew();
    bytes = mbs_stages_bytes(&problem);
    s = make();
    LAW("a workspace is large enough", s != NULL && mbs_stages_create(&problem, memory, bytes) != NULL);
    LAW("or there is no solver",
        mbs_stages_create(&problem, memory, bytes - 1) == NULL && mbs_stages_create(&problem, NULL, bytes) == NULL);
    sizes[8] = sizes[4];
    LAW("nothing follows the last stage", mbs_stages_bytes(&problem) == 0);
    anew();
    for (i = 0; i < 4; ++i) {
        const mbs_stages_patterns right = patterns;
        mbs_stages_pattern *const each[] = {&patterns.de, &patterns.dd, &patterns.dg, &patterns.h};
        const int rows = i == 0 ? 11 : i == 1 ? 5 : i == 2 ? 1 : 17;
        each[i]->column = NULL;
        LAW("a pattern has columns", mbs_stages_bytes(&problem) == 0);
        for (k = 0; k < 18; ++k)
            column[k] = k > 3, row[k] = rows - 1;
        each[i]->column = column, each[i]->row = row;
        LAW("rows that are there", mbs_stages_bytes(&problem) > 0);
        row[0] = rows;
        LAW("no others", mbs_stages_bytes(&problem) == 0);
        row[0] = -1;
        LAW("none before the first", mbs_stages_bytes(&problem) == 0);
        column[1] = column[2] = column[3] = 1;
        LAW("in the first column too", mbs_stages_bytes(&problem) == 0);
        column[1] = column[2] = column[3] = 0;
        row[0] = 3;
        LAW("in a triangle from the diagonal on", (mbs_stages_bytes(&problem) > 0) == (rows > 3));
        row[0] = 2;
        LAW("and elsewhere from the first", (mbs_stages_bytes(&problem) > 0) == (i < 2));
        each[i]->row = NULL;
        LAW("a pattern with nonzeros has rows", mbs_stages_bytes(&problem) == 0);
        for (k = 0; k < 18; ++k)
            column[k] = 0;
        LAW("one without needs none", mbs_stages_bytes(&problem) > 0);
        for (k = 0; k < 18; ++k)
            column[k] = k > 3 ? 2 : 0, row[k] = 4;
        each[i]->row = row;
        LAW("rows increase", mbs_stages_bytes(&problem) == 0);
        row[0] = 3;
        LAW("in a column", (mbs_stages_bytes(&problem) > 0) == (rows > 4));
        for (k = 0; k < 18; ++k)
            column[k] = k == 3 ? 1 : 0, row[k] = 4;
        LAW("columns follow each other", mbs_stages_bytes(&problem) == 0);
        for (k = 0; k < 18; ++k)
            column[k] = 1;
        LAW("from the first nonzero", mbs_stages_bytes(&problem) == 0);
        patterns = right;
    }
}

/* What a new solver holds. */
static void begins(void)
{
    mbs_stages *s;
    mbs_stages_point point;
    int k, i;
    anew();
    s = make(), point = mbs_stages_iterate(s);
    LAW("the iterate is the solver's",
        point.w == s->point.w && point.y == s->point.y && point.below == s->point.below &&
                                           point.above == s->point.above);
    for (i = 0; i < point.variables; ++i)
        LAW("all are 0 at first",
            point.w[i] == 0 && point.below[i] == 0 && point.above[i] == 0 && s->variable_scale[i] == 0);
    for (i = 0; i < point.rows; ++i)
        LAW("multipliers too", point.y[i] == 0 && s->best_y[i] == 0);
    for (k = 0; k < STAGES; ++k) {
        const mbs_stages_stage *t = &s->recursion.stage[k];
        const mbs_stages_place p = mbs_stages_places(s, k);
        LAW("places are for the caller",
            p.x == t->w && p.v == t->w + sizes[k].nx && p.e == t->e && p.d == t->d && p.g == t->g);
    }
    LAW("the other problem is of least violation", s->least.elastic && !s->main.elastic);
    LAW("both have the solver's options", s->main.options == &s->options && s->least.options == &s->options);
    LAW("pivots are judged by the precision",
        s->recursion.zero_pivot == MBS_STAGES_ZERO && s->recursion.small_pivot == MBS_STAGES_SMALL);
    LAW("growth too",
        s->recursion.growth == MBS_STAGES_GROWTH && near(s->recursion.zero_curvature, 10 * MBS_STAGES_EPSILON));
    problem.lower = NULL;
    LAW("without bounds none are equal", make()->recursion.stage[0].equal == 0);
    problem.lower = lower, problem.upper = NULL;
    LAW("of either side", make()->recursion.stage[0].equal == 0);
    problem.upper = upper, problem.least = NULL;
    LAW("nor of rows", make()->recursion.stage[0].equal == 0);
    problem.least = least, problem.most = NULL;
    LAW("either", make()->recursion.stage[0].equal == 0);
}

int main(void)
{
    rooms(0);
    rooms(3);
    shares();
    reads();
    kinds();
    refuses();
    begins();
    free(memory);
    return broken > 0;
}
