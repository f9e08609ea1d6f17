// What a tile of paths consists of: its columns, and the small things that all of its parts do with them.
#pragma once

#include <chrono>

#include "queries.h"
#include "render.h"
#include "stored_hits.h"
#include "tape_sweep.h"

namespace tr {

template <class F, int C>
class TileBase {
protected:
    using S = ScalarOf<F>;
    using U = UIntOf<F>;
    using I = IntOf<F>;
    using M = MaskOf<F>;
    static constexpr int W = Lanes<F>::Width;

public:
    // by path of the tile (`slot`), set before `run`
    uint32_t *pixel, *row, *column, *sample;
    S *delta[C];  // reverse: adjoint of the path's radiance
    // by slot, after `run` (after `sweep` in forward mode)
    S *film_x, *film_y, *radiance[C], *alpha;
    RenderStats stats;
    // off unless begun before `run`: keeps what its rays hit, or knows it already
    HitRecorder recorder;
    HitReplay replay;

    TileBase(const RenderCall<S> &call, size_t capacity, const DerivativeCall<S> *derivative)
        : call_(call), scene_(*call.scene), derivative_(derivative) {
        size_t n = capacity + 2 * W;
        slots_.allocate([&](Arena &a) {
            for (uint32_t **p : {&pixel, &row, &column, &sample}) a.column(*p, n);
            for (S **p : {&film_x, &film_y, &alpha}) a.column(*p, n);
            a.column(delta, n);
            a.column(radiance, n);
        });
        size_t shadows = (call.config.volumetric ? 2 : 1) * n, hits = entries(shadows);
        hits_.allocate([&](Arena &a) {
            for (uint32_t **p : {&hit_shape_, &hit_primitive_, &order_}) a.column(*p, hits);
            for (S **p : {&hit_t_, &hit_b1_, &hit_b2_}) a.column(*p, hits);
            for (float **p : {&ray_[0], &ray_[1], &ray_[2], &ray_[3], &ray_[4], &ray_[5], &ray_[6], &float_t_,
                              &float_b1_, &float_b2_})
                a.column(*p, hits);
            a.column(kind_, hits);
            a.column(occluded_, hits);
        });
        for (auto &f : fronts_) f.allocate(n);
        shadow_.allocate(shadows);
    }

protected:
    static constexpr int Miss = Segment::Miss, Collision = Segment::Collision;
    static constexpr int NullKind = kind_of_model<NullBsdf>(Bsdfs{});

    // Entries that n hits take at most once they are grouped.
    static constexpr size_t entries(size_t n) { return n + size_t(Collision + 2) * 2 * W; }

    // Where rays hit; lanes that are not active get any place there is.
    Interaction<F> interaction(const Ray<F> &ray, const LaneSet<F> &lanes) const {
        SurfacePoint<F> at{lanes.get(hit_shape_), lanes.get(hit_primitive_), lanes.get(hit_b1_), lanes.get(hit_b2_)};
        at.shape = select(mask<U>(lanes.active), at.shape, U(0u));
        at.primitive = select(mask<U>(lanes.active), at.primitive, U(0u));
        return make_interaction(scene_, ray, at, lanes.get(hit_t_), lanes.active);
    }

    // Where queries write what rays hit: in single precision, which widen_hits then converts.
    static constexpr bool Single = sizeof(S) == 4;
    HitBatch hit_columns() const {
        return {hit_shape_, hit_primitive_, Single ? (float *)hit_t_ : float_t_, Single ? (float *)hit_b1_ : float_b1_,
                Single ? (float *)hit_b2_ : float_b2_};
    }
    void widen_hits(size_t n) {
        for (size_t i = 0; !Single && i < n; ++i)
            hit_t_[i] = S(float_t_[i]), hit_b1_[i] = S(float_b1_[i]), hit_b2_[i] = S(float_b2_[i]);
    }

    TR_INLINE void append(Front<S, C> &f, const Ray<F> &ray, const F &length, const Vec3<F> &from, const F &pdf,
                          const Color<F, C> &beta, const Color<F, C> &survival, const F &eta, const U &slot,
                          const U &parent, const U &seen, const M &m) {
        size_t n = f.n;
        const F *numbers[12] = {&ray.o.x, &ray.o.y, &ray.o.z, &ray.d.x, &ray.d.y, &ray.d.z,
                                &length,  &from.x,  &from.y,  &from.z,  &pdf,     &eta};
        S *columns[12] = {f.o[0],   f.o[1],    f.o[2],    f.d[0],    f.d[1], f.d[2],
                          f.length, f.from[0], f.from[1], f.from[2], f.pdf,  f.eta};
        for (int k = 0; k < 12; ++k) store_compressed<F>(columns[k] + n, *numbers[k], m);
        for (int c = 0; c < C; ++c) {
            store_compressed<F>(f.beta[c] + n, beta[c], m);
            store_compressed<F>(f.survival[c] + n, survival[c], m);
        }
        store_compressed<F>(f.slot + n, slot, m);
        store_compressed<F>(f.parent + n, parent, m);
        store_compressed<F>(f.seen + n, seen, m);
        f.n += size_t(count(m));
    }

    static Emission<F, C> no_emission() {
        Emission<F, C> e;
        e.point.emitter = I(-1);
        e.point.at = {U(0u), U(0u), F(0), F(0)};
        e.weight = F(0);
        e.radiance = uniform_color<C>(F(0));
        return e;
    }

    void see(const U &slot, const U &seen, const M &active) {
        M first = active && mask<F>(seen == 0u);
        if (!any(first)) return;
        alignas(64) uint32_t s[W], set[W];
        store(&s[0], slot);
        store(&set[0], select(mask<U>(first), U(1u), U(0u)));
        for (int i = 0; i < W; ++i)
            if (set[i]) alpha[s[i]] = S(1);
    }

    // Lanes whose value is finite; the others are counted and the first one remembered.
    M finite(const Color<F, C> &value, const M &active, const char *category, const I &index) {
        M usable = active && is_finite(value);
        int lost = count(active) - count(usable);
        if (lost) {
            stats.non_finite += uint64_t(lost);
            if (stats.non_finite_where.empty()) {
                M bad = active && !usable;
                stats.non_finite_where = std::string(category) + " " + std::to_string(first_lane(index, bad));
            }
        }
        return usable;
    }

    TapeLevel<S, C> &level() { return *levels_[size_t(n_levels_ - 1)]; }
    const int32_t *bsdf_wanted() const { return derivative_->bsdf_wanted.data(); }

    const RenderCall<S> &call_;
    const SceneView<S> &scene_;
    const DerivativeCall<S> *derivative_;
    Arena slots_, hits_;
    Front<S, C> fronts_[3];
    ShadowRays<S, C> shadow_;
    std::vector<std::unique_ptr<TapeLevel<S, C>>> levels_;
    int n_levels_ = 0;
    size_t n_slots_ = 0;
    std::vector<Segment> segments_;
    uint32_t *hit_shape_, *hit_primitive_, *order_;
    S *hit_t_, *hit_b1_, *hit_b2_;
    float *ray_[7], *float_t_, *float_b1_, *float_b2_;
    int32_t *kind_;
    uint8_t *occluded_;
};

}  // namespace tr
