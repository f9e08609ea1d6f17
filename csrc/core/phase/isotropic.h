// `isotropic`: all directions alike.
#pragma once

#include "../math/warp.h"
#include "../scene.h"

namespace tr {

struct Isotropic {
    static constexpr Field fields[] = {{nullptr, Kind::Int, 0, 0, 0, "", ""}};
    static constexpr Model model = {"phase", "isotropic", "Scatters alike in all directions.", fields, 0};

    template <class F, class S>
    TR_INLINE static F eval(const SceneView<S> &, const Record &, const Vec3<F> &, const Vec3<F> &) {
        return F(1 / (4 * Pi));
    }

    template <class F, class S>
    TR_INLINE static Vec3<F> sample(const SceneView<S> &, const Record &, const Vec3<F> &, const F &u1, const F &u2,
                                    const MaskOf<F> &) {
        return square_to_sphere(u1, u2);
    }

    template <class F, int C, class S, class Sink>
    TR_INLINE static void sweep(const SceneView<S> &, const Record &, const Vec3<F> &, const Vec3<F> &,
                                const Color<F, C> &, const MaskOf<F> &, Sink &) {}
};

}  // namespace tr
