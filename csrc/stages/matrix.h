/* Matrices of a stage: the numbers that callbacks wrote, dense or by a pattern. */
#ifndef MBS_STAGES_MATRIX_H
#define MBS_STAGES_MATRIX_H

#include "blocks.h"

/* Nonzeros of column j: value[begin[j]] up to value[end[j]], in rows `row`. Without `begin` all entries are there. */
typedef struct {
    int rows, columns;
    const int *begin, *end, *row;
    int count; /* of numbers in `value` */
    real *value;
} mbs_stages_matrix;

/* y += A x, and y += AT x */
void mbs_stages_matrix_apply(const mbs_stages_matrix *A, const real *x, real *y);
void mbs_stages_matrix_apply_transposed(const mbs_stages_matrix *A, const real *x, real *y);

/* y += A x, of the lower triangle of a symmetric A */
void mbs_stages_matrix_apply_symmetric(const mbs_stages_matrix *A, const real *x, real *y);

/* Multiply row i by row[i], and column j by column[j]. */
void mbs_stages_matrix_scale(const mbs_stages_matrix *A, const real *row, const real *column);

/* most[i] = the largest entry of row i */
void mbs_stages_matrix_row_maxima(const mbs_stages_matrix *A, real *most);

/* The largest entry of the diagonal. */
real mbs_stages_matrix_diagonal(const mbs_stages_matrix *A);

/* Write all entries into a dense matrix with `ld` numbers a column. */
void mbs_stages_matrix_spread(const mbs_stages_matrix *A, real *dense, int ld);

#endif
