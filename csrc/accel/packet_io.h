// Rays of a batch as packets of this build's width.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>

#include "accel.h"
#include "core/math/vector.h"

namespace tr {

// Copies W numbers, or as many as there are. (Of a known size that is two instructions.)
template <int W, class T>
void copy_some(T *to, const T *from, size_t count) {
    if (count >= size_t(W))
        std::memcpy(to, from, W * sizeof(T));
    else
        std::memcpy(to, from, count * sizeof(T));
}

struct PacketIo {
#if TR_HAS_PACKETS
    using F = FloatPacket;
#else
    using F = float;
#endif
    using U = UIntOf<F>;
    using M = MaskOf<F>;
    static constexpr size_t W = size_t(Lanes<F>::Width);

    static M first(size_t count) { return mask<F>(lane_index<F>() < U(uint32_t(std::min(count, W)))); }

    // W numbers, or as many as are left.
    static F load_some(const float *p, size_t count) {
        if (count >= W) return load<F>(p);
        alignas(64) float some[W] = {};
        std::memcpy(some, p, count * sizeof(float));
        return load<F>(&some[0]);
    }
    template <class T, class S>
    static void store_some(S *p, const T &x, size_t count) {
        if (count >= W) return store(p, x);
        alignas(64) S some[W];
        store(&some[0], x);
        std::memcpy(p, some, count * sizeof(S));
    }
    // Lanes whose byte is 0.
    static M clear(const uint8_t *p, size_t count) {
        alignas(64) uint32_t wide[W] = {};
        for (size_t k = 0; k < std::min(count, W); ++k) wide[k] = p[k];
        return mask<F>(load_uint<F>(&wide[0]) == 0u);
    }

    struct Rays {
        Vec3<F> o, d;
        F tmax;
        M valid;  // see RayBatch

        Rays(const RayBatch &rays, size_t i, size_t count) {
            o = {load_some(rays.o[0] + i, count), load_some(rays.o[1] + i, count), load_some(rays.o[2] + i, count)};
            d = {load_some(rays.d[0] + i, count), load_some(rays.d[1] + i, count), load_some(rays.d[2] + i, count)};
            tmax = load_some(rays.tmax + i, count);
            F squared = squared_norm(d), finite = o.x + o.y + o.z;
            finite = finite - finite;
            valid = mask<F>(squared > F(0)) && mask<F>(squared <= F(3.4028235e38f)) && mask<F>(finite == F(0)) &&
                    mask<F>(tmax >= F(0));
        }
    };
};

}  // namespace tr
