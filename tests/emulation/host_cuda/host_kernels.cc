// SPDX-License-Identifier: GPL-3.0-or-later
// The CUDA kernels as functions of the processor: launch_NAME(grid, threads of a block, bytes
// shared, addresses of arguments).
#define HOST_CUDA
#include "kernels.cu"

#define HOST_LAUNCH(name)                                                                          \
    extern "C" void launch_##name(const unsigned* grid, unsigned block, std::size_t shared,        \
                                  void** arguments)                                                \
    {                                                                                              \
        host::launch(name, grid, block, shared, arguments);                                        \
    }
HOST_LAUNCH(scales)
HOST_LAUNCH(sparse_filters)
HOST_LAUNCH(dense_filters)
HOST_LAUNCH(forward)
HOST_LAUNCH(inverse)
HOST_LAUNCH(direct)
