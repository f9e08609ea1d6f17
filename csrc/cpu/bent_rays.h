// Flights of rays through a medium whose index of refraction varies, from where they begin to the last kick before they
// meet a surface; their derivatives; and the field by itself.
#pragma once

#include <algorithm>

#include "accel/accel.h"
#include "core/medium/bend_medium.h"

namespace tr {

// What a flight ends at. Rays that were given up have one of these in place of a shape.
enum : uint32_t { BentTooLong = Accel::Miss, BentTooFar = Accel::Miss - 1 };

// Its last kick: the state after it, as many steps before it, sums of Phi and of n over the kicks, with weights 1/2, 1,
// 1, ..., and what they do to light, if that is asked for; and what is hit from there, `t` steps away.
template <class F>
struct FlightEnd {
    BendState<F> state;
    IntOf<F> steps;
    F optical, length;
    LightSum<F> light;
    UIntOf<F> shape, primitive;
    F t, b1, b2;
};

// From q with the velocity u, in voxels and voxels a step. `offset`: in the world, from where the ray begins to a point
// off the surface that it leaves, which it does not meet again at once; 0: it leaves none. `light`: null, or what sums
// of it are wanted of.
template <class F>
FlightEnd<F> fly(const BendMedium<ScalarOf<F>> &medium, const Accel &accel, const Vec3<F> &q, const Vec3<F> &u,
                 const Vec3<F> &offset, const MaskOf<F> &active, const LightAlong<F> *light = nullptr);

// What a medium does to light by grids of its own, of 1 or 3 channels, in place of a scene's volumes.
template <class S>
struct LightGrids {
    enum { Extinction, Emission };
    TensorView<S> tensors[2]{};
    Record records[2]{};
    S factor = 1;  // of the extinction
    SceneView<S> scene{};
    BendLight<S> light{{-1, {}}, {-1, {}}, 0, 0};

    explicit LightGrids(S step) {
        light.step = step;
        scene.values = {&factor, tensors}, scene.volumes = records;
    }
    LightGrids(const LightGrids &) = delete;
    // `map`: from voxels of the medium to the grid's cube, 3 rows of 4.
    void set(int which, const TensorView<S> &data, int filter, int wrap, const S *map) {
        tensors[which] = data;
        Record &record = records[which];
        record.kind = int32_t(VolumeKind::Grid);
        record.field[GridVolume::Data] = which;
        record.field[GridVolume::Filter] = filter, record.field[GridVolume::Wrap] = wrap;
        BendVolume<S> &volume = which == Extinction ? light.extinction : light.emission;
        volume.volume = which;
        std::copy_n(map, 12, volume.to_local);
    }
};

// Arrays of n rows, in voxels and voxels a step unless stated.
template <class S>
struct BentRays {
    BendField<S> field;
    S constant;  // of Phi, which the field's values do not have
    bool quadratic;
    int threads;
    bool partials;  // derivatives by the field's values are as many arrays as there are threads, for the caller to add
    size_t n;

    // In: where a ray begins and its velocity.
    const S *q, *u;
    // What FlightEnd has: state (n, 6), steps; position and velocity; sums (n, 2); with `light` depth and what is
    // emitted (n, 3).
    BendInt<S> *state;
    int32_t *steps;
    S *last_q, *last_u, *sums, *depth, *emitted;
    const LightGrids<S> *light;  // null: they are not wanted
};

template <class S>
struct BentHits {
    uint32_t *shape, *primitive;
    S *t;
};
template <class S>
void trace_bent(const BendMedium<S> &medium, const Accel &accel, const BentRays<S> &rays, const S *offset,
                const BentHits<S> &hits);

// Adjoints of last_q, last_u, sums, depth and emitted in, of q, u, of the field's values (to which it is added) and of
// `kick` (6 numbers) out; likewise of grids and of their maps (12 numbers).
template <class S>
struct BentAdjoints {
    const S *last_q, *last_u, *sums, *depth, *emitted;
    S *q, *u, *values;
    double *kick;
    S *grids[2] = {};
    double *maps[2] = {};
};
template <class S>
void reverse_bent(const BentRays<S> &rays, const BentAdjoints<S> &adjoints);

// Tangents of what goes in, those of values and of `kick` as a field, and of what comes out; `rays.steps` are known.
template <class S>
struct BentTangents {
    BendField<S> field;
    const S *q, *u;
    S *last_q, *last_u, *sums, *depth, *emitted;
    TensorView<S> grids[2] = {};
    const S *maps[2] = {};
};
template <class S>
void forward_bent(const BentRays<S> &rays, const BentTangents<S> &tangents);

// The field at points `rays.q`: values (n,) and gradients (n, 3); their adjoints in, of points and of the field's
// values (added) out; tangents of points and values in, of both out.
template <class S>
struct FieldValues {
    S *value, *slope;
};
template <class S>
void evaluate_field(const BentRays<S> &rays, const FieldValues<S> &out);
template <class S>
void reverse_field(const BentRays<S> &rays, const FieldValues<S> &adjoints, S *q, S *values);
template <class S>
void forward_field(const BentRays<S> &rays, const BentTangents<S> &tangents, const FieldValues<S> &out);

}  // namespace tr
