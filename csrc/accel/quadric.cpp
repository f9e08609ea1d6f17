#include "quadric.h"

#include <algorithm>
#include <cmath>

namespace tr {

namespace {

// Members of Embree's rays and hits as multiples of the packet's width.
enum RayRow {
    Org = 0,
    Near = 3,
    Dir = 4,
    Far = 8,
    HitNormal = 12,
    HitU = 15,
    HitV = 16,
    HitPrimitive = 17,
    HitGeometry = 18,
    HitInstance = 19
};

struct LocalRay {
    double o[3], d[3];

    LocalRay(const Quadric &q, const float *rays, uint32_t n, uint32_t lane) {
        for (int i = 0; i < 3; ++i) {
            const double *row = q.to_object + 4 * i;
            o[i] = row[3];
            d[i] = 0;
            for (uint32_t k = 0; k < 3; ++k) {
                o[i] += row[k] * double(rays[(Org + k) * n + lane]);
                d[i] += row[k] * double(rays[(Dir + k) * n + lane]);
            }
        }
    }
};

double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// Distances to the unit sphere without cancellation, for small spheres far away and origins close to the surface:
// Haines, Guenther and Akenine-Moeller, "Precision Improvements for Ray/Sphere Intersection", Ray Tracing Gems, ch. 7.
bool sphere_roots(const LocalRay &ray, double &t0, double &t1) {
    double a = dot(ray.d, ray.d), b = -dot(ray.o, ray.d);
    double nearest[3];  // from the centre to the line's nearest point
    for (int i = 0; i < 3; ++i) nearest[i] = ray.o[i] + b / a * ray.d[i];
    double discriminant = 1 - dot(nearest, nearest);
    if (!(discriminant >= 0)) return false;
    double q = b + std::copysign(std::sqrt(a * discriminant), b);
    double c = dot(ray.o, ray.o) - 1;
    t0 = q != 0 ? c / q : 0;
    t1 = q / a;
    if (t0 > t1) std::swap(t0, t1);
    return true;
}

// Distances to the line's points on the infinite cylinder; where it is parallel to the axis there are none.
bool cylinder_roots(LocalRay ray, double &t0, double &t1) {
    ray.o[2] = ray.d[2] = 0;
    return (ray.d[0] != 0 || ray.d[1] != 0) && sphere_roots(ray, t0, t1);
}

// Smallest distance in (near, far), or a negative number.
float first_hit(const Quadric &q, const float *rays, uint32_t n, uint32_t lane) {
    LocalRay ray(q, rays, n, lane);
    float near = rays[Near * n + lane], far = rays[Far * n + lane];
    double t0, t1;
    if (q.kind == QuadricKind::Sphere) {
        if (!sphere_roots(ray, t0, t1)) return -1;
    } else if (q.kind == QuadricKind::Cylinder) {
        if (!cylinder_roots(ray, t0, t1)) return -1;
        for (double t : {t0, t1}) {
            double z = ray.o[2] + t * ray.d[2];
            if (z >= 0 && z <= 1 && float(t) > near && float(t) < far) return float(t);
        }
        return -1;
    } else {
        if (ray.d[2] == 0) return -1;
        t0 = t1 = -ray.o[2] / ray.d[2];
        double x = ray.o[0] + t0 * ray.d[0], y = ray.o[1] + t0 * ray.d[1];
        if (!(x * x + y * y <= 1)) return -1;
    }
    for (float t : {float(t0), float(t1)})
        if (t > near && t < far) return t;
    return -1;
}

}  // namespace

void Quadric::bounds(rtc::Bounds &result) const {
    for (int i = 0; i < 3; ++i) {
        const double *row = to_world + 4 * i;
        // the largest coordinate of a linear map of the unit ball (disk) is the length of the row
        double z = kind == QuadricKind::Sphere ? row[2] : 0, middle = row[3];
        double extent = std::sqrt(row[0] * row[0] + row[1] * row[1] + z * z);
        if (kind == QuadricKind::Cylinder) middle += 0.5 * row[2], extent += 0.5 * std::abs(row[2]);
        double rounding = 1e-6 * (std::abs(middle) + extent);
        result.lower[i] = float(middle - extent - rounding);
        result.upper[i] = float(middle + extent + rounding);
    }
}

void Quadric::on_bounds(const rtc::BoundsFunctionArguments *arguments) {
    static_cast<const Quadric *>(arguments->user)->bounds(*arguments->bounds);
}

void Quadric::on_intersect(const rtc::UserFunctionArguments *arguments) {
    const auto &q = *static_cast<const Quadric *>(arguments->user);
    uint32_t n = arguments->n;
    float *rays = arguments->rays;
    auto *integers = reinterpret_cast<uint32_t *>(rays);
    for (uint32_t i = 0; i < n; ++i) {
        if (arguments->valid[i] == 0) continue;
        float t = first_hit(q, rays, n, i);
        if (t < 0) continue;
        rays[Far * n + i] = t;
        // nothing but the distance is used: position and normal follow from it
        for (uint32_t k = 0; k < 3; ++k) rays[(HitNormal + k) * n + i] = 0;
        rays[HitU * n + i] = rays[HitV * n + i] = 0;
        integers[HitPrimitive * n + i] = 0;
        integers[HitGeometry * n + i] = q.shape;
        integers[HitInstance * n + i] = rtc::InvalidGeometry;
    }
}

void Quadric::on_occluded(const rtc::UserFunctionArguments *arguments) {
    const auto &q = *static_cast<const Quadric *>(arguments->user);
    for (uint32_t i = 0; i < arguments->n; ++i)
        if (arguments->valid[i] != 0 && first_hit(q, arguments->rays, arguments->n, i) >= 0)
            arguments->rays[Far * arguments->n + i] = -INFINITY;
}

}  // namespace tr
