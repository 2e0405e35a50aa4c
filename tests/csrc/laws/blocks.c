#include "laws.h"

#include <stdlib.h>

#include "../../../csrc/stages/blocks.c"

/* Whole numbers, whose sums and products are exact: operations of any order of sums give the same. */
enum { MOST = 24 };
static unsigned seed = 3;

static real draw(void)
{
    seed = seed * 1103515245u + 12345u;
    return (real)((int)(seed / 65536 % 15) - 7);
}

/* An array of exactly `size` numbers. */
static real *make(int size)
{
    real *x = malloc((size_t)(size > 0 ? size : 1) * sizeof *x);
    int i;
    for (i = 0; i < size; ++i)
        x[i] = draw();
    return x;
}

static real *copy(int size, const real *x)
{
    real *y = make(size);
    memcpy(y, x, (size_t)size * sizeof *y);
    return y;
}

/* Matrices column by column, `lda` apart. */
static void columns(int m, int n, int lda)
{
    real *A = make((n > 0 ? n - 1 : 0) * lda + m), *x = make(n), *y = make(m), *was = copy(m, y), *back = make(n);
    real *before = copy(n, back);
    int i, j;
    mbs_stages_apply(m, n, 2, A, lda, x, y);
    mbs_stages_apply_transposed(m, n, 2, A, lda, was, back);
    for (i = 0; i < m; ++i) {
        real sum = was[i];
        for (j = 0; j < n; ++j)
            sum += 2 * A[j * lda + i] * x[j];
        LAW("a product is added", y[i] == sum);
    }
    for (j = 0; j < n; ++j) {
        real sum = before[j];
        for (i = 0; i < m; ++i)
            sum += 2 * A[j * lda + i] * was[i];
        LAW("and one across", back[j] == sum);
    }
    free(A), free(x), free(y), free(was), free(back), free(before);
}

/* Lower triangles, with a diagonal of ones and twos. */
static void triangles(int n, int ld)
{
    real *L = make(n * ld), *x = make(n), *y = make(n), *was = copy(n, y), *wanted = copy(n, x), *b = make(n);
    int i, j;
    mbs_stages_apply_symmetric(n, -3, L, ld, x, y);
    for (i = 0; i < n; ++i) {
        real sum = was[i];
        for (j = 0; j < n; ++j)
            sum -= 3 * (j <= i ? L[j * ld + i] : L[i * ld + j]) * x[j];
        LAW("a symmetric product is by the lower triangle", y[i] == sum);
    }
    for (i = 0; i < n; ++i)
        for (j = 0; j < n; ++j)
            L[i * ld + j] = i == j ? 1 + i % 2 : i < j ? (real)((i + j) % 3 - 1) : 99;
    for (i = 0; i < n; ++i)
        for (j = 0, b[i] = 0; j <= i; ++j)
            b[i] += L[j * ld + i] * wanted[j];
    mbs_stages_lower(n, L, ld, b);
    for (i = 0; i < n; ++i)
        LAW("a lower triangle is solved", b[i] == wanted[i]);
    for (i = 0; i < n; ++i)
        for (j = i, b[i] = 0; j < n; ++j)
            b[i] += L[i * ld + j] * wanted[j];
    mbs_stages_lower_transposed(n, L, ld, b);
    for (i = 0; i < n; ++i)
        LAW("and across", b[i] == wanted[i]);
    free(L), free(x), free(y), free(was), free(wanted), free(b);
}

