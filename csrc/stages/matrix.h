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

/* y += A x, and y += AT x, for the columns from .. to - 1 of A */
void mbs_stages_matrix_apply(const mbs_stages_matrix *A, int from, int to, const real *x, real *y);
void mbs_stages_matrix_apply_transposed(const mbs_stages_matrix *A, int from, int to, const real *x, real *y);

/* rows += A x, and columns += AT y */
void mbs_stages_matrix_apply_both(const mbs_stages_matrix *A, const real *x, real *rows, const real *y, real *columns);

/* y += A x, of the lower triangle of a symmetric A */
void mbs_stages_matrix_apply_symmetric(const mbs_stages_matrix *A, const real *x, real *y);

/* Row j of Z = diagonal[j] times row j of V, plus A_lj times row l of V for the nonzeros of A's column j from begin[j] up to
 * end[j]; j and l count from `first` on. Rows of `width` numbers begin `ld` apart; they
 * have room for whole lines, and what fills them up may change. */
typedef struct {
    int first, count;
    const int *begin, *end;
    const real *diagonal;
} mbs_stages_part;
#if MBS_STAGES_ROOMY
void mbs_stages_matrix_multiply_rows(const mbs_stages_matrix *A, const mbs_stages_part *part, int width, int ld,
                                     const real *V, real *Z);
#endif

/* Multiply row i by row[i], and column j by column[j]. */
void mbs_stages_matrix_scale(const mbs_stages_matrix *A, const real *row, const real *column);

/* most[i] = the largest entry of row i */
void mbs_stages_matrix_row_maxima(const mbs_stages_matrix *A, real *most);

/* The largest entry of the diagonal. */
real mbs_stages_matrix_diagonal(const mbs_stages_matrix *A);

/* Write all entries, or the lower `triangle` alone, into a dense matrix with `ld` numbers a row. */
void mbs_stages_matrix_spread(const mbs_stages_matrix *A, int triangle, real *dense, int ld);

#endif
