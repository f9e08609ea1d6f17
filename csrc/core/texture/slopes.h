// The derivative of a texture by its coordinates. Bitmaps have one; other textures are flat between their jumps.
#pragma once

#include "texture.h"

namespace tr {

template <class F>
struct TextureSlopes {
    Spectrum<F> u, v;
};

template <class F, class S>
TR_LARGE TextureSlopes<F> texture_slopes(const SceneView<S> &scene, const Wavelengths<F> &waves, const IntOf<F> &id,
                                         const TexturedPoint<F> &at, const MaskOf<F> &active);

template <class F, class S>
struct SlopesVisitor {
    const SceneView<S> &scene;
    const Wavelengths<F> &waves;
    TextureSlopes<F> result{uniform_spectrum(F(0)), uniform_spectrum(F(0))};

    TR_INLINE void constant(const IntOf<F> &, const MaskOf<F> &) {}
    TR_INLINE void attribute(const Record &, const AttributeInfo &, const Footprint<F, 3> &, const MaskOf<F> &) {}
    TR_INLINE void volume(int32_t, const Vec3<F> &, const MaskOf<F> &) {}
    TR_INLINE void bitmap(const Record &record, const Footprint<F, 4> &at, const Vec2<F> &, const MaskOf<F> &lanes) {
        if (record.field[Bitmap::Filter] == 1) return;
        const TensorView<S> &tensor = scene.values.tensors[record.field[Bitmap::Data]];
        const S *m = scene.values.constants + record.field[Bitmap::ToUv];
        Slopes<F> slope = slopes(at);
        Spectrum<F> x = gather_footprint(tensor, waves, slope.x, lanes) * F(S(tensor.shape[1]));
        Spectrum<F> y = gather_footprint(tensor, waves, slope.y, lanes) * F(S(tensor.shape[0]));
        result.u = select(lanes, x * F(m[0]) + y * F(m[3]), result.u);
        result.v = select(lanes, x * F(m[1]) + y * F(m[4]), result.v);
    }
};

}  // namespace tr
