// Shadow rays of volumetric paths: through media, and through boundaries that do not scatter.
#pragma once

#include "core/integrator/medium.h"
#include "tile_base.h"
#include "tracker.h"

namespace tr {

template <class F, int C>
class ShadowWays : public TileBase<F, C> {
protected:
    using Base = TileBase<F, C>;
    using Base::call_, Base::scene_, Base::shadow_, Base::stats, Base::W, Base::pixel, Base::sample, Base::radiance;
    using Base::hit_shape_, Base::hit_t_, Base::hit_b1_, Base::hit_b2_, Base::hit_primitive_, Base::ray_;
    using typename Base::I;
    using typename Base::M;
    using typename Base::S;
    using typename Base::U;
    static constexpr uint32_t CollisionShape = 0xFFFFFFFEu;  // in place of a shape that was hit
    static_assert(CollisionShape != Accel::Miss);

    ShadowWays(const RenderCall<S> &call, size_t capacity, const DerivativeCall<S> *derivative)
        : Base(call, capacity, derivative), tracker_(scene_), volumetric_(call.config.volumetric) {
        if (!volumetric_) return;
        probing_ = derivative && derivative->wanted.medium.extinction;
        const size_t shadows = 2 * (capacity + 2 * W);
        columns_.allocate([&](Arena &a) {
            for (S **p : {&way_end_, &way_start_, &way_length_, &way_total_, &pick_, &spot_, &ray_length_})
                a.column(*p, shadows);
            for (auto *p : {&way_point_, &ray_o_, &ray_d_}) a.column(*p, shadows);
            a.column(transmittance_, shadows);
            a.column(way_seed_, shadows);
            a.column(way_medium_, shadows);
            for (uint32_t **p : {&pending_, &queue_}) a.column(*p, shadows);
        });
    }

    TR_INLINE void push_shadow(const Vec3<F> &o, const EmitterSample<F> &light, const Color<F, C> &contribution,
                               const I &medium, const U &slot, const U &position, ShadowPurpose purpose,
                               const M &wanted) {
        if (!any(wanted)) return;
        M near = mask<F>(light.distance < F(S(1e30)));
        push_shadow(o, light.d, select(near, light.distance * F(1 - ShadowEpsilon), F(S(INFINITY))), F(0), contribution,
                    medium, slot, position, purpose, wanted);
    }
    TR_INLINE void push_shadow(const Vec3<F> &o, const Vec3<F> &d, const F &length, const F &lag,
                               const Color<F, C> &contribution, const I &medium, const U &slot, const U &position,
                               ShadowPurpose purpose, const M &wanted) {
        size_t n = shadow_.n;
        const F *numbers[8] = {&o.x, &o.y, &o.z, &d.x, &d.y, &d.z, &length, &lag};
        S *columns[8] = {shadow_.o[0], shadow_.o[1], shadow_.o[2],   shadow_.d[0],
                         shadow_.d[1], shadow_.d[2], shadow_.length, shadow_.lag};
        for (int k = 0; k < 8; ++k) store_compressed<F>(columns[k] + n, *numbers[k], wanted);
        for (int c = 0; c < C; ++c) store_compressed<F>(shadow_.contribution[c] + n, contribution[c], wanted);
        store_compressed<F>(shadow_.slot + n, slot, wanted);
        store_compressed<F>(shadow_.position + n, position, wanted);
        store_compressed<F>(shadow_.medium + n, U(medium), wanted);
        store_compressed<F>(shadow_.purpose + n, U(uint32_t(purpose)), wanted);
        shadow_.n += size_t(count(wanted));
    }

