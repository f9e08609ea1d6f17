// What smooth and rough coatings over a diffuse base share.
#pragma once

#include "../math/warp.h"
#include "bsdf.h"
#include "microfacet.h"

namespace tr {

// What a coating does to the diffuse base below it: light that the interface throws back into the coat meets the base
// again and again. `reflectance` is the base's, `internal` the interface's for diffuse light from below; with
// `nonlinear`, colours deepen with every further reflection, else each is as grey as the first.
template <class T, class M>
TR_INLINE T coated_albedo(const T &reflectance, const T &internal, const M &nonlinear) {
    return reflectance / (T(1) - select(nonlinear, reflectance * internal, internal));
}

// Polarised light needs a rough coat and the base below it apart: they are lobes 1 and 2; 0 is both.
template <class I, class T>
TR_INLINE void choose_lobe(const I &lobe, T &coat, T &base) {
    using F = std::decay_t<decltype(value_of(coat))>;
    coat = select(mask<F>(lobe == 2), T(0), coat), base = select(mask<F>(lobe == 1), T(0), base);
}

// The chance with which the interface's lobe is sampled, of which the share of light is r: in proportion to the largest
// channels, but both lobes with a chance, since what is black has a derivative too.
template <class F>
TR_INLINE F specular_sampling_weight(const F &r, const Spectrum<F> &specular, const Spectrum<F> &diffuse) {
    F coat = r * max_component(specular), base = (F(1) - r) * max_component(diffuse), sum = coat + base;
    auto some = mask<F>(sum > F(0));
    return min(max(select(some, coat / select(some, sum, F(1)), F(0.5)), F(0.1)), F(0.9));
}

// Rough reflection off the interface, sampled with probability p, or a diffuse lobe below it: the density of a
// direction, and a direction of this density.
template <class M, class F>
TR_INLINE F rough_or_diffuse_pdf(const M &ggx, const F &alpha, const F &p, const Vec3<F> &wi, const Vec3<F> &wo) {
    FacetReflection<F> r(ggx, alpha, wi, wo);
    return select(r.possible, p * r.density * F(0.25) + (F(1) - p) * wo.z * F(1 / Pi), F(0));
}
template <class M, class F>
TR_INLINE BsdfSample<F> sample_rough_or_diffuse(const M &ggx, const F &alpha, const F &p, const Vec3<F> &wi,
                                                const F &u0, const F &u1, const F &u2) {
    BsdfSample<F> r;
    r.wo =
        select(mask<F>(u0 < p), sample_facet_reflection(ggx, alpha, wi, u1, u2), square_to_cosine_hemisphere(u1, u2));
    r.pdf = rough_or_diffuse_pdf(ggx, alpha, p, wi, r.wo);
    r.eta = F(1);
    r.lobe = IntOf<F>(0);
    r.delta = MaskOf<F>(false);
    return r;
}

}  // namespace tr
