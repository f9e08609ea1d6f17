// The derivative of a path, one vertex at a time, from its end to its beginning.
//
// With the suffix radiance  R_k = E_k + N_k + f_k / (p_k q_k) R_{k+1}  and the pixel's adjoint delta, A_k = delta
// beta_k:
//     dL = sum_k  A_k ( dE_k + dN_k + df_k / (p_k q_k) R_{k+1} ).
// Sampling densities, MIS weights, roulette and visibility are constants of the derivative (detached sampling: Zeltner,
// Speierer, Georgiev and Jakob, "Monte Carlo Estimators for Differential Light Transport", SIGGRAPH 2021). Nothing is
// traced again and nothing is divided by f: where f = 0 its derivative is as good as anywhere.
//
// What moves (surface.h): the point that a smooth BSDF's ray has hit, or that was sampled on a light, is glued to its
// surface. With D = x_{k+1} - x_k the integrand is a function of both ends, through the direction w = D / |D| and, area
// being the measure, through J = |N_{k+1}.D| / |D|^3 relative to its current value (the material form of Zhang, Miller,
// Yan, Gkioulekas and Zhao, "Path-Space Differentiable Rendering", SIGGRAPH 2020). Camera rays and those that leave a
// delta lobe are functions of the camera, of the interface and of its index: what they hit slides, and the derivative
// of the ray is handed on from vertex to vertex (RayAdjoint) until a smooth BSDF ends the chain.
#pragma once

#include "../integrator/medium.h"
#include "layers.h"
#include "pointlight.h"

namespace tr {

// What a vertex gets from the next one: R_{k+1}, the adjoint of the ray to it (behind a smooth BSDF that of x_k only);
// and where a point is glued there, D / r^2 and the point (D = 0: there is none).
template <class F, int C>
struct NextVertex {
    Color<F, C> radiance;
    RayAdjoint<F> ray;
    Vec3<F> segment, p;
    SurfacePoint<F> at;
};

// Adjoint of D from that of its direction, with u = D / r^2.
template <class F>
TR_INLINE Vec3<F> direction_adjoint(const Vec3<F> &u, const Vec3<F> &w_bar) {
    F inverse_squared = squared_norm(u);
    F inverse_r = sqrt(inverse_squared);
    Vec3<F> w = u * (F(1) / select(mask<F>(inverse_squared > F(0)), inverse_r, F(1)));
    return unnormalize(w, w_bar, inverse_r);
}

// Derivative of what an emitter sends, at one of its points. `at` and `d_bar` receive the adjoints of the point and of
// the direction d to it (not looked at unless something moves), where its radiance varies with them.
template <class F, int C, class S, class Sink>
TR_INLINE void sweep_emitter(const SceneView<S> &scene, const EmitterPoint<F> &point, const Vec3<F> &d,
                             const Color<F, C> &g, const Wanted &wanted, const MaskOf<F> &active,
                             CoordinateAdjoint<F> &at, Vec3<F> &d_bar, Sink &sink) {
    IntOf<F> kind = record_kind<F>(scene.emitters, point.emitter, active);
    auto area = active && mask<F>(kind == int32_t(EmitterKind::Area));
    if (any(area)) {
        IntOf<F> texture = record_field<F>(scene.emitters, AreaEmitter::Radiance, point.emitter, area);
        if (wanted.emitter) sink.texture(scene, texture, point.at, g, area);
        if (wanted.geometry) sweep_lookup<C>(scene, texture, point.at, g, area, at, sink);
    }
    auto flat = active &&
                (mask<F>(kind == int32_t(EmitterKind::Constant)) || mask<F>(kind == int32_t(EmitterKind::Directional)));
    if (any(flat) && wanted.emitter)
        sink.color(scene, record_field<F>(scene.emitters, 0, point.emitter, flat), g, flat);
    for_each_point_light<F>(kind, active, [&](auto model, const MaskOf<F> &lanes) {
        sweep_point_light<decltype(model), C>(scene, point, d, g, wanted.emitter, wanted.geometry, lanes, d_bar, sink);
    });
    auto map = active && mask<F>(kind == int32_t(EmitterKind::EnvironmentMap));
    if (any(map)) {
        const Record &record = scene.emitters[scene.environment];
        int32_t slot = record.field[EnvironmentMap::Data];
        const TensorView<S> &tensor = scene.values.tensors[slot];
        F scale(scene.values.constants[record.field[EnvironmentMap::Scale]]);
        Vec2<F> uv{point.at.b1, point.at.b2};
        if (wanted.emitter) {
            auto footprint = EnvironmentMap::footprint(tensor, uv);
            sink.footprint(scene, slot, footprint, g * scale, map);
            sink.number(scene, IntOf<F>(record.field[EnvironmentMap::Scale]),
                        g * gather_footprint<C>(tensor, footprint, map), map);
        }
        if (wanted.geometry) sweep_environment_lookup<C>(scene, uv, d, g, map, d_bar, sink);
    }
}

// The local frame of a vertex, and the adjoint of its normal when directions are taken to it and from it: when the
// normal moves by dn, the frame turns with it, ds = -(s.dn) n, dt = -(t.dn) n. How it turns about n besides, by dphi,
// ds = dphi t, dt = -dphi s, matters where the model is Oriented: as s = a / |a|, a = u - (n.u) n, u being dp/du,
// dphi = t.ds = t.(du - (n.u) dn) / |a|.
template <class F, bool Oriented = false>
struct VertexFrame {
    Frame<F> frame;
    Vec3<F> n_bar{F(0), F(0), F(0)};
    F phi_bar{0};

