// Spheres and cylinders have small parameters besides `to_world`: their unit shape is moved by to_world times a map of
// these, whose derivatives are here, too.
#pragma once

#include <algorithm>

#include "../core/math/dual.h"
#include "../core/registry.h"

namespace tr {

struct Placement {
    static constexpr int Most = 7;
    double map[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};  // 3 rows of 4
    int n = 0;                                              // parameters of it
    int32_t offset[Most];                                   // of each in the block of small parameters
    double derivative[Most][12] = {};                       // of the map by each
};

namespace detail {

// From the unit cylinder: the z axis becomes the segment from p0 to p1, and where the azimuth begins is Mitsuba's.
template <class T>
void place_cylinder(const T (&p)[7], T (&map)[12]) {
    Vec3<T> p0{p[0], p[1], p[2]}, axis = Vec3<T>{p[3], p[4], p[5]} - p0, s, t;
    coordinate_system(axis * (T(1) / norm(axis)), s, t);
    const Vec3<T> column[4] = {s * p[6], t * p[6], axis, p0};
    for (int j = 0; j < 4; ++j) map[j] = column[j].x, map[4 + j] = column[j].y, map[8 + j] = column[j].z;
}

}  // namespace detail

// Of a shape whose record has these fields; `constants` is the block of small parameters.
template <class S>
Placement placement_of(const ShapeInfo &shape, const int32_t *field, const S *constants) {
    Placement r;
    auto add = [&](int32_t offset, int n) {
        while (n--) r.offset[r.n++] = offset++;
    };
    if (shape.flags & IsSphere) {
        add(field[SphereModel::Center], 3);
        add(field[SphereModel::Radius], 1);
        for (int k = 0; k < 3; ++k) {
            r.map[5 * k] = double(constants[r.offset[3]]);
            r.map[4 * k + 3] = double(constants[r.offset[k]]);
            r.derivative[k][4 * k + 3] = r.derivative[3][5 * k] = 1;
        }
    } else if (shape.flags & IsCylinder) {
        add(field[CylinderModel::P0], 3);
        add(field[CylinderModel::P1], 3);
        add(field[CylinderModel::Radius], 1);
        using D = Dual<double, 7>;
        D p[7], map[12];
        for (int k = 0; k < 7; ++k) p[k] = D(double(constants[r.offset[k]]), k);
        detail::place_cylinder(p, map);
        for (int i = 0; i < 12; ++i) {
            r.map[i] = map[i].v;
            for (int k = 0; k < 7; ++k) r.derivative[k][i] = map[i].d[k];
        }
    }
    return r;
}

// a * b of affine maps; without the translation of a where b is a change of such a map.
template <class A, class B, class To>
void add_product(const A *a, const B *b, bool change, To *to) {
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 4; ++j) {
            double sum = j == 3 && !change ? double(a[4 * i + 3]) : 0;
            for (int l = 0; l < 3; ++l) sum += double(a[4 * i + l]) * double(b[4 * l + j]);
            to[4 * i + j] += To(sum);
        }
}

}  // namespace tr
