// Radiance along rays that are given.
#include "packet_rows.h"
#include "path_tile.h"
#include "work_items.h"

namespace tr {

namespace {

constexpr size_t RaysPerItem = 2048, RaysPerBatch = 1024;

// Into the queue of camera rays; a ray's random numbers are those of the pixel that `key` numbers.
template <class F>
void start_rays(PathTile<F> &tile, const GivenRays<ScalarOf<F>> &rays, size_t begin, uint32_t n) {
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    auto &slots = tile.slots;
    for (uint32_t k = 0; k < n; ++k) {
        slots.pixel[k] = rays.key[begin + k];
        slots.sample[k] = 0;
        slots.row[k] = slots.column[k] = 0;
        slots.film_x[k] = slots.film_y[k] = S(0);
    }
    PathQueue<S> &queue = tile.wavefront.queues[0];
    const Spectrum<F> one = uniform_spectrum(F(1));
    for (uint32_t i = 0; i < n; i += uint32_t(Lanes<F>::Width)) {
        const PacketRows<F> rows(begin + i, begin + n);
        write(slots.alpha, i, F(0));
        write(slots.radiance, i, uniform_spectrum(F(0)));
        const Vec3<F> o = rows.vector(rays.o);
        append(queue,
               PathState<F>{o, rows.vector(rays.d), rows.number(rays.length), o, rows.number(rays.pdf), one, F(1), one,
                            U(i) + lane_index<F>(), U(0u), U(0u)},
               rows.active);
    }
}

}  // namespace

template <class S>
RenderStats render_rays(const RenderCall<S> &call, const GivenRays<S> &rays, S *radiance, S *alpha) {
    using F = PacketOf<S>;
    RenderStats stats;
    Stopwatch watch(stats.seconds);
    const size_t items = (rays.n + RaysPerItem - 1) / RaysPerItem;
    auto make = [&](int) { return std::make_unique<PathTile<F>>(call, RaysPerBatch, nullptr); };
    run_tiles(items, call, Assignment::Dynamic, stats, make, [&](PathTile<F> &tile, size_t item, int, auto &&stop) {
        const size_t end = std::min(rays.n, (item + 1) * RaysPerItem);
        for (size_t begin = item * RaysPerItem; begin < end && !stop(); begin += RaysPerBatch) {
            const uint32_t n = uint32_t(std::min(RaysPerBatch, end - begin));
            tile.begin(n);
            start_rays(tile, rays, begin, n);
            tile.run(false, stop, rays.depth);
            for (uint32_t k = 0; k < n; ++k) {
                for (int c = 0; c < call.values; ++c)
                    radiance[(begin + k) * size_t(call.values) + size_t(c)] = tile.slots.radiance[c][k];
                alpha[begin + k] = tile.slots.alpha[k];
            }
        }
    });
    return stats;
}

#define TR_INSTANTIATE(S) template RenderStats render_rays(const RenderCall<S> &, const GivenRays<S> &, S *, S *);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
