// One model at a time, a number at a time: what `torchrender.testing` hands to statistical tests. The functions are
// those that the integrator calls.
#pragma once

#include "accel/accel.h"
#include "core/integrator/path.h"

namespace tr {

template <class S>
Vec3<S> vec3_at(const S *p, size_t i) {
    return {p[3 * i], p[3 * i + 1], p[3 * i + 2]};
}
template <class S>
void put(S *p, size_t i, const Vec3<S> &v) {
    p[3 * i] = v.x, p[3 * i + 1] = v.y, p[3 * i + 2] = v.z;
}

// `twosided` resolved as at a hit: the leaf, and -1 where directions are mirrored.
template <class S>
Leaf<S> leaf_of(const SceneView<S> &scene, int bsdf, const Vec3<S> &wi, S &mirror) {
    if (scene.bsdfs[bsdf].kind > TwoSidedKind)
        throw std::invalid_argument(
            "bsdf: a mixture, a mask or a normal map is met by chance or at a surface; probe what "
            "is nested in it");
    Leaf<S> leaf = resolve_bsdf<S>(scene, bsdf, wi.z < S(0), true);
    mirror = leaf.mirrored ? S(-1) : S(1);
    return leaf;
}

// value (n, C) with the cosine, density (n,) of the smooth part.
template <class S, int C>
void probe_bsdf(const SceneView<S> &scene, int bsdf, size_t n, const S *wi, const S *wo, const S *uv, S *value,
                S *pdf) {
    for (size_t i = 0; i < n; ++i) {
        S mirror;
        Vec3<S> a = vec3_at(wi, i), b = vec3_at(wo, i);
        Leaf<S> leaf = leaf_of(scene, bsdf, a, mirror);
        a.z *= mirror, b.z *= mirror;
        SurfacePoint<S> at{0u, 0u, uv[2 * i], uv[2 * i + 1]};
        dispatch(Bsdfs{}, scene.bsdfs[leaf.bsdf].kind, [&](auto m) {
            using Model = decltype(m);
            auto params = load_params<Model, C>(scene, leaf.bsdf, at, true);
            Color<S, C> f = uniform_color<C>(S(0));
            if (Model::Smooth) f = Model::template eval<C>(params, a, b, 0);
            for (int c = 0; c < C; ++c) value[i * C + size_t(c)] = f[c];
            pdf[i] = Model::template pdf<C>(params, a, b);
        });
    }
}

// direction (n, 3), weight = value / density (n, C), density or probability (n,), whether the lobe is a delta (n,).
template <class S, int C>
void probe_bsdf_sample(const SceneView<S> &scene, int bsdf, size_t n, const S *wi, const S *uv, const S *u, S *wo,
                       S *weight, S *pdf, S *eta, uint8_t *delta) {
    for (size_t i = 0; i < n; ++i) {
        S mirror;
        Vec3<S> a = vec3_at(wi, i);
        Leaf<S> leaf = leaf_of(scene, bsdf, a, mirror);
        a.z *= mirror;
        SurfacePoint<S> at{0u, 0u, uv[2 * i], uv[2 * i + 1]};
        dispatch(Bsdfs{}, scene.bsdfs[leaf.bsdf].kind, [&](auto m) {
            using Model = decltype(m);
            auto params = load_params<Model, C>(scene, leaf.bsdf, at, true);
            BsdfSample<S> s = Model::template sample<C>(params, a, u[3 * i], u[3 * i + 1], u[3 * i + 2]);
            Color<S, C> f = Model::template eval<C>(params, a, s.wo, s.lobe);
            for (int c = 0; c < C; ++c) weight[i * C + size_t(c)] = s.pdf > S(0) ? f[c] / s.pdf : S(0);
            s.wo.z *= mirror;
            put(wo, i, s.wo);
            pdf[i] = s.pdf, eta[i] = s.eta, delta[i] = s.delta;
        });
    }
}

// direction (n, 3), distance, density per solid angle (n,), radiance that would arrive (n, C).
template <class S, int C>
void probe_emitter_sample(const SceneView<S> &scene, size_t n, const S *p, const S *u, S *d, S *distance, S *pdf,
                          S *radiance) {
    for (size_t i = 0; i < n; ++i) {
        EmitterSample<S> s = sample_emitter(scene, vec3_at(p, i), u[3 * i], u[3 * i + 1], u[3 * i + 2], true);
        put(d, i, s.d);
        distance[i] = s.distance, pdf[i] = s.pdf;
        Color<S, C> e = eval_emitter<C>(scene, s.point, s.pdf > S(0)) * s.factor;
        for (int c = 0; c < C; ++c) radiance[i * C + size_t(c)] = e[c];
    }
}

// Density with which emitter sampling at p takes the direction d (of what a ray from there meets first), and the
// radiance that arrives.
template <class S, int C>
void probe_emitter_pdf(const SceneView<S> &scene, const Accel &accel, size_t n, const S *p, const S *d, S *pdf,
                       S *radiance) {
    for (size_t i = 0; i < n; ++i) {
        Ray<S> ray{vec3_at(p, i), vec3_at(d, i)};
        float in[7] = {float(ray.o.x), float(ray.o.y), float(ray.o.z), float(ray.d.x),
                       float(ray.d.y), float(ray.d.z), INFINITY};
        uint32_t shape, primitive;
        float t, b1, b2;
        accel.intersect({{in, in + 1, in + 2}, {in + 3, in + 4, in + 5}, in + 6}, {&shape, &primitive, &t, &b1, &b2}, 1,
                        false);
        Color<S, C> e = uniform_color<C>(S(0));
        pdf[i] = S(0);
        if (shape == Accel::Miss) {
            if (scene.environment >= 0) {
                EmitterPoint<S> point = environment_point(scene, ray.d);
                pdf[i] = environment_pdf(scene, point, true);
                e = eval_emitter<C>(scene, point, true);
            }
        } else if (scene.shapes[shape].emitter >= 0) {
            Interaction<S> si = make_interaction<S>(scene, ray, {shape, primitive, S(b1), S(b2)}, S(t), true);
            if (dot(si.frame.n, ray.d) < S(0)) {
                int32_t emitter = scene.shapes[shape].emitter;
                pdf[i] = area_light_pdf<S>(scene, emitter, shape, ray.o, si.p, si.ng, true);
                e = eval_emitter<C>(scene, EmitterPoint<S>{emitter, si.at}, true);
            }
        }
        for (int c = 0; c < C; ++c) radiance[i * C + size_t(c)] = e[c];
    }
}

}  // namespace tr
