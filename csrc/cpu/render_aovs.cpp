// Outputs besides radiance, and their derivatives.
#include "first_hits.h"
#include "wavefront.h"
#include "work_items.h"

namespace tr {

namespace {

// The call for a pass.
template <class S>
PathConfig config_of_pass(const RenderCall<S> &call, uint64_t seed) {
    PathConfig config = call.config;
    config.seed = seed;
    return config;
}

// Adds values, then the weight of samples that hit something, then all weights of every pass to the film.
template <class F, class Fill>
void splat_first_hits(const RenderCall<ScalarOf<F>> &call, const TileSchedule &schedule, const AovLayout &layout,
                      const AovOutput<ScalarOf<F>> &out, Film &film, RenderStats &stats, Fill &&fill) {
    using Tile = FirstHits<F>;
    const Filter filter = filter_of(out, call.filter);
    const size_t capacity = 1024;
    const int values = layout.n + 1;
    for (uint64_t seed : out.seeds) {
        const PathConfig config = config_of_pass(call, seed);
        OrderedMerge merge(schedule, film, call.threads);
        auto make = [&](int) { return std::make_unique<Tile>(call, layout, capacity); };
        run_tiles(
            schedule.n_items(), call, Assignment::Dynamic, stats, make,
            [&](Tile &hits, size_t item, int, const Stop &stop) {
                const auto &at = hits.samples;
                std::vector<FilmBlock> blocks = blocks_of(schedule, item, values);
                for_batches(at, call, schedule, item, capacity, stop, [&](size_t n, const std::vector<Span> &spans) {
                    hits.trace(config, n, false);
                    fill(hits, n);
                    for_film_places<F>(filter, at, spans, [&](const Span &span, size_t k, const FilmPlace<F> &place) {
                        double v[MaxAovChannels + 1];
                        for (int c = 0; c < layout.n; ++c) v[c] = double(hits.value[c][k]);
                        v[layout.n] = hits.is_hit(k) ? 1 : 0;
                        blocks[span.unit].splat(place, v);
                    });
                });
                merge.push(item, std::move(blocks), stop);
            });
        if (stats.interrupted) return;
    }
}

// What the rays through the centres of the wanted pixels hit.
template <class F>
void identify(const RenderCall<ScalarOf<F>> &call, const TileSchedule &schedule, const AovOutput<ScalarOf<F>> &out,
              RenderStats &stats) {
    using Tile = FirstHits<F>;
    const size_t capacity = 1024;
    const AovLayout none = no_outputs(call);
    auto make = [&](int) { return std::make_unique<Tile>(call, none, capacity); };
    run_tiles((schedule.n_results() + capacity - 1) / capacity, call, Assignment::Dynamic, stats, make,
              [&](Tile &hits, size_t item, int, const Stop &stop) {
                  if (stop()) return;
                  size_t first = item * capacity, n = std::min(capacity, schedule.n_results() - first);
                  for (size_t k = 0; k < n; ++k) {
                      Pixel at = schedule.target(schedule.target_of(first + k));
                      hits.samples.row[k] = uint32_t(at.y), hits.samples.column[k] = uint32_t(at.x);
                  }
                  hits.trace(call.config, n, true);
                  const auto &at = hits.queries.hits.at;
                  for (size_t k = 0; k < n; ++k)
                      write_identifiers(*call.scene, first + k, at.shape[k], at.primitive[k], out);
              });
}

template <class F>
RenderStats primal_aovs(const RenderCall<ScalarOf<F>> &call, const AovOutput<ScalarOf<F>> &out) {
    RenderStats stats;
    {
        Stopwatch watch(stats.seconds);
        TileSchedule schedule = make_schedule(call);
        const AovLayout layout = layout_of(out, call.values);
        if (layout.n > 0) {
            Film film(schedule, layout.n + 2);
            splat_first_hits<F>(call, schedule, layout, out, film, stats,
                                [](FirstHits<F> &hits, size_t n) { hits.evaluate(n); });
            write_outputs(schedule, layout, film.sums(), out, false);
        }
        if ((out.shape || out.primitive || out.material) && !stats.interrupted) identify<F>(call, schedule, out, stats);
    }
    return stats;
}

template <class F>
RenderStats tangent_aovs(const RenderCall<ScalarOf<F>> &call, const AovOutput<ScalarOf<F>> &out,
                         const DerivativeCall<ScalarOf<F>> &derivative) {
    RenderStats stats;
    {
        Stopwatch watch(stats.seconds);
        TileSchedule schedule = make_schedule(call);
        const AovLayout layout = layout_of(out, call.values);
        Film film(schedule, layout.n + 2);
        splat_first_hits<F>(call, schedule, layout, out, film, stats, [&](FirstHits<F> &hits, size_t n) {
            GradientSink<F> sink = derivative.template forward_sink<F>();
            hits.sweep(n, derivative.gradient_needs(), sink);
        });
        write_outputs(schedule, layout, film.sums(), out, true);
    }
    return stats;
}

// d loss / d (weighted sums) of every wanted pixel.
template <class F>
Film adjoint_film(const RenderCall<ScalarOf<F>> &call, const TileSchedule &schedule, const AovLayout &layout,
                  const AovOutput<ScalarOf<F>> &out, RenderStats &stats) {
    Film adjoint(schedule, layout.n), weights(schedule, 2);
    splat_first_hits<F>(call, schedule, no_outputs(call), out, weights, stats, [](FirstHits<F> &, size_t) {});
    if (stats.interrupted) return adjoint;
    for (size_t i = 0; i < schedule.n_results(); ++i) {
        size_t target = schedule.target_of(i);
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
    return adjoint;
}

template <class F>
RenderStats adjoint_aovs(const RenderCall<ScalarOf<F>> &call, const AovOutput<ScalarOf<F>> &out,
                         DerivativeCall<ScalarOf<F>> &derivative) {
    using S = ScalarOf<F>;
    using Tile = FirstHits<F>;
    RenderStats stats;
    {
        Stopwatch watch(stats.seconds);
        TileSchedule schedule = make_schedule(call);
        const Filter filter = filter_of(out, call.filter);
        const AovLayout layout = layout_of(out, call.values);
        const Film adjoint = adjoint_film<F>(call, schedule, layout, out, stats);
        const size_t capacity = 256;
        std::vector<GradientBuffers<S>> buffers{size_t(call.threads)};
        for (uint64_t seed : out.seeds) {
            if (stats.interrupted) return stats;
            const PathConfig config = config_of_pass(call, seed);
            auto make = [&](int thread) {
                buffers[size_t(thread)].allocate(derivative, thread);
                return std::make_unique<Tile>(call, layout, capacity);
            };
            run_tiles(schedule.n_items(), call, Assignment::Interleaved, stats, make,
                      [&](Tile &hits, size_t item, int thread, const Stop &stop) {
                          const auto &at = hits.samples;
                          std::vector<FilmBlock> blocks = adjoint_blocks(schedule, item, adjoint, layout.n);
                          for_batches(
                              at, call, schedule, item, capacity, stop, [&](size_t n, const std::vector<Span> &spans) {
                                  hits.trace(config, n, false);
                                  for_film_places<F>(filter, at, spans,
                                                     [&](const Span &span, size_t k, const FilmPlace<F> &place) {
                                                         double v[MaxAovChannels];
                                                         blocks[span.unit].collect(place, v);
                                                         for (int c = 0; c < layout.n; ++c) hits.value[c][k] = S(v[c]);
                                                     });
                                  GradientSink<F> sink = buffers[size_t(thread)].template sink<F>(derivative);
                                  hits.sweep(n, derivative.gradient_needs(), sink);
                              });
                      });
        }
        if (!stats.interrupted) add_buffers(buffers, derivative);
    }
    return stats;
}

template <class F>
RenderStats find_weights(const RenderCall<ScalarOf<F>> &call, const AovOutput<ScalarOf<F>> &out,
                         const PixelWeights &weights) {
    RenderStats stats;
    Stopwatch watch(stats.seconds);
    TileSchedule schedule = make_schedule(call);
    if (weights.samples) {
        std::unique_ptr<Film> film = sum_weights<F>(call, schedule, stats);
        if (stats.interrupted) return stats;
        for (size_t i = 0; i < schedule.n_results(); ++i) weights.samples[i] = *film->at(schedule.target_of(i));
    }
    if (weights.hits) {
        Film film(schedule, 2);
        splat_first_hits<F>(call, schedule, no_outputs(call), out, film, stats, [](FirstHits<F> &, size_t) {});
        for (size_t i = 0; i < schedule.n_results(); ++i)
            std::copy_n(film.at(schedule.target_of(i)), 2, weights.hits + 2 * i);
    }
    return stats;
}

}  // namespace

template <class S>
RenderStats pixel_weights(const RenderCall<S> &call, const AovOutput<S> &out, const PixelWeights &weights) {
    return find_weights<PacketOf<S>>(call, out, weights);
}
template <class S>
RenderStats render_aov(const RenderCall<S> &call, const AovOutput<S> &out) {
    return primal_aovs<PacketOf<S>>(call, out);
}
template <class S>
RenderStats reverse_aov(const RenderCall<S> &call, const AovOutput<S> &out, DerivativeCall<S> &derivative) {
    return adjoint_aovs<PacketOf<S>>(call, out, derivative);
}
template <class S>
RenderStats forward_aov(const RenderCall<S> &call, const AovOutput<S> &out, const DerivativeCall<S> &derivative) {
    return tangent_aovs<PacketOf<S>>(call, out, derivative);
}

#define TR_INSTANTIATE(S)                                                                                  \
    template RenderStats pixel_weights(const RenderCall<S> &, const AovOutput<S> &, const PixelWeights &); \
    template RenderStats render_aov(const RenderCall<S> &, const AovOutput<S> &);                          \
    template RenderStats reverse_aov(const RenderCall<S> &, const AovOutput<S> &, DerivativeCall<S> &);    \
    template RenderStats forward_aov(const RenderCall<S> &, const AovOutput<S> &, const DerivativeCall<S> &);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
