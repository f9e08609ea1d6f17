// What of a tree of BSDFs a hit is scattered by. `twosided` goes by the side that is met; `blendbsdf` and `mask` by
// chance, with the last number of the scattering's block; `normalmap` and `bumpmap` turn the frame; the BSDF below all
// of them scatters. That a branch is taken with a probability q and has a weight w multiplies what comes of it by w /
// q: the image is that of the mixture, every model may be in it, and one at a time is evaluated.
//
// While rendering q = w. For a derivative in w both branches need a chance even where w is 0 or 1: with a branch's
// radiance R_i the mixture changes by dw (R_1 - R_0).
#pragma once

#include "../registry.h"
#include "../shape/partials.h"
#include "../texture/slopes.h"

namespace tr {

// What the BSDFs above the resolved one make of it.
template <class F>
struct BsdfStack {
    F weight{1};                      // the product of the weights of the branches
    F inverse_probability{1};         // of taking them
    MaskOf<F> hole{false};            // the hole of a mask, with the record of that
    MaskOf<F> differentiated{false};  // a weight on the way is
    IntOf<F> perturbed{-1};           // the record of a normal map
    MaskOf<F> mirrored{false};        // the side of `base_normal` that it perturbs
};

// The BSDF of a hit: its record, and whether directions are mirrored. `choice` and `base_normal` are what it was found
// from, the normal before it was perturbed; both mean something in scenes with stacks alone.
template <class F>
struct ResolvedBsdf {
    IntOf<F> bsdf;
    MaskOf<F> mirrored;
    BsdfStack<F> stack;
    F choice{0};
    Vec3<F> base_normal;

    // local directions as the BSDF sees them
    TR_INLINE Vec3<F> mirror(Vec3<F> w) const {
        w.z = select(mirrored, -w.z, w.z);
        return w;
    }
};

template <class F>
TR_INLINE void resolve_side(const RecordLanes<F> &record, const MaskOf<F> &back, const MaskOf<F> &active,
                            ResolvedBsdf<F> &r) {
    using I = IntOf<F>;
    auto two = active && mask<F>(record.kind() == TwoSidedKind);
    if (!any(two)) return;
    I front = record.field(TwoSided::Front), behind = record.field(TwoSided::Back);
    behind = select(mask<I>(behind < 0), front, behind);
    r.bsdf = select(mask<I>(two), select(mask<I>(back), behind, front), r.bsdf);
    r.mirrored = r.mirrored || (two && back);
}

// A scene without stacks has at most `twosided`.
template <class F>
TR_INLINE ResolvedBsdf<F> resolve_bsdf(const SceneOf<F> &scene, const IntOf<F> &bsdf, const MaskOf<F> &back,
                                       const MaskOf<F> &active) {
    ResolvedBsdf<F> r{bsdf, MaskOf<F>(false), {}, F(0), {}};
    resolve_side(RecordLanes<F>(scene.bsdfs, bsdf, active), back, active, r);
    return r;
}

// The weight of the second branch of a blend, or of what is there of a masked surface.
template <class F>
TR_INLINE F branch_weight(const SceneOf<F> &scene, const Wavelengths<F> &waves, const IntOf<F> &texture,
                          const TexturedPoint<F> &at, const MaskOf<F> &active) {
    F w = luminance(eval_texture(scene, waves, texture, at, active));
    return max(F(0), min(w, F(1)));
}

// Where a weight is as it is looked up, and not clamped: what its derivative belongs to.
template <class F>
TR_INLINE MaskOf<F> unclamped_weight(const SceneOf<F> &scene, const Wavelengths<F> &waves, const IntOf<F> &texture,
                                     const TexturedPoint<F> &at, const MaskOf<F> &active) {
    F w = luminance(eval_texture(scene, waves, texture, at, active));
    return active && mask<F>(w >= F(0)) && mask<F>(w <= F(1));
}

// The branches that were chosen on the way down, for the derivative of their weights.
template <class F>
struct Branches {
    int n = 0;
    IntOf<F> texture[MaxBsdfDepth];
    F weight[MaxBsdfDepth];
    MaskOf<F> second[MaxBsdfDepth], lanes[MaxBsdfDepth];
};

// Walks down the stack. `differentiated`: by bsdf, whether a value of it is; null while rendering. `branches` may be
// null.
template <class F>
TR_LARGE ResolvedBsdf<F> walk_stack(const SceneOf<F> &scene, const Wavelengths<F> &waves, const IntOf<F> &root,
                                    const MaskOf<F> &back, const TexturedPoint<F> &at, const F &choice,
                                    const int32_t *differentiated, const MaskOf<F> &active, Branches<F> *branches);

template <class F>
TR_INLINE IntOf<F> resolved_kind(const SceneOf<F> &scene, const ResolvedBsdf<F> &r, const MaskOf<F> &active) {
    using I = IntOf<F>;
    return select(mask<I>(r.stack.hole), I(MaskHoleKind), record_kind<F>(scene.bsdfs, r.bsdf, active));
}

// What a normal is perturbed by: an image's colours, or slopes of heights, and the surface's tangents.
template <class F>
struct NormalPerturbation {
    MaskOf<F> mapped{false}, bumped{false};
    PositionPartials<F> tangents;
    Vec3<F> map{F(0), F(0), F(1)};
    F scale{0};
    Vec2<F> slopes{F(0), F(0)};  // without the scale

    TR_LARGE NormalPerturbation(const SceneOf<F> &scene, const Wavelengths<F> &waves, const TexturedPoint<F> &at,
                                const IntOf<F> &record, const MaskOf<F> &perturbed);

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

// Resolves the stack at a hit that a ray along d has come to, and perturbs its frame. `viewed`: the ray comes from
// where the image is seen from, so that normals which hide from it are reversed.
template <class F>
TR_LARGE ResolvedBsdf<F> resolve_stack(const SceneOf<F> &scene, const Wavelengths<F> &waves, Interaction<F> &si,
                                       const Vec3<F> &d, const F &choice, bool viewed, const int32_t *differentiated,
                                       const MaskOf<F> &active);

// The factor of a value because the normal was perturbed from `base` to n: 0 where one of them sees `w` from the other
// side, and what is left of light from `light` near the terminator.
template <class F>
struct PerturbationFactor {
    MaskOf<F> perturbed, shadowed{false};
    Vec3<F> base, n;  // both on the side that is shaded
    static constexpr double Least = 1e-6;

    TR_INLINE PerturbationFactor() : perturbed(false) {}
    TR_INLINE PerturbationFactor(const SceneOf<F> &scene, const ResolvedBsdf<F> &r, const Vec3<F> &n_,
                                 const MaskOf<F> &active)
        : base(r.base_normal * select(r.stack.mirrored, F(-1), F(1))), n(n_) {
        perturbed = active && mask<F>(r.stack.perturbed >= 0);
        if (any(perturbed)) {
            IntOf<F> shadowing = record_field<F>(scene.bsdfs, NormalMap::Shadowing, r.stack.perturbed, perturbed);
            shadowed = perturbed && mask<F>(shadowing == 1);
        }
    }
    TR_INLINE MaskOf<F> hidden(const Vec3<F> &w) const {
        return perturbed && mask<F>(dot(base, w) * dot(n, w) <= F(0));
    }
    TR_INLINE F operator()(const Vec3<F> &w, const Vec3<F> &light) const {
        F r(1);
        if (any(shadowed)) r = select(shadowed, NormalMap::shadowing(base, n, light, F(Least)), r);
        return select(hidden(w), F(0), r);
    }
};

}  // namespace tr