    // Rays to lights: through media, and through boundaries that do not scatter.
    template <bool Derivative>
    void trace_through(uint32_t level) {
        const size_t all = shadow_.n;
        if (all == 0) return;
        for (int c = 0; c < C; ++c) std::fill_n(transmittance_[c], all, S(1));
        std::fill_n(way_total_, all, S(0));
        for (size_t k = 0; k < all; ++k) pending_[k] = uint32_t(k);
        for (size_t n = all, round = 0; n > 0; ++round) {
            for (size_t j = 0; j < n; ++j) {
                uint32_t k = pending_[j];
                for (int a = 0; a < 3; ++a) ray_o_[a][j] = shadow_.o[a][k], ray_d_[a][j] = shadow_.d[a][k];
                ray_length_[j] = shadow_.length[k];
            }
            query(n);
            seed_ways(level, uint32_t(round), n);
            // the parts of the rays in front of what they hit
            for (size_t j = 0; j < n; ++j) {
                uint32_t k = pending_[j], shape = hit_shape_[j];
                bool hit = shape != Accel::Miss;
                way_end_[k] = hit ? hit_t_[j] : shadow_.length[k];
                if (hit && !passes(shape)) {
                    for (int c = 0; c < C; ++c) transmittance_[c][k] = S(0);
                    hit_shape_[j] = CollisionShape;  // in the dark
                }
            }
            for (int32_t m = 0; m < scene_.n_media; ++m) {
                size_t waiting = 0;
                for (size_t j = 0; j < n; ++j)
                    if (shadow_.medium[pending_[j]] == uint32_t(m) && hit_shape_[j] != CollisionShape)
                        queue_[waiting++] = pending_[j];
                if (waiting == 0) continue;
                TransmittanceColumns<S, C> columns{way_end_,       shadow_.lag, way_seed_,
                                                   transmittance_, way_start_,  way_length_};
                tracker_.transmit(m, shadow_.o, shadow_.d, columns, queue_, waiting);
                if (Derivative && probing_) choose_points(waiting, m);
            }
            n = cross_boundaries(n);
        }
        for (size_t k = 0; k < all; ++k) {
            uint32_t position = shadow_.position[k], slot = shadow_.slot[k];
            if (!Derivative) {
                for (int c = 0; c < C; ++c) radiance[c][slot] += transmittance_[c][k] * shadow_.contribution[c][k];
                continue;
            }
            VolumeColumns<S, C> &tape = this->level().volume;
            bool probe = shadow_.purpose[k] == uint32_t(ShadowPurpose::Probe);
            S *const *value = probe ? tape.probe_value : tape.shadow_value;
            for (int c = 0; c < C; ++c) value[c][position] = transmittance_[c][k] * shadow_.contribution[c][k];
            if (probe) continue;
            for (int c = 0; c < C; ++c) tape.through[c][position] = transmittance_[c][k];
            if (!probing_ || way_total_[k] == 0) continue;
            for (int a = 0; a < 3; ++a) tape.shadow[a][position] = way_point_[a][k];
            tape.shadow_length[position] = way_total_[k];
            tape.shadow_medium[position] = way_medium_[k];
        }
    }

    Tracker<F, C> tracker_;
    bool volumetric_, probing_ = false;  // probing: the extinction is differentiated

private:
    void query(size_t n) {
        auto begin = std::chrono::steady_clock::now();
        RayBatch rays = ray_batch(ray_o_, ray_d_, ray_length_, n, ray_);
        HitBatch hits = this->hit_columns();
        call_.accel->intersect(rays, hits, n, false);
        this->widen_hits(n);
        stats.shadow_rays += n;
        stats.seconds_trace += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    }

    bool passes(uint32_t shape) const { return scene_.bsdfs[scene_.shapes[shape].bsdf].kind == Base::NullKind; }

