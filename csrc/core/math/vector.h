// Points, directions and frames over any Float (number, packet, dual number).
#pragma once

#include "rows.h"

namespace tr {

template <class F>
struct Vec2 {
    F x, y;
};

template <class F>
struct Vec3 {
    F x, y, z;
};

#define TR_VEC_OP(op)                                                          \
    template <class A, class B>                                                \
    TR_INLINE auto operator op(const Vec3<A> &a, const Vec3<B> &b) {           \
        return Vec3<decltype(a.x op b.x)>{a.x op b.x, a.y op b.y, a.z op b.z}; \
    }
TR_VEC_OP(+)
TR_VEC_OP(-)
#undef TR_VEC_OP
template <class F>
TR_INLINE Vec3<F> operator-(const Vec3<F> &a) {
    return {-a.x, -a.y, -a.z};
}
template <class A, class B>
TR_INLINE auto operator*(const Vec3<A> &a, const B &s) {
    return Vec3<decltype(a.x * s)>{a.x * s, a.y * s, a.z * s};
}
template <class A, class B>
TR_INLINE auto dot(const Vec3<A> &a, const Vec3<B> &b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <class F>
TR_INLINE Vec3<F> cross(const Vec3<F> &a, const Vec3<F> &b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <class F>
TR_INLINE F squared_norm(const Vec3<F> &a) {
    return dot(a, a);
}
template <class F>
TR_INLINE F norm(const Vec3<F> &a) {
    return sqrt(squared_norm(a));
}
template <class F>
TR_INLINE Vec3<F> normalize(const Vec3<F> &a) {
    return a * rsqrt(squared_norm(a));
}
// The length of v and its direction, which is 0 where v is.
template <class F>
struct Direction {
    Vec3<F> d;
    F length;
    TR_INLINE explicit Direction(const Vec3<F> &v) {
        F squared = squared_norm(v);
        auto some = mask<F>(squared > F(0));
        F inverse = select(some, rsqrt(select(some, squared, F(1))), F(0));
        d = v * inverse;
        length = squared * inverse;
    }
};
template <class M, class F>
TR_INLINE Vec3<F> select(const M &m, const Vec3<F> &a, const Vec3<F> &b) {
    return {select(m, a.x, b.x), select(m, a.y, b.y), select(m, a.z, b.z)};
}
template <class F>
TR_INLINE F max_abs(const Vec3<F> &a) {
    return max(abs(a.x), max(abs(a.y), abs(a.z)));
}

// sign(a) * b, with sign(0) = +1
template <class F>
TR_INLINE F mulsign(const F &b, const F &a) {
    return select(mask<F>(a < F(0)), -b, b);
}

// A vector orthogonal to the unit vector n, without a branch: Duff et al., "Building an Orthonormal Basis, Revisited",
// JCGT 6(1), 2017.
template <class F>
TR_INLINE void coordinate_system(const Vec3<F> &n, Vec3<F> &s, Vec3<F> &t) {
    F sign = mulsign(F(1), n.z);
    F a = F(-1) / (sign + n.z);
    F b = n.x * n.y * a;
    s = {F(1) + sign * n.x * n.x * a, sign * b, -sign * n.x};
    t = {b, sign + n.y * n.y * a, -n.y};
}

// An orthonormal frame (s, t, n). In local coordinates n is +z.
template <class F>
struct Frame {
    Vec3<F> s, t, n;

    TR_INLINE Vec3<F> to_local(const Vec3<F> &v) const { return {dot(v, s), dot(v, t), dot(v, n)}; }
    TR_INLINE Vec3<F> to_world(const Vec3<F> &v) const { return s * v.x + t * v.y + n * v.z; }
};

template <class F>
TR_INLINE Frame<F> make_frame(const Vec3<F> &n) {
    Frame<F> f;
    f.n = n;
    coordinate_system(n, f.s, f.t);
    return f;
}

// Affine maps stored as 3 rows of 4.
template <class F, class S>
TR_INLINE Vec3<F> transform_point(const S *m, const Vec3<F> &p) {
    return {m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3], m[4] * p.x + m[5] * p.y + m[6] * p.z + m[7],
            m[8] * p.x + m[9] * p.y + m[10] * p.z + m[11]};
}
template <class F, class S>
TR_INLINE Vec3<F> transform_vector(const S *m, const Vec3<F> &v) {
    return {m[0] * v.x + m[1] * v.y + m[2] * v.z, m[4] * v.x + m[5] * v.y + m[6] * v.z,
            m[8] * v.x + m[9] * v.y + m[10] * v.z};
}
// m is the inverse of the map whose normals are wanted
template <class F, class S>
TR_INLINE Vec3<F> transform_normal(const S *m, const Vec3<F> &n) {
    return {m[0] * n.x + m[4] * n.y + m[8] * n.z, m[1] * n.x + m[5] * n.y + m[9] * n.z,
            m[2] * n.x + m[6] * n.y + m[10] * n.z};
}

// Every lane its own matrix: rows of 4 at `base + index`.
template <class F, class S>
TR_INLINE void gather_matrix(const S *base, UIntOf<F> index, MaskOf<F> active, F (&m)[12]) {
    for (uint32_t i = 0; i < 3; ++i) {
        F row[4];
        gather_rows<F>(base, index + 4u * i, active, row);
        for (int k = 0; k < 4; ++k) m[4 * i + uint32_t(k)] = row[k];
    }
}

}  // namespace tr
