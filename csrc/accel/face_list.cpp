#include "face_list.h"

#include <algorithm>
#include <cmath>

#include "packet_io.h"

namespace tr {

namespace {

using F = PacketIo::F;
using U = PacketIo::U;
using M = PacketIo::M;
using Rays = PacketIo::Rays;
constexpr size_t W = PacketIo::W;

// So far outside of a face, relative to it, a ray still hits: from less than some twenty lengths of a face away none
// slips through between neighbours.
constexpr float Margin = 1e-6f;

// The fourth corner of a parallelogram may be off by the rounding of its coordinates, but where that is much of the
// face its triangles are tested one by one.
constexpr double LargestRounding = 5e-7, LargestSkew = 1e-3;

// Where rays meet a plane, all times `det` >= 0: nothing is divided until the nearest face is known.
struct Meeting {
    F t, u, v, det;
    Vec3<F> from;  // the plane's origin, the ray's

    template <class Plane>
    TR_INLINE Meeting(const Plane &p, const Rays &rays) {
        from = {rays.o.x - F(p.origin[0]), rays.o.y - F(p.origin[1]), rays.o.z - F(p.origin[2])};
        F along = product(p.n, rays.d), height = product(p.n, from);
        M below = mask<F>(along > F(0));
        det = abs(along);
        t = select(below, -height, height);
    }
    // Ahead of the ray, and before distance t_max / det_max; what a ray begins on is not hit.
    TR_INLINE M ahead(const F &t_max, const F &det_max) const {
        return mask<F>(t > F(0)) && mask<F>(t * det_max < t_max * det);
    }
    // Where in the plane.
    template <class Plane>
    TR_INLINE void place(const Plane &p, const Rays &rays) {
        u = fmadd(product(p.u, from), det, product(p.u, rays.d) * t);
        v = fmadd(product(p.v, from), det, product(p.v, rays.d) * t);
    }
    TR_INLINE static F product(const float (&a)[3], const Vec3<F> &b) {
        return fmadd(F(a[0]), b.x, fmadd(F(a[1]), b.y, F(a[2]) * b.z));
    }
    template <bool Parallelogram>
    TR_INLINE M inside() const {
        F low = det * F(-Margin), high = det - low;
        M r = mask<F>(u >= low) && mask<F>(v >= low);
        if (Parallelogram) return r && mask<F>(u <= high) && mask<F>(v <= high);
        return r && mask<F>(u + v <= high);
    }
};

// The nearest face so far; the distance is t / det.
struct Nearest {
    F t, det, u, v;
    U face;

