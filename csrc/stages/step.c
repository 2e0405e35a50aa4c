/* One step of the recursion: the cost z.Q z / 2 + q.z and rows M z + m = 0 of z = (x, v), reduced to x.
 *
 * Rows are eliminated by pivoting, first in the columns of v: by columns where a pivot is large in its row, then
 * completely. A row without pivot there is a condition on x; those are made independent in the same way, and the rest
 * has no pivot at all. With z = (x, free, pivots),
 *
 *     pivots = -(T r + t),  r = (x, free),   Q_rr - TT Q_pr - Q_rp T + TT Q_pp T = [KT; L] [K LT] + [P 0; 0 0].
 *
 * The cost of x and the conditions on x are all that an earlier stage needs to know (Vanroye, De Schutter, Decre: A
 * generalization of the Riccati recursion for equality-constrained linear quadratic optimal control, 2023). */
#include "step.h"

#include <string.h>

#define LARGE_BLOCK 32 /* rows of L that are lowered at once by all rows before them */
#define SMALL_BLOCK 8  /* the same by rows of the large block */

/* The inverse of the largest entry of each row. */
static void weigh_rows(const mbs_stages_step *p, real *weight)
{
    int i, j;
    memset(weight, 0, (size_t)p->rows * sizeof *weight);
    for (j = 0; j < p->n; ++j) {
        const real *a = p->lu + (size_t)j * (size_t)p->capacity;
        for (i = 0; i < p->rows; ++i)
            weight[i] = real_abs(a[i]) > weight[i] ? real_abs(a[i]) : weight[i];
    }
    for (i = 0; i < p->rows; ++i)
        weight[i] = weight[i] > 0 ? 1 / weight[i] : 0;
}

static void exchange_rows(mbs_stages_step *p, real *weight, int a, int b)
{
    const int row = p->row[a];
    const real w = weight[a];
    int j;
    if (a == b)
        return;
    p->row[a] = p->row[b], p->row[b] = row;
    weight[a] = weight[b], weight[b] = w;
    for (j = 0; j < p->n; ++j) {
        real *column = p->lu + (size_t)j * (size_t)p->capacity, t = column[a];
        column[a] = column[b], column[b] = t;
    }
}

/* The largest entry beside its row, at least `zero`: columns from .. to - 1 that hold no pivot. Returns 0 if none. */
static int find_pivot(const mbs_stages_step *p, const real *weight, const char *used, int from, int to, int done,
                      real zero, int *row, int *column)
{
    real most = zero;
    int i, j, found = 0;
    for (j = from; j < to; ++j) {
        const real *a = p->lu + (size_t)j * (size_t)p->capacity;
        if (used[j])
            continue;
        for (i = done; i < p->rows; ++i)
            if (real_abs(a[i]) * weight[i] > most) {
                most = real_abs(a[i]) * weight[i];
                *row = i;
                *column = j;
                found = 1;
            }
    }
    return found;
}

static void eliminate_below(mbs_stages_step *p, const char *used, int done, int column)
{
    real *factor = p->lu + (size_t)column * (size_t)p->capacity;
    int i, j;
    for (i = done + 1; i < p->rows; ++i)
        factor[i] /= factor[done];
    for (j = 0; j < p->n; ++j) {
        real *restrict a = p->lu + (size_t)j * (size_t)p->capacity;
        const real b = a[done];
        if (used[j] || b == 0)
            continue;
        for (i = done + 1; i < p->rows; ++i)
            a[i] -= factor[i] * b;
    }
}

/* Use a pivot. */
static void take_pivot(mbs_stages_step *p, real *weight, char *used, int done, int row, int column)
{
    exchange_rows(p, weight, done, row);
    used[column] = 1;
    p->column[done] = column;
    eliminate_below(p, used, done, column);
}

/* Eliminate column by column where the best pivot of a column is large in its row. That is the usual case of unknowns
 * that equations of their stage determine, and saves the search through all columns. */
static int eliminate_clear(mbs_stages_step *p, real *weight, char *used, int from, int to)
{
    int i, j, done = 0;
    for (j = from; j < to && done < p->rows; ++j) {
        const real *a = p->lu + (size_t)j * (size_t)p->capacity;
        real most = 0;
        int row = done;
        for (i = done; i < p->rows; ++i) {
            const real share = real_abs(a[i]) * weight[i];
            row = share > most ? i : row;
            most = share > most ? share : most;
        }
        if (most >= CLEAR_PIVOT)
            take_pivot(p, weight, used, done++, row, j);
    }
    return done;
}

/* Eliminate with pivots in columns from .. to - 1; returns how many pivots there are then. */
static int eliminate(mbs_stages_step *p, real *weight, char *used, int from, int to, int done, real zero)
{
    int row, column;
    while (done < p->rows && find_pivot(p, weight, used, from, to, done, zero, &row, &column))
        take_pivot(p, weight, used, done++, row, column);
    return done;
}

