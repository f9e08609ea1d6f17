// The derivative of a texture's luminance with respect to its coordinates: what bump maps are made of. Bitmaps have
// one; other textures are flat between their jumps.
#pragma once

#include "texture.h"

namespace tr {

template <class F, int C, class S>
struct TextureSlopes {
    const SceneView<S> &scene;
    F u{0}, v{0};

    TR_INLINE void constant(const IntOf<F> &, const MaskOf<F> &) {}
    TR_INLINE void attribute(const Record &, const AttributeInfo &, const Footprint<F, 3> &, const MaskOf<F> &) {}
    TR_INLINE void bitmap(const Record &record, const Footprint<F, 4> &at, const Vec2<F> &, const MaskOf<F> &lanes) {
        if (record.field[Bitmap::Filter] == 1) return;
        const TensorView<S> &tensor = scene.values.tensors[record.field[Bitmap::Data]];
        const S *m = scene.values.constants + record.field[Bitmap::ToUv];
        Slopes<F> slope = slopes(at);
        F x = luminance(gather_footprint<C>(tensor, slope.x, lanes)) * F(S(tensor.shape[1]));
        F y = luminance(gather_footprint<C>(tensor, slope.y, lanes)) * F(S(tensor.shape[0]));
        u = select(lanes, x * m[0] + y * m[3], u);
        v = select(lanes, x * m[1] + y * m[4], v);
    }
};

template <int C, template <class> class Point, class F, class S>
TR_INLINE Vec2<F> texture_slopes(const SceneView<S> &scene, const IntOf<F> &id, const Point<F> &at,
                                 const MaskOf<F> &active) {
    TextureSlopes<F, C, S> visitor{scene};
    visit_texture<F>(scene, id, at, active, visitor);
    return {visitor.u, visitor.v};
}

}  // namespace tr
