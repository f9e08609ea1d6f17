#include "camera.h"

namespace tr {

template <class F>
TR_LARGE void start_paths(const PathContext<F> &c, ScalarOf<F> width, ScalarOf<F> height, bool skip_zero_adjoint,
                          uint32_t i, uint32_t n_slots, PathQueue<ScalarOf<F>> &out) {
    using U = UIntOf<F>;
    const Record &sensor = c.scene.sensors[c.config.sensor];
    const bool lens = uses_lens(sensor);
    U slot = U(i) + lane_index<F>();
    auto active = mask<F>(slot < U(n_slots));
    Random4<F> u = choose_position<F>(c.config, c.slots, lens, i, c.keys);
    write(c.slots.alpha, i, F(0));
    write(c.slots.radiance, i, uniform_spectrum(F(0)));
    if (c.config.stokes) {
        const SpectrumColumn<ScalarOf<F>> values[] = {c.slots.q, c.slots.u, c.slots.v};
        for (const auto &column : values) write(column, i, uniform_spectrum(F(0)));
    }
    Entries<F> from(i);
    if (skip_zero_adjoint) {
        const SpectrumColumn<ScalarOf<F>> adjoints[] = {c.slots.delta, c.slots.delta_q, c.slots.delta_u,
                                                        c.slots.delta_v};
        F adjoint(0);
        for (int k = 0; k < (c.config.stokes ? 4 : 1); ++k)
            adjoint = adjoint + component_sum(magnitude(from(adjoints[k])));
        active = active && !mask<F>(adjoint == F(0));
    }
    if (!any(active)) return;
    CameraSample<F> at{from(c.slots.film_x), from(c.slots.film_y)};
    if (lens) at.choose_lens(u);
    CameraRay<F> r = camera_ray(c.scene, sensor, at, width, height);
    Spectrum<F> one = uniform_spectrum(F(1));
    append(out, PathState<F>{r.ray.o, r.ray.d, r.length, r.center, F(0), one, F(1), one, slot, U(0u), U(0u)},
           active && r.exists);
}

#define TR_INSTANTIATE(F, S) \
    template void start_paths(const PathContext<F> &, S, S, bool, uint32_t, uint32_t, PathQueue<S> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
