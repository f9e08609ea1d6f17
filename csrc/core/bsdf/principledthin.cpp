// `principledthin`: the variant of `principled` for sheets without a volume: Burley, "Extending the Disney BRDF to a
// BSDF with Integrated Subsurface Scattering", SIGGRAPH 2015 course, section 5.3. Both sides look alike. Light goes
// through by diffuse transmission, and by microfacets that mirror it to the other side.
#include "../math/warp.h"
#include "kernels.h"
#include "principled_lobes.h"

namespace tr {

struct PrincipledThin {
    static constexpr Field fields[] = {
        {"base_color", Kind::Texture, 0.5, 0, 1, "interior", "colour of the sheet and of tints"},
        {"roughness", Kind::Scalar, 0.5, 0, 1, "interior",
         "square root of the microfacets' alpha, which is at least 0.001"},
        {"spec_trans", Kind::Scalar, 0, 0, 1,
         "interior, without the light that would come through where it is 0; zero where it is larger",
         "0: diffuse, 1: microfacets that reflect and let through", nullptr, Optional},
        {"eta", Kind::Scalar, 1.5, 1e-3, 1e3, "interior", "index of refraction of the sheet over that around it"},
        {"spec_tint", Kind::Scalar, 0, 0, 1, "interior", "how much of the base's hue reflections take on", nullptr,
         Optional},
        {"sheen", Kind::Scalar, 0, 0, 1, "interior", "reflection of cloth at grazing angles", nullptr, Optional},
        {"sheen_tint", Kind::Scalar, 0, 0, 1, "interior", "how much of the base's hue that takes on", nullptr,
         Optional},
        {"flatness", Kind::Scalar, 0, 0, 1, "interior", "0: diffuse, 1: the flatter look of light from below", nullptr,
         Optional},
        {"diff_trans", Kind::Scalar, 0, 0, 2,
         "interior, without the light that would come through where it is 0; zero where it is larger",
         "twice the part of diffuse light that goes through", nullptr, Optional},
        {"anisotropic", Kind::Scalar, 0, 0, 1, "interior",
         "0: microfacets as rough along the tangent dp/du as across it, 1: ten times as rough along it", nullptr,
         Optional | FollowsTangent},
        {"specular_reflectance_sampling_rate", Kind::Float, 1, 0, INFINITY, "none: sampling has no derivative",
         "how often reflection off microfacets is sampled, relative to the others"},
        {"diffuse_reflectance_sampling_rate", Kind::Float, 1, 0, INFINITY, "none: sampling has no derivative",
         "how often diffuse reflection is sampled"},
        {"specular_transmittance_sampling_rate", Kind::Float, 1, 0, INFINITY, "none: sampling has no derivative",
         "how often transmission through microfacets is sampled"},
        {"diffuse_transmittance_sampling_rate", Kind::Float, 1, 0, INFINITY, "none: sampling has no derivative",
         "how often diffuse transmission is sampled"},
    };
    static constexpr int BaseColor = color_index(fields, "base_color");
    static constexpr int Roughness = number_index(fields, "roughness");
    static constexpr int SpecTrans = number_index(fields, "spec_trans");
    static constexpr int Eta = number_index(fields, "eta");
    static constexpr int SpecTint = number_index(fields, "spec_tint");
    static constexpr int Sheen = number_index(fields, "sheen");
    static constexpr int SheenTint = number_index(fields, "sheen_tint");
    static constexpr int Flatness = number_index(fields, "flatness");
    static constexpr int DiffTrans = number_index(fields, "diff_trans");
    static constexpr int Anisotropic = number_index(fields, "anisotropic");
    static constexpr int SpecularReflected = number_index(fields, "specular_reflectance_sampling_rate");
    static constexpr int DiffuseReflected = number_index(fields, "diffuse_reflectance_sampling_rate");
    static constexpr int SpecularTransmitted = number_index(fields, "specular_transmittance_sampling_rate");
    static constexpr int DiffuseTransmitted = number_index(fields, "diffuse_transmittance_sampling_rate");
    static constexpr int Luminance = DiffuseTransmitted + 1;  // behind the fields' numbers
    static constexpr Model model = {"bsdf",
                                    "principledthin",
                                    "Principled BSDF of a thin sheet.",
                                    fields,
                                    14,
                                    HasSmoothLobes | FollowsTangent | Transmits | ChoosesLobe,
                                    "PrincipledThin"};
    static constexpr int Albedo = field_index(fields, "base_color");
    static constexpr int LuminanceOf = Albedo;

