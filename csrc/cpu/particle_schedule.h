// Light paths on the CPU: as schedule.h, but what a path brings may be anywhere on the film. The items of the plan are
// divided into groups, as many whatever the number of threads; a group has a film of its own, and films are added, in
// double precision, in the order of their groups.
#pragma once

#include "items.h"
#include "particle_tile.h"
#include "splat.h"

namespace tr {

namespace detail {

// Spp paths start in every pixel, taken as a stratum of the emitters.
template <class S>
Plan plan_of_light(const RenderCall<S> &call) {
    Rect film{0, 0, call.film_height, call.film_width};
    return Plan(film, film, 0, call.spp);
}

// What sums over all paths are multiplied with, by row and column: the image is the average that the path tracer takes
// of a film with `sample_border`. Light counts beyond the film's edge, too, as far as filters reach: it may cross it
// when things move. A surface that measures ends at the film's edge, and so do the averages.
template <class S>
class LightScale {
public:
    explicit LightScale(const RenderCall<S> &call)
        : call_(call),
          paths_(double(call.spp) * call.film_height * call.film_width),
          measured_(call.scene->sensors[call.config.sensor].kind == IrradianceMeterKind) {}

    double operator()(int row, int column) const {
        return 1 / (paths_ * within(row, call_.film_height) * within(column, call_.film_width));
    }

private:
    double within(int pixel, int size) const {
        double center = pixel + 0.5;
        return measured_ ? call_.filter.integral(-center, size - center) : call_.filter.integral(-INFINITY, INFINITY);
    }
    const RenderCall<S> &call_;
    double paths_;
    bool measured_;
};

// The wanted pixels in the order of the results: visit(result, y, x).
template <class S, class Visit>
void for_results(const RenderCall<S> &call, Visit &&visit) {
    size_t i = 0;
    if (call.pixels) {
        for (const Pixel &p : *call.pixels) visit(i++, p.y, p.x);
        return;
    }
    for (int y = call.crop.y0; y < call.crop.y1; ++y)
        for (int x = call.crop.x0; x < call.crop.x1; ++x) visit(i++, y, x);
}

// Sums up films in the order of their numbers, whoever finishes first.
template <class S, int C>
class OrderedFilms {
public:
    explicit OrderedFilms(const Rect &rect) : total(rect) {}
    SplatFilm<double, C> total;

    void push(size_t number, std::unique_ptr<SplatFilm<S, C>> film) {
        std::lock_guard<std::mutex> lock(mutex_);
        waiting_.emplace(number, std::move(film));
        for (auto it = waiting_.find(next_); it != waiting_.end(); it = waiting_.find(++next_)) {
            total.add(*it->second);
            waiting_.erase(it);
        }
    }

private:
    std::mutex mutex_;
    std::map<size_t, std::unique_ptr<SplatFilm<S, C>>> waiting_;
    size_t next_ = 0;
};

template <class F, int C>
void splat_connections(const Filter &filter, const Connections<ScalarOf<F>, C> &free, SplatFilm<ScalarOf<F>, C> &film,
                       SplatAxes<F> &axes) {
    axes.for_places(filter, free.x, free.y, free.n, false, [&](size_t k, int lane) {
        typename SplatFilm<ScalarOf<F>, C>::Vector value{};
        for (int c = 0; c < C; ++c) value[c] = free.value[c][k];
        film.splat(axes.x, axes.y, lane, value);
    });
}

// The image's derivative along a tangent, of the connections of one level at a time: its sweeps give the derivatives
// of what they bring, channel by channel, and of their places.
template <class F, int C>
class LightTangents {
    using S = ScalarOf<F>;

public:
    LightTangents(const RenderCall<S> &call, const DerivativeCall<S> &derivative)
        : call_(call), derivative_(derivative) {}

    void keep(int level, const Connections<S, C> &free) {
        if (size_t(level) >= levels_.size()) levels_.resize(size_t(level) + 1);
        Kept &kept = levels_[size_t(level)];
        kept.x.assign(free.x, free.x + free.n), kept.y.assign(free.y, free.y + free.n);
        kept.slot.assign(free.slot, free.slot + free.n);
        kept.position.assign(free.position, free.position + free.n);
        for (int c = 0; c < C; ++c) kept.value[c].assign(free.value[c], free.value[c] + free.n);
    }

