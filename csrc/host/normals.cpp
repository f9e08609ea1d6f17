#include "normals.h"

#include <algorithm>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/math/vector.h"
#include "parallel.h"

namespace tr {

namespace {

#if TR_HAS_PACKETS
using F = drjit::Packet<double, TR_PACKET_WIDTH / 2>;
#else
using F = double;
#endif
using V = Vec3<F>;
using Row = Vec3<double>;
constexpr size_t W = size_t(Lanes<F>::Width), Block = size_t(1) << 15;

// Faces, one a lane. (A face without an area has no normal, and its angles do not change.)
struct Corners {
    V edge[3];  // from corner i to the next
    V normal;
    F length, inverse;         // of the product of two edges, twice the area
    F along[3];                // the cosine of an angle, times the lengths of its edges
    F angle[3], per_along[3];  // and minus its derivative by `along`

    explicit Corners(const V (&p)[3]) {
        for (size_t i = 0; i < 3; ++i) edge[i] = p[(i + 1) % 3] - p[i];
        const V product = cross(edge[0], edge[1]);
        length = norm(product);
        const auto some = mask<F>(length > F(0));
        inverse = select(some, F(1) / length, F(0));
        normal = select(some, product * inverse, V{F(0), F(0), F(0)});
        for (size_t i = 0; i < 3; ++i) {
            along[i] = -dot(edge[i], edge[(i + 2) % 3]);
            angle[i] = atan2(length, along[i]);
            per_along[i] = select(some, length / (length * length + along[i] * along[i]), F(0));
        }
    }

    // The adjoints of the corners, from those of the normal times each corner's angle.
    void sweep(const V (&bar)[3], V (&p_bar)[3]) const {
        V sum = bar[0] * angle[0] + bar[1] * angle[1] + bar[2] * angle[2];
        F length_bar(0);
        V edge_bar[3] = {{F(0), F(0), F(0)}, {F(0), F(0), F(0)}, {F(0), F(0), F(0)}};
        for (size_t i = 0; i < 3; ++i) {
            const F g = dot(normal, bar[i]) * per_along[i];
            length_bar = length_bar + g * along[i] * inverse;
            edge_bar[i] = edge_bar[i] + edge[(i + 2) % 3] * g;
            edge_bar[(i + 2) % 3] = edge_bar[(i + 2) % 3] + edge[i] * g;
        }
        const V product_bar = (sum - normal * dot(normal, sum)) * inverse + normal * length_bar;
        edge_bar[0] = edge_bar[0] + cross(edge[1], product_bar);
        edge_bar[1] = edge_bar[1] + cross(product_bar, edge[0]);
        for (size_t i = 0; i < 3; ++i) p_bar[i] = edge_bar[(i + 2) % 3] - edge_bar[i];
    }

    // The tangent of the normal times each corner's angle.
    void push(const V (&p_dot)[3], V (&dot_of)[3]) const {
        V edge_dot[3];
        for (size_t i = 0; i < 3; ++i) edge_dot[i] = p_dot[(i + 1) % 3] - p_dot[i];
        const V product_dot = cross(edge_dot[0], edge[1]) + cross(edge[0], edge_dot[1]);
        const F length_dot = dot(normal, product_dot);
        const V normal_dot = (product_dot - normal * length_dot) * inverse;
        for (size_t i = 0; i < 3; ++i) {
            const size_t before = (i + 2) % 3;
            const F along_dot = -dot(edge_dot[i], edge[before]) - dot(edge[i], edge_dot[before]);
            const F angle_dot = per_along[i] * (along[i] * length_dot * inverse - along_dot);
            dot_of[i] = normal_dot * angle[i] + normal * angle_dot;
        }
    }
};

template <class S>
class Pass {
public:
    Pass(const Triangles<S> &mesh, int threads) : mesh_(mesh), threads_(threads) {
        const int32_t *end = mesh.faces + 3 * mesh.n_faces, *wrong = std::find_if(mesh.faces, end, [&](int32_t index) {
            return index < 0 || size_t(index) >= mesh.n_vertices;
        });
        if (wrong != end)
            throw std::invalid_argument("faces: expected indices below " + std::to_string(mesh.n_vertices) + ", got " +
                                        std::to_string(*wrong));
    }

