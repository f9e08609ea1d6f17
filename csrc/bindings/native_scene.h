// A scene as Python holds it, whatever its precision and colours.
#pragma once

#include <memory>
#include <optional>

#include "config.h"
#include "cpu/boundary_call.h"
#include "cpu/derivative_call.h"

namespace tr {

using Arrays = std::map<std::string, uintptr_t>;  // addresses by name

// The values of the parameters, and which of them have changed since the last call.
struct ParameterValues {
    Addresses addresses;
    std::vector<uint8_t> dirty;
};

// The outlines of a scene, kept from call to call.
struct SceneOutlines {
    OutlineSet set;
    OutlinePieces pieces;
    std::optional<ShadowPieces> shadows;  // of the last time, once they were wanted
};

// A part of a BoundaryCall's members, by their names.
struct BoundaryRequest {
    std::string part;  // silhouettes, outputs, reflections, shadows or pilot
    Arrays arrays;
    std::map<std::string, double> numbers;
    Arrays outputs;  // by the names of outputs: anything but zero
};

// What of bent_rays.h, its numbers and its arrays by their names, and how many rows these have.
struct BendRequest {
    std::string what;  // trace, reverse, forward, field, field_reverse or field_forward
    size_t n;
    std::map<std::string, double> numbers;
    Arrays arrays;
};

class NativeScene {
public:
    virtual ~NativeScene() = default;
    virtual void build(const SceneObjects &objects, const std::vector<std::vector<int64_t>> &shapes,
                       const std::vector<IndexArray> &arrays, NativeScene *previous) = 0;
    virtual std::map<std::string, uint64_t> counters() = 0;

    // `image`, and `alpha` and `variance` where they are given.
    virtual RenderStats render(const Config &, const ParameterValues &, const Arrays &out) = 0;
    // Adjoints of one image, each with gradients, of slots that the first one has gradients of.
    virtual RenderStats reverse(const Config &, const ParameterValues &, const Addresses &adjoints,
                                const std::vector<Addresses> &gradients) = 0;
    virtual RenderStats forward(const Config &, const ParameterValues &, const Addresses &tangents,
                                uintptr_t image) = 0;
    // See PixelWeights.
    virtual RenderStats weights(const Config &, const ParameterValues &, const Arrays &out) = 0;
    // By the responses of the film's channels, see response_reverse: added to `gradient`.
    virtual RenderStats response_reverse(const Config &, const ParameterValues &, uintptr_t adjoint,
                                         uintptr_t gradient) = 0;
    // Outputs besides radiance, by name; shape_id, prim_id and material_id are int32.
    virtual RenderStats aov(const Config &, const ParameterValues &, const Arrays &out) = 0;
    virtual RenderStats aov_reverse(const Config &, const ParameterValues &, const Arrays &adjoints,
                                    const Addresses &gradients) = 0;
    virtual RenderStats aov_forward(const Config &, const ParameterValues &, const Addresses &tangents,
                                    const Arrays &out) = 0;

    // Brings outlines up to date, see OutlineSet::update; false if that was interrupted.
    virtual bool find_outlines(const Config &, const ParameterValues &, uintptr_t moves, SceneOutlines &) = 0;
    // The derivative of their motion: added to the gradients or, `forward`, along tangents.
    // Of several samples of parts at once, with a configuration each.
    virtual std::vector<RenderStats> boundary(const std::vector<Config> &, const ParameterValues &,
                                              const std::vector<BoundaryRequest> &, SceneOutlines &,
                                              const Addresses &slots, bool forward) = 0;

    // Rays: origins and directions (n, 3) and lengths (n,). `device`: cpu or emulated.
    virtual void intersect(size_t n, const std::array<uintptr_t, 3> &rays, const Arrays &out, const std::string &device,
                           const ParameterValues &) = 0;
    virtual void occluded(size_t n, const std::array<uintptr_t, 3> &rays, uintptr_t out, const std::string &device,
                          const ParameterValues &) = 0;
    // One model of the scene, see probes.h; arrays by name.
    virtual void probe(const std::string &what, int index, size_t n, const Arrays &arrays, const ParameterValues &) = 0;
    // Rays that bend, see bend.h.
    virtual void bend(const BendRequest &, const ParameterValues &) = 0;
    virtual std::array<double, 6> bounds() = 0;
    virtual std::vector<double> emitter_probabilities() = 0;  // of the last call
    // The record that keeps the rays of the next renderings; null: none any more.
    virtual void record_rays(std::shared_ptr<RayRecord> record) = 0;
    virtual RayRecord::Replay replay_rays(const RayRecord &, RayKind, int width, bool coherent, int threads,
                                          int rounds) = 0;
};

// color: mono, rgb or spectral; dtype: float32, or float64 where this module computes in it.
std::unique_ptr<NativeScene> make_scene(const std::string &color, const std::string &dtype);

}  // namespace tr
