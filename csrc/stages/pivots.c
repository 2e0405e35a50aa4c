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
 * Stages that share an order are factorised, and solved for, several at once. */
#include "pivots.h"

#include <string.h>

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
        least = b > BALANCING_SMALL * most && b < least ? b : least;
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
    for (pass = 0; pass < BALANCING_PASSES; ++pass)
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
            if (!(size > r->zero_pivot * r->size[i]) || size < PIVOT_SHARE * most || (best >= 0 && cost > best))
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
    return (real)count >= FULL_BLOCK * (real)left * (real)left;
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
#if MBS_STAGES_ROOMY
    p->core = r.n;
#endif
    while (r.done < r.n) {
        if (!full && is_nearly_full(&r)) {
            full = 1;
#if MBS_STAGES_ROOMY
            p->core = r.done;
#endif
            fill(&r);
        }
        if (!find_best(&r, full, &at_row, &at_column))
            return -1;
        take(&r, at_row, at_column);
    }
    if (write_factors(&r, p))
        return -1;
    write_entries(p, A, spots, spots + p->n);
    p->ready = 1;
    return 0;
}

/* Numbers of several stages: one of each side by side, so that one instruction takes them all. */
typedef struct {
    const mbs_stages_pivots *p;
    mbs_stages_together *stages;
    lanes *lower, *inverse, *upper, *row;
} elimination;

static void clear(int count, const int *restrict place, lanes *restrict row)
{
    const lanes zero = {0};
    int t;
    for (t = 0; t < count; ++t)
        row[place[t]] = zero;
}

/* The square of the norm of numbers at places */
static void find_size(int count, const int *restrict place, const lanes *restrict row, lanes *size)
{
    lanes sum = {0};
    int t;
    for (t = 0; t < count; ++t)
        LANES_ADD_EACH(sum, row[place[t]], row[place[t]]);
    *size = sum;
}

/* Write the nonzeros of row i, with zeros where factors have more. */
static void spread_row(const elimination *a, int i)
{
    const mbs_stages_pivots *p = a->p;
    const int first = p->entry[i], count = p->entry[i + 1] - first;
    const int *restrict at = p->entry_at + first, *restrict place = p->entry_place + first;
    const real *const *value = a->stages->value;
    const real *restrict v0 = value[0], *restrict v1 = value[1], *restrict v2 = value[2], *restrict v3 = value[3];
    lanes *restrict row = a->row;
    int t;
    clear(p->lower[i + 1] - p->lower[i], p->lower_place + p->lower[i], row);
    clear(p->upper[i + 1] - p->upper[i], p->upper_place + p->upper[i], row);
    clear(1, &i, row);
    for (t = 0; t < count; ++t) {
        const lanes number = LANES_OF(v0[at[t]], v1[at[t]], v2[at[t]], v3[at[t]]);
        row[place[t]] = number;
    }
}

/* Numbers at places += factors times x, which is none of them */
static void add_multiples(int count, const int *restrict place, const lanes *restrict factor, const lanes *x,
                          lanes *restrict to)
{
    const lanes a = *x;
    int t;
    for (t = 0; t < count; ++t)
        LANES_ADD_EACH(to[place[t]], a, factor[t]);
}

/* Eliminate the numbers before the pivot in row i that belong to the full part, four together. */
static void eliminate_core(const elimination *a, int i)
{
    const mbs_stages_pivots *p = a->p;
    lanes *restrict row = a->row, *restrict lower = a->lower + p->lower[i + 1] - (i - p->core);
    int j = p->core, k, l;
    for (; j + 4 <= i; j += 4) {
        const lanes *restrict u0 = a->upper + p->upper[j] - (j + 1), *restrict u1 = a->upper + p->upper[j + 1] - (j + 2);
        const lanes *restrict u2 = a->upper + p->upper[j + 2] - (j + 3);
        const lanes *restrict u3 = a->upper + p->upper[j + 3] - (j + 4);
        const lanes f0 = row[j];
        lanes f1 = row[j + 1], f2 = row[j + 2], f3 = row[j + 3];
        LANES_ADD_EACH(f1, f0, u0[j + 1]);
        LANES_ADD_EACH(f2, f0, u0[j + 2]);
        LANES_ADD_EACH(f2, f1, u1[j + 2]);
        LANES_ADD_EACH(f3, f0, u0[j + 3]);
        LANES_ADD_EACH(f3, f1, u1[j + 3]);
        LANES_ADD_EACH(f3, f2, u2[j + 3]);
        row[j + 1] = f1;
        row[j + 2] = f2;
        row[j + 3] = f3;
        for (k = j + 4; k < p->n; ++k) {
            lanes sum = row[k];
            LANES_ADD_EACH(sum, f0, u0[k]);
            LANES_ADD_EACH(sum, f1, u1[k]);
            LANES_ADD_EACH(sum, f2, u2[k]);
            LANES_ADD_EACH(sum, f3, u3[k]);
            row[k] = sum;
        }
    }
    for (; j < i; ++j) {
        const lanes *restrict u = a->upper + p->upper[j] - (j + 1), f = row[j];
        for (k = j + 1; k < p->n; ++k)
            LANES_ADD_EACH(row[k], f, u[k]);
    }
    for (l = 0; l < i - p->core; ++l) {
        lanes factor = row[p->core + l];
        LANES_SCALE(factor, -1);
        lower[l] = factor;
    }
}

