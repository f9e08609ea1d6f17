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

// Functions that are compiled once for all who call them: out of line in device code, too, where they are in the same
// translation unit. Where it is compiled for one scene, little is left of them, and the compiler may decide: arguments
// then stay in registers.
#if defined(__CUDACC__) && !defined(TR_ONE_SCENE)
#define TR_LARGE TR_HD __noinline__
#elif defined(__CUDACC__)
#define TR_LARGE TR_HD
#else
#define TR_LARGE
#endif

// Tables of functions that host and device have alike. A device's are constant data of the one translation unit that it
// is compiled from; a CPU's are put together from many when the program starts.
#if defined(__CUDACC__)
#define TR_DEVICE_CONSTEXPR constexpr
#else
#define TR_DEVICE_CONSTEXPR
#endif

// A pointer to data or to a function of the host, in a table that a device has, too: null there.
#if defined(__CUDA_ARCH__)
#define TR_HOST_POINTER(p) nullptr
#else
#define TR_HOST_POINTER(p) p
#endif

namespace tr {

constexpr double Pi = 3.14159265358979323846, SqrtPi = 1.77245385090551602730;

}  // namespace tr
