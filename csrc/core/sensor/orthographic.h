// `orthographic`: parallel rays. The film's width is [-1, 1] of the camera's frame, so that the scale of the image is
// that of `to_world`.
#pragma once

#include "local_ray.h"
#include "perspective.h"

namespace tr {

struct Orthographic {
    enum { ToWorld, Near, Far, Medium };
    static constexpr Field fields[] = {
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, Perspective::Edges,
         "camera frame to world; its scale is half of the film's width"},
        {"near_clip", Kind::Float, 1e-2, 0, INFINITY, "none: a clipping plane", "distance of the near plane"},
        {"far_clip", Kind::Float, 1e4, 0, INFINITY, "none: a clipping plane", "distance of the far plane"},
        {"medium", Kind::Medium, -1, 0, INFINITY, "", "the medium that the camera is in"},
    };
    static constexpr Model model = {"sensor", "orthographic",      "A camera of parallel rays.", fields, 4,
                                    0,        "OrthographicCamera"};

    static constexpr bool Lens = false;
    static constexpr int N = 0, Table = -1, Entries = 0;
    static constexpr std::array Numbers{-1};

    template <class T, class F, class S>
    TR_INLINE static LocalRay<T, F> local(const T *, const FilmSample<F, S> &at) {
        Vec3<T> o{F(1) - F(2) * at.x, (F(1) - F(2) * at.y) * F(at.height), F(0)};
        return {o, {F(0), F(0), F(1)}, F(at.near), F(at.far - at.near), MaskOf<F>(true)};
    }

    template <class F, class S>
    TR_INLINE static MaskOf<F> seen(const F *, const FilmSample<F, S> &at, const Vec3<F> &p, Vec2<F> &place) {
        place = {(F(1) - p.x) * F(0.5), (F(1) - p.y * F(S(1) / at.height)) * F(0.5)};
        return MaskOf<F>(true);
    }
};

}  // namespace tr
