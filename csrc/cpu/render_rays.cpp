// Radiance along rays that are given.
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
    constexpr uint32_t W = uint32_t(Lanes<F>::Width);
    PathQueue<S> &queue = tile.wavefront.queues[0];
    const Spectrum<F> one = uniform_spectrum(F(1));
    for (uint32_t i = 0; i < n; i += W) {
        alignas(64) S column[7][W] = {};
        for (uint32_t k = 0; k < std::min(W, n - i); ++k) {
            for (size_t c = 0; c < 3; ++c) {
                column[c][k] = rays.o[3 * (begin + i + k) + c];
                column[3 + c][k] = rays.d[3 * (begin + i + k) + c];
            }
            column[6][k] = rays.length[begin + i + k];
        }
        auto vector = [&](int first) {
            return Vec3<F>{load<F>(column[first]), load<F>(column[first + 1]), load<F>(column[first + 2])};
        };
        write(slots.alpha, i, F(0));
        write(slots.radiance, i, uniform_spectrum(F(0)));
        const Vec3<F> o = vector(0);
        const U slot = U(i) + lane_index<F>();
        append(queue, PathState<F>{o, vector(3), load<F>(column[6]), o, F(0), one, F(1), one, slot, U(0u), U(0u)},
               mask<F>(slot < U(n)));
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
            tile.run(false, stop);
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
