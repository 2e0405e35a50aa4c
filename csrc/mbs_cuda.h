/* Kernels in many states on a GPU: a state a thread, for the CUDA C that a folder holds beside each kernel.
 *
 * NVRTC compiles such a file with -default-device and empty headers for <math.h> and <float.h>; nvcc compiles it as it is.
 * -DMBS_REAL=float computes in single precision. With -DMBS_NONZEROS, the nonzeros of results
 * are the rows of a column.
 */
#ifndef MBS_CUDA_H
#define MBS_CUDA_H

/* A thread computes a single state, without vectors; functions that are found by their names stay with its C. */
#define MBS_SCALAR
#define MBS_WITHOUT_PLAIN_NAMES

#include <float.h>
#include <math.h>

#include "mbs_abi.h"

/* Where numbers lie: row r, column c of state s at first + s * step + r * down + c * across. Threads of a warp reach
 * neighbours in memory where step is 1. */
typedef struct {
    mbs_real *first;
    long long step, down, across;
} mbs_array;

#define MBS_PLACE(a, r, c) (a).first[mbs_state * (a).step + (r) * (a).down + (c) * (a).across]
#define MBS_LOAD(a, r, c, k) mbs_##a[k] = MBS_PLACE(a, r, c)
#ifdef MBS_NONZEROS
#define MBS_STORE(a, r, c, k) MBS_PLACE(a, k, 0) = mbs_##a[k]
#define MBS_STORE_ZERO(a, r, c)
#define MBS_FAIL(a, rows, cols, nonzeros) mbs_fail(a, mbs_state, nonzeros, 1)
#else
#define MBS_STORE(a, r, c, k) MBS_PLACE(a, r, c) = mbs_##a[k]
#define MBS_STORE_ZERO(a, r, c) MBS_PLACE(a, r, c) = 0
#define MBS_FAIL(a, rows, cols, nonzeros) mbs_fail(a, mbs_state, rows, cols)
#endif

/* Write what is no number to all entries of a result of a state. */
static __device__ inline void mbs_fail(mbs_array a, long long state, int rows, int cols)
{
    int r, c;
    for (r = 0; r < rows; ++r)
        for (c = 0; c < cols; ++c)
            a.first[state * a.step + r * a.down + c * a.across] = nanf("");
}

/* The kernel's C, which follows, has no words of CUDA: nvcc would take its functions for the host's, and either compiler
 * speaks of names that a kernel does not use. */
#if defined(__CUDACC__)
#pragma nv_diag_suppress 20044
#endif
#if defined(__CUDACC__) && !defined(__CUDACC_RTC__)
#pragma nv_diag_suppress 20037
#define static static __device__
#endif

#endif
