// `redner`: the material of redner (Li, Aittala, Durand and Lehtinen, "Differentiable Monte Carlo Ray Tracing through
// Edge Sampling", SIGGRAPH Asia 2018), so that its scenes can be compared: a diffuse lobe beside, not below, one of
// microfacets whose normals have the density of Blinn and Phong.
#include "../math/warp.h"
#include "coating.h"
#include "kernels.h"
#include "microfacet.h"
#include "principled_lobes.h"

namespace tr {

struct RednerMaterial {
    static constexpr double MinRoughness = 1e-5;
    static constexpr Field fields[] = {
        {"diffuse_reflectance", Kind::Texture, 0.5, 0, 1, "interior", "albedo"},
        {"specular_reflectance", Kind::Texture, 0, 0, 1, "interior", "reflectance of microfacets at normal incidence"},
        {"roughness", Kind::Scalar, 1, 0, 1, "interior",
         "2 / (n + 2) for the exponent n of the microfacets' cosine; below 0.00001 it counts as that"},
    };
    static constexpr int Diffuse = color_index(fields, "diffuse_reflectance"),
                         Specular = color_index(fields, "specular_reflectance");
    static constexpr int Roughness = number_index(fields, "roughness");
    static constexpr Model model = {"bsdf",          "redner", "Diffuse and Blinn-Phong reflection, one-sided.",
                                    fields,          3,        HasSmoothLobes | ChoosesLobe,
                                    "RednerMaterial"};
    static constexpr int Albedo = field_index(fields, "diffuse_reflectance");

    // The rational fit to Smith's masking of Beckmann microfacets of alpha^2 = roughness: Walter et al., EGSR 2007,
    // section 5.2.
    template <class T>
    TR_INLINE static T masking(const T &roughness, const Vec3<T> &v) {
        using F = std::decay_t<decltype(value_of(roughness))>;
        T sine2 = v.x * v.x + v.y * v.y;
        auto tilted = mask<F>(value_of(sine2) > F(1e-12));
        T a = abs(v.z) / sqrt(select(tilted, sine2 * roughness, T(1)));
        auto steep = tilted && mask<F>(value_of(a) < F(1.6));
        a = select(steep, a, T(1));
        T a2 = a * a;
        return select(steep, (T(3.535) * a + T(2.181) * a2) / (T(1) + T(2.276) * a + T(2.577) * a2), T(1));
    }
    template <class T>
    TR_INLINE static T rendered(const T &roughness) {
        using F = std::decay_t<decltype(value_of(roughness))>;
        return at_least(roughness, F(MinRoughness));
    }
    // (n + 2) / (2 pi) cos^n, with n + 2 = 2 / roughness.
    template <class T>
    TR_INLINE static T density(const T &roughness, const T &cos2) {
        T inverse = T(1) / roughness;
        return inverse * T(1 / Pi) * exp((inverse - T(1)) * log(max(cos2, T(1e-30))));
    }

    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi_, const Vec3<F> &wo_, const IntOf<F> &) {
        using T = std::decay_t<decltype(params.number[Roughness] * wi_.z)>;
        using V = std::decay_t<decltype(value_of(std::declval<T>()))>;
        Vec3<T> wi = convert<T>(wi_), wo = convert<T>(wo_);
        auto above = mask<V>(value_of(wi.z) > V(0)) && mask<V>(value_of(wo.z) > V(0));
        T roughness = rendered(T(params.number[Roughness]));
        Vec3<T> h = wi + wo;
        T length2 = squared_norm(h);
        above = above && mask<V>(value_of(length2) > V(1e-20));
        length2 = select(above, length2, T(1));
        T inverse2 = T(1) / length2;
        T facets = density(roughness, h.z * h.z * inverse2);
        facets = facets * masking(roughness, wi) * masking(roughness, wo) * T(0.25) / select(above, wi.z, T(1));
        T away = schlick_weight(sqrt(length2) * T(0.5)), diffuse = wo.z * T(1 / Pi);
        Spectrum<T> result;
        for (int c = 0; c < SpectrumSize; ++c) {
            T specular(params.color[Specular][c]);
            T value = T(params.color[Diffuse][c]) * diffuse + mix(specular, T(1), away) * facets;
            result[c] = select(above, value, T(0));
        }
        return result;
    }

    template <class P, class F>
    TR_INLINE static F pdf(const P &params, const Vec3<F> &wi, const Vec3<F> &wo) {
        auto above = mask<F>(wi.z > F(0)) && mask<F>(wo.z > F(0));
        F p = specular_sampling_weight(F(0.5), params.color[Specular], params.color[Diffuse]);
        Vec3<F> h = wi + wo;
        F length2 = squared_norm(h);
        above = above && mask<F>(length2 > F(1e-20));
        length2 = select(above, length2, F(1));
        F inverse2 = F(1) / length2;
        F cos2 = h.z * h.z * inverse2;
        F facets = density(rendered(params.number[Roughness]), cos2);
        facets = facets * sqrt(cos2) / (F(2) * sqrt(length2));  // 4 wi.h = 2 |h|
        return select(above, p * facets + (F(1) - p) * wo.z * F(1 / Pi), F(0));
    }

    template <class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &u0, const F &u1, const F &u2) {
        auto facets = mask<F>(u0 < specular_sampling_weight(F(0.5), params.color[Specular], params.color[Diffuse]));
        // cos^2 = (1 - u)^(2 / (n + 2)) of a normal of the density times its cosine
        F cos2 = exp(rendered(params.number[Roughness]) * log(max(F(1) - u2, F(1e-30)))), s, c;
        F sine = sqrt(max(F(1) - cos2, F(0)));
        sincos(u1 * F(2 * Pi), s, c);
        Vec3<F> m{sine * c, sine * s, sqrt(cos2)};
        F cos_i = dot(wi, m);
        BsdfSample<F> r;
        r.wo = select(facets, normalize(m * (F(2) * cos_i) - wi), square_to_cosine_hemisphere(u1, u2));
        auto usable = !facets || mask<F>(cos_i > F(0));
        r.pdf = select(usable, pdf(params, wi, r.wo), F(0));
        r.eta = F(1);
        r.lobe = IntOf<F>(0);
        r.delta = MaskOf<F>(false);
        return r;
    }
};

TR_BSDF(RednerMaterial)

}  // namespace tr
