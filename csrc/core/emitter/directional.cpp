// `directional`: light from infinitely far away that travels along the +z axis of `to_world`. A delta function of
// direction: only emitter sampling finds it.
#include "delta_position.h"
#include "infinite.h"

namespace tr {

struct DirectionalEmitter {
    static constexpr Field fields[] = {
        {"irradiance", Kind::Spectrum, 1, 0, INFINITY, "interior",
         "power per area perpendicular to its direction, W / m^2"},
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY,
         "interior, without shadow edges that are seen in mirrors or through glass; zero where there are none",
         "light travels along its +z axis"},
        {"sampling_weight", Kind::Float, 1, 0, INFINITY,
         "none: a probability; images do not depend on it in expectation",
         "relative probability of choosing this emitter"},
        {"stokes", Kind::Vector, 0, -1, 1, "interior",
         "(3,) Q, U and V of the light's Stokes vector over I, Q along the x axis of to_world across the ray", nullptr,
         Optional},
    };
    static constexpr int Irradiance = field_index(fields, "irradiance"), ToWorld = field_index(fields, "to_world");
    static constexpr Model model = {
        "emitter",  "directional",     "Parallel light from infinitely far away.", fields, 4,
        IsInfinite, "DirectionalLight"};
};

namespace {

template <class F>
struct Directional {
    using M = MaskOf<F>;
    using Scene = SceneOf<F>;

    TR_HD static void eval(const Scene &scene, const Wavelengths<F> &waves, const EmitterPoint<F> &point,
                           const M &lanes, Spectrum<F> &r) {
        IntOf<F> offset = emitter_field<F>(scene, DirectionalEmitter::Irradiance, point.emitter, lanes);
        r = select(lanes, constant_spectrum<F>(scene.values, waves, offset, lanes), r);
    }

    // the +z axis, of its length
    TR_HD static Vec3<F> axis(const Scene &scene, const IntOf<F> &emitter, const M &lanes) {
        return gather_frame<F>(scene, emitter_field<F>(scene, DirectionalEmitter::ToWorld, emitter, lanes), lanes).z;
    }

    TR_HD static void sample_direct(const Scene &scene, const Vec3<F> &, const F &, const F &, const F &,
                                    const M &lanes, EmitterSample<F> &r) {
        r.d = select(lanes, -normalize(axis(scene, r.point.emitter, lanes)), r.d);
        r.distance = select(lanes, F(INFINITY), r.distance);
        r.pdf = select(lanes, F(1), r.pdf);
        r.delta = r.delta || lanes;
    }

    TR_HD static void sample_emission(const Scene &scene, const F &, const F &, const F &, const F &c, const F &d,
                                      const F &inverse_pmf, const M &lanes, EmissionSample<F> &r) {
        r.inverse_pdf = select(lanes, inverse_pmf, r.inverse_pdf);
        begin_from_afar(scene, -normalize(axis(scene, r.point.emitter, lanes)), c, d, lanes, r);
    }

    TR_HD static void vjp(const Scene &scene, const EmitterPoint<F> &point, const Vec3<F> &, const Spectrum<F> &g,
                          const GradientNeeds &needs, const M &lanes, CoordinateAdjoint<F> &, Vec3<F> &,
                          GradientSink<F> &sink) {
        if (needs.emitter)
            sink.spectrum(emitter_field<F>(scene, DirectionalEmitter::Irradiance, point.emitter, lanes), g, lanes);
    }

    TR_HD static void direct_vjp(const Scene &scene, const DirectAdjoint<F> &g, const M &lanes, Vec3<F> &,
                                 GradientSink<F> &sink) {
        sweep_axis(scene, g.point.emitter, -g.w_bar, lanes, sink);
    }
    TR_HD static void emission_vjp(const Scene &scene, const EmissionRecord<F> &e, const NextVertex<F> &next, const F &,
                                   const CoordinateAdjoint<F> &, const Vec3<F> &, const M &lanes,
                                   GradientSink<F> &sink) {
        sweep_axis(scene, e.v.light.emitter, next.ray.d, lanes, sink);
    }

    static double power(EmitterMeans &means, const Record &record) {
        return means.disk * means.color(record.field[DirectionalEmitter::Irradiance]);
    }

    static constexpr EmitterKernels<F> table() {
        return {DirectionalEmitter::model,
                eval,
                sample_direct,
                nullptr,
                nullptr,
                TR_OF_LIGHT_PATHS(sample_emission),
                TR_OF_DERIVATIVES(vjp),
                TR_OF_DERIVATIVES(direct_vjp),
                TR_OF_DERIVATIVES(TR_OF_LIGHT_PATHS(emission_vjp)),
                TR_HOST_POINTER(power)};
    }

private:
    // Hands the adjoint of the direction of travel to the matrix.
    TR_HD static void sweep_axis(const Scene &scene, const IntOf<F> &emitter, const Vec3<F> &d_bar, const M &lanes,
                                 GradientSink<F> &sink) {
        Vec3<F> z = axis(scene, emitter, lanes);
        F inverse = F(1) / norm(z);
        Vec3<F> bar = unnormalize(z * inverse, d_bar, inverse);
        IntOf<F> offset = emitter_field<F>(scene, DirectionalEmitter::ToWorld, emitter, lanes);
        sink.scalar(offset + 2, bar.x, lanes);
        sink.scalar(offset + 6, bar.y, lanes);
        sink.scalar(offset + 10, bar.z, lanes);
    }
};

}  // namespace

TR_EMITTER(DirectionalEmitter, Directional)

}  // namespace tr
