/* Double-double arithmetic: a number is the sum of two doubles, with some 31 digits.
 *
 * Sums, products, quotients and roots follow Joldes, Muller, Popescu, "Tight and rigorous error bounds for basic building
 * blocks of double-word arithmetic", ACM TOMS 44(2), 2017: their errors are at most 3, 5, 15 and 4 u^2 of the result, with
 * u = 2^-53; a sum that cancels is no exception. Sines, cosines and the other functions err by some 1e-31 of the result.
 * An angle beyond 1e15 and an infinite number give no number. The exponent is the exponent of a double: below 1e-290, and
 * beyond 1e300, digits are lost.
 *
 * Doubles must be rounded as they are written: fast-math, registers of the x87, and -DMBS_REAL=float are refused. A product
 * and a sum that the compiler contracts to one operation do no harm.
 *
 * C99, reentrant.
 */
#ifndef MBS_DOUBLE_DOUBLE_H
#define MBS_DOUBLE_DOUBLE_H

#include <float.h>
#include <math.h>

#include "mbs_abi.h"

#define MBS_IS_double 1
#define MBS_IS_float 0
#if !MBS_PASTE(MBS_IS_, MBS_REAL)
#error "functions in double-double need -DMBS_REAL=double: compile them apart from functions in single precision"
#endif
#if defined(__FAST_MATH__) || defined(__ASSOCIATIVE_MATH__) || (defined(_MSC_VER) && defined(_M_FP_FAST))
#error "fast-math drops the low halves of numbers in double-double: compile without -ffast-math"
#endif
#if FLT_EVAL_METHOD != 0
#error "numbers in double-double need doubles that are rounded after each operation: on x86, compile with -mfpmath=sse"
#endif

#if defined(__GNUC__)
#define MBS_DD_APART __attribute__((noinline, unused))
#else
#define MBS_DD_APART
#endif
#if defined(FP_FAST_FMA) || defined(__FMA__) || defined(__aarch64__)
#define MBS_DD_FMA
#endif

/* The sum high + low, with |low| at most half a unit in the last place of high. */
typedef struct {
    double high, low;
} mbs_dd;

typedef struct {
    mbs_dd sine, cosine;
} mbs_dd_turn;

#define MBS_DD_EPSILON 0x1p-104

static inline mbs_dd mbs_dd_of(double high, double low)
{
    const mbs_dd x = {high, low};
    return x;
}

/* a + b without an error, where a is 0 or no smaller than b. */
static inline mbs_dd mbs_dd_renew(double a, double b)
{
    const double s = a + b;
    return mbs_dd_of(s, b - (s - a));
}

/* a + b without an error. */
static inline mbs_dd mbs_dd_sum(double a, double b)
{
    const double s = a + b;
    const double part = s - a;
    return mbs_dd_of(s, (a - (s - part)) + (b - part));
}

/* a b without an error: by one operation, or of halves with 26 digits (Dekker). */
static inline mbs_dd mbs_dd_product(double a, double b)
{
    const double p = a * b;
#ifdef MBS_DD_FMA
    return mbs_dd_of(p, fma(a, b, -p));
#else
    const double a1 = a * 134217729.0, b1 = b * 134217729.0; /* 2^27 + 1 */
    const double ah = a1 - (a1 - a), bh = b1 - (b1 - b);
    const double al = a - ah, bl = b - bh;
    return mbs_dd_of(p, ((ah * bh - p) + ah * bl + al * bh) + al * bl);
#endif
}

/* a b + c, where the rounding of the product does not matter. */
static inline double mbs_dd_fused(double a, double b, double c)
{
#ifdef MBS_DD_FMA
    return fma(a, b, c);
#else
    return a * b + c;
#endif
}

static inline mbs_dd mbs_dd_neg(mbs_dd x)
{
    return mbs_dd_of(-x.high, -x.low);
}

static inline mbs_dd mbs_dd_add(mbs_dd x, mbs_dd y)
{
    const mbs_dd s = mbs_dd_sum(x.high, y.high), t = mbs_dd_sum(x.low, y.low);
    const mbs_dd v = mbs_dd_renew(s.high, s.low + t.high);
    return mbs_dd_renew(v.high, t.low + v.low);
}

static inline mbs_dd mbs_dd_sub(mbs_dd x, mbs_dd y)
{
    return mbs_dd_add(x, mbs_dd_neg(y));
}

static inline mbs_dd mbs_dd_mul(mbs_dd x, mbs_dd y)
{
    const mbs_dd p = mbs_dd_product(x.high, y.high);
    const double rest = mbs_dd_fused(x.low, y.high, mbs_dd_fused(x.high, y.low, x.low * y.low));
    return mbs_dd_renew(p.high, p.low + rest);
}

