// What one call of DevicePaths is about, and how it goes through batches of samples: for its own files alone.
#pragma once

#include <algorithm>
#include <chrono>
#include <utility>
#include <vector>

#include "allocation.h"
#include "device_paths.h"
#include "work_items.h"

namespace tr {

template <class S>
struct DevicePaths<S>::Work : DeviceCall<S> {
    using DeviceCall<S>::call;
    const TileSchedule &schedule;
    ListedPixels list{};
    std::vector<TileList> lists{1};  // by tile; one for all where there is no list
    int64_t n_paths = 0;
    size_t batch = 0;  // paths of one at most
    std::chrono::steady_clock::time_point begun = std::chrono::steady_clock::now();

    double seconds() const { return std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count(); }

    // Wanted pixels that the units of a batch may reach: the first of them, and how many.
    std::pair<uint32_t, uint32_t> targets(const std::vector<FilmUnit> &units) const {
        if (call.pixels) return {0, uint32_t(schedule.n_targets())};
        const Rect &wanted = schedule.rect();
        int y0 = wanted.y1, y1 = wanted.y0;
        for (const FilmUnit &unit : units) y0 = std::min(y0, unit.rect.y0), y1 = std::max(y1, unit.rect.y1);
        y0 = std::max(wanted.y0, y0 - call.filter.reach()), y1 = std::min(wanted.y1, y1 + call.filter.reach());
        const auto width = uint32_t(wanted.width());
        return {uint32_t(y0 - wanted.y0) * width, uint32_t(std::max(0, y1 - y0)) * width};
    }
};

// Of a unit's pixels, if they have numbers of samples of their own, and behind them.
template <class S>
std::vector<OwnSamples> DevicePaths<S>::own_samples(const Work &work, const WorkItem &units, size_t unit,
                                                    const Tile &tile) {
    std::vector<OwnSamples> r;
    if (!tile.counts) return r;
    uint32_t n = 0;
    for (size_t p = 0; p < tile.n; ++p) {
        const auto [first, last] = work.schedule.samples(units, unit, tile, p);
        const double weight = double(work.schedule.spp()) / double(std::max(1u, tile.counts[p]));
        r.push_back({n, uint32_t(work.call.sample_offset + first), weight});
        n += uint32_t(last - first);
    }
    r.push_back({n, 0, 0});
    return r;
}

// Calls body(batch) for batches of samples, in the schedule's order, until it is interrupted. `silent`: they are no
// share of what somebody waits for.
template <class S>
template <class Body>
void DevicePaths<S>::for_batches(const Work &work, RenderStats &stats, bool silent, Body &&body) {
    const RenderCall<S> &call = work.call;
    SampleNumbers batch;
    int64_t done = 0;
    const auto finish = [&] {
        body(batch);
        launcher_.synchronize();
        done += silent ? 0 : int64_t(batch.size);
        stats.seconds = work.seconds();
        stats.interrupted = call.interrupted && call.interrupted(double(done) / double(work.n_paths));
    };
    for (size_t item = 0; item < work.schedule.n_items(); ++item) {
        const WorkItem units = work.schedule.work_item(item);
        for (size_t u = 0; u < units.size(); ++u) {
            const size_t number = units.tile_of(u);
            const Tile tile = work.schedule.tile(number);
            const auto [first, last] = work.schedule.samples(units, u, tile, 0);
            const std::vector<OwnSamples> own = own_samples(work, units, u, tile);
            const int64_t samples = own.empty() ? int64_t(tile.n) * (last - first) : int64_t(own.back().offset);
            for (int64_t taken = 0; taken < samples;) {
                if (batch.size == work.batch) {
                    finish();
                    if (stats.interrupted) return;
                    batch = {};
                }
                const int64_t taking = std::min(int64_t(work.batch) - int64_t(batch.size), samples - taken);
                const TileList &at = work.lists[work.call.pixels ? number : 0];
                batch.units.push_back({tile.sampled, int32_t(int64_t(batch.size) - taken), at.pixel, at.place,
                                       uint32_t(last - first), uint32_t(call.sample_offset + first),
                                       uint32_t(batch.own.size()), uint32_t(tile.n), taken == 0,
                                       taken + taking == samples});
                batch.own.insert(batch.own.end(), own.begin(), own.end());
                taken += taking, batch.size += uint32_t(taking);
            }
        }
    }
    if (!batch.units.empty()) finish();
}

// Calls f(work, stats), which writes nothing before all is computed.
template <class S>
template <class Do>
RenderStats DevicePaths<S>::run(const RenderCall<S> &call, const SceneData<S> &data, const TreeView &tree,
                                const DerivativeCall<S> *derivative, int channels, Do &&f) {
    check(call);
    TileSchedule schedule = make_schedule(call);
    if (derivative && derivative->adaptive && channels == Radiance)
        allocate(schedule, call.filter, derivative->adjoint, call.values);
    return with_memory(
        launcher_, memory_, [&] { release(); },
        [&] {
            RenderStats stats;
            Work work = begin(call, data, tree, schedule, derivative, channels);
            f(work, stats);
            return stats;
        });
}

}  // namespace tr
