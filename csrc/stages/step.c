/* One step of the recursion: the cost z.Q z / 2 + q.z and rows M z + m = 0 of z = (x, v), reduced to x.
 *
 * Rows are eliminated by pivoting, first in the columns of v: by columns where a pivot is large in its row, then
 * completely. A row without pivot there is a condition on x; those are made independent in the same way, and the rest
 * has no pivot at all. With z = (pivots, free, x),
 *
 *     pivots = -(T r + t),  r = (free, x),   Q_rr - TT Q_pr - Q_rp T + TT Q_pp T = [L; K] [LT KT] + [0 0; 0 P].
 *
 * The cost of x and the conditions on x are all that an earlier stage needs to know (Vanroye, De Schutter, Decre: A
 * generalization of the Riccati recursion for equality-constrained linear quadratic optimal control, 2023). */
#include "step.h"

#include <string.h>

#define CLEAR ((real)0.25) /* share of a pivot in its row that needs no better one */

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
        if (most >= CLEAR)
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

/* Order variables: pivots, free ones, x. */
static void order_variables(mbs_stages_step *p, const char *used)
{
    int i, at = 0;
    for (i = 0; i < p->pivots; ++i)
        p->order[at++] = p->column[i];
    for (i = p->nx; i < p->n; ++i)
        if (!used[i])
            p->order[at++] = i;
    for (i = 0; i < p->nx; ++i)
        p->order[at++] = i;
    p->reduced = p->n - p->pivots;
}

/* Rows of pivots: U, and T = U^-1 [free x]; TT, row after row of T, stays in `turned`. */
static void solve_pivots(mbs_stages_step *p, real *turned, real *row)
{
    const int m = p->pivots, n = p->reduced;
    int i, j;
    for (j = 0; j < p->n; ++j) {
        const real *from = p->lu + (size_t)p->order[j] * (size_t)p->capacity;
        real *to = j < m ? p->U + (size_t)j * (size_t)m : p->T + (size_t)(j - m) * (size_t)m;
        memcpy(to, from, (size_t)m * sizeof *to);
    }
    mbs_stages_transpose(m, n, p->T, m, turned, n);
    for (i = m - 1; i >= 0; --i) {
        real *t = turned + (size_t)i * (size_t)n;
        for (j = i + 1; j < m; ++j)
            row[j] = p->U[(size_t)j * (size_t)m + (size_t)i];
        mbs_stages_apply(n, m - i - 1, -1, t + n, n, row + i + 1, t);
        for (j = 0; j < n; ++j)
            t[j] /= p->U[(size_t)i * (size_t)m + (size_t)i];
    }
    mbs_stages_transpose(n, m, turned, n, p->T, m);
}

/* Rows that x must meet; where an earlier one of them has its pivot, `lu` holds a factor instead of 0. */
static void copy_passed(mbs_stages_step *p)
{
    int i, j, l;
    for (i = 0; i < p->passed; ++i) {
        for (j = 0; j < p->nx; ++j)
            p->C[(size_t)j * (size_t)p->passed + (size_t)i] =
                p->lu[(size_t)j * (size_t)p->capacity + (size_t)(p->pivots + i)];
        for (l = 0; l < i; ++l)
            p->C[(size_t)p->column[p->pivots + l] * (size_t)p->passed + (size_t)i] = 0;
    }
}

static real entry(const real *lower, int n, int i, int j)
{
    return i >= j ? lower[(size_t)j * (size_t)n + (size_t)i] : lower[(size_t)i * (size_t)n + (size_t)j];
}

/* Entries `at` of a column. */
static void gather(int n, const int *at, const real *restrict column, real *restrict to)
{
    int i;
    for (i = 0; i < n; ++i)
        to[i] = column[at[i]];
}

/* Blocks of the cost in the order of variables: pp into p->Q, pr into p->Y, the lower triangle of rr into `rr`. */
static void gather_cost(mbs_stages_step *p, real *quadratic, real *rr)
{
    const int m = p->pivots, n = p->reduced, *at = p->order;
    const size_t all = (size_t)p->n;
    int i, j;
    for (j = 0; j < p->n; ++j)
        for (i = 0; i < j; ++i)
            quadratic[(size_t)j * all + (size_t)i] = quadratic[(size_t)i * all + (size_t)j];
    for (j = 0; j < m; ++j)
        gather(m, at, quadratic + (size_t)at[j] * all, p->Q + (size_t)j * (size_t)m);
    for (j = 0; j < n; ++j) {
        const real *column = quadratic + (size_t)at[m + j] * all;
        gather(m, at, column, p->Y + (size_t)j * (size_t)m);
        gather(n - j, at + m + j, column, rr + (size_t)j * (size_t)n + (size_t)j);
    }
}

