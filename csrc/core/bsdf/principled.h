// `principled`: Burley, "Physically Based Shading at Disney", SIGGRAPH 2012 course, and "Extending the Disney BRDF to a
// BSDF with Integrated Subsurface Scattering", SIGGRAPH 2015 course: a diffuse base with retro-reflection, sheen, a
// rough interface that is dielectric or metallic, and a clear coat. The facets of the interface are those of
// `roughdielectric` with GGX; what makes it transparent, metallic or tinted is how much of them reflects.
#pragma once

#include "bsdf.h"
#include "facet_interface.h"

namespace tr {

// (1 - cos)^5, the interpolation of Schlick, "An Inexpensive BRDF Model for Physically-based Rendering", 1994
template <class T>
TR_INLINE T schlick_weight(const T &cosine) {
    T m = max(T(1) - cosine, T(0)), m2 = m * m;
    return m2 * m2 * m;
}
template <class T>
TR_INLINE T mix(const T &a, const T &b, const T &t) {
    return a + (b - a) * t;
}

// Schlick's R0, reflectance at normal incidence.
template <class T>
TR_INLINE T schlick_r0(const T &eta) {
    T r = (eta - T(1)) / (eta + T(1));
    return r * r;
}

// The hue of a colour, the colour over its luminance (Burley 2012, section 5.3): white where it has none.
template <class T>
struct Hue {
    MaskOf<T> dark;
    T inverse;
    TR_INLINE explicit Hue(const T &luminance)
        : dark(!mask<T>(luminance > T(0))), inverse(T(1) / select(dark, T(1), luminance)) {}
    TR_INLINE T operator()(const T &color) const { return select(dark, T(1), color * inverse); }
};

// Diffuse reflection with its retro-reflection (Burley 2012, section 5.3), and its flat variant (2015, section 4.3), of
// cosines and Schlick's weights of both directions; `retro90` is 2 roughness cos_d^2.
template <class T, class M>
TR_INLINE T principled_diffuse(const T &ni, const T &no, const T &fi, const T &fo, const T &retro90, const T &flatness,
                               const M &possible) {
    T diffuse = (T(1) - T(0.5) * fi) * (T(1) - T(0.5) * fo) + retro90 * (fo + fi + fo * fi * (retro90 - T(1)));
    T flat90 = retro90 * T(0.5), sum = select(possible, ni + no, T(1));
    T flat = mix(T(1), flat90, fi) * mix(T(1), flat90, fo);
    return mix(diffuse, T(1.25) * (flat * (T(1) / sum - T(0.5)) + T(0.5)), flatness);
}

// GGX facets that are rougher along the tangent than across it: alpha / aspect and alpha aspect (Burley 2012, section
// 5.4). By their squares, so that neither roots nor more than one division have derivatives.
template <class T>
struct PrincipledAlpha {
    T square, narrow, wide;  // alpha^2, aspect^2 and its inverse