/* Order variables: x, free ones, pivots. */
static void order_variables(mbs_stages_step *p, const char *used)
{
    int i, at = 0;
    for (i = 0; i < p->n; ++i)
        if (i < p->nx || !used[i])
            p->order[at++] = i;
    for (i = 0; i < p->pivots; ++i)
        p->order[at++] = p->column[i];
    p->reduced = p->n - p->pivots;
    p->width = mbs_stages_width(p->reduced);
}

/* Rows of pivots: U, and T = U^-1 [x free]. */
static void solve_pivots(mbs_stages_step *p)
{
    const int m = p->pivots, n = p->reduced, *at = p->order;
    const size_t width = (size_t)p->width;
    int i, j;
    memset(p->T, 0, (size_t)m * width * sizeof *p->T);
    for (i = m - 1; i >= 0; --i) {
        real *u = p->U + (size_t)i * (size_t)m, *t = p->T + (size_t)i * width;
        for (j = 0; j < m; ++j)
            u[j] = p->lu[(size_t)at[n + j] * (size_t)p->capacity + (size_t)i];
        for (j = 0; j < n; ++j)
            t[j] = p->lu[(size_t)at[j] * (size_t)p->capacity + (size_t)i];
        mbs_stages_add_rows(p->width, m - i - 1, -1, u + i + 1, 1, t + width, p->width, t);
        for (j = 0; j < n; ++j)
            t[j] /= u[i];
    }
}

/* Rows that x must meet; where an earlier one of them has its pivot, `lu` holds a factor instead of 0. */
static void copy_passed(mbs_stages_step *p)
{
    const size_t width = (size_t)mbs_stages_width(p->nx);
    int i, j, l;
    for (i = 0; i < p->passed; ++i) {
        real *c = p->C + (size_t)i * width;
        memset(c, 0, width * sizeof *c);
        for (j = 0; j < p->nx; ++j)
            c[j] = p->lu[(size_t)j * (size_t)p->capacity + (size_t)(p->pivots + i)];
        for (l = 0; l < i; ++l)
            c[p->column[p->pivots + l]] = 0;
    }
}

/* Blocks of the cost in the order of variables: pp into p->Q, pr into p->Y, rr into `rr`. */
static void gather_cost(mbs_stages_step *p, real *quadratic, real *rr)
{
    const int m = p->pivots, n = p->reduced, all = mbs_stages_width(p->n), *at = p->order;
    const size_t width = (size_t)p->width;
    int i, j;
    mbs_stages_mirror(p->n, quadratic, all);
    memset(p->Y, 0, (size_t)m * width * sizeof *p->Y);
    memset(rr, 0, width * width * sizeof *rr);
    for (i = 0; i < p->n; ++i) {
        const real *row = quadratic + (size_t)at[i] * (size_t)all;
        real *to = i < n ? rr + (size_t)i * width : p->Y + (size_t)(i - n) * width;
        for (j = 0; j < n; ++j)
            to[j] = row[at[j]];
        for (j = n; i >= n && j < p->n; ++j)
            p->Q[(size_t)(i - n) * (size_t)m + (size_t)(j - n)] = row[at[j]];
    }
}

/* rr -= TT Y' + Y'T T with Y' = Q_pr - Q_pp T / 2; then Y = Q_pr - Q_pp T. */
static void substitute_pivots(mbs_stages_step *p, real *rr, real *half)
{
    const int m = p->pivots, width = p->width;
    const size_t count = (size_t)m * (size_t)width;
    size_t i;
    int j;
    memcpy(half, p->Y, count * sizeof *half);
    for (j = 0; j < m; ++j)
        mbs_stages_add_rows(width, m, (real)-0.5, p->Q + (size_t)j * (size_t)m, 1, p->T, width,
                            half + (size_t)j * (size_t)width);
    mbs_stages_gram(m, width, width, 1, -1, p->T, width, half, width, rr, width);
    mbs_stages_gram(m, width, width, 1, -1, half, width, p->T, width, rr, width);
    for (i = 0; i < count; ++i)
        p->Y[i] = 2 * half[i] - p->Y[i];
}

#if MBS_STAGES_ROOMY
/* Take `count` rows of L from row `from` on out of `rows` rows from row `first` on; columns before the first row's
 * diagonal that are not of x stay or change, and become 0 later. */
