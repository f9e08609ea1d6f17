// All that can be an outline in a scene: the edges of its meshes, with the faces that meet at each, and curves of its
// quadrics and height fields. Which faces meet depends on the indices of the meshes and on which vertices are in one
// place, and is found once; where they are, and a tree to choose from, is brought up to date.
#pragma once

#include <functional>

#include "core/scene.h"
#include "morton_order.h"
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

    bool of_field() const { return kind >= FieldContour; }
};

class OutlineSet {
public:
    // To where vertices are; `moves`: by shape, whether it does. Edges are found the first time, and where vertices
    // that were in one place no longer are, or faces that had no area have one. (Of a scene with other indices there
    // is another set.) Nothing is done if `version`, see SceneData::geometry_version, and `moves` are those of the last
    // time. `interrupted` is asked now and then; false if it was, and nothing is known then.
    template <class S>
    bool update(const SceneView<S> &scene, const uint8_t *moves, uint64_t version, int threads,
                const std::function<bool()> &interrupted);

    size_t n_edges() const { return begin_.size() - 1; }
    size_t size() const { return n_edges() + curves_.size(); }
    bool is_edge(size_t element) const { return element < n_edges(); }
    // Beyond the elements are the faces, for the rims of their normals (see cpu/outline_rims.h).
    bool is_face(size_t element) const { return element >= size(); }
    bool is_curve(size_t element) const { return !is_edge(element) && !is_face(element); }
    uint32_t face(size_t element) const { return uint32_t(element - size()); }
    size_t element_of_face(uint32_t face) const { return size() + face; }
    // Of which shape an element is, of the first where faces of several meet.
    template <class S>
    uint32_t shape_of_element(const SceneView<S> &scene, size_t i) const {
        if (is_face(i)) return shape_of_face(face(i));
        return is_edge(i) ? shape_of(half(scene, i, 0)) : uint32_t(curve(i).shape);
    }
    bool moves(uint32_t shape) const { return moves_[shape] != 0; }
    // How many faces an edge has, and one of them.
    size_t count(size_t edge) const { return begin_[edge + 1] - begin_[edge]; }
    template <class S>
    HalfEdge half(const SceneView<S> &scene, size_t edge, size_t k) const {
        return half_of(scene, corners_[begin_[edge] + k]);
    }
    uint32_t shape_of(const HalfEdge &half) const { return shape_of_face(half.face); }
    uint32_t shape_of_face(uint32_t face) const {
        if (meshes_.size() == 1) return meshes_[0].shape;
        size_t low = 0, high = meshes_.size();
        while (high - low > 1) {
            const size_t middle = (low + high) / 2;
            (meshes_[middle].face <= face ? low : high) = middle;
        }
        return meshes_[low].shape;
    }
    // Faces have vertices or shapes of their own there.
    bool is_split(size_t edge) const { return (around_[edge].all[1] & Flag) != 0; }
    // Of another element.
    const OutlineCurve &curve(size_t element) const { return curves_[element - n_edges()]; }
    template <class S>
    OutlineElement element(const SceneView<S> &scene, size_t i) const {
        return is_edge(i) ? edge_element(scene, i) : curve_element(scene, i);
    }
    const OutlineTree &tree() const { return tree_; }

private:
    static constexpr uint32_t Flag = 0x80000000u;
    struct Mesh {
        uint32_t face, shape;  // its first one
    };
    // The ends of an edge, and the third corners of two of its faces, or twice that of one: all that the tree needs, in
    // one place. The first end has a flag where there are not two faces, the second one where they are split, the
    // others where their face is turned.
    struct Around {
        uint32_t all[4];
    };
    // Of edges: three times a face, plus which of its corners the edge begins at, and whether it is turned; where those
    // of each edge begin.
    std::vector<uint32_t> corners_, begin_{0};
    std::vector<Around> around_;
    std::vector<Mesh> meshes_;
    std::vector<OutlineCurve> curves_;
    std::vector<uint32_t> copies_;  // pairs of vertices that are in one place
    std::vector<uint32_t> flat_;    // faces without an area
    std::vector<uint8_t> moves_;    // by shape
    OutlineTree tree_;
    bool found_ = false;
    uint64_t version_ = 0;

    template <class S>
    static HalfEdge half_of(const SceneView<S> &scene, uint32_t corner) {
        const uint32_t at = corner & ~Flag, face = at / 3, i = at - 3 * face;
        const uint32_t *v = scene.faces + 3 * size_t(face);
        // without branches, which nobody foresees
        const uint32_t next = (i + 1) & (i / 2 - 1), turned = corner / Flag, from = v[i], to = v[next];
        const uint32_t swapped = (from ^ to) & (0 - turned);
        return {from ^ swapped, to ^ swapped, v[3 - i - next], face, turned != 0};
    }
    template <class S>
    bool find(const SceneView<S> &scene, int threads, const std::function<bool()> &interrupted);
    template <class S>
    void gather(const SceneView<S> &scene, int threads);
    template <class S>
    bool holds(const SceneView<S> &scene) const;
    template <class S>
    void plant(const SceneView<S> &scene, int threads);
    template <class S>
    Extent extent_of_edges(const SceneView<S> &scene, size_t begin, size_t end) const;
    template <class S>
    bool are_in_order(const SceneView<S> &scene) const;
    template <class S>
    void plant_many(const SceneView<S> &scene, int threads);
    // Up to sixteen edges at once.
    template <class S>
    void put_edges(const SceneView<S> &scene, const uint32_t *edges, size_t n, OutlineLeaves::Elements &to) const;
    template <class S>
    OutlineElement edge_element(const SceneView<S> &scene, size_t edge) const;
    template <class S>
    OutlineElement curve_element(const SceneView<S> &scene, size_t element) const;
};

}  // namespace tr
