#include "sdf_grid.h"

#include "core/math/rows.h"
#include "core/shape/sdfgrid.h"

namespace tr {

namespace {

using F = PacketIo::F;
using U = PacketIo::U;
using M = PacketIo::M;
using I = IntOf<F>;
constexpr size_t W = PacketIo::W;

I choose(const M &m, const I &a, const I &b) { return select(mask<I>(m), a, b); }

// c0 + c1 s + c2 s^2 + c3 s^3 from s = 0 to 1.
struct Cubic {
    F c0, c1, c2, c3;

    F at(const F &s) const { return fmadd(fmadd(fmadd(c3, s, c2), s, c1), s, c0); }
    F slope(const F &s) const { return fmadd(fmadd(F(3) * c3, s, F(2) * c2), s, c1); }

    // Its extrema between 0 and 1 in order; 1 in place of those that are not.
    void extrema(F &first, F &second) const {
        F a = F(3) * c3, b = c2, square = b * b - a * c1;
        F q = -(b + mulsign(sqrt(max(square, F(0))), b));
        F r = q / a, s = c1 / q;  // infinite or NaN: none
        auto keep = [&](const F &x) {
            return select(mask<F>(square > F(0)) && mask<F>(x > F(0)) && mask<F>(x < F(1)), x, F(1));
        };
        r = keep(r), s = keep(s);
        first = min(r, s), second = max(r, s);
    }