/* Eliminate the nonzeros before the pivot in row i, and keep them in the lower factor, negative. */
static void eliminate_row(const elimination *a, int i)
{
    const mbs_stages_pivots *p = a->p;
    const int full = MBS_STAGES_ROOMY && i > p->core ? i - p->core : 0;
    int t;
    for (t = p->lower[i]; t < p->lower[i + 1] - full; ++t) {
        const int j = p->lower_place[t], first = p->upper[j];
        lanes factor = a->row[j];
        add_multiples(p->upper[j + 1] - first, p->upper_place + first, a->upper + first, &factor, a->row);
        LANES_SCALE(factor, -1);
        a->lower[t] = factor;
    }
    if (full > 0)
        eliminate_core(a, i);
}

/* Divide row i by its pivots. Where one is as good as 0, or small beside its row, the stage has failed here, unless it
 * has before. Squares too large or too small for their precision count as such. */
static void take_pivots(const elimination *a, int i, const lanes *size, real zero_pivot)
{
    const mbs_stages_pivots *p = a->p;
    const real zero = zero_pivot * zero_pivot, lost = PIVOT_LOSS * PIVOT_LOSS;
    const int first = p->upper[i], count = p->upper[i + 1] - first, *restrict place = p->upper_place + first;
    const lanes *restrict row = a->row, pivot = row[i];
    lanes *restrict upper = a->upper + first, inverse, minus, most;
    int t, c;
    find_size(count, place, row, &most);
    for (c = 0; c < MBS_STAGES_TOGETHER; ++c) {
        const real own = LANE(pivot, c), square = own * own;
        const int good = square > zero * LANE(*size, c) && LANE(most, c) <= lost * square;
        if (!good && a->stages->failed[c] < 0)
            a->stages->failed[c] = i;
        LANE(inverse, c) = good ? 1 / own : 0;
    }
    a->inverse[i] = minus = inverse;
    LANES_SCALE(minus, -1);
    for (t = 0; t < count; ++t)
        LANES_MULTIPLY(upper[t], minus, row[place[t]]);
}

void mbs_stages_factorise_together(const mbs_stages_pivots *p, mbs_stages_together *stages, const mbs_stages_factors *f,
                                   real *work, real zero_pivot)
{
    elimination a;
    lanes size;
    int i, c;
    a.p = p;
    a.stages = stages;
    a.lower = (lanes *)f->lower;
    a.inverse = (lanes *)f->inverse;
    a.upper = (lanes *)f->upper;
    a.row = (lanes *)work;
    for (c = stages->count; c < MBS_STAGES_TOGETHER; ++c)
        stages->value[c] = stages->value[0];
    for (c = 0; c < MBS_STAGES_TOGETHER; ++c)
        stages->failed[c] = -1;
    for (i = 0; i < p->n; ++i) {
        spread_row(&a, i);
        find_size(p->entry[i + 1] - p->entry[i], p->entry_place + p->entry[i], a.row, &size);
        eliminate_row(&a, i);
        take_pivots(&a, i, &size, zero_pivot);
    }
}

/* sum += factors times numbers at places */
static void add_products(int count, const int *restrict place, const lanes *restrict factor, const lanes *restrict x,
                           lanes *restrict sum)
{
    lanes a = *sum;
    int t;
    for (t = 0; t < count; ++t)
        LANES_ADD_EACH(a, factor[t], x[place[t]]);
    *sum = a;
}

