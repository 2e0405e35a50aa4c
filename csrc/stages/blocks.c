/* Small dense blocks: see blocks.h. Sums run down columns, so that compilers make vectors of them. */
#include "blocks.h"

static void add_columns(int from, int m, const real *restrict A, int lda, real b0, real b1, real b2, real b3,
                        real *restrict c)
{
    const real *restrict a1 = A + lda, *restrict a2 = a1 + lda, *restrict a3 = a2 + lda;
    int i;
    for (i = from; i < m; ++i)
        c[i] += (A[i] * b0 + a1[i] * b1) + (a2[i] * b2 + a3[i] * b3);
}

static void add_column(int from, int m, const real *restrict a, real b, real *restrict c)
{
    int i;
    for (i = from; i < m; ++i)
        c[i] += a[i] * b;
}

static real dot(int m, const real *restrict a, const real *restrict b)
{
    real s0 = 0, s1 = 0, s2 = 0, s3 = 0;
    int i;
    for (i = 0; i + 4 <= m; i += 4) {
        s0 += a[i] * b[i];
        s1 += a[i + 1] * b[i + 1];
        s2 += a[i + 2] * b[i + 2];
        s3 += a[i + 3] * b[i + 3];
    }
    for (; i < m; ++i)
        s0 += a[i] * b[i];
    return (s0 + s1) + (s2 + s3);
}

/* c += A b from row `from` on; b has k entries, `factor` each */
static void add_product(int from, int m, int k, real factor, const real *A, int lda, const real *b, real *c)
{
    int l;
    for (l = 0; l + 4 <= k; l += 4, A += 4 * (size_t)lda)
        add_columns(from, m, A, lda, factor * b[l], factor * b[l + 1], factor * b[l + 2], factor * b[l + 3], c);
    for (; l < k; ++l, A += lda)
        add_column(from, m, A, factor * b[l], c);
}

void mbs_stages_multiply(int m, int n, int k, real factor, const real *A, int lda, const real *B, int ldb, real *C,
                         int ldc, int lower)
{
    int j;
    for (j = 0; j < n; ++j)
        add_product(lower ? j : 0, m, k, factor, A, lda, B + (size_t)j * (size_t)ldb, C + (size_t)j * (size_t)ldc);
}

void mbs_stages_transpose(int m, int n, const real *A, int lda, real *B, int ldb)
{
    int i, j;
    for (j = 0; j < n; ++j)
        for (i = 0; i < m; ++i)
            B[(size_t)i * (size_t)ldb + (size_t)j] = A[(size_t)j * (size_t)lda + (size_t)i];
}

void mbs_stages_apply(int m, int n, real factor, const real *A, int lda, const real *x, real *y)
{
    add_product(0, m, n, factor, A, lda, x, y);
}

void mbs_stages_apply_transposed(int m, int n, real factor, const real *A, int lda, const real *x, real *y)
{
    int j;
    for (j = 0; j < n; ++j)
        y[j] += factor * dot(m, A + (size_t)j * (size_t)lda, x);
}

void mbs_stages_apply_symmetric(int n, real factor, const real *A, int lda, const real *x, real *y)
{
    int j;
    for (j = 0; j < n; ++j) {
        const real *a = A + (size_t)j * (size_t)lda;
        y[j] += factor * (a[j] * x[j] + dot(n - j - 1, a + j + 1, x + j + 1));
        add_column(j + 1, n, a, factor * x[j], y);
    }
}

int mbs_stages_cholesky(int m, int n, real *A, int lda, real zero)
{
    int i, j, l;
    for (j = 0; j < n; ++j) {
        real *a = A + (size_t)j * (size_t)lda, pivot = real_abs(a[j]);
        for (l = 0; l < j; ++l)
            add_column(j, m, A + (size_t)l * (size_t)lda, -A[(size_t)l * (size_t)lda + (size_t)j], a);
        if (!(a[j] > zero * pivot))
            return j;
        pivot = 1 / real_sqrt(a[j]);
        for (i = j; i < m; ++i)
            a[i] *= pivot;
    }
    return -1;
}

void mbs_stages_lower(int n, const real *L, int ldl, real *x)
{
    int j;
    for (j = 0; j < n; ++j, L += ldl) {
        x[j] /= L[j];
        add_column(j + 1, n, L, -x[j], x);
    }
}

