/* Optimality conditions of stages at random: laid out by the solver, factorised, and compared with their equations.
 *
 *     (H + diagonal + curvature) dw + JT dy = -rw,   J dw - compliance dy = -rc,   dw = 0 where fixed.
 *
 * Matrices are kept apart, as all their entries; of the dense Hessians that the recursion reads, the upper triangle is
 * no number. */
#ifndef KKT_H
#define KKT_H

#include "condense.h"
#include "laws.h"

#include <math.h>
#include <stdlib.h>

enum { KINDS = 3, STAGES = 12, MOST = 26, ALL = STAGES * MOST * 2, WORKERS = 3 };
/* APART: sparse, no inner equation reads the first 5 states, no inner variable is curved. CARRIED: sparse, the dynamics
 * alone read the first 5 states, and multiply each by a number. */
enum { DENSE, SPARSE, APART, CARRIED };

/* A kind of stages. The first `inner` rows of e give as many of the first v. */
typedef struct {
    int nx, nv, ne, ng, inner, entries;
} kkt_kind;

typedef struct {
    kkt_kind kinds[KINDS];
    int stages, kind[STAGES];
} kkt_shape;

static kkt_shape shape;
static mbs_stages_size sizes[STAGES];
static mbs_stages_patterns patterns[KINDS];
static int begins[KINDS][4][MOST + 1], rows_of[KINDS][4][MOST * MOST];
static char masks[KINDS][4][MOST * MOST];
static real entries[STAGES][4][MOST * MOST]; /* E, F, G, and the lower triangle of H: row by row */
static real rw[ALL], rc[ALL], dw[ALL], dy[ALL], lower_of[ALL], upper_of[ALL];
static void *apart[6]; /* arrays of the solver, each in separate memory, beyond whose ends nobody reads */
static mbs_stages_problem problem;
static mbs_stages_team team;
static mbs_stages *kkt;
static void *room;
static unsigned kkt_seed = 7;

static real draw(void)
{
    kkt_seed = kkt_seed * 1103515245u + 12345u;
    return (real)(kkt_seed / 65536 % 2001) / 1000 - 1;
}

static int no_values(void *c, int k, const real *x, const real *v, real *f, real *e, real *d, real *g)
{
    (void)c, (void)k, (void)x, (void)v, (void)f, (void)e, (void)d, (void)g;
    return -1;
}

static int no_jacobians(void *c, int k, const real *x, const real *v, real *df, real *de, real *dd, real *dg)
{
    (void)c, (void)k, (void)x, (void)v, (void)df, (void)de, (void)dd, (void)dg;
    return -1;
}

static int no_hessian(void *c, int k, const real *x, const real *v, real f, const real *ye, const real *yd,
                      const real *yg, real *h)
{
    (void)c, (void)k, (void)x, (void)v, (void)f, (void)ye, (void)yd, (void)yg, (void)h;
    return -1;
}

/* Cut the stages at random, and let the last part come first. */
static void spread(void *pool, int count, mbs_stages_task task, void *data)
{
    int cut = count;
    LAW("a team gets its pool", pool == &team);
    while (cut > 0) {
        const int from = cut - 1 - (int)((1 + draw()) / 2 * (real)(cut - 1) * (real)0.7);
        task(data, from, cut, cut % WORKERS);
        cut = from;
    }
}

static int kkt_next(int k)
{
    return k + 1 < shape.stages ? sizes[k + 1].nx : 0;
}

static int kkt_rows(int k, int which)
{
    const mbs_stages_size *z = &sizes[k];
    return which == 0 ? z->ne : which == 1 ? kkt_next(k) : which == 2 ? z->ng : z->nx + z->nv;
}

/* Let some rows of a stage that are not inner ones give, and some stages have curvature, by turns. */
static void vary_stage(int k, int turn)
{
    mbs_stages_recursion *r = &kkt->recursion;
    mbs_stages_stage *t = &r->stage[k];
    int i;
    for (i = t->inner.n; i < t->ne; ++i)
        r->compliance[t->e + i] = (i + k + turn) % 2 ? (real)(2 + k) / 4 : 0;
    for (i = 0; i < t->ng; ++i)
        r->compliance[t->g + i] = (i + k + turn) % 2 ? 0 : (real)(3 + i) / 4;
    t->curvature = (k + turn) % 3 == 2 ? 0 : (real)(1 + k % 2) / 2;
}

static int is_inner_of(const mbs_stages_size *z, int i)
{
    return i >= z->nx && i < z->nx + z->inner;
}

/* Whether an entry is among the nonzeros of a kind. */
static int draw_mask(const kkt_kind *z, int which, int i, int j)
{
    const int inner = j >= z->nx && j < z->nx + z->inner;
    if (which == 3 && i < j)
        return 0;
    if (z->entries == DENSE)
        return 1;
    if (z->entries == CARRIED && (j < 5 || (which == 1 && i < 5)))
        return which == 1 && i == j;
    if (which == 0 && i < z->inner && z->entries == APART && j < 5)
        return 0;
    if (which == 3 && z->entries == APART && (inner || (i >= z->nx && i < z->nx + z->inner)))
        return 0;
    return (which == 0 && i == j - z->nx) || draw() > (real)-0.5;
}

