#include "normals.h"

#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

namespace tr {

template <class S>
void vertex_normals(const S *positions, size_t n_vertices, const int32_t *faces, size_t n_faces, S *normals) {
    std::vector<double> sums(n_vertices * 3);
    for (size_t f = 0; f < n_faces; ++f) {
        const S *p[3];
        size_t vertex[3];
        for (size_t i = 0; i < 3; ++i) {
            vertex[i] = size_t(faces[3 * f + i]);
            if (faces[3 * f + i] < 0 || vertex[i] >= n_vertices)
                throw std::invalid_argument("faces: expected indices below " + std::to_string(n_vertices) + ", got " +
                                            std::to_string(faces[3 * f + i]));
            p[i] = positions + 3 * vertex[i];
        }
        double edge[3][3];  // from corner i to the next
        for (size_t i = 0; i < 3; ++i)
            for (size_t k = 0; k < 3; ++k) edge[i][k] = double(p[(i + 1) % 3][k]) - double(p[i][k]);
        const double *a = edge[0], *b = edge[1];
        double normal[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
        double length = std::sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]);
        if (!(length > 0)) continue;
        for (size_t i = 0; i < 3; ++i) {
            const double *out = edge[i], *in = edge[(i + 2) % 3];
            // sine and cosine times the lengths of both edges; the sine's product is the same at all corners
            double angle = std::atan2(length, -(out[0] * in[0] + out[1] * in[1] + out[2] * in[2]));
            for (size_t k = 0; k < 3; ++k) sums[3 * vertex[i] + k] += normal[k] / length * angle;
        }
    }
    for (size_t v = 0; v < n_vertices; ++v) {
        const double *n = &sums[3 * v];
        double length = std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        for (size_t k = 0; k < 3; ++k) normals[3 * v + k] = length > 0 ? S(n[k] / length) : S(k == 0);
    }
}

template void vertex_normals(const float *, size_t, const int32_t *, size_t, float *);
template void vertex_normals(const double *, size_t, const int32_t *, size_t, double *);

}  // namespace tr
