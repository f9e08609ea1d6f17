// Interfaces between two transparent media with microscopic microfacets, each of which reflects and refracts like
// `dielectric`. Walter, Marschner, Li and Torrance, "Microfacet Models for Refraction through Rough Surfaces", EGSR
// 2007. Light is scattered once: what microfacets throw onto others is lost.
#pragma once

#include "dielectric_microfacet.h"
#include "kernels.h"

namespace tr {

// `Surface`, the model, says where its parameters are and how rough it is: alpha(params) is a number, or a pair of
// them.
template <class Surface>
struct MicrofacetDielectric {
    static constexpr Polarization Polarizes = Polarization::Interface;

    template <class P>
    TR_INLINE static auto ggx(const P &params) {
        return mask<std::decay_t<decltype(value_of(params.number[0]))>>(params.choice[Surface::Distribution] ==
                                                                        int32_t(Microfacets::Ggx));
    }

    // What `eval` and `pdf` share: F D G1(wi) / (4 |cos_i|) of reflection, and of refraction (1 - F) D G1(wi) |wi.h|
    // |wo.h| / (|cos_i| (wi.h + eta wo.h)^2): equations 20 and 21.
    template <class T>
    struct Terms {
        T value, eta;  // the relative index along wi
        MaskOf<T> reflects, possible;
    };

    template <class T, class P, class V>
    TR_INLINE static Terms<T> terms(const P &params, const V &wi_, const V &wo_) {
        Vec3<T> wi = convert<T>(wi_), wo = convert<T>(wo_);
        DielectricMicrofacet<T> facet(clamp_eta(T(params.number[Surface::Eta])), wi, wo);
        auto alpha = clamp_alpha(Surface::template alpha<T>(params));
        T fresnel = facet.fresnel();
        T scattered = select(facet.reflects, fresnel * T(0.25), (T(1) - fresnel) * facet.refraction);
        auto facets = ggx(params);
        T density = distribution_of(facets, alpha, facet.h, facet.inverse2);
        T value = select(facet.possible, scattered * density * smith_g1_over_cos(facets, alpha, wi), T(0));
        return {value, facet.eta, facet.reflects, facet.possible};
    }

    // Radiance is divided by the squared relative index when it is refracted (see dielectric.h), which cancels that of
    // equation 21.
    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi, const Vec3<F> &wo, const IntOf<F> &,
                               Transport transport = Transport::Radiance) {
        using T = std::decay_t<decltype(params.number[0] * wi.z)>;
        Terms<T> r = terms<T>(params, wi, wo);
        Vec3<T> to = convert<T>(wo);
        auto alpha = clamp_alpha(Surface::template alpha<T>(params));
        T value = r.value * (abs(to.z) * smith_g1_over_cos(ggx(params), alpha, to));
        T transmitted = transport == Transport::Radiance ? value : value * (r.eta * r.eta);
        Spectrum<T> result;
        for (int c = 0; c < SpectrumSize; ++c)
            result[c] = select(r.reflects, T(params.color[Surface::Reflectance][c]) * value,
                               T(params.color[Surface::Transmittance][c]) * transmitted);
        return result;
    }

    // Equations 14, 17 and 24, with normals sampled by their visibility.
    template <class P, class F>
    TR_INLINE static F pdf(const P &params, const Vec3<F> &wi, const Vec3<F> &wo) {
        Terms<F> r = terms<F>(params, wi, wo);
        return select(r.reflects, r.value, r.value * (r.eta * r.eta));
    }

    template <class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &u0, const F &u1, const F &u2) {
        Vec3<F> seen = select(mask<F>(wi.z < F(0)), -wi, wi);
        Vec3<F> m = sample_visible_normal(ggx(params), clamp_alpha(Surface::template alpha<F>(params)), seen, u1, u2);
        F cos_i = dot(wi, m);
        Fresnel<F> fresnel = fresnel_dielectric(cos_i, clamp_eta(params.number[Surface::Eta]));
        auto reflects = mask<F>(u0 < fresnel.reflectance);
        BsdfSample<F> r;
        Vec3<F> along = wi - m * cos_i;  // the part of wi along the microfacet
        r.wo = normalize(m * select(reflects, cos_i, fresnel.cos_t) - along * select(reflects, F(1), fresnel.eta_ti));
        auto right_side = mask<F>(mulsign(select(reflects, r.wo.z, -r.wo.z), wi.z) > F(0));
        r.pdf = select(right_side, pdf(params, wi, r.wo), F(0));
        r.eta = select(reflects, F(1), fresnel.eta_it);
        r.lobe = IntOf<F>(0);
        r.delta = MaskOf<F>(false);
        return r;
    }
};

}  // namespace tr
