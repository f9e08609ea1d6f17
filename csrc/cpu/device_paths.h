// The path tracer on a device: batches of samples as wavefronts (device/path_kernels.h), which add to a film there. For
// surfaces, in single precision and rgb; light goes straight.
#pragma once

#include "device/device_scene.h"
#include "device/film_kernels.h"
#include "device/path_kernels.h"
#include "device/sort_kernels.h"
#include "render.h"

namespace tr {

// What a batch of paths has, by sample or by entry of a queue: an array of device memory each.
struct BatchColumns {
    SlotColumns<float> slots{};
    LostColumns lost{};
    PathQueue<float> queues[3]{};  // the first has the camera's rays
    HitColumns<float> hits{};
    ShadowQueue<float> shadows{};
    int32_t *key, *out_key, *shadow_key;                       // of hits, and of what goes on from them
    uint32_t *camera_rays, *live_rays, *sorted, *shadow_rays;  // lists of entries

    template <class Visit>
    void for_arrays(Visit &&visit) {
        auto each = [&](auto &...column) { (column.each(visit), ...); };
#define TR_VISIT(type, name) each(of.name);
        auto of_samples = [&](auto &of) { TR_SAMPLE_COLUMNS(TR_VISIT) };
        auto of_paths = [&](auto &of) { TR_PATH_COLUMNS(TR_VISIT) };
        auto of_shadows = [&](auto &of) { TR_SHADOW_COLUMNS(TR_VISIT) TR_SHADOW_VALUE_COLUMNS(TR_VISIT) };
#undef TR_VISIT
        of_samples(slots), each(slots.radiance, slots.alpha);
        visit(lost.count), visit(lost.culprit), visit(lost.index);
        for (auto &queue : queues) of_paths(queue);
        hits.for_arrays(visit), of_shadows(shadows);
        visit(key), visit(out_key), visit(shadow_key);
        visit(camera_rays), visit(live_rays), visit(sorted), visit(shadow_rays);
    }
};

class DevicePaths {
public:
    // The launcher has to live longer. `memory`: bytes for the paths of a batch; scene and film have theirs besides.
    DevicePaths(Launcher &launcher, size_t memory) : launcher_(launcher), memory_(memory) {}
    explicit DevicePaths(Launcher &launcher) : DevicePaths(launcher, launcher.batch_memory()) {}
    DevicePaths(const DevicePaths &) = delete;
    DevicePaths &operator=(const DevicePaths &) = delete;

    // As render_primal: the same samples, summed in the same order. `call.scene` is that of `data`, and `tree` its tree
    // on the device. std::invalid_argument for what is not there, see the beginning.
    RenderStats render(const RenderCall<float> &call, const SceneData<float> &data, const TreeView &tree,
                       const RenderOutput<float> &out);

    // Of `memory` a path takes.
    static size_t bytes_per_path();

private:
    // The samples of a batch as the host numbers them, and where the film finds them.
    struct Batch {
        uint32_t size = 0;
        std::vector<SampledPixel> pixels;
        std::vector<FilmUnit> units;
        std::vector<FilmSpan> spans;
    };
    // What one call of render is about.
    struct Work;

    Launcher &launcher_;
    const size_t memory_;
    DeviceScene scene_;
    size_t capacity_ = 0;  // paths of a batch
    BatchColumns at_{};
    std::vector<DeviceArray<uint32_t>> arrays_;  // of it
    EntryList camera_{}, live_{}, sorted_{}, lit_{};
    DeviceArray<uint32_t> lengths_;  // of these lists
    DeviceArray<uint32_t> counts_, begin_, total_, begin_of_one_, total_of_one_;
    DeviceArray<int32_t> kinds_, targets_;
    DeviceArray<uint64_t> totals_;  // closest hits, shadow rays, values that are not finite
    DeviceArray<double> sums_, open_;
    DeviceArray<SampledPixel> pixels_;
    DeviceArray<FilmUnit> units_;
    DeviceArray<FilmSpan> spans_;

    void reserve(size_t n);
    template <class T>
    void clear(T *array, size_t n);
    template <class Body>
    static void for_batches(const RenderCall<float> &call, const TileSchedule &schedule, size_t size, Body &&body);
    void sort(const int32_t *key, const EntryList *from, const uint32_t *n, const EntryList &to, bool by_kind,
              uint32_t launched);
    void run_batch(const Work &work, const Batch &batch);
    void trace_paths(const Work &work, uint32_t n);
    void trace_hits(const Work &work, const PathQueue<float> &queue, const EntryList &rays, bool passes, uint32_t n);
    void step(const Work &work, const PathStep &at, PathQueue<float> &in, const EntryList &rays,
              const PathQueue<float> &out, uint32_t n);
    bool nothing_left() const;
    void count_lost(RenderStats &stats) const;
};

}  // namespace tr
