// `rayleigh`: particles much smaller than the wavelength, unpolarised.
#include "../math/warp.h"
#include "kernels.h"

namespace tr {

struct Rayleigh {
    static constexpr Field fields[] = {{nullptr, Kind::Int, 0, 0, 0, "", ""}};
    static constexpr Model model = {"phase", "rayleigh", "Rayleigh's phase function, of particles like molecules.",
                                    fields, 0};

    template <class F>
    TR_HD static F eval(const SceneOf<F> &, const Record &, const Vec3<F> &, const Vec3<F> &d, const Vec3<F> &wo,
                        const MaskOf<F> &) {
        F cosine = dot(d, wo);
        return fmadd(cosine, cosine, F(1)) * F(3 / (16 * Pi));
    }

    // The cumulative distribution is a cubic with one real root: Frisvad, "Importance sampling the Rayleigh phase
    // function", Journal of the Optical Society of America A 28 (2011), equation 9.
    template <class F>
    TR_HD static Vec3<F> sample(const SceneOf<F> &, const Record &, const Vec3<F> &, const Vec3<F> &d, const F &,
                                const F &u1, const F &u2, const MaskOf<F> &) {
        F z = fmadd(F(4), u1, F(-2)), size = abs(z);
        // of the positive half, where nothing cancels; the argument is at least 1
        F root = exp(log(size + sqrt(fmadd(size, size, F(1)))) * F(1.0 / 3));
        F cosine = mulsign(min(root - F(1) / root, F(1)), z);
        return direction_about(d, cosine, sqrt(max(F(1) - cosine * cosine, F(0))), u2);
    }

    template <class F>
    TR_HD static F slope(const SceneOf<F> &, const Record &, const Vec3<F> &, const Vec3<F> &d, const Vec3<F> &wo,
                         const F &, const MaskOf<F> &, Vec3<F> &, GradientSink<F> &) {
        return dot(d, wo) * F(6 / (16 * Pi));
    }
};

TR_PHASE(Rayleigh)

}  // namespace tr
