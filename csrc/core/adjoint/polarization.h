// Polarised light on the path tape. What is sampled, and with which density, are functions of intensities alone: paths
// are traced and recorded as ever. Columns, Stokes vectors of radiance, run over the tape from its end,
//     S_k = E_k + N_k + f_k / (p_k q_k) M_k T_k S_{k+1},
// T_k being the rotation from the axis of vertex k + 1 to that of vertex k, and M_k the matrix of math/polarization.h;
// rows, adjoints of the columns, from its beginning: A_{k+1} = A_k f_k / (p_k q_k) M_k T_k. Between a row and a column
// a vertex is the number A_k M_k R: its derivative by what the unpolarised one depends on, too, is that of f times this
// number, and what remains is the derivative of M and of the axes. Vectors alone, in one pass; matrices are never
// inverted.
//
// Paths from lights have the roles exchanged. What a vertex does to light that travels backwards is, by reciprocity,
// D M^T D with D = diag(1, 1, -1, 1) (Perrin, "Polarization of Light Scattered by Isotropic Opalescent Media", Journal
// of Chemical Physics 10, 1942): seen from behind, the axis turns the other way. So what light brings is, with its U
// reversed, a row of the formulas above, and what the film and the rest of the path hand back are columns.
#pragma once

#include "../bsdf/bsdf.h"
#include "../integrator/light.h"
#include "../sensor/perspective.h"
#include "../state/tape.h"
#include "gradient_sink.h"
#include "needs.h"
#include "polarized_light.h"

namespace tr {

// The axis of the film's Stokes vectors, of light that comes along k: horizontal, by the camera's upward direction.
template <class F>
TR_INLINE Vec3<F> camera_up(const SceneOf<F> &scene, uint32_t sensor) {
    const ScalarOf<F> *m = scene.values.constants + scene.sensors[sensor].field[Perspective::ToWorld];
    return {F(m[1]), F(m[5]), F(m[9])};
}
template <class F>
TR_INLINE Vec3<F> film_axis(const SceneOf<F> &scene, uint32_t sensor, const Vec3<F> &k) {
    return axis_between(camera_up<F>(scene, sensor), k);
}
// It turns with the camera, and with k, to whose adjoint what its angle makes is added.
template <class F>
TR_INLINE void sweep_film_axis(const SceneOf<F> &scene, uint32_t sensor, const Vec3<F> &k, const F &angle_bar,
                               bool camera, const MaskOf<F> &active, Vec3<F> &k_bar, GradientSink<F> &sink) {
    Vec3<F> up_bar{F(0), F(0), F(0)};
    sweep_axis(camera_up<F>(scene, sensor), k, k, angle_bar, up_bar, k_bar);
    if (!camera) return;
    const int32_t to_world = scene.sensors[sensor].field[Perspective::ToWorld];
    const F by_row[3] = {up_bar.x, up_bar.y, up_bar.z};
    for (int i = 0; i < 3; ++i) sink.scalar(IntOf<F>(to_world + 4 * i + 1), by_row[i], active);
}

// From `to`, where light comes from, through the BSDF.
template <class F>
struct PolarizedWay {
    Vec3<F> to;          // in the world
    F z;                 // its cosine
    MaskOf<F> reflects;  // on the side of wi
    MaskOf<F> base;      // below a coat, without the coat's facets
    Vec3<F> out, in;     // axes of what leaves and of what arrives, not normalized
    Spectrum<F> factor;  // f / (p q); N of unpolarised light
    MuellerMatrix<F> matrix[SpectrumSize];
};

// Of a vertex of a light path: how it is connected to the camera, and the film's row, with U reversed, or 0.
template <class F>
struct PolarizedConnection {
    const LightSensor<ScalarOf<F>> &sensor;
    uint32_t sensor_index;
    ConnectionRecord<F> record;
    Stokes<F> film;
};

// A vertex whose BSDF is known: its values, with those of the stack above it, matrices and axes towards the next vertex
// and towards the light, or the camera where paths come from lights. A rough coat and the base below it are two lobes,
// of which each has its own.
template <class F>
struct PolarizedVertex {
    const BsdfKernels<F> &bsdf;
    BsdfParameters<F> params;
    Polarization kind;
    int n_lobes;
    Vec3<F> wi, n;  // in the world
    F z;            // the cosine of wi
    PolarizedLight<F> lamp;
    const PolarizedConnection<F> *connection;  // null: the path comes from the camera
    Stokes<F> sent;                            // the column of what is connected, for `factor` as the intensity
    struct Lobe {
        PolarizedWay<F> path, light;
    } lobes[2];

    // `needs` say with which probabilities branches of stacks were taken.
    TR_LARGE PolarizedVertex(const SceneOf<F> &scene, const Wavelengths<F> &waves, int kind, const VertexRecord<F> &v,
                             const GradientNeeds &needs, const MaskOf<F> &active,
                             const PolarizedConnection<F> *connection = nullptr);

    // The column of what comes from here, but for its own emission, from that which arrives.
    TR_LARGE Stokes<F> column(const Stokes<F> &arriving) const;
    // The row for what arrives along the path, or along the connection, from that for what leaves.
    TR_LARGE Stokes<F> row(const Stokes<F> &leaving, bool connected = false) const;
    // The number that a row makes with the light of the emitter sample, colour by colour.
    TR_LARGE Spectrum<F> direct(const Stokes<F> &leaving) const;
    // The derivative, `next` being the vertex behind (whose radiance is the column `arriving`). Adds as
    // sweep_scattering does; returns the number that row and column make here, without the vertex' own emission.
    TR_LARGE F sweep(const SceneOf<F> &scene, int kind, const VertexRecord<F> &v, const Stokes<F> &leaving,
                     const Stokes<F> &arriving, const NextVertex<F> &next, const GradientNeeds &needs,
                     const MaskOf<F> &active, HitAdjoint<F> &hit, Vec3<F> &d_bar, GradientSink<F> &sink) const;

private:
    // Adjoints of directions in the world, of the normal, and by the BSDF's variables.
    struct Adjoints {
        Vec3<F> wi, path, light, n;
        Spectrum<F> by_variable[BsdfInfo::MaxVariables];
    };

    TR_HD void sweep_way(const PolarizedWay<F> &way, const Stokes<F> &leaving, const Stokes<F> &column,
                         const GradientNeeds &needs, Vec3<F> &to_bar, Adjoints &bar) const;
    TR_HD void sweep_lamp(const SceneOf<F> &scene, const VertexRecord<F> &v, const PolarizedWay<F> &way,
                          const Stokes<F> &leaving, const GradientNeeds &needs, const MaskOf<F> &active,
                          HitAdjoint<F> &hit, Vec3<F> &to_bar, GradientSink<F> &sink) const;
    TR_HD void sweep_film(const SceneOf<F> &scene, const PolarizedWay<F> &way, const Stokes<F> &leaving,
                          const GradientNeeds &needs, const MaskOf<F> &active, Vec3<F> &to_bar,
                          GradientSink<F> &sink) const;
    TR_HD void sweep_plate(const SceneOf<F> &scene, const VertexRecord<F> &v, const Spectrum<F> &angle,
                           const GradientNeeds &needs, const MaskOf<F> &active, HitAdjoint<F> &hit,
                           Adjoints &bar) const;
};

}  // namespace tr
