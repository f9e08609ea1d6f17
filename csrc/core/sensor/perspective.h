// `perspective`: a pinhole camera. It looks along +z of its frame, +x is left in the image and +y up.
#pragma once

#include "../shape/surface.h"

namespace tr {

struct Perspective {
    enum { ToWorld, Fov, OffsetX, OffsetY, Near, Far, Aspect, Medium, Distortion };
    static constexpr const char *Edges =
        "interior, without the motion of silhouettes of curves and grids of distances, of edges that "
        "are seen in mirrors or through glass, and of jumps of textures; zero where these are out of view or both "
        "sides of them are of equal colour";
    static constexpr Field fields[] = {
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, Edges, "pose: camera frame to world, no scale"},
        {"x_fov", Kind::Float, None, 0, 180, Edges, "horizontal field of view of the full film, degrees"},
        {"principal_point_offset_x", Kind::Float, 0, -INFINITY, INFINITY, Edges,
         "moves the image left, in film widths"},
        {"principal_point_offset_y", Kind::Float, 0, -INFINITY, INFINITY, Edges, "moves the image up, in film heights"},
        {"near_clip", Kind::Float, 1e-2, 0, INFINITY, "none: a clipping plane", "distance of the near plane"},
        {"far_clip", Kind::Float, 1e4, 0, INFINITY, "none: a clipping plane", "distance of the far plane"},
        {"pixel_aspect", Kind::Float, 1, 1e-3, 1e3, Edges,
         "focal length in pixels along x over that along y; 1 for square pixels"},
        {"medium", Kind::Medium, -1, 0, INFINITY, "", "the medium that the camera is in"},
        {"distortion", Kind::Tensor, -1, -INFINITY, INFINITY, Edges,
         "(8,) coefficients of the lens, in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6; see distorted.h", nullptr,
         Optional},
    };
    static constexpr Model model = {"sensor", "perspective", "A pinhole camera.", fields, 9, 0, "PerspectiveCamera"};

    // (x, y): position on the film in pixels, the whole film being width x height. The direction in the camera's frame
    // is (a x slope, b y slope, 1), normalised.
    template <class F, class S>
    struct FilmPoint {
        const S *constants, *to_world;
        S slope, rise;  // tangents of half the fields of view along x and y
        F a, b;

        TR_INLINE FilmPoint(const SceneView<S> &scene, const Record &record, const F &x, const F &y, S width, S height)
            : constants(scene.values.constants), to_world(constants + record.field[ToWorld]) {
            slope = std::tan(constants[record.field[Fov]] * S(Pi / 360));
            rise = slope * height / width * constants[record.field[Aspect]];
            a = F(1) - F(2) * (x * F(S(1) / width) + F(constants[record.field[OffsetX]]));
            b = F(1) - F(2) * (y * F(S(1) / height) + F(constants[record.field[OffsetY]]));
        }
        TR_INLINE Vec3<F> direction() const { return {a * slope, b * rise, F(1)}; }
        TR_INLINE Vec3<F> origin() const { return {F(to_world[3]), F(to_world[7]), F(to_world[11])}; }
    };

    // Returns the ray's length too, and the pinhole `center` it comes from.
    template <class F, class S>
    TR_INLINE static Ray<F> ray(const SceneView<S> &scene, const Record &record, const F &x, const F &y, S width,
                                S height, F &length, Vec3<F> &center) {
        FilmPoint<F, S> film(scene, record, x, y, width, height);
        S near = film.constants[record.field[Near]], far = film.constants[record.field[Far]];
        Vec3<F> local = normalize(film.direction());
        F inverse_z = F(1) / local.z;
        Ray<F> r;
        center = film.origin();
        r.d = normalize(transform_vector(film.to_world, local));
        r.o = center + r.d * (inverse_z * near);
        length = inverse_z * (far - near);
        return r;
    }
};

}  // namespace tr
