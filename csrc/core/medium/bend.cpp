#include "bend_medium.h"

#include "medium.h"

namespace tr {

template <class F>
TR_LARGE LocalIndex<F> local_index(const BendMedium<ScalarOf<F>> &medium, const Vec3<F> &p, const MaskOf<F> &active) {
    const int bits = position_bits<F>(medium.field);
    const BendState<F> s = state_at(medium, p);
    auto slope = [&](auto taps) {
        constexpr int T = decltype(taps)::value;
        return spline_slope<T, F>(medium.field, cell_at<T>(medium.field, s, bits), active);
    };
    const BendSlope<F> at =
        medium.quadratic ? slope(std::integral_constant<int, 3>{}) : slope(std::integral_constant<int, 4>{});
    return {refractive_index(at.value, medium.constant), at.slope};
}

template <class F>
TR_LARGE F boundary_eta(const SceneOf<F> &scene, const SurfacePoint<F> &at, const MaskOf<F> &active) {
    F eta(1);
    const Vec3<F> p = surface_position(scene, at, active);
    for_each_bend<F>(scene, inner_medium<F>(scene, at, active), active, [&](const auto &medium, const auto &lanes) {
        eta = select(lanes, local_index<F>(medium, p, lanes).n / F(medium.ext_ior), eta);
    });
    return eta;
}

#define TR_INSTANTIATE(F, S)                                                                       \
    template LocalIndex<F> local_index(const BendMedium<S> &, const Vec3<F> &, const MaskOf<F> &); \
    template F boundary_eta(const SceneView<S> &, const SurfacePoint<F> &, const MaskOf<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
