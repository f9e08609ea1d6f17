// What emitters have in common that emit from a point: from a distance r they are seen as colour * pattern / r^2, the
// pattern depending on the direction in the light's frame.
//
// Such a light is a model that says
//   ColorField    the field of a colour, -1: none           PlaceField   that of its place: `position` or `to_world`
//   HasFrame      whether it has a frame, which looks along +z; if so also
//   TextureField  the field of a texture                     NumberFields: fields of numbers, of which the first
//   pattern(d, numbers), d a unit vector of the frame,       Differentiable have derivatives
//                 for numbers and dual numbers
//   flux(numbers): on the host, the integral of the pattern's factor over all directions
// and sample(numbers, u1, u2, inverse_pdf): a direction, and 1 / its density per solid angle.
#pragma once

#include <array>

#include "../math/dual.h"
#include "../texture/slopes.h"
#include "kernels.h"

namespace tr {

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

// Where in its texture a light's pattern is looked up.
template <class F>
TR_INLINE TexturedPoint<F> pattern_point(const F &u, const F &v) {
    return {{UIntOf<F>(0u), UIntOf<F>(0u), F(0), F(0)}, {u, v}};
}

template <class Model, class F>
struct DeltaPosition {
    using S = ScalarOf<F>;
    using M = MaskOf<F>;
    using Scene = SceneView<S>;
    static constexpr int N = int(Model::Numbers);

    TR_HD static void eval(const Scene &scene, const Wavelengths<F> &waves, const EmitterPoint<F> &point,
                           const M &lanes, Spectrum<F> &r) {
        Spectrum<F> intensity = color(scene, waves, point.emitter, lanes);
        if constexpr (Model::HasFrame) {
            Numbers numbers(scene, point.emitter, lanes);
            Pattern<F> pattern = Model::pattern(direction_of_point(point.at.b1, point.at.b2), numbers.value);
            IntOf<F> texture = emitter_field<F>(scene, Model::TextureField, point.emitter, lanes);
            auto lit = lanes && pattern.lit;
            Spectrum<F> black = uniform_spectrum(F(0));
            if (any(lit)) {
                Spectrum<F> image = eval_texture(scene, waves, texture, pattern_point(pattern.u, pattern.v), lit);
                intensity = select(lit, intensity * image * pattern.factor, black);
            } else {
                intensity = black;
            }
        }
        r = select(lanes, intensity, r);
    }

    TR_HD static void sample_direct(const Scene &scene, const Vec3<F> &p, const F &, const F &, const F &,
                                    const M &lanes, EmitterSample<F> &r) {
        LightFrame<F> frame = frame_of(scene, r.point.emitter, lanes);
        Vec3<F> to_light = frame.p - p;
        F distance = norm(to_light);
        auto apart = lanes && mask<F>(distance > F(0));
        F inverse = F(1) / select(apart, distance, F(1));
        r.d = select(apart, to_light * inverse, r.d);
        r.distance = select(apart, distance, r.distance);
        r.factor = select(apart, inverse * inverse, r.factor);
        auto lit = apart;
        if constexpr (Model::HasFrame) {
            Vec3<F> local = frame.to_local(-to_light);
            local = select(apart, normalize(local), Vec3<F>{F(0), F(0), F(1)});
            Vec2<F> b = direction_to_point(local);
            r.point.at.b1 = select(apart, b.x, r.point.at.b1);
            r.point.at.b2 = select(apart, b.y, r.point.at.b2);
            Numbers numbers(scene, r.point.emitter, lanes);
            lit = lit && Model::pattern(direction_of_point(b.x, b.y), numbers.value).lit;
        }
        r.pdf = select(lit, F(1), r.pdf);
        r.delta = r.delta || apart;
    }

    TR_HD static void sample_emission(const Scene &scene, const F &, const F &a, const F &b, const F &, const F &,
                                      const F &inverse_pmf, const M &lanes, EmissionSample<F> &r) {
        Numbers numbers(scene, r.point.emitter, lanes);
        F inverse_pdf;
        Vec3<F> local = Model::sample(numbers.value, a, b, inverse_pdf);
        LightFrame<F> frame = frame_of(scene, r.point.emitter, lanes);
        r.p = select(lanes, frame.p, r.p);
        r.weight = select(lanes, inverse_pmf * inverse_pdf, r.weight);
        if constexpr (Model::HasFrame) {
            Vec2<F> at = direction_to_point(local);
            r.point.at.b1 = select(lanes, at.x, r.point.at.b1);
            r.point.at.b2 = select(lanes, at.y, r.point.at.b2);
            local = normalize(frame.to_world(local));
        }
        r.d = select(lanes, local, r.d);
    }

