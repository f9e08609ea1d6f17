// The rays of a batch that come near a box, one after the other: what lies in the box need not hear of the others, and
// queries of packets are full.
#pragma once

#include "packet_io.h"

namespace tr {

struct Box {
    float lower[3] = {INFINITY, INFINITY, INFINITY}, upper[3] = {-INFINITY, -INFINITY, -INFINITY};
    bool empty() const { return !(lower[0] <= upper[0]); }
    float half_area() const {
        if (empty()) return 0;
        float x = upper[0] - lower[0], y = upper[1] - lower[1], z = upper[2] - lower[2];
        return x * y + y * z + z * x;
    }
    template <class P>
    void include(const P *point) {
        for (int k = 0; k < 3; ++k) {
            lower[k] = point[k] < lower[k] ? float(point[k]) : lower[k];
            upper[k] = point[k] > upper[k] ? float(point[k]) : upper[k];
        }
    }
};

class NearRays {
    static constexpr size_t W = PacketIo::W;

public:
    static constexpr size_t Capacity = 512;
    size_t n = 0;
    alignas(64) float column[7][Capacity + W];
    alignas(64) uint32_t index[Capacity + W];  // in the batch
    // room for their hits
    alignas(64) uint32_t shape[Capacity], primitive[Capacity];
    alignas(64) float t[Capacity], b1[Capacity], b2[Capacity];
    uint8_t occluded[Capacity];

    RayBatch rays() const { return {{column[0], column[1], column[2]}, {column[3], column[4], column[5]}, column[6]}; }
    HitBatch hits() { return {shape, primitive, t, b1, b2}; }

    // Takes those of the rays begin .. begin + Capacity (at most n_rays); `skip`, if not null: not those.
    void take(const RayBatch &rays, size_t begin, size_t n_rays, const uint8_t *skip, const Box &box) {
        using F = PacketIo::F;
        n = 0;
        size_t end = n_rays - begin < Capacity ? n_rays : begin + Capacity;
        float extent = 0;
        for (int k = 0; k < 3; ++k) extent = std::max(extent, box.upper[k] - box.lower[k]);
        Vec3<F> lower = corner(box.lower, -extent), upper = corner(box.upper, extent);
        for (size_t i = begin; i < end; i += W) {
            size_t left = end - i;
            PacketIo::Rays r(rays, i, left);
            // a coordinate of the direction that is 0 gives infinities, or NaN on a side of the box, which counts as
            // inside
            Vec3<F> inverse{F(1) / r.d.x, F(1) / r.d.y, F(1) / r.d.z};
            F enter(0), leave = r.tmax;
            clip(r.o.x, inverse.x, lower.x, upper.x, enter, leave);
            clip(r.o.y, inverse.y, lower.y, upper.y, enter, leave);
            clip(r.o.z, inverse.z, lower.z, upper.z, enter, leave);
            MaskOf<F> near = r.valid && !mask<F>(enter > leave) && PacketIo::first(left);
            if (skip) near = near && PacketIo::clear(skip + i, left);
            if (!any(near)) continue;
            const F *numbers[7] = {&r.o.x, &r.o.y, &r.o.z, &r.d.x, &r.d.y, &r.d.z, &r.tmax};
            for (int k = 0; k < 7; ++k) store_compressed<F>(column[k] + n, *numbers[k], near);
            store_compressed<F>(index + n, UIntOf<F>(uint32_t(i)) + lane_index<F>(), near);
            n += size_t(count(near));
        }
    }

private:
    using F = PacketIo::F;
    // A little outwards, whose sign `extent` has: rounding must not lose a ray.
    static Vec3<F> corner(const float *x, float extent) {
        float r[3];
        for (int k = 0; k < 3; ++k) r[k] = x[k] + 1e-5f * (std::copysign(x[k], extent) + extent);
        return {F(r[0]), F(r[1]), F(r[2])};
    }
    TR_INLINE static void clip(const F &o, const F &inverse, const F &lower, const F &upper, F &enter, F &leave) {
        F a = (lower - o) * inverse, b = (upper - o) * inverse;
        MaskOf<F> back = mask<F>(inverse < F(0));
        F near = select(back, b, a), far = select(back, a, b);
        enter = select(mask<F>(near > enter), near, enter);
        leave = select(mask<F>(far < leave), far, leave);
    }
};

}  // namespace tr
