// What a camera model is: a map from a sample on the film to a ray in the camera's frame, which looks along +z, with +x
// to the left in the image and +y up. It is written for a scalar type T: a Float, or a dual number over the model's few
// numbers. That a matrix takes the ray to the world is the same for all models, see camera.h.
//
//   static constexpr bool Lens;          the model uses a second pair of random numbers
//   static constexpr int N;              how many numbers with a derivative there are, and, one at least,
//   static constexpr std::array Numbers; their fields
//   static constexpr int Table, Entries; field of a tensor of numbers that follow them, and how many it has (0: none)
//   template <class T, class F, class S>
//   static LocalRay<T, F> local(const T *numbers, const FilmSample<F, S> &at);
//
// and, of those that have a film on which a point is seen in one place, the inverse: where p, in the camera's frame,
// is, as fractions of the film, through the place `at.lens`. (Where a lens distorts, `local` says whether it is there.)
//
//   template <class F, class S>
//   static MaskOf<F> seen(const F *numbers, const FilmSample<F, S> &at, const Vec3<F> &p, Vec2<F> &place);
#pragma once

#include <array>

#include "../math/dual.h"
#include "../math/warp.h"

namespace tr {

template <class T, class F>
struct LocalRay {
    Vec3<T> o, d;  // d of unit length
    T start;       // distance along d from o to where things begin to be seen
    F length;      // from there to where they end
    MaskOf<F> exists;
};

template <class F, class S>
struct FilmSample {
    F x, y;        // fractions of the film's width and height, from its upper left corner
    Vec2<F> lens;  // in the unit disk
    S height;      // of the film over its width
    S near, far;   // clipping distances
    S limit;       // what else a model wants to know, see there
};

// What pinholes and lenses have in common: the direction whose z is 1, from their field of view, the offsets of the
// principal point and the aspect of pixels, in this order.
template <class T, class F, class S>
TR_INLINE Vec2<T> film_slopes(const T *numbers, const T &half_width, const FilmSample<F, S> &at) {
    T a = F(1) - F(2) * (at.x + numbers[1]), b = F(1) - F(2) * (at.y + numbers[2]);
    return {a * half_width, b * half_width * numbers[3] * F(at.height)};
}
template <class T, class F, class S>
TR_INLINE Vec3<T> projective_direction(const T *numbers, const FilmSample<F, S> &at) {
    T s, c;
    sincos(numbers[0] * F(Pi / 360), s, c);
    Vec2<T> slopes = film_slopes(numbers, s / c, at);
    return {slopes.x, slopes.y, T(F(1))};
}

// The inverse of film_slopes.
template <class F, class S>
TR_INLINE Vec2<F> film_fractions(const F *numbers, const F &half_width, const Vec2<F> &slopes,
                                 const FilmSample<F, S> &at) {
    return {(F(1) - slopes.x / half_width) * F(0.5) - numbers[1],
            (F(1) - slopes.y / (half_width * numbers[3] * F(at.height))) * F(0.5) - numbers[2]};
}
template <class F>
TR_INLINE F half_width(const F *numbers) {
    F s, c;
    sincos(numbers[0] * F(Pi / 360), s, c);
    return s / c;
}
// 1 / z of what is in front of the camera.
template <class F>
TR_INLINE F inverse_depth(const F &z, MaskOf<F> &front) {
    front = mask<F>(z > F(0));
    return F(1) / select(front, z, F(1));
}

// Along u, between planes in front of the camera.
template <class T, class F, class S>
TR_INLINE LocalRay<T, F> between_planes(const Vec3<T> &o, const Vec3<T> &u, const FilmSample<F, S> &at) {
    LocalRay<T, F> r;
    r.o = o;
    r.d = u * (T(F(1)) / sqrt(squared_norm(u)));
    T inverse_z = T(F(1)) / r.d.z;
    r.start = inverse_z * F(at.near);
    r.length = value_of(inverse_z) * F(at.far - at.near);
    r.exists = MaskOf<F>(true);
    return r;
}

}  // namespace tr
