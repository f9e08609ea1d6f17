#include "envmap.h"

#include "infinite.h"

namespace tr {

namespace {

template <class F>
struct Map : Environment<EnvironmentMap, Map<F>, F> {
    using S = ScalarOf<F>;
    using Base = Environment<EnvironmentMap, Map, F>;
    using typename Base::M;
    using typename Base::Scene;

    // A scene has one environment.
    TR_HD static const Record &record_of(const Scene &scene) { return scene.emitters[scene.environment]; }
    TR_HD static const TensorView<S> &texels(const Scene &scene) {
        return scene.values.tensors[record_of(scene).field[EnvironmentMap::Data]];
    }
    TR_HD static F scale(const Scene &scene) {
        return F(scene.values.constants[record_of(scene).field[EnvironmentMap::Scale]]);
    }
    TR_HD static Vec2<F> coordinates(const EmitterPoint<F> &point) { return {point.at.b1, point.at.b2}; }

    TR_HD static void eval(const Scene &scene, const Wavelengths<F> &waves, const EmitterPoint<F> &point,
                           const M &lanes, Spectrum<F> &r) {
        auto at = EnvironmentMap::footprint(texels(scene), coordinates(point));
        r = select(lanes, gather_footprint(texels(scene), waves, at, lanes) * scale(scene), r);
    }

    TR_HD static F pdf_direct(const Scene &scene, const EmitterPoint<F> &point, const Vec3<F> &, const Vec3<F> &,
                              const Vec3<F> &, const M &lanes) {
        return EnvironmentMap::pdf(scene, coordinates(point), lanes);
    }

    TR_HD static void point_of_direction(const Scene &scene, const Vec3<F> &d, EmitterPoint<F> &r) {
        Vec2<F> uv = EnvironmentMap::to_uv(scene, d);
        r.at.b1 = uv.x, r.at.b2 = uv.y;
    }

    TR_HD static void vjp(const Scene &scene, const EmitterPoint<F> &point, const Vec3<F> &d, const Spectrum<F> &g,
                          const GradientNeeds &needs, const M &lanes, CoordinateAdjoint<F> &, Vec3<F> &d_bar,
                          GradientSink<F> &sink) {
        Vec2<F> uv = coordinates(point);
        if (needs.emitter) {
            auto at = EnvironmentMap::footprint(texels(scene), uv);
            sink.footprint(scene, record_of(scene).field[EnvironmentMap::Data], at, g * scale(scene), lanes);
            sink.number(IntOf<F>(record_of(scene).field[EnvironmentMap::Scale]),
                        g * gather_footprint(texels(scene), sink.waves, at, lanes), lanes);
        }
        if (needs.geometry) sweep_direction(scene, uv, d, g, lanes, d_bar, sink);
    }

    static double power(EmitterMeans &means, const Record &record) {
        return 4 * Pi * means.disk * means.number(record.field[EnvironmentMap::Scale]) *
               means.environment(record.field[EnvironmentMap::Data]);
    }

private:
    // The map as a look-up in a direction: adds to the adjoint of d, and to that of the map's rotation.
    TR_HD static void sweep_direction(const Scene &scene, const Vec2<F> &uv, const Vec3<F> &d, const Spectrum<F> &g,
                                      const M &lanes, Vec3<F> &d_bar, GradientSink<F> &sink) {
        const Record &record = record_of(scene);
        const TensorView<S> &tensor = scene.values.tensors[record.field[EnvironmentMap::Data]];
        F scale(scene.values.constants[record.field[EnvironmentMap::Scale]]);
        Slopes<F> slope = slopes(EnvironmentMap::footprint(tensor, uv));
        F u = component_sum(g * gather_footprint(tensor, sink.waves, slope.x, lanes)) * (F(S(tensor.shape[1])) * scale);
        F v = component_sum(g * gather_footprint(tensor, sink.waves, slope.y, lanes)) *
              (F(S(tensor.shape[0] - 1)) * scale);
        Vec3<F> m = transform_vector(scene.env_to_local, d);
        F length = norm(m);
        Vec3<F> l = m * (F(1) / length);
        F around = l.x * l.x + l.z * l.z;  // 0 at the poles, where u says nothing
        auto apart = lanes && mask<F>(around > F(1e-12));
        F by_u = select(apart, u * F(1 / (2 * Pi)) / select(apart, around, F(1)), F(0));
        F by_v = select(apart, v * F(-1 / Pi) / sqrt(select(apart, around, F(1))), F(0));
        Vec3<F> l_bar{-l.z * by_u, by_v, l.x * by_u};
        Vec3<F> m_bar = (l_bar - l * dot(l, l_bar)) * (F(1) / length);
        Vec3<F> turned = transform_normal(scene.env_to_local, m_bar);
        d_bar = select(lanes, d_bar + turned, d_bar);
        const F by_row[3] = {turned.x, turned.y, turned.z}, column[3] = {m.x, m.y, m.z};
        int32_t offset = record.field[EnvironmentMap::ToWorld];
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) sink.scalar(IntOf<F>(offset + 4 * i + j), -by_row[i] * column[j], lanes);
    }
};

}  // namespace

TR_EMITTER(EnvironmentMap, Map)

}  // namespace tr
