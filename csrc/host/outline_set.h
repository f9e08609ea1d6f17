// What can be an outline in a scene (OutlineTable), as it is made: which faces meet depends on the indices of the
// meshes and on which vertices are in one place, and is found once; where they are, and a tree to choose from, is
// brought up to date.
#pragma once

#include <functional>

#include "core/boundary/outline_table.h"
#include "morton_order.h"
#include "outline_tree.h"

namespace tr {

class OutlineSet {
public:
    OutlineSet() = default;
    OutlineSet(const OutlineSet &) = delete;
    OutlineSet &operator=(const OutlineSet &) = delete;

    // To where vertices are; `moves`: by shape, whether it does. Edges are found the first time, and where vertices
    // that were in one place no longer are, or faces that had no area have one. (Of a scene with other indices there
    // is another set.) Nothing is done if `version`, see SceneData::geometry_version, and `moves` are those of the last
    // time. `interrupted` is asked now and then; false if it was, and nothing is known then.
    template <class S>
    bool update(const SceneView<S> &scene, const uint8_t *moves, uint64_t version, int threads,
                const std::function<bool()> &interrupted);

    size_t n_edges() const { return table_.n_edges; }
    size_t size() const { return table_.size(); }
    template <class S>
    OutlineElement element(const SceneView<S> &scene, size_t i) const {
        return table_.is_edge(i) ? edge_element(scene, i) : curve_element(scene, i);
    }
    // As it is now.
    const OutlineTable &table() const { return table_; }
    const OutlineTree &tree() const { return tree_; }
    // Another number, of all sets, whenever it has changed.
    uint64_t revision() const { return revision_; }
    size_t n_shapes() const { return moves_.size(); }

private:
    static constexpr uint32_t Flag = OutlineFlag;
    // See OutlineTable.
    std::vector<uint32_t> corners_, begin_{0};
    std::vector<OutlineEnds> around_;
    std::vector<OutlineMesh> meshes_;
    std::vector<OutlineCurve> curves_;
    std::vector<uint32_t> copies_;  // pairs of vertices that are in one place
    std::vector<uint32_t> flat_;    // faces without an area
    std::vector<uint8_t> moves_;    // by shape
    OutlineTree tree_;
    OutlineTable table_{};
    bool found_ = false;
    uint64_t version_ = 0, revision_ = 0;

    void refresh_table();
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
    void put_edges(const SceneView<S> &scene, const uint32_t *edges, size_t n, OutlineLeaf &to) const;
    template <class S>
    OutlineElement edge_element(const SceneView<S> &scene, size_t edge) const;
    template <class S>
    OutlineElement curve_element(const SceneView<S> &scene, size_t element) const;
};

}  // namespace tr
