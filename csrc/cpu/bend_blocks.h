// Where in a grid of voxels surfaces may be: blocks of voxels, a bit each, so that rays that bend ask for the nearest
// surface only there.
#pragma once

#include <array>
#include <vector>

#include "core/medium/bend.h"
#include "core/scene.h"

namespace tr {

class BendBlocks {
public:
    static constexpr int Bits = 2;  // blocks of 4 voxels along a side

    // Of a scene's surfaces those that are within `reach` voxels of a block, and perhaps more; `to_world`: from voxels,
    // 3 rows of 4.
    template <class S>
    BendBlocks(const SceneView<S> &scene, const int32_t (&n)[3], const S *to_world, double reach);

    // Whether there may be one near a position in the grid.
    template <class F>
    TR_INLINE MaskOf<F> surface_near(const BendState<F> &s, int bits, const MaskOf<F> &active) const {
        using U = UIntOf<F>;
        auto block = [&](int k) { return U(IntOf<F>(s.q[k] >> (bits + Bits))); };
        const U index = (block(2) * uint32_t(n_[1]) + block(1)) * uint32_t(n_[0]) + block(0);
        const U word = gather<U>(words_.data(), index >> 5, mask<U>(active));
        return active && mask<F>(((word >> (index & 31u)) & 1u) != 0u);
    }

private:
    using Point = std::array<double, 3>;
    int32_t n_[3];  // blocks
    double reach_;
    std::vector<uint32_t> words_;

    template <class Keep>
    void mark(const Point &low, const Point &high, Keep &&keep);
    void mark_triangle(const Point &a, const Point &b, const Point &c);
    void mark_box(const Point *corners, size_t n);
    void mark_sphere(const double (&to_object)[12]);
};

}  // namespace tr