    TR_HD static void vjp(const Scene &scene, const EmitterPoint<F> &point, const Vec3<F> &d, const Spectrum<F> &g,
                          const GradientNeeds &needs, const M &lanes, CoordinateAdjoint<F> &, Vec3<F> &d_bar,
                          GradientSink<F> &sink) {
        if constexpr (!Model::HasFrame) {
            if (needs.emitter)
                sink.spectrum(emitter_field<F>(scene, Model::ColorField, point.emitter, lanes), g, lanes);
        } else {
            pattern_vjp(scene, point, d, g, needs.emitter, needs.geometry, lanes, d_bar, sink);
        }
    }

    // Of the falling off with the squared distance, and of the direction.
    TR_HD static void direct_vjp(const Scene &scene, const DirectAdjoint<F> &g, const M &lanes, Vec3<F> &x_bar,
                                 GradientSink<F> &sink) {
        auto near = lanes && mask<F>(g.distance < F(S(1e30)));
        if (!any(near)) return;
        F inverse = F(1) / select(near, g.distance, F(1));
        Vec3<F> D_bar = unnormalize(g.w, g.w_bar, inverse) - g.w * (F(2) * g.log_bar * inverse);
        x_bar = select(near, -D_bar, x_bar);
        sweep_place(scene, g.point.emitter, D_bar + g.end_bar, near, sink);
    }

    TR_HD static void emission_vjp(const Scene &scene, const EmissionRecord<F> &e, const NextVertex<F> &next, const F &,
                                   const CoordinateAdjoint<F> &, const Vec3<F> &d_bar, const M &lanes,
                                   GradientSink<F> &sink) {
        Vec3<F> D_bar{F(0), F(0), F(0)};
        if constexpr (Model::HasFrame) {  // the intensity changes with the direction to the next point
            D_bar = direction_adjoint(next.segment, -d_bar);
            auto meets = lanes && mask<F>(squared_norm(next.segment) > F(0));
            if (any(meets)) sweep_position(scene, next.at, next.p, D_bar, meets, sink);
        }
        sweep_place(scene, e.v.light.emitter, next.ray.o - D_bar, lanes, sink);
    }

    static double power(EmitterMeans &means, const Record &record) {
        double factor = 4 * Pi;
        if constexpr (Model::HasFrame) {
            double numbers[N + 1] = {};
            for (int i = 0; i < N; ++i) numbers[i] = means.number(record.field[Model::NumberFields[i]]);
            factor = Model::flux(numbers) * means.texture(record.field[Model::TextureField], -1);
        }
        if constexpr (Model::ColorField >= 0) factor *= means.color(record.field[Model::ColorField]);
        return factor;
    }

    static constexpr EmitterKernels<F> table() {
        return {Model::model,
                eval,
                sample_direct,
                nullptr,
                nullptr,
                TR_OF_LIGHT_PATHS(sample_emission),
                TR_OF_DERIVATIVES(vjp),
                TR_OF_DERIVATIVES(direct_vjp),
                TR_OF_DERIVATIVES(TR_OF_LIGHT_PATHS(emission_vjp)),
                TR_HOST_POINTER(power)};
    }

private:
    // A light's numbers and where they are.
    struct Numbers {
        F value[N + 1];
        IntOf<F> offset[N + 1];

        TR_INLINE Numbers(const Scene &scene, const IntOf<F> &emitter, const M &lanes) {
            if constexpr (N > 0) {
                static constexpr auto fields = Model::NumberFields;  // device code cannot point into the member
                for (int i = 0; i < N; ++i) {
                    offset[i] = emitter_field<F>(scene, fields[i], emitter, lanes);
                    value[i] = gather<F>(scene.values.constants, UIntOf<F>(offset[i]), lanes);
                }
            }
            value[N] = F(0);
            offset[N] = IntOf<F>(0);
        }
    };

    TR_INLINE static LightFrame<F> frame_of(const Scene &scene, const IntOf<F> &emitter, const M &lanes) {
        IntOf<F> offset = emitter_field<F>(scene, Model::PlaceField, emitter, lanes);
        if constexpr (Model::HasFrame) {
            return gather_frame<F>(scene, offset, lanes);
        } else {
            F position[3];
            gather_few_rows<F>(scene.values.constants, UIntOf<F>(offset), lanes, position);
            LightFrame<F> r;
            r.p = {position[0], position[1], position[2]};
            return r;
        }
    }

