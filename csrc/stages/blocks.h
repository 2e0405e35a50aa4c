/* Small dense blocks, column by column. */
#ifndef MBS_STAGES_BLOCKS_H
#define MBS_STAGES_BLOCKS_H

#include "mbs_stages.h"

#include <math.h>

/* Numbers and functions of one precision alone: a processor may compute double ones by software. */
typedef mbs_stages_real real;
#ifdef MBS_STAGES_FLOAT
#define real_abs fabsf
#define real_sqrt sqrtf
#define real_pow powf
#define real_log logf
#define real_log10 log10f
#else
#define real_abs fabs
#define real_sqrt sqrt
#define real_pow pow
#define real_log log
#define real_log10 log10
#endif

/* C += factor A B: A is m by k, B is k by n; `lower`: only the lower triangle of C. */
void mbs_stages_multiply(int m, int n, int k, real factor, const real *A, int lda, const real *B, int ldb, real *C,
                         int ldc, int lower);

/* B = AT, A is m by n */
void mbs_stages_transpose(int m, int n, const real *A, int lda, real *B, int ldb);

/* y += factor A x, and y += factor AT x; A is m by n */
void mbs_stages_apply(int m, int n, real factor, const real *A, int lda, const real *x, real *y);
void mbs_stages_apply_transposed(int m, int n, real factor, const real *A, int lda, const real *x, real *y);

/* y += factor A x, of the lower triangle of a symmetric A */
void mbs_stages_apply_symmetric(int n, real factor, const real *A, int lda, const real *x, real *y);

/* Rows of `width` numbers, contiguous, for the operations below; a width is a multiple of MBS_STAGES_LANES. */
#define MBS_STAGES_LANES 4
int mbs_stages_width(int n);

/* out = scale (out + sum over t of factor[t stride] times row index[t]); rows begin `ld` numbers apart */
void mbs_stages_combine(int width, int count, const int *index, const real *factor, int stride, const real *rows,
                        int ld, real scale, real *out);

/* M += ST Z: S and Z have m rows, M has `width` of them; rows begin `ld` numbers apart. */
void mbs_stages_gram(int m, int width, const real *S, const real *Z, real *M, int ld);

/* Factorise the first n columns of the lower triangle of a symmetric A, m by m: A = L LT there. Returns the column of
 * the first pivot that is not above `zero` times the largest that the diagonal entry was, or -1. */
int mbs_stages_cholesky(int m, int n, real *A, int lda, real zero);

/* x = L^-1 x and x = L^-T x */
void mbs_stages_lower(int n, const real *L, int ldl, real *x);
void mbs_stages_lower_transposed(int n, const real *L, int ldl, real *x);

/* x = U^-1 x and x = U^-T x; U in the upper triangle */
void mbs_stages_upper(int n, const real *U, int ldu, real *x);
void mbs_stages_upper_transposed(int n, const real *U, int ldu, real *x);

#endif
