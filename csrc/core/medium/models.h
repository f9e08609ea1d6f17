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

constexpr const char *BendEdges =
    "interior, without the motion of edges seen through the medium; zero where there are none or both sides of them "
    "are "
    "of equal colour";

// Light in it bends; see bend.h.
struct GradientIndexMedium {
    static constexpr const char *Splines[] = {"cubic", "quadratic", nullptr};
    static constexpr Field fields[] = {
        {"index", Kind::Tensor, None, -INFINITY, INFINITY, BendEdges,
         "control values (Z, Y, X) of the index of refraction, before base and scale"},
        {"index_base", Kind::Float, 0, -INFINITY, INFINITY, BendEdges, "added to the scaled control values"},
        {"index_scale", Kind::Float, 1, -INFINITY, INFINITY, BendEdges, "factor of the control values"},
        {"to_world", Kind::Transform, None, -INFINITY, INFINITY, BendEdges,
         "from the unit cube that the grid fills to the world"},
        {"ext_ior", Kind::Float, 1.000277, 1e-3, 1e3, BendEdges,
         "index of refraction outside of dielectric boundaries"},
        {"sigma_t", Kind::Volume, 0, 0, INFINITY, "interior", "absorption per unit length"},
        {"emission", Kind::Volume, -1, 0, INFINITY, "interior", "radiance emitted per unit length; none: dark"},
        {"scale", Kind::Float, 1, 0, INFINITY, "interior", "factor of the absorption"},
        {"interpolation", Kind::Int, 0, 0, 1, "", "B-splines of squared indices", Splines},
        {"step", Kind::Float, 1, 1e-3, 256, "none: a setting of the numerical solution",
         "length of steps in shortest sides of a voxel, at most"},
        {"max_steps", Kind::Int, 0, 0, 1e9, "",
         "after which a ray is given up; 0: the steps along 8 times three edges of the grid"},
    };
    static constexpr Model model = {
        "medium", "gradientindex",      "A medium whose index of refraction varies: light in it bends.", fields, 11,
        0,        "GradientIndexMedium"};
};

}  // namespace tr
