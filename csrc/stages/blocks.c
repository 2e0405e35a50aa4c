/* Small dense blocks: see blocks.h. */
#include "blocks.h"

#define GRAM_ROWS 128 /* of 500 doubles, half of 1 MiB */
#if MBS_STAGES_WIDE
#define WIDE_LANES MBS_STAGES_LINE
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

/* For COUNT vectors of columns. Sums stay in registers: their number is constant. Each takes rows in TURNS, so that no
 * sum waits for the one before. */
#define COMBINE(NAME, VECTOR, COUNT, TURNS)                                                                           \
    static void NAME(int count, const int *restrict index, int first, const real *restrict factor, size_t stride,     \
                     const real *restrict rows, size_t ld, real scale, const real *from, real *out)                   \
    {                                                                                                                 \
        const real zeros[COUNT * sizeof(VECTOR) / sizeof(real)] = {0};                                                \
        VECTOR sum[TURNS][COUNT];                                                                                     \
        int t, c, l;                                                                                                  \
        for (c = 0; c < COUNT; ++c)                                                                                   \
            sum[0][c] = ((const VECTOR *)from)[c];                                                                    \
        for (l = 1; l < TURNS; ++l)                                                                                   \
            for (c = 0; c < COUNT; ++c)                                                                               \
                sum[l][c] = ((const VECTOR *)zeros)[c];                                                               \
        for (t = 0; t + TURNS <= count; t += TURNS)                                                                   \
            for (l = 0; l < TURNS; ++l) {                                                                             \
                const VECTOR *row = (const VECTOR *)(rows + (size_t)(index[t + l] - first) * ld);                     \
                const real f = factor[(size_t)(t + l) * stride];                                                      \
                for (c = 0; c < COUNT; ++c)                                                                           \
                    LANES_ADD(sum[l][c], f, row[c]);                                                                  \
            }                                                                                                         \
        for (; t < count; ++t) {                                                                                      \
            const VECTOR *row = (const VECTOR *)(rows + (size_t)(index[t] - first) * ld);                             \
            const real f = factor[(size_t)t * stride];                                                                \
            for (c = 0; c < COUNT; ++c)                                                                               \
                LANES_ADD(sum[0][c], f, row[c]);                                                                      \
        }                                                                                                             \
        for (c = 0; c < COUNT; ++c) {                                                                                 \
            for (l = 1; l < TURNS; ++l)                                                                               \
                LANES_PLUS(sum[0][c], sum[l][c]);                                                                     \
            LANES_SCALE(sum[0][c], scale);                                                                            \
            ((VECTOR *)out)[c] = sum[0][c];                                                                           \
        }                                                                                                             \
    }
COMBINE(combine_1, lanes, 1, 1)
#if MBS_STAGES_WIDE
COMBINE(combine_wide_4, wide, 4, 2)
COMBINE(combine_wide_2, wide, 2, 1)
COMBINE(combine_wide_1, wide, 1, 4)
#elif MBS_STAGES_ROOMY
COMBINE(combine_4, lanes, 4, 1)
COMBINE(combine_2, lanes, 2, 1)
#endif

void mbs_stages_combine(int width, int count, const int *index, int first, const real *factor, int stride,
                        const real *rows, int ld, real scale, const real *from, real *out)
{
    const size_t step = (size_t)stride, w = (size_t)ld;
    int c = 0;
#if MBS_STAGES_WIDE
    for (; c + 4 * WIDE_LANES <= width; c += 4 * WIDE_LANES)
        combine_wide_4(count, index, first, factor, step, rows + c, w, scale, from + c, out + c);
    for (; c + 2 * WIDE_LANES <= width; c += 2 * WIDE_LANES)
        combine_wide_2(count, index, first, factor, step, rows + c, w, scale, from + c, out + c);
    for (; c + WIDE_LANES <= width; c += WIDE_LANES)
        combine_wide_1(count, index, first, factor, step, rows + c, w, scale, from + c, out + c);
#elif MBS_STAGES_ROOMY
    for (; c + 16 <= width; c += 16)
        combine_4(count, index, first, factor, step, rows + c, w, scale, from + c, out + c);
    for (; c + 8 <= width; c += 8)
        combine_2(count, index, first, factor, step, rows + c, w, scale, from + c, out + c);
#endif
    for (; c < width; c += 4)
        combine_1(count, index, first, factor, step, rows + c, w, scale, from + c, out + c);
}

