// The renderer is written once, for a `Float` that is a number or a packet of them. This header gives both one
// vocabulary: masks, select, gather and scatter, and the elementary functions. A number is a packet of one lane.
// Packets are those of Dr.Jit (drjit/packet.h, header only); CUDA and other processors use the numbers.
#pragma once

#include <type_traits>

#include "config.h"

#if !defined(TR_PACKET_WIDTH)
#define TR_PACKET_WIDTH 1
#endif

#if TR_PACKET_WIDTH > 1 && !defined(__CUDACC__)
#define TR_HAS_PACKETS 1
#include <drjit/math.h>
#include <drjit/packet.h>
#else
#define TR_HAS_PACKETS 0
#endif

namespace tr {

// ---------------------------------------------------------------------------------------------------- numbers
template <class F>
struct Lanes {
    using Scalar = F;
    using Mask = bool;
    using UInt = uint32_t;
    using Int = int32_t;
    static constexpr int Width = 1;
};

template <class F>
using ScalarOf = typename Lanes<F>::Scalar;
template <class F>
using MaskOf = typename Lanes<F>::Mask;
template <class F>
using UIntOf = typename Lanes<F>::UInt;
template <class F>
using IntOf = typename Lanes<F>::Int;

TR_INLINE bool any(bool m) { return m; }
TR_INLINE bool all(bool m) { return m; }
TR_INLINE int count(bool m) { return m ? 1 : 0; }
template <class T, class = std::enable_if_t<std::is_arithmetic_v<T>>>
TR_INLINE T select(bool m, T a, T b) {
    return m ? a : b;
}
#define TR_UNARY(name, expression)                       \
    TR_INLINE float name(float x) { return expression; } \
    TR_INLINE double name(double x) { return expression; }
TR_UNARY(sqrt, std::sqrt(x))
TR_UNARY(exp, std::exp(x))
TR_UNARY(log, std::log(x))
TR_UNARY(sin, std::sin(x))
TR_UNARY(cos, std::cos(x))
TR_UNARY(acos, std::acos(x))
TR_UNARY(abs, std::fabs(x))
TR_UNARY(floor, std::floor(x))
#undef TR_UNARY
TR_INLINE float rsqrt(float x) { return 1.f / std::sqrt(x); }
TR_INLINE double rsqrt(double x) { return 1. / std::sqrt(x); }
TR_INLINE float atan2(float y, float x) { return std::atan2(y, x); }
TR_INLINE double atan2(double y, double x) { return std::atan2(y, x); }
TR_INLINE float min(float a, float b) { return a < b ? a : b; }
TR_INLINE double min(double a, double b) { return a < b ? a : b; }
TR_INLINE int32_t min(int32_t a, int32_t b) { return a < b ? a : b; }
TR_INLINE uint32_t min(uint32_t a, uint32_t b) { return a < b ? a : b; }
TR_INLINE int64_t min(int64_t a, int64_t b) { return a < b ? a : b; }
TR_INLINE float max(float a, float b) { return a > b ? a : b; }
TR_INLINE double max(double a, double b) { return a > b ? a : b; }
TR_INLINE int32_t max(int32_t a, int32_t b) { return a > b ? a : b; }
TR_INLINE uint32_t max(uint32_t a, uint32_t b) { return a > b ? a : b; }
TR_INLINE int64_t max(int64_t a, int64_t b) { return a > b ? a : b; }
TR_INLINE float fmadd(float a, float b, float c) { return a * b + c; }
TR_INLINE double fmadd(double a, double b, double c) { return a * b + c; }
TR_INLINE bool isfinite(float x) { return x - x == 0.f; }
TR_INLINE bool isfinite(double x) { return x - x == 0.; }
TR_INLINE uint32_t mul_hi(uint32_t a, uint32_t b) { return uint32_t((uint64_t(a) * b) >> 32); }
TR_INLINE void sincos(float x, float &s, float &c) { s = std::sin(x), c = std::cos(x); }
TR_INLINE void sincos(double x, double &s, double &c) { s = std::sin(x), c = std::cos(x); }

// The uniform part of the vocabulary: F is named, so that one text reads for both.
template <class F, class S>
TR_INLINE F gather(const S *base, UIntOf<F> index, MaskOf<F> active) {
    if constexpr (Lanes<F>::Width == 1) {
        return active ? F(base[index]) : F(0);
#if TR_HAS_PACKETS
    } else {
        return drjit::gather<F>(base, index, active);
#endif
    }
}

template <class To, class From>
TR_INLINE To convert(From x) {
    return To(x);
}

// Masks of integer comparisons and of floating-point comparisons are different types for a packet.
template <class F, class M>
TR_INLINE MaskOf<F> mask(M m) {
    return MaskOf<F>(m);
}

template <class F>
TR_INLINE F load(const ScalarOf<F> *p) {
    if constexpr (Lanes<F>::Width == 1) return *p;
#if TR_HAS_PACKETS
    else
        return drjit::load<F>(p);
#endif
}

template <class F>
TR_INLINE UIntOf<F> load_uint(const uint32_t *p) {
    if constexpr (Lanes<F>::Width == 1) return *p;
#if TR_HAS_PACKETS
    else
        return drjit::load<UIntOf<F>>(p);
#endif
}

template <class T, class S>
TR_INLINE void store(S *p, const T &x) {
    if constexpr (sizeof(T) == sizeof(S)) *p = S(x);
#if TR_HAS_PACKETS
    else
        drjit::store(p, x);
#endif
}

// 0, 1, 2, ... width - 1
template <class F>
TR_INLINE UIntOf<F> lane_index() {
    if constexpr (Lanes<F>::Width == 1) return 0u;
#if TR_HAS_PACKETS
    else
        return drjit::arange<UIntOf<F>>();
#endif
}

// Lane `i` as a number: for the loops over lanes that scatter with conflicts.
template <class T>
TR_INLINE auto lane(const T &x, [[maybe_unused]] int i) {
    if constexpr (std::is_arithmetic_v<T>) return x;
#if TR_HAS_PACKETS
    else
        return x.entry(i);
#endif
}

template <class M>
TR_INLINE bool lane_is_set(const M &m, [[maybe_unused]] int i) {
    if constexpr (std::is_same_v<M, bool>) return m;
#if TR_HAS_PACKETS
    else
        return m.entry(i);
#endif
}

template <class T>
TR_INLINE auto lane_sum(const T &x) {
    if constexpr (std::is_arithmetic_v<T>) return x;
#if TR_HAS_PACKETS
    else
        return drjit::sum(x);
#endif
}

// The value of x where m is set for the first time.
template <class T, class M>
TR_INLINE auto first_lane(const T &x, [[maybe_unused]] const M &m) {
    if constexpr (std::is_arithmetic_v<T>) return x;
#if TR_HAS_PACKETS
    else
        return drjit::extract(x, drjit::mask_t<T>(m));
#endif
}

// Adds to a number in memory and returns what it was before. Other lanes of a device may add to it at the same time;
// threads of a CPU have numbers of their own, but for whole ones of the emulated device.
template <class T>
TR_INLINE T accumulate(T *to, T value) {
#if defined(__CUDA_ARCH__)
    if constexpr (std::is_same_v<T, uint64_t>)
        return atomicAdd(reinterpret_cast<unsigned long long *>(to), static_cast<unsigned long long>(value));
    else
        return atomicAdd(to, value);
#else
#if defined(__GNUC__) && !TR_HAS_PACKETS
    if constexpr (std::is_integral_v<T>) return __atomic_fetch_add(to, value, __ATOMIC_RELAXED);
#endif
    T before = *to;
    *to = before + value;
    return before;
#endif
}

#if TR_HAS_PACKETS
// ---------------------------------------------------------------------------------------------------- packets
using FloatPacket = drjit::Packet<float, TR_PACKET_WIDTH>;

template <class T, size_t N>
struct Lanes<drjit::Packet<T, N>> {
    using Scalar = T;
    using Mask = drjit::mask_t<drjit::Packet<T, N>>;
    using UInt = drjit::uint32_array_t<drjit::Packet<T, N>>;
    using Int = drjit::int32_array_t<drjit::Packet<T, N>>;
    static constexpr int Width = int(N);
};

template <class T, size_t N>
TR_INLINE bool any(const drjit::PacketMask<T, N> &m) {
    return drjit::any(m);
}
template <class T, size_t N>
TR_INLINE bool all(const drjit::PacketMask<T, N> &m) {
    return drjit::all(m);
}
template <class T, size_t N>
TR_INLINE int count(const drjit::PacketMask<T, N> &m) {
    return int(drjit::count(m));
}
template <class M, class T, size_t N>
TR_INLINE drjit::Packet<T, N> select(const drjit::PacketMask<M, N> &m, const drjit::Packet<T, N> &a,
                                     const drjit::Packet<T, N> &b) {
    return drjit::select(drjit::mask_t<drjit::Packet<T, N>>(m), a, b);
}
#define TR_UNARY(name)                                                 \
    template <class T, size_t N>                                       \
    TR_INLINE drjit::Packet<T, N> name(const drjit::Packet<T, N> &x) { \
        return drjit::name(x);                                         \
    }
TR_UNARY(sqrt)
TR_UNARY(rsqrt)
TR_UNARY(exp)
TR_UNARY(log)
TR_UNARY(sin)
TR_UNARY(cos)
TR_UNARY(acos)
TR_UNARY(abs)
TR_UNARY(floor)
#undef TR_UNARY
#define TR_BINARY(name, call)                                                                        \
    template <class T, size_t N>                                                                     \
    TR_INLINE drjit::Packet<T, N> name(const drjit::Packet<T, N> &a, const drjit::Packet<T, N> &b) { \
        return drjit::call(a, b);                                                                    \
    }
TR_BINARY(min, minimum)
TR_BINARY(max, maximum)
TR_BINARY(atan2, atan2)
TR_BINARY(mul_hi, mul_hi)
#undef TR_BINARY
template <class T, size_t N>
TR_INLINE drjit::Packet<T, N> fmadd(const drjit::Packet<T, N> &a, const drjit::Packet<T, N> &b,
                                    const drjit::Packet<T, N> &c) {
    return drjit::fmadd(a, b, c);
}
template <class T, size_t N>
TR_INLINE auto isfinite(const drjit::Packet<T, N> &x) {
    return (x - x) == T(0);
}
template <class T, size_t N>
TR_INLINE void sincos(const drjit::Packet<T, N> &x, drjit::Packet<T, N> &s, drjit::Packet<T, N> &c) {
    auto [s_, c_] = drjit::sincos(x);
    s = s_, c = c_;
}
#endif

#if TR_HAS_PACKETS && defined(DRJIT_X86_AVX2) && !defined(DRJIT_X86_AVX512)
// Of every set of 8 lanes the numbers of those in it, in ascending order, a byte each.
struct LaneOrders {
    uint64_t of[256]{};
    constexpr LaneOrders() {
        for (int set = 0; set < 256; ++set)
            for (int lane = 0, n = 0; lane < 8; ++lane)
                if (set >> lane & 1) of[set] |= uint64_t(lane) << (8 * n++);
    }
};
inline constexpr LaneOrders lane_orders;
#endif

// Writes the lanes of `x` that are set in `m` one after the other. The packet is compressed in a register and stored
// whole: a compressing store to memory is microcoded on Zen 4. `p` therefore needs room for a full packet.
template <class F, class T, class S>
TR_INLINE void store_compressed(S *p, const T &x, [[maybe_unused]] const MaskOf<F> &m) {
    if constexpr (Lanes<F>::Width == 1) {
        *p = S(x);  // overwritten by the next lane where m is false
    }
#if TR_HAS_PACKETS
    else {
#if defined(DRJIT_X86_AVX512)
        if constexpr (sizeof(T) == 64) {
            __mmask16 k;
            if constexpr (sizeof(S) == 4) {
                k = __mmask16(drjit::mask_t<T>(m).k);
                if constexpr (std::is_same_v<S, float>)
                    _mm512_storeu_ps((float *)p, _mm512_maskz_compress_ps(k, x.m));
                else
                    _mm512_storeu_si512((void *)p, _mm512_maskz_compress_epi32(k, x.m));
                return;
            }
        }
#elif defined(DRJIT_X86_AVX2)
        if constexpr (sizeof(T) == 32 && sizeof(S) == 4) {
            const int set = _mm256_movemask_ps(drjit::mask_t<drjit::Packet<float, 8>>(m).m);
            const __m256i order = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(int64_t(lane_orders.of[set])));
            if constexpr (std::is_same_v<S, float>)
                _mm256_storeu_ps((float *)p, _mm256_permutevar8x32_ps(x.m, order));
            else
                _mm256_storeu_si256((__m256i *)p, _mm256_permutevar8x32_epi32(x.m, order));
            return;
        }
#endif
        int n = 0;
        for (int i = 0; i < Lanes<F>::Width; ++i) {
            p[n] = x.entry(i);
            n += m.entry(i) ? 1 : 0;
        }
    }
#endif
}

