/* The order of pivots of inner equations, and sparse factors by it.
 *
 * Stages of one kind share an order. The numbers of one of them give it, and it is kept while pivots are good. */
#ifndef MBS_STAGES_PIVOTS_H
#define MBS_STAGES_PIVOTS_H

#include "matrix.h"

#define MBS_STAGES_TOGETHER 4 /* stages whose inner equations are factorised at once */

/* The block has the first n rows of e and the n columns from `first` on. Place i has row[i] and column[i] of it. With
 * these orders it is the product of a lower matrix and an upper one with a unit diagonal. */
typedef struct {
    int n, first, capacity, entries; /* the most nonzeros of both factors; nonzeros of the block */
    int ready;                       /* 1: there is an order */
    int core;                        /* rows and columns from this place on are full in the factors */
    int stage;                       /* whose numbers are to give the next order */
    int stages, failed;              /* of this kind; stages whose pivots were too small */
    int *row, *column;
    int *entry, *entry_at, *entry_place; /* nonzeros of the row at place i: in the matrix, and the place of the column */
    int *lower, *lower_place, *lower_row; /* nonzeros before the pivot: places of their columns, rows at these */
    int *upper, *upper_place;            /* nonzeros right of it */
    int *upper_column;                   /* the same as columns of the block */
} mbs_stages_pivots;

/* Factors of several stages with one order, number t of lane c at 4 t + c: negative lower entries, the inverse of pivots,
 * negative upper entries. */
typedef struct {
    real *lower, *inverse, *upper;
} mbs_stages_factors;

/* Choose an order by the numbers of A = de. Works in block and marks (n by n), sizes (n) and spots
 * (2 n). Returns -1 if
 * the block is singular or its factors have too many nonzeros. */
int mbs_stages_choose_pivots(mbs_stages_pivots *p, const mbs_stages_matrix *A, real *block, real *sizes, char *marks,
                             int *spots, real zero_pivot);

/* Stages with one order that are factorised at once, a lane each: the numbers of de. */
typedef struct {
    int count;
    const real *value[MBS_STAGES_TOGETHER];
    int failed[MBS_STAGES_TOGETHER]; /* -1, or the place where the pivot is too small */
} mbs_stages_together;

/* Factorise, and write `failed`. Works in `work` (n numbers a lane). No number of a stage depends on the others. */
void mbs_stages_factorise_together(const mbs_stages_pivots *p, mbs_stages_together *stages, const mbs_stages_factors *f,
                                   real *work, real zero_pivot);

/* x = B^-1 b in all lanes: `b` by rows of the block for `count` stages, x by columns, in lanes. Works in `work` (n a lane).
 * x = B^-T b: b in lanes by columns (overwritten), x by rows, in lanes. */
void mbs_stages_solve_together(const mbs_stages_pivots *p, const mbs_stages_factors *f, const real *const *b, int count,
                               real *x, real *work);
void mbs_stages_solve_together_transposed(const mbs_stages_pivots *p, const mbs_stages_factors *f, real *b, real *x,
                                          real *work);

/* X = B^-1 R for one lane, of `width` numbers a row, which begin `ld` apart: R by rows of the block (overwritten), X by
 * columns. Rows have room for whole lines, and what fills them up may change. */
#if MBS_STAGES_ROOMY
void mbs_stages_solve_rows(const mbs_stages_pivots *p, const mbs_stages_factors *f, int lane, int width, int ld, real *R,
                           real *X);
#endif

#endif