/* x times a double. */
static inline mbs_dd mbs_dd_scale(mbs_dd x, double y)
{
    const mbs_dd p = mbs_dd_product(x.high, y);
    return mbs_dd_renew(p.high, mbs_dd_fused(x.low, y, p.low));
}

static inline mbs_dd mbs_dd_div(mbs_dd x, mbs_dd y)
{
    const double quotient = x.high / y.high;
    const mbs_dd r = mbs_dd_scale(y, quotient);
    return mbs_dd_renew(quotient, ((x.high - r.high) + (x.low - r.low)) / y.high);
}

static inline mbs_dd mbs_dd_sqrt(mbs_dd x)
{
    const double root = sqrt(x.high);
    const mbs_dd square = mbs_dd_product(root, root);
    if (root == 0)
        return mbs_dd_of(root, 0.0);
    return mbs_dd_renew(root, (((x.high - square.high) - square.low) + x.low) / (2 * root));
}

static inline mbs_dd mbs_dd_abs(mbs_dd x)
{
    return x.high < 0 ? mbs_dd_neg(x) : x;
}

static inline mbs_dd mbs_dd_sign(mbs_dd x)
{
    return mbs_dd_of(MBS_SIGN(x.high), 0.0);
}

/* Whether a pivot stands out of rounding; see MBS_THRESHOLD. */
static inline int mbs_dd_stands(mbs_dd pivot, double tolerance, mbs_dd scale)
{
    const double part = tolerance * MBS_DD_EPSILON;
    return pivot.high > (part < 3e-5 ? part : 3e-5) * scale.high;
}

static inline void mbs_dd_store(double *high, double *low, mbs_dd x)
{
    *high = x.high;
    *low = x.low;
}

/* c[0] + z c[1] + z^2 c[2] + ..., of n terms; `rest` is the sum of later ones, by z^n. */
static inline mbs_dd mbs_dd_series(mbs_dd z, const mbs_dd *c, int n, mbs_dd rest)
{
    int i;
    for (i = n; i-- > 0;)
        rest = mbs_dd_add(c[i], mbs_dd_mul(z, rest));
    return rest;
}