static void lower_rows(mbs_stages_step *p, int first, int rows, int from, int count)
{
    const int nx = mbs_stages_width(p->nx), at = p->nx + first, tiles = rows / 4 * 4;
    const int begin = at / MBS_STAGES_LANES * MBS_STAGES_LANES > nx ? at / MBS_STAGES_LANES * MBS_STAGES_LANES : nx;
    const size_t width = (size_t)p->width;
    const real *L = p->L + (size_t)from * width;
    real *to = p->L + (size_t)first * width;
    int i;
    if (tiles > 0) {
        mbs_stages_gram(count, tiles, nx, 0, -1, L + at, p->width, L, p->width, to, p->width);
        mbs_stages_gram(count, tiles, p->width - begin, 0, -1, L + at, p->width, L + begin, p->width, to + begin,
                        p->width);
    }
    for (i = tiles; i < rows; ++i)
        mbs_stages_add_rows(p->width, count, -1, L + at + i, p->width, L, p->width, to + (size_t)i * width);
}

/* Take the rows before row i of L out of it, and out of others that follow it, where a block begins. */
static void lower_row(mbs_stages_step *p, int i)
{
    const int end = p->reduced - p->nx, large = i / LARGE_BLOCK * LARGE_BLOCK, small = i / SMALL_BLOCK * SMALL_BLOCK;
    if (i == large && i > 0)
        lower_rows(p, i, end - i < LARGE_BLOCK ? end - i : LARGE_BLOCK, 0, i);
    if (i == small && i > large)
        lower_rows(p, i, end - i < SMALL_BLOCK ? end - i : SMALL_BLOCK, large, i - large);
    if (i > small)
        lower_rows(p, i, 1, small, i - small);
}
#else
static void lower_row(mbs_stages_step *p, int i)
{
    mbs_stages_add_rows(p->width, i, -1, p->L + p->nx + i, p->width, p->L, p->width, p->L + (size_t)i * (size_t)p->width);
}
#endif

/* Factorise the free variables: rows (K LT), with the inverse of L's diagonal, and 0 before it. Where a pivot is too small,
 * `lost` notes whether that may be rounding. */
static int factorise_free(mbs_stages_step *p, const real *rr, real zero_curvature)
{
    const int nx = p->nx, free_ones = p->reduced - nx, width = p->width;
    int i;
    memcpy(p->L, rr + (size_t)nx * (size_t)width, (size_t)free_ones * (size_t)width * sizeof *rr);
    mbs_stages_mirror(free_ones, p->L + nx, width);
    for (i = 0; i < free_ones; ++i) {
        real *row = p->L + (size_t)i * (size_t)width, pivot = rr[(size_t)(nx + i) * (size_t)(width + 1)], scale;
        lower_row(p, i);
        if (MBS_STAGES_SEARCHES)
            p->lost = !(real_abs(row[nx + i]) > PIVOT_ROUNDING * real_abs(pivot));
        if (!(row[nx + i] > zero_curvature * real_abs(pivot)))
            return -1;
        scale = 1 / real_sqrt(row[nx + i]);
        mbs_stages_scale_row(width, scale, row, row);
        memset(row + nx, 0, (size_t)i * sizeof *row);
        row[nx + i] = scale;
    }
    return 0;
}

/* Take the free variables out of the cost of x: P = rr - KT K. Rows of them in `rr` are overwritten. */
static void reduce_cost(mbs_stages_step *p, real *rr)
{
    const int nx = p->nx;
    const size_t width = (size_t)mbs_stages_width(nx);
    int i, j;
    mbs_stages_gram(p->reduced - nx, (int)width, (int)width, 1, -1, p->L, p->width, p->L, p->width, rr, p->width);
    for (i = 0; i < nx; ++i) {
        const real *from = rr + (size_t)i * (size_t)p->width;
        real *to = p->P + (size_t)i * width;
        for (j = 0; j <= i; ++j)
            to[j] = p->P[(size_t)j * width + (size_t)i] = from[j];
        memset(to + nx, 0, (width - (size_t)nx) * sizeof *to);
    }
}

int mbs_stages_reduce(mbs_stages_step *p, real *quadratic, real *const *work, real zero_pivot, real zero_curvature)
{
    real *weight = work[0], *rr = quadratic;
    char *used = (char *)work[1];
    int i;
    memset(used, 0, (size_t)p->n);
    for (i = 0; i < p->rows; ++i)
        p->row[i] = i;
    weigh_rows(p, weight);
    p->pivots = eliminate_clear(p, weight, used, p->nx, p->n);
    p->pivots = eliminate(p, weight, used, p->nx, p->n, p->pivots, zero_pivot);
    order_variables(p, used);
    for (i = p->nx; i < p->n; ++i)
        used[i] = 1;
    p->passed = eliminate(p, weight, used, 0, p->nx, p->pivots, zero_pivot) - p->pivots;
    copy_passed(p);
    if (p->pivots > 0) {
        rr = work[0];
        solve_pivots(p);
        gather_cost(p, quadratic, rr);
        substitute_pivots(p, rr, work[1]);
    }
    if (factorise_free(p, rr, zero_curvature))
        return -1;
    reduce_cost(p, rr);
    return 0;
}