#define ADD_ROWS(NAME, VECTOR, COUNT)                                                                                 \
    static void NAME(int count, real factor, const real *restrict by, size_t stride, const real *restrict rows,       \
                     size_t ld, real *restrict out)                                                                   \
    {                                                                                                                 \
        VECTOR sum[COUNT], *to = (VECTOR *)out;                                                                       \
        int t, c;                                                                                                     \
        for (c = 0; c < COUNT; ++c)                                                                                   \
            sum[c] = to[c];                                                                                           \
        for (t = 0; t < count; ++t, by += stride, rows += ld) {                                                       \
            const real f = factor * *by;                                                                              \
            for (c = 0; c < COUNT; ++c)                                                                               \
                LANES_ADD(sum[c], f, ((const VECTOR *)rows)[c]);                                                      \
        }                                                                                                             \
        for (c = 0; c < COUNT; ++c)                                                                                   \
            to[c] = sum[c];                                                                                           \
    }
ADD_ROWS(add_rows_1, lanes, 1)
#if MBS_STAGES_WIDE
ADD_ROWS(add_rows_wide_8, wide, 8)
ADD_ROWS(add_rows_wide_2, wide, 2)
ADD_ROWS(add_rows_wide_1, wide, 1)
#elif MBS_STAGES_ROOMY
ADD_ROWS(add_rows_4, lanes, 4)
ADD_ROWS(add_rows_2, lanes, 2)
#endif

void mbs_stages_add_rows(int width, int count, real factor, const real *by, int stride, const real *rows, int ld,
                         real *out)
{
    const size_t step = (size_t)stride, w = (size_t)ld;
    int c = 0;
#if MBS_STAGES_WIDE
    for (; c + 8 * WIDE_LANES <= width; c += 8 * WIDE_LANES)
        add_rows_wide_8(count, factor, by, step, rows + c, w, out + c);
    for (; c + 2 * WIDE_LANES <= width; c += 2 * WIDE_LANES)
        add_rows_wide_2(count, factor, by, step, rows + c, w, out + c);
    for (; c + WIDE_LANES <= width; c += WIDE_LANES)
        add_rows_wide_1(count, factor, by, step, rows + c, w, out + c);
#elif MBS_STAGES_ROOMY
    for (; c + 16 <= width; c += 16)
        add_rows_4(count, factor, by, step, rows + c, w, out + c);
    for (; c + 8 <= width; c += 8)
        add_rows_2(count, factor, by, step, rows + c, w, out + c);
#endif
    for (; c < width; c += 4)
        add_rows_1(count, factor, by, step, rows + c, w, out + c);
}

/* A tile of M, ROWS by COUNT vectors. One of EARLY and LATE is the factor, the other one 1: where it is early, gcc does not
 * read four times what few rows share; where it is late, many rows have fewer products. */
#define GRAM(NAME, VECTOR, ROWS, COUNT, EARLY, LATE)                                                                  \
    static void NAME(int m, real factor, const real *restrict S, size_t lds, const real *restrict Z, size_t ldz,      \
                     real *restrict M, size_t ldm)                                                                    \
    {                                                                                                                 \
        const real zeros[COUNT * sizeof(VECTOR) / sizeof(real)] = {0};                                                \
        VECTOR sum[ROWS][COUNT], z[COUNT];                                                                            \
        int j, b, c;                                                                                                  \
        for (b = 0; b < ROWS; ++b)                                                                                    \
            for (c = 0; c < COUNT; ++c)                                                                               \
                sum[b][c] = ((const VECTOR *)zeros)[c];                                                               \
        for (j = 0; j < m; ++j, S += lds, Z += ldz) {                                                                 \
            for (c = 0; c < COUNT; ++c) {                                                                             \
                z[c] = ((const VECTOR *)Z)[c];                                                                        \
                LANES_SCALE(z[c], EARLY);                                                                             \
            }                                                                                                         \
            for (b = 0; b < ROWS; ++b)                                                                                \
                for (c = 0; c < COUNT; ++c)                                                                           \
                    LANES_ADD(sum[b][c], S[b], z[c]);                                                                 \
        }                                                                                                             \
        for (b = 0; b < ROWS; ++b, M += ldm)                                                                          \
            for (c = 0; c < COUNT; ++c)                                                                               \
                LANES_ADD(((VECTOR *)M)[c], LATE, sum[b][c]);                                                         \
    }