/* rr -= TT Y' + Y'T T with Y' = Q_pr - Q_pp T / 2; then Y = Q_pr - Q_pp T. `turned` holds TT. */
static void substitute_pivots(mbs_stages_step *p, real *rr, real *half, real *turned)
{
    const int m = p->pivots, n = p->reduced;
    const size_t count = (size_t)m * (size_t)n;
    size_t i;
    memcpy(half, p->Y, count * sizeof *half);
    mbs_stages_multiply(m, n, m, (real)-0.5, p->Q, m, p->T, m, half, m, 0);
    mbs_stages_multiply(n, n, m, -1, turned, n, half, m, rr, n, 1);
    mbs_stages_transpose(m, n, half, m, turned, n);
    mbs_stages_multiply(n, n, m, -1, turned, n, p->T, m, rr, n, 1);
    for (i = 0; i < count; ++i)
        p->Y[i] = 2 * half[i] - p->Y[i];
}

/* Factorise the free variables, and take them out of the cost of x. */
static int reduce_free(mbs_stages_step *p, real *rr, real *turned, real zero_curvature)
{
    const int n = p->reduced, free_ones = n - p->nx;
    int i, j;
    if (mbs_stages_cholesky(n, free_ones, rr, n, zero_curvature) >= 0)
        return -1;
    memcpy(p->L, rr, (size_t)n * (size_t)free_ones * sizeof *rr);
    mbs_stages_transpose(p->nx, free_ones, rr + free_ones, n, turned, free_ones);
    rr += (size_t)free_ones * (size_t)n + (size_t)free_ones;
    mbs_stages_multiply(p->nx, p->nx, free_ones, -1, p->L + free_ones, n, turned, free_ones, rr, n, 1);
    for (j = 0; j < p->nx; ++j)
        for (i = 0; i < p->nx; ++i)
            p->P[(size_t)j * (size_t)p->nx + (size_t)i] = entry(rr, n, i, j);
    return 0;
}

int mbs_stages_reduce(mbs_stages_step *p, real *quadratic, real *const *work, real zero_pivot, real zero_curvature)
{
    real *weight = work[0];
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
    solve_pivots(p, work[2], work[0]);
    copy_passed(p);
    gather_cost(p, quadratic, work[0]);
    substitute_pivots(p, work[0], work[1], work[2]);
    return reduce_free(p, work[0], work[1], zero_curvature);
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

void mbs_stages_step_back(mbs_stages_step *p, const real *linear, real *constant, real *vector)
{
    const int m = p->pivots, n = p->reduced, free_ones = n - p->nx, *at = p->order;
    real *q = vector;
    int i;
    eliminate_constants(p, constant, vector);
    for (i = 0; i < m; ++i)
        p->t[i] = vector[i];
    for (i = 0; i < p->passed; ++i)
        p->c[i] = vector[m + i];
    mbs_stages_upper(m, p->U, m, p->t);
    for (i = 0; i < n; ++i)
        q[i] = linear[at[m + i]];
    for (i = 0; i < m; ++i)
        p->qp[i] = linear[at[i]];
    mbs_stages_apply_transposed(m, n, -1, p->T, m, p->qp, q);
    mbs_stages_apply_transposed(m, n, -1, p->Y, m, p->t, q);
    mbs_stages_apply(m, m, -1, p->Q, m, p->t, p->qp);
    for (i = 0; i < free_ones; ++i)
        p->l[i] = q[i];
    mbs_stages_lower(free_ones, p->L, n, p->l);
    for (i = 0; i < p->nx; ++i)
        p->p[i] = q[free_ones + i];
    mbs_stages_apply(p->nx, free_ones, -1, p->L + free_ones, n, p->l, p->p);
}

/* Multipliers of all rows, from the gradient of the cost by the pivots and the multipliers of rows passed on. */
static void find_multipliers(const mbs_stages_step *p, const real *r, const real *passed, real *y, real *m)
{
    const int done = p->pivots + p->passed;
    int i, j;
    for (i = 0; i < p->pivots; ++i)
        m[i] = -p->qp[i];
    mbs_stages_apply(p->pivots, p->reduced, -1, p->Y, p->pivots, r, m);
    mbs_stages_upper_transposed(p->pivots, p->U, p->pivots, m);
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
    const int m = p->pivots, n = p->reduced, free_ones = n - p->nx, *at = p->order;
    real *r = vector, *pivot = vector + n;
    int i;
    for (i = 0; i < free_ones; ++i)
        r[i] = -p->l[i];
    for (i = 0; i < p->nx; ++i)
        r[free_ones + i] = x[i];
    mbs_stages_apply_transposed(p->nx, free_ones, -1, p->L + free_ones, n, x, r);
    mbs_stages_lower_transposed(free_ones, p->L, n, r);
    for (i = 0; i < m; ++i)
        pivot[i] = -p->t[i];
    mbs_stages_apply(m, n, -1, p->T, m, r, pivot);
    for (i = 0; i < m; ++i)
        z[at[i]] = pivot[i];
    for (i = 0; i < n; ++i)
        z[at[m + i]] = r[i];
    find_multipliers(p, r, passed, y, vector + n);
}
