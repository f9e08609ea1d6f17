// A vertex of a path as its derivative sees it.
#pragma once

#include "../emitter/emitter.h"
#include "surface.h"

namespace tr {

// What the path tape keeps of a vertex.
template <class F>
struct VertexRecord {
    Spectrum<F> beta;  // throughput of the camera's side
    TexturedPoint<F> at;
    EmitterPoint<F> emission;  // (its surface point is `at` on shapes)
    F emission_weight;
    Spectrum<F> emission_radiance;  // E_k
    IntOf<F> bsdf;
    Vec3<F> wi;
    // emitter sample; light_weight = 0 where there was none or it was in shadow
    EmitterPoint<F> light;
    Vec3<F> wo_light;
    F light_weight, light_distance;
    Spectrum<F> emitted;
    Spectrum<F> through = uniform_spectrum(F(1));  // transmittance of media on the way to the light
    LineAdjoint<F> way;                            // ... and what it hands to that way's ends, where something moves
    // BSDF sample; inverse_pdf = 1 / (p q)
    Vec3<F> wo;
    IntOf<F> lobe;
    F inverse_pdf;
    // the local frame: shading normal, and -1 where z is reversed (the back of `twosided`)
    Vec3<F> normal;
    F mirror;
    Vec3<F> s{F(0), F(0), F(0)};  // its first axis, of scenes that follow the tangent
    // scenes with stacks of BSDFs, see ResolvedBsdf
    F choice{0};
    Vec3<F> base_normal{F(0), F(0), F(0)};
    // only where something moves: the ray that arrived, and D = x_k - x_{k-1} (0 for rays that left the scene)
    Vec3<F> d, p, segment;
    F t;
    MaskOf<F> attached;         // the ray comes from the camera or a delta lobe
    MaskOf<F> parallel{false};  // ... from infinitely far away
    MaskOf<F> resting{false};   // attached to a direction that rests
};

template <class F, class S>
TR_INLINE Frame<F> vertex_frame(const SceneView<S> &scene, const VertexRecord<F> &v) {
    if (scene.follows_tangent) return {v.s, cross(v.normal, v.s), v.normal};
    return make_frame(v.normal);
}

// What a vertex gets from the next one: R_{k+1}, the adjoint of the ray to it (behind a smooth BSDF that of x_k only);
// and where a point is glued there, D / r^2 and the point (D = 0: there is none).
template <class F>
struct NextVertex {
    Spectrum<F> radiance;
    RayAdjoint<F> ray;
    Vec3<F> segment, p;
    SurfacePoint<F> at;
    // Behind boundaries that do not scatter: of the place that what follows began at, if its direction rests; and of
    // that before all such boundaries, from which the glued point is seen.
    Vec3<F> rest{F(0), F(0), F(0)}, from{F(0), F(0), F(0)};
};

// Adjoint of D from that of its direction, with u = D / r^2.
template <class F>
TR_INLINE Vec3<F> direction_adjoint(const Vec3<F> &u, const Vec3<F> &w_bar) {
    F inverse_squared = squared_norm(u);
    F inverse_r = sqrt(inverse_squared);
    Vec3<F> w = u * (F(1) / select(mask<F>(inverse_squared > F(0)), inverse_r, F(1)));
    return unnormalize(w, w_bar, inverse_r);
}

// Of light paths: what the tape keeps of a connection besides VertexRecord, whose `light_weight` is W where the way is
// free, else 0, and whose `emitted` is the adjoint of what the connection brings.
template <class F>
struct ConnectionRecord {
    F x_bar, y_bar;  // of the place on the film
    Vec3<F> ng;      // geometric normal of the vertex
};

// What the tape keeps of a light path's beginning, see EmissionSample; `v` holds its connection, and in `inverse_pdf`
// the weight of the light that leaves along d.
template <class F>
struct EmissionRecord {
    const VertexRecord<F> &v;
    const ConnectionRecord<F> &connection;
    IntOf<F> kind;
    Spectrum<F> radiance;
};

}  // namespace tr