    TR_INLINE PrincipledAlpha(const T &roughness, const T &anisotropic) {
        using F = std::decay_t<decltype(value_of(roughness))>;
        narrow = at_least(T(1) - T(0.9) * anisotropic, F(0.1));
        wide = T(1) / narrow;
        T alpha = at_least(roughness * roughness, F(MinAlpha) * sqrt(value_of(wide)));
        square = alpha * alpha;
    }
};
template <class T>
TR_INLINE T ggx_density_along(const PrincipledAlpha<T> &alpha, const Vec3<T> &h, const T &inverse2) {
    T d = (alpha.narrow * (h.x * h.x) + alpha.wide * (h.y * h.y) + alpha.square * (h.z * h.z)) * inverse2;
    return alpha.square / (d * d * T(Pi));
}
template <class T>
TR_INLINE T spread2(const PrincipledAlpha<T> &alpha, const Vec3<T> &v) {
    return alpha.square * (alpha.wide * (v.x * v.x) + alpha.narrow * (v.y * v.y));
}
template <class F>
TR_INLINE Vec3<F> scaled_along(const PrincipledAlpha<F> &alpha, const Vec3<F> &v) {
    return {sqrt(alpha.square * alpha.wide) * v.x, sqrt(alpha.square * alpha.narrow) * v.y, v.z};
}
template <class T, class M>
TR_INLINE T density_along(const M &, const PrincipledAlpha<T> &alpha, const Vec3<T> &h, const T &inverse2) {
    return ggx_density_along(alpha, h, inverse2);
}
template <class T, class M>
TR_INLINE T masking_over_cosine(const M &, const PrincipledAlpha<T> &alpha, const Vec3<T> &v) {
    return ggx_masking_over_cosine(alpha, v);
}
template <class F, class M>
TR_INLINE Vec3<F> sample_visible_normal(const M &, const PrincipledAlpha<F> &alpha, const Vec3<F> &wi, const F &u1,
                                        const F &u2) {
    return sample_visible_ggx_normal(alpha, wi, u1, u2);
}

// The tail of the clear coat, "generalized Trowbridge-Reitz" with exponent 1: Burley 2012, appendix B.2.
struct CoatFacets {
    static constexpr double MaskingAlpha = 0.25;  // Burley's choice, whatever the gloss
    template <class T>
    TR_INLINE static T alpha(const T &gloss) {
        return mix(T(0.1), T(0.001), gloss);
    }
    template <class T>
    TR_INLINE static T density(const T &gloss, const T &cos2, const T &sin2) {
        T a = alpha(gloss), a2 = a * a;
        return (a2 - T(1)) / (log(a2) * (a2 * cos2 + sin2) * T(Pi));
    }
    // A normal of the density times its cosine.
    template <class F>
    TR_INLINE static Vec3<F> sample(const F &gloss, const F &u1, const F &u2) {
        F a = alpha(gloss), a2 = a * a, s, c;
        F sin2 = a2 * (exp((u2 - F(1)) * log(a2)) - F(1)) / (F(1) - a2);  // (a2^u - a2) / (1 - a2)
        sin2 = min(max(sin2, F(0)), F(1));
        F sine = sqrt(sin2);
        sincos(u1 * F(2 * Pi), s, c);
        return {sine * c, sine * s, sqrt(F(1) - sin2)};
    }
};

struct Principled {
    enum { BaseColor = 0 };  // of color[]
    enum Numbers {
        Roughness,
        Metallic,
        SpecTrans,
        Eta,
        Specular,
        SpecTint,
        Sheen,
        SheenTint,
        Flatness,
        Coat,
        CoatGloss,
        Anisotropic,
        DiffuseRate,
        SpecularRate,
        CoatRate,
        Luminance
    };  // of number[]
    static constexpr Field fields[] = {
        {"base_color", Kind::Texture, 0.5, 0, 1, "interior", "colour of the base, of metal and of tints"},
        {"roughness", Kind::Scalar, 0.5, 0, 1, "interior", "square root of the facets' alpha, which is at least 0.001"},
        {"metallic", Kind::Scalar, 0, 0, 1, "interior", "0: dielectric over a diffuse base, 1: metal"},
        {"spec_trans", Kind::Scalar, 0, 0, 1,
         "interior, without the light that would come through where it is 0; zero where it is larger",
         "0: opaque, 1: clear"},
        {"eta", Kind::Float, 0, 0, 1e3, "interior", "index of refraction inside over outside; 0: as `specular` says"},
        {"specular", Kind::Float, 0.5, 0, 1, "interior",
         "the index, as 12.5 times the reflectance at normal incidence; counts if there is no `eta`"},
        {"spec_tint", Kind::Scalar, 0, 0, 1, "interior", "how much of the base's hue reflections take on"},
        {"sheen", Kind::Scalar, 0, 0, 1, "interior", "reflection of cloth at grazing angles"},
        {"sheen_tint", Kind::Scalar, 0, 0, 1, "interior", "how much of the base's hue that takes on"},
        {"flatness", Kind::Scalar, 0, 0, 1, "interior", "0: diffuse, 1: the flatter look of light from below"},
        {"clearcoat", Kind::Scalar, 0, 0, 1, "interior", "a second reflection, of index 1.5"},
        {"clearcoat_gloss", Kind::Scalar, 0, 0, 1, "interior", "0: satin, 1: gloss"},
        {"anisotropic", Kind::Scalar, 0, 0, 1, "interior",
         "0: facets as rough along the tangent dp/du as across it, 1: ten times as rough along it"},
        {"diffuse_reflectance_sampling_rate", Kind::Float, 1, 0, INFINITY, "none: sampling has no derivative",
         "how often the base is sampled, relative to the other two"},
        {"main_specular_sampling_rate", Kind::Float, 1, 0, INFINITY, "none: sampling has no derivative",
         "how often the interface is sampled"},
        {"clearcoat_sampling_rate", Kind::Float, 1, 0, INFINITY, "none: sampling has no derivative",
         "how often the clear coat is sampled"},
    };
    static constexpr Model model = {"bsdf", "principled", "Principled BSDF of Burley.", fields, 16};
    static constexpr bool Smooth = true, Delta = false, Oriented = true;
    static constexpr int OrientedBy = 12;  // anisotropic
    static constexpr int Albedo = 0;
    static constexpr int LuminanceOf = 0;  // the base colour
    static constexpr bool Asymmetric = true;

