#include "outline_leaves.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace tr {

namespace {

constexpr float Places = 65535, Normals = 32767, Weights = 127;
constexpr float Half = 0.5f;  // makes cutting off the fraction rounding, of what is not negative

using V = Vec3<float>;
using F = PacketOf<float>;
using M = MaskOf<F>;
constexpr size_t W = size_t(Lanes<F>::Width);

// A packet of integers as floating point; and, of such that are not negative, without their fractions, back.
#if TR_HAS_PACKETS && defined(DRJIT_X86_AVX512)
F numbers(const uint16_t *at) {
    return F(_mm512_cvtepi32_ps(_mm512_cvtepu16_epi32(_mm256_loadu_si256(reinterpret_cast<const __m256i *>(at)))));
}
F numbers(const int16_t *at) {
    return F(_mm512_cvtepi32_ps(_mm512_cvtepi16_epi32(_mm256_loadu_si256(reinterpret_cast<const __m256i *>(at)))));
}
void store_whole(const F &x, uint16_t *to) {
    const __m256i whole = _mm512_cvtepi32_epi16(_mm512_cvttps_epi32(x.m));
    _mm256_storeu_si256(reinterpret_cast<__m256i *>(to), whole);
}
#else
template <class T>
F numbers(const T *at) {
    alignas(64) float all[W];
    for (size_t k = 0; k < W; ++k) all[k] = float(int32_t(at[k]));
    return load<F>(all);
}
void store_whole(const F &x, uint16_t *to) {
    alignas(64) float all[W];
    store(all, x);
    for (size_t k = 0; k < W; ++k) to[k] = uint16_t(int32_t(all[k]));
}
#endif

// From 0 to 62, for numbers up to 1: their exponent and the first bit behind it; and back, the middle of these.
constexpr uint32_t BendShift = 22, LeastBend = (127 - 31) << 1;
uint8_t packed_bend(float bend) {
    uint32_t bits;
    std::memcpy(&bits, &bend, sizeof(bits));
    return uint8_t(std::max(bits >> BendShift, LeastBend) - LeastBend);
}
float unpacked_bend(uint32_t packed) {
    const uint32_t bits = packed == 0 ? 0 : (packed + LeastBend) << BendShift | 1u << (BendShift - 1);
    float bend;
    std::memcpy(&bend, &bits, sizeof(bend));
    return bend;
}

}  // namespace

void OutlineLeaves::Elements::set(size_t k, const OutlineElement &e) {
    put_lane(e.a, a, k), put_lane(e.b, b, k), put_lane(e.n0, n0, k), put_lane(e.n1, n1, k);
    weight[k] = e.moves ? e.weight : -e.weight, bend[k] = e.bend;
    kind[k] = e.kind, shape[k] = e.shape, index[k] = e.index;
}

OutlineLeaves::Box OutlineLeaves::Elements::box() const {
    Vec3<F> least{F(INFINITY), F(INFINITY), F(INFINITY)}, most = -least;
    for (size_t i = 0; i < Wide; i += W) {
        const M counts = mask<F>(load<F>(&weight[i]) != F(0));
        const M round = are<F>(OutlineElement::Round, i);
        const Vec3<F> from = load_vector<F>(a, i), to = load_vector<F>(b, i);
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

OutlineElement OutlineLeaves::Elements::get(size_t k) const {
    return {lane_of(a, k), lane_of(b, k), lane_of(n0, k), lane_of(n1, k), std::fabs(weight[k]),
            bend[k],       kind[k],       shape[k],       index[k],       weight[k] > 0};
}

void OutlineLeaves::resize(size_t n_elements, size_t n_rounded) {
    exact_.resize((n_elements + Wide - 1) / Wide);
    rounded_.resize((n_rounded + Wide - 1) / Wide);
}

void OutlineLeaves::set(size_t leaf, const Elements &elements, const Box &box) {
    if (leaf < exact_.size())
        exact_[leaf] = elements;
    else
        rounded_[leaf - exact_.size()] = pack(elements, box);
}

OutlineLeaves::Rounded OutlineLeaves::pack(const Elements &from, const Box &box) {
    Rounded to;
    V low = box.low, high = box.high;
    if (!(low.x <= high.x)) low = high = {0, 0, 0};
    to.step = std::max(std::max({high.x - low.x, high.y - low.y, high.z - low.z}) / Places, 1e-30f);
    const float corner[3] = {low.x, low.y, low.z}, inverse = 1 / to.step;
    for (size_t c = 0; c < 3; ++c) {
        to.corner[c] = corner[c];
        for (size_t i = 0; i < Wide; i += W) {
            auto round = [&](const Column<float> &x) {
                return min(max((load<F>(&x[i]) - F(corner[c])) * F(inverse), F(0)) + F(Half), F(Places));
            };
            store_whole(round(from.a[c]), &to.a[c][i]), store_whole(round(from.b[c]), &to.b[c][i]);
        }
    }
    // of a face whose normal is too short to be one nobody knows which side is seen
    alignas(64) float known[Wide];
    std::fill_n(known, Wide, 1.f);
    auto flatten = [&](const Column<float>(&n)[3], Column<int16_t>(&r)[2]) {
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

void OutlineLeaves::unpack(const Rounded &from, Elements &to, Rounding &rounding) {
    // half a step of x and of y, and what both make of z, for a vector that is not longer than 1; half a step of each
    // coordinate, and what sums in single precision leave out
    const float far = std::max({std::fabs(from.corner[0]), std::fabs(from.corner[1]), std::fabs(from.corner[2])});
    rounding = {1.4f / Normals, from.step + 1.2e-7f * far};
    const F step(from.step);
    for (size_t i = 0; i < Wide; i += W) {
        for (size_t c = 0; c < 3; ++c) {
            const F corner(from.corner[c]);
            store(&to.a[c][i], corner + numbers(&from.a[c][i]) * step);
            store(&to.b[c][i], corner + numbers(&from.b[c][i]) * step);
        }
        auto unfold = [&](const Column<int16_t>(&n)[2], Column<float>(&r)[3]) {
            const F x = numbers(&n[0][i]) * F(1 / Normals), y = numbers(&n[1][i]) * F(1 / Normals);
            const F z = F(1) - abs(x) - abs(y), below = max(F(0), -z);
            store(&r[0][i], x + select(mask<F>(x < F(0)), below, -below));
            store(&r[1][i], y + select(mask<F>(y < F(0)), below, -below));
            store(&r[2][i], z);
        };
        unfold(from.n0, to.n0), unfold(from.n1, to.n1);
    }
    for (size_t k = 0; k < Wide; ++k) to.weight[k] = float(from.weight[k]) * (1 / Weights);
    for (size_t k = 0; k < Wide; ++k) to.bend[k] = unpacked_bend(from.kind[k] & 63u);
    for (size_t k = 0; k < Wide; ++k) to.kind[k] = from.kind[k] >> 6;
    std::fill_n(to.shape, Wide, -2);
    std::copy_n(from.index, Wide, to.index);
}

}  // namespace tr
