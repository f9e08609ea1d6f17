// `thindielectric`: a pane of glass that is much thinner than what is seen through it. Lobe 0 reflects, lobe 1 goes
// straight on.
#include "../math/fresnel.h"
#include "kernels.h"

namespace tr {

struct ThinDielectric {
    static constexpr Field fields[] = {
        {"eta", Kind::Float, 1.5046 / 1.000277, 1e-3, 1e3, "interior",
         "index of refraction of the pane over that around it"},
        {"specular_reflectance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical", nullptr, Optional},
        {"specular_transmittance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical", nullptr, Optional},
    };
    static constexpr int Eta = number_index(fields, "eta");
    static constexpr int Reflectance = color_index(fields, "specular_reflectance"),
                         Transmittance = color_index(fields, "specular_transmittance");
    static constexpr Model model = {
        "bsdf",          "thindielectric", "Thin pane of glass.", fields, 3, HasDeltaLobes | Transmits | ChoosesLobe,
        "ThinDielectric"};
    static constexpr int Albedo = field_index(fields, "specular_transmittance");  // what goes through is most of it
    static constexpr Polarization Polarizes = Polarization::Pane;

    // Between both faces, light that is reflected r, leaves in t r t, t r^3 t, ...: r + t^2 r / (1 - r^2) = 2 r / (1 +
    // r), with t = 1 - r.
    template <class T>
    TR_INLINE static T reflected(const T &cosine, const T &eta) {
        T r = fresnel_dielectric(abs(cosine), eta).reflectance;
        return T(2) * r / (T(1) + r);
    }

    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi, const Vec3<F> &, const IntOf<F> &lobe) {
        using T = std::decay_t<decltype(params.number[Eta] * wi.z)>;
        T r = reflected(T(wi.z), T(params.number[Eta]));
        return select(mask<F>(lobe == 0), params.color[Reflectance] * r, params.color[Transmittance] * (T(1) - r));
    }

    template <class P, class F>
    TR_INLINE static F pdf(const P &, const Vec3<F> &, const Vec3<F> &) {
        return F(0);
    }

    template <class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &u0, const F &, const F &) {
        F chance = reflected(wi.z, params.number[Eta]);
        auto reflects = mask<F>(u0 < chance);
        BsdfSample<F> r;
        r.pdf = select(reflects, chance, F(1) - chance);
        r.eta = F(1);
        r.lobe = select(mask<IntOf<F>>(reflects), IntOf<F>(0), IntOf<F>(1));
        r.wo = direction(params, wi, r.lobe);
        r.delta = MaskOf<F>(true);
        return r;
    }

    template <class P, class T>
    TR_INLINE static Vec3<T> direction(const P &, const Vec3<T> &wi, const IntOf<T> &lobe) {
        return {-wi.x, -wi.y, select(mask<T>(lobe == 0), wi.z, -wi.z)};
    }
};

TR_BSDF(ThinDielectric)

}  // namespace tr
