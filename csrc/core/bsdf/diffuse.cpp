// `diffuse`: a Lambertian reflector, f = reflectance / pi on the side of the normal, black from behind.
#include "../math/warp.h"
#include "kernels.h"

namespace tr {

struct Diffuse {
    static constexpr Field fields[] = {
        {"reflectance", Kind::Texture, 0.5, 0, 1, "interior", "albedo"},
    };
    static constexpr Model model = {"bsdf", "diffuse", "Ideal diffuse (Lambertian) reflection, one-sided.",
                                    fields, 1,         HasSmoothLobes};
    static constexpr int Albedo = field_index(fields, "reflectance");

    template <class P, class F>
    TR_INLINE static auto eval(const P &params, const Vec3<F> &wi, const Vec3<F> &wo, const IntOf<F> &) {
        auto above = mask<F>(wi.z > F(0)) && mask<F>(wo.z > F(0));
        return params.color[0] * select(above, wo.z * F(1 / Pi), F(0));
    }

    template <class P, class F>
    TR_INLINE static F pdf(const P &, const Vec3<F> &wi, const Vec3<F> &wo) {
        auto above = mask<F>(wi.z > F(0)) && mask<F>(wo.z > F(0));
        return select(above, wo.z * F(1 / Pi), F(0));
    }

    template <class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &, const Vec3<F> &wi, const F &, const F &u1, const F &u2) {
        BsdfSample<F> r;
        r.wo = square_to_cosine_hemisphere(u1, u2);
        r.pdf = select(mask<F>(wi.z > F(0)), r.wo.z * F(1 / Pi), F(0));
        r.eta = F(1);
        r.lobe = IntOf<F>(0);
        r.delta = MaskOf<F>(false);
        return r;
    }
};

TR_BSDF(Diffuse)

}  // namespace tr
