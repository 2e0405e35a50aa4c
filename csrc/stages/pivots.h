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
    int stage;                       /* whose numbers are to give the next order */
    int stages, failed;              /* of this kind; stages whose pivots were too small */
    int *row, *column;
    int *entry, *entry_at, *entry_place; /* nonzeros of the row at place i: in the matrix, and the place of the column */
    int *lower, *lower_place, *lower_row; /* nonzeros before the pivot: places of their columns, rows at these */
    int *upper, *upper_place;            /* nonzeros right of it */
    int *upper_column;                   /* the same as columns of the block */
    int dense;                           /* from this place on the factors are full */
} mbs_stages_pivots;

/* Factors of a stage: negative lower entries, the inverse of pivots, negative upper entries after the lower ones. */
typedef struct {
    real *lower, *inverse, *upper;
} mbs_stages_factors;

/* Choose an order by the numbers of A = de. Works in block and marks (n by n), sizes (n) and spots
 * (2 n). Returns -1 if
 * the block is singular or its factors have too many nonzeros. */
int mbs_stages_choose_pivots(mbs_stages_pivots *p, const mbs_stages_matrix *A, real *block, real *sizes, char *marks,
                             int *spots, real zero_pivot);

/* Stages with one order that are factorised at once: the numbers of de, and where factors come to. */
typedef struct {
    int count;
    const real *value[MBS_STAGES_TOGETHER];
    const mbs_stages_factors *factors[MBS_STAGES_TOGETHER];
    int failed[MBS_STAGES_TOGETHER]; /* -1, or the place where the pivot is too small */
} mbs_stages_together;

/* Factorise, and write `failed`. Works in `work`: 2 n numbers and as many as the factors have, of each stage. No number of
 * a stage depends on the others. */
void mbs_stages_factorise_together(const mbs_stages_pivots *p, mbs_stages_together *stages, real *work,
                                   real zero_pivot);

/* x = B^-1 b: b by rows and x by columns of the block; x = B^-T b: b by columns (overwritten), x by rows. Both work in
 * `work` (n). */
void mbs_stages_solve_block(const mbs_stages_pivots *p, const mbs_stages_factors *f, const real *b, real *x,
                            real *work);
void mbs_stages_solve_block_transposed(const mbs_stages_pivots *p, const mbs_stages_factors *f, real *b, real *x,
                                       real *work);

#endif
