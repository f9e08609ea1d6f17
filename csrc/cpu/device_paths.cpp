#include "device_paths.h"

#include <algorithm>
#include <chrono>
#include <cstring>
#include <set>
#include <string>

#include "work_items.h"

namespace tr {

namespace {

constexpr uint32_t Kinds = uint32_t(EmissionKind) + 1;
static_assert(Kinds <= SortTable::MostKinds);
constexpr int LevelsBetweenLooks = 8;            // at how many paths are left
constexpr size_t LeastMemory = size_t(1) << 20;  // below which batches do not get smaller
constexpr int MostLevels = 16;  // of a tape that batches are sized for; deeper ones have few paths left

uint32_t chunks_of(size_t n) { return uint32_t((n + SortTable::Chunk - 1) / SortTable::Chunk); }

// Waits, whatever happens: what was launched needs memory that may be given back.
class Finish {
public:
    explicit Finish(Launcher &launcher) : launcher_(launcher) {}
    Finish(const Finish &) = delete;
    Finish &operator=(const Finish &) = delete;
    ~Finish() {
        try {
            launcher_.synchronize();
        } catch (...) {  // what went wrong is on its way already
            return;
        }
    }

private:
    Launcher &launcher_;
};

void check(const RenderCall<float> &call) {
    const char *missing = call.config.volumetric           ? "media"
                          : call.config.stokes             ? "polarised light"
                          : call.config.spectral.positions ? "wavelengths"
                          : call.scene->bends              ? "media that light bends in"
                          : call.ray_record                ? "records of rays"
                          : call.keep_hits                 ? "hits that are kept"
                                                           : nullptr;
    if (missing) throw std::invalid_argument(std::string("device: there are no ") + missing + " on devices yet");
}

// The kinds that hits of a scene can have.
std::vector<int32_t> kinds_in(const SceneView<float> &scene) {
    std::set<int32_t> found;
    if (scene.environment >= 0) found.insert(MissKind);
    for (int b = 0; b < scene.n_bsdfs; ++b) {
        const int32_t kind = scene.bsdfs[b].kind;
        if (kind < FirstWrapper) found.insert(kind);
        if (kind == MaskKind) found.insert(MaskHoleKind);
    }
    return {found.begin(), found.end()};
}

}  // namespace

struct DevicePaths::Work {
    const RenderCall<float> &call;
    PathStage stage;
    TreeView tree;
    std::vector<int32_t> kinds;  // that are launched
    const TileSchedule &schedule;
    ListedPixels list{};
    std::vector<TileList> lists{1};  // by tile; one for all where there is no list
    TapeParts parts{};
    int64_t n_paths = 0;
    size_t batch = 0;      // paths of one at most
    bool reverse = false;  // paths that nothing is asked of are left out
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
    // How often the first vertex is scattered from.
    int splits() const {
        const PathConfig &config = call.config;
        const bool scatters = config.max_depth < 0 || config.max_depth > 1;
        return scatters ? std::max(config.emitter_samples, config.bsdf_samples) : 1;
    }
};

// Where entries of each key of a sort begin, and how many they are.
struct DevicePaths::Sorted {
    uint32_t *begin, *total;
    uint32_t kinds;
};

size_t DevicePaths::bytes_per_path() {
    size_t bytes = 0;
    BatchColumns().for_arrays([&](auto *&array) { bytes += sizeof(*array); });
    return bytes;
}

void DevicePaths::reserve(size_t n) {
    if (n <= capacity_) return;
    launcher_.synchronize();
    capacity_ = 0;
    arrays_.clear();
    at_.for_arrays([&](auto *&array) {
        static_assert(sizeof(*array) == sizeof(uint32_t));
        arrays_.emplace_back(launcher_, n);
        array = reinterpret_cast<std::remove_reference_t<decltype(array)>>(arrays_.back().get());
    });
    lengths_.reserve(launcher_, 4);
    camera_ = {at_.camera_rays, lengths_.get()}, live_ = {at_.live_rays, lengths_.get() + 1};
    sorted_ = {at_.sorted, lengths_.get() + 2}, lit_ = {at_.shadow_rays, lengths_.get() + 3};
    counts_.reserve(launcher_, size_t(Kinds) * chunks_of(n));
    ranges_.reserve(launcher_, 2 * size_t(Kinds)), range_of_one_.reserve(launcher_, 2);
    totals_.reserve(launcher_, 4);
    at_.lost.total = totals_.get() + 2;
    capacity_ = n;
}

// ---------------------------------------------------------------------------------------------------------- a call
DevicePaths::Work DevicePaths::begin(const RenderCall<float> &call, const SceneData<float> &data, const TreeView &tree,
                                     const TileSchedule &schedule, const DerivativeCall<float> *derivative) {
    const SceneView<float> &host = *call.scene;
    Work work{call, {}, tree, kinds_in(host), schedule};
    for (size_t i = 0; i < schedule.n_tiles(); ++i) work.n_paths += int64_t(schedule.tile(i).n) * call.spp;
    if (call.pixels) work.list = list_pixels(schedule, work.lists);
    size_t memory = memory_, bytes = bytes_per_path();
    if (derivative) {
        const int depth = call.config.max_depth, levels = depth < 0 ? MostLevels : std::min(depth, MostLevels);
        memory *= TapeShare;
        work.parts = {host.has_stacks, host.follows_tangent, derivative->needs.numbers()};
        bytes += size_t(levels + work.splits()) * DeviceTapeLevels::bytes_per_entry(work.parts);
    }
    work.batch = std::max<size_t>(1, std::min(std::max<size_t>(memory / bytes, 1), size_t(work.n_paths)));
    reserve(work.batch);
    clear(launcher_, at_.lost.count, capacity_), clear(launcher_, totals_.get(), 4);

    SceneFacts facts(host, call.config);
    facts.records = derivative != nullptr, facts.forward = derivative && !derivative->adjoint;
    facts.motion = work.parts.motion, facts.fixed_sums = derivative && derivative->fixed_sums;
    launcher_.know(facts);
    std::vector<int32_t> kinds(size_t(host.n_bsdfs));
    for (int b = 0; b < host.n_bsdfs; ++b) kinds[size_t(b)] = resolved_kind(host, b);
    kinds_.upload(launcher_, kinds.data(), kinds.size());
    work.stage = {scene_.upload(launcher_, data, call.threads),
                  call.config,
                  at_.slots,
                  at_.lost,
                  float(call.film_width),
                  float(call.film_height)};
    if (derivative) {
        const GradientNeeds needs = work.stage.needs = derivative_.needs(launcher_, *derivative);
        work.stage.records = true;
        work.stage.bsdfs_alone = needs.bsdf && !needs.emitter && !needs.numbers() && !needs.camera;
    }
    return work;
}

// Calls body(batch) for batches of samples, in the schedule's order, until it is interrupted. `silent`: they are no
// share of what somebody waits for.
template <class Body>
void DevicePaths::for_batches(const Work &work, RenderStats &stats, bool silent, Body &&body) {
    const RenderCall<float> &call = work.call;
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
            const auto samples = int64_t(tile.n) * (last - first);
            for (int64_t taken = 0; taken < samples;) {
                if (batch.size == work.batch) {
                    finish();
                    if (stats.interrupted) return;
                    batch = {};
                }
                const int64_t taking = std::min(int64_t(work.batch) - int64_t(batch.size), samples - taken);
                const TileList &at = work.lists[work.call.pixels ? number : 0];
                batch.units.push_back({tile.sampled, int32_t(int64_t(batch.size) - taken), at.pixel, at.place,
                                       uint32_t(last - first), uint32_t(call.sample_offset + first), taken == 0,
                                       taken + taking == samples});
                taken += taking, batch.size += uint32_t(taking);
            }
        }
    }
    if (!batch.units.empty()) finish();
}

