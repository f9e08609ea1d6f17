// Media that light bends in: what steps through them need, and where there are surfaces.
#include <algorithm>
#include <cmath>

#include "../core/medium/medium.h"
#include "placement.h"
#include "scene_data.h"

namespace tr {

template <class S>
void SceneData<S>::update_bends() {
    using Fields = GradientIndexMedium;
    constexpr int Index = field_index(Fields::fields, "index"), Base = field_index(Fields::fields, "index_base"),
                  ToWorld = field_index(Fields::fields, "to_world"), ExtIor = field_index(Fields::fields, "ext_ior"),
                  Spline = field_index(Fields::fields, "interpolation"), Step = field_index(Fields::fields, "step"),
                  SigmaT = field_index(Fields::fields, "sigma_t"), Emission = field_index(Fields::fields, "emission"),
                  Scale = field_index(Fields::fields, "scale"), MaxSteps = field_index(Fields::fields, "max_steps");
    view_.bends = nullptr;
    const auto &media = layout_.media;
    if (std::none_of(media.begin(), media.end(), [](const MediumInfo &m) { return (m.flags & Bends) != 0; })) return;
    bends_.resize(media.size());
    blocks_.resize(media.size());
    for (size_t m = 0; m < media.size(); ++m) {
        if (!(media[m].flags & Bends)) continue;
        const int32_t *field = layout_.records.at("medium")[m].field;
        auto where = [&](const char *name) { return path("medium", int(m)) + ": field '" + name + "'"; };
        auto constant = [&](int f) { return double(constants_[size_t(field[f])]); };
        BendMedium<S> &b = bends_[m];
        b.slot = field[Index];
        const TensorView<S> &values = tensors_[size_t(b.slot)];
        b.field.values = values.data;
        for (int k = 0; k < 3; ++k) b.field.n[k] = values.shape[2 - k] - 2 * BendField<S>::Padding;
        b.quadratic = field[Spline] == 1;
        // Python gives the differences from this index, see scene/gradientindex.py
        const double base = constant(Base), reference = base > 0 ? base : 1;
        b.constant = S(reference * reference / 2);
        const auto [low, high] = std::minmax_element(values.data, values.data + b.field.size());
        if (!(double(*low) + double(b.constant) > 0))
            bad_value(where("index"), "positive indices of refraction", "others");
        const double largest = std::sqrt(2 * (double(*high) + double(b.constant)));

        Affine placed;
        std::copy_n(&constants_[size_t(field[ToWorld])], 12, placed.m);
        double voxel = INFINITY, edges = 0;
        for (int k = 0; k < 3; ++k) {
            edges += placed.column_norm(k);
            for (int i = 0; i < 3; ++i) placed.m[4 * i + k] /= b.field.n[k];
            voxel = std::min(voxel, placed.column_norm(k));
        }
        const Affine inverse = placed.inverse(where("to_world"));
        const bool same =
            blocks_[m] && std::equal(placed.m, placed.m + 12, b.to_world, [](double a, S s) { return S(a) == s; });
        std::copy_n(placed.m, 12, b.to_world);
        std::copy_n(inverse.m, 12, b.to_voxels);
        // rounded up, so that steps hardly ever change in an optimisation
        const double voxels = constant(Step), step = voxels * voxel / (std::ceil(largest * 16) / 16);
        b.step = S(step);
        constexpr int entries[6][2] = {{0, 0}, {1, 1}, {2, 2}, {0, 1}, {0, 2}, {1, 2}};
        for (int e = 0; e < 6; ++e) {
            double sum = 0;
            for (int k = 0; k < 3; ++k)
                sum += double(inverse.m[4 * entries[e][0] + k]) * double(inverse.m[4 * entries[e][1] + k]);
            b.field.kick[e] = S(step * step * sum);
        }
        b.ext_ior = S(constant(ExtIor)), b.ext_ior_offset = field[ExtIor];
        b.to_world_offset = field[ToWorld];
        auto is_grid = [&](int32_t volume) {
            return layout_.records.at("volume")[size_t(volume)].kind == int32_t(VolumeKind::Grid);
        };
        auto volume = [&](int32_t number) {
            BendVolume<S> v{number, {}};
            if (number < 0 || !is_grid(number)) return v;
            double local[12], all[12] = {};
            std::copy_n(&volume_to_local_[12 * size_t(number)], 12, local);
            add_product(local, placed.m, false, all);
            std::copy_n(all, 12, v.to_local);
            return v;
        };
        b.light = {volume(field[SigmaT]), volume(field[Emission]), field[Scale], b.step};
        b.varies = field[Emission] >= 0 || is_grid(field[SigmaT]);
        const S reach = S(std::min(1.5 * voxels, 4.0));
        const int given = field[MaxSteps];
        b.max_steps = given > 0 ? given : int32_t(std::min(std::ceil(8 * edges / (voxel * voxels)), 1e9));
        if (!same || reach != b.reach || blocks_[m]->version != geometry_version_) {
            blocks_[m] = std::make_unique<BendBlocks>(view_, b.field.n, b.to_world, double(reach));
            blocks_[m]->version = geometry_version_;
        }
        b.reach = reach;
        b.blocks = blocks_[m]->words();
        std::copy_n(blocks_[m]->n(), 3, b.n_blocks);
    }
    view_.bends = bends_.data();
}

#define TR_INSTANTIATE(S) template void SceneData<S>::update_bends();
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
