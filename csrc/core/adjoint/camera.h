// The derivative of a camera ray (from the pinhole along a unit vector) with respect to the camera's parameters.
#pragma once

#include "../sensor/perspective.h"
#include "surface.h"

namespace tr {

// `direction_bar`: of FilmPoint::direction, where more than the ray depends on it.
template <class F, class S, class Sink>
TR_NOINLINE void sweep_camera(const SceneView<S> &scene, const Record &record, const F &x, const F &y, S width,
                              S height, const RayAdjoint<F> &g, const Vec3<F> &direction_bar, const MaskOf<F> &active,
                              Sink &sink) {
    Perspective::FilmPoint<F, S> film(scene, record, x, y, width, height);
    Vec3<F> u = film.direction();
    F inverse = F(1) / norm(u);
    Vec3<F> local = u * inverse;
    Vec3<F> m = transform_vector(film.to_world, local);
    F inverse_m = F(1) / norm(m);
    Vec3<F> m_bar = unnormalize(m * inverse_m, g.d, inverse_m);

    const F row[3] = {m_bar.x, m_bar.y, m_bar.z}, move[3] = {g.o.x, g.o.y, g.o.z},
            column[3] = {local.x, local.y, local.z};
    int32_t to_world = record.field[Perspective::ToWorld];
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) sink.scalar(IntOf<F>(to_world + 4 * i + j), row[i] * column[j], active);
        sink.scalar(IntOf<F>(to_world + 4 * i + 3), move[i], active);
    }

    Vec3<F> u_bar = unnormalize(local, transform_normal(film.to_world, m_bar), inverse) + direction_bar;
    auto add = [&](int field, const F &value) { sink.scalar(IntOf<F>(record.field[field]), value, active); };
    F by_x = u_bar.x * film.slope, by_y = u_bar.y * film.rise;
    add(Perspective::OffsetX, by_x * F(-2));
    add(Perspective::OffsetY, by_y * F(-2));
    add(Perspective::Aspect, by_y * film.b * (S(1) / film.constants[record.field[Perspective::Aspect]]));
    S degrees = (S(1) + film.slope * film.slope) / film.slope * S(Pi / 360);  // d slope / d fov, over slope
    add(Perspective::Fov, (by_x * film.a + by_y * film.b) * degrees);
}

template <class F, class S, class Sink>
TR_INLINE void sweep_camera(const SceneView<S> &scene, const Record &record, const F &x, const F &y, S width, S height,
                            const RayAdjoint<F> &g, const MaskOf<F> &active, Sink &sink) {
    sweep_camera(scene, record, x, y, width, height, g, Vec3<F>{F(0), F(0), F(0)}, active, sink);
}

}  // namespace tr
