// `normalmap`: a BSDF whose shading normal an image turns: red, green and blue are (n + 1) / 2, n being the normal in
// the frame of dp/du, made orthogonal to the shading normal, the vector orthogonal to both, and the shading normal.
//
// Where the turned normal hides from the viewer (flip_invalid_normals) its tangential part is reversed. Light is dimmed
// near the terminator (use_shadowing_function) by Estevez, Lecocq and Stein, "A Microfacet-Based Shadowing Function to
// Solve the Bump Terminator Problem", Ray Tracing Gems, 2019, chapter 12.
#pragma once

#include "../math/dual.h"
#include "../model.h"

namespace tr {

struct NormalMap {
    enum { Map, Nested, Flip, Shadowing };
    static constexpr Field fields[] = {
        {"normalmap", Kind::Texture, None, -INFINITY, INFINITY,
         "interior, without the jump where a normal begins to hide from the viewer", "normals as colours, (n + 1) / 2"},
        {"nested_bsdf", Kind::Bsdf, None, 0, INFINITY, "", "what is seen with the turned normal"},
        {"flip_invalid_normals", Kind::Int, 1, 0, 1, "", "turn normals that face away from the viewer towards it",
         Boolean},
        {"use_shadowing_function", Kind::Int, 1, 0, 1, "", "dim light near the terminator", Boolean},
    };
    static constexpr Model model = {"bsdf",     "normalmap", "A BSDF with normals from an image.",
                                    fields,     4,           WrapsBsdfs | PerturbsNormals,
                                    "NormalMap"};

    // `z`: the shading normal on the side that is shaded, `side` -1 where that is the back; `tangent`: dp/du;
    // `sign` -1 reverses the tangential part.
    template <class T, class F>
    TR_INLINE static Vec3<T> turn(const Vec3<T> &z, const F &side, const Vec3<T> &tangent, const Vec3<T> &map,
                                  const F &sign) {
        Vec3<T> along = tangent - z * dot(z, tangent);
        F size = value_of(squared_norm(along));
        auto usable = mask<F>(size > F(0));
        Vec3<T> s = along * (T(1) / sqrt(select(usable, squared_norm(along), T(1))));
        Vec3<T> t = cross(z, s) * T(side);
        T x = (map.x * T(2) - T(1)) * T(sign), y = (map.y * T(2) - T(1)) * T(sign), up = map.z * T(2) - T(1);
        Vec3<T> n = s * x + t * y + z * up;
        T squared = squared_norm(n);
        auto some = mask<F>(value_of(squared) > F(1e-12));
        Vec3<T> unit = n * (T(1) / sqrt(select(some, squared, T(1))));
        return {select(some, unit.x, z.x), select(some, unit.y, z.y), select(some, unit.z, z.z)};
    }

    // What is left of light from the direction `light`.
    template <class T, class F>
    TR_INLINE static T shadowing(const Vec3<T> &base, const Vec3<T> &n, const Vec3<T> &light, const F &least) {
        auto tangent2 = [&](const T &cosine) {
            T squared = max(cosine * cosine, T(least));
            return max(T(1) - squared, T(F(0))) / squared;
        };
        T alpha2 = min(tangent2(dot(base, n)) * T(F(0.125)), T(F(1)));
        return T(F(2)) / (T(F(1)) + sqrt(T(F(1)) + alpha2 * tangent2(dot(base, light))));
    }
};

}  // namespace tr
