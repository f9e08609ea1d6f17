#include "outline_choice.h"

#include "../math/lanes.h"

namespace tr {

namespace {

constexpr float Grazing = 0.1f;  // the least share of what is at the face's horizon, which hardly moves before it
constexpr float Any = 0.05f;     // share of choices that leave nothing out
using V = Vec3<float>;
using F = PacketOf<float>;
using M = MaskOf<F>;
constexpr size_t W = size_t(Lanes<F>::Width);
constexpr float pi = float(Pi);
constexpr size_t Wide = OutlineWide, Aligned = W > 1 ? 64 : alignof(float);
static_assert(Wide % W == 0);

// Numbers of a counter (Steele et al., "Fast Splittable Pseudorandom Number Generators", 2014).
struct Numbers {
    uint64_t state;
    TR_HD uint64_t bits() {
        uint64_t z = (state += 0x9E3779B97F4A7C15ull);
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
        z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
        return z ^ (z >> 31);
    }
    TR_HD double uniform() { return double(bits() >> 11) * 0x1p-53; }
    TR_HD float single() { return float(bits() >> 40) * 0x1p-24f; }
};

TR_HD inline Vec3<F> widen(const V &v) { return {F(v.x), F(v.y), F(v.z)}; }

// What only weighs choices may be rough: roots and quotients as the processor estimates them, to 2^-14, and the greater
// and the lesser of numbers, without regard to what is not a number.
#if TR_HAS_PACKETS && defined(DRJIT_X86_AVX512)
TR_INLINE F rough_rsqrt(const F &x) { return F(_mm512_rsqrt14_ps(x.m)); }
TR_INLINE F rough_rcp(const F &x) { return F(_mm512_rcp14_ps(x.m)); }
TR_INLINE F greater(const F &x, const F &y) { return F(_mm512_max_ps(x.m, y.m)); }
TR_INLINE F lesser(const F &x, const F &y) { return F(_mm512_min_ps(x.m, y.m)); }
#else
TR_INLINE F rough_rsqrt(const F &x) { return rsqrt(x); }
TR_INLINE F rough_rcp(const F &x) { return F(1) / x; }
TR_INLINE F greater(const F &x, const F &y) { return max(x, y); }
TR_INLINE F lesser(const F &x, const F &y) { return min(x, y); }
#endif
TR_INLINE F rough_sqrt(const F &x) { return x * rough_rsqrt(greater(x, F(1e-30f))); }

TR_HD inline float weight_of(float given, const OutlineAnchor &from) { return given < 0 ? -given * from.still : given; }

// What about is scattered towards directions around the unit vector d, within an angle.
TR_INLINE F scattered(const OutlineAnchor &from, const Vec3<F> &d, const F &cos_angle, const F &sin_angle) {
    auto nearest = [&](const V &axis) {  // cosine of the least angle to `axis`
        const F c = greater(F(-1), lesser(F(1), dot(widen(axis), d)));
        const F turned = c * cos_angle + rough_sqrt(greater(F(0), F(1) - c * c)) * sin_angle;
        return select(mask<F>(c >= cos_angle), F(1), turned);
    };
    F cosine(1), grazing(1);
    if (squared_norm(from.n) > 0) {
        cosine = greater(F(0), nearest(from.n));
        grazing = greater(F(Grazing), lesser(F(1), nearest(from.ng) * rough_rcp(greater(cosine, F(1e-6f)))));
    }
    if (from.share <= 0) return cosine * grazing;
    // with a tail, as lobes of rough surfaces have
    const F lobe = rough_rcp(F(1) + (F(1) - nearest(from.axis)) * F(0.5f * from.k));
    return (cosine * F(1 - from.share + 0.02f * from.share) +
            select(mask<F>(cosine > F(0)), lobe * lobe * F(from.share), F(0))) *
           grazing;
}

#if TR_HAS_PACKETS
// Sums of numbers up to each; in a register where there is one, since what is stored piecewise is slow to load.
TR_HD inline void sum_up(const float (&each)[Wide], float (&sum)[Wide]) {
#if defined(DRJIT_X86_AVX512)
    const __m512i zero = _mm512_setzero_si512();
    __m512 v = _mm512_loadu_ps(each);
    auto add = [&](__m512i shifted) { v = _mm512_add_ps(v, _mm512_castsi512_ps(shifted)); };
    add(_mm512_alignr_epi32(_mm512_castps_si512(v), zero, 15));
    add(_mm512_alignr_epi32(_mm512_castps_si512(v), zero, 14));
    add(_mm512_alignr_epi32(_mm512_castps_si512(v), zero, 12));
    add(_mm512_alignr_epi32(_mm512_castps_si512(v), zero, 8));
    _mm512_storeu_ps(sum, v);
#else
    sum[0] = each[0];
    for (size_t k = 1; k < Wide; ++k) sum[k] = sum[k - 1] + each[k];
#endif
}
#endif

// Sixteen weights, none of them negative, added up; sums up to each are kept where there are packets. (A device has
// little room for what is a thread's own.)
struct Weights {
    alignas(Aligned) float each[Wide];
#if TR_HAS_PACKETS
    alignas(Aligned) float sum[Wide];
    TR_HD float total() const { return sum[Wide - 1]; }
#else
    float sum;
    TR_HD float total() const { return sum; }
#endif

