// Free flight and transmittance in one medium, the pieces that packets of rays share. Scheduling is elsewhere
// (cpu/tracker.h).
//
// Constant extinction: closed forms. A grid: delta tracking and ratio tracking (Woodcock et al. 1965; Novak, Selle and
// Jarosz, "Residual Ratio Tracking for Estimating Attenuation in Participating Media", SIGGRAPH Asia 2014) against a
// coarse grid of majorants, which a ray walks through cell by cell; the optical depth to the next collision is drawn
// once and used up on the way.
//
// Coloured extinction: distances are sampled for the path's channel h and weighted by the balance heuristic over the
// channels (Wilkie et al., "Hero Wavelength Spectral Sampling", EGSR 2014; Miller, Georgiev and Jarosz, "A Null-
// Scattering Path Integral Formulation of Light Transport", SIGGRAPH 2019). What the value and the density of channel c
// are multiplied with, relative to those of h, is the same number: Flight::weight[c].
#pragma once

#include "../math/philox.h"
#include "medium.h"

namespace tr {

// A small generator a lane, for segments that need an unknown number of random numbers; seeded by the counter-based
// one, so that a segment's numbers depend on nothing else. xoroshiro64* of Blackman and Vigna, "Scrambled Linear
// Pseudorandom Number Generators", ACM TOMS 47 (2021), of which the upper 24 bits are used.
template <class F>
struct TrackingRandom {
    UIntOf<F> a, b;

    TR_INLINE F next(const MaskOf<F> &active) {
        using U = UIntOf<F>;
        auto m = mask<U>(active);
        U bits = a * U(0x9E3779BBu), x = a ^ b;
        a = select(m, ((a << 26) | (a >> 6)) ^ x ^ (x << 9), a);
        b = select(m, (x << 13) | (x >> 19), b);
        return uniform_of<F>(bits);
    }
};

// An optical depth, exponentially distributed; u in [0, 1).
template <class F>
TR_INLINE F optical_depth(const F &u) {
    return -log(F(1) - u);
}

// One ray in the cells of a grid's majorants. Distances are those of the world, counted from where the ray enters the
// grid.
template <class F, class S>
struct MajorantWalk {
    using I = IntOf<F>;
    using M = MaskOf<F>;
    Vec3<F> o, d;  // in the space of the grid's unit cube; o is where the ray enters
    F enter, t, end;
    F border[3], width[3];  // distance to the next border along each axis, and between borders
    I at[3], step[3];
    F majorant;

    // Sets the lanes of `fresh` up; returns those whose ray meets the grid.
    TR_INLINE M start(const SceneView<S> &scene, const MediumInfo &medium, const Vec3<F> &from,
                      const Vec3<F> &direction, const F &length, const M &fresh) {
        Vec3<F> o_ = to_volume(scene, medium.extinction, from);
        Vec3<F> d_ = transform_vector(scene.volume_to_local + 12 * medium.extinction, direction);
        const F *from_axis[3] = {&o_.x, &o_.y, &o_.z}, *along[3] = {&d_.x, &d_.y, &d_.z};
        F inverse[3], first(0), last = length;
        for (int k = 0; k < 3; ++k) {
            auto flat = mask<F>(abs(*along[k]) < F(S(1e-18)));
            inverse[k] = select(flat, F(S(1e18)), F(1) / select(flat, F(1), *along[k]));
            F a = -*from_axis[k] * inverse[k], b = (F(1) - *from_axis[k]) * inverse[k];
            first = max(first, min(a, b));
            last = min(last, max(a, b));
        }
        M meets = fresh && mask<F>(first < last);
        set(enter, first, fresh);
        set(t, F(0), fresh);
        set(end, max(last - first, F(0)), fresh);
        o = select(fresh, o_ + d_ * first, o);
        d = select(fresh, d_, d);
        const F *entered[3] = {&o.x, &o.y, &o.z};
        for (int k = 0; k < 3; ++k) {
            const S n = voxels(scene, medium, k) / S(medium.cell);  // the last cell may reach out of the grid
            I i = max(I(0), min(I(medium.cells[k] - 1), I(floor(*entered[k] * F(n)))));
            auto up = mask<F>(*along[k] > F(0)) || mask<F>(abs(*along[k]) < F(S(1e-18)));
            F edge = (F(i) + select(up, F(1), F(0))) * F(S(1) / n);
            set(border[k], (edge - *entered[k]) * inverse[k], fresh);
            set(width[k], abs(inverse[k]) * F(S(1) / n), fresh);
            auto fresh_i = mask<I>(fresh);
            at[k] = select(fresh_i, i, at[k]);
            step[k] = select(fresh_i, select(mask<I>(up), I(1), I(-1)), step[k]);
        }
        look_up(scene, medium, meets);
        return meets;
    }

    // Advances the lanes of `walking` to where `depth` is used up (`stopped`), into the next cell, or to the end
    // (`left`). Lanes that stopped or left are no longer among those walking.
    TR_INLINE void advance(const SceneView<S> &scene, const MediumInfo &medium, F &depth, M &walking, M &stopped,
                           M &left) {
        F nearest = min(border[0], min(border[1], border[2]));
        F to = max(min(nearest, end), t);
        F used = majorant * (to - t);
        M stops = walking && mask<F>(used > depth);
        M goes = walking && !stops;
        F safe = select(stops, majorant, F(1));
        t = select(stops, t + depth / safe, select(goes, to, t));
        depth = select(goes, depth - used, depth);
        M leaves = goes && mask<F>(to >= end);
        M crosses = goes && !leaves;
        for (int k = 0; k < 3; ++k) {
            // with two borders at the same distance the other one is crossed next, at no distance
            M here = crosses && mask<F>(border[k] <= nearest);
            border[k] = select(here, border[k] + width[k], border[k]);
            at[k] = select(mask<I>(here), at[k] + step[k], at[k]);
            leaves = leaves || (here && (mask<F>(at[k] < 0) || mask<F>(at[k] >= medium.cells[k])));
        }
        walking = crosses && !leaves;
        stopped = stopped || stops;
        left = left || leaves;
        if (any(walking)) look_up(scene, medium, walking);
    }

    TR_INLINE Vec3<F> local() const { return o + d * t; }

private:
    TR_INLINE static void set(F &to, const F &value, const M &where) { to = select(where, value, to); }
    TR_INLINE static S voxels(const SceneView<S> &scene, const MediumInfo &medium, int axis) {
        const int32_t *shape = scene.values.tensors[scene.volumes[medium.extinction].field[GridVolume::Data]].shape;
        return S(axis == 0 ? shape[1] : axis == 1 ? shape[0] : shape[3]);
    }
    TR_INLINE void look_up(const SceneView<S> &scene, const MediumInfo &medium, const M &where) {
        I index = (at[2] * medium.cells[1] + at[1]) * medium.cells[0] + at[0];
        F found = gather<F>(scene.majorants + medium.first, UIntOf<F>(index), where);
        majorant = select(where, found * F(scene.values.constants[medium.scale]), majorant);
    }
};

// The extinction of a gridded medium at a point of its unit cube.
template <int N, class F, class S>
TR_INLINE Spectrum<F, N> grid_extinction(const SceneView<S> &scene, const MediumInfo &medium, const Vec3<F> &local,
                                         const MaskOf<F> &active) {
    Spectrum<F> all = eval_grid(scene.values, Wavelengths<F>{}, scene.volumes[medium.extinction], local, active);
    Spectrum<F, N> r;
    for (int c = 0; c < N; ++c) r[c] = all[c] * F(scene.values.constants[medium.scale]);
    return r;
}

}  // namespace tr
