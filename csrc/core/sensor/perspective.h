// `perspective`: a pinhole camera. It looks along +z of its frame, +x is left in the image and +y up.
#pragma once

#include "../shape/surface.h"

namespace tr {

struct Perspective {
    enum { ToWorld, Fov, OffsetX, OffsetY, Near, Far };
    static constexpr const char *Missing = "none: the derivative of a camera is not implemented yet";
    static constexpr Field fields[] = {
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, Missing, "pose: camera frame to world, no scale"},
        {"x_fov", Kind::Float, None, 0, 180, Missing, "horizontal field of view of the full film, degrees"},
        {"principal_point_offset_x", Kind::Float, 0, -INFINITY, INFINITY, Missing,
         "moves the image left, in film widths"},
        {"principal_point_offset_y", Kind::Float, 0, -INFINITY, INFINITY, Missing,
         "moves the image up, in film heights"},
        {"near_clip", Kind::Float, 1e-2, 0, INFINITY, "none: a clipping plane", "distance of the near plane"},
        {"far_clip", Kind::Float, 1e4, 0, INFINITY, "none: a clipping plane", "distance of the far plane"},
    };
    static constexpr Model model = {"sensor", "perspective", "A pinhole camera.", fields, 6};

    // (x, y): position on the film in pixels, the whole film being width x height. Returns the ray's length too.
    template <class F, class S>
    TR_INLINE static Ray<F> ray(const SceneView<S> &scene, const Record &record, const F &x, const F &y, S width,
                                S height, F &length) {
        const S *c = scene.values.constants, *m = c + record.field[ToWorld];
        S t = std::tan(c[record.field[Fov]] * S(Pi / 360)), near = c[record.field[Near]], far = c[record.field[Far]];
        F px = F(2) * (x * F(S(1) / width) + F(c[record.field[OffsetX]]));
        F py = F(2) * (y * F(S(1) / height) + F(c[record.field[OffsetY]]));
        Vec3<F> local = normalize(Vec3<F>{(F(1) - px) * t, (F(1) - py) * (t * height / width), F(1)});
        F inverse_z = F(1) / local.z;
        Ray<F> r;
        r.d = normalize(transform_vector(m, local));
        r.o = Vec3<F>{F(m[3]), F(m[7]), F(m[11])} + r.d * (inverse_z * near);
        length = inverse_z * (far - near);
        return r;
    }
};

}  // namespace tr