    // False if they are all zero. What is not finite counts as that.
    TR_HD bool add_up() {
        for (size_t i = 0; i < Wide; i += W) {
            const F w = load<F>(&each[i]);
            store(&each[i], select(mask<F>(w > F(0)) && mask<F>(w < F(1e30f)), w, F(0)));
        }
#if TR_HAS_PACKETS
        sum_up(each, sum);
#else
        sum = 0;
        for (const float w : each) sum += w;
#endif
        return total() > 0;
    }
    // In proportion to the weights, for u in [0, 1).
    TR_HD size_t pick(float u) const {
        const F at(u * total());
        int k = 0;
#if TR_HAS_PACKETS
        for (size_t i = 0; i < Wide; i += W) k += count(mask<F>(load<F>(&sum[i]) <= at));
#else
        float upto = 0;
        for (const float w : each) upto += w, k += upto <= at;
#endif
        for (k = std::min(k, int(Wide) - 1); !(each[k] > 0); --k) {}  // by rounding
        return size_t(k);
    }
    // The same, but some of the time all that are not zero alike: the number among all children, for that of the
    // parent; returns its probability.
    TR_HD float choose(float u, size_t &number) const {
        const size_t k = u < Any ? pick_any(u / Any) : pick((u - Any) / (1 - Any));
        number = number * Wide + k;
        return (1 - Any) * each[k] / total() + Any / float(positive());
    }
    // All that are not zero alike.
    TR_HD size_t pick_any(float u) const {
        size_t at = size_t(u * float(positive())), k = 0;
        for (; k + 1 < Wide; ++k)
            if (each[k] > 0 && at-- == 0) break;
        return k;
    }
    TR_HD int positive() const {
        int n = 0;
        for (size_t i = 0; i < Wide; i += W) n += count(mask<F>(load<F>(&each[i]) > F(0)));
        return n;
    }
};

// Of the edges of a leaf: a place along each, what it is chosen in proportion to, and that over the place's density.
struct Candidates {
    Weights weights;
    alignas(Aligned) float s[Wide], target[Wide];
};

// Whether some are near; then, what these may be at most.
TR_HD inline bool importance(const OutlineNodes &nodes, const OutlineAnchor &from, float (&to)[Wide],
                             float (&near)[Wide]) {
    auto inverse_square = [](const F &x) {
        const F r = rough_rsqrt(greater(x, F(1e-30f)));
        return r * r;
    };
    bool some = false;
    for (size_t i = 0; i < Wide; i += W) {
        const F flux = load<F>(&nodes.flux[i]) + load<F>(&nodes.still[i]) * F(from.still),
                radius = from.parallel ? F(0) : load<F>(&nodes.radius[i]);
        const Vec3<F> d = from.parallel ? widen(from.p) : load_vector<F>(nodes.center, i) - widen(from.p);
        const F squared = squared_norm(d), r2 = radius * radius;
        const M counts = mask<F>(flux > F(0)), outside = mask<F>(squared > r2);
        const F inverse = rough_rsqrt(greater(squared, F(1e-30f)));
        const F sin_angle = lesser(radius * inverse, F(1)), cos_angle = rough_sqrt(F(1) - sin_angle * sin_angle);
        const Vec3<F> direction = d * inverse;
        // all faces are seen from one side if the axis is further than both angles from across
        const F cone = load<F>(&nodes.cosine[i]), spread = load<F>(&nodes.sine[i]);
        const F cosine = cone * cos_angle - spread * sin_angle, sine = spread * cos_angle + cone * sin_angle;
        const M bounded = mask<F>(cone > F(0)) && mask<F>(cosine > F(0));
        const M none = bounded && mask<F>(abs(dot(load_vector<F>(nodes.axis, i), direction)) > sine);
        // where normals and directions spread less than in all directions, more of what may be an outline is one
        const F narrow = select(bounded, lesser(F(50), rough_rsqrt(greater(sine * sine, F(1e-30f)))), F(1));
        const F r = flux * narrow * inverse * inverse * scattered(from, direction, cos_angle, sin_angle);
        store(&to[i], select(counts, select(outside, select(none, F(0), r), flux * inverse_square(r2)), F(0)));
        const M close = counts && mask<F>(squared < F(2.f) * r2);
        if (!any(close)) continue;
        // what it may be, if all of it is where the ball comes closest
        for (size_t k = 0; !some && k < Wide; ++k) near[k] = 0;
        some = true;
        const F gap = greater(F(0), squared * inverse - radius);
        store(near + i, select(close && !none, flux * inverse_square(gap * gap + F(0.01f) * r2), F(0)));
    }
    return some;
}

TR_HD inline float curve_target(const OutlineLeaf &leaf, size_t k, const OutlineAnchor &from) {
    if (leaf.shape[k] == from.own) return 0;
    const V a = lane_of(leaf.a, k) - from.p;
    const float r = leaf.b[0][k], length = weight_of(leaf.weight[k], from) * 2 * pi * r;
    if (from.parallel) return length;
    const float squared = dot(a, a), distance = std::sqrt(squared);
    float seen = 1;
    if (distance > r) {
        const float sine = r / distance;
        alignas(Aligned) float all[W];
        store(&all[0], scattered(from, widen(a * (1 / distance)), F(std::sqrt(1 - sine * sine)), F(sine)));
        seen = all[0];
    }
    return length / std::max(squared, r * r) * seen;
}

// A place along each of the edges from one random number, in proportion to sin / r^2 where that varies: with l along
// the line from its point next to `from`, h away, the integral of h / r^3 is l / (h r).
TR_NOINLINE void propose(const OutlineTreeView &tree, size_t number, const OutlineAnchor &from, float u,
                         Candidates &to) {
    OutlineLeaf space;
    LeafRounding rounding;
    const OutlineLeaf &leaf = tree.leaves.get(number, space, rounding);
    bool curves = false;
    for (size_t i = 0; i < Wide; i += W) {
        const Vec3<F> p = widen(from.p), along = load_vector<F>(leaf.b, i) - load_vector<F>(leaf.a, i);
        const Vec3<F> a = from.parallel ? p : load_vector<F>(leaf.a, i) - p;
        F s(u), spread(1);  // one over the density of s
        if (!from.parallel) {
            const F squared = greater(squared_norm(along), F(1e-30f)), inverse = rsqrt(squared);
            const F length = squared * inverse, l0 = dot(a, along) * inverse, l1 = l0 + length;
            const F h2 = greater(squared_norm(cross(a, along)) * inverse * inverse, F(1e-30f));
            const F x0 = l0 * rsqrt(l0 * l0 + h2), dx = l1 * rsqrt(l1 * l1 + h2) - x0, x = x0 + dx * F(u);
            const F l = x * sqrt(h2 / greater(F(1e-12f), (F(1) - x) * (F(1) + x)));
            const F r2 = l * l + h2;
            const M varies = mask<F>(dx > F(0.01f)) && mask<F>(l > l0) && mask<F>(l < l1);
            s = select(varies, (l - l0) * inverse, s);
            spread = select(varies, dx * r2 * sqrt(r2) * inverse / h2, spread);
        }
        const Vec3<F> d = from.parallel ? p : a + along * s;
        const F given = load<F>(&leaf.weight[i]), bend = load<F>(&leaf.bend[i]);
        const F weight = select(mask<F>(given < F(0)), given * F(-from.still), given);
        const F n0 = dot(load_vector<F>(leaf.n0, i), d), n1 = dot(load_vector<F>(leaf.n1, i), d),
                distance2 = squared_norm(d), inverse = rough_rsqrt(greater(distance2, F(1e-30f)));
        const M unknown =
            mask<F>(lesser(abs(n0), abs(n1)) <= distance2 * inverse * F(rounding.normal) + F(rounding.place));
        const M in0 = mask<F>(n0 < F(0)), in1 = mask<F>(n1 < F(0)), outline = (in0 && !in1) || (in1 && !in0) || unknown;
        const F crease = select(leaf.are<F>(OutlineElement::Crease, i), greater(F(0.05f), lesser(bend, F(1))), F(0));
        F kept = weight * select(outline || leaf.are<F>(OutlineElement::Always, i), F(1), crease);
        const F r = kept * rough_sqrt(squared_norm(cross(d, along))) * inverse * inverse * inverse *
                    scattered(from, d * inverse, F(1), F(0));
        const M round = leaf.are<F>(OutlineElement::Round, i);
        curves |= any(round);
        const F target = select(mask<F>(kept > F(0)) && !round, r, F(0));
        store(&to.s[i], s), store(&to.target[i], target), store(&to.weights.each[i], target * spread);
    }
    for (size_t k = 0; curves && k < Wide; ++k)
        if (leaf.kind[k] == OutlineElement::Round && leaf.weight[k] != 0)
            to.s[k] = u, to.weights.each[k] = to.target[k] = curve_target(leaf, k, from);
}

// A node, or at level -1 an edge and a place along it, see Candidates; and the probability to be there.
struct Place {
    int level = 0;
    size_t index = 0;
    float weight = 0, probability = 0, s = 0, target = 0;
};

// Nodes that have been looked into. Those that are near, of which no estimate is good, are replaced by their children,
// those first that may be most important: Conty Estevez and Kulla's adaptive splitting, up to a number of nodes. What
// is left is one distribution over nodes and, of leaves that were split, edges, with places along them that `draw`
// chooses.
class Front {
public:
    TR_HD Front(const OutlineTreeView &tree, const OutlineAnchor &from) : tree_(tree), from_(from) {
        add(tree.n_levels - 1, 0);
        while (n_ <= Splits && n_near_ > 0) {
            Near *most = near_;
            for (size_t k = 1; k < n_near_; ++k)
                if (most->most < near_[k].most) most = near_ + k;
            const Near chosen = *most;
            *most = near_[--n_near_];
            Group &group = groups_[chosen.group];
            group.weights().each[chosen.k] = 0;
            add(group.level - 1, group.number * Wide + chosen.k);
        }
        for (size_t g = 0; g < n_; ++g)
            if (groups_[g].level >= 0) groups_[g].add_up();
    }

