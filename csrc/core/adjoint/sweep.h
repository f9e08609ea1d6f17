// The derivative of a path, one vertex at a time, from its end to its beginning.
//
// With the suffix radiance  R_k = E_k + N_k + f_k / (p_k q_k) R_{k+1}  and the pixel's adjoint delta, A_k = delta
// beta_k:
//     dL = sum_k  A_k ( dE_k + dN_k + df_k / (p_k q_k) R_{k+1} ).
// Sampling densities, MIS weights, roulette and visibility are constants of the derivative (detached sampling: Zeltner,
// Speierer, Georgiev and Jakob, "Monte Carlo Estimators for Differential Light Transport", SIGGRAPH 2021). Nothing is
// traced again and nothing is divided by f: where f = 0 its derivative is as good as anywhere.
#pragma once

#include "../integrator/path.h"
#include "sink.h"

namespace tr {

// What the path tape keeps of a vertex.
template <class F, int C>
struct VertexRecord {
    Color<F, C> beta;  // throughput of the camera's side
    SurfacePoint<F> at;
    EmitterPoint<F> emission;  // (its surface point is `at` on shapes)
    F emission_weight;
    Color<F, C> emission_radiance;  // E_k
    IntOf<F> bsdf;
    Vec3<F> wi;
    // emitter sample; light_weight = 0 where there was none or it was in shadow
    EmitterPoint<F> light;
    Vec3<F> wo_light;
    F light_weight;
    Color<F, C> emitted;
    // BSDF sample; inverse_pdf = 1 / (p q)
    Vec3<F> wo;
    IntOf<F> lobe;
    F inverse_pdf;
    // for the position of a point light: distance, and the frame in which wo_light is
    F light_distance, mirror;
    Vec3<F> normal;
};

struct Wanted {
    bool bsdf, emitter, position;
};

// Derivative of what an emitter sends, at one of its points.
template <class F, int C, class S, class Sink>
TR_INLINE void sweep_emitter(const SceneView<S> &scene, const EmitterPoint<F> &point, const Color<F, C> &g,
                             const MaskOf<F> &active, Sink &sink) {
    IntOf<F> kind = record_kind<F>(scene.emitters, point.emitter, active);
    auto area = active && mask<F>(kind == int32_t(EmitterKind::Area));
    if (any(area)) {
        IntOf<F> texture = record_field<F>(scene.emitters, AreaEmitter::Radiance, point.emitter, area);
        sink.texture(scene, texture, point.at, g, area);
    }
    auto flat =
        active && (mask<F>(kind == int32_t(EmitterKind::Constant)) || mask<F>(kind == int32_t(EmitterKind::Point)));
    if (any(flat)) sink.color(scene, record_field<F>(scene.emitters, 0, point.emitter, flat), g, flat);
    auto map = active && mask<F>(kind == int32_t(EmitterKind::EnvironmentMap));
    if (any(map)) {
        const Record &record = scene.emitters[scene.environment];
        int32_t slot = record.field[EnvironmentMap::Data];
        const TensorView<S> &tensor = scene.values.tensors[slot];
        F scale(scene.values.constants[record.field[EnvironmentMap::Scale]]);
        auto at = EnvironmentMap::footprint(tensor, Vec2<F>{point.at.b1, point.at.b2});
        sink.footprint(scene, slot, at, g * scale, map);
        sink.number(scene, IntOf<F>(record.field[EnvironmentMap::Scale]), g * gather_footprint<C>(tensor, at, map),
                    map);
    }
}

// dN/d(position) of a point light: f(w) I / |x|^2 with x = position - p, by dual numbers over the three local
// coordinates of x.
template <class Model, int C, class F, class S, class Sink>
TR_INLINE void sweep_light_position(const SceneView<S> &scene, const VertexRecord<F, C> &v,
                                    const ParamsOf<Model, F, C> &params, const Color<F, C> &a, const MaskOf<F> &lit,
                                    Sink &sink) {
    IntOf<F> kind = record_kind<F>(scene.emitters, v.light.emitter, lit);
    auto point = lit && mask<F>(kind == int32_t(EmitterKind::Point));
    if (!any(point)) return;
    using D = Dual<F, 3>;
    Vec3<D> x{D(v.wo_light.x * v.light_distance, 0), D(v.wo_light.y * v.light_distance, 1),
              D(v.wo_light.z * v.light_distance, 2)};
    D inverse_squared = D(F(1)) / squared_norm(x);
    Vec3<D> wo = x * sqrt(inverse_squared), wi{D(v.wi.x), D(v.wi.y), D(v.wi.z)};
    auto f = Model::template eval<C>(params, wi, wo, IntOf<F>(0));
    // light_weight = m / p / |x|^2 held the geometry that now moves
    F rest = v.light_weight * v.light_distance * v.light_distance;
    Frame<F> frame = make_frame(v.normal);
    IntOf<F> offset = record_field<F>(scene.emitters, PointEmitter::Position, v.light.emitter, point);
    Color<F, C> local[3];
    for (int c = 0; c < C; ++c) {
        D n = f[c] * inverse_squared;
        for (int i = 0; i < 3; ++i) local[i][c] = n.d[i] * a[c] * v.emitted[c] * rest;
    }
    F mirror = v.mirror;
    sink.number(scene, offset, local[0] * frame.s.x + local[1] * frame.t.x + local[2] * (frame.n.x * mirror), point);
    sink.number(scene, offset + 1, local[0] * frame.s.y + local[1] * frame.t.y + local[2] * (frame.n.y * mirror),
                point);
    sink.number(scene, offset + 2, local[0] * frame.s.z + local[1] * frame.t.z + local[2] * (frame.n.z * mirror),
                point);
}

// One scattering vertex. `next` is R_{k+1} (0 where the path ended), `a` is A_k; returns N_k + f_k / (p_k q_k) R_{k+1}.
template <class Model, int C, class F, class S, class Sink>
TR_INLINE Color<F, C> sweep_scattering(const SceneView<S> &scene, const VertexRecord<F, C> &v, const Color<F, C> &a,
                                       const Color<F, C> &next, const Wanted &wanted, const MaskOf<F> &active,
                                       Sink &sink) {
    auto params = load_params<Model, C>(scene, v.bsdf, v.at, active);
    Color<F, C> light_factor = v.emitted * v.light_weight;  // N = f_light * light_factor
    Color<F, C> path_factor = next * v.inverse_pdf;
    Color<F, C> f, f_light = uniform_color<C>(F(0));
    auto lit = active && mask<F>(v.light_weight > F(0));
    constexpr int N = ParamCount<Model>::All;
    bool done = false;
    if constexpr (N > 0) {
        if (wanted.bsdf) {
            done = true;
            auto seeded = seed_params<Model, C>(params);
            auto df = Model::template eval<C>(seeded, v.wi, v.wo, v.lobe);
            auto df_light = df;
            if constexpr (Model::Smooth) df_light = Model::template eval<C>(seeded, v.wi, v.wo_light, IntOf<F>(0));
            for (int c = 0; c < C; ++c) {
                f[c] = df[c].v;
                if constexpr (Model::Smooth) f_light[c] = df_light[c].v;
            }
            // both evaluations share the look-ups: one scatter for their sum
            for (int i = 0; i < N; ++i) {
                Color<F, C> g;
                for (int c = 0; c < C; ++c) {
                    g[c] = df[c].d[i] * path_factor[c];
                    if constexpr (Model::Smooth) g[c] = fmadd(df_light[c].d[i], light_factor[c], g[c]);
                    g[c] = g[c] * a[c];
                }
                IntOf<F> field = record_field<F>(scene.bsdfs, i, v.bsdf, active);
                if (Model::fields[i].kind == Kind::Float)
                    sink.number(scene, field, g, active);
                else
                    sink.texture(scene, field, v.at, g, active);
            }
        }
    }
    if (!done) {
        f = Model::template eval<C>(params, v.wi, v.wo, v.lobe);
        if constexpr (Model::Smooth) f_light = Model::template eval<C>(params, v.wi, v.wo_light, IntOf<F>(0));
    }
    if constexpr (Model::Smooth) {
        if (any(lit)) {
            if (wanted.emitter) sweep_emitter(scene, v.light, a * f_light * v.light_weight, lit, sink);
            if (wanted.position) sweep_light_position<Model, C>(scene, v, params, a, lit, sink);
        }
    }
    return f_light * light_factor + f * path_factor;
}

}  // namespace tr
