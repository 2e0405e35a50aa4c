/* Small dense blocks: see blocks.h. */
#include "blocks.h"

#if defined(MBS_SCALAR) && defined(__OPTIMIZE_SIZE__)
#define WIDE 0 /* without vectors, wider blocks of columns save little time */
#else
#define WIDE 1
#endif

static void add_columns(int m, const real *restrict A, int lda, real b0, real b1, real b2, real b3, real *restrict c)
{
    const real *restrict a1 = A + lda, *restrict a2 = a1 + lda, *restrict a3 = a2 + lda;
    int i;
    for (i = 0; i < m; ++i)
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

/* c += A b; b has k entries, `factor` each */
static void add_product(int m, int k, real factor, const real *A, int lda, const real *b, real *c)
{
    int l;
    for (l = 0; l + 4 <= k; l += 4, A += 4 * (size_t)lda)
        add_columns(m, A, lda, factor * b[l], factor * b[l + 1], factor * b[l + 2], factor * b[l + 3], c);
    for (; l < k; ++l, A += lda)
        add_column(0, m, A, factor * b[l], c);
}

void mbs_stages_apply(int m, int n, real factor, const real *A, int lda, const real *x, real *y)
{
    add_product(m, n, factor, A, lda, x, y);
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

int mbs_stages_width(int n)
{
    return (n + MBS_STAGES_LANES - 1) / MBS_STAGES_LANES * MBS_STAGES_LANES;
}

real mbs_stages_dot(int width, const real *restrict a, const real *restrict b)
{
    lanes sum = {0};
    int i;
    for (i = 0; i < width / MBS_STAGES_LANES; ++i)
        LANES_ADD_EACH(sum, ((const lanes *)a)[i], ((const lanes *)b)[i]);
    return (LANE(sum, 0) + LANE(sum, 1)) + (LANE(sum, 2) + LANE(sum, 3));
}

void mbs_stages_add_row(int width, real factor, const real *restrict row, real *restrict out)
{
    int i;
    for (i = 0; i < width / MBS_STAGES_LANES; ++i)
        LANES_ADD(((lanes *)out)[i], factor, ((const lanes *)row)[i]);
}

void mbs_stages_scale_row(int width, real factor, const real *row, real *out)
{
    int i;
    for (i = 0; i < width / MBS_STAGES_LANES; ++i) {
        lanes number = ((const lanes *)row)[i];
        LANES_SCALE(number, factor);
        ((lanes *)out)[i] = number;
    }
}

/* For COUNT times LANES columns. Sums stay in registers: their number is constant. */
#define COMBINE(COUNT)                                                                                                \
    static void combine_##COUNT(int count, const int *restrict index, int first, const real *restrict factor,         \
                                size_t stride, const real *restrict rows, size_t ld, real scale, const real *from,    \
                                real *out)                                                                            \
    {                                                                                                                 \
        lanes sum[COUNT];                                                                                             \
        int t, c;                                                                                                     \
        for (c = 0; c < COUNT; ++c)                                                                                   \
            sum[c] = ((const lanes *)from)[c];                                                                        \
        for (t = 0; t < count; ++t) {                                                                                 \
            const lanes *row = (const lanes *)(rows + (size_t)(index[t] - first) * ld);                               \
            const real f = factor[(size_t)t * stride];                                                                \
            for (c = 0; c < COUNT; ++c)                                                                               \
                LANES_ADD(sum[c], f, row[c]);                                                                         \
        }                                                                                                             \
        for (c = 0; c < COUNT; ++c) {                                                                                 \
            LANES_SCALE(sum[c], scale);                                                                               \
            ((lanes *)out)[c] = sum[c];                                                                               \
        }                                                                                                             \
    }
COMBINE(4)
COMBINE(2)
COMBINE(1)

void mbs_stages_combine(int width, int count, const int *index, int first, const real *factor, int stride,
                        const real *rows, int ld, real scale, const real *from, real *out)
{
    const size_t step = (size_t)stride, w = (size_t)ld;
    int c = 0;
    for (; WIDE && c + 16 <= width; c += 16)
        combine_4(count, index, first, factor, step, rows + c, w, scale, from + c, out + c);
    for (; WIDE && c + 8 <= width; c += 8)
        combine_2(count, index, first, factor, step, rows + c, w, scale, from + c, out + c);
    for (; c < width; c += 4)
        combine_1(count, index, first, factor, step, rows + c, w, scale, from + c, out + c);
}

#define ADD_ROWS(COUNT)                                                                                               \
    static void add_rows_##COUNT(int count, real factor, const real *restrict by, size_t stride,                      \
                                 const real *restrict rows, size_t ld, real *restrict out)                            \
    {                                                                                                                 \
        lanes sum[COUNT], *to = (lanes *)out;                                                                         \
        int t, c;                                                                                                     \
        for (c = 0; c < COUNT; ++c)                                                                                   \
            sum[c] = to[c];                                                                                           \
        for (t = 0; t < count; ++t, by += stride, rows += ld) {                                                       \
            const real f = factor * *by;                                                                              \
            for (c = 0; c < COUNT; ++c)                                                                               \
                LANES_ADD(sum[c], f, ((const lanes *)rows)[c]);                                                       \
        }                                                                                                             \
        for (c = 0; c < COUNT; ++c)                                                                                   \
            to[c] = sum[c];                                                                                           \
    }
