// Leaves of an OutlineTree: sixteen elements each, as they are; or edges alone, rounded to 27 bytes each, of which
// large scenes have many. Rounding makes no derivative wrong: it changes how often an edge is chosen, and an edge that
// may be an outline within it can be chosen.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/math/vector.h"

namespace tr {

// A vector in three columns.
template <class T>
Vec3<float> lane_of(const T &columns, size_t k) {
    return {columns[0][k], columns[1][k], columns[2][k]};
}
template <class T>
void put_lane(const Vec3<float> &v, T &columns, size_t k) {
    columns[0][k] = v.x, columns[1][k] = v.y, columns[2][k] = v.z;
}
// ... as many from k on as F has lanes.
template <class F, class T>
Vec3<F> load_vector(const T &columns, size_t k) {
    return {load<F>(&columns[0][k]), load<F>(&columns[1][k]), load<F>(&columns[2][k])};
}
template <class F, class T>
void store_vector(const Vec3<F> &v, T &columns, size_t k) {
    store(&columns[0][k], v.x), store(&columns[1][k], v.y), store(&columns[2][k], v.z);
}

// Of the lanes of a packet.
#if TR_HAS_PACKETS
inline float least_of(const PacketOf<float> &x) { return drjit::min(x); }
inline float greatest_of(const PacketOf<float> &x) { return drjit::max(x); }
inline float sum_of(const PacketOf<float> &x) { return drjit::sum(x); }
#else
inline float least_of(float x) { return x; }
inline float greatest_of(float x) { return x; }
inline float sum_of(float x) { return x; }
#endif

// What can be an outline: a straight edge between `a` and `b` of faces with normals n0 and n1; or, `Round`, a curve
// around `a` with the radius b[0], of the curved shape of number `shape`.
struct OutlineElement {
    enum Kind : int32_t { Edge = 0, Always = 1, Crease = 2, Round = 3 };  // Crease: of an edge, an outline or not
    Vec3<float> a, b, n0, n1;
    float weight, bend;  // not above 1 and 2
    int32_t kind, shape, index;
    bool moves;  // what has a weight
};

class OutlineLeaves {
public:
    static constexpr size_t Wide = 16;
    template <class T>
    using Column = T[Wide];
    struct Box {
        Vec3<float> low, high;
    };
    struct alignas(64) Elements {                              // of a leaf
        Column<float> a[3], b[3], n0[3], n1[3], weight, bend;  // a weight below zero: it rests
        Column<int32_t> kind, shape, index;

        void set(size_t k, const OutlineElement &element);
        OutlineElement get(size_t k) const;
        // Which of as many elements from k on as F has lanes are of a kind.
        template <class F>
        TR_INLINE MaskOf<F> are(OutlineElement::Kind what, size_t k) const {
            return mask<F>(IntOf<F>(load_uint<F>(reinterpret_cast<const uint32_t *>(&kind[k]))) == int32_t(what));
        }
        // Around what has a weight; upside down, if nothing has.
        Box box() const;
    };
    // How far a normal is off across its length, at most, and a place; below zero: not at all.
    struct Rounding {
        float normal, place;
    };

    // Leaves for n elements that are kept as they are, then for n edges that are rounded.
    void resize(size_t n_elements, size_t n_rounded);
    size_t size() const { return exact_.size() + rounded_.size(); }
    size_t n_exact() const { return exact_.size(); }
    // `box`: that of the elements.
    void set(size_t leaf, const Elements &elements, const Box &box);

    // Those of a leaf, `space` if they are rounded.
    const Elements &get(size_t leaf, Elements &space, Rounding &rounding) const {
        rounding = {-1, -1};
        if (leaf < exact_.size()) return exact_[leaf];
        unpack(rounded_[leaf - exact_.size()], space, rounding);
        return space;
    }
    // Begins to load a leaf.
    void prefetch(size_t leaf) const {
        const char *at = leaf < exact_.size() ? reinterpret_cast<const char *>(&exact_[leaf])
                                              : reinterpret_cast<const char *>(&rounded_[leaf - exact_.size()]);
        for (size_t k = 0; k < (leaf < exact_.size() ? sizeof(Elements) : sizeof(Rounded)); k += 64)
            __builtin_prefetch(at + k);
    }
    int32_t index(size_t leaf, size_t k) const {
        return leaf < exact_.size() ? exact_[leaf].index[k] : rounded_[leaf - exact_.size()].index[k];
    }

private:
    // Places in a box, in steps of its longest side / 65535; normals by two coordinates on an octahedron (Meyer et al.,
    // "On Floating-Point Normal Vectors", 2010); weights in steps of 1 / 127; a kind, and the bend in half octaves,
    // from 2^-31 on.
    struct Rounded {
        float corner[3], step;
        Column<uint16_t> a[3], b[3];
        Column<int16_t> n0[2], n1[2];
        Column<int8_t> weight;
        Column<uint8_t> kind;
        Column<int32_t> index;
    };
    std::vector<Elements> exact_;
    std::vector<Rounded> rounded_;

    static Rounded pack(const Elements &elements, const Box &box);
    static void unpack(const Rounded &from, Elements &to, Rounding &rounding);
};

}  // namespace tr
