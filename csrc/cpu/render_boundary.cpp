// The derivative of moving outlines, see boundary_tile.h.
#include "boundary_lights.h"
#include "boundary_outputs.h"
#include "boundary_reflections.h"
#include "boundary_seen.h"
#include "work_items.h"

#include <numeric>

namespace tr {

namespace {

// Calls work(tile, first, n, thread, stop) for batches of the samples.
template <class Tile, class S, class Make, class Work>
RenderStats run_boundary(const RenderCall<S> &call, const BoundaryCall<S> &boundary, Make &&make, Work &&work) {
    RenderStats stats;
    Stopwatch watch(stats.seconds);
    const uint64_t size = group_of(boundary);
    const size_t items = size_t((boundary.count + size - 1) / size);
    run_tiles(items, call, Assignment::Interleaved, stats, make,
              [&](Tile &tile, size_t item, int thread, const Stop &stop) {
                  const uint64_t end = std::min(boundary.count, uint64_t(item + 1) * size);
                  for (uint64_t first = item * size; first < end && !stop(); first += Tile::Capacity)
                      work(tile, first, uint32_t(std::min<uint64_t>(Tile::Capacity, end - first)), thread, stop);
              });
    return stats;
}

template <class Tile, class F, class S = ScalarOf<F>>
RenderStats reverse(const RenderCall<S> &call, const BoundaryCall<S> &given, const DerivativeCall<S> &derivative,
                    std::vector<GradientBuffers<S>> &locals) {
    FilmBlock film;
    film.reset(call.crop, given.channels);
    const double *from = given.adjoint;
    for (int y = call.crop.y0; y < call.crop.y1; ++y)
        for (int x = call.crop.x0; x < call.crop.x1; ++x, from += film.values)
            std::copy_n(from, film.values, film.at(y, x));
    BoundaryCall<S> boundary = given;
    boundary.film = &film;
    auto make = [&](int thread) {
        locals[size_t(thread)].allocate(derivative, thread);
        return std::make_unique<Tile>(call, boundary, derivative);
    };
    return run_boundary<Tile>(call, boundary, make,
                              [&](Tile &tile, uint64_t first, uint32_t n, int thread, const Stop &stop) {
                                  GradientSink<F> sink = locals[size_t(thread)].template sink<F>(derivative);
                                  tile.run(first, n, sink, stop);
                              });
}

template <class Tile, class F, class S = ScalarOf<F>>
RenderStats forward(const RenderCall<S> &call, const BoundaryCall<S> &boundary, const DerivativeCall<S> &derivative) {
    auto make = [&](int) { return std::make_unique<Tile>(call, boundary, derivative); };
    return run_boundary<Tile>(call, boundary, make, [&](Tile &tile, uint64_t first, uint32_t n, int, const Stop &stop) {
        GradientSink<F> sink = derivative.template forward_sink<F>();
        tile.run(first, n, sink, stop);
    });
}

}  // namespace

template <class S>
bool find_outlines(const RenderCall<S> &call, const uint8_t *moves, bool glued, uint64_t version, OutlineSet &outlines,
                   OutlinePieces &pieces) {
    auto interrupted = [&] { return call.interrupted && call.interrupted(0); };
    pieces = {};
    if (!outlines.update(*call.scene, moves, version, call.threads, interrupted)) return false;
    pieces = OutlineCutter<S>(call, outlines, glued).cut();
    return true;
}
template <class S>
ShadowPieces find_shadows(const RenderCall<S> &given, const BoundaryCall<S> &boundary,
                          const std::function<void(const BoundaryCall<S> &)> &look) {
    const LightPathCall<S> light(given, boundary.glued);
    constexpr size_t most = 4096, enough = 16;  // samples, and samples of a piece (half of a round lamp faces away)
    constexpr double unseen = 0.3;              // share of what goes by length alone
    ShadowPieces r = ShadowCutter<S>(light.call, *boundary.outlines, boundary.moves).cut();
    for (size_t i = 0; i < r.of.size(); ++i) {
        OutlinePieces &pieces = r.of[i];
        const size_t n = pieces.all.size();
        if (n == 0 || n > most || !(pieces.total() > 0)) continue;
        const size_t copies = std::min(enough, most / n);
        std::vector<double> each(n * copies, 0.0), seen(n, 0.0);
        BoundaryCall<S> looking = boundary;
        looking.part = BoundaryPart::Pieces, looking.shadows = &r, looking.emitter = int32_t(i);
        looking.first = 0, looking.count = each.size(), looking.samples = looking.total = 1, looking.in_view = 1;
        looking.value = each.data();
        look(looking);
        for (size_t k = 0; k < each.size(); ++k) seen[k % n] += each[k];
        const double sum = std::accumulate(seen.begin(), seen.end(), 0.0), length = pieces.total();
        if (!(sum > 0)) continue;
        double before = 0, total = 0;
        for (size_t k = 0; k < n; ++k) {
            const double share = (pieces.cdf[k] - before) / length;
            before = pieces.cdf[k];
            pieces.cdf[k] = total += unseen * share + (1 - unseen) * seen[k] / sum;
        }
    }
    return r;
}
template <class S>
std::vector<RenderStats> boundary_reverse(const std::vector<RenderCall<S>> &calls,
                                          const std::vector<BoundaryCall<S>> &boundaries,
                                          DerivativeCall<S> &derivative) {
    using F = PacketOf<S>;
    derivative.needs.geometry = true;  // paths keep where they arrived although lights alone may move
    int threads = 1;
    for (const RenderCall<S> &call : calls) threads = std::max(threads, call.threads);
    std::vector<GradientBuffers<S>> sums{size_t(threads)};
    auto reverse_one = [&](const RenderCall<S> &given, const BoundaryCall<S> &boundary) {
        const LightPathCall<S> light(given, boundary.glued);
        const RenderCall<S> &call = light.call;
        const BoundaryPart part = boundary.part;
        if (part == BoundaryPart::Silhouettes) return reverse<SilhouetteTile<F>, F>(call, boundary, derivative, sums);
        if (part == BoundaryPart::Outputs) return reverse<OutputTile<F>, F>(call, boundary, derivative, sums);
        if (part == BoundaryPart::Reflections) return reverse<ReflectionTile<F>, F>(call, boundary, derivative, sums);
        return reverse<ShadowTile<F>, F>(call, boundary, derivative, sums);
    };
    std::vector<RenderStats> stats;
    for (size_t i = 0; i < calls.size(); ++i) {
        stats.push_back(reverse_one(calls[i], boundaries[i]));
        if (stats.back().interrupted) return stats;
    }
    add_buffers(sums, derivative);
    return stats;
}
template <class S>
RenderStats boundary_forward(const RenderCall<S> &given, const BoundaryCall<S> &boundary,
                             DerivativeCall<S> &derivative) {
    using F = PacketOf<S>;
    const LightPathCall<S> light(given, boundary.glued);
    const RenderCall<S> &call = light.call;
    derivative.needs.geometry = true;
    if (boundary.part == BoundaryPart::Silhouettes) return forward<SilhouetteTile<F>, F>(call, boundary, derivative);
    if (boundary.part == BoundaryPart::Outputs) return forward<OutputTile<F>, F>(call, boundary, derivative);
    if (boundary.part == BoundaryPart::Reflections) return forward<ReflectionTile<F>, F>(call, boundary, derivative);
    return forward<ShadowTile<F>, F>(call, boundary, derivative);
}

#define TR_INSTANTIATE(S)                                                                                          \
    template bool find_outlines(const RenderCall<S> &, const uint8_t *, bool, uint64_t, OutlineSet &,              \
                                OutlinePieces &);                                                                  \
    template ShadowPieces find_shadows(const RenderCall<S> &, const BoundaryCall<S> &,                             \
                                       const std::function<void(const BoundaryCall<S> &)> &);                      \
    template std::vector<RenderStats> boundary_reverse(const std::vector<RenderCall<S>> &,                         \
                                                       const std::vector<BoundaryCall<S>> &, DerivativeCall<S> &); \
    template RenderStats boundary_forward(const RenderCall<S> &, const BoundaryCall<S> &, DerivativeCall<S> &);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
