// The derivative of a texture's value with respect to everything in it that is not its data: where it is looked up, the
// map of its coordinates, the factor of an attribute, the place of a volume. (For the data see the sinks.)
#pragma once

#include "sink.h"

namespace tr {

// Adjoint of a point on a surface: of its texture coordinates, and of its own coordinates (SurfacePoint::b1, b2) and
// its position where a look-up uses those directly.
template <class F>
struct CoordinateAdjoint {
    Vec2<F> uv{F(0), F(0)}, b{F(0), F(0)};
    Vec3<F> p{F(0), F(0), F(0)};
};

template <class F, int C>
TR_INLINE F channel_sum(const Color<F, C> &a) {
    F r = a[0];
    for (int c = 1; c < C; ++c) r = r + a[c];
    return r;
}

// Colours of a mesh, times `scale`, as a function of the barycentric coordinates.
template <int C, class F, class S>
TR_INLINE void sweep_attribute(const SceneView<S> &scene, const AttributeInfo &info, const Footprint<F, 3> &at,
                               const F &scale, const Color<F, C> &g, const MaskOf<F> &lanes, CoordinateAdjoint<F> &to) {
    if (info.per_face) return;
    const TensorView<S> &tensor = scene.values.tensors[info.tensor];
    Footprint<F, 3> b1 = at, b2 = at;
    b1.weight[0] = b2.weight[0] = -scale;
    b1.weight[1] = b2.weight[2] = scale;
    b1.weight[2] = b2.weight[1] = F(0);
    to.b.x = select(lanes, to.b.x + channel_sum(g * gather_footprint<C>(tensor, b1, lanes)), to.b.x);
    to.b.y = select(lanes, to.b.y + channel_sum(g * gather_footprint<C>(tensor, b2, lanes)), to.b.y);
}

template <class F, int C, class S, class Sink>
struct LookupVisitor {
    const SceneView<S> &scene;
    const Color<F, C> &g;
    CoordinateAdjoint<F> &to;
    Sink &sink;

    TR_INLINE void constant(const IntOf<F> &, const MaskOf<F> &) {}

    TR_INLINE void bitmap(const Record &record, const Footprint<F, 4> &at, const Vec2<F> &uv, const MaskOf<F> &lanes) {
        if (record.field[Bitmap::Filter] == 1) return;
        const TensorView<S> &tensor = scene.values.tensors[record.field[Bitmap::Data]];
        Slopes<F> slope = slopes(at);
        F x = channel_sum(g * gather_footprint<C>(tensor, slope.x, lanes)) * F(S(tensor.shape[1]));
        F y = channel_sum(g * gather_footprint<C>(tensor, slope.y, lanes)) * F(S(tensor.shape[0]));
        int32_t offset = record.field[Bitmap::ToUv];
        const S *m = scene.values.constants + offset;
        to.uv.x = select(lanes, to.uv.x + x * m[0] + y * m[3], to.uv.x);
        to.uv.y = select(lanes, to.uv.y + x * m[1] + y * m[4], to.uv.y);
        sink.scalar(IntOf<F>(offset), x * uv.x, lanes);
        sink.scalar(IntOf<F>(offset + 1), x * uv.y, lanes);
        sink.scalar(IntOf<F>(offset + 2), x, lanes);
        sink.scalar(IntOf<F>(offset + 3), y * uv.x, lanes);
        sink.scalar(IntOf<F>(offset + 4), y * uv.y, lanes);
        sink.scalar(IntOf<F>(offset + 5), y, lanes);
    }

    TR_INLINE void attribute(const Record &record, const AttributeInfo &info, const Footprint<F, 3> &at,
                             const MaskOf<F> &lanes) {
        const TensorView<S> &tensor = scene.values.tensors[info.tensor];
        int32_t offset = record.field[MeshAttribute::Scale];
        sink.scalar(IntOf<F>(offset), channel_sum(g * gather_footprint<C>(tensor, at, lanes)), lanes);
        sweep_attribute<C>(scene, info, at, F(scene.values.constants[offset]), g, lanes, to);
    }

