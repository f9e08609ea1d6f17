// Evaluating a texture where every lane may have its own.
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
constexpr int MostNested = 8;  // textures in a texture

// The texture that is seen through checkerboards, of one lane: devices have little room for calls in calls.
template <class F, class S, class Point>
TR_INLINE int32_t behind_checkerboards(const SceneView<S> &scene, int32_t id, const Point &at) {
    if constexpr (!facts::has(facts::TextureKinds, int(TextureKind::Checkerboard))) return id;
    for (int depth = 0; depth < MostNested; ++depth) {
        const Record &record = scene.textures[id];
        if (record.kind != int32_t(TextureKind::Checkerboard)) break;
        const bool second = Checkerboard::second(scene, record, lookup_coordinates<F>(scene, at, true));
        id = record.field[second ? Checkerboard::Color1 : Checkerboard::Color0];
    }
    return id;
}

template <class F, class S, class Point, class Visitor>
TR_HD void visit_texture(const SceneView<S> &scene, const IntOf<F> &given, const Point &at, const MaskOf<F> &active,
                         Visitor &visitor, int depth = 0) {
    IntOf<F> id = given;
    if constexpr (Lanes<F>::Width == 1)
        if (scene.textured && active) id = behind_checkerboards<F>(scene, given, at);
    if (!scene.textured)
        return visitor.constant(record_field<F>(scene.textures, ConstantTexture::Value, id, active), active);
    auto rest = active;
    if (!any(rest)) return;
    const int32_t first = first_lane(id, active);
    if (any(active && mask<F>(id != first)) || scene.textures[first].kind == int32_t(TextureKind::Constant)) {
        RecordLanes<F> record(scene.textures, id, active);
        auto constant = active && mask<F>(record.kind() == int32_t(TextureKind::Constant));
        if (any(constant)) visitor.constant(record.field(ConstantTexture::Value), constant);
        rest = active && !constant;
        if (!any(rest)) return;
    }
    Vec2<F> uv = lookup_coordinates<F>(scene, at, rest);
    for_each_distinct<F>(id, rest, [&](int32_t i, const MaskOf<F> &lanes) {
        const Record &record = scene.textures[i];
        switch (TextureKind(record.kind)) {
            case TextureKind::Bitmap:
                if constexpr (!facts::has(facts::TextureKinds, int(TextureKind::Bitmap))) break;
                visitor.bitmap(record, Bitmap::footprint(scene, record, uv), uv, lanes);
                break;
            case TextureKind::Checkerboard: {
                if constexpr (Lanes<F>::Width == 1) break;
                auto second = Checkerboard::second(scene, record, uv);
                IntOf<F> nested = select(mask<IntOf<F>>(second), IntOf<F>(record.field[Checkerboard::Color1]),
                                         IntOf<F>(record.field[Checkerboard::Color0]));
                if constexpr (Lanes<F>::Width > 1)
                    if (depth < MostNested) visit_texture<F>(scene, nested, at, lanes, visitor, depth + 1);
                break;
            }
            case TextureKind::MeshAttribute:
                if constexpr (!facts::has(facts::TextureKinds, int(TextureKind::MeshAttribute))) break;
                for_each_distinct<F>(IntOf<F>(at.shape), lanes, [&](int32_t shape, const MaskOf<F> &same) {
                    int32_t a = MeshAttribute::find(scene, record, uint32_t(shape));
                    if (a < 0) return;
                    const AttributeInfo &info = scene.attributes[a];
                    visitor.attribute(record, info, MeshAttribute::footprint<F>(scene, info, uint32_t(shape), at, same),
                                      same);
                });
                break;
            case TextureKind::Volume:
                if constexpr (!facts::has(facts::TextureKinds, int(TextureKind::Volume))) break;
                visitor.volume(record.field[VolumeTexture::VolumeIndex], surface_position<F>(scene, at, lanes), lanes);
                break;
            default:
                break;
        }
    });
}

// A look-up in a texture that is not constant everywhere.
template <class F, class S>
TR_LARGE Spectrum<F> lookup_texture(const SceneView<S> &scene, const Values<S> &values, const Wavelengths<F> &waves,
                                    const IntOf<F> &id, const TexturedPoint<F> &at, const MaskOf<F> &active);

// `values` is the scene's own for the value, the tangent's for its forward-mode derivative: textures are linear in
// their data; what else they depend on is in adjoint/lookup.h.
template <template <class> class Point, class F, class S>
TR_INLINE Spectrum<F> eval_texture(const SceneView<S> &scene, const Values<S> &values, const Wavelengths<F> &waves,
                                   const IntOf<F> &id, const Point<F> &at, const MaskOf<F> &active) {
    if (!scene.textured)
        return constant_spectrum<F>(values, waves, record_field<F>(scene.textures, ConstantTexture::Value, id, active),
                                    active);
    RecordLanes<F> record(scene.textures, id, active);
    auto constant = active && mask<F>(record.kind() == int32_t(TextureKind::Constant));
    Spectrum<F> r = uniform_spectrum(F(0));
    if (any(constant))
        r = select(constant, constant_spectrum<F>(values, waves, record.field(ConstantTexture::Value), constant), r);
    auto rest = active && !constant;
    if (any(rest)) {
        TexturedPoint<F> where{at, lookup_coordinates<F>(scene, at, rest)};
        r = select(rest, lookup_texture(scene, values, waves, id, where, rest), r);
    }
    return r;
}
template <template <class> class Point, class F, class S>
TR_INLINE Spectrum<F> eval_texture(const SceneView<S> &scene, const Wavelengths<F> &waves, const IntOf<F> &id,
                                   const Point<F> &at, const MaskOf<F> &active) {
    return eval_texture(scene, scene.values, waves, id, at, active);
}

// In the spectral variant: the luminance of a texture in daylight, which does not depend on a path's wavelengths.
template <class F, class S>
TR_LARGE F daylight_luminance(const SceneView<S> &scene, const Values<S> &values, const IntOf<F> &id,
                              const TexturedPoint<F> &at, const MaskOf<F> &active);

}  // namespace tr
