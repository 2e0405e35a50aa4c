/* Numbers of several states side by side: compiled with -DMBS_STATES=8, a kernel computes 8 states at once.
 *
 * mbs_real is a vector then, with a number of each state; each is computed as for one state alone. Results are equal, but
 * for the last digits where the compiler contracts products and sums differently. A kernel fails where one of its states
 * does; mbs_many.c finds out which. Needs the vectors of gcc and clang. mbs_abi.h includes this file.
 */
#ifndef MBS_STATES_H
#define MBS_STATES_H

#include <math.h>

#if defined(__SSE2__)
#include <immintrin.h>
#endif

/* Vectors are passed to inline functions alone. */
#pragma GCC diagnostic ignored "-Wpsabi"

#define MBS_LANE_double 8
#define MBS_LANE_float 4
#define MBS_FLAG_double long long
#define MBS_FLAG_float int
#define MBS_VECTOR (MBS_STATES * MBS_PASTE(MBS_LANE_, MBS_REAL)) /* bytes */
typedef MBS_REAL mbs_real __attribute__((vector_size(MBS_VECTOR)));
typedef MBS_PASTE(MBS_FLAG_, MBS_REAL) mbs_flags __attribute__((vector_size(MBS_VECTOR))); /* -1: yes, 0: no */

/* A library may hold a kernel for several numbers of states: its functions' names end with the number. */
#define MBS_STATES_NAME(name) MBS_PASTE(MBS_PASTE(name, _at_), MBS_STATES)
#ifndef MBS_WITHOUT_PLAIN_NAMES
#define MBS_WITHOUT_PLAIN_NAMES
#endif
#undef casadi_real
#define casadi_real mbs_real

/* Instructions for a vector that fills a register. */
#if defined(__AVX512F__) && MBS_STATES == 8
#define MBS_SQRT_VECTOR_double(x) ((mbs_real)_mm512_sqrt_pd((__m512d)(x)))
#define MBS_COMPARE_double(a, b) (_mm512_cmp_pd_mask((__m512d)(a), (__m512d)(b), _CMP_GT_OQ) == 0xff)
#define MBS_HAS_VECTOR_double 1
#elif defined(__AVX__) && MBS_STATES == 4
#define MBS_SQRT_VECTOR_double(x) ((mbs_real)_mm256_sqrt_pd((__m256d)(x)))
#define MBS_COMPARE_double(a, b) (_mm256_movemask_pd(_mm256_cmp_pd((__m256d)(a), (__m256d)(b), _CMP_GT_OQ)) == 0xf)
#define MBS_HAS_VECTOR_double 1
#elif defined(__SSE2__) && MBS_STATES == 2
#define MBS_SQRT_VECTOR_double(x) ((mbs_real)_mm_sqrt_pd((__m128d)(x)))
#define MBS_COMPARE_double(a, b) (_mm_movemask_pd(_mm_cmpgt_pd((__m128d)(a), (__m128d)(b))) == 0x3)
#define MBS_HAS_VECTOR_double 1
#endif
#if defined(__AVX512F__) && MBS_STATES == 16
#define MBS_SQRT_VECTOR_float(x) ((mbs_real)_mm512_sqrt_ps((__m512)(x)))
#define MBS_COMPARE_float(a, b) (_mm512_cmp_ps_mask((__m512)(a), (__m512)(b), _CMP_GT_OQ) == 0xffff)
#define MBS_HAS_VECTOR_float 1
#elif defined(__AVX__) && MBS_STATES == 8
#define MBS_SQRT_VECTOR_float(x) ((mbs_real)_mm256_sqrt_ps((__m256)(x)))
#define MBS_COMPARE_float(a, b) (_mm256_movemask_ps(_mm256_cmp_ps((__m256)(a), (__m256)(b), _CMP_GT_OQ)) == 0xff)
#define MBS_HAS_VECTOR_float 1
#elif defined(__SSE2__) && MBS_STATES == 4
#define MBS_SQRT_VECTOR_float(x) ((mbs_real)_mm_sqrt_ps((__m128)(x)))
#define MBS_COMPARE_float(a, b) (_mm_movemask_ps(_mm_cmpgt_ps((__m128)(a), (__m128)(b))) == 0xf)
#define MBS_HAS_VECTOR_float 1
#endif
#define MBS_HAS_VECTOR MBS_PASTE(MBS_HAS_VECTOR_, MBS_REAL)

