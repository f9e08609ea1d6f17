// A batch of paths on a device, what PathTile is on the CPU: wavefronts of device/path_kernels.h and, of a derivative,
// a tape over which device/derivative_kernels.h runs backwards.
#pragma once

#include <vector>

#include "device/derivative_kernels.h"
#include "device/sort_kernels.h"
#include "device_batch.h"
#include "device_tape.h"
#include "render.h"

namespace tr {

constexpr size_t LeastMemory = size_t(1) << 20;  // below which batches do not get smaller
constexpr int MostLevels = 16;  // of a tape that batches are sized for; deeper ones have few paths left

// Waits, whatever happens: what was launched needs memory that may be given back.
class FinishLaunches {
public:
    explicit FinishLaunches(Launcher &launcher) : launcher_(launcher) {}
    FinishLaunches(const FinishLaunches &) = delete;
    FinishLaunches &operator=(const FinishLaunches &) = delete;
    ~FinishLaunches() {
        try {
            launcher_.synchronize();
        } catch (...) {  // what went wrong is on its way already
            return;
        }
    }

private:
    Launcher &launcher_;
};

// What f() returns; where memory is short, again with half of it for batches, once release() has given back what they
// had.
template <class Release, class Do>
auto with_memory(Launcher &launcher, size_t &memory, Release &&release, Do &&f) {
    for (;;) {
        try {
            const FinishLaunches finished(launcher);
            launcher.synchronize();
            return f();
        } catch (const std::bad_alloc &) {
            if (memory < LeastMemory) throw DeviceMemoryError();
            memory /= 2;
            release();
        }
    }
}

// By BSDF, the kind that hits on it have, through wrappers.
template <class S>
std::vector<int32_t> kinds_of_bsdfs(const SceneView<S> &scene) {
    std::vector<int32_t> kinds(size_t(scene.n_bsdfs));
    for (int b = 0; b < scene.n_bsdfs; ++b) kinds[size_t(b)] = resolved_kind(scene, b);
    return kinds;
}

// The kinds that hits of a scene can have; those of paths that are recorded, or of light's.
template <class S>
std::vector<int32_t> kinds_in(const SceneView<S> &scene, const PathConfig &config, bool records, bool light);

// What launches for paths are about.
template <class S>
struct DeviceCall {
    const RenderCall<S> &call;
    PathStage<S> stage;
    TreeView tree;
    std::vector<int32_t> kinds;             // that are launched
    const int32_t *kind_of_bsdf = nullptr;  // on the device
    TapeParts parts{};
    SceneFacts facts{};
    MediumContext<S> media{};
    LightView<S> light{};              // of light paths
    bool skips_zero_adjoints = false;  // paths that nothing is asked of are left out

    // How often the first vertex is scattered from.
    int splits() const {
        const PathConfig &config = call.config;
        const bool scatters = config.max_depth < 0 || config.max_depth > 1;
        return scatters ? std::max(config.emitter_samples, config.bsdf_samples) : 1;
    }
};

template <class S>
class DeviceTile {
public:
    // The launcher has to live longer.
    explicit DeviceTile(Launcher &launcher) : launcher_(launcher) {}
    DeviceTile(const DeviceTile &) = delete;
    DeviceTile &operator=(const DeviceTile &) = delete;

    static constexpr size_t TapeShare = 4;
    static size_t bytes_per_path(const BatchParts &parts = {});
    // Room for so many paths.
    void reserve(size_t n, const BatchParts &parts);
    void release();

    // What paths through media have here, `needs`: those that are recorded.
    MediumContext<S> media(const SceneView<S> &host, const GradientNeeds *needs) const;

    // Lists entries of the first queue that a launch for n samples has started, in camera_.
    void list_started(uint32_t n, const EntryList &to);
    void list_started(uint32_t n) { list_started(n, camera_); }
    // How many those are; waits.
    uint32_t n_started() const;
    void trace_paths(DeviceCall<S> &work, uint32_t n, bool scattered = false);
    // `first` vertices are behind the rays; `traced`: what they meet is known; `scattered`: after the first vertex
    // paths go on in directions of smooth BSDFs alone.
    void run(DeviceCall<S> &work, uint32_t n, int first, bool traced, bool scattered = false);
    // The vertices that the rays meet, `depth` vertices behind the first one, and nothing after them.
    void first_vertices(const DeviceCall<S> &work, int depth, uint32_t n);

    using TapeLevel = typename DeviceTapeLevels<S>::Level;
    BatchColumns<S> &at() { return at_; }
    DeviceTapeLevels<S> &levels() { return levels_; }
    // Closest hits, shadow rays, values that are not finite: of paths, of derivatives.
    static constexpr int Totals = 4;
    uint64_t *totals() { return totals_.get(); }
    void clear_totals();
    void add_totals(RenderStats &stats) const;

protected:
    static constexpr int LevelsBetweenLooks = 8;  // at how many paths are left

    Launcher &launcher_;
    size_t capacity_ = 0;  // paths of a batch
    BatchParts parts_;     // of these
    BatchColumns<S> at_{};
    std::vector<DeviceArray<uint8_t>> arrays_;  // of it
    EntryList camera_{}, live_{}, sorted_{}, lit_{};
    DeviceArray<uint32_t> lengths_;  // of these lists
    DeviceArray<uint32_t> counts_, ranges_, range_of_one_;
    DeviceArray<uint64_t> totals_;
    DeviceArray<uint64_t> tracking_;  // TrackingTotals
    DeviceTapeLevels<S> levels_;

    // Where entries of each key of a sort begin, and how many they are.
    struct Sorted {
        uint32_t *begin, *total;
        uint32_t kinds;
    };
    void count_lost(RenderStats &stats) const;
    void sort(const int32_t *key, const EntryList *from, const uint32_t *n, const EntryList &to, const Sorted &ranges,
              uint32_t launched, uint32_t each = 1);
    void keep(const int32_t *key, const uint32_t *n, const EntryList &to, uint32_t launched, uint32_t each = 1);
    void start(const DeviceCall<S> &work, uint32_t n);
    void trace_volumetric(DeviceCall<S> &work, uint32_t n);
    void trace_levels(const DeviceCall<S> &work, uint32_t first, const EntryList &rays, uint32_t n);
    void trace_hits(const DeviceCall<S> &work, const PathQueue<S> &queue, const EntryList &rays, bool passes,
                    uint32_t n);
    PathStage<S> begin_step(const DeviceCall<S> &work, int parents, bool scatters, uint32_t n, Sorted &ranges);
    void sort_hits(const DeviceCall<S> &work, const PathStage<S> &stage, const PathStep &at, PathQueue<S> &in,
                   const EntryList &rays, uint32_t n, const Sorted &ranges);
    ShadeHits<S> shading(const PathStage<S> &stage, const PathStep &at, const PathQueue<S> &in, const PathQueue<S> &out,
                         const Sorted &ranges) const;
    void step(const DeviceCall<S> &work, const PathStep &at, PathQueue<S> &in, const EntryList &rays,
              const PathQueue<S> &out, uint32_t n, int parents, bool smooth_alone = false);
    void sweep(const DeviceCall<S> &work, const DerivativePlaces<S> &to, bool unit_adjoint, int last);
    void sweep(const DeviceCall<S> &work, const DerivativePlaces<S> &to, bool unit_adjoint) {
        sweep(work, to, unit_adjoint, levels_.size() - 1);
    }
    uint32_t live() const;
};

}  // namespace tr
