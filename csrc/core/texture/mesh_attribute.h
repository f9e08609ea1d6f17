// `mesh_attribute`: colours stored on a mesh, interpolated between vertices or constant on a face.
#pragma once

#include "bitmap.h"

namespace tr {

struct MeshAttribute {
    enum { Name, Scale };
    static constexpr Field fields[] = {
        {"name", Kind::Int, None, 0, INFINITY, "", "number of the attribute's name: vertex_* (V, C) or face_* (F, C)"},
        {"scale", Kind::Float, 1, -INFINITY, INFINITY, "interior", "factor"},
    };
    static constexpr Model model = {"texture", "mesh_attribute", "Colours stored on the vertices or faces of a mesh.",
                                    fields, 2};

    // The attribute of this name on a shape: -1 if it has none.
    template <class S>
    TR_HD static int32_t find(const SceneView<S> &scene, const Record &record, uint32_t shape) {
        int32_t i = scene.shapes[shape].first_attribute;
        while (i >= 0 && scene.attributes[i].name != record.field[Name]) i = scene.attributes[i].next;
        return i;
    }

    template <class F, class S>
    TR_INLINE static Footprint<F, 3> footprint(const SceneView<S> &scene, const AttributeInfo &info, uint32_t shape,
                                               const SurfacePoint<F> &at, const MaskOf<F> &active) {
        using U = UIntOf<F>;
        Footprint<F, 3> r;
        if (info.per_face) {
            for (int k = 0; k < 3; ++k) r.texel[k] = select(mask<U>(active), at.primitive, U(0u));
            r.weight[0] = F(1);
            r.weight[1] = r.weight[2] = F(0);
            return r;
        }
        const ShapeInfo &mesh = scene.shapes[shape];
        // faces hold indices into the vertices of all meshes
        U face = (U(uint32_t(mesh.face_offset)) + at.primitive) * 3u;
        for (uint32_t k = 0; k < 3; ++k)
            r.texel[k] = gather<U>(scene.faces, face + k, mask<U>(active)) - uint32_t(mesh.first_vertex);
        r.weight[0] = F(1) - at.b1 - at.b2;
        r.weight[1] = at.b1;
        r.weight[2] = at.b2;
        return r;
    }
};

}  // namespace tr
