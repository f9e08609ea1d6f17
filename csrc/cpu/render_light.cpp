// Light paths, and their derivatives: as render_paths.cpp, but what a path brings may be anywhere on the film. The
// items of the schedule are divided into groups, as many whatever the number of threads; a group has a film of its own,
// and films are added, in double precision, in the order of their groups.
#include <optional>

#include "light_connections.h"
#include "render_response.h"
#include "work_items.h"

namespace tr {

namespace {

// Sums up films in the order of their numbers, whoever finishes first.
template <class S>
class OrderedFilms {
public:
    using Films = std::vector<SplatFilm<S>>;
    explicit OrderedFilms(const RenderCall<S> &call) : total(empty_films<double>(call)) {}
    std::vector<SplatFilm<double>> total;

    void push(size_t number, Films films) {
        std::lock_guard<std::mutex> lock(mutex_);
        waiting_.emplace(number, std::move(films));
        for (auto it = waiting_.find(next_); it != waiting_.end(); it = waiting_.find(++next_)) {
            for (size_t p = 0; p < total.size(); ++p) total[p].add(it->second[p]);
            waiting_.erase(it);
        }
    }

private:
    std::mutex mutex_;
    std::map<size_t, Films> waiting_;
    size_t next_ = 0;
};

// Light paths, with what becomes of their connections.
template <class F>
struct SplattingTile {
    using S = ScalarOf<F>;
    LightTile<F> paths;
    SplatAxes<F> axes;
    std::optional<LightTangents<F>> tangents;
    ConnectionParts<F> parts;
    RenderStats take_stats() { return paths.take_stats(); }

