/* Sines and cosines of some angles together, for the kernels that include this file.
 *
 * An angle less a multiple of pi/2, in three pieces (Cody and Waite, "Software Manual for the Elementary Functions",
 * 1980), leaves a remainder, kept in two numbers, for minimax polynomials. Where the compiler knows vectors, several
 * angles are computed at once. Errors stay below 0.86 units in the last place (0.9 in single precision): half of one by the
 * last rounding, a quarter by that of the square. A zero keeps its sign; beyond MBS_SINCOS_LIMIT, and for what is no number, <math.h> is asked. Rounding to nearest is taken
 * for granted. -DMBS_LIBM asks <math.h> always, -DMBS_SCALAR uses no vectors.
 *
 * C99, reentrant. tests/csrc/minimax.py finds the numbers.
 */
#ifndef MBS_SINCOS_H
#define MBS_SINCOS_H

#include <float.h>
#include <math.h>

#include "mbs_abi.h"

/* Sums must be rounded as they are written. */
#if !defined(MBS_LIBM) && (FLT_EVAL_METHOD != 0 || defined(__FAST_MATH__))
#define MBS_LIBM
#endif

#ifdef MBS_LIBM

#define MBS_PACK 1

static inline void mbs_sincos(int n, const mbs_real *x, mbs_real *s, mbs_real *c)
{
    int i;
    for (i = 0; i < n; ++i) {
        s[i] = MBS_SIN(x[i]);
        c[i] = MBS_COS(x[i]);
    }
}

#else

#define MBS_SINCOS_LIMIT_double 1e5 /* below 2^16 quarters of a turn; times the first two pieces, they are exact */
#define MBS_SINCOS_LIMIT_float 200.0f /* 2^7 */
#define MBS_SINCOS_LIMIT MBS_PASTE(MBS_SINCOS_LIMIT_, MBS_REAL)
#define MBS_INTEGER_double 0x1.8p52 /* added to a number, it leaves an integer, in the last bits */
#define MBS_INTEGER_float 0x1.8p23f
#define MBS_INTEGER MBS_PASTE(MBS_INTEGER_, MBS_REAL)
#define MBS_ONE MBS_PASTE(MBS_C_, MBS_REAL)(1.0)
#define MBS_HALF MBS_PASTE(MBS_C_, MBS_REAL)(0.5)
#define MBS_TWO_OVER_PI_double 0x1.45f306dc9c883p-1
#define MBS_TWO_OVER_PI_float 0x1.45f306p-1f
#define MBS_TWO_OVER_PI MBS_PASTE(MBS_TWO_OVER_PI_, MBS_REAL)
#define MBS_HALF_PI_1_double 0x1.921fb5444p+0
#define MBS_HALF_PI_1_float 0x1.921fp+0f
#define MBS_HALF_PI_1 MBS_PASTE(MBS_HALF_PI_1_, MBS_REAL)
#define MBS_HALF_PI_2_double 0x1.68c234c4cp-39
#define MBS_HALF_PI_2_float 0x1.6a88p-17f
#define MBS_HALF_PI_2 MBS_PASTE(MBS_HALF_PI_2_, MBS_REAL)
#define MBS_HALF_PI_3_double 0x1.98a2e03707345p-77
#define MBS_HALF_PI_3_float 0x1.0b4612p-34f
#define MBS_HALF_PI_3 MBS_PASTE(MBS_HALF_PI_3_, MBS_REAL)

/* sin r = r + r z S(z), cos r = 1 - z/2 + z^2 C(z), with z = r^2; relative errors up to 2^-57.9 and 2^-27.9 */
#define MBS_POLYNOMIAL_2(z, a, b, c) ((a) + (z) * ((b) + (z) * (c)))
#define MBS_POLYNOMIAL_5(z, a, b, c, d, e, f) MBS_POLYNOMIAL_2(z, a, b, (c) + (z) * ((d) + (z) * ((e) + (z) * (f))))
#define MBS_SINE_double(z) \
    MBS_POLYNOMIAL_5(z, -0.1666666666666663, 0.008333333333322009, -0.0001984126982949777, 2.7557313588428564e-06, \
                     -2.505074243774969e-08, 1.58959124452268e-10)
