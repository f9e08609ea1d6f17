// `distant`: radiance that leaves the scene in one direction, averaged over the cross section of a ball around the
// scene (which rests in derivatives), or towards one point. Rays travel along +z of the frame, from outside of the
// scene.
#pragma once

#include "local_ray.h"
#include "perspective.h"

namespace tr {

struct Distant {
    enum { ToWorld, Target };
    static constexpr Field fields[] = {
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, Perspective::Edges,
         "its z axis is the direction in which rays travel; its place does not matter"},
        {"target", Kind::Tensor, -1, -INFINITY, INFINITY, Perspective::Edges,
         "(3,) the point that all rays meet; without it they cover the scene", nullptr, Optional},
    };
    static constexpr Model model = {
        "sensor", "distant", "Radiance that leaves the scene in a direction.", fields, 2, 0, "DistantSensor"};

    static constexpr bool Lens = true;
    static constexpr int N = 0, Table = -1, Entries = 0;
    static constexpr std::array Numbers{-1};

    // Relative to the target, or to the middle of the scene. `near` is the radius of what is covered, and `limit` how
    // far off rays start.
    template <class T, class F, class S>
    TR_INLINE static LocalRay<T, F> local(const T *, const FilmSample<F, S> &at) {
        Vec3<T> o{at.lens.x * F(at.near), at.lens.y * F(at.near), F(-at.limit)};
        return {o, {F(0), F(0), F(1)}, F(0), F(S(INFINITY)), MaskOf<F>(true)};
    }
};

}  // namespace tr
