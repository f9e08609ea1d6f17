// The leaves of an OutlineTree as they are made, see core/boundary/outline_leaves.h.
#pragma once

#include <vector>

#include "core/boundary/outline_leaves.h"

namespace tr {

// Of the lanes of a packet.
#if TR_HAS_PACKETS
inline float least_of(const PacketOf<float> &x) { return drjit::min(x); }
inline float greatest_of(const PacketOf<float> &x) { return drjit::max(x); }
inline float sum_of(const PacketOf<float> &x) { return drjit::sum(x); }
#else
inline float least_of(float x) { return x; }
inline float greatest_of(float x) { return x; }
inline float sum_of(float x) { return x; }
#endif

struct LeafBox {
    Vec3<float> low, high;
};
// Around what has a weight; upside down, if nothing has.
LeafBox box_of(const OutlineLeaf &leaf);
void set_element(OutlineLeaf &leaf, size_t k, const OutlineElement &element);
OutlineElement element_of(const OutlineLeaf &leaf, size_t k);

class OutlineLeafStore {
public:
    // Leaves for n elements that are kept as they are, then for n edges that are rounded.
    void resize(size_t n_elements, size_t n_rounded);
    // `box`: that of the elements.
    void set(size_t leaf, const OutlineLeaf &elements, const LeafBox &box);
    OutlineLeaves view() const {
        return {exact_.data(), rounded_.data(), uint32_t(exact_.size()), uint32_t(rounded_.size())};
    }

private:
    std::vector<OutlineLeaf> exact_;
    std::vector<RoundedLeaf> rounded_;
};

}  // namespace tr
