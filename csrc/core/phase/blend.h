// `blendphase`: two phase functions, (1 - weight) of the first and weight of the second.
#pragma once

#include "../scene.h"

namespace tr {

template <class F>
class GradientSink;

struct BlendPhase {
    static constexpr Field fields[] = {
        {"weight", Kind::Volume, 0.5, 0, 1, "interior", "share of the second, one number everywhere or in each voxel"},
        {"phase_0", Kind::Phase, None, 0, INFINITY, "", "the first phase function"},
        {"phase_1", Kind::Phase, None, 0, INFINITY, "", "the second phase function"},
    };
    static constexpr int Weight = field_index(fields, "weight"), First = field_index(fields, "phase_0"),
                         Second = field_index(fields, "phase_1");
    static constexpr Model model = {"phase", "blendphase", "Two phase functions, blended by a volume.", fields, 3,
                                    0,       "BlendPhase"};

    // see PhaseKernels
    template <class F>
    TR_LARGE static F eval(const SceneOf<F> &, const Record &, const Vec3<F> &p, const Vec3<F> &d, const Vec3<F> &wo,
                           const MaskOf<F> &);
    template <class F>
    TR_LARGE static Vec3<F> sample(const SceneOf<F> &, const Record &, const Vec3<F> &p, const Vec3<F> &d, const F &u0,
                                   const F &u1, const F &u2, const MaskOf<F> &);
    template <class F>
    TR_LARGE static F slope(const SceneOf<F> &, const Record &, const Vec3<F> &p, const Vec3<F> &d, const Vec3<F> &wo,
                            const F &g, const MaskOf<F> &, Vec3<F> &p_bar, GradientSink<F> &);
    template <class F>
    TR_LARGE static void vjp(const SceneOf<F> &, const Record &, const Vec3<F> &p, const Vec3<F> &d, const Vec3<F> &wo,
                             const Spectrum<F> &g, const MaskOf<F> &, GradientSink<F> &);
};

}  // namespace tr
