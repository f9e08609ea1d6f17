// Phase functions on the host: what blends may contain, and the tables of those given by numbers.
#include <cmath>
#include <limits>

#include "../core/phase/blend.h"
#include "../core/phase/tabulated.h"
#include "../core/registry.h"
#include "scene_data.h"

namespace tr {

namespace {

constexpr int BlendedKind = kind_of_model<BlendPhase>(Phases{});
constexpr int TabulatedKind = kind_of_model<TabulatedPhase>(Phases{});

// One number stands for all channels: a blend is a density, which has no colour.
bool is_grey(const SceneLayout &layout, const Record &volume) {
    if (volume.kind == int32_t(VolumeKind::Grid))
        return layout.tensor_shapes[size_t(volume.field[GridVolume::Data])][2] == 1;
    return volume.field[Record::Extra] != 0;
}

void check_blend(const SceneLayout &layout, const Record &record, const std::string &at) {
    for (int f : {BlendPhase::First, BlendPhase::Second})
        if (layout.records.at("phase")[size_t(record.field[f])].kind == BlendedKind)
            bad_value(at + ": field '" + BlendPhase::fields[f].name + "'", "a phase function that is no blend itself",
                      std::string("'") + BlendPhase::model.type + "'");
    if (!is_grey(layout, layout.records.at("volume")[size_t(record.field[BlendPhase::Weight])]))
        bad_value(at + ": field 'weight'", "a volume of one channel", "a coloured one");
}

}  // namespace

void lay_out_phases(SceneLayout &layout, const std::vector<std::vector<int64_t>> &param_shapes) {
    std::vector<Record> &phases = layout.records.at("phase");
    for (size_t i = 0; i < phases.size(); ++i) {
        Record &record = phases[i];
        if (record.kind == BlendedKind) check_blend(layout, record, layout.paths.at("phase")[i]);
        if (record.kind != TabulatedKind) continue;
        const std::vector<int64_t> &shape = param_shapes[size_t(record.field[TabulatedPhase::Data])];
        if (shape.size() != 1 || shape[0] < 2)
            bad_value(layout.paths.at("phase")[i] + ": field 'values'",
                      "a tensor of shape (N,) with at least 2 numbers",
                      std::to_string(shape.size()) + " dimensions, the first of size " + std::to_string(shape[0]));
        record.field[Record::Extra] = layout.n_phase_numbers;
        layout.n_phase_numbers += 1 + 2 * int(shape[0]);
    }
}

// Always made again: they are small, and asking what has changed costs as much.
template <class S>
void SceneData<S>::update_phases(const std::vector<uint8_t> &dirty) {
    const std::vector<Record> &phases = layout_.records.at("phase");
    phase_tables_.assign(size_t(layout_.n_phase_numbers), S(0));
    for (size_t i = 0; i < phases.size(); ++i) {
        const Record &record = phases[i];
        auto where = [&](const char *field) { return path("phase", int(i)) + ": field '" + field + "'"; };
        if (record.kind == BlendedKind) {
            const Record &weight = layout_.records.at("volume")[size_t(record.field[BlendPhase::Weight])];
            const S *numbers = &constants_[0];
            int64_t n = 1;
            if (weight.kind == int32_t(VolumeKind::Constant)) {
                numbers += weight.field[ConstantVolume::Value];
            } else {
                size_t slot = size_t(weight.field[GridVolume::Data]);
                numbers = tensors_[slot].data, n = dirty[slot] ? layout_.slot_sizes[slot] : 0;
            }
            for (int64_t k = 0; k < n; ++k)
                if (!(numbers[k] >= 0 && numbers[k] <= 1))
                    bad_value(where("weight"), "numbers from 0 to 1", std::to_string(numbers[k]));
        }
        if (record.kind != TabulatedKind) continue;
        const TensorView<S> &values = tensors_[size_t(record.field[TabulatedPhase::Data])];
        const int32_t n = values.shape[0];
        S *scale = &phase_tables_[size_t(record.field[Record::Extra])], *density = scale + 1, *below = density + n;
        double area = 0;  // the integral in units of the distance of two cosines
        for (int32_t k = 0; k < n; ++k) {
            if (!(values.data[k] >= 0) || !std::isfinite(values.data[k]))
                bad_value(where("values"), "finite numbers that are not negative",
                          std::to_string(values.data[k]) + " at element " + std::to_string(k));
            area += double(values.data[k]) * (k == 0 || k == n - 1 ? 0.5 : 1);
        }
        if (!(area > double(std::numeric_limits<S>::min()) * 1e6))  // its reciprocal must be finite, and its square
            bad_value(where("values"), "a positive number among them", "only zeros, or numbers next to them");
        const double factor = (n - 1) / (4 * Pi * area);
        *scale = S(factor);
        double sum = 0;
        for (int32_t k = 0; k < n; ++k) {
            density[k] = S(factor * double(values.data[k]));
            below[k] = S(sum / area);
            if (k < n - 1) sum += 0.5 * (double(values.data[k]) + double(values.data[k + 1]));
        }
        below[n - 1] = S(1);
    }
}

#define TR_INSTANTIATE(S) template void SceneData<S>::update_phases(const std::vector<uint8_t> &);
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