#define MBS_ABREAST MBS_STATES
#define MBS_EVERY(x) ((x) - (mbs_real){0}) /* in all states */
#undef MBS_C
#define MBS_C(x) MBS_EVERY(MBS_PASTE(MBS_C_, MBS_REAL)(x))
#undef MBS_THRESHOLD
#define MBS_THRESHOLD(t) mbs_lesser((t) * MBS_EPSILON, MBS_C(3e-5))
#define MBS_EXCEEDS(a, b) mbs_exceeds(a, b)
#define MBS_LARGER(a, b) mbs_select((a) <= (b), b, a)

static inline mbs_real mbs_select(mbs_flags which, mbs_real yes, mbs_real no)
{
    return (mbs_real)((which & (mbs_flags)yes) | (~which & (mbs_flags)no));
}

static inline mbs_real mbs_lesser(mbs_real a, mbs_real b)
{
    return mbs_select(a < b, a, b);
}

/* Return whether a > b in all states; no number is. */
static inline int mbs_exceeds(mbs_real a, mbs_real b)
{
#if MBS_HAS_VECTOR == 1
    return MBS_PASTE(MBS_COMPARE_, MBS_REAL)(a, b);
#else
    const mbs_flags found = a > b;
    int state, all = 1;
    for (state = 0; state < MBS_STATES; ++state)
        all &= found[state] != 0;
    return all;
#endif
}

static inline mbs_real mbs_sqrt(mbs_real x)
{
#if MBS_HAS_VECTOR == 1
    return MBS_PASTE(MBS_SQRT_VECTOR_, MBS_REAL)(x);
#else
    int state;
    for (state = 0; state < MBS_STATES; ++state)
        x[state] = MBS_PASTE(MBS_SQRT_, MBS_REAL)(x[state]);
    return x;
#endif
}

static inline mbs_real mbs_abs(mbs_real x)
{
    return (mbs_real)((mbs_flags)x & ~(mbs_flags)(-(mbs_real){0}));
}

static inline mbs_real mbs_sign(mbs_real x)
{
    return mbs_select(x > 0, MBS_C(1.0), mbs_select(x < 0, MBS_C(-1.0), x));
}

/* Functions of <math.h>, of each state in turn. */
#define MBS_FUNCTION(name, function) \
    static inline mbs_real mbs_each_##name(mbs_real x) \
    { \
        int state; \
        for (state = 0; state < MBS_STATES; ++state) \
            x[state] = MBS_PASTE(function, MBS_REAL)(x[state]); \
        return x; \
    }
MBS_FUNCTION(sin, MBS_SIN_)
MBS_FUNCTION(cos, MBS_COS_)
MBS_FUNCTION(tan, MBS_TAN_)
MBS_FUNCTION(asin, MBS_ASIN_)
MBS_FUNCTION(acos, MBS_ACOS_)
MBS_FUNCTION(atan, MBS_ATAN_)
MBS_FUNCTION(exp, MBS_EXP_)
MBS_FUNCTION(log, MBS_LOG_)
MBS_FUNCTION(tanh, MBS_TANH_)

static inline mbs_real mbs_each_atan2(mbs_real y, mbs_real x)
{
    int state;
    for (state = 0; state < MBS_STATES; ++state)
        x[state] = MBS_PASTE(MBS_ATAN2_, MBS_REAL)(y[state], x[state]);
    return x;
}

#undef MBS_SIN
#define MBS_SIN mbs_each_sin
#undef MBS_COS
#define MBS_COS mbs_each_cos
#undef MBS_SQRT
#define MBS_SQRT mbs_sqrt
#undef MBS_TAN
#define MBS_TAN mbs_each_tan
#undef MBS_ASIN
#define MBS_ASIN mbs_each_asin
#undef MBS_ACOS
#define MBS_ACOS mbs_each_acos
#undef MBS_ATAN
#define MBS_ATAN mbs_each_atan
#undef MBS_ATAN2
#define MBS_ATAN2 mbs_each_atan2
#undef MBS_EXP
#define MBS_EXP mbs_each_exp
#undef MBS_LOG
#define MBS_LOG mbs_each_log
#undef MBS_TANH
#define MBS_TANH mbs_each_tanh
#undef MBS_ABS
#define MBS_ABS mbs_abs
#undef MBS_SIGN
#define MBS_SIGN mbs_sign

#endif
