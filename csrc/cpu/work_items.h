// Working through a tile schedule: work items on threads, batches of samples, blocks merged in order.
#pragma once

#include <algorithm>
#include <condition_variable>
#include <map>
#include <memory>
#include <mutex>

#include "arena.h"
#include "core/integrator/camera.h"
#include "render.h"
#include "zeros.h"

namespace tr {

// Who takes an item: the next free thread, or always the same one, so that what a thread sums up is repeatable.
enum class Assignment { Dynamic, Interleaved };

// Calls make(thread) on every thread, and what that returns, work(item, stop), for items until none is left. The
// calling thread, which is one of them, polls for an interruption, telling which share of the items is done: stop()
// asks for it and is called between batches.
using ItemWork = std::function<void(size_t, const Stop &)>;
void run_items(size_t n_items, int threads, Assignment assignment, const std::function<bool(double)> &interrupted,
               bool &was_interrupted, const std::function<ItemWork(int)> &make);

// Adds the blocks of items to the film in the order of the items, whoever finishes first.
class OrderedMerge {
public:
    OrderedMerge(const TileSchedule &schedule, Film &film, int threads)
        : schedule_(schedule), film_(film), limit_(64 + 4 * size_t(threads)) {}

    // Blocks by unit. Waits while too much is waiting, so that memory stays constant.
    void push(size_t item, std::vector<FilmBlock> &&blocks, const Stop &stop);

private:
    const TileSchedule &schedule_;
    Film &film_;
    size_t limit_;
    std::mutex mutex_;
    std::condition_variable merged_;
    std::map<size_t, std::vector<FilmBlock>> waiting_;
    size_t next_ = 0;
};

// Samples k .. end of a batch, whose values are in columns.
template <class F, class Columns, class S>
void splat_span(FilmBlock &block, const Filter &filter, const Columns &at, size_t k, size_t end, S *const *value,
                int values) {
    if (filter.reach() == 0) {
        while (k < end) {
            const size_t begin = k;
            while (k < end && at.pixel[k] == at.pixel[begin]) ++k;
            block.splat_pixel(int32_t(at.row[begin]), int32_t(at.column[begin]), begin, k, value);
        }
        return;
    }
    if (!block.is_usual())
        return for_film_places<F>(filter, at, k, end, [&](size_t i, const FilmPlace<F> &place) {
            double v[4 * SpectrumSize + 1];
            for (int c = 0; c < values; ++c) v[c] = double(value[c][i]);
            block.splat(place, v);
        });
    using Values = FilmBlock::UsualValues;
    const auto get = [&](size_t i, Values &v) {
        v = Values{double(value[0][i]), double(value[1][i]), double(value[2][i]), double(value[3][i])};
    };
    const auto run = [&](size_t first, const SplatAxes<F> &axes, int begin, int last) {
        Values v[Lanes<F>::Width], nothing{};
        for (int i = begin; i < last; ++i) get(first + size_t(i), v[i]), nothing += v[i] - v[i];
        for (int c = 0; c < FilmBlock::Usual; ++c)
            if (nothing[c] != 0) return false;  // not finite
        block.splat_run(axes, begin, last, v);
        return true;
    };
    for_film_runs<F>(filter, at, k, end, run, [&](size_t i, const FilmPlace<F> &place) {
        Values v;
        get(i, v);
        double numbers[FilmBlock::Usual];
        std::memcpy(numbers, &v, sizeof(v));
        block.splat(place, numbers);
    });
}

// A block for every unit of an item.
inline std::vector<FilmBlock> blocks_of(const TileSchedule &schedule, size_t item, int values, int moments = 0) {
    WorkItem work = schedule.work_item(item);
    std::vector<FilmBlock> blocks(work.size());
    for (size_t u = 0; u < blocks.size(); ++u) blocks[u].reset(schedule.tile(work.tile_of(u)).reached, values, moments);
    return blocks;
}

// The same with a tile of paths a thread: make_tile(thread) makes it, work(tile, item, thread, stop) has an item.
template <class S, class MakeTile, class Work>
void run_tiles(size_t n_items, const RenderCall<S> &call, Assignment assignment, RenderStats &stats,
               MakeTile &&make_tile, Work &&work) {
    std::mutex mutex;
    run_items(n_items, call.threads, assignment, call.interrupted, stats.interrupted, [&](int thread) {
        auto tile = make_tile(thread);
        return [&, thread, tile = std::shared_ptr(std::move(tile))](size_t item, const Stop &stop) {
            work(*tile, item, thread, stop);
            RenderStats found = tile->take_stats();
            std::lock_guard<std::mutex> lock(mutex);
            stats.add(found);
        };
    });
}

// Paths begin .. end of a batch belong to one unit of the item and, where pixels have numbers of samples of their own,
// to one pixel. A path counts `weight` times: the schedule's number of samples over the pixel's.
struct Span {
    size_t unit;
    uint32_t begin, end;
    double weight;
};

// visit(span, k, place) for the samples of all spans.
template <class F, class Columns, class Visit>
void for_film_places(const Filter &filter, const Columns &at, const std::vector<Span> &spans, Visit &&visit) {
    for (const Span &span : spans)
        for_film_places<F>(filter, at, span.begin, span.end,
                           [&](size_t k, const FilmPlace<F> &place) { visit(span, k, place); });
}

// Calls body(n, spans) for batches of an item's paths, whose identities are set.
template <class S, class Columns, class Body>
void for_batches(const Columns &to, const RenderCall<S> &call, const TileSchedule &schedule, size_t item,
                 size_t capacity, const Stop &stop, Body &&body) {
    WorkItem work = schedule.work_item(item);
    std::vector<Span> spans;
    size_t n = 0;
    for (size_t u = 0; u < work.size(); ++u) {
        Tile tile = schedule.tile(work.tile_of(u));
        size_t begin = n;
        double weight = 1;
        auto close_span = [&] {
            if (n > begin) spans.push_back({u, uint32_t(begin), uint32_t(n), weight});
            begin = n;
        };
        for (size_t p = 0; p < tile.n; ++p) {
            Pixel at = tile.pixel(p);
            uint32_t number = pixel_number(at.y, at.x);
            auto [first, last] = schedule.samples(work, u, tile, p);
            if (tile.counts) weight = double(schedule.spp()) / double(std::max(1u, tile.counts[p]));
            for (int64_t s = first; s < last;) {
                for (; s < last && n < capacity; ++s, ++n) {
                    to.row[n] = uint32_t(at.y);
                    to.column[n] = uint32_t(at.x);
                    to.pixel[n] = number;
                    to.sample[n] = uint32_t(call.sample_offset + s);
                }
                if (n < capacity) continue;
                close_span();
                if (stop()) return;
                body(n, spans);
                spans.clear();
                n = begin = 0;
            }
            if (tile.counts) close_span();
        }
        close_span();
    }
    if (n > 0 && !stop()) body(n, spans);
}

template <class S>
TileSchedule make_schedule(const RenderCall<S> &call) {
    if (!call.pixels) return TileSchedule(call.crop, call.samples, call.filter.reach(), call.spp);
    return TileSchedule(*call.pixels, call.samples, call.filter.reach(), call.spp);
}

// The identities of a batch of samples, where no paths are traced.
template <class S>
struct SampleBatch {
    Arena arena;
    SampleColumns<S> columns;
    RenderStats take_stats() const { return {}; }

