#include "height_field.h"

namespace tr {

namespace {

using F = PacketIo::F;
using U = PacketIo::U;
using M = PacketIo::M;
constexpr size_t W = PacketIo::W;

}  // namespace

template <bool Occlusion>
M HeightField::walk(const PacketIo::Rays &rays, F &t, F &u, F &v) const {
    const Vec3<F> o = transform_point(to_object_, rays.o), d = transform_vector(to_object_, rays.d);
    return table_.linear ? walk_heights<2, Occlusion>(table_, o, d, rays.tmax, rays.valid, t, u, v)
                         : walk_heights<4, Occlusion>(table_, o, d, rays.tmax, rays.valid, t, u, v);
}

void HeightField::intersect(const RayBatch &rays, const HitBatch &hits, size_t n) const {
    for (size_t i = 0; i < n; i += W) {
        size_t left = n - i;
        PacketIo::Rays r(rays, i, left);
        F t = r.tmax, u(0), v(0);
        M hit = walk<false>(r, t, u, v);
        PacketIo::store_some(hits.shape + i, select(mask<U>(hit), U(shape_), U(Accel::Miss)), left);
        PacketIo::store_some(hits.primitive + i, U(0u), left);
        PacketIo::store_some(hits.t + i, t, left);
        PacketIo::store_some(hits.b1 + i, u, left);
        PacketIo::store_some(hits.b2 + i, v, left);
    }
}

void HeightField::occluded(const RayBatch &rays, uint8_t *hit, size_t n) const {
    for (size_t i = 0; i < n; i += W) {
        size_t left = std::min(W, n - i);
        PacketIo::Rays r(rays, i, left);
        F t, u, v;
        M found = PacketIo::first(left) && walk<true>(r, t, u, v);
        alignas(64) uint32_t blocked[W];
        store(&blocked[0], select(mask<U>(found), U(1u), U(0u)));
        for (size_t k = 0; k < left; ++k) hit[i + k] = uint8_t(blocked[k]);
    }
}

float HeightField::set_heights(uint32_t shape, const float *heights, int rows, int columns, bool linear) {
    shape_ = shape;
    ranges_.set(heights, rows, columns);
    table_ = ranges_.table(heights, rows, columns, linear);
    set_bounds();
    return table_.largest;
}

void HeightField::set_matrices(const float to_world[12], const float to_object[12]) {
    std::copy_n(to_world, 12, to_world_);
    std::copy_n(to_object, 12, to_object_);
    set_bounds();
}

void HeightField::set_bounds() {
    bounds_ = Box{};
    height_box(to_world_, table_.range, bounds_.lower, bounds_.upper);
}

}  // namespace tr
