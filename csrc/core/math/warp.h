// Maps from the unit square to the distributions that are sampled, and their densities.
#pragma once

#include "vector.h"

namespace tr {

// Concentric map of the square to the disk: Shirley and Chiu, "A Low Distortion Map Between Disk and Square", 1997,
// in the branchless form of Cline (2011).
template <class F>
TR_INLINE Vec2<F> square_to_disk(const F &u1, const F &u2) {
    F x = F(2) * u1 - F(1), y = F(2) * u2 - F(1);
    auto quadrant_x = mask<F>(abs(x) > abs(y));
    F r = select(quadrant_x, x, y), rp = select(quadrant_x, y, x);
    F phi = select(mask<F>(r == F(0)), F(0), rp / select(mask<F>(r == F(0)), F(1), r)) * F(Pi / 4);
    phi = select(quadrant_x, phi, F(Pi / 2) - phi);
    F s, c;
    sincos(phi, s, c);
    return {r * c, r * s};
}

// Its inverse.
template <class F>
TR_INLINE Vec2<F> disk_to_square(const Vec2<F> &p) {
    const auto quadrant_x = mask<F>(abs(p.x) > abs(p.y));
    const F along = select(quadrant_x, p.x, p.y), across = select(quadrant_x, p.y, p.x);
    const F sign = select(mask<F>(along < F(0)), F(-1), F(1)), r = sqrt(p.x * p.x + p.y * p.y);
    const F x = sign * r, y = r * atan2(across, max(abs(along), F(1e-30))) * F(4 / Pi);
    return {F(0.5) * select(quadrant_x, x, y) + F(0.5), F(0.5) * select(quadrant_x, y, x) + F(0.5)};
}

// Density cos(theta) / pi.
template <class F>
TR_INLINE Vec3<F> square_to_cosine_hemisphere(const F &u1, const F &u2) {
    Vec2<F> p = square_to_disk(u1, u2);
    F z = sqrt(max(F(1) - p.x * p.x - p.y * p.y, F(0)));
    return {p.x, p.y, max(z, F(1e-7))};  // never exactly grazing: the density must not vanish
}

// Density 1 / (4 pi).
template <class F>
TR_INLINE Vec3<F> square_to_sphere(const F &u1, const F &u2) {
    F z = F(1) - F(2) * u2, r = sqrt(max(F(1) - z * z, F(0))), s, c;
    sincos(u1 * F(2 * Pi), s, c);
    return {r * c, r * s, z};
}

// Density 1 / (2 pi (1 - cos_cutoff)) about +z, given 1 - cos_cutoff, which is accurate for narrow cones.
template <class F>
TR_INLINE Vec3<F> square_to_cone(const F &u1, const F &u2, const F &one_minus_cos_cutoff) {
    F a = u2 * one_minus_cos_cutoff;  // 1 - cos(theta)
    F r = sqrt(max(a * (F(2) - a), F(0))), s, c;
    sincos(u1 * F(2 * Pi), s, c);
    return {r * c, r * s, F(1) - a};
}

// The unit vector at an angle to `axis`, of which cosine and sine are given; u turns it about the axis.
template <class F>
TR_INLINE Vec3<F> direction_about(const Vec3<F> &axis, const F &cosine, const F &sine, const F &u) {
    F s, c;
    sincos(u * F(2 * Pi), s, c);
    return normalize(make_frame(axis).to_world({sine * c, sine * s, cosine}));
}

// Barycentric coordinates (b1, b2), uniform on the triangle.
template <class F>
TR_INLINE Vec2<F> square_to_triangle(const F &u1, const F &u2) {
    F t = sqrt(max(F(1) - u1, F(0)));
    return {F(1) - t, t * u2};
}

}  // namespace tr
