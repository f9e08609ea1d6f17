// `panorama`: all directions, in latitude and longitude: the rows go from +y of the camera's frame to -y, the middle of
// the film is +z and its right -x, as in the bitmap of an `envmap` that is at rest in that frame.
#pragma once

#include "local_ray.h"
#include "perspective.h"

namespace tr {

struct Panorama {
    enum { ToWorld, Near, Far, Medium };
    static constexpr Field fields[] = {
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, Perspective::Edges,
         "pose: camera frame to world, no scale"},
        {"near_clip", Kind::Float, 1e-2, 0, INFINITY, "none: a clipping surface", "where things begin to be seen"},
        {"far_clip", Kind::Float, 1e4, 0, INFINITY, "none: a clipping surface", "where they end to be seen"},
        {"medium", Kind::Medium, -1, 0, INFINITY, "", "the medium that the camera is in"},
    };
    static constexpr Model model = {"sensor", "panorama",      "A camera that sees all around.", fields, 4,
                                    0,        "PanoramaCamera"};

    static constexpr bool Lens = false;
    static constexpr int N = 0, Table = -1, Entries = 0;
    static constexpr std::array Numbers{-1};

    template <class T, class F, class S>
    TR_INLINE static LocalRay<T, F> local(const T *, const FilmSample<F, S> &at) {
        F s, c, sin_phi, cos_phi;
        sincos(at.y * F(Pi), s, c);
        sincos((at.x - F(0.5)) * F(2 * Pi), sin_phi, cos_phi);
        Vec3<T> d{-(sin_phi * s), c, cos_phi * s};
        return {{F(0), F(0), F(0)}, d, F(at.near), F(at.far - at.near), MaskOf<F>(true)};
    }

    template <class F, class S>
    TR_INLINE static MaskOf<F> seen(const F *, const FilmSample<F, S> &, const Vec3<F> &p, Vec2<F> &place) {
        F theta = atan2(sqrt(p.x * p.x + p.z * p.z), p.y), phi = atan2(-p.x, p.z);
        place = {phi * F(1 / (2 * Pi)) + F(0.5), theta * F(1 / Pi)};
        return MaskOf<F>(true);
    }
};

}  // namespace tr
