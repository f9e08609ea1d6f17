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

// Lanes of a column: consecutive where the order is, gathered otherwise.
template <class F>
struct LaneSet {
    UIntOf<F> index;
    uint32_t first;
    bool consecutive;
    MaskOf<F> active;

    template <class S>
    TR_INLINE F get(const S *column) const {
        if (consecutive) return load<F>(column + first);
        return gather<F>(column, index, active);
    }
    TR_INLINE UIntOf<F> get(const uint32_t *column) const {
        using U = UIntOf<F>;
        if (consecutive) return load_uint<F>(column + first);
        return gather<U>(column, index, mask<U>(active));
    }
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
};

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
