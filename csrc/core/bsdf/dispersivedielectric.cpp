// `dispersivedielectric`: a smooth interface whose index of refraction depends on the wavelength. Lobe 0 reflects all
// wavelengths of a path, each with its own Fresnel reflectance. Refraction splits them: the first goes on and counts
// for all. That is unbiased because the first is equally likely to be each of the three, and it needs no word in what
// comes after: of the others nothing is left. (Wilkie et al., "Hero Wavelength Spectral Sampling", EGSR 2014,
// section 3.2.)
#include "../math/fresnel.h"
#include "kernels.h"

namespace tr {

struct DispersiveDielectric {
    static constexpr Field fields[] = {
        {"eta", Kind::Texture, 1.5046 / 1.000277, 1e-3, 1e3,
         "interior, without the motion of edges seen through the surface; zero where there are none or both sides of "
         "them are of equal colour",
         "index of refraction inside (below the surface) over outside, by wavelength"},
        {"specular_reflectance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical", nullptr, Optional},
        {"specular_transmittance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical", nullptr, Optional},
    };
    static constexpr int TurnedBy = field_index(fields, "eta");
    static constexpr int Eta = color_index(fields, "eta"), Reflectance = color_index(fields, "specular_reflectance"),
                         Transmittance = color_index(fields, "specular_transmittance");
    static constexpr Model model = {"bsdf",
                                    "dispersivedielectric",
                                    "Smooth dielectric interface that disperses.",
                                    fields,
                                    3,
                                    HasDeltaLobes | Transmits | IsAsymmetric | Disperses | ChoosesLobe,
                                    "DispersiveDielectric"};
    static constexpr int Albedo = field_index(fields, "specular_transmittance");
    static constexpr Polarization Polarizes = Polarization::Interface;

    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi, const Vec3<F> &, const IntOf<F> &lobe,
                               Transport transport = Transport::Radiance) {
        using T = std::decay_t<decltype(params.color[Eta][0] * wi.z)>;
        const auto all = mask<F>(lobe == RefractsAll), reflect = mask<F>(lobe == 0);
        const F first = select(mask<F>(lobe == RefractsFirst), F(ScalarOf<F>(SpectrumSize)), F(1));
        Spectrum<T> reflected, transmitted;
        for (int c = 0; c < SpectrumSize; ++c) {
            Fresnel<T> fresnel = fresnel_dielectric(T(wi.z), T(params.color[Eta][c]));
            T scale = transport == Transport::Radiance ? fresnel.eta_ti * fresnel.eta_ti : T(F(1));
            const F share = c == 0 ? first : select(all, F(1), F(0));
            reflected[c] = params.color[Reflectance][c] * fresnel.reflectance;
            transmitted[c] = params.color[Transmittance][c] * ((T(F(1)) - fresnel.reflectance) * scale * T(share));
        }
        return select(reflect, reflected, transmitted);
    }

    template <class P, class F>
    TR_INLINE static F pdf(const P &, const Vec3<F> &, const Vec3<F> &) {
        return F(0);
    }

    // One of three wavelengths may be reflected totally while others are not: what they have in common decides.
    template <class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &u0, const F &, const F &) {
        Fresnel<F> first = fresnel_dielectric(wi.z, params.color[Eta][0]);
        F mean = first.reflectance;
        for (int c = 1; c < SpectrumSize; ++c) mean = mean + fresnel_dielectric(wi.z, params.color[Eta][c]).reflectance;
        mean = mean * F(ScalarOf<F>(1.0 / SpectrumSize));
        const F probability = select(mask<F>(params.refraction == RefractsFirst), mean, first.reflectance);
        const auto reflect = mask<F>(u0 < probability);
        BsdfSample<F> r;
        r.pdf = select(reflect, probability, F(1) - probability);
        r.eta = select(reflect, F(1), first.eta_it);
        r.lobe = select(mask<IntOf<F>>(reflect), IntOf<F>(0), params.refraction);
        r.wo = turned(params.color[Eta][0], wi, r.lobe);
        r.delta = MaskOf<F>(true);
        return r;
    }

    template <class P, class T>
    TR_INLINE static Vec3<T> direction(const P &params, const Vec3<T> &wi, const IntOf<T> &lobe) {
        return turned(T(params.number[0]), wi, lobe);
    }

private:
    template <class T>
    TR_INLINE static Vec3<T> turned(const T &eta, const Vec3<T> &wi, const IntOf<T> &lobe) {
        Fresnel<T> fresnel = fresnel_dielectric(wi.z, eta);
        auto reflect = mask<T>(lobe == 0);
        return select(reflect, Vec3<T>{-wi.x, -wi.y, wi.z},
                      Vec3<T>{-fresnel.eta_ti * wi.x, -fresnel.eta_ti * wi.y, fresnel.cos_t});
    }
};

TR_BSDF(DispersiveDielectric)

}  // namespace tr
