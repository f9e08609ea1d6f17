// `roughdielectric` whose roughness differs along the surface, as that of `anisotropicconductor`. (In Python it is the
// class that RoughDielectric makes of alpha_u and alpha_v.)
#include "microfacet_dielectric.h"

namespace tr {

struct AnisotropicDielectric : MicrofacetDielectric<AnisotropicDielectric> {
    static constexpr Field fields[] = {
        {"eta", Kind::Float, 1.5046 / 1.000277, 1e-3, 1e3, "interior",
         "index of refraction inside (below the surface) over outside; within 1e-3 of 1 it counts as 1.001 or 0.999"},
        {"alpha_u", Kind::Scalar, 0.1, 0, 10, "interior", "roughness along the tangent dp/du, at least 0.001"},
        {"alpha_v", Kind::Scalar, 0.1, 0, 10, "interior", "roughness across it, at least 0.001"},
        {"specular_reflectance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical", nullptr, Optional},
        {"specular_transmittance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical", nullptr, Optional},
        {"distribution", Kind::Int, 0, 0, 1, "", "of the microfacets' normals", MicrofacetDistributions},
    };
    static constexpr int Eta = number_index(fields, "eta"), AlphaU = number_index(fields, "alpha_u"),
                         AlphaV = number_index(fields, "alpha_v");
    static constexpr int Reflectance = color_index(fields, "specular_reflectance"),
                         Transmittance = color_index(fields, "specular_transmittance");
    static constexpr int Distribution = choice_index(fields, "distribution");
    static constexpr Model model = {"bsdf",
                                    "anisotropicdielectric",
                                    "Rough dielectric interface, brushed.",
                                    fields,
                                    6,
                                    HasSmoothLobes | FollowsTangent | Transmits | IsAsymmetric | ChoosesLobe,
                                    "AnisotropicDielectric"};
    static constexpr int Albedo = field_index(fields, "specular_transmittance");  // what goes through is most of it

    template <class T, class P>
    TR_INLINE static Vec2<T> alpha(const P &params) {
        return {T(params.number[AlphaU]), T(params.number[AlphaV])};
    }
};

TR_BSDF(AnisotropicDielectric)

}  // namespace tr
