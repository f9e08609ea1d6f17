// The derivative of a texture by its coordinates. Bitmaps have one; other textures are flat between their jumps.
#pragma once

#include "texture.h"

namespace tr {

template <class F, int C, class S>
struct TextureSlopes {
    const SceneView<S> &scene;
    Color<F, C> u = uniform_color<C>(F(0)), v = uniform_color<C>(F(0));

    TR_INLINE void constant(const IntOf<F> &, const MaskOf<F> &) {}
    TR_INLINE void attribute(const Record &, const AttributeInfo &, const Footprint<F, 3> &, const MaskOf<F> &) {}
    TR_INLINE void volume(int32_t, const Vec3<F> &, const MaskOf<F> &) {}
    TR_INLINE void bitmap(const Record &record, const Footprint<F, 4> &at, const Vec2<F> &, const MaskOf<F> &lanes) {
        if (record.field[Bitmap::Filter] == 1) return;
        const TensorView<S> &tensor = scene.values.tensors[record.field[Bitmap::Data]];
        const S *m = scene.values.constants + record.field[Bitmap::ToUv];
        Slopes<F> slope = slopes(at);
        Color<F, C> x = gather_footprint<C>(tensor, slope.x, lanes) * F(S(tensor.shape[1]));
        Color<F, C> y = gather_footprint<C>(tensor, slope.y, lanes) * F(S(tensor.shape[0]));
        u = select(lanes, x * F(m[0]) + y * F(m[3]), u);
        v = select(lanes, x * F(m[1]) + y * F(m[4]), v);
    }
};

// That of its luminance: what bump maps are made of.
template <int C, template <class> class Point, class F, class S>
TR_INLINE Vec2<F> texture_slopes(const SceneView<S> &scene, const IntOf<F> &id, const Point<F> &at,
                                 const MaskOf<F> &active) {
    TextureSlopes<F, C, S> visitor{scene};
    visit_texture<F>(scene, id, at, active, visitor);
    return {luminance(visitor.u), luminance(visitor.v)};
}

}  // namespace tr
