// A `perspective` camera whose lens distorts: the model of Brown and Conrady in the form of OpenCV (documentation of
// calib3d), with the coefficients k1 k2 p1 p2 k3 k4 k5 k6. A direction (x, y, 1), x to the right and y down, is seen
// where an ideal camera would see (x', y', 1):
//     x' = x s + 2 p1 x y + p2 (r^2 + 2 x^2),   y' = y s + p1 (r^2 + 2 y^2) + 2 p2 x y,
//     s = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6),   r^2 = x^2 + y^2.
// A ray needs the inverse, by Newton's method; its derivative follows from that of the map (the implicit function
// theorem) and is one more step of it in dual numbers.
#pragma once

#include <initializer_list>
#include <limits>

#include "local_ray.h"
#include "perspective.h"

namespace tr {

// T and K are Float or dual numbers over F.
template <class F, class K, class T>
TR_INLINE auto distort(const K *k, const Vec2<T> &p) {
    T rr = p.x * p.x + p.y * p.y;
    auto above = F(1) + rr * (k[0] + rr * (k[1] + rr * k[4])), below = F(1) + rr * (k[5] + rr * (k[6] + rr * k[7]));
    auto s = above / below;
    T xy = F(2) * (p.x * p.y), xx = rr + F(2) * (p.x * p.x), yy = rr + F(2) * (p.y * p.y);
    return Vec2<decltype(s)>{p.x * s + k[2] * xy + k[3] * xx, p.y * s + k[2] * yy + k[3] * xy};
}

template <class F>
struct Undistorted {
    F x, y, inverse[4];  // of the map's Jacobian, row by row
    MaskOf<F> exists;
};

// The point that is seen at `seen`; there is none beyond the place where the map turns back.
template <class F>
TR_NOINLINE Undistorted<F> undistort(const F *k, const Vec2<F> &seen) {
    using D = Dual<F, 2>;
    const F epsilon(std::numeric_limits<ScalarOf<F>>::epsilon());
    Undistorted<F> r;
    r.x = seen.x, r.y = seen.y;
    for (int i = 0;; ++i) {
        Vec2<D> now = distort<F>(k, Vec2<D>{D(r.x, 0), D(r.y, 1)});
        F determinant = now.x.d[0] * now.y.d[1] - now.x.d[1] * now.y.d[0];
        auto turns = mask<F>(abs(determinant) > F(0));
        F scale = select(turns, F(1) / select(turns, determinant, F(1)), F(0));
        r.inverse[0] = now.y.d[1] * scale, r.inverse[1] = -now.x.d[1] * scale;
        r.inverse[2] = -now.y.d[0] * scale, r.inverse[3] = now.x.d[0] * scale;
        F x = now.x.v - seen.x, y = now.y.v - seen.y;
        F step_x = r.inverse[0] * x + r.inverse[1] * y, step_y = r.inverse[2] * x + r.inverse[3] * y;
        auto moving = mask<F>(abs(step_x) + abs(step_y) > F(4) * epsilon * (abs(r.x) + abs(r.y)));
        if (i == 20 || !any(moving)) {
            F error = abs(x) + abs(y), size = F(1) + abs(seen.x) + abs(seen.y);
            // on the branch that contains the centre: not folded, and not turned around
            r.exists = mask<F>(error < F(1e-4) * size) && mask<F>(determinant > F(0)) &&
                       mask<F>(r.x * seen.x + r.y * seen.y >= F(0));
            for (F *n : {&r.x, &r.y, r.inverse, r.inverse + 1, r.inverse + 2, r.inverse + 3})
                *n = select(r.exists, *n, F(0));
            return r;
        }
        r.x = r.x - step_x, r.y = r.y - step_y;
    }
}

struct DistortedPerspective : Perspective {
    static constexpr bool Lens = false;
    static constexpr int N = 4, Table = Distortion, Entries = 8;
    static constexpr std::array Numbers{Fov, OffsetX, OffsetY, Aspect};

    template <class T, class F, class S>
    TR_INLINE static LocalRay<T, F> local(const T *numbers, const FilmSample<F, S> &at) {
        Vec3<T> u = projective_direction(numbers, at);
        F k[Entries];
        for (int i = 0; i < Entries; ++i) k[i] = value_of(numbers[N + i]);
        Undistorted<F> found = undistort(k, Vec2<F>{-value_of(u.x), -value_of(u.y)});
        Vec2<T> seen = distort<F>(numbers + N, Vec2<F>{found.x, found.y});
        T x = seen.x + u.x, y = seen.y + u.y;
        T step_x = found.inverse[0] * x + found.inverse[1] * y, step_y = found.inverse[2] * x + found.inverse[3] * y;
        Vec3<T> d{step_x - found.x, step_y - found.y, T(F(1))};
        LocalRay<T, F> r = between_planes(Vec3<T>{T(F(0)), T(F(0)), T(F(0))}, d, at);
        r.exists = found.exists;
        return r;
    }

    template <class F, class S>
    TR_INLINE static MaskOf<F> seen(const F *numbers, const FilmSample<F, S> &at, const Vec3<F> &p, Vec2<F> &place) {
        MaskOf<F> front;
        F inverse = inverse_depth(p.z, front);
        Vec2<F> shown = distort<F>(numbers + N, Vec2<F>{-p.x * inverse, -p.y * inverse});
        place = film_fractions(numbers, half_width(numbers), Vec2<F>{-shown.x, -shown.y}, at);
        return front;
    }
};

}  // namespace tr
