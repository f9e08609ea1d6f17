// Working through a plan: items on threads, batches of samples, blocks merged in order.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <map>
#include <memory>
#include <mutex>
#include <thread>

#include "columns.h"
#include "core/integrator/path.h"
#include "render.h"
#include "zeros.h"

namespace tr {

namespace detail {

// Who takes an item: the next free thread, or always the same one, so that what a thread sums up is repeatable.
enum class Schedule { Dynamic, Interleaved };

// Calls make(thread) on every thread, and what that returns, work(item, stop), for items until none is left. The
// calling thread, which is one of them, polls for an interruption: stop() asks for it and is called between batches.
template <class Make>
void run_items(size_t n_items, int threads, Schedule schedule, const std::function<bool()> &interrupted,
               bool &was_interrupted, Make &&make) {
    std::atomic<size_t> next{0};
    std::atomic<bool> stop{false};
    std::exception_ptr error;
    std::mutex mutex;
    std::condition_variable finished;
    int running = 0;
    auto fail = [&] {
        std::lock_guard<std::mutex> lock(mutex);
        if (!error) error = std::current_exception();
        stop = true;
    };
    auto poll = [&] {
        if (!stop && interrupted && interrupted()) {
            was_interrupted = true;
            stop = true;
        }
    };
    auto body = [&](int thread) {
        try {
            auto work = make(thread);
            bool fixed = schedule == Schedule::Interleaved;
            for (size_t item = fixed ? size_t(thread) : next++; item < n_items && !stop;
                 item = fixed ? item + size_t(threads) : next++) {
                work(item, [&] {
                    if (thread == 0) poll();
                    return stop.load();
                });
            }
        } catch (...) {
            fail();
        }
    };
    std::vector<std::thread> others;
    try {
        for (int t = 1; t < threads && size_t(t) < n_items; ++t) {
            {
                std::lock_guard<std::mutex> lock(mutex);
                ++running;
            }
            others.emplace_back([&, t] {
                body(t);
                std::lock_guard<std::mutex> lock(mutex);
                --running;
                finished.notify_one();
            });
        }
    } catch (...) {  // no more threads to be had
        fail();
        std::lock_guard<std::mutex> lock(mutex);
        --running;
    }
    body(0);
    for (std::unique_lock<std::mutex> lock(mutex); running > 0;) {
        finished.wait_for(lock, std::chrono::milliseconds(20));
        lock.unlock();
        poll();
        lock.lock();
    }
    for (auto &t : others) t.join();
    if (error) std::rethrow_exception(error);
}

// Adds the blocks of items to the film in the order of the items, whoever finishes first.
class OrderedMerge {
public:
    OrderedMerge(const Plan &plan, Film &film, int threads)
        : plan_(plan), film_(film), limit_(64 + 4 * size_t(threads)) {}