    TR_INLINE VertexFrame(const Frame<F> &of, const F &mirror) : frame(of) { frame.n = of.n * mirror; }
    // the adjoint of a world direction from that of its local coordinates
    TR_INLINE Vec3<F> into(const Vec3<F> &local, const Vec3<F> &local_bar) {
        n_bar = n_bar + frame.to_world(local) * local_bar.z - frame.s * (local_bar.x * local.z) -
                frame.t * (local_bar.y * local.z);
        if constexpr (Oriented) phi_bar = phi_bar + (local_bar.x * local.y - local_bar.y * local.x);
        return frame.to_world(local_bar);
    }
    // the adjoint of local coordinates from that of the world direction they give
    TR_INLINE Vec3<F> out_of(const Vec3<F> &local, const Vec3<F> &world_bar) {
        static_assert(!Oriented, "delta lobes are the same in all directions");
        F along = dot(frame.n, world_bar);
        n_bar = n_bar + world_bar * local.z - frame.s * (local.x * along) - frame.t * (local.y * along);
        return frame.to_local(world_bar);
    }
    // What the surface gets of all that.
    template <int C, class S>
    TR_INLINE void hand_to(HitAdjoint<F> &hit, const SceneView<S> &scene, const VertexRecord<F, C> &v,
                           const MaskOf<F> &active) const {
        hit.n = hit.n + n_bar * v.mirror;
        if constexpr (Oriented) {
            if (!scene.oriented) return;
            TangentPart<F> part(v.normal, surface_tangent(scene, v.at, active));
            Vec3<F> u_bar = frame.t * (phi_bar * part.inverse);
            hit.tangent = hit.tangent + u_bar;
            hit.n = hit.n - u_bar * part.up;
        }
    }
};
template <class Model, class F>
using FrameOf = VertexFrame<F, IsOriented<Model>::value>;

// Adjoints of both directions of eval, whose value has the weight `weight`.
template <Transport transport, class Model, int C, class F>
TR_INLINE void sweep_directions(const ParamsOf<Model, F, C> &params, const Vec3<F> &wi, const Vec3<F> &wo,
                                const IntOf<F> &lobe, const Color<F, C> &weight, Vec3<F> &wi_bar, Vec3<F> &wo_bar) {
    constexpr int N = Model::Smooth ? 6 : 3;  // delta lobes do not ask for wo
    using D = Dual<F, N>;
    Vec3<D> from{D(wi.x, 0), D(wi.y, 1), D(wi.z, 2)}, to{D(wo.x), D(wo.y), D(wo.z)};
    if constexpr (Model::Smooth) to = {D(wo.x, 3), D(wo.y, 4), D(wo.z, 5)};
    Color<D, C> f = eval_bsdf<transport, Model, C>(params, from, to, lobe);
    F sum[6] = {F(0), F(0), F(0), F(0), F(0), F(0)};
    for (int i = 0; i < N; ++i) {
        sum[i] = f[0].d[i] * weight[0];
        for (int c = 1; c < C; ++c) sum[i] = fmadd(f[c].d[i], weight[c], sum[i]);
    }
    wi_bar = wi_bar + Vec3<F>{sum[0], sum[1], sum[2]};
    wo_bar = {sum[3], sum[4], sum[5]};
}

// The value of a BSDF with its derivatives in a block of its parameters.
template <Transport transport, class Model, int C, class F, class D>
TR_NOINLINE void eval_large_block(const ParamsOf<Model, F, C> &params, int first, const Vec3<F> &wi, const Vec3<F> &wo,
                                  const IntOf<F> &lobe, Color<D, C> &r) {
    r = eval_inline<transport, Model, C>(seed_params<Model, C>(params, first), wi, wo, lobe);
}
template <Transport transport, class Model, int C, class F, class D>
TR_INLINE void eval_block(const ParamsOf<Model, F, C> &params, int first, const Vec3<F> &wi, const Vec3<F> &wo,
                          const IntOf<F> &lobe, Color<D, C> &r) {
    if constexpr (IsLarge<Model>)
        eval_large_block<transport, Model, C>(params, first, wi, wo, lobe, r);
    else
        r = eval_inline<transport, Model, C>(seed_params<Model, C>(params), wi, wo, lobe);
}

// What moves on along the path; `a_path` is A_k times the factors of f in the rest of it. Adds to `hit` and to the
// adjoint of the local wi.
template <Transport transport, class Model, int C, class F, class S, class Sink>
TR_INLINE void sweep_continuation(const SceneView<S> &scene, const VertexRecord<F, C> &v,
                                  const ParamsOf<Model, F, C> &params, const Color<F, C> &a_path,
                                  const NextVertex<F, C> &next, const MaskOf<F> &active, FrameOf<Model, F> &frame,
                                  Vec3<F> &wi_bar, HitAdjoint<F> &hit, Sink &sink) {
    Vec3<F> wo_bar;
    sweep_directions<transport, Model, C>(params, v.wi, v.wo, v.lobe, a_path, wi_bar, wo_bar);
    hit.p = hit.p + next.ray.o;
    if constexpr (Model::Smooth) {
        // (behind a delta lobe of a model that has both, `segment` is 0)
        Vec3<F> w_bar = frame.into(v.wo, wo_bar) + next.ray.d;
        Vec3<F> D_bar = direction_adjoint(next.segment, w_bar);
        hit.p = hit.p - D_bar;
        auto glued = active && mask<F>(squared_norm(next.segment) > F(0));
        if (any(glued)) sweep_position(scene, next.at, next.p, D_bar, glued, sink);
    }
    if constexpr (Model::Delta) {
        static_assert(ParamCount<Model>::Scalars == 0, "a delta lobe is turned by numbers, not by textures");
        Vec3<F> turned = next.ray.d;
        if constexpr (Model::Smooth) turned = select(mask<F>(v.lobe == 0), Vec3<F>{F(0), F(0), F(0)}, turned);
        using E = Dual<F, 3 + ParamCount<Model>::Numbers>;
        Params<E, C, 0, ParamCount<Model>::Numbers> numbers;
        for (int i = 0; i < ParamCount<Model>::Numbers; ++i) numbers.number[i] = E(params.number[i], 3 + i);
        Vec3<E> from{E(v.wi.x, 0), E(v.wi.y, 1), E(v.wi.z, 2)};
        Vec3<E> to = Model::direction(numbers, from, v.lobe);
        Vec3<F> to_bar = frame.out_of(v.wo, turned);
        auto chain = [&](int i) { return to.x.d[i] * to_bar.x + to.y.d[i] * to_bar.y + to.z.d[i] * to_bar.z; };
        wi_bar = wi_bar + Vec3<F>{chain(0), chain(1), chain(2)};
        int number = 0;
        for (int i = 0; i < ParamCount<Model>::All; ++i)
            if (ParamCount<Model>::is_number(i))
                sink.scalar(record_field<F>(scene.bsdfs, i, v.bsdf, active), chain(3 + number++), active);
    }
}

// Everything that moves at a scattering vertex. Adds to `hit` and returns the adjoint of the direction of the ray that
// arrived. `a_light`, `a_path` are A_k times the factors of f in N_k and in the rest of the path.
template <class Model, int C, class F, class S, class Sink>
TR_NOINLINE Vec3<F> sweep_motion(const SceneView<S> &scene, const VertexRecord<F, C> &v,
                                 const ParamsOf<Model, F, C> &params, const Color<F, C> &a_light,
                                 const Color<F, C> &a_path, const Color<F, C> &f_light, const NextVertex<F, C> &next,
                                 const MaskOf<F> &active, const MaskOf<F> &lit, const Vec3<F> &light_d_bar,
                                 const CoordinateAdjoint<F> &light_at, const Wanted &wanted, HitAdjoint<F> &hit,
                                 Sink &sink) {
    FrameOf<Model, F> frame(vertex_frame(scene, v), v.mirror);
    Vec3<F> zero{F(0), F(0), F(0)}, wi_bar = zero;
    sweep_continuation<Transport::Radiance, Model, C>(scene, v, params, a_path, next, active, frame, wi_bar, hit, sink);

    // to the light
    if constexpr (Model::Smooth) {
        if (any(lit)) {
            Vec3<F> wo_bar;
            sweep_directions<Transport::Radiance, Model, C>(params, v.wi, v.wo_light, IntOf<F>(0), a_light, wi_bar,
                                                            wo_bar);
            Vec3<F> w_bar = frame.into(v.wo_light, wo_bar) + light_d_bar;
            Vec3<F> w = frame.frame.to_world(v.wo_light);
            IntOf<F> kind = record_kind<F>(scene.emitters, v.light.emitter, lit);
            auto near = lit && mask<F>(v.light_distance < F(S(1e30)));
            F distance = select(near, v.light_distance, F(1)), weight = channel_sum(a_light * f_light);
            Vec3<F> x_bar = zero;
            auto area = near && mask<F>(kind == int32_t(EmitterKind::Area));
            if (any(area) && wanted.geometry) {
                HitAdjoint<F> on_light;
                on_light.at = light_at;
                Arrival<F> in{MaskOf<F>(false), w, distance, w * distance, w_bar, weight};
                x_bar = sweep_surface(scene, v.light.at, v.p + in.D, in, on_light, area, sink).o;
            }
            for_each_point_light<F>(kind, near, [&](auto model, const MaskOf<F> &lanes) {
                F inverse = F(1) / distance;
                Vec3<F> D_bar = unnormalize(w, w_bar, inverse) - w * (F(2) * weight * inverse);  // of 1 / r^2
                x_bar = select(lanes, -D_bar, x_bar);
                sweep_light_place<decltype(model)>(scene, v.light.emitter, D_bar, lanes, sink);
            });
            auto parallel = lit && mask<F>(kind == int32_t(EmitterKind::Directional));
            if (any(parallel)) sweep_light_axis(scene, v.light.emitter, -w_bar, parallel, sink);
            hit.p = hit.p + x_bar;
        }
    }
    Vec3<F> from_bar = frame.into(v.wi, wi_bar);
    frame.hand_to(hit, scene, v, active);
    return -from_bar;
}

// Adjoints of the parameters of a BSDF, which has the values f towards the next vertex and f_light towards the light;
// `path_factor` and `light_factor` are what they are multiplied with.
template <Transport transport, class Model, int C, class F, class S, class Sink>
TR_INLINE void sweep_parameters(const SceneView<S> &scene, const VertexRecord<F, C> &v,
                                const ParamsOf<Model, F, C> &params, const Color<F, C> &a,
                                const Color<F, C> &light_factor, const Color<F, C> &path_factor, const Wanted &wanted,
                                const MaskOf<F> &active, HitAdjoint<F> &hit, Color<F, C> &f, Color<F, C> &f_light,
                                Sink &sink) {
    f_light = uniform_color<C>(F(0));
    using Count = ParamCount<Model>;
    constexpr int N = Count::Variables;
    bool done = false;
    if constexpr (N > 0) {
        if (wanted.bsdf || (wanted.geometry && wanted.lookups)) {
            done = true;
            constexpr int Block = Count::Block;
            Color<Dual<F, Block>, C> df, df_light;
            for (int first = 0; first < N; first += Block) {
                eval_block<transport, Model, C>(params, first, v.wi, v.wo, v.lobe, df);
                if constexpr (Model::Smooth)
                    eval_block<transport, Model, C>(params, first, v.wi, v.wo_light, IntOf<F>(0), df_light);
                for (int c = 0; c < C; ++c) {
                    f[c] = df[c].v;
                    if constexpr (Model::Smooth) f_light[c] = df_light[c].v;
                }
                // both evaluations share the look-ups: one scatter for their sum
                for (int i = first; i < N && i < first + Block; ++i) {
                    Color<F, C> g;
                    for (int c = 0; c < C; ++c) {
                        g[c] = df[c].d[i - first] * path_factor[c];
                        if constexpr (Model::Smooth) g[c] = fmadd(df_light[c].d[i - first], light_factor[c], g[c]);
                        g[c] = g[c] * a[c];
                    }
                    bool luminance = i >= Count::Fields;
                    IntOf<F> field =
                        record_field<F>(scene.bsdfs, luminance ? LuminanceField<Model>::value : i, v.bsdf, active);
                    if (luminance || Count::is_scalar(i)) {
                        if (wanted.bsdf) sink.scalar_texture(scene, field, v.at, g, active);
                        if (wanted.geometry)
                            sweep_lookup<C>(scene, field, v.at, luminance_adjoint(g), active, hit.at, sink);
                    } else if (Count::is_number(i)) {
                        sink.number(scene, field, g, active);
                    } else {
                        if (wanted.bsdf) sink.texture(scene, field, v.at, g, active);
                        if (wanted.geometry) sweep_lookup<C>(scene, field, v.at, g, active, hit.at, sink);
                    }
                }
            }
        }
    }
    if (!done) {
        f = eval_bsdf<transport, Model, C>(params, v.wi, v.wo, v.lobe);
        if constexpr (Model::Smooth) f_light = eval_bsdf<transport, Model, C>(params, v.wi, v.wo_light, IntOf<F>(0));
    }
}

// One scattering vertex; `a` is A_k. Returns N_k + f_k / (p_k q_k) R_{k+1}; adds the adjoints of the hit and of the
// arriving ray's direction.
template <class Model, int C, class F, class S, class Sink>
TR_INLINE Color<F, C> sweep_scattering(const SceneView<S> &scene, const VertexRecord<F, C> &v, Color<F, C> a,
                                       NextVertex<F, C> next, const Wanted &wanted, const MaskOf<F> &active,
                                       HitAdjoint<F> &hit, Vec3<F> &d_bar, Sink &sink) {
    auto params = load_params<Model, C>(scene, v.bsdf, v.at, active);
    Color<F, C> light_factor = v.emitted * v.through * v.light_weight;  // N = f_light * light_factor
    Color<F, C> path_factor = next.radiance * v.inverse_pdf;
    Color<F, C> f, f_light;
    auto lit = active && mask<F>(v.light_weight > F(0));
    Color<F, C> whole = a;  // above the layers
    LayerSweep<F> layers;
    if (scene.layered) {
        layers = begin_layers<C>(scene, v, wanted, Transport::Radiance, active);
        a = a * layers.leaf.layers.weight;
        light_factor = light_factor * layers.light_factor;
        path_factor = path_factor * layers.path_factor;
    }
    sweep_parameters<Transport::Radiance, Model, C>(scene, v, params, a, light_factor, path_factor, wanted, active, hit,
                                                    f, f_light, sink);
    CoordinateAdjoint<F> light_at;
    Vec3<F> light_d_bar{F(0), F(0), F(0)};
    if constexpr (Model::Smooth) {
        if (any(lit) && (wanted.emitter || wanted.geometry)) {
            Vec3<F> d{F(0), F(0), F(1)};
            if (wanted.geometry) d = VertexFrame<F>(vertex_frame(scene, v), v.mirror).frame.to_world(v.wo_light);
            Color<F, C> g = a * f_light * v.through * v.light_weight;
            if (scene.layered) g = g * layers.light_factor;
            sweep_emitter(scene, v.light, d, g, wanted, lit, light_at, light_d_bar, sink);
        }
    }
    Color<F, C> total = f_light * light_factor + f * path_factor;
    if (scene.layered && any(layers.factor.shadowed) && wanted.numbers())
        layers.sweep_shadowing(v.normal, Transport::Radiance, channel_sum(a * f_light * light_factor),
                               channel_sum(a * f * path_factor), light_d_bar, next.ray.d, d_bar);
    if (wanted.numbers())
        d_bar = d_bar + sweep_motion<Model, C>(scene, v, params, a * light_factor, a * path_factor, f_light, next,
                                               active, lit, light_d_bar, light_at, wanted, hit, sink);
    if (scene.layered) {
        finish_layers<C>(scene, v, layers, whole * total, wanted, active, hit, sink);
        total = total * layers.leaf.layers.weight;
    }
    return total;
}

}  // namespace tr
