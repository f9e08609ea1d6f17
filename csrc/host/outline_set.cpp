#include "outline_set.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>

#include "morton_order.h"
#include "parallel.h"

namespace tr {

namespace {

constexpr float Hollow = 0.1f;  // weight of edges that can be seen from behind only
// Scenes of more edges than this have them rounded, in the order of their vertices, of which there are fewer.
constexpr size_t ManyEdges = size_t(1) << 16;

using V = Vec3<float>;

template <class S>
V place_of(const SceneView<S> &scene, uint32_t vertex) {
    const S *p = scene.vertices + VertexRow<S>::Size * size_t(vertex);
    return {float(p[0]), float(p[1]), float(p[2])};
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

constexpr size_t FewLeaves = 256;  // for a thread

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

// For each vertex of meshes, those of which are `known`, the first one that is in the same place.
template <class S>
std::vector<uint32_t> weld(const SceneView<S> &scene, const std::vector<uint8_t> &known) {
    constexpr uint32_t empty = 0xFFFFFFFFu;
    size_t size = 16;
    while (size < 2 * known.size()) size *= 2;
    std::vector<uint32_t> table(size, empty), first(known.size(), empty);
    for (uint32_t v = 0; v < known.size(); ++v) {
        if (!known[v]) continue;
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

// In order, and those that are equal in theirs. Few are sorted where they are.
template <class It, class Less>
void sort_few(It begin, It end, Less &&less) {
    if (end - begin > 32) return std::stable_sort(begin, end, less);
    for (It i = begin; i != end; ++i)
        for (It k = i; k != begin && less(*k, *(k - 1)); --k) std::swap(*k, *(k - 1));
}

}  // namespace

// Half edges go by the smaller of their welded ends, and there by the larger one.
template <class S>
bool OutlineSet::find(const SceneView<S> &scene, const std::function<bool()> &interrupted) {
    constexpr size_t patience = size_t(1) << 18;  // a few milliseconds
    size_t work = 0;
    auto stop = [&] { return interrupted && ++work % patience == 0 && interrupted(); };
    meshes_.clear();
    size_t n_faces = 0;
    for (int32_t s = 0; s < scene.n_shapes; ++s) {
        const ShapeInfo &info = scene.shapes[s];
        if ((info.flags & IsCurved) || info.n_faces == 0) continue;
        meshes_.push_back({uint32_t(info.face_offset), uint32_t(s)});
        n_faces = std::max(n_faces, size_t(info.face_offset) + size_t(info.n_faces));
    }
    std::sort(meshes_.begin(), meshes_.end(), [](const Mesh &a, const Mesh &b) { return a.face < b.face; });
    if (3 * n_faces >= Flag) throw std::length_error("outlines: more than 715 million triangles");
    // Calls visit(face, its indices); false if it was interrupted.
    auto each_face = [&](auto &&visit) {
        for (int32_t s = 0; s < scene.n_shapes; ++s) {
            const ShapeInfo &info = scene.shapes[s];
            if (info.flags & IsCurved) continue;
            for (uint32_t f = uint32_t(info.face_offset), end = f + uint32_t(info.n_faces); f < end; ++f) {
                if (stop()) return false;
                visit(f, scene.faces + 3 * size_t(f));
            }
        }
        return true;
    };
    std::vector<uint8_t> known, flat(n_faces);
    flat_.clear();
    bool whole = each_face([&](uint32_t f, const uint32_t *face) {
        if (!has_area(scene, face)) flat_.push_back(f), flat[f] = 1;
        for (size_t k = 0; k < 3; ++k) {
            if (face[k] >= known.size()) known.resize(size_t(face[k]) + 1 + known.size() / 2);
            known[face[k]] = 1;
        }
    });
    if (!whole) return false;
    size_t n = known.size();
    while (n > 0 && !known[n - 1]) --n;
    known.resize(n);
    const std::vector<uint32_t> first = weld(scene, known);
    if (interrupted && interrupted()) return false;
    copies_.clear();
    for (uint32_t v = 0; v < n; ++v)
        if (known[v] && first[v] != v) copies_.push_back(v), copies_.push_back(first[v]);
    // faces without an area have no part in it
    struct Found {
        uint32_t high, corner;
    };
    auto each_half = [&](auto &&visit) {
        return each_face([&](uint32_t f, const uint32_t *face) {
            for (uint32_t k = 0; k < 3 && !flat[f]; ++k) {
                const uint32_t from = first[face[k]], to = first[face[(k + 1) % 3]];
                visit(std::min(from, to), Found{std::max(from, to), (3 * f + k) | (from > to ? Flag : 0)});
            }
        });
    };
    std::vector<uint32_t> bucket(n + 1);
    if (!each_half([&](uint32_t low, const Found &) { ++bucket[low + 1]; })) return false;
    for (size_t v = 0; v < n; ++v) bucket[v + 1] += bucket[v];
    std::vector<Found> all(n ? bucket[n] : 0);
    if (!each_half([&](uint32_t low, const Found &found) { all[bucket[low]++] = found; })) return false;
    corners_.clear(), begin_.clear(), groups_.clear();
    corners_.reserve(all.size());
    for (size_t v = 0, i = 0; v < n; ++v) {
        if (stop()) return false;
        auto begin = all.begin() + ptrdiff_t(i), end = all.begin() + bucket[v];  // now where the next one's begin
        sort_few(begin, end, [](const Found &a, const Found &b) { return a.high < b.high; });
        if (begin != end) groups_.push_back(uint32_t(begin_.size()));
        HalfEdge before{};
        for (; i < bucket[v]; ++i) {
            corners_.push_back(all[i].corner);
            const HalfEdge half = half_of(scene, all[i].corner);
            if (all.begin() + ptrdiff_t(i) == begin || all[i].high != all[i - 1].high)
                begin_.push_back(uint32_t(i)), before = half;
            else if (half.v0 != before.v0 || half.v1 != before.v1 || shape_of(half) != shape_of(before))
                begin_.back() |= Flag;
        }
    }
    begin_.push_back(uint32_t(corners_.size()));
    groups_.push_back(uint32_t(n_edges()));
    if (n_edges() <= ManyEdges) groups_.clear();
    groups_.shrink_to_fit(), begin_.shrink_to_fit();
    curves_.clear();
    for (int32_t s = 0; s < scene.n_shapes; ++s) {
        const int32_t flags = scene.shapes[s].flags;
        if (flags & IsHeightField) {
            for (int32_t kind : {OutlineCurve::FieldContour, OutlineCurve::FieldBorder}) curves_.push_back({s, kind});
            if (scene.shapes[s].interpolation != 0) curves_.push_back({s, OutlineCurve::FieldCreases});
        }
        if (flags & IsSphere) curves_.push_back({s, OutlineCurve::Contour});
        if (flags & IsDisk) curves_.push_back({s, OutlineCurve::Rim});
        for (int32_t k = OutlineCurve::LowerRim; k <= OutlineCurve::RightLine && (flags & IsCylinder); ++k)
            curves_.push_back({s, k});
    }
    return found_ = true;
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
bool OutlineSet::update(const SceneView<S> &scene, const uint8_t *moves, uint64_t version, int threads,
                        const std::function<bool()> &interrupted) {
    const std::vector<uint8_t> moving(moves, moves + scene.n_shapes);
    if (found_ && version == version_ && moving == moves_) return true;
    version_ = 0;  // until the end is reached
    moves_ = moving;
    if (!found_ || !holds(scene)) {
        found_ = false;
        if (!find(scene, interrupted)) return false;
    }
    for (OutlineCurve &curve : curves_)
        if (curve.of_field()) curve.bounds = bounds_of(scene, scene.shapes[curve.shape], threads);
    // Of where things are now, so that what a call finds does not depend on earlier ones.
    if (groups_.empty())
        plant(scene, threads);
    else
        plant_groups(scene, threads);
    tree_.build(threads);
    version_ = version;
    return true;
}

// Every element by itself.
template <class S>
void OutlineSet::plant(const SceneView<S> &scene, int threads) {
    std::vector<Extent> things(size());
    for_ranges(size(), threads, [&](size_t begin, size_t end, int) {
        for (size_t i = begin; i < end; ++i) {
            if (is_edge(i)) {
                const HalfEdge h = half(scene, i, 0);
                const V a = place_of(scene, h.v0), b = place_of(scene, h.v1), p = (a + b) * 0.5f;
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
            OutlineLeaves::Elements elements_of_leaf;
            for (size_t leaf = begin; leaf < end; ++leaf) {
                size_t edges[OutlineTree::Wide], curves[OutlineTree::Wide], n = 0, n_curves = 0;
                for (size_t k = leaf * OutlineTree::Wide; n + n_curves < OutlineTree::Wide && k < size(); ++k) {
                    const size_t i = size_t(order[k]);
                    (is_edge(i) ? edges[n++] : curves[n_curves++]) = i;
                }
                put_edges(scene, edges, n, elements_of_leaf);
                for (size_t k = 0; k < n_curves; ++k) elements_of_leaf.set(n + k, curve_element(scene, curves[k]));
                tree_.set(leaf, elements_of_leaf);
            }
        },
        FewLeaves);
}

// Curves by themselves; then edges by their smaller ends, a third as many as there are edges: those of one, about
// half of all around it, are next to each other whatever is done.
template <class S>
void OutlineSet::plant_groups(const SceneView<S> &scene, int threads) {
    const size_t n = groups_.size() - 1;
    std::vector<Extent> things(std::max(n, curves_.size()));
    for (size_t i = 0; i < curves_.size(); ++i) things[i] = extent_of(curve_element(scene, n_edges() + i));
    tree_.resize(curves_.size(), n_edges());
    OutlineElement elements[OutlineTree::Wide];
    const std::vector<int32_t> curves = morton_order(things.data(), curves_.size(), threads);
    const size_t first = (curves.size() + OutlineTree::Wide - 1) / OutlineTree::Wide;
    for (size_t leaf = 0, k = 0; leaf < first; ++leaf) {
        size_t count = 0;
        for (; count < OutlineTree::Wide && k < curves.size(); ++k)
            elements[count++] = curve_element(scene, n_edges() + size_t(curves[k]));
        tree_.set(leaf, elements, count);
    }
    for_ranges(n, threads, [&](size_t begin, size_t end, int) {
        for (size_t i = begin; i < end; ++i) {
            const HalfEdge first = half(scene, groups_[i], 0);  // about as long as the others
            const V a = place_of(scene, first.v0);
            things[i] = {{a.x, a.y, a.z}, norm(place_of(scene, first.v1) - a)};
        }
    });
    const std::vector<int32_t> order = morton_order(things.data(), n, threads);
    std::vector<Extent>().swap(things);
    std::vector<uint32_t> ends(n);  // of the edges of the first groups
    for (size_t i = 0, sum = 0; i < n; ++i) {
        const size_t group = size_t(order[i]);
        ends[i] = uint32_t(sum += groups_[group + 1] - groups_[group]);
    }
    for_ranges(
        tree_.n_leaves() - first, threads,
        [&](size_t begin, size_t end, int) {
            OutlineLeaves::Elements elements_of_leaf;
            size_t edges[OutlineTree::Wide];
            const size_t before = begin * OutlineTree::Wide;
            size_t i = size_t(std::upper_bound(ends.begin(), ends.end(), before) - ends.begin());
            size_t e = i < n ? groups_[size_t(order[i]) + 1] - (ends[i] - before) : 0;
            for (size_t leaf = begin; leaf < end; ++leaf) {
                size_t count = 0;
                while (count < OutlineTree::Wide && i < n) {
                    edges[count++] = e;
                    if (++e < groups_[size_t(order[i]) + 1]) continue;
                    if (++i < n) e = groups_[size_t(order[i])];
                }
                put_edges(scene, edges, count, elements_of_leaf);
                tree_.set(first + leaf, elements_of_leaf);
            }
        },
        FewLeaves);
}

template <class S>
void OutlineSet::put_edges(const SceneView<S> &scene, const size_t *edges, size_t n,
                           OutlineLeaves::Elements &to) const {
    using F = PacketOf<float>;
    constexpr size_t Wide = OutlineLeaves::Wide;
    // of both faces: the third corner, 1 or, of one that is turned, -1; and what is more than two of these or less
    alignas(64) float third[2][3][Wide] = {}, sign[2][Wide] = {}, odd[Wide] = {}, split[Wide] = {}, moving[Wide] = {};
    to = {};
    std::fill_n(to.index, Wide, -1);
    std::fill_n(to.shape, Wide, -2);
    for (size_t k = 0; k < n; ++k) {
        const size_t edge = edges[k], faces = count(edge);
        const HalfEdge h[2] = {half(scene, edge, 0), half(scene, edge, faces > 1 ? 1 : 0)};
        put_lane(place_of(scene, h[0].v0), to.a, k), put_lane(place_of(scene, h[0].v1), to.b, k);
        for (size_t i = 0; i < 2; ++i)
            put_lane(place_of(scene, h[i].third), third[i], k), sign[i][k] = h[i].turned ? -1.f : 1.f;
        const uint32_t shape = shape_of(h[0]);
        const bool flat = !(scene.shapes[shape].flags & HasNormals), apart = is_split(edge);
        odd[k] = faces != 2, split[k] = apart;
        bool moves = moves_[shape] != 0;
        for (size_t i = 1; i < faces && apart; ++i) moves |= moves_[shape_of(half(scene, edge, i))] != 0;
        moving[k] = moves ? 1.f : -1.f;
        to.kind[k] = faces != 2      ? OutlineElement::Always
                     : apart || flat ? OutlineElement::Crease
                                     : OutlineElement::Edge;
        to.index[k] = int32_t(edge);
    }
    for (size_t i = 0; i < Wide; i += size_t(Lanes<F>::Width)) {
        const Vec3<F> a = load_vector<F>(to.a, i), along = load_vector<F>(to.b, i) - a;
        auto normal = [&](size_t face) {
            const Vec3<F> v = cross(along, load_vector<F>(third[face], i) - a);
            return v * (load<F>(&sign[face][i]) / max(sqrt(squared_norm(v)), F(1e-30f)));
        };
        const auto alone = mask<F>(load<F>(&odd[i]) > F(0)), apart = mask<F>(load<F>(&split[i]) > F(0));
        const Vec3<F> n0 = normal(0), n1 = normal(1);
        const F bend = max(F(0), F(1) - dot(n0, n1));
        const auto counts = mask<F>(bend > F(1e-7f)) || apart || alone;
        const auto hollow = !alone && mask<F>(dot(n0, load_vector<F>(third[1], i) - a) > F(0));
        const F weight = select(counts, select(hollow, F(Hollow), F(1)), F(0));
        store_vector(n0, to.n0, i), store_vector(n1, to.n1, i);
        store(&to.weight[i], weight * load<F>(&moving[i]));
        store(&to.bend[i], select(apart, max(bend, F(0.05f)), bend));
    }
}

template <class S>
OutlineElement OutlineSet::edge_element(const SceneView<S> &scene, size_t edge) const {
    OutlineLeaves::Elements one;
    put_edges(scene, &edge, 1, one);
    return one.get(0);
}

template <class S>
OutlineElement OutlineSet::curve_element(const SceneView<S> &scene, size_t element) const {
    const OutlineCurve &c = curve(element);
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
