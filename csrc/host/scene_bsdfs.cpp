// BSDFs on the host: the tables of rough coatings, and what outputs show.
#include <algorithm>

#include "../core/integrator/bsdf_aovs.h"
#include "models.h"
#include "scene_data.h"

namespace tr {

namespace {

bool is_tabulated(const Record &record) {
    return record.kind < FirstWrapper && bsdf_kernels<PacketOf<float>>(record.kind).tabulated;
}

// Models without the field show a constant: no surface but a diffuse one is rough without a number that says so.
BsdfAovRow aov_row(const Record &record, BsdfAov output) {
    if (record.kind >= FirstWrapper) return {};  // a mixture: its parts are shown
    const BsdfInfo &info = bsdf_kernels<PacketOf<float>>(record.kind);
    const int field = output == BsdfAov::Albedo     ? info.albedo
                      : output == BsdfAov::Specular ? info.specular
                                                    : info.roughness;
    BsdfAovRow r;
    r.one = output == BsdfAov::Albedo || (output == BsdfAov::Roughness && !info.is(HasDeltaLobes));
    if (field >= 0) (info.use[field] == BsdfInfo::Number ? r.number : r.texture) = record.field[field];
    return r;
}

}  // namespace

void lay_out_bsdfs(SceneLayout &layout) {
    for (Record &record : layout.records.at("bsdf")) {
        for (const BsdfAov output : {BsdfAov::Albedo, BsdfAov::Specular, BsdfAov::Roughness}) {
            const BsdfAovRow row = aov_row(record, output);
            layout.bsdf_aovs.insert(layout.bsdf_aovs.end(), {row.texture, row.number, row.one});
        }
        if (!is_tabulated(record)) continue;
        record.field[Record::Extra] = layout.n_bsdf_numbers;
        layout.n_bsdf_numbers += RoughTransmittanceSize::Numbers;
    }
}

template <class S>
void SceneData<S>::update_bsdfs() {
    std::vector<Coating> coatings;
    std::vector<int32_t> begins;
    for (const Record &record : layout_.records.at("bsdf")) {
        if (!is_tabulated(record)) continue;
        const CoatingFields fields(model_of("bsdf", record));
        double eta = double(constants_[size_t(record.field[fields.eta])]);
        double alpha = double(constants_[size_t(record.field[fields.alpha])]);
        coatings.push_back(make_coating(eta, alpha, record.field[fields.distribution]));
        begins.push_back(record.field[Record::Extra]);
    }
    const bool fresh = bsdf_tables_.size() != size_t(layout_.n_bsdf_numbers) || coatings.size() != coatings_.size();
    bsdf_tables_.resize(size_t(layout_.n_bsdf_numbers));
    double numbers[RoughTransmittanceSize::Numbers];
    for (size_t i = 0; i < coatings.size(); ++i) {
        if (!fresh && coatings[i] == coatings_[i]) continue;
        fill_rough_transmittance(coatings[i], numbers);
        std::copy_n(numbers, RoughTransmittanceSize::Numbers, &bsdf_tables_[size_t(begins[i])]);
    }
    coatings_ = std::move(coatings);
}

#define TR_INSTANTIATE(S) template void SceneData<S>::update_bsdfs();
TR_FOR_EACH_PRECISION(TR_INSTANTIATE)
#undef TR_INSTANTIATE

}  // namespace tr
