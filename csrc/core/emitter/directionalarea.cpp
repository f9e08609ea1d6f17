// `directionalarea`: a shape that emits along its normal only, in parallel beams where it is flat. No other direction
// has light, so neither sampling of emitters nor a BSDF's sample finds it: it is seen by light tracing alone.
#include "on_shape.h"

namespace tr {

struct DirectionalAreaEmitter {
    static constexpr Field fields[] = {
        {"radiance", Kind::Texture, 1, 0, INFINITY, "interior", "power that leaves a unit of area, W / m^2"},
        {"sampling_weight", Kind::Float, 1, 0, INFINITY,
         "none: a probability; images do not depend on it in expectation",
         "relative probability of choosing this emitter"},
        {"stokes", Kind::Vector, 0, -1, 1, "interior",
         "(3,) Q, U and V of the light's Stokes vector over I, Q along dp/du across the ray", nullptr, Optional},
    };
    static constexpr int Radiance = field_index(fields, "radiance");
    static constexpr Model model = {
        "emitter",          "directionalarea",     "A shape that emits along its normal.", fields, 3,
        IsOnShape | IsBeam, "DirectionalAreaLight"};
};

namespace {

template <class F>
struct DirectionalArea : OnShape<DirectionalAreaEmitter, F> {
    using Base = OnShape<DirectionalAreaEmitter, F>;
    using typename Base::M;
    using typename Base::Scene;

    TR_HD static void sample_emission(const Scene &scene, const F &left, const F &a, const F &b, const F &, const F &,
                                      const F &inverse_pmf, const M &lanes, EmissionSample<F> &r) {
        Base::sample_point(scene, left, a, b, inverse_pmf, lanes, r);
        r.weight = select(lanes, r.inverse_pdf, r.weight);
    }

    // A ray that moves with its surface.
    TR_HD static void emission_vjp(const Scene &scene, const EmissionRecord<F> &e, const NextVertex<F> &next,
                                   const F &carried, const CoordinateAdjoint<F> &at, const Vec3<F> &, const M &all,
                                   GradientSink<F> &sink) {
        const VertexRecord<F> &v = e.v;
        const M lanes = sink.wants_shape(v.light.at.shape, all);  // nothing else moves
        if (!any(lanes)) return;
        Base::sweep_coordinates(scene, v, at, lanes, sink);
        HitAdjoint<F> hit;
        hit.p = next.ray.o;
        hit.n = next.ray.d;
        sweep_area(scene, v.light.at, v.p, v.normal, carried, hit, lanes, sink);
    }

    static double power(EmitterMeans &means, const Record &record) {
        const int32_t shape = record.field[EmitterShape];
        return means.texture(record.field[DirectionalAreaEmitter::Radiance], shape) * means.area(shape);
    }

    static constexpr EmitterKernels<F> table() {
        return {DirectionalAreaEmitter::model,
                Base::eval,
                nullptr,
                nullptr,
                nullptr,
                TR_OF_LIGHT_PATHS(sample_emission),
                TR_OF_DERIVATIVES(Base::vjp),
                nullptr,
                TR_OF_DERIVATIVES(TR_OF_LIGHT_PATHS(emission_vjp)),
                TR_HOST_POINTER(power)};
    }
};

}  // namespace

TR_EMITTER(DirectionalAreaEmitter, DirectionalArea)

}  // namespace tr
