// Which outline a point on a surface should look past: a tree over all edges of a scene that can hide something, from
// which one is chosen about in proportion to what it may bring. With an idea of Conty Estevez and Kulla, "Importance
// Sampling of Many Lights with Adaptive Tree Splitting" (2018), boxes have cones of normals, which tell that all faces
// below look towards a point or away from it; then nothing below is an outline.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace tr {

// What can be an outline: a straight edge between `a` and `b` of faces with normals n0 and n1; or, `Round`, a curve
// around `a` with the radius b[0], of the curved shape of number `shape`.
struct OutlineElement {
    enum Kind : int32_t { Edge = 0, Always = 1, Crease = 2, Round = 3 };  // Crease: of an edge, an outline or not
    float a[3], b[3], n0[3], n1[3], weight, bend;
    int32_t kind, shape, index;
};

// Where it is looked from: a point or, `parallel`, along the unit vector p. Light is scattered towards d about like (1
// - share) max(0, n.d) + share exp(k (axis.d - 1)); n = 0: alike in all directions. What is on the curved shape `own`
// sees no outline of it.
struct OutlineAnchor {
    float p[3], n[3], axis[3], k, share;
    int32_t parallel, own;
};

// One of many candidates (resampled, Talbot et al. 2005): `element` or -1; the place s in [0, 1) along it; and one over
// the density of both, in expectation.
struct OutlineChoice {
    int32_t element;
    float s, inverse_density;
};

class OutlineTree {
public:
    static constexpr size_t Leaf = 8, Descents = 4;

    // In an order that keeps close ones together, see `morton_order`; `build` finds the rest once they are there.
    std::vector<OutlineElement> &elements() { return elements_; }
    const std::vector<OutlineElement> &elements() const { return elements_; }
    void build(int threads);
    OutlineChoice choose(const OutlineAnchor &from, uint64_t seed) const;

private:
    struct Node {
        float center[3], radius;
        float axis[3], cosine, sine;  // cone of normals; its half angle is at least 90 degrees where cosine <= 0
        float flux;
    };
    std::vector<OutlineElement> elements_;
    std::vector<Node> nodes_;  // 1 is the root, 2i and 2i+1 the children of i
    size_t first_leaf_ = 1;

    Node node_of(size_t begin, size_t end) const;
    static Node united(const Node &a, const Node &b);
    static float importance(const Node &node, const OutlineAnchor &from);
    static float target(const OutlineElement &e, const OutlineAnchor &from, float s);
};

// Places (n, 3) along a curve that keeps close ones together.
std::vector<int32_t> morton_order(const float *places, size_t n);

}  // namespace tr
