// BSDFs on the host: the tables of rough coatings.
#include <algorithm>

#include "../core/registry.h"
#include "scene_data.h"

namespace tr {

namespace {

constexpr int Coated = kind_of_model<RoughPlastic>(Bsdfs{});
constexpr int EtaField = 0, AlphaField = 1, DistributionField = 4;

}  // namespace

void lay_out_bsdfs(SceneLayout &layout) {
    for (Record &record : layout.records.at("bsdf")) {
        if (record.kind != Coated) continue;
        record.field[Record::Extra] = layout.n_bsdf_numbers;
        layout.n_bsdf_numbers += CoatTableSize::Numbers;
    }
}

template <class S>
void SceneData<S>::update_bsdfs() {
    std::vector<Coat> coats;
    std::vector<int32_t> begins;
    for (const Record &record : layout_.records.at("bsdf")) {
        if (record.kind != Coated) continue;
        double eta = double(constants_[size_t(record.field[EtaField])]);
        double alpha = double(constants_[size_t(record.field[AlphaField])]);
        bool ggx = record.field[DistributionField] == int32_t(Microfacets::Ggx);
        coats.push_back({std::max(eta, 1e-3), rendered_alpha(alpha), ggx});
        begins.push_back(record.field[Record::Extra]);
    }
    const bool fresh = bsdf_tables_.size() != size_t(layout_.n_bsdf_numbers) || coats.size() != coats_.size();
    bsdf_tables_.resize(size_t(layout_.n_bsdf_numbers));
    double numbers[CoatTableSize::Numbers];
    for (size_t i = 0; i < coats.size(); ++i) {
        if (!fresh && coats[i] == coats_[i]) continue;
        fill_coat_table(coats[i], numbers);
        std::copy_n(numbers, CoatTableSize::Numbers, &bsdf_tables_[size_t(begins[i])]);
    }
    coats_ = std::move(coats);
}

template void SceneData<float>::update_bsdfs();
template void SceneData<double>::update_bsdfs();

}  // namespace tr