void mbs_stages_solve_together(const mbs_stages_pivots *p, const mbs_stages_factors *f, const real *const *b, int count,
                               real *x, real *work)
{
    const lanes *lower = (const lanes *)f->lower, *inverse = (const lanes *)f->inverse, *upper = (const lanes *)f->upper;
    lanes *half = (lanes *)work, *found = (lanes *)x;
    const real *right[MBS_STAGES_TOGETHER];
    int i, c;
    for (c = 0; c < MBS_STAGES_TOGETHER; ++c)
        right[c] = b[c < count ? c : 0];
    for (i = 0; i < p->n; ++i) {
        const int first = p->lower[i], at = p->row[i];
        const lanes number = LANES_OF(right[0][at], right[1][at], right[2][at], right[3][at]);
        half[i] = number;
        add_products(p->lower[i + 1] - first, p->lower_place + first, lower + first, half, &half[i]);
        LANES_MULTIPLY(half[i], inverse[i], half[i]);
    }
    for (i = p->n - 1; i >= 0; --i) {
        const int first = p->upper[i];
        found[p->column[i]] = half[i];
        add_products(p->upper[i + 1] - first, p->upper_column + first, upper + first, found, &found[p->column[i]]);
    }
}

void mbs_stages_solve_together_transposed(const mbs_stages_pivots *p, const mbs_stages_factors *f, real *b, real *x,
                                          real *work)
{
    const lanes *lower = (const lanes *)f->lower, *inverse = (const lanes *)f->inverse, *upper = (const lanes *)f->upper;
    lanes *half = (lanes *)work, *found = (lanes *)x, *right = (lanes *)b;
    int i;
    for (i = 0; i < p->n; ++i) {
        const int first = p->upper[i];
        half[i] = right[p->column[i]];
        add_multiples(p->upper[i + 1] - first, p->upper_column + first, upper + first, &half[i], right);
    }
    for (i = p->n - 1; i >= 0; --i) {
        const int first = p->lower[i];
        LANES_MULTIPLY(half[i], inverse[i], half[i]);
        found[p->row[i]] = half[i];
        add_multiples(p->lower[i + 1] - first, p->lower_place + first, lower + first, &half[i], half);
    }
}

#if MBS_STAGES_ROOMY
/* For COUNT vectors of columns. */
#define SOLVE_ROWS(COUNT) \
    static void solve_panel_##COUNT(const mbs_stages_pivots *p, const mbs_stages_factors *f, size_t lane, size_t ld, \
                                    real *R, real *X) \
    { \
        const size_t step = MBS_STAGES_TOGETHER; \
        mbs_stages_panel sum[COUNT]; \
        int i, t, c; \
        for (i = 0; i < p->n; ++i) { \
            mbs_stages_panel *row = (mbs_stages_panel *)(R + (size_t)p->row[i] * ld); \
            const real pivot = f->inverse[(size_t)i * step + lane]; \
            for (c = 0; c < COUNT; ++c) \
                sum[c] = row[c]; \
            for (t = p->lower[i]; t < p->lower[i + 1]; ++t) { \
                const mbs_stages_panel *other = (const mbs_stages_panel *)(R + (size_t)p->lower_row[t] * ld); \
                const real x = f->lower[(size_t)t * step + lane]; \
                for (c = 0; c < COUNT; ++c) \
                    LANES_ADD(sum[c], x, other[c]); \
            } \
            for (c = 0; c < COUNT; ++c) { \
                LANES_SCALE(sum[c], pivot); \
                row[c] = sum[c]; \
            } \
        } \
        for (i = p->n - 1; i >= 0; --i) { \
            const mbs_stages_panel *row = (const mbs_stages_panel *)(R + (size_t)p->row[i] * ld); \
            mbs_stages_panel *to = (mbs_stages_panel *)(X + (size_t)p->column[i] * ld); \
            for (c = 0; c < COUNT; ++c) \
                sum[c] = row[c]; \
            for (t = p->upper[i]; t < p->upper[i + 1]; ++t) { \
                const mbs_stages_panel *other = (const mbs_stages_panel *)(X + (size_t)p->upper_column[t] * ld); \
                const real x = f->upper[(size_t)t * step + lane]; \
                for (c = 0; c < COUNT; ++c) \
                    LANES_ADD(sum[c], x, other[c]); \
            } \
            for (c = 0; c < COUNT; ++c) \
                to[c] = sum[c]; \
        } \
    }
MBS_STAGES_PANELS(SOLVE_ROWS)
#define SOLVE_PANEL(COUNT) solve_panel_##COUNT(p, f, at, w, R + c, X + c)

void mbs_stages_solve_rows(const mbs_stages_pivots *p, const mbs_stages_factors *f, int lane, int width, int ld, real *R,
                           real *X)
{
    const size_t at = (size_t)lane, w = (size_t)ld;
    int c = 0;
    MBS_STAGES_EACH_PANEL(c, width, SOLVE_PANEL);
}
#endif
