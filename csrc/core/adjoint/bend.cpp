#include "bend.h"

#include "../medium/medium.h"

namespace tr {

namespace {

// What the index is at least, squared, where it is divided by.
template <class S>
constexpr S LeastSquare = S(1e-12);

// Of a field's values, to where a sink wants it.
template <int T, class F, class S>
TR_INLINE void add_values(const BendMedium<S> &medium, const BendPoint<T, F> &at, const F &value, const Vec3<F> &slope,
                          const MaskOf<F> &active, GradientSink<F> &sink) {
    if (!sink.forward) {
        S *to = sink.tensors[medium.slot];
        if (to)
            splat_spline<T>(medium.field, at, value, slope, to,
                            active && mask<F>(isfinite(value + slope.x + slope.y + slope.z)));
        return;
    }
    BendField<S> tangent = medium.field;
    tangent.values = sink.tangent.tensors[medium.slot].data;
    if (!tangent.values) return;
    const BendJet<F> change = at.jet_of(tangent, active);
    sink.number_tangent(value * change.value + dot(slope, change.slope), active);
}

// The adjoint of where a medium is: of its map x = A q + b from voxels. Steps do not depend on it.
template <class F>
struct PlaceAdjoint {
    F a[3][3];
    Vec3<F> b{F(0), F(0), F(0)};

    TR_HD PlaceAdjoint() {
        for (auto &row : a)
            for (F &number : row) number = F(0);
    }
    // Of a vector A v whose adjoint is y; of A^-1 z it is that of -A (A^-1 z) with the adjoint A^-T y.
    TR_HD void add(const Vec3<F> &y, const Vec3<F> &v) {
        const F row[3] = {y.x, y.y, y.z}, column[3] = {v.x, v.y, v.z};
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k) a[i][k] = fmadd(row[i], column[k], a[i][k]);
    }
    // Of a point A q + b.
    TR_HD void add_point(const Vec3<F> &y, const Vec3<F> &q) { add(y, q), b = b + y; }

    // Of a map from voxels into a grid's cube, which a map V into it from the world follows.
    template <class S>
    TR_HD void add_map(const S *v, const MapAdjoint<F> &map) {
        for (int k = 0; k < 3; ++k) {
            const Vec3<F> y = transform_normal(v, map.column(k));
            a[0][k] = a[0][k] + y.x, a[1][k] = a[1][k] + y.y, a[2][k] = a[2][k] + y.z;
        }
        b = b + transform_normal(v, map.column(3));
    }

    // G = step^2 A^-1 A^-T: -2 A^-T G_bar G, of a symmetric G_bar.
    template <class S>
    TR_HD void add_kick(const BendMedium<S> &medium, const F (&kick)[6]) {
        const S *g = medium.field.kick;
        const Vec3<F> columns[3] = {
            {F(g[0]), F(g[3]), F(g[4])}, {F(g[3]), F(g[1]), F(g[5])}, {F(g[4]), F(g[5]), F(g[2])}};
        const F half[6] = {kick[0], kick[1], kick[2], kick[3] * F(S(0.5)), kick[4] * F(S(0.5)), kick[5] * F(S(0.5))};
        for (int k = 0; k < 3; ++k) {
            const Vec3<F> y = transform_normal(medium.to_voxels, symmetric_times<F>(half, columns[k]));
            const F row[3] = {y.x, y.y, y.z};
            for (int i = 0; i < 3; ++i) a[i][k] = a[i][k] - F(2) * row[i];
        }
    }