void mbs_stages_lower_transposed(int n, const real *L, int ldl, real *x)
{
    int j;
    for (j = n - 1; j >= 0; --j) {
        const real *a = L + (size_t)j * (size_t)ldl;
        x[j] = (x[j] - dot(n - j - 1, a + j + 1, x + j + 1)) / a[j];
    }
}

void mbs_stages_upper(int n, const real *U, int ldu, real *x)
{
    int j;
    for (j = n - 1; j >= 0; --j) {
        const real *a = U + (size_t)j * (size_t)ldu;
        x[j] /= a[j];
        add_column(0, j, a, -x[j], x);
    }
}

void mbs_stages_upper_transposed(int n, const real *U, int ldu, real *x)
{
    int j;
    for (j = 0; j < n; ++j, U += ldu)
        x[j] = (x[j] - dot(j, U, x)) / U[j];
}

int mbs_stages_width(int n)
{
    return (n + MBS_STAGES_LANES - 1) / MBS_STAGES_LANES * MBS_STAGES_LANES;
}

/* Sums stay in registers: lengths of the inner loops are constants, so that compilers make vectors of them. */
#define COMBINE(LENGTH)                                                                                               \
    static void combine_##LENGTH(int count, const int *restrict index, const real *restrict factor,                   \
                                 size_t stride, const real *restrict rows, size_t ld, real scale,                     \
                                 real *restrict out)                                                                  \
    {                                                                                                                 \
        real sum[LENGTH];                                                                                             \
        int t, c;                                                                                                     \
        for (c = 0; c < LENGTH; ++c)                                                                                  \
            sum[c] = out[c];                                                                                          \
        for (t = 0; t < count; ++t) {                                                                                 \
            const real *restrict row = rows + (size_t)index[t] * ld;                                                  \
            const real f = factor[(size_t)t * stride];                                                                \
            for (c = 0; c < LENGTH; ++c)                                                                              \
                sum[c] += f * row[c];                                                                                 \
        }                                                                                                             \
        for (c = 0; c < LENGTH; ++c)                                                                                  \
            out[c] = scale * sum[c];                                                                                  \
    }
COMBINE(16)
COMBINE(8)
COMBINE(4)

void mbs_stages_combine(int width, int count, const int *index, const real *factor, int stride, const real *rows,
                        int ld, real scale, real *out)
{
    const size_t step = (size_t)stride, w = (size_t)ld;
    int c = 0;
    for (; c + 16 <= width; c += 16)
        combine_16(count, index, factor, step, rows + c, w, scale, out + c);
    for (; c + 8 <= width; c += 8)
        combine_8(count, index, factor, step, rows + c, w, scale, out + c);
    for (; c < width; c += 4)
        combine_4(count, index, factor, step, rows + c, w, scale, out + c);
}

/* A tile of M, 4 by LENGTH */
#define GRAM(LENGTH)                                                                                                  \
    static void gram_##LENGTH(int m, const real *restrict S, const real *restrict Z, size_t ld, real *restrict M)     \
    {                                                                                                                 \
        real sum[4][LENGTH];                                                                                          \
        int j, b, c;                                                                                                  \
        for (b = 0; b < 4; ++b)                                                                                       \
            for (c = 0; c < LENGTH; ++c)                                                                              \
                sum[b][c] = M[(size_t)b * ld + (size_t)c];                                                            \
        for (j = 0; j < m; ++j, S += ld, Z += ld)                                                                     \
            for (b = 0; b < 4; ++b)                                                                                   \
                for (c = 0; c < LENGTH; ++c)                                                                          \
                    sum[b][c] += S[b] * Z[c];                                                                         \
        for (b = 0; b < 4; ++b)                                                                                       \
            for (c = 0; c < LENGTH; ++c)                                                                              \
                M[(size_t)b * ld + (size_t)c] = sum[b][c];                                                            \
    }
GRAM(8)
GRAM(4)

void mbs_stages_gram(int m, int width, const real *S, const real *Z, real *M, int ld)
{
    int b, c;
    for (b = 0; b < width; b += 4) {
        real *to = M + (size_t)b * (size_t)ld;
        for (c = 0; c + 8 <= width; c += 8)
            gram_8(m, S + b, Z + c, (size_t)ld, to + c);
        for (; c < width; c += 4)
            gram_4(m, S + b, Z + c, (size_t)ld, to + c);
    }
}
