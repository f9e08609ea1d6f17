// Light tracing: paths from an emitter on that are connected to the camera at every vertex that is not a delta lobe
// (Dutre, Lafortune and Willems 1993; Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997,
// chapters 4 and 10.2). Caustics that no path from the camera finds are its strength; a surface that is seen through
// smooth glass its blind spot.
//
// The point on the emitter is spread evenly over all paths: the pixels of the film are strata of the unit square. For
// random numbers see config.h.
#pragma once

#include "../sensor/irradiancemeter.h"
#include "surface.h"

namespace tr {

// The sensor as light paths see it.
template <class S>
struct LightSensor {
    const Record &record;
    Pinhole<S> camera;
    int32_t meter = -1;  // the shape that an irradiance meter lies on

    TR_HD LightSensor(const SceneView<S> &scene, uint32_t index, S width, S height)
        : record(scene.sensors[index]), camera(width, height) {
        if (record.kind == IrradianceMeterKind)
            meter = record.field[IrradianceMeter::ShapeIndex];
        else
            camera = Pinhole<S>(scene, record, width, height);
    }
    // What that has found before.
    TR_HD LightSensor(const Record &record_, const Pinhole<S> &camera_, int32_t meter_)
        : record(record_), camera(camera_), meter(meter_) {}
};

// With an interpolated normal n_s, light that arrives along wi and leaves along wo is scattered by f(wi, wo) |wo.n_s|
// towards a camera's path, but the flux of a light path sees |wi.n_s| / |wi.n_g| of it (Veach 1997, section 5.3.2).
template <class F>
TR_INLINE F shading_correction(const Vec3<F> &wi, const Vec3<F> &wo, const Vec3<F> &ns, const Vec3<F> &ng,
                               const MaskOf<F> &interpolated) {
    F below = dot(wi, ng) * dot(wo, ns), above = dot(wi, ns) * dot(wo, ng);
    auto usable = interpolated && mask<F>(below != F(0));
    return select(usable, abs(above / select(usable, below, F(1))), F(1));
}

// Whether flux sees another cosine than the geometric one, see shading_correction.
template <class F>
TR_INLINE MaskOf<F> has_shading_normal(const ShapeLanes<F> &shape, const BsdfStack<F> &stack, const MaskOf<F> &active) {
    return active && (shape.has(HasNormals) || mask<F>(stack.perturbed >= 0));
}

// Paths of slots i on, and the connections of the emitters themselves to the camera.
template <class F>
TR_LARGE void start_light_paths(const PathContext<F> &c, const LightSensor<ScalarOf<F>> &sensor, uint32_t i,
                                uint32_t n_slots, PathQueue<ScalarOf<F>> &out, ShadowQueue<ScalarOf<F>> &connections);

// The hits of `lanes`, all of one kind, entry i on of the tape's level. `step.scatters`: paths go on.
template <class F>
TR_LARGE void shade_light_path(const PathContext<F> &c, const LightSensor<ScalarOf<F>> &sensor, int kind,
                               const PathStep &step, const PathQueue<ScalarOf<F>> &in,
                               const HitColumns<ScalarOf<F>> &hits, const LaneSet<F> &lanes, uint32_t i,
                               PathQueue<ScalarOf<F>> &out, ShadowQueue<ScalarOf<F>> &connections);

}  // namespace tr