    // To the parameter, from the unit cube to the world.
    template <class S>
    TR_HD void hand_to(const BendMedium<S> &medium, const MaskOf<F> &active, GradientSink<F> &sink) const {
        const F offset[3] = {b.x, b.y, b.z};
        for (int i = 0; i < 3; ++i) {
            const IntOf<F> at = IntOf<F>(medium.to_world_offset + 4 * i);
            for (int k = 0; k < 3; ++k) sink.scalar(at + k, a[i][k] * F(S(1) / S(medium.field.n[k])), active);
            sink.scalar(at + 3, offset[i], active);
        }
    }
};

// Of where the medium is, and where the volume is, from the adjoint of the map between them.
template <class F>
TR_NOINLINE void sweep_map(const SceneOf<F> &scene, const BendVolume<ScalarOf<F>> &of, const MapAdjoint<F> &map,
                           const MaskOf<F> &active, PlaceAdjoint<F> &place, GradientSink<F> &sink) {
    if (of.volume < 0 || scene.volumes[of.volume].kind != int32_t(VolumeKind::Grid)) return;
    const ScalarOf<F> *v = scene.volume_to_local + 12 * of.volume;
    place.add_map(v, map);
    // V = P^-1, and d V = -V dP V: sums over points of the cube times their adjoints
    PlaceAdjoint<F> own;
    for (int i = 0; i < 3; ++i) {
        const F row[4] = {map.m[4 * i], map.m[4 * i + 1], map.m[4 * i + 2], map.m[4 * i + 3]};
        for (int k = 0; k < 3; ++k) {
            const ScalarOf<F> *to = of.to_local + 4 * k;
            own.a[i][k] = row[0] * to[0] + row[1] * to[1] + row[2] * to[2] + row[3] * to[3];
        }
    }
    const int32_t offset = scene.volumes[of.volume].field[GridVolume::ToWorld];
    for (int k = 0; k < 4; ++k) {
        const Vec3<F> y =
            transform_normal(v, k < 3 ? Vec3<F>{own.a[0][k], own.a[1][k], own.a[2][k]} : map.column(3)) * F(-1);
        sink.scalar(IntOf<F>(offset + k), y.x, active), sink.scalar(IntOf<F>(offset + 4 + k), y.y, active);
        sink.scalar(IntOf<F>(offset + 8 + k), y.z, active);
    }
}

template <int T, class F>
TR_NOINLINE RayAdjoint<F> sweep_flight_of(const SceneOf<F> &scene, const BendMedium<ScalarOf<F>> &medium,
                                          const BentPacket<F> &bent, const SurfacePoint<F> &at, const Vec3<F> &p,
                                          const Vec3<F> &d, const Vec3<F> &d_bar, const BentLight<F> &brought,
                                          HitAdjoint<F> hit, const MaskOf<F> &active, GradientSink<F> &sink) {
    using S = ScalarOf<F>;
    const BendField<S> &field = medium.field;
    const int bits = position_bits<F>(field);
    const Vec3<F> zero{F(0), F(0), F(0)};
    auto add = [&](const BendPoint<T, F> &point, const F &value, const Vec3<F> &slope, const MaskOf<F> &lanes) {
        add_values(medium, point, value, slope, lanes, sink);
    };

    const Spectrum<F> none = uniform_spectrum(F(0));
    LightBack<F> along{
        {scene, medium.light, sink.waves}, sink, brought.begin_bar, none, bent.depth, brought.arrived, {}, {}};
    LightBack<F> *light = medium.varies ? &along : nullptr;

    BendState<F> s = state_from_bits(bent.q, bent.u);
    const Vec3<F> u = velocity_of(s), v = transform_vector(medium.to_world, u);
    const F speed = norm(v), inverse_speed = F(1) / select(mask<F>(speed > F(0)), speed, F(1));
    const Vec3<F> straight = v * inverse_speed;

    // the kick at the end, of what is left of the last step
    const BendState<F> end = state_at(medium, p);
    const BendPoint<T, F> last(field, end, bits, active);
    const Vec3<F> force = symmetric_times<F>(field.kick, last.jet.slope);
    const F weight = bent.rest - F(S(0.5));
    const F inverse = F(1) / norm(transform_vector(medium.to_world, u + force * weight));
    const Vec3<F> end_bar = transform_normal(medium.to_world, unnormalize(d, d_bar, inverse));
    const Vec3<F> kick = symmetric_times<F>(field.kick, end_bar) * weight;
    const F n_end = refractive_index(last.jet.value, medium.constant, LeastSquare<S>);
    const F way_bar = brought.length_bar * F(medium.step);  // the way is a sum of n
    LightKick<F> own;
    if (light) own = light->kick(position_of(end, bits), n_end, weight, active);
    const F value = way_bar * weight / n_end + own.value;
    add(last, value, kick, active);
    const Vec3<F> end_p_bar =
        transform_normal(medium.to_voxels, symmetric_times<F>(last.jet.curve, kick) + last.jet.slope * value + own.q);
    hit.p = hit.p + end_p_bar;
    PlaceAdjoint<F> place;
    place.add_point(-end_p_bar, position_of(end, bits));
    place.add(unnormalize(d, d_bar, inverse), u + force * weight);

    // the hit slides along the last step
    const F t_bar = (dot(force, end_bar) + n_end * way_bar + own.weight) * inverse_speed;
    hit.p = hit.p + straight * t_bar;
    const Arrival<F> in{MaskOf<F>(true), straight, bent.rest * speed, straight, zero, F(0)};
    const RayAdjoint<F> leg = sweep_surface(scene, at, p, in, hit, active, sink);
    const Vec3<F> o_bar = leg.o - straight * t_bar,
                  v_bar = unnormalize(straight, leg.d, inverse_speed) - straight * (t_bar * bent.rest);
    place.add_point(o_bar, position_of(s, bits));
    place.add(v_bar, u);
    BendAdjoint<F> a{transform_normal(medium.to_world, o_bar), end_bar + transform_normal(medium.to_world, v_bar), F(0),
                     way_bar};
    a.add_kick(weight, end_bar, last.jet.slope);
    fly_back<T, F>(field, medium.constant, s, bits, IntOf<F>(bent.steps), a, active, add, light);

    // u = step n d at the beginning
    const Vec3<F> direction = normalize(transform_vector(medium.to_world, velocity_of(s)));
    const BendPoint<T, F> first(field, s, bits, active);
    const F n = refractive_index(first.jet.value, medium.constant, LeastSquare<S>);
    const Vec3<F> w = transform_normal(medium.to_voxels, a.u) * F(medium.step);
    const F phi_bar = dot(w, direction) / n;
    add(first, phi_bar, zero, active);
    a.q = a.q + first.jet.slope * phi_bar;
    const RayAdjoint<F> ray{transform_normal(medium.to_voxels, a.q), w * n};
    place.add_point(-ray.o, position_of(s, bits));
    place.add(-ray.d, transform_vector(medium.to_voxels, direction));
    place.add_kick(medium, a.kick);
    if (light) {
        sweep_map(scene, medium.light.extinction, along.extinction, active, place, sink);
        sweep_map(scene, medium.light.emission, along.emission, active, place, sink);
    }
    place.hand_to(medium, active, sink);
    return ray;
}

template <int T, class F>
TR_NOINLINE void sweep_index_of(const BendMedium<ScalarOf<F>> &medium, const Vec3<F> &p, const F &n_bar,
                                const MaskOf<F> &active, HitAdjoint<F> &hit, GradientSink<F> &sink) {
    using S = ScalarOf<F>;
    const int bits = position_bits<F>(medium.field);
    const BendState<F> s = state_at(medium, p);
    const BendPoint<T, F> at(medium.field, s, bits, active);
    const F n = refractive_index(at.jet.value, medium.constant, LeastSquare<S>);
    const F phi_bar = select(active, n_bar / n, F(0));
    add_values(medium, at, phi_bar, {F(0), F(0), F(0)}, active, sink);
    const Vec3<F> p_bar = transform_normal(medium.to_voxels, at.jet.slope * phi_bar);
    hit.p = hit.p + p_bar;
    PlaceAdjoint<F> place;
    place.add_point(-p_bar, position_of(s, bits));
    place.hand_to(medium, active, sink);
}

}  // namespace

