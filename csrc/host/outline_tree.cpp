#include "outline_tree.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "parallel.h"

namespace tr {

namespace {

using V = Vec3<float>;
using F = PacketOf<float>;
using M = MaskOf<F>;
constexpr size_t W = size_t(Lanes<F>::Width);
constexpr float pi = float(Pi);
static_assert(OutlineTree::Wide % W == 0);

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
    float single() { return float(bits() >> 40) * 0x1p-24f; }
};

template <class T>
Vec3<F> load_vector(const T &columns, size_t i) {
    return {load<F>(&columns[0][i]), load<F>(&columns[1][i]), load<F>(&columns[2][i])};
}
template <class T>
V lane_of(const T &columns, size_t k) {
    return {columns[0][k], columns[1][k], columns[2][k]};
}
template <class T>
void put_lane(const V &v, T &columns, size_t k) {
    columns[0][k] = v.x, columns[1][k] = v.y, columns[2][k] = v.z;
}
Vec3<F> widen(const V &v) { return {F(v.x), F(v.y), F(v.z)}; }

float weight_of(float given, const OutlineAnchor &from) { return given < 0 ? -given * from.still : given; }

// What about is scattered towards directions around the unit vector d, within an angle.
F scattered(const OutlineAnchor &from, const Vec3<F> &d, const F &cos_angle, const F &sin_angle) {
    auto nearest = [&](const V &axis) {  // cosine of the least angle to `axis`
        const F c = max(F(-1), min(F(1), dot(widen(axis), d)));
        const F turned = c * cos_angle + sqrt(max(F(0), F(1) - c * c)) * sin_angle;
        return select(mask<F>(c >= cos_angle), F(1), turned);
    };
    const F cosine = squared_norm(from.n) > 0 ? max(F(0), nearest(from.n)) : F(1);
    if (from.share <= 0) return cosine;
    // a tail keeps what the lobe's model leaves out
    return cosine * F(1 - from.share + 0.02f * from.share) +
           select(mask<F>(cosine > F(0)), exp((nearest(from.axis) - F(1)) * F(from.k)) * F(from.share), F(0));
}

// Sums of numbers up to each; in a register where there is one, since what is stored piecewise is slow to load.
void add_up(const float (&each)[OutlineTree::Wide], float (&sum)[OutlineTree::Wide]) {
#if TR_HAS_PACKETS && defined(DRJIT_X86_AVX512)
    const __m512i zero = _mm512_setzero_si512();
    __m512 v = _mm512_loadu_ps(each);
    auto add = [&](__m512i shifted) { v = _mm512_add_ps(v, _mm512_castsi512_ps(shifted)); };
    add(_mm512_alignr_epi32(_mm512_castps_si512(v), zero, 15));
    add(_mm512_alignr_epi32(_mm512_castps_si512(v), zero, 14));
    add(_mm512_alignr_epi32(_mm512_castps_si512(v), zero, 12));
    add(_mm512_alignr_epi32(_mm512_castps_si512(v), zero, 8));
    _mm512_storeu_ps(sum, v);
#else
    std::partial_sum(each, each + OutlineTree::Wide, sum);
#endif
}

// Sixteen weights, none of them negative, added up.
struct Weights {
    static constexpr size_t Wide = OutlineTree::Wide;
    alignas(64) float each[Wide], sum[Wide];

    float total() const { return sum[Wide - 1]; }
    // False if they are all zero. What is not finite counts as that.
    bool add_up() {
        for (size_t i = 0; i < Wide; i += W) {
            const F w = load<F>(&each[i]);
            store(&each[i], select(mask<F>(w > F(0)) && mask<F>(w < F(1e30f)), w, F(0)));
        }
        tr::add_up(each, sum);
        return total() > 0;
    }
    // In proportion to the weights, for u in [0, 1).
    size_t pick(float u) const {
        const F at(u * total());
        int k = 0;
        for (size_t i = 0; i < Wide; i += W) k += count(mask<F>(load<F>(&sum[i]) <= at));
        for (k = std::min(k, int(Wide) - 1); !(each[k] > 0); --k) {}  // by rounding
        return size_t(k);
    }
    // All that are not zero alike.
    size_t pick_any(float u) const {
        size_t at = size_t(u * float(positive())), k = 0;
        for (; k + 1 < Wide; ++k)
            if (each[k] > 0 && at-- == 0) break;
        return k;
    }
    int positive() const {
        int n = 0;
        for (size_t i = 0; i < Wide; i += W) n += count(mask<F>(load<F>(&each[i]) > F(0)));
        return n;
    }
};

}  // namespace

void OutlineTree::resize(size_t n) {
    n_ = n;
    leaves_.resize((n + Wide - 1) / Wide);
    if (!leaves_.empty()) leaves_.back() = {};
}

void OutlineTree::set(size_t i, const OutlineElement &e) {
    Elements &leaf = leaves_[i / Wide];
    const size_t k = i % Wide;
    put_lane(e.a, leaf.a, k), put_lane(e.b, leaf.b, k), put_lane(e.n0, leaf.n0, k), put_lane(e.n1, leaf.n1, k);
    leaf.weight[k] = e.moves ? e.weight : -e.weight, leaf.bend[k] = e.bend;
    leaf.kind[k] = e.kind, leaf.shape[k] = e.shape, leaf.index[k] = e.index;
}

