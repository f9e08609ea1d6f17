// Media on the host: the maps into grids, and majorants of their extinction.
#include <algorithm>
#include <cmath>
#include <limits>

#include "../core/registry.h"
#include "scene_data.h"

namespace tr {

namespace {

// The largest value of `from` that a look-up between voxels c * cell and (c + 1) * cell of one axis can touch, for
// every c: interpolation reaches one voxel further. Axes: `outer` x n x `inner` numbers become `outer` x cells x
// `inner`.
template <class S>
std::vector<S> dilated_maximum(const S *from, size_t outer, int n, size_t inner, int cell, int wrap) {
    const int cells = (n + cell - 1) / cell;
    std::vector<S> to(outer * size_t(cells) * inner, S(0));
    for (size_t o = 0; o < outer; ++o)
        for (int c = 0; c < cells; ++c) {
            S *row = &to[(o * size_t(cells) + size_t(c)) * inner];
            for (int i = c * cell - 1; i <= std::min((c + 1) * cell, n); ++i) {
                const S *source = from + (o * size_t(n) + size_t(Bitmap::wrap<S>(i, n, wrap))) * inner;
                for (size_t k = 0; k < inner; ++k) row[k] = std::max(row[k], source[k]);
            }
        }
    return to;
}

constexpr double LargestThickness = 1e5;

template <class S>
void require_range(const S *data, int64_t n, S largest, const std::string &where, const char *expected) {
    auto [low, high] = std::minmax_element(data, data + n);
    if (*low < 0 || *high > largest) bad_value(where, expected, std::to_string(*low < 0 ? *low : *high));
}

}  // namespace

template <class S>
void SceneData<S>::update_media(const std::vector<uint8_t> &dirty) {
    const std::vector<Record> &volumes = layout_.records.at("volume");
    auto is_grid = [&](int32_t volume) { return volumes[size_t(volume)].kind == int32_t(VolumeKind::Grid); };
    volume_to_local_.assign(12 * volumes.size(), S(0));
    for (size_t i = 0; i < volumes.size(); ++i) {
        if (!is_grid(int32_t(i))) continue;
        Affine to_world;
        std::copy_n(&constants_[size_t(volumes[i].field[GridVolume::ToWorld])], 12, to_world.m);
        Affine inverse = to_world.inverse(path("volume", int(i)) + ": field 'to_world'");
        std::copy_n(inverse.m, 12, &volume_to_local_[12 * i]);
    }
    majorants_.assign(size_t(layout_.n_majorants), S(0));
    for (size_t m = 0; m < layout_.media.size(); ++m) {
        const MediumInfo &info = layout_.media[m];
        const bool bends = (info.flags & Bends) != 0;
        auto where = [&](const char *field) { return path("medium", int(m)) + ": field '" + field + "'"; };
        const int n_constant = layout_.spectral ? SpectrumSamples : layout_.channels;
        auto check = [&](int32_t volume, S largest, const char *field, const char *expected) {
            if (volume < 0) return;
            const Record &record = volumes[size_t(volume)];
            if (!is_grid(volume)) {
                require_range(&constants_[size_t(record.field[ConstantVolume::Value])], n_constant, largest,
                              where(field), expected);
                return;
            }
            size_t slot = size_t(record.field[GridVolume::Data]);
            if (tensors_[slot].shape[2] == SigmoidChannels) return;  // Python has looked at the colours
            if (dirty[slot])
                require_range(tensors_[slot].data, layout_.slot_sizes[slot], largest, where(field), expected);
        };
        const S unlimited = std::numeric_limits<S>::max();
        // a grid's with its majorants, whether or not it says that it has changed
        if (!(info.flags & IsGrid)) check(info.extinction, unlimited, "sigma_t", "numbers that are not negative");
        if (!bends) check(info.albedo, S(1), "albedo", "numbers from 0 to 1");
        check(info.emission, unlimited, "emission", "numbers that are not negative");
        require_range(&constants_[size_t(info.scale)], 1, unlimited, where("scale"), "a number that is not negative");
        const double scale = double(constants_[size_t(info.scale)]);
        if (!(info.flags & IsGrid)) {
            const S *value = &constants_[size_t(volumes[size_t(info.extinction)].field[ConstantVolume::Value])];
            if (!(double(*std::max_element(value, value + n_constant)) * scale <= double(unlimited)))
                bad_value(where("sigma_t"), "a finite product with scale", "infinity");
            continue;
        }
        // always made again, for the price of asking whether anything has changed
        const Record &record = volumes[size_t(info.extinction)];
        const TensorView<S> &grid = tensors_[size_t(record.field[GridVolume::Data])];
        const size_t nx = size_t(grid.shape[1]), ny = size_t(grid.shape[0]), nz = size_t(grid.shape[3]);
        const int wrap = record.field[GridVolume::Wrap], channels = grid.shape[2];
        std::vector<S> grey;
        const S *voxels = grid.data;
        if (channels > 1) {
            grey.resize(nx * ny * nz);
            for (size_t i = 0; i < grey.size(); ++i)
                grey[i] = *std::max_element(voxels + i * size_t(channels), voxels + (i + 1) * size_t(channels));
            voxels = grey.data();
        }
        S low(0);
        for (size_t i = 0; i < nx * ny * nz; ++i) low = std::min(low, voxels[i]);
        if (low < 0) bad_value(where("sigma_t"), "numbers that are not negative", std::to_string(low));
        std::vector<S> z = dilated_maximum(voxels, 1, int(nz), ny * nx, info.cell, wrap);
        std::vector<S> y = dilated_maximum(z.data(), size_t(info.cells[2]), int(ny), nx, info.cell, wrap);
        std::vector<S> x =
            dilated_maximum(y.data(), size_t(info.cells[2]) * size_t(info.cells[1]), int(nx), 1, info.cell, wrap);
        // a little more, for the rounding of interpolation
        S largest(0);
        for (size_t i = 0; i < x.size(); ++i) {
            majorants_[size_t(info.first) + i] = x[i] * S(1.00001);
            largest = std::max(largest, x[i]);
        }
        const S *to_world = &constants_[size_t(record.field[GridVolume::ToWorld])];
        double size = 0;
        for (int k = 0; k < 3; ++k)
            size = std::max(size, std::hypot(double(to_world[k]), double(to_world[4 + k]), double(to_world[8 + k])));
        if (!(double(largest) * scale * size <= LargestThickness))
            bad_value(where("sigma_t"),
                      "a largest extinction times the grid's size of at most 1e5: tracing takes a step for each",
                      std::to_string(double(largest) * scale * size));
    }
}

#define TR_INSTANTIATE(S) template void SceneData<S>::update_media(const std::vector<uint8_t> &);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