#define MBS_SINE_float(z) MBS_POLYNOMIAL_2(z, -0.16666655f, 0.008332157f, -0.00019514647f)
#define MBS_SINE MBS_PASTE(MBS_SINE_, MBS_REAL)
#define MBS_COSINE_double(z) \
    MBS_POLYNOMIAL_5(z, 0.041666666666666595, -0.00138888888888729, 2.4801587288750676e-05, -2.7557314149360595e-07, \
                     2.0875696675036095e-09, -1.1358315905576734e-11)
#define MBS_COSINE_float(z) MBS_POLYNOMIAL_2(z, 0.041666646f, -0.001388731f, 2.4432431e-05f)
#define MBS_COSINE MBS_PASTE(MBS_COSINE_, MBS_REAL)

/* Some numbers side by side, and their bits. Vectors of 512 bits are slower on the processors that have them. */
#define MBS_BITS_double unsigned long long
#define MBS_BITS_float unsigned int
typedef MBS_PASTE(MBS_BITS_, MBS_REAL) mbs_word;
#define MBS_SIZE_double 8
#define MBS_SIZE_float 4
#if defined(MBS_STATES)
#define MBS_PACK MBS_STATES
#elif !defined(__GNUC__) || defined(MBS_SCALAR)
#define MBS_PACK 1
#elif defined(__AVX__)
#define MBS_PACK (32 / MBS_PASTE(MBS_SIZE_, MBS_REAL))
#else
#define MBS_PACK (16 / MBS_PASTE(MBS_SIZE_, MBS_REAL))
#endif
#if MBS_PACK == 16
#define MBS_EACH(x) \
    x(0) x(1) x(2) x(3) x(4) x(5) x(6) x(7) x(8) x(9) x(10) x(11) x(12) x(13) x(14) x(15)
#elif MBS_PACK == 8
#define MBS_EACH(x) x(0) x(1) x(2) x(3) x(4) x(5) x(6) x(7)
#elif MBS_PACK == 4
#define MBS_EACH(x) x(0) x(1) x(2) x(3)
#elif MBS_PACK == 2
#define MBS_EACH(x) x(0) x(1)
#else
#define MBS_EACH(x) x(0)
#endif
#if MBS_PACK > 1
#define MBS_ENTRY(pack, i) (pack)[i]
#define MBS_COLD __attribute__((noinline, cold))
typedef MBS_REAL mbs_pack __attribute__((vector_size(MBS_PACK * sizeof(MBS_REAL))));
typedef mbs_word mbs_bits __attribute__((vector_size(MBS_PACK * sizeof(MBS_REAL))));
#define mbs_to_bits(pack) ((mbs_bits)(pack))
#define mbs_from_bits(bits) ((mbs_pack)(bits))
#else
#define MBS_ENTRY(pack, i) (pack)
#if defined(__CUDACC__)
#define MBS_COLD __noinline__
#else
#define MBS_COLD
#endif
typedef mbs_real mbs_pack;
typedef mbs_word mbs_bits;
typedef union {
    mbs_pack numbers;
    mbs_bits bits;
} mbs_either;
static inline mbs_bits mbs_to_bits(mbs_pack numbers)
{
    const mbs_either x = {numbers};
    return x.bits;
}
static inline mbs_pack mbs_from_bits(mbs_bits bits)
{
    mbs_either x;
    x.bits = bits;
    return x.numbers;
}
#endif

