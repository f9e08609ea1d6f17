// `fisheye`: a lens of more than a half space. The distance from the principal point is, times the focal length,
//     theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8),
// theta being the angle to the axis (Kannala and Brandt, "A Generic Camera Model and Calibration Method", PAMI 2006, as
// in OpenCV). With zeros it is the equidistant fisheye.
#pragma once

#include <limits>

#include "local_ray.h"
#include "perspective.h"

namespace tr {

struct Fisheye {
    enum { ToWorld, Fov, OffsetX, OffsetY, Near, Far, Aspect, Medium, Distortion, MaxAngle };
    static constexpr Field fields[] = {
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, Perspective::Edges,
         "pose: camera frame to world, no scale"},
        {"x_fov", Kind::Float, 180, 0, 720, Perspective::Edges,
         "width of the film over the focal length, degrees: the horizontal field of view without distortion"},
        {"principal_point_offset_x", Kind::Float, 0, -INFINITY, INFINITY, Perspective::Edges,
         "moves the image left, in film widths"},
        {"principal_point_offset_y", Kind::Float, 0, -INFINITY, INFINITY, Perspective::Edges,
         "moves the image up, in film heights"},
        {"near_clip", Kind::Float, 1e-2, 0, INFINITY, "none: a clipping surface", "where things begin to be seen"},
        {"far_clip", Kind::Float, 1e4, 0, INFINITY, "none: a clipping surface", "where they end to be seen"},
        {"pixel_aspect", Kind::Float, 1, 1e-3, 1e3, Perspective::Edges,
         "focal length in pixels along x over that along y; 1 for square pixels"},
        {"medium", Kind::Medium, -1, 0, INFINITY, "", "the medium that the camera is in"},
        {"distortion", Kind::Tensor, None, -INFINITY, INFINITY, Perspective::Edges, "(4,) the coefficients k1 to k4"},
        {"max_angle", Kind::Float, 180, 0, 180, "none: where the image ends",
         "angle to the axis, degrees, beyond which nothing is seen"},
    };
    static constexpr Model model = {"sensor", "fisheye",      "A camera with a fisheye lens.", fields, 10,
                                    0,        "FisheyeCamera"};

    static constexpr bool Lens = false;
    static constexpr int N = 4, Table = Distortion, Entries = 4;
    static constexpr std::array Numbers{Fov, OffsetX, OffsetY, Aspect};

    template <class K, class T, class F>
    TR_INLINE static auto seen_at(const K *k, const T &theta, const F &one) {
        T square = theta * theta;
        return theta * (one + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3]))));
    }

    // `limit` is the largest angle, in radians.
    template <class T, class F, class S>
    TR_INLINE static LocalRay<T, F> local(const T *numbers, const FilmSample<F, S> &at) {
        using D = Dual<F, 1>;
        const F one(1), epsilon(std::numeric_limits<S>::epsilon());
        Vec2<T> u = film_slopes(numbers, numbers[0] * F(Pi / 360), at);
        T radius = sqrt(u.x * u.x + u.y * u.y);
        F k[Entries], seen = value_of(radius);
        for (int i = 0; i < Entries; ++i) k[i] = value_of(numbers[N + i]);
        F theta = min(seen, F(at.limit)), slope(1), error(0);
        for (int i = 0; i < 20; ++i) {  // Newton's method
            D now = seen_at(k, D(theta, 0), one);
            error = now.v - seen;
            slope = select(mask<F>(now.d[0] > F(1e-3)), now.d[0], F(1e-3));
            F next = min(max(theta - error / slope, F(0)), F(Pi));
            auto moving = mask<F>(abs(next - theta) > F(4) * epsilon * theta);
            theta = next;
            if (!any(moving)) break;
        }
        D now = seen_at(k, D(theta, 0), one);
        LocalRay<T, F> r;
        r.exists = mask<F>(abs(now.v - seen) < F(1e-4) * (one + seen)) && mask<F>(now.d[0] > F(1e-3)) &&
                   mask<F>(theta <= F(at.limit) * (one + F(4) * epsilon));
        F inverse = select(r.exists, one / select(r.exists, now.d[0], one), F(0));
        theta = select(r.exists, theta, F(0));
        // the implicit function theorem, as in distorted.h
        T angle = theta - (seen_at(numbers + N, theta, one) - radius) * inverse;
        T s, c;
        sincos(angle, s, c);
        auto off_axis = mask<F>(seen > F(0));
        T ratio = select(off_axis, s / select(off_axis, radius, T(one)), T(one));
        r.o = {T(F(0)), T(F(0)), T(F(0))};
        r.d = {u.x * ratio, u.y * ratio, c};
        r.start = T(F(at.near));
        r.length = F(at.far - at.near);
        return r;
    }

    template <class F, class S>
    TR_INLINE static MaskOf<F> seen(const F *numbers, const FilmSample<F, S> &at, const Vec3<F> &p, Vec2<F> &place) {
        F radius = sqrt(p.x * p.x + p.y * p.y);
        auto off_axis = mask<F>(radius > F(0));
        F scale = seen_at(numbers + N, atan2(radius, p.z), F(1)) / select(off_axis, radius, F(1));
        place = film_fractions(numbers, numbers[0] * F(Pi / 360), Vec2<F>{p.x * scale, p.y * scale}, at);
        return MaskOf<F>(true);
    }
};

}  // namespace tr