    SplattingTile(const RenderCall<S> &call, size_t capacity, const DerivativeCall<S> *derivative)
        : paths(call, capacity, derivative), parts(call, paths.slots) {
        if (derivative) tangents.emplace(call, *derivative);
    }
};

// Primal and, with a derivative, forward mode.
template <class F>
RenderStats splat_light(const RenderCall<ScalarOf<F>> &call, const DerivativeCall<ScalarOf<F>> *derivative,
                        ScalarOf<F> *image, FilmSums *sums) {
    using S = ScalarOf<F>;
    using Tile = SplattingTile<F>;
    RenderStats stats;
    {
        Stopwatch watch(stats.seconds);
        TileSchedule schedule = schedule_of_light(call);
        const size_t capacity = 512;
        // Enough for many threads, but few enough that adding up films is less work than tracing; not a matter of the
        // crop, whose pixels are to be those of the whole bit for bit.
        const size_t fitting = std::min<size_t>(64, std::max<size_t>(16, size_t(call.spp) / 4));
        const size_t film_bytes = 16 * n_parts(call) * (size_t(call.film_height) * size_t(call.film_width) + 1);
        const size_t affordable =
            std::max<size_t>(4, (size_t(1) << 30) / film_bytes);  // films that wait for an earlier one
        const size_t groups = std::min({schedule.n_items(), fitting, affordable});
        OrderedFilms<S> films(call);
        const bool recording = derivative || call.config.stokes;
        auto make = [&](int) { return std::make_unique<Tile>(call, capacity, derivative); };
        run_tiles(groups, call, Assignment::Dynamic, stats, make, [&](Tile &tile, size_t group, int, const Stop &stop) {
            std::vector<SplatFilm<S>> own = empty_films<S>(call);
            const size_t end = schedule.n_items() * (group + 1) / groups;
            auto visit = [&](int level, const ShadowQueue<S> &free) {
                const TapeColumns<S> *tape = recording ? &tile.paths.wavefront.tape[level].columns : nullptr;
                const auto &brought = tile.parts.brought(tape, free);
                if (derivative)
                    tile.tangents->keep(level, free, brought, tile.parts.columns(*tape));
                else
                    splat_connections<F>(call.filter, free, brought, own, tile.axes);
            };
            for (size_t item = schedule.n_items() * group / groups; item < end && !stop(); ++item)
                for_batches(tile.paths.slots, call, schedule, item, capacity, stop,
                            [&](size_t n, const std::vector<Span> &) {
                                tile.paths.run(n, recording, stop, visit);
                                if (derivative) tile.tangents->sweep(tile.paths, n, tile.parts, own);
                            });
            films.push(group, std::move(own));
        });
        if (stats.interrupted) return stats;
        write_light(call, image, sums,
                    [&](size_t part, int row, int column, int c) { return films.total[part].at(row, column)[c]; });
    }
    return stats;
}

template <class F>
RenderStats reverse_light(const RenderCall<ScalarOf<F>> &call, DerivativeCall<ScalarOf<F>> &derivative) {
    using S = ScalarOf<F>;
    using Tile = SplattingTile<F>;
    using AdjointFilm = SplatFilm<S>;
    RenderStats stats;
    {
        Stopwatch watch(stats.seconds);
        TileSchedule schedule = schedule_of_light(call);
        const size_t capacity = 512;
        const std::vector<AdjointFilm> adjoint = adjoint_films(call, derivative.adjoint);
        std::vector<GradientBuffers<S>> locals{size_t(call.threads)};
        auto make = [&](int thread) {
            locals[size_t(thread)].allocate(derivative, thread);
            return std::make_unique<Tile>(call, capacity, &derivative);
        };
        run_tiles(schedule.n_items(), call, Assignment::Interleaved, stats, make,
                  [&](Tile &tile, size_t item, int thread, const Stop &stop) {
                      SplatAxes<F> &axes = tile.axes;
                      auto collect = [&](int number, const ShadowQueue<S> &free) {
                          const TapeColumns<S> &level = tile.paths.wavefront.tape[number].columns;
                          const auto &brought = tile.parts.brought(&level, free);
                          const auto columns = tile.parts.columns(level);
                          axes.for_places(call.filter, free.film_x.at, free.film_y.at, free.n, true,
                                          [&](size_t k, int lane) {
                                              uint32_t at = free.position[k];
                                              S x_bar(0), y_bar(0);
                                              for (size_t p = 0; p < columns.size(); ++p) {
                                                  typename AdjointFilm::Vector sum, by_x, by_y;
                                                  adjoint[p].collect(axes.x, axes.y, lane, sum, by_x, by_y);
                                                  for (int c = 0; c < SpectrumSize; ++c) {
                                                      const S value = brought[p][size_t(c)][k];
                                                      columns[p][c][at] = sum[c];
                                                      x_bar += by_x[c] * value, y_bar += by_y[c] * value;
                                                  }
                                              }
                                              level.connection.x_bar[at] = x_bar, level.connection.y_bar[at] = y_bar;
                                          });
                          for (const auto &column : columns)
                              tile.parts.channels.each(
                                  free.slot.at, free.n, tile.parts.channels.arrays(column), free.position.at,
                                  [](const FilmWeights<F> &weights, const Spectrum<F> &x) { return weights.pull(x); });
                      };
                      for_batches(tile.paths.slots, call, schedule, item, capacity, stop,
                                  [&](size_t n, const std::vector<Span> &) {
                                      tile.paths.run(n, true, stop, collect);
                                      GradientSink<F> sink = locals[size_t(thread)].template sink<F>(derivative);
                                      tile.paths.sweep(sink);
                                  });
                  });
        add_buffers(locals, derivative);
    }
    return stats;
}

// See render_response.h.
template <class F>
RenderStats light_responses(const RenderCall<ScalarOf<F>> &call, const ScalarOf<F> *given, double *gradient) {
    using S = ScalarOf<F>;
    using Tile = SplattingTile<F>;
    RenderStats stats;
    Stopwatch watch(stats.seconds);
    const TileSchedule schedule = schedule_of_light(call);
    const size_t capacity = 512;
    const std::vector<SplatFilm<S>> adjoint = adjoint_films(call, given);
    std::vector<ResponseSums> sums{size_t(call.threads)};
    auto make = [&](int) { return std::make_unique<Tile>(call, capacity, nullptr); };
    run_tiles(
        schedule.n_items(), call, Assignment::Interleaved, stats, make,
        [&](Tile &tile, size_t item, int thread, const Stop &stop) {
            const SlotColumns<S> &slots = tile.paths.slots;
            auto visit = [&](int level, const ShadowQueue<S> &free) {
                const bool recorded = call.config.stokes;
                const auto &spectra =
                    tile.parts.spectra(recorded ? &tile.paths.wavefront.tape[level].columns : nullptr, free);
                SplatAxes<F> &axes = tile.axes;
                axes.for_places(call.filter, free.film_x.at, free.film_y.at, free.n, true, [&](size_t k, int lane) {
                    const uint32_t slot = free.slot[k];
                    const auto chosen = chosen_wavelengths<S>(call.config, slots.pixel[slot], slots.sample[slot]);
                    for (size_t p = 0; p < spectra.size(); ++p) {
                        typename SplatFilm<S>::Vector sum, by_x, by_y;
                        adjoint[p].collect(axes.x, axes.y, lane, sum, by_x, by_y);
                        sums[size_t(thread)].add(
                            chosen, [&](int j) { return sum[j]; }, [&](int c) { return spectra[p][size_t(c)][k]; });
                    }
                });
            };
            for_batches(slots, call, schedule, item, capacity, stop, [&](size_t n, const std::vector<Span> &) {
                tile.paths.run(n, call.config.stokes, stop, visit);
            });
        });
    for (const ResponseSums &part : sums) part.add_to(gradient);
    return stats;
}

}  // namespace

template <class S>
RenderStats trace_light_responses(const RenderCall<S> &call, const S *adjoint, double *gradient) {
    return light_responses<PacketOf<S>>(call, adjoint, gradient);
}
template <class S>
RenderStats trace_light(const RenderCall<S> &call, S *image, FilmSums *sums) {
    return splat_light<PacketOf<S>>(call, nullptr, image, sums);
}
template <class S>
RenderStats trace_light_forward(const RenderCall<S> &call, const DerivativeCall<S> &derivative, S *image) {
    return splat_light<PacketOf<S>>(call, &derivative, image, nullptr);
}
template <class S>
RenderStats trace_light_reverse(const RenderCall<S> &call, DerivativeCall<S> &derivative) {
    return reverse_light<PacketOf<S>>(call, derivative);
}

#define TR_INSTANTIATE(S)                                                                   \
    template RenderStats trace_light(const RenderCall<S> &, S *, FilmSums *);               \
    template RenderStats trace_light_responses(const RenderCall<S> &, const S *, double *); \
    template RenderStats trace_light_reverse(const RenderCall<S> &, DerivativeCall<S> &);   \
    template RenderStats trace_light_forward(const RenderCall<S> &, const DerivativeCall<S> &, S *);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
