// The scene as the renderer sees it: flat tables, indices instead of pointers, so that packets gather from it and a
// device copy is a copy. Filled by csrc/host.
#pragma once

#include "color/color.h"
#include "model.h"

namespace tr {

// A large tensor where it lies; shape (rows, columns, channels) or (n, channels).
template <class S>
struct TensorView {
    const S *data;
    int32_t shape[3];
};

// Parameter values. The tangent of a forward-mode derivative has the same layout.
template <class S>
struct Values {
    const S *constants;            // the small parameters, colours expanded to C numbers
    const TensorView<S> *tensors;  // by slot in the flat parameter list
};

enum ShapeFlags : int32_t { HasNormals = 1, HasTexcoords = 2, FlipNormals = 4 };
enum class ShapeKind : int32_t { Mesh = 0, Sphere = 1, Disk = 2 };

struct ShapeInfo {
    int32_t kind, flags, bsdf, emitter;
    int32_t face_offset, n_faces, first_vertex, cdf_offset;
    int32_t first_attribute, reserved[7];
};
static_assert(sizeof(ShapeInfo) == 64, "gathered with a stride of 16 integers");

struct AttributeInfo {
    int32_t name, tensor, per_face, next;  // a list a shape: next = -1 ends it
};

template <class S>
struct SceneView {
    Values<S> values;

    const Record *textures, *bsdfs, *emitters, *sensors;
    int32_t n_textures, n_bsdfs, n_emitters, n_sensors;

    // geometry: all meshes one after the other, indices global
    const S *positions, *normals, *texcoords;
    const uint32_t *faces;
    const ShapeInfo *shapes;
    const S
        *shape_matrices;  // 24 a shape: to_world and its inverse, 3 rows of 4 each (sphere, disk: of the unit shape)
    const S *shape_areas;
    const S *area_cdf;  // of the faces of emitting meshes
    const AttributeInfo *attributes;
    int32_t n_shapes;

    // choosing an emitter
    const S *emitter_cdf, *emitter_pmf;
    int32_t environment;  // emitter index or -1

    // environment map: cells between texels, chosen by row, then by column
    const S *env_marginal, *env_conditional, *env_to_local, *env_to_world;
    int32_t env_columns, env_rows;
};

// ------------------------------------------------------------------------------------------------- reading records
template <class F>
TR_INLINE IntOf<F> record_field(const Record *table, int field, const IntOf<F> &index, const MaskOf<F> &active) {
    const int32_t *base = &table->kind + 1 + field;
    return gather<IntOf<F>>(base, convert<UIntOf<IntOf<F>>>(index * 16), mask<IntOf<F>>(active));
}
template <class F>
TR_INLINE IntOf<F> record_kind(const Record *table, const IntOf<F> &index, const MaskOf<F> &active) {
    return record_field<F>(table, -1, index, active);
}
template <class F>
TR_INLINE IntOf<F> shape_info(const ShapeInfo *table, int32_t ShapeInfo::*member, const UIntOf<F> &shape,
                              const MaskOf<F> &active) {
    return gather<IntOf<F>>(&(table->*member), shape * 16u, mask<IntOf<F>>(active));
}

template <int C, class F, class S>
TR_INLINE Color<F, C> constant_color(const Values<S> &values, const IntOf<F> &offset, const MaskOf<F> &active) {
    Color<F, C> r;
    for (int c = 0; c < C; ++c) r[c] = gather<F>(values.constants, UIntOf<F>(offset) + uint32_t(c), active);
    return r;
}

// The index of the first number of cdf[offset .. offset + n) that is larger than u; n - 1 if none is.
template <class F, class S>
TR_INLINE UIntOf<F> search_cdf(const S *cdf, const UIntOf<F> &offset, const UIntOf<F> &n, const F &u,
                               const MaskOf<F> &active) {
    using U = UIntOf<F>;
    U low(0u), high = n - 1u;
    auto open = mask<F>(low < high) && active;
    while (any(open)) {
        U middle = (low + high) >> 1;
        auto right = mask<F>(gather<F>(cdf, offset + middle, open) <= u);
        low = select(right && open, middle + 1u, low);
        high = select(!right && open, middle, high);
        open = mask<F>(low < high) && active;
    }
    return low;
}

}  // namespace tr