    template <class T, class P>
    TR_INLINE static PrincipledAlpha<T> alpha(const P &params) {
        return {T(params.number[Roughness]), T(params.number[Anisotropic])};
    }
    // Schlick's R0 = ((eta - 1) / (eta + 1))^2 = 0.08 specular (Burley 2012, section 5.5), solved for eta.
    template <class T, class P>
    TR_INLINE static T index(const P &params) {
        T eta(params.number[Eta]), root = sqrt(max(T(params.number[Specular]) * T(0.08), T(0)));
        return usable_index(select(mask<T>(eta > T(0)), eta, T(2) / (T(1) - root) - T(1)));
    }

    template <int C, class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi_, const Vec3<F> &wo_, const IntOf<F> &,
                               Transport transport = Transport::Radiance) {
        using T = std::decay_t<decltype(params.number[0] * wi_.z)>;
        Vec3<T> wi = convert<T>(wi_), wo = convert<T>(wo_);
        auto number = [&](int i) { return T(params.number[i]); };
        T metallic = number(Metallic), dielectric = T(1) - metallic;
        T transparent = dielectric * number(SpecTrans), opaque = dielectric * (T(1) - number(SpecTrans));
        T ni = abs(wi.z), no = abs(wo.z);
        FacetInterface<T> facet(index<T>(params), wi, wo);
        auto front = facet.outside && facet.reflects;

        // the interface
        PrincipledAlpha<T> facets_alpha = alpha<T>(params);
        T fresnel = facet.fresnel();
        T facets = ggx_density_along(facets_alpha, facet.h, facet.inverse2) *
                   ggx_masking_over_cosine(facets_alpha, wi) * ggx_masking_over_cosine(facets_alpha, wo) * no;
        facets = select(facet.possible, facets, T(0));
        T mirrored = facets * T(0.25);
        T transmitted = transparent * (T(1) - fresnel) * facets * facet.stretch;
        if (transport == Transport::Importance) transmitted = transmitted * facet.eta * facet.eta;
        // Schlick's weight by the cosine on the side of the lower index
        T away = schlick_weight(select(mask<T>(facet.eta > T(1)), facet.ci, facet.ct));
        T hue_of_reflection = dielectric * number(SpecTint);
        T grey_of_reflection = select(front, dielectric * (T(1) - number(SpecTint)), transparent) * fresnel;
        T r0 = schlick_r0(facet.eta);

        // diffuse base, sheen, clear coat
        T fi = schlick_weight(ni), fo = schlick_weight(no);
        T retro90 = T(2) * number(Roughness) * facet.ci * facet.ci;
        T diffuse = principled_diffuse(ni, no, fi, fo, retro90, number(Flatness), facet.possible);
        T base = opaque * no * diffuse * T(1 / Pi);
        T grazing = schlick_weight(facet.ci);
        T sheen = number(Sheen) * dielectric * grazing * no;
        T coat_alpha(CoatFacets::MaskingAlpha);
        T coat = T(0.25) * number(Coat) * mix(T(0.04), T(1), grazing) *
                 CoatFacets::density(number(CoatGloss), facet.cos2, facet.sin2) *
                 (ggx_masking_over_cosine(coat_alpha, wi) * ni) * (ggx_masking_over_cosine(coat_alpha, wo) * no) * no;
        coat = select(facet.possible, coat, T(0));

        Hue<T> hue_of(number(Luminance));
        Color<T, C> result;
        for (int c = 0; c < C; ++c) {
            T color(params.color[BaseColor][c]), hue = hue_of(color);
            T reflected = grey_of_reflection + metallic * mix(color, T(1), away);
            reflected = reflected + hue_of_reflection * mix(hue * r0, T(1), away);
            T above = color * base + sheen * mix(T(1), hue, number(SheenTint)) + coat + reflected * mirrored;
            T below = sqrt(max(color, T(0))) * transmitted;
            T back = grey_of_reflection * mirrored;
            result[c] = select(front, above, select(facet.reflects, back, below));
        }
        return result;
    }

