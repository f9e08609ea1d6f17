#include "outline_set.h"

#include <algorithm>
#include <cmath>

#include "parallel.h"

namespace tr {

namespace {

constexpr float Still = 0.1f;   // weight of outlines that rest: they count where what sees them moves
constexpr float Hollow = 0.1f;  // ... of edges that can be seen from behind only

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

// The largest factor by which the matrix of these columns stretches, by the power method.
float stretch(const V &x, const V &y, const V &z) {
    V v{0.6f, 0.5f, 0.7f};
    for (int i = 0; i < 32; ++i) {
        const V w = x * v.x + y * v.y + z * v.z, next{dot(x, w), dot(y, w), dot(z, w)};
        v = next * (1 / std::max(norm(next), 1e-30f));
    }
    return norm(x * v.x + y * v.y + z * v.z);
}

}  // namespace

OutlineSet::OutlineSet(std::vector<HalfEdge> halves, std::vector<uint32_t> begin, std::vector<OutlineCurve> curves,
                       std::vector<int64_t> first_vertex, std::vector<uint32_t> copies)
    : halves_(std::move(halves)),
      begin_(std::move(begin)),
      curves_(std::move(curves)),
      first_vertex_(std::move(first_vertex)),
      copies_(std::move(copies)),
      split_(n_edges()),
      moves_(size()) {
    for (size_t e = 0; e < n_edges(); ++e) {
        const HalfEdge &first = *this->halves(e);
        for (size_t k = 1; k < count(e); ++k) {
            const HalfEdge &other = this->halves(e)[k];
            split_[e] |= other.v0 != first.v0 || other.v1 != first.v1 || other.shape != first.shape;
        }
    }
}

// The scene's list of vertices has those of curves, too.
template <class S>
void OutlineSet::place(const SceneView<S> &scene) {
    auto shift = [&](uint32_t shape) { return uint32_t(scene.shapes[shape].first_vertex - first_vertex_[shape]); };
    for (HalfEdge &h : halves_) {
        const uint32_t by = shift(h.shape);
        h.v0 += by, h.v1 += by, h.third += by;
    }
    for (size_t i = 0; i < copies_.size(); i += 4)
        copies_[i] += shift(copies_[i + 2]), copies_[i + 1] += shift(copies_[i + 3]);
    placed_ = true;
}

template <class S>
bool OutlineSet::update(const SceneView<S> &scene, const uint8_t *moves, int threads) {
    if (!placed_) place(scene);
    for (size_t i = 0; i < copies_.size(); i += 4) {
        const S *a = scene.vertices + VertexRow<S>::Size * size_t(copies_[i]),
                *b = scene.vertices + VertexRow<S>::Size * size_t(copies_[i + 1]);
        if (!std::equal(a, a + 3, b)) return false;
    }
    if (order_.empty() && size() > 0) {
        std::vector<float> places(3 * size());
        for (size_t i = 0; i < size(); ++i) {
            const OutlineElement e = is_edge(i) ? edge_element(scene, i) : curve_element(scene, i);
            const V p = is_edge(i) ? (e.a + e.b) * 0.5f : e.a;
            places[3 * i] = p.x, places[3 * i + 1] = p.y, places[3 * i + 2] = p.z;
        }
        order_ = morton_order(places.data(), size());
    }
    tree_.resize(size());
    for_ranges(size(), threads, [&](size_t begin, size_t end, int) {
        for (size_t k = begin; k < end; ++k) {
            const size_t i = size_t(order_[k]);
            bool any = false;
            if (is_edge(i))
                for (size_t h = 0; h < count(i); ++h) any |= moves[halves(i)[h].shape] != 0;
            else
                any = moves[curve(i).shape] != 0;
            moves_[i] = any;
            OutlineElement e = is_edge(i) ? edge_element(scene, i) : curve_element(scene, i);
            e.weight *= any ? 1.f : Still;
            e.index = int32_t(i);
            tree_.set(k, e);
        }
    });
    tree_.build(threads);
    return true;
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

template bool OutlineSet::update(const SceneView<float> &, const uint8_t *, int);
template bool OutlineSet::update(const SceneView<double> &, const uint8_t *, int);

}  // namespace tr
