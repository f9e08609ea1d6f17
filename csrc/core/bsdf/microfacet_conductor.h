// Metals of microscopic microfacets, each of which reflects like `conductor`. Walter, Marschner, Li and Torrance,
// "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007, equation 20, with the Fresnel equations for a
// complex index. Light is scattered once: what microfacets throw onto others is lost.
#pragma once

#include "../math/fresnel.h"
#include "kernels.h"
#include "microfacet.h"

namespace tr {

// `Surface`, the model, says where its parameters are and how rough it is: alpha(params) is a number, or a pair of
// them.
template <class Surface>
struct MicrofacetConductor {
    static constexpr Polarization Polarizes = Polarization::Metal;

    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi, const Vec3<F> &wo, const IntOf<F> &) {
        using T = std::decay_t<decltype(params.number[0] * wi.z)>;
        auto facets = is_ggx<F>(params.choice[Surface::Distribution]);
        auto alpha = clamp_alpha(Surface::template alpha<T>(params));
        FacetReflection<T> r(facets, alpha, convert<T>(wi), convert<T>(wo));
        T value = r.density * (r.shadowing(facets, alpha, convert<T>(wo)) * T(0.25));
        Spectrum<T> result;
        for (int c = 0; c < SpectrumSize; ++c) {
            T fresnel = fresnel_conductor(r.cosine, T(params.color[Surface::Eta][c]), T(params.color[Surface::K][c]));
            result[c] = select(r.possible, T(params.color[Surface::Reflectance][c]) * fresnel * value, T(0));
        }
        return result;
    }

    template <class P, class F>
    TR_INLINE static F pdf(const P &params, const Vec3<F> &wi, const Vec3<F> &wo) {
        FacetReflection<F> r(is_ggx<F>(params.choice[Surface::Distribution]),
                             clamp_alpha(Surface::template alpha<F>(params)), wi, wo);
        return select(r.possible, r.density * F(0.25), F(0));
    }

    template <class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &, const F &u1, const F &u2) {
        BsdfSample<F> r;
        r.wo = sample_facet_reflection(is_ggx<F>(params.choice[Surface::Distribution]),
                                       clamp_alpha(Surface::template alpha<F>(params)), wi, u1, u2);
        r.pdf = pdf(params, wi, r.wo);
        r.eta = F(1);
        r.lobe = IntOf<F>(0);
        r.delta = MaskOf<F>(false);
        return r;
    }
};

}  // namespace tr
