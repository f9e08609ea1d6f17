// `principled`: Burley, "Physically Based Shading at Disney", SIGGRAPH 2012 course, and "Extending the Disney BRDF to a
// BSDF with Integrated Subsurface Scattering", SIGGRAPH 2015 course: a diffuse base with retro-reflection, sheen, a
// rough interface that is dielectric or metallic, and a clear coat. The microfacets of the interface are those of
// `roughdielectric` with GGX; what makes it transparent, metallic or tinted is how much of them reflects.
#include "../math/warp.h"
#include "kernels.h"
#include "principled_lobes.h"

namespace tr {

struct Principled {
    static constexpr Field fields[] = {
        {"base_color", Kind::Texture, 0.5, 0, 1, "interior", "colour of the base, of metal and of tints"},
        {"roughness", Kind::Scalar, 0.5, 0, 1, "interior",
         "square root of the microfacets' alpha, which is at least 0.001"},
        {"metallic", Kind::Scalar, 0, 0, 1, "interior", "0: dielectric over a diffuse base, 1: metal", nullptr,
         Optional},
        {"spec_trans", Kind::Scalar, 0, 0, 1,
         "interior, without the light that would come through where it is 0; zero where it is larger",
         "0: opaque, 1: clear", nullptr, Optional | Transmits},
        {"eta", Kind::Float, 0, 0, 1e3, "interior", "index of refraction inside over outside; 0: as `specular` says",
         nullptr, Optional},
        {"specular", Kind::Float, 0.5, 0, 1, "interior",
         "the index, as 12.5 times the reflectance at normal incidence; counts if there is no `eta`", nullptr,
         Optional},
        {"spec_tint", Kind::Scalar, 0, 0, 1, "interior", "how much of the base's hue reflections take on", nullptr,
         Optional},
        {"sheen", Kind::Scalar, 0, 0, 1, "interior", "reflection of cloth at grazing angles", nullptr, Optional},
        {"sheen_tint", Kind::Scalar, 0, 0, 1, "interior", "how much of the base's hue that takes on", nullptr,
         Optional},
        {"flatness", Kind::Scalar, 0, 0, 1, "interior", "0: diffuse, 1: the flatter look of light from below", nullptr,
         Optional},
        {"clearcoat", Kind::Scalar, 0, 0, 1, "interior", "a second reflection, of index 1.5", nullptr, Optional},
        {"clearcoat_gloss", Kind::Scalar, 0, 0, 1, "interior", "0: satin, 1: gloss", nullptr, Optional},
        {"anisotropic", Kind::Scalar, 0, 0, 1, "interior",
         "0: microfacets as rough along the tangent dp/du as across it, 1: ten times as rough along it", nullptr,
         Optional | FollowsTangent},
        {"diffuse_reflectance_sampling_rate", Kind::Float, 1, 0, INFINITY, "none: sampling has no derivative",
         "how often the base is sampled, relative to the other two"},
        {"main_specular_sampling_rate", Kind::Float, 1, 0, INFINITY, "none: sampling has no derivative",
         "how often the interface is sampled"},
        {"clearcoat_sampling_rate", Kind::Float, 1, 0, INFINITY, "none: sampling has no derivative",
         "how often the clear coat is sampled"},
    };
    static constexpr int BaseColor = color_index(fields, "base_color");
    static constexpr int Roughness = number_index(fields, "roughness");
    static constexpr int Metallic = number_index(fields, "metallic");
    static constexpr int SpecTrans = number_index(fields, "spec_trans");
    static constexpr int Eta = number_index(fields, "eta");
    static constexpr int Specular = number_index(fields, "specular");
    static constexpr int SpecTint = number_index(fields, "spec_tint");
    static constexpr int Sheen = number_index(fields, "sheen");
    static constexpr int SheenTint = number_index(fields, "sheen_tint");
    static constexpr int Flatness = number_index(fields, "flatness");
    static constexpr int Coat = number_index(fields, "clearcoat");
    static constexpr int CoatGloss = number_index(fields, "clearcoat_gloss");
    static constexpr int Anisotropic = number_index(fields, "anisotropic");
    static constexpr int DiffuseRate = number_index(fields, "diffuse_reflectance_sampling_rate");
    static constexpr int SpecularRate = number_index(fields, "main_specular_sampling_rate");
    static constexpr int CoatRate = number_index(fields, "clearcoat_sampling_rate");
    static constexpr int Luminance = CoatRate + 1;  // behind the fields' numbers
    static constexpr Model model = {
        "bsdf", "principled", "Principled BSDF of Burley.",
        fields, 16,           HasSmoothLobes | FollowsTangent | Transmits | IsAsymmetric | ChoosesLobe};
    static constexpr int Albedo = field_index(fields, "base_color");
    static constexpr int LuminanceOf = Albedo;

