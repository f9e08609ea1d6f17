// Leaves of the tree of outlines (outline_tree.h): sixteen elements each, as they are; or edges alone, rounded to 27
// bytes each, of which large scenes have many. Rounding makes no derivative wrong: it changes how often an edge is
// chosen, and an edge that may be an outline within it can be chosen.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>

#include "../math/vector.h"

namespace tr {

// A vector in three columns.
template <class T>
TR_HD Vec3<float> lane_of(const T &columns, size_t k) {
    return {columns[0][k], columns[1][k], columns[2][k]};
}
template <class T>
TR_HD void put_lane(const Vec3<float> &v, T &columns, size_t k) {
    columns[0][k] = v.x, columns[1][k] = v.y, columns[2][k] = v.z;
}
// ... as many from k on as F has lanes.
template <class F, class T>
TR_INLINE Vec3<F> load_vector(const T &columns, size_t k) {
    return {load<F>(&columns[0][k]), load<F>(&columns[1][k]), load<F>(&columns[2][k])};
}
template <class F, class T>
TR_INLINE void store_vector(const Vec3<F> &v, T &columns, size_t k) {
    store(&columns[0][k], v.x), store(&columns[1][k], v.y), store(&columns[2][k], v.z);
}

// What can be an outline: a straight edge between `a` and `b` of faces with normals n0 and n1; or, `Round`, a curve
// around `a` with the radius b[0], of the curved shape of number `shape`.
struct OutlineElement {
    enum Kind : int32_t { Edge = 0, Always = 1, Crease = 2, Round = 3 };  // Crease: of an edge, an outline or not
    Vec3<float> a, b, n0, n1;
    float weight, bend;  // not above 1 and 2
    int32_t kind, shape, index;
    bool moves;  // what has a weight
};

// Sixteen numbers, side by side.
constexpr size_t OutlineWide = 16;
template <class T>
using OutlineColumn = T[OutlineWide];

struct alignas(64) OutlineLeaf {
    OutlineColumn<float> a[3], b[3], n0[3], n1[3], weight, bend;  // a weight below zero: it rests
    OutlineColumn<int32_t> kind, shape, index;

    // Which of as many elements from k on as F has lanes are of a kind.
    template <class F>
    TR_INLINE MaskOf<F> are(OutlineElement::Kind what, size_t k) const {
        return mask<F>(IntOf<F>(load_uint<F>(reinterpret_cast<const uint32_t *>(&kind[k]))) == int32_t(what));
    }
};

// Places in a box, in steps of its longest side / 65535; normals by two coordinates on an octahedron (Meyer et al., "On
// Floating-Point Normal Vectors", 2010); weights in steps of 1 / 127; a kind, and the bend in half octaves, from 2^-31
// on.
struct RoundedLeaf {
    static constexpr float Places = 65535, Normals = 32767, Weights = 127;
    float corner[3], step;
    OutlineColumn<uint16_t> a[3], b[3];
    OutlineColumn<int16_t> n0[2], n1[2];
    OutlineColumn<int8_t> weight;
    OutlineColumn<uint8_t> kind;
    OutlineColumn<int32_t> index;

