// The tree over all edges of a scene that can hide something, from which outlines are chosen: see outline_choice.h.
#pragma once

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

// Everything below a node is in a ball. The cone of its normals has a half angle of at least 90 degrees where its
// cosine is not above zero. Fluxes: of what moves, and of what rests. (Siblings, side by side.)
struct alignas(64) OutlineNodes {
    OutlineColumn<float> center[3], radius, axis[3], cosine, sine, flux, still;
};

struct OutlineTreeView {
    static constexpr int MostLevels = 8;  // 16^8 leaves
    OutlineLeaves leaves;
    const OutlineNodes *levels[MostLevels];  // from the leaves to the root, which are the children of one
    int32_t n_levels;

    // The element of a leaf's place k.
    TR_HD int32_t index(size_t leaf, size_t k) const { return leaves.index(leaf, k); }
    template <class Visit>
    void for_pointers(Visit &&visit) const {
        leaves.for_pointers(visit);
        for (int l = 0; l < n_levels; ++l) visit(levels[l]);
    }
};

}  // namespace tr
