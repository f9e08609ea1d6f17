// The derivative of light along a ray that bends, kick by kick backwards: what is behind a kick is known, and what is
// before it follows from the depth of all.
//
// With A the adjoint of the light where the ray begins, D the depth up to a piece, x = sigma l and m(x) = (1 - exp(-x))
// / x, a piece lets out R = exp(-x) R_behind + j l m(x), j = eps / n^2, and has the adjoints, of A exp(-D) = a,
//     l_bar = a exp(-x) (j - sigma R_behind),  sigma_bar = a l (j l m'(x) - exp(-x) R_behind),  j_bar = a l m(x).
#pragma once

#include "../medium/bend_light.h"
#include "gradient_sink.h"

namespace tr {

// The adjoint of a map into the cube of a grid, 3 rows of 4.
template <class F>
struct MapAdjoint {
    F m[12] = {F(0), F(0), F(0), F(0), F(0), F(0), F(0), F(0), F(0), F(0), F(0), F(0)};

    TR_INLINE void add(const Vec3<F> &local_bar, const Vec3<F> &q) {
        const F row[3] = {local_bar.x, local_bar.y, local_bar.z}, column[3] = {q.x, q.y, q.z};
        for (int i = 0; i < 3; ++i) {
            for (int k = 0; k < 3; ++k) m[4 * i + k] = fmadd(row[i], column[k], m[4 * i + k]);
            m[4 * i + 3] = m[4 * i + 3] + row[i];
        }
    }
    TR_INLINE Vec3<F> column(int k) const { return {m[k], m[4 + k], m[8 + k]}; }
};

// What a kick's light hands on: adjoints of the place, of Phi there, and of the kick's weight.
template <class F>
struct LightKick {
    Vec3<F> q{F(0), F(0), F(0)};
    F value{0}, weight{0};
};

template <class F>
class LightBack {
    using S = ScalarOf<F>;
    using M = MaskOf<F>;

public:
    LightAlong<F> along;
    GradientSink<F> &sink;
    Spectrum<F> begin_bar;  // A
    Spectrum<F> depth_bar;  // of the depth of all, by itself
    Spectrum<F> depth;      // from the beginning to behind the next kick
    Spectrum<F> radiance;   // behind it
    MapAdjoint<F> extinction, emission;

    // A kick of weight w at q, where the index is n.
    TR_NOINLINE LightKick<F> kick(const Vec3<F> &q, const F &n, const F &w, const M &active) {
        const S step = along.light.step;
        const F usable = select(mask<F>(n > F(0)), n, F(1)), inverse_square = F(1) / (usable * usable);
        const F length = select(active, w * n * F(step), F(0));
        const Spectrum<F> volume = along.at(along.light.extinction, along.scene.values, q, active),
                          sigma = volume * along.scale(), eps = along.emission(q, active);
        Spectrum<F> sigma_bar, eps_bar;
        F length_bar(0), index_bar(0);
        for (int c = 0; c < SpectrumSize; ++c) {
            const F x = sigma[c] * length, j = eps[c] * inverse_square;
            const MeanDecay<F> decay(x);
            const F before = depth[c] - x, a = begin_bar[c] * exp(-before), left = decay.end * radiance[c];
            sigma_bar[c] = select(active, length * (a * (j * length * decay.slope - left) + depth_bar[c]), F(0));
            length_bar = length_bar + a * (j * decay.end - sigma[c] * left) + depth_bar[c] * sigma[c];
            const F j_bar = a * length * decay.value;
            eps_bar[c] = select(active, j_bar * inverse_square, F(0));
            index_bar = fmadd(j_bar, j, index_bar);
            depth[c] = select(active, before, depth[c]);
            radiance[c] = select(active, fmadd(j * length, decay.value, left), radiance[c]);
        }
        sink.number(IntOf<F>(along.light.scale_offset), sigma_bar * volume, active);
        LightKick<F> r;
        r.q = add(along.light.extinction, q, sigma_bar * along.scale(), active, extinction);
        if (along.emits()) r.q = r.q + add(along.light.emission, q, eps_bar, active, emission);
        r.value = select(active, (w * F(step) * length_bar - F(2) * index_bar / usable) / usable, F(0));
        r.weight = select(active, n * F(step) * length_bar, F(0));
        return r;
    }

private:
    // `g`: the adjoint of a volume at q. Returns that of q.
    TR_HD Vec3<F> add(const BendVolume<S> &of, const Vec3<F> &q, const Spectrum<F> &g, const M &active,
                      MapAdjoint<F> &map) {
        const Record &record = along.scene.volumes[of.volume];
        if (record.kind == int32_t(VolumeKind::Constant)) {
            sink.spectrum(IntOf<F>(record.field[ConstantVolume::Value]), g, active);
            return {F(0), F(0), F(0)};
        }
        const int32_t slot = record.field[GridVolume::Data];
        const TensorView<S> &grid = along.scene.values.tensors[slot];
        const Vec3<F> local = transform_point(of.to_local, q);
        const Footprint<F, 8> at = GridVolume::footprint(grid, record, local);
        sink.footprint(along.scene, slot, at, g, active);
        if (record.field[GridVolume::Filter] == 1) return {F(0), F(0), F(0)};
        F value[8];
        for (int k = 0; k < 8; ++k)
            value[k] =
                component_sum(g * gather_footprint(grid, along.waves, Footprint<F, 1>{{at.texel[k]}, {F(1)}}, active));
        const Vec3<F> local_bar =
            select(active, GridVolume::slope(grid, record, local, at, value), Vec3<F>{F(0), F(0), F(0)});
        map.add(local_bar, q);
        return transform_normal(of.to_local, local_bar);
    }
};

// The same forwards: sums with their tangents, of grids.
template <class F>
class LightForward {
    using S = ScalarOf<F>;
    using M = MaskOf<F>;

public:
    LightAlong<F> along;
    const Values<S> &tangent;
    const S *extinction_map, *emission_map;  // tangents of maps, 3 rows of 4
    LightSum<F> sum{};
    Spectrum<F> depth = uniform_spectrum(F(0)), emitted = uniform_spectrum(F(0));  // tangents