template <class F>
TR_LARGE RayAdjoint<F> sweep_flight(const SceneOf<F> &scene, const BendMedium<ScalarOf<F>> &medium,
                                    const BentPacket<F> &bent, const SurfacePoint<F> &at, const Vec3<F> &p,
                                    const Vec3<F> &d, const Vec3<F> &d_bar, const BentLight<F> &light,
                                    HitAdjoint<F> hit, const MaskOf<F> &active, GradientSink<F> &sink) {
    return medium.quadratic ? sweep_flight_of<3, F>(scene, medium, bent, at, p, d, d_bar, light, hit, active, sink)
                            : sweep_flight_of<4, F>(scene, medium, bent, at, p, d, d_bar, light, hit, active, sink);
}

template <class F>
TR_LARGE void sweep_index(const BendMedium<ScalarOf<F>> &medium, const Vec3<F> &p, const F &n_bar,
                          const MaskOf<F> &active, HitAdjoint<F> &hit, GradientSink<F> &sink) {
    if (medium.quadratic)
        sweep_index_of<3, F>(medium, p, n_bar, active, hit, sink);
    else
        sweep_index_of<4, F>(medium, p, n_bar, active, hit, sink);
}

template <class F>
TR_LARGE void sweep_boundary(const SceneOf<F> &scene, const SurfacePoint<F> &at, const Vec3<F> &p, const F &eta_bar,
                             const MaskOf<F> &active, HitAdjoint<F> &hit, GradientSink<F> &sink) {
    for_each_bend<F>(scene, inner_medium<F>(scene, at, active), active, [&](const auto &medium, const auto &lanes) {
        const F outside = F(medium.ext_ior), eta = local_index<F>(medium, p, lanes).n / outside;
        sweep_index(medium, p, eta_bar / outside, lanes, hit, sink);
        sink.scalar(IntOf<F>(medium.ext_ior_offset), -eta_bar * eta / outside, lanes);
    });
}

#define TR_INSTANTIATE(F, S)                                                                                         \
    template RayAdjoint<F> sweep_flight(const SceneView<S> &, const BendMedium<S> &, const BentPacket<F> &,          \
                                        const SurfacePoint<F> &, const Vec3<F> &, const Vec3<F> &, const Vec3<F> &,  \
                                        const BentLight<F> &, HitAdjoint<F>, const MaskOf<F> &, GradientSink<F> &);  \
    template void sweep_index(const BendMedium<S> &, const Vec3<F> &, const F &, const MaskOf<F> &, HitAdjoint<F> &, \
                              GradientSink<F> &);                                                                    \
    template void sweep_boundary(const SceneView<S> &, const SurfacePoint<F> &, const Vec3<F> &, const F &,          \
                                 const MaskOf<F> &, HitAdjoint<F> &, GradientSink<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