    // Of a bend its exponent and the first bit behind it, from 0 to 62 for numbers up to 1.
    static constexpr uint32_t BendShift = 22, LeastBend = (127 - 31) << 1;
};

// How far a normal is off across its length, at most, and a place; below zero: not at all.
struct LeafRounding {
    float normal, place;
};

// A packet of integers as floating point.
#if TR_HAS_PACKETS && defined(DRJIT_X86_AVX512)
TR_INLINE PacketOf<float> whole_numbers(const uint16_t *at) {
    return PacketOf<float>(
        _mm512_cvtepi32_ps(_mm512_cvtepu16_epi32(_mm256_loadu_si256(reinterpret_cast<const __m256i *>(at)))));
}
TR_INLINE PacketOf<float> whole_numbers(const int16_t *at) {
    return PacketOf<float>(
        _mm512_cvtepi32_ps(_mm512_cvtepi16_epi32(_mm256_loadu_si256(reinterpret_cast<const __m256i *>(at)))));
}
#else
template <class T>
TR_INLINE PacketOf<float> whole_numbers(const T *at) {
    using F = PacketOf<float>;
    constexpr size_t W = size_t(Lanes<F>::Width);
    alignas(64) float all[W];
    for (size_t k = 0; k < W; ++k) all[k] = float(int32_t(at[k]));
    return load<F>(&all[0]);
}
#endif

// The middle of the bends that are packed so.
TR_HD inline float unpacked_bend(uint32_t packed) {
    const uint32_t bits =
        packed == 0 ? 0
                    : (packed + RoundedLeaf::LeastBend) << RoundedLeaf::BendShift | 1u << (RoundedLeaf::BendShift - 1);
    float bend;
    std::memcpy(&bend, &bits, sizeof(bend));
    return bend;
}

TR_HD inline void unpack(const RoundedLeaf &from, OutlineLeaf &to, LeafRounding &rounding) {
    using F = PacketOf<float>;
    constexpr size_t W = size_t(Lanes<F>::Width);
    constexpr float Normals = RoundedLeaf::Normals;
    // half a step of x and of y, and what both make of z, for a vector that is not longer than 1; half a step of each
    // coordinate, and what sums in single precision leave out
    const float far =
        std::max(std::max(std::fabs(from.corner[0]), std::fabs(from.corner[1])), std::fabs(from.corner[2]));
    rounding = {1.4f / Normals, from.step + 1.2e-7f * far};
    const F step(from.step);
    for (size_t i = 0; i < OutlineWide; i += W) {
        for (size_t c = 0; c < 3; ++c) {
            const F corner(from.corner[c]);
            store(&to.a[c][i], corner + whole_numbers(&from.a[c][i]) * step);
            store(&to.b[c][i], corner + whole_numbers(&from.b[c][i]) * step);
        }
        auto unfold = [&](const OutlineColumn<int16_t>(&n)[2], OutlineColumn<float>(&r)[3]) {
            const F x = whole_numbers(&n[0][i]) * F(1 / Normals), y = whole_numbers(&n[1][i]) * F(1 / Normals);
            const F z = F(1) - abs(x) - abs(y), below = max(F(0), -z);
            store(&r[0][i], x + select(mask<F>(x < F(0)), below, -below));
            store(&r[1][i], y + select(mask<F>(y < F(0)), below, -below));
            store(&r[2][i], z);
        };
        unfold(from.n0, to.n0), unfold(from.n1, to.n1);
    }
    for (size_t k = 0; k < OutlineWide; ++k) to.weight[k] = float(from.weight[k]) * (1 / RoundedLeaf::Weights);
    for (size_t k = 0; k < OutlineWide; ++k) to.bend[k] = unpacked_bend(from.kind[k] & 63u);
    for (size_t k = 0; k < OutlineWide; ++k) to.kind[k] = from.kind[k] >> 6;
    for (size_t k = 0; k < OutlineWide; ++k) to.shape[k] = -2, to.index[k] = from.index[k];
}

// All leaves: first those that are kept as they are.
struct OutlineLeaves {
    const OutlineLeaf *exact;
    const RoundedLeaf *rounded;
    uint32_t n_exact, n_rounded;

    TR_HD size_t size() const { return size_t(n_exact) + n_rounded; }
    // `space` if it is rounded.
    TR_HD const OutlineLeaf &get(size_t leaf, OutlineLeaf &space, LeafRounding &rounding) const {
        rounding = {-1, -1};
        if (leaf < n_exact) return exact[leaf];
        unpack(rounded[leaf - n_exact], space, rounding);
        return space;
    }
    // Begins to load one.
    TR_HD void prefetch(size_t leaf) const {
#if !defined(__CUDA_ARCH__)
        const char *at = leaf < n_exact ? reinterpret_cast<const char *>(&exact[leaf])
                                        : reinterpret_cast<const char *>(&rounded[leaf - n_exact]);
        for (size_t k = 0; k < (leaf < n_exact ? sizeof(OutlineLeaf) : sizeof(RoundedLeaf)); k += 64)
            __builtin_prefetch(at + k);
#endif
    }
    TR_HD int32_t index(size_t leaf, size_t k) const {
        return leaf < n_exact ? exact[leaf].index[k] : rounded[leaf - n_exact].index[k];
    }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(exact), visit(rounded);
    }
};

}  // namespace tr