    // How often what is sampled: the interface and the base, on the front side; the rest is the clear coat.
    template <class F>
    struct Chances {
        F interface, base, coat, transparent;
        MaskOf<F> outside;

        template <class P>
        TR_INLINE Chances(const P &params, const Vec3<F> &wi) {
            auto number = [&](int i) { return min(max(params.number[i], F(0)), F(1)); };
            F dielectric = F(1) - number(Metallic);
            outside = mask<F>(!(wi.z < F(0)));
            transparent = dielectric * number(SpecTrans);
            interface = params.number[SpecularRate];
            base = dielectric * (F(1) - number(SpecTrans)) * params.number[DiffuseRate];
            coat = F(0.25) * number(Coat) * params.number[CoatRate];
            F sum = interface + base + coat;
            auto some = outside && mask<F>(sum > F(0));
            F inverse = F(1) / select(some, sum, F(1));
            interface = select(some, interface * inverse, F(1));
            base = select(some, base * inverse, F(0)), coat = select(some, coat * inverse, F(0));
        }
        // Of the facets' light, what is reflected: from the front all that cannot get through.
        TR_INLINE F reflected(const F &fresnel) const {
            return select(outside, F(1) - transparent * (F(1) - fresnel), fresnel);
        }
    };

    template <int C, class P, class F>
    TR_INLINE static F pdf(const P &params, const Vec3<F> &wi, const Vec3<F> &wo) {
        Chances<F> chance(params, wi);
        FacetInterface<F> facet(index<F>(params), wi, wo);
        PrincipledAlpha<F> a = alpha<F>(params);
        F reflected = chance.reflected(facet.fresnel());
        F facets = ggx_density_along(a, facet.h, facet.inverse2) * ggx_masking_over_cosine(a, wi) * chance.interface;
        F mirrored = facets * reflected * F(0.25);
        F refracted = facets * (F(1) - reflected) * facet.stretch * facet.eta * facet.eta;
        F coat = CoatFacets::density(params.number[CoatGloss], facet.cos2, facet.sin2) * sqrt(facet.cos2) /
                 (F(4) * facet.ci);
        F above = mirrored + chance.base * abs(wo.z) * F(1 / Pi) + chance.coat * coat;
        F r = select(facet.reflects, select(facet.outside, above, mirrored), refracted);
        return select(facet.possible, r, F(0));
    }

    template <int C, class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &u0, const F &u1, const F &u2) {
        Chances<F> chance(params, wi);
        Vec3<F> seen = select(chance.outside, wi, -wi);
        Vec3<F> m = sample_visible_ggx_normal(alpha<F>(params), seen, u1, u2);
        auto diffuse = mask<F>(!(u0 < chance.interface)) && mask<F>(u0 < chance.interface + chance.base);
        auto coat = mask<F>(!(u0 < chance.interface + chance.base));
        m = select(coat, CoatFacets::sample(params.number[CoatGloss], u1, u2), m);
        F cos_i = dot(seen, m);
        auto visible = mask<F>(cos_i > F(0));
        Fresnel<F> fresnel = fresnel_dielectric(mulsign(abs(cos_i), wi.z), index<F>(params));
        auto reflects = coat || diffuse || mask<F>(u0 < chance.interface * chance.reflected(fresnel.reflectance));
        BsdfSample<F> r;
        // below the horizon it is `seen` that reflects and refracts, with the facet's normal turned round
        m = select(chance.outside, m, -m);
        Vec3<F> along = wi - m * cos_i;
        Vec3<F> wo = m * select(reflects, cos_i, -abs(fresnel.cos_t)) - along * select(reflects, F(1), fresnel.eta_ti);
        r.wo = select(diffuse, square_to_cosine_hemisphere(u1, u2), normalize(wo));
        auto right_side = (diffuse || visible) && mask<F>(mulsign(select(reflects, r.wo.z, -r.wo.z), wi.z) > F(0));
        r.pdf = select(right_side, pdf<C>(params, wi, r.wo), F(0));
        r.eta = select(reflects, F(1), fresnel.eta_it);
        r.lobe = IntOf<F>(0);
        r.delta = r.null = MaskOf<F>(false);
        return r;
    }
};

}  // namespace tr
