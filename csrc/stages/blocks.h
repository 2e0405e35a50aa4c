/* Small dense blocks. */
#ifndef MBS_STAGES_BLOCKS_H
#define MBS_STAGES_BLOCKS_H

#include "mbs_stages.h"
#include "names.h"

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

#include "constants.h"

#define MBS_STAGES_LANES 4

/* As many numbers, written as a vector where there are such: a loop over four is taken apart before a compiler sees
 * that it could be one. LANES_ADD: a += x b, for a number x; LANES_ADD_EACH: a += x b, for lanes x; LANE: number c of a. */
#if defined(__arm__) && !defined(__ARM_NEON) && defined(__OPTIMIZE_SIZE__) && !defined(MBS_SCALAR)
#define MBS_SCALAR /* no vectors: loops are smaller, and a few per cent slower */
#endif
/* Where registers hold 64 bytes, there are vectors of as many, and long rows begin with them. */
#ifndef MBS_STAGES_WIDE
#if defined(__AVX512F__) && defined(__GNUC__) && !defined(MBS_SCALAR)
#define MBS_STAGES_WIDE 1
#else
#define MBS_STAGES_WIDE 0
#endif
#endif
#if defined(MBS_SCALAR) && defined(__OPTIMIZE_SIZE__)
#define MBS_STAGES_ROOMY 0 /* without vectors, larger blocks save little time */
#else
#define MBS_STAGES_ROOMY 1
#endif
#define MBS_STAGES_LINE (MBS_STAGES_WIDE ? 64 / (int)sizeof(real) : MBS_STAGES_LANES)

#if defined(__GNUC__) && !defined(MBS_SCALAR)
typedef real lanes __attribute__((vector_size(MBS_STAGES_LANES * sizeof(real)), aligned(sizeof(real)), may_alias));
#if MBS_STAGES_WIDE
typedef real wide __attribute__((vector_size(64), aligned(sizeof(real)), may_alias));
#endif
#define LANES_OF(a, b, c, d) {a, b, c, d}
#define LANES_ADD(a, x, b) ((a) += (x) * (b))
#define LANES_ADD_EACH(a, x, b) ((a) += (x) * (b))
#define LANES_PLUS(a, b) ((a) += (b))
#define LANES_SCALE(a, x) ((a) *= (x))
#define LANES_MULTIPLY(a, x, b) ((a) = (x) * (b))
#else
typedef struct {
    real at[MBS_STAGES_LANES];
} lanes;
#define OF_LANES(assign)                                         \
    do {                                                         \
        int at_lane;                                             \
        for (at_lane = 0; at_lane < MBS_STAGES_LANES; ++at_lane) \
            assign;                                              \
    } while (0)
#define LANES_OF(a, b, c, d) {{a, b, c, d}}
#define LANES_ADD(a, x, b) OF_LANES((a).at[at_lane] += (x) * (b).at[at_lane])
#define LANES_ADD_EACH(a, x, b) OF_LANES((a).at[at_lane] += (x).at[at_lane] * (b).at[at_lane])
#define LANES_PLUS(a, b) OF_LANES((a).at[at_lane] += (b).at[at_lane])
#define LANES_SCALE(a, x) OF_LANES((a).at[at_lane] *= (x))
#define LANES_MULTIPLY(a, x, b) OF_LANES((a).at[at_lane] = (x).at[at_lane] * (b).at[at_lane])
#endif
#define LANE(a, c) (((real *)&(a))[c])

/* y += factor A x, and y += factor AT x; A is m by n */
void mbs_stages_apply(int m, int n, real factor, const real *A, int lda, const real *x, real *y);
void mbs_stages_apply_transposed(int m, int n, real factor, const real *A, int lda, const real *x, real *y);

/* y += factor A x, of the lower triangle of a symmetric A */
void mbs_stages_apply_symmetric(int n, real factor, const real *A, int lda, const real *x, real *y);

/* x = L^-1 x and x = L^-T x, for a lower triangle */
void mbs_stages_lower(int n, const real *L, int ldl, real *x);
void mbs_stages_lower_transposed(int n, const real *L, int ldl, real *x);

/* For the operations below, matrices lie row by row. A row has a `width`, a multiple of MBS_STAGES_LANES: zeros fill it
 * up. Rows begin `ld` numbers apart. */
int mbs_stages_width(int n);

/* Such a width in lines, multiples of MBS_STAGES_LINE. */
static inline int mbs_stages_lines(int width)
{
    return MBS_STAGES_WIDE ? (width + MBS_STAGES_LINE - 1) / MBS_STAGES_LINE * MBS_STAGES_LINE : width;
}

/* Panels of long rows: as many vectors as stay in registers. DEFINE(count) is repeated for each number of vectors there is,
 * and CALL(count) for each panel of `width` numbers from c on. */
#if MBS_STAGES_WIDE
typedef wide mbs_stages_panel;
#define MBS_STAGES_PANELS(DEFINE) DEFINE(4) DEFINE(3) DEFINE(2) DEFINE(1)
#define MBS_STAGES_EACH_PANEL(c, width, CALL) \
    do { \
        for (; (c) + 3 * MBS_STAGES_LINE < (width); (c) += 4 * MBS_STAGES_LINE) \
            CALL(4); \
        if ((c) + 2 * MBS_STAGES_LINE < (width)) \
            CALL(3); \
        else if ((c) + MBS_STAGES_LINE < (width)) \
            CALL(2); \
        else if ((c) < (width)) \
            CALL(1); \
    } while (0)
#else
typedef lanes mbs_stages_panel;
#define MBS_STAGES_PANELS(DEFINE) DEFINE(4) DEFINE(2) DEFINE(1)
#define MBS_STAGES_EACH_PANEL(c, width, CALL) \
    do { \
        for (; (c) + 4 * MBS_STAGES_LANES <= (width); (c) += 4 * MBS_STAGES_LANES) \
            CALL(4); \
        for (; (c) + 2 * MBS_STAGES_LANES <= (width); (c) += 2 * MBS_STAGES_LANES) \
            CALL(2); \
        for (; (c) < (width); (c) += MBS_STAGES_LANES) \
            CALL(1); \
    } while (0)
#endif

real mbs_stages_dot(int width, const real *a, const real *b);

/* out += factor row, and out = factor row; `row` may be `out` of the second one */
void mbs_stages_add_row(int width, real factor, const real *row, real *out);
void mbs_stages_scale_row(int width, real factor, const real *row, real *out);

/* out = scale (from + sum over t of factor[t stride] times row index[t] - first); `from` may be `out` */
void mbs_stages_combine(int width, int count, const int *index, int first, const real *factor, int stride,
                        const real *rows, int ld, real scale, const real *from, real *out);

/* out += factor times the sum over t < count of by[t stride] times row t */
void mbs_stages_add_rows(int width, int count, real factor, const real *by, int stride, const real *rows, int ld,
                         real *out);

/* M += factor ST Z: S and Z have m rows; M has `rows` of them, a multiple of MBS_STAGES_LANES. `lower`: at least the
 * lower triangle of it. */
void mbs_stages_gram(int m, int rows, int width, int lower, real factor, const real *S, int lds, const real *Z, int ldz,
                     real *M, int ldm);

/* Copy the lower triangle of the first n rows into the upper one. */
void mbs_stages_mirror(int n, real *M, int ld);

#endif
