// `plastic`: a smooth dielectric coating over a diffuse base. Lobe 0 is the base, lobe 1 the mirror reflection.
#include "../math/fresnel.h"
#include "../math/warp.h"
#include "coating.h"
#include "kernels.h"

namespace tr {

struct Plastic {
    static constexpr Field fields[] = {
        {"eta", Kind::Float, 1.49 / 1.000277, 1e-3, 1e3, "interior",
         "index of refraction inside (below the surface) over outside"},
        {"diffuse_reflectance", Kind::Texture, 0.5, 0, 1, "interior", "albedo of the base"},
        {"specular_reflectance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical", nullptr, Optional},
        {"nonlinear", Kind::Int, 0, 0, 1, "", "whether colours deepen with every reflection inside", Boolean},
    };
    static constexpr int Eta = number_index(fields, "eta");
    static constexpr int Diffuse = color_index(fields, "diffuse_reflectance"),
                         Specular = color_index(fields, "specular_reflectance");
    static constexpr int Nonlinear = choice_index(fields, "nonlinear");
    static constexpr Model model = {"bsdf", "plastic", "Smooth plastic, one-sided.",
                                    fields, 4,         HasSmoothLobes | HasDeltaLobes | ChoosesLobe};
    static constexpr int Albedo = field_index(fields, "diffuse_reflectance");
    static constexpr Polarization Polarizes = Polarization::Coat;

    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi, const Vec3<F> &wo, const IntOf<F> &lobe) {
        using T = std::decay_t<decltype(params.number[Eta] * wi.z)>;
        using V = std::decay_t<decltype(value_of(std::declval<T>()))>;
        T zi(wi.z), zo(wo.z), eta(params.number[Eta]);
        auto mirrors = mask<V>(lobe != 0), seen = mask<V>(value_of(zi) > V(0));
        auto above = seen && mask<V>(value_of(zo) > V(0));
        auto nonlinear = mask<V>(params.choice[Nonlinear] != 0);
        T reflected = fresnel_dielectric(zi, eta).reflectance;
        T in = T(1) - reflected, out = T(1) - fresnel_dielectric(zo, eta).reflectance;
        T through = in * out * zo / (eta * eta * T(Pi)), internal = diffuse_fresnel(T(1) / eta);
        Spectrum<T> result;
        for (int c = 0; c < SpectrumSize; ++c) {
            T base = coated_albedo(T(params.color[Diffuse][c]), internal, nonlinear) * through;
            result[c] = select(mirrors, select(seen, T(params.color[Specular][c]) * reflected, T(0)),
                               select(above, base, T(0)));
        }
        return result;
    }

    template <class P, class F>
    TR_INLINE static F specular_weight(const P &params, const F &cosine) {
        return specular_sampling_weight(fresnel_dielectric(cosine, params.number[Eta]).reflectance,
                                        params.color[Specular], params.color[Diffuse]);
    }

    template <class P, class F>
    TR_INLINE static F pdf(const P &params, const Vec3<F> &wi, const Vec3<F> &wo) {
        auto above = mask<F>(wi.z > F(0)) && mask<F>(wo.z > F(0));
        return select(above, (F(1) - specular_weight(params, wi.z)) * wo.z * F(1 / Pi), F(0));
    }

    template <class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &u0, const F &u1, const F &u2) {
        F p = specular_weight(params, wi.z);
        auto mirrors = mask<F>(u0 < p), seen = mask<F>(wi.z > F(0));
        BsdfSample<F> r;
        r.lobe = select(mask<IntOf<F>>(mirrors), IntOf<F>(1), IntOf<F>(0));
        r.wo = select(mirrors, direction(params, wi, r.lobe), square_to_cosine_hemisphere(u1, u2));
        r.pdf = select(seen, select(mirrors, p, (F(1) - p) * r.wo.z * F(1 / Pi)), F(0));
        r.eta = F(1);
        r.delta = mirrors;
        return r;
    }

    template <class P, class T>
    TR_INLINE static Vec3<T> direction(const P &, const Vec3<T> &wi, const IntOf<T> &) {
        return {-wi.x, -wi.y, wi.z};
    }
};

TR_BSDF(Plastic)

}  // namespace tr
