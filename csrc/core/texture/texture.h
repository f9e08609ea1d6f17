// Evaluating a texture where every lane may have its own, and the two directions of its derivative.
#pragma once

#include "bitmap.h"
#include "checkerboard.h"
#include "constant.h"
#include "mesh_attribute.h"
#include "volume.h"

namespace tr {

enum class TextureKind : int32_t {
    Constant = 0,
    Bitmap = 1,
    Checkerboard = 2,
    MeshAttribute = 3,
    Volume = 4
};  // order of the registry

// Calls visit(index, lanes) once for every distinct index.
template <class F, class Visit>
TR_INLINE void for_each_distinct(const IntOf<F> &index, MaskOf<F> rest, Visit &&visit) {
    while (any(rest)) {
        int32_t i = first_lane(index, rest);
        auto same = rest && mask<F>(index == i);
        visit(i, same);
        rest = rest && !same;
    }
}

// Walks down to the look-ups that a texture consists of, and hands each to the visitor:
//   visitor.constant(offset lanes, lanes)
//   visitor.bitmap(record, footprint, uv, lanes)
//   visitor.attribute(record, info, footprint, lanes)      (without the factor `scale`)
//   visitor.volume(index, position, lanes)
template <class F, class S, class Point, class Visitor>
TR_HD void visit_texture(const SceneView<S> &scene, const IntOf<F> &id, const Point &at, const MaskOf<F> &active,
                         Visitor &visitor, int depth = 0) {
    RecordLanes<F> record(scene.textures, id, active);
    auto constant = active && mask<F>(record.kind() == int32_t(TextureKind::Constant));
    if (any(constant)) visitor.constant(record.field(ConstantTexture::Value), constant);
    auto rest = active && !constant;
    if (!any(rest)) return;
    Vec2<F> uv = lookup_coordinates<F>(scene, at, rest);
    for_each_distinct<F>(id, rest, [&](int32_t i, const MaskOf<F> &lanes) {
        const Record &record = scene.textures[i];
        switch (TextureKind(record.kind)) {
            case TextureKind::Bitmap:
                visitor.bitmap(record, Bitmap::footprint(scene, record, uv), uv, lanes);
                break;
            case TextureKind::Checkerboard: {
                auto second = Checkerboard::second(scene, record, uv);
                IntOf<F> nested = select(mask<IntOf<F>>(second), IntOf<F>(record.field[Checkerboard::Color1]),
                                         IntOf<F>(record.field[Checkerboard::Color0]));
                if (depth < 8) visit_texture<F>(scene, nested, at, lanes, visitor, depth + 1);
                break;
            }
            case TextureKind::MeshAttribute:
                for_each_distinct<F>(IntOf<F>(at.shape), lanes, [&](int32_t shape, const MaskOf<F> &same) {
                    int32_t a = MeshAttribute::find(scene, record, uint32_t(shape));
                    if (a < 0) return;
                    const AttributeInfo &info = scene.attributes[a];
                    visitor.attribute(record, info, MeshAttribute::footprint<F>(scene, info, uint32_t(shape), at, same),
                                      same);
                });
                break;
            case TextureKind::Volume:
                visitor.volume(record.field[VolumeTexture::VolumeIndex], surface_position<F>(scene, at, lanes), lanes);
                break;
            default:
                break;
        }
    });
}

template <class F, int C, class S>
struct TextureValue {
    const SceneView<S> &scene;
    const Values<S> &values;
    Color<F, C> result;

    TR_INLINE void constant(const IntOf<F> &offset, const MaskOf<F> &lanes) {
        result = select(lanes, constant_color<C, F>(values, offset, lanes), result);
    }
    TR_INLINE void bitmap(const Record &record, const Footprint<F, 4> &at, const Vec2<F> &, const MaskOf<F> &lanes) {
        footprint(record.field[Bitmap::Data], at, F(1), lanes);
    }
    TR_INLINE void attribute(const Record &record, const AttributeInfo &info, const Footprint<F, 3> &at,
                             const MaskOf<F> &lanes) {
        footprint(info.tensor, at, F(scene.values.constants[record.field[MeshAttribute::Scale]]), lanes);
    }

    TR_NOINLINE void volume(int32_t index, const Vec3<F> &p, const MaskOf<F> &lanes) {
        result = select(lanes, eval_volume<C>(scene, values, index, p, lanes), result);
    }

private:
    template <int N>
    TR_INLINE void footprint(int32_t slot, const Footprint<F, N> &at, const F &scale, const MaskOf<F> &lanes) {
        const TensorView<S> &tensor = values.tensors[slot];
        if (!tensor.data) return;  // a tangent that was not given
        result = select(lanes, gather_footprint<C>(tensor, at, lanes) * scale, result);
    }
};

// `values` is the scene's own for the value, the tangent's for its forward-mode derivative: textures are linear in
// their data; what else they depend on is in adjoint/lookup.h.
template <int C, template <class> class Point, class F, class S>
TR_INLINE Color<F, C> eval_texture(const SceneView<S> &scene, const Values<S> &values, const IntOf<F> &id,
                                   const Point<F> &at, const MaskOf<F> &active) {
    TextureValue<F, C, S> visitor{scene, values, uniform_color<C>(F(0))};
    visit_texture<F>(scene, id, at, active, visitor);
    return visitor.result;
}

}  // namespace tr
