/* What generated kernels share: the scalar type, the functions of <math.h> that go with it, CasADi's contract.
 *
 * -DMBS_REAL=float computes in single precision, -DMBS_STATES=8 computes 8 states at once (mbs_states.h). casadi_real and casadi_int can be defined to suit another caller.
 * C99; needs nothing but <math.h> and <float.h>.
 */
#ifndef MBS_ABI_H
#define MBS_ABI_H

#ifndef MBS_REAL
#define MBS_REAL double
#endif
#ifndef casadi_real
#define casadi_real MBS_REAL
#endif
#ifndef casadi_int
#define casadi_int long long int
#endif

#if defined(__cplusplus) && (defined(__GNUC__) || defined(_MSC_VER))
#define MBS_RESTRICT __restrict
#elif defined(__cplusplus)
#define MBS_RESTRICT
#else
#define MBS_RESTRICT restrict
#endif

/* A function that is not to become a part of another again. On a GPU it is one: what lies in memory would be slow. */
#if defined(__CUDACC__)
#define MBS_APART
#elif defined(__GNUC__)
#define MBS_APART __attribute__((noinline))
#else
#define MBS_APART
#endif

/* The next loop, written out: only then do its numbers stay in registers, at any optimisation. */
#if defined(__CUDACC__)
#define MBS_UNROLLED _Pragma("unroll")
#elif defined(__clang__)
#define MBS_UNROLLED _Pragma("clang loop unroll(full)")
#elif defined(__GNUC__) && __GNUC__ >= 8
#define MBS_UNROLLED _Pragma("GCC unroll 16")
#else
#define MBS_UNROLLED
#endif

/* Pasting the name of the type chooses the function, and the suffix of a literal. */
#define MBS_PASTE_(a, b) a##b
#define MBS_PASTE(a, b) MBS_PASTE_(a, b)

/* A name in object files. Those of single precision have a part that doubles lack, so that both can be in one program, and
 * a caller in the other precision does not link. */
#define MBS_IS_SINGLE_double 0
#define MBS_IS_SINGLE_float 1
#if MBS_PASTE(MBS_IS_SINGLE_, MBS_REAL)
#define MBS_SINGLE
#define MBS_OWN(head, tail) head##_float##tail
#else
#define MBS_OWN(head, tail) head##tail
#endif

#define MBS_C_double(x) x
#define MBS_C_float(x) x##f
#define MBS_C(x) MBS_PASTE(MBS_C_, MBS_REAL)(x)
#define MBS_SIN_double sin
#define MBS_SIN_float sinf
#define MBS_SIN MBS_PASTE(MBS_SIN_, MBS_REAL)
#define MBS_COS_double cos
#define MBS_COS_float cosf
#define MBS_COS MBS_PASTE(MBS_COS_, MBS_REAL)
#define MBS_SQRT_double sqrt
#define MBS_SQRT_float sqrtf
#define MBS_SQRT MBS_PASTE(MBS_SQRT_, MBS_REAL)
#define MBS_EPSILON_double 2.2204460492503131e-16 /* DBL_EPSILON, FLT_EPSILON: from 1 to the next number */
#define MBS_EPSILON_float 1.1920929e-07f
#define MBS_EPSILON MBS_PASTE(MBS_EPSILON_, MBS_REAL)
/* What part of its scale a pivot must exceed: so many epsilon, but in single precision not more than leaves it use. */
#define MBS_THRESHOLD(t) ((t) * MBS_EPSILON < MBS_C(3e-5) ? (t) * MBS_EPSILON : MBS_C(3e-5))
#define MBS_TAN_double tan
#define MBS_TAN_float tanf
#define MBS_TAN MBS_PASTE(MBS_TAN_, MBS_REAL)
#define MBS_ASIN_double asin
#define MBS_ASIN_float asinf
#define MBS_ASIN MBS_PASTE(MBS_ASIN_, MBS_REAL)
#define MBS_ACOS_double acos
#define MBS_ACOS_float acosf
#define MBS_ACOS MBS_PASTE(MBS_ACOS_, MBS_REAL)
#define MBS_ATAN_double atan
#define MBS_ATAN_float atanf
#define MBS_ATAN MBS_PASTE(MBS_ATAN_, MBS_REAL)
#define MBS_ATAN2_double atan2
#define MBS_ATAN2_float atan2f
#define MBS_ATAN2 MBS_PASTE(MBS_ATAN2_, MBS_REAL)
#define MBS_EXP_double exp
#define MBS_EXP_float expf
#define MBS_EXP MBS_PASTE(MBS_EXP_, MBS_REAL)
#define MBS_LOG_double log
#define MBS_LOG_float logf
#define MBS_LOG MBS_PASTE(MBS_LOG_, MBS_REAL)
#define MBS_TANH_double tanh
#define MBS_TANH_float tanhf
#define MBS_TANH MBS_PASTE(MBS_TANH_, MBS_REAL)
#define MBS_ABS_double fabs
#define MBS_ABS_float fabsf
#define MBS_ABS_OF_ONE MBS_PASTE(MBS_ABS_, MBS_REAL)
#define MBS_ABS MBS_ABS_OF_ONE
#define MBS_SIGN(x) ((x) > 0 ? (mbs_real)1 : (x) < 0 ? -(mbs_real)1 : (x)) /* not a number stays what it is */

