// Scheduling of the outputs besides radiance: included by the small files in variants/.
#pragma once

#include "first_hits.h"

namespace tr {

namespace detail {

// What averages over the samples that hit something are weighted with: filters with negative lobes would make anything
// of them beside an outline, where such a lobe may be all that reaches the object.
template <class S>
Filter filter_of_outputs(const RenderCall<S> &call, const AovOutput<S> &out) {
    return out.zero_at_misses ? call.filter : call.filter.magnitude();
}

// Adds values, then the weight of samples that hit something, then all weights of every pass to the film.
template <class F, int C, class Fill>
void splat_first_hits(const RenderCall<ScalarOf<F>> &call, const Plan &plan, const AovLayout &layout,
                      const AovOutput<ScalarOf<F>> &out, Film &film, RenderStats &stats, Fill &&fill) {
    const Filter filter = filter_of_outputs(call, out);
    const size_t capacity = 1024;
    const int values = layout.n + 1;
    std::mutex mutex;
    for (uint64_t seed : out.seeds) {
        PathConfig config = call.config;
        config.seed = seed;
        OrderedMerge merge(plan, film, call.threads);
        run_items(plan.n_items(), call.threads, Schedule::Dynamic, call.interrupted, stats.interrupted, [&](int) {
            auto hits = std::make_shared<FirstHits<F, C>>(call, layout, capacity);
            return [&, hits](size_t item, auto &&stop) {
                std::vector<FilmBlock> blocks = blocks_of(plan, item, values);
                for_batches(*hits, call, plan, item, capacity, stop, [&](size_t n, const std::vector<Span> &spans) {
                    hits->trace(config, n, false);
                    uint64_t lost = fill(*hits, n);
                    if (lost) {
                        std::lock_guard<std::mutex> lock(mutex);
                        stats.non_finite += lost;
                        if (stats.non_finite_where.empty()) stats.non_finite_where = "a derivative";
                    }
                    for (const Span &span : spans)
                        for (size_t k = span.begin; k < span.end; ++k) {
                            double v[MaxAovChannels + 1];
                            for (int c = 0; c < layout.n; ++c) v[c] = double(hits->value[c][k]);
                            v[layout.n] = hits->shape[k] != Accel::Miss ? 1 : 0;
                            blocks[span.unit].splat(filter, int32_t(hits->row[k]), int32_t(hits->column[k]),
                                                    double(hits->film_y[k]), double(hits->film_x[k]), v);
                        }
                });
                merge.push(item, std::move(blocks), stop);
                std::lock_guard<std::mutex> lock(mutex);
                stats.closest_rays += hits->rays;
                hits->rays = 0;
            };
        });
        if (stats.interrupted) return;
    }
}

// Hands the channels of the film's pixels out: averages, or infinity or zero where nothing was hit.
template <class S>
void write_outputs(const Plan &plan, const AovLayout &layout, const Film &film, const AovOutput<S> &out,
                   bool derivative) {
    for (size_t i = 0; i < plan.n_results(); ++i) {
        const double *p = film.at(plan.target_of(i));
        double total = out.zero_at_misses ? p[layout.n + 1] : p[layout.n];  // the first may be negative
        for (int kind = 0; kind < AovCount; ++kind) {
            if (!layout.wants(kind)) continue;
            int n = layout.count(kind);
            bool infinite = aov_names[kind].infinite && !out.zero_at_misses && !derivative;
            for (int c = 0; c < n; ++c)
                out.data[size_t(kind)][i * size_t(n) + size_t(c)] = total != 0 ? S(p[layout.offset[kind] + c] / total)
                                                                    : infinite ? S(INFINITY)
                                                                               : S(0);
        }
    }
}

// What the rays through the centres of the wanted pixels hit.
template <class F, int C>
void identify(const RenderCall<ScalarOf<F>> &call, const Plan &plan, const AovOutput<ScalarOf<F>> &out,
              RenderStats &stats) {
    const size_t capacity = 1024;
    AovLayout none(C, [](int) { return false; });
    run_items((plan.n_results() + capacity - 1) / capacity, call.threads, Schedule::Dynamic, call.interrupted,
              stats.interrupted, [&](int) {
                  auto hits = std::make_shared<FirstHits<F, C>>(call, none, capacity);
                  return [&, hits](size_t item, auto &&stop) {
                      if (stop()) return;
                      size_t first = item * capacity, n = std::min(capacity, plan.n_results() - first);
                      for (size_t k = 0; k < n; ++k) {
                          Pixel at = plan.target(plan.target_of(first + k));
                          hits->row[k] = uint32_t(at.y), hits->column[k] = uint32_t(at.x);
                      }
                      hits->trace(call.config, n, true);
                      for (size_t k = 0; k < n; ++k) {
                          bool hit = hits->shape[k] != Accel::Miss;
                          if (out.shape) out.shape[first + k] = hit ? int32_t(hits->shape[k]) : -1;
                          if (out.primitive) out.primitive[first + k] = hit ? int32_t(hits->primitive[k]) : -1;
                          if (out.material)
                              out.material[first + k] = hit ? call.scene->shapes[hits->shape[k]].bsdf : -1;
                      }
                  };
              });
}

template <class S>
AovLayout layout_of(const AovOutput<S> &out, int colors) {
    AovLayout r(colors, [&](int kind) { return out.data[size_t(kind)] != nullptr; });
    r.attributes = out.attributes;
    return r;
}

template <class F, int C>
RenderStats primal_aov(const RenderCall<ScalarOf<F>> &call, const AovOutput<ScalarOf<F>> &out) {
    RenderStats stats;
    auto begin = std::chrono::steady_clock::now();
    Plan plan = make_plan(call);
    const AovLayout layout = layout_of(out, C);
    if (layout.n > 0) {
        Film film(plan, layout.n + 2);
        splat_first_hits<F, C>(call, plan, layout, out, film, stats, [](FirstHits<F, C> &hits, size_t n) {
            hits.evaluate(n);
            return uint64_t(0);
        });
        write_outputs(plan, layout, film, out, false);
    }
    if ((out.shape || out.primitive || out.material) && !stats.interrupted) identify<F, C>(call, plan, out, stats);
    stats.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    return stats;
}

template <class F, int C>
RenderStats tangent_aov(const RenderCall<ScalarOf<F>> &call, const AovOutput<ScalarOf<F>> &out,
                        const DerivativeCall<ScalarOf<F>> &derivative) {
    RenderStats stats;
    auto begin = std::chrono::steady_clock::now();
    Plan plan = make_plan(call);
    const AovLayout layout = layout_of(out, C);
    Film film(plan, layout.n + 2);
    splat_first_hits<F, C>(call, plan, layout, out, film, stats, [&](FirstHits<F, C> &hits, size_t n) {
        ForwardSink<F, C> sink;
        sink.tangent = derivative.tangent;
        sink.geometry = derivative.geometry_tangent;
        hits.sweep(n, derivative.wanted, sink);
        return uint64_t(sink.non_finite);
    });
    write_outputs(plan, layout, film, out, true);
    stats.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    return stats;
}

template <class F, int C>
RenderStats adjoint_aov(const RenderCall<ScalarOf<F>> &call, const AovOutput<ScalarOf<F>> &out,
                        DerivativeCall<ScalarOf<F>> &derivative) {
    using S = ScalarOf<F>;
    RenderStats stats;
    auto begin = std::chrono::steady_clock::now();
    derivative.sums.reset(derivative.n_constants, derivative.geometry_sizes);
    Plan plan = make_plan(call);
    const Filter filter = filter_of_outputs(call, out);
    const AovLayout layout = layout_of(out, C);
    // d loss / d (weighted sums) of every wanted pixel
    Film adjoint(plan, layout.n);
    {
        AovLayout none(C, [](int) { return false; });
        Film weights(plan, 2);
        splat_first_hits<F, C>(call, plan, none, out, weights, stats,
                               [](FirstHits<F, C> &, size_t) { return uint64_t(0); });
        if (stats.interrupted) return stats;
        for (size_t i = 0; i < plan.n_results(); ++i) {
            size_t target = plan.target_of(i);
            double total = weights.at(target)[out.zero_at_misses ? 1 : 0];
            if (total == 0) continue;
            for (int kind = 0; kind < AovCount; ++kind) {
                if (!layout.wants(kind)) continue;
                int n = layout.count(kind);
                for (int c = 0; c < n; ++c)
                    adjoint.at(target)[layout.offset[kind] + c] +=
                        double(out.data[size_t(kind)][i * size_t(n) + size_t(c)]) / total;
            }
        }
    }
    const size_t capacity = 256;
    std::vector<GradientBuffers<S>> buffers{size_t(call.threads)};
    for (uint64_t seed : out.seeds) {
        PathConfig config = call.config;
        config.seed = seed;
        std::mutex mutex;
        run_items(
            plan.n_items(), call.threads, Schedule::Interleaved, call.interrupted, stats.interrupted, [&](int thread) {
                GradientBuffers<S> &buffer = buffers[size_t(thread)];
                buffer.allocate(derivative, thread);
                auto hits = std::make_shared<FirstHits<F, C>>(call, layout, capacity);
                return [&, hits](size_t item, auto &&stop) {
                    std::vector<FilmBlock> blocks = adjoint_blocks(plan, item, adjoint, layout.n);
                    for_batches(*hits, call, plan, item, capacity, stop, [&](size_t n, const std::vector<Span> &spans) {
                        hits->trace(config, n, false);
                        for (const Span &span : spans)
                            for (size_t k = span.begin; k < span.end; ++k) {
                                double v[MaxAovChannels];
                                blocks[span.unit].collect(filter, int32_t(hits->row[k]), int32_t(hits->column[k]),
                                                          double(hits->film_y[k]), double(hits->film_x[k]), v);
                                for (int c = 0; c < layout.n; ++c) hits->value[c][k] = S(v[c]);
                            }
                        ReverseSink<F, C> sink;
                        buffer.connect(derivative, sink);
                        hits->sweep(n, derivative.wanted, sink);
                        std::lock_guard<std::mutex> lock(mutex);
                        stats.non_finite += sink.non_finite;
                        if (sink.non_finite && stats.non_finite_where.empty()) stats.non_finite_where = "a derivative";
                    });
                    std::lock_guard<std::mutex> lock(mutex);
                    stats.closest_rays += hits->rays;
                    hits->rays = 0;
                };
            });
        if (stats.interrupted) return stats;
    }
    add_buffers(buffers, derivative);
    stats.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    return stats;
}

}  // namespace detail

template <class S, int C>
RenderStats render_aov(const RenderCall<S> &call, bool packets, const AovOutput<S> &out) {
    if (packets) return detail::primal_aov<typename detail::PacketOf<S>::type, C>(call, out);
    return detail::primal_aov<S, C>(call, out);
}
template <class S, int C>
RenderStats reverse_aov(const RenderCall<S> &call, bool packets, const AovOutput<S> &out,
                        DerivativeCall<S> &derivative) {
    if (packets) return detail::adjoint_aov<typename detail::PacketOf<S>::type, C>(call, out, derivative);
    return detail::adjoint_aov<S, C>(call, out, derivative);
}
template <class S, int C>
RenderStats forward_aov(const RenderCall<S> &call, bool packets, const AovOutput<S> &out,
                        const DerivativeCall<S> &derivative) {
    if (packets) return detail::tangent_aov<typename detail::PacketOf<S>::type, C>(call, out, derivative);
    return detail::tangent_aov<S, C>(call, out, derivative);
}

}  // namespace tr
