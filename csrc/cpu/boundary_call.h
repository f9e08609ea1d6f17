// What the derivative of moving outlines is asked for, besides what every derivative is (DerivativeCall).
#pragma once

#include <algorithm>
#include <functional>
#include <vector>

#include "aovs.h"
#include "core/boundary/samples.h"
#include "shadow_pieces.h"

namespace tr {

// Which samples: of outlines that the camera sees, for radiance or other outputs; of those that vertices of paths see;
// of those that lights see, which have two places on the film each; of these, whether they are found and where the
// camera sees them; and how much it sees of each of the pieces of a light.
enum class BoundaryPart { Silhouettes, Outputs, Reflections, Shadows, Pilot, Pieces };

constexpr int MostBoundaryChannels = std::max(4 * SpectrumSize, MaxAovChannels) + 1;

// Look-ups of light that belong to one sample have the same wavelengths, see CopyBit.
template <class S>
void share_wavelengths(RenderCall<S> &call) {
    call.config.spectral.pixel_bits = (1u << CopyBit) - 1, call.config.spectral.sample_bits = 0;
}

template <class S>
struct BoundaryCall {
    BoundaryPart part;
    // Of a place on the film: radiance, or Stokes vectors, and alpha; or the channels of other outputs, and whether
    // there is anything.
    int channels;
    Filter filter;
    const AovLayout *layout = nullptr;  // of other outputs
    const OutlineSet *outlines;
    const uint8_t *moves;  // by shape, whether it does
    // Of a pass there are so many samples, and sample i takes a random place from i / samples to (i + 1) / samples: of
    // silhouettes along all pieces, else among the cells.
    const OutlinePieces *pieces;
    double samples;
    const ShadowPieces *shadows;
    int32_t emitter = -1;  // of the part `Pieces`, whose samples are those of its pieces in turn
    const int64_t *cells;  // (n_cells, 2), x and y: squares of the film that reach wanted pixels
    size_t n_cells;
    uint64_t first, count;  // numbers of the samples, of `total` in all passes
    double total;
    double near;          // what counts as close
    double in_view;       // the share of the outlines that lights see which the camera sees
    bool weighs = false;  // samples alone, see `value`
    bool glued = false;   // points move with their surfaces, as those of light paths do, see boundary_tile.h
    const FilmBlock *film = nullptr;  // reverse: the adjoint, set by the call
    // Pilot: the place, NaN where nothing is seen, and 1 where an edge was found. Pieces: what is seen, as a number.
    // What weighs: the square of what a sample adds to the film where its outline moves by 1, summed over channels.
    // Reverse: the adjoint of the wanted pixels (height, width, channels) over the integral of their filter.
    // Forward: for each sample its place on the film (count, 2) and what it adds there (count, channels).
    const double *adjoint;
    double *place, *value;
};

template <class S>
BoundaryView<S> view_of(const RenderCall<S> &call, const BoundaryCall<S> &given) {
    return {given.outlines->table(),
            given.pieces->view(),
            given.samples,
            given.cells,
            given.n_cells,
            given.first,
            given.total,
            given.near,
            given.in_view,
            given.glued,
            S(call.film_width),
            S(call.film_height),
            call.crop,
            call.samples,
            given.filter.reach()};
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

    bool changes_scene() const { return call.scene == &scene; }
};
// Of their paths, which look for no lights: what they are for is their vertices.
template <class S>
RenderCall<S> outline_path_call(const RenderCall<S> &call, BoundaryPart part) {
    RenderCall<S> r = call;
    r.config.emitter_samples = 0, r.config.bsdf_samples = 1;
    r.config.sampler = {};
    // the last vertex of paths to lights is one that lights have found
    if (part == BoundaryPart::Shadows && r.config.max_depth > 0) --r.config.max_depth;
    r.ray_record = nullptr;
    return r;
}
// Lights that throw shadows, `extended`: those alone that rays can find; see LightList.
struct LightTable {
    std::vector<int32_t> lights;
    std::vector<double> cdf;
};
template <class F>
LightTable shadow_lights(const SceneOf<F> &scene, bool extended) {
    LightTable r;
    double sum = 0;
    for (int32_t i = 0; i < scene.n_emitters; ++i) {
        const EmitterKernels<F> &kernels = emitter_kernels<F>(scene.emitters[i].kind);
        const bool found = kernels.is(IsEnvironment) || (kernels.is(IsOnShape) && !kernels.is(IsBeam));
        const bool from_afar = kernels.is(IsInfinite | HasDeltaPosition);
        if (!(found || (from_afar && !extended)) || !(scene.emitter_pmf[i] > 0)) continue;
        sum += double(scene.emitter_pmf[i]);
        r.lights.push_back(i), r.cdf.push_back(sum);
    }
    return r;
}
// Samples that are worked on together, of which each may depend on the others: few, for all threads, of few.
template <class S>
uint64_t group_of(const BoundaryCall<S> &boundary) {
    return boundary.weighs || boundary.part == BoundaryPart::Pilot ? 64 : 1024;
}

// Brings outlines up to date, see OutlineSet::update, and finds pieces of those that the camera sees, `glued`: for such
// samples; false if that was interrupted.
template <class S>
bool find_outlines(const RenderCall<S> &call, const uint8_t *moves, bool glued, uint64_t version, OutlineSet &outlines,
                   OutlinePieces &pieces);
// The pieces of shadows' edges, weighted by what the camera sees of them, where they are few beside so many samples.
// look(boundary) takes samples of that part.
template <class S>
ShadowPieces find_shadows(const RenderCall<S> &call, const BoundaryCall<S> &boundary,
                          const std::function<void(const BoundaryCall<S> &)> &look);
// Of several calls, which add up what they find together, so that the gradients of a large mesh are made once. It ends
// with one that is interrupted.
template <class S>
std::vector<RenderStats> boundary_reverse(const std::vector<RenderCall<S>> &calls,
                                          const std::vector<BoundaryCall<S>> &boundaries,
                                          DerivativeCall<S> &derivative);
template <class S>
RenderStats boundary_forward(const RenderCall<S> &call, const BoundaryCall<S> &boundary, DerivativeCall<S> &derivative);

}  // namespace tr
