// The particle tracer, a vertex at a time: paths of light, from an emitter on, that are connected to the camera at
// every vertex that is not a delta lobe (light tracing: Dutre, Lafortune and Willems 1993; Veach, "Robust Monte Carlo
// Methods for Light Transport Simulation", 1997, chapters 4 and 10.2). Caustics that no path from the camera finds are
// its strength; a surface that is seen through smooth glass its blind spot.
//
// Random numbers of a path: block 0 gives the point on the emitter, which is spread evenly over all paths (the pixels
// of the film are strata of the unit square); block 1 the emitter and the direction. Scatterings take the blocks that
// they take in the path tracer; of block 1 + 2 j roulette uses the last number.
#pragma once

#include "../emitter/emission.h"
#include "../sensor/irradiancemeter.h"
#include "path.h"

namespace tr {

constexpr uint32_t EmissionBlock = 1;

// With an interpolated normal n_s, light that arrives along wi and leaves along wo is scattered by f(wi, wo) |wo.n_s|
// towards a camera's path, but the flux of a light path sees |wi.n_s| / |wi.n_g| of it (Veach 1997, section 5.3.2).
template <class F>
TR_INLINE F shading_correction(const Vec3<F> &wi, const Vec3<F> &wo, const Vec3<F> &ns, const Vec3<F> &ng,
                               const MaskOf<F> &interpolated) {
    F below = dot(wi, ng) * dot(wo, ns), above = dot(wi, ns) * dot(wo, ng);
    auto usable = interpolated && mask<F>(below != F(0));
    return select(usable, abs(above / select(usable, below, F(1))), F(1));
}

// What leaves an emitter along d, divided by radiance: the cosine, or 0 behind it. Beams cannot be connected.
template <class F>
TR_INLINE F emission_cosine(const EmissionSample<F> &e, const Vec3<F> &d) {
    auto area = mask<F>(e.kind == int32_t(EmitterKind::Area));
    return select(area, max(dot(e.n, d), F(0)), select(is_surrounding<F>(e.kind), F(1), F(0)));
}

template <class F, int C>
struct LightScattering {
    Color<F, C> f_camera, f;  // with their corrections
    Vec3<F> wo_camera;        // local
    MaskOf<F> connected;
    BsdfSample<F> sample;
    F inverse_pdf;
    MaskOf<F> alive;
};

// The sensor as light paths see it.
template <class S>
struct LightSensor {
    const Record &record;
    Pinhole<S> camera;
    int32_t meter = -1;  // the shape that an irradiance meter lies on

    LightSensor(const SceneView<S> &scene, uint32_t index, S width, S height)
        : record(scene.sensors[index]), camera(width, height) {
        if (record.kind == IrradianceMeterKind)
            meter = record.field[IrradianceMeter::ShapeIndex];
        else
            camera = Pinhole<S>(scene, record, width, height);
    }
};

// Whether flux sees another cosine than the geometric one, see shading_correction.
template <class F>
TR_INLINE MaskOf<F> has_shading_normal(const ShapeLanes<F> &shape, const Leaf<F> &leaf, const MaskOf<F> &active) {
    return active && (shape.has(HasNormals) || mask<F>(leaf.layers.turned >= 0));
}

// As scatter_through_layers; light comes along d.
template <int C, class F, class S>
TR_NOINLINE void scatter_light_through_layers(const SceneView<S> &scene, const Interaction<F> &si, const Vec3<F> &d,
                                              const Leaf<F> &leaf, const Vec3<F> &to_camera, const Vec3<F> &wo,
                                              const MaskOf<F> &active, LightScattering<F, C> &r) {
    const Layers<F> &layers = leaf.layers;
    r.f = r.f * layers.weight;
    r.f_camera = r.f_camera * (layers.weight * layers.inverse_probability);
    r.inverse_pdf = r.inverse_pdf * layers.inverse_probability;
    TurnedFactor<F> factor(scene, leaf, si.frame.n, active);
    if (!any(factor.turned)) return;
    auto seen = !factor.hidden(-d);
    r.connected = r.connected && seen && !factor.hidden(to_camera);
    r.alive = r.alive && seen && !factor.hidden(wo);
    r.f_camera = r.f_camera * factor(to_camera, -d);
    r.f = r.f * factor(wo, -d);
    r.inverse_pdf = select(r.alive, r.inverse_pdf, F(0));
}

// One vertex. `wi` is local and mirrored where the leaf is; `d` the direction of travel. `goes_on`: the path does.
template <class Model, int C, class F, class S>
TR_INLINE void scatter_light(const SceneView<S> &scene, const Interaction<F> &si, const Vec3<F> &d, const Vec3<F> &wi,
                             const Leaf<F> &leaf, const Connection<F> &camera, const Random4<F> &u, bool goes_on,
                             const MaskOf<F> &active, LightScattering<F, C> &r) {
    constexpr Transport importance = Transport::Importance;
    auto params = load_params<Model, C>(scene, leaf.bsdf, si.at, active);
    F mirror = select(leaf.mirrored, F(-1), F(1));
    auto interpolated = has_shading_normal(si.shape, leaf, active);
    r.connected = MaskOf<F>(false);
    r.wo_camera = {F(0), F(0), F(1)};
    r.f = r.f_camera = uniform_color<C>(F(0));
    if constexpr (Model::Smooth) {
        auto seen = active && camera.seen;
        if (any(seen)) {
            r.wo_camera = si.frame.to_local(camera.d);
            r.wo_camera.z = r.wo_camera.z * mirror;
            r.f_camera = eval_bsdf<importance, Model, C>(params, wi, r.wo_camera, IntOf<F>(0)) *
                         shading_correction(-d, camera.d, si.frame.n, si.ng, interpolated);
            // black surfaces have derivatives, too
            r.connected = seen && mask<F>(Model::template pdf<C>(params, wi, r.wo_camera) > F(0));
        }
    }
    r.alive = MaskOf<F>(false);
    r.inverse_pdf = F(0);
    r.sample = {{F(0), F(0), F(1)}, F(0), F(1), IntOf<F>(0), MaskOf<F>(false), MaskOf<F>(false)};
    Vec3<F> out = si.frame.n;
    if (goes_on) {
        r.sample = Model::template sample<C>(params, wi, u.u[0], u.u[1], u.u[2]);
        Vec3<F> wo = r.sample.wo;
        wo.z = wo.z * mirror;
        out = si.frame.to_world(wo);
        r.f = eval_bsdf<importance, Model, C>(params, wi, r.sample.wo, r.sample.lobe) *
              shading_correction(-d, out, si.frame.n, si.ng, interpolated);
        r.alive = active && mask<F>(r.sample.pdf > F(0));
        r.inverse_pdf = select(r.alive, F(1) / select(r.alive, r.sample.pdf, F(1)), F(0));
    }
    if (scene.layered) scatter_light_through_layers(scene, si, d, leaf, camera.d, out, active, r);
}

}  // namespace tr
