/* Inner equations whose usual pivots are too small: complete pivoting, which finds what they do not determine. */
#ifndef MBS_STAGES_COMPLETE_H
#define MBS_STAGES_COMPLETE_H

#include "matrix.h"

/* Row and column of place i are row[i] and column[i]; the first `rank` places have pivots. The lower factor has a unit
 * diagonal. */
typedef struct {
    int n, rank;
    real *a; /* both factors, row by row, by places */
    int *row, *column;
    real *work; /* n */
    int *largest, *nonzero; /* the column of the largest entry of each row; columns of a row; n each */
} mbs_stages_complete;

/* Pivots, beside the largest entry of their row: those up to `zero` are 0; those up to `small` are used only while more
 * than `room` rows would be left without a pivot. */
typedef struct {
    real zero, small;
    int room;
} mbs_stages_least_pivots;

/* Factorise the first n rows of A, in the n columns from `first` on. */
void mbs_stages_factorise_completely(mbs_stages_complete *c, const mbs_stages_matrix *A, int first,
                                     const mbs_stages_least_pivots *least);

/* Unknowns without a pivot are 0, and so are multipliers of rows without one. Returns the largest residual of these
 * rows. b by rows, x by columns. */
real mbs_stages_solve_completely(const mbs_stages_complete *c, const real *b, real *x);

/* b by columns, x by rows */
void mbs_stages_solve_completely_transposed(const mbs_stages_complete *c, const real *b, real *x);

/* The same for right-hand sides of `width` numbers a row, which begin `ld` apart: B by rows (overwritten), X by
 * columns. */
void mbs_stages_solve_rows_completely(const mbs_stages_complete *c, int width, int ld, real *B, real *X);

#endif
