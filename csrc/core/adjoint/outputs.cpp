#include "outputs.h"

namespace tr {

namespace {

// The geometric normal of a mesh, which is that of the triangle; elsewhere it is the shading normal.
template <class F, class S>
TR_INLINE void sweep_face_normal(const SceneView<S> &scene, const Interaction<F> &si, const Vec3<F> &n_bar,
                                 const MaskOf<F> &mesh, GradientSink<F> &sink) {
    auto wanted = sink.wants_shape(si.at.shape, mesh);
    if (!any(wanted)) return;
    Triangle<F, S> tri(scene, UIntOf<F>(si.shape.face_offset) + si.at.primitive, wanted);
    Vec3<F> area = cross(tri.e1, tri.e2);
    F squared = squared_norm(area);
    wanted = wanted && mask<F>(squared > F(0));
    F inverse = F(1) / sqrt(select(wanted, squared, F(1)));
    Vec3<F> area_bar = unnormalize(area * inverse, n_bar, inverse);
    Vec3<F> e1_bar = cross(tri.e2, area_bar), e2_bar = cross(area_bar, tri.e1);
    sweep_mesh_vertex(VertexArray::Positions, tri.corner[0], -(e1_bar + e2_bar), wanted, sink);
    sweep_mesh_vertex(VertexArray::Positions, tri.corner[1], e1_bar, wanted, sink);
    sweep_mesh_vertex(VertexArray::Positions, tri.corner[2], e2_bar, wanted, sink);
}

}  // namespace

template <class F>
TR_LARGE void sweep_outputs(const SceneOf<F> &scene, const Record &record, const CameraFrame<ScalarOf<F>> &camera,
                            const CameraSample<F> &sample, ScalarOf<F> width, ScalarOf<F> height, const Vec3<F> &center,
                            const Vec3<F> &d, const Interaction<F> &si, const OutputAdjoint<F> &g, bool camera_wanted,
                            bool partials, const MaskOf<F> &active, GradientSink<F> &sink) {
    using S = ScalarOf<F>;
    const Vec3<F> zero{F(0), F(0), F(0)};
    Vec3<F> axis[3] = {widen<F>(camera.axis[0]), widen<F>(camera.axis[1]), widen<F>(camera.axis[2])};
    Vec3<F> from = si.p - center, axis_bar[3] = {zero, zero, zero};
    F t = norm(from);
    F by_length = (g.distance + g.ray_length) / select(active, t, F(1));
    Vec3<F> apart = axis[2] * g.depth + from * by_length;
    axis_bar[2] = (si.p - widen<F>(camera.origin)) * g.depth;

    HitAdjoint<F> hit;
    hit.at = g.at;
    if (partials) sweep_partials(scene, si.at, si.shape, g.partial_u, g.partial_v, active, hit.at, sink);
    hit.p = g.position + apart;
    Vec3<F> face = g.normal;
    hit.n = g.shading_normal;
    const F face_camera[3] = {g.normal_camera.x, g.normal_camera.y, g.normal_camera.z};
    const F turned[3] = {g.shading_normal_camera.x, g.shading_normal_camera.y, g.shading_normal_camera.z};
    for (int k = 0; k < 3; ++k) {
        face = face + axis[k] * face_camera[k];
        hit.n = hit.n + axis[k] * turned[k];
        axis_bar[k] = axis_bar[k] + si.ng * face_camera[k] + si.frame.n * turned[k];
    }
    auto mesh = active && !si.shape.has(IsCurved);
    if (any(mesh)) sweep_face_normal(scene, si, select(si.shape.has(FlipNormals), -face, face), mesh, sink);
    auto grid = active && si.shape.has(IsSdfGrid);  // has two normals
    hit.ng = select(grid, face, zero);
    hit.n = select(mesh || grid, hit.n, hit.n + face);

    Arrival<F> in{active, d, t, zero, zero, F(0)};
    RayAdjoint<F> ray = sweep_surface(scene, si.at, si.p, in, hit, active, sink);
    if (!camera_wanted) return;
    int32_t to_world = record.field[Perspective::ToWorld];
    for (int k = 0; k < 3; ++k) {
        Vec3<F> column = unnormalize(axis[k], axis_bar[k], F(S(1) / camera.length[k]));
        const F rows[3] = {column.x, column.y, column.z};
        for (int i = 0; i < 3; ++i) sink.scalar(IntOf<F>(to_world + 4 * i + k), rows[i], active);
    }
    if (!is_pinhole(record)) {  // depth is from the frame's origin, distances are from where the ray comes from
        const F forward[3] = {axis[2].x, axis[2].y, axis[2].z};
        for (int i = 0; i < 3; ++i) sink.scalar(IntOf<F>(to_world + 4 * i + 3), -(forward[i] * g.depth), active);
        ray.o = ray.o - from * by_length;
        return sweep_camera(scene, record, sample, width, height, ray, -g.ray_length, active, sink);
    }
    ray.o = ray.o - apart;
    // the near plane is met at near |u| along the ray
    Perspective::FilmPoint<F, S> film(scene, record, sample.x, sample.y, width, height);
    Vec3<F> u = film.direction();
    F near(-film.constants[record.field[Perspective::Near]]);
    sweep_pinhole(scene, record, sample.x, sample.y, width, height, ray, u * (g.ray_length * near / norm(u)), active,
                  sink);
}

#define TR_INSTANTIATE(F, S)                                                                                           \
    template void sweep_outputs(const SceneView<S> &, const Record &, const CameraFrame<S> &, const CameraSample<F> &, \
                                S, S, const Vec3<F> &, const Vec3<F> &, const Interaction<F> &,                        \
                                const OutputAdjoint<F> &, bool, bool, const MaskOf<F> &, GradientSink<F> &);
TR_FOR_EACH_FLOAT(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
