#include "lookup.h"

namespace tr {

namespace {

template <class F, class S>
struct LookupVisitor {
    const SceneView<S> &scene;
    const Spectrum<F> &g;
    CoordinateAdjoint<F> &to;
    GradientSink<F> &sink;

    TR_INLINE void constant(const IntOf<F> &, const MaskOf<F> &) {}

    TR_INLINE void bitmap(const Record &record, const Footprint<F, 4> &at, const Vec2<F> &uv, const MaskOf<F> &lanes) {
        if (record.field[Bitmap::Filter] == 1) return;
        const TensorView<S> &tensor = scene.values.tensors[record.field[Bitmap::Data]];
        Slopes<F> slope = slopes(at);
        F x = component_sum(g * gather_footprint(tensor, sink.waves, slope.x, lanes)) * F(S(tensor.shape[1]));
        F y = component_sum(g * gather_footprint(tensor, sink.waves, slope.y, lanes)) * F(S(tensor.shape[0]));
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
        sink.scalar(IntOf<F>(offset), component_sum(g * gather_footprint(tensor, sink.waves, at, lanes)), lanes);
        sweep_attribute(scene, sink.waves, info, at, F(scene.values.constants[offset]), g, lanes, to);
    }

    TR_INLINE void volume(int32_t index, const Vec3<F> &p, const MaskOf<F> &lanes) {
        Vec3<F> slope = sweep_volume_place(scene, index, p, g, lanes, sink);
        to.p = select(lanes, to.p + slope, to.p);
    }
};

template <class F, class S>
struct SlopesAdjoint {
    const SceneView<S> &scene;
    const Vec2<F> &g;  // the adjoint of the slopes along u and v
    bool values, motion;
    CoordinateAdjoint<F> &to;
    GradientSink<F> &sink;

