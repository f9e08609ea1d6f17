// `radiancemeter`: the radiance along one ray, +z of its frame.
#pragma once

#include "local_ray.h"
#include "perspective.h"

namespace tr {

struct RadianceMeter {
    enum { ToWorld, Medium };
    static constexpr Field fields[] = {
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, Perspective::Edges,
         "the ray starts at the frame's origin and goes along its z axis"},
        {"medium", Kind::Medium, -1, 0, INFINITY, "", "the medium that the ray starts in"},
    };
    static constexpr Model model = {"sensor", "radiancemeter", "Radiance along a ray.", fields, 2, 0, "RadianceMeter"};

    static constexpr bool Lens = false;
    static constexpr int N = 0, Table = -1, Entries = 0;
    static constexpr std::array Numbers{-1};

    template <class T, class F, class S>
    TR_INLINE static LocalRay<T, F> local(const T *, const FilmSample<F, S> &) {
        return {{F(0), F(0), F(0)}, {F(0), F(0), F(1)}, F(0), F(S(INFINITY)), MaskOf<F>(true)};
    }
};

}  // namespace tr