/* Rows of whole lanes, `ld` apart. */
static void rows(int width, int count, int ld, int stride)
{
    const int size = (count > 0 ? count - 1 : 0) * ld + width;
    real *A = make(size), *by = make((count > 0 ? count - 1 : 0) * stride + 1), *out = make(width),
        *was = copy(width, out);
    real *from = make(width), *a = make(width);
    int *index = malloc((size_t)(count + 1) * sizeof *index), c, t;
    real sum = 0;
    for (t = 0; t < count; ++t)
        index[t] = 5 + (t * 7 + 3) % count;
    for (c = 0; c < width; ++c)
        sum += from[c] * a[c];
    LAW("a product of rows has all numbers", mbs_stages_dot(width, from, a) == sum);
    mbs_stages_add_row(width, 3, a, out);
    for (c = 0; c < width; ++c)
        LAW("a row is added", out[c] == was[c] + 3 * a[c]);
    mbs_stages_scale_row(width, -2, a, out);
    for (c = 0; c < width; ++c)
        LAW("or scaled", out[c] == -2 * a[c]);
    mbs_stages_scale_row(width, 3, out, out);
    for (c = 0; c < width; ++c)
        LAW("in place", out[c] == -6 * a[c]);
    memcpy(out, was, (size_t)width * sizeof *out);
    mbs_stages_add_rows(width, count, -3, by, stride, A, ld, out);
    for (c = 0; c < width; ++c) {
        for (t = 0, sum = was[c]; t < count; ++t)
            sum -= 3 * by[t * stride] * A[t * ld + c];
        LAW("rows are added by numbers a stride apart", out[c] == sum);
    }
    mbs_stages_combine(width, count, index, 5, by, stride, A, ld, 2, from, out);
    for (c = 0; c < width; ++c) {
        for (t = 0, sum = from[c]; t < count; ++t)
            sum += by[t * stride] * A[(index[t] - 5) * ld + c];
        LAW("or those of an index, and scaled", out[c] == 2 * sum);
    }
    free(A), free(by), free(out), free(was), free(from), free(a), free(index);
}

/* M += -2 S^T Z, at least of its lower triangle. */
static void grams(int m, int count, int width, int lower)
{
    const int lds = count + 3, ldz = width + 4, ldm = width + 4, whole = MBS_STAGES_WIDE ? count / 8 * 8 : 0;
    real *S = make((m > 0 ? m - 1 : 0) * lds + count), *Z = make((m > 0 ? m - 1 : 0) * ldz + width);
    real *M = make(count * ldm), *was = copy(count * ldm, M);
    int i, j, t;
    mbs_stages_gram(m, count, width, lower, -2, S, lds, Z, ldz, M, ldm);
    for (i = 0; i < count; ++i)
        for (j = 0; j < ldm; ++j) {
            real sum = was[i * ldm + j];
            if (lower && j > i && j < width)
                continue;
            for (t = 0; t < m && j < width; ++t)
                sum -= 2 * S[t * lds + i] * Z[t * ldz + j];
            LAW("a product of columns is added", M[i * ldm + j] == sum);
        }
    for (i = 0; i < count && lower; ++i)
        for (j = i < whole ? i / 8 * 8 + 8 : i / 4 * 4 + 4; j < ldm; ++j)
            LAW("beside the triangle's tiles nothing is", M[i * ldm + j] == was[i * ldm + j]);
    free(S), free(Z), free(M), free(was);
}

static void mirrors(void)
{
    real M[12] = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12};
    mbs_stages_mirror(3, M, 4);
    LAW("the lower triangle is copied", M[1] == 5 && M[2] == 9 && M[6] == 10);
    LAW("and nothing else", M[0] == 1 && M[3] == 4 && M[4] == 5 && M[5] == 6 && M[7] == 8 && M[8] == 9 && M[9] == 10);
    LAW("rows are filled up to lanes",
        mbs_stages_width(0) == 0 && mbs_stages_width(1) == 4 && mbs_stages_width(4) == 4);
    LAW("whole ones", mbs_stages_width(5) == 8 && mbs_stages_width(8) == 8 && mbs_stages_width(9) == 12);
}

int main(void)
{
    int m, n;
    for (m = 0; m < 11; ++m)
        for (n = 0; n < 10; ++n)
            columns(m, n, m + n % 3);
    for (n = 0; n < 11; ++n)
        triangles(n, n + n % 2);
    for (m = 4; m < 77; m += 4)
        for (n = 0; n < 6; ++n)
            rows(m, n, m + 4 * (n % 2), 1 + n % 3);
    for (m = 0; m < 6; ++m)
        for (n = 4; n < 45; n += 4)
            grams(m, n, n, 1), grams(m, n, n, 0), grams(m, n, n + 4, 0);
    for (m = GRAM_ROWS - 1; m < GRAM_ROWS + 2; ++m)
        grams(m, 8, 8, 1), grams(m, 12, 20, 0);
    mirrors();
    return broken > 0;
}