// Calls f(work, stats); where memory is short again, with smaller batches. Nothing is written before all is computed.
template <class Do>
RenderStats DevicePaths::run(const RenderCall<float> &call, const SceneData<float> &data, const TreeView &tree,
                             const DerivativeCall<float> *derivative, Do &&f) {
    check(call);
    if (derivative) DeviceDerivative::check(*derivative);
    const TileSchedule schedule = make_schedule(call);
    for (;;) {
        try {
            RenderStats stats;
            const Finish finished(launcher_);
            launcher_.synchronize();
            Work work = begin(call, data, tree, schedule, derivative);
            f(work, stats);
            return stats;
        } catch (const std::bad_alloc &) {
            if (memory_ < LeastMemory) throw DeviceMemoryError();
            memory_ /= 2;
            release();
        }
    }
}

// What the paths of batches take.
void DevicePaths::release() {
    launcher_.synchronize();
    capacity_ = 0;
    arrays_.clear();
    levels_ = DeviceTapeLevels();
}

RenderStats DevicePaths::render(const RenderCall<float> &call, const SceneData<float> &data, const TreeView &tree,
                                const RenderOutput<float> &out) {
    return run(call, data, tree, nullptr, [&](Work &work, RenderStats &stats) {
        const int colors = call.values, moments = out.variance || out.second_moment ? colors : 0;
        const int channels = FilmBlock::channels(colors + 1, moments);
        begin_film(work, channels);
        for_batches(work, stats, false, [&](const SampleNumbers &batch) {
            number_samples(work, batch);
            trace_paths(work, batch.size);
            add_to_film(work, batch, colors, moments);
        });
        if (stats.interrupted) return;
        finish(work, stats);
        write_results(call, work.schedule, download_film(work, channels), moments, out);
    });
}

