// Normals of a mesh that follow from its positions, and their derivatives.
#pragma once

#include <cstddef>
#include <cstdint>

namespace tr {

// A mesh's `positions` (n_vertices, 3) and `faces` (n_faces, 3).
template <class S>
struct Triangles {
    const S *positions;
    size_t n_vertices;
    const int32_t *faces;
    size_t n_faces;
};

// Face normals averaged with the corners' angles as weights (Thurmer and Wuthrich, "Computing Vertex Normals from
// Polygonal Facets", 1998), computed in double precision; (n_vertices, 3), the same for any number of threads. Vertices
// without a face, or where the average vanishes, get (1, 0, 0), and faces without an area have no part in it; neither
// has a derivative. std::invalid_argument for an index that is out of range.
template <class S>
void vertex_normals(const Triangles<S> &mesh, S *normals, int threads);

// The adjoint of positions from that of normals, and the tangent of normals from that of positions.
template <class S>
void vertex_normals_vjp(const Triangles<S> &mesh, const S *normals_bar, S *positions_bar, int threads);
template <class S>
void vertex_normals_jvp(const Triangles<S> &mesh, const S *positions_dot, S *normals_dot, int threads);

}  // namespace tr
