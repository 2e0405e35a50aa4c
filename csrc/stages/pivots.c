/* Sparse factors of the equations within an interval.
 *
 * Pivots are chosen by Markowitz' rule among entries that are not small in their row: the product of the numbers of other
 * nonzeros in row and column bounds the fill (Duff, Erisman, Reid: Direct methods for sparse matrices, 2017, chapter 7).
 * Where most of the remaining block is filled, it is taken as full, and pivots are the largest beside their rows.
 *
 * Later factorisations follow the order row by row: row i of the lower factor and of the upper one are
 *
 *     l_ij = a_ij - sum_k l_ik u_kj  for j <= i,      u_ij = (a_ij - sum_k l_ik u_kj) / l_ii  for j > i.
 *
 * Full rows come last, and are eliminated together, column by column: none waits for the one before. */
#include "pivots.h"

#include <string.h>

#define SHARE ((real)0.01)     /* of a pivot in its row, at least, when an order is chosen */
#define LOST ((real)1e9)      /* how much larger than a pivot the rest of its row may become later; h^2 is a pivot */
#define PASSES 3
#define SMALL ((real)1e-5)     /* entries beside the largest that rows are not balanced by */
#define FULL ((real)0.95)       /* nonzeros of a block that is taken as full */

/* The block that remains while an order is chosen. */
typedef struct {
    int n, done;
    real *a;          /* row by row */
    char *nonzero;    /* the same */
    int *in_row, *in_column; /* nonzeros of rows and columns that remain */
    int *row, *column;       /* places so far; then what remains */
    real *size;              /* the largest entry of each row at first */
    real zero_pivot;
} remainder_block;

static void read_block(remainder_block *r, const mbs_stages_pivots *p, const mbs_stages_matrix *A)
{
    const size_t n = (size_t)p->n;
    int i, j, l;
    r->n = p->n;
    r->done = 0;
    memset(r->a, 0, n * n * sizeof *r->a);
    memset(r->nonzero, 0, n * n);
    for (i = 0; i < p->n; ++i)
        r->in_row[i] = r->in_column[i] = 0;
    for (j = 0; j < p->n; ++j)
        for (l = A->begin[p->first + j]; l < A->end[p->first + j] && (i = A->row[l]) < p->n; ++l) {
            r->a[(size_t)i * n + (size_t)j] = A->value[l];
            r->nonzero[(size_t)i * n + (size_t)j] = 1;
            ++r->in_row[i];
            ++r->in_column[j];
        }
    for (i = 0; i < p->n; ++i)
        r->row[i] = r->column[i] = i;
}

/* Multiply `count` numbers, `stride` apart, so that the smallest and the largest of them are the inverse of each other.
 * Very small ones beside the largest may be rounding, and do not count. Returns -1 if all are 0. */
static int balance(real *a, int count, int stride)
{
    const size_t step = (size_t)stride;
    real least, most = 0, factor;
    size_t i;
    for (i = 0; i < (size_t)count; ++i)
        most = real_abs(a[i * step]) > most ? real_abs(a[i * step]) : most;
    if (!(most > 0))
        return -1;
    least = most;
    for (i = 0; i < (size_t)count; ++i) {
        const real b = real_abs(a[i * step]);
        least = b > SMALL * most && b < least ? b : least;
    }
    factor = 1 / (real_sqrt(least) * real_sqrt(most));
    for (i = 0; i < (size_t)count; ++i)
        a[i * step] *= factor;
    return 0;
}

/* Balance rows and columns, so that units of equations and variables do not decide about pivots. Returns -1 if a row or
 * a column is 0. */
static int balance_block(remainder_block *r)
{
    int pass, i;
    for (pass = 0; pass < PASSES; ++pass)
        for (i = 0; i < r->n; ++i)
            if (balance(r->a + i, r->n, r->n) || balance(r->a + (size_t)i * (size_t)r->n, r->n, 1))
                return -1;
    return 0;
}

/* The largest entry of a row in columns that remain. */
static real largest_in_row(const remainder_block *r, int i)
{
    const real *a = r->a + (size_t)i * (size_t)r->n;
    real most = 0;
    int t;
    for (t = r->done; t < r->n; ++t)
        most = real_abs(a[r->column[t]]) > most ? real_abs(a[r->column[t]]) : most;
    return most;
}

