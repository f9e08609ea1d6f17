#include "outline_set.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "morton_order.h"
#include "parallel.h"

namespace tr {

namespace {

constexpr float Hollow = 0.1f;  // weight of edges that can be seen from behind only

using V = Vec3<float>;

template <class S>
V place_of(const SceneView<S> &scene, uint32_t vertex) {
    const S *p = scene.vertices + VertexRow<S>::Size * size_t(vertex);
    return {float(p[0]), float(p[1]), float(p[2])};
}

template <class S>
V face_normal(const SceneView<S> &scene, const HalfEdge &h) {
    const V a = place_of(scene, h.v0), n = cross(place_of(scene, h.v1) - a, place_of(scene, h.third) - a);
    const float length = norm(n);
    return n * ((h.turned ? -1.f : 1.f) / std::max(length, 1e-30f));
}

template <class S>
bool has_area(const SceneView<S> &scene, const uint32_t *face) {
    Vec3<S> p[3];
    for (size_t k = 0; k < 3; ++k) {
        const S *row = scene.vertices + VertexRow<S>::Size * size_t(face[k]);
        p[k] = {row[0], row[1], row[2]};
    }
    return max_abs(cross(p[1] - p[0], p[2] - p[0])) > 0;
}

// The largest factor by which the matrix of these columns stretches, by the power method.
float stretch(const V &x, const V &y, const V &z) {
    V v{0.6f, 0.5f, 0.7f};
    for (int i = 0; i < 32; ++i) {
        const V w = x * v.x + y * v.y + z * v.z, next{dot(x, w), dot(y, w), dot(z, w)};
        v = next * (1 / std::max(norm(next), 1e-30f));
    }
    return norm(x * v.x + y * v.y + z * v.z);
}

// For each vertex of meshes the first one that is in the same place.
template <class S>
std::vector<uint32_t> weld(const SceneView<S> &scene, const std::vector<uint32_t> &vertices, size_t n) {
    constexpr uint32_t empty = 0xFFFFFFFFu;
    size_t size = 16;
    while (size < 2 * vertices.size()) size *= 2;
    std::vector<uint32_t> table(size, empty), first(n, empty);
    for (uint32_t v : vertices) {
        const S *p = scene.vertices + VertexRow<S>::Size * size_t(v);
        uint64_t hash = 0;
        for (size_t k = 0; k < 3; ++k) {
            const double x = double(p[k]) + 0.0;  // minus zero becomes zero
            uint64_t bits;
            std::memcpy(&bits, &x, sizeof(bits));
            hash = (hash ^ bits) * 0x9E3779B97F4A7C15ull;
            hash ^= hash >> 29;
        }
        size_t at = size_t(hash) & (size - 1);
        auto differs = [&](uint32_t other) {
            return !std::equal(p, p + 3, scene.vertices + VertexRow<S>::Size * size_t(other));
        };
        while (table[at] != empty && differs(table[at])) at = (at + 1) & (size - 1);
        if (table[at] == empty) table[at] = v;
        first[v] = table[at];
    }
    return first;
}

}  // namespace

// Half edges go by the smaller of their welded ends, and there by the larger one.
template <class S>
void OutlineSet::find(const SceneView<S> &scene) {
    struct Found {
        uint32_t high;
        HalfEdge half;
    };
    std::vector<uint32_t> vertices;
    std::vector<uint8_t> known;
    auto each_face = [&](auto &&visit) {
        for (int32_t s = 0; s < scene.n_shapes; ++s) {
            const ShapeInfo &info = scene.shapes[s];
            if (info.flags & IsCurved) continue;
            for (int32_t f = 0; f < info.n_faces; ++f)
                visit(uint32_t(s), scene.faces + 3 * size_t(info.face_offset + f));
        }
    };
    flat_.clear();
    each_face([&](uint32_t, const uint32_t *face) {
        if (!has_area(scene, face)) flat_.push_back(uint32_t((face - scene.faces) / 3));
        for (size_t k = 0; k < 3; ++k) {
            if (face[k] >= known.size()) known.resize(size_t(face[k]) + 1 + known.size() / 2);
            if (!known[face[k]]) known[face[k]] = 1, vertices.push_back(face[k]);
        }
    });
    std::sort(vertices.begin(), vertices.end());
    const size_t n = vertices.empty() ? 0 : size_t(vertices.back()) + 1;
    const std::vector<uint32_t> first = weld(scene, vertices, n);
    copies_.clear();
    for (uint32_t v : vertices)
        if (first[v] != v) copies_.push_back(v), copies_.push_back(first[v]);
    // faces without an area have no part in it
    auto each_half = [&](auto &&visit) {
        each_face([&](uint32_t shape, const uint32_t *face) {
            if (!has_area(scene, face)) return;
            for (size_t k = 0; k < 3; ++k) {
                const uint32_t v0 = face[k], v1 = face[(k + 1) % 3], third = face[(k + 2) % 3];
                const bool turned = first[v0] > first[v1];
                const uint32_t low = turned ? v1 : v0, high = turned ? v0 : v1;
                visit(first[low], Found{first[high], {low, high, third, shape & 0x7FFFFFFFu, turned}});
            }
        });
    };
    std::vector<uint32_t> bucket(n + 1);
    each_half([&](uint32_t low, const Found &) { ++bucket[low + 1]; });
    for (size_t v = 0; v < n; ++v) bucket[v + 1] += bucket[v];
    std::vector<Found> all(n ? bucket[n] : 0);
    std::vector<uint32_t> next(bucket.begin(), bucket.end());
    each_half([&](uint32_t low, const Found &found) { all[next[low]++] = found; });
    halves_.clear(), split_.clear(), begin_.assign(1, 0);
    halves_.reserve(all.size());
    for (size_t v = 0; v < n; ++v) {
        std::stable_sort(all.begin() + bucket[v], all.begin() + bucket[v + 1],
                         [](const Found &a, const Found &b) { return a.high < b.high; });
        for (uint32_t i = bucket[v]; i < bucket[v + 1]; ++i) {
            const HalfEdge &half = all[i].half;
            if (i > bucket[v] && all[i].high == all[i - 1].high) {
                const HalfEdge &before = halves_[begin_[begin_.size() - 2]];
                split_.back() |= half.v0 != before.v0 || half.v1 != before.v1 || half.shape != before.shape;
                ++begin_.back();
            } else {
                begin_.push_back(begin_.back() + 1), split_.push_back(0);
            }
            halves_.push_back(half);
        }
    }
    curves_.clear();
    for (int32_t s = 0; s < scene.n_shapes; ++s) {
        const int32_t flags = scene.shapes[s].flags;
        if (flags & IsSphere) curves_.push_back({s, OutlineCurve::Contour});
        if (flags & IsDisk) curves_.push_back({s, OutlineCurve::Rim});
        for (int32_t k = OutlineCurve::LowerRim; k <= OutlineCurve::RightLine && (flags & IsCylinder); ++k)
            curves_.push_back({s, k});
    }
    found_ = true;
}

template <class S>
bool OutlineSet::holds(const SceneView<S> &scene) const {
    for (size_t i = 0; i < copies_.size(); i += 2) {
        const S *a = scene.vertices + VertexRow<S>::Size * size_t(copies_[i]),
                *b = scene.vertices + VertexRow<S>::Size * size_t(copies_[i + 1]);
        if (!std::equal(a, a + 3, b)) return false;
    }
    return std::none_of(flat_.begin(), flat_.end(),
                        [&](uint32_t face) { return has_area(scene, scene.faces + 3 * size_t(face)); });
}

template <class S>
void OutlineSet::update(const SceneView<S> &scene, const uint8_t *moves, int threads) {
    if (!found_ || !holds(scene)) find(scene);
    // Of where things are now, so that what a call finds does not depend on earlier ones.
    std::vector<Extent> things(size());
    for_ranges(size(), threads, [&](size_t begin, size_t end, int) {
        for (size_t i = begin; i < end; ++i) {
            if (is_edge(i)) {
                const V a = place_of(scene, halves(i)->v0), b = place_of(scene, halves(i)->v1), p = (a + b) * 0.5f;
                things[i] = {{p.x, p.y, p.z}, norm(b - a)};
            } else {
                const OutlineElement e = curve_element(scene, i);
                things[i] = {{e.a.x, e.a.y, e.a.z}, 2 * e.b.x};
            }
        }
    });
    const std::vector<int32_t> order = morton_order(things.data(), size(), threads);
    tree_.resize(size());
    for_ranges(size(), threads, [&](size_t begin, size_t end, int) {
        for (size_t k = begin; k < end; ++k) {
            const size_t i = size_t(order[k]);
            bool any = false;
            if (is_edge(i))
                for (size_t h = 0; h < count(i); ++h) any |= moves[halves(i)[h].shape] != 0;
            else
                any = moves[curve(i).shape] != 0;
            OutlineElement e = element(scene, i);
            e.moves = any;
            e.index = int32_t(i);
            tree_.set(k, e);
        }
    });
    tree_.build(threads);
}

template <class S>
OutlineElement OutlineSet::edge_element(const SceneView<S> &scene, size_t edge) const {
    const HalfEdge *h = halves(edge);
    const size_t n = count(edge);
    const V a = place_of(scene, h->v0), b = place_of(scene, h->v1);
    const V n0 = face_normal(scene, h[0]), n1 = n > 1 ? face_normal(scene, h[1]) : n0;
    const bool flat = !(scene.shapes[h->shape].flags & HasNormals), split = is_split(edge);
    float bend = std::max(0.f, 1 - dot(n0, n1));
    OutlineElement e{};
    e.a = a, e.b = b, e.n0 = n0, e.n1 = n1;
    e.weight = bend > 1e-7f || split || n != 2 ? 1.f : 0.f;
    if (n == 2 && dot(n0, place_of(scene, h[1].third) - a) > 0) e.weight *= Hollow;
    e.bend = split ? std::max(bend, 0.05f) : bend;
    e.kind = n != 2 ? OutlineElement::Always : split || flat ? OutlineElement::Crease : OutlineElement::Edge;
    e.shape = -2;
    return e;
}

template <class S>
OutlineElement OutlineSet::curve_element(const SceneView<S> &scene, size_t element) const {
    const OutlineCurve &c = curve(element);
    const S *m = scene.shape_matrices + 24 * size_t(c.shape);
    auto column = [&](size_t i) { return V{float(m[i]), float(m[4 + i]), float(m[8 + i])}; };
    const V x = column(0), y = column(1), z = column(2), place = column(3);
    const float across = std::max(norm(x), norm(y));
    const bool line = c.kind >= OutlineCurve::LeftLine;
    OutlineElement e{};
    e.kind = OutlineElement::Round, e.shape = c.shape, e.bend = 1, e.weight = line ? 0.3f : 1.f;
    e.a = c.kind == OutlineCurve::UpperRim ? place + z : line ? place + z * 0.5f : place;
    // a line is somewhere on the cylinder, around its axis
    e.b.x = c.kind == OutlineCurve::Contour ? stretch(x, y, z) : line ? across + 0.5f * norm(z) : across;
    return e;
}

template void OutlineSet::update(const SceneView<float> &, const uint8_t *, int);
template void OutlineSet::update(const SceneView<double> &, const uint8_t *, int);

}  // namespace tr
