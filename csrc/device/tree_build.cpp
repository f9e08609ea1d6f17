#include "tree_build.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "accel/height_ranges.h"
#include "accel/sdf_blocks.h"
#include "core/shape/quadric_hit.h"
#include "host/parallel.h"

namespace tr {

namespace {

constexpr float Infinity = std::numeric_limits<float>::infinity();
constexpr int Bins = 16;
constexpr size_t LargestLeaf = 4;
constexpr size_t FewItems = 8192;      // are not worth a thread
constexpr double LargestGrowth = 1.2;  // of the cost by motion, as in accel.cpp

struct Bounds {
    float lower[3] = {Infinity, Infinity, Infinity}, upper[3] = {-Infinity, -Infinity, -Infinity};

    void include(const float *p) {
        for (int k = 0; k < 3; ++k) lower[k] = std::min(lower[k], p[k]), upper[k] = std::max(upper[k], p[k]);
    }
    void include(const Bounds &other) {  // which may be empty
        for (int k = 0; k < 3; ++k) {
            lower[k] = std::min(lower[k], other.lower[k]);
            upper[k] = std::max(upper[k], other.upper[k]);
        }
    }
    double half_area() const {
        const double x = double(upper[0]) - double(lower[0]), y = double(upper[1]) - double(lower[1]),
                     z = double(upper[2]) - double(lower[2]);
        return x >= 0 ? x * y + y * z + z * x : 0;
    }
};

Bounds bounds_of(const TreeItem &item) {
    Bounds box;
    for (int c = 0; c < (item.kind == TreeKind::Triangle ? 3 : 2); ++c) box.include(item.p[c]);
    return box;
}

Bounds bounds_of(const TreeNode &node, int k) {
    Bounds box;
    std::copy_n(node.lower[k], 3, box.lower);
    std::copy_n(node.upper[k], 3, box.upper);
    return box;
}

struct Entry {
    Bounds box;
    float centre[3];  // twice
    uint32_t item;
};

struct Child {
    Bounds box;
    uint32_t child, count;
};

void set_child(TreeNode &node, int k, const Child &c) {
    std::copy_n(c.box.lower, 3, node.lower[k]);
    std::copy_n(c.box.upper, 3, node.upper[k]);
    node.child[k] = c.child, node.count[k] = c.count;
}

class Builder {
public:
    explicit Builder(std::vector<Entry> &entries) : entries_(entries) {}

    // The subtree of the entries begin .. end, whose nodes are added to `nodes`; `depth` levels are left for it.
    Child build(size_t begin, size_t end, int depth, int threads, std::vector<TreeNode> &nodes) const {
        Child made;
        for (size_t i = begin; i < end; ++i) made.box.include(entries_[i].box);
        made.child = uint32_t(begin), made.count = uint32_t(end - begin);
        if (end - begin == 1) return made;
        const size_t middle = split(begin, end, made.box, depth);
        if (middle == begin) return made;
        made.child = uint32_t(nodes.size()), made.count = 0;
        nodes.emplace_back();
        Child children[2];
        if (threads > 1 && end - begin > FewItems) {
            std::vector<TreeNode> others;
            const auto part = [&](size_t, size_t, int k) {
                children[k] = k == 0 ? build(begin, middle, depth - 1, threads / 2, nodes)
                                     : build(middle, end, depth - 1, threads - threads / 2, others);
            };
            for_ranges(2, 2, part, 1);
            // their numbers were counted from 0
            const auto before = uint32_t(nodes.size());
            for (TreeNode &node : others)
                for (int k = 0; k < 2; ++k)
                    if (node.count[k] == 0) node.child[k] += before;
            if (children[1].count == 0) children[1].child += before;
            nodes.insert(nodes.end(), others.begin(), others.end());
        } else {
            children[0] = build(begin, middle, depth - 1, 1, nodes);
            children[1] = build(middle, end, depth - 1, 1, nodes);
        }
        for (int k = 0; k < 2; ++k) set_child(nodes[made.child], k, children[k]);
        return made;
    }

private:
    std::vector<Entry> &entries_;

    // Sorts the entries into two parts and returns where the second begins; `begin`: a leaf is better.
    size_t split(size_t begin, size_t end, const Bounds &box, int depth) const {
        const size_t n = end - begin, middle = begin + n / 2;
        Bounds centres;
        for (size_t i = begin; i < end; ++i) centres.include(entries_[i].centre);
        double best = std::numeric_limits<double>::infinity();
        int axis = 0, edge = 0;
        for (int k = 0; k < 3; ++k) {
            if (!(centres.lower[k] < centres.upper[k])) continue;
            Bounds boxes[Bins];
            size_t counts[Bins] = {};
            for (size_t i = begin; i < end; ++i) {
                const int bin = bin_of(entries_[i], centres, k);
                boxes[bin].include(entries_[i].box);
                ++counts[bin];
            }
            double after[Bins];
            Bounds sum;
            size_t count = 0;
            for (int b = Bins - 1; b > 0; --b) {
                sum.include(boxes[b]);
                count += counts[b];
                after[b] = sum.half_area() * double(count);
            }
            sum = {}, count = 0;
            for (int b = 1; b < Bins; ++b) {
                sum.include(boxes[b - 1]);
                count += counts[b - 1];
                const double cost = sum.half_area() * double(count) + after[b];
                if (count != 0 && count != n && cost < best) best = cost, axis = k, edge = b;
            }
        }
        if (n <= LargestLeaf && box.half_area() * double(n) <= box.half_area() + best) return begin;
        // where there is nothing to choose from, or halves are all that fits into the levels left
        if (!(best < std::numeric_limits<double>::infinity()) || levels_of(n) >= depth) return middle;
        const auto second = std::partition(entries_.begin() + ptrdiff_t(begin), entries_.begin() + ptrdiff_t(end),
                                           [&](const Entry &e) { return bin_of(e, centres, axis) < edge; });
        return size_t(second - entries_.begin());
    }