/* The best pivot: places of its row and its column among what remains. `full`: by size alone. Returns 0 if none. */
static int find_best(const remainder_block *r, int full, int *at_row, int *at_column)
{
    long best = -1;
    real best_size = 0;
    int s, t;
    for (s = r->done; s < r->n; ++s) {
        const int i = r->row[s];
        const real *a = r->a + (size_t)i * (size_t)r->n, most = largest_in_row(r, i);
        for (t = r->done; t < r->n; ++t) {
            const int j = r->column[t];
            const real size = real_abs(a[j]);
            const long cost = full ? 0 : (long)(r->in_row[i] - 1) * (r->in_column[j] - 1);
            if (!(size > r->zero_pivot * r->size[i]) || size < SHARE * most || (best >= 0 && cost > best))
                continue;
            if (best < 0 || cost < best || size > best_size) {
                best = cost;
                best_size = size;
                *at_row = s;
                *at_column = t;
            }
        }
    }
    return best >= 0;
}

static void exchange(int *a, int i, int j)
{
    const int t = a[i];
    a[i] = a[j];
    a[j] = t;
}

/* Subtract the row of the pivot from row i. */
static void subtract_row(remainder_block *r, int pivot, int i)
{
    const size_t n = (size_t)r->n;
    const int column = r->column[r->done];
    const real *from = r->a + (size_t)pivot * n;
    const char *has = r->nonzero + (size_t)pivot * n;
    real *to = r->a + (size_t)i * n, factor = to[column] / from[column];
    char *gets = r->nonzero + (size_t)i * n;
    int t;
    for (t = r->done + 1; t < r->n; ++t) {
        const int j = r->column[t];
        if (!has[j])
            continue;
        to[j] -= factor * from[j];
        if (!gets[j]) {
            gets[j] = 1;
            ++r->in_row[i];
            ++r->in_column[j];
        }
    }
}

/* Use the pivot at these places: `nonzero` of its row and column stay in the factors. */
static void take(remainder_block *r, int at_row, int at_column)
{
    const size_t n = (size_t)r->n;
    int row, column, t;
    exchange(r->row, r->done, at_row);
    exchange(r->column, r->done, at_column);
    row = r->row[r->done];
    column = r->column[r->done];
    for (t = r->done + 1; t < r->n; ++t) {
        r->in_column[r->column[t]] -= r->nonzero[(size_t)row * n + (size_t)r->column[t]];
        if (r->nonzero[(size_t)r->row[t] * n + (size_t)column]) {
            --r->in_row[r->row[t]];
            subtract_row(r, row, r->row[t]);
        }
    }
    ++r->done;
}

static int is_nearly_full(const remainder_block *r)
{
    const int left = r->n - r->done;
    long count = 0;
    int s;
    for (s = r->done; s < r->n; ++s)
        count += r->in_row[r->row[s]];
    return (real)count >= FULL * (real)left * (real)left;
}

static void fill(remainder_block *r)
{
    int s, t;
    for (s = r->done; s < r->n; ++s)
        for (t = r->done; t < r->n; ++t)
            r->nonzero[(size_t)r->row[s] * (size_t)r->n + (size_t)r->column[t]] = 1;
}

/* Write what is above and below the pivots. Returns -1 if that is too much. */
static int write_factors(const remainder_block *r, mbs_stages_pivots *p)
{
    int i, j, lower = 0, upper = 0;
    for (i = 0; i < r->n; ++i) {
        const char *nonzero = r->nonzero + (size_t)r->row[i] * (size_t)r->n;
        p->lower[i] = lower;
        p->upper[i] = upper;
        for (j = 0; j < r->n; ++j) {
            if (j == i || !nonzero[r->column[j]])
                continue;
            if (lower + upper == p->capacity)
                return -1;
            if (j < i) {
                p->lower_row[lower] = r->row[j];
                p->lower_place[lower++] = j;
            } else {
                p->upper_column[upper] = r->column[j];
                p->upper_place[upper++] = j;
            }
        }
    }
    p->lower[r->n] = lower;
    p->upper[r->n] = upper;
    return 0;
}

