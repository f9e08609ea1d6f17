// Media: their grids, and which of them light cannot leave.
#include "../core/registry.h"
#include "../core/sensor/camera.h"
#include "layout_builder.h"
#include "models.h"

namespace tr {

void LayoutBuilder::connect_media() {
    const int grid = find_model("volume", GridVolume::model.type)->kind;
    const std::vector<Record> &volumes = out_.records["volume"];
    for (int i = 0; i < int(list("volume").size()); ++i) {
        if (volumes[size_t(i)].kind != grid) continue;
        const auto &s = shapes_[size_t(value("volume", i, GridVolume::Data))];
        if (s.size() != 4 || (s[3] != 1 && s[3] != out_.texel_channels()))
            fail(where("volume", i, "data"), "a tensor of shape (Z, Y, X, " + channel_choices() + ")", text(s));
    }
    for (int i = 0; i < int(list("medium").size()); ++i) {
        const int32_t *field = out_.records["medium"][size_t(i)].field;
        MediumInfo info{};
        if (list("medium")[size_t(i)].type == GradientIndexMedium::model.type) {
            using Fields = GradientIndexMedium;
            info.extinction = field[field_index(Fields::fields, "sigma_t")];
            info.emission = field[field_index(Fields::fields, "emission")];
            info.scale = field[field_index(Fields::fields, "scale")];
            info.albedo = info.phase = -1;
            info.flags = Bends;
            check_extinction(i, info);
            out_.media.push_back(info);
            continue;
        }
        info.extinction = field[MediumFields::Extinction];
        info.albedo = field[MediumFields::Albedo];
        info.emission = field[MediumFields::Emission];
        info.phase = field[MediumFields::PhaseIndex];
        info.scale = field[MediumFields::Scale];
        const Record &extinction = volumes[size_t(info.extinction)];
        if (extinction.kind != grid) {
            info.flags = out_.channels > 1 && !extinction.field[Record::Extra] ? IsChromatic : 0;
        } else {
            if (list("medium")[size_t(i)].type == HomogeneousMedium::model.type)
                fail(where("medium", i, "sigma_t"), "a constant", "a grid, which a heterogeneous medium may have");
            check_extinction(i, info);
            const auto &shape = out_.tensor_shapes[size_t(extinction.field[GridVolume::Data])];
            const int n[3] = {shape[1], shape[0], shape[3]};
            info.flags = IsGrid | (shape[2] > 1 ? IsChromatic : 0);
            info.cell = majorant_cell(n);
            info.first = out_.n_majorants;
            int64_t cells = 1;
            for (int k = 0; k < 3; ++k) cells *= info.cells[k] = (n[k] + info.cell - 1) / info.cell;
            out_.n_majorants += int(cells);
        }
        out_.media.push_back(info);
    }
}

void LayoutBuilder::check_extinction(int medium, const MediumInfo &info) {
    const Record &extinction = out_.records["volume"][size_t(info.extinction)];
    if (!out_.spectral || extinction.kind != int32_t(VolumeKind::Grid)) return;
    const auto &shape = out_.tensor_shapes[size_t(extinction.field[GridVolume::Data])];
    if (shape[2] > 1)
        fail(where("medium", medium, "sigma_t"), "one channel: an extinction on a grid has no spectrum",
             text({shape[2]}));
}

// Voxels along the side of a majorant's cell: small enough to follow the density, large enough that rays do not
// stop at a cell's border more often than at a collision.
int LayoutBuilder::majorant_cell(const int (&n)[3]) {
    int largest = std::max(n[0], std::max(n[1], n[2]));
    return largest >= 64 ? 8 : largest >= 16 ? 4 : 2;
}

bool LayoutBuilder::lets_through(int32_t bsdf) const {
    const Record &record = out_.records.at("bsdf")[size_t(bsdf)];
    return record.kind == NullKind;
}

void LayoutBuilder::find_enclosed_media() {
    for (const Record &emitter : out_.records["emitter"])
        if (!model_of("emitter", emitter).is(IsInfinite)) return;
    for (size_t m = 0; m < out_.media.size(); ++m) {
        bool bounded = false, open = false;
        for (const Record &sensor : out_.records["sensor"]) open |= camera_medium(sensor) == int32_t(m);
        for (const ShapeInfo &shape : out_.shapes) {
            if (shape.interior != int32_t(m) && shape.exterior != int32_t(m)) continue;
            bounded = true;
            open |= lets_through(shape.bsdf) || shape.exterior == int32_t(m);
        }
        out_.media[m].enclosed = bounded && !open;
    }
}

}  // namespace tr