    void seed_ways(uint32_t level, uint32_t round, size_t n) {
        const PathConfig &config = call_.config;
        for (size_t j = 0; j < n; j += W) {
            M active = mask<F>(U(uint32_t(j)) + lane_index<F>() < U(uint32_t(n)));
            U id = select(mask<U>(active), load_uint<F>(pending_ + j), U(0u));
            auto get = [&](const uint32_t *column, const U &at) { return gather<U>(column, at, mask<U>(active)); };
            U slot = get(shadow_.slot, id), purpose = get(shadow_.purpose, id);
            U block = U(SegmentBlock + BlocksPerSegment * level + 1u) + purpose;
            auto bits =
                random_bits4<F>(config.seed, config.sensor + (round << 16), get(pixel, slot), get(sample, slot), block);
            scatter_lanes<F>(way_seed_[0], id, bits.bits[0] | U(1u), active);
            scatter_lanes<F>(way_seed_[1], id, bits.bits[1], active);
            scatter_lanes<F>(pick_, id, uniform_of<F>(bits.bits[2]), active);
            scatter_lanes<F>(spot_, id, uniform_of<F>(bits.bits[3]), active);
        }
    }

    // A point uniform on all of the parts of a ray that are in media.
    void choose_points(size_t waiting, int32_t m) {
        for (size_t q = 0; q < waiting; ++q) {
            uint32_t k = queue_[q];
            S length = way_length_[k];
            if (!(length > 0)) continue;
            way_total_[k] += length;
            if (!(pick_[k] * way_total_[k] < length)) continue;
            way_medium_[k] = m;
            S t = way_start_[k] + spot_[k] * length;
            for (int a = 0; a < 3; ++a) way_point_[a][k] = shadow_.o[a][k] + shadow_.d[a][k] * t;
        }
    }

    // Rays that have come to a boundary go on behind it; returns how many.
    size_t cross_boundaries(size_t n) {
        size_t left = 0;
        for (size_t j = 0; j < n; j += W) {
            U row = U(uint32_t(j)) + lane_index<F>();
            U shape = load_uint<F>(hit_shape_ + j);
            M on = mask<F>(row < U(uint32_t(n))) && !mask<F>(shape == U(Accel::Miss)) &&
                   !mask<F>(shape == U(CollisionShape));
            if (!any(on)) continue;
            U id = select(mask<U>(on), load_uint<F>(pending_ + j), U(0u));
            auto vec = [&](S *const(&column)[3]) {
                return Vec3<F>{gather<F>(column[0], id, on), gather<F>(column[1], id, on),
                               gather<F>(column[2], id, on)};
            };
            Ray<F> ray{vec(shadow_.o), vec(shadow_.d)};
            F t = load<F>(hit_t_ + j), length = gather<F>(shadow_.length, id, on) - t;
            SurfacePoint<F> at{select(mask<U>(on), shape, U(0u)),
                               select(mask<U>(on), load_uint<F>(hit_primitive_ + j), U(0u)), load<F>(hit_b1_ + j),
                               load<F>(hit_b2_ + j)};
            Interaction<F> si = make_interaction(scene_, ray, at, t, on);
            I medium = I(gather<U>(shadow_.medium, id, mask<U>(on)));
            Vec3<F> o = offset_origin(si.p, si.ng, ray.d);
            medium = medium_behind(scene_, at.shape, si.ng, ray.d, medium, on);
            const F *moved[3] = {&o.x, &o.y, &o.z};
            for (int a = 0; a < 3; ++a) scatter_lanes<F>(shadow_.o[a], id, *moved[a], on);
            scatter_lanes<F>(shadow_.length, id, length, on);
            scatter_lanes<F>(shadow_.lag, id, dot(o - si.p, ray.d), on);
            scatter_lanes<F>(shadow_.medium, id, U(medium), on);
            M lit(false);
            for (int c = 0; c < C; ++c) lit = lit || mask<F>(gather<F>(transmittance_[c], id, on) > F(0));
            on = on && lit && mask<F>(length > F(0));
            store_compressed<F>(pending_ + left, id, on);
            left += size_t(count(on));
        }
        return left;
    }

    Arena columns_;
    // by shadow ray
    S *way_end_, *way_start_, *way_length_, *way_total_, *pick_, *spot_, *way_point_[3], *transmittance_[C];
    uint32_t *way_seed_[2], *pending_, *queue_;
    int32_t *way_medium_;
    // of those in flight
    S *ray_o_[3], *ray_d_[3], *ray_length_;
};

}  // namespace tr
