// Arrays of rows, (n, columns), a packet of rows at a time. Lanes behind the end repeat the last row.
#pragma once

#include <algorithm>

#include "core/color/spectrum.h"

namespace tr {

template <class F>
class PacketRows {
    using S = ScalarOf<F>;
    static constexpr size_t W = size_t(Lanes<F>::Width);

public:
    const size_t begin, count;  // of the rows that there are
    const MaskOf<F> active;

    PacketRows(size_t first, size_t n)
        : begin(first), count(std::min(n - first, W)), active(mask<F>(lane_index<F>() < UIntOf<F>(uint32_t(count)))) {}

    F number(const S *from, size_t columns = 1, size_t column = 0) const {
        alignas(64) S lanes[W];
        for (size_t i = 0; i < W; ++i) lanes[i] = from[columns * row(i) + column];
        return load<F>(lanes);
    }
    Vec3<F> vector(const S *from) const { return {number(from, 3, 0), number(from, 3, 1), number(from, 3, 2)}; }
    Vec2<F> pair(const S *from) const { return {number(from, 2, 0), number(from, 2, 1)}; }
    // Of `channels` numbers a row; what there are not are zero.
    Spectrum<F> spectrum(const S *from, int channels) const {
        Spectrum<F> r = uniform_spectrum(F(0));
        for (int c = 0; c < channels; ++c) r[c] = number(from, size_t(channels), size_t(c));
        return r;
    }
    UIntOf<F> index(const uint32_t *from) const {
        alignas(64) uint32_t lanes[W];
        for (size_t i = 0; i < W; ++i) lanes[i] = from[row(i)];
        return load_uint<F>(lanes);
    }

    void put(S *to, const F &x, size_t columns = 1, size_t column = 0) const {
        alignas(64) S lanes[W];
        store(lanes, x);
        for (size_t i = 0; i < count; ++i) to[columns * (begin + i) + column] = lanes[i];
    }
    void put(S *to, const Vec3<F> &v) const { put(to, v.x, 3, 0), put(to, v.y, 3, 1), put(to, v.z, 3, 2); }
    void put(S *to, const Vec2<F> &v) const { put(to, v.x, 2, 0), put(to, v.y, 2, 1); }
    void put(S *to, const Spectrum<F> &v, int channels) const {
        for (int c = 0; c < channels; ++c) put(to, v[c], size_t(channels), size_t(c));
    }
    // Integers and flags.
    template <class T, class I>
    void put_integers(T *to, const I &x) const {
        alignas(64) uint32_t lanes[W];
        store(lanes, UIntOf<F>(x));
        for (size_t i = 0; i < count; ++i) to[begin + i] = T(lanes[i]);
    }
    template <class T>
    void put_flags(T *to, const MaskOf<F> &m) const {
        put_integers(to, select(mask<UIntOf<F>>(m), UIntOf<F>(1u), UIntOf<F>(0u)));
    }

private:
    size_t row(size_t lane) const { return begin + std::min(lane, count - 1); }
};

// Calls visit(rows) for n rows.
template <class F, class Visit>
void for_rows(size_t n, Visit &&visit) {
    for (size_t begin = 0; begin < n; begin += size_t(Lanes<F>::Width)) visit(PacketRows<F>(begin, n));
}

}  // namespace tr
