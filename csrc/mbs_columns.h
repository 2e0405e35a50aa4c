/* Columns that one factorisation solves for, for the kernels that include this file.
 *
 * M = LT D L of n rows, where L has a unit diagonal. Row k of L has its other entries at starts[k] to starts[k + 1] - 1 of
 * `lower`, in the columns that `ancestors` gives; so a tree's elimination fills nothing. B is kept by rows of `width`
 * numbers, a multiple of MBS_LANES, so that a compiler that knows vectors computes several columns at once.
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
/* Replace B by M^-1 B. */
static MBS_APART void mbs_solve_columns(int n, const int *starts, const int *ancestors,
                                        const mbs_real *MBS_RESTRICT lower, const mbs_real *MBS_RESTRICT inverses,
                                        int width, mbs_real *MBS_RESTRICT B)
{
    const int step = 2 * (width / MBS_LANES);
    int first, k, e;
    for (first = 0; first < step; first += 2) {
        mbs_lanes *rows = (mbs_lanes *)B + first;
        for (k = n - 1; k >= 0; --k) {
            const mbs_lanes left = rows[k * step], right = rows[k * step + 1];
            for (e = starts[k]; e < starts[k + 1]; ++e) {
                mbs_lanes *above = rows + ancestors[e] * step;
                MBS_SUBTRACT(above[0], lower[e], left);
                MBS_SUBTRACT(above[1], lower[e], right);
            }
        }
        for (k = 0; k < n; ++k) {
            mbs_lanes left = rows[k * step], right = rows[k * step + 1];
            MBS_SCALE(left, inverses[k]);
            MBS_SCALE(right, inverses[k]);
            for (e = starts[k]; e < starts[k + 1]; ++e) {
                const mbs_lanes *above = rows + ancestors[e] * step;
                MBS_SUBTRACT(left, lower[e], above[0]);
                MBS_SUBTRACT(right, lower[e], above[1]);
            }
            rows[k * step] = left;
            rows[k * step + 1] = right;
        }
    }
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