/* An angle is a multiple of pi/16 and a remainder. The later terms of the series need the digits of a double only. */
static MBS_DD_APART mbs_dd_turn mbs_dd_sincos(mbs_dd x)
{
    static const mbs_dd sines[] = { /* of the multiples */
    {0.0, 0.0},
    {0x1.8f8b83c69a60bp-3, -0x1.26d19b9ff8d82p-57},
    {0x1.87de2a6aea963p-2, -0x1.72cedd3d5a610p-57},
    {0x1.1c73b39ae68c8p-1, 0x1.b25dd267f6600p-55},
    {0x1.6a09e667f3bcdp-1, -0x1.bdd3413b26456p-55},
    {0x1.a9b66290ea1a3p-1, 0x1.9f630e8b6dac8p-60},
    {0x1.d906bcf328d46p-1, 0x1.457e610231ac2p-56},
    {0x1.f6297cff75cb0p-1, 0x1.562172a361fd3p-56},
    {0x1.0000000000000p+0, 0.0}
    };
    static const mbs_dd sine[] = { /* 1/3!, 1/5!, ..., with their signs */
    {-0x1.5555555555555p-3, -0x1.5555555555555p-57},
    {0x1.1111111111111p-7, 0x1.1111111111111p-63},
    {-0x1.a01a01a01a01ap-13, -0x1.a01a01a01a01ap-73},
    {0x1.71de3a556c734p-19, -0x1.c154f8ddc6c00p-73}
    };
    static const mbs_dd cosine[] = { /* 1/4!, 1/6!, ... */
    {0x1.5555555555555p-5, 0x1.5555555555555p-59},
    {-0x1.6c16c16c16c17p-10, 0x1.f49f49f49f49fp-65},
    {0x1.a01a01a01a01ap-16, 0x1.a01a01a01a01ap-76}
    };
    static const double sixteenth[] = {0x1.921fb54442d18p-3, 0x1.1a62633145c07p-57, -0x1.f1976b7ed8fbcp-113,
                                       0x1.4cf98e804177dp-167}; /* pi/16, in four parts */
    static const double s[] = {-2.505210838544172e-08, 1.6059043836821613e-10, -7.647163731819816e-13, 2.8114572543455206e-15};
    static const double c[] = {-2.755731922398589e-07, 2.08767569878681e-09, -1.1470745597729725e-11, 4.779477332387385e-14, -1.5619206968586225e-16};
    const double k = floor(x.high * 5.0929581789406507 + 0.5);
    mbs_dd_turn turn;
    mbs_dd r = x, z, sr, cr, sj, cj;
    double h;
    int i, place;
    if (!(fabs(x.high) <= 1e15)) {
        turn.sine = turn.cosine = mbs_dd_of(x.high - x.high, 0.0);
        turn.sine.high /= turn.sine.high; /* not a number */
        turn.cosine = turn.sine;
        return turn;
    }
    if (k != 0)
        for (i = 0; i < 4; ++i)
            r = mbs_dd_add(r, mbs_dd_product(-k, sixteenth[i]));
    z = mbs_dd_mul(r, r);
    h = z.high;
    sr = mbs_dd_scale(z, s[0] + h * (s[1] + h * (s[2] + h * s[3])));
    sr = mbs_dd_add(sine[3], sr);
    sr = mbs_dd_series(z, sine, 3, sr);
    sr = mbs_dd_add(r, mbs_dd_mul(mbs_dd_mul(r, z), sr));
    cr = mbs_dd_scale(z, c[0] + h * (c[1] + h * (c[2] + h * (c[3] + h * c[4]))));
    cr = mbs_dd_add(cosine[2], cr);
    cr = mbs_dd_series(z, cosine, 2, cr);
    cr = mbs_dd_add(mbs_dd_of(-0.5 * z.high, -0.5 * z.low), mbs_dd_mul(mbs_dd_mul(z, z), cr));
    cr = mbs_dd_add(mbs_dd_of(1.0, 0.0), cr);
    place = (int)((long long)k & 31); /* of 32 in a turn */
    if (place & 7) {
        sj = sines[place & 7];
        cj = sines[8 - (place & 7)];
        turn.sine = mbs_dd_add(mbs_dd_mul(sj, cr), mbs_dd_mul(cj, sr));
        turn.cosine = mbs_dd_sub(mbs_dd_mul(cj, cr), mbs_dd_mul(sj, sr));
    } else {
        turn.sine = sr;
        turn.cosine = cr;
    }
    if (place & 8) { /* an odd quarter */
        const mbs_dd kept = turn.sine;
        turn.sine = turn.cosine;
        turn.cosine = mbs_dd_neg(kept);
    }
    if (place & 16) {
        turn.sine = mbs_dd_neg(turn.sine);
        turn.cosine = mbs_dd_neg(turn.cosine);
    }
    return turn;
}

static inline mbs_dd mbs_dd_tan(mbs_dd x)
{
    const mbs_dd_turn turn = mbs_dd_sincos(x);
    return mbs_dd_div(turn.sine, turn.cosine);
}

/* The angle of a double, and the sine of the angle that is missing. */
static MBS_DD_APART mbs_dd mbs_dd_atan2(mbs_dd y, mbs_dd x)
{
    const double angle = atan2(y.high, x.high);
    const mbs_dd_turn turn = mbs_dd_sincos(mbs_dd_of(angle, 0.0));
    const mbs_dd length = mbs_dd_sqrt(mbs_dd_add(mbs_dd_mul(x, x), mbs_dd_mul(y, y)));
    const mbs_dd across = mbs_dd_sub(mbs_dd_mul(y, turn.cosine), mbs_dd_mul(x, turn.sine));
    if (length.high == 0 && x.high == 0 && y.high == 0)
        return mbs_dd_of(angle, 0.0);
    return mbs_dd_add(mbs_dd_of(angle, 0.0), mbs_dd_div(across, length));
}

static inline mbs_dd mbs_dd_atan(mbs_dd x)
{
    return mbs_dd_atan2(x, mbs_dd_of(1.0, 0.0));
}

/* sqrt(1 - x^2) */
static inline mbs_dd mbs_dd_beside(mbs_dd x)
{
    const mbs_dd one = mbs_dd_of(1.0, 0.0);
    return mbs_dd_sqrt(mbs_dd_mul(mbs_dd_sub(one, x), mbs_dd_add(one, x)));
}

static inline mbs_dd mbs_dd_asin(mbs_dd x)
{
    return mbs_dd_atan2(x, mbs_dd_beside(x));
}

static inline mbs_dd mbs_dd_acos(mbs_dd x)
{
    return mbs_dd_atan2(mbs_dd_beside(x), x);
}

