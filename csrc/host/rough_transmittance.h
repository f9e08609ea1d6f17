// The tables of rough coatings (core/bsdf/rough_transmittance.h), made of index and roughness.
#pragma once

#include "../core/bsdf/rough_transmittance.h"
#include "../core/model.h"

namespace tr {

struct Coating {
    double eta = 0, alpha = 0;  // alpha as it is rendered with
    bool ggx = false;

    bool operator==(const Coating &o) const { return eta == o.eta && alpha == o.alpha && ggx == o.ggx; }
};

// The coating of a tabulated model, found by the names of the fields that all of them have.
struct CoatingFields {
    int eta, alpha, distribution;

    explicit CoatingFields(const Model &model)
        : eta(field_named(model, "eta")),
          alpha(field_named(model, "alpha")),
          distribution(field_named(model, "distribution")) {}
};

// With the values of these fields, as it is rendered.
Coating make_coating(double eta, double alpha, int32_t distribution);

// Fills rows of 4 numbers, RoughTransmittanceSize::Numbers in all.
void fill_rough_transmittance(const Coating &coating, double *numbers);

}  // namespace tr