RenderStats DevicePaths::reverse(const RenderCall<float> &call, const SceneData<float> &data, const TreeView &tree,
                                 DerivativeCall<float> &derivative) {
    return run(call, data, tree, &derivative, [&](Work &work, RenderStats &stats) {
        work.reverse = true;
        begin_adjoint(work, derivative.adjoint, stats);
        if (stats.interrupted) return;
        DerivativePlaces to = derivative_.begin_gradients(launcher_, derivative, totals_.get() + 3);
        for_batches(work, stats, false, [&](const SampleNumbers &batch) {
            number_samples(work, batch);
            if (call.filter.reach() > 0) launcher_.run(PlaceSamples{call.config, at_.slots}, batch.size);
            derivative_.collect(launcher_, call, at_.slots, batch.size);
            trace_paths(work, batch.size);
            to.measures = to.fixed;
            sweep(work, to, false);
            if (to.fixed) {
                to.measures = false;
                sweep(work, to, false);
            }
            derivative_.settle(launcher_);
        });
        if (stats.interrupted) return;
        finish(work, stats);
        derivative_.finish_gradients(launcher_, derivative, call.threads);
    });
}

RenderStats DevicePaths::forward(const RenderCall<float> &call, const SceneData<float> &data, const TreeView &tree,
                                 const DerivativeCall<float> &derivative, float *image) {
    return run(call, data, tree, &derivative, [&](Work &work, RenderStats &stats) {
        const DerivativePlaces to = derivative_.tangents(launcher_, derivative, totals_.get() + 3);
        const int channels = FilmBlock::channels(call.values + 1, 0);
        begin_film(work, channels);
        for_batches(work, stats, false, [&](const SampleNumbers &batch) {
            number_samples(work, batch);
            trace_paths(work, batch.size);
            sweep_components(work, to, batch.size);
            add_to_film(work, batch, call.values, 0);
        });
        if (stats.interrupted) return;
        finish(work, stats);
        write_results(call, work.schedule, download_film(work, channels), 0, RenderOutput<float>{image});
    });
}

void DevicePaths::finish(const Work &work, RenderStats &stats) const {
    uint64_t totals[4];
    totals_.download(totals, 4);
    stats.closest_rays = totals[0], stats.shadow_rays = totals[1];
    if (totals[2] != 0) count_lost(stats);
    stats.count_non_finite(totals[3], "a derivative");
    stats.seconds = work.seconds();
}

