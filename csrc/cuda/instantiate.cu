// The renderer's core compiled for a CUDA device, with Float = float: every stage of the path tracer as a kernel over
// paths. Nothing launches these kernels yet (that needs ray queries on the device and a scheduler); compiling them is
// what keeps the core free of everything that a device cannot do. `make cuda` does that.
#include "core/adjoint/camera.h"
#include "core/bsdf/diffuse.h"
#include "core/integrator/medium.h"

namespace tr {

using S = float;

// A path between two kernels.
struct PathState {
    Vec3<float> origin, direction;
    Origin<float> from;
    uint32_t pixel, sample;
    int32_t depth;
};

// What a ray query found: t < 0 at a miss.
struct Hit {
    SurfacePoint<float> at;
    float t;
};

__device__ inline uint32_t thread_index() { return blockIdx.x * blockDim.x + threadIdx.x; }

__global__ void start_paths(SceneView<S> scene, PathConfig config, uint32_t n, uint32_t width, uint32_t height,
                            PathState *paths) {
    uint32_t i = thread_index();
    if (i >= n) return;
    uint32_t pixel = i % (width * height), sample = i / (width * height);
    Random4<float> u = draw4<float>(config, pixel, sample, 0, 2);
    float length;
    Vec3<float> center;
    Ray<float> ray = Perspective::ray(scene, scene.sensors[config.sensor], float(pixel % width) + u.u[0],
                                      float(pixel / width) + u.u[1], S(width), S(height), length, center);
    paths[i] = {ray.o, ray.d, {center, 0.f}, pixel, sample, 0};
}

template <>
__global__ void emission(SceneView<S> scene, PathConfig config, uint32_t n, const PathState *paths, const Hit *hits,
                         S *radiance) {
    uint32_t i = thread_index();
    if (i >= n) return;
    const PathState &path = paths[i];
    Emission<float> found;
    found.radiance = uniform_spectrum(0.f);
    if (hits[i].t < 0) {
        if (scene.environment >= 0)
            found = environment_emission(scene, config, path.direction, path.from, true, path.depth == 1);
    } else {
        Ray<float> ray{path.origin, path.direction};
        Interaction<float> si = make_interaction(scene, ray, hits[i].at, hits[i].t, true);
        float cos_i = -dot(ray.d, si.frame.n);
        found = surface_emission(scene, config, si, cos_i, path.from, true, path.depth == 1);
    }
    for (int c = 0; c < SpectrumSize; ++c) radiance[i * C + c] = found.radiance[c];
}

template <>
__global__ void scatter_paths(SceneView<S> scene, PathConfig config, uint32_t n, PathState *paths, const Hit *hits,
                              Scattering<float> *out) {
    uint32_t i = thread_index();
    if (i >= n || hits[i].t < 0) return;
    PathState &path = paths[i];
    Ray<float> ray{path.origin, path.direction};
    Interaction<float> si = make_interaction(scene, ray, hits[i].at, hits[i].t, true);
    Vec3<float> wi = si.frame.to_local(-ray.d);
    int32_t bsdf = si.shape.bsdf;
    Leaf<float> leaf = resolve_bsdf<float>(scene, bsdf, wi.z < 0, true);
    wi.z = leaf.mirrored ? -wi.z : wi.z;
    uint32_t block = BlocksPerScattering * uint32_t(path.depth);
    Random4<float> ue = draw4<float>(config, path.pixel, path.sample, EmitterBlock + block, 4);
    Random4<float> ub = draw4<float>(config, path.pixel, path.sample, BsdfBlock + block, 3);
    dispatch(Bsdfs{}, scene.bsdfs[leaf.bsdf].kind, [&](auto model) {
        scatter<decltype(model)>(scene, config, si, wi, leaf, 0, path.depth, ue, ub, true, out[i]);
    });
    Vec3<float> wo = out[i].sample.wo;
    wo.z = leaf.mirrored ? -wo.z : wo.z;
    path.origin = si.p;
    path.direction = si.frame.to_world(wo);
    path.from = {si.p, out[i].sample.delta ? 0.f : out[i].sample.pdf};
    ++path.depth;
}

// Delta tracking to the next collision in a gridded medium, and scattering there.
template <>
__global__ void scatter_in_media(SceneView<S> scene, PathConfig config, uint32_t n, int32_t medium, PathState *paths,
                                 const S *length, MediumScattering<float> *out) {
    uint32_t i = thread_index();
    if (i >= n) return;
    PathState &path = paths[i];
    const MediumInfo &info = scene.media[medium];
    uint32_t block = SegmentBlock + BlocksPerSegment * uint32_t(path.depth);
    auto bits = random_bits4<float>(config.seed, config.sensor, path.pixel, path.sample, block);
    TrackingRandom<float> random{bits.bits[0] | 1u, bits.bits[1]};
    MajorantWalk<float, S> walk{};
    bool walking = walk.start(scene, info, path.origin, path.direction, length[i], true), stopped = false, left = false;
    float depth = optical_depth(random.next(true));
    while (walking) {
        walk.advance(scene, info, depth, walking, stopped, left);
        if (!stopped) continue;
        float sigma = grid_extinction<1>(scene, info, walk.local(), true)[0];
        if (random.next(true) * walk.majorant < sigma) break;
        depth = optical_depth(random.next(true));
        walking = true, stopped = false;
    }
    out[i] = no_medium_scattering<float>();
    if (!stopped) return;
    Vec3<float> p = path.origin + path.direction * (walk.enter + walk.t);
    block = BlocksPerScattering * uint32_t(path.depth);
    Random4<float> ue = draw4<float>(config, path.pixel, path.sample, EmitterBlock + block, 4);
    Random4<float> ub = draw4<float>(config, path.pixel, path.sample, BsdfBlock + block, 3);
    scatter_in_medium(scene, medium, p, path.direction, ue, ub, true, out[i]);
    path.origin = p;
    path.direction = out[i].wo;
    path.from = {p, out[i].pdf};
    ++path.depth;
}

// The derivative of a BSDF's value in each of its parameters, by dual numbers.
template <class Model>
__device__ void differentiate(const SceneView<S> &scene, int32_t bsdf, const SurfacePoint<float> &at,
                              const Vec3<float> &wi, const Vec3<float> &wo, S *out) {
    if constexpr (ParamCount<Model>::All > 0) {
        auto params = seed_params<Model, float>(load_params<Model>(scene, bsdf, at, true));
        auto value = Model::eval(params, wi, wo, 0);
        for (int c = 0; c < SpectrumSize; ++c)
            for (int k = 0; k < ParamCount<Model>::All; ++k) out[c * ParamCount<Model>::All + k] = value[c].d[k];
    }
}

template <>
__global__ void differentiate_bsdfs(SceneView<S> scene, uint32_t n, const int32_t *bsdfs, const SurfacePoint<float> *at,
                                    const Vec3<float> *wi, const Vec3<float> *wo, S *out, uint32_t stride) {
    uint32_t i = thread_index();
    if (i >= n) return;
    dispatch(Bsdfs{}, scene.bsdfs[bsdfs[i]].kind, [&](auto model) {
        differentiate<decltype(model)>(scene, bsdfs[i], at[i], wi[i], wo[i], out + i * stride);
    });
}

// Forward-mode derivative of where camera rays hit, for adjoints of position, normal and coordinates.
template <>
__global__ void move_hits(SceneView<S> scene, PathConfig config, uint32_t n, uint32_t width, uint32_t height,
                          const Hit *hits, const HitAdjoint<float> *adjoints, const float *x, const float *y,
                          ForwardSink<float> *sinks) {
    uint32_t i = thread_index();
    if (i >= n || hits[i].t < 0) return;
    const Record &camera = scene.sensors[config.sensor];
    float length;
    Vec3<float> center, zero{0.f, 0.f, 0.f};
    Ray<float> ray = Perspective::ray(scene, camera, x[i], y[i], S(width), S(height), length, center);
    Interaction<float> si = make_interaction(scene, ray, hits[i].at, hits[i].t, true);
    Vec3<float> segment = si.p - center;
    Arrival<float> in{true, ray.d, norm(segment), segment, zero, 0.f};
    RayAdjoint<float> g = sweep_surface(scene, si.at, si.p, in, adjoints[i], true, sinks[i]);
    sweep_pinhole(scene, camera, x[i], y[i], S(width), S(height), g, zero, true, sinks[i]);
}

// Scattering in a medium: a new direction, and the forward-mode derivative of its density.
template <>
__global__ void scatter_by_phase(SceneView<S> scene, uint32_t n, const int32_t *phases, const Vec3<float> *u,
                                 PathState *paths, ForwardSink<float> *sinks, S *density) {
    uint32_t i = thread_index();
    if (i >= n) return;
    const Vec3<float> p = paths[i].origin, d = paths[i].direction;
    Vec3<float> wo = sample_phase(scene, phases[i], p, d, u[i].x, u[i].y, u[i].z, true);
    density[i] = eval_phase(scene, phases[i], p, d, wo, true);
    sweep_phase(scene, phases[i], p, d, wo, uniform_spectrum(1.f), true, sinks[i]);
    paths[i].direction = wo;
}

#define TR_INSTANTIATE(C)                                                                                              \
    template __global__ void emission(SceneView<S>, PathConfig, uint32_t, const PathState *, const Hit *, S *);        \
    template __global__ void scatter_paths(SceneView<S>, PathConfig, uint32_t, PathState *, const Hit *,               \
                                           Scattering<float> *);                                                       \
    template __global__ void scatter_in_media(SceneView<S>, PathConfig, uint32_t, int32_t, PathState *, const S *,     \
                                              MediumScattering<float> *);                                              \
    template __global__ void scatter_by_phase(SceneView<S>, uint32_t, const int32_t *, const Vec3<float> *,            \
                                              PathState *, ForwardSink<float> *, S *);                                 \
    template __global__ void move_hits(SceneView<S>, PathConfig, uint32_t, uint32_t, uint32_t, const Hit *,            \
                                       const HitAdjoint<float> *, const float *, const float *, ForwardSink<float> *); \
    template __global__ void differentiate_bsdfs(SceneView<S>, uint32_t, const int32_t *, const SurfacePoint<float> *, \
                                                 const Vec3<float> *, const Vec3<float> *, S *, uint32_t);
TR_INSTANTIATE(1)
TR_INSTANTIATE(3)

}  // namespace tr
