// What of a tree of BSDFs a hit is scattered by. `twosided` goes by the side that is met; `blendbsdf` and `mask` by
// chance, with the last number of the scattering's block; `normalmap` and `bumpmap` turn the frame; the leaf they end
// at scatters. That a branch is taken with a probability q and has a weight w multiplies what comes of it by w / q: the
// image is that of the mixture, every model may be in it, and one at a time is evaluated.
//
// While rendering q = w. For a derivative in w both branches need a chance even where w is 0 or 1: with a branch's
// radiance R_i the mixture changes by dw (R_1 - R_0).
#pragma once

#include "../registry.h"
#include "../shape/partials.h"
#include "../texture/slopes.h"

namespace tr {

// What the layers above a leaf make of it.
template <class F>
struct Layers {
    F weight{1};                // the product of the weights of the branches
    F inverse_probability{1};   // of taking them
    MaskOf<F> opening{false};   // the hole of a mask, with the record of that
    MaskOf<F> wanted{false};    // a weight on the way is differentiated
    IntOf<F> turned{-1};        // the record of a normal map
    MaskOf<F> mirrored{false};  // the side of `base` that it turns
};

// The BSDF of a hit: the leaf's record, and whether directions are mirrored. `choice` and `base` are what the layers
// were found from, the normal before it was turned being `base`; both mean something in layered scenes alone.
template <class F>
struct Leaf {
    IntOf<F> bsdf;
    MaskOf<F> mirrored;
    Layers<F> layers;
    F choice{0};
    Vec3<F> base;
};

template <class F>
TR_INLINE void resolve_side(const RecordLanes<F> &record, const MaskOf<F> &back, const MaskOf<F> &active,
                            Leaf<F> &leaf) {
    using I = IntOf<F>;
    auto two = active && mask<F>(record.kind() == TwoSidedKind);
    if (!any(two)) return;
    I front = record.field(TwoSided::Front), behind = record.field(TwoSided::Back);
    behind = select(mask<I>(behind < 0), front, behind);
    leaf.bsdf = select(mask<I>(two), select(mask<I>(back), behind, front), leaf.bsdf);
    leaf.mirrored = leaf.mirrored || (two && back);
}

// A scene without layers has at most `twosided`.
template <class F, class S>
TR_INLINE Leaf<F> resolve_bsdf(const SceneView<S> &scene, const IntOf<F> &bsdf, const MaskOf<F> &back,
                               const MaskOf<F> &active) {
    Leaf<F> r{bsdf, MaskOf<F>(false), {}, F(0), {}};
    resolve_side(RecordLanes<F>(scene.bsdfs, bsdf, active), back, active, r);
    return r;
}

// The weight of the second branch of a blend, or of what is there of a masked surface.
template <int C, template <class> class Point, class F, class S>
TR_INLINE F branch_weight(const SceneView<S> &scene, const IntOf<F> &texture, const Point<F> &at,
                          const MaskOf<F> &active) {
    F w = luminance(eval_texture<C>(scene, scene.values, texture, at, active));
    return max(F(0), min(w, F(1)));
}

// Where a weight is as it is looked up, and not clamped: what its derivative belongs to.
template <int C, template <class> class Point, class F, class S>
TR_INLINE MaskOf<F> unclamped_weight(const SceneView<S> &scene, const IntOf<F> &texture, const Point<F> &at,
                                     const MaskOf<F> &active) {
    F w = luminance(eval_texture<C>(scene, scene.values, texture, at, active));
    return active && mask<F>(w >= F(0)) && mask<F>(w <= F(1));
}

// Walks down to the leaf. Calls visit(texture, second, weight of the branch, lanes) where branches are chosen.
// `wanted`: by bsdf, whether a value of it is differentiated; null while rendering.
template <int C, template <class> class Point, class F, class S, class Visit>
TR_INLINE Leaf<F> walk_layers(const SceneView<S> &scene, const IntOf<F> &root, const MaskOf<F> &back,
                              const Point<F> &at, const F &choice, const int32_t *wanted, const MaskOf<F> &active,
                              Visit &&visit) {
    using I = IntOf<F>;
    static_assert(int(BlendBsdf::Weight) == int(MaskBsdf::Opacity), "both are read as one field");
    Leaf<F> r{root, MaskOf<F>(false), {}, choice, {}};
    Layers<F> &layers = r.layers;
    auto open = active;
    F u = choice;
    for (int depth = 0; depth < MaxLayers; ++depth) {
        RecordLanes<F> record(scene.bsdfs, r.bsdf, open);
        const I &kind = record.kind();
        open = open && mask<F>(kind >= TwoSidedKind);
        if (!any(open)) break;
        const I here = r.bsdf;
        resolve_side(record, back, open, r);
        auto blend = open && mask<F>(kind == BlendKind), masked = open && mask<F>(kind == MaskKind);
        auto chosen = blend || masked;
        if (any(chosen)) {
            I texture = record.field(BlendBsdf::Weight);
            F w = branch_weight<C>(scene, texture, at, chosen), q = w;
            if (wanted) {
                auto here_wanted = chosen && mask<F>(gather<I>(wanted, UIntOf<F>(here), mask<I>(chosen)) != 0);
                q = select(here_wanted, fmadd(w, F(0.8), F(0.1)), w);
                layers.wanted = layers.wanted || here_wanted;
            }
            auto second = mask<F>(u < q);
            F p = select(second, q, F(1) - q), share = select(second, w, F(1) - w);
            F inverse = F(1) / max(p, F(1e-12));
            u = select(chosen, min(select(second, u, u - q) * inverse, F(1 - 1e-7)), u);
            layers.weight = select(chosen, layers.weight * share, layers.weight);
            layers.inverse_probability =
                select(chosen, layers.inverse_probability * inverse, layers.inverse_probability);
            I to = select(mask<I>(second), record.field(BlendBsdf::Second), record.field(BlendBsdf::First));
            r.bsdf = select(mask<I>(blend), to, r.bsdf);
            r.bsdf = select(mask<I>(masked && second), record.field(MaskBsdf::Nested), r.bsdf);
            auto hole = masked && !second;
            layers.opening = layers.opening || hole;
            open = open && !hole;
            visit(texture, second, share, chosen);
        }
        auto turns = open && (mask<F>(kind == NormalMapKind) || mask<F>(kind == BumpMapKind));
        if (any(turns)) {
            layers.turned = select(mask<I>(turns), here, layers.turned);
            layers.mirrored = layers.mirrored || (turns && r.mirrored);
            r.bsdf = select(mask<I>(turns), record.field(NormalMap::Nested), r.bsdf);
        }
    }
    return r;
}

template <class F, class S>
TR_INLINE IntOf<F> leaf_kind(const SceneView<S> &scene, const Leaf<F> &leaf, const MaskOf<F> &active) {
    using I = IntOf<F>;
    return select(mask<I>(leaf.layers.opening), I(OpeningKind), record_kind<F>(scene.bsdfs, leaf.bsdf, active));
}

template <class F>
TR_INLINE Vec3<F> as_vector(const Color<F, 3> &c) {
    return {c[0], c[1], c[2]};
}

// What a normal is turned by: an image's colours, or slopes of heights, and the surface's tangents.
template <class F>
struct NormalTurn {
    MaskOf<F> mapped{false}, bumped{false};
    PositionPartials<F> tangents;
    Vec3<F> map{F(0), F(0), F(1)};
    F scale{0};
    Vec2<F> slopes{F(0), F(0)};  // without the scale

