// `roughdielectric`: an interface between two transparent media with microscopic facets, each of which reflects and
// refracts like `dielectric`. Walter, Marschner, Li and Torrance, "Microfacet Models for Refraction through Rough
// Surfaces", EGSR 2007. Light is scattered once: what facets throw onto others is lost.
#pragma once

#include "../math/fresnel.h"
#include "bsdf.h"
#include "microfacet.h"

namespace tr {

struct RoughDielectric {
    enum { Reflectance = 0, Transmittance = 1 };  // of color[]
    enum { Eta = 0, Alpha = 1 };                  // of number[]
    static constexpr Field fields[] = {
        {"eta", Kind::Float, 1.5046 / 1.000277, 1e-3, 1e3, "interior",
         "index of refraction inside (below the surface) over outside; within 1e-3 of 1 it counts as 1.001 or 0.999"},
        {"alpha", Kind::Float, 0.1, MinAlpha, 10, "interior", "roughness of the microfacet distribution"},
        {"specular_reflectance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical"},
        {"specular_transmittance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical"},
        {"distribution", Kind::Int, 0, 0, 1, "", "0: beckmann, 1: ggx"},
    };
    static constexpr Model model = {"bsdf", "roughdielectric", "Rough dielectric interface.", fields, 5};
    static constexpr bool Smooth = true, Delta = false;
    static constexpr bool Asymmetric = true;
    static constexpr int Albedo = 3;  // what goes through is most of it

    // Without an interface nothing would be scattered: the lobe of refraction is a delta there. Indices next to 1 give
    // lobes that are too narrow for directions in single precision.
    template <class T>
    TR_INLINE static T index(const T &eta) {
        using F = std::decay_t<decltype(value_of(eta))>;
        F v = max(value_of(eta), F(1e-3));
        auto below = mask<F>(v < F(1));
        return with_value(eta, select(below, min(v, F(1 - 1e-3)), max(v, F(1 + 1e-3))));
    }

    template <class P>
    TR_INLINE static auto ggx(const P &params) {
        return mask<std::decay_t<decltype(value_of(params.number[0]))>>(params.choice[0] == int32_t(Microfacets::Ggx));
    }

    // What `eval` and `pdf` share: F D G1(wi) / (4 |cos_i|) of reflection, and of refraction
    // (1 - F) D G1(wi) |wi.h| |wo.h| / (|cos_i| (wi.h + eta wo.h)^2): equations 20 and 21. Half vectors are not
    // normalized; with h = wi + eta wo, the last denominator is |h|^2.
    template <class T>
    struct Terms {
        T value, eta;  // the relative index along wi
        MaskOf<T> reflects, possible;
    };

