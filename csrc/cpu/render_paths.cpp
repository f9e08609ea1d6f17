// Paths of the items of a schedule, and their derivatives.
#include <cmath>

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
                        splat_span<F>(blocks[span.unit], call.filter, slots, span.begin, span.end, columns, values);
                });
                merge.push(item, std::move(blocks), stop);
            });
        if (stats.interrupted) return stats;
        write_results(call, schedule, film.sums(), moments, out);
    }
    return stats;
}

// One of the adjoints: its film, and what threads add up for it.
template <class S>
struct Pull {
    DerivativeCall<S> &derivative;
    std::unique_ptr<Film> film;
    std::vector<GradientBuffers<S>> buffers;
};

// A tile of paths that are swept once for each of several adjoints. Those of a batch, where there is more than one, are
// kept here, and the slots have one after the other.
template <class F>
class PullTile : public PathTile<F> {
    using S = ScalarOf<F>;
    using Base = PathTile<F>;

public:
    PullTile(const RenderCall<S> &call, size_t capacity, const DerivativeCall<S> &derivative, size_t count)
        : Base(call, capacity, &derivative), kept_(count > 1 ? count : 0) {
        arena_.declare([&](Arena &arena) {
            for (SpectrumColumn<S> &column : kept_) column.each([&](S *&array) { arena.array(array, capacity); });
        });
    }
    // Of n slots, number k.
    void keep(size_t k, size_t n) {
        if (kept_.empty()) return;
        for (int c = 0; c < SpectrumSize; ++c) std::copy_n(Base::slots.delta[c], n, kept_[k][c]);
    }
    void show(size_t k, size_t n) {
        for (int c = 0; c < SpectrumSize; ++c) std::copy_n(kept_[k][c], n, Base::slots.delta[c]);
    }
    // Zero where all of them are.
    void show_magnitude(size_t n) {
        for (const SpectrumColumn<S> &column : kept_) {
            const bool first = &column == kept_.data();
            for (int c = 0; c < SpectrumSize; ++c) {
                S *to = Base::slots.delta[c];
                for (size_t i = 0; i < n; ++i) to[i] = (first ? S(0) : to[i]) + std::abs(column[c][i]);
            }
        }
    }

private:
    Arena arena_;
    std::vector<SpectrumColumn<S>> kept_;
};

template <class F>
RenderStats reverse_paths(const RenderCall<ScalarOf<F>> &call,
                          const std::vector<DerivativeCall<ScalarOf<F>> *> &derivatives) {
    using S = ScalarOf<F>;
    using Tile = PullTile<F>;
    RenderStats stats;
    {
        Stopwatch watch(stats.seconds);
        TileSchedule schedule = make_schedule(call);
        const int values = call.numbers();
        const DerivativeCall<S> &first = *derivatives[0];
        if (first.adaptive) allocate(schedule, call.filter, first.adjoint, values);
        const size_t capacity = 512;
        const std::unique_ptr<Film> weights = sum_weights<F>(call, schedule, stats);
        if (stats.interrupted) return stats;
        std::vector<Pull<S>> pulls;
        pulls.reserve(derivatives.size());
        for (DerivativeCall<S> *d : derivatives)
            pulls.push_back({*d, adjoint_film(call, schedule, *weights, d->adjoint),
                             std::vector<GradientBuffers<S>>(size_t(call.threads))});
        auto make = [&](int thread) {
            for (Pull<S> &pull : pulls) pull.buffers[size_t(thread)].allocate(pull.derivative, thread);
            return std::make_unique<Tile>(call, capacity, first, pulls.size());
        };
        run_tiles(
            schedule.n_items(), call, Assignment::Interleaved, stats, make,
            [&](Tile &tile, size_t item, int thread, const Stop &stop) {
                const auto &slots = tile.slots;
                std::vector<std::vector<FilmBlock>> blocks;
                blocks.reserve(pulls.size());
                for (const Pull<S> &pull : pulls) blocks.push_back(adjoint_blocks(schedule, item, *pull.film, values));
                size_t done = 0;  // paths of the item
                for_batches(slots, call, schedule, item, capacity, stop, [&](size_t n, const std::vector<Span> &spans) {
                    if (call.filter.reach() > 0) choose_positions<F>(call.config, slots, n);
                    tile.begin(n);
                    for (size_t k = 0; k < pulls.size(); ++k) {
                        collect_adjoints<F>(call, blocks[k], spans, slots);
                        tile.pull_adjoints();
                        tile.keep(k, n);
                    }
                    tile.show_magnitude(n);
                    tile.start(n, true);
                    tile.wavefront.replay.begin(call.kept_hits, item, done, n, size_t(tile.splits(call.config)));
                    done += n;
                    tile.run(true, stop);
                    std::vector<GradientSink<F>> sinks;
                    sinks.reserve(pulls.size());
                    for (Pull<S> &pull : pulls)
                        sinks.push_back(pull.buffers[size_t(thread)].template sink<F>(pull.derivative));
                    if (sinks.size() == 1)
                        tile.sweep(sinks[0]);
                    else
                        tile.sweep_each(sinks, [&](size_t k) { tile.show(k, n); });
                });
            });
        for (Pull<S> &pull : pulls) add_buffers(pull.buffers, pull.derivative);
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
RenderStats render_reverse(const RenderCall<S> &call, const std::vector<DerivativeCall<S> *> &derivatives) {
    return reverse_paths<PacketOf<S>>(call, derivatives);
}

#define TR_INSTANTIATE(S)                                                                                 \
    template RenderStats render_primal(const RenderCall<S> &, const RenderOutput<S> &);                   \
    template RenderStats render_reverse(const RenderCall<S> &, const std::vector<DerivativeCall<S> *> &); \
    template RenderStats render_forward(const RenderCall<S> &, const DerivativeCall<S> &, S *);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
