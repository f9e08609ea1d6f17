// A vertex of a path as its derivative sees it.
#pragma once

#include "../integrator/medium.h"
#include "surface.h"

namespace tr {

// What the path tape keeps of a vertex.
template <class F, int C>
struct VertexRecord {
    Color<F, C> beta;  // throughput of the camera's side
    TexturedPoint<F> at;
    EmitterPoint<F> emission;  // (its surface point is `at` on shapes)
    F emission_weight;
    Color<F, C> emission_radiance;  // E_k
    IntOf<F> bsdf;
    Vec3<F> wi;
    // emitter sample; light_weight = 0 where there was none or it was in shadow
    EmitterPoint<F> light;
    Vec3<F> wo_light;
    F light_weight, light_distance;
    Color<F, C> emitted;
    Color<F, C> through = uniform_color<C>(F(1));  // transmittance of media on the way to the light
    // BSDF sample; inverse_pdf = 1 / (p q)
    Vec3<F> wo;
    IntOf<F> lobe;
    F inverse_pdf;
    // the local frame: shading normal, and -1 where z is turned round (the back of `twosided`)
    Vec3<F> normal;
    F mirror;
    Vec3<F> s{F(0), F(0), F(0)};  // its first axis, of oriented scenes
    // layered scenes, see Leaf
    F choice{0};
    Vec3<F> base{F(0), F(0), F(0)};
    // only where something moves: the ray that arrived, and D = x_k - x_{k-1} (0 for rays that left the scene)
    Vec3<F> d, p, segment;
    F t;
    MaskOf<F> attached;  // the ray comes from the camera or a delta lobe
};

template <class F, int C, class S>
TR_INLINE Frame<F> vertex_frame(const SceneView<S> &scene, const VertexRecord<F, C> &v) {
    if (scene.oriented) return {v.s, cross(v.normal, v.s), v.normal};
    return make_frame(v.normal);
}

struct Wanted {
    bool bsdf, emitter, light_position;
    bool geometry;  // anything that moves rays, hits or look-ups
    bool camera;
    MediumWanted medium{};
    bool lookups = true;             // with `geometry`: what BSDFs look up varies over surfaces
    const int32_t *bsdfs = nullptr;  // by bsdf, whether a parameter of it is differentiated; null if `bsdf` is not set
    bool numbers() const { return light_position || geometry; }  // adjoints that are sums over channels
};

}  // namespace tr