    // A kick of weight w at q, where the index is n; `d_`: tangents.
    TR_NOINLINE void kick(const Vec3<F> &q, const Vec3<F> &d_q, const F &n, const F &d_n, const F &w, const M &active) {
        const F usable = select(mask<F>(n > F(0)), n, F(1)), inverse_square = F(1) / (usable * usable);
        const F by_n = select(active, w * F(along.light.step), F(0)), length = by_n * n, d_length = by_n * d_n;
        const Spectrum<F> sigma = along.extinction(q, active), eps = along.emission(q, active);
        const Spectrum<F> d_sigma = change(along.light.extinction, extinction_map, q, d_q, active) * along.scale();
        Spectrum<F> d_eps = uniform_spectrum(F(0));
        if (along.emits()) d_eps = change(along.light.emission, emission_map, q, d_q, active);
        for (int c = 0; c < SpectrumSize; ++c) {
            const F j = eps[c] * inverse_square, d_j = d_eps[c] * inverse_square - F(2) * j * d_n / usable;
            const MeanDecay<F> decay(sigma[c] * length);
            const F brought = j * length * decay.value, d_brought = d_j * length * decay.value +
                                                                    j * length * length * decay.slope * d_sigma[c] +
                                                                    j * decay.end * d_length;
            const F through = exp(-sum.depth[c]);
            emitted[c] = emitted[c] + select(active, through * (d_brought - brought * depth[c]), F(0));
            depth[c] = depth[c] + length * d_sigma[c] + sigma[c] * d_length;
        }
        sum.add(along, q, n, w, active);
    }

private:
    TR_HD Spectrum<F> change(const BendVolume<S> &of, const S *map, const Vec3<F> &q, const Vec3<F> &d_q,
                             const M &active) {
        const Record &record = along.scene.volumes[of.volume];
        const int32_t slot = record.field[GridVolume::Data];
        const TensorView<S> &grid = along.scene.values.tensors[slot];
        const Vec3<F> local = transform_point(of.to_local, q),
                      d_local = transform_vector(of.to_local, d_q) + transform_point(map, q);
        const Footprint<F, 8> at = GridVolume::footprint(grid, record, local);
        Spectrum<F> r = uniform_spectrum(F(0)), value[8];
        if (tangent.tensors[slot].data) r = gather_footprint(tangent.tensors[slot], along.waves, at, active);
        if (record.field[GridVolume::Filter] == 1) return r;
        for (int k = 0; k < 8; ++k)
            value[k] = gather_footprint(grid, along.waves, Footprint<F, 1>{{at.texel[k]}, {F(1)}}, active);
        for (int c = 0; c < SpectrumSize; ++c) {
            F numbers[8];
            for (int k = 0; k < 8; ++k) numbers[k] = value[k][c];
            r[c] = r[c] + dot(GridVolume::slope(grid, record, local, at, numbers), d_local);
        }
        return r;
    }
};

}  // namespace tr
