// `tabphase`: given by numbers at equal distances of the cosine, from -1 (backward) to 1 (forward), linear in between.
//
// The host makes from the N values v a table of 1 + 2 N numbers: k = 1 / (2 pi I) with the integral I over the cosine;
// the densities p = k v; the share of the distribution below each cosine.
#pragma once

#include "../scene.h"

namespace tr {

template <class F>
class GradientSink;

struct TabulatedPhase {
    static constexpr Field fields[] = {
        {"values", Kind::Tensor, None, 0, INFINITY, "interior",
         "at cosines at equal distances from -1 to 1, of any scale"},
    };
    static constexpr int Data = field_index(fields, "values");
    static constexpr Model model = {
        "phase", "tabphase", "A table over the cosine, interpolated linearly.", fields, 1, 0, "TabulatedPhase"};

    // Where the host's table begins.
    TR_INLINE static int32_t first(const Record &record) { return record.field[Record::Extra]; }
    template <class S>
    TR_INLINE static int32_t size(const SceneView<S> &scene, const Record &record) {
        return scene.values.tensors[record.field[Data]].shape[0];
    }

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