    void sweep(ParticleTile<F, C> &tile, size_t n, SplatFilm<S, C> &film) {
        ForwardSink<F, C> sink;
        sink.tangent = derivative_.tangent;
        sink.geometry = derivative_.geometry_tangent;
        const bool moves = derivative_.wanted.geometry;
        for (size_t level = 0; level < levels_.size(); ++level) {
            Kept &kept = levels_[level];
            if (kept.slot.empty()) continue;
            TapeLevel<S, C> &tape = tile.level_at(int(level));
            // what connections hand to the sweep: nothing, all channels, one of them, or C and C + 1 for the place
            constexpr int Nothing = -1, All = -2;
            auto set_adjoints = [&](int what) {
                for (uint32_t at : kept.position) {
                    for (int c = 0; c < C; ++c) tape.emitted[c][at] = S(what == All || what == c ? 1 : 0);
                    tape.light.x_bar[at] = S(what == C ? 1 : 0);
                    tape.light.y_bar[at] = S(what == C + 1 ? 1 : 0);
                }
            };
            std::vector<S> d[C + 2];
            auto sweep_for = [&](int what, int channel, std::vector<S> *to, int channels) {
                set_adjoints(what);
                for (int c = 0; c < C; ++c) std::fill_n(tile.radiance[c], n, S(0));
                sink.channel = channel;
                tile.sweep(sink);
                for (int c = channel; c < channel + channels; ++c, ++to)
                    for (uint32_t slot : kept.slot) to->push_back(tile.radiance[c][slot]);
            };
            if (moves)
                for (int what = 0; what < C + 2; ++what) sweep_for(what, what < C ? what : 0, &d[what], 1);
            else
                sweep_for(All, 0, d, C);
            set_adjoints(Nothing);  // they count no more
            splat(kept, d, moves, film);
            kept.slot.clear();
        }
    }

private:
    struct Kept {
        std::vector<S> x, y, value[C];
        std::vector<uint32_t> slot, position;
    };

    void splat(const Kept &kept, const std::vector<S> (&d)[C + 2], bool moves, SplatFilm<S, C> &film) {
        axes_.for_places(call_.filter, kept.x.data(), kept.y.data(), kept.x.size(), true, [&](size_t k, int lane) {
            typename SplatFilm<S, C>::Vector change{}, value{};
            for (int c = 0; c < C; ++c) change[c] = d[c][k], value[c] = kept.value[c][k];
            film.splat(axes_.x, axes_.y, lane, change);
            if (moves) film.splat_motion(axes_.x, axes_.y, lane, d[C][k], d[C + 1][k], value);
        });
    }