    // The first place where it is on the other side than `side`, which the ray was on before; where there is none is
    // left out of `lanes`.
    F first_root(const F &side, M &lanes) const {
        F e1, e2;
        extrema(e1, e2);
        auto other = [&](const F &s) { return mask<F>(side * at(s) < F(0)); };
        const M by_first = other(e1), by_second = other(e2), by_end = other(F(1));
        lanes = lanes && (by_first || by_second || by_end);
        F low = select(by_first, F(0), select(by_second, e1, e2)),
          high = select(by_first, e1, select(by_second, e2, F(1)));
        F v_low = at(low), v_high = at(high), change = v_low - v_high;
        F s = low + (high - low) * (v_low / select(mask<F>(change == F(0)), F(1), change));
        M open = lanes;
        for (int step = 0; step < 24 && any(open); ++step) {
            s = max(low, min(high, s));
            F v = at(s), d = slope(s);
            M before = mask<F>(v * side > F(0));
            low = select(open && before, s, low);
            high = select(open && !before, s, high);
            F next = s - v / select(mask<F>(d == F(0)), F(1), d);
            M inside = mask<F>(next >= low) && mask<F>(next <= high) && mask<F>(d != F(0));
            next = select(inside, next, F(0.5) * (low + high));
            F apart = abs(next - s);
            s = select(open, next, s);
            open = open && mask<F>(apart > F(1e-7f)) && mask<F>(v != F(0));
        }
        return s;
    }
};

}  // namespace

template <bool Occlusion>
PacketIo::M SdfGrid::walk(const PacketIo::Rays &rays, Found &found) const {
    M hit(false);
    const Vec3<F> local_o = transform_point(to_object_, rays.o), local_d = transform_vector(to_object_, rays.d);
    const F os[3] = {local_o.x, local_o.y, local_o.z}, ds[3] = {local_d.x, local_d.y, local_d.z};
    F o[3], d[3], inverse[3], enter(0), leave = rays.tmax;
    M forward[3];
    const F scale(float(std::max(cells_[0], std::max(cells_[1], cells_[2]))));
    // a direction without zeros: what changes by so little does not change
    F tiny = max(max_abs(local_d) * scale * F(1e-12f), F(1e-37f));
    for (int a = 0; a < 3; ++a) {
        o[a] = os[a] * F(float(cells_[a]));
        d[a] = ds[a] * F(float(cells_[a]));
        d[a] = select(mask<F>(abs(d[a]) < tiny), mulsign(tiny, d[a]), d[a]);
        inverse[a] = F(1) / d[a];
        forward[a] = mask<F>(d[a] > F(0));
        F low = (F(float(first_[a])) - o[a]) * inverse[a], high = (F(float(last_[a] + 1)) - o[a]) * inverse[a];
        enter = max(enter, min(low, high));
        leave = min(leave, max(low, high));
    }
    M open = rays.valid && mask<F>(enter <= leave);
    if (!any(open)) return hit;

    auto cell_at = [&](int a, const F &t, const I &low, const I &high) {
        F x = max(F(-1), min(F(2e9f), fmadd(t, d[a], o[a])));
        return max(low, min(high, I(floor(x))));
    };
    I cell[3];
    for (int a = 0; a < 3; ++a) cell[a] = cell_at(a, enter, I(first_[a]), I(last_[a]));
    F t = enter, side(0);
    while (any(open)) {
        U index = U((cell[2] * cells_[1] + cell[1]) * cells_[0] + cell[0]);
        U word = gather<U>(empty_.data(), index >> 2, mask<U>(open));
        I empty = I((word >> ((index & 3u) * 8u)) & 255u);
        M full = open && mask<F>(empty == 0);
        I size = choose(full, I(1), empty), low[3];
        F to[3];
        for (int a = 0; a < 3; ++a) {
            low[a] = cell[a] & (I(0) - size);
            to[a] = (F(choose(forward[a], low[a] + size, low[a])) - o[a]) * inverse[a];
        }
        F out = max(t, min(min(to[0], to[1]), min(to[2], leave)));
        if (any(full)) {
            // f along the ray from t to out, in parts of this way
            F corner[8], at[3], along[3], length = out - t;
            I base = cell[2] * stride_[2] + cell[1] * stride_[1] + cell[0];
            for (int b = 0; b < 8; b += 2) {
                F row[2];
                gather_rows<F>(values_, U(base + ((b >> 1 & 1) * stride_[1] + (b >> 2) * stride_[2])), full, row);
                corner[b] = row[0], corner[b + 1] = row[1];
            }
            for (int a = 0; a < 3; ++a) {
                at[a] = fmadd(t, d[a], o[a]) - F(cell[a]);
                along[a] = d[a] * length;
            }
            SdfCorners<F> f(corner);
            f.evaluate(at);
            Cubic c{
                f.value, f.slope[0] * along[0] + f.slope[1] * along[1] + f.slope[2] * along[2],
                f.mixed[0] * along[1] * along[2] + f.mixed[1] * along[2] * along[0] + f.mixed[2] * along[0] * along[1],
                f.all * along[0] * along[1] * along[2]};
            // The side the ray is on is kept from cell to cell, so that none slips through where they meet.
            side = select(full && mask<F>(side == F(0)), select(mask<F>(c.c0 < F(0)), F(-1), F(1)), side);
            M behind = full && mask<F>(side * c.c0 < F(0)), crossing = full && !behind;
            F s = c.first_root(side, crossing);
            M met = behind || crossing;
            if constexpr (!Occlusion) {
                if (any(met)) {
                    s = select(behind, F(0), s);
                    for (int a = 0; a < 3; ++a) at[a] = max(F(0), min(F(1), fmadd(s, along[a], at[a])));
                    f.evaluate(at);
                    F steep[3] = {abs(f.slope[0]), abs(f.slope[1]), abs(f.slope[2])};
                    M x = mask<F>(steep[0] >= steep[1]) && mask<F>(steep[0] >= steep[2]);
                    M y = !x && mask<F>(steep[1] >= steep[2]);
                    U axis = select(mask<U>(x), U(0u), select(mask<U>(y), U(1u), U(2u)));
                    I code = (cell[2] << bits_[1] | cell[1]) << bits_[0] | cell[0];
                    found.t = select(met, fmadd(s, length, t), found.t);
                    found.b1 = select(met, select(x, at[1], select(y, at[2], at[0])), found.b1);
                    found.b2 = select(met, select(x, at[2], select(y, at[0], at[1])), found.b2);
                    found.primitive = select(mask<U>(met), (U(code) << SdfCellBits::Axis) | axis, found.primitive);
                }
            }
            hit = hit || met;
            open = open && !met;
        }
        // to the block behind, never back, though rounding would have it
        M by_x = mask<F>(to[0] <= to[1]) && mask<F>(to[0] <= to[2]), by_y = !by_x && mask<F>(to[1] <= to[2]);
        const M by[3] = {by_x, by_y, !by_x && !by_y};
        M inside(true);
        for (int a = 0; a < 3; ++a) {
            I end = low[a] + size - 1, next = choose(forward[a], end + 1, low[a] - 1);
            I beside = cell_at(a, out, choose(forward[a], cell[a], low[a]), choose(forward[a], end, cell[a]));
            cell[a] = choose(open, choose(by[a], next, beside), cell[a]);
            inside = inside && mask<F>(cell[a] >= first_[a]) && mask<F>(cell[a] <= last_[a]);
        }
        t = out;
        open = open && mask<F>(t < leave) && inside;
    }
    return hit;
}

void SdfGrid::intersect(const RayBatch &rays, const HitBatch &hits, size_t n) const {
    for (size_t i = 0; i < n; i += W) {
        size_t left = n - i;
        PacketIo::Rays r(rays, i, left);
        Found found{r.tmax, F(0), F(0), U(0u)};
        M hit = walk<false>(r, found);
        PacketIo::store_some(hits.shape + i, select(mask<U>(hit), U(shape_), U(Accel::Miss)), left);
        PacketIo::store_some(hits.primitive + i, found.primitive, left);
        PacketIo::store_some(hits.t + i, found.t, left);
        PacketIo::store_some(hits.b1 + i, found.b1, left);
        PacketIo::store_some(hits.b2 + i, found.b2, left);
    }
}

void SdfGrid::occluded(const RayBatch &rays, uint8_t *hit, size_t n) const {
    for (size_t i = 0; i < n; i += W) {
        size_t left = std::min(W, n - i);
        PacketIo::Rays r(rays, i, left);
        Found none{};
        M found = PacketIo::first(left) && walk<true>(r, none);
        alignas(64) uint32_t blocked[W];
        store(&blocked[0], select(mask<U>(found), U(1u), U(0u)));
        for (size_t k = 0; k < left; ++k) hit[i + k] = uint8_t(blocked[k]);
    }
}

float SdfGrid::set_values(uint32_t shape, const float *values, const std::array<int32_t, 3> &n) {
    values_ = values, shape_ = shape;
    stride_[0] = 1, stride_[1] = n[0], stride_[2] = n[0] * n[1];
    for (int a = 0; a < 3; ++a) cells_[a] = n[size_t(a)] - 1, bits_[a] = SdfCellBits::of(cells_[a]);
    const size_t nx = size_t(cells_[0]), ny = size_t(cells_[1]), nz = size_t(cells_[2]);

    // which cells have values of both signs, and then blocks of twice the side, up to 128
    float largest = 0;
    const size_t n_values = size_t(n[0]) * size_t(n[1]) * size_t(n[2]);
    for (size_t i = 0; i < n_values; ++i) {
        float size = std::abs(values[i]);
        largest = size <= largest ? largest : size;  // NaN is the largest
    }
    struct Level {
        size_t n[3];
        std::vector<uint8_t> full;
    };
    std::vector<Level> levels(1, Level{{nx, ny, nz}, std::vector<uint8_t>(nx * ny * nz)});
    for (int a = 0; a < 3; ++a) first_[a] = cells_[a], last_[a] = -1;
    std::vector<float> low(nx + 1), high(nx + 1);
    for (int32_t z = 0; z < cells_[2]; ++z)
        for (int32_t y = 0; y < cells_[1]; ++y) {
            // of the four numbers beside each other, then of two such: loops that a compiler makes packets of
            const float *a = values + size_t(z) * size_t(stride_[2]) + size_t(y) * size_t(stride_[1]),
                        *b = a + stride_[1], *c = a + stride_[2], *d = b + stride_[2];
            float *l = low.data(), *h = high.data();
            for (size_t x = 0; x <= nx; ++x) {
                float ab = a[x] < b[x] ? a[x] : b[x], cd = c[x] < d[x] ? c[x] : d[x];
                float most = a[x] > b[x] ? a[x] : b[x], other = c[x] > d[x] ? c[x] : d[x];
                l[x] = ab < cd ? ab : cd;
                h[x] = most > other ? most : other;
            }
            uint8_t *full = &levels[0].full[(size_t(z) * ny + size_t(y)) * nx], some = 0;
            for (size_t x = 0; x < nx; ++x) {
                float least = l[x] < l[x + 1] ? l[x] : l[x + 1], most = h[x] > h[x + 1] ? h[x] : h[x + 1];
                full[x] = uint8_t((least <= 0) & (most >= 0) & (least < most));
                some |= full[x];
            }
            if (!some) continue;
            int32_t begin = 0, end = cells_[0] - 1;
            while (!full[begin]) ++begin;
            while (!full[end]) --end;
            const int32_t from[3] = {begin, y, z}, to[3] = {end, y, z};
            for (int k = 0; k < 3; ++k) first_[k] = std::min(first_[k], from[k]), last_[k] = std::max(last_[k], to[k]);
        }
    while (levels.size() < 8 && std::max(levels.back().n[0], std::max(levels.back().n[1], levels.back().n[2])) > 1) {
        const Level &fine = levels.back();
        Level coarse{{(fine.n[0] + 1) / 2, (fine.n[1] + 1) / 2, (fine.n[2] + 1) / 2}, {}};
        coarse.full.assign(coarse.n[0] * coarse.n[1] * coarse.n[2], 0);
        const uint8_t *from = fine.full.data();
        for (size_t z = 0; z < fine.n[2]; ++z)
            for (size_t y = 0; y < fine.n[1]; ++y) {
                uint8_t *to = &coarse.full[(z / 2 * coarse.n[1] + y / 2) * coarse.n[0]];
                for (size_t x = 0; x < fine.n[0]; ++x) to[x / 2] |= *from++;
            }
        levels.push_back(std::move(coarse));
    }
    // from the coarsest to the finest: a block that is empty, or in one that is, has that one's side
    std::vector<uint8_t> side, above;
    size_t above_n[3] = {0, 0, 0};
    for (size_t k = levels.size(); k-- > 0;) {
        const Level &level = levels[k];
        above.swap(side);
        side.resize(level.full.size());
        size_t i = 0;
        for (size_t z = 0; z < level.n[2]; ++z)
            for (size_t y = 0; y < level.n[1]; ++y)
                for (size_t x = 0; x < level.n[0]; ++x, ++i) {
                    uint8_t larger = above.empty() ? 0 : above[(z / 2 * above_n[1] + y / 2) * above_n[0] + x / 2];
                    side[i] = larger ? larger : level.full[i] ? uint8_t(0) : uint8_t(1u << k);
                }
        std::copy_n(level.n, 3, above_n);
    }
    empty_.assign(side.size() / 4 + 1, 0);
    std::memcpy(empty_.data(), side.data(), side.size());
    set_bounds();
    return largest;
}

void SdfGrid::set_matrices(const float to_world[12], const float to_object[12]) {
    std::copy_n(to_world, 12, to_world_);
    std::copy_n(to_object, 12, to_object_);
    set_bounds();
}

void SdfGrid::set_bounds() {
    bounds_ = Box{};
    if (last_[0] < 0) {  // no surface: a point in the grid
        const float p[3] = {to_world_[3], to_world_[7], to_world_[11]};
        return bounds_.include(p);
    }
    for (int corner = 0; corner < 8; ++corner) {
        float local[3], p[3];
        for (int a = 0; a < 3; ++a) local[a] = float(corner >> a & 1 ? last_[a] + 1 : first_[a]) / float(cells_[a]);
        for (int i = 0; i < 3; ++i) {
            const float *row = to_world_ + 4 * i;
            p[i] = row[0] * local[0] + row[1] * local[1] + row[2] * local[2] + row[3];
        }
        bounds_.include(p);
    }
}

}  // namespace tr
