#include "camera.h"

namespace tr {

namespace {

// Of any other camera. `g.o` is the adjoint of the ray's `center`, `start_bar` that of the distance from there to where
// things begin to be seen. The matrix takes o to M o + t and d to M d, of length |M d|; the few numbers of the model
// reach both, in the camera's frame, through dual numbers.
template <class Model, class F, class S>
TR_LARGE void sweep_lens(const SceneView<S> &scene, const Record &record, const CameraSample<F> &sample, S width,
                         S height, const RayAdjoint<F> &g, const F &start_bar, const MaskOf<F> &active,
                         GradientSink<F> &sink) {
    constexpr int N = Model::N + Model::Entries;
    using T = std::conditional_t<(N > 0), Dual<F, (N > 0 ? N : 1)>, F>;
    CameraNumbers<Model, T, F, S> numbers(scene, record);
    LocalRay<T, F> local = Model::local(numbers.value, film_sample<Model, F, S>(scene, record, sample, width, height));
    const S *to_world = scene.values.constants + record.field[Model::ToWorld];
    Vec3<F> o = values_of(local.o), d = values_of(local.d);
    F start = value_of(local.start);
    Vec3<F> m = transform_vector(to_world, d);
    F length = norm(m), inverse = F(1) / length;
    Vec3<F> direction = m * inverse;
    Vec3<F> m_bar = unnormalize(direction, g.d, inverse) + direction * (start * start_bar);

    const F row[3] = {m_bar.x, m_bar.y, m_bar.z}, move[3] = {g.o.x, g.o.y, g.o.z};
    const F of_d[3] = {d.x, d.y, d.z}, of_o[3] = {o.x, o.y, o.z};
    int32_t at = record.field[Model::ToWorld];
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) sink.scalar(IntOf<F>(at + 4 * i + j), row[i] * of_d[j] + move[i] * of_o[j], active);
    if constexpr (std::is_same_v<Model, Distant>) {
        if (record.field[Distant::Target] >= 0) {
            Footprint<F, 3> target{{UIntOf<F>(0u), UIntOf<F>(1u), UIntOf<F>(2u)}, {move[0], move[1], move[2]}};
            sink.taps(record.field[Distant::Target], target, active);
        }
    } else {
        for (int i = 0; i < 3; ++i) sink.scalar(IntOf<F>(at + 4 * i + 3), move[i], active);
    }
    if constexpr (N > 0) {
        Vec3<F> o_bar = transform_normal(to_world, g.o), d_bar = transform_normal(to_world, m_bar);
        F s_bar = start_bar * length;
        auto derivative = [&](int i) {
            return local.o.x.d[i] * o_bar.x + local.o.y.d[i] * o_bar.y + local.o.z.d[i] * o_bar.z +
                   local.d.x.d[i] * d_bar.x + local.d.y.d[i] * d_bar.y + local.d.z.d[i] * d_bar.z +
                   local.start.d[i] * s_bar;
        };
        static constexpr auto fields = Model::Numbers;
        for (int i = 0; i < Model::N; ++i) sink.scalar(IntOf<F>(record.field[fields[i]]), derivative(i), active);
        if constexpr (Model::Entries > 0) {
            Footprint<F, Model::Entries> table;
            for (int i = 0; i < Model::Entries; ++i)
                table.texel[i] = UIntOf<F>(uint32_t(i)), table.weight[i] = derivative(Model::N + i);
            sink.taps(record.field[Model::Table], table, active);
        }
    }
}

}  // namespace

template <class F>
TR_LARGE void sweep_pinhole(const SceneOf<F> &scene, const Record &record, const F &x, const F &y, ScalarOf<F> width,
                            ScalarOf<F> height, const RayAdjoint<F> &g, const Vec3<F> &direction_bar,
                            const MaskOf<F> &active, GradientSink<F> &sink) {
    using S = ScalarOf<F>;
    Perspective::FilmPoint<F, S> film(scene, record, x, y, width, height);
    Vec3<F> u = film.direction();
    F inverse = F(1) / norm(u);
    Vec3<F> local = u * inverse;
    Vec3<F> m = transform_vector(film.to_world, local);
    F inverse_m = F(1) / norm(m);
    Vec3<F> m_bar = unnormalize(m * inverse_m, g.d, inverse_m);

    const F row[3] = {m_bar.x, m_bar.y, m_bar.z}, move[3] = {g.o.x, g.o.y, g.o.z},
            column[3] = {local.x, local.y, local.z};
    int32_t to_world = record.field[Perspective::ToWorld];
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) sink.scalar(IntOf<F>(to_world + 4 * i + j), row[i] * column[j], active);
        sink.scalar(IntOf<F>(to_world + 4 * i + 3), move[i], active);
    }

    Vec3<F> u_bar = unnormalize(local, transform_normal(film.to_world, m_bar), inverse) + direction_bar;
    auto add = [&](int field, const F &value) { sink.scalar(IntOf<F>(record.field[field]), value, active); };
    F by_x = u_bar.x * film.slope, by_y = u_bar.y * film.rise;
    add(Perspective::OffsetX, by_x * F(-2));
    add(Perspective::OffsetY, by_y * F(-2));
    add(Perspective::Aspect, by_y * film.b * (S(1) / film.constants[record.field[Perspective::Aspect]]));
    S degrees = (S(1) + film.slope * film.slope) / film.slope * S(Pi / 360);  // d slope / d fov, over slope
    add(Perspective::Fov, (by_x * film.a + by_y * film.b) * degrees);
}

template <class F>
TR_LARGE void sweep_camera(const SceneOf<F> &scene, const Record &record, const CameraSample<F> &sample,
                           ScalarOf<F> width, ScalarOf<F> height, const RayAdjoint<F> &g, const F &start_bar,
                           const MaskOf<F> &active, GradientSink<F> &sink) {
    if (is_pinhole(record))
        return sweep_pinhole(scene, record, sample.x, sample.y, width, height, g, Vec3<F>{F(0), F(0), F(0)}, active,
                             sink);
    with_lens(record, [&](auto model) {
        sweep_lens<decltype(model)>(scene, record, sample, width, height, g, start_bar, active, sink);
    });
}

#define TR_INSTANTIATE(F, S)                                                                                   \
    template void sweep_pinhole(const SceneView<S> &, const Record &, const F &, const F &, S, S,              \
                                const RayAdjoint<F> &, const Vec3<F> &, const MaskOf<F> &, GradientSink<F> &); \
    template void sweep_camera(const SceneView<S> &, const Record &, const CameraSample<F> &, S, S,            \
                               const RayAdjoint<F> &, const F &, const MaskOf<F> &, GradientSink<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