/* Draw the pattern of a kind: `rows` of the matrix. */
static void draw_pattern(int kind, int which, int rows)
{
    const kkt_kind *z = &shape.kinds[kind];
    int i, j, at = 0;
    for (j = 0; j < z->nx + z->nv; ++j) {
        begins[kind][which][j] = at;
        for (i = 0; i < rows; ++i) {
            masks[kind][which][i * MOST + j] = (char)draw_mask(z, which, i, j);
            if (masks[kind][which][i * MOST + j])
                rows_of[kind][which][at++] = i;
        }
        begins[kind][which][j + 1] = at;
    }
}

static mbs_stages_matrix *kkt_matrix(int k, int which)
{
    mbs_stages_stage *t = &kkt->recursion.stage[k];
    return which == 0 ? &t->E : which == 1 ? &t->F : which == 2 ? &t->G : &t->H;
}

/* Write the entries of a stage where the recursion reads them. */
static void write_stage(int k)
{
    int which, i, j, at;
    for (which = 0; which < 4; ++which) {
        const int rows = kkt_rows(k, which);
        real *value = kkt_matrix(k, which)->value;
        for (j = 0, at = 0; j < sizes[k].nx + sizes[k].nv; ++j)
            for (i = 0; i < rows; ++i) {
                const int is_there = masks[shape.kind[k]][which][i * MOST + j];
                if (sizes[k].patterns == NULL)
                    value[j * rows + i] = is_there ? entries[k][which][i * MOST + j] : (real)NAN;
                else if (is_there)
                    value[at++] = entries[k][which][i * MOST + j];
            }
    }
    kkt->recursion.stage[k].inner.stale = 1;
}

/* Draw the entries of a stage: inner equations that give their variables well, a convex cost. */
static void draw_stage(int k)
{
    int which, i, j;
    memset(entries[k], 0, sizeof entries[k]);
    for (which = 0; which < 4; ++which)
        for (i = 0; i < kkt_rows(k, which); ++i)
            for (j = 0; j < sizes[k].nx + sizes[k].nv; ++j)
                if (masks[shape.kind[k]][which][i * MOST + j])
                    entries[k][which][i * MOST + j] =
                        which == 3 ? draw() / 2 + (i == j) : draw() * (real)0.6 + 3 * (which == 0 &&
                            i == j - sizes[k].nx);
    write_stage(k);
}

static void *set_apart(int place, const void *from, int count, size_t bytes)
{
    free(apart[place]);
    apart[place] = malloc((size_t)count * bytes);
    return memcpy(apart[place], from, (size_t)count * bytes);
}

/* Make a solver of a shape, and draw all numbers; nothing is fixed,
    and all rows are exact. `with_team`: workers cut the
 * stages. */
static void open_kkt(const kkt_shape *of, int with_team)
{
    mbs_stages_problem p = {0};
    int k, which, i;
    memset(sizes, 0, sizeof sizes);
    shape = *of;
    for (k = 0; k < shape.stages; ++k) {
        const kkt_kind *z = &shape.kinds[shape.kind[k]];
        mbs_stages_patterns *own = &patterns[shape.kind[k]];
        mbs_stages_pattern *const each[] = {&own->de, &own->dd, &own->dg, &own->h};
        sizes[k] = (mbs_stages_size){z->nx, z->nv, z->ne, z->ng, z->inner, z->entries == DENSE ? NULL : own};
        for (which = 0; which < 4; ++which)
            *each[which] = (mbs_stages_pattern){begins[shape.kind[k]][which], rows_of[shape.kind[k]][which]};
    }
    for (k = 0; k < shape.stages; ++k)
        for (which = 0; which < 4; ++which) /* stages of a sparse kind have as many next states */
            draw_pattern(shape.kind[k], which, kkt_rows(k, which));
    for (i = 0; i < ALL; ++i)
        lower_of[i] = upper_of[i] = (real)(i % 3 == 0);
    team = (mbs_stages_team){WORKERS, spread, &team, NULL};
    p.stages = shape.stages, p.size = sizes, p.values = no_values, p.jacobians = no_jacobians, p.hessian = no_hessian;
    p.lower = lower_of, p.upper = upper_of, p.team = with_team ? &team : NULL;
    problem = p;
    free(room);
    room = malloc(mbs_stages_bytes(&problem));
    kkt = mbs_stages_create(&problem, room, mbs_stages_bytes(&problem));
    kkt->recursion.stage = set_apart(0, kkt->recursion.stage, shape.stages, sizeof *kkt->recursion.stage);
    kkt->recursion.step = set_apart(1, kkt->recursion.step, shape.stages, sizeof *kkt->recursion.step);
    kkt->recursion.soft = set_apart(2, kkt->recursion.soft, shape.stages, sizeof *kkt->recursion.soft);
    kkt->fixed = set_apart(3, kkt->fixed, kkt->variables, 1), kkt->recursion.fixed = kkt->fixed;
    kkt->recursion.diagonal = set_apart(4, kkt->recursion.diagonal, kkt->variables, sizeof(real));
    kkt->recursion.compliance = set_apart(5, kkt->recursion.compliance, kkt->rows, sizeof(real));
    for (k = 0; k < shape.stages; ++k)
        draw_stage(k);
    for (i = 0; i < kkt->variables; ++i)
        kkt->recursion.diagonal[i] = 6 + draw();
}

