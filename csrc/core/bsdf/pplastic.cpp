// `pplastic`: the plastic of Baek, Jeon, Tong and Kim, "Simultaneous Acquisition of Polarimetric SVBRDF and Normals",
// TOG 2018: rough reflection off the surface as of `roughdielectric`, and beside it a diffuse lobe that is transmitted
// through the smooth interface on its way in and on its way out (equations 10 and 14). Light that the interface throws
// back inside is left out, and so is the change of solid angles, as in Mitsuba 3.
#include "../math/fresnel.h"
#include "coating.h"
#include "kernels.h"

namespace tr {

struct PolarimetricPlastic {
    static constexpr Field fields[] = {
        {"eta", Kind::Float, 1.49 / 1.000277, 1e-3, 1e3, "interior",
         "index of refraction inside (below the surface) over outside"},
        {"alpha", Kind::Scalar, 0.1, 0, 10, "interior",
         "roughness of the microfacet distribution; below 0.001 it counts as that"},
        {"diffuse_reflectance", Kind::Texture, 0.5, 0, 1, "interior", "albedo of the diffuse lobe below the interface"},
        {"specular_reflectance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical", nullptr, Optional},
        {"distribution", Kind::Int, 0, 0, 1, "", "of the microfacets' normals", MicrofacetDistributions},
    };
    static constexpr int Eta = number_index(fields, "eta"), Alpha = number_index(fields, "alpha");
    static constexpr int Diffuse = color_index(fields, "diffuse_reflectance"),
                         Specular = color_index(fields, "specular_reflectance");
    static constexpr int Distribution = choice_index(fields, "distribution");
    static constexpr Model model = {"bsdf",    "pplastic", "Plastic of polarimetric acquisition, one-sided.",
                                    fields,    5,          HasSmoothLobes | ChoosesLobe,
                                    "PPlastic"};
    static constexpr int Albedo = field_index(fields, "diffuse_reflectance");
    static constexpr Polarization Polarizes = Polarization::Coat;

    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi_, const Vec3<F> &wo_, const IntOf<F> &lobe) {
        using T = std::decay_t<decltype(params.number[Eta] * wi_.z)>;
        Vec3<T> wi = convert<T>(wi_), wo = convert<T>(wo_);
        auto ggx = is_ggx<F>(params.choice[Distribution]);
        T alpha = clamp_alpha(T(params.number[Alpha])), eta(params.number[Eta]);
        FacetReflection<T> r(ggx, alpha, wi, wo);
        T mirrored =
            r.density * (r.shadowing(ggx, alpha, wo) * T(0.25)) * fresnel_dielectric(r.cosine, eta).reflectance;
        T in = T(1) - fresnel_dielectric(wi.z, eta).reflectance, out = T(1) - fresnel_dielectric(wo.z, eta).reflectance;
        T through = in * out * wo.z * T(1 / Pi);
        choose_lobe(lobe, mirrored, through);
        Spectrum<T> result;
        for (int c = 0; c < SpectrumSize; ++c)
            result[c] = select(r.possible,
                               T(params.color[Specular][c]) * mirrored + T(params.color[Diffuse][c]) * through, T(0));
        return result;
    }

    template <class P, class F>
    TR_INLINE static F specular_weight(const P &params, const F &cosine) {
        return specular_sampling_weight(fresnel_dielectric(cosine, params.number[Eta]).reflectance,
                                        params.color[Specular], params.color[Diffuse]);
    }
    template <class P, class F>
    TR_INLINE static F pdf(const P &params, const Vec3<F> &wi, const Vec3<F> &wo) {
        return rough_or_diffuse_pdf(is_ggx<F>(params.choice[Distribution]), clamp_alpha(params.number[Alpha]),
                                    specular_weight(params, wi.z), wi, wo);
    }
    template <class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &u0, const F &u1, const F &u2) {
        return sample_rough_or_diffuse(is_ggx<F>(params.choice[Distribution]), clamp_alpha(params.number[Alpha]),
                                       specular_weight(params, wi.z), wi, u0, u1, u2);
    }
};

TR_BSDF(PolarimetricPlastic)

}  // namespace tr
