// `null`: no interaction. The boundary of a medium, or a hole.
#include "kernels.h"

namespace tr {

struct NullBsdf {
    static constexpr Field fields[] = {{nullptr, Kind::Int, 0, 0, 0, "", ""}};
    static constexpr Model model = {"bsdf", "null", "Rays pass through unchanged.",
                                    fields, 0,      HasDeltaLobes | Transmits};
    static constexpr int Albedo = -1;
    static constexpr Polarization Polarizes = Polarization::Pass;

    template <class P, class F>
    TR_INLINE static auto eval(const P &, const Vec3<F> &, const Vec3<F> &, const IntOf<F> &) {
        return uniform_spectrum(F(1));
    }

    template <class P, class F>
    TR_INLINE static F pdf(const P &, const Vec3<F> &, const Vec3<F> &) {
        return F(0);
    }

    template <class P, class F>
    TR_INLINE static BsdfSample<F> sample(const P &params, const Vec3<F> &wi, const F &, const F &, const F &) {
        BsdfSample<F> r;
        r.wo = direction(params, wi, IntOf<F>(0));
        r.pdf = F(1);
        r.eta = F(1);
        r.lobe = IntOf<F>(0);
        r.delta = MaskOf<F>(true);
        return r;
    }

    template <class P, class T>
    TR_INLINE static Vec3<T> direction(const P &, const Vec3<T> &wi, const IntOf<T> &) {
        return -wi;
    }
};

// The hole of a mask that a path has met: as if nothing were there, with the record of the mask. A kind apart from
// `null`, which bounds media and which rays to lights pass.
struct MaskHole : NullBsdf {};

TR_BSDF(NullBsdf)
TR_BSDF(MaskHole)

}  // namespace tr
