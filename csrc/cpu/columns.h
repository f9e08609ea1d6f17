// Structure-of-arrays storage of a tile: columns of one allocation, aligned for packets, that live as long as a thread
// renders.
#pragma once

#include <cstdlib>
#include <memory>
#include <new>

#include "core/color/color.h"
#include "core/math/vector.h"

namespace tr {

class Arena {
public:
    Arena() = default;
    Arena(Arena &&) = default;
    Arena &operator=(Arena &&) = default;

    // Two passes over the same list of columns: with no memory the first one counts.
    template <class Declare>
    void allocate(Declare &&declare) {
        used_ = 0;
        memory_.reset();
        declare(*this);
        size_t size = used_ + 64;
        memory_.reset(static_cast<char *>(std::aligned_alloc(64, (size + 63) / 64 * 64)));
        if (!memory_) throw std::bad_alloc();
        used_ = 0;
        declare(*this);
    }
    template <class T>
    void column(T *&pointer, size_t n) {
        pointer = memory_ ? reinterpret_cast<T *>(memory_.get() + used_) : nullptr;  // no arithmetic on a null pointer
        used_ += (n * sizeof(T) + 63) / 64 * 64;
    }
    template <class T, size_t N>
    void column(T *(&pointers)[N], size_t n) {
        for (T *&p : pointers) column(p, n);
    }

private:
    struct Free {
        void operator()(char *p) const { std::free(p); }
    };
    std::unique_ptr<char, Free> memory_;
    size_t used_ = 0;
};

// Consecutive entries of columns.
template <class F, class S>
TR_INLINE Vec3<F> load_vec(S *const (&column)[3], size_t i) {
    return {load<F>(column[0] + i), load<F>(column[1] + i), load<F>(column[2] + i)};
}
template <class F, int C, class S>
TR_INLINE Color<F, C> load_color(S *const (&column)[C], size_t i) {
    Color<F, C> r;
    for (int c = 0; c < C; ++c) r[c] = load<F>(column[c] + i);
    return r;
}

// Lanes of columns, in ascending order: loaded where they follow each other, picked from two packets where they are
// near, gathered otherwise. Columns have room for two packets behind their last entry.
template <class F>
struct LaneSet {
    using U = UIntOf<F>;
    U index;  // into the column; once near, relative to `first`
    uint32_t first;
    enum { Consecutive, Near, Scattered } kind;
    MaskOf<F> active;

    // `order` holds the entries, of which the first `n` count.
    TR_INLINE LaneSet(const uint32_t *order, uint32_t n) {
        constexpr uint32_t W = uint32_t(Lanes<F>::Width);
        n = n < W ? n : W;
        active = mask<F>(lane_index<F>() < U(n));
        first = order[0];
        uint32_t distance = order[n - 1] - first;
        kind = distance == n - 1 ? Consecutive : distance < 2 * W ? Near : Scattered;
        index = select(mask<U>(active), load_uint<F>(order), U(first));
        if (kind == Near) index = index - U(first);
    }

    // Entries in any order, of which the first lane counts.
    TR_INLINE LaneSet(const U &entries, const MaskOf<F> &active_) : active(active_) {
        first = lane(entries, 0);
        index = select(mask<U>(active), entries, U(first));
        U offset = index - U(first);
        // not `offset < 2 W`: AVX-512 packets of Dr.Jit compare unsigned numbers as if they were signed
        bool near = all(mask<F>((offset & U(~uint32_t(2 * Lanes<F>::Width - 1))) == U(0u)));
        kind = near ? Near : Scattered;
        if (near) index = offset;
    }

    TR_INLINE F get(const ScalarOf<F> *column) const { return at<F>(column); }
    TR_INLINE U get(const uint32_t *column) const { return at<U>(column); }

    template <class S>
    TR_INLINE Vec3<F> vec(S *const (&column)[3]) const {
        return {get(column[0]), get(column[1]), get(column[2])};
    }
    template <int C, class S>
    TR_INLINE Color<F, C> color(S *const (&column)[C]) const {
        Color<F, C> r;
        for (int c = 0; c < C; ++c) r[c] = get(column[c]);
        return r;
    }

private:
    template <class T, class S>
    TR_INLINE T at(const S *column) const {
        if constexpr (Lanes<F>::Width == 1) {
            return column[first];
        }
#if TR_HAS_PACKETS
        else {
            if (kind == Consecutive) return drjit::load<T>(column + first);
            if (kind == Near) return pick<T>(column + first, index);
            return drjit::gather<T>(column, index);
        }
#endif
    }
};

// Writes lanes into a column; no two of them have one entry.
template <class F, class T, class S>
TR_INLINE void scatter_lanes(S *column, const UIntOf<F> &entry, const T &value, const MaskOf<F> &m) {
    if constexpr (Lanes<F>::Width == 1) {
        if (m) column[entry] = S(value);
    }
#if TR_HAS_PACKETS
    else
        drjit::scatter(column, value, entry, drjit::mask_t<T>(m));
#endif
}

// Adds a colour a lane to the columns of a colour; several lanes may have one slot.
template <class F, int C, class S>
TR_INLINE void add_to_slots(S *const *columns, const UIntOf<F> &slot, const Color<F, C> &value, const MaskOf<F> &m) {
    constexpr int W = Lanes<F>::Width;
    alignas(64) uint32_t s[W], set[W];
    alignas(64) S v[C][W];
    store(&s[0], slot);
    store(&set[0], select(mask<UIntOf<F>>(m), UIntOf<F>(1u), UIntOf<F>(0u)));
    for (int c = 0; c < C; ++c) store(&v[c][0], value[c]);
    for (int i = 0; i < W; ++i)
        if (set[i])
            for (int c = 0; c < C; ++c) columns[c][s[i]] += v[c][i];
}

}  // namespace tr