OutlineElement OutlineTree::get(size_t i) const {
    const Elements &leaf = leaves_[i / Wide];
    const size_t k = i % Wide;
    return {lane_of(leaf.a, k), lane_of(leaf.b, k), lane_of(leaf.n0, k), lane_of(leaf.n1, k), std::fabs(leaf.weight[k]),
            leaf.bend[k],       leaf.kind[k],       leaf.shape[k],       leaf.index[k],       leaf.weight[k] > 0};
}

void OutlineTree::build(int threads) {
    levels_.clear();
    size_t n = leaves_.size();
    for (bool first = true; n > 0; first = false) {
        std::vector<Nodes> level((n + Wide - 1) / Wide);
        const std::vector<Nodes> *below = first ? nullptr : &levels_.back();
        for_ranges(n, threads, [&](size_t begin, size_t end, int) {
            for (size_t i = begin; i < end; ++i)
                put(below ? united((*below)[i]) : node_of(leaves_[i]), level[i / Wide], i % Wide);
        });
        levels_.push_back(std::move(level));
        n = levels_.back().size();
        if (n == 1) break;
    }
}

void OutlineTree::put(const Node &node, Nodes &to, size_t k) {
    put_lane(node.center, to.center, k), put_lane(node.axis, to.axis, k);
    to.radius[k] = node.radius, to.cosine[k] = node.cosine, to.sine[k] = node.sine, to.flux[k] = node.flux,
    to.still[k] = node.still;
}

OutlineTree::Node OutlineTree::node_of(const Elements &leaf) const {
    V low{INFINITY, INFINITY, INFINITY}, high{-INFINITY, -INFINITY, -INFINITY}, sum{0, 0, 0};
    auto include = [&](const V &p) {
        low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
        high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
    };
    bool any_direction = false;
    Node node;
    for (size_t k = 0; k < Wide; ++k) {
        const float weight = std::fabs(leaf.weight[k]);
        if (!(weight > 0)) continue;
        float &flux = leaf.weight[k] > 0 ? node.flux : node.still;
        const V a = lane_of(leaf.a, k), b = lane_of(leaf.b, k);
        const int32_t kind = leaf.kind[k];
        if (kind == OutlineElement::Round) {
            const V r{b.x, b.x, b.x};
            include(a - r), include(a + r);
            flux += weight * 2 * pi * b.x;
        } else {
            include(a), include(b);
            // an edge is an outline from the share of directions between its faces
            const float angle = kind == OutlineElement::Edge ? std::sqrt(2 * leaf.bend[k]) / pi : 1;
            flux += weight * norm(b - a) * std::max(angle, 1e-4f);
        }
        any_direction |= kind != OutlineElement::Edge;
        sum = sum + lane_of(leaf.n0, k) + lane_of(leaf.n1, k);
    }
    if (!(node.flux + node.still > 0)) return node;
    node.center = (low + high) * 0.5f;
    node.radius = norm(high - low) * 0.5f * 1.00001f;
    node.axis = unit(sum);
    node.cosine = any_direction ? -1.f : 1.f;
    for (size_t k = 0; k < Wide && !any_direction; ++k)
        if (leaf.weight[k] != 0)
            node.cosine =
                std::min({node.cosine, dot(node.axis, lane_of(leaf.n0, k)), dot(node.axis, lane_of(leaf.n1, k))});
    node.cosine = node.cosine > 0 ? std::max(0.f, node.cosine - 1e-4f) : -1.f;
    node.sine = std::sqrt(std::max(0.f, 1 - node.cosine * node.cosine));
    return node;
}