    TR_INLINE void constant(const IntOf<F> &, const MaskOf<F> &) {}
    TR_INLINE void attribute(const Record &, const AttributeInfo &, const Footprint<F, 3> &, const MaskOf<F> &) {}
    TR_INLINE void volume(int32_t, const Vec3<F> &, const MaskOf<F> &) {}
    TR_INLINE void bitmap(const Record &record, const Footprint<F, 4> &at, const Vec2<F> &uv, const MaskOf<F> &lanes) {
        if (record.field[Bitmap::Filter] == 1) return;
        int32_t slot = record.field[Bitmap::Data], offset = record.field[Bitmap::ToUv];
        const TensorView<S> &tensor = scene.values.tensors[slot];
        const S *m = scene.values.constants + offset;
        F columns(S(tensor.shape[1])), rows(S(tensor.shape[0]));
        Slopes<F> slope = slopes(at);
        F x_bar = g.x * m[0] + g.y * m[1], y_bar = g.x * m[3] + g.y * m[4];  // of the slopes along x and y of the image
        if (values) {
            Footprint<F, 4> taps = at;
            for (int k = 0; k < 4; ++k)
                taps.weight[k] = slope.x.weight[k] * columns * x_bar + slope.y.weight[k] * rows * y_bar;
            sink.luminance_footprint(scene, slot, taps, lanes);
        }
        if (!motion) return;
        Footprint<F, 4> mixed = at;
        mixed.weight[0] = mixed.weight[3] = F(1), mixed.weight[1] = mixed.weight[2] = F(-1);
        auto height = [&](const Footprint<F, 4> &taps) {
            return luminance(gather_footprint(tensor, sink.waves, taps, lanes));
        };
        F twist = height(mixed) * columns * rows, x = height(slope.x) * columns, y = height(slope.y) * rows;
        F by_u = y_bar * twist, by_v = x_bar * twist;
        to.uv.x = select(lanes, to.uv.x + by_u * m[0] + by_v * m[3], to.uv.x);
        to.uv.y = select(lanes, to.uv.y + by_u * m[1] + by_v * m[4], to.uv.y);
        sink.scalar(IntOf<F>(offset), by_u * uv.x + g.x * x, lanes);
        sink.scalar(IntOf<F>(offset + 1), by_u * uv.y + g.y * x, lanes);
        sink.scalar(IntOf<F>(offset + 2), by_u, lanes);
        sink.scalar(IntOf<F>(offset + 3), by_v * uv.x + g.x * y, lanes);
        sink.scalar(IntOf<F>(offset + 4), by_v * uv.y + g.y * y, lanes);
        sink.scalar(IntOf<F>(offset + 5), by_v, lanes);
    }
};

}  // namespace

template <class F>
TR_LARGE Vec3<F> sweep_volume_place(const SceneOf<F> &scene, int32_t index, const Vec3<F> &p, const Spectrum<F> &g,
                                    const MaskOf<F> &active, GradientSink<F> &sink) {
    using S = ScalarOf<F>;
    const Record &record = scene.volumes[index];
    if (record.kind != int32_t(VolumeKind::Grid) || record.field[GridVolume::Filter] == 1) return {F(0), F(0), F(0)};
    const TensorView<S> &grid = scene.values.tensors[record.field[GridVolume::Data]];
    Vec3<F> local = to_volume(scene, index, p);
    Footprint<F, 8> at = GridVolume::footprint(grid, record, local);
    F value[8];
    for (int k = 0; k < 8; ++k) {
        Footprint<F, 1> one{{at.texel[k]}, {F(1)}};
        value[k] = component_sum(g * gather_footprint(grid, sink.waves, one, active));
    }
    Vec3<F> slope =
        transform_normal(scene.volume_to_local + 12 * index, GridVolume::slope(grid, record, local, at, value));
    slope = select(active, slope, Vec3<F>{F(0), F(0), F(0)});
    // local = M^-1 p, and d M^-1 = -M^-1 dM M^-1
    sweep_volume_matrix(record, local, -slope, active, sink);
    return slope;
}

template <class F>
TR_LARGE void sweep_lookup(const SceneOf<F> &scene, const IntOf<F> &texture, const TexturedPoint<F> &at,
                           const Spectrum<F> &g, const MaskOf<F> &active, CoordinateAdjoint<F> &to,
                           GradientSink<F> &sink) {
    LookupVisitor<F, ScalarOf<F>> visitor{scene, g, to, sink};
    visit_texture<F>(scene, texture, at, active, visitor);
}
template <class F>
TR_LARGE void sweep_lookup(const SceneOf<F> &scene, const IntOf<F> &texture, const SurfacePoint<F> &at,
                           const Spectrum<F> &g, const MaskOf<F> &active, CoordinateAdjoint<F> &to,
                           GradientSink<F> &sink) {
    LookupVisitor<F, ScalarOf<F>> visitor{scene, g, to, sink};
    visit_texture<F>(scene, texture, at, active, visitor);
}

template <class F>
TR_LARGE void sweep_slopes(const SceneOf<F> &scene, const IntOf<F> &texture, const TexturedPoint<F> &at,
                           const Vec2<F> &g, bool values, bool motion, const MaskOf<F> &active,
                           CoordinateAdjoint<F> &to, GradientSink<F> &sink) {
    SlopesAdjoint<F, ScalarOf<F>> visitor{scene, g, values, motion, to, sink};
    visit_texture<F>(scene, texture, at, active, visitor);
}

#define TR_INSTANTIATE(F, S)                                                                                          \
    template void sweep_lookup(const SceneView<S> &, const IntOf<F> &, const TexturedPoint<F> &, const Spectrum<F> &, \
                               const MaskOf<F> &, CoordinateAdjoint<F> &, GradientSink<F> &);                         \
    template void sweep_lookup(const SceneView<S> &, const IntOf<F> &, const SurfacePoint<F> &, const Spectrum<F> &,  \
                               const MaskOf<F> &, CoordinateAdjoint<F> &, GradientSink<F> &);                         \
    template Vec3<F> sweep_volume_place(const SceneView<S> &, int32_t, const Vec3<F> &, const Spectrum<F> &,          \
                                        const MaskOf<F> &, GradientSink<F> &);                                        \
    template void sweep_slopes(const SceneView<S> &, const IntOf<F> &, const TexturedPoint<F> &, const Vec2<F> &,     \
                               bool, bool, const MaskOf<F> &, CoordinateAdjoint<F> &, GradientSink<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
