// Scheduling on the CPU: tiles of the film on threads. Included by the small files in variants/, which say for which
// arithmetic and colour it is compiled.
#pragma once

#include <atomic>
#include <exception>
#include <thread>

#include "cpu/path_tile.h"

namespace tr {

namespace detail {

constexpr int TileSize = 16;  // pixels on a side

// Who renders a tile: the next free thread, or always the same one, so that what a thread sums up is repeatable.
enum class Schedule { Dynamic, Interleaved };

// A thread's share: calls work(tile) for tiles until none is left; the calling thread polls for an interruption.
template <class Make>
void run_tiles(size_t n_tiles, int threads, Schedule schedule, const std::function<bool()> &interrupted,
               bool &was_interrupted, Make &&make) {
    std::atomic<size_t> next{0};
    std::atomic<bool> stop{false};
    std::exception_ptr error;
    std::mutex mutex;
    auto body = [&](int thread) {
        try {
            auto work = make(thread);
            bool fixed = schedule == Schedule::Interleaved;
            for (size_t tile = fixed ? size_t(thread) : next++; tile < n_tiles && !stop;
                 tile = fixed ? tile + size_t(threads) : next++) {
                work(tile, [&] {  // asked between batches of paths
                    if (thread == 0 && interrupted && interrupted()) {
                        was_interrupted = true;
                        stop = true;
                    }
                    return stop.load();
                });
            }
        } catch (...) {
            std::lock_guard<std::mutex> lock(mutex);
            if (!error) error = std::current_exception();
            stop = true;
        }
    };
    std::vector<std::thread> others;
    for (int t = 1; t < threads; ++t) others.emplace_back(body, t);
    body(0);
    for (auto &t : others) t.join();
    if (error) std::rethrow_exception(error);
}

struct Tiles {
    Rect samples;
    int y0, x0, columns, rows;
    explicit Tiles(const Rect &s) : samples(s) {
        auto down = [](int a) { return (a >= 0 ? a : a - TileSize + 1) / TileSize; };
        y0 = down(s.y0), x0 = down(s.x0);
        rows = s.height() > 0 ? down(s.y1 - 1) - y0 + 1 : 0;
        columns = s.width() > 0 ? down(s.x1 - 1) - x0 + 1 : 0;
    }
    size_t size() const { return size_t(rows) * size_t(columns); }
    Rect rect(size_t i) const {
        int y = (y0 + int(i) / columns) * TileSize, x = (x0 + int(i) % columns) * TileSize;
        return intersect(samples, {y, x, y + TileSize, x + TileSize});
    }
};

template <class S>
void sum_stats(RenderStats &to, const RenderStats &from) {
    to.non_finite += from.non_finite;
    to.closest_rays += from.closest_rays;
    to.shadow_rays += from.shadow_rays;
    to.lanes += from.lanes;
    to.lane_slots += from.lane_slots;
    to.seconds_trace += from.seconds_trace;
    if (to.non_finite_where.empty()) to.non_finite_where = from.non_finite_where;
}

// Pixels are numbered alike whatever is rendered of a film, those outside of it included.
inline uint32_t pixel_number(int y, int x) { return uint32_t(y + 32768) << 16 | uint32_t(x + 32768); }

// Calls body(n) for batches of the tile's paths, whose identities are set.
template <class F, int C, class S, class Stop, class Body>
void for_batches(PathTile<F, C> &tile, const RenderCall<S> &call, const Rect &r, size_t capacity, Stop &&stop,
                 Body &&body) {
    size_t pixels = size_t(r.height()) * size_t(r.width()), total = pixels * size_t(call.spp);
    for (size_t begin = 0; begin < total && !stop(); begin += capacity) {
        size_t n = std::min(capacity, total - begin);
        size_t p = begin / size_t(call.spp), s = begin % size_t(call.spp);
        int y = r.y0 + int(p) / r.width(), x = r.x0 + int(p) % r.width();
        for (size_t k = 0; k < n; ++k) {
            tile.row[k] = uint32_t(y);
            tile.column[k] = uint32_t(x);
            tile.pixel[k] = pixel_number(y, x);
            tile.sample[k] = uint32_t(call.sample_offset + int64_t(s));
            if (++s < size_t(call.spp)) continue;
            s = 0;
            if (++x == r.x1) x = r.x0, ++y;
        }
        body(n);
    }
}

template <class S>
Rect reach_of(const RenderCall<S> &call, const Rect &r) {
    int k = call.filter.reach();
    return intersect(call.crop, {r.y0 - k, r.x0 - k, r.y1 + k, r.x1 + k});
}

// Primal and forward mode: every path has a value, which is splatted.
template <class F, int C, bool Forward>
RenderStats splat_paths(const RenderCall<ScalarOf<F>> &call, const DerivativeCall<ScalarOf<F>> *derivative,
                        ScalarOf<F> *image, ScalarOf<F> *alpha) {
    using S = ScalarOf<F>;
    RenderStats stats;
    auto begin = std::chrono::steady_clock::now();
    Tiles tiles(call.samples);
    FilmBlock film;
    film.reset(call.crop, C + 2);
    OrderedMerge merge(film);
    std::mutex mutex;
    const size_t capacity = Forward ? 256 : 1024;
    run_tiles(tiles.size(), call.threads, Schedule::Dynamic, call.interrupted, stats.interrupted, [&](int) {
        auto tile = std::make_shared<PathTile<F, C>>(call, capacity, derivative);
        if (Forward) tile->set_bsdf_wanted(derivative->bsdf_wanted);
        return [&, tile](size_t index, auto &&stop) {
            Rect r = tiles.rect(index);
            FilmBlock block;
            block.reset(reach_of(call, r), C + 2);
            for_batches(*tile, call, r, capacity, stop, [&](size_t n) {
                tile->start(n, false);
                tile->template run<Forward>();
                if constexpr (Forward) {
                    ForwardSink<F, C> sink;
                    sink.tangent = derivative->tangent;
                    sink.geometry = derivative->geometry_tangent;
                    tile->sweep(sink, true);
                }
                for (size_t k = 0; k < n; ++k) {
                    double v[C + 1];
                    for (int c = 0; c < C; ++c) v[c] = double(tile->radiance[c][k]);
                    v[C] = double(tile->alpha[k]);
                    block.splat(call.filter, double(tile->film_y[k]), double(tile->film_x[k]), v);
                }
            });
            merge.push(index, std::move(block));
            std::lock_guard<std::mutex> lock(mutex);
            sum_stats<S>(stats, tile->stats);
            tile->stats = {};
        };
    });
    int w = call.crop.width();
    for (int y = call.crop.y0; y < call.crop.y1; ++y)
        for (int x = call.crop.x0; x < call.crop.x1; ++x) {
            const double *p = film.at(y, x);
            size_t i = size_t(y - call.crop.y0) * size_t(w) + size_t(x - call.crop.x0);
            double inverse = p[C + 1] != 0 ? 1 / p[C + 1] : 0;
            for (int c = 0; c < C; ++c) image[i * C + size_t(c)] = S(p[c] * inverse);
            if (alpha) alpha[i] = S(p[C] * inverse);
        }
    stats.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    return stats;
}

template <class S>
GeometryTables<double> geometry_tables(GradientSums &sums, const DerivativeCall<S> &derivative) {
    auto table = [](std::vector<double> &v) { return v.empty() ? nullptr : v.data(); };
    return {table(sums.positions), table(sums.normals), table(sums.texcoords), derivative.matrices,
            derivative.shape_wanted.data()};
}

template <class F, int C>
RenderStats reverse_paths(const RenderCall<ScalarOf<F>> &call, DerivativeCall<ScalarOf<F>> &derivative) {
    using S = ScalarOf<F>;
    RenderStats stats;
    auto begin = std::chrono::steady_clock::now();
    Tiles tiles(call.samples);
    const size_t capacity = 256;
    // sums of filter weights
    FilmBlock weights;
    weights.reset(call.crop, 1);
    auto position = [&](uint32_t y, uint32_t x, uint32_t sample, double &fy, double &fx) {
        Random4<S> u =
            random4<S>(call.config.seed, call.config.sensor, pixel_number(int32_t(y), int32_t(x)), sample, 0);
        fx = double(S(int32_t(x)) + u.u[0]), fy = double(S(int32_t(y)) + u.u[1]);
    };
    const int reach = call.filter.reach();  // 0: the box filter, whose weights are the number of samples
    for (int y = call.samples.y0; reach > 0 && y < call.samples.y1; ++y)
        for (int x = call.samples.x0; x < call.samples.x1; ++x)
            for (int64_t s = 0; s < call.spp; ++s) {
                double fy, fx;
                position(uint32_t(y), uint32_t(x), uint32_t(call.sample_offset + s), fy, fx);
                weights.splat(call.filter, fy, fx, nullptr);
            }
    struct Local {
        GradientSums sums;
        std::vector<std::vector<S>> buffers;
        std::vector<S *> pointers;
    };
    std::vector<Local> locals{size_t(call.threads)};
    std::mutex mutex;
    run_tiles(tiles.size(), call.threads, Schedule::Interleaved, call.interrupted, stats.interrupted, [&](int thread) {
        Local &local = locals[size_t(thread)];
        local.sums.reset(derivative.n_constants, derivative.geometry_sizes);
        for (size_t i = 0; i < derivative.gradients.size(); ++i) {
            local.buffers.emplace_back();
            if (derivative.gradients[i]) local.buffers[i].assign(size_t(derivative.sizes[i]), S(0));
            local.pointers.push_back(derivative.gradients[i] ? local.buffers[i].data() : nullptr);
        }
        auto tile = std::make_shared<PathTile<F, C>>(call, capacity, &derivative);
        tile->set_bsdf_wanted(derivative.bsdf_wanted);
        return [&, tile](size_t index, auto &&stop) {
            Rect r = tiles.rect(index);
            for_batches(*tile, call, r, capacity, stop, [&](size_t n) {
                for (size_t k = 0; k < n; ++k) {
                    if (reach == 0) {
                        int y = int32_t(tile->row[k]), x = int32_t(tile->column[k]);
                        bool inside = call.crop.contains(y, x);
                        const S *a = derivative.adjoint;
                        if (inside)
                            a += (size_t(y - call.crop.y0) * size_t(call.crop.width()) + size_t(x - call.crop.x0)) * C;
                        for (int c = 0; c < C; ++c) tile->delta[c][k] = inside ? a[c] / S(call.spp) : S(0);
                        continue;
                    }
                    double fy, fx, d[C] = {};
                    position(tile->row[k], tile->column[k], tile->sample[k], fy, fx);
                    int py = int(std::floor(fy)), px = int(std::floor(fx));
                    for (int y = py - reach; y <= py + reach; ++y)
                        for (int x = px - reach; x <= px + reach; ++x) {
                            if (!call.crop.contains(y, x)) continue;
                            double w = call.filter(y + 0.5 - fy) * call.filter(x + 0.5 - fx);
                            double total = *weights.at(y, x);
                            if (w == 0 || total == 0) continue;
                            const S *a =
                                derivative.adjoint +
                                (size_t(y - call.crop.y0) * size_t(call.crop.width()) + size_t(x - call.crop.x0)) * C;
                            for (int c = 0; c < C; ++c) d[c] += w / total * double(a[c]);
                        }
                    for (int c = 0; c < C; ++c) tile->delta[c][k] = S(d[c]);
                }
                tile->start(n, true);
                tile->template run<true>();
                ReverseSink<F, C> sink;
                sink.constants = local.sums.constants.data();
                sink.geometry = geometry_tables(local.sums, derivative);
                sink.tensors = local.pointers.data();
                tile->sweep(sink, false);
            });
            std::lock_guard<std::mutex> lock(mutex);
            sum_stats<S>(stats, tile->stats);
            tile->stats = {};
        };
    });
    derivative.sums.reset(derivative.n_constants, derivative.geometry_sizes);
    for (Local &local : locals) {
        if (local.sums.constants.empty()) continue;  // a thread that never started
        derivative.sums.add(local.sums);
        for (size_t i = 0; i < local.buffers.size(); ++i)
            for (size_t k = 0; k < local.buffers[i].size(); ++k) derivative.gradients[i][k] += local.buffers[i][k];
    }
    stats.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    return stats;
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

template <class S, int C>
RenderStats render_primal(const RenderCall<S> &call, bool packets, S *image, S *alpha) {
    if (packets) return detail::splat_paths<typename detail::PacketOf<S>::type, C, false>(call, nullptr, image, alpha);
    return detail::splat_paths<S, C, false>(call, nullptr, image, alpha);
}
template <class S, int C>
RenderStats render_forward(const RenderCall<S> &call, bool packets, const DerivativeCall<S> &derivative, S *image) {
    if (packets)
        return detail::splat_paths<typename detail::PacketOf<S>::type, C, true>(call, &derivative, image, nullptr);
    return detail::splat_paths<S, C, true>(call, &derivative, image, nullptr);
}
template <class S, int C>
RenderStats render_reverse(const RenderCall<S> &call, bool packets, DerivativeCall<S> &derivative) {
    if (packets) return detail::reverse_paths<typename detail::PacketOf<S>::type, C>(call, derivative);
    return detail::reverse_paths<S, C>(call, derivative);
}

}  // namespace tr