    static int bin_of(const Entry &entry, const Bounds &centres, int k) {
        const float place = (entry.centre[k] - centres.lower[k]) / (centres.upper[k] - centres.lower[k]);
        return std::min(Bins - 1, int(place * float(Bins)));
    }
    // Of a tree whose nodes have halves.
    static int levels_of(size_t n) {
        int levels = 1;
        while ((size_t(1) << levels) < n) ++levels;
        return levels + 1;
    }
};

double cost_of(const Tree &tree) {
    Bounds whole;
    whole.include(tree.lower), whole.include(tree.upper);  // infinite where there is nothing
    if (tree.nodes.empty() || !(whole.half_area() > 0)) return 0;
    double sum = 0;
    for (const TreeNode &node : tree.nodes)
        for (int k = 0; k < 2; ++k) sum += bounds_of(node, k).half_area() * double(1 + node.count[k]);
    return sum / whole.half_area();
}

void set_bounds(Tree &tree) {
    Bounds all;
    for (int k = 0; k < 2 && !tree.nodes.empty(); ++k) all.include(bounds_of(tree.nodes[0], k));
    std::copy_n(all.lower, 3, tree.lower);
    std::copy_n(all.upper, 3, tree.upper);
    tree.cost = cost_of(tree);
}

}  // namespace

TreeView Tree::view() const {
    TreeView view{
        nodes.data(), items.data(), matrices.data(), fields.data(), grids.data(), uint32_t(items.size()), {}, {}};
    std::copy_n(lower, 3, view.lower);
    std::copy_n(upper, 3, view.upper);
    return view;
}

void Tree::build(int threads) {
    std::vector<Entry> entries(items.size());
    for (size_t i = 0; i < items.size(); ++i) {
        Entry &e = entries[i];
        e.box = bounds_of(items[i]), e.item = uint32_t(i);
        for (int k = 0; k < 3; ++k) e.centre[k] = e.box.lower[k] + e.box.upper[k];
    }
    nodes.clear();
    if (!items.empty()) {
        std::vector<TreeNode> below;
        const Child root = Builder(entries).build(0, entries.size(), TreeDepth - 1, threads, below);
        if (root.count != 0) {  // a leaf alone: its node has an empty box beside it
            nodes.emplace_back();
            set_child(nodes[0], 0, root);
            set_child(nodes[0], 1, {{}, 0, 0});
        } else {
            nodes = std::move(below);
        }
        std::vector<TreeItem> sorted(items.size());
        for (size_t i = 0; i < entries.size(); ++i) sorted[i] = items[entries[i].item];
        items = std::move(sorted);
    }
    set_bounds(*this);
    built_cost = cost;
}

bool Tree::refit() {
    // children come after their parents
    for (size_t at = nodes.size(); at-- > 0;) {
        TreeNode &node = nodes[at];
        for (int k = 0; k < 2; ++k) {
            if (at == 0 && node.count[k] == 0 && node.child[k] == 0) continue;  // beside a leaf alone
            Child c{{}, node.child[k], node.count[k]};
            for (uint32_t i = 0; i < c.count; ++i) c.box.include(bounds_of(items[c.child + i]));
            for (int j = 0; j < 2 && c.count == 0; ++j) c.box.include(bounds_of(nodes[c.child], j));
            set_child(node, k, c);
        }
    }
    set_bounds(*this);
    return cost <= LargestGrowth * built_cost;
}

TreeItem triangle_item(uint32_t shape, uint32_t primitive, const float *p0, const float *p1, const float *p2) {
    TreeItem item{{}, shape, primitive, TreeKind::Triangle};
    std::copy_n(p0, 3, item.p[0]);
    std::copy_n(p1, 3, item.p[1]);
    std::copy_n(p2, 3, item.p[2]);
    return item;
}

TreeItem quadric_item(uint32_t shape, TreeKind kind, const double to_world[12]) {
    TreeItem item{{}, shape, 0, kind};
    quadric_box(to_world, kind == TreeKind::Sphere, kind == TreeKind::Cylinder, item.p[0], item.p[1]);
    return item;
}

namespace {

struct Single {
    float m[12];
    explicit Single(const double of[12]) { std::copy_n(of, 12, m); }
};

}  // namespace

TreeItem grid_item(uint32_t shape, const SdfTable &grid, const double to_world[12]) {
    TreeItem item{{}, shape, 0, TreeKind::SdfGrid};
    sdf_box(Single(to_world).m, grid, item.p[0], item.p[1]);
    return item;
}

TreeItem field_item(uint32_t shape, const HeightRange &range, const double to_world[12]) {
    TreeItem item{{}, shape, 0, TreeKind::HeightField};
    height_box(Single(to_world).m, range, item.p[0], item.p[1]);
    return item;
}

}  // namespace tr
