#include "render_response.h"

#include "adjoint_film.h"
#include "path_tile.h"

namespace tr {

namespace {

// What the paths of a batch, whose adjoints are those of the film's channels, add to the gradient.
template <class S>
void add_responses(const RenderCall<S> &call, const SlotColumns<S> &slots, size_t n, ResponseSums &sums) {
    const SpectrumColumn<S> adjoints[] = {slots.delta, slots.delta_q, slots.delta_u, slots.delta_v},
                            values[] = {slots.radiance, slots.q, slots.u, slots.v};
    const int parts = call.config.stokes ? 4 : 1;
    for (size_t k = 0; k < n; ++k) {
        const ChosenWavelengths<S> chosen = chosen_wavelengths<S>(call.config, slots.pixel[k], slots.sample[k]);
        for (int p = 0; p < parts; ++p)
            sums.add(chosen, [&](int j) { return adjoints[p][j][k]; }, [&](int c) { return values[p][c][k]; });
    }
}

}  // namespace

template <class S>
RenderStats response_reverse(const RenderCall<S> &call, const S *given, double *gradient) {
    using F = PacketOf<S>;
    using Tile = PathTile<F>;
    RenderStats stats;
    Stopwatch watch(stats.seconds);
    const TileSchedule schedule = make_schedule(call);
    const std::unique_ptr<Film> weights = sum_weights<F>(call, schedule, stats);
    if (stats.interrupted) return stats;
    const std::unique_ptr<Film> adjoint = adjoint_film(call, schedule, *weights, given);
    if (stats.interrupted) return stats;
    const int values = call.numbers();
    const size_t capacity = 512;
    std::vector<ResponseSums> sums{size_t(call.threads)};
    auto make = [&](int) { return std::make_unique<Tile>(call, capacity, nullptr); };
    run_tiles(schedule.n_items(), call, Assignment::Interleaved, stats, make,
              [&](Tile &tile, size_t item, int thread, const Stop &stop) {
                  const auto &slots = tile.slots;
                  const std::vector<FilmBlock> blocks = adjoint_blocks(schedule, item, *adjoint, values);
                  for_batches(slots, call, schedule, item, capacity, stop,
                              [&](size_t n, const std::vector<Span> &spans) {
                                  if (call.filter.reach() > 0) choose_positions<F>(call.config, slots, n);
                                  collect_adjoints<F>(call, blocks, spans, slots);
                                  tile.start(n, true);
                                  tile.run(call.config.stokes, stop);
                                  if (call.config.stokes) tile.sweep_columns();
                                  add_responses(call, slots, n, sums[size_t(thread)]);
                              });
              });
    for (const ResponseSums &part : sums) part.add_to(gradient);
    return stats;
}

#define TR_INSTANTIATE(S) template RenderStats response_reverse(const RenderCall<S> &, const S *, double *);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
