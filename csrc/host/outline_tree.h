// The tree of outlines, from which vertices of paths and lights choose (core/boundary/outline_choice.h), as it is made.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/boundary/outline_tree.h"
#include "outline_leaves.h"

namespace tr {

class OutlineTree {
public:
    static constexpr size_t Wide = OutlineWide;

    // For n_elements that are kept as they are, and n_rounded edges; in leaves of their own. `set` gives a leaf up to
    // sixteen, from the first one on, in an order that keeps close ones together, see `morton_order`; different leaves
    // may be set at once. `build` finds the rest once they are there.
    void resize(size_t n_elements, size_t n_rounded);
    size_t n_leaves() const { return leaves_.view().size(); }
    void set(size_t leaf, const OutlineElement *elements, size_t n);
    void set(size_t leaf, const OutlineLeaf &elements);
    void build(int threads);

    // Calls visit(elements, rounding) for a leaf; most leaves that have no element which moves (or, `resting`, rests)
    // and of which some face may be seen and another not, within `margin`, from p or, `parallel`, along p, are left
    // out.
    template <class Visit>
    void if_outlines(size_t leaf, const Vec3<float> &p, bool parallel, float margin, bool resting,
                     Visit &&visit) const {
        if (!may_have_outlines(leaf, p, parallel, margin, resting)) return;
        OutlineLeaf space;
        LeafRounding rounding;
        const OutlineLeaf &elements = leaves_.view().get(leaf, space, rounding);
        visit(elements, rounding);
    }

    // The element of a leaf's place k.
    int32_t index(size_t leaf, size_t k) const { return leaves_.view().index(leaf, k); }

    OutlineTreeView view() const;

private:
    struct Node {
        Vec3<float> center{0, 0, 0};
        float radius = 0;
        Vec3<float> axis{0, 0, 1};
        float cosine = -1, sine = 0, flux = 0, still = 0;
    };
    OutlineLeafStore leaves_;
    std::vector<std::vector<OutlineNodes>> levels_;

    static Node node_of(const OutlineLeaf &leaf, const LeafBox &box);
    static Node united(const OutlineNodes &children);
    static void put(const Node &node, OutlineNodes &to, size_t k);
    bool may_have_outlines(size_t leaf, const Vec3<float> &p, bool parallel, float margin, bool resting) const;
};

}  // namespace tr