    // What is seen through microfacets looks as rough as if they refracted it (2015, section 5.3).
    template <class T, class P>
    TR_INLINE static PrincipledAlpha<T> alpha(const P &params, const T &eta, const MaskOf<T> &through) {
        T roughness(params.number[Roughness]);
        T r = select(through, roughness * (T(0.65) * eta - T(0.35)), roughness);
        return {r, T(params.number[Anisotropic])};
    }
    // Both directions above the sheet.
    template <class T>
    TR_INLINE static Vec3<T> upper(const Vec3<T> &v) {
        return {v.x, v.y, abs(v.z)};
    }
    template <class T>
    TR_INLINE static auto goes_through(const Vec3<T> &wi, const Vec3<T> &wo) {
        using F = std::decay_t<decltype(value_of(wi.z))>;
        return mask<F>(mulsign(value_of(wo.z), value_of(wi.z)) < F(0));
    }

    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi_, const Vec3<F> &wo_, const IntOf<F> &) {
        using T = std::decay_t<decltype(params.number[0] * wi_.z)>;
        using V = std::decay_t<decltype(value_of(std::declval<T>()))>;
        auto number = [&](int i) { return T(params.number[i]); };
        Vec3<T> wi = upper(convert<T>(wi_)), wo = upper(convert<T>(wo_));
        auto through = goes_through(wi_, wo_);
        MaskOf<V> all(true);
        T eta = max(number(Eta), T(1e-3));
        PrincipledAlpha<T> a = alpha(params, eta, through);
        FacetReflection<T> facet(all, a, wi, wo);
        T facets = number(SpecTrans) * facet.density * (facet.shadowing(all, a, wo) * T(0.25));
        facets = select(facet.possible, facets, T(0));
        // The microfacet's far side has to be seen from where light comes out, although it is a mirror that sends it
        // there: so it is in Mitsuba.
        V along = value_of(facet.cosine) * V(2), up = (value_of(wi.z) + value_of(wo.z)) / max(along, V(1e-20));
        T transmitted = select(mask<V>(value_of(facet.cosine) < V(2) * value_of(wo.z) * up), facets, T(0));
        T fresnel = fresnel_dielectric(facet.cosine, eta).reflectance;
        T r0 = schlick_r0(eta), away = schlick_weight(facet.cosine);

        T retro90 = T(2) * number(Roughness) * facet.cosine * facet.cosine;
        T fi = schlick_weight(wi.z), fo = schlick_weight(wo.z);
        T diffuse = principled_diffuse(wi.z, wo.z, fi, fo, retro90, number(Flatness), facet.possible);
        T opaque = (T(1) - number(SpecTrans)) * wo.z, part = number(DiffTrans) * T(0.5);
        T back = opaque * part * T(1 / Pi), front = opaque * (T(1) - part) * diffuse * T(1 / Pi);
        T sheen = number(Sheen) * opaque * (T(1) - part) * away;

        Hue<T> hue_of(number(Luminance));
        Spectrum<T> result;
        for (int c = 0; c < SpectrumSize; ++c) {
            T color(params.color[BaseColor][c]), hue = hue_of(color);
            T reflected = mix(fresnel, mix(hue * r0, T(1), away), number(SpecTint)) * facets;
            T above = color * front + sheen * mix(T(1), hue, number(SheenTint)) + reflected;
            T below = color * (back + (T(1) - fresnel) * transmitted);
            result[c] = select(facet.possible, select(through, below, above), T(0));
        }
        return result;
    }

    // Of the four ways the chances, by Fresnel's reflectance of the sheet itself.
    template <class F>
    struct LobeProbabilities {
        F mirrored, transmitted, diffuse, through;

        template <class P>
        TR_INLINE LobeProbabilities(const P &params, const Vec3<F> &wi) {
            auto share = [&](int i, double most) { return min(max(params.number[i], F(0)), F(most)) * F(1 / most); };
            F eta = max(params.number[Eta], F(1e-3));
            F r = min(max(fresnel_dielectric(abs(wi.z), eta).reflectance, F(0.1)), F(0.9));
            F facets = share(SpecTrans, 1), part = share(DiffTrans, 2);
            mirrored = facets * r * params.number[SpecularReflected];
            transmitted = facets * (F(1) - r) * params.number[SpecularTransmitted];
            diffuse = (F(1) - facets) * (F(1) - part) * params.number[DiffuseReflected];
            through = (F(1) - facets) * part * params.number[DiffuseTransmitted];
            F sum = mirrored + transmitted + diffuse + through;
            auto some = mask<F>(sum > F(0));
            F inverse = F(1) / select(some, sum, F(1));
            mirrored = mirrored * inverse, transmitted = transmitted * inverse, through = through * inverse;
            diffuse = select(some, diffuse * inverse, F(1));
        }
    };

    template <class P, class F>
    TR_INLINE static F pdf(const P &params, const Vec3<F> &wi, const Vec3<F> &wo) {
        LobeProbabilities<F> chance(params, wi);
        auto through = goes_through(wi, wo);
        MaskOf<F> all(true);
        FacetReflection<F> facet(all, alpha(params, params.number[Eta], through), upper(wi), upper(wo));
        F facets = select(through, chance.transmitted, chance.mirrored) * facet.density * F(0.25);
        F diffuse = select(through, chance.through, chance.diffuse) * abs(wo.z) * F(1 / Pi);
        return select(facet.possible, facets + diffuse, F(0));
    }

    template <class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &u0, const F &u1, const F &u2) {
        LobeProbabilities<F> chance(params, wi);
        F before = chance.mirrored + chance.transmitted;
        auto facets = mask<F>(u0 < before);
        auto through = (facets && mask<F>(!(u0 < chance.mirrored))) || mask<F>(!(u0 < before + chance.diffuse));
        MaskOf<F> all(true);
        PrincipledAlpha<F> a = alpha(params, params.number[Eta], through);
        Vec3<F> mirrored = sample_facet_reflection(all, a, upper(wi), u1, u2);
        Vec3<F> wo = select(facets, mirrored, square_to_cosine_hemisphere(u1, u2));
        auto above = mask<F>(wo.z > F(0));
        wo.z = mulsign(select(through, -wo.z, wo.z), wi.z);
        BsdfSample<F> r;
        r.wo = wo;
        r.pdf = select(above, pdf(params, wi, wo), F(0));
        r.eta = F(1);
        r.lobe = IntOf<F>(0);
        r.delta = MaskOf<F>(false);
        return r;
    }
};

TR_BSDF(PrincipledThin)

}  // namespace tr
