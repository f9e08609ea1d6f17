// All that can be an outline in a scene: the edges of its meshes, with the faces that meet at each, and curves of its
// quadrics. Which faces meet depends on the indices of the meshes and on which vertices are in one place, and is found
// once; where they are, and a tree to choose from, is brought up to date.
#pragma once

#include "core/scene.h"
#include "outline_tree.h"

namespace tr {

// An edge as one of its faces has it: its ends, in the same order for all of its faces, and the face's third corner.
// `turned`: the face has the ends the other way round.
struct HalfEdge {
    uint32_t v0, v1, third, shape : 31, turned : 1;
};

// What of a quadric is an outline.
struct OutlineCurve {
    enum Kind : int32_t { Contour, Rim, LowerRim, UpperRim, LeftLine, RightLine };
    int32_t shape, kind;
};

class OutlineSet {
public:
    // To where vertices are; `moves`: by shape, whether it does. Edges are found the first time, and where vertices
    // that were in one place no longer are, or faces that had no area have one. (Of a scene with other indices there
    // is another set.)
    template <class S>
    void update(const SceneView<S> &scene, const uint8_t *moves, int threads);

    size_t n_edges() const { return begin_.size() - 1; }
    size_t size() const { return n_edges() + curves_.size(); }
    bool is_edge(size_t element) const { return element < n_edges(); }
    // Of an edge.
    const HalfEdge *halves(size_t edge) const { return halves_.data() + begin_[edge]; }
    size_t count(size_t edge) const { return begin_[edge + 1] - begin_[edge]; }
    // Faces have vertices or shapes of their own there.
    bool is_split(size_t edge) const { return split_[edge] != 0; }
    // Of another element.
    const OutlineCurve &curve(size_t element) const { return curves_[element - n_edges()]; }
    const OutlineTree &tree() const { return tree_; }

private:
    std::vector<HalfEdge> halves_;
    std::vector<uint32_t> begin_{0};
    std::vector<OutlineCurve> curves_;
    std::vector<uint32_t> copies_;  // pairs of vertices that are in one place
    std::vector<uint32_t> flat_;    // faces without an area
    std::vector<uint8_t> split_;
    OutlineTree tree_;
    bool found_ = false;

    template <class S>
    void find(const SceneView<S> &scene);
    template <class S>
    bool holds(const SceneView<S> &scene) const;
    template <class S>
    OutlineElement element(const SceneView<S> &scene, size_t i) const {
        return is_edge(i) ? edge_element(scene, i) : curve_element(scene, i);
    }
    template <class S>
    OutlineElement edge_element(const SceneView<S> &scene, size_t edge) const;
    template <class S>
    OutlineElement curve_element(const SceneView<S> &scene, size_t element) const;
};

}  // namespace tr
