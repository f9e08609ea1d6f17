#include "stack.h"

#include "frame.h"

namespace tr {

namespace {

// A vector as three independent variables, from the i-th on.
template <class D, class F>
TR_INLINE Vec3<D> seeded(const Vec3<F> &v, int i) {
    return {D(v.x, i), D(v.y, i + 1), D(v.z, i + 2)};
}

}  // namespace

template <class F>
TR_LARGE StackAdjoint<F>::StackAdjoint(const SceneOf<F> &scene, const Wavelengths<F> &waves, const VertexRecord<F> &v,
                                       const GradientNeeds &needs, Transport transport, const MaskOf<F> &active) {
    const Frame<F> frame = model_frame(scene, v);
    wi = frame.to_world(v.wi), wo = frame.to_world(v.wo), wo_light = frame.to_world(v.wo_light);
    auto back = mask<F>(dot(v.base_normal, wi) < F(0));
    ShapeLanes<F> shape(scene.shapes, v.at.shape, active);
    Branches<F> *none = nullptr;
    bsdf = walk_stack(scene, waves, shape.bsdf, back, v.at, v.choice, needs.bsdfs, active, none);
    bsdf.base_normal = v.base_normal;
    factor = PerturbationFactor<F>(scene, bsdf, v.normal, active);
    const bool radiance = transport == Transport::Radiance;
    light_factor = factor(wo_light, radiance ? wo_light : wi);
    path_factor = factor(wo, radiance ? wo : wi);
}

template <class F>
TR_LARGE void StackAdjoint<F>::sweep_shadowing(const Vec3<F> &normal, Transport transport, const F &by_light,
                                               const F &by_path, Vec3<F> &light_bar, Vec3<F> &path_bar,
                                               Vec3<F> &wi_bar) {
    auto add = [&](const Vec3<F> &light, const F &weight, Vec3<F> &direction_bar) {
        using D = Dual<F, 9>;
        D r = NormalMap::shadowing(seeded<D>(factor.base, 0), seeded<D>(normal, 3), seeded<D>(light, 6),
                                   F(PerturbationFactor<F>::Least));
        F scale = select(factor.shadowed, weight / r.v, F(0));
        base_bar = base_bar + Vec3<F>{r.d[0], r.d[1], r.d[2]} * scale;
        n_bar = n_bar + Vec3<F>{r.d[3], r.d[4], r.d[5]} * scale;
        direction_bar = direction_bar + Vec3<F>{r.d[6], r.d[7], r.d[8]} * scale;
    };
    if (transport == Transport::Radiance) {
        add(wo_light, by_light, light_bar);
        add(wo, by_path, path_bar);
    } else {
        add(wi, by_light + by_path, wi_bar);
    }
}

// `g`: the adjoint of the product of the weights times that product.
template <class F>
TR_LARGE void StackAdjoint<F>::sweep_weights(const SceneOf<F> &scene, const VertexRecord<F> &v, const Spectrum<F> &g,
                                             const GradientNeeds &needs, const MaskOf<F> &active, HitAdjoint<F> &hit,
                                             GradientSink<F> &sink) {
    Branches<F> all;
    ShapeLanes<F> shape(scene.shapes, v.at.shape, active);
    auto back = mask<F>(dot(v.base_normal, wi) < F(0));
    walk_stack(scene, sink.waves, shape.bsdf, back, v.at, v.choice, needs.bsdfs, active, &all);
    for (int i = 0; i < all.n; ++i) {
        F others(1);
        for (int j = 0; j < all.n; ++j)
            if (j != i) others = others * select(all.lanes[j], all.weight[j], F(1));
        Spectrum<F> g_i = g * (others * select(all.second[i], F(1), F(-1)));
        auto there = unclamped_weight(scene, sink.waves, all.texture[i], v.at, all.lanes[i]);
        if (!any(there)) continue;
        if (needs.bsdf) sink.scalar_texture(scene, all.texture[i], v.at, g_i, there);
        if (needs.geometry) sweep_lookup(scene, all.texture[i], v.at, luminance_adjoint(g_i), there, hit.at, sink);
    }
}

// The normal of `hit`, so far the perturbed one, handed on to the texture, to the shading normal and to the tangents.
template <class F>
TR_LARGE void StackAdjoint<F>::sweep_perturbed_normal(const SceneOf<F> &scene, const VertexRecord<F> &v,
                                                      const GradientNeeds &needs, HitAdjoint<F> &hit,
                                                      GradientSink<F> &sink) {
    const IntOf<F> &record = bsdf.stack.perturbed;
    NormalPerturbation<F> turn(scene, sink.waves, v.at, record, factor.perturbed);
    const Vec3<F> normal_bar = hit.n, z = factor.base;
    F side = select(bsdf.stack.mirrored, F(-1), F(1));
    // whether it was reversed shows in where it points
    auto reversed = mask<F>(dot(turn(z, side, F(-1)), v.normal) > dot(turn(z, side, F(1)), v.normal));
    F sign = select(reversed, F(-1), F(1));
    IntOf<F> texture = record_field<F>(scene.bsdfs, NormalMap::Map, record, factor.perturbed);
    if (any(turn.mapped)) {
        using D = Dual<F, 9>;
        Vec3<D> n = NormalMap::turn(seeded<D>(z, 0), side, seeded<D>(turn.tangents.u, 3), seeded<D>(turn.map, 6), sign);
        auto bar = [&](int i) { return n.x.d[i] * normal_bar.x + n.y.d[i] * normal_bar.y + n.z.d[i] * normal_bar.z; };
        hit.n = select(turn.mapped, Vec3<F>{bar(0), bar(1), bar(2)} * side, hit.n);
        hit.tangent = select(turn.mapped, hit.tangent + Vec3<F>{bar(3), bar(4), bar(5)}, hit.tangent);
        Vec3<F> g{bar(6), bar(7), bar(8)};
        if (needs.bsdf) sink.vector_texture(scene, texture, v.at, g, turn.mapped);
        sweep_lookup(scene, texture, v.at, Spectrum<F>{{g.x, g.y, g.z}}, turn.mapped, hit.at, sink);
    }
    if (any(turn.bumped)) {
        using D = Dual<F, 11>;
        D u(turn.slopes.x * turn.scale, 9), w(turn.slopes.y * turn.scale, 10);
        Vec3<D> n = BumpMap::turn(seeded<D>(z, 0), side, seeded<D>(turn.tangents.u, 3), seeded<D>(turn.tangents.v, 6),
                                  u, w, sign);
        auto bar = [&](int i) { return n.x.d[i] * normal_bar.x + n.y.d[i] * normal_bar.y + n.z.d[i] * normal_bar.z; };
        hit.n = select(turn.bumped, Vec3<F>{bar(0), bar(1), bar(2)} * side, hit.n);
        hit.tangent = select(turn.bumped, hit.tangent + Vec3<F>{bar(3), bar(4), bar(5)}, hit.tangent);
        hit.tangent_v = select(turn.bumped, Vec3<F>{bar(6), bar(7), bar(8)}, hit.tangent_v);
        Vec2<F> g{bar(9) * turn.scale, bar(10) * turn.scale};
        sink.scalar(record_field<F>(scene.bsdfs, BumpMap::Scale, record, turn.bumped),
                    bar(9) * turn.slopes.x + bar(10) * turn.slopes.y, turn.bumped);
        sweep_slopes(scene, texture, v.at, g, needs.bsdf, true, turn.bumped, hit.at, sink);
    }
}

template <class F>
TR_LARGE void StackAdjoint<F>::finish(const SceneOf<F> &scene, const VertexRecord<F> &v, const Spectrum<F> &whole,
                                      const GradientNeeds &needs, const MaskOf<F> &active, HitAdjoint<F> &hit,
                                      GradientSink<F> &sink) {
    if (needs.bsdf || needs.geometry) sweep_weights(scene, v, whole, needs, active, hit, sink);
    if (needs.geometry && any(factor.perturbed)) {
        F side = select(bsdf.stack.mirrored, F(-1), F(1));
        hit.n = hit.n + n_bar;
        sweep_perturbed_normal(scene, v, needs, hit, sink);
        hit.n = hit.n + base_bar * side;
    }
}

#define TR_INSTANTIATE(F, S) template struct StackAdjoint<F>;
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
