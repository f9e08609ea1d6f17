// `thinlens`: a camera with a lens, in focus at one distance. Rays come from a disk, uniformly, and those of one point
// of the film meet in the plane of focus (Pharr, Jakob and Humphreys, "Physically Based Rendering", section 5.2.3).
#pragma once

#include "local_ray.h"
#include "perspective.h"

namespace tr {

struct ThinLens {
    enum { ToWorld, Fov, OffsetX, OffsetY, Near, Far, Aspect, Medium, ApertureRadius, FocusDistance };
    static constexpr Field fields[] = {
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, Perspective::Edges,
         "pose: camera frame to world, no scale"},
        {"x_fov", Kind::Float, None, 0, 180, Perspective::Edges, "horizontal field of view of the full film, degrees"},
        {"principal_point_offset_x", Kind::Float, 0, -INFINITY, INFINITY, Perspective::Edges,
         "moves the image left, in film widths"},
        {"principal_point_offset_y", Kind::Float, 0, -INFINITY, INFINITY, Perspective::Edges,
         "moves the image up, in film heights"},
        {"near_clip", Kind::Float, 1e-2, 0, INFINITY, "none: a clipping plane", "distance of the near plane"},
        {"far_clip", Kind::Float, 1e4, 0, INFINITY, "none: a clipping plane", "distance of the far plane"},
        {"pixel_aspect", Kind::Float, 1, 1e-3, 1e3, Perspective::Edges,
         "focal length in pixels along x over that along y; 1 for square pixels"},
        {"medium", Kind::Medium, -1, 0, INFINITY, "", "the medium that the camera is in"},
        {"aperture_radius", Kind::Float, None, 0, INFINITY, Perspective::Edges, "radius of the lens; 0 for a pinhole"},
        {"focus_distance", Kind::Float, None, 1e-6, INFINITY, Perspective::Edges,
         "distance of the plane that is in focus, along the camera's axis"},
    };
    static constexpr Model model = {"sensor", "thinlens",      "A camera with a thin lens.", fields, 10,
                                    0,        "ThinLensCamera"};

    static constexpr bool Lens = true;
    static constexpr int N = 6;
    static constexpr std::array Numbers{Fov, OffsetX, OffsetY, Aspect, ApertureRadius, FocusDistance};
    static constexpr int Table = -1, Entries = 0;

    template <class T, class F, class S>
    TR_INLINE static LocalRay<T, F> local(const T *numbers, const FilmSample<F, S> &at) {
        Vec3<T> o{numbers[4] * at.lens.x, numbers[4] * at.lens.y, T(F(0))};
        Vec3<T> focus = projective_direction(numbers, at) * numbers[5];
        return between_planes(o, focus - o, at);
    }

    template <class F, class S>
    TR_INLINE static MaskOf<F> seen(const F *numbers, const FilmSample<F, S> &at, const Vec3<F> &p, Vec2<F> &place) {
        MaskOf<F> front;
        const F x = numbers[4] * at.lens.x, y = numbers[4] * at.lens.y;
        const F scale = numbers[5] * inverse_depth(p.z, front), inverse = F(1) / numbers[5];
        const Vec2<F> slopes{(x + (p.x - x) * scale) * inverse, (y + (p.y - y) * scale) * inverse};
        place = film_fractions(numbers, half_width(numbers), slopes, at);
        return front;
    }
};

}  // namespace tr
