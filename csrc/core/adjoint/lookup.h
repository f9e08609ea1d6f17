// The derivative of a texture's value with respect to everything in it that is not its data: where it is looked up, the
// map of its coordinates, the factor of an attribute, the place of a volume. (For the data see the sink.)
#pragma once

#include "gradient_sink.h"

namespace tr {

// Adjoint of a point on a surface: of its texture coordinates, and of its own coordinates (SurfacePoint::b1, b2) and
// its position where a look-up uses those directly.
template <class F>
struct CoordinateAdjoint {
    Vec2<F> uv{F(0), F(0)}, b{F(0), F(0)};
    Vec3<F> p{F(0), F(0), F(0)};
};

// Colours of a mesh, times `scale`, as a function of the barycentric coordinates.
template <class F>
TR_INLINE void sweep_attribute(const SceneOf<F> &scene, const Wavelengths<F> &waves, const AttributeInfo &info,
                               const Footprint<F, 3> &at, const F &scale, const Spectrum<F> &g, const MaskOf<F> &lanes,
                               CoordinateAdjoint<F> &to) {
    if (info.per_face) return;
    const auto &tensor = scene.values.tensors[info.tensor];
    Footprint<F, 3> b1 = at, b2 = at;
    b1.weight[0] = b2.weight[0] = -scale;
    b1.weight[1] = b2.weight[2] = scale;
    b1.weight[2] = b2.weight[1] = F(0);
    to.b.x = select(lanes, to.b.x + component_sum(g * gather_footprint(tensor, waves, b1, lanes)), to.b.x);
    to.b.y = select(lanes, to.b.y + component_sum(g * gather_footprint(tensor, waves, b2, lanes)), to.b.y);
}

// The adjoint of a grid's place: `row_bar` is that of a point `local` of its cube, as it moves with the cube.
template <class F>
TR_INLINE void sweep_volume_matrix(const Record &record, const Vec3<F> &local, const Vec3<F> &row_bar,
                                   const MaskOf<F> &active, GradientSink<F> &sink) {
    const F row[3] = {row_bar.x, row_bar.y, row_bar.z}, column[4] = {local.x, local.y, local.z, F(1)};
    for (int i = 0; i < 12; ++i)
        sink.scalar(IntOf<F>(record.field[GridVolume::ToWorld] + i), row[i / 4] * column[i % 4], active);
}

// `g` is the adjoint of a volume's value at p. Hands it to the volume's place, and returns the adjoint of p.
template <class F>
TR_LARGE Vec3<F> sweep_volume_place(const SceneOf<F> &scene, int32_t index, const Vec3<F> &p, const Spectrum<F> &g,
                                    const MaskOf<F> &active, GradientSink<F> &sink);

// `g` is the adjoint of the texture's value at `at`.
template <class F>
TR_LARGE void sweep_lookup(const SceneOf<F> &scene, const IntOf<F> &texture, const TexturedPoint<F> &at,
                           const Spectrum<F> &g, const MaskOf<F> &active, CoordinateAdjoint<F> &to,
                           GradientSink<F> &sink);
template <class F>
TR_LARGE void sweep_lookup(const SceneOf<F> &scene, const IntOf<F> &texture, const SurfacePoint<F> &at,
                           const Spectrum<F> &g, const MaskOf<F> &active, CoordinateAdjoint<F> &to,
                           GradientSink<F> &sink);

// `g` is the adjoint of the slopes of its luminance along u and v (texture/slopes.h): `values`, to its texels;
// `motion`, to the map of its coordinates and to where it is looked up, where bilinear heights have the mixed second
// derivative alone.
template <class F>
TR_LARGE void sweep_slopes(const SceneOf<F> &scene, const IntOf<F> &texture, const TexturedPoint<F> &at,
                           const Vec2<F> &g, bool values, bool motion, const MaskOf<F> &active,
                           CoordinateAdjoint<F> &to, GradientSink<F> &sink);

}  // namespace tr
