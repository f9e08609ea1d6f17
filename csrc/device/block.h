// Blocks of threads that work together on one item, phase by phase: a barrier is between phases, and none can stand
// where only some of the threads come to it. What threads hand to each other, and keep from phase to phase, is in a
// `Shared`. The host runs the threads of a phase one by one, forwards or backwards by the item's number.
#pragma once

#include <type_traits>

#include "core/math/config.h"

namespace tr {

constexpr uint32_t BlockSize = 256;

template <class Shared>
struct Block {
    Shared &shared;
    [[maybe_unused]] uint32_t number;

    // Calls f(thread), after all threads have done what was before.
    template <class Do>
    TR_HD void each(Do &&f) const {
#if defined(__CUDA_ARCH__)
        f(uint32_t(threadIdx.x));
        __syncthreads();
#else
        for (uint32_t t = 0; t < BlockSize; ++t) f(number % 2 ? BlockSize - 1 - t : t);
#endif
    }
};

// Whether a kernel's items are such blocks: see kernel.h.
template <class K, class = void>
struct IsBlockKernel : std::false_type {};
template <class K>
struct IsBlockKernel<K, std::void_t<typename K::Shared>> : std::true_type {};

}  // namespace tr
