// What lights have in common that emit from a point: from a distance r they are seen as colour * pattern / r^2, the
// pattern depending on the direction in the light's frame.
//
// Such a light is a model derived from PointLight, which says
//   ColorField    the field of a colour, -1: none           PlaceField   that of its place: `position` or `to_world`
//   Oriented      whether it has a frame, which looks along +z; if so also
//   TextureField  the field of a texture                     number_field(i), i < Numbers: fields of numbers; the
//   pattern(d, numbers), d a unit vector of the frame,       first Differentiable of them have derivatives
//                 for numbers and dual numbers
//   sample(numbers, u1, u2, inverse_pdf): a direction, and 1 / its density per solid angle
//   flux(numbers): on the host, the integral of the pattern's factor over all directions
#pragma once

#include "../texture/texture.h"

namespace tr {

struct PointLight {
    static constexpr int TextureField = -1, Numbers = 0, Differentiable = 0;
    static constexpr int number_field(int) { return -1; }
};
template <class Model>
constexpr bool IsPointLight = std::is_base_of_v<PointLight, Model>;

// The factor of the colour, and where the texture is looked up. No light goes where it is not `lit`, and no parameter
// changes that but by moving an edge.
template <class T>
struct Pattern {
    T factor, u, v;
    MaskOf<T> lit;
};

// A point and the columns of a matrix; no frame: those of the world.
template <class F>
struct LightFrame {
    Vec3<F> p, x{F(1), F(0), F(0)}, y{F(0), F(1), F(0)}, z{F(0), F(0), F(1)};

    // The inverse of the matrix is that of its cofactors, whose rows are
    TR_INLINE Vec3<F> row(int i) const {
        Vec3<F> r = i == 0 ? cross(y, z) : i == 1 ? cross(z, x) : cross(x, y);
        return r * (F(1) / dot(x, cross(y, z)));
    }
    TR_INLINE Vec3<F> to_local(const Vec3<F> &d) const { return {dot(row(0), d), dot(row(1), d), dot(row(2), d)}; }
    TR_INLINE Vec3<F> to_world(const Vec3<F> &d) const { return x * d.x + y * d.y + z * d.z; }
};

template <class F, class S>
TR_INLINE LightFrame<F> gather_frame(const SceneView<S> &scene, const IntOf<F> &offset, const MaskOf<F> &active) {
    F m[12];
    gather_matrix<F>(scene.values.constants, UIntOf<F>(offset), active, m);
    LightFrame<F> r;
    r.x = {m[0], m[4], m[8]}, r.y = {m[1], m[5], m[9]}, r.z = {m[2], m[6], m[10]}, r.p = {m[3], m[7], m[11]};
    // lanes of other lights: something that can be inverted
    r.x = select(active, r.x, Vec3<F>{F(1), F(0), F(0)});
    r.y = select(active, r.y, Vec3<F>{F(0), F(1), F(0)});
    r.z = select(active, r.z, Vec3<F>{F(0), F(0), F(1)});
    return r;
}

template <class Model, class F, class S>
TR_INLINE LightFrame<F> point_light_frame(const SceneView<S> &scene, const IntOf<F> &emitter, const MaskOf<F> &active) {
    IntOf<F> offset = record_field<F>(scene.emitters, Model::PlaceField, emitter, active);
    if constexpr (Model::Oriented) {
        return gather_frame<F>(scene, offset, active);
    } else {
        F position[3];
        gather_few_rows<F>(scene.values.constants, UIntOf<F>(offset), active, position);
        LightFrame<F> r;
        r.p = {position[0], position[1], position[2]};
        return r;
    }
}

// A light's numbers and where they are.
template <class Model, class F>
struct LightNumbers {
    F value[Model::Numbers + 1];
    IntOf<F> offset[Model::Numbers + 1];

    template <class S>
    TR_INLINE LightNumbers(const SceneView<S> &scene, const IntOf<F> &emitter, const MaskOf<F> &active) {
        for (int i = 0; i < Model::Numbers; ++i) {
            offset[i] = record_field<F>(scene.emitters, Model::number_field(i), emitter, active);
            value[i] = gather<F>(scene.values.constants, UIntOf<F>(offset[i]), active);
        }
        value[Model::Numbers] = F(0);
        offset[Model::Numbers] = IntOf<F>(0);
    }
};

// The direction of travel in a light's frame as the two numbers that an emitter point has: stereographic, from -z.
template <class F>
TR_INLINE Vec2<F> direction_to_point(const Vec3<F> &d) {
    F above = F(1) + d.z;
    auto usable = mask<F>(above > F(1e-6));
    F inverse = F(1) / select(usable, above, F(1));
    return {select(usable, d.x * inverse, F(1e4)), select(usable, d.y * inverse, F(0))};
}
template <class F>
TR_INLINE Vec3<F> direction_of_point(const F &b1, const F &b2) {
    F s = b1 * b1 + b2 * b2, inverse = F(1) / (F(1) + s);
    return {F(2) * b1 * inverse, F(2) * b2 * inverse, (F(1) - s) * inverse};
}

template <class Model, int C, class F, class S>
TR_INLINE Color<F, C> point_light_color(const SceneView<S> &scene, const IntOf<F> &emitter, const MaskOf<F> &active) {
    if constexpr (Model::ColorField < 0)
        return uniform_color<C>(F(1));
    else
        return constant_color<C, F>(scene.values, record_field<F>(scene.emitters, Model::ColorField, emitter, active),
                                    active);
}

// Where in its texture a light's pattern is looked up.
template <class F>
TR_INLINE TexturedPoint<F> pattern_point(const F &u, const F &v) {
    return {{UIntOf<F>(0u), UIntOf<F>(0u), F(0), F(0)}, {u, v}};
}

// Intensity in the direction that `at` holds.
template <class Model, int C, class F, class S>
TR_INLINE Color<F, C> eval_point_light(const SceneView<S> &scene, const IntOf<F> &emitter, const SurfacePoint<F> &at,
                                       const MaskOf<F> &active) {
    Color<F, C> r = point_light_color<Model, C, F>(scene, emitter, active);
    if constexpr (Model::Oriented) {
        LightNumbers<Model, F> numbers(scene, emitter, active);
        Pattern<F> pattern = Model::pattern(direction_of_point(at.b1, at.b2), numbers.value);
        IntOf<F> texture = record_field<F>(scene.emitters, Model::TextureField, emitter, active);
        auto lit = active && pattern.lit;
        if (!any(lit)) return uniform_color<C>(F(0));
        Color<F, C> image = eval_texture<C>(scene, scene.values, texture, pattern_point(pattern.u, pattern.v), lit);
        r = select(lit, r * image * pattern.factor, uniform_color<C>(F(0)));
    }
    return r;
}

}  // namespace tr
