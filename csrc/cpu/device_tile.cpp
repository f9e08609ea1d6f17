#include "device_tile.h"

#include <set>
#include <string>
#include <utility>

namespace tr {

namespace {

constexpr uint32_t Kinds = uint32_t(EmissionKind) + 1;
static_assert(Kinds <= SortTable::MostKinds);

uint32_t chunks_of(size_t n) { return uint32_t((n + SortTable::Chunk - 1) / SortTable::Chunk); }

}  // namespace

template <class S>
std::vector<int32_t> kinds_in(const SceneView<S> &scene, const PathConfig &config, bool records, bool light) {
    std::set<int32_t> found;
    if (config.volumetric) {
        found.insert(CollisionKind);
        if (records) found.insert(MissKind);
        if (config.hide_emitters) found.insert(NullKind);
    }
    if (scene.environment >= 0 && !light) found.insert(MissKind);
    for (int b = 0; b < scene.n_bsdfs; ++b) {
        const int32_t kind = scene.bsdfs[b].kind;
        if (kind < FirstWrapper) found.insert(kind);
        if (kind == MaskKind) found.insert(MaskHoleKind);
    }
    return {found.begin(), found.end()};
}
template std::vector<int32_t> kinds_in(const SceneView<float> &, const PathConfig &, bool, bool);
template std::vector<int32_t> kinds_in(const SceneView<double> &, const PathConfig &, bool, bool);

// --------------------------------------------------------------------------------------------------------- a batch
// Lists entries 0 .. each * *n - 1, or those of `from`, those of every key one after the other.
template <class S>
void DeviceTile<S>::sort(const int32_t *key, const EntryList *from, const uint32_t *n, const EntryList &to,
                         const Sorted &ranges, uint32_t launched, uint32_t each) {
    const uint32_t chunks = chunks_of(size_t(each) * launched);
    const SortTable table{key,
                          from ? from->entry : nullptr,
                          n,
                          counts_.get(),
                          ranges.begin,
                          ranges.total,
                          to.entry,
                          to.n,
                          each,
                          ranges.kinds,
                          chunks};
    launcher_.run(CountKeys{table}, chunks);
    launcher_.run(SumKeys{table}, ranges.kinds);
    launcher_.run(PlaceKeys{table}, chunks);
}

// ... those that are kept.
template <class S>
void DeviceTile<S>::keep(const int32_t *key, const uint32_t *n, const EntryList &to, uint32_t launched, uint32_t each) {
    sort(key, nullptr, n, to, {range_of_one_.get(), range_of_one_.get() + 1, 1}, launched, each);
}

// Camera rays, and the list of those that there are.
template <class S>
void DeviceTile<S>::start(const DeviceCall<S> &work, uint32_t n) {
    launcher_.run(StartPaths<S>{work.stage, at_.queues[0], at_.out_key, n, work.skips_zero_adjoints}, n);
    list_started(n, camera_);
}

// Those that a launch for all samples has started.
template <class S>
void DeviceTile<S>::list_started(uint32_t n, const EntryList &to) {
    launcher_.run(FillWords{sorted_.n, n}, 1);  // in place of hits: all samples
    keep(at_.out_key, sorted_.n, to, n);
}

// Camera rays and their paths.
template <class S>
void DeviceTile<S>::trace_paths(DeviceCall<S> &work, uint32_t n, bool scattered) {
    start(work, n);
    run(work, n, 0, false, scattered);
}

// As PathTile::run, of the rays of the first queue that are listed in camera_, n at most.
template <class S>
void DeviceTile<S>::run(DeviceCall<S> &work, uint32_t n, int first, bool traced, bool scattered) {
    const PathConfig &config = work.call.config;
    const int depth = config.max_depth;
    PathQueue<S> *queues = at_.queues;
    levels_.begin(work.parts);
    if (depth >= 0 && first >= depth) return;
    if (config.volumetric) return trace_volumetric(work, n);
    if (!traced) trace_hits(work, queues[0], camera_, config.hide_emitters && first == 0, n);
    const bool scatters = depth < 0 || depth > first + 1;
    for (int split = 0; split < (first == 0 ? work.splits() : 1); ++split) {
        if (split > 0) trace_hits(work, queues[0], camera_, false, n);
        step(work, {first, split, scatters}, queues[0], camera_, queues[1], n, TapeLevel::NoParents, scattered);
        PathQueue<S> *current = &queues[1], *next = &queues[2];
        uint32_t most = n;  // that may be left
        for (int level = first + 1; depth < 0 || level < depth; ++level) {
            if (level % LevelsBetweenLooks == 0) most = live();
            if (most == 0) break;
            trace_hits(work, *current, live_, false, most);
            step(work, {level, 0, depth < 0 || level + 1 < depth}, *current, live_, *next, most, levels_.size() - 1);
            std::swap(current, next);
        }
    }
}

// As PathTile::first_vertices.
template <class S>
void DeviceTile<S>::first_vertices(const DeviceCall<S> &work, int depth, uint32_t n) {
    levels_.begin(work.parts);
    trace_hits(work, at_.queues[0], camera_, work.call.config.hide_emitters && depth == 0, n);
    step(work, {depth, 0, true}, at_.queues[0], camera_, at_.queues[1], n, TapeLevel::NoParents);
}

template <class S>
MediumContext<S> DeviceTile<S>::media(const SceneView<S> &host, const GradientNeeds *needs) const {
    MediumContext<S> r(host, needs);
    r.flight = at_.flight, r.branch = at_.branch;
    return r;
}

// As PathTile::run_volumetric.
template <class S>
void DeviceTile<S>::trace_volumetric(DeviceCall<S> &work, uint32_t n) {
    launcher_.run(BeginMedia<S>{work.stage, work.media, at_.queues[0]}, n);
    trace_levels(work, 0, camera_, n);
    if (!work.stage.records || !work.media.differential) return;
    // what is not recorded has other kernels
    SceneFacts facts = work.facts;
    facts.records = work.stage.records = false;
    launcher_.know(facts);
    launcher_.run(StartBranches<S>{work.stage, work.media, at_.queues[0], at_.out_key, n}, n);
    list_started(n, live_);
    trace_levels(work, BranchLevel, live_, n);
    launcher_.run(FinishBranches<S>{at_.slots.radiance, at_.branch.radiance}, n);
    work.stage.records = true;
    launcher_.know(work.facts);
}

// As PathTile::run_levels, of `rays` of the first queue.
template <class S>
void DeviceTile<S>::trace_levels(const DeviceCall<S> &work, uint32_t first, const EntryList &rays, uint32_t n) {
    PathQueue<S> *current = &at_.queues[0], *next = &at_.queues[1];
    for (uint32_t level = 0, most = n; most > 0; ++level) {
        const EntryList &list = level == 0 ? rays : live_;
        const int parents = level == 0 ? TapeLevel::NoParents : levels_.size() - 1;
        trace_hits(work, *current, list, false, most);
        step(work, {int(first + level), 0, true}, *current, list, *next, most, parents);
        std::swap(current, next);
        if ((level + 1) % LevelsBetweenLooks == 0) most = live();
    }
}

template <class S>
void DeviceTile<S>::trace_hits(const DeviceCall<S> &work, const PathQueue<S> &queue, const EntryList &rays, bool passes,
                               uint32_t n) {
    launcher_.run(TracePaths<S>{work.stage.scene, work.tree, queue, at_.hits, rays, totals_.get(), passes}, n);
}

// The stage of a step, with a level of the tape if there is one, and where its hits of each kind are. `parents`: the
// level that they come from.
template <class S>
PathStage<S> DeviceTile<S>::begin_step(const DeviceCall<S> &work, int parents, bool scatters, uint32_t n,
                                       Sorted &ranges) {
    ranges = {ranges_.get(), ranges_.get() + Kinds, Kinds};
    PathStage<S> stage = work.stage;
    if (stage.records) {
        const TapeLevel &level = levels_.add(launcher_, parents, scatters, n, Kinds);
        stage.tape = level.tape;
        ranges = {level.begin, level.total, Kinds};
    }
    return stage;
}

// Lists the hits of the rays, n at most, by kind.
template <class S>
void DeviceTile<S>::sort_hits(const DeviceCall<S> &work, const PathStage<S> &stage, const PathStep &at,
                              PathQueue<S> &in, const EntryList &rays, uint32_t n, const Sorted &ranges) {
    const bool viewed = !parts_.light;
    launcher_.run(ClassifyHits<S>{stage, at, viewed, in, at_.hits, work.kind_of_bsdf, rays, at_.key}, n);
    sort(at_.key, &rays, rays.n, sorted_, ranges, n);
}

// ... which are to be shaded so.
template <class S>
ShadeHits<S> DeviceTile<S>::shading(const PathStage<S> &stage, const PathStep &at, const PathQueue<S> &in,
                                    const PathQueue<S> &out, const Sorted &ranges) const {
    return {stage,        at,           MissKind, 3,           in,          at_.hits,      sorted_.entry,
            ranges.begin, ranges.total, out,      at_.shadows, at_.out_key, at_.shadow_key};
}

// Shades what the rays have hit, n at most; those that go on are in `out`, and listed in live_, `smooth_alone`: those
// in directions of smooth BSDFs.
template <class S>
void DeviceTile<S>::step(const DeviceCall<S> &work, const PathStep &at, PathQueue<S> &in, const EntryList &rays,
                         const PathQueue<S> &out, uint32_t n, int parents, bool smooth_alone) {
    const int depth = work.call.config.max_depth;
    const bool volumetric = work.call.config.volumetric;
    Sorted ranges;
    const PathStage<S> stage = begin_step(work, parents, at.scatters, n, ranges);
    in.n = uint32_t(capacity_);  // any entry of it may be asked for
    MediumContext<S> media = work.media;
    media.level = uint32_t(at.depth);
    if (volumetric) launcher_.run(FlyRays<S>{stage, media, in, at_.hits, rays, {tracking_.get()}}, n);
    sort_hits(work, stage, at, in, rays, n, ranges);
    ShadeHits<S> hits = shading(stage, at, in, out, ranges);
    hits.left = volumetric || depth < 0 ? 3 : std::min(std::max(depth - at.depth - 1, 1), 3);
    for (const int32_t kind : work.kinds) {
        hits.kind = kind;
        if (volumetric)
            launcher_.run(ShadeInMedia<S>{hits, media}, n, kind);
        else
            launcher_.run(hits, n, kind);
    }
    if (!at.scatters) return;
    keep(at_.shadow_key, sorted_.n, lit_, n, volumetric ? MostShadows : 1);
    if (volumetric) {
        launcher_.run(
            TransmitShadows<S>{stage, media, work.tree, at_.shadows, at_.transmittance, lit_, {tracking_.get()}},
            MostShadows * n);
    } else {
        launcher_.run(TraceShadows<S>{work.tree, at_.shadows, lit_, at_.slots.radiance,
                                      stage.records ? stage.tape.outgoing.light_weight.at : nullptr, totals_.get() + 1},
                      n);
    }
    if (smooth_alone) launcher_.run(KeepSmooth<S>{out.pdf.at, sorted_.n, at_.out_key}, n);
    keep(at_.out_key, sorted_.n, live_, n);
}

// As PathTile::sweep_levels, or LightTile::sweep, from level `last` on.
template <class S>
void DeviceTile<S>::sweep(const DeviceCall<S> &work, const DerivativePlaces<S> &to, bool unit_adjoint, int last) {
    static const std::vector<int32_t> beginning{EmissionKind};
    const bool light = parts_.light;
    BranchEnds<S> branches;
    if (work.media.differential) branches = {at_.branch.level, at_.branch.entry, at_.branch.radiance};
    for (int l = last; l >= 0; --l) {
        const TapeLevel &level = levels_[l];
        PathStage<S> stage = work.stage;
        stage.tape = level.tape;
        TapeBefore<S> before;
        if (level.parents >= 0) {
            const TapeColumns<S> &parents = levels_[level.parents].tape;
            before = {parents.vertex.suffix, parents.next, parents.motion.rest_bar, parents.motion.from_bar};
        }
        for (const int32_t kind : light &&l == 0 ? beginning : work.kinds) {
            const SweepVertices<S> vertices{stage,  kind,     uint32_t(l), level.scatters, level.begin, level.total,
                                            before, branches, to,          unit_adjoint};
            if (light)
                launcher_.run(SweepLightVertices<S>{vertices, work.light}, level.room, kind);
            else
                launcher_.run(vertices, level.room, kind);
        }
    }
}

template <class S>
uint32_t DeviceTile<S>::live() const {
    uint32_t n = 0;
    launcher_.download(&n, live_.n, sizeof n);
    return n;
}

template <class S>
uint32_t DeviceTile<S>::n_started() const {
    uint32_t n = 0;
    launcher_.download(&n, camera_.n, sizeof n);
    return n;
}

template <class S>
void DeviceTile<S>::release() {
    launcher_.synchronize();
    capacity_ = 0;
    arrays_.clear();
    levels_ = DeviceTapeLevels<S>();
}

template <class S>
void DeviceTile<S>::clear_totals() {
    clear(launcher_, at_.lost.count, capacity_), clear(launcher_, totals_.get(), Totals);
    if (parts_.media) clear(launcher_, tracking_.get(), TrackingTotals::Numbers);
}

template <class S>
void DeviceTile<S>::add_totals(RenderStats &stats) const {
    uint64_t totals[Totals];
    totals_.download(totals, Totals);
    stats.closest_rays += totals[0], stats.shadow_rays += totals[1];
    if (totals[2] != 0) count_lost(stats);
    stats.count_non_finite(totals[3], "a derivative");
    if (!parts_.media) return;
    std::vector<uint64_t> sums(TrackingTotals::Numbers);
    tracking_.download(sums.data(), sums.size());
    for (size_t i = 0; i < sums.size(); i += TrackingTotals::Sums)
        stats.collisions += sums[i], stats.majorants_exceeded += sums[i + 1], stats.shadow_rays += sums[i + 2];
}

template <class S>
void DeviceTile<S>::count_lost(RenderStats &stats) const {
    std::vector<uint32_t> found[3];
    const uint32_t *columns[] = {at_.lost.count, at_.lost.culprit, at_.lost.index};
    for (int k = 0; k < 3; ++k) {
        found[k].resize(capacity_);
        launcher_.download(found[k].data(), columns[k], capacity_ * sizeof(uint32_t));
    }
    for (size_t i = 0; i < capacity_; ++i)
        if (found[0][i] != 0)
            stats.count_non_finite(found[0][i],
                                   name_of(Culprit(found[1][i])) + (" " + std::to_string(int32_t(found[2][i]))));
}

template <class S>
size_t DeviceTile<S>::bytes_per_path(const BatchParts &parts) {
    size_t bytes = 0;
    BatchColumns<S>().for_arrays(parts, [&](auto *&array, size_t each) { bytes += each * sizeof(*array); });
    return bytes;
}

template <class S>
void DeviceTile<S>::reserve(size_t n, const BatchParts &parts) {
    if (n <= capacity_ && parts == parts_) return;
    launcher_.synchronize();
    capacity_ = 0, parts_ = parts;
    arrays_.clear();
    at_ = {};
    at_.for_arrays(parts, [&](auto *&array, size_t each) {
        arrays_.emplace_back(launcher_, each * n * sizeof(*array));
        array = reinterpret_cast<std::remove_reference_t<decltype(array)>>(arrays_.back().get());
    });
    lengths_.reserve(launcher_, 4);
    camera_ = {at_.camera_rays, lengths_.get()}, live_ = {at_.live_rays, lengths_.get() + 1};
    sorted_ = {at_.sorted, lengths_.get() + 2}, lit_ = {at_.shadow_rays, lengths_.get() + 3};
    static_assert(MostShadows <= Kinds);
    counts_.reserve(launcher_, size_t(Kinds) * chunks_of(n));  // also of so many shadow rays, of one kind
    ranges_.reserve(launcher_, 2 * size_t(Kinds)), range_of_one_.reserve(launcher_, 2);
    totals_.reserve(launcher_, Totals);
    if (parts.media) tracking_.reserve(launcher_, TrackingTotals::Numbers);
    at_.lost.total = totals_.get() + 2;
    capacity_ = n;
}

template class DeviceTile<float>;
template class DeviceTile<double>;

}  // namespace tr
