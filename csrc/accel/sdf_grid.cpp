#include "sdf_grid.h"

namespace tr {

namespace {

using F = PacketIo::F;
using U = PacketIo::U;
using M = PacketIo::M;
constexpr size_t W = PacketIo::W;

}  // namespace

template <bool Occlusion>
M SdfGrid::walk(const PacketIo::Rays &rays, SdfFound<F> &found) const {
    const Vec3<F> o = transform_point(to_object_, rays.o), d = transform_vector(to_object_, rays.d);
    return walk_sdf<Occlusion>(blocks_.table(), o, d, rays.tmax, rays.valid, found);
}

void SdfGrid::intersect(const RayBatch &rays, const HitBatch &hits, size_t n) const {
    for (size_t i = 0; i < n; i += W) {
        size_t left = n - i;
        PacketIo::Rays r(rays, i, left);
        SdfFound<F> found{r.tmax, F(0), F(0), U(0u)};
        M hit = walk<false>(r, found);
        PacketIo::store_some(hits.shape + i, select(mask<U>(hit), U(shape_), U(Accel::Miss)), left);
        PacketIo::store_some(hits.primitive + i, found.primitive, left);
        PacketIo::store_some(hits.t + i, found.t, left);
        PacketIo::store_some(hits.b1 + i, found.b1, left);
        PacketIo::store_some(hits.b2 + i, found.b2, left);
    }
}

void SdfGrid::occluded(const RayBatch &rays, uint8_t *hit, size_t n) const {
    for (size_t i = 0; i < n; i += W) {
        size_t left = std::min(W, n - i);
        PacketIo::Rays r(rays, i, left);
        SdfFound<F> none{};
        M found = PacketIo::first(left) && walk<true>(r, none);
        alignas(64) uint32_t blocked[W];
        store(&blocked[0], select(mask<U>(found), U(1u), U(0u)));
        for (size_t k = 0; k < left; ++k) hit[i + k] = uint8_t(blocked[k]);
    }
}

float SdfGrid::set_values(uint32_t shape, const float *values, const std::array<int32_t, 3> &n) {
    shape_ = shape;
    const float largest = blocks_.set(values, n);
    set_bounds();
    return largest;
}

void SdfGrid::set_matrices(const float to_world[12], const float to_object[12]) {
    std::copy_n(to_world, 12, to_world_);
    std::copy_n(to_object, 12, to_object_);
    set_bounds();
}

void SdfGrid::set_bounds() {
    bounds_ = Box{};
    sdf_box(to_world_, blocks_.table(), bounds_.lower, bounds_.upper);
}

}  // namespace tr