    TR_NOINLINE void volume(int32_t index, const Vec3<F> &p, const MaskOf<F> &lanes) {
        const Record &record = scene.volumes[index];
        if (record.kind != int32_t(VolumeKind::Grid) || record.field[GridVolume::Filter] == 1) return;
        const TensorView<S> &grid = scene.values.tensors[record.field[GridVolume::Data]];
        Vec3<F> local = to_volume(scene, index, p);
        Footprint<F, 8> at = GridVolume::footprint(grid, record, local);
        F value[8];
        for (int k = 0; k < 8; ++k) {
            Footprint<F, 1> one{{at.texel[k]}, {F(1)}};
            value[k] = channel_sum(g * gather_footprint<C>(grid, one, lanes));
        }
        Vec3<F> slope =
            transform_normal(scene.volume_to_local + 12 * index, GridVolume::slope(grid, record, local, at, value));
        to.p = select(lanes, to.p + slope, to.p);
        // local = M^-1 p, and d M^-1 = -M^-1 dM M^-1
        int32_t offset = record.field[GridVolume::ToWorld];
        const F by_row[3] = {slope.x, slope.y, slope.z}, column[4] = {local.x, local.y, local.z, F(1)};
        for (int i = 0; i < 12; ++i) sink.scalar(IntOf<F>(offset + i), -by_row[i / 4] * column[i % 4], lanes);
    }
};

// `g` is the adjoint of the texture's value at `at`.
template <int C, template <class> class Point, class F, class S, class Sink>
TR_NOINLINE void sweep_lookup(const SceneView<S> &scene, const IntOf<F> &texture, const Point<F> &at,
                              const Color<F, C> &g, const MaskOf<F> &active, CoordinateAdjoint<F> &to, Sink &sink) {
    LookupVisitor<F, C, S, Sink> visitor{scene, g, to, sink};
    visit_texture<F>(scene, texture, at, active, visitor);
}

// The environment map as a look-up in a direction: adds to the adjoint of d, and to that of the map's rotation.
template <int C, class F, class S, class Sink>
TR_NOINLINE void sweep_environment_lookup(const SceneView<S> &scene, const Vec2<F> &uv, const Vec3<F> &d,
                                          const Color<F, C> &g, const MaskOf<F> &active, Vec3<F> &d_bar, Sink &sink) {
    const Record &record = scene.emitters[scene.environment];
    const TensorView<S> &tensor = scene.values.tensors[record.field[EnvironmentMap::Data]];
    F scale(scene.values.constants[record.field[EnvironmentMap::Scale]]);
    Slopes<F> slope = slopes(EnvironmentMap::footprint(tensor, uv));
    F u = channel_sum(g * gather_footprint<C>(tensor, slope.x, active)) * (F(S(tensor.shape[1])) * scale);
    F v = channel_sum(g * gather_footprint<C>(tensor, slope.y, active)) * (F(S(tensor.shape[0] - 1)) * scale);
    Vec3<F> m = transform_vector(scene.env_to_local, d);
    F length = norm(m);
    Vec3<F> l = m * (F(1) / length);
    F around = l.x * l.x + l.z * l.z;  // 0 at the poles, where u says nothing
    auto apart = active && mask<F>(around > F(1e-12));
    F by_u = select(apart, u * F(1 / (2 * Pi)) / select(apart, around, F(1)), F(0));
    F by_v = select(apart, v * F(-1 / Pi) / sqrt(select(apart, around, F(1))), F(0));
    Vec3<F> l_bar{-l.z * by_u, by_v, l.x * by_u};
    Vec3<F> m_bar = (l_bar - l * dot(l, l_bar)) * (F(1) / length);
    Vec3<F> turned = transform_normal(scene.env_to_local, m_bar);
    d_bar = select(active, d_bar + turned, d_bar);
    const F by_row[3] = {turned.x, turned.y, turned.z}, column[3] = {m.x, m.y, m.z};
    int32_t offset = record.field[EnvironmentMap::ToWorld];
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) sink.scalar(IntOf<F>(offset + 4 * i + j), -by_row[i] * column[j], active);
}

}  // namespace tr