    template <class T, class P>
    TR_INLINE static PrincipledAlpha<T> alpha(const P &params) {
        return {T(params.number[Roughness]), T(params.number[Anisotropic])};
    }
    // Schlick's R0 = ((eta - 1) / (eta + 1))^2 = 0.08 specular (Burley 2012, section 5.5), solved for eta.
    template <class T, class P>
    TR_INLINE static T index(const P &params) {
        T eta(params.number[Eta]), root = sqrt(max(T(params.number[Specular]) * T(0.08), T(0)));
        return clamp_eta(select(mask<T>(eta > T(0)), eta, T(2) / (T(1) - root) - T(1)));
    }

    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi_, const Vec3<F> &wo_, const IntOf<F> &,
                               Transport transport = Transport::Radiance) {
        using T = std::decay_t<decltype(params.number[0] * wi_.z)>;
        Vec3<T> wi = convert<T>(wi_), wo = convert<T>(wo_);
        auto number = [&](int i) { return T(params.number[i]); };
        T metallic = number(Metallic), dielectric = T(1) - metallic;
        T transparent = dielectric * number(SpecTrans), opaque = dielectric * (T(1) - number(SpecTrans));
        T ni = abs(wi.z), no = abs(wo.z);
        DielectricMicrofacet<T> facet(index<T>(params), wi, wo);
        auto front = facet.outside && facet.reflects;

        // the interface
        PrincipledAlpha<T> facets_alpha = alpha<T>(params);
        T fresnel = facet.fresnel();
        T facets = ggx_distribution_of(facets_alpha, facet.h, facet.inverse2) *
                   ggx_smith_g1_over_cos(facets_alpha, wi) * ggx_smith_g1_over_cos(facets_alpha, wo) * no;
        facets = select(facet.possible, facets, T(0));
        T mirrored = facets * T(0.25);
        T transmitted = transparent * (T(1) - fresnel) * facets * facet.refraction;
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
                 (ggx_smith_g1_over_cos(coat_alpha, wi) * ni) * (ggx_smith_g1_over_cos(coat_alpha, wo) * no) * no;
        coat = select(facet.possible, coat, T(0));

        Hue<T> hue_of(number(Luminance));
        Spectrum<T> result;
        for (int c = 0; c < SpectrumSize; ++c) {
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
    struct LobeProbabilities {
        F interface, base, coat, transparent;
        MaskOf<F> outside;

        template <class P>
        TR_INLINE LobeProbabilities(const P &params, const Vec3<F> &wi) {
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
        // Of the microfacets' light, what is reflected: from the front all that cannot get through.
        TR_INLINE F reflected(const F &fresnel) const {
            return select(outside, F(1) - transparent * (F(1) - fresnel), fresnel);
        }
    };

    template <class P, class F>
    TR_INLINE static F pdf(const P &params, const Vec3<F> &wi, const Vec3<F> &wo) {
        LobeProbabilities<F> chance(params, wi);
        DielectricMicrofacet<F> facet(index<F>(params), wi, wo);
        PrincipledAlpha<F> a = alpha<F>(params);
        F reflected = chance.reflected(facet.fresnel());
        F facets = ggx_distribution_of(a, facet.h, facet.inverse2) * ggx_smith_g1_over_cos(a, wi) * chance.interface;
        F mirrored = facets * reflected * F(0.25);
        F refracted = facets * (F(1) - reflected) * facet.refraction * facet.eta * facet.eta;
        F coat = CoatFacets::density(params.number[CoatGloss], facet.cos2, facet.sin2) * sqrt(facet.cos2) /
                 (F(4) * facet.ci);
        F above = mirrored + chance.base * abs(wo.z) * F(1 / Pi) + chance.coat * coat;
        F r = select(facet.reflects, select(facet.outside, above, mirrored), refracted);
        return select(facet.possible, r, F(0));
    }

    template <class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &u0, const F &u1, const F &u2) {
        LobeProbabilities<F> chance(params, wi);
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
        // below the horizon it is `seen` that reflects and refracts, with the microfacet's normal turned round
        m = select(chance.outside, m, -m);
        Vec3<F> along = wi - m * cos_i;
        Vec3<F> wo = m * select(reflects, cos_i, -abs(fresnel.cos_t)) - along * select(reflects, F(1), fresnel.eta_ti);
        r.wo = select(diffuse, square_to_cosine_hemisphere(u1, u2), normalize(wo));
        auto right_side = (diffuse || visible) && mask<F>(mulsign(select(reflects, r.wo.z, -r.wo.z), wi.z) > F(0));
        r.pdf = select(right_side, pdf(params, wi, r.wo), F(0));
        r.eta = select(reflects, F(1), fresnel.eta_it);
        r.lobe = IntOf<F>(0);
        r.delta = MaskOf<F>(false);
        return r;
    }
};

TR_BSDF(Principled)

}  // namespace tr
