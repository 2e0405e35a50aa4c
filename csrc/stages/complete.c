/* Complete pivoting of a block: see complete.h. Rows are compared beside their largest entries.
 *
 * Most entries are 0. A row whose entry in the column of the pivot is 0 stays as it is, and so does its largest entry. */
#include "complete.h"

#include <string.h>

static void read_block(mbs_stages_complete *c, const mbs_stages_matrix *A, int first)
{
    const size_t n = (size_t)c->n;
    int i, j, l;
    memset(c->a, 0, n * n * sizeof *c->a);
    for (j = 0; j < c->n; ++j)
        for (l = A->begin[first + j]; l < A->end[first + j] && (i = A->row[l]) < c->n; ++l)
            c->a[(size_t)i * n + (size_t)j] = A->value[l];
    for (i = 0; i < c->n; ++i)
        c->row[i] = c->column[i] = i;
}

/* Find the largest entry of a row in columns that hold no pivot. */
static void find_largest(mbs_stages_complete *c, int i)
{
    const real *a = c->a + (size_t)i * (size_t)c->n;
    int j, at = c->rank;
    for (j = c->rank + 1; j < c->n; ++j)
        at = real_abs(a[j]) > real_abs(a[at]) ? j : at;
    c->largest[i] = at;
}

static void weigh_rows(mbs_stages_complete *c)
{
    int i;
    for (i = 0; i < c->n; ++i) {
        real most;
        find_largest(c, i);
        most = real_abs(c->a[(size_t)i * (size_t)c->n + (size_t)c->largest[i]]);
        c->work[i] = most > 0 ? 1 / most : 0;
    }
}

static int find_pivot(const mbs_stages_complete *c, const mbs_stages_least_pivots *least, int *row, int *column)
{
    real most = c->n - c->rank > least->room ? least->zero : least->small;
    int i, found = 0;
    for (i = c->rank; i < c->n; ++i) {
        const real size = real_abs(c->a[(size_t)i * (size_t)c->n + (size_t)c->largest[i]]) * c->work[i];
        if (size > most) {
            most = size;
            *row = i;
            *column = c->largest[i];
            found = 1;
        }
    }
    return found;
}

static void exchange_numbers(int *a, int i, int j)
{
    const int t = a[i];
    a[i] = a[j];
    a[j] = t;
}

static void exchange(mbs_stages_complete *c, int row, int column)
{
    const int at = c->rank;
    real *a = c->a + (size_t)at * (size_t)c->n, *b = c->a + (size_t)row * (size_t)c->n;
    int i;
    for (i = 0; i < c->n; ++i) {
        const real t = a[i];
        a[i] = b[i];
        b[i] = t;
    }
    exchange_numbers(c->row, at, row);
    exchange_numbers(c->column, at, column);
    c->largest[row] = c->largest[at];
    c->work[row] = c->work[at];
    for (i = 0; i < c->n; ++i) {
        real *e = c->a + (size_t)i * (size_t)c->n, t = e[at];
        e[at] = e[column];
        e[column] = t;
    }
}

/* List the columns of nonzeros right of the last pivot; returns how many there are. */
static int list_nonzeros(const mbs_stages_complete *c, const real *pivot)
{
    int j, count = 0;
    for (j = c->rank; j < c->n; ++j)
        if (pivot[j] != 0)
            c->nonzero[count++] = j;
    return count;
}

/* Subtract the row of the next pivot from the rows below that have an entry in its column. */
static void eliminate_below(mbs_stages_complete *c)
{
    const int at = c->rank++;
    const real *restrict pivot = c->a + (size_t)at * (size_t)c->n;
    const int count = list_nonzeros(c, pivot);
    int i, t;
    for (i = c->rank; i < c->n; ++i) {
        real *restrict a = c->a + (size_t)i * (size_t)c->n;
        if (a[at] == 0 && c->largest[i] != at)
            continue;
        a[at] /= pivot[at];
        for (t = 0; t < count; ++t)
            a[c->nonzero[t]] -= a[at] * pivot[c->nonzero[t]];
        find_largest(c, i);
    }
}

void mbs_stages_factorise_completely(mbs_stages_complete *c, const mbs_stages_matrix *A, int first,
                                     const mbs_stages_least_pivots *least)
{
    int row, column;
    c->rank = 0;
    read_block(c, A, first);
    weigh_rows(c);
    while (c->rank < c->n && find_pivot(c, least, &row, &column)) {
        exchange(c, row, column);
        eliminate_below(c);
    }
}

real mbs_stages_solve_completely(const mbs_stages_complete *c, const real *b, real *x)
{
    real left = 0;
    int i, j;
    for (i = 0; i < c->n; ++i) {
        const real *a = c->a + (size_t)i * (size_t)c->n;
        real sum = b[c->row[i]];
        for (j = 0; j < i && j < c->rank; ++j)
            sum -= a[j] * c->work[j];
        c->work[i] = sum;
        left = i >= c->rank && real_abs(sum) > left ? real_abs(sum) : left;
    }
    for (i = c->n - 1; i >= 0; --i) {
        const real *a = c->a + (size_t)i * (size_t)c->n;
        real sum = i < c->rank ? c->work[i] : 0;
        for (j = i + 1; j < c->rank; ++j)
            sum -= a[j] * c->work[j];
        c->work[i] = i < c->rank ? sum / a[i] : 0;
        x[c->column[i]] = c->work[i];
    }
    return left;
}

void mbs_stages_solve_completely_transposed(const mbs_stages_complete *c, const real *b, real *x)
{
    int i, j;
    for (i = 0; i < c->rank; ++i) {
        real sum = b[c->column[i]];
        for (j = 0; j < i; ++j)
            sum -= c->a[(size_t)j * (size_t)c->n + (size_t)i] * c->work[j];
        c->work[i] = sum / c->a[(size_t)i * (size_t)c->n + (size_t)i];
    }
    for (i = c->n - 1; i >= 0; --i) {
        real sum = i < c->rank ? c->work[i] : 0;
        for (j = i + 1; j < c->rank; ++j)
            sum -= c->a[(size_t)j * (size_t)c->n + (size_t)i] * c->work[j];
        x[c->row[i]] = i < c->rank ? (c->work[i] = sum) : 0;
    }
}

static void subtract(int width, real factor, const real *restrict a, real *restrict b)
{
    int i;
    for (i = 0; factor != 0 && i < width; ++i)
        b[i] -= factor * a[i];
}

void mbs_stages_solve_rows_completely(const mbs_stages_complete *c, int width, int ld, real *B, real *X)
{
    const size_t w = (size_t)ld;
    int i, j;
    for (i = 0; i < c->rank; ++i)
        for (j = 0; j < i; ++j)
            subtract(width, c->a[(size_t)i * (size_t)c->n + (size_t)j], B + (size_t)c->row[j] * w,
                     B + (size_t)c->row[i] * w);
    for (i = c->n - 1; i >= 0; --i) {
        real *x = X + (size_t)c->column[i] * w;
        memset(x, 0, (size_t)width * sizeof *x);
        if (i >= c->rank)
            continue;
        memcpy(x, B + (size_t)c->row[i] * w, (size_t)width * sizeof *x);
        for (j = i + 1; j < c->rank; ++j)
            subtract(width, c->a[(size_t)i * (size_t)c->n + (size_t)j], X + (size_t)c->column[j] * w, x);
        for (j = 0; j < width; ++j)
            x[j] /= c->a[(size_t)i * (size_t)c->n + (size_t)i];
    }
}
