// The camera as light paths see it: where on the film a point is seen, and with which importance. That of a pinhole is
// a delta function of position; what is left, integrated over the film in pixels, is d(film) / d(solid angle).
#pragma once

#include "perspective.h"

namespace tr {

// A pinhole at rest, with what all points share. A direction l = (x, y, 1) of the camera's frame is M l in the world;
// solid angle there is |det M| / |M l|^3 times area of the plane z = 1, of which the film takes 4 slope rise.
template <class S>
struct Pinhole {
    S inverse[9]{}, determinant{};  // of M
    Vec3<S> origin{S(0), S(0), S(0)};
    S slope{}, rise{}, offset_x{}, offset_y{}, near{}, far{}, width, height;

    TR_HD Pinhole(S width_, S height_) : width(width_), height(height_) {}  // a film without a camera

    TR_HD Pinhole(const SceneView<S> &scene, const Record &record, S width_, S height_)
        : width(width_), height(height_) {
        Perspective::FilmPoint<S, S> film(scene, record, S(0), S(0), width, height);
        const S *m = film.to_world;
        const double a[9] = {m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]};
        const double cofactor[9] = {a[4] * a[8] - a[5] * a[7], a[2] * a[7] - a[1] * a[8], a[1] * a[5] - a[2] * a[4],
                                    a[5] * a[6] - a[3] * a[8], a[0] * a[8] - a[2] * a[6], a[2] * a[3] - a[0] * a[5],
                                    a[3] * a[7] - a[4] * a[6], a[1] * a[6] - a[0] * a[7], a[0] * a[4] - a[1] * a[3]};
        double d = a[0] * cofactor[0] + a[1] * cofactor[3] + a[2] * cofactor[6];
        for (int i = 0; i < 9; ++i) inverse[i] = S(cofactor[i] / d);
        determinant = S(std::fabs(d));
        origin = film.origin();
        slope = film.slope, rise = film.rise;
        const S *c = film.constants;
        offset_x = c[record.field[Perspective::OffsetX]], offset_y = c[record.field[Perspective::OffsetY]];
        near = c[record.field[Perspective::Near]], far = c[record.field[Perspective::Far]];
    }

    template <class F>
    TR_INLINE Vec3<F> to_camera(const Vec3<F> &y) const {
        return {y.x * inverse[0] + y.y * inverse[1] + y.z * inverse[2],
                y.x * inverse[3] + y.y * inverse[4] + y.z * inverse[5],
                y.x * inverse[6] + y.y * inverse[7] + y.z * inverse[8]};
    }
};

template <class F>
struct Connection {
    Vec3<F> d;          // unit direction to the pinhole
    F distance, clear;  // to the pinhole, and to the near plane in front of it
    F x, y;             // on the film, in pixels
    F importance;       // times radiance sent there, per area perpendicular to d at the point: what a pixel gets
    MaskOf<F> seen;
};

// The camera seen from p; `parallel`: p is a direction to a point that is infinitely far away, and importance is per
// solid angle at the camera.
template <class F, class S>
TR_INLINE Connection<F> connect(const Pinhole<S> &camera, const Vec3<F> &p, const MaskOf<F> &parallel,
                                const MaskOf<F> &active) {
    Connection<F> r;
    Vec3<F> origin{F(camera.origin.x), F(camera.origin.y), F(camera.origin.z)};
    Vec3<F> y = select(parallel, p, p - origin), q = camera.to_camera(y);
    F squared = squared_norm(y);
    auto front = active && mask<F>(q.z > F(0)) && mask<F>(squared > F(0));
    squared = select(front, squared, F(1));
    F z = select(front, q.z, F(1)), inverse_z = F(1) / z;
    r.distance = sqrt(squared);
    F inverse = F(1) / r.distance;
    r.d = y * (-inverse);
    F a = q.x * inverse_z * F(S(1) / camera.slope), b = q.y * inverse_z * F(S(1) / camera.rise);
    r.x = ((F(1) - a) * F(0.5) - F(camera.offset_x)) * F(camera.width);
    r.y = ((F(1) - b) * F(0.5) - F(camera.offset_y)) * F(camera.height);
    S pixels = camera.width * camera.height / (S(4) * camera.slope * camera.rise * camera.determinant);
    r.importance = r.distance * inverse_z * inverse_z * inverse_z * F(pixels);
    r.importance = select(parallel, r.importance * squared, r.importance);
    r.clear = r.distance * (F(1) - F(camera.near) * inverse_z);
    auto between = mask<F>(z > F(camera.near)) && mask<F>(z < F(camera.far));
    r.seen = front && (parallel || between);
    return r;
}

}  // namespace tr