    TR_HD void draw(float u) {
        u_ = u, total_ = 0, positive_ = 0;
        for (size_t g = 0; g < n_; ++g) {
            Group &group = groups_[g];
            if (group.level < 0) group.propose(tree_, from_, u);
            if (group.positive > 0) total_ += group.weights().total(), positive_ += group.positive;
        }
    }

    // A node of the level, or an edge of a leaf at level -1; false if there is none.
    TR_HD bool pick(float u, Place &to) const {
        if (!(total_ > 0)) return false;
        const bool even = u < Any;
        float left = even ? u / Any * float(positive_) : (u - Any) / (1 - Any) * total_, all = 0;
        const Group *found = nullptr;
        for (const Group *g = groups_; g < groups_ + n_; ++g) {
            if (g->positive == 0) continue;
            if (found && left < all) break;
            if (found) left -= all;
            found = g, all = even ? float(g->positive) : g->weights().total();
        }
        const float at = std::min(std::max(left / all, 0.f), 1 - 0x1p-24f);
        const Weights &weights = found->weights();
        const size_t k = even ? weights.pick_any(at) : weights.pick(at);
        to.level = found->level, to.index = found->number * Wide + k, to.weight = weights.each[k];
        if (to.level < 0) found->find_place(tree_, from_, u_, k, to);
        to.probability = (1 - Any) * weights.each[k] / total_ + Any / float(positive_);
        return true;
    }

private:
    static constexpr size_t Splits = 32, MostNear = 128;
    // The children of a node or, at level -1, the edges of a leaf; places along these are kept where there are packets.
    struct Group {
#if TR_HAS_PACKETS
        Candidates nodes;
        TR_HD Weights &weights() { return nodes.weights; }
        TR_HD const Weights &weights() const { return nodes.weights; }
#else
        Weights nodes;
        TR_HD Weights &weights() { return nodes; }
        TR_HD const Weights &weights() const { return nodes; }
#endif
        int level, positive;
        size_t number;

