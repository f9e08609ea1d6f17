// `isotropic`: all directions alike.
#include "../math/warp.h"
#include "kernels.h"

namespace tr {

struct Isotropic {
    static constexpr Field fields[] = {{nullptr, Kind::Int, 0, 0, 0, "", ""}};
    static constexpr Model model = {"phase", "isotropic", "Scatters alike in all directions.", fields, 0};

    template <class F>
    TR_HD static F eval(const SceneOf<F> &, const Record &, const Vec3<F> &, const Vec3<F> &, const Vec3<F> &,
                        const MaskOf<F> &) {
        return F(1 / (4 * Pi));
    }

    template <class F>
    TR_HD static Vec3<F> sample(const SceneOf<F> &, const Record &, const Vec3<F> &, const Vec3<F> &, const F &,
                                const F &u1, const F &u2, const MaskOf<F> &) {
        return square_to_sphere(u1, u2);
    }

    template <class F>
    TR_HD static F slope(const SceneOf<F> &, const Record &, const Vec3<F> &, const Vec3<F> &, const Vec3<F> &,
                         const F &, const MaskOf<F> &, Vec3<F> &, GradientSink<F> &) {
        return F(0);
    }
};

TR_PHASE(Isotropic)

}  // namespace tr
