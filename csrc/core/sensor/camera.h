// A ray of any camera. That of an ideal pinhole is computed where it is wanted; the other models are chosen from once a
// packet, and share all that is not their own map from the film to a ray in the camera's frame, see local_ray.h.
#pragma once

#include "../math/philox.h"
#include "../registry.h"
#include "distorted.h"

namespace tr {

// A place on the film in pixels, the whole film being width x height, and one on the lens, in the unit square.
template <class F>
struct CameraSample {
    F x, y;
    F lens_x = F(0.5), lens_y = F(0.5);

    // from the numbers of block 0
    TR_INLINE void choose_lens(const Random4<F> &u) { lens_x = u.u[2], lens_y = u.u[3]; }
};

template <class F>
struct CameraRay {
    Ray<F> ray;
    F length;
    Vec3<F> center;  // where the ray comes from, before the near plane
    MaskOf<F> exists;
};

TR_INLINE bool is_pinhole(const Record &record) {
    if constexpr (!facts::Lens || !facts::Pinhole) return facts::Pinhole;
    return record.kind == kind_of_model<Perspective>(Sensors{}) && record.field[Perspective::Distortion] < 0;
}

// Calls f with a value of the camera's model, which is not that of an ideal pinhole.
template <class Call>
TR_INLINE void with_lens(const Record &record, Call &&f) {
    if (facts::has(facts::SensorKinds, kind_of_model<Perspective>(Sensors{})) &&
        record.kind == kind_of_model<Perspective>(Sensors{}))
        return f(DistortedPerspective{});
    dispatch(Sensors{}, record.kind, [&](auto model) {
        using Model = decltype(model);
        if constexpr (!std::is_same_v<Model, Perspective> && !std::is_same_v<Model, IrradianceMeter> &&
                      facts::has(facts::SensorKinds, kind_of_model<Model>(Sensors{})))
            f(model);
    });
}

// Whether there are a third and a fourth number for each ray.
TR_HD inline bool uses_lens(const Record &record) {
    bool lens = false;
    if (!is_pinhole(record)) with_lens(record, [&](auto model) { lens = decltype(model)::Lens; });
    return lens;
}

// The medium that the camera is in, -1: none.
TR_HD inline int32_t camera_medium(const Record &record) {
    if (is_pinhole(record)) return record.field[Perspective::Medium];
    int32_t medium = -1;
    with_lens(record, [&](auto model) {
        using Model = decltype(model);
        if constexpr (!std::is_same_v<Model, Distant>) medium = record.field[Model::Medium];
    });
    return medium;
}

// The numbers of a model, those in its table after the others. T is F or a dual number, of which each is a variable.
template <class Model, class T, class F, class S>
struct CameraNumbers {
    static constexpr int N = Model::N + Model::Entries;
    T value[N > 0 ? N : 1];

    TR_INLINE CameraNumbers(const SceneView<S> &scene, const Record &record) {
        static constexpr auto fields = Model::Numbers;  // device code cannot point into the member
        for (int i = 0; i < N; ++i) {
            F number(i < Model::N ? scene.values.constants[record.field[fields[i < Model::N ? i : 0]]]
                                  : scene.values.tensors[record.field[Model::Table]].data[i - Model::N]);
            if constexpr (std::is_same_v<T, F>)
                value[i] = number;
            else
                value[i] = T(number, i);
        }
    }
};

// Where the rays of a distant sensor go.
template <class S>
struct DistantBase {
    Vec3<S> p;      // what they aim at
    S radius, far;  // of the disk around it that they cover, and how far before it they start