static void draw_right(void)
{
    int i;
    for (i = 0; i < ALL; ++i)
        rw[i] = draw(), rc[i] = draw(), dw[i] = dy[i] = (real)NAN;
}

/* Whether curvature is added to a variable: all do but inner ones that are found from others. */
static int has_curvature(int k, int i)
{
    const mbs_stages_inner *y = &kkt->recursion.stage[k].inner;
    int l, is_found = is_inner_of(&sizes[k], i);
    for (l = 0; l < y->deferred; ++l)
        is_found = is_found && y->variable[l] != i - sizes[k].nx;
    return !is_found;
}

/* The larger of two numbers, which is none if one of them is none. */
static real larger(real a, real b)
{
    return a != a || a > b ? a : b;
}

/* The largest residual of the rows. */
static real row_residual(void)
{
    const mbs_stages_recursion *r = &kkt->recursion;
    real most = 0;
    int k, which, i, j;
    for (k = 0; k < shape.stages; ++k) {
        const mbs_stages_stage *t = &r->stage[k];
        for (which = 0; which < 3; ++which)
            for (i = 0; i < kkt_rows(k, which); ++i) {
                const int at = (which == 0 ? t->e : which == 1 ? t->d : t->g) + i;
                real sum = rc[at] - r->compliance[at] * dy[at];
                for (j = 0; j < t->n; ++j)
                    sum += entries[k][which][i * MOST + j] * dw[t->w + j];
                if (which == 1)
                    sum -= dw[r->stage[k + 1].w + i];
                most = larger(most, real_abs(sum));
            }
    }
    return most;
}

/* The largest derivative of the Lagrangian by variables that are not fixed, beside the largest multiplier. */
static real slope_residual(void)
{
    const mbs_stages_recursion *r = &kkt->recursion;
    real most = 0, size = 1;
    int k, i, j;
    for (i = 0; i < kkt->rows; ++i)
        size = real_abs(dy[i]) > size ? real_abs(dy[i]) : size;
    for (k = 0; k < shape.stages; ++k) {
        const mbs_stages_stage *t = &r->stage[k];
        for (i = 0; i < t->n; ++i) {
            real sum = rw[t->w + i] + (r->diagonal[t->w + i] + t->curvature * (real)has_curvature(k, i)) * dw[t->w + i];
            for (j = 0; j < t->n && !r->plain; ++j)
                sum += entries[k][3][i >= j ? i * MOST + j : j * MOST + i] * dw[t->w + j];
            for (j = 0; j < t->ne; ++j)
                sum += entries[k][0][j * MOST + i] * dy[t->e + j];
            for (j = 0; j < t->next; ++j)
                sum += entries[k][1][j * MOST + i] * dy[t->d + j];
            for (j = 0; j < t->ng; ++j)
                sum += entries[k][2][j * MOST + i] * dy[t->g + j];
            if (k > 0 && i < t->nx)
                sum -= dy[r->stage[k - 1].d + i];
            if (!r->fixed[t->w + i])
                most = larger(most, real_abs(sum));
        }
    }
    return most / size;
}

/* Whether fixed variables stay, and those before `first` move as they must. */
static int keeps_fixed(const real *move, int first)
{
    int i, kept = 1;
    for (i = 0; i < kkt->variables; ++i)
        if (kkt->recursion.fixed[i])
            kept = kept && (i < first ? real_abs(dw[i] - move[i]) < (real)1e-12 : dw[i] == 0);
    return kept;
}

/* Solve for right-hand sides at random, and compare. */
static void solve_kkt(const char *text)
{
    mbs_stages_recursion *r = &kkt->recursion;
    draw_right();
    mbs_stages_sweep(r, rw, rc, dw, dy);
    LAW(text, row_residual() < (real)1e-10);
    LAW(text, slope_residual() < (real)1e-9);
    LAW(text, keeps_fixed(NULL, 0));
    LAW(text, r->left < (real)1e-10);
}

/* Let inner rows from `rank` on be sums of the first two, in the inner variables. */
static void lose_rank(int k, int rank)
{
    const mbs_stages_size *z = &sizes[k];
    int i, j;
    for (i = rank; i < z->inner; ++i)
        for (j = z->nx; j < z->nx + z->inner; ++j) {
            const real first = entries[k][0][j], second = entries[k][0][MOST + j];
            entries[k][0][i * MOST + j] = rank < 1 ? 0 : rank < 2 ? first : first - second * (real)i;
        }
    write_stage(k);
}

#endif
