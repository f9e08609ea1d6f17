// `constant`: the same radiance from every direction. Sampled uniformly.
#include "infinite.h"

namespace tr {

struct ConstantEmitter {
    static constexpr Field fields[] = {
        {"radiance", Kind::Spectrum, 1, 0, INFINITY, "interior", "radiance from everywhere, W / (m^2 sr)"},
        {"sampling_weight", Kind::Float, 1, 0, INFINITY,
         "none: a probability; images do not depend on it in expectation",
         "relative probability of choosing this emitter"},
    };
    static constexpr int Radiance = field_index(fields, "radiance");
    static constexpr Model model = {
        "emitter", "constant", "A constant environment.", fields, 2, IsEnvironment | IsInfinite, "ConstantLight"};

    template <class F, class S>
    TR_INLINE static Vec3<F> sample(const SceneView<S> &, const F &u1, const F &u2, Vec2<F> &uv, F &pdf,
                                    const MaskOf<F> &) {
        uv = {F(0), F(0)};
        pdf = F(1 / (4 * Pi));
        return square_to_sphere(u1, u2);
    }
};

namespace {

template <class F>
struct Constant : Environment<ConstantEmitter, Constant<F>, F> {
    using Base = Environment<ConstantEmitter, Constant, F>;
    using typename Base::M;
    using typename Base::Scene;

    TR_HD static void eval(const Scene &scene, const Wavelengths<F> &waves, const EmitterPoint<F> &point,
                           const M &lanes, Spectrum<F> &r) {
        IntOf<F> offset = emitter_field<F>(scene, ConstantEmitter::Radiance, point.emitter, lanes);
        r = select(lanes, constant_spectrum<F>(scene.values, waves, offset, lanes), r);
    }
    TR_HD static F pdf_direct(const Scene &, const EmitterPoint<F> &, const Vec3<F> &, const Vec3<F> &, const Vec3<F> &,
                              const M &) {
        return F(1 / (4 * Pi));
    }
    TR_HD static void point_of_direction(const Scene &, const Vec3<F> &, EmitterPoint<F> &) {}
    TR_HD static void vjp(const Scene &scene, const EmitterPoint<F> &point, const Vec3<F> &, const Spectrum<F> &g,
                          const GradientNeeds &needs, const M &lanes, CoordinateAdjoint<F> &, Vec3<F> &,
                          GradientSink<F> &sink) {
        if (needs.emitter)
            sink.spectrum(emitter_field<F>(scene, ConstantEmitter::Radiance, point.emitter, lanes), g, lanes);
    }
    static double power(EmitterMeans &means, const Record &record) {
        return 4 * Pi * means.disk * means.color(record.field[ConstantEmitter::Radiance]);
    }
};

}  // namespace

TR_EMITTER(ConstantEmitter, Constant)

}  // namespace tr
