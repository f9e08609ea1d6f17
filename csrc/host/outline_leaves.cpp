#include "outline_leaves.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace tr {

namespace {

constexpr float Places = RoundedLeaf::Places, Normals = RoundedLeaf::Normals, Weights = RoundedLeaf::Weights;
constexpr size_t Wide = OutlineWide;
constexpr float Half = 0.5f;  // makes cutting off the fraction rounding, of what is not negative

using V = Vec3<float>;
using F = PacketOf<float>;
using M = MaskOf<F>;
constexpr size_t W = size_t(Lanes<F>::Width);

// Of a packet of numbers that are not negative: integers, without their fractions.
#if TR_HAS_PACKETS && defined(DRJIT_X86_AVX512)
void store_whole(const F &x, uint16_t *to) {
    const __m256i whole = _mm512_cvtepi32_epi16(_mm512_cvttps_epi32(x.m));
    _mm256_storeu_si256(reinterpret_cast<__m256i *>(to), whole);
}
#else
void store_whole(const F &x, uint16_t *to) {
    alignas(64) float all[W];
    store(all, x);
    for (size_t k = 0; k < W; ++k) to[k] = uint16_t(int32_t(all[k]));
}
#endif

uint8_t packed_bend(float bend) {
    uint32_t bits;
    std::memcpy(&bits, &bend, sizeof(bits));
    return uint8_t(std::max(bits >> RoundedLeaf::BendShift, RoundedLeaf::LeastBend) - RoundedLeaf::LeastBend);
}

RoundedLeaf pack(const OutlineLeaf &from, const LeafBox &box) {
    RoundedLeaf to;
    V low = box.low, high = box.high;
    if (!(low.x <= high.x)) low = high = {0, 0, 0};
    to.step = std::max(std::max({high.x - low.x, high.y - low.y, high.z - low.z}) / Places, 1e-30f);
    const float corner[3] = {low.x, low.y, low.z}, inverse = 1 / to.step;
    for (size_t c = 0; c < 3; ++c) {
        to.corner[c] = corner[c];
        for (size_t i = 0; i < Wide; i += W) {
            auto round = [&](const OutlineColumn<float> &x) {
                return min(max((load<F>(&x[i]) - F(corner[c])) * F(inverse), F(0)) + F(Half), F(Places));
            };
            store_whole(round(from.a[c]), &to.a[c][i]), store_whole(round(from.b[c]), &to.b[c][i]);
        }
    }
    // of a face whose normal is too short to be one nobody knows which side is seen
    alignas(64) float known[Wide];
    std::fill_n(known, Wide, 1.f);
    auto flatten = [&](const OutlineColumn<float>(&n)[3], OutlineColumn<int16_t>(&r)[2]) {
        alignas(64) float flat[2][Wide];
        for (size_t i = 0; i < Wide; i += W) {
            const F nx = load<F>(&n[0][i]), ny = load<F>(&n[1][i]), nz = load<F>(&n[2][i]);
            const F size = abs(nx) + abs(ny) + abs(nz), scale = F(1) / max(size, F(0.5f));
            const F x = nx * scale, y = ny * scale;
            const M below = mask<F>(nz < F(0));
            const F turned_x = select(mask<F>(x < F(0)), abs(y) - F(1), F(1) - abs(y));
            const F turned_y = select(mask<F>(y < F(0)), abs(x) - F(1), F(1) - abs(x));
            store(&flat[0][i], select(below, turned_x, x)), store(&flat[1][i], select(below, turned_y, y));
            store(&known[i], select(mask<F>(size > F(0.5f)), load<F>(&known[i]), F(0)));
        }
        for (size_t c = 0; c < 2; ++c)
            for (size_t k = 0; k < Wide; ++k) r[c][k] = int16_t(int32_t(flat[c][k] * Normals + Normals + Half) - 32767);
    };
    flatten(from.n0, to.n0), flatten(from.n1, to.n1);
    for (size_t k = 0; k < Wide; ++k) {
        const float weight = from.weight[k], bend = std::min(std::max(from.bend[k], 0.f), 1.f);
        const int32_t kind = known[k] > 0 ? from.kind[k] : int32_t(OutlineElement::Always);
        const int32_t size = std::max(1, int32_t(std::min(std::fabs(weight), 1.f) * Weights + Half));
        to.weight[k] = int8_t(weight > 0 ? size : weight < 0 ? -size : 0);
        to.kind[k] = uint8_t(kind << 6 | packed_bend(bend));
        to.index[k] = from.index[k];
    }
    return to;
}

}  // namespace

void set_element(OutlineLeaf &leaf, size_t k, const OutlineElement &e) {
    put_lane(e.a, leaf.a, k), put_lane(e.b, leaf.b, k), put_lane(e.n0, leaf.n0, k), put_lane(e.n1, leaf.n1, k);
    leaf.weight[k] = e.moves ? e.weight : -e.weight, leaf.bend[k] = e.bend;
    leaf.kind[k] = e.kind, leaf.shape[k] = e.shape, leaf.index[k] = e.index;
}

LeafBox box_of(const OutlineLeaf &leaf) {
    Vec3<F> least{F(INFINITY), F(INFINITY), F(INFINITY)}, most = -least;
    for (size_t i = 0; i < Wide; i += W) {
        const M counts = mask<F>(load<F>(&leaf.weight[i]) != F(0));
        const M round = leaf.are<F>(OutlineElement::Round, i);
        const Vec3<F> from = load_vector<F>(leaf.a, i), to = load_vector<F>(leaf.b, i);
        const F radius = select(round, to.x, F(0));
        auto include = [&](const F &x, const F &y, F &below, F &above) {
            const F first = x - radius, last = select(round, x + radius, y);
            below = min(select(counts, min(first, last), F(INFINITY)), below);  // NaN: leaves it as it is
            above = max(select(counts, max(first, last), F(-INFINITY)), above);
        };
        include(from.x, to.x, least.x, most.x), include(from.y, to.y, least.y, most.y);
        include(from.z, to.z, least.z, most.z);
    }
    return {{least_of(least.x), least_of(least.y), least_of(least.z)},
            {greatest_of(most.x), greatest_of(most.y), greatest_of(most.z)}};
}

OutlineElement element_of(const OutlineLeaf &leaf, size_t k) {
    return {lane_of(leaf.a, k), lane_of(leaf.b, k), lane_of(leaf.n0, k), lane_of(leaf.n1, k), std::fabs(leaf.weight[k]),
            leaf.bend[k],       leaf.kind[k],       leaf.shape[k],       leaf.index[k],       leaf.weight[k] > 0};
}

void OutlineLeafStore::resize(size_t n_elements, size_t n_rounded) {
    exact_.resize((n_elements + Wide - 1) / Wide);
    rounded_.resize((n_rounded + Wide - 1) / Wide);
}

void OutlineLeafStore::set(size_t leaf, const OutlineLeaf &elements, const LeafBox &box) {
    if (leaf < exact_.size())
        exact_[leaf] = elements;
    else
        rounded_[leaf - exact_.size()] = pack(elements, box);
}

}  // namespace tr
