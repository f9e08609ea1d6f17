// Emission, found in two ways that are combined by the power heuristic (Veach 1997, section 9.2): by sampling an
// emitter from a vertex, and where a ray happens to meet one.
#pragma once

#include "context.h"

namespace tr {

template <class F>
TR_INLINE F power_heuristic(const F &a, const F &b) {
    F a2 = a * a, b2 = b * b;
    auto usable = mask<F>(a2 > F(0));
    return select(usable, a2 / select(usable, a2 + b2, F(1)), F(0));
}

// The factor of an emitter sample whose direction something else samples with density `pdf`; `n_light` and `n_other` of
// each are taken.
template <class F>
TR_INLINE F emitter_sample_weight(const EmitterSample<F> &light, const F &pdf, const F &n_light, const F &n_other,
                                  const MaskOf<F> &possible) {
    F weight = select(light.delta, F(1), power_heuristic(n_light * light.pdf, n_other * pdf));
    return select(possible, weight * light.factor / select(possible, n_light * light.pdf, F(1)), F(0));
}

// What a ray that met an emitter must know of the vertex it came from.
template <class F>
struct PreviousVertex {
    Vec3<F> p;
    F pdf;  // of the ray's direction; 0 after a delta lobe and for camera rays, whose emission has weight 1
};

// Whether a ray passes through one of n boxes.
template <class B, class F>
TR_INLINE MaskOf<F> may_meet(const B *boxes, int32_t n, const Vec3<F> &o, const Vec3<F> &d) {
    using S = ScalarOf<F>;
    MaskOf<F> r(false);
    const F *from[3] = {&o.x, &o.y, &o.z}, *along[3] = {&d.x, &d.y, &d.z};
    F inverse[3];
    for (int k = 0; k < 3; ++k) {
        auto flat = mask<F>(abs(*along[k]) < F(S(1e-18)));
        inverse[k] = F(1) / select(flat, F(S(1e-18)), *along[k]);
    }
    for (int32_t l = 0; l < n; ++l) {
        const B *box = boxes + 6 * l;
        F first(0), last = F(S(INFINITY));
        for (int k = 0; k < 3; ++k) {
            F a = (F(S(box[k])) - *from[k]) * inverse[k], b = (F(S(box[3 + k])) - *from[k]) * inverse[k];
            first = max(first, min(a, b));
            last = min(last, max(a, b));
        }
        r = r || mask<F>(first <= last * F(1.00001));
    }
    return r;
}

template <class F>
struct FoundEmission {
    EmitterPoint<F> point;
    F weight;  // 0 where there is none
    Spectrum<F> radiance;
};

template <class F>
TR_INLINE FoundEmission<F> no_emission() {
    return {{IntOf<F>(-1), {UIntOf<F>(0u), UIntOf<F>(0u), F(0), F(0)}}, F(0), uniform_spectrum(F(0))};
}

// `depth`: how many vertices come before this one.
template <class F>
TR_INLINE F found_weight(const PathConfig &config, const PreviousVertex<F> &from, F emitter_pdf, int depth) {
    using S = ScalarOf<F>;
    if (depth == 1) emitter_pdf = emitter_pdf * F(S(config.emitter_samples) / S(config.bsdf_samples));
    return select(mask<F>(from.pdf > F(0)), power_heuristic(from.pdf, emitter_pdf), F(1));
}

template <class F>
TR_INLINE FoundEmission<F> surface_emission(const PathContext<F> &c, const Wavelengths<F> &waves,
                                            const Interaction<F> &si, const F &cos_i, const PreviousVertex<F> &from,
                                            const MaskOf<F> &active, int depth) {
    FoundEmission<F> r = no_emission<F>();
    r.point = {si.shape.emitter, si.at};
    auto lit = active && mask<F>(r.point.emitter >= 0) && mask<F>(cos_i > F(0));
    if (!any(lit)) return r;
    F pdf = shape_emitter_pdf(c.scene, r.point, from.p, si.p, si.ng, lit);
    r.weight = select(lit, found_weight(c.config, from, pdf, depth), F(0));
    r.radiance = select(lit, eval_emitter(c.scene, waves, r.point, lit) * r.weight, r.radiance);
    return r;
}

// Of a ray that left the scene.
template <class F>
TR_INLINE FoundEmission<F> environment_emission(const PathContext<F> &c, const Wavelengths<F> &waves, const Vec3<F> &d,
                                                const PreviousVertex<F> &from, const MaskOf<F> &active, int depth) {
    FoundEmission<F> r;
    F pdf;
    r.point = environment_point(c.scene, d, pdf, active);
    r.weight = select(active, found_weight(c.config, from, pdf, depth), F(0));
    r.radiance = eval_emitter(c.scene, waves, r.point, active) * r.weight;
    return r;
}

// Adds what was found, weighted with the throughput.
template <class F>
TR_INLINE void add_radiance(const PathContext<F> &c, const UIntOf<F> &slot, const Spectrum<F> &beta,
                            const FoundEmission<F> &e, const MaskOf<F> &active, Culprit culprit) {
    auto some = active && mask<F>(e.weight > F(0));
    if (any(some))
        add_to_entries<F>(c.slots.radiance, slot, apply(beta, e.radiance),
                          finite(c, e.radiance, some, culprit, e.point.emitter));
}

}  // namespace tr
