#include "device_paths.h"

#include <algorithm>
#include <chrono>
#include <set>
#include <string>

#include "work_items.h"

namespace tr {

namespace {

constexpr uint32_t Kinds = uint32_t(EmissionKind) + 1;
static_assert(Kinds <= SortTable::MostKinds);
constexpr int LevelsBetweenLooks = 8;  // at whether paths are left

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
    int moments;
    const TileSchedule &schedule;

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

size_t DevicePaths::bytes_per_path() {
    size_t bytes = 0;
    BatchColumns().for_arrays([&](auto *&array) { bytes += sizeof(*array); });
    return bytes;
}

void DevicePaths::reserve(size_t n) {
    if (n <= capacity_) return;
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
    begin_.reserve(launcher_, Kinds), total_.reserve(launcher_, Kinds);
    begin_of_one_.reserve(launcher_, 1), total_of_one_.reserve(launcher_, 1);
    totals_.reserve(launcher_, 3);
    at_.lost.total = totals_.get() + 2;
    capacity_ = n;
}

template <class T>
void DevicePaths::clear(T *array, size_t n) {
    launcher_.run(FillWords{reinterpret_cast<uint32_t *>(array), 0}, uint32_t(n * sizeof(T) / sizeof(uint32_t)));
}

// Lists entries 0 .. *n - 1, or those of `from`, that are kept, or those of every kind one after the other.
void DevicePaths::sort(const int32_t *key, const EntryList *from, const uint32_t *n, const EntryList &to, bool by_kind,
                       uint32_t launched) {
    const uint32_t kinds = by_kind ? Kinds : 1, chunks = chunks_of(launched);
    const SortTable table{key,
                          from ? from->entry : nullptr,
                          n,
                          counts_.get(),
                          by_kind ? begin_.get() : begin_of_one_.get(),
                          by_kind ? total_.get() : total_of_one_.get(),
                          to.entry,
                          to.n,
                          kinds,
                          chunks};
    launcher_.run(CountKeys{table}, chunks);
    launcher_.run(SumKeys{table}, kinds);
    launcher_.run(PlaceKeys{table}, chunks);
}

// Calls body(batch) for batches of `size` samples, in the schedule's order, until it is false.
template <class Body>
void DevicePaths::for_batches(const RenderCall<float> &call, const TileSchedule &schedule, size_t size, Body &&body) {
    Batch batch;
    const auto open = [&](const Rect &rect, bool opens) {
        batch.units.push_back({rect, uint32_t(batch.spans.size()), opens, false});
        batch.spans.resize(batch.spans.size() + size_t(rect.height()) * size_t(rect.width()));
    };
    for (size_t item = 0; item < schedule.n_items(); ++item) {
        const WorkItem work = schedule.work_item(item);
        for (size_t u = 0; u < work.size(); ++u) {
            const Tile tile = schedule.tile(work.tile_of(u));
            const Rect &rect = tile.sampled;
            open(rect, true);
            for (size_t p = 0; p < tile.n; ++p) {
                const Pixel at = tile.pixel(p);
                const auto [first, last] = schedule.samples(work, u, tile, p);
                for (int64_t s = first; s < last;) {
                    if (batch.size == size) {
                        if (!body(batch)) return;
                        batch = {};
                        open(rect, false);
                    }
                    const auto begin = batch.size, end = uint32_t(std::min<int64_t>(int64_t(size), begin + last - s));
                    batch.spans[batch.units.back().first_span + size_t(at.y - rect.y0) * size_t(rect.width()) +
                                size_t(at.x - rect.x0)] = {begin, end};
                    batch.pixels.push_back({begin, at.y, at.x, uint32_t(call.sample_offset + s)});
                    s += end - begin, batch.size = end;
                }
            }
            batch.units.back().closes = true;
        }
    }
    if (!batch.units.empty()) body(batch);
}

RenderStats DevicePaths::render(const RenderCall<float> &call, const SceneData<float> &data, const TreeView &tree,
                                const RenderOutput<float> &out) {
    check(call);
    RenderStats stats;
    const auto begin = std::chrono::steady_clock::now();
    const Finish finish(launcher_);
    launcher_.synchronize();
    const TileSchedule schedule = make_schedule(call);
    int64_t n_paths = 0;
    for (size_t i = 0; i < schedule.n_tiles(); ++i) n_paths += int64_t(schedule.tile(i).n) * call.spp;
    const size_t most = std::max<size_t>(memory_ / bytes_per_path(), 1);
    reserve(std::max<size_t>(1, std::min(most, size_t(n_paths))));
    const size_t batch_size = std::min(most, capacity_);

    const int colors = call.values, moments = out.variance || out.second_moment ? colors : 0;
    Film film(schedule, FilmBlock::channels(colors + 1, moments));
    const size_t n_sums = schedule.n_targets() * size_t(film.channels());
    if (schedule.n_targets() > UINT32_MAX / (2 * size_t(film.channels())))
        throw std::invalid_argument("device: the image has too many pixels");
    if (call.pixels) {
        std::vector<int32_t> targets;
        for (size_t i = 0; i < schedule.n_targets(); ++i) {
            const Pixel at = schedule.target(i);
            targets.insert(targets.end(), {at.y, at.x});
        }
        targets_.upload(launcher_, targets.data(), targets.size());
    }
    sums_.reserve(launcher_, n_sums), open_.reserve(launcher_, n_sums);
    clear(sums_.get(), n_sums), clear(open_.get(), n_sums);
    clear(at_.lost.count, capacity_), clear(totals_.get(), 3);

    const SceneView<float> &host = *call.scene;
    launcher_.know(SceneFacts(host, call.config));
    std::vector<int32_t> kinds(size_t(host.n_bsdfs));
    for (int b = 0; b < host.n_bsdfs; ++b) kinds[size_t(b)] = resolved_kind(host, b);
    kinds_.upload(launcher_, kinds.data(), kinds.size());
    const SceneView<float> &scene = scene_.upload(launcher_, data);
    const Work work{call,    {scene, call.config, at_.slots, at_.lost, float(call.film_width), float(call.film_height)},
                    tree,    kinds_in(host),
                    moments, schedule};
    int64_t done = 0;
    for_batches(call, schedule, batch_size, [&](const Batch &batch) {
        run_batch(work, batch);
        done += int64_t(batch.size);
        stats.interrupted = call.interrupted && call.interrupted(double(done) / double(n_paths));
        return !stats.interrupted;
    });
    stats.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    if (stats.interrupted) return stats;
    if (n_sums != 0) sums_.download(film.at(0), n_sums);
    uint64_t totals[3];
    totals_.download(totals, 3);
    stats.closest_rays = totals[0], stats.shadow_rays = totals[1];
    if (totals[2] != 0) count_lost(stats);
    write_results(call, schedule, film, moments, out);
    return stats;
}

void DevicePaths::run_batch(const Work &work, const Batch &batch) {
    const uint32_t n = batch.size;
    pixels_.upload(launcher_, batch.pixels.data(), batch.pixels.size());
    launcher_.run(NumberSamples{pixels_.get(), uint32_t(batch.pixels.size()), at_.slots}, n);
    trace_paths(work, n);
    units_.upload(launcher_, batch.units.data(), batch.units.size());
    spans_.upload(launcher_, batch.spans.data(), batch.spans.size());
    const auto [first, n_targets] = work.targets(batch.units);
    launcher_.run(AddToFilm{work.call.filter, int32_t(std::min(work.call.filter.reach(), MaxReach)),
                            int32_t(work.call.values), int32_t(work.moments), units_.get(),
                            uint32_t(batch.units.size()), spans_.get(), work.call.pixels ? targets_.get() : nullptr,
                            work.schedule.rect(), first, sums_.get(), open_.get(), at_.slots},
                  n_targets);
    launcher_.synchronize();
}

// As PathTile::run.
void DevicePaths::trace_paths(const Work &work, uint32_t n) {
    const PathConfig &config = work.call.config;
    const int depth = config.max_depth;
    PathQueue<float> *queues = at_.queues;
    launcher_.run(StartPaths{work.stage, queues[0], at_.out_key, n}, n);
    launcher_.run(FillWords{sorted_.n, n}, 1);  // in place of hits: all samples
    sort(at_.out_key, nullptr, sorted_.n, camera_, false, n);
    if (depth == 0) return;
    trace_hits(work, queues[0], camera_, config.hide_emitters, n);
    const bool scatters = depth < 0 || depth > 1;
    const int splits = scatters ? std::max(config.emitter_samples, config.bsdf_samples) : 1;
    for (int split = 0; split < splits; ++split) {
        if (split > 0) trace_hits(work, queues[0], camera_, false, n);
        step(work, {0, split, scatters}, queues[0], camera_, queues[1], n);
        PathQueue<float> *current = &queues[1], *next = &queues[2];
        for (int level = 1; depth < 0 || level < depth; ++level) {
            if (level % LevelsBetweenLooks == 0 && nothing_left()) break;
            trace_hits(work, *current, live_, false, n);
            step(work, {level, 0, depth < 0 || level + 1 < depth}, *current, live_, *next, n);
            std::swap(current, next);
        }
    }
}

void DevicePaths::trace_hits(const Work &work, const PathQueue<float> &queue, const EntryList &rays, bool passes,
                             uint32_t n) {
    launcher_.run(TracePaths{work.stage.scene, work.tree, queue, at_.hits, rays, totals_.get(), passes}, n);
}

// Shades what the rays have hit; those that go on are in `out`, and listed in live_.
void DevicePaths::step(const Work &work, const PathStep &at, PathQueue<float> &in, const EntryList &rays,
                       const PathQueue<float> &out, uint32_t n) {
    const int depth = work.call.config.max_depth;
    in.n = n;  // any entry of it may be asked for
    launcher_.run(ClassifyHits{work.stage, at, in, at_.hits, kinds_.get(), rays, at_.key}, n);
    sort(at_.key, &rays, rays.n, sorted_, true, n);
    const bool last = depth >= 0 && at.depth + 2 >= depth && work.call.scene->n_light_boxes >= 0;
    for (const int32_t kind : work.kinds)
        launcher_.run(ShadeHits{work.stage, at, kind, last, in, at_.hits, sorted_.entry, begin_.get(), total_.get(),
                                out, at_.shadows, at_.out_key, at_.shadow_key},
                      n, kind);
    if (!at.scatters) return;
    sort(at_.shadow_key, nullptr, sorted_.n, lit_, false, n);
    launcher_.run(TraceShadows{work.tree, at_.shadows, lit_, at_.slots.radiance, totals_.get() + 1}, n);
    sort(at_.out_key, nullptr, sorted_.n, live_, false, n);
}

bool DevicePaths::nothing_left() const {
    uint32_t n = 0;
    launcher_.download(&n, live_.n, sizeof n);
    return n == 0;
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

}  // namespace tr
