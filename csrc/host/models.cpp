#include "models.h"

#include <stdexcept>

#include "../core/registry.h"

namespace tr {

namespace {

template <class... Ts>
void append(std::vector<ModelEntry> &all, TypeList<Ts...>, int first_kind = 0) {
    int kind = first_kind;
    (all.push_back({&Ts::model, kind++}), ...);
    static_assert(((Ts::model.n_fields <= Record::Fields) && ...), "a record has room for this many fields");
}

}  // namespace

const std::vector<ModelEntry> &all_models() {
    static const std::vector<ModelEntry> all = [] {
        std::vector<ModelEntry> r;
        append(r, Textures{});
        append(r, Bsdfs{});
        append(r, BsdfWrappers{}, TwoSidedKind);
        append(r, Emitters{});
        append(r, Shapes{});
        append(r, Sensors{});
        append(r, Volumes{});
        append(r, Phases{});
        append(r, Media{});
        append(r, Attributes{});
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
