// Which outline a point on a surface should look past: one of the tree is chosen about in proportion to what it may
// bring. With an idea of Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting"
// (2018), nodes have cones of normals, which tell that all faces below look towards a point or away from it; then
// nothing below is an outline. Nodes have 16 children, so that a packet looks at all of them at once.
#pragma once

#include "outline_tree.h"

namespace tr {

constexpr size_t MostOutlineDescents = 8;

// n of them for one place, each of so many candidates, at most MostOutlineDescents.
TR_LARGE void choose_outlines(const OutlineTreeView &tree, const OutlineAnchor &from, uint64_t seed, size_t descents,
                              OutlineChoice *choices, size_t n);

}  // namespace tr