    TR_INLINE static Spectrum<F> color(const Scene &scene, const Wavelengths<F> &waves, const IntOf<F> &emitter,
                                       const M &lanes) {
        if constexpr (Model::ColorField < 0)
            return uniform_spectrum(F(1));
        else
            return constant_spectrum<F>(scene.values, waves, emitter_field<F>(scene, Model::ColorField, emitter, lanes),
                                        lanes);
    }

    // Hands the adjoint of a light's place to its parameter.
    TR_HD static void sweep_place(const Scene &scene, const IntOf<F> &emitter, const Vec3<F> &p_bar, const M &lanes,
                                  GradientSink<F> &sink) {
        IntOf<F> offset = emitter_field<F>(scene, Model::PlaceField, emitter, lanes);
        constexpr int first = Model::HasFrame ? 3 : 0, stride = Model::HasFrame ? 4 : 1;
        sink.scalar(offset + first, p_bar.x, lanes);
        sink.scalar(offset + (first + stride), p_bar.y, lanes);
        sink.scalar(offset + (first + 2 * stride), p_bar.z, lanes);
    }

    // `values`, `motion`: whether derivatives are wanted of what is sent; of the orientation and of d.
    TR_HD static void pattern_vjp(const Scene &scene, const EmitterPoint<F> &point, const Vec3<F> &d,
                                  const Spectrum<F> &g, bool values, bool motion, M lanes, Vec3<F> &d_bar,
                                  GradientSink<F> &sink) {
        constexpr int Variables = Model::Differentiable;
        using D = Dual<F, 3 + Variables>;
        Numbers numbers(scene, point.emitter, lanes);
        Vec3<F> l = direction_of_point(point.at.b1, point.at.b2);
        D number[N + 1];
        for (int i = 0; i <= N; ++i) number[i] = i < Variables ? D(numbers.value[i], 3 + i) : D(numbers.value[i]);
        Pattern<D> pattern = Model::pattern(Vec3<D>{D(l.x, 0), D(l.y, 1), D(l.z, 2)}, number);
        lanes = lanes && pattern.lit;
        if (!any(lanes)) return;
        const F factor = pattern.factor.v;
        TexturedPoint<F> where = pattern_point(pattern.u.v, pattern.v.v);
        IntOf<F> texture = emitter_field<F>(scene, Model::TextureField, point.emitter, lanes);
        Spectrum<F> colored = color(scene, sink.waves, point.emitter, lanes);
        Spectrum<F> image = eval_texture(scene, sink.waves, texture, where, lanes);
        TextureSlopes<F> slope = texture_slopes(scene, sink.waves, texture, where, lanes);
        // by the i-th variable
        auto derivative = [&](int i) {
            return colored *
                   (image * pattern.factor.d[i] + (slope.u * pattern.u.d[i] + slope.v * pattern.v.d[i]) * factor);
        };
        if (values) {
            if constexpr (Model::ColorField >= 0)
                sink.spectrum(emitter_field<F>(scene, Model::ColorField, point.emitter, lanes), g * image * factor,
                              lanes);
            sink.texture(scene, texture, where, g * colored * factor, lanes);
            for (int i = 0; i < Variables; ++i) sink.number(numbers.offset[i], g * derivative(3 + i), lanes);
        }
        if (!motion) return;
        CoordinateAdjoint<F> at;  // of the coordinates, which are `derivative`'s
        sweep_lookup(scene, texture, where, g * colored * factor, lanes, at, sink);
        // l is M^-1 w, normalised, w = -d
        LightFrame<F> frame = frame_of(scene, point.emitter, lanes);
        Vec3<F> l_bar{component_sum(g * derivative(0)), component_sum(g * derivative(1)),
                      component_sum(g * derivative(2))};
        Vec3<F> m = frame.to_local(-d);
        F inverse = F(1) / norm(m);
        Vec3<F> m_bar = unnormalize(m * inverse, l_bar, inverse);
        Vec3<F> turned = frame.row(0) * m_bar.x + frame.row(1) * m_bar.y + frame.row(2) * m_bar.z;
        d_bar = select(lanes, d_bar - turned, d_bar);
        IntOf<F> offset = emitter_field<F>(scene, Model::PlaceField, point.emitter, lanes);
        const F rows[3] = {turned.x, turned.y, turned.z}, columns[3] = {m.x, m.y, m.z};
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) sink.scalar(offset + (4 * i + j), -rows[i] * columns[j], lanes);
    }
};

}  // namespace tr
