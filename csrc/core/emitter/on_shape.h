// What the emitters of shapes share: a textured radiance, and points sampled by area, or by what an image on them
// shows.
#pragma once

#include "cells.h"
#include "kernels.h"

namespace tr {

// Lights that show an image have cells over the parallelogram of two triangles of one size, a rectangle for one, filled
// by the unit square as `sample_shape` does when it unfolds them. Weights are mixtures of what the image shows there
// and of its mean: black texels are chosen, too, since they have a derivative.
template <class F>
TR_INLINE CellGrid<F> light_cells(const SceneOf<F> &scene, const IntOf<F> &emitter, const MaskOf<F> &active) {
    using U = UIntOf<F>;
    IntOf<F> row[4];
    gather_few_rows<F>(&scene.light_cells->rows, UIntOf<F>(emitter * 4), active, row);
    return {scene.cell_marginal, scene.cell_conditional, U(row[0]), U(row[1]), U(row[2]), U(row[3])};
}

// Density of the square's points by which a point on such a light is chosen; 1 of others.
template <class F>
TR_INLINE F light_density(const SceneOf<F> &scene, const EmitterPoint<F> &point, const MaskOf<F> &active) {
    using U = UIntOf<F>;
    F density(1);
    if (!scene.light_cells) return density;
    CellGrid<F> grid = light_cells<F>(scene, point.emitter, active);
    auto chosen = active && mask<F>(grid.rows > 0u);
    if (!any(chosen)) return density;
    const SurfacePoint<F> &at = point.at;
    auto first = mask<F>(at.primitive == 0u);
    F both = at.b1 + at.b2, x = select(first, both, at.b1), y = select(first, at.b2, both);
    F rows = F(IntOf<F>(grid.rows)), columns = F(IntOf<F>(grid.columns));
    auto cell = [](const F &x, const F &n) { return U(IntOf<F>(max(F(0), min(floor(x * n), n - F(1))))); };
    U none(0u), row = select(mask<U>(chosen), cell(y, rows), none),
                column = select(mask<U>(chosen), cell(x, columns), none);
    return select(chosen, grid.mass(row, column, chosen) * rows * columns, density);
}

// A point of the unit square in place of (x, y), and its density; lanes without cells keep theirs. Returns those with.
template <class F>
TR_INLINE MaskOf<F> choose_light_cell(const SceneOf<F> &scene, const IntOf<F> &emitter, const MaskOf<F> &active, F &x,
                                      F &y, F &density) {
    density = F(1);
    if (!scene.light_cells) return MaskOf<F>(false);
    CellGrid<F> grid = light_cells<F>(scene, emitter, active);
    auto chosen = active && mask<F>(grid.rows > 0u);
    if (!any(chosen)) return chosen;
    grid.rows = max(grid.rows, UIntOf<F>(1u)), grid.columns = max(grid.columns, UIntOf<F>(1u));
    SampledCell<F> cell(grid, y, x, chosen);
    F rows = F(IntOf<F>(grid.rows)), columns = F(IntOf<F>(grid.columns));
    x = select(chosen, (F(IntOf<F>(cell.column)) + cell.across) / columns, x);
    y = select(chosen, (F(IntOf<F>(cell.row)) + cell.down) / rows, y);
    density = select(chosen, cell.mass * rows * columns, density);
    return chosen;
}

template <class Model, class F>
struct OnShape {
    using M = MaskOf<F>;
    using Scene = SceneOf<F>;

    TR_HD static void eval(const Scene &scene, const Wavelengths<F> &waves, const EmitterPoint<F> &point,
                           const M &lanes, Spectrum<F> &r) {
        IntOf<F> texture = emitter_field<F>(scene, Model::Radiance, point.emitter, lanes);
        r = select(lanes, eval_texture(scene, waves, texture, point.at, lanes), r);
    }

    TR_HD static void vjp(const Scene &scene, const EmitterPoint<F> &point, const Vec3<F> &, const Spectrum<F> &g,
                          const GradientNeeds &needs, const M &lanes, CoordinateAdjoint<F> &at, Vec3<F> &,
                          GradientSink<F> &sink) {
        IntOf<F> texture = emitter_field<F>(scene, Model::Radiance, point.emitter, lanes);
        if (needs.emitter) sink.texture(scene, texture, point.at, g, lanes);
        if (needs.geometry) sweep_lookup(scene, texture, point.at, g, lanes, at, sink);
    }

protected:
    TR_HD static UIntOf<F> shape_of(const Scene &scene, const IntOf<F> &emitter, const M &lanes) {
        return UIntOf<F>(emitter_field<F>(scene, EmitterShape, emitter, lanes));
    }

    TR_INLINE static void put(const SurfacePoint<F> &from, const M &lanes, SurfacePoint<F> &to) {
        auto lanes_u = mask<UIntOf<F>>(lanes);
        to.shape = select(lanes_u, from.shape, to.shape);
        to.primitive = select(lanes_u, from.primitive, to.primitive);
        to.b1 = select(lanes, from.b1, to.b1);
        to.b2 = select(lanes, from.b2, to.b2);
    }

    // A point, and light that leaves it along its normal.
    TR_HD static SampledPoint<F> sample_point(const Scene &scene, const F &left, const F &a, const F &b,
                                              const F &inverse_pmf, const M &lanes, EmissionSample<F> &r) {
        F x = a, y = b, density;
        choose_light_cell(scene, r.point.emitter, lanes, x, y, density);
        SampledPoint<F> q = sample_shape<F>(scene, shape_of(scene, r.point.emitter, lanes), left, x, y, lanes, M(true));
        put(q.at, lanes, r.point.at);
        r.p = select(lanes, q.p, r.p);
        r.n = select(lanes, q.n, r.n);
        r.d = select(lanes, q.n, r.d);
        r.inverse_pdf = select(lanes, inverse_pmf / (q.pdf * density), r.inverse_pdf);
        return q;
    }

    // Of a light path's beginning: the surface's texture coordinates, where nothing else moves.
    TR_HD static void sweep_coordinates(const Scene &scene, const VertexRecord<F> &v, const CoordinateAdjoint<F> &at,
                                        const M &lanes, GradientSink<F> &sink) {
        if (!scene.textured) return;
        HitAdjoint<F> hit;
        hit.at = at;
        sweep_area(scene, v.light.at, v.p, v.normal, F(0), hit, lanes, sink);
    }
};

}  // namespace tr
