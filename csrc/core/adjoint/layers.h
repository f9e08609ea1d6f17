// The derivative of the layers above a leaf: of the weights of branches, of the factor near the terminator, and of a
// turned normal. With branch weights w_j and what the leaf brings, X, the vertex brings w_1 w_2 ... X.
#pragma once

#include "slopes.h"
#include "vertex.h"

namespace tr {

// A vector as three independent variables, from the i-th on.
template <class D, class F>
TR_INLINE Vec3<D> seeded(const Vec3<F> &v, int i) {
    return {D(v.x, i), D(v.y, i + 1), D(v.z, i + 2)};
}

// The vertex with its layers found again.
template <class F>
struct LayerSweep {
    Leaf<F> leaf;
    TurnedFactor<F> factor;
    Vec3<F> wi, wo, wo_light;                             // in the world
    F light_factor, path_factor;                          // of TurnedFactor
    Vec3<F> base_bar{F(0), F(0), F(0)}, n_bar{base_bar};  // what the shadowing function adds

    // Adds, for contributions of these sizes, the derivative of their factor: to the adjoint of the direction that
    // light comes from, and to those of the normals.
    TR_NOINLINE void sweep_shadowing(const Vec3<F> &normal, Transport transport, const F &by_light, const F &by_path,
                                     Vec3<F> &light_bar, Vec3<F> &path_bar, Vec3<F> &wi_bar) {
        auto add = [&](const Vec3<F> &light, const F &weight, Vec3<F> &direction_bar) {
            using D = Dual<F, 9>;
            D r = NormalMap::shadowing(seeded<D>(factor.base, 0), seeded<D>(normal, 3), seeded<D>(light, 6),
                                       F(TurnedFactor<F>::Least));
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
};

template <int C, class F, class S>
TR_NOINLINE LayerSweep<F> begin_layers(const SceneView<S> &scene, const VertexRecord<F, C> &v, const Wanted &wanted,
                                       Transport transport, const MaskOf<F> &active) {
    Frame<F> frame = vertex_frame(scene, v);
    frame.n = v.normal * v.mirror;
    Vec3<F> wi = frame.to_world(v.wi), wo = frame.to_world(v.wo), wo_light = frame.to_world(v.wo_light);
    auto back = mask<F>(dot(v.base, wi) < F(0));
    ShapeLanes<F> shape(scene.shapes, v.at.shape, active);
    auto nothing = [](const IntOf<F> &, const MaskOf<F> &, const F &, const MaskOf<F> &) {};
    Leaf<F> leaf = walk_layers<C>(scene, shape.bsdf, back, v.at, v.choice, wanted.bsdfs, active, nothing);
    leaf.base = v.base;
    TurnedFactor<F> factor(scene, leaf, v.normal, active);
    LayerSweep<F> r{leaf, factor, wi, wo, wo_light, F(1), F(1)};
    const bool radiance = transport == Transport::Radiance;
    r.light_factor = factor(wo_light, radiance ? wo_light : wi);
    r.path_factor = factor(wo, radiance ? wo : wi);
    return r;
}

// The branches of a vertex: their textures, weights and on which side of the choice they are.
template <class F>
struct Branches {
    int n = 0;
    IntOf<F> texture[MaxLayers];
    F weight[MaxLayers], sign[MaxLayers];
    MaskOf<F> there[MaxLayers];
};

// Adjoints of the weights; `g` is that of their product, times it, by channel.
template <int C, class F, class S, class Sink>
TR_INLINE void sweep_weights(const SceneView<S> &scene, const VertexRecord<F, C> &v, const LayerSweep<F> &layers,
                             const Color<F, C> &g, const Wanted &wanted, const MaskOf<F> &active, HitAdjoint<F> &hit,
                             Sink &sink) {
    Branches<F> all;
    ShapeLanes<F> shape(scene.shapes, v.at.shape, active);
    auto back = mask<F>(dot(v.base, layers.wi) < F(0));
    walk_layers<C>(scene, shape.bsdf, back, v.at, v.choice, wanted.bsdfs, active,
                   [&](const IntOf<F> &texture, const MaskOf<F> &second, const F &weight, const MaskOf<F> &lanes) {
                       all.texture[all.n] = texture;
                       all.weight[all.n] = select(lanes, weight, F(1));
                       all.sign[all.n] = select(second, F(1), F(-1));
                       all.there[all.n++] = lanes;
                   });
    for (int i = 0; i < all.n; ++i) {
        F others(1);
        for (int j = 0; j < all.n; ++j)
            if (j != i) others = others * all.weight[j];
        Color<F, C> g_i = g * (others * all.sign[i]);
        auto there = unclamped_weight<C>(scene, all.texture[i], v.at, all.there[i]);
        if (!any(there)) continue;
        if (wanted.bsdf) sink.scalar_texture(scene, all.texture[i], v.at, g_i, there);
        if (wanted.geometry) sweep_lookup<C>(scene, all.texture[i], v.at, luminance_adjoint(g_i), there, hit.at, sink);
    }
}

// The normal of `hit`, so far the turned one, handed on to the texture, to the shading normal and to the tangents.
template <int C, class F, class S, class Sink>
TR_INLINE void sweep_turned_normal(const SceneView<S> &scene, const VertexRecord<F, C> &v, const LayerSweep<F> &layers,
                                   const Wanted &wanted, HitAdjoint<F> &hit, Sink &sink) {
    const IntOf<F> &record = layers.leaf.layers.turned;
    NormalTurn<F> turn(scene, v.at, record, layers.factor.turned);
    const Vec3<F> n_bar = hit.n, z = layers.factor.base;
    F side = select(layers.leaf.layers.mirrored, F(-1), F(1));
    // whether it was reversed shows in where it points
    auto reversed = mask<F>(dot(turn(z, side, F(-1)), v.normal) > dot(turn(z, side, F(1)), v.normal));
    F sign = select(reversed, F(-1), F(1));
    IntOf<F> texture = record_field<F>(scene.bsdfs, NormalMap::Map, record, layers.factor.turned);
    if (any(turn.mapped)) {
        using D = Dual<F, 9>;
        Vec3<D> n = NormalMap::turn(seeded<D>(z, 0), side, seeded<D>(turn.tangents.u, 3), seeded<D>(turn.map, 6), sign);
        auto bar = [&](int i) { return n.x.d[i] * n_bar.x + n.y.d[i] * n_bar.y + n.z.d[i] * n_bar.z; };
        hit.n = select(turn.mapped, Vec3<F>{bar(0), bar(1), bar(2)} * side, hit.n);
        hit.tangent = select(turn.mapped, hit.tangent + Vec3<F>{bar(3), bar(4), bar(5)}, hit.tangent);
        Color<F, 3> g{{bar(6), bar(7), bar(8)}};
        if (wanted.bsdf) sink.vector_texture(scene, texture, v.at, g, turn.mapped);
        sweep_lookup<3>(scene, texture, v.at, g, turn.mapped, hit.at, sink);
    }
    if (any(turn.bumped)) {
        using D = Dual<F, 11>;
        D u(turn.slopes.x * turn.scale, 9), w(turn.slopes.y * turn.scale, 10);
        Vec3<D> n = BumpMap::turn(seeded<D>(z, 0), side, seeded<D>(turn.tangents.u, 3), seeded<D>(turn.tangents.v, 6),
                                  u, w, sign);
        auto bar = [&](int i) { return n.x.d[i] * n_bar.x + n.y.d[i] * n_bar.y + n.z.d[i] * n_bar.z; };
        hit.n = select(turn.bumped, Vec3<F>{bar(0), bar(1), bar(2)} * side, hit.n);
        hit.tangent = select(turn.bumped, hit.tangent + Vec3<F>{bar(3), bar(4), bar(5)}, hit.tangent);
        hit.tangent_v = select(turn.bumped, Vec3<F>{bar(6), bar(7), bar(8)}, hit.tangent_v);
        Vec2<F> g{bar(9) * turn.scale, bar(10) * turn.scale};
        sink.scalar(record_field<F>(scene.bsdfs, BumpMap::Scale, record, turn.bumped),
                    bar(9) * turn.slopes.x + bar(10) * turn.slopes.y, turn.bumped);
        sweep_slopes<3>(scene, texture, v.at, g, wanted.bsdf, true, turn.bumped, hit.at, sink);
    }
}

// `whole`: what the leaf brings, times the adjoint of the vertex above its layers.
template <int C, class F, class S, class Sink>
TR_NOINLINE void finish_layers(const SceneView<S> &scene, const VertexRecord<F, C> &v, const LayerSweep<F> &layers,
                               const Color<F, C> &whole, const Wanted &wanted, const MaskOf<F> &active,
                               HitAdjoint<F> &hit, Sink &sink) {
    if (wanted.bsdf || wanted.geometry) sweep_weights(scene, v, layers, whole, wanted, active, hit, sink);
    if (wanted.geometry && any(layers.factor.turned)) {
        F side = select(layers.leaf.layers.mirrored, F(-1), F(1));
        hit.n = hit.n + layers.n_bar;
        sweep_turned_normal(scene, v, layers, wanted, hit, sink);
        hit.n = hit.n + layers.base_bar * side;
    }
}

}  // namespace tr