#ifdef MBS_STATES
#include "mbs_states.h"
#else
typedef MBS_REAL mbs_real;
#define MBS_ABREAST 1 /* states */
#define MBS_EVERY(x) ((mbs_real)(x))
#define MBS_EXCEEDS(a, b) ((a) > (b))
#define MBS_LARGER(a, b) ((a) <= (b) ? (b) : (a))
#endif

/* A function in CasADi's contract with the functions that describe it. Any arg[k] may be NULL (zeros), any res[k] may
 * be NULL (not wanted); only nonzeros are passed, column by column; iw and w are not used. */
#define MBS_DECLARE_CASADI(f) MBS_DECLARE_WITH(f, casadi_int)
#define MBS_DECLARE_CASADI_INT(f) MBS_DECLARE_WITH(f, int) /* as acados wants its own */
#define MBS_DECLARE_WITH(f, integer) \
    int f(const casadi_real **arg, casadi_real **res, integer *iw, casadi_real *w, int mem); \
    integer f##_n_in(void); \
    integer f##_n_out(void); \
    const char *f##_name_in(integer i); \
    const char *f##_name_out(integer i); \
    const integer *f##_sparsity_in(integer i); /* rows, columns, then 1, or column pointers and rows */ \
    const integer *f##_sparsity_out(integer i); \
    int f##_diff_in(integer i); \
    int f##_work(integer *sz_arg, integer *sz_res, integer *sz_iw, integer *sz_w)

/* The same function by a second name, under which programs find it in a library that they load. A folder's own C has
 * tagged names, which no other folder's library can replace. */
#define MBS_NAME_CASADI(name, own, integer) MBS_NAME_CASADI_(name, own, integer)
#define MBS_NAME_CASADI_(name, own, integer) \
    MBS_DECLARE_WITH(own, integer); \
    MBS_DECLARE_WITH(name, integer); \
    int name(const casadi_real **arg, casadi_real **res, integer *iw, casadi_real *w, int mem) \
    { \
        return own(arg, res, iw, w, mem); \
    } \
    integer name##_n_in(void) \
    { \
        return own##_n_in(); \
    } \
    integer name##_n_out(void) \
    { \
        return own##_n_out(); \
    } \
    const char *name##_name_in(integer i) \
    { \
        return own##_name_in(i); \
    } \
    const char *name##_name_out(integer i) \
    { \
        return own##_name_out(i); \
    } \
    const integer *name##_sparsity_in(integer i) \
    { \
        return own##_sparsity_in(i); \
    } \
    const integer *name##_sparsity_out(integer i) \
    { \
        return own##_sparsity_out(i); \
    } \
    int name##_diff_in(integer i) \
    { \
        return own##_diff_in(i); \
    } \
    int name##_work(integer *sz_arg, integer *sz_res, integer *sz_iw, integer *sz_w) \
    { \
        return own##_work(sz_arg, sz_res, sz_iw, sz_w); \
    }

#ifndef MBS_STATES
/* Write the full matrix, row by row as C stores `A[rows][columns]`, or column by column as BLAS and LAPACK store it: from
 * its nonzeros, and their pattern as f##_sparsity_out gives it. */
static inline void mbs_fill(const casadi_int *pattern, const mbs_real *nonzeros, mbs_real *A, int by_rows)
{
    const casadi_int rows = pattern[0], cols = pattern[1];
    const int is_full = pattern[2] == 1; /* column pointers begin with 0 */
    const casadi_int *colind = pattern + 2, *row = pattern + 3 + cols;
    for (casadi_int k = 0; k < rows * cols; k++)
        A[k] = 0;
    for (casadi_int c = 0; c < cols; c++) {
        const casadi_int first = is_full ? c * rows : colind[c], end = is_full ? first + rows : colind[c + 1];
        for (casadi_int k = first; k < end; k++) {
            const casadi_int r = is_full ? k - first : row[k];
            A[by_rows ? r * cols + c : c * rows + r] = nonzeros[k];
        }
    }
}

static inline void mbs_fill_rows(const casadi_int *pattern, const mbs_real *nonzeros, mbs_real *A)
{
    mbs_fill(pattern, nonzeros, A, 1);
}

static inline void mbs_fill_columns(const casadi_int *pattern, const mbs_real *nonzeros, mbs_real *A)
{
    mbs_fill(pattern, nonzeros, A, 0);
}
#endif

#endif
