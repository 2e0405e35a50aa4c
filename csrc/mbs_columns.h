/* Columns that one factorisation solves for, for the kernels that include this file.
 *
 * M = LT D L of n rows, where L has a unit diagonal. Row k of L has its other entries at starts[k] to starts[k + 1] - 1 of
 * `lower`, in the columns that `ancestors` gives; so a tree's elimination fills nothing. Column k of L has its other
 * entries at the places below_starts[k] to below_starts[k + 1] - 1 of `below`: pairs of a row and a place in `lower`, from
 * the last row on. B is kept by rows of `width` numbers, a multiple of MBS_LANES, so that a compiler that knows vectors
 * computes several columns at once.
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

#ifndef MBS_DYNAMICS_H /* which solves by the bodies */
#ifdef MBS_STATES /* a number is a vector already */
typedef mbs_real mbs_piece;
#undef MBS_SUBTRACT
#undef MBS_SCALE
#define MBS_SUBTRACT(a, x, b) ((a) -= (x) * (b))
#define MBS_SCALE(a, x) ((a) *= (x))
#define MBS_PIECES 8
#else
typedef mbs_lanes mbs_piece;
#define MBS_PIECES 4
#endif

/* Both substitutions for as many pieces of each row as EACH names. They stay in registers while a row is computed, so
 * that a product takes one number from memory, and puts none there. */
#define MBS_PIECE_TAKE(i) mbs_piece x##i = row[i];
#define MBS_PIECE_LESS(i) MBS_SUBTRACT(x##i, l, other[i]);
#define MBS_PIECE_DIVIDE(i) MBS_SCALE(x##i, inverses[k]);
#define MBS_PIECE_PUT(i) row[i] = x##i;
#define MBS_SOLVE_PIECES(EACH) \
    do { \
        for (k = n - 1; k >= 0; --k) { \
            mbs_piece *row = rows + k * step; \
            EACH(MBS_PIECE_TAKE) \
            for (e = below_starts[k]; e < below_starts[k + 1]; ++e) { \
                const mbs_piece *other = rows + below[2 * e] * step; \
                const mbs_real l = lower[below[2 * e + 1]]; \
                EACH(MBS_PIECE_LESS) \
            } \
            EACH(MBS_PIECE_PUT) \
        } \
        for (k = 0; k < n; ++k) { \
            mbs_piece *row = rows + k * step; \
            EACH(MBS_PIECE_TAKE) \
            EACH(MBS_PIECE_DIVIDE) \
            for (e = starts[k]; e < starts[k + 1]; ++e) { \
                const mbs_piece *other = rows + ancestors[e] * step; \
                const mbs_real l = lower[e]; \
                EACH(MBS_PIECE_LESS) \
            } \
            EACH(MBS_PIECE_PUT) \
        } \
    } while (0)
#define MBS_PIECES_TWO(f) f(0) f(1)
#define MBS_PIECES_FOUR(f) MBS_PIECES_TWO(f) f(2) f(3)
#define MBS_PIECES_EIGHT(f) MBS_PIECES_FOUR(f) f(4) f(5) f(6) f(7)

/* Replace B by M^-1 B. */
static MBS_APART void mbs_solve_columns(int n, const int *starts, const int *ancestors, const int *below_starts,
                                        const int *below, const mbs_real *MBS_RESTRICT lower,
                                        const mbs_real *MBS_RESTRICT inverses, int width, mbs_real *MBS_RESTRICT B)
{
    const int step = width / (int)(sizeof(mbs_piece) / sizeof(mbs_real));
    mbs_piece *rows = (mbs_piece *)B, *end = rows + step;
    int k, e;
    for (; end - rows >= MBS_PIECES; rows += MBS_PIECES)
#ifdef MBS_STATES
        MBS_SOLVE_PIECES(MBS_PIECES_EIGHT);
#else
        MBS_SOLVE_PIECES(MBS_PIECES_FOUR);
    if (rows < end)
        MBS_SOLVE_PIECES(MBS_PIECES_TWO);
#endif
}
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