/* exp(x) - 1 for |x| <= 0.35: of x/512, doubled nine times. */
static MBS_DD_APART mbs_dd mbs_dd_grow(mbs_dd x)
{
    static const mbs_dd inverse[] = { /* 1/3!, 1/4!, 1/5! */
    {0x1.5555555555555p-3, 0x1.5555555555555p-57},
    {0x1.5555555555555p-5, 0x1.5555555555555p-59},
    {0x1.1111111111111p-7, 0x1.1111111111111p-63}
    };
    const mbs_dd r = mbs_dd_of(x.high / 512, x.low / 512);
    const double h = r.high;
    const mbs_dd rest = mbs_dd_of((1.0 / 720) + h * ((1.0 / 5040) + h * ((1.0 / 40320) + h * (1.0 / 362880))), 0.0);
    const mbs_dd square = mbs_dd_mul(r, r);
    mbs_dd e = mbs_dd_mul(mbs_dd_mul(square, r), mbs_dd_series(r, inverse, 3, rest));
    int i;
    e = mbs_dd_add(mbs_dd_add(mbs_dd_of(square.high / 2, square.low / 2), e), r);
    for (i = 0; i < 9; ++i)
        e = mbs_dd_add(mbs_dd_of(2 * e.high, 2 * e.low), mbs_dd_mul(e, e));
    return e;
}

static MBS_DD_APART mbs_dd mbs_dd_exp(mbs_dd x)
{
    static const double parts[] = {0x1.62e42fefa39efp-1, 0x1.abc9e3b39803fp-56, 0x1.7b57a079a1934p-111}; /* log 2 */
    const double k = floor(x.high * 1.4426950408889634 + 0.5);
    mbs_dd r = x;
    int i;
    if (!(fabs(x.high) <= 700)) /* 0, infinite, not a number, or without digits in the low half */
        return mbs_dd_of(exp(x.high), 0.0);
    for (i = 0; i < 3; ++i)
        r = mbs_dd_add(r, mbs_dd_product(-k, parts[i]));
    r = mbs_dd_add(mbs_dd_of(1.0, 0.0), mbs_dd_grow(r));
    return mbs_dd_of(ldexp(r.high, (int)k), ldexp(r.low, (int)k));
}

/* Near 1 the series of log((1 + z)/(1 - z)), elsewhere one step of Halley's iteration. */
static MBS_DD_APART mbs_dd mbs_dd_log(mbs_dd x)
{
    static const mbs_dd inverse[] = { /* 1/3, 1/5, ... */
    {0x1.5555555555555p-2, 0x1.5555555555555p-56},
    {0x1.999999999999ap-3, -0x1.999999999999ap-57},
    {0x1.2492492492492p-3, 0x1.2492492492492p-57},
    {0x1.c71c71c71c71cp-4, 0x1.c71c71c71c71cp-58},
    {0x1.745d1745d1746p-4, -0x1.745d1745d1746p-59},
    {0x1.3b13b13b13b14p-4, -0x1.3b13b13b13b14p-58},
    {0x1.1111111111111p-4, 0x1.1111111111111p-60}
    };
    const mbs_dd one = mbs_dd_of(1.0, 0.0), start = mbs_dd_of(log(x.high), 0.0);
    mbs_dd e;
    if (fabs(x.high - 1) < 0.02) {
        const mbs_dd z = mbs_dd_div(mbs_dd_sub(x, one), mbs_dd_add(x, one)), square = mbs_dd_mul(z, z);
        e = mbs_dd_series(square, inverse, 6, inverse[6]);
        e = mbs_dd_add(z, mbs_dd_mul(mbs_dd_mul(square, z), e));
        return mbs_dd_of(2 * e.high, 2 * e.low);
    }
    if (!(fabs(start.high) <= 700)) /* infinite, or not a number */
        return start;
    e = mbs_dd_exp(start);
    e = mbs_dd_div(mbs_dd_sub(x, e), mbs_dd_add(x, e));
    return mbs_dd_add(start, mbs_dd_of(2 * e.high, 2 * e.low));
}

static MBS_DD_APART mbs_dd mbs_dd_tanh(mbs_dd x)
{
    const mbs_dd twice = mbs_dd_of(2 * x.high, 2 * x.low);
    const int is_small = fabs(twice.high) < 0.34;
    const mbs_dd one = mbs_dd_of(1.0, 0.0);
    const mbs_dd e = is_small ? mbs_dd_grow(twice) : mbs_dd_sub(mbs_dd_exp(twice), one);
    if (fabs(x.high) > 40)
        return mbs_dd_sign(x);
    return mbs_dd_div(e, mbs_dd_add(e, mbs_dd_of(2.0, 0.0)));
}

#endif
