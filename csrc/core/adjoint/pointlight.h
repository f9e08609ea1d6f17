// The derivative of lights that emit from a point, and of parallel light: with respect to what they send, to their
// place and to their orientation.
#pragma once

#include "../texture/slopes.h"
#include "arrival.h"

namespace tr {

// Hands the adjoint of a light's place to its parameter.
template <class Model, class F, class S, class Sink>
TR_INLINE void sweep_light_place(const SceneView<S> &scene, const IntOf<F> &emitter, const Vec3<F> &p_bar,
                                 const MaskOf<F> &active, Sink &sink) {
    IntOf<F> offset = record_field<F>(scene.emitters, Model::PlaceField, emitter, active);
    constexpr int first = Model::Oriented ? 3 : 0, stride = Model::Oriented ? 4 : 1;
    sink.scalar(offset + first, p_bar.x, active);
    sink.scalar(offset + (first + stride), p_bar.y, active);
    sink.scalar(offset + (first + 2 * stride), p_bar.z, active);
}

// Hands the adjoint of the direction of parallel light to its matrix.
template <class F, class S, class Sink>
TR_INLINE void sweep_light_axis(const SceneView<S> &scene, const IntOf<F> &emitter, const Vec3<F> &d_bar,
                                const MaskOf<F> &active, Sink &sink) {
    Vec3<F> axis = DirectionalEmitter::axis<F>(scene, emitter, active);
    F inverse = F(1) / norm(axis);
    Vec3<F> bar = unnormalize(axis * inverse, d_bar, inverse);
    IntOf<F> offset = record_field<F>(scene.emitters, DirectionalEmitter::ToWorld, emitter, active);
    sink.scalar(offset + 2, bar.x, active);
    sink.scalar(offset + 6, bar.y, active);
    sink.scalar(offset + 10, bar.z, active);
}

// What a light sends along -d, `point` being that direction in its frame; g is the adjoint. `values`, `motion`: whether
// derivatives are wanted of what it sends there; of its orientation and of d, whose adjoint is added to d_bar.
template <class Model, int C, class F, class S, class Sink>
TR_NOINLINE void sweep_point_light(const SceneView<S> &scene, const EmitterPoint<F> &point, const Vec3<F> &d,
                                   const Color<F, C> &g, bool values, bool motion, MaskOf<F> active, Vec3<F> &d_bar,
                                   Sink &sink) {
    if constexpr (!Model::Oriented) {
        if (values)
            sink.color(scene, record_field<F>(scene.emitters, Model::ColorField, point.emitter, active), g, active);
    } else {
        constexpr int N = Model::Differentiable;
        using D = Dual<F, 3 + N>;
        LightNumbers<Model, F> numbers(scene, point.emitter, active);
        Vec3<F> l = direction_of_point(point.at.b1, point.at.b2);
        D number[Model::Numbers + 1];
        for (int i = 0; i <= Model::Numbers; ++i) number[i] = i < N ? D(numbers.value[i], 3 + i) : D(numbers.value[i]);
        Pattern<D> pattern = Model::pattern(Vec3<D>{D(l.x, 0), D(l.y, 1), D(l.z, 2)}, number);
        active = active && pattern.lit;
        if (!any(active)) return;
        const F factor = pattern.factor.v;
        TexturedPoint<F> where = pattern_point(pattern.u.v, pattern.v.v);
        IntOf<F> texture = record_field<F>(scene.emitters, Model::TextureField, point.emitter, active);
        Color<F, C> color = point_light_color<Model, C, F>(scene, point.emitter, active);
        Color<F, C> image = eval_texture<C>(scene, scene.values, texture, where, active);
        TextureSlopes<F, C, S> slope{scene};
        visit_texture<F>(scene, texture, where, active, slope);
        // by the i-th variable
        auto derivative = [&](int i) {
            return color *
                   (image * pattern.factor.d[i] + (slope.u * pattern.u.d[i] + slope.v * pattern.v.d[i]) * factor);
        };
        if (values) {
            if constexpr (Model::ColorField >= 0) {
                IntOf<F> field = record_field<F>(scene.emitters, Model::ColorField, point.emitter, active);
                sink.color(scene, field, g * image * factor, active);
            }
            sink.texture(scene, texture, where, g * color * factor, active);
            for (int i = 0; i < N; ++i) sink.number(scene, numbers.offset[i], g * derivative(3 + i), active);
        }
        if (!motion) return;
        CoordinateAdjoint<F> at;  // of the coordinates, which are `derivative`'s
        sweep_lookup<C>(scene, texture, where, g * color * factor, active, at, sink);
        // l is M^-1 w, normalised, w = -d
        LightFrame<F> frame = point_light_frame<Model, F>(scene, point.emitter, active);
        Vec3<F> l_bar{channel_sum(g * derivative(0)), channel_sum(g * derivative(1)), channel_sum(g * derivative(2))};
        Vec3<F> m = frame.to_local(-d);
        F inverse = F(1) / norm(m);
        Vec3<F> m_bar = unnormalize(m * inverse, l_bar, inverse);
        Vec3<F> turned = frame.row(0) * m_bar.x + frame.row(1) * m_bar.y + frame.row(2) * m_bar.z;
        d_bar = select(active, d_bar - turned, d_bar);
        IntOf<F> offset = record_field<F>(scene.emitters, Model::PlaceField, point.emitter, active);
        const F rows[3] = {turned.x, turned.y, turned.z}, columns[3] = {m.x, m.y, m.z};
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) sink.scalar(offset + (4 * i + j), -rows[i] * columns[j], active);
    }
}

}  // namespace tr
