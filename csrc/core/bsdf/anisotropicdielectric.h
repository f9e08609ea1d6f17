// `roughdielectric` whose roughness differs along the surface, as that of `anisotropicconductor`. (In Python it is the
// class that RoughDielectric makes of alpha_u and alpha_v.)
#pragma once

#include "roughdielectric.h"

namespace tr {

struct AnisotropicDielectric : DielectricFacets<AnisotropicDielectric> {
    static constexpr Field fields[] = {
        {"eta", Kind::Float, 1.5046 / 1.000277, 1e-3, 1e3, "interior",
         "index of refraction inside (below the surface) over outside; within 1e-3 of 1 it counts as 1.001 or 0.999"},
        {"alpha_u", Kind::Scalar, 0.1, 0, 10, "interior", "roughness along the tangent dp/du, at least 0.001"},
        {"alpha_v", Kind::Scalar, 0.1, 0, 10, "interior", "roughness across it, at least 0.001"},
        {"specular_reflectance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical"},
        {"specular_transmittance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical"},
        {"distribution", Kind::Int, 0, 0, 1, "", "0: beckmann, 1: ggx"},
    };
    static constexpr Model model = {"bsdf", "anisotropicdielectric", "Rough dielectric interface, brushed.", fields, 6};
    static constexpr bool Smooth = true, Delta = false, Oriented = true;
    static constexpr bool Asymmetric = true;
    static constexpr int Albedo = 4;  // what goes through is most of it

    template <class T, class P>
    TR_INLINE static Vec2<T> alpha(const P &params) {
        return {T(params.number[1]), T(params.number[2])};
    }
};

}  // namespace tr