    explicit SampleBatch(size_t capacity) { arena.allocate(capacity + 16, columns); }
};

// Film positions of the first n samples, as paths begin there.
template <class F, class Columns>
void choose_positions(const PathConfig &config, const Columns &at, size_t n) {
    for (size_t i = 0; i < n; i += size_t(Lanes<F>::Width)) choose_position<F>(config, at, false, i);
}

// The sum of filter weights of every wanted pixel, of samples that count as their spans say.
template <class F>
std::unique_ptr<Film> sum_weights(const RenderCall<ScalarOf<F>> &call, const TileSchedule &schedule,
                                  RenderStats &stats) {
    auto film = std::make_unique<Film>(schedule, FilmBlock::channels(0, 0));
    if (call.filter.reach() == 0) {
        for (size_t i = 0; i < schedule.n_targets(); ++i) *film->at(i) = double(schedule.spp());
        return film;
    }
    using Batch = SampleBatch<ScalarOf<F>>;
    OrderedMerge merge(schedule, *film, call.threads);
    const size_t capacity = 1024;
    auto make = [&](int) { return std::make_unique<Batch>(capacity); };
    RenderCall<ScalarOf<F>> silent = call;  // these are no share of what somebody waits for
    if (call.interrupted) silent.interrupted = [&](double) { return call.interrupted(0); };
    run_tiles(schedule.n_items(), silent, Assignment::Dynamic, stats, make,
              [&](Batch &batch, size_t item, int, const Stop &stop) {
                  const auto &at = batch.columns;
                  std::vector<FilmBlock> blocks = blocks_of(schedule, item, 0);
                  for_batches(at, call, schedule, item, capacity, stop, [&](size_t n, const std::vector<Span> &spans) {
                      choose_positions<F>(call.config, at, n);
                      for (const Span &span : spans) {
                          FilmBlock &block = blocks[span.unit];
                          for_film_runs<F>(
                              call.filter, at, span.begin, span.end,
                              [&](size_t, const SplatAxes<F> &axes, int begin, int last) {
                                  if (span.weight != 1) return false;
                                  block.add_weights(axes, begin, last);
                                  return true;
                              },
                              [&](size_t, const FilmPlace<F> &place) { block.add_weight(place, span.weight); });
                      }
                  });
                  merge.push(item, std::move(blocks), stop);
              });
    return film;
}

// The part of a film that the samples of an item reach, a block a unit.
inline std::vector<FilmBlock> adjoint_blocks(const TileSchedule &schedule, size_t item, const Film &adjoint,
                                             int channels) {
    std::vector<FilmBlock> blocks = blocks_of(schedule, item, channels);
    WorkItem work = schedule.work_item(item);
    for (size_t u = 0; u < blocks.size(); ++u)
        schedule.for_targets(schedule.tile(work.tile_of(u)), [&](size_t target, int y, int x) {
            std::copy_n(adjoint.at(target), channels, blocks[u].at(y, x));
        });
    return blocks;
}

// What a thread adds up in reverse mode: in buffers of its own, but the calling thread in the gradients themselves.
template <class S>
struct GradientBuffers {
    GradientSums sums;
    std::vector<S *> pointers;

