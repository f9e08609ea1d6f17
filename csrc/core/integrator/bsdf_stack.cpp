#include "bsdf_stack.h"

namespace tr {

template <class F>
TR_LARGE ResolvedBsdf<F> walk_stack(const SceneOf<F> &scene, const Wavelengths<F> &waves, const IntOf<F> &root,
                                    const MaskOf<F> &back, const TexturedPoint<F> &at, const F &choice,
                                    const int32_t *differentiated, const MaskOf<F> &active, Branches<F> *branches) {
    using I = IntOf<F>;
    static_assert(int(BlendBsdf::Weight) == int(MaskBsdf::Opacity), "both are read as one field");
    ResolvedBsdf<F> r{root, MaskOf<F>(false), {}, choice, {}};
    BsdfStack<F> &stack = r.stack;
    auto open = active;
    F u = choice;
    for (int depth = 0; depth < MaxBsdfDepth; ++depth) {
        RecordLanes<F> record(scene.bsdfs, r.bsdf, open);
        const I &kind = record.kind();
        open = open && mask<F>(kind >= FirstWrapper);
        if (!any(open)) break;
        const I here = r.bsdf;
        resolve_side(record, back, open, r);
        auto blend = open && mask<F>(kind == BlendKind), masked = open && mask<F>(kind == MaskKind);
        auto chosen = blend || masked;
        if (any(chosen)) {
            I texture = record.field(BlendBsdf::Weight);
            F w = branch_weight(scene, waves, texture, at, chosen), q = w;
            if (differentiated) {
                auto both = chosen && mask<F>(gather<I>(differentiated, UIntOf<F>(here), mask<I>(chosen)) != 0);
                q = select(both, fmadd(w, F(0.8), F(0.1)), w);
                stack.differentiated = stack.differentiated || both;
            }
            auto second = mask<F>(u < q);
            F p = select(second, q, F(1) - q), share = select(second, w, F(1) - w);
            F inverse = F(1) / max(p, F(1e-12));
            u = select(chosen, min(select(second, u, u - q) * inverse, F(1 - 1e-7)), u);
            stack.weight = select(chosen, stack.weight * share, stack.weight);
            stack.inverse_probability = select(chosen, stack.inverse_probability * inverse, stack.inverse_probability);
            I to = select(mask<I>(second), record.field(BlendBsdf::Second), record.field(BlendBsdf::First));
            r.bsdf = select(mask<I>(blend), to, r.bsdf);
            r.bsdf = select(mask<I>(masked && second), record.field(MaskBsdf::Nested), r.bsdf);
            auto hole = masked && !second;
            stack.hole = stack.hole || hole;
            open = open && !hole;
            if (branches) {
                Branches<F> &b = *branches;
                b.texture[b.n] = texture, b.weight[b.n] = share;
                b.second[b.n] = second, b.lanes[b.n] = chosen;
                ++b.n;
            }
        }
        auto perturbs = open && (mask<F>(kind == NormalMapKind) || mask<F>(kind == BumpMapKind));
        if (any(perturbs)) {
            stack.perturbed = select(mask<I>(perturbs), here, stack.perturbed);
            stack.mirrored = stack.mirrored || (perturbs && r.mirrored);
            r.bsdf = select(mask<I>(perturbs), record.field(NormalMap::Nested), r.bsdf);
        }
    }
    return r;
}

template <class F>
TR_LARGE NormalPerturbation<F>::NormalPerturbation(const SceneOf<F> &scene, const Wavelengths<F> &waves,
                                                   const TexturedPoint<F> &at, const IntOf<F> &record,
                                                   const MaskOf<F> &perturbed) {
    static_assert(int(NormalMap::Map) == int(BumpMap::Heights) && int(NormalMap::Flip) == int(BumpMap::Flip) &&
                      int(NormalMap::Shadowing) == int(BumpMap::Shadowing),
                  "these are read as one");
    IntOf<F> kind = record_kind<F>(scene.bsdfs, record, perturbed);
    IntOf<F> texture = record_field<F>(scene.bsdfs, NormalMap::Map, record, perturbed);
    tangents = position_partials(scene, at, ShapeLanes<F>(scene.shapes, at.shape, perturbed), perturbed);
    mapped = perturbed && mask<F>(kind == NormalMapKind);
    bumped = perturbed && mask<F>(kind == BumpMapKind);
    if (any(mapped)) {
        Spectrum<F> color = eval_texture(scene, waves, texture, at, mapped);
        map = {color[0], color[1], color[2]};
    }
    if (any(bumped)) {
        IntOf<F> offset = record_field<F>(scene.bsdfs, BumpMap::Scale, record, bumped);
        scale = gather<F>(scene.values.constants, UIntOf<F>(offset), bumped);
        TextureSlopes<F> slope = texture_slopes(scene, waves, texture, at, bumped);
        slopes = {luminance(slope.u), luminance(slope.v)};
    }
}

namespace {

// The perturbed normal; `z` is the one that is turned and `wi` the direction to where the path comes from.
template <class F>
TR_INLINE Vec3<F> perturbed_normal(const SceneOf<F> &scene, const Wavelengths<F> &waves, const TexturedPoint<F> &at,
                                   const Vec3<F> &z, const F &side, const Vec3<F> &wi, bool viewed,
                                   const BsdfStack<F> &stack, const MaskOf<F> &perturbed) {
    NormalPerturbation<F> turn(scene, waves, at, stack.perturbed, perturbed);
    Vec3<F> n = turn(z, side, F(1));
    if (!viewed) return n;
    auto flips = perturbed && mask<F>(record_field<F>(scene.bsdfs, NormalMap::Flip, stack.perturbed, perturbed) == 1);
    flips = flips && mask<F>(dot(n, wi) * dot(z, wi) < F(0));
    return any(flips) ? select(flips, turn(z, side, F(-1)), n) : n;
}

}  // namespace

template <class F>
TR_LARGE ResolvedBsdf<F> resolve_stack(const SceneOf<F> &scene, const Wavelengths<F> &waves, Interaction<F> &si,
                                       const Vec3<F> &d, const F &choice, bool viewed, const int32_t *differentiated,
                                       const MaskOf<F> &active) {
    auto back = mask<F>(dot(si.frame.n, d) > F(0));
    ResolvedBsdf<F> r = walk_stack(scene, waves, si.shape.bsdf, back, si.at, choice, differentiated, active,
                                   static_cast<Branches<F> *>(nullptr));
    r.base_normal = si.frame.n;
    auto perturbed = active && mask<F>(r.stack.perturbed >= 0);
    if (any(perturbed)) {
        F side = select(r.stack.mirrored, F(-1), F(1));
        Vec3<F> n = perturbed_normal(scene, waves, si.at, si.frame.n * side, side, -d, viewed, r.stack, perturbed);
        si.frame = make_frame(select(perturbed, n, si.frame.n));
        r.mirrored = r.mirrored && !perturbed;
    }
    return r;
}

#define TR_INSTANTIATE(F, S)                                                                                     \
    template ResolvedBsdf<F> walk_stack(const SceneView<S> &, const Wavelengths<F> &, const IntOf<F> &,          \
                                        const MaskOf<F> &, const TexturedPoint<F> &, const F &, const int32_t *, \
                                        const MaskOf<F> &, Branches<F> *);                                       \
    template struct NormalPerturbation<F>;                                                                       \
    template ResolvedBsdf<F> resolve_stack(const SceneView<S> &, const Wavelengths<F> &, Interaction<F> &,       \
                                           const Vec3<F> &, const F &, bool, const int32_t *, const MaskOf<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
