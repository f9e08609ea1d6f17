// Declarations of the media. What they are while rendering is in medium.h.
#pragma once

#include "../phase/phase.h"
#include "../volume/volume.h"

namespace tr {

struct MediumFields {
    enum { Extinction, Albedo, Emission, Scale, PhaseIndex };
    static constexpr Field fields[] = {
        {"sigma_t", Kind::Volume, 1, 0, INFINITY, "interior", "extinction per unit length; a grid is empty outside"},
        {"albedo", Kind::Volume, 0.75, 0, 1, "interior", "part of the extinction that is scattering"},
        {"emission", Kind::Volume, -1, 0, INFINITY, "interior", "radiance emitted per unit length; none: dark"},
        {"scale", Kind::Float, 1, 0, INFINITY, "interior", "factor of the extinction"},
        {"phase", Kind::Phase, -1, 0, INFINITY, "", "phase function, isotropic if not given"},
    };
};

struct HomogeneousMedium : MediumFields {
    static constexpr Model model = {
        "medium", "homogeneous",      "A medium whose extinction is the same everywhere.", MediumFields::fields, 5,
        0,        "HomogeneousMedium"};
};

struct HeterogeneousMedium : MediumFields {
    static constexpr Model model = {
        "medium", "heterogeneous",      "A medium whose extinction may be a grid.", MediumFields::fields, 5,
        0,        "HeterogeneousMedium"};
};

}  // namespace tr