        TR_HD void add_up() { positive = weights().add_up() ? weights().positive() : 0; }
        TR_HD void propose(const OutlineTreeView &tree, const OutlineAnchor &from, float u) {
#if TR_HAS_PACKETS
            tr::propose(tree, number, from, u, nodes);
#else
            Candidates all;
            tr::propose(tree, number, from, u, all);
            nodes = all.weights;
#endif
            add_up();
        }
        TR_HD void find_place(const OutlineTreeView &tree, const OutlineAnchor &from, float u, size_t k,
                              Place &to) const {
#if TR_HAS_PACKETS
            (void)tree, (void)from, (void)u;
            to.s = nodes.s[k], to.target = nodes.target[k];
#else
            Candidates all;
            tr::propose(tree, number, from, u, all);
            to.s = all.s[k], to.target = all.target[k];
#endif
        }
    };
    struct Near {
        float most;
        uint16_t group, k;
    };
    TR_HD void add(int level, size_t number) {
        Group &g = groups_[n_++];
        g.level = level, g.number = number;
        if (level < 0) return;
        alignas(Aligned) float near[Wide];
        if (!importance(tree_.levels[level][number], from_, g.weights().each, near)) return;
        for (size_t k = 0; k < Wide; ++k)
            if (near[k] > 0 && n_near_ < MostNear) near_[n_near_++] = {near[k], uint16_t(n_ - 1), uint16_t(k)};
    }

