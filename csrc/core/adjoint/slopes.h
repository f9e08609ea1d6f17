// The derivative of a texture's slopes (texture/slopes.h): by its texels, by the map of its coordinates, and by where
// it is looked up, where bilinear heights have the mixed second derivative alone.
#pragma once

#include "../texture/slopes.h"
#include "lookup.h"

namespace tr {

template <class F, int C, class S, class Sink>
struct SlopesVisitor {
    const SceneView<S> &scene;
    const Vec2<F> &g;  // the adjoint of the slopes along u and v
    bool values, motion;
    CoordinateAdjoint<F> &to;
    Sink &sink;

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
        auto height = [&](const Footprint<F, 4> &taps) { return luminance(gather_footprint<C>(tensor, taps, lanes)); };
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

template <int C, template <class> class Point, class F, class S, class Sink>
TR_NOINLINE void sweep_slopes(const SceneView<S> &scene, const IntOf<F> &texture, const Point<F> &at, const Vec2<F> &g,
                              bool values, bool motion, const MaskOf<F> &active, CoordinateAdjoint<F> &to, Sink &sink) {
    SlopesVisitor<F, C, S, Sink> visitor{scene, g, values, motion, to, sink};
    visit_texture<F>(scene, texture, at, active, visitor);
}

}  // namespace tr