ADD_ROWS(4)
ADD_ROWS(2)
ADD_ROWS(1)

void mbs_stages_add_rows(int width, int count, real factor, const real *by, int stride, const real *rows, int ld,
                         real *out)
{
    const size_t step = (size_t)stride, w = (size_t)ld;
    int c = 0;
    for (; WIDE && c + 16 <= width; c += 16)
        add_rows_4(count, factor, by, step, rows + c, w, out + c);
    for (; WIDE && c + 8 <= width; c += 8)
        add_rows_2(count, factor, by, step, rows + c, w, out + c);
    for (; c < width; c += 4)
        add_rows_1(count, factor, by, step, rows + c, w, out + c);
}

/* A tile of M, 4 by COUNT times LANES. The factor is early: gcc would read what it need not compute four times. */
#define GRAM(COUNT)                                                                                                   \
    static void gram_##COUNT(int m, real factor, const real *restrict S, size_t lds, const real *restrict Z,          \
                             size_t ldz, real *restrict M, size_t ldm)                                                \
    {                                                                                                                 \
        const real zeros[COUNT * MBS_STAGES_LANES] = {0};                                                             \
        lanes sum[4][COUNT];                                                                                          \
        int j, b, c;                                                                                                  \
        for (b = 0; b < 4; ++b)                                                                                       \
            for (c = 0; c < COUNT; ++c)                                                                               \
                sum[b][c] = ((const lanes *)zeros)[c];                                                                \
        for (j = 0; j < m; ++j, S += lds, Z += ldz)                                                                   \
            for (c = 0; c < COUNT; ++c) {                                                                             \
                lanes z = ((const lanes *)Z)[c];                                                                      \
                LANES_SCALE(z, factor);                                                                               \
                LANES_ADD(sum[0][c], S[0], z);                                                                        \
                LANES_ADD(sum[1][c], S[1], z);                                                                        \
                LANES_ADD(sum[2][c], S[2], z);                                                                        \
                LANES_ADD(sum[3][c], S[3], z);                                                                        \
            }                                                                                                         \
        for (b = 0; b < 4; ++b, M += ldm)                                                                             \
            for (c = 0; c < COUNT; ++c)                                                                               \
                LANES_PLUS(((lanes *)M)[c], sum[b][c]);                                                               \
    }
GRAM(2)
GRAM(1)

void mbs_stages_gram(int m, int rows, int width, int lower, real factor, const real *S, int lds, const real *Z, int ldz,
                     real *M, int ldm)
{
    const size_t s = (size_t)lds, z = (size_t)ldz, l = (size_t)ldm;
    int b, c;
    for (b = 0; b < rows; b += 4, M += 4 * l) {
        const int columns = lower ? b + 4 : width;
        for (c = 0; WIDE && c + 8 <= columns; c += 8)
            gram_2(m, factor, S + b, s, Z + c, z, M + c, l);
        for (; c < columns; c += 4)
            gram_1(m, factor, S + b, s, Z + c, z, M + c, l);
    }
}

void mbs_stages_mirror(int n, real *M, int ld)
{
    const size_t l = (size_t)ld;
    int i, j;
    for (i = 0; i < n; ++i)
        for (j = 0; j < i; ++j)
            M[(size_t)j * l + (size_t)i] = M[(size_t)i * l + (size_t)j];
}
