#include "embree_queries.h"

#include <algorithm>
#include <cstring>
#include <limits>

#include "packet_io.h"

namespace tr {

namespace {

// Loads W rays, or as many as are left, and decides which take part. Returns false if none does.
template <int W>
bool load_rays(const RayBatch &rays, size_t begin, size_t n, rtc::Ray<W> &ray, int *valid) {
    size_t count = std::min<size_t>(W, n - begin);
    if (count < W) std::memset(&ray, 0, sizeof(ray));
    auto load = [&](float *to, const float *from) { copy_some<W>(to, from + begin, count); };
    load(ray.org_x, rays.o[0]);
    load(ray.org_y, rays.o[1]);
    load(ray.org_z, rays.o[2]);
    load(ray.dir_x, rays.d[0]);
    load(ray.dir_y, rays.d[1]);
    load(ray.dir_z, rays.d[2]);
    load(ray.tfar, rays.tmax);
    int any = 0;
    for (int i = 0; i < W; ++i) {
        float d2 = ray.dir_x[i] * ray.dir_x[i] + ray.dir_y[i] * ray.dir_y[i] + ray.dir_z[i] * ray.dir_z[i];
        float o = ray.org_x[i] + ray.org_y[i] + ray.org_z[i];
        // an origin that is not finite makes o - o NaN
        int ok = int(d2 > 0) & int(d2 <= std::numeric_limits<float>::max()) & int(o - o == 0) & int(ray.tfar[i] >= 0);
        valid[i] = -ok;
        any |= ok;
        ray.tnear[i] = ray.time[i] = 0;
        ray.mask[i] = 0xffffffffu;
        ray.id[i] = ray.flags[i] = 0;
    }
    return any != 0;
}

// Rays along an axis but for rounding: packets that Embree is told are similar lose some of them, where such numbers
// have different signs (Embree 4.3). Along the axis itself they are as good.
template <int W>
void straighten(rtc::Ray<W> &ray) {
    for (int i = 0; i < W; ++i) {
        const float x = ray.dir_x[i], y = ray.dir_y[i], z = ray.dir_z[i], small = 1e-12f * (x * x + y * y + z * z);
        ray.dir_x[i] = x * x < 1e-12f * small ? 0 : x;
        ray.dir_y[i] = y * y < 1e-12f * small ? 0 : y;
        ray.dir_z[i] = z * z < 1e-12f * small ? 0 : z;
    }
}

template <int W>
void intersect_width(const rtc::Api &api, rtc::Scene scene, const RayBatch &rays, const HitBatch &hits, size_t n,
                     bool coherent) {
    rtc::QueryArguments arguments;
    arguments.flags = coherent ? rtc::QueryCoherent : rtc::QueryIncoherent;
    alignas(64) int valid[W];
    rtc::RayHit<W> q;
    for (size_t begin = 0; begin < n; begin += W) {
        bool any = load_rays<W>(rays, begin, n, q.ray, valid);
        if (coherent) straighten(q.ray);
        for (int i = 0; i < W; ++i) {
            q.hit.geometry[i] = q.hit.instance[i] = rtc::InvalidGeometry;
            q.hit.primitive[i] = 0;
            q.hit.u[i] = q.hit.v[i] = 0;
        }
        if (any) api.intersect<W>(valid, scene, q, arguments);
        size_t count = std::min<size_t>(W, n - begin);
        copy_some<W>(hits.shape + begin, q.hit.geometry, count);
        copy_some<W>(hits.primitive + begin, q.hit.primitive, count);
        copy_some<W>(hits.t + begin, q.ray.tfar, count);
        copy_some<W>(hits.b1 + begin, q.hit.u, count);
        copy_some<W>(hits.b2 + begin, q.hit.v, count);
    }
}

template <int W>
void occluded_width(const rtc::Api &api, rtc::Scene scene, const RayBatch &rays, uint8_t *hit, size_t n) {
    rtc::QueryArguments arguments;
    alignas(64) int valid[W];
    rtc::Ray<W> ray;
    for (size_t begin = 0; begin < n; begin += W) {
        if (load_rays<W>(rays, begin, n, ray, valid)) api.occluded<W>(valid, scene, ray, arguments);
        size_t count = std::min<size_t>(W, n - begin);
        for (size_t i = 0; i < count; ++i) hit[begin + i] = uint8_t(valid[i] != 0 && ray.tfar[i] < 0);
    }
}

}  // namespace

void intersect_embree(const rtc::Api &api, rtc::Scene scene, int width, const RayBatch &rays, const HitBatch &hits,
                      size_t n, bool coherent) {
    switch (width) {
        case 16:
            return intersect_width<16>(api, scene, rays, hits, n, coherent);
        case 8:
            return intersect_width<8>(api, scene, rays, hits, n, coherent);
        case 4:
            return intersect_width<4>(api, scene, rays, hits, n, coherent);
        default:
            return intersect_width<1>(api, scene, rays, hits, n, coherent);
    }
}

void occluded_embree(const rtc::Api &api, rtc::Scene scene, int width, const RayBatch &rays, uint8_t *hit, size_t n) {
    switch (width) {
        case 16:
            return occluded_width<16>(api, scene, rays, hit, n);
        case 8:
            return occluded_width<8>(api, scene, rays, hit, n);
        case 4:
            return occluded_width<4>(api, scene, rays, hit, n);
        default:
            return occluded_width<1>(api, scene, rays, hit, n);
    }
}

}  // namespace tr
