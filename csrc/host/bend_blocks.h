// Where in a grid of voxels surfaces may be: blocks of voxels, a bit each, so that rays that bend ask for the nearest
// surface only there.
#pragma once

#include <vector>

#include "core/medium/bend_medium.h"

namespace tr {

struct Affine;

class BendBlocks {
public:
    static constexpr int Bits = BendMedium<float>::BlockBits;

    // Of a scene's surfaces those that are within `reach` voxels of a block, and perhaps more; `to_world`: from voxels,
    // 3 rows of 4.
    template <class S>
    BendBlocks(const SceneView<S> &scene, const int32_t (&n)[3], const S *to_world, double reach);

    uint64_t version = 0;  // of the geometry they are of

    const uint32_t *words() const { return words_.data(); }
    const int32_t (&n() const)[3] { return n_; }

private:
    using Point = Vec3<double>;
    struct Box;
    int32_t n_[3];  // blocks
    double reach_;
    std::vector<uint32_t> words_;

    template <class Keep>
    void mark(const Box &box, Keep &&keep);
    void mark_triangle(const Point &a, const Point &b, const Point &c);
    void mark_sphere(const Affine &to_object);
};

}  // namespace tr