void DevicePaths::count_lost(RenderStats &stats) const {
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

// -------------------------------------------------------------------------------------------------------- the film
ListedPixels DevicePaths::list_pixels(const TileSchedule &schedule, std::vector<TileList> &lists) {
    std::vector<int32_t> pixels, places;
    lists.resize(schedule.n_tiles());
    for (size_t i = 0; i < schedule.n_tiles(); ++i) {
        const Tile tile = schedule.tile(i);
        const Rect &rect = tile.sampled;
        lists[i] = {uint32_t(pixels.size() / 2), uint32_t(places.size())};
        places.resize(places.size() + size_t(rect.height()) * size_t(rect.width()), -1);
        for (size_t p = 0; p < tile.n; ++p) {
            const Pixel at = tile.pixel(p);
            pixels.insert(pixels.end(), {at.y, at.x});
            places[lists[i].place + size_t(at.y - rect.y0) * size_t(rect.width()) + size_t(at.x - rect.x0)] =
                int32_t(p);
        }
    }
    pixels_.upload(launcher_, pixels.data(), pixels.size());
    places_.upload(launcher_, places.data(), places.size());
    return {pixels_.get(), places_.get()};
}

void DevicePaths::begin_film(const Work &work, int channels) {
    const TileSchedule &schedule = work.schedule;
    const size_t n = schedule.n_targets() * size_t(channels);
    if (schedule.n_targets() > UINT32_MAX / (2 * size_t(channels)))
        throw std::invalid_argument("device: the image has too many pixels");
    if (work.call.pixels) {
        std::vector<int32_t> targets;
        for (size_t i = 0; i < schedule.n_targets(); ++i) {
            const Pixel at = schedule.target(i);
            targets.insert(targets.end(), {at.y, at.x});
        }
        targets_.upload(launcher_, targets.data(), targets.size());
    }
    sums_.reserve(launcher_, n), open_.reserve(launcher_, n);
    clear(launcher_, sums_.get(), n), clear(launcher_, open_.get(), n);
}

void DevicePaths::number_samples(const Work &work, const SampleNumbers &batch) {
    units_.upload(launcher_, batch.units.data(), batch.units.size());
    launcher_.run(NumberSamples{units_.get(), uint32_t(batch.units.size()), work.list, at_.slots}, batch.size);
}

void DevicePaths::add_to_film(const Work &work, const SampleNumbers &batch, int colors, int moments) {
    const auto [first, n_targets] = work.targets(batch.units);
    launcher_.run(AddToFilm{work.call.filter, int32_t(std::min(work.call.filter.reach(), MaxReach)), int32_t(colors),
                            int32_t(moments), units_.get(), uint32_t(batch.units.size()), batch.size, work.list,
                            work.call.pixels ? targets_.get() : nullptr, work.schedule.rect(), first, sums_.get(),
                            open_.get(), at_.slots},
                  n_targets);
}

const double *DevicePaths::download_film(const Work &work, int channels) {
    const size_t n = work.schedule.n_targets() * size_t(channels);
    auto *to = static_cast<double *>(film_.reserve(launcher_, n * sizeof(double)));
    sums_.download(to, n);
    return to;
}

// As adjoint_film.
void DevicePaths::begin_adjoint(const Work &work, const float *image, RenderStats &stats) {
    const bool box = work.call.filter.reach() == 0;
    if (!box) {
        begin_film(work, FilmBlock::channels(1, 0));
        for_batches(work, stats, true, [&](const SampleNumbers &batch) {
            number_samples(work, batch);
            launcher_.run(PlaceSamples{work.call.config, at_.slots}, batch.size);
            add_to_film(work, batch, 0, 0);
        });
    }
    derivative_.begin_adjoint(launcher_, work.call, work.schedule, image, box ? nullptr : sums_.get());
}

// --------------------------------------------------------------------------------------------------------- a batch
// Lists entries 0 .. *n - 1, or those of `from`, those of every key one after the other.
void DevicePaths::sort(const int32_t *key, const EntryList *from, const uint32_t *n, const EntryList &to,
                       const Sorted &ranges, uint32_t launched) {
    const uint32_t chunks = chunks_of(launched);
    const SortTable table{
        key,   from ? from->entry : nullptr, n, counts_.get(), ranges.begin, ranges.total, to.entry, to.n, ranges.kinds,
        chunks};
    launcher_.run(CountKeys{table}, chunks);
    launcher_.run(SumKeys{table}, ranges.kinds);
    launcher_.run(PlaceKeys{table}, chunks);
}

// ... those that are kept.
void DevicePaths::keep(const int32_t *key, const uint32_t *n, const EntryList &to, uint32_t launched) {
    sort(key, nullptr, n, to, {range_of_one_.get(), range_of_one_.get() + 1, 1}, launched);
}

// As PathTile::run.
void DevicePaths::trace_paths(const Work &work, uint32_t n) {
    const PathConfig &config = work.call.config;
    const int depth = config.max_depth;
    PathQueue<float> *queues = at_.queues;
    levels_.begin(work.parts);
    launcher_.run(StartPaths{work.stage, queues[0], at_.out_key, n, work.reverse}, n);
    launcher_.run(FillWords{sorted_.n, n}, 1);  // in place of hits: all samples
    keep(at_.out_key, sorted_.n, camera_, n);
    if (depth == 0) return;
    trace_hits(work, queues[0], camera_, config.hide_emitters, n);
    const bool scatters = depth < 0 || depth > 1;
    for (int split = 0; split < work.splits(); ++split) {
        if (split > 0) trace_hits(work, queues[0], camera_, false, n);
        step(work, {0, split, scatters}, queues[0], camera_, queues[1], n, DeviceTapeLevels::Level::NoParents);
        PathQueue<float> *current = &queues[1], *next = &queues[2];
        uint32_t most = n;  // that may be left
        for (int level = 1; depth < 0 || level < depth; ++level) {
            if (level % LevelsBetweenLooks == 0) most = live();
            if (most == 0) break;
            trace_hits(work, *current, live_, false, most);
            step(work, {level, 0, depth < 0 || level + 1 < depth}, *current, live_, *next, most, levels_.size() - 1);
            std::swap(current, next);
        }
    }
}

void DevicePaths::trace_hits(const Work &work, const PathQueue<float> &queue, const EntryList &rays, bool passes,
                             uint32_t n) {
    launcher_.run(TracePaths{work.stage.scene, work.tree, queue, at_.hits, rays, totals_.get(), passes}, n);
}

// Shades what the rays have hit, n at most; those that go on are in `out`, and listed in live_. `parents`: the level of
// the tape that they come from.
void DevicePaths::step(const Work &work, const PathStep &at, PathQueue<float> &in, const EntryList &rays,
                       const PathQueue<float> &out, uint32_t n, int parents) {
    const int depth = work.call.config.max_depth;
    Sorted ranges{ranges_.get(), ranges_.get() + Kinds, Kinds};
    PathStage stage = work.stage;
    if (stage.records) {
        const DeviceTapeLevels::Level &level = levels_.add(launcher_, parents, at.scatters, n, Kinds);
        stage.tape = level.tape;
        ranges = {level.begin, level.total, Kinds};
    }
    in.n = uint32_t(capacity_);  // any entry of it may be asked for
    launcher_.run(ClassifyHits{stage, at, in, at_.hits, kinds_.get(), rays, at_.key}, n);
    sort(at_.key, &rays, rays.n, sorted_, ranges, n);
    const bool last = depth >= 0 && at.depth + 2 >= depth;
    for (const int32_t kind : work.kinds)
        launcher_.run(ShadeHits{stage, at, kind, last, in, at_.hits, sorted_.entry, ranges.begin, ranges.total, out,
                                at_.shadows, at_.out_key, at_.shadow_key},
                      n, kind);
    if (!at.scatters) return;
    keep(at_.shadow_key, sorted_.n, lit_, n);
    launcher_.run(TraceShadows{work.tree, at_.shadows, lit_, at_.slots.radiance,
                               stage.records ? stage.tape.outgoing.light_weight.at : nullptr, totals_.get() + 1},
                  n);
    keep(at_.out_key, sorted_.n, live_, n);
}

// As PathTile::sweep_levels.
void DevicePaths::sweep(const Work &work, const DerivativePlaces &to, bool unit_adjoint) {
    for (int l = levels_.size() - 1; l >= 0; --l) {
        const DeviceTapeLevels::Level &level = levels_[l];
        PathStage stage = work.stage;
        stage.tape = level.tape;
        TapeBefore before;
        if (level.parents >= 0) {
            const TapeColumns<float> &parents = levels_[level.parents].tape;
            before = {parents.vertex.suffix, parents.next};
        }
        for (const int32_t kind : work.kinds)
            launcher_.run(SweepVertices{stage, kind, uint32_t(l), level.scatters, level.begin, level.total, before, to,
                                        unit_adjoint},
                          level.room, kind);
    }
}

// In forward mode, as PathTile::sweep_tape: numbers need a sweep a component.
void DevicePaths::sweep_components(const Work &work, DerivativePlaces to, uint32_t n) {
    if (!work.stage.needs.numbers()) return sweep(work, to, true);
    for (to.component = 0; to.component < work.call.values; ++to.component) {
        for (int c = 0; c < SpectrumSize; ++c) {
            const float adjoint = c == to.component ? 1.f : 0.f;
            uint32_t bits;
            std::memcpy(&bits, &adjoint, sizeof bits);
            launcher_.run(FillWords{reinterpret_cast<uint32_t *>(at_.slots.delta[c]), bits}, n);
        }
        sweep(work, to, false);
    }
}

uint32_t DevicePaths::live() const {
    uint32_t n = 0;
    launcher_.download(&n, live_.n, sizeof n);
    return n;
}

}  // namespace tr