/* Sort the nonzeros of the lower factor that are in full rows, and in columns that are not, by columns. */
static void write_columns(mbs_stages_pivots *p)
{
    int i, j, t;
    for (j = 0; j <= p->dense; ++j)
        p->below[j] = 0;
    for (i = p->dense; i < p->n; ++i)
        for (t = p->lower[i]; t < p->lower[i + 1] && p->lower_place[t] < p->dense; ++t)
            ++p->below[p->lower_place[t] + 1];
    for (j = 0; j < p->dense; ++j)
        p->below[j + 1] += p->below[j];
    for (i = p->dense; i < p->n; ++i)
        for (t = p->lower[i]; t < p->lower[i + 1] && p->lower_place[t] < p->dense; ++t) {
            const int at = p->below[p->lower_place[t]]++;
            p->below_place[at] = i;
            p->below_at[at] = t;
        }
    for (j = p->dense; j > 0; --j)
        p->below[j] = p->below[j - 1];
    p->below[0] = 0;
}

/* Sort the nonzeros of the block by places of rows. Works in `count` and `place` (n each). */
static void write_entries(mbs_stages_pivots *p, const mbs_stages_matrix *A, int *count, int *place)
{
    int i, j, l;
    for (i = 0; i < p->n; ++i)
        count[i] = 0;
    for (j = p->first; j < p->first + p->n; ++j)
        for (l = A->begin[j]; l < A->end[j] && A->row[l] < p->n; ++l)
            ++count[A->row[l]];
    p->entry[0] = 0;
    for (i = 0; i < p->n; ++i) {
        p->entry[i + 1] = p->entry[i] + count[p->row[i]];
        place[p->column[i]] = i;
    }
    for (i = 0; i < p->n; ++i)
        count[p->row[i]] = p->entry[i];
    for (j = 0; j < p->n; ++j)
        for (l = A->begin[p->first + j]; l < A->end[p->first + j] && A->row[l] < p->n; ++l) {
            const int at = count[A->row[l]]++;
            p->entry_at[at] = l;
            p->entry_place[at] = place[j];
        }
}

int mbs_stages_choose_pivots(mbs_stages_pivots *p, const mbs_stages_matrix *A, real *block, real *sizes, char *marks,
                             int *spots, real zero_pivot)
{
    remainder_block r;
    int i, at_row = 0, at_column = 0, full = 0;
    r.a = block;
    r.nonzero = marks;
    r.in_row = spots;
    r.in_column = spots + p->n;
    r.row = p->row;
    r.column = p->column;
    r.size = sizes;
    r.zero_pivot = zero_pivot;
    read_block(&r, p, A);
    if (balance_block(&r))
        return -1;
    for (i = 0; i < r.n; ++i)
        r.size[i] = largest_in_row(&r, i);
    p->dense = p->n;
    while (r.done < r.n) {
        if (!full && is_nearly_full(&r)) {
            full = 1;
            p->dense = r.done;
            fill(&r);
        }
        if (!find_best(&r, full, &at_row, &at_column))
            return -1;
        take(&r, at_row, at_column);
    }
    if (write_factors(&r, p))
        return -1;
    write_columns(p);
    write_entries(p, A, spots, spots + p->n);
    p->ready = 1;
    return 0;
}

/* Write the nonzeros of row i. Returns the largest one. */
static real write_row(const mbs_stages_pivots *p, const mbs_stages_matrix *A, int i, real *row)
{
    real most = 0;
    int t;
    for (t = p->entry[i]; t < p->entry[i + 1]; ++t) {
        const real a = A->value[p->entry_at[t]];
        row[p->entry_place[t]] = a;
        most = real_abs(a) > most ? real_abs(a) : most;
    }
    return most;
}

/* The same, with zeros where factors have more nonzeros. */
static real spread_row(const mbs_stages_pivots *p, const mbs_stages_matrix *A, int i, real *row)
{
    int t;
    for (t = p->lower[i]; t < p->lower[i + 1]; ++t)
        row[p->lower_place[t]] = 0;
    for (t = p->upper[i]; t < p->upper[i + 1]; ++t)
        row[p->upper_place[t]] = 0;
    row[i] = 0;
    return write_row(p, A, i, row);
}

