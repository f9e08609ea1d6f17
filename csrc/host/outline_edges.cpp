// Which edges meshes have, and which faces meet at each.
#include <algorithm>
#include <cstring>
#include <stdexcept>
#include <utility>

#include "outline_set.h"
#include "parallel.h"

namespace tr {

namespace {

template <class S>
bool has_area(const SceneView<S> &scene, const uint32_t *face) {
    Vec3<S> p[3];
    for (size_t k = 0; k < 3; ++k) {
        const S *row = scene.vertices + VertexRow<S>::Size * size_t(face[k]);
        p[k] = {row[0], row[1], row[2]};
    }
    return max_abs(cross(p[1] - p[0], p[2] - p[0])) > 0;
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

// Half edges go by the smaller of their welded ends, and there by the larger one. Edges, then, by the first of their
// faces: what follows each other in meshes is close in most of them.
template <class S>
bool OutlineSet::find(const SceneView<S> &scene, int threads, const std::function<bool()> &interrupted) {
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
    std::sort(meshes_.begin(), meshes_.end(),
              [](const OutlineMesh &a, const OutlineMesh &b) { return a.face < b.face; });
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
    if (n > Flag) throw std::length_error("outlines: more than 2147 million vertices");
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
    constexpr uint32_t none = 0xFFFFFFFFu;
    std::vector<uint32_t> begin(3 * n_faces, none);  // in `all`, of the edge whose first half begins at a corner
    for (size_t v = 0, i = 0; v < n; ++v) {
        if (stop()) return false;
        const auto from = all.begin() + ptrdiff_t(i), to = all.begin() + bucket[v];  // now where the next one's begin
        sort_few(from, to, [](const Found &a, const Found &b) { return a.high < b.high; });
        for (uint32_t before = none; i < bucket[v]; ++i) {
            if (all[i].high == before) continue;
            begin[all[i].corner & ~Flag] = uint32_t(i);
            before = std::exchange(all[i].high, all[i].high | Flag);
        }
    }
    corners_.clear(), begin_.clear();
    corners_.reserve(all.size());
    for (size_t first : begin) {
        if (stop()) return false;
        if (first == none) continue;
        begin_.push_back(uint32_t(corners_.size()));
        corners_.push_back(all[first].corner);
        for (size_t i = first + 1; i < all.size() && !(all[i].high & Flag); ++i) corners_.push_back(all[i].corner);
    }
    begin_.push_back(uint32_t(corners_.size()));
    begin_.shrink_to_fit();
    gather(scene, threads);
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
    refresh_table();
    return found_ = true;
}

template <class S>
void OutlineSet::gather(const SceneView<S> &scene, int threads) {
    around_.resize(begin_.size() - 1);
    refresh_table();
    for_ranges(n_edges(), threads, [&](size_t begin, size_t end, int) {
        for (size_t edge = begin; edge < end; ++edge) {
            const size_t n = table_.count(edge);
            const HalfEdge first = table_.half(scene, edge, 0), second = table_.half(scene, edge, n > 1 ? 1 : 0);
            bool split = false;
            for (size_t k = 1; k < n && !split; ++k) {
                const HalfEdge other = table_.half(scene, edge, k);
                split =
                    other.v0 != first.v0 || other.v1 != first.v1 || table_.shape_of(other) != table_.shape_of(first);
            }
            auto flagged = [](uint32_t vertex, bool flag) { return vertex | (flag ? Flag : 0); };
            around_[edge] = {{flagged(first.v0, n != 2), flagged(first.v1, split), flagged(first.third, first.turned),
                              flagged(second.third, second.turned)}};
        }
    });
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

#define TR_INSTANTIATE(S)                                                                     \
    template bool OutlineSet::find(const SceneView<S> &, int, const std::function<bool()> &); \
    template bool OutlineSet::holds(const SceneView<S> &) const;
TR_INSTANTIATE(float)
TR_INSTANTIATE(double)
#undef TR_INSTANTIATE

}  // namespace tr
