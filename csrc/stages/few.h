/* Matrices some of whose rows have few numbers that are not 0, as muscles have them for activations. */
#ifndef MBS_STAGES_FEW_H
#define MBS_STAGES_FEW_H

#include "blocks.h"

#ifdef MBS_STAGES_REALTIME
#define MBS_STAGES_LOOKS 0 /* steps alone have little code, and no memory for lists */
#else
#define MBS_STAGES_LOOKS MBS_STAGES_ROOMY
#endif
#define MBS_STAGES_FEW 4 /* numbers of such a row, at most */

/* Row i has count[i] numbers that are not 0, in columns from column[MBS_STAGES_FEW i] on, or more: then count[i] is
 * negative. A pointer that is NULL: all rows have more. */
typedef struct {
    int *count, *column;
} mbs_stages_few;

#if MBS_STAGES_LOOKS
/* Look at m rows of `width` numbers. */
void mbs_stages_find_few(const mbs_stages_few *f, int m, int width, const real *A, int lda);

/* How many rows from row i on, of m, are alike: they have few numbers, or more. */
int mbs_stages_count_alike(const mbs_stages_few *f, int i, int m);

/* M += ST Z as mbs_stages_gram has it. Row 0 of S is row `first` of the matrix, column 0 its column `shift`; columns before
 * it hold 0. */
void mbs_stages_gram_few(const mbs_stages_few *f, int first, int shift, int m, int rows, int width, int lower,
                         const real *S, int lds, const real *Z, int ldz, real *M, int ldm);

/* The lower triangle of M += ST Z, or `twice` of M += ST Z + ZT S, of m rows and n columns. Above it M is 0 before, and
 * anything after. */
void mbs_stages_square_few(const mbs_stages_few *f, int m, int n, int twice, const real *S, int lds, const real *Z, int ldz,
                           real *M, int ldm);

/* M += A F of m rows: A is m by n, F has n rows, which are rows from `first` on of the matrix, and columns from `shift` on.
 * A is symmetric where m is n, and has `n` in whole lanes of rows. */
void mbs_stages_product_few(const mbs_stages_few *f, int first, int shift, int n, int width, const real *A, int lda,
                            const real *F, int ldf, real *M, int ldm);

/* out += factor row, of row i with `width` numbers; the sum of products; out += AT by, for m rows. */
void mbs_stages_add_row_few(const mbs_stages_few *f, int i, int width, real factor, const real *row, real *out);
real mbs_stages_dot_few(const mbs_stages_few *f, int i, int width, const real *row, const real *x);
void mbs_stages_add_rows_few(const mbs_stages_few *f, int m, int width, const real *by, const real *A, int lda,
                             real *out);
#else
static inline void mbs_stages_find_few(const mbs_stages_few *f, int m, int width, const real *A, int lda)
{
    (void)f, (void)m, (void)width, (void)A, (void)lda;
}

static inline void mbs_stages_gram_few(const mbs_stages_few *f, int first, int shift, int m, int rows, int width, int lower,
                                       const real *S, int lds, const real *Z, int ldz, real *M, int ldm)
{
    (void)f, (void)first, (void)shift;
    mbs_stages_gram(m, rows, width, lower, 1, S, lds, Z, ldz, M, ldm);
}

static inline void mbs_stages_square_few(const mbs_stages_few *f, int m, int n, int twice, const real *S, int lds,
                                         const real *Z, int ldz, real *M, int ldm)
{
    (void)f;
    mbs_stages_gram(m, n, n, 1, 1, S, lds, Z, ldz, M, ldm);
    if (twice)
        mbs_stages_gram(m, n, n, 1, 1, Z, ldz, S, lds, M, ldm);
}

static inline void mbs_stages_product_few(const mbs_stages_few *f, int first, int shift, int n, int width, const real *A,
                                          int lda, const real *F, int ldf, real *M, int ldm)
{
    (void)f, (void)first, (void)shift;
    mbs_stages_gram(n, mbs_stages_width(n), width, 0, 1, A, lda, F, ldf, M, ldm);
}

static inline void mbs_stages_add_row_few(const mbs_stages_few *f, int i, int width, real factor, const real *row,
                                          real *out)
{
    (void)f, (void)i;
    mbs_stages_add_row(width, factor, row, out);
}

static inline real mbs_stages_dot_few(const mbs_stages_few *f, int i, int width, const real *row, const real *x)
{
    (void)f, (void)i;
    return mbs_stages_dot(width, row, x);
}

static inline void mbs_stages_add_rows_few(const mbs_stages_few *f, int m, int width, const real *by, const real *A,
                                           int lda, real *out)
{
    (void)f;
    mbs_stages_add_rows(width, m, 1, by, 1, A, lda, out);
}
#endif

#endif