static inline void mbs_sincos_pack(const mbs_pack *x, mbs_pack *s, mbs_pack *c)
{
    const mbs_pack turned = *x * MBS_TWO_OVER_PI + MBS_INTEGER;
    const mbs_pack k = turned - MBS_INTEGER;
    const mbs_pack near = *x - k * MBS_HALF_PI_1; /* exact */
    const mbs_pack r = near - k * MBS_HALF_PI_2;
    const mbs_pack excess = ((r - near) + k * MBS_HALF_PI_2) + k * MBS_HALF_PI_3; /* of r over the remainder */
    const mbs_pack z = r * r;
    const mbs_pack half = MBS_HALF * z;
    const mbs_pack one = MBS_ONE - half;
    const mbs_bits sine = mbs_to_bits(r - (excess * one - (r * z) * MBS_SINE(z)));
    const mbs_bits cosine = mbs_to_bits(one + (((MBS_ONE - one) - half) + ((z * z) * MBS_COSINE(z) + r * excess)));
    /* Odd quarters exchange the two, and every second changes a sign. */
    const mbs_bits quarter = mbs_to_bits(turned);
    const mbs_bits exchange = (sine ^ cosine) & -(quarter & 1);
    *s = mbs_from_bits(sine ^ exchange ^ ((quarter & 2) << (8 * sizeof(mbs_word) - 2)));
    *c = mbs_from_bits(cosine ^ exchange ^ (((quarter + 1) & 2) << (8 * sizeof(mbs_word) - 2)));
}

/* Replace what is beyond the limit, or was computed of no number. */
static MBS_COLD void mbs_sincos_far(const mbs_pack *x, mbs_pack *s, mbs_pack *c)
{
#define MBS_REPLACE(j) \
    if (!(MBS_PASTE(MBS_ABS_, MBS_REAL)(MBS_ENTRY(*x, j)) <= MBS_SINCOS_LIMIT)) { \
        MBS_ENTRY(*s, j) = MBS_PASTE(MBS_SIN_, MBS_REAL)(MBS_ENTRY(*x, j)); \
        MBS_ENTRY(*c, j) = MBS_PASTE(MBS_COS_, MBS_REAL)(MBS_ENTRY(*x, j)); \
    }
    MBS_EACH(MBS_REPLACE)
}

#ifdef MBS_STATES

static inline void mbs_sincos(int n, const mbs_real *x, mbs_real *s, mbs_real *c)
{
    int i;
    MBS_UNROLLED
    for (i = 0; i < n; ++i) {
        const mbs_pack angle = x[i];
        mbs_pack sine, cosine;
        mbs_sincos_pack(&angle, &sine, &cosine);
        if (!mbs_exceeds((mbs_real){0} + MBS_SINCOS_LIMIT * MBS_SINCOS_LIMIT, angle * angle)) {
            mbs_pack far = angle, far_sine = sine, far_cosine = cosine;
            mbs_sincos_far(&far, &far_sine, &far_cosine);
            sine = far_sine;
            cosine = far_cosine;
        }
        s[i] = sine;
        c[i] = cosine;
    }
}

#else

static inline void mbs_sincos(int n, const mbs_real *x, mbs_real *s, mbs_real *c)
{
    int i;
    MBS_UNROLLED
    for (i = 0; i < n; i += MBS_PACK) {
#define MBS_TAKE(j) x[i + (j)],
        const mbs_pack angle = {MBS_EACH(MBS_TAKE)};
        const mbs_pack squares = angle * angle;
        mbs_pack sine, cosine;
        mbs_real sum = 0;
        mbs_sincos_pack(&angle, &sine, &cosine);
#define MBS_ADD(j) sum += MBS_ENTRY(squares, j);
        MBS_EACH(MBS_ADD)
        if (!(sum <= MBS_SINCOS_LIMIT * MBS_SINCOS_LIMIT)) {
            mbs_pack far = angle, far_sine = sine, far_cosine = cosine; /* only these need be in memory */
            mbs_sincos_far(&far, &far_sine, &far_cosine);
            sine = far_sine;
            cosine = far_cosine;
        }
#define MBS_PUT(j) s[i + (j)] = MBS_ENTRY(sine, j), c[i + (j)] = MBS_ENTRY(cosine, j);
        MBS_EACH(MBS_PUT)
    }
}

#endif

#endif

/* The length of arrays of n angles, and of their sines: what is behind the angles must be 0. */
#ifdef MBS_STATES
#define MBS_PADDED(n) (n)
#else
#define MBS_PADDED(n) (((n) + MBS_PACK - 1) / MBS_PACK * MBS_PACK)
#endif

#endif
