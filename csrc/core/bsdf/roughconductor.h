// `roughconductor`: a metal of microscopic facets, each of which reflects like `conductor`. Walter, Marschner, Li and
// Torrance, "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007, equation 20, with the Fresnel
// equations for a complex index. Light is scattered once: what facets throw onto others is lost.
#pragma once

#include "../math/fresnel.h"
#include "bsdf.h"
#include "microfacet.h"

namespace tr {

// `Surface` says how rough it is: alpha(params) is a number, or a pair of them.
template <class Surface>
struct ConductorFacets {
    enum { Eta = 0, K = 1, Reflectance = 2 };  // of color[]

    template <int C, class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi, const Vec3<F> &wo, const IntOf<F> &) {
        using T = std::decay_t<decltype(params.number[0] * wi.z)>;
        auto facets = ggx_facets<F>(params.choice[0]);
        auto alpha = rendered_alpha(Surface::template alpha<T>(params));
        FacetReflection<T> r(facets, alpha, convert<T>(wi), convert<T>(wo));
        T value = r.density * (r.shadowing(facets, alpha, convert<T>(wo)) * T(0.25));
        Color<T, C> result;
        for (int c = 0; c < C; ++c) {
            T fresnel = fresnel_conductor(r.cosine, T(params.color[Eta][c]), T(params.color[K][c]));
            result[c] = select(r.possible, T(params.color[Reflectance][c]) * fresnel * value, T(0));
        }
        return result;
    }

    template <int C, class P, class F>
    TR_INLINE static F pdf(const P &params, const Vec3<F> &wi, const Vec3<F> &wo) {
        FacetReflection<F> r(ggx_facets<F>(params.choice[0]), rendered_alpha(Surface::template alpha<F>(params)), wi,
                             wo);
        return select(r.possible, r.density * F(0.25), F(0));
    }

    template <int C, class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &, const F &u1, const F &u2) {
        BsdfSample<F> r;
        r.wo = sample_facet_reflection(ggx_facets<F>(params.choice[0]),
                                       rendered_alpha(Surface::template alpha<F>(params)), wi, u1, u2);
        r.pdf = pdf<C>(params, wi, r.wo);
        r.eta = F(1);
        r.lobe = IntOf<F>(0);
        r.delta = r.null = MaskOf<F>(false);
        return r;
    }
};

struct RoughConductor : ConductorFacets<RoughConductor> {
    static constexpr Field fields[] = {
        {"alpha", Kind::Scalar, 0.1, 0, 10, "interior",
         "roughness of the microfacet distribution; below 0.001 it counts as that"},
        {"eta", Kind::Texture, 0, 0, INFINITY, "interior", "real part of the index of refraction"},
        {"k", Kind::Texture, 1, 0, INFINITY, "interior", "imaginary part (absorption)"},
        {"specular_reflectance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical"},
        {"distribution", Kind::Int, 0, 0, 1, "", "0: beckmann, 1: ggx"},
    };
    static constexpr Model model = {"bsdf", "roughconductor", "Rough conductor, one-sided.", fields, 5};
    static constexpr bool Smooth = true, Delta = false;
    static constexpr int Albedo = 3;

    template <class T, class P>
    TR_INLINE static T alpha(const P &params) {
        return T(params.number[0]);
    }
};

}  // namespace tr
