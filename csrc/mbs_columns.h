/* Columns that one factorisation solves for, for the kernels that include this file.
 *
 * M = LT D L of n rows, where L has a unit diagonal. Row k of L has its other entries at starts[k] to starts[k + 1] - 1 of
 * `lower`, in the columns that `ancestors` gives; so a tree's elimination fills nothing. Column k of L has its other
 * entries at the places below_starts[k] to below_starts[k + 1] - 1 of `below`: pairs of a row and a place in `lower`, from
 * the last row on. B is kept by rows of `width` numbers, a multiple of MBS_LANES, so that a compiler that knows vectors
 * computes several columns at once. In several states, columns are kept in groups.
 *
 * C99, reentrant.
 */
#ifndef MBS_COLUMNS_H
#define MBS_COLUMNS_H

#include "mbs_abi.h"

#define MBS_LANES 16

/* Half of MBS_LANES numbers, written as a vector where there are such: a loop over so few is taken apart before a
 * compiler sees that it could be one. */
#if defined(__GNUC__) && !defined(MBS_SCALAR) && !defined(MBS_STATES)
typedef mbs_real mbs_lanes __attribute__((vector_size(MBS_LANES / 2 * sizeof(mbs_real)), aligned(sizeof(mbs_real)), may_alias));
#define MBS_SUBTRACT(a, x, b) ((a) -= (x) * (b))
#define MBS_SCALE(a, x) ((a) *= (x))
#define MBS_ALIGNED __attribute__((aligned(64)))
#else
typedef struct {
    mbs_real at[MBS_LANES / 2];
} mbs_lanes;
#define MBS_OF_LANES(assign) \
    do { \
        int mbs_l; \
        for (mbs_l = 0; mbs_l < MBS_LANES / 2; ++mbs_l) \
            assign; \
    } while (0)
#define MBS_SUBTRACT(a, x, b) MBS_OF_LANES((a).at[mbs_l] -= (x) * (b).at[mbs_l])
#define MBS_SCALE(a, x) MBS_OF_LANES((a).at[mbs_l] *= (x))
#define MBS_ALIGNED
#endif

/* Columns of several states stand in other places. */
#ifdef MBS_STATES
#define MBS_EITHER(one, several) several
#else
#define MBS_EITHER(one, several) one
#endif

#ifndef MBS_DYNAMICS_H /* which solves by the bodies */
#ifdef MBS_STATES

/* A number of a state is one of a vector here, so that a solution costs the same for each column: columns in groups of
 * MBS_WIDTH, whose nonzeros are in the same rows as far as possible. Only products with such rows are computed.
 *
 * A step computes up to MBS_HEIGHT rows, of a chain: how many they are, the number of products of each with rows before,
 * the rows, their places in the results; then the products: a row, and for each row of the step a place in `lower`; then
 * the places of the rows of the step in each other's. The steps of a substitution end with 0. */
#define MBS_WIDTH 6
#define MBS_HEIGHT 3

/* A number that stays in a register: gcc would read it from memory for each use. */
#if MBS_HAS_VECTOR == 1 && !defined(__clang__)
#define MBS_HOLD(x) __asm__("" : "+v"(x))
#else
#define MBS_HOLD(x) (void)0
#endif
#if defined(__AVX512F__) || defined(__aarch64__) /* 32 registers hold the numbers of a step in six columns, 16 in three */
#define MBS_PIECES 6
#else
#define MBS_PIECES 3
#endif

/* Compute the rows of a step in some columns of a group; return the next step. Rows of B begin at `right`, where the
 * first substitution reads them; the second one has the inverses, and writes results. */
static inline __attribute__((always_inline)) const int *mbs_step_columns(
    const int height, const int *step, const mbs_real *lower, const mbs_real *inverses, const mbs_real *right,
    mbs_real *rows, mbs_real *const *results)
{
    const int *const own = step + 2, *at = own + 2 * height, *const shared = at + step[1] * (1 + height);
    mbs_real x[MBS_HEIGHT][MBS_PIECES], l[MBS_HEIGHT];
    int i, j, k;
    MBS_UNROLLED
    for (j = 0; j < height; ++j)
        MBS_UNROLLED
        for (i = 0; i < MBS_PIECES; ++i)
            x[j][i] = inverses ? rows[own[j] * MBS_WIDTH + i] * inverses[own[j]] : right[j * MBS_WIDTH + i];
    for (; at < shared; at += 1 + height) {
        const mbs_real *other = rows + at[0] * MBS_WIDTH;
        MBS_UNROLLED
        for (j = 0; j < height; ++j)
            l[j] = lower[at[1 + j]];
        MBS_UNROLLED
        for (i = 0; i < MBS_PIECES; ++i) {
            mbs_real y = other[i];
            MBS_HOLD(y);
            MBS_UNROLLED
            for (j = 0; j < height; ++j)
                x[j][i] -= l[j] * y;
        }
    }
    MBS_UNROLLED
    for (j = 1; j < height; ++j)
        MBS_UNROLLED
        for (k = 0; k < j; ++k) {
            const mbs_real y = lower[*at++];
            MBS_UNROLLED
            for (i = 0; i < MBS_PIECES; ++i)
                x[j][i] -= y * x[k][i];
        }
    MBS_UNROLLED
    for (j = 0; j < height; ++j)
        MBS_UNROLLED
        for (i = 0; i < MBS_PIECES; ++i) {
            rows[own[j] * MBS_WIDTH + i] = x[j][i];
            if (inverses)
                results[i][own[height + j]] = -x[j][i];
        }
    return at;
}