    template <class T, class P, class V>
    TR_INLINE static Terms<T> terms(const P &params, const V &wi_, const V &wo_) {
        using F = std::decay_t<decltype(value_of(std::declval<T>()))>;
        Vec3<T> wi{T(wi_.x), T(wi_.y), T(wi_.z)}, wo{T(wo_.x), T(wo_.y), T(wo_.z)};
        F zi = value_of(wi.z), zo = value_of(wo.z);
        auto outside = mask<F>(!(zi < F(0)));
        Terms<T> r;
        r.reflects = mask<F>(mulsign(zo, zi) > F(0));
        T inside_over_outside = index(T(params.number[Eta])), alpha = at_least(T(params.number[Alpha]), F(MinAlpha));
        r.eta = select(outside, inside_over_outside, T(1) / inside_over_outside);
        Vec3<T> h = wi + wo * select(r.reflects, T(1), r.eta);
        T length2 = squared_norm(h);
        auto usable = mask<F>(value_of(length2) > F(1e-20));
        T inverse2 = T(1) / select(usable, length2, T(1));
        T wi_h = dot(wi, h), wo_h = dot(wo, h);
        // both directions see the facet on the side on which they are
        F side = value_of(h.z);
        auto visible = mask<F>(mulsign(mulsign(value_of(wi_h), zi), side) > F(0)) &&
                       mask<F>(mulsign(mulsign(value_of(wo_h), zo), side) > F(0));
        r.possible = usable && visible && mask<F>(abs(zi) > F(0)) && mask<F>(abs(zo) > F(0));

        // Cosines on the facet. Refraction has both of them at hand, so that nothing is singular at the critical angle.
        wi_h = abs(wi_h), wo_h = abs(wo_h);
        T ci = wi_h, ct = wo_h;
        if (any(r.reflects)) {
            T c = sqrt(length2) * T(0.5);  // wi.h = wo.h = |h|^2 / 2
            T t = sqrt(max(T(1) - (T(1) - c * c) / (r.eta * r.eta), T(0)));
            ci = select(r.reflects, c, ci), ct = select(r.reflects, t, ct);
        }
        ci = select(r.possible, ci, T(1)), ct = select(r.possible, ct, T(1));
        T fresnel = fresnel_of_cosines(ci, ct, r.eta);
        T scattered = select(r.reflects, fresnel * T(0.25), (T(1) - fresnel) * (wi_h * inverse2) * (wo_h * inverse2));
        auto facets = ggx(params);
        T density = microfacet_density(facets, alpha, h.z * h.z * inverse2, (h.x * h.x + h.y * h.y) * inverse2);
        r.value = select(r.possible, scattered * density * masking_over_cosine(facets, alpha, wi), T(0));
        return r;
    }

    // Radiance is divided by the squared relative index when it is refracted (see dielectric.h), which cancels that of
    // equation 21.
    template <int C, class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi, const Vec3<F> &wo, const IntOf<F> &,
                               Transport transport = Transport::Radiance) {
        using T = std::decay_t<decltype(params.number[0] * wi.z)>;
        Terms<T> r = terms<T>(params, wi, wo);
        using V = std::decay_t<decltype(value_of(r.value))>;
        Vec3<T> to{T(wo.x), T(wo.y), T(wo.z)};
        T alpha = at_least(T(params.number[Alpha]), V(MinAlpha));
        T value = r.value * (abs(to.z) * masking_over_cosine(ggx(params), alpha, to));
        T transmitted = transport == Transport::Radiance ? value : value * (r.eta * r.eta);
        Color<T, C> result;
        for (int c = 0; c < C; ++c)
            result[c] = select(r.reflects, T(params.color[Reflectance][c]) * value,
                               T(params.color[Transmittance][c]) * transmitted);
        return result;
    }

    // Equations 14, 17 and 24, with normals sampled by their visibility.
    template <int C, class P, class F>
    TR_INLINE static F pdf(const P &params, const Vec3<F> &wi, const Vec3<F> &wo) {
        Terms<F> r = terms<F>(params, wi, wo);
        return select(r.reflects, r.value, r.value * (r.eta * r.eta));
    }

    template <int C, class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &u0, const F &u1, const F &u2) {
        Vec3<F> seen = select(mask<F>(wi.z < F(0)), -wi, wi);
        F alpha = max(params.number[Alpha], F(MinAlpha));
        Vec3<F> m = sample_visible_normal(ggx(params), alpha, seen, u1, u2);
        F cos_i = dot(wi, m);
        Fresnel<F> fresnel = fresnel_dielectric(cos_i, index(params.number[Eta]));
        auto reflects = mask<F>(u0 < fresnel.reflectance);
        BsdfSample<F> r;
        Vec3<F> along = wi - m * cos_i;  // the part of wi along the facet
        r.wo = normalize(m * select(reflects, cos_i, fresnel.cos_t) - along * select(reflects, F(1), fresnel.eta_ti));
        auto right_side = mask<F>(mulsign(select(reflects, r.wo.z, -r.wo.z), wi.z) > F(0));
        r.pdf = select(right_side, pdf<C>(params, wi, r.wo), F(0));
        r.eta = select(reflects, F(1), fresnel.eta_it);
        r.lobe = IntOf<F>(0);
        r.delta = r.null = MaskOf<F>(false);
        return r;
    }
};

}  // namespace tr