    template <class S>
    TR_INLINE NormalTurn(const SceneView<S> &scene, const TexturedPoint<F> &at, const IntOf<F> &record,
                         const MaskOf<F> &turned) {
        static_assert(int(NormalMap::Map) == int(BumpMap::Heights) && int(NormalMap::Flip) == int(BumpMap::Flip) &&
                          int(NormalMap::Shadowing) == int(BumpMap::Shadowing),
                      "these are read as one");
        IntOf<F> kind = record_kind<F>(scene.bsdfs, record, turned);
        IntOf<F> texture = record_field<F>(scene.bsdfs, NormalMap::Map, record, turned);
        tangents = position_partials(scene, at, ShapeLanes<F>(scene.shapes, at.shape, turned), turned);
        mapped = turned && mask<F>(kind == NormalMapKind);
        bumped = turned && mask<F>(kind == BumpMapKind);
        if (any(mapped)) map = as_vector(eval_texture<3>(scene, scene.values, texture, at, mapped));
        if (any(bumped)) {
            IntOf<F> offset = record_field<F>(scene.bsdfs, BumpMap::Scale, record, bumped);
            scale = gather<F>(scene.values.constants, UIntOf<F>(offset), bumped);
            slopes = texture_slopes<3>(scene, texture, at, bumped);
        }
    }
    // `z`: the normal that is turned; `side`, `sign`: see NormalMap::turn.
    TR_INLINE Vec3<F> operator()(const Vec3<F> &z, const F &side, const F &sign) const {
        Vec3<F> n = z;
        if (any(mapped)) n = select(mapped, NormalMap::turn(z, side, tangents.u, map, sign), n);
        if (any(bumped)) {
            F u = slopes.x * scale, v = slopes.y * scale;
            n = select(bumped, BumpMap::turn(z, side, tangents.u, tangents.v, u, v, sign), n);
        }
        return n;
    }
};

// The turned normal; `z` is the one that is turned and `wi` the direction to where the path comes from.
template <class F, class S>
TR_INLINE Vec3<F> turned_normal(const SceneView<S> &scene, const TexturedPoint<F> &at, const Vec3<F> &z, const F &side,
                                const Vec3<F> &wi, bool viewed, const Layers<F> &layers, const MaskOf<F> &turned) {
    NormalTurn<F> turn(scene, at, layers.turned, turned);
    Vec3<F> n = turn(z, side, F(1));
    if (!viewed) return n;
    auto flips = turned && mask<F>(record_field<F>(scene.bsdfs, NormalMap::Flip, layers.turned, turned) == 1);
    flips = flips && mask<F>(dot(n, wi) * dot(z, wi) < F(0));
    return any(flips) ? select(flips, turn(z, side, F(-1)), n) : n;
}

// Resolves the layers at a hit that a ray along d has come to, and turns its frame. `viewed`: the ray comes from where
// the image is seen from, so that normals which hide from it are reversed.
template <int C, class F, class S>
TR_NOINLINE Leaf<F> resolve_layers(const SceneView<S> &scene, Interaction<F> &si, const Vec3<F> &d, const F &choice,
                                   bool viewed, const int32_t *wanted, const MaskOf<F> &active) {
    auto back = mask<F>(dot(si.frame.n, d) > F(0));
    auto nothing = [](const IntOf<F> &, const MaskOf<F> &, const F &, const MaskOf<F> &) {};
    Leaf<F> r = walk_layers<C>(scene, si.shape.bsdf, back, si.at, choice, wanted, active, nothing);
    r.base = si.frame.n;
    auto turned = active && mask<F>(r.layers.turned >= 0);
    if (any(turned)) {
        F side = select(r.layers.mirrored, F(-1), F(1));
        Vec3<F> n = turned_normal(scene, si.at, si.frame.n * side, side, -d, viewed, r.layers, turned);
        si.frame = make_frame(select(turned, n, si.frame.n));
        r.mirrored = r.mirrored && !turned;
    }
    return r;
}

// The factor of a value because the normal was turned from `base` to n: 0 where one of them sees `w` from the other
// side, and what is left of light from `light` near the terminator.
template <class F>
struct TurnedFactor {
    MaskOf<F> turned, shadowed{false};
    Vec3<F> base, n;  // both on the side that is shaded
    static constexpr double Least = 1e-6;

    TR_INLINE TurnedFactor() : turned(false) {}
    template <class S>
    TR_INLINE TurnedFactor(const SceneView<S> &scene, const Leaf<F> &leaf, const Vec3<F> &n_, const MaskOf<F> &active)
        : base(leaf.base * select(leaf.layers.mirrored, F(-1), F(1))), n(n_) {
        turned = active && mask<F>(leaf.layers.turned >= 0);
        if (any(turned))
            shadowed =
                turned && mask<F>(record_field<F>(scene.bsdfs, NormalMap::Shadowing, leaf.layers.turned, turned) == 1);
    }
    TR_INLINE MaskOf<F> hidden(const Vec3<F> &w) const { return turned && mask<F>(dot(base, w) * dot(n, w) <= F(0)); }
    TR_INLINE F operator()(const Vec3<F> &w, const Vec3<F> &light) const {
        F r(1);
        if (any(shadowed)) r = select(shadowed, NormalMap::shadowing(base, n, light, F(Least)), r);
        return select(hidden(w), F(0), r);
    }
};

}  // namespace tr
