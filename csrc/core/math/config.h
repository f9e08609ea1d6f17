// What every core header needs: the host/device marker and the integer types.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#if defined(__CUDACC__)
#define TR_HD __host__ __device__
#else
#define TR_HD
#endif

// Small functions on packets must be inlined: a packet passed through memory costs more than most of them compute.
#if defined(__CUDACC__)
#define TR_INLINE TR_HD __forceinline__
#elif defined(__GNUC__) && !defined(__SANITIZE_ADDRESS__)  // sanitized code of that size takes a compiler too long
#define TR_INLINE inline __attribute__((always_inline))
#else
#define TR_INLINE inline
#endif

// Large functions that are called in several places, and seldom.
#if defined(__CUDACC__)
#define TR_NOINLINE TR_HD __noinline__
#elif defined(__GNUC__)
#define TR_NOINLINE __attribute__((noinline))
#else
#define TR_NOINLINE
#endif

namespace tr {

constexpr double Pi = 3.14159265358979323846, SqrtPi = 1.77245385090551602730;

}  // namespace tr
