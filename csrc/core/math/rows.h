// Rows of tables: a few consecutive numbers for every lane. A processor's gather takes about as long for one number as
// reading a whole row a lane and transposing takes for four of them.
#pragma once

#include <cstring>

#include "lanes.h"

namespace tr {

#if TR_HAS_PACKETS && defined(DRJIT_X86_SSE42)
namespace detail {

// (A load of a double would ask for its alignment.)
TR_INLINE __m128 load_two(const void *p) { return _mm_castsi128_ps(_mm_loadl_epi64(static_cast<const __m128i *>(p))); }
// N <= 4 consecutive numbers, nothing behind them is read.
template <int N, class S>
TR_INLINE __m128 load_row(const S *p) {
    const float *f = reinterpret_cast<const float *>(p);
    if constexpr (N == 1) return _mm_load_ss(f);
    if constexpr (N == 2) return load_two(p);
    if constexpr (N == 3) {
#if defined(DRJIT_X86_AVX512)
        return _mm_maskz_loadu_ps(7, f);
#else
        return _mm_insert_ps(load_two(p), _mm_load_ss(f + 2), 0x20);
#endif
    }
    if constexpr (N == 4) return _mm_loadu_ps(f);
}

template <class V>
TR_INLINE V interleave(V a, V b, bool high);
template <>
TR_INLINE __m128 interleave(__m128 a, __m128 b, bool high) {
    return high ? _mm_unpackhi_ps(a, b) : _mm_unpacklo_ps(a, b);
}
template <class V>
TR_INLINE V interleave_pairs(V a, V b, bool high);
template <>
TR_INLINE __m128 interleave_pairs(__m128 a, __m128 b, bool high) {
    return high ? _mm_movehl_ps(b, a) : _mm_movelh_ps(a, b);
}

// Register j holds the rows of lanes j, 4 + j, 8 + j, ..., so that transposing blocks of 4x4 leaves lanes in order.
template <int N, class S, int W>
struct RowRegisters {
    __m128 r[4];
    TR_INLINE RowRegisters(const S *base, const uint32_t *at) {
        for (int j = 0; j < 4; ++j) r[j] = load_row<N>(base + at[j]);
    }
};
#if defined(DRJIT_X86_AVX)
template <>
TR_INLINE __m256 interleave(__m256 a, __m256 b, bool high) {
    return high ? _mm256_unpackhi_ps(a, b) : _mm256_unpacklo_ps(a, b);
}
template <>
TR_INLINE __m256 interleave_pairs(__m256 a, __m256 b, bool high) {
    return high ? _mm256_shuffle_ps(a, b, 0xEE) : _mm256_shuffle_ps(a, b, 0x44);
}
template <int N, class S>
struct RowRegisters<N, S, 8> {
    __m256 r[4];
    TR_INLINE RowRegisters(const S *base, const uint32_t *at) {
        for (int j = 0; j < 4; ++j)
            r[j] = _mm256_insertf128_ps(_mm256_castps128_ps256(load_row<N>(base + at[j])),
                                        load_row<N>(base + at[4 + j]), 1);
    }
};
#endif
#if defined(DRJIT_X86_AVX512)
template <>
TR_INLINE __m512 interleave(__m512 a, __m512 b, bool high) {
    return high ? _mm512_unpackhi_ps(a, b) : _mm512_unpacklo_ps(a, b);
}
template <>
TR_INLINE __m512 interleave_pairs(__m512 a, __m512 b, bool high) {
    return high ? _mm512_shuffle_ps(a, b, 0xEE) : _mm512_shuffle_ps(a, b, 0x44);
}
template <int N, class S>
struct RowRegisters<N, S, 16> {
    __m512 r[4];
    TR_INLINE RowRegisters(const S *base, const uint32_t *at) {
        for (int j = 0; j < 4; ++j) {
            __m512 x = _mm512_castps128_ps512(load_row<N>(base + at[j]));
            x = _mm512_insertf32x4(x, load_row<N>(base + at[4 + j]), 1);
            x = _mm512_insertf32x4(x, load_row<N>(base + at[8 + j]), 2);
            r[j] = _mm512_insertf32x4(x, load_row<N>(base + at[12 + j]), 3);
        }
    }
};
#endif

#if defined(DRJIT_X86_AVX)
// Number k of a row of 4, in each 128 bits of 4 registers.
template <class V>
TR_INLINE V column_of(const V (&r)[4], int k) {
    return interleave_pairs(interleave(r[0], r[1], k > 1), interleave(r[2], r[3], k > 1), k % 2 == 1);
}

// The first or the second 128 bits of every 256, those of a before those of b.
TR_INLINE __m256 halves(__m256 a, __m256 b, bool second) {
    return second ? _mm256_permute2f128_ps(a, b, 0x31) : _mm256_permute2f128_ps(a, b, 0x20);
}
#if defined(DRJIT_X86_AVX512)
TR_INLINE __m512 halves(__m512 a, __m512 b, bool second) {
    return second ? _mm512_shuffle_f32x4(a, b, 0xDD) : _mm512_shuffle_f32x4(a, b, 0x88);
}
#endif

// Rows of 8: register j of a group holds those of lanes j and 4 + j of its 8 lanes (AVX: of lane j of its 4), so that
// columns of both groups put together are in order.
template <class S, int W>
struct LongRowRegisters;
template <class S>
struct LongRowRegisters<S, 8> {
    __m256 r[2][4];
    TR_INLINE LongRowRegisters(const S *base, const uint32_t *at) {
        for (int j = 0; j < 8; ++j) r[j / 4][j % 4] = _mm256_loadu_ps(reinterpret_cast<const float *>(base + at[j]));
    }
    // Column k in the first half, k + 4 in the second.
    TR_INLINE __m256 column(int group, int k) const { return column_of(r[group], k); }
};
#if defined(DRJIT_X86_AVX512)
template <class S>
struct LongRowRegisters<S, 16> {
    __m512 r[2][4];
    TR_INLINE LongRowRegisters(const S *base, const uint32_t *at) {
        auto load = [&](int lane) { return _mm256_loadu_ps(reinterpret_cast<const float *>(base + at[lane])); };
        for (int g = 0; g < 2; ++g)
            for (int j = 0; j < 4; ++j)
                r[g][j] = _mm512_insertf32x8(_mm512_castps256_ps512(load(8 * g + j)), load(8 * g + 4 + j), 1);
    }
    TR_INLINE __m512 column(int group, int k) const { return column_of(r[group], k); }
};
#endif
#endif

template <class V, class T>
TR_INLINE void put_bits(const V &bits, T &out) {
    static_assert(sizeof(V) == sizeof(T));
    std::memcpy(static_cast<void *>(&out), &bits, sizeof(T));
}

}  // namespace detail
#endif

// out[k] = base[index + k], N <= 4. Lanes that are not active get what they like; at least one must be, or the table
// must have N numbers.
template <class F, int N, class T, class S>
TR_INLINE void gather_rows(const S *base, const UIntOf<F> &index, const MaskOf<F> &active, T (&out)[N]) {
    constexpr int W = Lanes<F>::Width;
    static_assert(N <= 4);
    if constexpr (W == 1) {
        for (int k = 0; k < N; ++k) out[k] = active ? T(base[index + uint32_t(k)]) : T(0);
    }
#if TR_HAS_PACKETS && defined(DRJIT_X86_SSE42)
    else if constexpr (sizeof(S) == 4) {
        alignas(64) uint32_t at[W];
        store(&at[0], select(mask<UIntOf<F>>(active), index, UIntOf<F>(0u)));
        __asm__("" : "+m"(at));  // read back from there: taking a register apart lane by lane is slower
        detail::RowRegisters<N, S, W> row(base, at);
        auto low0 = detail::interleave(row.r[0], row.r[1], false), low1 = detail::interleave(row.r[2], row.r[3], false);
        detail::put_bits(detail::interleave_pairs(low0, low1, false), out[0]);
        if constexpr (N > 1) detail::put_bits(detail::interleave_pairs(low0, low1, true), out[1]);
        if constexpr (N > 2) {
            auto high0 = detail::interleave(row.r[0], row.r[1], true),
                 high1 = detail::interleave(row.r[2], row.r[3], true);
            detail::put_bits(detail::interleave_pairs(high0, high1, false), out[2]);
            if constexpr (N > 3) detail::put_bits(detail::interleave_pairs(high0, high1, true), out[3]);
        }
    }
#endif
    else {
        for (int k = 0; k < N; ++k) out[k] = gather<T>(base, index + uint32_t(k), mask<T>(active));
    }
}

// A row of 8 numbers a lane: from 256 bits a load, half the loads of two rows of 4.
template <class F, class T, class S>
TR_INLINE void gather_long_rows(const S *base, const UIntOf<F> &index, const MaskOf<F> &active, T (&out)[8]) {
#if TR_HAS_PACKETS && defined(DRJIT_X86_AVX)
    constexpr int W = Lanes<F>::Width;
    if constexpr (W >= 8 && sizeof(S) == 4) {
        alignas(64) uint32_t at[W];
        store(&at[0], select(mask<UIntOf<F>>(active), index, UIntOf<F>(0u)));
        __asm__("" : "+m"(at));
        detail::LongRowRegisters<S, W> row(base, at);
        for (int k = 0; k < 4; ++k) {
            auto low = row.column(0, k), high = row.column(1, k);
            detail::put_bits(detail::halves(low, high, false), out[k]);
            detail::put_bits(detail::halves(low, high, true), out[4 + k]);
        }
        return;
    }
#endif
    T half[4];
    for (uint32_t h = 0; h < 2; ++h) {
        gather_rows<F>(base, index + 4u * h, active, half);
        for (int k = 0; k < 4; ++k) out[4 * h + uint32_t(k)] = half[k];
    }
}

// The same from a table in which all lanes often want the same row.
template <class F, int N, class T, class S>
TR_INLINE void gather_few_rows(const S *base, const UIntOf<F> &index, const MaskOf<F> &active, T (&out)[N]) {
    if constexpr (Lanes<F>::Width > 1) {
        if (!any(active)) {
            for (int k = 0; k < N; ++k) out[k] = T(0);
            return;
        }
        uint32_t first = first_lane(index, active);
        if (!any(active && mask<F>(index != first))) {
            for (int k = 0; k < N; ++k) out[k] = T(base[first + uint32_t(k)]);
            return;
        }
    }
    gather_rows<F>(base, index, active, out);
}

// p[offset] for offsets below twice the width, all of which may be read: two loads and a permutation.
template <class T, class S>
TR_INLINE T pick(const S *p, const UIntOf<T> &offset) {
    if constexpr (Lanes<T>::Width == 1) {
        return T(p[offset]);
    }
#if TR_HAS_PACKETS
#if defined(DRJIT_X86_AVX512)
    else if constexpr (sizeof(T) == 64) {
        __m512i index;
        std::memcpy(&index, &offset, 64);
        T r;
        detail::put_bits(
            _mm512_permutex2var_ps(_mm512_loadu_ps((const float *)p), index, _mm512_loadu_ps((const float *)p + 16)),
            r);
        return r;
    }
#endif
#if defined(DRJIT_X86_AVX2)
    else if constexpr (sizeof(T) == 32) {
        __m256i index;
        std::memcpy(&index, &offset, 32);
        const float *f = reinterpret_cast<const float *>(p);
        __m256 low = _mm256_permutevar8x32_ps(_mm256_loadu_ps(f), index);
        __m256 high = _mm256_permutevar8x32_ps(_mm256_loadu_ps(f + 8), index);
        T r;
        detail::put_bits(_mm256_blendv_ps(low, high, _mm256_castsi256_ps(_mm256_slli_epi32(index, 28))), r);
        return r;
    }
#endif
    else {
        return drjit::gather<T>(p, offset);
    }
#endif
}

}  // namespace tr