GRAM(gram_4_2, lanes, 4, 2, factor, 1)
GRAM(gram_4_1, lanes, 4, 1, factor, 1)
#if MBS_STAGES_WIDE
GRAM(wide_8_3, wide, 8, 3, 1, factor)
GRAM(wide_8_2, wide, 8, 2, 1, factor)
GRAM(wide_8_1, wide, 8, 1, 1, factor)
GRAM(wide_4_2, wide, 4, 2, factor, 1)
GRAM(wide_4_1, wide, 4, 1, factor, 1)
GRAM(gram_8_1, lanes, 8, 1, 1, factor)

/* The first columns, as many as make whole vectors, of a tile of 8 rows or 4; returns how many. */
static int gram_widely(int m, int rows, int columns, real factor, const real *S, size_t lds, const real *Z, size_t ldz,
                       real *M, size_t ldm)
{
    int c = 0;
    for (; rows == 8 && c + 3 * WIDE_LANES <= columns; c += 3 * WIDE_LANES)
        wide_8_3(m, factor, S, lds, Z + c, ldz, M + c, ldm);
    for (; c + 2 * WIDE_LANES <= columns; c += 2 * WIDE_LANES)
        (rows == 8 ? wide_8_2 : wide_4_2)(m, factor, S, lds, Z + c, ldz, M + c, ldm);
    for (; c + WIDE_LANES <= columns; c += WIDE_LANES)
        (rows == 8 ? wide_8_1 : wide_4_1)(m, factor, S, lds, Z + c, ldz, M + c, ldm);
    for (; rows == 8 && c < columns; c += MBS_STAGES_LANES)
        gram_8_1(m, factor, S, lds, Z + c, ldz, M + c, ldm);
    return c;
}
#endif

/* The same for rows of S and Z that stay in the cache while all tiles read them. */
static void gram_near(int m, int rows, int width, int lower, real factor, const real *S, size_t lds, const real *Z,
                      size_t ldz, real *M, size_t ldm)
{
    int b, c, tile;
    for (b = 0; b < rows; b += tile, M += (size_t)tile * ldm) {
        int columns;
        tile = MBS_STAGES_WIDE && b + 8 <= rows ? 8 : 4;
        columns = lower ? b + tile : width;
        c = 0;
#if MBS_STAGES_WIDE
        c = gram_widely(m, tile, columns, factor, S + b, lds, Z, ldz, M, ldm);
#endif
        for (; MBS_STAGES_ROOMY && c + 8 <= columns; c += 8)
            gram_4_2(m, factor, S + b, lds, Z + c, ldz, M + c, ldm);
        for (; c < columns; c += 4)
            gram_4_1(m, factor, S + b, lds, Z + c, ldz, M + c, ldm);
    }
}

void mbs_stages_gram(int m, int rows, int width, int lower, real factor, const real *S, int lds, const real *Z, int ldz,
                     real *M, int ldm)
{
    const size_t s = (size_t)lds, z = (size_t)ldz;
    const int near = MBS_STAGES_ROOMY ? GRAM_ROWS : m;
    int j;
    for (j = 0; j + near < m; j += near)
        gram_near(near, rows, width, lower, factor, S + (size_t)j * s, s, Z + (size_t)j * z, z, M, (size_t)ldm);
    gram_near(m - j, rows, width, lower, factor, S + (size_t)j * s, s, Z + (size_t)j * z, z, M, (size_t)ldm);
}

void mbs_stages_mirror(int n, real *M, int ld)
{
    const size_t l = (size_t)ld;
    int i, j;
    for (i = 0; i < n; ++i)
        for (j = 0; j < i; ++j)
            M[(size_t)j * l + (size_t)i] = M[(size_t)i * l + (size_t)j];
}
