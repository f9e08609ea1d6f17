// `plastic`: a smooth dielectric coating over a diffuse base. Lobe 0 is the base, lobe 1 the mirror reflection.
#pragma once

#include "../math/fresnel.h"
#include "bsdf.h"

namespace tr {

// What a coating does to the diffuse base below it: light that the interface throws back into the coat meets the base
// again and again. `reflectance` is the base's, `internal` the interface's for diffuse light from below; with
// `nonlinear`, colours deepen with every further reflection, else each is as grey as the first.
template <class T, class M>
TR_INLINE T coated_albedo(const T &reflectance, const T &internal, const M &nonlinear) {
    return reflectance / (T(1) - select(nonlinear, reflectance * internal, internal));
}

// The chance with which the interface's lobe is sampled, of which the share of light is r: in proportion to the largest
// channels, but both lobes with a chance, since what is black has a derivative too.
template <class F, int C>
TR_INLINE F chance_of_coat(const F &r, const Color<F, C> &specular, const Color<F, C> &diffuse) {
    F coat = r * max_channel(specular), base = (F(1) - r) * max_channel(diffuse), sum = coat + base;
    auto some = mask<F>(sum > F(0));
    return min(max(select(some, coat / select(some, sum, F(1)), F(0.5)), F(0.1)), F(0.9));
}

struct Plastic {
    enum { Diffuse = 0, Specular = 1 };  // of color[]
    static constexpr Field fields[] = {
        {"eta", Kind::Float, 1.49 / 1.000277, 1e-3, 1e3, "interior",
         "index of refraction inside (below the surface) over outside"},
        {"diffuse_reflectance", Kind::Texture, 0.5, 0, 1, "interior", "albedo of the base"},
        {"specular_reflectance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical"},
        {"nonlinear", Kind::Int, 0, 0, 1, "", "1: colours shift with every reflection inside"},
    };
    static constexpr Model model = {"bsdf", "plastic", "Smooth plastic, one-sided.", fields, 4};
    static constexpr bool Smooth = true, Delta = true;
    static constexpr int Albedo = 1;

    template <int C, class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi, const Vec3<F> &wo, const IntOf<F> &lobe) {
        using T = std::decay_t<decltype(params.number[0] * wi.z)>;
        using V = std::decay_t<decltype(value_of(std::declval<T>()))>;
        T zi(wi.z), zo(wo.z), eta(params.number[0]);
        auto mirrors = mask<V>(lobe != 0), seen = mask<V>(value_of(zi) > V(0));
        auto above = seen && mask<V>(value_of(zo) > V(0));
        auto nonlinear = mask<V>(params.choice[0] != 0);
        T reflected = fresnel_dielectric(zi, eta).reflectance;
        T in = T(1) - reflected, out = T(1) - fresnel_dielectric(zo, eta).reflectance;
        T through = in * out * zo / (eta * eta * T(Pi)), internal = diffuse_fresnel(T(1) / eta);
        Color<T, C> result;
        for (int c = 0; c < C; ++c) {
            T base = coated_albedo(T(params.color[Diffuse][c]), internal, nonlinear) * through;
            result[c] = select(mirrors, select(seen, T(params.color[Specular][c]) * reflected, T(0)),
                               select(above, base, T(0)));
        }
        return result;
    }

    template <int C, class P, class F>
    TR_INLINE static F chance(const P &params, const F &cosine) {
        return chance_of_coat(fresnel_dielectric(cosine, params.number[0]).reflectance, params.color[Specular],
                              params.color[Diffuse]);
    }

    template <int C, class P, class F>
    TR_INLINE static F pdf(const P &params, const Vec3<F> &wi, const Vec3<F> &wo) {
        auto above = mask<F>(wi.z > F(0)) && mask<F>(wo.z > F(0));
        return select(above, (F(1) - chance<C>(params, wi.z)) * wo.z * F(1 / Pi), F(0));
    }

    template <int C, class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &u0, const F &u1, const F &u2) {
        F p = chance<C>(params, wi.z);
        auto mirrors = mask<F>(u0 < p), seen = mask<F>(wi.z > F(0));
        BsdfSample<F> r;
        r.lobe = select(mask<IntOf<F>>(mirrors), IntOf<F>(1), IntOf<F>(0));
        r.wo = select(mirrors, direction(params, wi, r.lobe), square_to_cosine_hemisphere(u1, u2));
        r.pdf = select(seen, select(mirrors, p, (F(1) - p) * r.wo.z * F(1 / Pi)), F(0));
        r.eta = F(1);
        r.delta = mirrors;
        r.null = MaskOf<F>(false);
        return r;
    }

    template <class P, class T>
    TR_INLINE static Vec3<T> direction(const P &, const Vec3<T> &wi, const IntOf<T> &) {
        return {-wi.x, -wi.y, wi.z};
    }
};

}  // namespace tr