    // Blocks by unit. Waits while too much is waiting, so that memory stays constant.
    template <class Stop>
    void push(size_t item, std::vector<FilmBlock> &&blocks, Stop &&stop) {
        std::unique_lock<std::mutex> lock(mutex_);
        while (item != next_ && waiting_.size() >= limit_) {
            merged_.wait_for(lock, std::chrono::milliseconds(5));
            lock.unlock();
            bool stopped = stop();
            lock.lock();
            if (stopped) return;
        }
        waiting_.emplace(item, std::move(blocks));
        for (auto it = waiting_.find(next_); it != waiting_.end(); it = waiting_.find(next_)) {
            Units units = plan_.units(next_);
            for (size_t u = 0; u < units.size(); ++u) film_.add(plan_.tile(units.tile_of(u)), it->second[u]);
            waiting_.erase(it);
            ++next_;
            merged_.notify_all();
        }
    }

private:
    const Plan &plan_;
    Film &film_;
    size_t limit_;
    std::mutex mutex_;
    std::condition_variable merged_;
    std::map<size_t, std::vector<FilmBlock>> waiting_;
    size_t next_ = 0;
};

// Samples k .. end of a batch, whose values are in columns.
template <class Columns, class S, int N>
void splat_span(FilmBlock &block, const Filter &filter, const Columns &at, size_t k, size_t end, S *const (&value)[N]) {
    while (k < end) {
        int row = int32_t(at.row[k]), column = int32_t(at.column[k]);
        if (filter.reach() == 0) {
            size_t begin = k;
            while (k < end && at.pixel[k] == at.pixel[begin]) ++k;
            block.splat_pixel(row, column, begin, k, value);
            continue;
        }
        double v[N];
        for (int c = 0; c < N; ++c) v[c] = double(value[c][k]);
        block.splat(filter, row, column, double(at.film_y[k]), double(at.film_x[k]), v);
        ++k;
    }
}

// A block for every unit of an item.
inline std::vector<FilmBlock> blocks_of(const Plan &plan, size_t item, int values, int moments = 0) {
    Units units = plan.units(item);
    std::vector<FilmBlock> blocks(units.size());
    for (size_t u = 0; u < blocks.size(); ++u) blocks[u].reset(plan.tile(units.tile_of(u)).reached, values, moments);
    return blocks;
}

inline void sum_stats(RenderStats &to, const RenderStats &from) {
    to.non_finite += from.non_finite;
    to.closest_rays += from.closest_rays;
    to.shadow_rays += from.shadow_rays;
    to.lanes += from.lanes;
    to.lane_slots += from.lane_slots;
    to.collisions += from.collisions;
    to.majorants_exceeded += from.majorants_exceeded;
    to.seconds_trace += from.seconds_trace;
    if (to.non_finite_where.empty()) to.non_finite_where = from.non_finite_where;
}

// Pixels are numbered alike whatever is rendered of a film, those outside of it included.
inline uint32_t pixel_number(int y, int x) { return (uint32_t(y + 32768) << 16) + uint32_t(x + 32768); }

// Paths begin .. end of a batch belong to one unit of the item and, where pixels have numbers of samples of their own,
// to one pixel. A path counts `weight` times: the plan's number of samples over the pixel's.
struct Span {
    size_t unit;
    uint32_t begin, end;
    double weight;
};

// Calls body(n, spans) for batches of an item's paths, whose identities are set.
template <class S, class Columns, class Stop, class Body>
void for_batches(Columns &to, const RenderCall<S> &call, const Plan &plan, size_t item, size_t capacity, Stop &&stop,
                 Body &&body) {
    Units units = plan.units(item);
    std::vector<Span> spans;
    size_t n = 0;
    for (size_t u = 0; u < units.size(); ++u) {
        Tile tile = plan.tile(units.tile_of(u));
        size_t begin = n;
        double weight = 1;
        auto close_span = [&] {
            if (n > begin) spans.push_back({u, uint32_t(begin), uint32_t(n), weight});
            begin = n;
        };
        for (size_t p = 0; p < tile.n; ++p) {
            Pixel at = tile.pixel(p);
            uint32_t number = pixel_number(at.y, at.x);
            auto [first, last] = plan.samples(units, u, tile, p);
            if (tile.counts) weight = double(plan.spp()) / double(std::max(1u, tile.counts[p]));
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
Plan make_plan(const RenderCall<S> &call) {
    if (!call.pixels) return Plan(call.crop, call.samples, call.filter.reach(), call.spp);
    return Plan(*call.pixels, call.samples, call.filter.reach(), call.spp);
}

// The identities of a batch of samples, where no paths are traced.
template <class S>
struct SampleColumns {
    Arena arena;
    uint32_t *row, *column, *pixel, *sample;
    S *film_y, *film_x;

    explicit SampleColumns(size_t capacity) {
        arena.allocate([&](Arena &a) {
            for (uint32_t **p : {&row, &column, &pixel, &sample}) a.column(*p, capacity + MaxWidth);
            for (S **p : {&film_y, &film_x}) a.column(*p, capacity + MaxWidth);
        });
    }
    static constexpr size_t MaxWidth = 16;
};

// Film positions of the first n samples, as PathTile::start chooses them.
template <class F, class Columns>
void choose_positions(const PathConfig &config, Columns &at, size_t n) {
    for (size_t i = 0; i < n; i += size_t(Lanes<F>::Width)) {
        Random4<F> u = draw4<F>(config, load_uint<F>(at.pixel + i), load_uint<F>(at.sample + i), 0, 2);
        store(at.film_x + i, F(IntOf<F>(load_uint<F>(at.column + i))) + u.u[0]);
        store(at.film_y + i, F(IntOf<F>(load_uint<F>(at.row + i))) + u.u[1]);
    }
}

// The sum of filter weights of every wanted pixel, of samples that count as their spans say.
template <class F>
std::unique_ptr<Film> sum_weights(const RenderCall<ScalarOf<F>> &call, const Plan &plan, RenderStats &stats) {
    auto film = std::make_unique<Film>(plan, FilmBlock::channels(0, 0));
    if (call.filter.reach() == 0) {
        for (size_t i = 0; i < plan.n_targets(); ++i) *film->at(i) = double(plan.spp());
        return film;
    }
    OrderedMerge merge(plan, *film, call.threads);
    const size_t capacity = 1024;
    run_items(plan.n_items(), call.threads, Schedule::Dynamic, call.interrupted, stats.interrupted, [&](int) {
        auto at = std::make_shared<SampleColumns<ScalarOf<F>>>(capacity);
        return [&, at](size_t item, auto &&stop) {
            std::vector<FilmBlock> blocks = blocks_of(plan, item, 0);
            for_batches(*at, call, plan, item, capacity, stop, [&](size_t n, const std::vector<Span> &spans) {
                choose_positions<F>(call.config, *at, n);
                for (const Span &span : spans)
                    for (size_t k = span.begin; k < span.end; ++k)
                        blocks[span.unit].add_weight(call.filter, int32_t(at->row[k]), int32_t(at->column[k]),
                                                     double(at->film_y[k]), double(at->film_x[k]), span.weight);
            });
            merge.push(item, std::move(blocks), stop);
        };
    });
    return film;
}

// The part of a film that the samples of an item reach, a block a unit.
inline std::vector<FilmBlock> adjoint_blocks(const Plan &plan, size_t item, const Film &adjoint, int channels) {
    std::vector<FilmBlock> blocks = blocks_of(plan, item, channels);
    Units units = plan.units(item);
    for (size_t u = 0; u < blocks.size(); ++u)
        plan.for_targets(plan.tile(units.tile_of(u)), [&](size_t target, int y, int x) {
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
    template <class Sink>
    void connect(const DerivativeCall<S> &derivative, Sink &sink) {
        auto table = [](std::vector<double> &v) { return v.empty() ? nullptr : v.data(); };
        sink.constants = sums.constants.data();
        sink.tensors = pointers.data();
        sink.geometry = {table(sums.positions), table(sums.normals), table(sums.texcoords), derivative.matrices,
                         derivative.shape_wanted.data()};
    }

private:
    std::vector<Zeros<S>> memory_;
};

// Adds what the threads have summed up, in their order.
template <class S>
void add_buffers(const std::vector<GradientBuffers<S>> &buffers, DerivativeCall<S> &derivative) {
    for (const GradientBuffers<S> &buffer : buffers)
        if (!buffer.pointers.empty()) derivative.sums.add(buffer.sums);  // a thread may never have started
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
    run_items(parts.size(), threads, Schedule::Dynamic, nullptr, interrupted, [&](int) {
        return [&](size_t item, auto &&) {
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

// Double precision, which is for checking, is rendered a path at a time.
template <class S>
struct PacketOf {
    using type = S;
};
#if TR_HAS_PACKETS
template <>
struct PacketOf<float> {
    using type = FloatPacket;
};
#endif
}  // namespace detail

}  // namespace tr