OutlineTree::Node OutlineTree::united(const Nodes &children) {
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

void OutlineTree::importance(const Nodes &nodes, const OutlineAnchor &from, float (&to)[Wide]) {
    for (size_t i = 0; i < Wide; i += W) {
        const F flux = load<F>(&nodes.flux[i]) + load<F>(&nodes.still[i]) * F(from.still),
                radius = load<F>(&nodes.radius[i]);
        const Vec3<F> d = from.parallel ? widen(from.p) : load_vector(nodes.center, i) - widen(from.p);
        const F squared = squared_norm(d), r2 = from.parallel ? F(0) : radius * radius;
        const M outside = mask<F>(squared > r2);
        const F inverse = F(1) / sqrt(select(outside, squared, F(1)));
        const F sin_angle = select(outside, sqrt(r2) * inverse, F(0)), cos_angle = sqrt(F(1) - sin_angle * sin_angle);
        const Vec3<F> direction = d * inverse;
        // all faces are seen from one side if the axis is further than both angles from across
        const F cone = load<F>(&nodes.cosine[i]), spread = load<F>(&nodes.sine[i]);
        const F cosine = cone * cos_angle - spread * sin_angle, sine = spread * cos_angle + cone * sin_angle;
        const M none = mask<F>(cone > F(0)) && mask<F>(cosine > F(0)) &&
                       mask<F>(abs(dot(load_vector(nodes.axis, i), direction)) > sine);
        F r = flux * inverse * inverse * scattered(from, direction, cos_angle, sin_angle);
        r = select(outside, select(none, F(0), r), flux / max(r2, F(1e-30f)));
        store(&to[i], select(mask<F>(flux > F(0)), r, F(0)));
    }
}

float OutlineTree::curve_target(const Elements &leaf, size_t k, const OutlineAnchor &from) {
    if (leaf.shape[k] == from.own) return 0;
    const V a = lane_of(leaf.a, k) - from.p;
    const float r = leaf.b[0][k], length = weight_of(leaf.weight[k], from) * 2 * pi * r;
    if (from.parallel) return length;
    const float squared = dot(a, a), distance = std::sqrt(squared);
    float seen = 1;
    if (distance > r) {
        const float sine = r / distance;
        alignas(64) float all[W];
        store(&all[0], scattered(from, widen(a * (1 / distance)), F(std::sqrt(1 - sine * sine)), F(sine)));
        seen = all[0];
    }
    return length / std::max(squared, r * r) * seen;
}

void OutlineTree::target(const Elements &leaf, const OutlineAnchor &from, float s, float (&to)[Wide]) {
    bool curves = false;
    for (size_t i = 0; i < Wide; i += W) {
        const Vec3<F> p = widen(from.p), a = from.parallel ? p : load_vector(leaf.a, i) - p;
        const Vec3<F> along = load_vector(leaf.b, i) - load_vector(leaf.a, i), d = from.parallel ? p : a + along * F(s);
        const IntOf<F> kind(load_uint<F>(reinterpret_cast<const uint32_t *>(&leaf.kind[i])));
        const F given = load<F>(&leaf.weight[i]), bend = load<F>(&leaf.bend[i]);
        const F weight = select(mask<F>(given < F(0)), given * F(-from.still), given);
        auto front = [&](const Column<float>(&n)[3]) { return mask<F>(dot(load_vector(n, i), d) < F(0)); };
        const M n0 = front(leaf.n0), n1 = front(leaf.n1), outline = (n0 && !n1) || (n1 && !n0);
        const F crease = select(mask<F>(kind == int32_t(OutlineElement::Crease)), max(F(0.05f), min(bend, F(1))), F(0));
        F kept = weight * select(outline || mask<F>(kind == int32_t(OutlineElement::Always)), F(1), crease);
        const F inverse = F(1) / max(norm(d), F(1e-30f));
        const F r =
            kept * norm(cross(d, along)) * inverse * inverse * inverse * scattered(from, d * inverse, F(1), F(0));
        const M round = mask<F>(kind == int32_t(OutlineElement::Round));
        curves |= any(round);
        store(&to[i], select(mask<F>(kept > F(0)) && !round, r, F(0)));
    }
    if (!curves) return;
    for (size_t k = 0; k < Wide; ++k)
        if (leaf.kind[k] == OutlineElement::Round && leaf.weight[k] != 0) to[k] = curve_target(leaf, k, from);
}

OutlineChoice OutlineTree::choose(const OutlineAnchor &from, uint64_t seed) const {
    Numbers numbers{seed};
    OutlineChoice choice{-1, 0, 0};
    float chosen = 0;
    double sum = 0;
    if (levels_.empty()) return choice;
    constexpr float any = 0.05f;  // none is left out altogether
    size_t at[Descents] = {};
    float probability[Descents];
    std::fill_n(probability, Descents, 1.f);
    Weights weights;
    // level by level, so that descents do not wait for each other
    for (size_t l = levels_.size(); l-- > 0;) {
        const bool root = l + 1 == levels_.size();
        for (size_t d = 0; d < Descents; ++d) {
            if (!(probability[d] > 0)) continue;
            if (!root || d == 0) {
                importance(levels_[l][at[d]], from, weights.each);
                weights.add_up();
            }
            if (!(weights.total() > 0)) {
                probability[d] = 0;
                continue;
            }
            const float u = numbers.single();
            const size_t k = u < any ? weights.pick_any(u / any) : weights.pick((u - any) / (1 - any));
            probability[d] *= (1 - any) * weights.each[k] / weights.total() + any / float(weights.positive());
            at[d] = at[d] * Wide + k;
        }
    }
    for (size_t d = 0; d < Descents; ++d) {
        if (!(probability[d] > 0)) continue;
        const float s = numbers.single();
        target(leaves_[at[d]], from, s, weights.each);
        if (!weights.add_up()) continue;
        const double share = double(weights.total()) / double(probability[d]);
        sum += share;
        if (numbers.uniform() * sum >= share) continue;
        const size_t k = weights.pick(numbers.single());
        choice.element = leaves_[at[d]].index[k], choice.s = s, chosen = weights.each[k];
    }
    if (choice.element >= 0) choice.inverse_density = float(sum / (double(Descents) * double(chosen)));
    return choice;
}

}  // namespace tr