    const OutlineTreeView &tree_;
    const OutlineAnchor &from_;
    Group groups_[Splits + 1];
    Near near_[MostNear];
    size_t n_ = 0, n_near_ = 0;
    float u_ = 0, total_ = 0;
    int positive_ = 0;
};

TR_HD inline OutlineChoice choose_below(const OutlineTreeView &tree, const Front &front, const OutlineAnchor &from,
                                        uint64_t seed, size_t descents) {
    OutlineChoice choice{-1, 0, 0};
    Numbers numbers{seed};
    Place places[MostOutlineDescents];
    const float u = numbers.single();  // spread evenly over what the front has
    for (size_t i = 0; i < descents; ++i)
        if (!front.pick((float(i) + u) / float(descents), places[i])) return choice;
    Candidates candidates;
    Weights &weights = candidates.weights;
    alignas(Aligned) float near[Wide];
    // level by level, so that descents do not wait for each other
    for (int l = tree.n_levels - 1; l-- > 0;)
        for (size_t i = 0; i < descents; ++i) {
            Place &place = places[i];
            if (place.level != l + 1 || !(place.probability > 0)) continue;
            importance(tree.levels[l][place.index], from, weights.each, near);
            place.probability *= weights.add_up() ? weights.choose(numbers.single(), place.index) : 0;
            place.level = l;
            if (l == 0) tree.leaves.prefetch(place.index);
        }
    double sum = 0;
    float target = 0;
    for (size_t i = 0; i < descents; ++i) {
        Place &place = places[i];
        if (place.level == 0 && place.probability > 0) {
            const size_t leaf = place.index;
            propose(tree, leaf, from, numbers.single(), candidates);
            if (!weights.add_up()) continue;
            const size_t k = weights.pick(numbers.single());
            place.index = leaf * Wide + k, place.probability *= weights.each[k] / weights.total();
            place.weight = weights.each[k], place.s = candidates.s[k], place.target = candidates.target[k];
        }
        if (!(place.probability > 0)) continue;
        const double share = double(place.weight) / double(place.probability);
        sum += share;
        if (numbers.uniform() * sum >= share) continue;
        choice.element = tree.leaves.index(place.index / Wide, place.index % Wide);
        choice.s = place.s, target = place.target;
    }
    if (choice.element >= 0) choice.inverse_density = float(sum / (double(descents) * double(target)));
    return choice;
}

}  // namespace

TR_LARGE void choose_outlines(const OutlineTreeView &tree, const OutlineAnchor &from, uint64_t seed, size_t descents,
                              OutlineChoice *choices, size_t n) {
    for (size_t j = 0; j < n; ++j) choices[j] = {-1, 0, 0};
    if (tree.n_levels == 0 || n == 0) return;
    Front front(tree, from);
    Numbers numbers{seed};
    const float u = numbers.single();
    for (size_t j = 0; j < n; ++j) {
        front.draw((float(j) + u) / float(n));
        choices[j] = choose_below(tree, front, from, numbers.bits(), descents);
    }
}

}  // namespace tr
