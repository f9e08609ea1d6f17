// Paths of the items of a schedule, and their derivatives.
#include "adjoint_film.h"
#include "allocation.h"
#include "path_tile.h"

namespace tr {

namespace {

// Primal and, with a derivative, forward mode: every path has a value, which is splatted.
template <class F>
RenderStats splat_paths(const RenderCall<ScalarOf<F>> &call, const DerivativeCall<ScalarOf<F>> *derivative,
                        const RenderOutput<ScalarOf<F>> &out) {
    using S = ScalarOf<F>;
    using Tile = PathTile<F>;
    RenderStats stats;
    {
        Stopwatch watch(stats.seconds);
        TileSchedule schedule = make_schedule(call);
        const int pixel = call.numbers(), values = pixel + 1;  // radiance, alpha
        const bool recorded = derivative || call.config.stokes;
        const int moments = out.to.variance || out.to.second_moment ? pixel : 0;
        Film film(schedule, FilmBlock::channels(values, moments));
        OrderedMerge merge(schedule, film, call.threads);
        const size_t capacity = recorded ? 512 : 1024;
        StoredHits *record = derivative ? nullptr : call.keep_hits;
        if (record) record->prepare(schedule.n_items(), capacity);
        auto make = [&](int) { return std::make_unique<Tile>(call, capacity, derivative); };
        run_tiles(
            schedule.n_items(), call, Assignment::Dynamic, stats, make,
            [&](Tile &tile, size_t item, int, const Stop &stop) {
                const auto &slots = tile.slots;
                std::vector<FilmBlock> blocks = blocks_of(schedule, item, values, moments);
                for_batches(slots, call, schedule, item, capacity, stop, [&](size_t n, const std::vector<Span> &spans) {
                    tile.start(n, false);
                    HitRecorder &recorder = tile.wavefront.recorder;
                    if (record && record->wants_more()) recorder.begin(n, size_t(tile.splits(call.config)));
                    tile.run(recorded, stop);
                    if (record) record->keep(item, recorder.finish());
                    if (derivative) {
                        GradientSink<F> sink = derivative->template forward_sink<F>();
                        tile.sweep(sink);
                    } else if (recorded) {
                        tile.sweep_columns();
                    }
                    tile.to_channels();
                    S *columns[4 * SpectrumSize + 1];
                    const SpectrumColumn<S> parts[] = {slots.radiance, slots.q, slots.u, slots.v};
                    for (int c = 0; c < pixel; ++c) columns[c] = parts[c / call.values][c % call.values];
                    columns[pixel] = slots.alpha.at;
                    for (const Span &span : spans)
                        splat_span(blocks[span.unit], call.filter, slots, span.begin, span.end, columns, values);
                });
                merge.push(item, std::move(blocks), stop);
            });
        if (stats.interrupted) return stats;
        write_results(call, schedule, film.sums(), moments, out);
    }
    return stats;
}

template <class F>
RenderStats reverse_paths(const RenderCall<ScalarOf<F>> &call, DerivativeCall<ScalarOf<F>> &derivative) {
    using S = ScalarOf<F>;
    using Tile = PathTile<F>;
    RenderStats stats;
    {
        Stopwatch watch(stats.seconds);
        TileSchedule schedule = make_schedule(call);
        const int values = call.numbers();
        if (derivative.adaptive) allocate(schedule, call.filter, derivative.adjoint, values);
        const size_t capacity = 512;
        const std::unique_ptr<Film> adjoint = adjoint_film<F>(call, schedule, derivative.adjoint, stats);
        if (stats.interrupted) return stats;
        std::vector<GradientBuffers<S>> locals{size_t(call.threads)};
        auto make = [&](int thread) {
            locals[size_t(thread)].allocate(derivative, thread);
            return std::make_unique<Tile>(call, capacity, &derivative);
        };
        run_tiles(
            schedule.n_items(), call, Assignment::Interleaved, stats, make,
            [&](Tile &tile, size_t item, int thread, const Stop &stop) {
                const auto &slots = tile.slots;
                std::vector<FilmBlock> blocks = adjoint_blocks(schedule, item, *adjoint, values);
                size_t done = 0;  // paths of the item
                for_batches(slots, call, schedule, item, capacity, stop, [&](size_t n, const std::vector<Span> &spans) {
                    if (call.filter.reach() > 0) choose_positions<F>(call.config, slots, n);
                    collect_adjoints(call, blocks, spans, slots);
                    tile.begin(n);
                    tile.pull_adjoints();
                    tile.start(n, true);
                    tile.wavefront.replay.begin(call.kept_hits, item, done, n, size_t(tile.splits(call.config)));
                    done += n;
                    tile.run(true, stop);
                    GradientSink<F> sink = locals[size_t(thread)].template sink<F>(derivative);
                    tile.sweep(sink);
                });
            });
        add_buffers(locals, derivative);
    }
    return stats;
}

}  // namespace

template <class S>
RenderStats render_primal(const RenderCall<S> &call, const RenderOutput<S> &out) {
    return splat_paths<PacketOf<S>>(call, nullptr, out);
}
template <class S>
RenderStats render_forward(const RenderCall<S> &call, const DerivativeCall<S> &derivative, S *image) {
    return splat_paths<PacketOf<S>>(call, &derivative, {{image}});
}
template <class S>
RenderStats render_reverse(const RenderCall<S> &call, DerivativeCall<S> &derivative) {
    return reverse_paths<PacketOf<S>>(call, derivative);
}

#define TR_INSTANTIATE(S)                                                               \
    template RenderStats render_primal(const RenderCall<S> &, const RenderOutput<S> &); \
    template RenderStats render_reverse(const RenderCall<S> &, DerivativeCall<S> &);    \
    template RenderStats render_forward(const RenderCall<S> &, const DerivativeCall<S> &, S *);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
