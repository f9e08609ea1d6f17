#include "slopes.h"

namespace tr {

namespace {

template <class F, class S>
struct TextureValue {
    const SceneView<S> &scene;
    const Values<S> &values;
    const Wavelengths<F> &waves;
    Spectrum<F> result;

    TR_INLINE void constant(const IntOf<F> &offset, const MaskOf<F> &lanes) {
        result = select(lanes, constant_spectrum<F>(values, waves, offset, lanes), result);
    }
    TR_INLINE void bitmap(const Record &record, const Footprint<F, 4> &at, const Vec2<F> &, const MaskOf<F> &lanes) {
        if (record.field[Bitmap::Filter] == 1)  // the others have no weight
            footprint(record.field[Bitmap::Data], Footprint<F, 1>{{at.texel[0]}, {at.weight[0]}}, F(1), lanes);
        else
            footprint(record.field[Bitmap::Data], at, F(1), lanes);
    }
    TR_INLINE void attribute(const Record &record, const AttributeInfo &info, const Footprint<F, 3> &at,
                             const MaskOf<F> &lanes) {
        footprint(info.tensor, at, F(scene.values.constants[record.field[MeshAttribute::Scale]]), lanes);
    }
    TR_INLINE void volume(int32_t index, const Vec3<F> &p, const MaskOf<F> &lanes) {
        result = select(lanes, eval_volume(scene, values, waves, index, p, lanes), result);
    }

private:
    template <int N>
    TR_INLINE void footprint(int32_t slot, const Footprint<F, N> &at, const F &scale, const MaskOf<F> &lanes) {
        const TensorView<S> &tensor = values.tensors[slot];
        if (!tensor.data) return;  // a tangent that was not given
        result = select(lanes, gather_footprint(tensor, waves, at, lanes) * scale, result);
    }
};

}  // namespace

template <class F, class S>
TR_LARGE Spectrum<F> lookup_texture(const SceneView<S> &scene, const Values<S> &values, const Wavelengths<F> &waves,
                                    const IntOf<F> &id, const TexturedPoint<F> &at, const MaskOf<F> &active) {
    TextureValue<F, S> visitor{scene, values, waves, uniform_spectrum(F(0))};
    visit_texture<F>(scene, id, at, active, visitor);
    return visitor.result;
}

template <class F, class S>
TR_LARGE TextureSlopes<F> texture_slopes(const SceneView<S> &scene, const Wavelengths<F> &waves, const IntOf<F> &id,
                                         const TexturedPoint<F> &at, const MaskOf<F> &active) {
    SlopesVisitor<F, S> visitor{scene, waves};
    visit_texture<F>(scene, id, at, active, visitor);
    return visitor.result;
}

template <class F, class S>
TR_LARGE F daylight_luminance(const SceneView<S> &scene, const Values<S> &values, const IntOf<F> &id,
                              const TexturedPoint<F> &at, const MaskOf<F> &active) {
    F sum(0);
    for (int third = 0; third < LuminanceNodes / SpectrumSize; ++third)
        sum = sum + component_sum(eval_texture(scene, values, luminance_wavelengths<F>(third), id, at, active));
    return sum * F(S(1.0 / LuminanceNodes));
}

#define TR_INSTANTIATE(S)                                                                                              \
    template Spectrum<PacketOf<S>> lookup_texture(const SceneView<S> &, const Values<S> &,                             \
                                                  const Wavelengths<PacketOf<S>> &, const IntOf<PacketOf<S>> &,        \
                                                  const TexturedPoint<PacketOf<S>> &, const MaskOf<PacketOf<S>> &);    \
    template PacketOf<S> daylight_luminance(const SceneView<S> &, const Values<S> &, const IntOf<PacketOf<S>> &,       \
                                            const TexturedPoint<PacketOf<S>> &, const MaskOf<PacketOf<S>> &);          \
    template TextureSlopes<PacketOf<S>> texture_slopes(const SceneView<S> &, const Wavelengths<PacketOf<S>> &,         \
                                                       const IntOf<PacketOf<S>> &, const TexturedPoint<PacketOf<S>> &, \
                                                       const MaskOf<PacketOf<S>> &);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
