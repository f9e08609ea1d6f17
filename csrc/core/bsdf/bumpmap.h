// `bumpmap`: a BSDF whose shading normal is that of a surface which a texture lifts: with heights h the tangents become
// dp/du + n (dh/du - n.dp/du), and likewise along v (Blinn, "Simulation of Wrinkled Surfaces", SIGGRAPH 1978). Normals
// that hide from the viewer and light near the terminator are treated as by `normalmap`.
#pragma once

#include "normalmap.h"

namespace tr {

struct BumpMap {
    enum { Heights, Nested, Flip, Shadowing, Scale };  // the first four as in NormalMap
    static constexpr Field fields[] = {
        {"nested_texture", Kind::Texture, None, -INFINITY, INFINITY,
         "interior, without the jumps of slopes between texels, and where a normal begins to hide from the viewer",
         "heights, in units of the scene; of a colour its luminance"},
        {"nested_bsdf", Kind::Bsdf, None, 0, INFINITY, "", "what is seen with the turned normal"},
        {"flip_invalid_normals", Kind::Int, 1, 0, 1, "", "turn normals that face away from the viewer towards it",
         Boolean},
        {"use_shadowing_function", Kind::Int, 1, 0, 1, "", "dim light near the terminator", Boolean},
        {"scale", Kind::Float, 1, -INFINITY, INFINITY, "interior, without the jump where a normal begins to hide",
         "factor of the heights"},
    };
    static constexpr Model model = {
        "bsdf", "bumpmap", "A BSDF with normals from heights.", fields, 5, WrapsBsdfs | PerturbsNormals, "BumpMap"};

    // `z`, `side` and `sign` as in NormalMap::turn; `u`, `v`: dp/du and dp/dv; (hu, hv): the slopes of the heights.
    template <class T, class F>
    TR_INLINE static Vec3<T> turn(const Vec3<T> &z, const F &side, const Vec3<T> &u, const Vec3<T> &v, const T &hu,
                                  const T &hv, const F &sign) {
        Vec3<T> n = z * T(side), a = u + n * (hu - dot(n, u)), b = v + n * (hv - dot(n, v)), m = cross(a, b);
        T squared = squared_norm(m);
        auto usable = mask<F>(value_of(squared) > F(0));
        T inverse = T(1) / sqrt(select(usable, squared, T(1))), up = dot(m, n) * inverse;
        inverse = select(mask<F>(value_of(up) < F(0)), -inverse, inverse);  // of mirrored texture coordinates
        Vec3<T> along = (m - n * dot(m, n)) * (inverse * T(sign)), r = along + z * abs(up);
        return {select(usable, r.x, z.x), select(usable, r.y, z.y), select(usable, r.z, z.z)};
    }
};

}  // namespace tr
