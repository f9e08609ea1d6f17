// The tables of rough coatings (core/bsdf/coat_table.h), made of index and roughness.
#pragma once

#include "../core/bsdf/coat_table.h"

namespace tr {

struct Coat {
    double eta = 0, alpha = 0;  // alpha as it is rendered with
    bool ggx = false;

    bool operator==(const Coat &o) const { return eta == o.eta && alpha == o.alpha && ggx == o.ggx; }
};

// Fills rows of 4 numbers, CoatTableSize::Numbers in all.
void fill_coat_table(const Coat &coat, double *numbers);

}  // namespace tr
