/* The grid of CUDA in plain C++: blocks and threads one after the other. */
#ifndef GRID_H
#define GRID_H

#include <cstddef>
#include <utility>

#define __global__
#define __device__

struct grid_place {
    unsigned x, y, z;
};
static grid_place gridDim, blockIdx, blockDim, threadIdx;

template <class... A, std::size_t... I>
static void grid_call(void (*kernel)(A...), void **arguments, std::index_sequence<I...>)
{
    kernel(*static_cast<A *>(arguments[I])...);
}

template <class... A>
static void grid_run(void (*kernel)(A...), unsigned blocks, unsigned threads, void **arguments)
{
    gridDim = {blocks, 1, 1};
    blockDim = {threads, 1, 1};
    for (blockIdx = {0, 0, 0}; blockIdx.x < blocks; ++blockIdx.x)
        for (threadIdx = {0, 0, 0}; threadIdx.x < threads; ++threadIdx.x)
            grid_call(kernel, arguments, std::index_sequence_for<A...>());
}

#endif
