#include "outline_tree.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "parallel.h"

namespace tr {

namespace {

using V = Vec3<float>;
constexpr float pi = float(Pi);

V unit(const V &a) {
    const float length = norm(a);
    return length > 0 ? a * (1 / length) : V{0, 0, 1};
}

}  // namespace

OutlineTreeView OutlineTree::view() const {
    OutlineTreeView r{leaves_.view(), {}, int32_t(levels_.size())};
    if (levels_.size() > size_t(OutlineTreeView::MostLevels)) throw std::length_error("outlines: too many edges");
    for (size_t l = 0; l < levels_.size(); ++l) r.levels[l] = levels_[l].data();
    return r;
}

void OutlineTree::resize(size_t n_elements, size_t n_rounded) {
    leaves_.resize(n_elements, n_rounded);
    const size_t n = n_leaves();
    levels_.resize(n > 0 ? 1 : 0);
    if (n == 0) return;
    levels_[0].resize((n + Wide - 1) / Wide);
    levels_[0].back() = {};
}

void OutlineTree::set(size_t leaf, const OutlineElement *elements, size_t n) {
    OutlineLeaf all{};
    std::fill_n(all.index, Wide, -1);
    for (size_t k = 0; k < n; ++k) set_element(all, k, elements[k]);
    set(leaf, all);
}

void OutlineTree::set(size_t leaf, const OutlineLeaf &all) {
    const LeafBox box = box_of(all);
    leaves_.set(leaf, all, box);
    put(node_of(all, box), levels_[0][leaf / Wide], leaf % Wide);
}

void OutlineTree::build(int threads) {
    constexpr size_t few = 256;
    while (!levels_.empty() && levels_.back().size() > 1) {
        const std::vector<OutlineNodes> &below = levels_.back();
        std::vector<OutlineNodes> level((below.size() + Wide - 1) / Wide);
        for_ranges(
            below.size(), threads,
            [&](size_t begin, size_t end, int) {
                for (size_t i = begin; i < end; ++i) put(united(below[i]), level[i / Wide], i % Wide);
            },
            few);
        levels_.push_back(std::move(level));
    }
}

// Whether some face below may be seen from p and another not: with the unit axis and the half angle of the cone, and
// the ball's centre at the vector c, normals times vectors to p are not closer to zero than the cosine of the largest
// angle between them times |c|, but for the radius.
bool OutlineTree::may_have_outlines(size_t leaf, const V &p, bool parallel, float margin, bool resting) const {
    const OutlineNodes &nodes = levels_[0][leaf / Wide];
    const size_t k = leaf % Wide;
    if (!(nodes.flux[k] > 0) && !(resting && nodes.still[k] > 0)) return false;
    if (!(nodes.cosine[k] > 0)) return true;
    const V c = parallel ? p : lane_of(nodes.center, k) - p;
    const float radius = parallel ? 0.f : nodes.radius[k], distance = norm(c);
    const float along = std::fabs(dot(lane_of(nodes.axis, k), c)),
                across = std::sqrt(std::max(0.f, distance * distance - along * along));
    const float least = along * nodes.cosine[k] - across * nodes.sine[k] - radius;
    return !(least > margin + 1e-4f * (distance + radius));
}

void OutlineTree::put(const Node &node, OutlineNodes &to, size_t k) {
    put_lane(node.center, to.center, k), put_lane(node.axis, to.axis, k);
    to.radius[k] = node.radius, to.cosine[k] = node.cosine, to.sine[k] = node.sine, to.flux[k] = node.flux,
    to.still[k] = node.still;
}

OutlineTree::Node OutlineTree::node_of(const OutlineLeaf &leaf, const LeafBox &box) {
    using F = PacketOf<float>;
    using M = MaskOf<F>;
    constexpr size_t W = size_t(Lanes<F>::Width);
    auto every = [](auto &&visit) {
        for (size_t i = 0; i < Wide; i += W) visit(i);
    };
    bool any_direction = false;
    F moving(0), resting(0);
    Vec3<F> normals{F(0), F(0), F(0)};
    every([&](size_t i) {
        const F weight = load<F>(&leaf.weight[i]);
        const M counts = mask<F>(weight != F(0)), edge = leaf.are<F>(OutlineElement::Edge, i),
                round = leaf.are<F>(OutlineElement::Round, i);
        const Vec3<F> a = load_vector<F>(leaf.a, i), b = load_vector<F>(leaf.b, i);
        // an edge is an outline from the share of directions between its faces
        const F angle = select(edge, sqrt(F(2) * load<F>(&leaf.bend[i])) * F(1 / pi), F(1));
        const F length = select(round, F(2 * pi) * b.x, sqrt(squared_norm(b - a)) * max(angle, F(1e-4f)));
        moving = moving + select(mask<F>(weight > F(0)), weight * length, F(0));
        resting = resting - select(mask<F>(weight < F(0)), weight * length, F(0));
        any_direction |= any(counts && !edge);
        normals = normals + select(counts, load_vector<F>(leaf.n0, i) + load_vector<F>(leaf.n1, i), {F(0), F(0), F(0)});
    });
    Node node;
    node.flux = sum_of(moving), node.still = sum_of(resting);
    if (!(node.flux + node.still > 0)) return node;
    node.center = (box.low + box.high) * 0.5f;
    node.radius = norm(box.high - box.low) * 0.5f * 1.00001f;
    node.axis = unit({sum_of(normals.x), sum_of(normals.y), sum_of(normals.z)});
    F cosine(1);
    every([&](size_t i) {
        const Vec3<F> axis{F(node.axis.x), F(node.axis.y), F(node.axis.z)};
        const F both = min(dot(axis, load_vector<F>(leaf.n0, i)), dot(axis, load_vector<F>(leaf.n1, i)));
        cosine = select(mask<F>(load<F>(&leaf.weight[i]) != F(0)), min(both, cosine), cosine);
    });
    node.cosine = any_direction ? -1.f : least_of(cosine);
    node.cosine = node.cosine > 0 ? std::max(0.f, node.cosine - 1e-4f) : -1.f;
    node.sine = std::sqrt(std::max(0.f, 1 - node.cosine * node.cosine));
    return node;
}

OutlineTree::Node OutlineTree::united(const OutlineNodes &children) {
    V low{INFINITY, INFINITY, INFINITY}, high{-INFINITY, -INFINITY, -INFINITY}, sum{0, 0, 0};
    Node node;
    for (size_t k = 0; k < Wide; ++k) {
        if (!(children.flux[k] + children.still[k] > 0)) continue;
        const V c = lane_of(children.center, k);
        const float r = children.radius[k];
        low = {std::min(low.x, c.x - r), std::min(low.y, c.y - r), std::min(low.z, c.z - r)};
        high = {std::max(high.x, c.x + r), std::max(high.y, c.y + r), std::max(high.z, c.z + r)};
        sum = sum + lane_of(children.axis, k);
        node.flux += children.flux[k], node.still += children.still[k];
    }
    if (!(node.flux + node.still > 0)) return node;
    node.center = (low + high) * 0.5f;
    node.axis = unit(sum);
    float angle = 0;  // the half angle that holds all cones
    for (size_t k = 0; k < Wide; ++k) {
        if (!(children.flux[k] + children.still[k] > 0)) continue;
        node.radius = std::max(node.radius, norm(lane_of(children.center, k) - node.center) + children.radius[k]);
        const float between = std::acos(std::clamp(dot(node.axis, lane_of(children.axis, k)), -1.f, 1.f));
        angle = std::max(angle, children.cosine[k] > 0 ? between + std::acos(std::min(children.cosine[k], 1.f)) : pi);
    }
    node.radius *= 1.00001f;
    angle += 1e-3f;
    node.cosine = angle < pi / 2 ? std::cos(angle) : -1.f;
    node.sine = std::sqrt(std::max(0.f, 1 - node.cosine * node.cosine));
    return node;
}

}  // namespace tr
