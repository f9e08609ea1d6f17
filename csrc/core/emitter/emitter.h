// All emitters: choosing one and a direction to it, the density of that choice, and what it sends.
#pragma once

#include "../typelist.h"
#include "area.h"
#include "constant.h"
#include "directional.h"
#include "directionalarea.h"
#include "envmap.h"
#include "point.h"
#include "projector.h"
#include "spot.h"

namespace tr {

// A model's kind is its position here.
using Emitters = TypeList<AreaEmitter, ConstantEmitter, EnvironmentMap, PointEmitter, DirectionalAreaEmitter,
                          DirectionalEmitter, SpotEmitter, ProjectorEmitter>;

// Those that have code of their own; point lights go by their models.
enum class EmitterKind : int32_t {
    Area = kind_of_model<AreaEmitter>(Emitters{}),
    Constant = kind_of_model<ConstantEmitter>(Emitters{}),
    EnvironmentMap = kind_of_model<tr::EnvironmentMap>(Emitters{}),
    DirectionalArea = kind_of_model<DirectionalAreaEmitter>(Emitters{}),
    Directional = kind_of_model<DirectionalEmitter>(Emitters{})
};

// Calls visit(model, lanes) for every model of a point light that lanes have.
template <class F, class Visit>
TR_INLINE void for_each_point_light(const IntOf<F> &kind, const MaskOf<F> &active, Visit &&visit) {
    for_each_model(Emitters{}, [&](auto model) {
        using Model = decltype(model);
        if constexpr (IsPointLight<Model>) {
            auto lanes = active && mask<F>(kind == int32_t(kind_of_model<Model>(Emitters{})));
            if (any(lanes)) visit(model, lanes);
        }
    });
}

// Light from all around, which the camera sees; and light that comes from infinitely far away.
template <class F>
TR_INLINE MaskOf<F> is_surrounding(const IntOf<F> &kind) {
    return mask<F>(kind == int32_t(EmitterKind::Constant)) || mask<F>(kind == int32_t(EmitterKind::EnvironmentMap));
}
template <class F>
TR_INLINE MaskOf<F> is_parallel(const IntOf<F> &kind) {
    return is_surrounding<F>(kind) || mask<F>(kind == int32_t(EmitterKind::Directional));
}

// Of a shape: such records have the shape's index.
constexpr bool is_surface_emitter(int32_t kind) {
    return kind == int32_t(EmitterKind::Area) || kind == int32_t(EmitterKind::DirectionalArea);
}

// Where on which emitter: on an area light a surface point; of an environment map (b1, b2) are its coordinates, of a
// point light the direction in its frame (pointlight.h).
template <class F>
struct EmitterPoint {
    IntOf<F> emitter;
    SurfacePoint<F> at;
};

template <class F>
struct EmitterSample {
    EmitterPoint<F> point;
    Vec3<F> d;  // unit direction from the reference point
    F distance;
    F pdf;     // per solid angle, times the probability of the emitter; 0: nothing arrives
    F factor;  // radiance arriving = factor * emitted: 1, or 1 / distance^2 of point lights
    MaskOf<F> delta;
};

template <class F>
TR_INLINE EmitterSample<F> no_emitter_sample() {
    EmitterSample<F> r;
    r.point = {IntOf<F>(-1), {UIntOf<F>(0u), UIntOf<F>(0u), F(0), F(0)}};
    r.d = {F(0), F(0), F(1)};
    r.distance = r.factor = F(1);
    r.pdf = F(0);
    r.delta = MaskOf<F>(false);
    return r;
}

// Emitted radiance (point lights: intensity; `directional`: irradiance).
template <int C, class F, class S>
TR_INLINE Color<F, C> eval_emitter(const SceneView<S> &scene, const EmitterPoint<F> &point, const MaskOf<F> &active) {
    RecordLanes<F> record(scene.emitters, point.emitter, active);
    const IntOf<F> &kind = record.kind();
    Color<F, C> r = uniform_color<C>(F(0));
    auto area = active && mask<F>(kind == int32_t(EmitterKind::Area));
    if (any(area)) {
        IntOf<F> texture = record.field(AreaEmitter::Radiance);
        r = select(area, eval_texture<C>(scene, scene.values, texture, point.at, area), r);
    }
    // radiance of `constant`, irradiance of `directional`: both are field 0
    auto flat = active &&
                (mask<F>(kind == int32_t(EmitterKind::Constant)) || mask<F>(kind == int32_t(EmitterKind::Directional)));
    if (any(flat)) {
        r = select(flat, constant_color<C, F>(scene.values, record.field(0), flat), r);
    }
    for_each_point_light<F>(kind, active, [&](auto model, const MaskOf<F> &lanes) {
        r = select(lanes, eval_point_light<decltype(model), C>(scene, point.emitter, point.at, lanes), r);
    });
    auto map = active && mask<F>(kind == int32_t(EmitterKind::EnvironmentMap));
    if (any(map)) {
        const Record &record = scene.emitters[scene.environment];
        const TensorView<S> &tensor = scene.values.tensors[record.field[EnvironmentMap::Data]];
        F scale(scene.values.constants[record.field[EnvironmentMap::Scale]]);
        auto at = EnvironmentMap::footprint(tensor, Vec2<F>{point.at.b1, point.at.b2});
        r = select(map, gather_footprint<C>(tensor, at, map) * scale, r);
    }
    return r;
}

// The environment in direction d as an emitter point.
template <class F, class S>
TR_INLINE EmitterPoint<F> environment_point(const SceneView<S> &scene, const Vec3<F> &d) {
    EmitterPoint<F> r;
    r.emitter = IntOf<F>(scene.environment);
    r.at.shape = r.at.primitive = UIntOf<F>(0u);
    r.at.b1 = r.at.b2 = F(0);
    if (scene.emitters[scene.environment].kind == int32_t(EmitterKind::EnvironmentMap)) {
        Vec2<F> uv = EnvironmentMap::to_uv(scene, d);
        r.at.b1 = uv.x;
        r.at.b2 = uv.y;
    }
    return r;
}

template <class F, class S>
TR_INLINE F environment_pdf(const SceneView<S> &scene, const EmitterPoint<F> &point, const MaskOf<F> &active) {
    F pdf(1 / (4 * Pi));
    if (scene.emitters[scene.environment].kind == int32_t(EmitterKind::EnvironmentMap))
        pdf = EnvironmentMap::pdf(scene, Vec2<F>{point.at.b1, point.at.b2}, active);
    return pdf * F(scene.emitter_pmf[scene.environment]);
}

// Density with which sample_emitter, at p, chooses the point of an area light that a ray in direction d has hit.
template <class F, class S>
TR_INLINE F area_light_pdf(const SceneView<S> &scene, const IntOf<F> &emitter, const UIntOf<F> &shape, const Vec3<F> &p,
                           const Vec3<F> &hit, const Vec3<F> &n, const MaskOf<F> &active) {
    Direction<F> to_light(hit - p);
    return area_emitter_pdf(scene, shape, p, n, to_light.d, to_light.length, active) *
           gather<F>(scene.emitter_pmf, UIntOf<F>(emitter), active);
}

// An emitter, the probability of choosing it, and a uniform number that is left of the one that chose.
template <class F>
struct ChosenEmitter {
    UIntOf<F> index{0u};
    F pmf, left;
};

template <class F, class S>
TR_INLINE ChosenEmitter<F> choose_emitter(const SceneView<S> &scene, const F &u, const MaskOf<F> &active) {
    using U = UIntOf<F>;
    ChosenEmitter<F> r;
    r.left = u;
    if (scene.n_emitters > 1) {
        r.index = search_cdf<F>(scene.emitter_cdf, U(0u), U(uint32_t(scene.n_emitters)), u, active);
        r.pmf = gather<F>(scene.emitter_pmf, r.index, active);
        F before = select(mask<F>(r.index > 0u), gather<F>(scene.emitter_cdf, max(r.index, U(1u)) - 1u, active), F(0));
        r.left = max(F(0), min((u - before) / max(r.pmf, F(1e-20)), F(1 - 1e-7)));
    } else {
        r.pmf = F(scene.emitter_pmf[0]);
    }
    return r;
}

// A direction to the environment, with its density and what eval_emitter takes of it.
template <class F, class S>
TR_INLINE Vec3<F> sample_environment(const SceneView<S> &scene, const F &u1, const F &u2, Vec2<F> &uv, F &pdf,
                                     const MaskOf<F> &active) {
    if (scene.emitters[scene.environment].kind == int32_t(EmitterKind::EnvironmentMap))
        return EnvironmentMap::sample(scene, u1, u2, uv, pdf, active);
    uv = {F(0), F(0)};
    pdf = F(1 / (4 * Pi));
    return square_to_sphere(u1, u2);
}

// u0 chooses the emitter and, with what is left of it, the face of a mesh light; u1, u2 the point or direction.
template <class F, class S>
TR_INLINE EmitterSample<F> sample_emitter(const SceneView<S> &scene, const Vec3<F> &p, const F &u0, const F &u1,
                                          const F &u2, const MaskOf<F> &active) {
    using U = UIntOf<F>;
    EmitterSample<F> r = no_emitter_sample<F>();
    auto [index, pmf, left] = choose_emitter(scene, u0, active);
    r.point.emitter = IntOf<F>(index);
    IntOf<F> kind = record_kind<F>(scene.emitters, r.point.emitter, active);

    auto area = active && mask<F>(kind == int32_t(EmitterKind::Area));
    if (any(area)) {
        U shape = U(record_field<F>(scene.emitters, AreaEmitter::ShapeIndex, r.point.emitter, area));
        SampledPoint<F> q = sample_area_emitter(scene, shape, p, left, u1, u2, area);
        Direction<F> to_light(q.p - p);
        auto facing = area && mask<F>(dot(q.n, to_light.d) < F(0));
        r.point.at.shape = select(mask<U>(area), q.at.shape, r.point.at.shape);
        r.point.at.primitive = select(mask<U>(area), q.at.primitive, r.point.at.primitive);
        r.point.at.b1 = select(area, q.at.b1, r.point.at.b1);
        r.point.at.b2 = select(area, q.at.b2, r.point.at.b2);
        r.d = select(area, to_light.d, r.d);
        r.distance = select(area, to_light.length, r.distance);
        r.pdf = select(facing, area_emitter_pdf(scene, shape, p, q.n, to_light.d, to_light.length, facing), r.pdf);
    }
    for_each_point_light<F>(kind, active, [&](auto model, const MaskOf<F> &lanes) {
        using Model = decltype(model);
        auto frame = point_light_frame<Model, F>(scene, r.point.emitter, lanes);
        Vec3<F> to_light = frame.p - p;
        F distance = norm(to_light);
        auto apart = lanes && mask<F>(distance > F(0));
        F inverse = F(1) / select(apart, distance, F(1));
        r.d = select(apart, to_light * inverse, r.d);
        r.distance = select(apart, distance, r.distance);
        r.factor = select(apart, inverse * inverse, r.factor);
        auto lit = apart;
        if constexpr (Model::Oriented) {
            Vec3<F> local = frame.to_local(-to_light);
            local = select(apart, normalize(local), Vec3<F>{F(0), F(0), F(1)});
            Vec2<F> b = direction_to_point(local);
            r.point.at.b1 = select(apart, b.x, r.point.at.b1);
            r.point.at.b2 = select(apart, b.y, r.point.at.b2);
            LightNumbers<Model, F> numbers(scene, r.point.emitter, lanes);
            lit = lit && Model::pattern(direction_of_point(b.x, b.y), numbers.value).lit;
        }
        r.pdf = select(lit, F(1), r.pdf);
        r.delta = r.delta || apart;
    });
    auto parallel = active && mask<F>(kind == int32_t(EmitterKind::Directional));
    if (any(parallel)) {
        Vec3<F> axis = DirectionalEmitter::axis<F>(scene, r.point.emitter, parallel);
        r.d = select(parallel, -normalize(axis), r.d);
        r.distance = select(parallel, F(INFINITY), r.distance);
        r.pdf = select(parallel, F(1), r.pdf);
        r.delta = r.delta || parallel;
    }
    if (scene.environment >= 0) {
        auto here = active && mask<F>(r.point.emitter == scene.environment);
        if (any(here)) {
            Vec2<F> uv;
            F pdf;
            Vec3<F> d = sample_environment(scene, u1, u2, uv, pdf, here);
            r.d = select(here, d, r.d);
            r.point.at.b1 = select(here, uv.x, r.point.at.b1);
            r.point.at.b2 = select(here, uv.y, r.point.at.b2);
            r.distance = select(here, F(INFINITY), r.distance);
            r.pdf = select(here, pdf, r.pdf);
        }
    }
    r.pdf = r.pdf * pmf;
    return r;
}

}  // namespace tr
