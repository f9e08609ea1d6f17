// The tables of rough coatings (core/bsdf/rough_transmittance.h), made of index and roughness.
#pragma once

#include "../core/bsdf/rough_transmittance.h"

namespace tr {

struct Coating {
    double eta = 0, alpha = 0;  // alpha as it is rendered with
    bool ggx = false;

    bool operator==(const Coating &o) const { return eta == o.eta && alpha == o.alpha && ggx == o.ggx; }
};

// Fills rows of 4 numbers, RoughTransmittanceSize::Numbers in all.
void fill_rough_transmittance(const Coating &coating, double *numbers);

}  // namespace tr
