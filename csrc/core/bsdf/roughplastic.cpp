// `roughplastic`: a rough dielectric coating over a diffuse base. The coating reflects like `roughdielectric`; what it
// lets through, either way, depends on the cosine, its index and its roughness by an integral over its microfacets, of
// which the host makes a table (host/rough_transmittance.h).
#include "../math/fresnel.h"
#include "coating.h"
#include "kernels.h"
#include "rough_transmittance.h"

namespace tr {

struct RoughPlastic {
    static constexpr Field fields[] = {
        {"eta", Kind::Float, 1.49 / 1.000277, 1e-3, 1e3, "interior",
         "index of refraction inside (below the surface) over outside"},
        {"alpha", Kind::Float, 0.1, 0, 10, "interior",
         "roughness of the microfacet distribution; below 0.001 it counts as that"},
        {"diffuse_reflectance", Kind::Texture, 0.5, 0, 1, "interior", "albedo of the base"},
        {"specular_reflectance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical", nullptr, Optional},
        {"distribution", Kind::Int, 0, 0, 1, "", "of the microfacets' normals", MicrofacetDistributions},
        {"nonlinear", Kind::Int, 0, 0, 1, "", "whether colours deepen with every reflection inside", Boolean},
    };
    static constexpr int Eta = number_index(fields, "eta"), Alpha = number_index(fields, "alpha");
    static constexpr int Diffuse = color_index(fields, "diffuse_reflectance"),
                         Specular = color_index(fields, "specular_reflectance");
    static constexpr int Distribution = choice_index(fields, "distribution"),
                         Nonlinear = choice_index(fields, "nonlinear");
    static constexpr Model model = {
        "bsdf", "roughplastic", "Rough plastic, one-sided.", fields, 6, HasSmoothLobes | ChoosesLobe, "RoughPlastic"};
    static constexpr int Albedo = field_index(fields, "diffuse_reflectance");
    static constexpr Polarization Polarizes = Polarization::Coat;
    static constexpr bool Tabulated = true;  // of what the coating lets through, see rough_transmittance.h

    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi_, const Vec3<F> &wo_, const IntOf<F> &lobe) {
        using T = std::decay_t<decltype(params.number[Eta] * wi_.z)>;
        using V = std::decay_t<decltype(value_of(std::declval<T>()))>;
        Vec3<T> wi = convert<T>(wi_), wo = convert<T>(wo_);
        auto facets = is_ggx<F>(params.choice[Distribution]);
        auto nonlinear = mask<V>(params.choice[Nonlinear] != 0);
        T alpha = clamp_alpha(T(params.number[Alpha])), eta(params.number[Eta]);
        FacetReflection<T> r(facets, alpha, wi, wo);
        T mirrored =
            r.density * (r.shadowing(facets, alpha, wo) * T(0.25)) * fresnel_dielectric(r.cosine, eta).reflectance;
        RoughTransmittance<T> table{params.table, params.row, eta, alpha, r.possible};
        T through = table.transmittance(wi.z) * table.transmittance(wo.z) * wo.z / (eta * eta * T(Pi));
        T internal = table.internal_reflectance();
        choose_lobe(lobe, mirrored, through);
        Spectrum<T> result;
        for (int c = 0; c < SpectrumSize; ++c) {
            T base = coated_albedo(T(params.color[Diffuse][c]), internal, nonlinear) * through;
            result[c] = select(r.possible, T(params.color[Specular][c]) * mirrored + base, T(0));
        }
        return result;
    }

    template <class P, class F>
    TR_INLINE static F specular_weight(const P &params, const F &cosine) {
        RoughTransmittance<F> table{params.table, params.row, params.number[Eta], params.number[Alpha],
                                    mask<F>(cosine > F(0))};
        return specular_sampling_weight(F(1) - table.transmittance(cosine), params.color[Specular],
                                        params.color[Diffuse]);
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

TR_BSDF(RoughPlastic)

}  // namespace tr
