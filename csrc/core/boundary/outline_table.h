// All that can be an outline in a scene: the edges of its meshes, with the faces that meet at each, and curves of its
// quadrics and height fields. The host makes it (host/outline_set.h).
#pragma once

#include "../scene.h"
#include "outline_tree.h"

namespace tr {

// An edge as one of its faces has it: its ends, in the same order for all of its faces, and the face's third corner.
// `turned`: the face has the ends the other way round.
struct HalfEdge {
    uint32_t v0, v1, third, face;
    bool turned;
};

// How steep a height field is along x and y at most, and its least and largest height, in its own frame.
struct HeightBounds {
    float slope_x, slope_y, low, high;
};

// What of a quadric or a height field is an outline.
struct OutlineCurve {
    enum Kind : int32_t {
        Contour,
        Rim,
        LowerRim,
        UpperRim,
        LeftLine,
        RightLine,
        FieldContour,
        FieldBorder,
        FieldCreases
    };
    int32_t shape, kind;
    HeightBounds bounds{};  // of height fields

    TR_HD bool of_field() const { return (facts::ShapeFlags & IsHeightField) != 0 && kind >= FieldContour; }
};

constexpr uint32_t OutlineFlag = 0x80000000u;

// A mesh, by its first face.
struct OutlineMesh {
    uint32_t face, shape;
};

// The ends of an edge, and the third corners of two of its faces, or twice that of one: all that the tree needs, in
// one place. The first end has a flag where there are not two faces, the second one where they are split, the others
// where their face is turned.
struct OutlineEnds {
    uint32_t all[4];
};

struct OutlineTable {
    // Of edges: three times a face, plus which of its corners the edge begins at, and whether it is turned; where those
    // of each edge begin.
    const uint32_t *corners, *begin;
    const OutlineEnds *around;
    const OutlineMesh *meshes;
    const OutlineCurve *curves;
    const uint8_t *moving;  // by shape
    uint32_t n_edges, n_meshes, n_curves;
    OutlineTreeView tree;

    TR_HD size_t size() const { return size_t(n_edges) + n_curves; }
    TR_HD bool is_edge(size_t element) const { return element < n_edges; }
    // Beyond the elements are the faces, for the rims of their normals (see outline_rims.h).
    TR_HD bool is_face(size_t element) const { return element >= size(); }
    TR_HD bool is_curve(size_t element) const { return !is_edge(element) && !is_face(element); }
    TR_HD uint32_t face(size_t element) const { return uint32_t(element - size()); }
    TR_HD size_t element_of_face(uint32_t face) const { return size() + face; }
    // Of which shape an element is, of the first where faces of several meet.
    template <class S>
    TR_HD uint32_t shape_of_element(const SceneView<S> &scene, size_t i) const {
        if (is_face(i)) return shape_of_face(face(i));
        return is_edge(i) ? shape_of(half(scene, i, 0)) : uint32_t(curve(i).shape);
    }
    TR_HD bool moves(uint32_t shape) const { return moving[shape] != 0; }
    // How many faces an edge has, and one of them.
    TR_HD size_t count(size_t edge) const { return begin[edge + 1] - begin[edge]; }
    template <class S>
    TR_HD HalfEdge half(const SceneView<S> &scene, size_t edge, size_t k) const {
        return half_of(scene, corners[begin[edge] + k]);
    }
    TR_HD uint32_t shape_of(const HalfEdge &half) const { return shape_of_face(half.face); }
    TR_HD uint32_t shape_of_face(uint32_t face) const {
        if (n_meshes == 1) return meshes[0].shape;
        size_t low = 0, high = n_meshes;
        while (high - low > 1) {
            const size_t middle = (low + high) / 2;
            (meshes[middle].face <= face ? low : high) = middle;
        }
        return meshes[low].shape;
    }
    // Faces have vertices or shapes of their own there.
    TR_HD bool is_split(size_t edge) const { return (around[edge].all[1] & OutlineFlag) != 0; }
    // Of another element.
    TR_HD const OutlineCurve &curve(size_t element) const { return curves[element - n_edges]; }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        visit(corners), visit(begin), visit(around), visit(meshes), visit(curves), visit(moving);
        tree.for_pointers(visit);
    }

private:
    template <class S>
    TR_HD static HalfEdge half_of(const SceneView<S> &scene, uint32_t corner) {
        const uint32_t at = corner & ~OutlineFlag, face = at / 3, i = at - 3 * face;
        const uint32_t *v = scene.faces + 3 * size_t(face);
        // without branches, which nobody foresees
        const uint32_t next = (i + 1) & (i / 2 - 1), turned = corner / OutlineFlag, from = v[i], to = v[next];
        const uint32_t swapped = (from ^ to) & (0 - turned);
        return {from ^ swapped, to ^ swapped, v[3 - i - next], face, turned != 0};
    }
};

}  // namespace tr
