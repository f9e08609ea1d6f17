// `dielectric`: a smooth interface between two transparent media. Lobe 0 reflects, lobe 1 refracts.
#include "../math/fresnel.h"
#include "kernels.h"

namespace tr {

struct Dielectric {
    static constexpr Field fields[] = {
        {"eta", Kind::Float, 1.5046 / 1.000277, 1e-3, 1e3,
         "interior, without the motion of edges seen through the surface; zero where there are none or both sides of "
         "them are of equal colour",
         "index of refraction inside (below the surface) over outside"},
        {"specular_reflectance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical", nullptr, Optional},
        {"specular_transmittance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical", nullptr, Optional},
    };
    static constexpr int Eta = number_index(fields, "eta");
    static constexpr int Reflectance = color_index(fields, "specular_reflectance"),
                         Transmittance = color_index(fields, "specular_transmittance");
    static constexpr Model model = {"bsdf",
                                    "dielectric",
                                    "Smooth dielectric interface.",
                                    fields,
                                    3,
                                    HasDeltaLobes | Transmits | IsAsymmetric | ChoosesLobe};
    static constexpr int Albedo = field_index(fields, "specular_transmittance");  // what goes through is most of it
    static constexpr Polarization Polarizes = Polarization::Interface;

    // Radiance is divided by the squared relative index when it enters the denser side (solid angles shrink): Veach,
    // "Robust Monte Carlo Methods for Light Transport Simulation", 1997, section 5.2.
    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi, const Vec3<F> &, const IntOf<F> &lobe,
                               Transport transport = Transport::Radiance) {
        using T = std::decay_t<decltype(params.number[Eta] * wi.z)>;
        Fresnel<T> fresnel = fresnel_dielectric(T(wi.z), T(params.number[Eta]));
        T scale = transport == Transport::Radiance ? fresnel.eta_ti * fresnel.eta_ti : T(F(1));
        T transmitted = (T(F(1)) - fresnel.reflectance) * scale;
        auto reflect = mask<F>(lobe == 0);
        return select(reflect, params.color[Reflectance] * fresnel.reflectance,
                      params.color[Transmittance] * transmitted);
    }

    template <class P, class F>
    TR_INLINE static F pdf(const P &, const Vec3<F> &, const Vec3<F> &) {
        return F(0);
    }

    template <class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &u0, const F &, const F &) {
        Fresnel<F> fresnel = fresnel_dielectric(wi.z, params.number[Eta]);
        auto reflect = mask<F>(u0 < fresnel.reflectance);
        BsdfSample<F> r;
        r.pdf = select(reflect, fresnel.reflectance, F(1) - fresnel.reflectance);
        r.eta = select(reflect, F(1), fresnel.eta_it);
        r.lobe = select(mask<IntOf<F>>(reflect), IntOf<F>(0), IntOf<F>(1));
        r.wo = direction(params, wi, r.lobe);
        r.delta = MaskOf<F>(true);
        return r;
    }

    // Reflection, or Snell's law. The numbers of `params` may be dual numbers like wi.
    template <class P, class T>
    TR_INLINE static Vec3<T> direction(const P &params, const Vec3<T> &wi, const IntOf<T> &lobe) {
        Fresnel<T> fresnel = fresnel_dielectric(wi.z, T(params.number[Eta]));
        auto reflect = mask<T>(lobe == 0);
        return select(reflect, Vec3<T>{-wi.x, -wi.y, wi.z},
                      Vec3<T>{-fresnel.eta_ti * wi.x, -fresnel.eta_ti * wi.y, fresnel.cos_t});
    }
};

// The boundary of a medium whose index of refraction varies, inside of which `eta` is what it is there: see
// load_parameters. Of the radiance there paths carry L / n^2, which nothing changes.
struct GradientDielectric : Dielectric {
    static constexpr bool Bent = true;
    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi, const Vec3<F> &wo, const IntOf<F> &lobe,
                               Transport = Transport::Radiance) {
        return Dielectric::eval(params, wi, wo, lobe, Transport::Importance);
    }
};

TR_BSDF(Dielectric)
TR_BSDF(GradientDielectric)

}  // namespace tr
