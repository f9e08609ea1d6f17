// Scheduling on the CPU: paths of the items of a plan. Included by the small files in variants/, which say for which
// arithmetic and colour it is compiled.
#pragma once

#include "allocation.h"
#include "items.h"
#include "path_tile.h"

namespace tr {

namespace detail {

// Primal and forward mode: every path has a value, which is splatted.
template <class F, bool Forward>
RenderStats splat_paths(const RenderCall<ScalarOf<F>> &call, const DerivativeCall<ScalarOf<F>> *derivative,
                        const RenderOutput<ScalarOf<F>> &out) {
    using S = ScalarOf<F>;
    RenderStats stats;
    auto begin = std::chrono::steady_clock::now();
    Plan plan = make_plan(call);
    const int pixel = call.values, values = pixel + 1;  // radiance, alpha
    const int moments = out.variance ? pixel : 0;
    Film film(plan, FilmBlock::channels(values, moments));
    OrderedMerge merge(plan, film, call.threads);
    std::mutex mutex;
    const size_t capacity = Forward ? 512 : 1024;
    StoredHits *record = Forward ? nullptr : call.keep_hits;
    if (record) record->prepare(plan.n_items(), capacity);
    run_items(plan.n_items(), call.threads, Schedule::Dynamic, call.interrupted, stats.interrupted, [&](int) {
        auto tile = std::make_shared<PathTile<F>>(call, capacity, derivative);
        return [&, tile](size_t item, auto &&stop) {
            std::vector<FilmBlock> blocks = blocks_of(plan, item, values, moments);
            for_batches(*tile, call, plan, item, capacity, stop, [&](size_t n, const std::vector<Span> &spans) {
                tile->start(n, false);
                if (record && record->wants_more()) tile->recorder.begin(n, size_t(tile->splits(call.config)));
                tile->template run<Forward>(stop);
                if (record) record->keep(item, tile->recorder.finish());
                if constexpr (Forward) {
                    ForwardSink<F> sink;
                    sink.tangent = derivative->tangent;
                    sink.geometry = derivative->geometry_tangent;
                    tile->sweep(sink, true);
                }
                S *columns[SpectrumSize + 1];
                for (int c = 0; c < pixel; ++c) columns[c] = tile->radiance[c];
                columns[pixel] = tile->alpha;
                for (const Span &span : spans)
                    splat_span(blocks[span.unit], call.filter, *tile, span.begin, span.end, columns, values);
            });
            merge.push(item, std::move(blocks), stop);
            std::lock_guard<std::mutex> lock(mutex);
            sum_stats(stats, tile->stats);
            tile->stats = {};
        };
    });
    for (size_t i = 0; i < plan.n_results(); ++i) {
        const double *p = film.at(plan.target_of(i)), *q = p + values + 1;
        double weight = p[values], inverse = weight != 0 ? 1 / weight : 0;
        for (int c = 0; c < pixel; ++c) out.image[i * size_t(pixel) + size_t(c)] = S(p[c] * inverse);
        if (out.alpha) out.alpha[i] = S(p[pixel] * inverse);
        if (!out.variance) continue;
        for (int c = 0; c < pixel; ++c)
            out.variance[i * size_t(pixel) + size_t(c)] =
                S(variance_of_mean(p[c], weight, q[c], q[pixel + c], q[2 * pixel]));
    }
    stats.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    return stats;
}

template <class F>
RenderStats reverse_paths(const RenderCall<ScalarOf<F>> &call, DerivativeCall<ScalarOf<F>> &derivative) {
    using S = ScalarOf<F>;
    RenderStats stats;
    auto begin = std::chrono::steady_clock::now();
    derivative.sums.reset(derivative.n_constants, derivative.geometry_sizes);
    Plan plan = make_plan(call);
    const int values = call.values;
    if (derivative.adaptive) allocate(plan, call.filter, derivative.adjoint, values);
    const size_t capacity = 512;
    // d loss / d (sum of weighted radiances) of every wanted pixel
    Film adjoint(plan, values);
    {
        std::unique_ptr<Film> weights = sum_weights<F>(call, plan, stats);
        if (stats.interrupted) return stats;
        for (size_t i = 0; i < plan.n_results(); ++i) {  // a pixel that was asked for twice has two
            size_t target = plan.target_of(i);
            double total = *weights->at(target);
            if (total == 0) continue;
            for (int c = 0; c < values; ++c)
                adjoint.at(target)[c] += double(derivative.adjoint[i * size_t(values) + size_t(c)]) / total;
        }
    }
    std::vector<GradientBuffers<S>> locals{size_t(call.threads)};
    std::mutex mutex;
    run_items(
        plan.n_items(), call.threads, Schedule::Interleaved, call.interrupted, stats.interrupted, [&](int thread) {
            GradientBuffers<S> &local = locals[size_t(thread)];
            local.allocate(derivative, thread);
            auto tile = std::make_shared<PathTile<F>>(call, capacity, &derivative);
            return [&, tile](size_t item, auto &&stop) {
                std::vector<FilmBlock> blocks = adjoint_blocks(plan, item, adjoint, values);
                size_t done = 0;  // paths of the item
                for_batches(*tile, call, plan, item, capacity, stop, [&](size_t n, const std::vector<Span> &spans) {
                    // the box filter asks for pixels only, whose samples follow each other
                    const bool box = call.filter.reach() == 0;
                    if (!box) choose_positions<F>(call.config, *tile, n);
                    for (const Span &span : spans)
                        for (size_t k = span.begin; k < span.end; ++k) {
                            if (box && k > span.begin && tile->pixel[k] == tile->pixel[k - 1]) {
                                for (int c = 0; c < SpectrumSize; ++c) tile->delta[c][k] = tile->delta[c][k - 1];
                                continue;
                            }
                            double d[SpectrumSize] = {};
                            blocks[span.unit].collect(call.filter, int32_t(tile->row[k]), int32_t(tile->column[k]),
                                                      double(tile->film_y[k]), double(tile->film_x[k]), d);
                            for (int c = 0; c < SpectrumSize; ++c) tile->delta[c][k] = S(d[c] * span.weight);
                        }
                    tile->start(n, true);
                    tile->replay.begin(call.kept_hits, item, done, n, size_t(tile->splits(call.config)));
                    done += n;
                    tile->template run<true>(stop);
                    ReverseSink<F> sink;
                    local.connect(derivative, sink);
                    tile->sweep(sink, false);
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

template <class S>
RenderStats render_primal(const RenderCall<S> &call, const RenderOutput<S> &out) {
    return detail::splat_paths<PacketOf<S>, false>(call, nullptr, out);
}
template <class S>
RenderStats render_forward(const RenderCall<S> &call, const DerivativeCall<S> &derivative, S *image) {
    RenderOutput<S> out{image, nullptr, nullptr};
    return detail::splat_paths<PacketOf<S>, true>(call, &derivative, out);
}
template <class S>
RenderStats render_reverse(const RenderCall<S> &call, DerivativeCall<S> &derivative) {
    return detail::reverse_paths<PacketOf<S>>(call, derivative);
}

}  // namespace tr