/* The same in all columns of a group. */
static inline __attribute__((always_inline)) const int *mbs_step_group(
    const int height, const int *step, const mbs_real *lower, const mbs_real *inverses, const mbs_real *right,
    mbs_real *rows, mbs_real *const *results)
{
    const int *next = step;
    int i;
    for (i = 0; i < MBS_WIDTH; i += MBS_PIECES)
        next = mbs_step_columns(height, step, lower, inverses, right ? right + i : 0, rows + i, results + i);
    return next;
}

/* Give -M^-1 B in `results`. A group is: where the steps of both substitutions begin, then a result for each column, from
 * 1, and its first number there. The rows that the first substitution does not reach follow its steps. */
static MBS_APART void mbs_solve_groups(int n, int count, const int *steps, const int *groups,
                                       const mbs_real *MBS_RESTRICT lower, const mbs_real *MBS_RESTRICT inverses,
                                       const mbs_real *MBS_RESTRICT right, mbs_real *const *results)
{
    mbs_real rows[n * MBS_WIDTH], spare[n], *to[MBS_WIDTH];
    int c, i, k;
    for (c = 0; c < count; ++c, groups += 2 + 2 * MBS_WIDTH) {
        const int *step = steps + groups[0];
        for (i = 0; i < MBS_WIDTH; ++i)
            to[i] = groups[2 + 2 * i] ? results[groups[2 + 2 * i] - 1] + groups[3 + 2 * i] : spare;
        while (*step) {
            const int height = *step;
            step = height == 1   ? mbs_step_group(1, step, lower, 0, right, rows, to)
                   : height == 2 ? mbs_step_group(2, step, lower, 0, right, rows, to)
                                 : mbs_step_group(3, step, lower, 0, right, rows, to);
            right += height * MBS_WIDTH;
        }
        for (k = 0; k < step[1]; ++k)
            for (i = 0; i < MBS_WIDTH; ++i)
                rows[step[2 + k] * MBS_WIDTH + i] = MBS_EVERY(0.0);
        for (step = steps + groups[1]; *step;)
            step = *step == 1   ? mbs_step_group(1, step, lower, inverses, 0, rows, to)
                   : *step == 2 ? mbs_step_group(2, step, lower, inverses, 0, rows, to)
                                : mbs_step_group(3, step, lower, inverses, 0, rows, to);
    }
}

#else
#define MBS_PIECES 4

/* Both substitutions for as many pieces of each row as EACH names. They stay in registers while a row is computed, so
 * that a product takes one number from memory, and puts none there. */
#define MBS_PIECE_TAKE(i) mbs_lanes x##i = row[i];
#define MBS_PIECE_LESS(i) MBS_SUBTRACT(x##i, l, other[i]);
#define MBS_PIECE_DIVIDE(i) MBS_SCALE(x##i, inverses[k]);
#define MBS_PIECE_PUT(i) row[i] = x##i;
#define MBS_SOLVE_PIECES(EACH) \
    do { \
        for (k = n - 1; k >= 0; --k) { \
            mbs_lanes *row = rows + k * step; \
            EACH(MBS_PIECE_TAKE) \
            for (e = below_starts[k]; e < below_starts[k + 1]; ++e) { \
                const mbs_lanes *other = rows + below[2 * e] * step; \
                const mbs_real l = lower[below[2 * e + 1]]; \
                EACH(MBS_PIECE_LESS) \
            } \
            EACH(MBS_PIECE_PUT) \
        } \
        for (k = 0; k < n; ++k) { \
            mbs_lanes *row = rows + k * step; \
            EACH(MBS_PIECE_TAKE) \
            EACH(MBS_PIECE_DIVIDE) \
            for (e = starts[k]; e < starts[k + 1]; ++e) { \
                const mbs_lanes *other = rows + ancestors[e] * step; \
                const mbs_real l = lower[e]; \
                EACH(MBS_PIECE_LESS) \
            } \
            EACH(MBS_PIECE_PUT) \
        } \
    } while (0)
#define MBS_PIECES_TWO(f) f(0) f(1)
#define MBS_PIECES_FOUR(f) MBS_PIECES_TWO(f) f(2) f(3)

/* Replace B by M^-1 B. */
static MBS_APART void mbs_solve_columns(int n, const int *starts, const int *ancestors, const int *below_starts,
                                        const int *below, const mbs_real *MBS_RESTRICT lower,
                                        const mbs_real *MBS_RESTRICT inverses, int width, mbs_real *MBS_RESTRICT B)
{
    const int step = width / (int)(sizeof(mbs_lanes) / sizeof(mbs_real));
    mbs_lanes *rows = (mbs_lanes *)B, *end = rows + step;
    int k, e;
    for (; end - rows >= MBS_PIECES; rows += MBS_PIECES)
        MBS_SOLVE_PIECES(MBS_PIECES_FOUR);
    if (rows < end)
        MBS_SOLVE_PIECES(MBS_PIECES_TWO);
}
#endif
#endif

/* Give a block out, negated and column by column: all of its entries, or those at the given places of B. */
static inline void mbs_give_block(int rows, int cols, int width, const mbs_real *B, mbs_real *result)
{
    int r, c;
    for (c = 0; c < cols; ++c)
        for (r = 0; r < rows; ++r)
            result[c * rows + r] = -B[r * width + c];
}

static inline void mbs_give_places(int count, const int *places, const mbs_real *B, mbs_real *result)
{
    int k;
    for (k = 0; k < count; ++k)
        result[k] = -B[places[k]];
}

#endif
