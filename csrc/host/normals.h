// Normals of a mesh that follow from its positions.
#pragma once

#include <cstddef>
#include <cstdint>

namespace tr {

// Face normals averaged with the corners' angles as weights (Thurmer and Wuthrich, "Computing Vertex Normals from
// Polygonal Facets", 1998), computed in double precision. `normals` and `positions` (n_vertices, 3), `faces` (n_faces,
// 3). Vertices without a face, or where the average vanishes, get (1, 0, 0). std::invalid_argument for an index that
// is out of range.
template <class S>
void vertex_normals(const S *positions, size_t n_vertices, const int32_t *faces, size_t n_faces, S *normals);

}  // namespace tr