    TR_INLINE DistantBase(const SceneView<S> &scene, const Record &record)
        : p{scene.center[0], scene.center[1], scene.center[2]}, radius(scene.radius / S(1.001)), far(scene.radius) {
        if (record.field[Distant::Target] < 0) return;
        const S *target = scene.values.tensors[record.field[Distant::Target]].data;
        Vec3<S> q{target[0], target[1], target[2]};
        far = far + norm(q - p);
        p = q, radius = S(0);
    }
};

template <class Model, class F, class S>
TR_INLINE FilmSample<F, S> film_sample(const SceneView<S> &scene, const Record &record, const CameraSample<F> &sample,
                                       S width, S height) {
    FilmSample<F, S> at;
    at.x = sample.x * F(S(1) / width), at.y = sample.y * F(S(1) / height);
    at.height = height / width;
    at.lens = {F(0), F(0)};
    if constexpr (Model::Lens) at.lens = square_to_disk(sample.lens_x, sample.lens_y);
    at.near = at.far = at.limit = S(0);
    const S *constants = scene.values.constants;
    if constexpr (std::is_same_v<Model, Distant>) {
        DistantBase<S> base(scene, record);
        at.near = base.radius, at.limit = base.far;
    } else if constexpr (!std::is_same_v<Model, RadianceMeter>) {
        at.near = constants[record.field[Model::Near]], at.far = constants[record.field[Model::Far]];
    }
    if constexpr (std::is_same_v<Model, Fisheye>) at.limit = constants[record.field[Fisheye::MaxAngle]] * S(Pi / 180);
    return at;
}

template <class F>
TR_INLINE Vec3<F> values_of(const Vec3<F> &v) {
    return v;
}
template <class F, int N>
TR_INLINE Vec3<F> values_of(const Vec3<Dual<F, N>> &v) {
    return {v.x.v, v.y.v, v.z.v};
}

template <class F, class S>
TR_NOINLINE CameraRay<F> lens_ray(const SceneView<S> &scene, const Record &record, const CameraSample<F> &sample,
                                  S width, S height) {
    CameraRay<F> r{};
    with_lens(record, [&](auto model) {
        using Model = decltype(model);
        CameraNumbers<Model, F, F, S> numbers(scene, record);
        LocalRay<F, F> local =
            Model::local(numbers.value, film_sample<Model, F, S>(scene, record, sample, width, height));
        const S *to_world = scene.values.constants + record.field[Model::ToWorld];
        Vec3<S> base{to_world[3], to_world[7], to_world[11]};
        if constexpr (std::is_same_v<Model, Distant>) base = DistantBase<S>(scene, record).p;
        r.center = transform_vector(to_world, local.o) + Vec3<F>{F(base.x), F(base.y), F(base.z)};
        Vec3<F> m = transform_vector(to_world, local.d);
        F length = norm(m);
        r.ray.d = m * (F(1) / length);
        r.ray.o = r.center + r.ray.d * (local.start * length);
        r.length = local.length;
        r.exists = local.exists;
    });
    return r;
}

template <class F, class S>
TR_INLINE CameraRay<F> camera_ray(const SceneView<S> &scene, const Record &record, const CameraSample<F> &sample,
                                  S width, S height) {
    if (!is_pinhole(record)) return lens_ray(scene, record, sample, width, height);
    CameraRay<F> r;
    r.ray = Perspective::ray(scene, record, sample.x, sample.y, width, height, r.length, r.center);
    r.exists = MaskOf<F>(true);
    return r;
}

// Whether all rays are parallel.
TR_HD inline bool is_parallel(const Record &record) {
    return record.kind == kind_of_model<Orthographic>(Sensors{}) || record.kind == kind_of_model<Distant>(Sensors{});
}

// Where on the film, in pixels, a point of the world is seen through the place on the lens of a sample; false where it
// is not, or the camera has no film of that kind. `distant` has that place instead, which is set.
template <class F, class S>
TR_NOINLINE MaskOf<F> film_place(const SceneView<S> &scene, const Record &record, const Vec3<F> &p, S width, S height,
                                 CameraSample<F> &sample) {
    MaskOf<F> seen(false);
    auto find = [&](auto model) {
        using Model = decltype(model);
        const S *m = scene.values.constants + record.field[Model::ToWorld];
        // the inverse of the matrix is that of its cofactors
        const Vec3<S> x{m[0], m[4], m[8]}, y{m[1], m[5], m[9]}, z{m[2], m[6], m[10]};
        const S inverse = S(1) / dot(x, cross(y, z));
        auto in_frame = [&](const Vec3<S> &origin) {
            const Vec3<F> d = p - origin;
            return Vec3<F>{dot(d, cross(y, z) * inverse), dot(d, cross(z, x) * inverse), dot(d, cross(x, y) * inverse)};
        };
        if constexpr (std::is_same_v<Model, Distant>) {
            // anywhere in its one pixel, through one place on the disk
            const DistantBase<S> base(scene, record);
            if (!(base.radius > 0)) return;
            const Vec3<F> local = in_frame(base.p);
            const Vec2<F> disk{local.x * F(S(1) / base.radius), local.y * F(S(1) / base.radius)};
            seen = mask<F>(disk.x * disk.x + disk.y * disk.y < F(1));
            const Vec2<F> lens = disk_to_square(disk);
            sample.lens_x = lens.x, sample.lens_y = lens.y;
            sample.x = F(width / 2), sample.y = F(height / 2);
        } else if constexpr (!std::is_same_v<Model, RadianceMeter>) {
            const Vec3<F> local = in_frame({m[3], m[7], m[11]});
            F numbers[DistortedPerspective::N + DistortedPerspective::Entries];
            static constexpr auto fields = Model::Numbers;  // device code cannot point into the member
            if (is_pinhole(record)) {                       // it has no coefficients
                for (int i = 0; i < Model::N; ++i) numbers[i] = F(scene.values.constants[record.field[fields[i]]]);
                for (int i = 0; i < Model::Entries; ++i) numbers[Model::N + i] = F(0);
            } else {
                CameraNumbers<Model, F, F, S> given(scene, record);
                for (int i = 0; i < Model::N + Model::Entries; ++i) numbers[i] = given.value[i];
            }
            Vec2<F> place{F(0), F(0)};
            seen = Model::seen(numbers, film_sample<Model, F, S>(scene, record, sample, width, height), local, place);
            sample.x = place.x * F(width), sample.y = place.y * F(height);
        }
    };
    if (is_pinhole(record))
        find(DistortedPerspective{});
    else
        with_lens(record, find);
    return seen;
}

}  // namespace tr