/* Constants of the rows in their new places, eliminated as the rows were. */
static void eliminate_constants(mbs_stages_step *p, real *constant, real *m)
{
    const int done = p->pivots + p->passed;
    int i, r;
    for (i = 0; i < p->rows; ++i)
        m[i] = constant[p->row[i]];
    for (r = 0; r < done; ++r) {
        const real *factor = p->lu + (size_t)p->column[r] * (size_t)p->capacity;
        for (i = r + 1; i < p->rows; ++i)
            m[i] -= factor[i] * m[r];
    }
    p->left = 0;
    for (i = done; i < p->rows; ++i)
        p->left = real_abs(m[i]) > p->left ? real_abs(m[i]) : p->left;
}

/* x of U x = x, or of UT x = x; U lies row by row. */
static void solve_upper(const mbs_stages_step *p, real *x)
{
    mbs_stages_lower_transposed(p->pivots, p->U, p->pivots, x);
}

static void solve_upper_transposed(const mbs_stages_step *p, real *x)
{
    mbs_stages_lower(p->pivots, p->U, p->pivots, x);
}

/* The derivatives of the cost by r, without pivots. */
static void reduce_linear(mbs_stages_step *p, const real *linear, real *q)
{
    const int m = p->pivots, n = p->reduced, width = p->width, *at = p->order;
    int i;
    for (i = 0; i < n; ++i)
        q[i] = linear[at[i]];
    for (; i < width; ++i)
        q[i] = 0;
    for (i = 0; i < m; ++i)
        p->qp[i] = linear[at[n + i]];
    mbs_stages_add_rows(width, m, -1, p->qp, 1, p->T, width, q);
    mbs_stages_add_rows(width, m, -1, p->t, 1, p->Y, width, q);
    mbs_stages_apply_transposed(m, m, -1, p->Q, m, p->t, p->qp);
}

void mbs_stages_step_back(mbs_stages_step *p, const real *linear, real *constant, real *vector)
{
    const int m = p->pivots, free_ones = p->reduced - p->nx, width = p->width;
    real *q = vector;
    int i;
    eliminate_constants(p, constant, vector);
    for (i = 0; i < m; ++i)
        p->t[i] = vector[i];
    for (i = 0; i < p->passed; ++i)
        p->c[i] = vector[m + i];
    solve_upper(p, p->t);
    reduce_linear(p, linear, q);
    for (i = 0; i < free_ones; ++i) {
        const real *row = p->L + (size_t)i * (size_t)width, l = p->l[i] = q[p->nx + i] * row[p->nx + i];
        mbs_stages_add_row(width, -l, row, q);
    }
    memcpy(p->p, q, (size_t)p->nx * sizeof *q);
}

/* Multipliers of all rows, from the gradient of the cost by the pivots and the multipliers of rows passed on. */
static void find_multipliers(const mbs_stages_step *p, const real *r, const real *passed, real *y, real *m)
{
    const int done = p->pivots + p->passed;
    int i, j;
    for (i = 0; i < p->pivots; ++i)
        m[i] = -p->qp[i] - mbs_stages_dot(p->width, p->Y + (size_t)i * (size_t)p->width, r);
    solve_upper_transposed(p, m);
    for (i = 0; i < p->passed; ++i)
        m[p->pivots + i] = passed[i];
    for (i = done; i < p->rows; ++i)
        m[i] = 0;
    for (j = done - 1; j >= 0; --j) {
        const real *factor = p->lu + (size_t)p->column[j] * (size_t)p->capacity;
        for (i = j + 1; i < p->rows; ++i)
            m[j] -= factor[i] * m[i];
    }
    for (i = 0; i < p->rows; ++i)
        y[p->row[i]] = m[i];
}

void mbs_stages_step_ahead(const mbs_stages_step *p, const real *x, const real *passed, real *z, real *y,
                           real *vector)
{
    const int nx = p->nx, n = p->reduced, width = p->width, *at = p->order;
    real *r = vector, *pivot = vector + width;
    int i;
    memcpy(r, x, (size_t)nx * sizeof *r);
    memset(r + nx, 0, (size_t)(width - nx) * sizeof *r);
    for (i = n - nx - 1; i >= 0; --i) {
        const real *row = p->L + (size_t)i * (size_t)width;
        r[nx + i] = -(p->l[i] + mbs_stages_dot(width, row, r)) * row[nx + i];
    }
    for (i = 0; i < p->pivots; ++i)
        pivot[i] = -p->t[i] - mbs_stages_dot(width, p->T + (size_t)i * (size_t)width, r);
    for (i = 0; i < n; ++i)
        z[at[i]] = r[i];
    for (i = 0; i < p->pivots; ++i)
        z[at[n + i]] = pivot[i];
    find_multipliers(p, r, passed, y, pivot);
}
