// Choosing among emitters: by their sampling weights, and by those times their power.
#include <algorithm>
#include <cmath>

#include "../core/registry.h"
#include "models.h"
#include "scene_data.h"

namespace tr {

template <class S>
SceneData<S>::EmitterTable::EmitterTable(const std::vector<double> &weights)
    : cdf(weights.size()), pmf(weights.size()) {
    double total = build_cdf(weights.data(), weights.size(), cdf.data());
    for (size_t i = 0; i < weights.size(); ++i) pmf[i] = S(weights[i] / total);
}

template <class S>
void SceneData<S>::update_emitters() {
    const std::vector<Record> &records = layout_.records.at("emitter");
    std::vector<double> weights;
    for (size_t i = 0; i < records.size(); ++i) {
        const Model &model = model_of("emitter", records[i]);
        weights.push_back(double(constants_[size_t(records[i].field[field_named(model, "sampling_weight")])]));
        if (!(weights.back() >= 0))
            bad_value(path("emitter", int(i)) + ": field 'sampling_weight'", "a number that is not negative",
                      std::to_string(weights.back()));
    }
    check_frames();
    by_weight_ = by_power_ = {};
    if (weights.empty()) return;
    by_weight_.cdf.resize(weights.size());
    double total = build_cdf(weights.data(), weights.size(), by_weight_.cdf.data());
    if (!(total > 0))
        bad_value(path("emitter", 0) + ": field 'sampling_weight'", "an emitter with a positive weight",
                  "0 for all of them");
    // lights that have shrunk to nothing are not chosen while there are others
    std::vector<double> seen = weights;
    for (size_t i = 0; i < records.size(); ++i)
        if (model_of("emitter", records[i]).is(IsOnShape) && dark_[size_t(records[i].field[EmitterShape])]) seen[i] = 0;
    double total_seen = build_cdf(seen.data(), seen.size(), by_weight_.cdf.data());
    by_weight_ = EmitterTable(total_seen > 0 ? seen : weights);
}

// Frames of lights are inverted while rendering.
template <class S>
void SceneData<S>::check_frames() const {
    const std::vector<Record> &records = layout_.records.at("emitter");
    for (size_t i = 0; i < records.size(); ++i) {
        const Model &model = model_of("emitter", records[i]);
        for (int f = 0; f < model.n_fields; ++f) {
            if (model.fields[f].kind != Kind::Transform || int(i) == layout_.environment) continue;
            Affine m;
            std::copy_n(&constants_[size_t(records[i].field[f])], 12, m.m);
            m.inverse(path("emitter", int(i)) + ": field 'to_world'");
        }
    }
}

// Mean luminance of a texture; `shape` is the one it is on, or -1. Texels count alike, whatever a mesh shows of them.
template <class S>
double SceneData<S>::mean_of_texture(int32_t texture, int32_t shape) {
    const Record &record = layout_.records.at("texture")[size_t(texture)];
    switch (TextureKind(record.kind)) {
        case TextureKind::Constant:
            return mean_color(record.field[ConstantTexture::Value]);
        case TextureKind::Bitmap:
            return mean_of_tensor(record.field[Bitmap::Data]);
        case TextureKind::Checkerboard:
            return 0.5 * (mean_of_texture(record.field[Checkerboard::Color0], shape) +
                          mean_of_texture(record.field[Checkerboard::Color1], shape));
        case TextureKind::MeshAttribute: {
            int32_t a = shape < 0 ? -1 : MeshAttribute::find(view_, record, uint32_t(shape));
            if (a < 0) return 0;
            double scale = double(constants_[size_t(record.field[MeshAttribute::Scale])]);
            return std::abs(scale) * mean_of_tensor(layout_.attributes[size_t(a)].tensor);
        }
        case TextureKind::Volume: {
            const Record &volume = layout_.records.at("volume")[size_t(record.field[VolumeTexture::VolumeIndex])];
            return volume.kind == kind_of_model<GridVolume>(Volumes{})
                       ? mean_of_tensor(volume.field[GridVolume::Data])
                       : mean_color(volume.field[ConstantVolume::Value]);
        }
    }
    return 0;
}

template <class S>
double SceneData<S>::mean_color(int32_t offset) const {
    const S *from = &constants_[size_t(offset)];
    if (layout_.spectral)
        return std::abs(luminance_under_daylight([&](double at) { return double(from[size_t(std::lround(at))]); }));
    double c[3] = {0, 0, 0};
    for (int k = 0; k < layout_.channels; ++k) c[k] = double(from[k]);
    return std::abs(luminance_of(c, layout_.channels));
}

// Kept until the tensor changes.
template <class S>
double SceneData<S>::mean_of_tensor(int32_t slot) {
    auto found = mean_texels_.find(slot);
    if (found != mean_texels_.end()) return found->second;
    const TensorView<S> &tensor = tensors_[size_t(slot)];
    const size_t channels = size_t(tensor.shape[2]), n = size_t(layout_.slot_sizes[size_t(slot)]);
    double sum[3] = {0, 0, 0}, total = 0;
    if (channels == SigmoidChannels) {
        for (size_t i = 0; i < n; i += channels) total += std::abs(luminance_of(tensor.data + i, int(channels)));
    } else {
        for (size_t i = 0; i < n; ++i) sum[i % channels] += std::abs(double(tensor.data[i]));
        total = luminance_of(sum, int(channels));
    }
    return mean_texels_[slot] = total * double(channels) / double(n);
}

// Over the sphere: rows near the poles are short.
template <class S>
double SceneData<S>::mean_of_environment(int32_t slot) {
    auto found = mean_texels_.find(slot);
    if (found != mean_texels_.end()) return found->second;
    const TensorView<S> &tensor = tensors_[size_t(slot)];
    const size_t rows = size_t(tensor.shape[0]), columns = size_t(tensor.shape[1]), channels = size_t(tensor.shape[2]);
    double sum = 0, total = 0;
    for (size_t i = 0; i < rows; ++i) {
        double weight = std::sin(double(i) / double(std::max<size_t>(rows - 1, 1)) * Pi);
        for (size_t j = 0; j < columns; ++j) {
            const S *texel = tensor.data + (i * columns + j) * channels;
            double c[SigmoidChannels] = {};
            for (size_t k = 0; k < channels; ++k) c[k] = channels == 3 ? std::abs(double(texel[k])) : double(texel[k]);
            sum += weight * std::abs(luminance_of(c, int(channels)));
        }
        total += weight * double(columns);
    }
    return mean_texels_[slot] = total > 0 ? sum / total : 0;
}

// Power (luminance) that an emitter sends into the scene.
template <class S>
double SceneData<S>::power_of(const Record &record) {
    struct Means : EmitterMeans {
        SceneData &data;
        explicit Means(SceneData &of) : data(of) { disk = Pi * double(of.view_.radius) * double(of.view_.radius); }
        double number(int32_t offset) const override { return double(data.constants_[size_t(offset)]); }
        double color(int32_t offset) const override { return data.mean_color(offset); }
        double texture(int32_t index, int32_t shape) override { return data.mean_of_texture(index, shape); }
        double environment(int32_t slot) override { return data.mean_of_environment(slot); }
        double area(int32_t shape) const override { return double(data.areas_[size_t(shape)]); }
    } means(*this);
    return emitter_kernels<PacketOf<S>>(record.kind).power(means, record);
}

// Black lights keep a tenth of the mean: they have a derivative.
template <class S>
void SceneData<S>::choose_emitters(bool by_power) {
    if (by_power && by_power_.cdf.empty() && !by_weight_.cdf.empty()) {
        const std::vector<Record> &records = layout_.records.at("emitter");
        std::vector<double> weights(by_weight_.pmf.begin(), by_weight_.pmf.end()), power(records.size(), 0);
        double mean = 0, chosen = 0;
        for (size_t i = 0; i < records.size(); ++i) {
            if (!(weights[i] > 0)) continue;
            power[i] = std::max(power_of(records[i]), 0.0);
            mean += power[i], chosen += 1;
        }
        mean /= std::max(chosen, 1.0);
        for (size_t i = 0; i < records.size(); ++i)
            weights[i] *= mean > 0 && std::isfinite(mean) ? std::max(power[i], 0.1 * mean) : 1;
        by_power_ = EmitterTable(weights);
    }
    const EmitterTable &table = by_power ? by_power_ : by_weight_;
    view_.emitter_cdf = table.cdf.data();
    view_.emitter_pmf = table.pmf.data();
}

// the other functions of this file are called from these only
#define TR_INSTANTIATE(S)                          \
    template void SceneData<S>::update_emitters(); \
    template void SceneData<S>::choose_emitters(bool);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
