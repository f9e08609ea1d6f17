// `conductor`: a smooth metal. Reflects only, by the Fresnel equations for a complex index eta - i k.
#include "../math/fresnel.h"
#include "kernels.h"

namespace tr {

struct Conductor {
    static constexpr Field fields[] = {
        {"eta", Kind::Texture, 0, 0, INFINITY, "interior", "real part of the index of refraction"},
        {"k", Kind::Texture, 1, 0, INFINITY, "interior", "imaginary part (absorption)"},
        {"specular_reflectance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical"},
    };
    static constexpr int Eta = color_index(fields, "eta"), K = color_index(fields, "k"),
                         Reflectance = color_index(fields, "specular_reflectance");
    static constexpr Model model = {"bsdf", "conductor", "Smooth conductor, one-sided.", fields, 3, HasDeltaLobes};
    static constexpr int Albedo = field_index(fields, "specular_reflectance");

    static constexpr Polarization Polarizes = Polarization::Metal;

    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi, const Vec3<F> &, const IntOf<F> &) {
        using T = std::decay_t<decltype(params.color[Eta][0] * wi.z)>;
        Spectrum<T> r;
        for (int c = 0; c < SpectrumSize; ++c)
            r[c] = T(params.color[Reflectance][c]) *
                   fresnel_conductor(T(max(wi.z, F(0))), T(params.color[Eta][c]), T(params.color[K][c]));
        return r;
    }

    template <class P, class F>
    TR_INLINE static F pdf(const P &, const Vec3<F> &, const Vec3<F> &) {
        return F(0);
    }

    template <class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &, const F &, const F &) {
        BsdfSample<F> r;
        r.wo = direction(params, wi, IntOf<F>(0));
        r.pdf = select(mask<F>(wi.z > F(0)), F(1), F(0));
        r.eta = F(1);
        r.lobe = IntOf<F>(0);
        r.delta = MaskOf<F>(true);
        return r;
    }

    template <class P, class T>
    TR_INLINE static Vec3<T> direction(const P &, const Vec3<T> &wi, const IntOf<T> &) {
        return {-wi.x, -wi.y, wi.z};
    }
};

TR_BSDF(Conductor)

}  // namespace tr
