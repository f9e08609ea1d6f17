#include "models.h"

#include <stdexcept>

#include "../core/registry.h"

namespace tr {

namespace {

using F = PacketOf<float>;  // of any arithmetic: models are the same in all

template <class... Ts>
void append(std::vector<ModelEntry> &all, TypeList<Ts...>, int first_kind = 0) {
    int kind = first_kind;
    (all.push_back({&Ts::model, kind++}), ...);
}

}  // namespace

const std::vector<ModelEntry> &all_models() {
    static const std::vector<ModelEntry> all = [] {
        std::vector<ModelEntry> r;
        append(r, Textures{});
        for (int kind = 0; kind < MaskHoleKind; ++kind) r.push_back({bsdf_kernels<F>(kind).model, kind});
        append(r, BsdfWrappers{}, FirstWrapper);
        for (int kind = 0; kind < EmitterKinds; ++kind) r.push_back({emitter_kernels<F>(kind).model, kind});
        append(r, Shapes{});
        append(r, Sensors{});
        append(r, Volumes{});
        for (int kind = 0; kind < PhaseKinds; ++kind) r.push_back({phase_kernels<F>(kind).model, kind});
        append(r, Media{});
        append(r, Attributes{});
        for (const ModelEntry &entry : r)  // what the host adds to a record stands behind its fields
            if (entry.model->n_fields > (entry.model->category == std::string("bsdf") ? Record::Fields : Record::Extra))
                throw std::logic_error(std::string(entry.model->type) + ": more fields than a record has room for");
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
    int kind = record.kind;
    if (category == "bsdf" && kind == GradientDielectricKind) kind = DielectricKind;
    for (const ModelEntry &entry : all_models())
        if (category == entry.model->category && entry.kind == kind) return *entry.model;
    throw std::logic_error(category + ": a record of an unknown kind");
}

std::string model_types(const std::string &category) {
    std::string r;
    for (const ModelEntry &entry : all_models())
        if (category == entry.model->category) r += (r.empty() ? "" : ", ") + std::string(entry.model->type);
    return r;
}

}  // namespace tr
