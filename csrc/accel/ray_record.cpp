#include "ray_record.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <string>
#include <thread>

#include "embree_library.h"
#include "packet_io.h"

namespace tr {

namespace {

// Columns of a batch.
struct Columns {
    const float *at[7];
    size_t n;
};

template <int W>
size_t load(const Columns &rays, size_t begin, rtc::Ray<W> &ray, int *valid) {
    float *to[7] = {ray.org_x, ray.org_y, ray.org_z, ray.dir_x, ray.dir_y, ray.dir_z, ray.tfar};
    size_t count = std::min<size_t>(W, rays.n - begin);
    for (int k = 0; k < 7; ++k) copy_some<W>(to[k], rays.at[k] + begin, count);
    for (int i = 0; i < W; ++i) {
        valid[i] = size_t(i) < count ? -1 : 0;
        ray.tnear[i] = ray.time[i] = 0;
        ray.mask[i] = 0xffffffffu;
        ray.id[i] = ray.flags[i] = 0;
    }
    return count;
}

template <int W>
uint64_t closest(const rtc::Api &api, rtc::Scene scene, const Columns &rays, bool coherent) {
    rtc::QueryArguments arguments;
    arguments.flags = coherent ? rtc::QueryCoherent : rtc::QueryIncoherent;
    alignas(64) int valid[W];
    rtc::RayHit<W> q;
    std::memset(&q, 0, sizeof(q));
    uint64_t hits = 0;
    for (size_t begin = 0; begin < rays.n; begin += W) {
        load<W>(rays, begin, q.ray, valid);
        for (int i = 0; i < W; ++i) q.hit.geometry[i] = q.hit.instance[i] = rtc::InvalidGeometry;
        api.intersect<W>(valid, scene, q, arguments);
        for (int i = 0; i < W; ++i) hits += q.hit.geometry[i] != rtc::InvalidGeometry;
    }
    return hits;
}

template <int W>
uint64_t occluded(const rtc::Api &api, rtc::Scene scene, const Columns &rays, bool coherent) {
    rtc::QueryArguments arguments;
    arguments.flags = coherent ? rtc::QueryCoherent : rtc::QueryIncoherent;
    alignas(64) int valid[W];
    rtc::Ray<W> ray;
    std::memset(&ray, 0, sizeof(ray));
    uint64_t hits = 0;
    for (size_t begin = 0; begin < rays.n; begin += W) {
        load<W>(rays, begin, ray, valid);
        api.occluded<W>(valid, scene, ray, arguments);
        for (int i = 0; i < W; ++i) hits += uint64_t(valid[i] != 0 && ray.tfar[i] < 0);
    }
    return hits;
}

template <int W>
uint64_t trace(const EmbreeScene &embree, RayKind kind, const Columns &rays, bool coherent) {
    bool any = kind == RayKind::CameraShadow || kind == RayKind::BounceShadow;
    return any ? occluded<W>(*embree.api, embree.scene, rays, coherent)
               : closest<W>(*embree.api, embree.scene, rays, coherent);
}

using Trace = uint64_t (*)(const EmbreeScene &, RayKind, const Columns &, bool coherent);

Trace trace_of(int width, int widest) {
    if (width <= widest) {
        if (width == 1) return trace<1>;
        if (width == 4) return trace<4>;
        if (width == 8) return trace<8>;
        if (width == 16) return trace<16>;
    }
    throw std::invalid_argument("width: expected 1, 4, 8 or 16, at most " + std::to_string(widest) + ", got " +
                                std::to_string(width));
}

}  // namespace

void RayRecord::add(RayKind kind, const RayBatch &rays, size_t n, size_t hits) {
    const float *from[7] = {rays.o[0], rays.o[1], rays.o[2], rays.d[0], rays.d[1], rays.d[2], rays.tmax};
    std::lock_guard<std::mutex> lock(mutex_);
    Rays &to = rays_[int(kind)];
    if (to.counts.rays + n > limit_) {
        to.counts.left_out += n;
        return;
    }
    to.begin.push_back(to.column[0].size());
    for (size_t i = 0; i < n; ++i) {
        float d2 = 0, sum = 0;
        for (int k = 0; k < 3; ++k) {
            d2 += from[3 + k][i] * from[3 + k][i];
            sum += from[k][i];
        }
        if (!(d2 > 0 && std::isfinite(d2) && std::isfinite(sum) && from[6][i] >= 0)) continue;
        for (int k = 0; k < 7; ++k) to.column[k].push_back(from[k][i]);
    }
    to.counts.rays = to.column[0].size();
    to.counts.hits += hits;
}

RayRecord::Counts RayRecord::counts(RayKind kind) const {
    std::lock_guard<std::mutex> lock(mutex_);
    return rays_[int(kind)].counts;
}

RayRecord::Replay RayRecord::replay(const Accel &accel, RayKind kind, int width, bool coherent, int threads,
                                    int rounds) const {
    std::lock_guard<std::mutex> lock(mutex_);
    const Rays &rays = rays_[int(kind)];
    const EmbreeScene embree = accel.embree();
    const Trace trace = trace_of(width, embree.widest_query);
    Replay result;
    for (int round = 0; round < rounds; ++round) {
        std::atomic<size_t> next{0};
        std::atomic<uint64_t> hits{0};
        auto work = [&] {
            uint64_t found = 0;
            for (size_t b = next++; b < rays.begin.size(); b = next++) {
                size_t begin = rays.begin[b];
                Columns columns;
                columns.n = (b + 1 < rays.begin.size() ? rays.begin[b + 1] : rays.column[0].size()) - begin;
                for (int k = 0; k < 7; ++k) columns.at[k] = rays.column[k].data() + begin;
                found += trace(embree, kind, columns, coherent);
            }
            hits += found;
        };
        auto start = std::chrono::steady_clock::now();
        std::vector<std::thread> others;
        for (int t = 1; t < threads; ++t) others.emplace_back(work);
        work();
        for (std::thread &t : others) t.join();
        result.seconds.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
        result.hits = hits;
    }
    return result;
}

}  // namespace tr
