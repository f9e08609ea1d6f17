// Rows of tables that lanes share: those next to each other are mostly in a few places, each of which is read once.
#pragma once

#include "rows.h"

namespace tr {

namespace detail {

#if TR_HAS_PACKETS && defined(DRJIT_X86_AVX512)
template <class F>
constexpr bool PermutesRows = sizeof(F) == 64 && sizeof(ScalarOf<F>) == 4;
#else
template <class F>
constexpr bool PermutesRows = false;
#endif

}  // namespace detail

// The different numbers of the lanes, in their order, if there are few; and which of them a lane has (lanes that are
// not active: any).
template <class F>
struct FewNumbers {
    using U = UIntOf<F>;
    static constexpr int W = Lanes<F>::Width, Most = W == 1 ? 0 : detail::PermutesRows<F> ? 8 : 6;
    alignas(64) uint32_t value[W > Most + 1 ? W : Most + 1];
    int n = 0;
    bool all = false;  // there are no more
    U which{0u};

    TR_INLINE FewNumbers([[maybe_unused]] const U &x, [[maybe_unused]] MaskOf<F> open) {
        value[0] = 0;
        if constexpr (Most == 0) {
#if TR_HAS_PACKETS && defined(DRJIT_X86_AVX512)
        } else if constexpr (detail::PermutesRows<F>) {
            // each lane finds the first one that has the same number by what conflicts with it
            const __mmask16 active = __mmask16(drjit::mask_t<U>(open).k);
            const __m512i zero = _mm512_setzero_si512(),
                          lane = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
            const __m128i some = _mm512_castsi512_si128(_mm512_maskz_compress_epi32(active, x.m));
            const __m512i number = _mm512_mask_mov_epi32(_mm512_broadcastd_epi32(some), active, x.m);
            const __m512i same = _mm512_conflict_epi32(number);
            const __mmask16 first = _mm512_testn_epi32_mask(same, same);
            const __m512i lowest = _mm512_and_si512(same, _mm512_sub_epi32(zero, same));
            const __m512i leader =
                _mm512_mask_sub_epi32(lane, __mmask16(~first), _mm512_set1_epi32(31), _mm512_lzcnt_epi32(lowest));
            _mm512_store_si512(value, _mm512_maskz_compress_epi32(first, number));
            n = __builtin_popcount(uint32_t(first));
            all = n <= Most;
            which.m = _mm512_permutexvar_epi32(leader, _mm512_maskz_expand_epi32(first, lane));
#endif
        } else {
            while (any(open) && n < Most) {
                value[n] = first_lane(x, open);
                const MaskOf<F> here = open && mask<F>(x == U(value[n]));
                which = select(mask<U>(here), U(uint32_t(n++)), which);
                open = open && !here;
            }
            all = !any(open);
        }
    }
};

// Calls visit(rows) where rows(base, out) is what gather_rows gives of T <= 4 numbers, `at` being all indices.
template <class F, int T, class Visit>
TR_INLINE auto with_shared_rows(const FewNumbers<F> &at, Visit &&visit) {
#if TR_HAS_PACKETS && defined(DRJIT_X86_AVX512)
    if constexpr (detail::PermutesRows<F>)
        if (at.n > 2) {
            // 4 rows a register, from which lanes take what is theirs; of one or two places numbers are as quick
            constexpr unsigned row = (1u << T) - 1;
            const uint32_t *from = at.value;
            const __m512i own = _mm512_slli_epi32(at.which.m, 2);
            auto four = [](const float *base, const uint32_t *index) {
                auto place = [&](int k) { return detail::load_row<T>(base + index[k]); };
                __m512 r = _mm512_castps128_ps512(place(0));
                r = _mm512_mask_broadcast_f32x4(r, __mmask16(row << 4), place(1));
                r = _mm512_mask_broadcast_f32x4(r, __mmask16(row << 8), place(2));
                return _mm512_mask_broadcast_f32x4(r, __mmask16(row << 12), place(3));
            };
            auto column = [&](int k) { return _mm512_add_epi32(own, _mm512_set1_epi32(k)); };
            if (at.n <= 4)
                return visit([&](const float *base, F(&out)[T]) {
                    const __m512 r = four(base, from);
                    for (int k = 0; k < T; ++k) detail::put_bits(_mm512_permutexvar_ps(column(k), r), out[k]);
                });
            return visit([&](const float *base, F(&out)[T]) {
                const __m512 r = four(base, from), more = four(base, from + 4);
                for (int k = 0; k < T; ++k) detail::put_bits(_mm512_permutex2var_ps(r, column(k), more), out[k]);
            });
        }
#endif
    MaskOf<F> here[FewNumbers<F>::Most];
    for (int i = 1; i < at.n; ++i) here[i] = mask<F>(at.which == UIntOf<F>(uint32_t(i)));
    return visit([&](const ScalarOf<F> *base, F(&out)[T]) {
        for (int k = 0; k < T; ++k) out[k] = F(base[at.value[0] + uint32_t(k)]);
        for (int i = 1; i < at.n; ++i)
            for (int k = 0; k < T; ++k) out[k] = select(here[i], F(base[at.value[i] + uint32_t(k)]), out[k]);
    });
}

// Up to four numbers a lane, turned into rows of four, the others being zero.
template <class F>
class LaneRows {
    using S = ScalarOf<F>;
    static constexpr int W = Lanes<F>::Width;
    alignas(64) S numbers_[4 * W];

public:
    template <int N>
    TR_INLINE explicit LaneRows(const F (&given)[N]) {
        F x[4] = {F(0), F(0), F(0), F(0)};
        for (int k = 0; k < N; ++k) x[k] = given[k];
#if TR_HAS_PACKETS && defined(DRJIT_X86_SSE42)
        if constexpr (W > 1 && sizeof(S) == 4) {
            // register j has the rows of lanes j, 4 + j, 8 + j, ...
            F rows[4];
            for (int high = 0; high < 2; ++high) {
                const auto a = detail::interleave(x[0].m, x[1].m, high), b = detail::interleave(x[2].m, x[3].m, high);
                detail::put_bits(detail::interleave_pairs(a, b, false), rows[2 * high]);
                detail::put_bits(detail::interleave_pairs(a, b, true), rows[2 * high + 1]);
            }
            for (int j = 0; j < 4; ++j) store(numbers_ + j * W, rows[j]);
            return;
        }
#endif
        for (int k = 0; k < 4; ++k) {
            alignas(64) S lanes[W];
            store(lanes, x[k]);
            for (int i = 0; i < W; ++i) numbers_[place(uint32_t(i)) + uint32_t(k)] = lanes[i];
        }
    }
    // Of lane i.
    TR_INLINE const S *operator[](uint32_t i) const { return numbers_ + place(i); }

private:
    static constexpr uint32_t place(uint32_t i) { return W > 1 ? i % 4 * uint32_t(W) + i / 4 * 4 : 0; }
};

// A row of four, to add others to.
template <class S>
struct RowSum {
    S x[4] = {S(0), S(0), S(0), S(0)};
    TR_INLINE void add(const S *row, S factor) {
        for (int k = 0; k < 4; ++k) x[k] = fmadd(row[k], factor, x[k]);
    }
    TR_INLINE void put(S *to) const {
        for (int k = 0; k < 4; ++k) to[k] = x[k];
    }
};
#if TR_HAS_PACKETS && defined(DRJIT_X86_SSE42)
template <>
struct RowSum<float> {
    __m128 x = _mm_setzero_ps();
    TR_INLINE void add(const float *row, float factor) {
#if defined(__FMA__)
        x = _mm_fmadd_ps(_mm_load_ps(row), _mm_set1_ps(factor), x);
#else
        x = _mm_add_ps(_mm_mul_ps(_mm_load_ps(row), _mm_set1_ps(factor)), x);
#endif
    }
    TR_INLINE void put(float *to) const { _mm_store_ps(to, x); }
};
#endif

}  // namespace tr
