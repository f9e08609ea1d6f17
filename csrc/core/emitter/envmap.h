// `envmap`: radiance from infinitely far away, an image over directions in latitude and longitude. In the emitter's
// frame d: u = atan2(d.x, -d.z) / (2 pi), v = acos(d.y) / pi. Column j is centred at u = (j + 0.5) / columns, periodic;
// row i lies at v = i / (rows - 1), so the first and the last row are the poles. Bilinear.
//
// Sampling: the cells between texel centres (cells.h), each with the mean luminance of its corners times sin(theta).
#pragma once

#include "../texture/bitmap.h"
#include "cells.h"

namespace tr {

struct EnvironmentMap {
    static constexpr Field fields[] = {
        {"data", Kind::Tensor, None, 0, INFINITY, "interior", "radiance (rows, columns, channels), linear"},
        {"scale", Kind::Float, 1, 0, INFINITY, "interior", "factor of all texels"},
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, "interior",
         "rotation from the emitter's frame to the world"},
        {"sampling_weight", Kind::Float, 1, 0, INFINITY,
         "none: a probability; images do not depend on it in expectation",
         "relative probability of choosing this emitter"},
    };
    static constexpr int Data = field_index(fields, "data"), Scale = field_index(fields, "scale"),
                         ToWorld = field_index(fields, "to_world");
    static constexpr Model model = {
        "emitter", "envmap", "An environment map.", fields, 4, IsEnvironment | IsInfinite, "EnvironmentMap"};

    template <class F, class S>
    TR_INLINE static Vec2<F> to_uv(const SceneView<S> &scene, const Vec3<F> &d) {
        Vec3<F> local = normalize(transform_vector(scene.env_to_local, d));
        F u = atan2(local.x, -local.z) * F(1 / (2 * Pi)), v = acos(max(F(-1), min(F(1), local.y))) * F(1 / Pi);
        return {u - floor(u), v};
    }

    template <class F, class S>
    TR_INLINE static Footprint<F, 4> footprint(const TensorView<S> &tensor, const Vec2<F> &uv) {
        using I = IntOf<F>;
        int rows = tensor.shape[0], columns = tensor.shape[1];
        F x = uv.x * F(S(columns)) - F(0.5), y = uv.y * F(S(rows - 1));
        F fx = floor(x), fy = min(floor(y), F(S(rows > 1 ? rows - 2 : 0)));
        F a = x - fx, b = y - fy;
        I x0 = I(fx), y0 = max(I(0), I(fy));
        x0 = select(mask<I>(x0 < 0), x0 + columns, x0);
        x0 = select(mask<I>(x0 >= columns), x0 - columns, x0);
        I x1 = select(mask<I>(x0 == columns - 1), I(0), x0 + 1), y1 = min(y0 + 1, I(rows - 1));
        return bilinear_footprint<F>(x0, x1, y0, y1, columns, a, b);
    }

    // density per solid angle of the direction with these coordinates
    template <class F, class S>
    TR_INLINE static F pdf(const SceneView<S> &scene, const Vec2<F> &uv, const MaskOf<F> &active) {
        using I = IntOf<F>;
        using U = UIntOf<F>;
        int columns = scene.env_columns, rows = scene.env_rows;
        F x = uv.x * F(S(columns)) - F(0.5);
        I j = I(floor(x));
        j = select(mask<I>(j < 0), j + columns, j);
        j = select(mask<I>(j >= columns), j - columns, j);
        I i = max(I(0), min(I(floor(uv.y * F(S(rows)))), I(rows - 1)));
        return density(scene, grid<F>(scene).mass(U(i), U(j), active), uv.y);
    }

    template <class F, class S>
    TR_INLINE static Vec3<F> sample(const SceneView<S> &scene, const F &u1, const F &u2, Vec2<F> &uv, F &pdf,
                                    const MaskOf<F> &active) {
        SampledCell<F> cell(grid<F>(scene), u1, u2, active);
        uv.x = (F(IntOf<F>(cell.column)) + F(0.5) + cell.across) * F(1.0 / uint32_t(scene.env_columns));
        uv.x = uv.x - floor(uv.x);
        uv.y = (F(IntOf<F>(cell.row)) + cell.down) * F(1.0 / uint32_t(scene.env_rows));
        F sin_phi, cos_phi, sin_theta, cos_theta;
        sincos(uv.x * F(2 * Pi), sin_phi, cos_phi);
        sincos(uv.y * F(Pi), sin_theta, cos_theta);
        pdf = density(scene, cell.mass, uv.y);
        return normalize(
            transform_vector(scene.env_to_world, Vec3<F>{sin_theta * sin_phi, cos_theta, -sin_theta * cos_phi}));
    }

private:
    template <class F, class S>
    TR_INLINE static CellGrid<F> grid(const SceneView<S> &scene) {
        using U = UIntOf<F>;
        return {scene.env_marginal,
                scene.env_conditional,
                U(uint32_t(scene.env_rows)),
                U(uint32_t(scene.env_columns)),
                U(0u),
                U(0u)};
    }
    // probability of a cell -> density per solid angle: d omega = 2 pi^2 sin(theta) du dv
    template <class F, class S>
    TR_INLINE static F density(const SceneView<S> &scene, const F &mass, const F &v) {
        F sin_theta = sin(v * F(Pi));
        auto usable = mask<F>(sin_theta > F(1e-6));
        F cells(S(scene.env_columns) * S(scene.env_rows));
        return select(usable, mass * cells / (F(2 * Pi * Pi) * select(usable, sin_theta, F(1))), F(0));
    }
};

}  // namespace tr
