// What a batch of paths has on a device: the samples of it, and what of these the host knows.
#pragma once

#include <algorithm>
#include <vector>

#include "device/film_kernels.h"
#include "device/launcher.h"
#include "device/medium_kernels.h"

namespace tr {

// Zeros.
template <class T>
void clear(Launcher &launcher, T *array, size_t n) {
    static_assert(sizeof(T) % 4 == 0);
    constexpr size_t words = sizeof(T) / 4, part = size_t(1) << 30;
    for (size_t i = 0; i < n * words; i += part)
        launcher.run(FillWords{reinterpret_cast<uint32_t *>(array) + i, 0}, uint32_t(std::min(part, n * words - i)));
}

// What paths have besides those that light goes straight in: through media, and from lights.
struct BatchParts {
    bool media = false, light = false;

    bool operator==(const BatchParts &o) const { return media == o.media && light == o.light; }
};

// By sample or by entry of a queue: an array of device memory each.
template <class S>
struct BatchColumns {
    SlotColumns<S> slots{};
    LostColumns lost{};
    PathQueue<S> queues[3]{};  // the first has the camera's rays
    HitColumns<S> hits{};
    ShadowQueue<S> shadows{};
    int32_t *key, *out_key, *shadow_key;                       // of hits, and of what goes on from them
    uint32_t *camera_rays, *live_rays, *sorted, *shadow_rays;  // lists of entries
    FlightColumns<S> flight{};
    BranchColumns<S> branch{};
    TransmittanceColumns<S> transmittance{};

    // visit(array, how many numbers it has for a path)
    template <class Each>
    void for_arrays(const BatchParts &parts, Each &&each_array) {
        const uint32_t shadows_of_path = parts.media ? MostShadows : 1;
        auto visit = [&](auto *&array) { each_array(array, 1u); };
        auto visit_shadows = [&](auto *&array) { each_array(array, shadows_of_path); };
        auto each = [&](auto &...column) { (column.each(visit), ...); };
#define TR_VISIT(type, name) each(of.name);
        auto of_samples = [&](auto &of) { TR_SAMPLE_COLUMNS(TR_VISIT) };
        auto of_paths = [&](auto &of) { TR_PATH_COLUMNS(TR_VISIT) };
        auto of_paths_in_media = [&](auto &of) { TR_PATH_MEDIUM_COLUMNS(TR_VISIT) };
#undef TR_VISIT
#define TR_VISIT(type, name) of.name.each(visit_shadows);
        auto of_shadows = [&](auto &of) { TR_SHADOW_COLUMNS(TR_VISIT) TR_SHADOW_VALUE_COLUMNS(TR_VISIT) };
        auto of_shadows_in_media = [&](auto &of) { TR_SHADOW_MEDIUM_COLUMNS(TR_VISIT) };
        auto of_connections = [&](auto &of) { TR_SHADOW_FILM_COLUMNS(TR_VISIT) };
#undef TR_VISIT
        of_samples(slots), each(slots.delta, slots.radiance, slots.alpha);
        visit(lost.count), visit(lost.culprit), visit(lost.index);
        for (auto &queue : queues) of_paths(queue);
        hits.for_arrays(visit), of_shadows(shadows);
        visit(key), visit(out_key), visit_shadows(shadow_key);
        visit(camera_rays), visit(live_rays), visit(sorted), visit_shadows(shadow_rays);
        if (parts.light) of_connections(shadows);
        if (!parts.media) return;
        for (auto &queue : queues) of_paths_in_media(queue);
        of_shadows_in_media(shadows), transmittance.for_arrays(visit_shadows);
        flight.for_arrays(visit);
        each(branch.hero, branch.level, branch.entry, branch.total_weight, branch.p, branch.d, branch.medium,
             branch.depth, branch.beta, branch.channel, branch.radiance, branch.factor);
    }
};

// The samples of a batch.
struct SampleNumbers {
    uint32_t size = 0;
    std::vector<FilmUnit> units;
    std::vector<OwnSamples> own;  // of their pixels, if they have some
};

}  // namespace tr
