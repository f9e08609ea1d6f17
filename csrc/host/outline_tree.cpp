#include "outline_tree.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/math/vector.h"
#include "parallel.h"

namespace tr {

namespace {

using V = Vec3<float>;
constexpr float pi = float(Pi);

V vec(const float *p) { return {p[0], p[1], p[2]}; }
void put(const V &v, float *p) { p[0] = v.x, p[1] = v.y, p[2] = v.z; }
V unit(const V &a) {
    const float length = norm(a);
    return length > 0 ? a * (1 / length) : V{0, 0, 1};
}

// Numbers of a counter (Steele et al., "Fast Splittable Pseudorandom Number Generators", 2014).
struct Numbers {
    uint64_t state;
    uint64_t bits() {
        uint64_t z = (state += 0x9E3779B97F4A7C15ull);
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
        z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
        return z ^ (z >> 31);
    }
    double uniform() { return double(bits() >> 11) * 0x1p-53; }
};

// What about is scattered towards directions around the unit vector d, within an angle.
float scattered(const OutlineAnchor &from, const V &d, float cos_angle, float sin_angle) {
    auto nearest = [&](const V &axis) {  // cosine of the least angle to `axis`
        const float c = std::clamp(dot(axis, d), -1.f, 1.f);
        if (c >= cos_angle) return 1.f;
        return c * cos_angle + std::sqrt(std::max(0.f, 1 - c * c)) * sin_angle;
    };
    const V n = vec(from.n);
    const float cosine = dot(n, n) > 0 ? std::max(0.f, nearest(n)) : 1.f;
    if (cosine <= 0 || from.share <= 0) return cosine;
    // a tail keeps what the lobe's model leaves out
    return (1 - from.share) * cosine + from.share * (std::exp(from.k * (nearest(vec(from.axis)) - 1)) + 0.02f * cosine);
}

}  // namespace

void OutlineTree::build(int threads) {
    const size_t leaves = (elements_.size() + Leaf - 1) / Leaf;
    first_leaf_ = 1;
    while (first_leaf_ < leaves) first_leaf_ *= 2;
    nodes_.assign(2 * first_leaf_, Node{{0, 0, 0}, 0, {0, 0, 1}, 1, 0, 0});
    for_ranges(leaves, threads, [&](size_t begin, size_t end, int) {
        for (size_t i = begin; i < end; ++i)
            nodes_[first_leaf_ + i] = node_of(i * Leaf, std::min(elements_.size(), (i + 1) * Leaf));
    });
    for (size_t level = first_leaf_ / 2; level > 0; level /= 2)
        for_ranges(level, threads, [&](size_t begin, size_t end, int) {
            for (size_t i = level + begin; i < level + end; ++i) nodes_[i] = united(nodes_[2 * i], nodes_[2 * i + 1]);
        });
}

OutlineTree::Node OutlineTree::node_of(size_t begin, size_t end) const {
    V low{INFINITY, INFINITY, INFINITY}, high{-INFINITY, -INFINITY, -INFINITY}, sum{0, 0, 0};
    auto include = [&](const V &p) {
        low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
        high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
    };
    bool any_direction = false;
    float flux = 0;
    for (size_t i = begin; i < end; ++i) {
        const OutlineElement &e = elements_[i];
        if (!(e.weight > 0)) continue;
        if (e.kind == OutlineElement::Round) {
            const V r{e.b[0], e.b[0], e.b[0]};
            include(vec(e.a) - r), include(vec(e.a) + r);
            flux += e.weight * 2 * pi * e.b[0];
        } else {
            include(vec(e.a)), include(vec(e.b));
            // an edge is an outline from the share of directions between its faces
            const float angle = e.kind == OutlineElement::Edge ? std::acos(std::clamp(1 - e.bend, -1.f, 1.f)) / pi : 1;
            flux += e.weight * norm(vec(e.b) - vec(e.a)) * std::max(angle, 1e-4f);
        }
        any_direction |= e.kind != OutlineElement::Edge;
        sum = sum + vec(e.n0) + vec(e.n1);
    }
    Node node{};
    if (!(flux > 0)) return node;
    put((low + high) * 0.5f, node.center);
    node.radius = norm(high - low) * 0.5f * 1.00001f;
    node.flux = flux;
    const V axis = unit(sum);
    put(axis, node.axis);
    node.cosine = any_direction ? -1.f : 1.f;
    for (size_t i = begin; i < end && !any_direction; ++i)
        if (elements_[i].weight > 0)
            node.cosine = std::min({node.cosine, dot(axis, vec(elements_[i].n0)), dot(axis, vec(elements_[i].n1))});
    node.cosine = node.cosine > 0 ? std::max(0.f, node.cosine - 1e-4f) : -1.f;
    node.sine = std::sqrt(std::max(0.f, 1 - node.cosine * node.cosine));
    return node;
}

OutlineTree::Node OutlineTree::united(const Node &a, const Node &b) {
    if (!(a.flux > 0)) return b;
    if (!(b.flux > 0)) return a;
    Node node{};
    const V from = vec(a.center), to = vec(b.center);
    const float distance = norm(to - from);
    if (distance + b.radius <= a.radius || distance + a.radius <= b.radius) {
        const Node &larger = a.radius >= b.radius ? a : b;
        put(vec(larger.center), node.center);
        node.radius = larger.radius;
    } else {
        node.radius = 0.5f * (distance + a.radius + b.radius) * 1.00001f;
        put(from + (to - from) * ((node.radius - a.radius) / distance), node.center);
    }
    node.flux = a.flux + b.flux;
    const V axis = unit(vec(a.axis) + vec(b.axis));
    put(axis, node.axis);
    // the half angle that holds both cones
    auto reach = [&](const Node &n) {
        return std::acos(std::clamp(dot(axis, vec(n.axis)), -1.f, 1.f)) + std::acos(std::clamp(n.cosine, -1.f, 1.f));
    };
    const float angle = a.cosine > 0 && b.cosine > 0 ? std::max(reach(a), reach(b)) + 1e-3f : pi;
    node.cosine = angle < pi / 2 ? std::cos(angle) : -1.f;
    node.sine = std::sqrt(std::max(0.f, 1 - node.cosine * node.cosine));
    return node;
}

float OutlineTree::importance(const Node &node, const OutlineAnchor &from) {
    if (!(node.flux > 0)) return 0;
    const V d = from.parallel ? vec(from.p) : vec(node.center) - vec(from.p);
    const float squared = dot(d, d), r2 = from.parallel ? 0.f : node.radius * node.radius;
    if (squared <= r2) return node.flux / std::max(r2, 1e-30f);
    const float inverse = 1 / std::sqrt(squared), sin_angle = std::sqrt(r2) * inverse,
                cos_angle = std::sqrt(1 - sin_angle * sin_angle);
    const V direction = d * inverse;
    if (node.cosine > 0) {  // all faces are seen from one side if the axis is further than both angles from across
        const float cosine = node.cosine * cos_angle - node.sine * sin_angle,
                    sine = node.sine * cos_angle + node.cosine * sin_angle;
        if (cosine > 0 && std::fabs(dot(vec(node.axis), direction)) > sine) return 0;
    }
    return node.flux / squared * scattered(from, direction, cos_angle, sin_angle);
}

float OutlineTree::target(const OutlineElement &e, const OutlineAnchor &from, float s) {
    const V p = vec(from.p), a = from.parallel ? p : vec(e.a) - p;
    if (e.kind == OutlineElement::Round) {
        const float squared = dot(a, a), r = e.b[0], distance = std::sqrt(squared);
        if (e.shape == from.own) return 0;
        if (from.parallel) return e.weight * 2 * pi * r;
        float seen = 1;
        if (distance > r) {
            const float sine = r / distance;
            seen = scattered(from, a * (1 / distance), std::sqrt(1 - sine * sine), sine);
        }
        return e.weight * 2 * pi * r / std::max(squared, r * r) * seen;
    }
    const V along = vec(e.b) - vec(e.a), d = from.parallel ? p : a + along * s;
    float kept = e.weight;
    if (e.kind != OutlineElement::Always) {
        const bool outline = (dot(vec(e.n0), d) < 0) != (dot(vec(e.n1), d) < 0);
        if (!outline) kept *= e.kind == OutlineElement::Crease ? std::clamp(e.bend, 0.05f, 1.f) : 0.f;
    }
    if (!(kept > 0)) return 0;
    const float inverse = 1 / std::max(norm(d), 1e-30f);
    return kept * norm(cross(d, along)) * inverse * inverse * inverse * scattered(from, d * inverse, 1, 0);
}

OutlineChoice OutlineTree::choose(const OutlineAnchor &from, uint64_t seed) const {
    Numbers numbers{seed};
    OutlineChoice choice{-1, 0, 0};
    float chosen = 0;
    double sum = 0;
    for (size_t k = 0; k < Descents && !elements_.empty(); ++k) {
        size_t at = 1;
        double u = numbers.uniform(), probability = 1;
        while (at < first_leaf_) {
            const float left = importance(nodes_[2 * at], from), right = importance(nodes_[2 * at + 1], from);
            const float total = left + right;
            if (!(total > 0)) break;
            double share = double(left) / double(total);
            if (left > 0 && right > 0) share = 0.025 + 0.95 * share;
            if (u < share)
                at = 2 * at, u /= share, probability *= share;
            else
                at = 2 * at + 1, u = (u - share) / (1 - share), probability *= 1 - share;
        }
        if (at < first_leaf_) continue;
        const size_t begin = (at - first_leaf_) * Leaf, end = std::min(elements_.size(), begin + Leaf);
        const float s = float(numbers.bits() >> 40) * 0x1p-24f;
        for (size_t i = begin; i < end; ++i) {
            const float t = target(elements_[i], from, s);
            if (!(t > 0) || !std::isfinite(t)) continue;
            const double weight = double(t) / probability;
            sum += weight;
            if (numbers.uniform() * sum < weight) choice.element = elements_[i].index, choice.s = s, chosen = t;
        }
    }
    if (choice.element >= 0) choice.inverse_density = float(sum / (double(Descents) * double(chosen)));
    return choice;
}

std::vector<int32_t> morton_order(const float *places, size_t n) {
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (size_t i = 0; i < 3 * n; ++i) {
        if (!std::isfinite(places[i])) continue;
        low[i % 3] = std::min(low[i % 3], places[i]), high[i % 3] = std::max(high[i % 3], places[i]);
    }
    auto spread = [](uint64_t x) {  // two zeros after each of 21 bits
        x = (x | x << 32) & 0x1F00000000FFFFull;
        x = (x | x << 16) & 0x1F0000FF0000FFull;
        x = (x | x << 8) & 0x100F00F00F00F00Full;
        x = (x | x << 4) & 0x10C30C30C30C30C3ull;
        return (x | x << 2) & 0x1249249249249249ull;
    };
    std::vector<uint64_t> code(n);
    for (size_t i = 0; i < n; ++i)
        for (size_t k = 0; k < 3; ++k) {
            const float size = high[k] - low[k], x = size > 0 ? (places[3 * i + k] - low[k]) / size : 0;
            code[i] |= spread(uint64_t(std::clamp(std::isfinite(x) ? x : 0.f, 0.f, 1.f) * 2097151.f)) << k;
        }
    std::vector<int32_t> order(n);
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(),
                     [&](int32_t i, int32_t j) { return code[size_t(i)] < code[size_t(j)]; });
    return order;
}

}  // namespace tr
