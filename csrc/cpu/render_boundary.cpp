// The derivative of moving outlines, see boundary_tile.h.
#include "boundary_lights.h"
#include "boundary_outputs.h"
#include "boundary_reflections.h"
#include "boundary_seen.h"
#include "work_items.h"

namespace tr {

namespace {

constexpr uint64_t SamplesPerItem = 2048;

// Calls work(tile, first, n, thread, stop) for batches of the samples.
template <class Tile, class S, class Make, class Work>
RenderStats run_boundary(const RenderCall<S> &call, const BoundaryCall<S> &boundary, Make &&make, Work &&work) {
    RenderStats stats;
    Stopwatch watch(stats.seconds);
    const size_t items = size_t((boundary.count + SamplesPerItem - 1) / SamplesPerItem);
    run_tiles(items, call, Assignment::Interleaved, stats, make, [&](Tile &tile, size_t item, int thread, auto &&stop) {
        const uint64_t end = std::min(boundary.count, uint64_t(item + 1) * SamplesPerItem);
        for (uint64_t first = item * SamplesPerItem; first < end && !stop(); first += Tile::Capacity)
            work(tile, first, uint32_t(std::min<uint64_t>(Tile::Capacity, end - first)), thread, stop);
    });
    return stats;
}

template <class Tile, class F, class S = ScalarOf<F>>
RenderStats reverse(const RenderCall<S> &call, const BoundaryCall<S> &given, DerivativeCall<S> &derivative) {
    derivative.sums.reset(derivative.n_constants, derivative.geometry_sizes);
    FilmBlock film;
    film.reset(call.crop, given.channels);
    const double *from = given.adjoint;
    for (int y = call.crop.y0; y < call.crop.y1; ++y)
        for (int x = call.crop.x0; x < call.crop.x1; ++x, from += film.values)
            std::copy_n(from, film.values, film.at(y, x));
    BoundaryCall<S> boundary = given;
    boundary.film = &film;
    std::vector<GradientBuffers<S>> locals{size_t(call.threads)};
    auto make = [&](int thread) {
        locals[size_t(thread)].allocate(derivative, thread);
        return std::make_unique<Tile>(call, boundary, derivative);
    };
    RenderStats stats =
        run_boundary<Tile>(call, boundary, make, [&](Tile &tile, uint64_t first, uint32_t n, int thread, auto &&stop) {
            GradientSink<F> sink = locals[size_t(thread)].template sink<F>(derivative);
            tile.run(first, n, sink, stop);
        });
    add_buffers(locals, derivative);
    return stats;
}

template <class Tile, class F, class S = ScalarOf<F>>
RenderStats forward(const RenderCall<S> &call, const BoundaryCall<S> &boundary, const DerivativeCall<S> &derivative) {
    auto make = [&](int) { return std::make_unique<Tile>(call, boundary, derivative); };
    return run_boundary<Tile>(call, boundary, make, [&](Tile &tile, uint64_t first, uint32_t n, int, auto &&stop) {
        GradientSink<F> sink = derivative.template forward_sink<F>();
        tile.run(first, n, sink, stop);
    });
}

// The call, of glued samples with a scene in which lights of no weight are dark: no light path begins there.
template <class S>
struct LightPathCall {
    SceneView<S> scene;
    std::vector<ShapeInfo> shapes;
    RenderCall<S> call;

    LightPathCall(const RenderCall<S> &given, bool glued) : scene(*given.scene), call(given) {
        const S *pmf = scene.emitter_pmf;
        if (!glued || std::all_of(pmf, pmf + scene.n_emitters, [](S p) { return p > 0; })) return;
        shapes.assign(scene.shapes, scene.shapes + scene.n_shapes);
        for (ShapeInfo &shape : shapes)
            if (shape.emitter >= 0 && !(pmf[shape.emitter] > 0)) shape.emitter = -1;
        if (scene.environment >= 0 && !(pmf[scene.environment] > 0)) scene.environment = -1;
        scene.shapes = shapes.data(), call.scene = &scene;
    }
    LightPathCall(const LightPathCall &) = delete;
};

}  // namespace

template <class S>
OutlinePieces find_outlines(const RenderCall<S> &call, const uint8_t *moves, OutlineSet &outlines, bool glued) {
    outlines.update(*call.scene, moves, call.threads);
    return OutlineCutter<S>(call, outlines, glued).cut();
}
template <class S>
RenderStats boundary_reverse(const RenderCall<S> &given, const BoundaryCall<S> &boundary,
                             DerivativeCall<S> &derivative) {
    using F = PacketOf<S>;
    const LightPathCall<S> light(given, boundary.glued);
    const RenderCall<S> &call = light.call;
    derivative.needs.geometry = true;  // paths keep where they arrived although lights alone may move
    if (boundary.part == BoundaryPart::Silhouettes) return reverse<SilhouetteTile<F>, F>(call, boundary, derivative);
    if (boundary.part == BoundaryPart::Outputs) return reverse<OutputTile<F>, F>(call, boundary, derivative);
    if (boundary.part == BoundaryPart::Reflections) return reverse<ReflectionTile<F>, F>(call, boundary, derivative);
    return reverse<ShadowTile<F>, F>(call, boundary, derivative);
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

#define TR_INSTANTIATE(S)                                                                                       \
    template OutlinePieces find_outlines(const RenderCall<S> &, const uint8_t *, OutlineSet &, bool);           \
    template RenderStats boundary_reverse(const RenderCall<S> &, const BoundaryCall<S> &, DerivativeCall<S> &); \
    template RenderStats boundary_forward(const RenderCall<S> &, const BoundaryCall<S> &, DerivativeCall<S> &);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
