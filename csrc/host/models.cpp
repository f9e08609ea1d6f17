#include "models.h"

#include <stdexcept>

#include "../core/registry.h"

namespace tr {

namespace {

template <int MaxFields, class... Ts>
void append(std::vector<ModelEntry> &all, TypeList<Ts...>, int first_kind = 0) {
    int kind = first_kind;
    (all.push_back({&Ts::model, kind++}), ...);
    static_assert(((Ts::model.n_fields <= MaxFields) && ...), "a record has room for this many fields");
}

}  // namespace

const std::vector<ModelEntry> &all_models() {
    static const std::vector<ModelEntry> all = [] {
        std::vector<ModelEntry> r;
        append<Record::Extra>(r, Textures{});
        append<Record::Fields>(r, Bsdfs{});  // to which the host adds nothing
        append<Record::Extra>(r, BsdfWrappers{}, TwoSidedKind);
        append<Record::Extra>(r, Emitters{});
        append<Record::Extra>(r, Shapes{});
        append<Record::Extra>(r, Sensors{});
        append<Record::Extra>(r, Volumes{});
        append<Record::Extra>(r, Phases{});
        append<Record::Extra>(r, Media{});
        append<Record::Extra>(r, Attributes{});
        return r;
    }();
    return all;
}

const ModelEntry *find_model(const std::string &category, const std::string &type) {
    for (const ModelEntry &entry : all_models())
        if (category == entry.model->category && type == entry.model->type) return &entry;
    return nullptr;
}

const Model &model_of(const std::string &category, const Record &record) {
    for (const ModelEntry &entry : all_models())
        if (category == entry.model->category && entry.kind == record.kind) return *entry.model;
    throw std::logic_error(category + ": a record of an unknown kind");
}

std::string model_types(const std::string &category) {
    std::string r;
    for (const ModelEntry &entry : all_models())
        if (category == entry.model->category) r += (r.empty() ? "" : ", ") + std::string(entry.model->type);
    return r;
}

}  // namespace tr