    // By vertex, the sums of what `each(corners, first face, number of faces, to)` gives for the corners of a packet of
    // faces. These are added in their order.
    template <class Each>
    std::vector<Row> sums(Each &&each) const {
        std::vector<Row> total(mesh_.n_vertices, Row{0, 0, 0}), given(3 * std::min(Block, mesh_.n_faces + W));
        for (size_t first = 0; first < mesh_.n_faces; first += Block) {
            const size_t n = std::min(Block, mesh_.n_faces - first);
            for_ranges((n + W - 1) / W, threads_,
                       [&](size_t begin, size_t end, int) {
                           for (size_t k = begin * W; k < std::min(end * W, n); k += W) {
                               const size_t there = std::min(W, n - k);
                               V p[3], found[3];
                               for (size_t i = 0; i < 3; ++i) p[i] = rows(mesh_.positions, first + k, there, i);
                               each(Corners(p), first + k, there, found);
                               for (size_t i = 0; i < 3; ++i) keep(found[i], &given[3 * k + i], there);
                           }
                       },
                       256);
            const int32_t *vertex = mesh_.faces + 3 * first;
            for (size_t k = 0; k < 3 * n; ++k) {
                Row &to = total[size_t(vertex[k])];
                to = to + given[k];
            }
        }
        return total;
    }
    // Rows of those vertices that are corner i of some faces; the last one again in lanes beyond these.
    template <class T>
    V rows(const T *of, size_t face, size_t n, size_t i) const {
        alignas(64) double at[3][W];
        for (size_t k = 0; k < W; ++k) {
            const T *row = of + 3 * size_t(mesh_.faces[3 * (face + std::min(k, n - 1)) + i]);
            for (size_t c = 0; c < 3; ++c) at[c][k] = double(row[c]);
        }
        return {load<F>(at[0]), load<F>(at[1]), load<F>(at[2])};
    }
    // Normals before they have unit length.
    std::vector<Row> totals() const {
        return sums([](const Corners &c, size_t, size_t, V(&to)[3]) {
            for (size_t i = 0; i < 3; ++i) to[i] = c.normal * c.angle[i];
        });
    }

private:
    const Triangles<S> &mesh_;
    const int threads_;

    static void keep(const V &v, Row *to, size_t n) {
        for (size_t k = 0; k < n; ++k) to[3 * k] = {lane(v.x, int(k)), lane(v.y, int(k)), lane(v.z, int(k))};
    }
};

template <class S>
void put(const Row &row, S *to) {
    to[0] = S(row.x), to[1] = S(row.y), to[2] = S(row.z);
}

// That part of `change` that turns `total`, over the latter's length: the derivative of its direction, and the adjoint.
Row turning(const Row &total, const Row &change) {
    const double length = norm(total);
    if (!(length > 0)) return {0, 0, 0};
    const Row n = total * (1 / length);
    return (change - n * dot(n, change)) * (1 / length);
}

template <class S>
Row row_of(const S *rows, size_t i) {
    return {double(rows[3 * i]), double(rows[3 * i + 1]), double(rows[3 * i + 2])};
}

}  // namespace

template <class S>
void vertex_normals(const Triangles<S> &mesh, S *normals, int threads) {
    const std::vector<Row> totals = Pass<S>(mesh, threads).totals();
    for (size_t v = 0; v < mesh.n_vertices; ++v) {
        const double length = norm(totals[v]);
        put(length > 0 ? totals[v] * (1 / length) : Row{1, 0, 0}, normals + 3 * v);
    }
}

template <class S>
void vertex_normals_vjp(const Triangles<S> &mesh, const S *normals_bar, S *positions_bar, int threads) {
    const Pass<S> pass(mesh, threads);
    std::vector<Row> bar = pass.totals();
    for (size_t v = 0; v < mesh.n_vertices; ++v) bar[v] = turning(bar[v], row_of(normals_bar, v));
    const std::vector<Row> swept = pass.sums([&](const Corners &c, size_t face, size_t n, V(&to)[3]) {
        V of[3];
        for (size_t i = 0; i < 3; ++i) of[i] = pass.rows(&bar[0].x, face, n, i);
        c.sweep(of, to);
    });
    for (size_t v = 0; v < mesh.n_vertices; ++v) put(swept[v], positions_bar + 3 * v);
}

template <class S>
void vertex_normals_jvp(const Triangles<S> &mesh, const S *positions_dot, S *normals_dot, int threads) {
    const Pass<S> pass(mesh, threads);
    const std::vector<Row> totals = pass.totals(),
                           change = pass.sums([&](const Corners &c, size_t face, size_t n, V(&to)[3]) {
                               V of[3];
                               for (size_t i = 0; i < 3; ++i) of[i] = pass.rows(positions_dot, face, n, i);
                               c.push(of, to);
                           });
    for (size_t v = 0; v < mesh.n_vertices; ++v) put(turning(totals[v], change[v]), normals_dot + 3 * v);
}

#define TR_INSTANTIATE(S)                                                        \
    template void vertex_normals(const Triangles<S> &, S *, int);                \
    template void vertex_normals_vjp(const Triangles<S> &, const S *, S *, int); \
    template void vertex_normals_jvp(const Triangles<S> &, const S *, S *, int);
TR_INSTANTIATE(float)
TR_INSTANTIATE(double)

}  // namespace tr
