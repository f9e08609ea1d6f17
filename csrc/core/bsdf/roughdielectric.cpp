// `roughdielectric`: an interface that is as rough in all directions.
#include "microfacet_dielectric.h"

namespace tr {

struct RoughDielectric : MicrofacetDielectric<RoughDielectric> {
    static constexpr Field fields[] = {
        {"eta", Kind::Float, 1.5046 / 1.000277, 1e-3, 1e3, "interior",
         "index of refraction inside (below the surface) over outside; within 1e-3 of 1 it counts as 1.001 or 0.999"},
        {"alpha", Kind::Scalar, 0.1, 0, 10, "interior",
         "roughness of the microfacet distribution; below 0.001 it counts as that"},
        {"specular_reflectance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical", nullptr, Optional},
        {"specular_transmittance", Kind::Texture, 1, 0, 1, "interior", "factor; 1 is physical", nullptr, Optional},
        {"distribution", Kind::Int, 0, 0, 1, "", "of the microfacets' normals", MicrofacetDistributions},
    };
    static constexpr int Eta = number_index(fields, "eta"), Alpha = number_index(fields, "alpha");
    static constexpr int Reflectance = color_index(fields, "specular_reflectance"),
                         Transmittance = color_index(fields, "specular_transmittance");
    static constexpr int Distribution = choice_index(fields, "distribution");
    static constexpr Model model = {"bsdf",
                                    "roughdielectric",
                                    "Rough dielectric interface.",
                                    fields,
                                    5,
                                    HasSmoothLobes | Transmits | IsAsymmetric | ChoosesLobe,
                                    "RoughDielectric"};
    static constexpr int Albedo = field_index(fields, "specular_transmittance");  // what goes through is most of it

    template <class T, class P>
    TR_INLINE static T alpha(const P &params) {
        return T(params.number[Alpha]);
    }
};

TR_BSDF(RoughDielectric)

}  // namespace tr
