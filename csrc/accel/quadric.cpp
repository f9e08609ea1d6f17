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

// Of one ray of a packet: the smallest distance in (near, far), or a negative number.
template <QuadricKind Kind>
TR_INLINE float first_hit(const double *to_object, const float *rays, uint32_t n, uint32_t lane) {
    float o[3], d[3];
    for (uint32_t k = 0; k < 3; ++k) o[k] = rays[(Org + k) * n + lane], d[k] = rays[(Dir + k) * n + lane];
    const UnitRay ray(to_object, o, d);
    const float near = rays[Near * n + lane], far = rays[Far * n + lane];
    if constexpr (Kind == QuadricKind::Sphere) return first_sphere_hit(ray, near, far);
    if constexpr (Kind == QuadricKind::Cylinder) return first_cylinder_hit(ray, near, far);
    return first_disk_hit(ray, near, far);
}

constexpr uint32_t Widest = 16;

// ... of all rays of a packet. Of a known number of them compilers make vectors.
template <QuadricKind Kind, uint32_t N>
void first_hits(const double *to_object, const float *rays, float *t) {
    for (uint32_t i = 0; i < N; ++i) t[i] = first_hit<Kind>(to_object, rays, N, i);
}

// ... of those that are valid, of a packet of any width up to the widest; of others it may be any number. All together
// are faster than these one by one if there are so many of them, as measured: 4 of 16 or of 8, all of 4, and never
// where compilers have no vectors.
template <QuadricKind Kind>
void first_hits(const double *to_object, const rtc::UserFunctionArguments &arguments, float *t) {
    const uint32_t n = arguments.n;
    uint32_t valid = 0;
    for (uint32_t i = 0; i < n; ++i) valid += arguments.valid[i] != 0;
    if (valid * uint32_t(TR_PACKET_WIDTH) > 3 * n) {
        if (n == 16) return first_hits<Kind, 16>(to_object, arguments.rays, t);
        if (n == 8) return first_hits<Kind, 8>(to_object, arguments.rays, t);
        if (n == 4) return first_hits<Kind, 4>(to_object, arguments.rays, t);
    }
    for (uint32_t i = 0; i < n; ++i)
        if (arguments.valid[i] != 0) t[i] = first_hit<Kind>(to_object, arguments.rays, n, i);
}

void first_hits(const Quadric &q, const rtc::UserFunctionArguments &arguments, float *t) {
    if (q.kind == QuadricKind::Sphere) return first_hits<QuadricKind::Sphere>(q.to_object, arguments, t);
    if (q.kind == QuadricKind::Cylinder) return first_hits<QuadricKind::Cylinder>(q.to_object, arguments, t);
    first_hits<QuadricKind::Disk>(q.to_object, arguments, t);
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
    float t[Widest];
    first_hits(q, *arguments, t);
    for (uint32_t i = 0; i < n; ++i) {
        if (arguments->valid[i] == 0 || t[i] < 0) continue;
        rays[Far * n + i] = t[i];
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
    float t[Widest];
    first_hits(q, *arguments, t);
    for (uint32_t i = 0; i < arguments->n; ++i)
        if (arguments->valid[i] != 0 && t[i] >= 0) arguments->rays[Far * arguments->n + i] = -INFINITY;
}

}  // namespace tr