    template <bool Parallelogram, class Planes>
    TR_INLINE void test(const Planes &planes, const Rays &rays, uint32_t first) {
        for (size_t k = 0; k < planes.size(); ++k) {
            Meeting m(planes[k], rays);
            M nearer = m.ahead(t, det);
            if (!any(nearer)) continue;  // rays that are alike often leave a face behind, all of them
            m.place(planes[k], rays);
            nearer = nearer && m.template inside<Parallelogram>();
            t = select(nearer, m.t, t);
            det = select(nearer, m.det, det);
            u = select(nearer, m.u, u);
            v = select(nearer, m.v, v);
            face = select(mask<U>(nearer), U(first + uint32_t(k)), face);
        }
    }
};

}  // namespace

size_t FaceList::limit() { return 2 * W; }

void FaceList::clear() {
    bounds_ = {};
    for (auto *planes : {&parallelograms_, &triangles_}) planes->clear();
    for (auto *owners : {&parallelogram_owners_, &triangle_owners_}) owners->clear();
}

bool FaceList::plane_of(const double *q0, const double *q1, const double *q2, Plane &plane) {
    using V = Vec3<double>;
    V o{q0[0], q0[1], q0[2]}, e1 = V{q1[0], q1[1], q1[2]} - o, e2 = V{q2[0], q2[1], q2[2]} - o, n = cross(e1, e2);
    double squared = squared_norm(n);
    if (!(squared > 0) || !std::isfinite(squared)) return false;
    V u = cross(e2, n) * (1 / squared), v = cross(n, e1) * (1 / squared);
    n = n * (1 / std::sqrt(squared));
    plane = {{float(o.x), float(o.y), float(o.z)},
             {float(n.x), float(n.y), float(n.z)},
             {float(u.x), float(u.y), float(u.z)},
             {float(v.x), float(v.y), float(v.z)}};
    return true;
}

// The triangles a and b of a mesh as q0 q1 q2 and q0 q2 q3, if that is a parallelogram.
bool FaceList::add_parallelogram(uint32_t shape, uint32_t face, const float *positions, const uint32_t *a,
                                 const uint32_t *b) {
    auto corner = [&](const uint32_t *triangle, uint32_t k) { return positions + 3 * size_t(triangle[k % 3]); };
    auto same = [](const float *x, const float *y) { return std::equal(x, x + 3, y); };
    for (uint32_t turn = 0; turn < 9; ++turn) {
        uint32_t i = turn / 3, j = turn % 3;
        const float *at[4] = {corner(a, i), corner(a, i + 1), corner(a, i + 2), corner(b, j + 2)};
        if (!same(corner(b, j), at[0]) || !same(corner(b, j + 1), at[2])) continue;
        double q[4][3], scale = 0, edge = 0, gap = 0;
        for (int k = 0; k < 3; ++k) {
            for (int c = 0; c < 4; ++c) q[c][k] = double(at[c][k]), scale = std::max(scale, std::abs(q[c][k]));
            edge = std::max(edge, std::max(std::abs(q[1][k] - q[0][k]), std::abs(q[3][k] - q[0][k])));
            gap = std::max(gap, std::abs(q[0][k] - q[1][k] + q[2][k] - q[3][k]));
        }
        Plane plane;
        if (!(gap <= std::min(LargestRounding * scale, LargestSkew * edge)) || !plane_of(q[0], q[1], q[3], plane))
            continue;
        parallelograms_.push_back(plane);
        parallelogram_owners_.push_back({shape, face, face + 1, 4 * j + i});
        return true;
    }
    return false;
}

void FaceList::add_triangle(uint32_t shape, uint32_t face, const float *positions, const uint32_t *corners) {
    double q[3][3];
    for (int c = 0; c < 3; ++c)
        for (int k = 0; k < 3; ++k) q[c][k] = double(positions[3 * size_t(corners[c]) + size_t(k)]);
    Plane plane;
    if (!plane_of(q[0], q[1], q[2], plane)) return;  // a face without area is not hit
    triangles_.push_back(plane);
    triangle_owners_.push_back({shape, face, face, 0});
}

void FaceList::add_mesh(uint32_t shape, const float *positions, const uint32_t *faces, size_t n_faces) {
    for (size_t k = 0; k < 3 * n_faces; ++k) bounds_.include(positions + 3 * size_t(faces[k]));
    for (size_t f = 0; f < n_faces; ++f) {
        const uint32_t *corners = faces + 3 * f;
        if (f + 1 < n_faces && add_parallelogram(shape, uint32_t(f), positions, corners, corners + 3))
            ++f;
        else
            add_triangle(shape, uint32_t(f), positions, corners);
    }
}

void FaceList::intersect(const RayBatch &rays, const HitBatch &hits, size_t n) const {
    const uint32_t none = uint32_t(parallelograms_.size() + triangles_.size());
    for (size_t i = 0; i < n; i += W) {
        size_t left = n - i;
        Rays r(rays, i, left);
        // rays that are none have no room for a hit
        Nearest nearest{select(r.valid, r.tmax, F(-1)), F(1), F(0), F(0), U(none)};
        nearest.test<true>(parallelograms_, r, 0);
        nearest.test<false>(triangles_, r, uint32_t(parallelograms_.size()));

        M hit = mask<F>(nearest.face != none);
        F inverse = F(1) / select(hit, nearest.det, F(1)), zero(0), one(1);
        F u = max(zero, min(one, nearest.u * inverse)), v = max(zero, min(one, nearest.v * inverse));
        U shape(Accel::Miss), primitive(0u);
        F b1(0), b2(0);
        if (any(hit)) {
            U owner[4], none_owner[4];
            M in_first = hit && mask<F>(nearest.face < uint32_t(parallelograms_.size())), in_second = hit && !in_first;
            for (int k = 0; k < 4; ++k) owner[k] = none_owner[k] = U(0u);
            if (any(in_first)) gather_few_rows<F>(&parallelogram_owners_[0].shape, nearest.face * 4u, in_first, owner);
            if (any(in_second)) {
                gather_few_rows<F>(&triangle_owners_[0].shape, (nearest.face - uint32_t(parallelograms_.size())) * 4u,
                                   in_second, none_owner);
                for (int k = 0; k < 4; ++k) owner[k] = select(mask<U>(in_second), none_owner[k], owner[k]);
            }
            // weights of the corners of the triangle in which (u, v) lies
            M upper = in_first && mask<F>(v > u);
            F w1 = select(in_first, select(upper, u, u - v), u);
            F w2 = select(in_first, select(upper, v - u, v), min(v, one - u));
            F w0 = one - w1 - w2;
            U turns = select(mask<U>(upper), owner[3] >> 2, owner[3] & 3u);
            M once = mask<F>(turns == 1u), twice = mask<F>(turns == 2u);
            shape = select(mask<U>(hit), owner[0], shape);
            primitive = select(mask<U>(hit), select(mask<U>(upper), owner[2], owner[1]), primitive);
            b1 = select(hit, select(once, w0, select(twice, w2, w1)), zero);
            b2 = select(hit, select(once, w1, select(twice, w0, w2)), zero);
        }
        PacketIo::store_some(hits.shape + i, shape, left);
        PacketIo::store_some(hits.primitive + i, primitive, left);
        PacketIo::store_some(hits.t + i, select(hit, nearest.t * inverse, r.tmax), left);
        PacketIo::store_some(hits.b1 + i, b1, left);
        PacketIo::store_some(hits.b2 + i, b2, left);
    }
}

void FaceList::occluded(const RayBatch &rays, uint8_t *hit, size_t n) const {
    for (size_t i = 0; i < n; i += W) {
        size_t left = std::min(W, n - i);
        Rays r(rays, i, left);
        M open = r.valid;
        auto test = [&](const auto &planes, auto parallelogram) {
            for (const Plane &plane : planes) {
                Meeting m(plane, r);
                M met = open && m.ahead(r.tmax, F(1));
                if (!any(met)) continue;
                m.place(plane, r);
                open = open && !(met && m.inside<parallelogram>());
                if (!any(open)) return;
            }
        };
        test(parallelograms_, std::true_type{});
        if (any(open)) test(triangles_, std::false_type{});
        alignas(64) uint32_t blocked[W];
        store(&blocked[0], select(mask<U>(r.valid && !open), U(1u), U(0u)));
        for (size_t k = 0; k < left; ++k) hit[i + k] = uint8_t(blocked[k]);
    }
}

}  // namespace tr
