// Where rays meet the unit sphere, the unit disk in the plane z = 0, and the open cylinder of radius 1 about the z axis
// from 0 to 1, for closest hits: one ray, in double precision, since small shapes may be far away. All inlined: whoever
// includes this may be compiled to round sums of products otherwise.
#pragma once

#include "../math/config.h"

namespace tr {

struct UnitRay {
    double o[3], d[3];

    // The ray (o, d) of the world under the matrix of 3 rows of 4.
    template <class S>
    TR_INLINE UnitRay(const double *to_object, const S *world_o, const S *world_d) {
        for (int i = 0; i < 3; ++i) {
            const double *row = to_object + 4 * i;
            o[i] = row[3];
            d[i] = 0;
            for (int k = 0; k < 3; ++k) {
                o[i] += row[k] * double(world_o[k]);
                d[i] += row[k] * double(world_d[k]);
            }
        }
    }
};

TR_INLINE double dot3(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// Distances to the unit sphere without cancellation, for small spheres far away and origins close to the surface:
// Haines, Guenther and Akenine-Moeller, "Precision Improvements for Ray/Sphere Intersection", Ray Tracing Gems, ch. 7.
TR_INLINE bool sphere_roots(const UnitRay &ray, double &t0, double &t1) {
    double a = dot3(ray.d, ray.d), b = -dot3(ray.o, ray.d);
    double nearest[3];  // from the centre to the line's nearest point
    for (int i = 0; i < 3; ++i) nearest[i] = ray.o[i] + b / a * ray.d[i];
    double discriminant = 1 - dot3(nearest, nearest);
    if (!(discriminant >= 0)) return false;
    double q = b + std::copysign(std::sqrt(a * discriminant), b);
    double c = dot3(ray.o, ray.o) - 1;
    t0 = q != 0 ? c / q : 0;
    t1 = q / a;
    if (t0 > t1) {
        const double larger = t0;
        t0 = t1, t1 = larger;
    }
    return true;
}

// The smallest distance in (near, far), or a negative number.
TR_INLINE float first_sphere_hit(const UnitRay &ray, float near, float far) {
    double t[2];
    if (!sphere_roots(ray, t[0], t[1])) return -1;
    for (double each : t)
        if (float(each) > near && float(each) < far) return float(each);
    return -1;
}

TR_INLINE float first_disk_hit(const UnitRay &ray, float near, float far) {
    if (ray.d[2] == 0) return -1;
    const double t = -ray.o[2] / ray.d[2];
    const double x = ray.o[0] + t * ray.d[0], y = ray.o[1] + t * ray.d[1];
    return x * x + y * y <= 1 && float(t) > near && float(t) < far ? float(t) : -1;
}

TR_INLINE float first_cylinder_hit(const UnitRay &ray, float near, float far) {
    // to the line's points on the infinite cylinder, of which there are none where it is parallel to the axis
    UnitRay flat = ray;
    flat.o[2] = flat.d[2] = 0;
    double t[2];
    if ((flat.d[0] == 0 && flat.d[1] == 0) || !sphere_roots(flat, t[0], t[1])) return -1;
    for (double each : t) {
        const double z = ray.o[2] + each * ray.d[2];
        if (z >= 0 && z <= 1 && float(each) > near && float(each) < far) return float(each);
    }
    return -1;
}

// The box around a unit shape in the world: around the sphere, else the cylinder, else the disk.
TR_INLINE void quadric_box(const double *to_world, bool sphere, bool cylinder, float *lower, float *upper) {
    for (int i = 0; i < 3; ++i) {
        const double *row = to_world + 4 * i;
        // the largest coordinate of a linear map of the unit ball (disk) is the length of the row
        double z = sphere ? row[2] : 0, middle = row[3];
        double extent = std::sqrt(row[0] * row[0] + row[1] * row[1] + z * z);
        if (cylinder) middle += 0.5 * row[2], extent += 0.5 * std::abs(row[2]);
        double rounding = 1e-6 * (std::abs(middle) + extent);
        lower[i] = float(middle - extent - rounding);
        upper[i] = float(middle + extent + rounding);
    }
}

}  // namespace tr