    const RenderCall<S> &call_;
    const DerivativeCall<S> &derivative_;
    std::vector<Kept> levels_;
    SplatAxes<F> axes_;
};

// Primal and forward mode.
template <class F, int C, bool Forward>
RenderStats splat_light(const RenderCall<ScalarOf<F>> &call, const DerivativeCall<ScalarOf<F>> *derivative,
                        ScalarOf<F> *image) {
    using S = ScalarOf<F>;
    RenderStats stats;
    auto begin = std::chrono::steady_clock::now();
    Plan plan = plan_of_light(call);
    const size_t capacity = Forward ? 512 : 1024;
    // Enough for many threads, but few enough that adding up films is less work than tracing; not a matter of the crop,
    // whose pixels are to be those of the whole bit for bit.
    const size_t fitting = std::min<size_t>(64, std::max<size_t>(16, size_t(call.spp) / 4));
    const size_t film_bytes = 16 * (size_t(call.film_height) * size_t(call.film_width) + 1);
    const size_t affordable =
        std::max<size_t>(4, (size_t(1) << 30) / film_bytes);  // films that wait for an earlier one
    const size_t groups = std::min({plan.n_items(), fitting, affordable});
    OrderedFilms<S, C> films(call.crop);
    std::mutex mutex;
    run_items(groups, call.threads, Schedule::Dynamic, call.interrupted, stats.interrupted, [&](int) {
        auto tile = std::make_shared<ParticleTile<F, C>>(call, capacity, derivative);
        auto splats = [&] {
            if constexpr (Forward)
                return std::make_shared<LightTangents<F, C>>(call, *derivative);
            else
                return std::make_shared<SplatAxes<F>>();
        }();
        return [&, tile, splats](size_t group, auto &&stop) {
            auto film = std::make_unique<SplatFilm<S, C>>(call.crop);
            const size_t end = plan.n_items() * (group + 1) / groups;
            for (size_t item = plan.n_items() * group / groups; item < end && !stop(); ++item)
                for_batches(*tile, call, plan, item, capacity, stop, [&](size_t n, const std::vector<Span> &) {
                    if constexpr (Forward) {
                        tile->template run<true>(
                            n, stop, [&](int level, const Connections<S, C> &free) { splats->keep(level, free); });
                        splats->sweep(*tile, n, *film);
                    } else {
                        tile->template run<false>(n, stop, [&](int, const Connections<S, C> &free) {
                            splat_connections<F, C>(call.filter, free, *film, *splats);
                        });
                    }
                });
            films.push(group, std::move(film));
            std::lock_guard<std::mutex> lock(mutex);
            sum_stats(stats, tile->stats);
            tile->stats = {};
        };
    });
    const LightScale<S> scale(call);
    for_results(call, [&](size_t i, int row, int column) {
        const double s = scale(row, column);
        for (int c = 0; c < C; ++c) image[i * C + size_t(c)] = S(films.total.at(row, column)[c] * s);
    });
    stats.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    return stats;
}

template <class F, int C>
RenderStats reverse_light(const RenderCall<ScalarOf<F>> &call, DerivativeCall<ScalarOf<F>> &derivative) {
    using S = ScalarOf<F>;
    RenderStats stats;
    auto begin = std::chrono::steady_clock::now();
    derivative.sums.reset(derivative.n_constants, derivative.geometry_sizes);
    Plan plan = plan_of_light(call);
    const size_t capacity = 512;
    using AdjointFilm = SplatFilm<S, C>;
    AdjointFilm adjoint(call.crop);
    const LightScale<S> scale(call);
    for_results(call, [&](size_t i, int row, int column) {
        const double s = scale(row, column);
        for (int c = 0; c < C; ++c) adjoint.at(row, column)[c] += S(double(derivative.adjoint[i * C + size_t(c)]) * s);
    });
    std::vector<GradientBuffers<S>> locals{size_t(call.threads)};
    std::mutex mutex;
    run_items(plan.n_items(), call.threads, Schedule::Interleaved, call.interrupted, stats.interrupted,
              [&](int thread) {
                  GradientBuffers<S> &local = locals[size_t(thread)];
                  local.allocate(derivative, thread);
                  auto tile = std::make_shared<ParticleTile<F, C>>(call, capacity, &derivative);
                  auto axes = std::make_shared<SplatAxes<F>>();
                  auto collect = [&, tile, axes](int number, const Connections<S, C> &free) {
                      TapeLevel<S, C> &level = tile->level_at(number);
                      axes->for_places(call.filter, free.x, free.y, free.n, true, [&](size_t k, int lane) {
                          typename AdjointFilm::Vector sum, by_x, by_y;
                          adjoint.collect(axes->x, axes->y, lane, sum, by_x, by_y);
                          uint32_t at = free.position[k];
                          S x_bar(0), y_bar(0);
                          for (int c = 0; c < C; ++c) {
                              level.emitted[c][at] = sum[c];
                              x_bar += by_x[c] * free.value[c][k], y_bar += by_y[c] * free.value[c][k];
                          }
                          level.light.x_bar[at] = x_bar, level.light.y_bar[at] = y_bar;
                      });
                  };
                  return [&, tile, collect](size_t item, auto &&stop) {
                      for_batches(*tile, call, plan, item, capacity, stop, [&](size_t n, const std::vector<Span> &) {
                          tile->template run<true>(n, stop, collect);
                          ReverseSink<F, C> sink;
                          local.connect(derivative, sink);
                          tile->sweep(sink);
                      });
                      std::lock_guard<std::mutex> lock(mutex);
                      sum_stats(stats, tile->stats);
                      tile->stats = {};
                  };
              });
    add_buffers(locals, derivative);
    stats.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    return stats;
}

}  // namespace detail

template <class S, int C>
RenderStats trace_light(const RenderCall<S> &call, bool packets, S *image) {
    if (packets) return detail::splat_light<typename detail::PacketOf<S>::type, C, false>(call, nullptr, image);
    return detail::splat_light<S, C, false>(call, nullptr, image);
}
template <class S, int C>
RenderStats trace_light_forward(const RenderCall<S> &call, bool packets, const DerivativeCall<S> &d, S *image) {
    if (packets) return detail::splat_light<typename detail::PacketOf<S>::type, C, true>(call, &d, image);
    return detail::splat_light<S, C, true>(call, &d, image);
}
template <class S, int C>
RenderStats trace_light_reverse(const RenderCall<S> &call, bool packets, DerivativeCall<S> &d) {
    if (packets) return detail::reverse_light<typename detail::PacketOf<S>::type, C>(call, d);
    return detail::reverse_light<S, C>(call, d);
}

}  // namespace tr
