// The models of this build as data: what the bindings show to Python and the host checks scenes against.
#pragma once

#include <string>
#include <vector>

#include "../core/model.h"

namespace tr {

struct ModelEntry {
    const Model *model;
    int kind;  // what a record of this model holds: the position in the registry's list of its category
};

// All models, category by category in the order of the registry; wrappers of BSDFs follow the BSDFs.
const std::vector<ModelEntry> &all_models();

// nullptr if there is none of this type in the category.
const ModelEntry *find_model(const std::string &category, const std::string &type);

// The model of a record of this category.
const Model &model_of(const std::string &category, const Record &record);

// The types of a category, comma-separated, for messages.
std::string model_types(const std::string &category);

}  // namespace tr
