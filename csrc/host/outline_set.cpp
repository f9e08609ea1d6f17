#include "outline_set.h"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "core/math/rows.h"
#include "parallel.h"

namespace tr {

namespace {

constexpr float Hollow = 0.1f;  // weight of edges that can be seen from behind only
// Scenes of more edges than this have them rounded, sixteen that follow each other in a leaf if they are close: if the
// box around these has a diagonal of less than `Close` edges.
constexpr size_t ManyEdges = size_t(1) << 16;
constexpr double Close = 16;

using V = Vec3<float>;

template <class S>
V place_of(const SceneView<S> &scene, uint32_t vertex) {
    const S *p = scene.vertices + VertexRow<S>::Size * size_t(vertex);
    return {float(p[0]), float(p[1]), float(p[2])};
}

constexpr size_t FewLeaves = 256;  // for a thread

std::atomic<uint64_t> latest_revision{0};

// Of a curve.
Extent extent_of(const OutlineElement &e) { return {{e.a.x, e.a.y, e.a.z}, 2 * e.b.x}; }

// Of control values of a spline, and of the corners of patches: neither is steeper than lines between them.
template <class S>
HeightBounds bounds_of(const SceneView<S> &scene, const ShapeInfo &info, int threads) {
    const TensorView<S> &heights = scene.values.tensors[info.heights];
    const size_t rows = size_t(heights.shape[0]), columns = size_t(heights.shape[2]);
    std::vector<HeightBounds> parts(size_t(std::max(1, threads)), HeightBounds{0, 0, INFINITY, -INFINITY});
    auto scan = [&](size_t begin, size_t end, int part) {
        HeightBounds b{0, 0, INFINITY, -INFINITY};
        for (size_t y = begin; y < end; ++y) {
            const S *row = heights.data + y * columns, *next = row + (y + 1 < rows ? columns : 0);
            for (size_t x = 0; x < columns; ++x) {
                const float h = float(row[x]);
                b.low = std::min(b.low, h), b.high = std::max(b.high, h);
                b.slope_y = std::max(b.slope_y, std::fabs(float(next[x]) - h));
            }
            for (size_t x = 1; x < columns; ++x)
                b.slope_x = std::max(b.slope_x, std::fabs(float(row[x]) - float(row[x - 1])));
        }
        parts[size_t(part)] = b;
    };
    constexpr size_t few = 64;
    for_ranges(rows, threads, scan, few);
    HeightBounds r = parts[0];
    for (const HeightBounds &b : parts) {
        r.slope_x = std::max(r.slope_x, b.slope_x), r.slope_y = std::max(r.slope_y, b.slope_y);
        r.low = std::min(r.low, b.low), r.high = std::max(r.high, b.high);
    }
    constexpr float rounding = 1 + 1e-5f;
    r.slope_x *= rounding * float(columns) / 2, r.slope_y *= rounding * float(rows) / 2;
    return r;
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

template <class S>
bool OutlineSet::update(const SceneView<S> &scene, const uint8_t *moves, uint64_t version, int threads,
                        const std::function<bool()> &interrupted) {
    const std::vector<uint8_t> moving(moves, moves + scene.n_shapes);
    if (found_ && version == version_ && moving == moves_) return true;
    version_ = 0;  // until the end is reached
    moves_ = moving;
    if (!found_ || !holds(scene)) {
        found_ = false;
        if (!find(scene, threads, interrupted)) return false;
    }
    for (OutlineCurve &curve : curves_)
        if (curve.of_field()) curve.bounds = bounds_of(scene, scene.shapes[curve.shape], threads);
    // Of where things are now, so that what a call finds does not depend on earlier ones.
    if (n_edges() > ManyEdges)
        plant_many(scene, threads);
    else
        plant(scene, threads);
    tree_.build(threads);
    refresh_table();
    version_ = version, revision_ = ++latest_revision;
    return true;
}

void OutlineSet::refresh_table() {
    table_ = {corners_.data(),
              begin_.data(),
              around_.data(),
              meshes_.data(),
              curves_.data(),
              moves_.data(),
              uint32_t(begin_.size() - 1),
              uint32_t(meshes_.size()),
              uint32_t(curves_.size()),
              tree_.view()};
}

// Every element by itself.
template <class S>
void OutlineSet::plant(const SceneView<S> &scene, int threads) {
    auto place = [&](uint32_t vertex) { return place_of(scene, vertex & ~Flag); };
    std::vector<Extent> things(size());
    for_ranges(size(), threads, [&](size_t begin, size_t end, int) {
        for (size_t i = begin; i < end; ++i) {
            if (table_.is_edge(i)) {
                const V a = place(around_[i].all[0]), b = place(around_[i].all[1]), p = (a + b) * 0.5f;
                things[i] = {{p.x, p.y, p.z}, norm(b - a)};
            } else {
                things[i] = extent_of(curve_element(scene, i));
            }
        }
    });
    const std::vector<int32_t> order = morton_order(things.data(), size(), threads);
    tree_.resize(size(), 0);
    for_ranges(
        tree_.n_leaves(), threads,
        [&](size_t begin, size_t end, int) {
            OutlineLeaf elements_of_leaf;
            for (size_t leaf = begin; leaf < end; ++leaf) {
                uint32_t edges[OutlineTree::Wide], curves[OutlineTree::Wide];
                size_t n = 0, n_curves = 0;
                for (size_t k = leaf * OutlineTree::Wide; n + n_curves < OutlineTree::Wide && k < size(); ++k) {
                    const uint32_t i = uint32_t(order[k]);
                    (table_.is_edge(i) ? edges[n++] : curves[n_curves++]) = i;
                }
                put_edges(scene, edges, n, elements_of_leaf);
                for (size_t k = 0; k < n_curves; ++k)
                    set_element(elements_of_leaf, n + k, curve_element(scene, curves[k]));
                tree_.set(leaf, elements_of_leaf);
            }
        },
        FewLeaves);
}

// Around edges from `begin` to `end`, roughly: around some of them.
template <class S>
Extent OutlineSet::extent_of_edges(const SceneView<S> &scene, size_t begin, size_t end) const {
    V low{INFINITY, INFINITY, INFINITY}, high = -low;
    for (size_t i = begin; i < end; i += 5)
        for (size_t k = 0; k < 2; ++k) {
            const V p = place_of(scene, around_[i].all[k] & ~Flag);
            low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
            high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
        }
    const V middle = (low + high) * 0.5f;
    return {{middle.x, middle.y, middle.z}, norm(high - low)};
}

// Whether edges that follow each other are close, by some of them.
template <class S>
bool OutlineSet::are_in_order(const SceneView<S> &scene) const {
    constexpr size_t Wide = OutlineTree::Wide, apart = 64 * Wide;
    double together = 0, alone = 0;
    for (size_t i = 0; i + Wide <= n_edges(); i += apart) {
        together += double(extent_of_edges(scene, i, i + Wide).size) * Wide;
        for (size_t k = i; k < i + Wide; ++k) alone += double(extent_of_edges(scene, k, k + 1).size);
    }
    return together < Close * alone;
}

// Curves by themselves; then edges, of which those that follow each other share leaves if they are close.
template <class S>
void OutlineSet::plant_many(const SceneView<S> &scene, int threads) {
    constexpr size_t Wide = OutlineTree::Wide;
    const size_t together = are_in_order(scene) ? Wide : 1, n = (n_edges() + together - 1) / together;
    std::vector<Extent> things(std::max(n, curves_.size()));
    for (size_t i = 0; i < curves_.size(); ++i) things[i] = extent_of(curve_element(scene, n_edges() + i));
    tree_.resize(curves_.size(), n_edges());
    OutlineElement elements[Wide];
    const std::vector<int32_t> curves = morton_order(things.data(), curves_.size(), threads);
    const size_t first = (curves.size() + Wide - 1) / Wide;
    for (size_t leaf = 0, k = 0; leaf < first; ++leaf) {
        size_t count = 0;
        for (; count < Wide && k < curves.size(); ++k)
            elements[count++] = curve_element(scene, n_edges() + size_t(curves[k]));
        tree_.set(leaf, elements, count);
    }
    for_ranges(n, threads, [&](size_t begin, size_t end, int) {
        for (size_t i = begin; i < end; ++i)
            things[i] = extent_of_edges(scene, i * together, std::min((i + 1) * together, n_edges()));
    });
    const std::vector<int32_t> order = morton_order(things.data(), n, threads);
    std::vector<Extent>().swap(things);
    auto edges_of = [&](size_t leaf, uint32_t (&to)[Wide]) {
        size_t count = 0;
        const size_t each = Wide / together;
        for (size_t i = leaf * each; i < std::min((leaf + 1) * each, n); ++i)
            for (size_t k = 0, e = size_t(order[i]) * together; k < together && e < n_edges(); ++k)
                to[count++] = uint32_t(e++);
        return count;
    };
    for_ranges(
        tree_.n_leaves() - first, threads,
        [&](size_t begin, size_t end, int) {
            OutlineLeaf elements_of_leaf;
            uint32_t edges[Wide];
            for (size_t leaf = begin; leaf < end; ++leaf) {
                // what the next ones are made of is on its way meanwhile
                for (size_t k = 0, count = edges_of(std::min(leaf + 2, end - 1), edges); k < count; k += 4)
                    __builtin_prefetch(&around_[edges[k]]);
                for (size_t k = 0, count = edges_of(std::min(leaf + 1, end - 1), edges); k < count; ++k)
                    for (size_t i = 0; i < 2; ++i)  // other corners are mostly ends of other edges
                        __builtin_prefetch(scene.vertices +
                                           VertexRow<S>::Size * size_t(around_[edges[k]].all[i] & ~Flag));
                const size_t count = edges_of(leaf, edges);
                put_edges(scene, edges, count, elements_of_leaf);
                tree_.set(first + leaf, elements_of_leaf);
            }
        },
        FewLeaves);
}

template <class S>
void OutlineSet::put_edges(const SceneView<S> &scene, const uint32_t *edges, size_t n, OutlineLeaf &to) const {
    using F = PacketOf<float>;
    using U = UIntOf<F>;
    using M = MaskOf<F>;
    constexpr size_t Wide = OutlineWide;
    alignas(64) uint32_t all[Wide];
    alignas(64) float moves[Wide] = {}, flat[Wide] = {};
    if (n < Wide) {
        to = {};
        std::fill_n(all, Wide, 0u), std::fill_n(to.index, Wide, -1);
    }
    std::fill_n(to.shape, Wide, -2);
    if (n == 0) return;
    std::copy_n(edges, n, all), std::copy_n(edges, n, to.index);
    auto is_flat = [&](uint32_t shape) { return (scene.shapes[shape].flags & HasNormals) == 0; };
    if (meshes_.size() == 1) {
        const uint32_t shape = meshes_[0].shape;
        std::fill_n(moves, Wide, float(moves_[shape] != 0)), std::fill_n(flat, Wide, float(is_flat(shape)));
    }
    for (size_t k = 0; k < n && meshes_.size() > 1; ++k) {
        const uint32_t shape = table_.shape_of(table_.half(scene, edges[k], 0));
        bool moving = moves_[shape] != 0;
        for (size_t i = 1, faces = table_.is_split(edges[k]) ? table_.count(edges[k]) : 0; i < faces; ++i)
            moving |= moves_[table_.shape_of(table_.half(scene, edges[k], i))] != 0;
        moves[k] = moving, flat[k] = is_flat(shape);
    }
    for (size_t i = 0; i < Wide; i += size_t(Lanes<F>::Width)) {
        const M some = mask<F>(lane_index<F>() + U(uint32_t(i)) < U(uint32_t(n)));
        U vertices[4];
        gather_rows<F>(around_[0].all, load_uint<F>(&all[i]) * 4u, some, vertices);
        M flags[4];
        Vec3<F> p[4];
        for (size_t c = 0; c < 4; ++c) {
            flags[c] = some && mask<F>((vertices[c] & U(Flag)) != U(0u));
            F row[4];  // one load; the last is not used
            gather_rows<F>(scene.vertices, (vertices[c] & U(~Flag)) * VertexRow<S>::Size, some, row);
            p[c] = {row[0], row[1], row[2]};
        }
        const M alone = flags[0], apart = flags[1];
        const Vec3<F> a = p[0], along = p[1] - a;
        auto normal = [&](size_t face) {
            const Vec3<F> v = cross(along, p[2 + face] - a);
            return v * (select(flags[2 + face], F(-1), F(1)) / max(sqrt(squared_norm(v)), F(1e-30f)));
        };
        const Vec3<F> n0 = normal(0), n1 = normal(1);
        const F bend = max(F(0), F(1) - dot(n0, n1));
        const M counts = mask<F>(bend > F(1e-7f)) || apart || alone;
        const M hollow = !alone && mask<F>(dot(n0, p[3] - a) > F(0));
        const F weight = select(counts, select(hollow, F(Hollow), F(1)), F(0));
        store_vector(a, to.a, i), store_vector(p[1], to.b, i), store_vector(n0, to.n0, i), store_vector(n1, to.n1, i);
        store(&to.weight[i], select(some && mask<F>(load<F>(&moves[i]) > F(0)), weight, select(some, -weight, F(0))));
        store(&to.bend[i], select(apart, max(bend, F(0.05f)), bend));
        auto kind = [](OutlineElement::Kind x) { return F(float(x)); };
        const M crease = apart || mask<F>(load<F>(&flat[i]) > F(0));
        const F kinds = select(alone, kind(OutlineElement::Always),
                               select(crease, kind(OutlineElement::Crease), kind(OutlineElement::Edge)));
        store(&to.kind[i], convert<IntOf<F>>(kinds));
    }
}

template <class S>
OutlineElement OutlineSet::edge_element(const SceneView<S> &scene, size_t edge) const {
    OutlineLeaf one;
    const uint32_t number = uint32_t(edge);
    put_edges(scene, &number, 1, one);
    return element_of(one, 0);
}

template <class S>
OutlineElement OutlineSet::curve_element(const SceneView<S> &scene, size_t element) const {
    const OutlineCurve &c = table_.curve(element);
    const S *m = scene.shape_matrices + 24 * size_t(c.shape);
    auto column = [&](size_t i) { return V{float(m[i]), float(m[4 + i]), float(m[8 + i])}; };
    const V x = column(0), y = column(1), z = column(2), place = column(3);
    const float across = std::max(norm(x), norm(y));
    if (c.of_field()) {
        // a ball around all of it, whose points may see its outlines
        const float low = c.bounds.low, high = c.bounds.high;
        OutlineElement e{};
        e.kind = OutlineElement::Round, e.shape = -2, e.index = int32_t(element),
        e.moves = moves_[size_t(c.shape)] != 0;
        e.bend = 1, e.weight = c.kind == OutlineCurve::FieldBorder ? 0.5f : 1.f;
        e.a = place + z * ((low + high) / 2);
        e.b.x = norm(x) + norm(y) + norm(z) * (high - low) / 2;
        return e;
    }
    const bool line = c.kind >= OutlineCurve::LeftLine;
    OutlineElement e{};
    e.kind = OutlineElement::Round, e.shape = c.shape, e.index = int32_t(element),
    e.moves = moves_[size_t(c.shape)] != 0;
    e.bend = 1, e.weight = line ? 0.3f : 1.f;
    e.a = c.kind == OutlineCurve::UpperRim ? place + z : line ? place + z * 0.5f : place;
    // a line is somewhere on the cylinder, around its axis
    e.b.x = c.kind == OutlineCurve::Contour ? stretch(x, y, z) : line ? across + 0.5f * norm(z) : across;
    return e;
}

#define TR_INSTANTIATE(S)                                                                  \
    template bool OutlineSet::update(const SceneView<S> &, const uint8_t *, uint64_t, int, \
                                     const std::function<bool()> &);                       \
    template OutlineElement OutlineSet::edge_element(const SceneView<S> &, size_t) const;  \
    template OutlineElement OutlineSet::curve_element(const SceneView<S> &, size_t) const;
TR_INSTANTIATE(float)
TR_INSTANTIATE(double)
#undef TR_INSTANTIATE

}  // namespace tr
