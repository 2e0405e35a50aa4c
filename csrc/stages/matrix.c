/* Matrices with or without a pattern: see matrix.h. */
#include "matrix.h"

#include <string.h>

void mbs_stages_matrix_apply(const mbs_stages_matrix *A, int from, int to, const real *x, real *restrict y)
{
    int j, l;
    if (A->begin == NULL) {
        mbs_stages_apply(A->rows, to - from, 1, A->value + (size_t)from * (size_t)A->rows, A->rows, x + from, y);
        return;
    }
    for (j = from; j < to; ++j) {
        const real a = x[j];
        for (l = A->begin[j]; l < A->end[j]; ++l)
            y[A->row[l]] += A->value[l] * a;
    }
}

void mbs_stages_matrix_apply_transposed(const mbs_stages_matrix *A, int from, int to, const real *x, real *restrict y)
{
    int j, l;
    if (A->begin == NULL) {
        mbs_stages_apply_transposed(A->rows, to - from, 1, A->value + (size_t)from * (size_t)A->rows, A->rows, x,
                                    y + from);
        return;
    }
    for (j = from; j < to; ++j) {
        real sum = 0;
        for (l = A->begin[j]; l < A->end[j]; ++l)
            sum += A->value[l] * x[A->row[l]];
        y[j] += sum;
    }
}

void mbs_stages_matrix_apply_both(const mbs_stages_matrix *A, const real *x, real *restrict rows, const real *y,
                                  real *restrict columns)
{
    int j, l;
    if (A->begin == NULL) {
        mbs_stages_matrix_apply(A, 0, A->columns, x, rows);
        mbs_stages_matrix_apply_transposed(A, 0, A->columns, y, columns);
        return;
    }
    for (j = 0; j < A->columns; ++j) {
        const real a = x[j];
        real sum = 0;
        for (l = A->begin[j]; l < A->end[j]; ++l) {
            const real value = A->value[l];
            const int i = A->row[l];
            rows[i] += value * a;
            sum += value * y[i];
        }
        columns[j] += sum;
    }
}

void mbs_stages_matrix_apply_symmetric(const mbs_stages_matrix *A, const real *x, real *restrict y)
{
    int j, l;
    if (A->begin == NULL) {
        mbs_stages_apply_symmetric(A->rows, 1, A->value, A->rows, x, y);
        return;
    }
    for (j = 0; j < A->columns; ++j) {
        const real a = x[j];
        real sum = 0;
        l = A->begin[j];
        if (l < A->end[j] && A->row[l] == j)
            sum = A->value[l++] * a;
        for (; l < A->end[j]; ++l) {
            sum += A->value[l] * x[A->row[l]];
            y[A->row[l]] += A->value[l] * a;
        }
        y[j] += sum;
    }
}

#if MBS_STAGES_ROOMY
/* For COUNT vectors of columns. */
#define MULTIPLY_ROWS(COUNT) \
    static void multiply_panel_##COUNT(const mbs_stages_matrix *A, const mbs_stages_part *part, size_t ld, \
                                       const real *restrict V, real *restrict Z) \
    { \
        const real *from = V; \
        int j, l, c; \
        for (j = 0; j < part->count; ++j, from += ld, Z += ld) { \
            mbs_stages_panel sum[COUNT]; \
            for (c = 0; c < COUNT; ++c) { \
                sum[c] = ((const mbs_stages_panel *)from)[c]; \
                LANES_SCALE(sum[c], part->diagonal[j]); \
            } \
            for (l = part->begin[j]; l < part->end[j]; ++l) { \
                const mbs_stages_panel *row = (const mbs_stages_panel *)(V + (size_t)(A->row[l] - part->first) * ld); \
                const real a = A->value[l]; \
                for (c = 0; c < COUNT; ++c) \
                    LANES_ADD(sum[c], a, row[c]); \
            } \
            for (c = 0; c < COUNT; ++c) \
                ((mbs_stages_panel *)Z)[c] = sum[c]; \
        } \
    }
MBS_STAGES_PANELS(MULTIPLY_ROWS)
#define MULTIPLY_PANEL(COUNT) multiply_panel_##COUNT(A, part, w, V + c, Z + c)

void mbs_stages_matrix_multiply_rows(const mbs_stages_matrix *A, const mbs_stages_part *part, int width, int ld,
                                     const real *V, real *Z)
{
    const size_t w = (size_t)ld;
    int c = 0;
    MBS_STAGES_EACH_PANEL(c, width, MULTIPLY_PANEL);
}
#endif

void mbs_stages_matrix_scale(const mbs_stages_matrix *A, const real *row, const real *column)
{
    int i, j, l;
    if (A->begin == NULL) {
        real *a = A->value;
        for (j = 0; j < A->columns; ++j, a += A->rows)
            for (i = 0; i < A->rows; ++i)
                a[i] *= row[i] * column[j];
        return;
    }
    for (j = 0; j < A->columns; ++j)
        for (l = A->begin[j]; l < A->end[j]; ++l)
            A->value[l] *= row[A->row[l]] * column[j];
}

static void raise_to(real *most, real a)
{
    if (real_abs(a) > *most)
        *most = real_abs(a);
}

void mbs_stages_matrix_row_maxima(const mbs_stages_matrix *A, real *most)
{
    int i, j, l;
    memset(most, 0, (size_t)A->rows * sizeof *most);
    for (j = 0; j < A->columns; ++j)
        if (A->begin == NULL)
            for (i = 0; i < A->rows; ++i)
                raise_to(&most[i], A->value[(size_t)j * (size_t)A->rows + (size_t)i]);
        else
            for (l = A->begin[j]; l < A->end[j]; ++l)
                raise_to(&most[A->row[l]], A->value[l]);
}

real mbs_stages_matrix_diagonal(const mbs_stages_matrix *A)
{
    real most = 0;
    int j;
    for (j = 0; j < A->columns; ++j)
        if (A->begin == NULL)
            raise_to(&most, A->value[(size_t)j * (size_t)(A->rows + 1)]);
        else if (A->begin[j] < A->end[j] && A->row[A->begin[j]] == j)
            raise_to(&most, A->value[A->begin[j]]);
    return most;
}

void mbs_stages_matrix_spread(const mbs_stages_matrix *A, int triangle, real *dense, int ld)
{
    int i, j, l;
    memset(dense, 0, (size_t)A->rows * (size_t)ld * sizeof *dense);
    for (j = 0; j < A->columns; ++j) {
        real *to = dense + j;
        for (i = triangle ? j : 0; A->begin == NULL && i < A->rows; ++i)
            to[(size_t)i * (size_t)ld] = A->value[(size_t)j * (size_t)A->rows + (size_t)i];
        for (l = A->begin ? A->begin[j] : 0; A->begin && l < A->end[j]; ++l)
            to[(size_t)A->row[l] * (size_t)ld] = A->value[l];
    }
}
