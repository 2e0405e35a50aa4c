/* Rows with few numbers: see few.h. */
#include "few.h"

#if MBS_STAGES_LOOKS
#define LEAST_WIDTH 64 /* of rows that are looked at: shorter ones are quick anyhow */

static int is_short(const mbs_stages_few *f, int i)
{
    return f->count != NULL && f->count[i] >= 0;
}

/* Whether a line of numbers is 0; it has no branch for each. */
static int is_zero(const real *restrict a)
{
    int i, any = 0;
    for (i = 0; i < MBS_STAGES_LANES; ++i)
        any |= a[i] != 0;
    return !any;
}

/* The numbers of a row that are not 0, or -1 where they are more than few. */
static int list_numbers(int width, const real *row, int *column)
{
    int j, i, count = 0;
    for (j = 0; j < width; j += MBS_STAGES_LANES)
        for (i = j; !is_zero(row + j) && i < j + MBS_STAGES_LANES; ++i) {
            if (row[i] == 0)
                continue;
            if (count == MBS_STAGES_FEW)
                return -1;
            column[count++] = i;
        }
    return count;
}

void mbs_stages_find_few(const mbs_stages_few *f, int m, int width, const real *A, int lda)
{
    int i;
    for (i = 0; i < m && f->count != NULL; ++i, A += lda)
        f->count[i] = width < LEAST_WIDTH ? -1 : list_numbers(width, A, f->column + (size_t)i * MBS_STAGES_FEW);
}

int mbs_stages_count_alike(const mbs_stages_few *f, int i, int m)
{
    int end = i + 1;
    while (end < m && is_short(f, end) == is_short(f, i))
        ++end;
    return end - i;
}

/* M += rT z, of one row of S */
static void add_outer(const mbs_stages_few *f, int i, int shift, int width, int lower, const real *row, const real *z,
                      real *M, int ldm)
{
    const int *column = f->column + (size_t)i * MBS_STAGES_FEW;
    int t;
    for (t = 0; t < f->count[i]; ++t) {
        const int at = column[t] - shift;
        mbs_stages_add_row(lower ? mbs_stages_width(at + 1) : width, row[at], z, M + (size_t)at * (size_t)ldm);
    }
}

void mbs_stages_gram_few(const mbs_stages_few *f, int first, int shift, int m, int rows, int width, int lower,
                         const real *S, int lds, const real *Z, int ldz, real *M, int ldm)
{
    int i, l, count;
    for (i = 0; i < m; i += count) {
        const real *s = S + (size_t)i * (size_t)lds, *z = Z + (size_t)i * (size_t)ldz;
        count = mbs_stages_count_alike(f, first + i, first + m);
        if (!is_short(f, first + i))
            mbs_stages_gram(count, rows, width, lower, 1, s, lds, z, ldz, M, ldm);
        for (l = 0; l < count && is_short(f, first + i); ++l, s += lds, z += ldz)
            add_outer(f, first + i + l, shift, width, lower, s, z, M, ldm);
    }
}

/* Above the diagonal, whole rows of ST Z are columns of ZT S below it. */
static void add_both(const mbs_stages_few *f, int i, int n, const real *row, const real *z, real *M, int ldm)
{
    const int *column = f->column + (size_t)i * MBS_STAGES_FEW;
    int t;
    add_outer(f, i, 0, n, 0, row, z, M, ldm);
    for (t = 0; t < f->count[i]; ++t)
        M[(size_t)column[t] * (size_t)(ldm + 1)] += row[column[t]] * z[column[t]];
}

/* Add what is above the diagonal to what is below it. */
static void fold(int n, real *M, int ldm)
{
    int i, j;
    for (i = 0; i < n; ++i)
        for (j = 0; j < i; ++j)
            M[(size_t)i * (size_t)ldm + (size_t)j] += M[(size_t)j * (size_t)ldm + (size_t)i];
}

void mbs_stages_square_few(const mbs_stages_few *f, int m, int n, int twice, const real *S, int lds, const real *Z, int ldz,
                           real *M, int ldm)
{
    int i, count, any = 0;
    for (i = 0; i < m && twice; ++i)
        if (is_short(f, i)) {
            add_both(f, i, n, S + (size_t)i * (size_t)lds, Z + (size_t)i * (size_t)ldz, M, ldm);
            any = 1;
        }
    if (any)
        fold(n, M, ldm);
    for (i = 0; i < m && twice; i += count) {
        const real *s = S + (size_t)i * (size_t)lds, *z = Z + (size_t)i * (size_t)ldz;
        count = mbs_stages_count_alike(f, i, m);
        if (is_short(f, i))
            continue;
        mbs_stages_gram(count, n, n, 1, 1, s, lds, z, ldz, M, ldm);
        mbs_stages_gram(count, n, n, 1, 1, z, ldz, s, lds, M, ldm);
    }
    if (!twice)
        mbs_stages_gram_few(f, 0, 0, m, n, n, 1, S, lds, Z, ldz, M, ldm);
}

/* M += a row, for the numbers in column j of A */
static void add_column(const mbs_stages_few *f, int i, int shift, int n, const real *a, int lda, const real *row, real *M,
                       int ldm)
{
    const int *column = f->column + (size_t)i * MBS_STAGES_FEW;
    int t, l;
    for (l = 0; l < n; ++l, a += lda, M += ldm)
        for (t = 0; t < f->count[i]; ++t)
            M[column[t] - shift] += *a * row[column[t] - shift];
}

void mbs_stages_product_few(const mbs_stages_few *f, int first, int shift, int n, int width, const real *A, int lda,
                            const real *F, int ldf, real *M, int ldm)
{
    int i, l, count;
    for (i = 0; i < n; i += count) {
        const real *row = F + (size_t)i * (size_t)ldf;
        count = mbs_stages_count_alike(f, first + i, first + n);
        if (!is_short(f, first + i))
            mbs_stages_gram(count, mbs_stages_width(n), width, 0, 1, A + (size_t)i * (size_t)lda, lda, row, ldf, M, ldm);
        for (l = i; l < i + count && is_short(f, first + i); ++l, row += ldf)
            add_column(f, first + l, shift, n, A + l, lda, row, M, ldm);
    }
}

void mbs_stages_add_row_few(const mbs_stages_few *f, int i, int width, real factor, const real *row, real *out)
{
    const int *column = f->column + (size_t)i * MBS_STAGES_FEW;
    int t;
    if (!is_short(f, i)) {
        mbs_stages_add_row(width, factor, row, out);
        return;
    }
    for (t = 0; t < f->count[i]; ++t)
        out[column[t]] += factor * row[column[t]];
}

real mbs_stages_dot_few(const mbs_stages_few *f, int i, int width, const real *row, const real *x)
{
    const int *column = f->column + (size_t)i * MBS_STAGES_FEW;
    real sum = 0;
    int t;
    if (!is_short(f, i))
        return mbs_stages_dot(width, row, x);
    for (t = 0; t < f->count[i]; ++t)
        sum += row[column[t]] * x[column[t]];
    return sum;
}

void mbs_stages_add_rows_few(const mbs_stages_few *f, int m, int width, const real *by, const real *A, int lda, real *out)
{
    int i, l, count;
    for (i = 0; i < m; i += count) {
        const real *row = A + (size_t)i * (size_t)lda;
        count = mbs_stages_count_alike(f, i, m);
        if (!is_short(f, i))
            mbs_stages_add_rows(width, count, 1, by + i, 1, row, lda, out);
        for (l = i; l < i + count && is_short(f, i); ++l, row += lda)
            mbs_stages_add_row_few(f, l, width, by[l], row, out);
    }
}
#endif
