// Which outline a point on a surface should look past: a tree over all edges of a scene that can hide something, from
// which one is chosen about in proportion to what it may bring. With an idea of Conty Estevez and Kulla, "Importance
// Sampling of Many Lights with Adaptive Tree Splitting" (2018), nodes have cones of normals, which tell that all faces
// below look towards a point or away from it; then nothing below is an outline. Nodes have 16 children, so that a
// packet looks at all of them at once.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "outline_leaves.h"

namespace tr {

// Where it is looked from: a point or, `parallel`, along the unit vector p. Light is scattered towards d about like
// (1 - share) max(0, n.d) + share / (1 + k (1 - axis.d) / 2)^2, and less close to the horizon of the face whose normal
// is ng, on the side of ng; n = 0: alike in all directions. What is on the curved shape `own` sees no outline of it.
// `still`: the weight of outlines that rest.
struct OutlineAnchor {
    Vec3<float> p, n, axis, ng;
    float k, share, still;
    bool parallel;
    int32_t own;
};

// One of many candidates (resampled, Talbot et al. 2005): `element` or -1; the place s in [0, 1) along it; and one over
// the density of both, in expectation.
struct OutlineChoice {
    int32_t element;
    float s, inverse_density;
};

class OutlineTree {
public:
    static constexpr size_t Wide = OutlineLeaves::Wide, MostDescents = 8;

    // For n_elements that are kept as they are, and n_rounded edges; in leaves of their own. `set` gives a leaf up to
    // sixteen, from the first one on, in an order that keeps close ones together, see `morton_order`; different leaves
    // may be set at once. `build` finds the rest once they are there.
    void resize(size_t n_elements, size_t n_rounded);
    size_t n_leaves() const { return leaves_.size(); }
    void set(size_t leaf, const OutlineElement *elements, size_t n);
    void set(size_t leaf, const OutlineLeaves::Elements &elements);
    void build(int threads);

    // Calls visit(elements, rounding) for a leaf; most leaves that have no element which moves (or, `resting`, rests)
    // and of which some face may be seen and another not, within `margin`, from p or, `parallel`, along p, are left
    // out.
    template <class Visit>
    void if_outlines(size_t leaf, const Vec3<float> &p, bool parallel, float margin, bool resting,
                     Visit &&visit) const {
        if (!may_have_outlines(leaf, p, parallel, margin, resting)) return;
        OutlineLeaves::Elements space;
        OutlineLeaves::Rounding rounding;
        const OutlineLeaves::Elements &elements = leaves_.get(leaf, space, rounding);
        visit(elements, rounding);
    }

    // The element of a leaf's place k.
    int32_t index(size_t leaf, size_t k) const { return leaves_.index(leaf, k); }

    // n of them for one place, each of so many candidates, at most MostDescents.
    void choose(const OutlineAnchor &from, uint64_t seed, size_t descents, OutlineChoice *choices, size_t n) const;
    OutlineChoice choose(const OutlineAnchor &from, uint64_t seed, size_t descents) const {
        OutlineChoice choice;
        choose(from, seed, descents, &choice, 1);
        return choice;
    }

private:
    // Everything below a node is in a ball. The cone of its normals has a half angle of at least 90 degrees where its
    // cosine is not above zero. Fluxes: of what moves, and of what rests.
    struct Node {
        Vec3<float> center{0, 0, 0};
        float radius = 0;
        Vec3<float> axis{0, 0, 1};
        float cosine = -1, sine = 0, flux = 0, still = 0;
    };
    using Elements = OutlineLeaves::Elements;
    using Rounding = OutlineLeaves::Rounding;
    template <class T>
    using Column = OutlineLeaves::Column<T>;
    struct alignas(64) Nodes {  // siblings
        Column<float> center[3], radius, axis[3], cosine, sine, flux, still;
    };
    OutlineLeaves leaves_;
    std::vector<std::vector<Nodes>> levels_;  // from the leaves to the root, which are the children of one

    static Node node_of(const Elements &leaf, const OutlineLeaves::Box &box);
    static Node united(const Nodes &children);
    static void put(const Node &node, Nodes &to, size_t k);
    // A node, or at level -1 an edge and a place along it, see Candidates; and the probability to be there.
    struct Place {
        int level = 0;
        size_t index = 0;
        float weight = 0, probability = 0, s = 0, target = 0;
    };
    struct Candidates;
    class Front;
    OutlineChoice choose_below(const Front &front, const OutlineAnchor &from, uint64_t seed, size_t descents) const;
    bool may_have_outlines(size_t leaf, const Vec3<float> &p, bool parallel, float margin, bool resting) const;
    // Whether some are near; then, what these may be at most.
    static bool importance(const Nodes &nodes, const OutlineAnchor &from, float (&to)[Wide], float (&near)[Wide]);
    void propose(size_t leaf, const OutlineAnchor &from, float u, Candidates &to) const;
    static float curve_target(const Elements &leaf, size_t k, const OutlineAnchor &from);
};

}  // namespace tr
