// Looking up volumes. The index of a volume is the same in all lanes: callers go through media one by one.
#pragma once

#include "constant.h"
#include "grid.h"

namespace tr {

enum class VolumeKind : int32_t { Constant = 0, Grid = 1 };  // order of the registry

// A point in the space of a grid's unit cube.
template <class F, class S>
TR_INLINE Vec3<F> to_volume(const SceneView<S> &scene, int32_t volume, const Vec3<F> &p) {
    return transform_point(scene.volume_to_local + 12 * volume, p);
}

// The weighted sum of voxels. A grey grid with its neighbours next to each other is read two voxels at a time.
template <class F, class S>
TR_INLINE Spectrum<F> gather_voxels(const TensorView<S> &grid, const Wavelengths<F> &waves, const Footprint<F, 8> &at,
                                    bool adjacent, const MaskOf<F> &active) {
    if (!adjacent || grid.shape[2] != 1) return gather_footprint(grid, waves, at, active);
    F sum(0);
    for (int k = 0; k < 8; k += 2) {
        F row[2];
        gather_rows<F>(grid.data, at.texel[k], active, row);
        sum = fmadd(at.weight[k], row[0], fmadd(at.weight[k + 1], row[1], sum));
    }
    return uniform_spectrum(sum);
}

// A grid at a point of its unit cube.
template <class F, class S>
TR_INLINE Spectrum<F> eval_grid(const Values<S> &values, const Wavelengths<F> &waves, const Record &record,
                                const Vec3<F> &local, const MaskOf<F> &active) {
    const TensorView<S> &grid = values.tensors[record.field[GridVolume::Data]];
    if (!grid.data) return uniform_spectrum(F(0));  // a tangent that was not given
    const bool adjacent =
        record.field[GridVolume::Wrap] == 2 && record.field[GridVolume::Filter] == 0 && grid.shape[1] > 1;
    return gather_voxels(grid, waves, GridVolume::footprint(grid, record, local), adjacent, active);
}

// `values` is the scene's own for the value, a tangent's for its forward-mode derivative: volumes are linear in their
// data.
template <class F, class S>
TR_INLINE Spectrum<F> eval_volume(const SceneView<S> &scene, const Values<S> &values, const Wavelengths<F> &waves,
                                  int32_t volume, const Vec3<F> &p, const MaskOf<F> &active) {
    const Record &record = scene.volumes[volume];
    if (record.kind == int32_t(VolumeKind::Constant))
        return constant_spectrum<F>(values, waves, record.field[ConstantVolume::Value]);
    return eval_grid(values, waves, record, to_volume(scene, volume, p), active);
}

}  // namespace tr