    void allocate(const DerivativeCall<S> &derivative, int thread) {
        if (!pointers.empty()) return;
        sums.reset(derivative.n_constants, derivative.geometry_sizes);
        if (thread == 0) {
            pointers = derivative.gradients;
            return;
        }
        pointers.assign(derivative.gradients.size(), nullptr);
        for (size_t i = 0; i < pointers.size(); ++i) {
            if (!derivative.gradients[i]) continue;
            memory_.emplace_back(size_t(derivative.sizes[i]));
            pointers[i] = memory_.back().data();
        }
    }
    template <class F>
    GradientSink<F> sink(const DerivativeCall<S> &derivative) {
        GradientSink<F> r;
        r.matrices = derivative.matrices;
        r.shape_wanted = derivative.shapes.data();
        r.constants = sums.constants.data();
        r.tensors = pointers.data();
        std::vector<double> *arrays[VertexArrays] = {&sums.positions, &sums.normals, &sums.texcoords};
        for (int k = 0; k < VertexArrays; ++k) r.vertices[k] = arrays[k]->empty() ? nullptr : arrays[k]->data();
        return r;
    }

private:
    std::vector<Zeros<S>> memory_;
};

// Adds what the threads have summed up, in their order. The sums of the first one become those of all.
template <class S>
void add_buffers(std::vector<GradientBuffers<S>> &buffers, DerivativeCall<S> &derivative) {
    bool first = true;
    for (GradientBuffers<S> &buffer : buffers) {
        if (buffer.pointers.empty()) continue;  // a thread may never have started
        if (first)
            derivative.sums = std::move(buffer.sums);
        else
            derivative.sums.add(buffer.sums, int(buffers.size()));
        first = false;
    }
    if (first) derivative.sums.reset(derivative.n_constants, derivative.geometry_sizes);
    struct Part {
        size_t tensor, begin, end;
    };
    std::vector<Part> parts;
    constexpr size_t size = 1 << 16;
    for (size_t i = 0; i < derivative.gradients.size(); ++i)
        if (derivative.gradients[i])
            for (size_t begin = 0, n = size_t(derivative.sizes[i]); begin < n; begin += size)
                parts.push_back({i, begin, std::min(n, begin + size)});
    bool interrupted = false;
    // few parts are not worth a thread
    int threads = parts.size() < 8 ? 1 : int(buffers.size());
    run_items(parts.size(), threads, Assignment::Dynamic, nullptr, interrupted, [&](int) {
        return [&](size_t item, const Stop &) {
            const Part &part = parts[item];
            for (size_t b = 1; b < buffers.size(); ++b) {
                if (buffers[b].pointers.empty()) continue;
                const S *from = buffers[b].pointers[part.tensor];
                S *to = derivative.gradients[part.tensor];
                for (size_t k = part.begin; k < part.end; ++k) to[k] += from[k];
            }
        };
    });
}

}  // namespace tr