// What numbers of a precision are computed in: single precision in packets, where there are any; double precision,
// which is for checking, in scalars. Functions that are compiled once for all who call them are instantiated in
// a file of their own for each of these: Do(F, S) for every Float F and its scalar S.
#if TR_HAS_PACKETS
namespace detail {
template <class S>
struct PacketOf;
template <>
struct PacketOf<float> {
    using type = FloatPacket;
};
}  // namespace detail
template <class S>
using PacketOf = typename detail::PacketOf<S>::type;
#define TR_FOR_EACH_PRECISION(Do) Do(float)
#define TR_FOR_EACH_FLOAT(Do) Do(FloatPacket, float)
#define TR_FOR_EACH_PRECISION_OF(Do, ...) Do(float, __VA_ARGS__)
#else
template <class S>
using PacketOf = S;
#if defined(__CUDACC__)  // device code is instantiated where a kernel asks for it
#define TR_FOR_EACH_PRECISION(Do)
#define TR_FOR_EACH_FLOAT(Do)
#define TR_FOR_EACH_PRECISION_OF(Do, ...)
#else
#define TR_FOR_EACH_PRECISION(Do) Do(float) Do(double)
#define TR_FOR_EACH_FLOAT(Do) Do(float, float) Do(double, double)
#define TR_FOR_EACH_PRECISION_OF(Do, ...) Do(float, __VA_ARGS__) Do(double, __VA_ARGS__)
#endif
#endif

}  // namespace tr