static void add(int n, real factor, const real *restrict a, real *restrict b)
{
    int i, c;
    for (i = 0; i + 4 <= n; i += 4)
        for (c = 0; c < 4; ++c)
            b[i + c] += factor * a[i + c];
    for (; i < n; ++i)
        b[i] += factor * a[i];
}

static real dot(int n, const real *restrict a, const real *restrict b)
{
    real sum[4] = {0, 0, 0, 0};
    int i, c;
    for (i = 0; i + 4 <= n; i += 4)
        for (c = 0; c < 4; ++c)
            sum[c] += a[i + c] * b[i + c];
    for (; i < n; ++i)
        sum[0] += a[i] * b[i];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* Eliminate the nonzeros before the pivot in row i, and keep them in the lower factor. */
static void eliminate_row(const mbs_stages_pivots *p, const mbs_stages_factors *f, int i, real *restrict row)
{
    int t, l;
    for (t = p->lower[i]; t < p->lower[i + 1]; ++t) {
        const int j = p->lower_place[t];
        const real factor = row[j];
        f->lower[t] = -factor;
        for (l = p->upper[j]; l < p->upper[j + 1]; ++l)
            row[p->upper_place[l]] += factor * f->upper[l];
    }
}

/* Divide row i of the upper factor by its pivot; -1 where that is below `least`, or small beside the row. */
static int take_pivot(const mbs_stages_pivots *p, const mbs_stages_factors *f, int i, real pivot, real least)
{
    real most = 0, inverse;
    int t;
    for (t = p->upper[i]; t < p->upper[i + 1]; ++t)
        most = real_abs(f->upper[t]) > most ? real_abs(f->upper[t]) : most;
    if (!(real_abs(pivot) > least) || !(most <= LOST * real_abs(pivot)))
        return -1;
    inverse = 1 / pivot;
    f->inverse[i] = inverse;
    for (t = p->upper[i]; t < p->upper[i + 1]; ++t)
        f->upper[t] *= -inverse;
    return 0;
}

static int factorise_sparse_rows(const mbs_stages_pivots *p, const mbs_stages_matrix *A, const mbs_stages_factors *f,
                                 real *row, real zero_pivot)
{
    int i, t;
    for (i = 0; i < p->dense; ++i) {
        const real size = spread_row(p, A, i, row);
        eliminate_row(p, f, i, row);
        for (t = p->upper[i]; t < p->upper[i + 1]; ++t)
            f->upper[t] = row[p->upper_place[t]];
        if (take_pivot(p, f, i, row[i], zero_pivot * size))
            return i;
    }
    return -1;
}

/* Write full rows of the block into `rows`, and their largest entries into `size`. */
static void spread_full_rows(const mbs_stages_pivots *p, const mbs_stages_matrix *A, real *rows, real *size)
{
    int i;
    memset(rows, 0, (size_t)(p->n - p->dense) * (size_t)p->n * sizeof *rows);
    for (i = p->dense; i < p->n; ++i)
        size[i] = write_row(p, A, i, rows + (size_t)(i - p->dense) * (size_t)p->n);
}

/* Add four multiples of columns to those rows that have an entry in column j. */
static void add_columns(const mbs_stages_pivots *p, int j, const int *restrict column, const real *restrict factor,
                        real *restrict rows)
{
    const size_t a = (size_t)column[0], b = (size_t)column[1], c = (size_t)column[2], d = (size_t)column[3];
    int t;
    for (t = p->below[j]; t < p->below[j + 1]; ++t) {
        real *restrict row = rows + (size_t)(p->below_place[t] - p->dense) * (size_t)p->n;
        const real x = row[j];
        row[a] += x * factor[0];
        row[b] += x * factor[1];
        row[c] += x * factor[2];
        row[d] += x * factor[3];
    }
}

/* Eliminate the sparse columns of full rows: column by column, so that rows need not wait for each other. */
static void eliminate_columns(const mbs_stages_pivots *p, const mbs_stages_factors *f, real *rows)
{
    int j, t, l;
    for (j = 0; j < p->dense; ++j) {
        for (l = p->upper[j]; l + 4 <= p->upper[j + 1]; l += 4)
            add_columns(p, j, p->upper_place + l, f->upper + l, rows);
        for (t = p->below[j]; t < p->below[j + 1]; ++t) {
            real *row = rows + (size_t)(p->below_place[t] - p->dense) * (size_t)p->n;
            int k;
            for (k = l; k < p->upper[j + 1]; ++k)
                row[p->upper_place[k]] += row[j] * f->upper[k];
            f->lower[p->below_at[t]] = -row[j];
        }
    }
}

/* Factorise the rest of full rows. Zeros before a pivot let vectors begin at multiples of 4. */
static int factorise_full_rows(const mbs_stages_pivots *p, const mbs_stages_factors *f, real *rows, const real *size,
                               real zero_pivot)
{
    int i, j, k;
    for (k = p->dense; k < p->n; ++k) {
        real *row = rows + (size_t)(k - p->dense) * (size_t)p->n, *upper = f->upper + p->upper[k];
        const int begin = k - (k - p->dense) % 4;
        for (j = p->dense; j < k; ++j)
            f->lower[p->lower[k + 1] - k + j] = -row[j];
        memcpy(upper, row + k + 1, (size_t)(p->n - k - 1) * sizeof *upper);
        if (take_pivot(p, f, k, row[k], zero_pivot * size[k]))
            return k;
        memset(row + begin, 0, (size_t)(k + 1 - begin) * sizeof *row);
        memcpy(row + k + 1, upper, (size_t)(p->n - k - 1) * sizeof *row);
        for (i = k + 1; i < p->n; ++i) {
            real *to = rows + (size_t)(i - p->dense) * (size_t)p->n;
            add(p->n - begin, to[k], row + begin, to + begin);
        }
    }
    return -1;
}

int mbs_stages_factorise_block(const mbs_stages_pivots *p, const mbs_stages_matrix *A, const mbs_stages_factors *f,
                               real *row, real *rows, real zero_pivot)
{
    const int failed = factorise_sparse_rows(p, A, f, row, zero_pivot);
    if (failed >= 0)
        return failed;
    spread_full_rows(p, A, rows, row);
    eliminate_columns(p, f, rows);
    return factorise_full_rows(p, f, rows, row, zero_pivot);
}

void mbs_stages_solve_block(const mbs_stages_pivots *p, const mbs_stages_factors *f, const real *b, real *x,
                            real *work)
{
    int i, t;
    for (i = 0; i < p->n; ++i) {
        const int full = i > p->dense ? i - p->dense : 0, end = p->lower[i + 1] - full;
        real sum = b[p->row[i]];
        for (t = p->lower[i]; t < end; ++t)
            sum += f->lower[t] * work[p->lower_place[t]];
        work[i] = (full > 0 ? sum + dot(full, f->lower + end, work + p->dense) : sum) * f->inverse[i];
    }
    for (i = p->n - 1; i >= 0; --i) {
        real sum = work[i];
        for (t = p->upper[i]; t < p->upper[i + 1]; ++t)
            sum += f->upper[t] * x[p->upper_column[t]];
        x[p->column[i]] = sum;
    }
}

void mbs_stages_solve_block_transposed(const mbs_stages_pivots *p, const mbs_stages_factors *f, real *b, real *x,
                                       real *work)
{
    int i, t;
    for (i = 0; i < p->n; ++i) {
        const real a = b[p->column[i]];
        for (t = p->upper[i]; t < p->upper[i + 1]; ++t)
            b[p->upper_column[t]] += f->upper[t] * a;
        work[i] = a;
    }
    for (i = p->n - 1; i >= 0; --i) {
        const int full = i > p->dense ? i - p->dense : 0, end = p->lower[i + 1] - full;
        const real a = work[i] * f->inverse[i];
        for (t = p->lower[i]; t < end; ++t)
            work[p->lower_place[t]] += f->lower[t] * a;
        if (full > 0)
            add(full, a, f->lower + end, work + p->dense);
        x[p->row[i]] = a;
    }
}
