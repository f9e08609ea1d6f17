#include "quadric.h"

#include <cmath>

#include "core/shape/quadric_hit.h"

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

// Smallest distance in (near, far), or a negative number.
float first_hit(const Quadric &q, const float *rays, uint32_t n, uint32_t lane) {
    float o[3], d[3];
    for (uint32_t k = 0; k < 3; ++k) o[k] = rays[(Org + k) * n + lane], d[k] = rays[(Dir + k) * n + lane];
    const UnitRay ray(q.to_object, o, d);
    const float near = rays[Near * n + lane], far = rays[Far * n + lane];
    if (q.kind == QuadricKind::Sphere) return first_sphere_hit(ray, near, far);
    return q.kind == QuadricKind::Cylinder ? first_cylinder_hit(ray, near, far) : first_disk_hit(ray, near, far);
}

}  // namespace

void Quadric::bounds(rtc::Bounds &result) const {
    quadric_box(to_world, kind == QuadricKind::Sphere, kind == QuadricKind::Cylinder, result.lower, result.upper);
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
